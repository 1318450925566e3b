//! Radiative backpropagation: the gradient of ten parameters in one pass over the image [Zeltner 2021,
//! algorithms 4.1 and 4.2].
//!
//! Parameters are an albedo, a specular reflectance, a roughness and an emission. Vertices do not
//! belong to them: detached paths have no derivative in geometry.

use optim::{Loss, LossKind};
use rayon::prelude::*;
use render::Job;
use render::film::PixelFilter;
use render::instances::{
    Direction, Estimator, backward_f32, backward_f64, forward_f32, render_f32,
};
use render::integrator::gradient::Active;
use render::params::{ParamInfo, Theta};
use render::statistics::{Estimate, z_limit};
use render::{Scene, Settings};

use super::propagation::{memory_stays, push_f64};
use crate::common_scenes::{Walls, cornell};
use crate::differences::central;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::picture;

const SEED: u64 = 4102;
pub(crate) const NAMES: [&str; 4] = [
    "left.reflectance.value",
    "back.specular_reflectance.value",
    "back.alpha.value",
    "light.emitter.radiance.value",
];
const LABELS: [&str; 10] = [
    "albedo r",
    "albedo g",
    "albedo b",
    "specular r",
    "specular g",
    "specular b",
    "roughness",
    "emission r",
    "emission g",
    "emission b",
];
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;

struct Room {
    scene: Scene,
    infos: Vec<ParamInfo>,
    active: Active,
    /// Derivative of a loss by the image: one linear functional for everything below.
    adjoint: Vec<f32>,
    target: render::Image,
}

/// What a gradient is estimated from.
#[derive(Clone, Copy, Debug)]
struct Samples {
    settings: Settings,
    seed: u64,
    spp: u64,
}

impl Room {
    fn new(size: u32) -> Result<Self> {
        let mut scene = cornell(size, Walls::GlossyBack, 5)?;
        // The adjoint of a pixel must not be filtered twice (errata Z-4.15): a box would hide it.
        scene.film.filter = PixelFilter::Gaussian { stddev: 0.5 };
        let infos = NAMES.iter().map(|n| scene.params().find(n).cloned());
        let infos: Vec<ParamInfo> = infos.collect::<std::result::Result<_, _>>()?;
        let active = Active::new(&scene, &NAMES)?;
        let mut other = scene.params().values().to_vec();
        let start = [0.3, 0.3, 0.4, 0.6, 0.9, 0.7, 0.3, 12.0, 14.0, 9.0];
        let places = infos.iter().flat_map(ParamInfo::range);
        places.zip(start).for_each(|(i, v)| other[i] = v);
        let shot = |values: &[f32], seed: u64| {
            let theta = Theta::constant(values);
            let job = Job::new(&scene, &scene.settings, seed, 0..128, &());
            render_f32(&job, &theta, Estimator::Mis).image(0)
        };
        let (image, target) = (shot(scene.params().values(), 1), shot(&other, 2));
        let mut adjoint = vec![0.0; image.data.len()];
        "l2".parse::<LossKind>()?
            .gradient(&image.data, &target.data, &mut adjoint)?;
        Ok(Self {
            scene,
            infos,
            active,
            adjoint,
            target,
        })
    }

    fn reverse_f64(&self, of: Samples) -> Result<Vec<f64>> {
        let values: Vec<f64> = self.values_f64();
        let theta = Theta::constant(&values);
        let gradient = backward_f64(
            &Job::new(&self.scene, &of.settings, of.seed, 0..of.spp, &()),
            &theta,
            &self.active,
            &self.adjoint,
        )?;
        Ok(gradient.values.concat())
    }

    fn reverse_f32(&self, of: Samples) -> std::result::Result<Vec<f64>, render::RenderError> {
        let theta = Theta::constant(self.scene.params().values());
        let gradient = backward_f32(
            &Job::new(&self.scene, &of.settings, of.seed, 0..of.spp, &()),
            &theta,
            &self.active,
            &self.adjoint,
        )?;
        Ok(gradient.values.concat())
    }

    /// Directions of the ten parameters, as range and vector.
    fn axes(&self) -> impl Iterator<Item = (&ParamInfo, Vec<f64>)> {
        self.infos.iter().flat_map(|info| {
            let n = info.shape.len();
            (0..n).map(move |k| (info, (0..n).map(|i| f64::from(i == k)).collect()))
        })
    }

    /// Ten derivative images, in double precision, against the adjoint.
    fn forward_f64(&self, of: Samples) -> Result<Vec<f64>> {
        self.axes()
            .map(|(info, axis)| {
                let (s, name) = (&of.settings, &info.name);
                let r = push_f64(&self.scene, name, &axis, s, of.seed, of.spp)?;
                Ok(self.against_adjoint(&r.sums[1], of.spp))
            })
            .collect()
    }

    /// The same in single precision, all ten in one call.
    fn forward_f32(&self, of: Samples) -> Result<Vec<f64>> {
        let params = self.scene.params();
        let directions: Vec<_> = self
            .axes()
            .map(|(info, axis)| {
                let axis = axis.iter().map(|&x| x as f32).collect();
                Direction::Dense(params.handle(info), axis)
            })
            .collect();
        let (values, s) = (params.values(), &of.settings);
        let samples = 0..of.spp;
        let r = forward_f32(
            &Job::new(&self.scene, s, of.seed, samples, &()),
            values,
            &directions,
        )?;
        let sums = r.sums.iter().skip(1);
        Ok(sums.map(|s| self.against_adjoint(s, of.spp)).collect())
    }

    /// Central differences of images with common random numbers, in double precision. Colours do not mix:
    /// three channels move at once.
    fn differences(&self, of: Samples) -> Vec<f64> {
        let values = self.values_f64();
        let mut out = Vec::new();
        for info in &self.infos {
            // Sampled paths jump with the roughness: a wide step. In the others the image is a polynomial.
            let step = if info.shape.len() == 1 { 0.1 } else { 0.02 };
            let steps: Vec<_> = info.range().map(|i| (i, step * values[i])).collect();
            let job = Job::new(&self.scene, &of.settings, of.seed, 0..of.spp, &());
            let difference = central(&job, Estimator::Mis, &steps);
            let scale = |i: usize| 1.0 / (2.0 * step * values[i] * of.spp as f64);
            if info.shape.len() == 1 {
                let sum = self.channel(&difference, None);
                out.push(sum * scale(info.offset));
            } else {
                out.extend((0..3).map(|c| {
                    let sum = self.channel(&difference, Some(c));
                    sum * scale(info.offset + c)
                }));
            }
        }
        out
    }

    fn values_f64(&self) -> Vec<f64> {
        let values = self.scene.params().values().iter();
        values.map(|&v| v.into()).collect()
    }

    fn against_adjoint(&self, sums: &[f64], spp: u64) -> f64 {
        self.channel(sums, None) / spp as f64
    }

    /// <adjoint, sums>, of all channels or of one.
    fn channel(&self, sums: &[f64], c: Option<usize>) -> f64 {
        let products = sums.iter().zip(&self.adjoint).enumerate();
        products
            .filter(|(i, _)| c.is_none_or(|c| i % 3 == c))
            .map(|(_, (s, &a))| s * f64::from(a))
            .sum()
    }
}

/// Largest difference relative to the other side.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    let pairs = a.iter().zip(b);
    pairs
        .map(|(a, b)| (a - b).abs() / b.abs())
        .fold(0.0, f64::max)
}

fn transpose(runs: Vec<Vec<f64>>) -> Vec<Estimate> {
    let n = LABELS.len();
    (0..n)
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect()
}

fn worst(a: &[Estimate], b: &[Estimate]) -> (f64, usize) {
    let zs = a.iter().zip(b).map(|(a, b)| a.z(b)).enumerate();
    zs.fold((0.0, 0), |(most, at), (i, z)| {
        if z.abs() > f64::abs(most) {
            (z, i)
        } else {
            (most, at)
        }
    })
}

/// `zeltner-alg-4-1`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let room = Room::new(fig.pick(32, 64))?;
    let (runs, spp): (u64, u64) = (32, fig.pick(16, 64));
    fig.note("runs", runs);
    fig.note("samples per pixel and run", spp);
    fig.note("seed", SEED);
    let settings = room.scene.settings;
    let at = |seed: u64| Samples {
        settings,
        seed,
        spp,
    };

    let pulled = room.reverse_f64(at(SEED))?;
    let off = distance(&room.forward_f64(at(SEED))?, &pulled);
    fig.check(
        "one reverse pass equals ten forward passes with the same seeds: 1e-9 in f64",
        off < 1e-9 && pulled.len() == LABELS.len(),
        format!("largest relative difference {off:.1e}"),
    );
    let off = distance(&room.forward_f32(at(SEED))?, &room.reverse_f32(at(SEED))?);
    fig.check(
        "the same in f32: 1e-3",
        off < 1e-3,
        format!("largest relative difference {off:.1e}"),
    );

    let many = |f: &(dyn Fn(u64) -> std::result::Result<Vec<f64>, render::RenderError> + Sync)| {
        let runs: std::result::Result<Vec<_>, _> = (0..runs).into_par_iter().map(f).collect();
        runs.map(transpose)
    };
    let reverse = many(&|k| room.reverse_f32(at(SEED + 1000 + k)))?;
    let differences = many(&|k| Ok(room.differences(at(SEED + 2000 + k))))?;
    let limit = z_limit(LABELS.len(), runs, LEVEL);
    let (z, i) = worst(&reverse, &differences);
    fig.check(
        "all ten equal finite differences",
        z.abs() < limit,
        format!(
            "largest |z| {z:.2} ({}), limit {limit:.2}; errors from {:.1} % to {:.1} % of a derivative",
            LABELS[i],
            100.0 * smallest(&reverse).0,
            100.0 * smallest(&reverse).1
        ),
    );
    // Survival is decided by constants: it must not add a derivative (errata S-D3).
    let roulette = Settings {
        rr_depth: 2,
        ..settings
    };
    let shortened = many(&|k| {
        room.reverse_f32(Samples {
            settings: roulette,
            ..at(SEED + 3000 + k)
        })
    })?;
    let (z, i) = worst(&shortened, &differences);
    fig.check(
        "Russian roulette from the second bounce on changes no derivative",
        z.abs() < limit,
        format!("largest |z| {z:.2} ({}), limit {limit:.2}", LABELS[i]),
    );

    // From where the longest path was met: a thread's records grow to that.
    let small = Room::new(16)?;
    let ladder: &[u64] = fig.pick(&[256, 512, 1024], &[256, 1024, 4096]);
    let peaks = memory_stays(fig, ladder, |spp| {
        let gradient = small.reverse_f32(Samples { spp, ..at(SEED) });
        gradient.map(|_| ()).map_err(|e| e.to_string())
    })?;
    report(fig, &room, &reverse, &differences, &pulled);
    let memory = ladder.iter().zip(&peaks);
    let memory: Vec<[f64; 2]> = memory.map(|(&n, &p)| [n as f64, p]).collect();
    fig.csv("memory", &["samples per pixel", "KiB"], memory);
    Ok(())
}

/// Smallest and largest standard error, relative.
fn smallest(estimates: &[Estimate]) -> (f64, f64) {
    let relative = estimates.iter().map(|e| e.se / e.mean.abs());
    relative.fold((f64::INFINITY, 0.0), |(lo, hi), e| (lo.min(e), hi.max(e)))
}

fn report(
    fig: &mut Figure,
    room: &Room,
    reverse: &[Estimate],
    differences: &[Estimate],
    pulled: &[f64],
) {
    let rows = LABELS.iter().enumerate().map(|(i, label)| {
        let (r, d) = (reverse[i], differences[i]);
        let numbers = [r.mean, r.se, d.mean, d.se, r.z(&d), pulled[i]];
        let [a, b, c, e, f, g] = numbers.map(|x| x.to_string());
        [(*label).to_owned(), a, b, c, e, f, g]
    });
    let rows: Vec<_> = rows.collect();
    let header = [
        "parameter",
        "reverse",
        "its error",
        "differences",
        "their error",
        "z",
        "reverse, f64, one run",
    ];
    fig.csv_text("gradient", &header, rows);
    // Each in units of the differences.
    let mut chart = LineChart::new(
        "One reverse pass over finite differences",
        "parameter",
        "ratio",
    );
    let ratio = |e: &[Estimate], k: f64| -> Vec<(f64, f64)> {
        let pairs = e.iter().zip(differences).enumerate();
        pairs
            .map(|(i, (e, d))| ((i + 1) as f64, (e.mean + k * e.se) / d.mean))
            .collect()
    };
    chart = chart
        .points("reverse mode", ratio(reverse, 0.0))
        .points("+ 2 standard errors", ratio(reverse, 2.0))
        .points("- 2 standard errors", ratio(reverse, -2.0))
        .dashed("finite differences", [(1.0, 1.0), (10.0, 1.0)]);
    fig.chart("gradient", &chart);
    let width = room.scene.film.size[0] as usize;
    let green = room.adjoint.iter().skip(1).step_by(3);
    let green: Vec<f64> = green.map(|&a| f64::from(a)).collect();
    let image = picture(&room.scene, 1, 128).image(0);
    let panels = [
        Panel::tonemapped("image", &image, 1.0).enlarged(4),
        Panel::tonemapped("target", &room.target, 1.0).enlarged(4),
        Panel::signed("adjoint image, green", width, &green, None).enlarged(4),
    ];
    fig.images("passes", 3, &panels);
}
