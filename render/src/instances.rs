//! The combinations of scalar, strategy and sampler that are compiled, as plain functions.
//!
//! The renderer is generic; a program that calls [`render::render`] with types of its own compiles the
//! whole of light transport for them. Tools and figures call these functions instead, and link in a
//! second. A new combination is one line in the table of [`render_f32`] or a function below it.

use std::ops::Range;

use ad_core::{Dual, Float};

use crate::bsdf::kernel::Rules;
use crate::error::RenderError;
use crate::estimator::{
    self, AllowBias, Attached, AttachedChoice, AttachedDirect, AttachedRoulette, AttachedWeights,
    Balance, BsdfOnly, Detached, DetachedMis, DetachedWeights, Differential, EmitterOnly,
    FrozenWeights, Mis, MixedWeights, Power, Reparameterised, Strategy, TrustBsdf, TrustLights,
    Unbiased,
};
use crate::integrator::density::{Convention, Map};
use crate::integrator::gradient::{self, Active, Gradient};
use crate::integrator::particle;
use crate::integrator::particle_gradient::{self, Measurement};
use crate::integrator::path::is_guided;
use crate::integrator::render::{self, Components, Progress, Rendering};
use crate::integrator::second_order::{self, GaussNewton};
use crate::integrator::tally::tally;
use crate::params::{ParamInfo, ParamRef, Params, Tangent, Theta};
use crate::sampler::{Independent, Spread};
use crate::scene::{Scene, Settings};

/// Which techniques estimate direct light; see [`crate::estimator`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Technique {
    /// BSDF and emitter sampling, power heuristic.
    #[default]
    MisPower,
    /// BSDF and emitter sampling, balance heuristic.
    MisBalance,
    /// BSDF sampling.
    BsdfOnly,
    /// Emitter sampling.
    EmitterOnly,
}

type MisOf<H> = Mis<Detached, Detached, DetachedWeights, H>;

fn run<R: Components, S: Unbiased>(
    scene: &Scene,
    theta: &Theta<R>,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    render::render::<R, S, Spread>(scene, theta, settings, seed, samples, progress)
}

fn primal<P: Components + Float>(
    scene: &Scene,
    theta: &Theta<P>,
    technique: Technique,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Rendering {
    let run = match technique {
        Technique::MisPower => render::unchecked::<P, MisOf<Power>, Spread>,
        Technique::MisBalance => render::unchecked::<P, MisOf<Balance>, Spread>,
        Technique::BsdfOnly => render::unchecked::<P, BsdfOnly<Detached>, Spread>,
        Technique::EmitterOnly => render::unchecked::<P, EmitterOnly<Detached>, Spread>,
    };
    run(scene, theta, settings, seed, samples, progress)
}

/// The image, in single precision: [`render::render`] with the points that `settings` asks for.
pub fn render_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    technique: Technique,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Rendering {
    primal(scene, theta, technique, settings, seed, samples, progress)
}

/// The image by particles, in single precision: [`particle::render`] with the points that `settings` asks
/// for.
///
/// # Errors
/// A scene that particles see otherwise than paths do.
pub fn particles_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    rules: Rules,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    let context = particle::Context {
        rules,
        ..particle::Context::new(scene, theta, settings)?
    };
    let r = particle::render::<f32, Spread>(&context, seed, samples, progress);
    Ok(r)
}

/// The image by particles that land and viewing rays that collect them within `radius`, in single precision:
/// [`Map`] with the points that `settings` asks for. As many particles are sent per sample as there are pixels.
///
/// # Errors
/// A scene that particles see otherwise than paths do; a radius that is not positive; too many particles.
pub fn density_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    rules: Rules,
    convention: Convention,
    radius: f64,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    let context = particle::Context {
        rules,
        ..particle::Context::new(scene, theta, settings)?
    };
    let map = Map::new::<Spread>(&context, radius, seed, samples.clone(), &())?;
    Ok(map.render::<Spread>(&context, convention, seed, samples, progress))
}

/// The particles of [`density_f32`], to be gathered at chosen points.
///
/// # Errors
/// As those of [`density_f32`].
pub fn particle_map_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    radius: f64,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
) -> Result<Map<f32>, RenderError> {
    let context = particle::Context::new(scene, theta, settings)?;
    Map::new::<Spread>(&context, radius, seed, samples, &())
}

/// The gradient of `<adjoint, image>` by particles, in single precision: [`particle_gradient::backward`] with
/// the points that `settings` asks for.
///
/// # Errors
/// An adjoint image of the wrong size; a scene that particles see otherwise than paths do.
pub fn backward_particles_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Measurement, RenderError> {
    let context = particle::Context::new(scene, theta, settings)?;
    particle_gradient::backward::<f32, Spread>(&context, active, adjoint, seed, samples, progress)
}

/// The image, in double precision: a reference for [`render_f32`] and for differences.
pub fn render_f64(
    scene: &Scene,
    theta: &Theta<f64>,
    technique: Technique,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Rendering {
    primal(scene, theta, technique, settings, seed, samples, progress)
}

/// The gradient of `<adjoint, image>`, in single precision: [`gradient::backward`] with detached MIS and
/// the points that `settings` asks for.
///
/// # Errors
/// An adjoint image of the wrong size.
pub fn backward_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Gradient, RenderError> {
    gradient::backward::<f32, DetachedMis, Spread>(
        scene, theta, active, adjoint, settings, seed, samples, progress,
    )
}

/// [`backward_f32`] in double precision.
///
/// # Errors
/// An adjoint image of the wrong size.
pub fn backward_f64(
    scene: &Scene,
    theta: &Theta<f64>,
    active: &Active,
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Gradient, RenderError> {
    gradient::backward::<f64, DetachedMis, Spread>(
        scene, theta, active, adjoint, settings, seed, samples, progress,
    )
}

/// The image and its derivative when all values of `active` move along `direction`, which has one
/// number per value, in single precision: components 0 and 1. Detached MIS.
///
/// # Errors
/// A direction of the wrong length; a parameter that moves a Dirac delta.
pub fn tangent_f32(
    scene: &Scene,
    values: &[f32],
    active: &Active,
    direction: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    if direction.len() != active.len() {
        return Err(RenderError::WrongLength {
            what: "direction",
            expected: active.len(),
            found: direction.len(),
        });
    }
    let mut tangents = vec![Tangent::None; scene.params().infos().len()];
    let mut rest = direction;
    for info in active.ranges() {
        let (own, later) = rest.split_at(info.shape.len());
        rest = later;
        let own = own.iter().map(|&d| Dual::new(0.0, [d])).collect();
        tangents[scene.params().handle(info).id as usize] = Tangent::Dense(own);
    }
    let theta = Theta::<Dual<f32, 1>>::with_tangents(values, &tangents);
    run::<Dual<f32, 1>, DetachedMis>(scene, &theta, settings, seed, samples, progress)
}

/// The Hessian of an image loss times a direction, in single precision:
/// [`second_order::hessian_vector`] with independent samples.
///
/// # Errors
/// Images or a direction of the wrong size.
pub fn hessian_vector_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    active: &Active,
    direction: &[f32],
    adjoints: [&[f32]; 2],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Gradient, RenderError> {
    second_order::hessian_vector::<f32, Independent>(
        scene, theta, active, direction, adjoints, settings, seed, samples, progress,
    )
}

/// Gradient and Gauss-Newton matrix of an image loss, in single precision: [`second_order::gauss_newton`]
/// with independent samples.
///
/// # Errors
/// Images of the wrong size, too many values, or fewer than two samples.
pub fn gauss_newton_f32(
    scene: &Scene,
    theta: &Theta<f32>,
    active: &Active,
    derivatives: [&[f32]; 2],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<GaussNewton, RenderError> {
    second_order::gauss_newton::<f32, Independent>(
        scene,
        theta,
        active,
        derivatives,
        settings,
        seed,
        samples,
        progress,
    )
}

/// A direction in parameter space along which forward mode differentiates.
///
/// Colours do not mix, so adding one number to all three channels of an RGB parameter gives, in channel c of
/// the image, the derivative with respect to channel c.
#[derive(Clone, Debug, PartialEq)]
pub enum Direction {
    /// One number added to every element of a range.
    Uniform(ParamRef),
    /// A multiple of this vector, one number per element, added to a range.
    Dense(ParamRef, Vec<f32>),
}

impl Direction {
    /// [`Direction::Uniform`] for the range called `name`.
    ///
    /// # Errors
    /// An unknown name.
    pub fn uniform(params: &Params, name: &str) -> Result<Self, RenderError> {
        Ok(Self::Uniform(params.handle(params.find(name)?)))
    }

    fn param(&self) -> ParamRef {
        match self {
            Self::Uniform(p) | Self::Dense(p, _) => *p,
        }
    }
}

/// Derivative images along any number of directions, in single precision (forward mode): component 0 of the
/// result is the image, component `k` the derivative along `directions[k - 1]`.
///
/// Renders `Dual<f32, N>` with N in 8, 4, 2, 1, so eleven directions cost three passes over the same
/// samples. Detached MIS.
///
/// # Errors
/// A dense direction of the wrong length; a parameter that moves a Dirac delta.
pub fn forward_f32(
    scene: &Scene,
    values: &[f32],
    directions: &[Direction],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    check_directions(scene, directions)?;
    let widest = |n: usize| [8, 4, 2].into_iter().find(|w| *w <= n).unwrap_or(1);
    let pass = |directions: &[Direction]| -> Result<Rendering, RenderError> {
        let run = match directions.len() {
            8 => forward::<8>,
            4 => forward::<4>,
            2 => forward::<2>,
            _ => forward::<1>,
        };
        let samples = samples.clone();
        let mut part = run(scene, values, directions, settings, seed, samples, progress)?;
        part.sums.truncate(1 + directions.len());
        Ok(part)
    };
    let (now, mut rest) = directions.split_at(widest(directions.len()).min(directions.len()));
    let mut out = pass(now)?;
    while !rest.is_empty() {
        let (now, later) = rest.split_at(widest(rest.len()));
        let part = pass(now)?;
        out.sums.extend(part.sums.into_iter().skip(1));
        out.cancelled |= part.cancelled;
        // A sample may fail in the tangents of one pass only.
        if part.non_finite.count > out.non_finite.count {
            out.non_finite = part.non_finite;
        }
        rest = later;
    }
    Ok(out)
}

fn check_directions(scene: &Scene, directions: &[Direction]) -> Result<(), RenderError> {
    for d in directions {
        let expected = scene.params().infos()[d.param().id as usize].shape.len();
        match d {
            Direction::Dense(_, v) if v.len() != expected => {
                return Err(RenderError::WrongLength {
                    what: "direction",
                    expected,
                    found: v.len(),
                });
            }
            _ => {}
        }
    }
    Ok(())
}

fn forward<const N: usize>(
    scene: &Scene,
    values: &[f32],
    directions: &[Direction],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    let tangents = tangents::<N>(scene.params(), directions.iter().enumerate());
    let theta = Theta::<Dual<f32, N>>::with_tangents(values, &tangents);
    run::<Dual<f32, N>, DetachedMis>(scene, &theta, settings, seed, samples, progress)
}

/// The image and its derivative along one direction with [`Estimator::Mis`] in double precision: what single
/// precision costs in accuracy, and gains in time.
///
/// # Errors
/// A dense direction of the wrong length; a parameter that moves a Dirac delta.
pub fn forward_f64(
    scene: &Scene,
    direction: &Direction,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Rendering, RenderError> {
    check_directions(scene, std::slice::from_ref(direction))?;
    let widened = |t: &Dual<f32, 1>| Dual::<f64, 1>::new(0.0, [t.eps[0].into()]);
    let tangents = tangents::<1>(scene.params(), [(0, direction)]);
    let tangents: Vec<Tangent<Dual<f64, 1>>> = tangents
        .iter()
        .map(|t| match t {
            Tangent::None => Tangent::None,
            Tangent::Uniform(t) => Tangent::Uniform(widened(t)),
            Tangent::Dense(t) => Tangent::Dense(t.iter().map(widened).collect()),
        })
        .collect();
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let theta = Theta::<Dual<f64, 1>>::with_tangents(&values, &tangents);
    run::<Dual<f64, 1>, DetachedMis>(scene, &theta, settings, seed, samples, progress)
}

/// One tangent per range of the layout; component `k` of the dual numbers is the sum of the directions
/// that come with `k`.
fn tangents<'a, const N: usize>(
    params: &Params,
    directions: impl IntoIterator<Item = (usize, &'a Direction)>,
) -> Vec<Tangent<Dual<f32, N>>> {
    let zero = Dual::new(0.0, [0.0; N]);
    let mut out = vec![Tangent::None; params.infos().len()];
    for (k, direction) in directions {
        let id = direction.param().id as usize;
        let len = params.infos()[id].shape.len();
        let tangent = &mut out[id];
        match (direction, &mut *tangent) {
            (Direction::Uniform(_), Tangent::None) => {
                let mut t = zero;
                t.eps[k] = 1.0;
                *tangent = Tangent::Uniform(t);
            }
            (Direction::Uniform(_), Tangent::Uniform(t)) => t.eps[k] += 1.0,
            (Direction::Uniform(_), Tangent::Dense(t)) => {
                t.iter_mut().for_each(|t| t.eps[k] += 1.0);
            }
            (Direction::Dense(_, v), current) => {
                let mut dense = match std::mem::replace(current, Tangent::None) {
                    Tangent::None => vec![zero; len],
                    Tangent::Uniform(t) => vec![t; len],
                    Tangent::Dense(t) => t,
                };
                for (t, v) in dense.iter_mut().zip(v) {
                    t.eps[k] += *v;
                }
                *current = Tangent::Dense(dense);
            }
        }
    }
    out
}

/// Which way derivatives are carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Derivative images along a direction.
    Forward,
    /// Gradients.
    #[default]
    Reverse,
}

/// All estimators that are compiled for comparison, one line each: name, type.
macro_rules! estimators {
    ($($(#[doc = $doc:literal])* $variant:ident $name:literal $strategy:ty;)*) => {
        /// An estimator of derivatives, by name; see [`crate::estimator`] for what the parts mean.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Estimator {
            $($(#[doc = $doc])* $variant,)*
        }

        impl Estimator {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Its name on command lines and in tables.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }

            /// Whether a [`Guide`](crate::guide::Guide) leads its paths: not where samples or weights move with the
            /// parameters.
            pub fn is_guided(self) -> bool {
                match self {
                    $(Self::$variant => is_guided::<$strategy>(),)*
                }
            }

            /// Whether it samples lights.
            pub fn samples_emitters(self) -> bool {
                match self {
                    $(Self::$variant => <$strategy as Strategy>::SAMPLES_EMITTERS,)*
                }
            }

            /// Whether it is one of those that are wrong on purpose: wrapped in [`AllowBias`].
            pub fn allows_bias(self) -> bool {
                match self {
                    $(Self::$variant => <$strategy as Strategy>::ALLOWS_BIAS,)*
                }
            }

            /// Whether it is right in this scene.
            ///
            /// # Errors
            /// See [`estimator::check`].
            pub fn check(self, scene: &Scene) -> Result<(), RenderError> {
                match self {
                    $(Self::$variant => estimator::check::<$strategy>(scene),)*
                }
            }

            /// The named parameters of a scene, as [`Active::seen_by`] this estimator.
            ///
            /// # Errors
            /// An unknown name, or a parameter whose derivative this estimator cannot see.
            pub fn active<N: AsRef<str>>(
                self,
                scene: &Scene,
                names: &[N],
            ) -> Result<Active, RenderError> {
                match self {
                    $(Self::$variant => Active::seen_by::<$strategy, N>(scene, names),)*
                }
            }

            pub(crate) fn check_parameter(self, info: &ParamInfo) -> Result<(), RenderError> {
                match self {
                    $(Self::$variant => estimator::check_parameter::<$strategy>(info),)*
                }
            }

            /// Work of a sample of derivatives in these parameters, in edges: see [`tally`].
            pub(crate) fn work(
                self,
                scene: &Scene,
                active: &Active,
                settings: &Settings,
                mode: Mode,
                seed: u64,
                paths: u64,
            ) -> f64 {
                let tally = match self {
                    $(Self::$variant => tally::<$strategy, Spread>,)*
                };
                tally(scene, active, settings, mode, seed, paths).work()
            }

            fn forward<R: Components>(self) -> Forward<R> {
                match self {
                    $(Self::$variant => run::<R, $strategy>,)*
                }
            }

            fn reverse(self) -> Reverse {
                match self {
                    $(Self::$variant => pull_back::<$strategy>,)*
                }
            }
        }
    };
}

type Forward<R> = fn(
    &Scene,
    &Theta<R>,
    &Settings,
    u64,
    Range<u64>,
    &dyn Progress,
) -> Result<Rendering, RenderError>;
type Reverse = fn(
    &Scene,
    &Theta<f32>,
    &Active,
    &[f32],
    &Settings,
    u64,
    Range<u64>,
    &dyn Progress,
) -> Result<Gradient, RenderError>;

fn pull_back<S: Unbiased>(
    scene: &Scene,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Result<Gradient, RenderError> {
    gradient::backward::<f32, S, Spread>(
        scene, theta, active, adjoint, settings, seed, samples, progress,
    )
}

impl Estimator {
    /// The estimator called `name`.
    ///
    /// # Errors
    /// An unknown name, with the known ones.
    pub fn from_name(name: &str) -> Result<Self, RenderError> {
        let found = Self::ALL.iter().find(|e| e.name() == name);
        found.copied().ok_or_else(|| RenderError::UnknownEstimator {
            name: name.into(),
            known: Self::ALL
                .iter()
                .map(|e| e.name())
                .collect::<Vec<_>>()
                .join(", "),
        })
    }

    /// The image and its derivative along the sum of `directions`, such as one number added to every
    /// roughness, in single precision (forward mode).
    ///
    /// # Errors
    /// A direction of the wrong length; an estimator that is wrong in this scene or for this parameter.
    pub fn forward_f32(
        self,
        scene: &Scene,
        values: &[f32],
        directions: &[Direction],
        settings: &Settings,
        seed: u64,
        samples: Range<u64>,
        progress: &dyn Progress,
    ) -> Result<Rendering, RenderError> {
        check_directions(scene, directions)?;
        let tangents = tangents::<1>(scene.params(), directions.iter().map(|d| (0, d)));
        let theta = Theta::<Dual<f32, 1>>::with_tangents(values, &tangents);
        self.forward()(scene, &theta, settings, seed, samples, progress)
    }

    /// The gradient of `<adjoint, image>` (reverse mode), in single precision.
    ///
    /// # Errors
    /// An adjoint image of the wrong size; an estimator that is wrong in this scene.
    pub fn backward_f32(
        self,
        scene: &Scene,
        theta: &Theta<f32>,
        active: &Active,
        adjoint: &[f32],
        settings: &Settings,
        seed: u64,
        samples: Range<u64>,
        progress: &dyn Progress,
    ) -> Result<Gradient, RenderError> {
        self.reverse()(
            scene, theta, active, adjoint, settings, seed, samples, progress,
        )
    }
}

type ReparameterisedMis = Mis<Reparameterised, Detached, AttachedWeights>;

estimators! {
    /// Light sampling only.
    Emitter "emitter" EmitterOnly<Detached>;
    /// Light sampling only, and samples of environment maps move with the texels; for scenes without
    /// discontinuities.
    EmitterAttached "emitter-attached" EmitterOnly<Detached, Attached>;
    /// BSDF sampling, samples constant.
    Detached "detached" BsdfOnly<Detached>;
    /// BSDF sampling, samples move; for scenes without discontinuities.
    Attached "attached" BsdfOnly<AttachedDirect>;
    /// The same where discontinuities bias it, to study that.
    AttachedNaive "attached-naive" AllowBias<BsdfOnly<AttachedDirect>>;
    /// Samples and all vertices behind them move; for scenes without discontinuities.
    AttachedPath "attached-path" BsdfOnly<Attached>;
    /// BSDF sampling, samples move but slow down at discontinuities.
    Reparameterised "reparameterised" BsdfOnly<Reparameterised>;
    /// BSDF sampling, and samples of the derivative of normals.
    Differential "differential" BsdfOnly<Differential>;
    /// Detached BSDF and light sampling, constant weights: the default.
    Mis "mis" DetachedMis;
    /// The same with the balance heuristic.
    MisBalance "mis-balance" Mis<Detached, Detached, DetachedWeights, Balance>;
    /// The same with lights trusted more, see [`TrustLights`]: to study weights, not to be used.
    MisTrustLights "mis-trust-lights" Mis<Detached, Detached, DetachedWeights, TrustLights>;
    /// The same with BSDF samples trusted more, likewise.
    MisTrustBsdf "mis-trust-bsdf" Mis<Detached, Detached, DetachedWeights, TrustBsdf>;
    /// [`Estimator::Mis`] with differentiated weights.
    MisAttachedWeights "mis-attached-weights" Mis<Detached, Detached, AttachedWeights>;
    /// BSDF sampling, samples of the derivative of normals and light sampling.
    DifferentialMis "differential-mis" Mis<Differential, Detached, DetachedWeights>;
    /// The same with the balance heuristic.
    DifferentialMisBalance "differential-mis-balance" Mis<Differential, Detached, DetachedWeights, Balance>;
    /// [`Estimator::DifferentialMis`] with differentiated weights for values.
    DifferentialMisAttachedWeights "differential-mis-attached-weights" Mis<Differential, Detached, AttachedWeights>;
    /// Attached BSDF sampling and light sampling, differentiated weights.
    AttachedMis "attached-mis" Mis<AttachedDirect, Detached, AttachedWeights>;
    /// The same where discontinuities bias it, to study that.
    AttachedMisNaive "attached-mis-naive" AllowBias<Mis<AttachedDirect, Detached, AttachedWeights>>;
    /// [`Estimator::AttachedMis`] with weights that follow the samples only.
    AttachedMisFrozen "attached-mis-frozen" Mis<AttachedDirect, Detached, FrozenWeights>;
    /// [`Estimator::AttachedMis`] whose samples of environment maps move with the texels.
    AttachedBoth "attached-both" Mis<AttachedDirect, Attached, AttachedWeights>;
    /// Reparameterised BSDF sampling and light sampling, differentiated weights.
    ReparameterisedMis "reparameterised-mis" ReparameterisedMis;
    /// Reparameterised with constant weights: biased [Zeltner 2021, Eq. 4.38].
    BiasedWeights "biased-weights" AllowBias<Mis<Reparameterised, Detached, DetachedWeights>>;
    /// Attached with constant weights: biased for the same reason, whatever the scene.
    BiasedAttachedWeights "biased-attached-weights" AllowBias<Mis<AttachedDirect, Detached, DetachedWeights>>;
    /// [`Estimator::Mis`] whose roulette takes a differentiated probability: biased where it is played (F5).
    BiasedRoulette "biased-roulette" AllowBias<AttachedRoulette<DetachedMis>>;
    /// Differentiated weights for one technique only: biased (errata Z-4.13f).
    BiasedMixed "biased-mixed" AllowBias<Mis<Reparameterised, Detached, MixedWeights>>;
    /// [`Estimator::Mis`] that divides by differentiated probabilities of lobes: biased where they depend on the
    /// parameter (F6).
    BiasedChoice "biased-choice" AllowBias<AttachedChoice<DetachedMis>>;
}
