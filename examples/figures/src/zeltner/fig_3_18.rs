//! [Zeltner 2021, figure 3.18]: azimuths that wrap around, in walks through a cylinder of glass.
//!
//! The renderer wraps them, and has its frame turn with the light, so that nothing depends on where azimuths begin. Walks here
//! are its own but for that: azimuths about a vertical axis that begin anywhere, and differences of them that are wrapped or
//! are not.

use ad_core::{Vec2, Vec3};
use rayon::prelude::*;
use render::bsdf::DeltaKind;
use render::manifold::constraint::scatter;
use render::manifold::{Solution, Space, Start, Target, Vertex, distinct, trials};
use render::math::Frame;
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Uniqueness};
use render::shape::{Cylinder, Shape};
use render::statistics::{Estimate, z_limit};

use super::manifold_scenes::glass;
use super::specular_scenes::Laboratory;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 318;
const LAMP: [f64; 3] = [-12.0, 7.0, 0.0];
/// The cylinder among the shapes, and its radius.
const SHAPE: u32 = 1;
const RADIUS: f64 = 2.0;
/// In through one side and out through the other.
const LIKE: [(u32, DeltaKind); 2] = [(SHAPE, DeltaKind::Transmission); 2];
const MOST_STEPS: u32 = 20;
const TOLERANCE: f64 = 1e-9;
/// How far a converged vertex may be from its root.
const ERROR: f64 = 1e-6;

/// A cylinder of glass on a floor, a lamp behind it.
fn scene() -> Result<render::Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-12.0, 0.0, -12.0], [0.0, 0.0, 24.0], [24.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let smooth = glass(&mut b)?;
    let cylinder = Cylinder::new([0.0; 3], [0.0, 8.0, 0.0], RADIUS, false);
    b.shape("cylinder", cylinder.ok_or("no cylinder")?, &smooth);
    let view = View {
        eye: [14.0, 12.0, 0.0],
        target: [2.0, 0.0, 0.0],
        fov: 40.0,
        size: [16; 2],
    };
    b.finish(&view, 4)
}

/// How azimuths are measured.
#[derive(Clone, Copy)]
struct Azimuths {
    frame: Frame<f64>,
    wrap: bool,
}

impl Azimuths {
    /// About the vertical axis, with the jump so many degrees aside of the lamp.
    fn new(degrees: f64, wrap: bool) -> Self {
        let (sin, cos) = degrees.to_radians().sin_cos();
        // The lamp is towards -x, and the jump opposite to `s`.
        let s = Vec3::new(cos, 0.0, sin);
        let n = Vec3::new(0.0, 1.0, 0.0);
        let frame = Frame {
            s,
            t: n.cross(s),
            n,
        };
        Self { frame, wrap }
    }

    fn of(&self, d: Vec3<f64>) -> f64 {
        d.dot(self.frame.t).atan2(d.dot(self.frame.s))
    }

    /// The difference between the azimuths of the way to the lamp and of that of the light behind the last vertex.
    fn difference(&self, last: &Vertex, next: Vec3<f64>) -> Option<f64> {
        let refracted = |w| scatter(last.kind, w, last.normal(), last.eta());
        Some(match refracted(last.wo) {
            Some(onward) => self.of(next) - self.of(onward),
            None => self.of(last.wo) - self.of(refracted(next)?),
        })
    }
}

/// Walks to one light.
struct Walks<'a> {
    space: Space<'a>,
    start: Start,
    lamp: Vec3<f64>,
    azimuths: Azimuths,
}

impl Walks<'_> {
    /// Newton's method with the step control of the renderer, and how many steps it tried.
    fn walk(&self, towards: Vec3<f64>) -> (Option<Solution>, u32) {
        let Self { space, start, .. } = self;
        let Some(mut chain) = space.trace_own(start, towards, &LIKE) else {
            return (None, 0);
        };
        let (target, mut part, mut tried) = (Target::Point(self.lamp), 1.0, 0);
        let value = |chain: &[Vertex]| {
            let at = space.derivative(start.si.p, chain, &target, &self.azimuths.frame)?;
            let last = chain.last()?;
            let turn = if self.azimuths.wrap {
                at.value.y
            } else {
                let next = (self.lamp - last.si.p).normalize();
                self.azimuths.difference(last, next)?
            };
            Some((at, Vec2::new(at.value.x, turn)))
        };
        let Some((mut at, mut c)) = value(&chain) else {
            return (None, 0);
        };
        for _ in 0..MOST_STEPS {
            if c.x.abs().max(c.y.abs()) <= TOLERANCE {
                let solution = Solution {
                    chain,
                    start: start.si.p,
                    derivative: at,
                    error: ERROR,
                };
                return (Some(solution), tried);
            }
            let Some(inverse) = at.first.inverse() else {
                break;
            };
            let step = inverse * c;
            let first = &chain[0].si;
            let Frame { s, t, .. } = Frame::from_normal(first.n_geo);
            let less = loop {
                tried += 1;
                let q = first.p - (s * step.x + t * step.y) * part;
                let found = space.trace_own(start, (q - start.si.p).normalize(), &LIKE);
                let found = found.and_then(|chain| {
                    let (at, now) = value(&chain)?;
                    (now.length() < c.length()).then_some((chain, at, now))
                });
                if found.is_some() || part < 1.0 / 64.0 {
                    break found;
                }
                part *= 0.5;
            };
            let Some(next) = less else {
                break;
            };
            (chain, at, c) = next;
            part = (2.0 * part).min(1.0);
        }
        (None, tried)
    }

    /// From a random point of the glass.
    fn random(&self, rng: &mut Independent) -> (Option<Solution>, u32) {
        let shape = &self.space.scene.shapes()[SHAPE as usize];
        match shape.sample(self.start.si.p, rng.next_2d::<f64>()) {
            Some(sample) => self.walk(sample.d),
            None => (None, 0),
        }
    }

    /// An unbiased estimate of the light, up to what glass reflects, and the steps that it took.
    fn estimate(&self, rng: &mut Independent) -> (f64, u32) {
        let (Some(first), mut steps) = self.random(rng) else {
            return (0.0, 1);
        };
        let again = || {
            let (found, more) = self.random(rng);
            steps += more;
            found.is_some_and(|s| first.is(&s, Uniqueness::ErrorBounds))
        };
        let (n, _) = trials(again, 1 << 16);
        (worth(&first) * f64::from(n), steps)
    }
}

/// What a solution brings to the floor, up to what glass reflects.
fn worth(solution: &Solution) -> f64 {
    solution.angle_per_target() * solution.direction().y.max(0.0)
}

/// Points of the floor behind the glass.
fn points(size: usize) -> Vec<[f64; 2]> {
    let at = |k: usize| (k as f64 + 0.5) / size as f64;
    (0..size * size)
        .map(|i| [2.2 + 7.0 * at(i / size), 3.0 * (2.0 * at(i % size) - 1.0)])
        .collect()
}

/// `zeltner-3-18`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("seed", SEED);
    let lab = Laboratory::new(scene()?);
    let space = lab.space(Constraint::Angle);
    let walks = |[x, z]: [f64; 2], azimuths: Azimuths| {
        Ok::<_, Box<dyn std::error::Error>>(Walks {
            space,
            start: lab.floor(x, z).ok_or("no floor")?,
            lamp: Vec3::from(LAMP),
            azimuths,
        })
    };

    // ---- Success by where azimuths begin ----
    let (size, each) = (fig.pick(8, 16), fig.pick(24u64, 100));
    fig.note("points", size * size);
    fig.note("walks per point", each);
    let rate = |azimuths: Azimuths| -> Result<f64> {
        let all: Vec<Walks> = (points(size).into_iter())
            .map(|p| walks(p, azimuths))
            .collect::<Result<_>>()?;
        let converged = all.par_iter().enumerate().map(|(i, w)| {
            let ended = (0..each).filter(|k| {
                let mut rng = Independent::new(SEED, i as u64, *k);
                w.random(&mut rng).0.is_some()
            });
            ended.count()
        });
        Ok(converged.sum::<usize>() as f64 / (all.len() as u64 * each) as f64)
    };
    let angles = fig.pick(
        vec![-120.0, -60.0, -20.0, 0.0, 20.0, 60.0, 120.0],
        (-12..=12).map(|k| 15.0 * f64::from(k)).collect(),
    );
    let rows: Vec<[f64; 3]> = (angles.into_iter())
        .map(|a| {
            let [wrapped, plain] = [true, false].map(|wrap| rate(Azimuths::new(a, wrap)));
            Ok([a, wrapped?, plain?])
        })
        .collect::<Result<_>>()?;
    let at_lamp = rows
        .iter()
        .find(|r| r[0] == 0.0)
        .ok_or("no angle of zero")?;
    let ratio = at_lamp[1] / at_lamp[2];
    fig.check(
        "where the jump is towards the lamp, wrapped differences about double the success rate",
        (1.6..=2.5).contains(&ratio),
        format!(
            "{:.1} % and {:.1} %, a ratio of {ratio:.2}",
            100.0 * at_lamp[1],
            100.0 * at_lamp[2]
        ),
    );
    let (low, high) = (rows.iter().map(|r| r[1])).fold((1.0, 0.0), |(low, high), r| {
        (f64::min(low, r), f64::max(high, r))
    });
    fig.check(
        "wrapped, it does not matter where azimuths begin; otherwise it is the better the further from the lamp",
        high - low < 0.02 && rows[0][2] > at_lamp[2],
        format!("{:.1} to {:.1} %", 100.0 * low, 100.0 * high),
    );
    let chart = LineChart::new(
        "walks through a cylinder",
        "degrees from the lamp to the jump of azimuths",
        "success rate",
    )
    .measured("wrapped", rows.iter().map(|r| (r[0], r[1])))
    .measured("as they are", rows.iter().map(|r| (r[0], r[2])));
    fig.chart("rates", &chart);
    fig.csv("rates", &["degrees", "wrapped", "plain"], rows);

    // ---- The light, and its noise ----
    let (size, each) = (fig.pick(12, 48), fig.pick(24u64, 64));
    fig.note("estimates per point", each);
    // What there is, from all solutions: a point near a caustic would count as much as all others without.
    let places = points(size);
    let light: Vec<f64> = (places.par_iter().enumerate())
        .map(|(i, p)| {
            let all = walks(*p, Azimuths::new(0.0, true)).ok()?;
            let mut rng = Independent::new(SEED + 3, i as u64, 0);
            let same = |a: &Solution, b: &Solution| a.is(b, Uniqueness::ErrorBounds);
            let found = distinct(200, || all.random(&mut rng).0, same);
            Some(found.iter().map(worth).sum())
        })
        .map(|found| found.unwrap_or(0.0))
        .collect();
    let measured = |wrap: bool| -> Result<(Vec<f64>, Vec<Estimate>, f64)> {
        let all: Vec<Walks> = (places.iter())
            .map(|p| walks(*p, Azimuths::new(0.0, wrap)))
            .collect::<Result<_>>()?;
        let estimates: Vec<Vec<(f64, u32)>> = (all.par_iter().enumerate())
            .map(|(i, w)| {
                let one = |k: u64| {
                    let seed = SEED + 1 + u64::from(wrap);
                    w.estimate(&mut Independent::new(seed, i as u64, k))
                };
                (0..each).map(one).collect()
            })
            .collect();
        let pixels: Vec<Estimate> = (estimates.iter())
            .map(|e| Estimate::of(&e.iter().map(|x| x.0).collect::<Vec<_>>()))
            .collect();
        // Independent pictures, as wholes: of what there is.
        let lit = light.iter().filter(|l| **l > 0.0).count() as f64;
        let wholes = (0..each as usize).map(|k| {
            let of = estimates.iter().zip(&light).filter(|(_, l)| **l > 0.0);
            of.map(|(e, l)| e[k].0 / l).sum::<f64>() / lit
        });
        let steps = estimates.iter().flatten().map(|e| f64::from(e.1)).sum();
        Ok((wholes.collect(), pixels, steps))
    };
    let (wrapped, pixels, steps) = measured(true)?;
    let (plain, pixels_plain, steps_plain) = measured(false)?;
    let (a, b) = (Estimate::of(&wrapped), Estimate::of(&plain));
    let z = [a, b].map(|e| e.z(&Estimate::exact(1.0)));
    let limit = z_limit(2, each, 1e-3);
    fig.check(
        "both have the mean of all solutions",
        z.iter().all(|z| z.abs() < limit) && a.se < 0.05 && b.se < 0.1,
        format!(
            "{:.4} ± {:.4} and {:.4} ± {:.4} of it, deviates {z:.2?}, limit {limit:.2}",
            a.mean, a.se, b.mean, b.se
        ),
    );
    let gain = (b.se / a.se).powi(2);
    fig.check(
        "wrapped, there is less noise, at equal samples and for the same number of steps",
        gain > 1.0 && gain * steps_plain > steps,
        format!(
            "variance {gain:.2} times smaller, steps {:.2} times",
            steps_plain / steps
        ),
    );
    let mean = pixels.iter().map(|e| e.mean).sum::<f64>() / pixels.len() as f64;
    let panels = [("wrapped", &pixels), ("as they are", &pixels_plain)].map(|(label, p)| {
        let values: Vec<f64> = p.iter().map(|e| 0.5 * e.mean / mean).collect();
        Panel::false_colour(label, size, &values, 0.0, 2.0).enlarged(fig.pick(10, 5))
    });
    fig.images("light", 2, &panels);
    Ok(())
}
