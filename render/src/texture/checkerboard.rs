//! Two constants in alternating squares.

use ad_core::{Float, Vec2};

use super::bitmap::UvTransform;
use crate::params::ParamRef;

/// A checkerboard with period one in `uv`.
#[derive(Clone, Debug)]
pub struct Checkerboard {
    /// Where `u` and `v` are in the same halves of their periods, and where they are not.
    pub colors: [ParamRef; 2],
    /// Applied to `uv` first.
    pub to_uv: UvTransform,
}

impl Checkerboard {
    /// The constant that holds at `uv`.
    #[inline]
    pub fn select<P: Float>(&self, uv: Vec2<P>) -> ParamRef {
        let uv = self.to_uv.apply(uv);
        let half = |x: P| x.rem_euclid(P::c(1.0)) > P::of(0.5);
        self.colors[usize::from(half(uv.x) != half(uv.y))]
    }
}
