//! The integral over glints: paths over one vertex, on a glinty surface that the camera sees ([`crate::glint`]).
//!
//! A glint is a path like any other: over a scalar with tangents its value has the derivatives of its factors, and reverse mode
//! goes back through the record of its vertices.

use ad_core::{Float, Real, Vec2, Vec3};

use super::active::Active;
use super::exact::ExactBuffer;
use super::pass::Pass;
use super::paths::{TileSums, assemble, deposit};
use super::record::{Bounce, Contribution, MetLight, Observer, PathRecord, Place, Recorder};
use super::rendering::{Components, NonFinite, Rendering};
use super::sink::{GradientSums, Sink};
use super::tile::{Sample, place, spot};
use super::vertex::MODE;
use crate::bsdf::{Bsdf, Component, DeltaKind, Part, Shading};
use crate::emitter::{Emission, Emitter};
use crate::error::RenderError;
use crate::estimator::{BsdfOnly, Detached, Sampling, Strategy};
use crate::glint::{Finder, Footprint, Glint};
use crate::manifold::cast;
use crate::math::Rgb;
use crate::parallel;
use crate::params::{ParamInfo, ParamKind};
use crate::sampler::{Independent, Sampler};
use crate::scene::{Scene, Settings};

/// Whether glints have the derivatives that are asked for, if they are sought: those that leave them where they are.
///
/// # Errors
/// Names the parameter that moves glints, or the reason.
pub(super) fn check<'a, S: Strategy>(
    settings: &Settings,
    moving: impl IntoIterator<Item = &'a ParamInfo>,
) -> Result<(), RenderError> {
    if settings.glints.is_none() {
        return Ok(());
    }
    if !S::Bsdf::DETACHED_PATH {
        let what = "whole paths that move have none; expected another estimator, or `--glints off`";
        return Err(RenderError::Glints { what: what.into() });
    }
    for info in moving {
        match info.kind {
            ParamKind::Smooth | ParamKind::Emission | ParamKind::Roughness | ParamKind::Normals => {
            }
            ParamKind::Delta
            | ParamKind::Position
            | ParamKind::Camera
            | ParamKind::LightPosition => {
                let name = &info.name;
                let what = format!(
                    "parameter `{name}` moves them, and they have derivatives only where they stay; expected \
                     `--glints off`"
                );
                return Err(RenderError::Glints { what });
            }
        }
    }
    Ok(())
}

/// That there are none, where something else has no part for them.
///
/// # Errors
/// That there are.
pub(super) fn refuse(settings: &Settings, whose: &str) -> Result<(), RenderError> {
    if settings.glints.is_none() {
        return Ok(());
    }
    let what = format!("{whose} leave out their light; expected `--glints off`");
    Err(RenderError::Glints { what })
}

/// So that glints and the paths beside them are independent.
const STREAM: u64 = 0x676c_696e_7473_2121;

/// The sum is made of this many parts, whatever the number of threads.
const JOBS: usize = 128;

fn vector<R: Real>(v: Vec3<f64>) -> Vec3<R> {
    v.map(R::of)
}

fn emission<R: Real>(e: &Emission<f64>) -> Emission<R> {
    Emission {
        uv: Vec2::new(R::of(e.uv.x), R::of(e.uv.y)),
        falloff: R::of(e.falloff),
    }
}

/// Who finds the glints of a pass. `None` if nobody does.
fn finder<'a, R: Real>(pass: &'a Pass<'a, R>) -> Option<Finder<'a, R::Primal>> {
    let (split, options) = (pass.split.as_deref()?, pass.settings.glints?);
    let glinty = split.glinty();
    let theta = pass.theta.primal();
    (!glinty.is_empty()).then(|| Finder::new(pass.scene, theta, glinty, options))
}

/// The glints of a sample, and the shape and the primitive they are on.
fn found<P: Float, X: Sampler>(
    scene: &Scene,
    pass: (crate::sampler::Points, u64),
    sample: &Sample,
    finder: &Finder<P>,
    glinty: &[bool],
    out: &mut Vec<Glint>,
) -> Option<(u32, u32)> {
    let (points, seed) = pass;
    out.clear();
    let ([x, y, u, v], _) = spot::<P, X>(scene, points, seed ^ STREAM, sample.pixel, sample.index);
    // Counted on the full film, so that a crop shows the same samples.
    let film = &scene.film;
    let [px, py] = [0, 1].map(|k: usize| sample.pixel[k] + film.crop_offset[k]);
    let at = [x, y].map(|x| x.to_f64());
    let middle = [px, py].map(|p| f64::from(p) + 0.5);
    let foot = Footprint::new(scene, at, [u, v].map(|u| u.to_f64()), middle)?;
    if !glinty[foot.shape as usize] {
        return None;
    }
    let pixel = u64::from(py) * u64::from(film.size[0]) + u64::from(px);
    let mut rng = Independent::new(seed ^ STREAM, pixel, sample.index);
    // A weight of its own: the point is not that of the paths.
    let offset = [0, 1].map(|k: usize| at[k] - middle[k]);
    finder.find(&foot, film.filter.weight(offset), &mut rng, out);
    Some((foot.shape, foot.prim))
}

/// What the material at a glint makes of light.
fn reflectance<R: Real>(scene: &Scene, pass: &Pass<R>, shape: u32, glint: &Glint) -> Rgb<R> {
    let at = Shading {
        theta: *pass.theta,
        uv: Vec2::new(R::of(glint.si.uv.x), R::of(glint.si.uv.y)),
    };
    let (wo, wi) = (vector(glint.wo), vector(glint.wi));
    let material = scene.material(shape);
    material.eval_delta(&at, wo, wi, DeltaKind::Reflection, 0, MODE)
}

/// The image of glints.
pub(super) fn image<R: Components, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let Some((finder, split)) = finder(pass).zip(pass.split.as_deref()) else {
        return Rendering::black(pass.scene.film.crop_size, &pass.samples, R::COUNT);
    };
    let (scene, progress, seed) = (pass.scene, pass.progress, pass.seed);
    let points = pass.settings.points;
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let tiles = pass.tiles();
    let sums: Vec<TileSums> = parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![0.0f64; R::COUNT * pixels * 3];
        let mut non_finite = NonFinite::default();
        let mut glints = Vec::new();
        for (at, sample) in tile.samples::<R::Primal, X>(scene, points, seed, &pass.samples) {
            if progress.cancelled() {
                return (Vec::new(), NonFinite::default());
            }
            let sees = (points, seed);
            let seen = found::<_, X>(scene, sees, &sample, &finder, split.glinty(), &mut glints);
            let Some((shape, _)) = seen else {
                continue;
            };
            let mut l = Rgb::<R>::black();
            for glint in &glints {
                let e = &scene.emitters()[glint.emitter as usize];
                let le = e.eval(pass.theta, &emission(&glint.emission));
                l += reflectance(scene, pass, shape, glint) * le * R::of(glint.weight);
            }
            if !l.is_finite() {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                continue;
            }
            deposit(&mut sums, at, l, spp / sample.count as f64);
        }
        progress.advance(pixels as u64);
        (sums, non_finite)
    });
    let mut out = assemble(pass, R::COUNT, &sums);
    out.glints = finder.statistics();
    out
}

/// How paths to glints scatter: a glint goes back as a path that was scattered.
type Scattering = BsdfOnly<Detached>;

/// A glint as a record of its path.
fn recorded<P: Float>(
    scene: &Scene,
    pass: &Pass<P>,
    on: (u32, u32),
    glint: &Glint,
) -> PathRecord<P> {
    let (shape, prim) = on;
    let mut path = PathRecord::default();
    let at = Place {
        shape,
        prim,
        si: cast(&glint.si),
        wo: vector(glint.wo),
    };
    path.vertex(Rgb::splat(P::one()), &at);
    let f = reflectance(scene, pass, shape, glint);
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
    let Some((finder, split)) = finder(pass).zip(pass.split.as_deref()) else {
        return sums;
    };
    let (scene, seed, points) = (pass.scene, pass.seed, pass.settings.points);
    let tiles = pass.tiles();
    let jobs = JOBS.min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        let mut glints = Vec::new();
        for tile in tiles.iter().skip(job).step_by(jobs) {
            for (_, sample) in tile.samples::<P, X>(scene, points, seed, &pass.samples) {
                if pass.progress.cancelled() {
                    break;
                }
                let sees = (points, seed);
                let seen =
                    found::<_, X>(scene, sees, &sample, &finder, split.glinty(), &mut glints);
                let Some(on) = seen else {
                    continue;
                };
                let d = sample.of_image::<P>(adjoint, scene) * P::of(1.0 / sample.count as f64);
                let mut l = Rgb::black();
                for glint in &glints {
                    let path = recorded(scene, pass, on, glint);
                    let recorder = Recorder { active, path };
                    l += recorder.backward::<Scattering>(scene, pass.theta, d, &mut sink);
                }
                if !l.is_finite() {
                    non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                }
            }
            pass.progress.advance(tile.pixels() as u64);
        }
        (sink.into_small(), non_finite)
    });
    sums.with_parts(parts)
}
