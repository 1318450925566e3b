//! What shapes, cameras and lights that move do to light, as far as nothing becomes visible or hidden: the interior term.
//!
//! It is an integral of its own, with samples of its own: ordinary paths over plain numbers, whose vertices are then moved
//! one by one ([`pull_back`]). Images get nothing from it but derivatives. Forward mode contracts the same adjoints, channel
//! by channel, with the tangents of the parameters, so that both modes are one linear map.
//!
//! Light from afar comes from a direction that is a constant in the world, also where an environment turns: then what it
//! sends from there changes.
//!
//! # Does not handle
//! Boundaries (F10): what is hidden stays hidden. Light from behind a surface with mapped normals that would see it is cut off
//! at its horizon (F9), which is a boundary, too. Dirac deltas and textures that jump are refused
//! ([`Scene::admits_motion`](crate::Scene::admits_motion)).

mod pull_back;
pub(super) mod slopes;
pub(super) mod trail;

use ad_core::{Const, Float, Real, array};

use self::pull_back::PullBack;
use self::trail::Trail;
use super::active::Active;
use super::exact::ExactBuffer;
use super::pass::Pass;
use super::path::Context;
use super::paths::{JOBS, TileSums, assemble, collect_parts, deposit};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::tile::{Paths, Sample, camera_sample, place};
use crate::estimator::Strategy;
use crate::math::Rgb;
use crate::parallel;
use crate::params::{GradSink, ParamRef, Theta};
use crate::sampler::Sampler;
use crate::scene::{Caustics, Scene};

/// The adjoints of one sample: only once all of them are known to be numbers, they count.
pub(super) struct Held<'a> {
    active: &'a Active,
    pub found: Vec<(ParamRef, u32, f64)>,
}

impl<P: Float> GradSink<P> for Held<'_> {
    fn active(&self, p: ParamRef) -> bool {
        self.active.contains(p)
    }

    fn add(&mut self, p: ParamRef, i: usize, d: P) {
        if self.active.contains(p) {
            self.found.push((p, i as u32, d.to_f64()));
        }
    }
}

impl<'a> Held<'a> {
    pub fn new(active: &'a Active) -> Self {
        Self {
            active,
            found: Vec::new(),
        }
    }

    pub fn is_finite(&self) -> bool {
        self.found.iter().all(|(_, _, d)| d.is_finite())
    }

    /// The adjoints times the tangents of the parameters.
    pub fn tangent<R: Real>(&self, theta: &Theta<R>) -> R {
        let add = |sum: R, &(p, i, d): &(ParamRef, u32, f64)| {
            let x = theta.get(p, i as usize);
            sum + (x - Const(x.primal())) * R::c(d)
        };
        self.found.iter().fold(R::zero(), add)
    }

    /// The sample is complete, a number if `finite`, and cost so many edges: its adjoints are added to the sums, or it is
    /// counted as none.
    pub fn settle(
        &self,
        (scene, sample): (&Scene, Sample),
        finite: bool,
        edges: u32,
        sink: &mut Sink,
        non_finite: &mut NonFinite,
    ) {
        if !(finite && self.is_finite()) {
            non_finite.add(place(scene, sample.pixel) as u64, sample.index);
            return;
        }
        for &(p, i, d) in &self.found {
            GradSink::<f64>::add(sink, p, i as usize, d);
        }
        sink.finish(scene, sample, edges);
    }
}

/// The paths of a pass, over plain numbers: all light is theirs, whoever else finds caustics.
pub(super) fn context<'a, R: Real>(
    pass: &'a Pass<'a, R>,
    theta: &'a Theta<'a, R::Primal>,
) -> Context<'a, R::Primal> {
    Context {
        scene: pass.scene,
        theta,
        settings: pass.settings,
        shifts: &[],
        caustics: Caustics::Paths,
        split: None,
        progress: pass.progress,
    }
}

/// What moves in derivative images.
pub(super) fn image<R: Components, S: Strategy, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let scene = pass.scene;
    let theta = pass.theta.primal();
    let active = Active::moving(scene, pass.theta);
    let context = context(pass, &theta);
    let tiles = pass.tiles();
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let sums = parallel::map(tiles.len(), |i| -> TileSums {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut non_finite = NonFinite::default();
        if pass.progress.cancelled() {
            return (Vec::new(), non_finite);
        }
        let mut sums = vec![0.0; R::COUNT * pixels * 3];
        let mut paths = Paths::<R::Primal, S, X, _>::new(Trail::default());
        let mut pull_back = PullBack::new::<S>(scene, &theta, &active);
        let mut held = Held::new(&active);
        let done = |at: usize, sample: Sample, l: Rgb<R::Primal>, trail: &mut Trail<R::Primal>| {
            let at_camera =
                camera_sample::<R::Primal, X>(scene, pass.settings.points, pass.seed, &sample);
            let mut tangents = [R::zero(); 3];
            let mut finite = l.is_finite();
            for (c, tangent) in tangents.iter_mut().enumerate() {
                held.found.clear();
                let unit = |i| R::Primal::select(i == c, R::Primal::one(), R::Primal::zero());
                pull_back.add(trail, &at_camera, array(unit).into(), &mut held);
                finite &= held.is_finite();
                *tangent = held.tangent(pass.theta);
            }
            trail.clear();
            if !(finite && Rgb::from(tangents).is_finite()) {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                return;
            }
            let weight = spp * sample.scale();
            deposit(&mut sums, at, Rgb::from(tangents), weight);
        };
        tile.trace(&context, (pass.seed, &pass.samples), &mut paths, done);
        if pass.progress.cancelled() {
            return (Vec::new(), NonFinite::default());
        }
        pass.progress.advance(pixels as u64);
        (sums, non_finite)
    });
    assemble(pass, R::COUNT, &sums)
}

/// The derivative of `<adjoint, image>` in what moves. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, S: Strategy, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let (scene, theta) = (pass.scene, pass.theta);
    let context = context(pass, theta);
    let tiles = pass.tiles();
    let jobs = JOBS.min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::of_samples(active, large);
        let mut non_finite = NonFinite::default();
        let mut paths = Paths::<P, S, X, _>::new(Trail::default());
        let mut pull_back = PullBack::new::<S>(scene, theta, active);
        let mut held = Held::new(active);
        for tile in tiles.iter().skip(job).step_by(jobs) {
            if pass.progress.cancelled() {
                break;
            }
            let done = |_, sample: Sample, l: Rgb<P>, trail: &mut Trail<P>| {
                let at_camera =
                    camera_sample::<P, X>(scene, pass.settings.points, pass.seed, &sample);
                let d = sample.of_image::<P>(adjoint, scene) * P::of(sample.scale());
                held.found.clear();
                pull_back.add(trail, &at_camera, d, &mut held);
                let edges = trail.stops.len() as u32 + 1;
                let which = (scene, sample);
                held.settle(which, l.is_finite(), edges, &mut sink, &mut non_finite);
                trail.clear();
            };
            tile.trace(&context, (pass.seed, &pass.samples), &mut paths, done);
            pass.progress.advance(tile.pixels() as u64);
        }
        (sink, non_finite)
    });
    collect_parts(scene, active, parts)
}
