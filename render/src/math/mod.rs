//! Geometry and colour over any scalar: one type per file.

mod transform;

pub use transform::Transform;
