//! All estimators of the derivative in roughness, where everything reflects everything [Zeltner 2021,
//! figures 4.1, 4.20 and 4.21].

use ad_core::Vec3;
use render::Job;
use render::instances::{Direction, Estimator};
use render::statistics::z_limit;
use render::{RenderError, Scene};

use crate::common_scenes::{TRAY, TRAY_LAMPS, tray};
use crate::differences::central;
use crate::statistics::{Series, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::{median, percentile};
use examples::scene_builder::picture;

const SEED: u64 = 420;
pub(crate) const DEPTH: u32 = 4;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
const ESTIMATORS: [Estimator; 11] = [
    Estimator::Emitter,
    Estimator::Detached,
    Estimator::Differential,
    Estimator::Reparameterised,
    Estimator::Mis,
    Estimator::MisAttachedWeights,
    Estimator::DifferentialMis,
    Estimator::DifferentialMisAttachedWeights,
    Estimator::ReparameterisedMis,
    Estimator::AttachedNaive,
    Estimator::AttachedMisNaive,
];
const EMITTER: usize = 0;
const DETACHED: usize = 1;
const DIFFERENTIAL: usize = 2;
const REPARAMETERISED: usize = 3;
const MIS: usize = 4;
const DIFFERENTIAL_MIS: usize = 6;
const REPARAMETERISED_MIS: usize = 8;
const NAIVE: usize = 9;

/// Sizes of images and blocks, numbers of runs and samples.
#[derive(Clone, Copy, Debug)]
struct Effort {
    size: [u32; 2],
    block: usize,
    runs: u64,
    spp: u64,
}

/// The direction of the derivative: all roughness grows alike.
fn directions(scene: &Scene) -> std::result::Result<Vec<Direction>, RenderError> {
    let of = |(name, _): &(&str, f64)| {
        Direction::uniform(scene.params(), &format!("{name}.alpha.value"))
    };
    TRAY.iter().map(of).collect()
}

fn series(
    effort: Effort,
    image: impl Fn(u64) -> std::result::Result<Vec<f64>, RenderError> + Sync + Send,
) -> Result<Series> {
    let width = effort.size[0] as usize;
    Ok(Series::of(effort.runs, [width, effort.block], image)?)
}

/// Central differences in double precision with common random numbers. Paths jump between things with
/// the roughness: the step is wide, a tenth of the smallest one.
fn differences(scene: &Scene, effort: Effort) -> Result<Series> {
    const STEP: f64 = 2e-3;
    let mut steps = Vec::new();
    for (name, _) in TRAY {
        let info = scene.params().find(&format!("{name}.alpha.value"))?;
        steps.push((info.offset, STEP));
    }
    let spp = 2 * effort.spp;
    series(effort, |run| {
        let job = Job::new(scene, &scene.settings, SEED + run, 0..spp, &());
        let difference = central(&job, Estimator::Mis, &steps);
        Ok(grey(&difference, 1.0 / (2.0 * STEP * spp as f64)))
    })
}

/// A set of pixels: its name, and whether a pixel belongs to it.
type Region = (&'static str, fn(&Seen) -> bool);

/// Properties of the surface at the centre of a pixel.
#[derive(Clone, Copy, Debug)]
struct Seen {
    /// Roughness; `None` in the background.
    alpha: Option<f64>,
    /// Whether the mirrored view meets another thing.
    reflects: bool,
    /// Whether a lamp is in the middle of what the rough surface reflects.
    lamp: bool,
}

fn seen(scene: &Scene) -> Vec<Seen> {
    let [width, height] = scene.film.size;
    let pixel = |i: u32| {
        let nothing = Seen {
            alpha: None,
            reflects: false,
            lamp: false,
        };
        let at = [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
        let ray = scene.camera.ray(at[0], at[1]);
        let Some(hit) = scene.intersect(&ray) else {
            return nothing;
        };
        let name = &scene.shape_info(hit.shape).name;
        let found = TRAY.iter().find(|(n, _)| n == name);
        let n = hit.si.frame.n;
        let mirrored = ray.d - n * (2.0 * ray.d.dot(n));
        let reflected = scene.intersect(&hit.si.spawn_ray(mirrored, scene.exit(hit.prim)));
        let emits = |s: u32| scene.shape_info(s).emitter.is_some();
        let alpha = found.map(|(_, alpha)| *alpha);
        // The slope of the microfacets that mirror it, in units of the roughness.
        let inside = |(at, ..): &([f64; 3], f64, [f64; 3])| {
            let to = (Vec3::from(at.map(|x| x as f32)) - hit.si.p).normalize();
            let cos = f64::from((to - ray.d).normalize().dot(n));
            let slope = (1.0 - cos * cos).sqrt() / cos.max(1e-6);
            to.dot(n) > 0.0 && alpha.is_some_and(|alpha| slope < alpha)
        };
        Seen {
            alpha,
            reflects: reflected.is_some_and(|r| !emits(r.shape)),
            lamp: TRAY_LAMPS.iter().any(inside),
        }
    };
    (0..width * height).map(pixel).collect()
}

/// `zeltner-4-20`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let effort = Effort {
        size: fig.pick([64, 48], [128, 96]),
        block: fig.pick(8, 16),
        runs: fig.pick(24, 32),
        spp: fig.pick(8, 16),
    };
    fig.note("width", effort.size[0]);
    fig.note("runs", effort.runs);
    fig.note("samples per pixel and run", effort.spp);
    fig.note("seed", SEED);
    let scene = tray(effort.size, DEPTH)?;
    let reference = differences(&scene, effort)?;
    let along = directions(&scene)?;
    let values = scene.params().values();
    let mut found = Vec::new();
    for (k, e) in ESTIMATORS.into_iter().enumerate() {
        found.push(series(effort, |run| {
            let seed = SEED + (k as u64 + 1) * 1000 + run;
            let spp = effort.spp;
            let r = e.forward_f32(
                &Job::new(&scene, &scene.settings, seed, 0..spp, &()),
                values,
                &along,
            )?;
            Ok(grey(&r.sums[1], 1.0 / spp as f64))
        })?);
    }
    let map = seen(&scene);
    let trial = Trial {
        effort,
        reference,
        found,
        map,
    };
    trial.unbiased(fig);
    trial.noise(fig);
    trial.report(fig);
    trial.pictures(fig, &scene);
    Ok(())
}

struct Trial {
    effort: Effort,
    reference: Series,
    found: Vec<Series>,
    map: Vec<Seen>,
}

impl Trial {
    /// Largest |z| of the blocks against the reference.
    fn z(&self, k: usize) -> f64 {
        let pairs = self.found[k].blocks.iter().zip(&self.reference.blocks);
        pairs.map(|(a, b)| a.z(b).abs()).fold(0.0, f64::max)
    }

    /// Standard deviation of one sample: mean over the pixels that `of` picks.
    fn std(&self, k: usize, of: impl Fn(&Seen) -> bool) -> f64 {
        let samples = (self.effort.runs * self.effort.spp) as f64;
        let pairs = self.found[k].pixels.iter().zip(&self.map);
        let chosen = pairs.filter(|(_, s)| of(s));
        let (sum, n) = chosen.fold((0.0, 0.0), |(sum, n), (e, _)| (sum + e.se, n + 1.0));
        sum / n * samples.sqrt()
    }

    /// Mean magnitude of the reference over the same pixels.
    fn signal(&self, of: impl Fn(&Seen) -> bool) -> f64 {
        let pairs = self.reference.pixels.iter().zip(&self.map);
        let chosen = pairs.filter(|(_, s)| of(s));
        let (sum, n) = chosen.fold((0.0, 0.0), |(sum, n), (e, _)| (sum + e.mean.abs(), n + 1.0));
        sum / n
    }

    fn unbiased(&self, fig: &mut Figure) {
        let n = self.reference.blocks.len();
        let limit = z_limit(NAIVE * n, self.effort.runs, LEVEL);
        let zs: Vec<f64> = (0..ESTIMATORS.len()).map(|k| self.z(k)).collect();
        let list = |range: std::ops::Range<usize>| {
            let texts = range.map(|k| format!("{} {:.2}", ESTIMATORS[k].name(), zs[k]));
            texts.collect::<Vec<_>>().join(", ")
        };
        fig.check(
            "(a) all unbiased estimators equal finite differences in every block",
            zs[..NAIVE].iter().all(|z| *z < limit),
            format!(
                "largest |z| of {n} blocks, limit {limit:.2}: {}",
                list(0..NAIVE)
            ),
        );
        fig.check(
            "(g) naive attached sampling differs by more than 5 standard errors",
            zs[NAIVE] > 5.0,
            format!("largest |z|: {}", list(NAIVE..ESTIMATORS.len())),
        );
    }

    /// Standard deviation of one estimator over that of another: the median of the pixels that `of` picks.
    fn ratio(&self, a: usize, b: usize, of: impl Fn(&Seen) -> bool) -> f64 {
        let pairs = self.found[a].pixels.iter().zip(&self.found[b].pixels);
        let chosen = pairs.zip(&self.map).filter(|(_, s)| of(s));
        let ratios = chosen.map(|((a, b), _)| a.se / b.se);
        let ratios: Vec<f64> = ratios.filter(|r| r.is_finite()).collect();
        median(&ratios).unwrap_or(f64::NAN)
    }

    fn noise(&self, fig: &mut Figure) {
        let rough = |s: &Seen| s.alpha.is_some_and(|a| a > 0.15) && s.lamp;
        let smooth = |s: &Seen| s.alpha.is_some_and(|a| a < 0.05);
        let lit = |s: &Seen| smooth(s) && !s.reflects;
        let crossed = |s: &Seen| smooth(s) && s.reflects;
        let all = |s: &Seen| s.alpha.is_some();

        let others = [DETACHED, DIFFERENTIAL, REPARAMETERISED];
        let ratios = others.map(|k| self.ratio(EMITTER, k, rough));
        fig.check(
            "(b) on rough things below small lamps, emitter sampling has the lowest std of the single \
             techniques",
            ratios.iter().all(|r| *r < 1.0),
            format!("{ratios:.2?} times that of detached, differential, reparameterised"),
        );
        let lamps = self.ratio(DETACHED, DIFFERENTIAL, lit);
        fig.check(
            "(c) where smooth things mirror lamps and hall: std of detached above twice that of \
             differential",
            lamps > 2.0,
            format!("{lamps:.2} times"),
        );
        let things = self.ratio(DETACHED, DIFFERENTIAL, crossed);
        fig.check(
            "(c) where they mirror each other, too",
            things > 2.0,
            format!("{things:.2} times"),
        );
        let pairs = self.found[REPARAMETERISED]
            .pixels
            .iter()
            .zip(&self.found[DETACHED].pixels);
        let pixels = self.map.iter().filter(|s| all(s)).count();
        let better = pairs
            .zip(&self.map)
            .filter(|((r, d), s)| all(s) && r.se < 0.5 * d.se)
            .count();
        let overall = self.ratio(REPARAMETERISED, DIFFERENTIAL, all);
        fig.check(
            "(d) reparameterised is better than detached in places, and not better than differential \
             overall",
            100 * better > pixels && overall >= 1.0,
            format!(
                "below half of its std in {better} of {pixels} pixels; {overall:.2} times differential"
            ),
        );
        let pairs = [
            (MIS, DETACHED),
            (DIFFERENTIAL_MIS, DIFFERENTIAL),
            (REPARAMETERISED_MIS, REPARAMETERISED),
        ];
        let ratios = pairs.map(|(both, one)| self.ratio(both, one, all));
        fig.check(
            "(e) combined with emitter sampling, the std of each is lower or equal",
            ratios.iter().all(|r| *r < 1.02),
            format!("{ratios:.2?} times for detached, differential, reparameterised"),
        );
        let least = |of: &dyn Fn(&Seen) -> bool| {
            let stds = (0..NAIVE).map(|k| self.std(k, of));
            stds.fold(f64::INFINITY, f64::min) / self.signal(of)
        };
        let (direct, indirect) = (least(&lit), least(&crossed));
        fig.check(
            "(f) where smooth things mirror each other, all are noisy: for the best of them one sample's \
             std is above the derivative, by more than where they mirror lights",
            indirect > 1.0 && indirect > direct,
            format!("{indirect:.1} times the derivative, where they mirror lights {direct:.1} times"),
        );
    }

    fn report(&self, fig: &mut Figure) {
        let regions: [Region; 5] = [
            ("all", |s| s.alpha.is_some()),
            ("rough", |s| s.alpha.is_some_and(|a| a > 0.15)),
            ("rough, mirrors lamps", |s| {
                s.alpha.is_some_and(|a| a > 0.15) && s.lamp
            }),
            ("smooth, mirrors lights", |s| {
                s.alpha.is_some_and(|a| a < 0.05) && !s.reflects
            }),
            ("smooth, mirrors things", |s| {
                s.alpha.is_some_and(|a| a < 0.05) && s.reflects
            }),
        ];
        let rows = ESTIMATORS.iter().enumerate().flat_map(|(k, e)| {
            regions.iter().map(move |(name, of)| {
                [
                    e.name().to_owned(),
                    (*name).to_owned(),
                    self.std(k, of).to_string(),
                    self.signal(of).to_string(),
                    self.z(k).to_string(),
                ]
            })
        });
        let header = [
            "estimator",
            "pixels",
            "std of a sample",
            "derivative",
            "largest z of a block",
        ];
        let rows: Vec<_> = rows.collect();
        fig.csv_text("deviations", &header, rows);
    }

    fn pictures(&self, fig: &mut Figure, scene: &Scene) {
        let image = picture(scene, SEED, fig.pick(64, 512)).image(0);
        let width = self.effort.size[0] as usize;
        let enlarge = (384 / width).max(1);
        let reference = self.reference.means();
        let scale = percentile(&reference, 0.95);
        let samples = ((self.effort.runs * self.effort.spp) as f64).sqrt();
        let signed = |label: &str, values: &[f64], scale: f64| {
            Panel::signed(label, width, values, Some(scale)).enlarged(enlarge)
        };
        let mut panels = vec![
            Panel::tonemapped("image", &image, 0.8).enlarged(enlarge),
            signed("finite differences", &reference, scale),
        ];
        let mut spreads = Vec::new();
        for (e, s) in ESTIMATORS.iter().zip(&self.found) {
            panels.push(signed(e.name(), &s.means(), scale));
            let std: Vec<f64> = s.pixels.iter().map(|e| e.se * samples).collect();
            spreads.push(signed(&format!("std: {}", e.name()), &std, 20.0 * scale));
        }
        fig.images("derivatives", 4, &panels);
        fig.images("deviations", 4, &spreads);
    }
}
