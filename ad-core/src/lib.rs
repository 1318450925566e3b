//! Differentiation without a tape: dual numbers and local adjoints over one scalar trait.

pub mod dual;
pub mod elementary;
pub mod mat;
pub mod real;
pub mod vec;

pub use dual::Dual;
pub use mat::{Mat2, Mat3, block_tridiagonal_solve};
pub use real::{Const, Float, Real};
pub use vec::{Vec2, Vec3};
