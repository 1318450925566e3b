//! Monte Carlo integration in one dimension: densities, histograms of their samples, and the integrals
//! that estimates are held against.
//!
//! Densities are written over a scalar: with duals, [`Density::sample`] moves with the parameters of
//! the density at a fixed random number.

use std::f64::consts::PI;

use ad_core::{Const, Float, Real};

use crate::statistics::ChiSquare;

/// A density over an interval.
pub trait Density<R: Real> {
    /// The interval.
    fn range(&self) -> [R::Primal; 2];

    /// The density at `x`; integrates to one over the interval.
    fn pdf(&self, x: R) -> R;

    /// The integral of the density up to `x`.
    fn cdf(&self, x: R) -> R;

    /// Inverse of [`cdf`](Self::cdf): the `x` below which the fraction `u` of the mass lies. Moves with
    /// the parameters where the density is not zero.
    fn sample(&self, u: R::Primal) -> R {
        let [mut low, mut high] = self.range();
        let half = R::Primal::of(0.5);
        let mut x = (low + high) * half;
        let mut last = R::Primal::MAX;
        // Newton's method inside a bracket, which is halved whenever a step leaves it or the error
        // does not fall fast enough: between two bumps, steps may go to and fro for long.
        for _ in 0..200 {
            let excess = self.cdf(R::lift(x)).primal() - u;
            if excess > R::Primal::zero() {
                high = x;
            } else {
                low = x;
            }
            let slope = self.pdf(R::lift(x)).primal();
            let newton = x - excess / slope;
            let fast = slope > R::Primal::zero() && excess.abs() < last.abs() * half;
            let next = if fast && newton >= low && newton <= high {
                newton
            } else {
                (low + high) * half
            };
            last = excess;
            let done = (next - x).abs() <= R::Primal::EPSILON * (low.abs() + high.abs());
            x = next;
            if done {
                break;
            }
        }
        let x = R::lift(x);
        let slope = self.pdf(x);
        if R::IS_PRIMAL || slope.primal() <= R::Primal::zero() {
            return x;
        }
        // The implicit function theorem: a Newton step that moves tangents only.
        let residual = self.cdf(x);
        x - (residual - Const(residual.primal())) / slope
    }
}

/// The same density everywhere in an interval.
#[derive(Clone, Copy, Debug)]
pub struct Uniform {
    /// The interval.
    pub range: [f64; 2],
}

impl<R: Real> Density<R> for Uniform {
    fn range(&self) -> [R::Primal; 2] {
        self.range.map(R::Primal::of)
    }

    fn pdf(&self, _: R) -> R {
        R::of(1.0 / (self.range[1] - self.range[0]))
    }

    fn cdf(&self, x: R) -> R {
        (x - R::c(self.range[0])) * R::c(1.0 / (self.range[1] - self.range[0]))
    }
}

/// A normal distribution cut to an interval.
#[derive(Clone, Copy, Debug)]
pub struct Normal<R> {
    /// Position of the maximum.
    pub mean: R,
    /// Standard deviation before the cut, positive.
    pub sd: R,
    /// The interval.
    pub range: [f64; 2],
}

impl<R: Real> Normal<R> {
    /// Mass below `x` before the cut.
    fn mass(&self, x: R) -> R {
        (((x - self.mean) / (self.sd * R::c(2.0f64.sqrt()))).erf() + R::c(1.0)) * R::c(0.5)
    }

    fn ends(&self) -> [R; 2] {
        self.range.map(|x| self.mass(R::of(x)))
    }
}

impl<R: Real> Density<R> for Normal<R> {
    fn range(&self) -> [R::Primal; 2] {
        self.range.map(R::Primal::of)
    }

    fn pdf(&self, x: R) -> R {
        let [low, high] = self.ends();
        let bell = (((x - self.mean) / self.sd).square() * R::c(-0.5)).exp();
        bell * R::c(1.0 / (2.0 * PI).sqrt()) / (self.sd * (high - low))
    }

    fn cdf(&self, x: R) -> R {
        let [low, high] = self.ends();
        (self.mass(x) - low) / (high - low)
    }
}

/// A density that is linear between nodes.
#[derive(Clone, Debug)]
pub struct Piecewise {
    /// Positions in increasing order, density there, and mass below.
    nodes: Vec<[f64; 3]>,
}

impl Piecewise {
    /// Proportional to the interpolation of `f` (positive somewhere, nowhere negative) between
    /// `n + 1` equidistant nodes.
    pub fn interpolating(range: [f64; 2], n: usize, f: impl Fn(f64) -> f64) -> Self {
        let n = n.max(1);
        let at = |i: usize| range[0] + (range[1] - range[0]) * i as f64 / n as f64;
        let mut nodes: Vec<[f64; 3]> = (0..=n).map(|i| [at(i), f(at(i)), 0.0]).collect();
        for i in 1..=n {
            let width = nodes[i][0] - nodes[i - 1][0];
            nodes[i][2] = nodes[i - 1][2] + 0.5 * width * (nodes[i][1] + nodes[i - 1][1]);
        }
        let total = nodes[n][2];
        for node in &mut nodes {
            node[1] /= total;
            node[2] /= total;
        }
        Self { nodes }
    }

    /// The segment with `x`: its left node, its width, and the slope of the density.
    fn segment(&self, x: f64) -> ([f64; 3], f64) {
        let right = self.nodes.partition_point(|n| n[0] <= x);
        let i = right.clamp(1, self.nodes.len() - 1);
        let (a, b) = (self.nodes[i - 1], self.nodes[i]);
        (a, (b[1] - a[1]) / (b[0] - a[0]))
    }
}

impl<R: Real> Density<R> for Piecewise {
    fn range(&self) -> [R::Primal; 2] {
        [self.nodes[0][0], self.nodes[self.nodes.len() - 1][0]].map(R::Primal::of)
    }

    fn pdf(&self, x: R) -> R {
        let ([x0, p0, _], slope) = self.segment(x.primal().to_f64());
        (x - R::c(x0)) * R::c(slope) + R::c(p0)
    }

    fn cdf(&self, x: R) -> R {
        let ([x0, p0, c0], slope) = self.segment(x.primal().to_f64());
        let t = x - R::c(x0);
        t * (t * R::c(0.5 * slope) + R::c(p0)) + R::c(c0)
    }
}

/// Integral by Simpson's rule on `2 n` equal steps.
pub fn integrate([a, b]: [f64; 2], n: usize, f: impl Fn(f64) -> f64) -> f64 {
    let h = (b - a) / (2 * n) as f64;
    let inner: f64 = (1..2 * n)
        .map(|i| f(a + h * i as f64) * if i % 2 == 1 { 4.0 } else { 2.0 })
        .sum();
    (f(a) + f(b) + inner) * h / 3.0
}

/// `n + 1` equidistant positions.
pub fn positions([a, b]: [f64; 2], n: usize) -> impl Iterator<Item = f64> {
    (0..=n).map(move |i| a + (b - a) * i as f64 / n as f64)
}

/// How samples are spread over equal cells of the interval, against their density.
#[derive(Clone, Debug)]
pub struct Histogram {
    /// Centre of a cell, and measured density there.
    pub bars: Vec<(f64, f64)>,
    /// Whether they have the density.
    pub test: ChiSquare,
}

impl Histogram {
    /// Number of cells.
    pub const CELLS: usize = 50;

    /// The histogram of samples that should have the density `p`.
    pub fn of(samples: &[f64], p: &impl Density<f64>) -> Self {
        let [a, b] = p.range();
        let width = (b - a) / Self::CELLS as f64;
        let mut counts = vec![0.0; Self::CELLS];
        for x in samples {
            counts[(((x - a) / width) as usize).min(Self::CELLS - 1)] += 1.0;
        }
        let n = samples.len() as f64;
        let left = |i: usize| a + width * i as f64;
        let bins = counts.iter().enumerate();
        let bins = bins.map(|(i, count)| (*count, n * (p.cdf(left(i + 1)) - p.cdf(left(i)))));
        let test = ChiSquare::of(&bins.collect::<Vec<_>>());
        let bar = |(i, count): (usize, &f64)| (left(i) + 0.5 * width, count / (n * width));
        let bars = counts.iter().enumerate().map(bar).collect();
        Self { bars, test }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;

    fn consistent(p: &impl Density<f64>) {
        let range = p.range();
        assert!((integrate(range, 3000, |x| p.pdf(x)) - 1.0).abs() < 1e-9);
        assert!(p.cdf(range[0]).abs() < 1e-12 && (p.cdf(range[1]) - 1.0).abs() < 1e-12);
        for u in positions([0.0, 1.0], 10_000) {
            assert!((p.cdf(p.sample(u)) - u).abs() < 1e-12, "{u}");
        }
    }

    #[test]
    fn densities_integrate_to_one_and_samples_invert_their_cdf() {
        consistent(&Uniform { range: [-1.0, 3.0] });
        let range = [-0.5, 2.0];
        consistent(&Normal {
            mean: 0.2,
            sd: 0.3,
            range,
        });
        // Two bumps apart, where Newton's method alone goes to and fro.
        consistent(&super::super::two_bumps::target());
        consistent(&Piecewise::interpolating(range, 10, |x| {
            (5.0 * x).sin() + 1.2
        }));
    }

    #[test]
    fn samples_move_with_the_parameters() {
        let (mean, sd, h) = (0.3, 0.2, 1e-5);
        let range = [0.0, 1.0];
        let dual = Normal {
            mean: Dual::<f64, 2>::var(mean, 0),
            sd: Dual::var(sd, 1),
            range,
        };
        for u in [0.1, 0.5, 0.9] {
            let x = |mean, sd| Normal { mean, sd, range }.sample(u);
            let moved = dual.sample(u);
            let expected = [
                (x(mean + h, sd) - x(mean - h, sd)) / (2.0 * h),
                (x(mean, sd + h) - x(mean, sd - h)) / (2.0 * h),
            ];
            for (a, b) in moved.eps.iter().zip(expected) {
                assert!((a - b).abs() < 1e-8, "{a} {b}");
            }
        }
    }
}
