//! Where light comes from: densities of directions, learned in the scene.
//!
//! A path that leaves a diffuse surface knows nothing of where the light is. Emitters can be sampled, but not what
//! reaches the surface by mirrors and water. A [`Guide`] holds, for each part of space, a density of directions made
//! of light that paths before have met there; half of the directions that leave diffuse surfaces are then drawn from
//! it. No expectation changes, whatever it has learned.
//!
//! ```
//! use render::instances::{Estimator, render_f32};
//! use render::params::Theta;
//! use render::{Job, Settings, auto};
//!
//! let mut room = render::scene::room(8, 8)?;
//! let settings = Settings { max_depth: 3, ..room.settings };
//! let mean = |room: &render::Scene| {
//!     let theta = Theta::constant(room.params().values());
//!     let job = Job::new(room, &settings, 1, 0..64, &());
//!     let image = render_f32(&job, &theta, Estimator::Mis).image(0);
//!     image.data.iter().sum::<f32>() / image.data.len() as f32
//! };
//! let before = mean(&room);
//! assert!(auto::guide(&mut room, &settings, 0, &())); // learned and set
//! assert!((mean(&room) / before - 1.0).abs() < 0.1); // within noise
//! room.set_guide(None); // the room as it was
//! assert_eq!(mean(&room), before);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Reference
//! [Müller et al. 2017], with a target of least variance like that of [Rath et al. 2020]: the density of a cell goes by
//! the root of the second moment of its light, not by the mean. Unlike there, space is cut at the mean of what
//! arrived, not at midpoints, and cosines belong to the light.

use std::f64::consts::{FRAC_PI_4, TAU};
use std::num::NonZeroU32;

use ad_core::{Float, Vec3};

/// A part of space with twice as many arrivals is cut in two,
const LEAST_PART: usize = 256;
/// unless there would be more than about so many parts: they would not stay in the cache.
const MOST_PARTS: usize = 512;
/// Part of the energy from which a cell of directions is cut,
const ENERGY: f64 = 0.05;
/// and arrivals: fewer may be odd samples.
const ARRIVALS: usize = 16;
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
    parts: Vec<Node>,
}

#[derive(Clone, Debug)]
enum Node {
    /// Cut across an axis at a coordinate: the parts below and above.
    Cut(usize, f32, [u32; 2]),
    Directions(Directions),
}

impl Guide {
    /// A guide to these arrivals. Their order is lost.
    pub(crate) fn new(arrivals: &mut [Arrival]) -> Self {
        let mut guide = Self { parts: Vec::new() };
        let part = LEAST_PART.max(arrivals.len() / MOST_PARTS);
        guide.grow(arrivals, part);
        guide
    }

    /// Adds the part of space of these arrivals; returns its index.
    fn grow(&mut self, arrivals: &mut [Arrival], part: usize) -> u32 {
        let index = self.parts.len();
        self.parts.push(Node::Directions(Directions::default()));
        self.parts[index] = match cut(arrivals) {
            Some((axis, at)) if arrivals.len() >= 2 * part => {
                arrivals.sort_by_key(|a| a.p[axis] >= at);
                let below = arrivals.partition_point(|a| a.p[axis] < at);
                let (below, above) = arrivals.split_at_mut(below);
                Node::Cut(axis, at, [self.grow(below, part), self.grow(above, part)])
            }
            _ => Node::Directions(Directions::new(arrivals)),
        };
        index as u32
    }

    /// The index of the densities at a point.
    #[inline(never)]
    pub(crate) fn part_at<P: Float>(&self, p: Vec3<P>) -> u32 {
        let p = [p.x.to_f32(), p.y.to_f32(), p.z.to_f32()];
        let mut index = 0;
        while let Node::Cut(axis, at, sides) = &self.parts[index as usize] {
            index = sides[usize::from(p[*axis] >= *at)];
        }
        index
    }

    /// These densities; none where space is cut once more.
    #[inline(always)]
    pub(crate) fn directions(&self, part: u32) -> Option<&Directions> {
        match &self.parts[part as usize] {
            Node::Cut(..) => None,
            Node::Directions(directions) => Some(directions),
        }
    }

    /// The densities at a point.
    #[inline(always)]
    pub(crate) fn at<P: Float>(&self, p: Vec3<P>) -> Option<&Directions> {
        self.directions(self.part_at(p))
    }
}

/// Across which axis to cut what lies at these places, and where, so that there is something on both sides.
fn cut(arrivals: &[Arrival]) -> Option<(usize, f32)> {
    let n = arrivals.len() as f64;
    let along = |k: usize| arrivals.iter().map(move |a| f64::from(a.p[k]));
    let spread = |k: usize| {
        let mean = along(k).sum::<f64>() / n;
        (along(k).map(|x| (x - mean).powi(2)).sum::<f64>(), mean)
    };
    let widest = (0..3).map(|k| (k, spread(k)));
    let (axis, (_, mean)) = widest.max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
    // Rounding may leave the mean beyond all of them.
    let at = mean as f32;
    let below = arrivals.iter().filter(|a| a.p[axis] < at).count();
    (below > 0 && below < arrivals.len()).then_some((axis, at))
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
    /// Index of each one's cell, if it is cut; never that of the whole square.
    quarters: [Option<NonZeroU32>; 4],
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
                quarters[k] = NonZeroU32::new(cell);
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
        per_solid_angle(density)
    }

    /// A direction with that density, and the density.
    #[inline(never)]
    pub fn sample<P: Float>(&self, [mut u, mut v]: [P; 2]) -> (Vec3<P>, P) {
        let (mut corner, mut size) = ([P::zero(); 2], P::one());
        let mut density = 1.0;
        // The half that `x` lies in, if the first has this probability, and where in it.
        let half = |x: P, first: P| {
            if x < first {
                (0, x / first)
            } else {
                (1, (x - first) / (P::one() - first))
            }
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
            density *= 4.0 * c.share[k];
            cell = c.quarters[k].map(|i| &self.cells[i.get() as usize]);
        }
        let place = [corner[0] + size * u, corner[1] + size * v];
        (direction(place), per_solid_angle(density))
    }
}

/// A density over the unit square as one over directions.
#[inline(always)]
fn per_solid_angle<P: Float>(density: f32) -> P {
    P::from_f32(density) * P::of(0.5 / TAU)
}

/// Directions as points of the unit square, areas in proportion [Clarberg 2008]: the upper half is the square on its
/// corner in the middle, the lower half its corners folded back.
#[inline]
pub(crate) fn square<P: Float>(d: Vec3<P>) -> [f32; 2] {
    let (x, y, z) = (d.x.to_f32(), d.y.to_f32(), d.z.to_f32());
    let r = (1.0 - z.abs()).max(0.0).sqrt();
    let v = r * y.abs().atan2(x.abs()) * std::f32::consts::FRAC_2_PI;
    let u = r - v;
    let (u, v) = if z < 0.0 { (1.0 - v, 1.0 - u) } else { (u, v) };
    let place =
        |a: f32, sign: f32| (0.5 * (1.0 + a.copysign(sign))).clamp(0.0, 1.0 - f32::EPSILON / 2.0);
    [place(u, x), place(v, y)]
}

/// The direction of a point of the square.
#[inline]
fn direction<P: Float>(at: [P; 2]) -> Vec3<P> {
    let (zero, one, two) = (P::zero(), P::one(), P::of(2.0));
    let (u, v) = (two * at[0] - one, two * at[1] - one);
    // Positive above.
    let up = one - (u.abs() + v.abs());
    let r = one - up.abs();
    let octant = P::select(r > zero, (v.abs() - u.abs()) / r, zero);
    let (sin, cos) = ((octant + one) * P::of(FRAC_PI_4)).sin_cos();
    let along = r * (two - r * r).max(zero).sqrt();
    let flip = |x: P, sign: P| P::select(sign < zero, -x, x);
    Vec3::new(
        flip(along * cos, u),
        flip(along * sin, v),
        flip(one - r * r, up),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Independent, Sampler};
    use crate::statistics::p_value;

    /// Light from around `d`, in a sphere of this radius before it is normalised.
    fn lamp(at: [f32; 3], d: [f64; 3], radius: f64, n: u64, seed: u64) -> Vec<Arrival> {
        let arrival = |i: u64| {
            let mut s = Independent::new(seed, i, 0);
            let mut near = |x: f64| x + radius * (2.0 * s.next_1d::<f64>() - 1.0);
            let d = Vec3::new(near(d[0]), near(d[1]), near(d[2])).normalize();
            Arrival {
                p: at,
                from: square(d),
                energy: 0.5 + s.next_1d::<f64>(),
            }
        };
        (0..n).map(arrival).collect()
    }

    fn learned() -> Directions {
        let mut arrivals = lamp([0.0; 3], [0.3, 0.8, 0.2], 0.05, 2000, 1);
        arrivals.extend(lamp([0.0; 3], [0.0, 0.0, 1.0], 0.05, 2000, 2));
        arrivals.extend(lamp([0.0; 3], [-1.0, 0.0, 0.0], 0.1, 500, 3));
        Directions::new(&mut arrivals)
    }

    /// 4e5 samples in 32 x 32 cells against the integral of the density, which is constant in finer ones;
    /// significance 1e-3.
    #[test]
    fn samples_have_their_density() {
        let (directions, n, cells) = (learned(), 400_000u64, 32);
        assert!(directions.cells.len() > 10);
        let mut counts = vec![0.0; cells * cells];
        for i in 0..n {
            let (d, pdf): (Vec3<f64>, f64) = directions.sample(Independent::new(9, i, 0).next_2d());
            assert!((d.length() - 1.0).abs() < 1e-12);
            let again = directions.pdf(d);
            // Single precision may have moved it to the next cell.
            assert!(
                i % 100 != 0 || (pdf / again - 1.0).abs() < 1e-6,
                "{pdf} {again}"
            );
            let [u, v] = square(d).map(|x| (x * cells as f32) as usize);
            counts[v * cells + u] += 1.0;
        }
        let fine = 1 << CUTS;
        let mut expected = vec![0.0; cells * cells];
        for i in 0..fine * fine {
            let place = [i % fine, i / fine].map(|k| (k as f64 + 0.5) / fine as f64);
            let pdf = directions.pdf(direction(place));
            let cell = place.map(|x| (x * cells as f64) as usize);
            expected[cell[1] * cells + cell[0]] += pdf * 2.0 * TAU / (fine * fine) as f64;
        }
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 1e-5, "{total}");
        let expected = expected.into_iter().map(|e| e * n as f64);
        let p = p_value(counts.into_iter().zip(expected));
        assert!(p > 1e-3, "p = {p}");
    }

    /// There and back, in every octant and on its edges; areas in proportion, by the mean of the solid angle's moments:
    /// over the square that of `d` is 0, and of `d_i d_k` a third of unity.
    #[test]
    fn directions_are_points_of_the_square() {
        let n = 512;
        let mut moments = [0.0; 9];
        for i in 0..n * n {
            let at = [i % n, i / n].map(|k| (k as f64 + 0.5) / n as f64);
            let d = direction(at);
            assert!((d.length() - 1.0).abs() < 1e-12);
            let back = square(d);
            for k in 0..2 {
                assert!((f64::from(back[k]) - at[k]).abs() < 1e-6, "{at:?} {back:?}");
            }
            let sums = [d.x, d.y, d.z, d.x * d.y, d.y * d.z, d.z * d.x];
            let squares = [d.x * d.x, d.y * d.y, d.z * d.z].map(|x| x - 1.0 / 3.0);
            for (m, x) in moments.iter_mut().zip(sums.iter().chain(&squares)) {
                *m += x / (n * n) as f64;
            }
        }
        assert!(moments.iter().all(|m| m.abs() < 1e-5), "{moments:?}");
        for d in [-1.0, -0.0, 0.0, 1.0f32] {
            for axis in 0..3 {
                let mut v = [0.0, -0.0, 0.0];
                v[axis] = d;
                let [u, v] = square(Vec3::from(v));
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
            }
        }
        for at in [[0.0, 0.0], [0.5, 0.5], [1.0, 1.0], [0.0, 0.5], [0.25, 0.75]] {
            assert!((direction::<f32>(at).length() - 1.0).abs() < 1e-6);
        }
    }

    /// Where light comes from is where samples go: each lamp has the root of its energy times its size.
    #[test]
    fn densities_go_where_the_light_is() {
        let directions = learned();
        let pdf = |d: [f64; 3]| directions.pdf(Vec3::from(d).normalize());
        println!(
            "{} {} {} cells {}",
            pdf([0.3, 0.8, 0.2]),
            pdf([0.01, 0.01, 1.0]),
            pdf([0.0, -1.0, -0.5]),
            directions.cells.len()
        );
        assert!(pdf([0.3, 0.8, 0.2]) > 1.0);
        assert!(pdf([0.01, 0.01, 1.0]) > 1.0);
        assert!(pdf([0.0, -1.0, -0.5]) < 0.1);
    }

    /// Two halves of space with light from two sides.
    #[test]
    fn parts_of_space_have_their_own_light() {
        let mut arrivals = Vec::new();
        for i in 0..1000u64 {
            let x = i as f32 / 1000.0;
            arrivals.extend(lamp([x, 5.0, 0.0], [1.0, 0.1, 0.1], 0.05, 1, i));
            arrivals.extend(lamp([x + 3.0, 5.0, 0.0], [-1.0, 0.1, 0.1], 0.05, 1, i));
        }
        let guide = Guide::new(&mut arrivals);
        let pdf = |x: f64, d: [f64; 3]| {
            let directions = guide.at(Vec3::new(x, 5.0, 0.0)).expect("densities");
            directions.pdf(Vec3::from(d).normalize())
        };
        for (x, d) in [(0.5, 1.0), (3.5, -1.0), (-1e30, 1.0), (1e30, -1.0)] {
            assert!(pdf(x, [d, 0.1, 0.1]) > 1.0);
            assert!(pdf(x, [-d, 0.1, 0.1]) < 0.01);
        }
    }

    /// All at one place and from one direction, energies of any size, coordinates that rounding cannot tell apart,
    /// directions at the ends of the square, nothing at all.
    #[test]
    fn odd_light_gives_finite_densities() {
        let one = |p: [f32; 3], d: [f32; 3], energy: f64| Arrival {
            p,
            from: square(Vec3::from(d)),
            energy,
        };
        let poles = [
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [-1.0, -0.0, 0.0],
            [-1.0, 0.0, 0.0],
        ];
        let same = vec![one([1.0, 2.0, 3.0], poles[0], 1.0); 3000];
        let wild = (0..3000).map(|i| {
            let energy = [f64::MIN_POSITIVE, 1e-30, 1.0, 1e300][i % 4];
            one([1e30, i as f32 * 1e-30, -1e30], poles[i / 4 % 4], energy)
        });
        let near = (0..3000).map(|i| one([f32::from_bits(0x3f80_0000 + i % 2); 3], poles[1], 1.0));
        for mut arrivals in [same, wild.collect(), near.collect(), Vec::new()] {
            let guide = Guide::new(&mut arrivals);
            for i in 0..1000 {
                let mut s = Independent::new(4, i, 0);
                let p = Vec3::from(s.next_3d::<f32>());
                let directions = guide.at(p).expect("densities");
                let u = match i {
                    0 => [0.0, 0.0],
                    1 => [1.0 - f32::EPSILON / 2.0; 2],
                    _ => s.next_2d::<f32>(),
                };
                let (d, pdf) = directions.sample(u);
                assert!((d.length() - 1.0).abs() < 1e-5, "{d:?}");
                assert!(pdf > 0.0 && pdf.is_finite(), "{pdf}");
                let [u, v] = square(d);
                assert!((0.0..1.0).contains(&u) && (0.0..1.0).contains(&v));
                assert!(directions.pdf(d).is_finite());
            }
        }
    }
}
