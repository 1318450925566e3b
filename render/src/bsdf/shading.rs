//! What materials read: textures at a point of a surface.

use ad_core::{Float, Real, Vec2};

use super::chart;
use crate::math::Rgb;
use crate::params::{ParamRef, Theta};
use crate::texture::{RgbTexture, ScalarTexture};

/// How a material's parameters are read: at a point, as seeds of local derivatives, or just listed.
pub trait Reader<R: Real> {
    /// The colour of `t`.
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<R>;
    /// The value of `t`.
    fn scalar(&mut self, t: &ScalarTexture) -> R;
    /// The colour of `t`, of which each channel changes all channels of what is scattered.
    #[inline(always)]
    fn mixed(&mut self, t: &RgbTexture) -> Rgb<R> {
        self.rgb(t)
    }
    /// The value of `t`, the roughness of a microsurface.
    #[inline(always)]
    fn alpha(&mut self, t: &ScalarTexture) -> R {
        self.scalar(t)
    }
    /// The value of `t`, the exponent of a lobe.
    #[inline(always)]
    fn exponent(&mut self, t: &ScalarTexture) -> R {
        self.scalar(t)
    }
}

/// A point on a surface as materials see it.
#[derive(Clone, Copy, Debug)]
pub struct Shading<'a, R: Real> {
    /// All parameters.
    pub theta: Theta<'a, R>,
    /// Surface coordinates.
    pub uv: Vec2<R>,
    /// How long these are, where materials want to know.
    pub(crate) on: Option<OnChart<'a>>,
}

/// Where on a chart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OnChart<'a> {
    pub chart: &'a chart::Chart,
    pub triangle: u32,
}

impl<'a, R: Real> Shading<'a, R> {
    /// At `uv`, which are the coordinates that interactions have.
    #[inline(always)]
    pub fn new(theta: Theta<'a, R>, uv: Vec2<R>) -> Self {
        Self {
            theta,
            uv,
            on: None,
        }
    }

    /// How long dp/du and dp/dv are, as far as that is known: [`super::Charted`].
    #[inline]
    pub(crate) fn stretch(&self) -> chart::Stretch<R> {
        self.on.map_or(chart::Stretch::unit(), |on| {
            on.chart.stretch(self.uv, on.triangle)
        })
    }

    /// The same point without tangents.
    #[inline]
    pub fn primal(&self) -> Shading<'a, R::Primal> {
        Shading {
            theta: self.theta.primal(),
            uv: self.uv.primal(),
            on: self.on,
        }
    }
}

impl<'a, P: Float> Shading<'a, P> {
    /// The same point over a scalar with tangents, all of them zero.
    #[inline]
    pub fn lift<R: Real<Primal = P>>(&self) -> Shading<'a, R> {
        Shading {
            theta: self.theta.lift(),
            uv: Vec2::lift(self.uv),
            on: self.on,
        }
    }
}

impl<R: Real> Reader<R> for &Shading<'_, R> {
    #[inline(always)]
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<R> {
        t.rgb(&self.theta, self.uv)
    }
    #[inline(always)]
    fn scalar(&mut self, t: &ScalarTexture) -> R {
        t.scalar(&self.theta, self.uv)
    }
}

/// A texture of a material, and how results depend on it.
#[derive(Clone, Copy, Debug)]
pub enum TextureRef<'a> {
    /// Channel c of a result depends on channel c only.
    Rgb(&'a RgbTexture),
    /// One number.
    Scalar(&'a ScalarTexture),
    /// One number: the roughness of a microsurface.
    Alpha(&'a ScalarTexture),
    /// One number: the exponent of a lobe.
    Exponent(&'a ScalarTexture),
    /// A colour whose channels mix.
    Mixed(&'a RgbTexture),
    /// A vector: channels mix.
    Vector(&'a RgbTexture),
    /// A vector that is not linear in the texels.
    Encoded(&'a RgbTexture),
    /// Numbers of which the slope counts, or a factor on it.
    Height(&'a ScalarTexture),
}

impl TextureRef<'_> {
    /// Whether it has the same value everywhere.
    pub fn is_constant(&self) -> bool {
        match self {
            Self::Rgb(t) | Self::Mixed(t) | Self::Vector(t) | Self::Encoded(t) => {
                matches!(t, RgbTexture::Constant(_))
            }
            Self::Scalar(t) | Self::Alpha(t) | Self::Exponent(t) | Self::Height(t) => {
                matches!(t, ScalarTexture::Constant(_))
            }
        }
    }

    /// See [`RgbTexture::closes`].
    pub(crate) fn closes(&self, around: usize) -> bool {
        match self {
            Self::Rgb(t) | Self::Mixed(t) | Self::Vector(t) | Self::Encoded(t) => t.closes(around),
            Self::Scalar(t) | Self::Alpha(t) | Self::Exponent(t) => t.closes(around),
            Self::Height(_) => self.is_constant(),
        }
    }

    /// See [`RgbTexture::jumps`].
    pub(crate) fn jumps(&self) -> bool {
        match self {
            Self::Rgb(t) | Self::Mixed(t) | Self::Vector(t) | Self::Encoded(t) => t.jumps(),
            Self::Scalar(t) | Self::Alpha(t) | Self::Exponent(t) => t.jumps(),
            // Slopes do, between texels.
            Self::Height(_) => !self.is_constant(),
        }
    }

    /// See [`RgbTexture::any_param`].
    #[inline]
    pub fn any_param(&self, f: impl FnMut(ParamRef) -> bool) -> bool {
        match self {
            Self::Rgb(t) | Self::Mixed(t) | Self::Vector(t) | Self::Encoded(t) => t.any_param(f),
            Self::Scalar(t) | Self::Alpha(t) | Self::Exponent(t) | Self::Height(t) => {
                t.any_param(f)
            }
        }
    }

    /// See [`RgbTexture::visit_params`].
    pub fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
        match self {
            Self::Rgb(t) | Self::Mixed(t) | Self::Vector(t) | Self::Encoded(t) => t.visit_params(f),
            Self::Scalar(t) | Self::Alpha(t) | Self::Exponent(t) | Self::Height(t) => {
                t.visit_params(f);
            }
        }
    }
}
