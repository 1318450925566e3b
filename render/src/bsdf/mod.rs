//! Materials: how a surface scatters.
//!
//! Directions are in the local shading frame (z = shading normal), unit length, and point away from
//! the surface: `wo` towards the viewer, `wi` the sampled one. [`Lobe::eval`] is `f_s |cos theta_i|`,
//! densities are per solid angle.
//!
//! Two layers. A [`Lobe`] is a scattering law with its parameters *evaluated at a point*: plain numbers
//! over a scalar, written once per material. A material holds [`crate::params::ParamRef`] handles; as
//! a [`Leaf`] it says how to read its lobe, and everything else - sampling, forward derivatives, the
//! adjoint of every parameter - follows from that one function. Materials made of other
//! materials ([`TwoSided`], [`Blend`], ..) implement [`Bsdf`] themselves.
//!
//! # A material of one's own
//!
//! A material that scene files name is one file here and one line in `materials!` below. One that scenes are not made
//! of, for an experiment, can be written anywhere. This reflector sends light back to where it comes from:
//!
//! ```
//! use ad_core::{Dual, Real, Vec2, Vec3};
//! use render::bsdf::{Bsdf, BsdfSample, Component, DeltaKind, Leaf, Lobe, Part, Reader, Shading, TransportMode, Use};
//! use render::math::Rgb;
//! use render::params::{GradSink, ParamRef, ParamShape, Params, Tangent, Theta};
//! use render::texture::RgbTexture;
//!
//! pub struct Retro {
//!     pub reflectance: RgbTexture,
//! }
//!
//! #[derive(Clone, Copy)]
//! pub struct RetroLobe<R>(Rgb<R>);
//!
//! impl Leaf for Retro {
//!     type Lobe<R: Real> = RetroLobe<R>;
//!     const DELTA: bool = true;
//!     fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RetroLobe<R> {
//!         RetroLobe(read.rgb(&self.reflectance))
//!     }
//! }
//!
//! impl<R: Real> Lobe<R> for RetroLobe<R> {
//!     fn eval(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
//!         Rgb::black()
//!     }
//!     fn pdf(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> R {
//!         R::zero()
//!     }
//!     fn sample(&self, wo: Vec3<R>, _u: [R::Primal; 3], _mode: TransportMode) -> Option<BsdfSample<R>> {
//!         let component = Component::Delta { kind: DeltaKind::Reflection, route: 0 };
//!         let sample = BsdfSample { wi: wo, pdf: R::one(), component, eta: R::Primal::one() };
//!         (wo.z.primal() > R::Primal::zero()).then_some(sample)
//!     }
//!     fn eval_delta(&self, wo: Vec3<R>, _kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
//!         if wo.z.primal() > R::Primal::zero() { self.0 } else { Rgb::black() }
//!     }
//! }
//!
//! // Nothing above speaks of derivatives, and all of them are there.
//! let mut params = Params::default();
//! let reflectance = params.push("retro.reflectance.value", ParamShape::Rgb, &[0.5, 0.6, 0.7], (0.0, 1.0));
//! let retro = Retro { reflectance: RgbTexture::Constant(reflectance) };
//! let (values, mode) = ([0.5f64, 0.6, 0.7], TransportMode::Radiance);
//! let theta = Theta::constant(&values);
//! let at = Shading::new(theta, Vec2::new(0.5, 0.5));
//! let wo = Vec3::new(0.6, 0.0, 0.8);
//! let (sample, value) = retro.sample_eval(&at, wo, [0.5; 3], mode).unwrap();
//! assert_eq!((sample.wi.x, value.g), (wo.x, 0.6));
//!
//! // Forward: all three channels move by one.
//! let tangents = [Tangent::Uniform(Dual::new(0.0, [1.0]))];
//! let theta: Theta<Dual<f64, 1>> = Theta::with_tangents(&values, &tangents);
//! let moving = Shading::new(theta, Vec2::lift(at.uv));
//! let (_, moved) = retro.sample_eval(&moving, Vec3::lift(wo), [0.5; 3], mode).unwrap();
//! assert_eq!(moved.g.eps, [1.0]);
//!
//! // Reverse: the adjoint of the value goes to the parameter.
//! struct Sum([f64; 3]);
//! impl GradSink<f64> for Sum {
//!     fn active(&self, _p: ParamRef) -> bool {
//!         true
//!     }
//!     fn add(&mut self, _p: ParamRef, i: usize, d: f64) {
//!         self.0[i] += d;
//!     }
//! }
//! let d = Rgb::new(1.0, 2.0, 3.0);
//! let used = Use { wi: sample.wi, component: sample.component, part: Part::All, d };
//! let mut sum = Sum([0.0; 3]);
//! retro.backward(&at, wo, &[used], mode, &mut sum);
//! assert_eq!(sum.0, [1.0, 2.0, 3.0]);
//! ```
//!
//! To make it part of scenes, put the type into `render/src/bsdf/retro.rs`, implement `FromNode` (its names in scene
//! files, and how to build it from one), and add `Retro` to `materials!`. It then loads, renders, and has derivative
//! images and gradients by every estimator; a line in `tests/src/cases.rs` compares them with differences.

mod blend;
mod blinn_phong;
mod bump_map;
pub mod chart;
mod charted;
pub(crate) mod coat;
mod conductor;
mod dielectric;
pub mod differential;
mod diffuse;
pub mod fresnel;
mod hair;
pub mod kernel;
mod leaf;
mod mask;
mod metals;
pub mod microfacet;
pub mod nesting;
mod normal_map;
mod null;
mod plastic;
mod principled;
mod principled_thin;
mod rough_conductor;
mod rough_dielectric;
mod rough_plastic;
mod shading;
mod slopes;
mod thin_dielectric;
mod tilted;
mod twosided;

pub use blend::Blend;
pub use blinn_phong::{BlinnPhong, BlinnPhongLobe, BlinnPhongSampling};
pub use bump_map::{BumpMap, Bumps};
pub use charted::Charted;
pub use coat::{Coat, Passes};
pub use conductor::{Conductor, ConductorIndex, ConductorLobe};
pub use dielectric::{Dielectric, DielectricLobe};
pub use differential::{DiffLobe, Part};
pub use diffuse::{Diffuse, DiffuseLobe};
pub use hair::{Absorption, Hair, HairLobe};
pub(crate) use hair::{Along, Around, Fibre, Seen};
pub use leaf::{Leaf, MANY_SLOTS, MAX_SLOTS, MOST_SLOTS};
pub use mask::Mask;
pub(crate) use normal_map::CORRECTIONS;
pub use normal_map::{EncodedNormals, Interpolation, NormalMap};
pub use null::{Null, NullLobe};
pub use plastic::{Coated, CoatedLobe, Plastic, PlasticLobe};
pub use principled::{AnisotropicPrincipled, Principled, PrincipledLobe, Reflectivity};
pub(crate) use principled::{Choices, ClearCoat, Tints};
pub use principled_thin::{AnisotropicThin, PrincipledThin, PrincipledThinLobe};
pub(crate) use principled_thin::{Pane, Sides, ThinShares, above};
pub use rough_conductor::{AnisotropicConductor, RoughConductor, RoughConductorLobe, Roughness};
pub(crate) use rough_conductor::{Facets, Metal, reflect};
pub use rough_dielectric::{AnisotropicDielectric, RoughDielectric, RoughDielectricLobe};
pub(crate) use rough_dielectric::{Facet, upwards};
pub use rough_plastic::{RoughPlastic, RoughPlasticLobe};
pub(crate) use shading::OnChart;
pub use shading::{Reader, Shading, TextureRef};
pub use thin_dielectric::{ThinDielectric, ThinDielectricLobe};
pub use tilted::{Corrections, Tilt, Tilted, shadowing};
pub(crate) use tilted::{tilted, tilts};
pub use twosided::TwoSided;

use std::sync::Arc;

use ad_core::{Float, Real, Vec3};

use crate::error::SceneError;
use crate::math::{Frame, Rgb};
use crate::params::{GradSink, ParamRef};
use crate::plugin::{FromNode, Node, Registry};

/// Which quantity is transported. BSDFs are not symmetric: [Veach 1996], errata section 6.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransportMode {
    /// Radiance, along paths from the camera: scaled by `(eta_i / eta_t)^2` at refraction.
    Radiance,
    /// Importance (particles), along paths from the light: no such factor.
    Importance,
}

/// What a sampled direction belongs to. A density and a probability cannot be confused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// A density per solid angle.
    Continuous,
    /// A Dirac delta; `route` says which child of nested blends it came from, one bit per level.
    Delta {
        /// Which delta.
        kind: DeltaKind,
        /// Choices made on the way down.
        route: u8,
    },
}

/// The deltas a material can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeltaKind {
    /// Mirror reflection.
    Reflection,
    /// Refraction.
    Transmission,
    /// Straight through, as if nothing were there (opacity masks).
    Passthrough,
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample<R: Real> {
    /// Sampled direction, local frame.
    pub wi: Vec3<R>,
    /// Density per solid angle, or probability if `component` is a delta. Equal to what `pdf`
    /// returns for `wi`, bit by bit.
    pub pdf: R,
    /// What the sample belongs to.
    pub component: Component,
    /// Index of refraction on the side of `wi` over that on the side of `wo` (1 for reflection).
    pub eta: R::Primal,
}

impl<R: Real> BsdfSample<R> {
    /// A direction on the side of `wo`, with its density per solid angle; `None` where that is not positive.
    #[inline(always)]
    pub(super) fn reflected(wi: Vec3<R>, pdf: R) -> Option<Self> {
        (pdf.primal() > R::Primal::zero()).then_some(Self {
            wi,
            pdf,
            component: Component::Continuous,
            eta: R::Primal::one(),
        })
    }

    /// The same without tangents.
    #[inline]
    pub fn primal(&self) -> BsdfSample<R::Primal> {
        BsdfSample {
            wi: self.wi.primal(),
            pdf: self.pdf.primal(),
            component: self.component,
            eta: self.eta,
        }
    }
}

/// What becomes of light at a smooth interface that it passes or is reflected by, without a branch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Passage<R: Real> {
    /// Whether it is reflected.
    pub reflects: bool,
    /// Direction, local frame.
    pub wi: Vec3<R>,
    /// Weight of that delta.
    pub value: Rgb<R>,
    /// Probability; zero if there is no such direction.
    pub pdf: R::Primal,
    /// As of [`BsdfSample::eta`].
    pub eta: R::Primal,
}

impl<R: Real> Passage<R> {
    /// `a` if `cond` holds, else `b`: no branch.
    #[inline(always)]
    pub fn select(cond: bool, a: Self, b: Self) -> Self {
        Self {
            reflects: (a.reflects & cond) | (b.reflects & !cond),
            wi: Vec3::select(cond, a.wi, b.wi),
            value: Rgb::select(cond, a.value, b.value),
            pdf: R::Primal::select(cond, a.pdf, b.pdf),
            eta: R::Primal::select(cond, a.eta, b.eta),
        }
    }

    /// The same as a sample.
    #[inline(always)]
    fn sample(&self) -> Option<BsdfSample<R>> {
        let kind = if self.reflects {
            DeltaKind::Reflection
        } else {
            DeltaKind::Transmission
        };
        (self.pdf > R::Primal::zero()).then_some(BsdfSample {
            wi: self.wi,
            pdf: R::lift(self.pdf),
            component: Component::Delta { kind, route: 0 },
            eta: self.eta,
        })
    }
}

/// A direction sampled over the scalar `G`, and the material's value there over `R`.
pub type Scattered<G, R> = (BsdfSample<G>, Rgb<R>);

/// A scattering law with evaluated parameters.
///
/// # Derivatives
/// `eval`, `pdf` and `eval_delta` are differentiable in the parameters and both directions; `sample`
/// in the parameters and `wo` at fixed random numbers (attached sampling). Discrete choices are
/// primal. Nothing here detaches anything, but `choice_pdf`, which is for a wrong derivative.
pub trait Lobe<R: Real>: Copy {
    /// `f_s(wo, wi) |cos theta_i|` without deltas, in sr^-1; zero where the lobe does not scatter.
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R>;

    /// Density of sampling `wi` given `wo` with [`Lobe::sample`], per solid angle; deltas excluded.
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> R;

    /// Both at once, where they share work.
    #[inline]
    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R) {
        (self.eval(wo, wi, mode), self.pdf(wo, wi, mode))
    }

    /// Samples a direction. `u[0]` chooses between parts, `u[1..]` within one. `None` means that no
    /// light is scattered along this choice (below the horizon); it is not an error.
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>>;

    /// [`Lobe::sample`], and the value of that direction: all of its component.
    #[inline]
    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let sample = self.sample(wo, u, mode)?;
        let f = match sample.component {
            Component::Continuous => self.eval(wo, sample.wi, mode),
            Component::Delta { kind, .. } => self.eval_delta(wo, kind, mode),
        };
        Some((sample, f))
    }

    /// The direction of [`Lobe::sample`], and its value over its density: the attached estimator of reflected light.
    ///
    /// # Derivatives
    /// Of both at fixed `u`: factors that value and density share cancel, and so do their derivatives.
    #[inline]
    fn sample_weight(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<(Vec3<R>, Rgb<R>)> {
        self.sample_eval(wo, u, mode).map(over_density)
    }

    /// Weight of a delta, integrated over it: reflectance or transmittance (times the radiance
    /// scale in [`TransportMode::Radiance`]), *not* divided by the probability of choosing it.
    #[inline]
    fn eval_delta(&self, _wo: Vec3<R>, _kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
        Rgb::black()
    }

    /// Density per solid angle, or probability of a delta, of a direction that [`Lobe::sample`] gave: its `pdf`, bit by
    /// bit, when directions stay and the densities of parts are constants.
    ///
    /// # Derivatives
    /// In the parameters that the probabilities of choosing between parts depend on, through those alone (F6).
    #[inline]
    fn choice_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, component: Component, mode: TransportMode) -> R {
        match component {
            Component::Continuous => constant(self.pdf(wo, wi, mode)),
            Component::Delta { .. } => R::one(),
        }
    }

    /// Samples a direction from each part of the derivative of the distribution of normals with respect
    /// to roughness ([`differential`]), in the order of [`DiffLobe::BOTH`]; `u` as in [`Lobe::sample`]. It is an
    /// antithetic pair; each of the two may be `None` on its own. Primal: for detached estimators.
    /// Its density is [`Lobe::pdf_differential`].
    #[inline]
    fn sample_differential(
        &self,
        _wo: Vec3<R::Primal>,
        _u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> [Option<BsdfSample<R::Primal>>; 2] {
        [None; 2]
    }

    /// The change of [`Lobe::eval`] through the distribution of normals alone, [`Part::Normals`]:
    /// tangents with primal part zero.
    #[inline]
    fn eval_normals(
        &self,
        _wo: Vec3<R::Primal>,
        _wi: Vec3<R::Primal>,
        _mode: TransportMode,
    ) -> Rgb<R> {
        Rgb::black()
    }

    /// [`Lobe::eval`] of constant directions.
    ///
    /// # Derivatives
    /// In the parameters, those that `part` says.
    #[inline]
    fn eval_still(
        &self,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        part: Part,
        mode: TransportMode,
    ) -> Rgb<R> {
        let all = || self.eval(Vec3::lift(wo), Vec3::lift(wi), mode);
        let normals = || self.eval_normals(wo, wi, mode);
        match part {
            Part::All => all(),
            Part::Normals => normals(),
            Part::Rest => all() - normals(),
        }
    }

    /// Density of sampling `wi` with [`Lobe::sample_differential`], both samples of a pair together, per
    /// solid angle; the choice between reflection and transmission included.
    #[inline]
    fn pdf_differential(&self, _wo: Vec3<R::Primal>, _wi: Vec3<R::Primal>) -> R::Primal {
        R::Primal::zero()
    }
}

/// A sampled direction, and its value over its density.
#[inline(always)]
fn over_density<R: Real>((sample, f): Scattered<R, R>) -> (Vec3<R>, Rgb<R>) {
    (sample.wi, f * sample.pdf.recip())
}

/// The same number without tangents.
#[inline]
fn constant<R: Real>(x: R) -> R {
    R::lift(x.primal())
}

/// One use of a material at a path vertex whose value had the adjoint `d`.
#[derive(Clone, Copy, Debug)]
pub struct Use<P: Float> {
    /// Sampled or connected direction, local frame.
    pub wi: Vec3<P>,
    /// What was evaluated: [`Bsdf::eval`] or [`Bsdf::eval_delta`].
    pub component: Component,
    /// Which derivatives of it are wanted.
    pub part: Part,
    /// Adjoint of that value.
    pub d: Rgb<P>,
}

/// The shading frame in its own coordinates.
#[inline]
fn upright<R: Real>() -> Frame<R> {
    let (zero, one) = (R::zero(), R::one());
    Frame {
        s: Vec3::new(one, zero, zero),
        t: Vec3::new(zero, one, zero),
        n: Vec3::new(zero, zero, one),
    }
}

/// A material: scattering laws with parameters that vary over the surface.
pub trait Bsdf: Send + Sync {
    /// [`Lobe::eval`] and [`Lobe::pdf`] at a point.
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R);

    /// [`Lobe::eval`] at a point.
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R>;

    /// [`Lobe::sample`] at a point.
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>>;

    /// [`Lobe::eval_delta`] at a point, for a sample that went along `wi`.
    fn eval_delta<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        kind: DeltaKind,
        route: u8,
        mode: TransportMode,
    ) -> Rgb<R>;

    /// [`Lobe::choice_pdf`] at a point.
    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R;

    /// Adds the adjoints of all active parameters, given those of the values used at this vertex.
    ///
    /// # Derivatives
    /// Detached: directions and densities are constants.
    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    );

    /// The values used at this vertex, each times its adjoint, added up.
    ///
    /// # Derivatives
    /// Those of [`Bsdf::backward`]: in the parameters, forward, of each channel by itself.
    #[inline]
    fn forward<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        uses: &[Use<R::Primal>],
        mode: TransportMode,
    ) -> Rgb<R> {
        uses.iter().fold(Rgb::black(), |sum, u| {
            let all = || {
                let (wo, wi) = (Vec3::lift(wo), Vec3::lift(u.wi));
                self.eval_component(at, wo, wi, u.component, mode)
            };
            let normals = || self.eval_normals(at, wo, u.wi, mode);
            let value = match u.part {
                Part::All => all(),
                Part::Normals => normals(),
                Part::Rest => all() - normals(),
            };
            sum + value * Rgb::lift(u.d)
        })
    }

    /// The frame that light is scattered in, in the coordinates of the shading frame: tilted where a normal map is read.
    /// Its normal is on the side of the shading normal that maps say, also where the viewer is behind. Of blends and
    /// masks, `route` says whose, as in [`Component::Delta`]; the hole of a mask tilts nothing. What side is seen along
    /// `wo`, and whether [`Corrections`] flip the normal, is a primal decision.
    ///
    /// # Derivatives
    /// In theta and in `uv`, as those of textures; so it gives how the normal changes over the surface
    /// ([`crate::shape::Partials::mapped`]).
    fn shading_frame<R: Real>(
        &self,
        _at: &Shading<R>,
        _wo: Vec3<R::Primal>,
        _route: u8,
        _mode: TransportMode,
    ) -> Frame<R> {
        upright()
    }

    /// Calls `f` with every texture the material reads.
    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef));

    /// How many textures it may read, as [`Leaf::MANY`] says; of no meaning for materials with children.
    fn most_textures(&self) -> usize {
        MAX_SLOTS
    }

    /// Calls `f` with every parameter range the material reads.
    fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
        self.visit_textures(&mut |t| t.visit_params(f));
    }

    /// Whether it scatters along deltas only.
    fn is_delta(&self) -> bool;

    /// Whether all light stays on the side that it came from.
    fn is_opaque(&self) -> bool;

    /// [`Lobe::sample_differential`] at a point. Materials made of others choose among those that
    /// have it.
    ///
    /// The two estimates are summed, each over the density of both together: only one part of a leaf
    /// reaches a direction, but the parts of a blend overlap.
    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2];

    /// [`Lobe::eval_normals`] at a point.
    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R>;

    /// [`Lobe::pdf_differential`] at a point.
    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P;

    /// Whether [`Bsdf::sample_differential`] gives a direction anywhere.
    fn has_differential(&self) -> bool;

    /// The value of a sampled direction, whatever it belongs to.
    #[inline(always)]
    fn eval_component<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> Rgb<R> {
        match component {
            Component::Continuous => self.eval(at, wo, wi, mode),
            Component::Delta { kind, route } => self.eval_delta(at, wo, wi, kind, route, mode),
        }
    }

    /// [`Lobe::sample_eval`] at a point: [`Bsdf::sample`] and [`Bsdf::eval_component`] there in one visit.
    #[inline(always)]
    fn sample_eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let sample = self.sample(at, wo, u, mode)?;
        let f = self.eval_component(at, wo, sample.wi, sample.component, mode);
        Some((sample, f))
    }

    /// [`Lobe::sample_weight`] at a point.
    #[inline(always)]
    fn sample_weight<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<(Vec3<R>, Rgb<R>)> {
        self.sample_eval(at, wo, u, mode).map(over_density)
    }

    /// [`Bsdf::sample_eval`] for a direction without tangents.
    #[inline(always)]
    fn scatter<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R::Primal, R>> {
        if R::IS_PRIMAL {
            let (sample, f) = self.sample_eval(at, Vec3::lift(wo), u, mode)?;
            return Some((sample.primal(), f));
        }
        let sample = self.sample(&at.primal(), wo, u, mode)?;
        let (wo, wi) = (Vec3::lift(wo), Vec3::lift(sample.wi));
        let f = self.eval_component(at, wo, wi, sample.component, mode);
        Some((sample, f))
    }
}

/// Materials.
impl Registry {
    /// Builds the material described by `node`, once however often it is referred to. Its parameters
    /// start with its id, or with the parent's name and `label`.
    ///
    /// # Errors
    /// Anything wrong with its description.
    pub fn material_from_node(
        &mut self,
        node: &Arc<Node>,
        label: &str,
    ) -> Result<Arc<Material>, SceneError> {
        if let Some(id) = &node.id {
            let way = format!("{}.{label}", self.prefix());
            self.params_mut().alias(way, id);
        }
        // One that reads attributes of a mesh is another one for each.
        let details = [self.attributes.as_ref().map_or(0, |a| a.serial), 0, 0];
        if let Some(m) = self.shared::<Material>(node, details) {
            return Ok(m);
        }
        let name = match &node.id {
            Some(id) => id.clone(),
            None => format!("{}.{label}", self.prefix()),
        };
        let material = self.called(name, |registry| Material::from_node(node, registry));
        let material = Arc::new(material.map_err(|e| e.at(&node.location))?);
        // A flag of other renderers: here everything is differentiable.
        node.ignore(&["differentiable"], Node::boolean)?;
        node.finish()?;
        self.share(node, details, material.clone());
        Ok(material)
    }
}

macro_rules! materials {
    (inline { $($hot:ident),* $(,)? } $($name:ident),* $(,)?) => {
        /// Any material.
        #[derive(Clone, Debug)]
        pub enum Material {
            $(#[doc = concat!("See [`", stringify!($hot), "`].")] $hot($hot),)*
            $(#[doc = concat!("See [`", stringify!($name), "`].")] $name($name),)*
        }

        $(impl From<$hot> for Material {
            fn from(m: $hot) -> Self {
                Self::$hot(m)
            }
        })*
        $(impl From<$name> for Material {
            fn from(m: $name) -> Self {
                Self::$name(m)
            }
        })*

        impl Material {
            /// Plugin names of all materials.
            pub const PLUGINS: &'static [&'static [&'static str]] =
                &[$(<$hot as FromNode>::PLUGINS,)* $(<$name as FromNode>::PLUGINS),*];

            /// Builds the material that the node's plugin names.
            ///
            /// # Errors
            /// Unknown plugin, or anything wrong with its description.
            pub fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
                $(if <$hot as FromNode>::takes(node) {
                    return Ok(Self::$hot(<$hot as FromNode>::from_node(node, registry)?));
                })*
                $(if <$name as FromNode>::takes(node) {
                    return Ok(Self::$name(<$name as FromNode>::from_node(node, registry)?));
                })*
                Err(node.unknown_plugin(&Self::PLUGINS.concat()))
            }
        }

        impl Bsdf for Material {
            #[inline(always)]
            fn eval_pdf<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode,
            ) -> (Rgb<R>, R) {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.eval_pdf(at, wo, wi, mode))
            }
            #[inline(always)]
            fn eval<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode,
            ) -> Rgb<R> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.eval(at, wo, wi, mode))
            }
            #[inline(always)]
            fn sample<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode,
            ) -> Option<BsdfSample<R>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.sample(at, wo, u, mode))
            }
            #[inline(always)]
            fn eval_delta<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>, kind: DeltaKind, route: u8, mode: TransportMode,
            ) -> Rgb<R> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.eval_delta(at, wo, wi, kind, route, mode))
            }
            #[inline]
            fn choice_pdf<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>, component: Component, mode: TransportMode,
            ) -> R {
                $crate::dispatch::dispatch!(self, [] [$($hot,)* $($name),*], m => m.choice_pdf(at, wo, wi, component, mode))
            }
            #[inline(always)]
            fn eval_component<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, wi: Vec3<R>, component: Component, mode: TransportMode,
            ) -> Rgb<R> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.eval_component(at, wo, wi, component, mode))
            }
            #[inline(always)]
            fn sample_eval<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode,
            ) -> Option<Scattered<R, R>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.sample_eval(at, wo, u, mode))
            }
            #[inline(always)]
            fn sample_weight<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode,
            ) -> Option<(Vec3<R>, Rgb<R>)> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.sample_weight(at, wo, u, mode))
            }
            #[inline(always)]
            fn scatter<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R::Primal>, u: [R::Primal; 3], mode: TransportMode,
            ) -> Option<Scattered<R::Primal, R>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.scatter(at, wo, u, mode))
            }
            #[inline(always)]
            fn backward<P: Float>(
                &self, at: &Shading<P>, wo: Vec3<P>, uses: &[Use<P>], mode: TransportMode,
                grad: &mut impl GradSink<P>,
            ) {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.backward(at, wo, uses, mode, grad))
            }
            #[inline(always)]
            fn forward<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R::Primal>, uses: &[Use<R::Primal>], mode: TransportMode,
            ) -> Rgb<R> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.forward(at, wo, uses, mode))
            }
            fn shading_frame<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R::Primal>, route: u8, mode: TransportMode,
            ) -> Frame<R> {
                match self { $(Self::$hot(m) => m.shading_frame(at, wo, route, mode),)* $(Self::$name(m) => m.shading_frame(at, wo, route, mode),)* }
            }
            fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
                match self { $(Self::$hot(m) => m.visit_textures(f),)* $(Self::$name(m) => m.visit_textures(f),)* }
            }
            fn most_textures(&self) -> usize {
                match self { $(Self::$hot(m) => m.most_textures(),)* $(Self::$name(m) => m.most_textures(),)* }
            }
            #[inline(always)]
            fn is_delta(&self) -> bool {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], m => m.is_delta())
            }
            fn is_opaque(&self) -> bool {
                match self { $(Self::$hot(m) => m.is_opaque(),)* $(Self::$name(m) => m.is_opaque(),)* }
            }
            #[inline(always)]
            fn sample_differential<P: Float>(
                &self, at: &Shading<P>, wo: Vec3<P>, u: [P; 3], mode: TransportMode,
            ) -> [Option<BsdfSample<P>>; 2] {
                $crate::dispatch::dispatch!(self, [] [$($hot,)* $($name),*], m => m.sample_differential(at, wo, u, mode))
            }
            #[inline(always)]
            fn pdf_differential<P: Float>(
                &self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>,
            ) -> P {
                $crate::dispatch::dispatch!(self, [] [$($hot,)* $($name),*], m => m.pdf_differential(at, wo, wi))
            }
            #[inline(always)]
            fn eval_normals<R: Real>(
                &self, at: &Shading<R>, wo: Vec3<R::Primal>, wi: Vec3<R::Primal>, mode: TransportMode,
            ) -> Rgb<R> {
                $crate::dispatch::dispatch!(self, [] [$($hot,)* $($name),*], m => m.eval_normals(at, wo, wi, mode))
            }
            #[inline]
            fn has_differential(&self) -> bool {
                match self { $(Self::$hot(m) => m.has_differential(),)* $(Self::$name(m) => m.has_differential(),)* }
            }
        }
    };
}

materials! {
    inline { Diffuse }
    BlinnPhong,
    Conductor,
    Dielectric,
    AnisotropicConductor,
    RoughConductor,
    TwoSided,
    Blend,
    Mask,
    NormalMap,
    BumpMap,
    Charted,
    AnisotropicDielectric,
    RoughDielectric,
    Plastic,
    RoughPlastic,
    ThinDielectric,
    Null,
    AnisotropicPrincipled,
    Principled,
    AnisotropicThin,
    PrincipledThin,
    Hair,
}
