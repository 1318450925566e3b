//! Two constants in alternating squares.

use ad_core::{Float, Vec2};

use super::bitmap::UvTransform;
use crate::params::ParamRef;

/// A checkerboard with period one in `uv`, as Mitsuba 3 draws it: `color0` where both halves agree.
#[derive(Clone, Debug)]
pub struct Checkerboard {
    /// `color0` and `color1`.
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
