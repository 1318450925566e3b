//! How a scattered direction is drawn.

use ad_core::{Real, Vec2, Vec3};

use super::memory::{Forget, Keep, Memory};
use crate::bsdf::{Bsdf, Material, Scattered, Shading, TransportMode};
use crate::math::Frame;
use crate::params::Theta;
use crate::shape::SurfaceInteraction;

/// How the light at the end of a sampled direction depends on that direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direct {
    /// As the rest of the path does.
    AsPath,
    /// It follows the attached direction, while the path goes on along the detached one.
    Attached,
    /// As `Attached`, but samples slow down towards discontinuities.
    Reparameterised {
        /// Auxiliary rays that look for discontinuities.
        rays: usize,
    },
}

/// A way of sampling directions.
pub trait Sampling: Send + Sync + 'static {
    /// The scalar of everything geometric on a path: rays, interactions, directions, densities.
    type Geometry<R: Real>: Real<Primal = R::Primal>;

    /// Whether paths are constants, so that `Geometry` is primal.
    const DETACHED_PATH: bool;

    /// Whether an edge must be remembered to be differentiated by itself.
    type Edge: Memory;

    /// How the light that a sampled direction finds is differentiated.
    const DIRECT: Direct = Direct::AsPath;

    /// Whether the derivative of rough materials has samples of its own.
    const DIFFERENTIAL: bool = false;

    /// Whether samples move across discontinuities without notice, so that the scene must not have
    /// any: see [`crate::Scene::admits`].
    const NEEDS_CONTINUITY: bool = false;

    /// The parameters in the scalar of the geometry.
    fn geometry<'a, R: Real>(theta: &Theta<'a, R>) -> Theta<'a, Self::Geometry<R>>;

    /// A geometric quantity in the scalar of the estimate.
    fn embed<R: Real>(g: Self::Geometry<R>) -> R;

    /// A geometric vector in the scalar of the estimate.
    #[inline(always)]
    fn embed3<R: Real>(v: Vec3<Self::Geometry<R>>) -> Vec3<R> {
        Vec3::new(Self::embed(v.x), Self::embed(v.y), Self::embed(v.z))
    }

    /// A surface point in the scalar of the estimate.
    #[inline(always)]
    fn embed_interaction<R: Real>(
        si: &SurfaceInteraction<Self::Geometry<R>>,
    ) -> SurfaceInteraction<R> {
        SurfaceInteraction {
            p: Self::embed3(si.p),
            t: Self::embed(si.t),
            n_geo: Self::embed3(si.n_geo),
            frame: Frame {
                s: Self::embed3(si.frame.s),
                t: Self::embed3(si.frame.t),
                n: Self::embed3(si.frame.n),
            },
            uv: Self::embed2(si.uv),
        }
    }

    /// Surface coordinates in the scalar of the estimate.
    #[inline(always)]
    fn embed2<R: Real>(v: Vec2<Self::Geometry<R>>) -> Vec2<R> {
        Vec2::new(Self::embed(v.x), Self::embed(v.y))
    }

    /// Draws a direction at a vertex, and evaluates the material there.
    fn scatter<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<Self::Geometry<R>>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<Self::Geometry<R>, R>>;
}

/// A way of sampling emitters, beside directions that are scattered as `B` says: [`Detached`] or [`Attached`].
#[diagnostic::on_unimplemented(
    message = "emitters cannot be sampled as `{Self}` says beside directions scattered as `{B}` says",
    note = "it is `Detached` or `Attached`, the latter beside `Detached`, `AttachedDirect` or `Reparameterised` scattering"
)]
pub trait EmitterSampling<B: Sampling>: Send + Sync + 'static {
    /// Whether a sample must be remembered to be moved: samples of emitters follow the parameters.
    type EmitterMotion: Memory;
}

impl<B: Sampling> EmitterSampling<B> for Detached {
    type EmitterMotion = Forget;
}

/// The random numbers of an environment map stay, and its direction moves with the texels; samples of other
/// emitters do not move with any parameter they have, so that they are attached and detached alike.
impl<B: Unsplit> EmitterSampling<B> for Attached {
    type EmitterMotion = Keep;
}

/// Constant paths with one estimate of the derivative of a BSDF: light that moves by itself can be
/// differentiated vertex by vertex.
#[diagnostic::on_unimplemented(
    message = "light samples that move with an environment map need paths of constants with one estimate per vertex, \
               which `{Self}` has not",
    note = "`Attached` emitter sampling goes with `Detached`, `AttachedDirect` or `Reparameterised` scattering"
)]
pub trait Unsplit: Sampling {}

impl Unsplit for Detached {}
impl Unsplit for AttachedDirect {}
impl<const RAYS: usize> Unsplit for Reparameterised<RAYS> {}

/// Samples whose path is a constant: primal geometry.
macro_rules! detached_path {
    () => {
        type Geometry<R: Real> = R::Primal;
        const DETACHED_PATH: bool = true;

        #[inline(always)]
        fn geometry<'a, R: Real>(theta: &Theta<'a, R>) -> Theta<'a, R::Primal> {
            theta.primal()
        }

        #[inline(always)]
        fn embed<R: Real>(g: R::Primal) -> R {
            R::lift(g)
        }

        #[inline(always)]
        fn scatter<R: Real>(
            material: &Material,
            at: &Shading<R>,
            wo: Vec3<R::Primal>,
            u: [R::Primal; 3],
            mode: TransportMode,
        ) -> Option<Scattered<R::Primal, R>> {
            material.scatter(at, wo, u, mode)
        }
    };
}

/// Samples are constants [Zeltner 2021, section 4.2.1]: only the integrand is differentiated.
///
/// # Does not handle
/// Parameters that a direction is a Dirac delta in (mirror normals, the index of smooth glass), and
/// moving discontinuities.
#[derive(Clone, Copy, Debug)]
pub struct Detached;

impl Sampling for Detached {
    detached_path!();
    type Edge = Forget;
}

/// Samples move with the parameters, and so does the whole path behind them [Zeltner 2021,
/// section 4.2.2]: vertices slide over surfaces, and directions are followed through every bounce.
///
/// # Does not handle
/// Discontinuities of the integrand along the motion: visibility, the horizon (F8, F9).
#[derive(Clone, Copy, Debug)]
pub struct Attached;

impl Sampling for Attached {
    type Edge = Forget;
    type Geometry<R: Real> = R;
    const DETACHED_PATH: bool = false;
    const NEEDS_CONTINUITY: bool = true;

    #[inline(always)]
    fn geometry<'a, R: Real>(theta: &Theta<'a, R>) -> Theta<'a, R> {
        *theta
    }

    #[inline(always)]
    fn embed<R: Real>(g: R) -> R {
        g
    }

    #[inline(always)]
    fn scatter<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        material.sample_eval(at, wo, u, mode)
    }
}

/// Attached through one bounce: the light that a sampled direction finds follows it, light that is
/// reflected on is estimated detached [Zeltner 2021, section 4.4.2, without its reparameterisation].
///
/// # Does not handle
/// Discontinuities, as [`Attached`].
#[derive(Clone, Copy, Debug)]
pub struct AttachedDirect;

impl Sampling for AttachedDirect {
    detached_path!();
    type Edge = Keep;
    const DIRECT: Direct = Direct::Attached;
    const NEEDS_CONTINUITY: bool = true;
}

/// [`AttachedDirect`] whose samples slow down towards discontinuities [Zeltner 2021, section 4.4.2]
/// by the factor `1 - B` of [`crate::integrator::reparameterisation`], found by `RAYS` auxiliary rays for each
/// direction that finds light.
///
/// The divergence term has the sign of errata Z-4.54.
///
/// # Does not handle
/// Dirac deltas in occluded scenes: a mirror direction is followed as by [`AttachedDirect`]. Outlines
/// that no auxiliary ray finds.
#[derive(Clone, Copy, Debug)]
pub struct Reparameterised<const RAYS: usize = 16>;

impl<const RAYS: usize> Sampling for Reparameterised<RAYS> {
    detached_path!();
    type Edge = Keep;
    const DIRECT: Direct = Direct::Reparameterised { rays: RAYS };
}

/// Detached, with two more samples for the derivative of the distribution of microfacet normals, an
/// antithetic pair from its negative and its positive part [Zeltner 2021, section 4.3.1].
///
/// They estimate the change through `D` alone, of all light: both go on as ordinary paths made of the same random
/// numbers, which the thesis leaves to detached sampling [section 4.4.2]. Every other derivative (masking,
/// reflectance) is left to the ordinary samples, since the pair would serve it badly (errata Z-4.43, F30, F39).
/// Materials without such a distribution cost nothing more.
#[derive(Clone, Copy, Debug)]
pub struct Differential;

impl Sampling for Differential {
    detached_path!();
    type Edge = Forget;
    const DIFFERENTIAL: bool = true;
}
