//! A rough mirror under an environment, over directions and over random numbers [Zeltner 2021, section
//! 4.2.2, unnumbered]; and the environment's texels as parameters.

mod texels;

use std::f64::consts::TAU;

use ad_core::{Dual, Real, Vec3};
use render::bsdf::microfacet::{Microfacet, Ndf};
use render::emitter::{AnyEmitter, Emitter};
use render::params::Theta;
use render::sampler::Sampler;
use render::statistics::z_limit;
use render::{Image, Scene};

use crate::statistics::Moments;
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

type D = Dual<f64, 1>;

const SEED: u64 = 422;
const ALPHA: f64 = 0.1;
/// Angle of the viewer from the normal, radians.
const INCIDENCE: f64 = 0.9;
/// Azimuth of the viewer: its mirror image is between two lamps.
const AZIMUTH: f64 = 0.55;

/// Reflection of the environment by a GGX mirror that absorbs nothing, visible normals sampled. The normal is
/// up.
struct Mirror<'a> {
    light: &'a AnyEmitter,
    values: Vec<f64>,
    wo: Vec3<f64>,
}

impl<'a> Mirror<'a> {
    fn new(scene: &'a Scene) -> Self {
        let (sin, cos) = AZIMUTH.sin_cos();
        Self {
            light: &scene.emitters()[0],
            values: (scene.params().values().iter().copied().map(f64::from)).collect(),
            wo: Vec3::new(
                INCIDENCE.sin() * cos,
                INCIDENCE.sin() * sin,
                INCIDENCE.cos(),
            ),
        }
    }

    /// Luminance from a direction (z up), with its derivative along with the direction's.
    fn light<R: Real<Primal = f64>>(&self, w: Vec3<R>) -> R {
        // The environment's y is up.
        let d = Vec3::new(w.x, w.z, -w.y);
        let theta = Theta::constant(&self.values);
        let hit = self.light.hit(d, None);
        hit.map_or(R::zero(), |e| self.light.eval::<R>(&theta, &e).luminance())
    }

    fn surface<R>(alpha: R) -> Microfacet<R> {
        Microfacet {
            kind: Ndf::Ggx,
            alpha,
            visible: true,
        }
    }

    /// The direction for two random numbers, if above the horizon.
    fn sample<R: Real<Primal = f64>>(&self, u: [f64; 2], alpha: R) -> Option<Vec3<R>> {
        let wo = Vec3::lift(self.wo);
        let m = Self::surface(alpha).sample(wo, u);
        let w = m * (wo.dot(m) * R::c(2.0)) - wo;
        (w.z.primal() > 0.0).then_some(w)
    }

    /// BSDF times cosine over the density of [`Self::sample`]: masking of the sampled direction.
    fn weight<R: Real<Primal = f64>>(w: Vec3<R>, alpha: R) -> R {
        w.z / Self::surface(alpha).sigma(w)
    }

    /// BSDF times cosine.
    fn bsdf<R: Real<Primal = f64>>(&self, w: Vec3<R>, alpha: R) -> R {
        let wo = Vec3::lift(self.wo);
        let m = (wo + w).normalize();
        let s = Self::surface(alpha);
        s.d(m) * w.z / (s.sigma(wo) * s.sigma(w) * R::c(4.0))
    }

    /// The terms at two random numbers.
    fn at(&self, u: [f64; 2]) -> Terms {
        let moving = D::var(ALPHA, 0);
        let Some(w) = self.sample(u, moving) else {
            return Terms::default();
        };
        let fixed = w.primal();
        let (light, weight) = (self.light(w), Self::weight(w, moving));
        let f = self.bsdf(Vec3::lift(fixed), moving);
        // How fast the light changes along two directions, each at a right angle to `w`.
        let s = Vec3::new(-fixed.y, fixed.x, 0.0).normalize();
        let t = fixed.cross(s);
        let along = |s: f64, t: f64, w: f64| Dual::<f64, 2>::new(w, [s, t]);
        let tangent = self.light(Vec3::new(
            along(s.x, t.x, fixed.x),
            along(s.y, t.y, fixed.y),
            along(s.z, t.z, fixed.z),
        ));
        Terms {
            primal: light.re * weight.re,
            weight: weight.re,
            attached: (light * weight).eps[0],
            moved: light.eps[0] * weight.re,
            detached: f.eps[0] / f.re * weight.re * light.re,
            slope: tangent.eps[0].hypot(tangent.eps[1]),
        }
    }
}

/// An estimate and its derivatives.
#[derive(Clone, Copy, Debug, Default)]
struct Terms {
    primal: f64,
    weight: f64,
    /// Derivative by roughness of the attached estimate.
    attached: f64,
    /// Its part from the motion of the sample in the light: `dT / d alpha . grad L`.
    moved: f64,
    /// Derivative of the detached estimate.
    detached: f64,
    /// Gradient of the light over directions, absolute.
    slope: f64,
}

/// `zeltner-4-2-2-env`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(100_000, 2_000_000);
    let size = fig.pick(128, 384);
    fig.note("alpha", ALPHA);
    fig.note("angle of the viewer", INCIDENCE);
    fig.note("samples", n);
    fig.note("seed", SEED);
    let mut builder = SceneBuilder::default();
    let material = builder.matt("floor", [0.5; 3])?;
    let sides = [[2.0, 0.0, 0.0], [0.0, 0.0, -2.0]];
    builder.quad("floor", [[-1.0, 0.0, 1.0], sides[0], sides[1]], &material)?;
    builder.hall(1.0)?;
    let view = View {
        eye: [0.0, 1.0, 4.0],
        target: [0.0; 3],
        fov: 30.0,
        size: [8, 8],
    };
    let scene = builder.finish(&view, 2)?;
    let mirror = Mirror::new(&scene);

    let exact = by_directions(&mirror, fig.pick(1000, 4000));
    let moments = |f: &dyn Fn(Terms) -> f64| Moments::of(n, SEED, |s| f(mirror.at(s.next_2d())));
    // The value, two derivatives, and these beside each other.
    let limit = z_limit(4, n, 1e-3);
    let primal = moments(&|t| t.primal);
    fig.check(
        "the value over random numbers has the mean of the product over directions",
        primal.z(exact.re).abs() < limit,
        format!(
            "{:.5} ± {:.5} and {:.5}",
            primal.mean,
            primal.of_mean().se,
            exact.re
        ),
    );
    let [attached, detached] = [moments(&|t| t.attached), moments(&|t| t.detached)];
    for (name, m) in [("attached", &attached), ("detached", &detached)] {
        fig.check(
            format!("the derivative, {name}, has the mean of that over directions"),
            m.z(exact.eps[0]).abs() < limit,
            format!(
                "{:.4} ± {:.4} and {:.4}; std {:.2}",
                m.mean,
                m.of_mean().se,
                exact.eps[0],
                m.variance().sqrt()
            ),
        );
    }
    let apart = attached.of_mean().z(&detached.of_mean());
    fig.check(
        "attached and detached estimates have the same mean",
        // Of the same random numbers, so closer than independent ones.
        apart.abs() < limit,
        format!("{apart:.2} standard errors apart, limit {limit:.2}"),
    );

    let grid: Vec<Terms> = (0..size * size)
        .map(|i| {
            let (x, y) = (i % size, size - 1 - i / size);
            mirror.at([x, y].map(|c| (c as f64 + 0.5) / size as f64))
        })
        .collect();
    let above: Vec<&Terms> = grid.iter().filter(|t| t.weight > 0.0).collect();
    let low = above.iter().map(|t| t.weight).fold(1.0, f64::min);
    let mean = above.iter().map(|t| t.weight).sum::<f64>() / above.len() as f64;
    let spread = above.iter().map(|t| (t.weight - mean).powi(2)).sum::<f64>();
    let spread = (spread / above.len() as f64).sqrt();
    fig.check(
        "over random numbers, the value is the warped environment: the rest is nearly constant",
        mean > 0.97 && spread < 0.05,
        format!("weight {mean:.4} ± {spread:.4}, at least {low:.3}"),
    );
    let edge = |t: &&&Terms| t.slope > 1e-9;
    let flat: f64 = (above.iter().filter(|t| !edge(t)))
        .map(|t| t.moved.abs())
        .fold(0.0, f64::max);
    let edges = above.iter().filter(edge).count() as f64 / above.len() as f64;
    let square = |f: &dyn Fn(&Terms) -> f64, all: bool| -> f64 {
        let chosen = above.iter().filter(|t| all || edge(t));
        chosen.map(|t| f(t).powi(2)).sum()
    };
    let share = square(&|t| t.attached, false) / square(&|t| t.attached, true);
    let moved = above.iter().map(|t| t.moved);
    let signs = [moved.clone().fold(0.0, f64::max), moved.fold(0.0, f64::min)];
    let typical = primal.mean;
    fig.check(
        "the derivative is large at the edges of lamps, with either sign, and only there",
        flat < 1e-9 && edges < 0.3 && share > 0.95 && signs[0] > 10.0 * typical
            && signs[1] < -10.0 * typical,
        format!(
            "from {:.0} to {:.0} (mean value {typical:.2}); edges fill {:.0} % of the square and hold {:.2} % of the squared derivative; elsewhere at most {flat:.0e} is due to motion",
            signs[1],
            signs[0],
            100.0 * edges,
            100.0 * share
        ),
    );
    let rest = square(&|t| t.attached - t.moved, true) / square(&|t| t.attached, true);
    fig.check(
        "the derivative is the product of motion and the light's gradient, but for masking",
        rest < 1e-3,
        format!("the rest holds {rest:.1e} of the squared derivative"),
    );

    let column = |f: &dyn Fn(&Terms) -> f64| grid.iter().map(f).collect::<Vec<_>>();
    let grey = |values: &[f64], label: &str, exposure: f64| {
        let mut image = Image::new(size, size);
        image.data = values.iter().flat_map(|&v| [v as f32; 3]).collect();
        Panel::tonemapped(label, &image, exposure)
    };
    let panels = [
        grey(
            &product(&mirror, size),
            "BSDF x light x cosine, directions from above",
            0.05,
        ),
        grey(&column(&|t| t.primal), "the same over random numbers", 0.12),
        Panel::signed("attached derivative", size, &column(&|t| t.attached), None),
        Panel::signed(
            "motion . gradient of the light",
            size,
            &column(&|t| t.moved),
            None,
        ),
        Panel::signed("detached derivative", size, &column(&|t| t.detached), None),
    ];
    let panels = panels.map(|p| p.enlarged(fig.pick(3, 1)));
    fig.images("environment", 3, &panels);
    let rows = [&primal, &attached, &detached].into_iter().enumerate();
    let rows = rows.map(|(k, m)| {
        let exact = [exact.re, exact.eps[0]][k.min(1)];
        [k as f64, exact, m.mean, m.of_mean().se, m.variance().sqrt()]
    });
    let header = ["estimate", "exact", "mean", "mean_error", "std"];
    fig.csv("moments", &header, rows);
    texels::measure(fig)
}

/// The reflected light and its derivative by roughness, over directions in rings about the mirror
/// direction: `n` rings of tilt of the normal, in which the lobe is smooth.
fn by_directions(mirror: &Mirror, n: usize) -> D {
    let alpha = D::var(ALPHA, 0);
    let around = n;
    let mut sum = D::zero();
    for i in 0..n {
        // tan(theta_m) = alpha t / (1 - t): dense where the lobe is.
        let t = (i as f64 + 0.5) / n as f64;
        let tan = ALPHA * t / (1.0 - t);
        let slope = ALPHA / (1.0 - t).powi(2) / n as f64;
        let cos = (1.0 + tan * tan).sqrt().recip();
        for j in 0..around {
            let (y, x) = (TAU * (j as f64 + 0.5) / around as f64).sin_cos();
            let m = Vec3::new(tan * x, tan * y, 1.0) * cos;
            let visible = mirror.wo.dot(m);
            let w = m * (2.0 * visible) - mirror.wo;
            if w.z <= 0.0 || visible <= 0.0 {
                continue;
            }
            // Solid angle of normals: tan cos^3 d tan d phi; of directions: 4 wo.m times it.
            let solid = tan * cos.powi(3) * slope * (TAU / around as f64) * 4.0 * visible;
            let f = mirror.bsdf(Vec3::lift(w), alpha);
            sum += f * D::lift(mirror.light(w) * solid);
        }
    }
    sum
}

/// BSDF times light times cosine over the unit disc of directions.
fn product(mirror: &Mirror, size: usize) -> Vec<f64> {
    let place = |i: usize| 2.0 * (i as f64 + 0.5) / size as f64 - 1.0;
    (0..size * size)
        .map(|i| {
            let (x, y) = (place(i % size), -place(i / size));
            let squared = 1.0 - x * x - y * y;
            if squared <= 0.0 {
                return 0.0;
            }
            let w = Vec3::new(x, y, squared.sqrt());
            mirror.bsdf(w, ALPHA) * mirror.light(w)
        })
        .collect()
}
