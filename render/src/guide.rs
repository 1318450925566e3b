//! Where light comes from: densities of directions, learned in the scene.
//!
//! A path that leaves a diffuse surface knows nothing of where the light is. Emitters can be sampled, but not what
//! reaches the surface by mirrors and water. A [`Guide`] holds, for each part of space, a density of directions made
//! of light that paths before have met there; half of the directions that leave diffuse surfaces are then drawn from
//! it. No expectation changes, whatever it has learned.
//!
//! # Reference
//! [Müller et al. 2017], with a target of least variance like that of [Rath et al. 2020]: the density of a cell goes by
//! the root of the second moment of its light, not by the mean. Unlike there, space is cut at medians of what arrived,
//! not at midpoints, and cosines belong to the light.

use std::f64::consts::{PI, TAU};

use ad_core::{Float, Vec3};

/// Arrivals from which a part of space has directions of its own.
const PART: usize = 2048;
/// Part of the energy from which a cell of directions is cut,
const ENERGY: f64 = 0.01;
/// and arrivals: fewer may be one odd sample.
const ARRIVALS: usize = 8;
/// How often at most. Cells are then less than a degree wide.
const CUTS: u32 = 8;
/// Probability of drawing a direction from the guide, not from the material.
pub(crate) const PART_GUIDED: f64 = 0.5;

/// Light that met a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    /// Where.
    pub p: [f32; 3],
    /// Where from, see [`square`].
    pub from: [f32; 2],
    /// Its squared radiance times cosine, over the density of its direction.
    pub energy: f64,
}

/// Densities of directions, for every point of a scene.
#[derive(Clone, Debug)]
pub struct Guide {
    /// The first one is the whole of space.
    parts: Vec<Part>,
}

#[derive(Clone, Debug)]
enum Part {
    /// Cut across an axis at a coordinate: the parts below and above.
    Cut(usize, f32, [u32; 2]),
    Directions(Directions),
}

impl Guide {
    /// A guide to these arrivals, at least one of which has energy; all numbers are finite. Their order is lost.
    pub(crate) fn new(arrivals: &mut [Arrival]) -> Self {
        let mut guide = Self { parts: Vec::new() };
        guide.grow(arrivals);
        guide
    }

    fn grow(&mut self, arrivals: &mut [Arrival]) -> u32 {
        let index = self.parts.len();
        self.parts.push(Part::Directions(Directions::default()));
        let bounds = |k: usize| {
            let along = arrivals.iter().map(|a| a.p[k]);
            along.fold((f32::INFINITY, f32::NEG_INFINITY), |(lo, hi), x| {
                (lo.min(x), hi.max(x))
            })
        };
        let extent = |&k: &usize| {
            let (lo, hi) = bounds(k);
            hi - lo
        };
        let widest = (0..3).max_by(|a, b| extent(a).total_cmp(&extent(b)));
        self.parts[index] = match widest {
            Some(k) if arrivals.len() >= 2 * PART && extent(&k) > 0.0 => {
                let half = arrivals.len() / 2;
                let (_, median, _) =
                    arrivals.select_nth_unstable_by(half, |a, b| a.p[k].total_cmp(&b.p[k]));
                let at = median.p[k];
                let (below, above) = arrivals.split_at_mut(half);
                Part::Cut(k, at, [self.grow(below), self.grow(above)])
            }
            _ => Part::Directions(Directions::new(arrivals)),
        };
        index as u32
    }

    /// The densities at a point.
    #[inline(never)]
    pub(crate) fn at<P: Float>(&self, p: Vec3<P>) -> &Directions {
        let p = p.to_array().map(|x| x.to_f32());
        let mut index = 0;
        loop {
            match &self.parts[index] {
                Part::Cut(axis, at, sides) => {
                    index = sides[usize::from(p[*axis] >= *at)] as usize;
                }
                Part::Directions(directions) => return directions,
            }
        }
    }
}

/// A density over the sphere: constant in each cell of a tree that cuts the square of [`square`] in four.
#[derive(Clone, Debug, Default)]
pub(crate) struct Directions {
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Probability of each quarter, given the cell.
    share: [f32; 4],
    /// Each one's cells, if it is cut.
    quarters: [Option<std::num::NonZeroU32>; 4],
}

/// Quarter of the unit square: lower bit across, upper bit along the second axis.
#[inline(always)]
fn quarter(u: [f32; 2]) -> usize {
    usize::from(u[0] >= 0.5) | usize::from(u[1] >= 0.5) << 1
}

/// The place in a quarter as one in the unit square.
#[inline(always)]
fn zoom(u: [f32; 2]) -> [f32; 2] {
    let half = |x: f32| 2.0 * x - if x >= 0.5 { 1.0 } else { 0.0 };
    [half(u[0]), half(u[1])]
}

impl Directions {
    fn new(arrivals: &mut [Arrival]) -> Self {
        let mut out = Self::default();
        let total: f64 = arrivals.iter().map(|a| a.energy).sum();
        if total > 0.0 {
            out.grow(arrivals, total, 0);
        }
        out
    }

    /// Adds the cell of these arrivals; returns its index, and its share of the density but for a factor.
    fn grow(&mut self, arrivals: &mut [Arrival], total: f64, cuts: u32) -> (u32, f64) {
        let index = self.cells.len();
        self.cells.push(Cell {
            share: [0.25; 4],
            quarters: [None; 4],
        });
        arrivals.sort_by_key(|a| quarter(a.from));
        let mut rest = arrivals;
        let (mut masses, mut quarters) = ([0.0; 4], [None; 4]);
        for k in 0..4 {
            let n = rest.partition_point(|a| quarter(a.from) <= k);
            let (here, after) = std::mem::take(&mut rest).split_at_mut(n);
            rest = after;
            let energy: f64 = here.iter().map(|a| a.energy).sum();
            if cuts + 1 < CUTS && here.len() >= ARRIVALS && energy > ENERGY * total {
                for a in here.iter_mut() {
                    a.from = zoom(a.from);
                }
                let (cell, mass) = self.grow(here, total, cuts + 1);
                quarters[k] = std::num::NonZeroU32::new(cell);
                masses[k] = mass;
            } else {
                // The best density of a cell is the root of its mean energy.
                let area = 0.25f64.powi(cuts as i32 + 1);
                masses[k] = (area * energy).sqrt();
            }
        }
        let mass: f64 = masses.iter().sum();
        if mass > 0.0 {
            self.cells[index].share = masses.map(|m| (m / mass) as f32);
        }
        self.cells[index].quarters = quarters;
        (index as u32, mass)
    }

    /// Density of a direction, per solid angle.
    #[inline(never)]
    pub fn pdf<P: Float>(&self, d: Vec3<P>) -> P {
        let mut u = square(d);
        let mut density = 1.0;
        let mut cell = self.cells.first();
        while let Some(c) = cell {
            let k = quarter(u);
            density *= 4.0 * c.share[k];
            u = zoom(u);
            cell = c.quarters[k].map(|i| &self.cells[i.get() as usize]);
        }
        P::from_f32(density) * P::of(0.5 / TAU)
    }

    /// A direction with that density.
    #[inline(never)]
    pub fn sample<P: Float>(&self, [mut u, mut v]: [P; 2]) -> Vec3<P> {
        let (mut corner, mut size) = ([P::zero(); 2], P::one());
        // The half that `x` lies in, if the first has this probability, and where in it.
        let half = |x: P, first: P| match x < first {
            true => (0, x / first),
            false => (1, (x - first) / (P::one() - first)),
        };
        let mut cell = self.cells.first();
        while let Some(c) = cell {
            let share = |k: usize| P::from_f32(c.share[k]);
            let (left, right) = (share(0) + share(2), share(1) + share(3));
            let (column, x) = half(u, left / (left + right));
            let (low, high) = (share(column), share(column + 2));
            let (row, y) = half(v, low / (low + high));
            let limit = P::one() - P::EPSILON;
            (u, v) = (x.min(limit), y.min(limit));
            size *= P::of(0.5);
            corner[0] += size * P::of(column as f64);
            corner[1] += size * P::of(row as f64);
            let k = column + 2 * row;
            cell = c.quarters[k].map(|i| &self.cells[i.get() as usize]);
        }
        let z = P::of(2.0) * (corner[1] + size * v) - P::one();
        let r = (P::one() - z * z).max(P::zero()).sqrt();
        let (sin, cos) = (P::of(TAU) * (corner[0] + size * u) - P::of(PI)).sin_cos();
        Vec3::new(r * cos, r * sin, z)
    }
}

/// Directions as points of the unit square, areas in proportion: longitude and height.
pub(crate) fn square<P: Float>(d: Vec3<P>) -> [f32; 2] {
    let longitude = d.y.to_f64().atan2(d.x.to_f64()) / TAU + 0.5;
    let height = 0.5 * (d.z.to_f64() + 1.0);
    let below_one = |x: f64| (x as f32).clamp(0.0, 1.0 - f32::EPSILON / 2.0);
    [below_one(longitude), below_one(height)]
}
