//! Geometry and colour over any scalar: one type per file.

pub mod angle;
mod frame;
pub(crate) mod gauss;
mod ray;
mod rgb;
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
