//! Slopes of Beckmann surfaces of roughness 1: what is seen of them, and how visible ones are drawn.
//!
//! `(s, c)` is the direction that sees them: `c` is its cosine, `s` its length along the surface, and `x` a slope along it.
//! Numbers are found without a call or a branch, for loops over many.

use std::f64::consts::PI;

use ad_core::{Const, Float, Real};

use crate::math::gauss::{
    BETWEEN, DOUBLE, Precision, SINGLE, exp_minus, is_single, rough_quantile,
};

/// Where cosine over sine is larger, masking is less than a rounding error.
const STEEPEST: f64 = 6.0;

/// Projected area of all facets that `(s, c)` sees, which needs not be of unit length.
#[inline]
pub(super) fn sigma<R: Real>(c: R, s: R) -> R {
    let (cos, sin) = (c.primal(), s.primal());
    let value = area(cos, sin);
    if R::IS_PRIMAL {
        return R::lift(value);
    }
    // Below that, s is not zero.
    if cos >= sin * R::Primal::of(STEEPEST) {
        return c;
    }
    let exact = area_below(c / s, c, s);
    exact - Const(exact.primal()) + Const(value)
}

/// [`sigma_in_line`], once for all who need no loop.
#[inline(never)]
fn area<P: Float>(c: P, s: P) -> P {
    sigma_in_line(c, s)
}

/// [`sigma`] where loops over many go through it.
#[inline(always)]
pub(super) fn sigma_in_line<P: Float>(c: P, s: P) -> P {
    if is_single::<P>() {
        VisibleSlopes::by(&SINGLE, c, s).area
    } else {
        VisibleSlopes::by(&DOUBLE, c, s).area
    }
}

/// The change of the logarithm of [`sigma_in_line`] with `s`.
#[inline(always)]
pub(super) fn log_slope_in_line<P: Float>(c: P, s: P) -> P {
    if is_single::<P>() {
        VisibleSlopes::by(&SINGLE, c, s).log_slope()
    } else {
        VisibleSlopes::by(&DOUBLE, c, s).log_slope()
    }
}

/// Projected area, seen from `(s, c)`, of the facets whose slope along it is below `x`:
/// `integral of (c - t s) exp(-t^2) / sqrt(pi) dt` up to `x`.
#[inline]
fn area_below<R: Real>(x: R, c: R, s: R) -> R {
    (c * (x.erf() + R::c(1.0)) + s * gauss(x)) * R::c(0.5)
}

/// Density of slopes.
#[inline]
fn gauss<R: Real>(x: R) -> R {
    exp_minus(x.square()) * R::c(1.0 / PI.sqrt())
}

/// What a direction sees.
#[derive(Clone, Copy)]
struct VisibleSlopes<P> {
    /// The largest slope that faces it, or what is as good.
    steepest: P,
    /// Projected area of all that does.
    area: P,
    /// Probability of a larger slope.
    beyond: P,
    /// The change of the area with `s`: slopes at the steepest one are seen edge-on.
    change: P,
}

impl<P: Float> VisibleSlopes<P> {
    #[inline(always)]
    fn by<const E: usize, const C: usize>(precision: &Precision<E, C>, c: P, s: P) -> Self {
        let half = P::of(0.5);
        let all = c >= s * P::of(STEEPEST);
        let steepest = P::select(all, P::of(STEEPEST), c / s);
        let [tail, erfcx] = precision.tail(steepest);
        let rest = (s * P::of(1.0 / PI.sqrt()) - c * erfcx) * (tail * half);
        Self {
            steepest,
            area: P::select(all, c, c + rest),
            beyond: tail * erfcx * half,
            change: P::select(all, P::zero(), tail * P::of(0.5 / PI.sqrt())),
        }
    }

    #[inline(always)]
    fn log_slope(&self) -> P {
        self.change / self.area
    }
}

/// A polynomial that vanishes at normal incidence.
#[inline(always)]
fn fitted([a, b, c, d]: [f32; 4], cos: f32) -> f32 {
    (1.0 - cos) * (((d * cos + c) * cos + b) * cos + a)
}

/// The part `below` of [`area_below`] all, and where it ends.
#[derive(Clone, Copy)]
struct Quantile {
    c: f64,
    s: f64,
    target: f64,
    /// A first guess.
    x: f64,
}

impl Quantile {
    /// What is below a slope is taken for `1 - (1 - below)^p` of what is below the steepest one. For a power `p` that falls
    /// from one at normal incidence to a half at grazing angles, a polynomial in the root of `1 - below` stands, which was
    /// fitted to the slopes themselves.
    #[inline(always)]
    fn of<const E: usize, const C: usize>(
        precision: &Precision<E, C>,
        [c, s]: [f64; 2],
        below: f64,
    ) -> Self {
        const FIRST: [f32; 4] = [-0.967_035_5, 3.187_807_6, -17.123_198, 14.951_41];
        const SECOND: [f32; 4] = [-0.451_821_64, -7.413_094_7, 31.319_506, -34.944_056];
        let seen = VisibleSlopes::by(precision, c, s);
        let cos = c as f32;
        let root = ((1.0 - below) as f32).sqrt();
        let bend = 1.0 + fitted(FIRST, cos) + fitted(SECOND, cos) * root;
        let beyond = seen.beyond as f32;
        let facing = 1.0 - beyond;
        let part = below as f32 / (1.0 + root) * (1.0 + root * bend);
        let rest = root * (1.0 - (1.0 - root) * bend);
        let least = 1e-30;
        let low = (facing * part).max(least);
        let high = (beyond + facing * rest).max(least);
        Self {
            c,
            s,
            target: seen.area * below,
            x: f64::from(rough_quantile(low, high)).min(seen.steepest),
        }
    }

    /// A step of Halley's method from `x`, and whether what is found there is too little.
    #[inline(always)]
    fn step<const E: usize, const C: usize>(
        &self,
        precision: &Precision<E, C>,
        x: f64,
    ) -> (f64, bool) {
        let &Self { c, s, target, .. } = self;
        let [tail, erfcx] = precision.tail(x.abs());
        let (gauss, half) = (tail * (1.0 / PI.sqrt()), 0.5 * c * tail * erfcx);
        let found = f64::select(x < 0.0, half, c - half) + 0.5 * s * gauss;
        let facing = c - x * s;
        let residual = target - found;
        let newton = residual / (facing * gauss);
        let step = newton / (1.0 - newton * (x + 0.5 * s / facing));
        (step, residual > 0.0)
    }

    /// After up to three steps of Halley's method, and whether the last of them was smaller than `last`: what is left is of its
    /// third order.
    #[inline(always)]
    fn refined<const E: usize, const C: usize>(
        &self,
        precision: &Precision<E, C>,
        (steps, last): (usize, f64),
    ) -> (f64, bool) {
        let (mut step, _) = self.step(precision, self.x);
        let mut x = self.x + step;
        // No loop: it would be too long to be unrolled before those around it become vectors.
        if steps > 1 {
            (step, _) = self.step(precision, x);
            x += step;
        }
        if steps > 2 {
            (step, _) = self.step(precision, x);
            x += step;
        }
        (x, step.abs() < last)
    }

    /// The same by as many steps as it takes, between brackets.
    #[cold]
    fn search(&self, last: f64) -> f64 {
        // Facets with a larger slope face away. Beyond 10, nothing is left of a Gaussian.
        let &Self { c, s, .. } = self;
        let (mut low, mut high) = (-10.0, if c < 10.0 * s { c / s } else { 10.0 });
        let mut x = self.x.clamp(low, high - 0.1 * (high - low));
        // Bisection alone would take 50.
        for _ in 0..60 {
            let (step, too_little) = self.step(&DOUBLE, x);
            if too_little {
                low = x;
            } else {
                high = x;
            }
            let next = x + step;
            if !(low..=high).contains(&next) {
                x = 0.5 * (low + high);
                continue;
            }
            x = next;
            if step.abs() < last {
                break;
            }
        }
        x
    }
}

/// Which steps, and how small the last of them has to be, for slopes along the direction and across.
type Steps = [(usize, f64); 2];

/// The last one is smaller than a fifth of the third root of a rounding. More would be needed once in some hundred times.
const SINGLE_STEPS: Steps = [(2, 9.8e-4), (1, 9.8e-4)];
const DOUBLE_STEPS: Steps = [(3, 1.2e-6), (2, 1.2e-6)];

#[inline(always)]
fn steps<P: Float>() -> Steps {
    if is_single::<P>() {
        SINGLE_STEPS
    } else {
        DOUBLE_STEPS
    }
}

/// The slope below which the fraction `u` of the area visible from the unit vector `(s, c)` lies, and whether it is right.
/// In double precision, to as many digits as the numbers have.
#[inline(always)]
fn in_line<P: Float>([c, s]: [P; 2], u: P, steps: (usize, f64)) -> (P, bool) {
    let (direction, below) = ([c.to_f64(), s.to_f64()], within_cell(u));
    let (x, right) = if is_single::<P>() {
        Quantile::of(&BETWEEN, direction, below).refined(&BETWEEN, steps)
    } else {
        Quantile::of(&DOUBLE, direction, below).refined(&DOUBLE, steps)
    };
    (P::of(x), right)
}

/// A slope along the unit vector `(s, c)` that is visible from there, and one across it, for which that makes no
/// difference: each from a number, in the order of these numbers. Also whether both are right.
#[inline(always)]
pub(super) fn visible_in_line<P: Float>(direction: [P; 2], [u, v]: [P; 2]) -> ([P; 2], bool) {
    let [along_steps, across_steps] = steps::<P>();
    let (along, right) = in_line(direction, u, along_steps);
    let (across, right_too) = in_line([P::one(), P::zero()], v, across_steps);
    ([along, across], right & right_too)
}

/// [`visible_in_line`], right in any case.
///
/// # Derivatives
/// In the direction.
#[inline]
pub(super) fn visible<R: Real>([c, s]: [R; 2], numbers: [R::Primal; 2]) -> [R; 2] {
    let [along, across] = found([c.primal(), s.primal()], numbers);
    [
        moving(along, [c, s], within_cell(numbers[0])),
        R::lift(across),
    ]
}

/// [`visible_in_line`], once for all who need no loop; what that does not find is searched.
#[inline(never)]
fn found<P: Float>(direction: [P; 2], numbers: [P; 2]) -> [P; 2] {
    let (slopes, right) = visible_in_line(direction, numbers);
    if right {
        slopes
    } else {
        searched(direction, numbers)
    }
}

#[cold]
fn searched<P: Float>(direction: [P; 2], [u, v]: [P; 2]) -> [P; 2] {
    let [(_, last), _] = steps::<P>();
    let found = |direction: [P; 2], u: P| {
        let direction = direction.map(P::to_f64);
        P::of(Quantile::of(&DOUBLE, direction, within_cell(u)).search(last))
    };
    [found(direction, u), found([P::one(), P::zero()], v)]
}

/// A visible slope with its tangents: Newton steps that move these only (implicit function theorem). Each raises the order
/// that is right by one, and the value stays.
#[inline]
fn moving<R: Real>(x: R::Primal, [c, s]: [R; 2], below: f64) -> R {
    let mut x = R::lift(x);
    if R::IS_PRIMAL {
        return x;
    }
    let target = sigma(c, s) * Const(R::Primal::of(below));
    for _ in 0..2 {
        let residual = area_below(x, c, s) - target;
        let slope = (c - x * s) * gauss(x);
        x -= (residual - Const(residual.primal())) / slope;
    }
    x
}

/// A random number stands for the numbers that were rounded to it: for 0, whose quantile is
/// infinite, the middle of them is taken.
#[inline(always)]
fn within_cell<P: Float>(u: P) -> f64 {
    u.to_f64().max(P::EPSILON.to_f64() * 0.25)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::warp::sin_cos_of_turns;

    /// Slopes that are found in line are the quantiles of what is seen, from above to grazing angles, and few are left for
    /// the search, which finds the same.
    fn assert_found<P: Float>(near: f64, most: usize) {
        let (mut all, mut missed) = (0, 0);
        for i in 0..400 {
            let (sin, cos) = sin_cos_of_turns((f64::from(i) + 0.5) / 1600.0);
            let direction = [P::of(cos), P::of(sin)];
            let [c, s] = direction.map(P::to_f64);
            for k in 0..500 {
                let u = P::of((f64::from(k) + 0.3) / 500.0);
                let below = u.to_f64();
                let ([along, across], right) = visible_in_line(direction, [u; 2]);
                let searched = searched(direction, [u; 2]);
                all += 1;
                if !right {
                    missed += 1;
                    continue;
                }
                for (found, searched) in [along, across].into_iter().zip(searched) {
                    assert!((found - searched).abs().to_f64() < near, "{c} {below}");
                }
                let part = area_below(along.to_f64(), c, s) / sigma(c, s);
                assert!((part - below).abs() < near, "{c} {below}: {part}");
                let part = area_below(across.to_f64(), 1.0, 0.0);
                assert!((part - below).abs() < near, "{below}: {part}");
            }
        }
        assert!(missed * most < all, "{missed} of {all}");
    }

    #[test]
    fn slopes_are_found_without_a_search() {
        assert_found::<f32>(1e-6, 100);
        assert_found::<f64>(1e-13, 100);
    }

    #[test]
    fn areas_are_right_to_a_few_roundings() {
        for i in 0..=1000 {
            let (sin, cos) = sin_cos_of_turns(f64::from(i) / 4000.0);
            for spread in [1e-4, 0.1, 0.5, 1.0] {
                let s = sin * spread;
                let right = if cos >= 6.0 * s {
                    cos
                } else {
                    area_below(cos / s, cos, s)
                };
                assert!(
                    (sigma(cos, s) / right - 1.0).abs() < 1e-15 * 4.0,
                    "{cos} {s}"
                );
                let single = f64::from(sigma(cos as f32, s as f32));
                assert!((single / right - 1.0).abs() < 5e-7, "{cos} {s}");
            }
        }
    }
}
