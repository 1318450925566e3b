//! How a scattered direction is drawn.

use ad_core::{Real, Vec3};

use crate::bsdf::{Bsdf, BsdfSample, Material, Shading, TransportMode};

/// A way of sampling directions.
pub trait Sampling: Send + Sync + 'static {
    /// The scalar of everything geometric on a path: rays, interactions, directions, densities.
    type Geometry<R: Real>: Real<Primal = R::Primal>;

    /// A geometric quantity in the scalar of the estimate.
    fn embed<R: Real>(g: Self::Geometry<R>) -> R;

    /// A geometric vector in the scalar of the estimate.
    #[inline(always)]
    fn embed3<R: Real>(v: Vec3<Self::Geometry<R>>) -> Vec3<R> {
        Vec3::new(Self::embed(v.x), Self::embed(v.y), Self::embed(v.z))
    }

    /// Draws a direction at a vertex.
    fn draw<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<Self::Geometry<R>>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<Self::Geometry<R>>>;
}

/// Samples are constants [Zeltner 2021, section 4.2.1]: only the integrand is differentiated.
///
/// # Does not handle
/// Parameters that a direction is a Dirac delta in (mirror normals, the index of smooth glass), and
/// moving discontinuities.
#[derive(Clone, Copy, Debug)]
pub struct Detached;

impl Sampling for Detached {
    type Geometry<R: Real> = R::Primal;

    #[inline(always)]
    fn embed<R: Real>(g: R::Primal) -> R {
        R::lift(g)
    }

    #[inline(always)]
    fn draw<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R::Primal>> {
        material.sample(&at.primal(), wo, u, mode)
    }
}

/// Samples move with the parameters [Zeltner 2021, section 4.2.2].
///
/// # Does not handle
/// Discontinuities of the integrand along the motion: visibility, the horizon (F8, F9).
#[derive(Clone, Copy, Debug)]
pub struct Attached;

impl Sampling for Attached {
    type Geometry<R: Real> = R;

    #[inline(always)]
    fn embed<R: Real>(g: R) -> R {
        g
    }

    #[inline(always)]
    fn draw<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        material.sample(at, wo, u, mode)
    }
}
