//! Light transport over a scalar: render, differentiate, compare estimators.
//!
//! The renderer is written once over [`ad_core::Real`]. With `f32` it renders; with `f64` it is its
//! own reference; with [`ad_core::Dual`] it renders derivative images (forward mode); and over recorded
//! paths it pulls an adjoint image back to all parameters at once (reverse mode). Where derivatives may
//! flow is a type: see [`estimator`].
//!
//! # One step of inverse rendering
//!
//! A scene is loaded and rendered, the picture is compared with a target, the derivative of the loss in every pixel is
//! pulled back to a parameter, and an optimiser moves that. Image and gradient take different seeds (errata Z-4.4).
//!
//! ```
//! # std::env::set_current_dir("..")?; // the examples run in the folder of this crate
//! use optim::{Adam, Loss, Optimizer, loss::L2};
//! use render::instances::{Estimator, render_f32};
//! use render::{Image, Job, Scene, image_io::write_exr, params::Theta};
//!
//! let (mut scene, _warnings) = Scene::load("examples/scenes/cornell.xml".as_ref(), &Default::default())?;
//! let mut values = scene.params().values().to_vec(); // all parameters, one vector
//! let theta = Theta::constant(&values);
//! let job = |seed| Job::new(&scene, &scene.settings, seed, 0..16, &());
//! let image = render_f32(&job(0), &theta, Estimator::Mis).image(0);
//!
//! let target = Image::new(image.width, image.height); // black
//! let mut adjoint = vec![0.0; image.data.len()]; // [height][width][3], as the image
//! L2.gradient(&image.data, &target.data, &mut adjoint)?;
//! let active = Estimator::Mis.active(&scene, &["red.reflectance.value"])?;
//! let gradient = Estimator::Mis.backward_f32(&job(1), &theta, &active, &adjoint)?;
//!
//! let gradient: Vec<f32> = gradient.values[0].iter().map(|&d| d as f32).collect();
//! let wall = scene.params().find("red.reflectance.value")?.range();
//! Adam::new(wall.len(), 0.02)?.step(&mut values[wall], &gradient)?;
//! scene.set_params(&values)?;
//! write_exr("before.exr".as_ref(), &image)?;
//! # assert!((values[scene.params().find("red.reflectance.value")?.range()][0] - 0.63).abs() < 1e-3);
//! # std::fs::remove_file("before.exr")?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Where to go on
//!
//! | for | see |
//! |---|---|
//! | scenes from files and from code, parameters, settings | [`scene`], [`params`], [`scene::Builder`] |
//! | images, gradients and derivative images | [`instances`] |
//! | what an estimator is, and which are right | [`estimator`] |
//! | an estimator that chooses by itself | [`auto`] |
//! | materials, and how to write one | [`bsdf`] |
//! | second derivatives | [`integrator::second_order`] |
//! | particles, density estimation, finite elements | [`integrator::particle`], [`integrator::density`], [`finite_element`] |
//! | image files | [`image_io`] |
//! | whether a gradient is right | [`mod@check`] |
//! | whether estimates agree within chance | [`statistics`] |

pub mod accel;
pub mod auto;
pub mod bsdf;
pub mod camera;
pub mod check;
mod dispatch;
mod edges;
pub mod emitter;
pub mod error;
pub mod estimator;
pub mod files;
pub mod film;
pub mod finite_element;
pub mod glint;
pub mod guide;
pub mod image_io;
mod inputs;
pub mod instances;
pub mod integrator;
pub mod manifold;
pub mod math;
pub mod motion;
mod parallel;
pub mod params;
pub mod plugin;
mod prefetch;
pub mod sampler;
pub mod scene;
pub mod shape;
pub mod statistics;
pub mod texture;

pub use error::{RenderError, SceneError};
pub use film::{Film, Image};
pub use integrator::Job;
pub use scene::{Scene, Settings};
