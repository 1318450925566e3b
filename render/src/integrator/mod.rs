//! Light transport: one path tracer for every scalar, strategy and use.
//!
//! [`path::trace`] follows a path and calls an [`record::Observer`]. With `()` it only renders; with a
//! [`record::Recorder`] the vertices are kept, and the adjoint is pulled back through them.
//! [`render`](render::render) and [`gradient`](gradient::Gradient) drive it over an image;
//! [`second_order`] has Hessian-vector products and the Gauss-Newton matrix.

mod active;
mod boundary;
pub mod chain_density;
mod chain_trail;
mod connections;
pub mod convolved;
pub mod coverage;
mod delta;
pub mod density;
pub mod direct;
mod exact;
mod glints;
pub mod gradient;
pub(crate) mod guide_training;
mod integrals;
mod job;
mod local;
mod lockstep;
mod motion;
pub mod noise;
pub mod particle;
pub mod particle_gradient;
mod pass;
pub mod path;
mod paths;
mod progress;
mod projection_map;
pub mod record;
pub mod render;
mod rendering;
pub mod reparameterisation;
pub mod second_order;
pub mod simple;
mod sink;
mod solved;
mod sparse;
mod tile;
pub mod vertex;
mod wave;
pub(crate) mod work;

pub use job::Job;
