//! [Stam 2020], Computing light transport gradients using the adjoint method.
//!
//! The scene of section 6 and paths through it are in [`cornell`] and [`fixed_path`]; every other module is
//! one figure or algorithm. Where the paper's text or pseudocode is wrong, the printed form is kept here
//! - and only here - to be measured beside the corrected one.

pub mod brdf;
pub mod cornell;
pub mod fixed_path;
pub mod gradient_images;
pub mod gradient_table;
pub mod path_tracer;
pub mod path_view;
pub mod printed;
pub mod recursion;
pub mod sampling;
