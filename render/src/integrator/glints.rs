//! The integral over glints: paths over one vertex, on a glinty surface that the camera sees ([`crate::glint`]).
//!
//! A glint is a path like any other: over a scalar with tangents its value has the derivatives of its factors, and reverse mode
//! goes back through the record of its vertices.

use ad_core::{Float, Real, Vec2};

use super::active::Active;
use super::connections::{emission, vector};
use super::exact::ExactBuffer;
use super::pass::Pass;
use super::paths::{JOBS, TileSums, assemble, deposit};
use super::progress::Progress;
use super::record::{Bounce, Contribution, MetLight, Observer, PathRecord, Place, Recorder};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::solved::Solved;
use super::tile::{Sample, place, spot};
use super::vertex::MODE;
use crate::bsdf::{Bsdf, Component, DeltaKind, Part, Shading};
use crate::emitter::Emitter;
use crate::error::RenderError;
use crate::estimator::{BsdfOnly, Detached};
use crate::glint::{Drawn, Finder, Glint, Pixel};
use crate::manifold::{Statistics, cast};
use crate::math::Rgb;
use crate::parallel;
use crate::sampler::{Family, Independent, Points, Sampler};
use crate::scene::Scene;

/// Glints that the camera sees.
pub(super) const GLINTS: Solved = Solved {
    these: "glints",
    option: "--glints off",
    error: |what| RenderError::Glints { what },
    is_sought: |settings| settings.glints.is_some(),
    admits: |_, _| Ok(()),
};

/// Finds the glints of a pass, sample by sample.
struct Seeking<'a, P: Float> {
    scene: &'a Scene,
    progress: &'a dyn Progress,
    finder: &'a Finder<'a, P>,
    /// Whether the camera looks through lamps.
    hidden: bool,
    points: Points,
    seed: u64,
    /// The pixel that was sampled last.
    pixel: Option<([u32; 2], Pixel)>,
    /// Glints of the sample.
    found: Vec<Glint>,
    /// What walks came to so far.
    came_to: Statistics,
}

/// What finds the glints of a pass; `None` where glints are not looked for.
fn finder<'a, R: Real>(pass: &'a Pass<'a, R>) -> Option<Finder<'a, R::Primal>> {
    let (split, options) = (pass.split.as_deref()?, pass.settings.glints?);
    let glinty = split.glinty();
    let theta = pass.theta.primal();
    (!glinty.is_empty()).then(|| Finder::new(pass.scene, theta, glinty, options))
}

impl<'a, P: Float> Seeking<'a, P> {
    fn new<R: Real<Primal = P>>(pass: &Pass<'a, R>, finder: &'a Finder<'a, P>) -> Self {
        Self {
            scene: pass.scene,
            progress: pass.progress,
            finder,
            hidden: pass.settings.hides(1),
            points: pass.settings.points,
            seed: pass.seed,
            pixel: None,
            found: Vec::new(),
            came_to: Statistics::default(),
        }
    }

    /// Finds the glints of a sample.
    fn seek<X: Sampler>(&mut self, sample: &Sample) {
        let (scene, seed) = (self.scene, Family::Glints.seed(self.seed));
        self.found.clear();
        let (seen, mut numbers) =
            spot::<P, X>(scene, self.points, seed, sample.pixel, sample.index);
        let (on_film, number) = scene.film.full_pixel(sample.pixel);
        let known = self.pixel.take().filter(|(at, _)| *at == on_film);
        let (_, pixel) = self.pixel.insert(known.unwrap_or_else(|| {
            let middle = on_film.map(|p| f64::from(p) + 0.5);
            (on_film, self.finder.pixel(middle, self.hidden))
        }));
        // Weights are those of a point that is not that of the paths.
        let [film, lens] = [seen.film, seen.lens].map(|x| x.map(P::to_f64));
        let part = numbers.next_3d::<f64>();
        let view = Drawn { film, lens, part };
        let mut rng = Independent::new(seed, number, sample.index);
        let progress = self.progress;
        let cancelled = || progress.cancelled();
        let (came_to, found) = (&mut self.came_to, &mut self.found);
        (self.finder).find(pixel, &view, &mut rng, &cancelled, came_to, found);
    }
}

/// What the material at a glint makes of light.
fn reflectance<R: Real>(scene: &Scene, pass: &Pass<R>, glint: &Glint) -> Rgb<R> {
    let at = Shading::new(
        *pass.theta,
        Vec2::new(R::of(glint.si.uv.x), R::of(glint.si.uv.y)),
    );
    let (wo, wi) = (vector(glint.wo), vector(glint.wi));
    let material = scene.material(glint.shape);
    material.eval_delta(&at, wo, wi, DeltaKind::Reflection, 0, MODE)
}

/// The image of glints.
pub(super) fn image<R: Components, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let Some(finder) = finder(pass) else {
        return Rendering::black(pass.scene.film.crop_size, &pass.samples, R::COUNT);
    };
    let (scene, progress, seed) = (pass.scene, pass.progress, pass.seed);
    let points = pass.settings.points;
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let tiles = pass.tiles();
    let found: Vec<(TileSums, Statistics)> = parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![0.0f64; R::COUNT * pixels * 3];
        let mut non_finite = NonFinite::default();
        let mut seeking = Seeking::new(pass, &finder);
        for (at, sample) in tile.samples::<R::Primal, X>(scene, points, seed, &pass.samples) {
            if progress.cancelled() {
                return ((Vec::new(), NonFinite::default()), seeking.came_to);
            }
            seeking.seek::<X>(&sample);
            if seeking.found.is_empty() {
                continue;
            }
            let mut l = Rgb::<R>::black();
            for glint in &seeking.found {
                let e = &scene.emitters()[glint.emitter as usize];
                let le = e.eval(pass.theta, &emission(&glint.emission));
                l += reflectance(scene, pass, glint) * le * R::of(glint.weight);
            }
            if !l.is_finite() {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                continue;
            }
            deposit(&mut sums, at, l, spp / sample.count as f64);
        }
        progress.advance(pixels as u64);
        ((sums, non_finite), seeking.came_to)
    });
    let (sums, came_to): (Vec<TileSums>, Vec<Statistics>) = found.into_iter().unzip();
    let mut out = assemble(pass, R::COUNT, &sums);
    came_to.iter().for_each(|s| out.glints.merge(s));
    out
}

/// How paths to glints scatter: a glint goes back as a path that was scattered.
type Scattering = BsdfOnly<Detached>;

/// A glint as a record of its path.
fn recorded<P: Float>(scene: &Scene, pass: &Pass<P>, glint: &Glint) -> PathRecord<P> {
    let mut path = PathRecord::default();
    let at = Place {
        shape: glint.shape,
        prim: glint.prim,
        si: cast(&glint.si),
        wo: vector(glint.wo),
    };
    path.vertex(Rgb::splat(P::one()), &at);
    let f = reflectance(scene, pass, glint);
    let weight = P::of(glint.weight);
    path.contribution(Contribution::Scattered(Bounce {
        wi: vector(glint.wi),
        component: Component::Delta {
            kind: DeltaKind::Reflection,
            route: 0,
        },
        mode: MODE,
        weight,
        f,
        part: Part::All,
        deciding: None,
    }));
    path.contribution(Contribution::Met(MetLight {
        emitter: glint.emitter,
        emission: emission(&glint.emission),
        weight: P::one(),
        beta: f * weight,
        share: P::one(),
    }));
    path
}

/// The derivative of `<adjoint, image>` by glints. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let sums = GradientSums::zero(active);
    let Some(finder) = finder(pass) else {
        return sums;
    };
    let (scene, seed, points) = (pass.scene, pass.seed, pass.settings.points);
    let tiles = pass.tiles();
    let jobs = JOBS.min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        let mut seeking = Seeking::new(pass, &finder);
        for tile in tiles.iter().skip(job).step_by(jobs) {
            for (_, sample) in tile.samples::<P, X>(scene, points, seed, &pass.samples) {
                if pass.progress.cancelled() {
                    break;
                }
                seeking.seek::<X>(&sample);
                let d = sample.of_image::<P>(adjoint, scene) * P::of(1.0 / sample.count as f64);
                let mut l = Rgb::black();
                for glint in &seeking.found {
                    let path = recorded(scene, pass, glint);
                    let recorder = Recorder { active, path };
                    l += recorder.backward::<Scattering>(scene, pass.theta, d, &mut sink);
                }
                if !l.is_finite() {
                    non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                }
            }
            pass.progress.advance(tile.pixels() as u64);
        }
        ((sink.into_small(), non_finite), seeking.came_to)
    });
    let (parts, came_to): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    let mut sums = sums.with_parts(parts);
    came_to.iter().for_each(|s| sums.glints.merge(s));
    sums
}
