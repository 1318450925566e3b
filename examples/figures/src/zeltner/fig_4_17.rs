//! Where attached samples have to stand still: the factor B of reparameterised attached sampling over
//! the hemisphere above a point of a room [Zeltner 2021, figure 4.17].

use std::f64::consts::TAU;

use ad_core::Vec3;
use rayon::prelude::*;
use render::Scene;
use render::integrator::reparameterisation::freeze;
use render::math::{Frame, Ray};
use render::sampler::{Independent, Sampler};

use crate::common_scenes::{Walls, cornell};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 417;
/// On the floor, in front of the tall block.
const POINT: [f64; 3] = [-0.3, -1.0 + 1e-4, 0.5];
/// Enough auxiliary rays to find every outline nearby: B itself, not an estimate with few of them.
const RAYS: usize = 512;

struct Place {
    scene: Scene,
    frame: Frame<f64>,
}

impl Place {
    fn b(&self, w: Vec3<f64>, rays: usize, stream: u64) -> f64 {
        let mut sampler = Independent::new(SEED, stream, 0);
        freeze(
            &self.scene,
            &Ray::new(POINT.into(), self.frame.to_world(w)),
            &self.frame,
            w,
            rays,
            &mut sampler,
        )
        .b
    }

    fn primitive(&self, w: Vec3<f64>) -> Option<u32> {
        let ray = Ray::new(POINT.into(), self.frame.to_world(w));
        self.scene.nearest(&ray).map(|hit| hit.prim)
    }

    /// A visible border between primitives on the way from `a` to `b`, if they see different ones:
    /// a direction on either side, within `distance`.
    fn border(&self, [mut a, mut b]: [Vec3<f64>; 2], distance: f64) -> Option<[Vec3<f64>; 2]> {
        let seen = self.primitive(a);
        if seen == self.primitive(b) {
            return None;
        }
        let way = (b - a).normalize();
        while (a - b).length() > 1e-4 {
            let middle = (a + b).normalize();
            if self.primitive(middle) == seen {
                a = middle;
            } else {
                b = middle;
            }
        }
        let rest = way * (distance - 1e-4);
        Some([a - rest, b + rest].map(Vec3::normalize))
    }

    /// Whether all directions within so many widths of `w` hit the primitive that `w` hits, and are above the horizon.
    fn is_interior(&self, w: Vec3<f64>, widths: u32) -> bool {
        let seen = self.primitive(w);
        let around = Frame::from_normal(w);
        (1..=widths).all(|ring| {
            let (sin, cos) = (0.02 * f64::from(ring)).sin_cos();
            (0..48).all(|k| {
                let (y, x) = (TAU * f64::from(k) / 48.0).sin_cos();
                let v = around.to_world(Vec3::new(sin * x, sin * y, cos));
                v.z > 0.0 && self.primitive(v) == seen
            })
        })
    }
}

fn uniform(stream: u64) -> Vec3<f64> {
    let mut sampler = Independent::new(SEED + 1, stream, 0);
    let [u, v]: [f64; 2] = sampler.next_2d();
    let (y, x) = (TAU * v).sin_cos();
    let r = (1.0 - u * u).sqrt();
    Vec3::new(r * x, r * y, u)
}

/// `zeltner-4-17`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let n: u64 = fig.pick(500, 4000);
    fig.note("seed", SEED);
    fig.note("directions", n);
    fig.note("auxiliary rays", RAYS as u64);
    let place = Place {
        scene: cornell(16, Walls::Matt, 2)?,
        frame: Frame::from_normal(Vec3::new(0.0, 1.0, 0.0)),
    };

    let beside = |distance: f64| -> Vec<f64> {
        let ends = |i| [uniform(2 * i), uniform(2 * i + 1)];
        (0..n)
            .into_par_iter()
            .filter_map(|i| Some((i, place.border(ends(i), distance)?)))
            .map(|(i, sides)| {
                let [a, b] = sides.map(|w| place.b(w, RAYS, i));
                a.min(b)
            })
            .collect()
    };
    let (borders, near) = (beside(1e-4), beside(1e-3));
    let least = |b: &[f64]| b.iter().copied().fold(f64::INFINITY, f64::min);
    fig.check(
        "B above 0.99 within 1e-4 of every visible outline, on both sides",
        borders.len() > 100 && least(&borders) > 0.99,
        format!("least of {}: {:.4}", borders.len(), least(&borders)),
    );
    let still = near.iter().filter(|b| **b > 0.99).count();
    fig.check(
        "and within 1e-3 where auxiliary rays meet what is behind it: at 80 % of them at least",
        10 * still > 8 * near.len(),
        format!("{still} of {}, least {:.4}", near.len(), least(&near)),
    );
    let horizon: Vec<f64> = (0..n)
        .into_par_iter()
        .map(|i| {
            let (y, x) = (TAU * i as f64 / n as f64).sin_cos();
            place.b(Vec3::new(x, y, 1e-3).normalize(), RAYS, i)
        })
        .collect();
    fig.check(
        "B above 0.99 within 1e-3 of the horizon",
        least(&horizon) > 0.99,
        format!("least of {}: {:.4}", horizon.len(), least(&horizon)),
    );
    let inside = |widths: u32| -> Vec<f64> {
        (0..n)
            .into_par_iter()
            .map(|i| (i, uniform(2 * i)))
            .filter(|(_, w)| place.is_interior(*w, widths))
            .map(|(i, w)| place.b(w, RAYS, i))
            .collect()
    };
    // Auxiliary rays reach ten widths. Between five and ten one of them may meet a surface of which the rest, with the
    // outline, is hidden behind what the direction sees: that outline counts, since whether it is hidden is not asked.
    let (interior, deep) = (inside(5), inside(10));
    let frozen = interior.iter().filter(|b| **b >= 0.1).count();
    fig.check(
        "B below 0.1 in interiors, but for one direction in 500 where rays come past what hides an outline",
        interior.len() > 100 && 500 * frozen <= interior.len(),
        format!("{frozen} of {} directions are not", interior.len()),
    );
    let moved = deep.iter().filter(|b| **b > 0.0).count();
    fig.check(
        "B is zero where all that rays can meet is one surface",
        deep.len() > 50 && moved == 0,
        format!("{moved} of {} directions are not", deep.len()),
    );
    // B falls at 77 per radian at most near one outline; a step is 1e-5.
    let jumps: Vec<f64> = (0..n)
        .into_par_iter()
        .map(|i| {
            let w = uniform(2 * i);
            let moved = (w + Frame::from_normal(w).s * 1e-5).normalize();
            (place.b(moved, RAYS, i) - place.b(w, RAYS, i)).abs()
        })
        .collect();
    let largest = jumps.iter().copied().fold(0.0, f64::max);
    fig.check(
        "B is continuous: over 1e-5 radian it changes by less than 0.01",
        largest < 0.01,
        format!("at most {largest:.5}, {n} places"),
    );

    let size: usize = fig.pick(96, 320);
    let image = |rays: usize| -> Vec<f64> {
        (0..size * size)
            .into_par_iter()
            .map(|p| {
                let centred = |i: usize| 2.0 * (i as f64 + 0.5) / size as f64 - 1.0;
                let (x, y) = (centred(p % size), -centred(p / size));
                let z = 1.0 - x * x - y * y;
                if z <= 0.0 {
                    return 0.0;
                }
                place.b(Vec3::new(x, y, z.sqrt()), rays, p as u64)
            })
            .collect()
    };
    let panels = [16, RAYS].map(|rays| {
        let label = format!("B, {rays} rays");
        Panel::false_colour(&label, size, &image(rays), 0.0, 1.0)
    });
    fig.images("freezing", 2, &panels);
    let rows = [&borders, &horizon, &interior].into_iter().enumerate();
    let rows = rows.flat_map(|(kind, b)| b.iter().map(move |b| [kind as f64, *b]));
    fig.csv("b", &["border 0, horizon 1, interior 2", "B"], rows);
    Ok(())
}
