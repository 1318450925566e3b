//! Specular manifolds: light over chains of mirrors and glass that sampling cannot find.
//!
//! A *connection* goes from a vertex that is not specular over one to K specular ones, the *chain*, to a sampled point of a
//! light. A chain is a root of the constraints of its vertices ([`constraint`]), which walks find by Newton's method
//! ([`Space::walk`]) from random starts ([`Connector`]); what light along it is worth says the generalised geometric term
//! ([`Solution::angle_per_target`]). Everything here is in double precision, whatever paths are in.
//!
//! # Who finds what
//! The space of paths is split once and for all, by [`Split::next`]: what connections can represent is theirs, everything
//! else that of ordinary sampling, which leaves their light out. Both sides ask the same function, so that the image is
//! that of the path tracer.
//!
//! # Solutions that are one
//! Two walks ended in the same root if they are nearer than both may be off. Of a sample of them that is proved, by interval arithmetic
//! ([`Space::sameness`]), and [`Statistics`] say how many proofs succeeded.
//!
//! # All chains, without trials
//! Where chains have one vertex, on smooth surfaces without normal maps, [`Space::every`] finds every one of them and proves that
//! there is no other ([`crate::scene::Method::Complete`]): nothing is random but the point of the light. It takes much longer than
//! random walks, and is there to know what these should find.
//!
//! # Rough casters
//! Of metal and glass that are rough, the normal of one facet per vertex is drawn for each estimate and kept through all its
//! walks; the chain is that of a mirror with this offset normal, and its light is worth the value of the material over the
//! density of the direction that the facet scatters into. Derivatives are those of the value: directions stay.
//!
//! # One walk, and paths for what it misses
//! The unbiased form of manifold next event estimation: paths that scatter over a chain onto a light count where the walks
//! between the same two ends do not find it ([`Connector::finds`]).
//!
//! ```
//! use render::instances::{Estimator, render_f32};
//! use render::params::Theta;
//! use render::scene::{Connections, LoadOptions, Method};
//! use render::{Job, Scene, Settings};
//!
//! let file = "../examples/scenes/glass.xml".as_ref();
//! let small = LoadOptions { defines: vec![("res".into(), "16".into())], ..Default::default() };
//! let (scene, _warnings) = Scene::load(file, &small)?;
//! let theta = Theta::constant(scene.params().values());
//! let connected = Settings { connections: Some(Connections::new(Method::Sms)), ..scene.settings };
//! let found = render_f32(&Job::new(&scene, &connected, 0, 0..4, &()), &theta, Estimator::Mis);
//! let walks = found.connections;
//! assert!(walks.walks > 0 && found.image(0).data.iter().all(|v| v.is_finite()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Does not handle
//! Bump maps. Roughness that changes over a shape, or is not the same along all tangents. Continua of solutions, as on the axis
//! of a mirrored cylinder (F21): walks end there somewhere or nowhere, in bounded time, and the estimate is of no use.
//!
//! # Source
//! [Zeltner 2021, chapter 3] with errata Z-3.9, Z-3.11, Z-3.13, Z-Alg-3.1, Z-3.19 and Z-A.3; [Hanika et al. 2015]; [Jakob and Marschner 2012].

mod chain;
mod connector;
pub mod constraint;
mod enumeration;
mod estimate;
mod landing;
mod met;
mod normal;
mod particles;
mod sameness;
mod space;
mod split;
mod walk;

pub use chain::{Chain, Derivative, Event, Row, Vertex};
pub(crate) use connector::cast;
pub use connector::{Connection, Connector, Link, Statistics};
pub use enumeration::{Every, Pieces};
pub(crate) use estimate::Asking;
pub use estimate::{distinct, trials};
pub use met::Met;
pub use normal::{Normal, Slopes};
pub use sameness::Sameness;
pub use space::{Space, Start, Target};
pub(crate) use split::chosen;
pub use split::{Run, Split};
pub use walk::Solution;

#[cfg(test)]
mod tests;
