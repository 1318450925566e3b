//! [Stam 2020], Computing light transport gradients using the adjoint method.
//!
//! The scene of section 6 and paths through it are in [`cornell`] and [`fixed_path`]. Where the paper's text or
//! pseudocode is wrong, the printed form is kept here - and only here - to be measured beside the corrected one.

pub mod alg_5_2;
pub mod alg_b;
pub mod alg_c;
pub mod alg_d;
pub mod cornell;
pub mod fig_05;
pub mod fig_06;
pub mod fig_07;
pub mod fig_08;
pub mod fixed_path;
mod gradient_images;
pub mod printed;
