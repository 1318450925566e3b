//! [Zeltner 2021, algorithm 3.1] with the geometric terms (3.9) and (3.10): into which medium they are anchored, and how often
//! the squared index belongs into the light (errata Z-3.9 and Z-Alg-3.1).
//!
//! Particles count what arrives, without a convention of radiance.

use ad_core::Vec3;
use rayon::prelude::*;
use render::bsdf::{DeltaKind, fresnel};
use render::manifold::constraint::refract;
use render::manifold::{Solution, Space, Start, Target};
use render::math::Ray;
use render::sampler::{Independent, Sampler};
use render::scene::Constraint;
use render::shape::{Exit, Shape};
use render::statistics::{Estimate, z_limit};

use super::manifold_scenes::{WATER, Waves, glass, half_ball, half_ball_lamp, pool};
use super::specular_scenes::Laboratory;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 31;
const GLASS: f64 = 1.5;
/// Half a side of the patches of the floor over which light is averaged.
const PATCH: f64 = 0.15;

/// Particles start so far off the lamp, so that they do not meet it.
const OFF: f64 = 1e-3;

/// An interface between a floor and a lamp, of unit radiance.
struct Case<'a> {
    name: &'static str,
    lab: &'a Laboratory,
    /// The interface among the shapes.
    shape: u32,
    eta: f64,
    /// Where the lamp is: corner and sides, and its unit normal.
    lamp: [Vec3<f64>; 3],
    places: Vec<[f64; 2]>,
}

impl Case<'_> {
    fn lamp_at(&self, [u, v]: [f64; 2]) -> Vec3<f64> {
        self.lamp[0] + self.lamp[1] * u + self.lamp[2] * v
    }

    fn facing(&self, d: Vec3<f64>) -> f64 {
        let n = self.lamp[1].cross(self.lamp[2]);
        n.normalize().dot(d)
    }

    fn area(&self) -> f64 {
        self.lamp[1].cross(self.lamp[2]).length()
    }

    /// Algorithm 3.1: one walk from the way to the lamp. Light on the floor at a point, for unit radiance.
    fn walk(&self, start: &Start, u: [f64; 2]) -> Option<(f64, Solution)> {
        let space = self.lab.space(Constraint::Angle);
        let at = self.lamp_at(u);
        let target = Target::Point(at);
        let like = [(self.shape, DeltaKind::Transmission)];
        let chain = space.trace_own(start, (at - start.si.p).normalize(), &like)?;
        // Nothing, where the walk fails.
        let solution = space.walk(start, chain, &target).solution?;
        let vertex = &solution.chain[0];
        let out = (at - vertex.si.p).normalize();
        let facing = self.facing(-out);
        if facing <= 0.0 {
            return None;
        }
        let transmit = fresnel::dielectric(vertex.normal().dot(out).abs(), self.eta).transmit;
        let cos = solution.direction().y;
        let value = solution.angle_per_target() * facing * self.area() * cos * transmit;
        Some((value, solution))
    }

    /// The same from the other end: dOmega_k / dA_1, with the cosine there.
    fn anchored_at_lamp(&self, start: &Start, at: Vec3<f64>, there: &Solution) -> Option<f64> {
        let space: Space = self.lab.space(Constraint::Angle);
        let mut back = *start;
        back.si.p = at;
        back.exit = Exit::default();
        let like = [(self.shape, DeltaKind::Transmission)];
        let d = (there.chain[0].si.p - at).normalize();
        let chain = space.trace_own(&back, d, &like)?;
        let target = Target::Point(start.si.p);
        let again = space.walk(&back, chain, &target).solution?;
        Some(again.angle_per_target())
    }

    /// Light on the patch around a point by particles, for unit radiance: flux over area.
    fn particle(&self, [x, z]: [f64; 2], rng: &mut Independent) -> f64 {
        let scene = &self.lab.scene;
        let from = self.lamp_at(rng.next_2d());
        let shape = &scene.shapes()[self.shape as usize];
        let Some(sample) = shape.sample(from, rng.next_2d::<f64>()) else {
            return 0.0;
        };
        let facing = self.facing(sample.d);
        let Some(met) = scene.intersect(&Ray::new(from + sample.d * OFF, sample.d)) else {
            return 0.0;
        };
        if facing <= 0.0 || met.shape != self.shape {
            return 0.0;
        }
        let n = met.si.frame.n;
        let light = fresnel::dielectric(n.dot(sample.d).abs(), self.eta);
        let Some(onward) = refract(-sample.d, n, self.eta) else {
            return 0.0;
        };
        let ray = met.si.spawn_ray(onward, scene.exit(met.prim));
        let Some(landed) = scene.intersect(&ray) else {
            return 0.0;
        };
        let p = landed.si.p;
        let inside = (p.x - x).abs() < PATCH && (p.z - z).abs() < PATCH && p.y.abs() < 1e-3;
        let flux = self.area() * facing * light.transmit / sample.pdf;
        f64::from(u8::from(inside)) * flux / (4.0 * PATCH * PATCH)
    }
}

/// `zeltner-alg-3-1`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, particles) = (
        fig.pick(4_000u64, 40_000),
        fig.pick(1_000_000u64, 4_000_000),
    );
    fig.note("walks", n);
    fig.note("particles", particles);
    fig.note("seed", SEED);
    let still = Waves::new(1.0, 0.0, SEED);
    let water = Laboratory::new(pool(16, 0.3, &still)?);
    let ball = Laboratory::new(half_ball(16, 0.4, |b, radius| {
        let smooth = glass(b)?;
        b.ball("ball", [0.0; 3], radius, &smooth)?;
        Ok(())
    })?);
    let v = |p: [f64; 3]| Vec3::from(p);
    let cases = [
        Case {
            name: "water",
            lab: &water,
            shape: 5,
            eta: WATER,
            lamp: [v([0.5, 4.5, -0.3]), v([0.6, 0.0, 0.0]), v([0.0, 0.0, 0.6])],
            places: vec![[0.7, 0.1], [-0.2, 0.4], [-1.2, -0.6]],
        },
        Case {
            name: "ball",
            lab: &ball,
            shape: 1,
            eta: GLASS,
            lamp: half_ball_lamp(0.4).map(v),
            places: vec![[-1.0, 0.5], [0.5, -1.0], [-2.0, 0.0]],
        },
    ];
    let mut rows = Vec::new();
    for (c, case) in cases.iter().enumerate() {
        anchors(fig, case)?;
        for (k, place) in case.places.iter().enumerate() {
            let stream = (10 * c + k) as u64;
            let walks: Vec<f64> = (0..n)
                .into_par_iter()
                .map(|i| {
                    let mut rng = Independent::new(SEED, stream, i);
                    let [a, b] = rng.next_2d::<f64>().map(|u| PATCH * (2.0 * u - 1.0));
                    let start = case.lab.floor(place[0] + a, place[1] + b)?;
                    Some(case.walk(&start, rng.next_2d())?.0)
                })
                .map(|found| found.unwrap_or(0.0))
                .collect();
            let counted: Vec<f64> = (0..particles)
                .into_par_iter()
                .map(|i| case.particle(*place, &mut Independent::new(SEED + 1, stream, i)))
                .collect();
            let (walks, counted) = (Estimate::of(&walks), Estimate::of(&counted));
            rows.push((case.name, case.eta, walks, counted));
        }
    }
    // Squared indices by which the bare (3.9), with the factor 1 - F, is to be multiplied.
    let off = |power: i32| {
        let of = |(_, eta, a, b): &(&str, f64, Estimate, Estimate)| {
            let scaled = Estimate {
                mean: a.mean * eta.powi(power),
                se: a.se * eta.powi(power),
            };
            scaled.z(b).abs()
        };
        rows.iter().map(of).collect::<Vec<f64>>()
    };
    let (right, printed, bare) = (off(2), off(4), off(0));
    let largest = |z: &[f64]| z.iter().copied().fold(0.0, f64::max);
    let least = |z: &[f64]| z.iter().copied().fold(f64::INFINITY, f64::min);
    let limit = z_limit(rows.len(), n.min(particles), 1e-3);
    fig.check(
        "with the squared index of the floor's medium once, walks bring what particles count",
        largest(&right) < limit && rows.iter().all(|r| r.3.se < 0.05 * r.3.mean),
        format!("largest deviate {:.2}, limit {limit:.2}", largest(&right)),
    );
    fig.check(
        "without it or with it twice, at no place",
        least(&bare) > 6.0 && least(&printed) > 6.0,
        format!(
            "least deviates {:.0} without and {:.0} twice",
            least(&bare),
            least(&printed)
        ),
    );
    let numbered = || rows.iter().enumerate().map(|(i, r)| ((i + 1) as f64, r));
    let chart = LineChart::new("light at six places", "place", "over what particles count")
        .y_range(0.0, 2.5)
        .points(
            "(3.9) times squared index",
            numbered().map(|(i, r)| (i, r.2.mean * r.1 * r.1 / r.3.mean)),
        )
        .points(
            "(3.9) alone",
            numbered().map(|(i, r)| (i, r.2.mean / r.3.mean)),
        )
        .points(
            "squared index twice",
            numbered().map(|(i, r)| (i, r.2.mean * r.1.powi(4) / r.3.mean)),
        )
        .dashed("particles", [(1.0, 1.0), (rows.len() as f64, 1.0)]);
    fig.chart("light", &chart);
    let columns = [
        "interface",
        "eta",
        "walks",
        "error_of_walks",
        "particles",
        "error_of_particles",
    ];
    let table = rows.iter().map(|(name, eta, a, b)| {
        let [e, w, x, p, y] = [*eta, a.mean, a.se, b.mean, b.se].map(|x| x.to_string());
        [(*name).to_owned(), e, w, x, p, y]
    });
    fig.csv_text("light", &columns, table.collect::<Vec<_>>());
    Ok(())
}

/// The terms anchored at either end, at the first place.
fn anchors(fig: &mut Figure, case: &Case) -> Result {
    let [x, z] = case.places[0];
    let start = case.lab.floor(x, z).ok_or("no floor")?;
    let (_, there) = case.walk(&start, [0.3, 0.6]).ok_or("no chain")?;
    let at = case.lamp_at([0.3, 0.6]);
    let back = (case.anchored_at_lamp(&start, at, &there)).ok_or("no chain back")?;
    let (one, other) = (there.angle_per_target(), back);
    let squared = case.eta * case.eta;
    fig.check(
        format!(
            "{}: (3.10) is the squared index times (3.9), not equal to it",
            case.name
        ),
        (other / (one * squared) - 1.0).abs() < 1e-6,
        format!("{one:.6} and {other:.6}, {squared:.4} times as much"),
    );
    if case.name == "water" {
        // Rings of light under flat water: sin dtheta dphi over x dphi cos dx.
        let vertex = &there.chain[0];
        let out = (at - vertex.si.p).normalize();
        let (deep, high) = (vertex.si.p.y - start.si.p.y, at.y - vertex.si.p.y);
        let (cos_1, cos_2) = (there.direction().y, out.y);
        let (sin_1, sin_2) = ((1.0 - cos_1 * cos_1).sqrt(), (1.0 - cos_2 * cos_2).sqrt());
        let x = deep * sin_1 / cos_1 + high * sin_2 / cos_2;
        let slope = deep / (cos_1 * cos_1) + high / (cos_2 * cos_2) * case.eta * cos_1 / cos_2;
        let expected = sin_1 / (x * cos_2 * slope);
        fig.check(
            "water: (3.9) is that of flat water in closed form",
            (one / expected - 1.0).abs() < 1e-6,
            format!("{one:.8} and {expected:.8}"),
        );
    }
    Ok(())
}
