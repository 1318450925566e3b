//! Two constants, or images, in alternating squares.

use ad_core::{Float, Real, Vec2};

use super::bitmap::{Bitmap, UvTransform};
use super::{Footprint, Interpolated};
use crate::params::ParamRef;

/// A checkerboard with period one in `uv`, of constants unless said otherwise.
#[derive(Clone, Debug)]
pub struct Checkerboard<T = ParamRef> {
    /// Where `u` and `v` are in the same halves of their periods, and where they are not.
    pub colors: [T; 2],
    /// Applied to `uv` first.
    pub to_uv: UvTransform,
}

impl<T> Checkerboard<T> {
    /// What holds at `uv`.
    #[inline(always)]
    pub fn select<P: Float>(&self, uv: Vec2<P>) -> &T {
        let uv = self.to_uv.apply(uv);
        let half = |x: P| x - x.floor() > P::of(0.5);
        &self.colors[usize::from(half(uv.x) != half(uv.y))]
    }
}

/// What squares show, at coordinates of the surface.
#[derive(Clone, Debug)]
pub enum Square {
    /// The same value everywhere.
    Constant(ParamRef),
    /// An image.
    Bitmap(Bitmap),
}

impl Interpolated for Square {
    #[inline]
    fn param(&self) -> ParamRef {
        match self {
            Self::Constant(p) => *p,
            Self::Bitmap(t) => t.param,
        }
    }

    #[inline]
    fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        match self {
            Self::Constant(p) => Footprint::single(*p),
            Self::Bitmap(t) => t.footprint(uv),
        }
    }
}

impl Square {
    /// As [`super::Texture::slopes`].
    pub(super) fn slopes<R: Real>(&self, uv: Vec2<R>) -> Footprint<[R; 2]> {
        match self {
            Self::Bitmap(t) if !t.nearest => t.slopes(uv),
            _ => Footprint::flat(self.param()),
        }
    }
}
