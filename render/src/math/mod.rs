//! Geometry and colour over any scalar: one type per file.
//!
//! ```
//! use ad_core::Vec3;
//! use render::math::{Frame, Transform, warp};
//!
//! let up = Transform::rotate([1.0, 0.0, 0.0], -90.0).expect("an axis");
//! let n = up.vector([0.0, 0.0, 1.0]);
//! let frame = Frame::from_normal(Vec3::from(n));
//! let d = frame.to_world(warp::square_to_cosine_hemisphere([0.3, 0.8]));
//! assert!(d.y > 0.0 && (d.length() - 1.0).abs() < 1e-12);
//! ```

pub mod angle;
pub(crate) mod bessel;
mod frame;
pub(crate) mod gauss;
mod ray;
mod rgb;
pub(crate) mod search;
mod transform;
pub mod warp;

/// `f` of each of three. Unlike `map` of arrays it is inlined wherever it is called: that is not marked so, and a
/// call per component would be made between parts of the crate that are compiled apart.
#[inline(always)]
pub(crate) fn each<T, U>([x, y, z]: [T; 3], f: impl Fn(T) -> U) -> [U; 3] {
    [f(x), f(y), f(z)]
}

/// The same of two.
#[inline(always)]
pub(crate) fn both<T, U>([a, b]: [T; 2], f: impl Fn(T) -> U) -> [U; 2] {
    [f(a), f(b)]
}

pub use ad_core::{Vec2, Vec3};
pub use frame::Frame;
pub use ray::{NOWHERE, Ray, RayAdjoint, Segment};
pub use rgb::{LUMINANCE, Rgb, rgb_of_xyz};
pub use transform::Transform;
