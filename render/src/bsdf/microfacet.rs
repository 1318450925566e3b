//! Microfacet distributions: how the normals of a rough surface are distributed, how much of each
//! other they hide, and how to sample them.
//!
//! With `D` the density of normals [Zeltner 2021, Eqs. 2.40, 2.41] and `w` a direction, everything is
//! written in terms of one function besides `D`, the area of the microsurface as seen from `w`,
//! `sigma(w) = integral of D(m) max(w.m, 0) dm = cos(theta_w) / G1(w)`. Unlike `G1 / cos` and
//! `tan(theta)` it is finite and smooth at grazing angles, and the cosines cancel for good:
//!
//! - masking `G1(w) = cos / sigma` [Eqs. 2.43, 2.44, the exact Smith forms],
//! - reflection `f cos_i = F D cos_i / (4 sigma_o sigma_i)` with `G = G1(wo) G1(wi)` [Eq. 2.45],
//! - density of visible normals `D (w.m) / sigma(w)`.
//!
//! `1 - cos^2` is never formed; normals are scaled by `1 / alpha` before they are squared. That keeps
//! single precision accurate to a few roundings for roughness down to 1e-4.

use std::f64::consts::PI;

use ad_core::{Const, Float, Real, Vec3};

use super::slopes;
use crate::math::gauss::{exp_minus, largest};
use crate::math::warp;

/// Valid values of a roughness.
pub const ALPHA_RANGE: (f64, f64) = (1e-4, 1.0);

/// The shape of a distribution of normals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Ndf {
    /// Gaussian slopes with standard deviation `alpha / sqrt(2)` per axis.
    Beckmann,
    /// Slopes with a long tail (Trowbridge-Reitz).
    Ggx,
}

/// Roughness as a number, the same in all directions, or as one number along each axis of the surface.
///
/// A surface of any roughness is one of roughness 1 whose slopes along either axis were multiplied: all that is known
/// of that one is known of all.
pub trait Alpha: Copy {
    /// Its numbers.
    type Scalar: Real;
    /// The same without tangents.
    type Primal: Alpha<Scalar = <Self::Scalar as Real>::Primal>;

    /// The same without tangents.
    fn primal(self) -> Self::Primal;
    /// The number, if it is one.
    fn isotropic(self) -> Option<Self::Scalar>;
    /// Roughness along the first and the second axis of the surface.
    fn axes(self) -> [Self::Scalar; 2];
    /// What has that roughness along them; the first, where it is the same along both.
    fn along(axes: [Self::Scalar; 2]) -> Self;
    /// [`Microfacet::d`] of GGX surfaces.
    fn ggx_d(self, m: Vec3<Self::Scalar>) -> Self::Scalar;
    /// [`Microfacet::sigma`] of GGX surfaces.
    fn ggx_sigma(self, w: Vec3<Self::Scalar>) -> Self::Scalar;
    /// Length of the part of `w` along the surface, each axis times its roughness.
    fn spread(self, w: Vec3<Self::Scalar>) -> Self::Scalar;
}

impl<R: Real> Alpha for R {
    type Scalar = R;
    type Primal = R::Primal;

    #[inline(always)]
    fn primal(self) -> R::Primal {
        Real::primal(self)
    }
    #[inline(always)]
    fn isotropic(self) -> Option<R> {
        Some(self)
    }
    #[inline(always)]
    fn axes(self) -> [R; 2] {
        [self; 2]
    }
    #[inline(always)]
    fn along([alpha, _]: [R; 2]) -> R {
        alpha
    }
    #[inline(always)]
    fn ggx_d(self, m: Vec3<R>) -> R {
        ggx_d(self, m)
    }
    #[inline(always)]
    fn ggx_sigma(self, w: Vec3<R>) -> R {
        ggx_sigma(self, w)
    }
    #[inline(always)]
    fn spread(self, w: Vec3<R>) -> R {
        self * (w.x.square() + w.y.square()).sqrt()
    }
}

/// Roughness along the first axis of the surface, along dp/du, and along the second.
#[derive(Clone, Copy, Debug)]
pub struct Axes<R>(pub [R; 2]);

impl<R: Real> Alpha for Axes<R> {
    type Scalar = R;
    type Primal = Axes<R::Primal>;

    #[inline]
    fn primal(self) -> Axes<R::Primal> {
        Axes(self.0.map(Real::primal))
    }
    #[inline(always)]
    fn isotropic(self) -> Option<R> {
        None
    }
    #[inline(always)]
    fn axes(self) -> [R; 2] {
        self.0
    }
    #[inline(always)]
    fn along(axes: [R; 2]) -> Self {
        Self(axes)
    }
    #[inline(always)]
    fn ggx_d(self, m: Vec3<R>) -> R {
        let Self([u, v]) = self;
        let (x, y) = (m.x / u, m.y / v);
        let d = (u * v * R::c(PI) * (x.square() + y.square() + m.z.square()).square()).recip();
        R::select(m.z.primal() > R::Primal::zero(), d, R::zero())
    }
    #[inline(always)]
    fn ggx_sigma(self, w: Vec3<R>) -> R {
        let Self([u, v]) = self;
        let spread = (u * w.x).square() + (v * w.y).square();
        (w.z.abs() + (w.z.square() + spread).sqrt()) * R::c(0.5)
    }
    #[inline(always)]
    fn spread(self, w: Vec3<R>) -> R {
        let Self([u, v]) = self;
        let squared = (u * w.x).square() + (v * w.y).square();
        // A root has no slope at zero, nor has what is made of this one.
        let none = squared.primal() <= R::Primal::MIN_POSITIVE;
        R::select(none, R::zero(), squared.sqrt())
    }
}

/// A distribution of microfacet normals, and which of them are sampled.
#[derive(Clone, Copy, Debug)]
pub struct Microfacet<A> {
    /// Its shape.
    pub kind: Ndf,
    /// Roughness, in [1e-4, 1].
    pub alpha: A,
    /// Sample the normals visible from a direction instead of all of them.
    pub visible: bool,
}

impl<R: Real, A: Alpha<Scalar = R>> Microfacet<A> {
    /// The same without tangents.
    #[inline]
    pub fn primal(&self) -> Microfacet<A::Primal> {
        Microfacet {
            kind: self.kind,
            alpha: self.alpha.primal(),
            visible: self.visible,
        }
    }

    /// The same, if it is the same in all directions.
    #[inline]
    pub fn isotropic(&self) -> Option<Microfacet<R>> {
        let &Self { kind, visible, .. } = self;
        let alpha = self.alpha.isotropic()?;
        Some(Microfacet {
            kind,
            alpha,
            visible,
        })
    }

    /// Density of normals `D(m)`, per solid angle and unit of macroscopic area; zero below the
    /// horizon. Integrates to one over projected solid angle.
    #[inline]
    pub fn d(&self, m: Vec3<R>) -> R {
        self.d_in_line(m)
    }

    /// [`Microfacet::d`] where loops over many go through it.
    #[inline(always)]
    pub(crate) fn d_in_line(&self, m: Vec3<R>) -> R {
        match self.kind {
            Ndf::Ggx => self.alpha.ggx_d(m),
            Ndf::Beckmann => {
                let [u, v] = self.alpha.axes();
                let area = u * v * R::c(PI);
                let steepness = (m.x / (u * m.z)).square() + (m.y / (v * m.z)).square();
                // In the far tail the exponential is no normal number: 0 * inf.
                let far = steepness.primal() > largest();
                let near = R::select(far, R::zero(), steepness);
                let d = exp_minus(near) / (area * m.z.square().square());
                let above = m.z.primal() > R::Primal::zero();
                R::select(above & !far, d, R::zero())
            }
        }
    }

    /// Projected area of the microfacets visible from `w`, on either side; `|cos| / G1`. Positive.
    #[inline]
    pub fn sigma(&self, w: Vec3<R>) -> R {
        match self.kind {
            Ndf::Ggx => self.alpha.ggx_sigma(w),
            Ndf::Beckmann => slopes::sigma(w.z.abs(), self.alpha.spread(w)),
        }
    }

    /// Masking: the part of the microfacets facing `w` that is visible from there, in [0, 1]; zero if
    /// `w` sees the normal `m` and the surface from different sides.
    #[inline]
    pub fn g1(&self, w: Vec3<R>, m: Vec3<R>) -> R {
        let zero = R::Primal::zero();
        if (w.dot(m).primal() > zero) != (w.z.primal() > zero) {
            return R::zero();
        }
        w.z.abs() / self.sigma(w)
    }

    /// Samples a normal, for `w` in the upper hemisphere. May face away from `w` unless `visible`.
    ///
    /// # Derivatives
    /// In roughness and `w`, at fixed `u`.
    #[inline]
    pub fn sample(&self, w: Vec3<R>, u: [R::Primal; 2]) -> Vec3<R> {
        if self.visible {
            self.sample_visible(w, u)
        } else {
            self.sample_all(u)
        }
    }

    /// Density of [`Microfacet::sample`] per solid angle of the normal.
    #[inline]
    pub fn pdf(&self, w: Vec3<R>, m: Vec3<R>) -> R {
        if self.visible {
            self.pdf_visible(w, m)
        } else {
            self.pdf_all(m)
        }
    }

    /// Density of the reflected direction when [`Microfacet::sample`] gave `m`: the density of
    /// normals over `4 w.m`, which cancels for visible ones.
    #[inline]
    pub fn pdf_reflected(&self, w: Vec3<R>, m: Vec3<R>) -> R {
        self.pdf_reflected_where(self.d(m), w, m, || self.sigma(w))
    }

    /// The same where `D(m)` and `sigma(w)` are known.
    #[inline(always)]
    pub(super) fn pdf_reflected_where(
        &self,
        d: R,
        w: Vec3<R>,
        m: Vec3<R>,
        sigma: impl FnOnce() -> R,
    ) -> R {
        if self.visible {
            d / (sigma() * R::c(4.0))
        } else {
            // Closer to grazing, derivatives leave the range of single precision.
            let cos = w.dot(m).abs();
            if cos.primal() < R::Primal::of(1e-8) {
                return R::zero();
            }
            d * m.z / (cos * R::c(4.0))
        }
    }

    /// A normal with density `D(m) cos(theta_m)`.
    #[inline]
    pub fn sample_all(&self, u: [R::Primal; 2]) -> Vec3<R> {
        let one = R::Primal::one();
        // tan(theta) / alpha
        let t = match self.kind {
            Ndf::Ggx => (u[0] / (one - u[0])).sqrt(),
            Ndf::Beckmann => (-(-u[0]).ln_1p()).sqrt(),
        };
        let (sin, cos) = warp::sin_cos_of_turns(u[1]);
        let [along, across] = self.alpha.axes();
        Vec3::new(along * Const(t * cos), across * Const(t * sin), R::one()).normalize()
    }

    /// Density of [`Microfacet::sample_all`].
    #[inline]
    pub fn pdf_all(&self, m: Vec3<R>) -> R {
        self.d(m) * m.z
    }

    /// A normal with density `D(m) max(w.m, 0) / sigma(w)`, for `w` above the horizon.
    ///
    /// A surface of roughness alpha is one of roughness 1 that was compressed vertically, so only
    /// that one is sampled: GGX as a hemisphere by [Dupuy and Benyoub 2023], Beckmann by inverting
    /// the exact CDF of the slope along `w` [Heitz and d'Eon 2014] to machine precision.
    #[inline]
    pub fn sample_visible(&self, w: Vec3<R>, u: [R::Primal; 2]) -> Vec3<R> {
        let [along, across] = self.alpha.axes();
        let stretched = Vec3::new(along * w.x, across * w.y, w.z).normalize();
        let m = match self.kind {
            Ndf::Ggx => ggx_visible(stretched, u),
            Ndf::Beckmann => {
                let side = Side::of(stretched);
                side.normal(slopes::visible([stretched.z, side.sine], u))
            }
        };
        Vec3::new(along * m.x, across * m.y, m.z).normalize()
    }

    /// Density of [`Microfacet::sample_visible`].
    #[inline]
    pub fn pdf_visible(&self, w: Vec3<R>, m: Vec3<R>) -> R {
        let cos = w.dot(m);
        if cos.primal() <= R::Primal::zero() {
            return R::zero();
        }
        self.d(m) * cos / self.sigma(w)
    }
}

impl<P: Float, A: Alpha<Scalar = P>> Microfacet<A> {
    /// [`Microfacet::sigma`] where loops over many go through it.
    #[inline(always)]
    pub(crate) fn sigma_in_line(&self, w: Vec3<P>) -> P {
        match self.kind {
            Ndf::Ggx => self.alpha.ggx_sigma(w),
            Ndf::Beckmann => slopes::sigma_in_line(w.z.abs(), self.alpha.spread(w)),
        }
    }

    /// [`Microfacet::sample_visible`], and whether that is right: without branches, as [`Vec3::unit`].
    #[inline(always)]
    pub(crate) fn sample_visible_in_line(&self, w: Vec3<P>, u: [P; 2]) -> (Vec3<P>, bool) {
        let [along, across] = self.alpha.axes();
        let (stretched, sane) = Vec3::new(along * w.x, across * w.y, w.z).unit();
        let (m, found) = match self.kind {
            Ndf::Ggx => (ggx_visible(stretched, u), true),
            Ndf::Beckmann => {
                let side = Side::of(stretched);
                let (slopes, right) = slopes::visible_in_line([stretched.z, side.sine], u);
                (side.normal(slopes), right)
            }
        };
        let (m, right) = Vec3::new(along * m.x, across * m.y, m.z).unit();
        (m, sane & right & found)
    }
}

impl<P: Float> Microfacet<P> {
    /// The change of the logarithm of what facets with the normal `m` reflect between `wo` and `wi`, in proportion to
    /// `D / (sigma_o sigma_i)`, with the roughness. Without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn log_slope_in_line(&self, m: Vec3<P>, [wo, wi]: [Vec3<P>; 2]) -> P {
        let (alpha, two) = (self.alpha, P::of(2.0));
        let (x, y) = (m.x / alpha, m.y / alpha);
        let steep = x.square() + y.square();
        let steepness = match self.kind {
            Ndf::Ggx => two * steep / (steep + m.z.square()),
            Ndf::Beckmann => steep / m.z.square(),
        };
        let of_d = (steepness - P::one()) * two / alpha;
        of_d - self.log_slope_of_sigma(wo) - self.log_slope_of_sigma(wi)
    }

    /// The change of the logarithm of [`Microfacet::sigma`] with the roughness.
    #[inline(always)]
    fn log_slope_of_sigma(&self, w: Vec3<P>) -> P {
        let s2 = w.x.square() + w.y.square();
        match self.kind {
            Ndf::Ggx => {
                let c = w.z.abs();
                let root = (c.square() + self.alpha.square() * s2).sqrt();
                self.alpha * s2 / (root * (c + root))
            }
            Ndf::Beckmann => {
                let spread = self.alpha.spread(w);
                s2.sqrt() * slopes::log_slope_in_line(w.z.abs(), spread)
            }
        }
    }
}

/// [`Microfacet::d`] of GGX surfaces.
#[inline(always)]
fn ggx_d<R: Real>(alpha: R, m: Vec3<R>) -> R {
    let area = alpha.square() * R::c(PI);
    let (x, y) = (m.x / alpha, m.y / alpha);
    let d = (area * (x.square() + y.square() + m.z.square()).square()).recip();
    R::select(m.z.primal() > R::Primal::zero(), d, R::zero())
}

/// [`Microfacet::sigma`] of GGX surfaces.
#[inline(always)]
fn ggx_sigma<R: Real>(alpha: R, w: Vec3<R>) -> R {
    let c = w.z.abs();
    let s2 = w.x.square() + w.y.square();
    (c + (c.square() + alpha.square() * s2).sqrt()) * R::c(0.5)
}

/// A visible normal of the GGX surface of roughness 1, not normalised: the half-vector of `w` and a
/// uniform point `c` on the spherical cap `c.z > -w.z`.
#[inline(always)]
fn ggx_visible<R: Real>(w: Vec3<R>, u: [R::Primal; 2]) -> Vec3<R> {
    let above = w.z + R::c(1.0);
    // 1 - w.z without cancellation.
    let below = (w.x.square() + w.y.square()) / above;
    let height = above * Const(R::Primal::one() - u[1]);
    // sin^2 = (1 - c.z)(1 + c.z) with c.z = height - w.z
    let sin = (above * Const(u[1]) * (below + height)).sqrt();
    let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[0]);
    Vec3::new(
        sin * Const(cos_phi) + w.x,
        sin * Const(sin_phi) + w.y,
        height,
    )
}

/// Where a direction points along the surface.
#[derive(Clone, Copy)]
struct Side<R> {
    sine: R,
    cos_phi: R,
    sin_phi: R,
}

impl<R: Real> Side<R> {
    #[inline(always)]
    fn of(w: Vec3<R>) -> Self {
        let s2 = w.x.square() + w.y.square();
        let at_pole = s2.primal() <= R::Primal::MIN_POSITIVE / R::Primal::EPSILON;
        let s = s2.sqrt();
        Self {
            sine: R::select(at_pole, R::zero(), s),
            cos_phi: R::select(at_pole, R::one(), w.x / s),
            sin_phi: R::select(at_pole, R::zero(), w.y / s),
        }
    }

    /// A normal, not normalised, of slopes along the direction and across.
    #[inline(always)]
    fn normal(&self, [along, across]: [R; 2]) -> Vec3<R> {
        let &Self {
            cos_phi, sin_phi, ..
        } = self;
        Vec3::new(
            sin_phi * across - cos_phi * along,
            -(cos_phi * across) - sin_phi * along,
            R::one(),
        )
    }
}
