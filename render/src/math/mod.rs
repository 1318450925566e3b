//! Geometry and colour over any scalar: one type per file.

mod frame;
mod ray;
mod rgb;
mod transform;
pub mod warp;

pub use ad_core::{Vec2, Vec3};
pub use frame::Frame;
pub use ray::Ray;
pub use rgb::{LUMINANCE, Rgb};
pub use transform::Transform;
