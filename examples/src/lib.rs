//! Command-line tools, and what they share with the figures.
//!
//! What is to be found from pictures goes through [`optimise`]. The colour of a wall, from a picture of the room:
//!
//! ```
//! use examples::optimise::Problem;
//! use optim::{Adam, Constrained, Groups, Parameterisation};
//! use render::Job;
//! use render::instances::{Estimator, render_f32};
//! use render::params::Theta;
//!
//! let (mut room, wall) = (render::scene::room(8, 8)?, "left.reflectance.value");
//! let truth = room.params().get(wall)?.to_vec();
//! let job = Job::new(&room, &room.settings, 0, 0..256, &());
//! let picture = render_f32(&job, &Theta::constant(room.params().values()), Estimator::Mis).image(0);
//! room.set([(wall, &[0.5; 3][..])])?; // where the search starts
//!
//! let mut problem = Problem::of(room, &[wall], "l2".parse()?, picture)?;
//! let mut groups = Groups::new(3);
//! groups.add(wall, 0..3, Parameterisation::bounded(0.0, 1.0)?)?;
//! let mut optimizer = Constrained::new(Adam::new(3, 0.03)?, groups)?;
//! let mut colour = problem.values();
//! for k in 0..60 {
//!     // An image and a gradient, each with a seed of its own.
//!     problem.step(&mut colour, &mut optimizer, [2 * k + 1, 2 * k + 2], &())?;
//! }
//! for (found, truth) in colour.iter().zip(truth) {
//!     assert!((found - truth).abs() < 0.05, "{found} {truth}");
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | contents |
//! |---|---|
//! | [`tools`] | what each tool does, one module each |
//! | [`optimise`] | the loop of inverse rendering |
//! | [`cli`], [`output`], [`print`](mod@print), [`progress`] | arguments, files, text and bars of all tools |
//! | [`figure`], [`chart`], [`sheet`], [`ranks`] | figures with checks of their claims, and how they are drawn |
//! | [`scene_builder`], [`builtin_scene`] | scenes from code |
//! | [`memory`] | how much memory a computation needs |

pub mod builtin_scene;
pub mod chart;
pub mod cli;
pub mod figure;
pub mod memory;
pub mod optimise;
pub mod output;
pub mod print;
pub mod progress;
pub mod ranks;
pub mod scene_builder;
pub mod sheet;
pub mod solved;
pub mod tools;
