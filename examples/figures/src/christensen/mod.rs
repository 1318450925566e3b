//! [Christensen, Salesin and DeRose 1993], a continuous adjoint formulation for radiance transport.
//!
//! [`boxes`] has the four scenes, which the paper shows but does not specify, and the refinement loop that
//! the figures share.

pub mod boxes;
pub mod eq6_11;
pub mod fig_01;
pub mod fig_02;
pub mod fig_03;
