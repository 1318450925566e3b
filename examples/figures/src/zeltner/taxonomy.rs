//! The taxonomy of differential estimators [Zeltner 2021, section 4.2] in one dimension, in its
//! simplest form: an integrand and a sampling technique that depend on one parameter, what of that
//! dependence an estimator follows, and combinations of two techniques.
//!
//! An estimator is a function of random numbers. Its mean is found by quadrature
//! ([`expectation`]), so bias shows without noise.

use std::f64::consts::{PI, TAU};

use ad_core::{Dual, Real};

use super::integration_1d::{Density, Normal, integrate};

/// A number and its derivative with respect to the parameter.
pub type D = Dual<f64, 1>;

/// An integrand over an interval that depends on a parameter.
pub trait Integrand {
    /// Its value.
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R;
}

/// A way to place samples that depends on the same parameter.
pub trait Technique {
    /// Density of the samples at `x`.
    fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R;
    /// The sample for a random number: moves with the parameter.
    fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R;
}

/// Whether samples move when the parameter is differentiated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sampling {
    /// Samples and densities are constants [Eq. 4.29].
    Detached,
    /// Both follow the parameter [Eq. 4.31].
    Attached,
}

impl Sampling {
    /// Both kinds.
    pub const ALL: [Self; 2] = [Self::Detached, Self::Attached];

    fn sample(self, t: &impl Technique, u: f64, pi: f64) -> D {
        match self {
            Self::Detached => D::lift(t.sample(u, pi)),
            Self::Attached => t.sample(u, D::var(pi, 0)),
        }
    }

    fn pdf(self, t: &impl Technique, x: D, pi: f64) -> D {
        match self {
            Self::Detached => D::lift(t.pdf(x.re, pi)),
            Self::Attached => t.pdf(x, D::var(pi, 0)),
        }
    }
}

/// The estimate from one random number, and its derivative.
pub fn estimate(f: &impl Integrand, t: &impl Technique, sampling: Sampling, pi: f64, u: f64) -> D {
    let x = sampling.sample(t, u, pi);
    f.eval(x, D::var(pi, 0)) / sampling.pdf(t, x, pi)
}

/// The estimate of a product with some factors attached and others constant: `g`, `h` and `1 / p`. Right
/// only if all are attached.
pub fn partly_attached(
    (g, h): (&impl Integrand, &impl Integrand),
    t: &impl Technique,
    attached: [bool; 3],
    pi: f64,
    u: f64,
) -> D {
    let moving = D::var(pi, 0);
    let x = t.sample(u, moving);
    let factors = [
        g.eval(x, moving),
        h.eval(x, moving),
        t.pdf(x, moving).recip(),
    ];
    let chosen = factors.into_iter().zip(attached);
    chosen.fold(D::one(), |product, (factor, attached)| {
        product * if attached { factor } else { factor.detach() }
    })
}

/// What of a weight of multiple importance sampling is differentiated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weight {
    /// Nothing of it: a constant.
    Detached,
    /// The position at which it is evaluated, not its parameter: the weight function of the unchanged techniques at the
    /// moving sample.
    Frozen,
    /// Position and parameter.
    Attached,
}

impl Weight {
    /// All three kinds.
    pub const ALL: [Self; 3] = [Self::Detached, Self::Frozen, Self::Attached];
}

/// How one of two combined techniques is differentiated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Differentiation {
    /// The technique.
    pub sampling: Sampling,
    /// Its weight.
    pub weight: Weight,
}

/// Whether the derivative of a combination is unbiased.
///
/// The weights must sum to one, as functions of place *and parameter*: either all follow the parameter
/// or none does. Then each technique may do as it likes, as long as its weight is taken where its
/// sample is. (The caption of figure 4.13 leaves the weight's attachment to each technique too: errata
/// Z-4.13f.)
pub fn is_unbiased(parts: [Differentiation; 2]) -> bool {
    let follows = |p: Differentiation| p.weight == Weight::Attached;
    let in_place =
        |p: Differentiation| p.weight != Weight::Detached || p.sampling == Sampling::Detached;
    follows(parts[0]) == follows(parts[1]) && parts.into_iter().all(in_place)
}

/// One sample of each technique, with weights of the power heuristic (balance heuristic for
/// `exponent` 1).
pub fn combined(
    f: &impl Integrand,
    (a, b): (&impl Technique, &impl Technique),
    parts: [Differentiation; 2],
    exponent: i32,
    pi: f64,
    u: [f64; 2],
) -> D {
    let weights = |x: D, pi: D| {
        let w = [a.pdf(x, pi), b.pdf(x, pi)].map(|p| p.powi(exponent));
        w.map(|p| p / (w[0] + w[1]))
    };
    let weight = |k: usize, x: D| match parts[k].weight {
        Weight::Detached => weights(x, D::lift(pi))[k].detach(),
        Weight::Frozen => weights(x, D::lift(pi))[k],
        Weight::Attached => weights(x, D::var(pi, 0))[k],
    };
    let s = parts.map(|p| p.sampling);
    let x = [s[0].sample(a, u[0], pi), s[1].sample(b, u[1], pi)];
    let p = [s[0].pdf(a, x[0], pi), s[1].pdf(b, x[1], pi)];
    let term = |k: usize| weight(k, x[k]) * f.eval(x[k], D::var(pi, 0)) / p[k];
    term(0) + term(1)
}

/// Detached samples of densities made for the derivative [section 4.3], which cover disjoint parts of
/// the interval: the sum of the estimates from all of them, at the same random number.
pub fn differential(f: &impl Integrand, lobes: &[Lobe], pi: f64, u: f64) -> f64 {
    let term = |lobe: &Lobe| {
        let x = lobe.sample(u);
        f.eval(D::lift(x), D::var(pi, 0)).eps[0] / lobe.pdf(x)
    };
    lobes.iter().map(term).sum()
}

/// Mean over the random number of an estimate and of its derivative, by quadrature that is fine
/// towards both ends.
pub fn expectation(f: impl Fn(f64) -> D) -> D {
    let part = |get: &dyn Fn(D) -> f64| {
        integrate([0.0, 1.0], 4000, |v| {
            // Zero at the ends with its first derivatives, so that they need not be evaluated.
            let slope = 30.0 * (v * (1.0 - v)).powi(2);
            if slope == 0.0 {
                return 0.0;
            }
            get(f(v * v * v * (10.0 + v * (6.0 * v - 15.0)))) * slope
        })
    };
    D::new(part(&|d| d.re), [part(&|d| d.eps[0])])
}

/// `x^(n pi)` on [0, 1].
#[derive(Clone, Copy, Debug)]
pub struct Power(pub f64);

impl Integrand for Power {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        x.powf(pi * R::c(self.0))
    }
}

/// Samples with the density `(pi + 1) x^pi` on [0, 1].
#[derive(Clone, Copy, Debug)]
pub struct Rising;

impl Technique for Rising {
    fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        (pi + R::c(1.0)) * x.powf(pi)
    }
    fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R {
        R::of(u).powf((pi + R::c(1.0)).recip())
    }
}

/// Samples with the density `2 (1 - x)` on [0, 1], whatever the parameter.
#[derive(Clone, Copy, Debug)]
pub struct Falling;

impl Technique for Falling {
    fn pdf<R: Real<Primal = f64>>(&self, x: R, _: R) -> R {
        (R::one() - x) * R::c(2.0)
    }
    fn sample<R: Real<Primal = f64>>(&self, u: f64, _: R) -> R {
        R::of(1.0 - (1.0 - u).sqrt())
    }
}

/// Samples of a normal distribution whose standard deviation is the parameter, cut to an interval.
#[derive(Clone, Copy, Debug)]
pub struct Bell {
    /// The interval.
    pub range: [f64; 2],
}

impl Bell {
    fn density<R: Real<Primal = f64>>(&self, pi: R) -> Normal<R> {
        Normal {
            mean: R::zero(),
            sd: pi,
            range: self.range,
        }
    }
}

impl Technique for Bell {
    fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        self.density(pi).pdf(x)
    }
    fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R {
        self.density(pi).sample(u)
    }
}

/// The wrapped normal distribution on [-pi, pi]; its standard deviation before wrapping, at most 2, is the
/// parameter.
#[derive(Clone, Copy, Debug)]
pub struct Wrapped;

/// How often the distribution is wrapped to either side: 4 standard deviations of 2, and a half.
const WRAPS: i32 = 3;

/// [`Wrapped`] at a parameter.
#[derive(Clone, Copy, Debug)]
pub struct WrappedNormal<R> {
    /// Standard deviation before wrapping.
    pub sd: R,
}

impl<R: Real<Primal = f64>> WrappedNormal<R> {
    fn sum(&self, term: impl Fn(R) -> R) -> R {
        (-WRAPS..=WRAPS)
            .map(|k| term(R::of(TAU * f64::from(k)) / self.sd))
            .sum()
    }
}

impl<R: Real<Primal = f64>> Density<R> for WrappedNormal<R> {
    fn range(&self) -> [f64; 2] {
        [-PI, PI]
    }
    fn pdf(&self, x: R) -> R {
        let x = x / self.sd;
        let bells = self.sum(|shift| ((x + shift).square() * R::c(-0.5)).exp());
        bells * R::c(1.0 / TAU.sqrt()) / self.sd
    }
    fn cdf(&self, x: R) -> R {
        let [x, low] = [x, R::of(-PI)].map(|x| x / (self.sd * R::c(2f64.sqrt())));
        let below = |shift: R| {
            let shift = shift * R::c(0.5f64.sqrt());
            ((x + shift).erf() - (low + shift).erf()) * R::c(0.5)
        };
        self.sum(below)
    }
}

impl Technique for Wrapped {
    fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        WrappedNormal { sd: pi }.pdf(x)
    }
    fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R {
        WrappedNormal { sd: pi }.sample(u)
    }
}

impl Integrand for Wrapped {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        WrappedNormal { sd: pi }.pdf(x)
    }
}

/// The density proportional to the derivative of a [`WrappedNormal`] with respect to its standard
/// deviation, between two roots of that.
#[derive(Clone, Copy, Debug)]
pub struct Lobe {
    sd: f64,
    range: [f64; 2],
    /// Integral of the derivative over the lobe: signed.
    pub mass: f64,
}

impl Lobe {
    /// The positive and the negative lobe. The positive one crosses the seam of the circle: it
    /// ends beyond pi.
    pub fn pair(sd: f64) -> [Self; 2] {
        let slope = |x: f64| Self::derivative(sd, x);
        // Negative at 0 and positive at pi, with one root between.
        let (mut low, mut high) = (0.0, PI);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if slope(middle) < 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let root = 0.5 * (low + high);
        [[root, TAU - root], [-root, root]].map(|range| {
            let [a, b] = range.map(|x| Self::below(sd, x));
            Self {
                sd,
                range,
                mass: b - a,
            }
        })
    }

    fn dual(sd: f64) -> WrappedNormal<D> {
        WrappedNormal { sd: D::var(sd, 0) }
    }

    fn derivative(sd: f64, x: f64) -> f64 {
        Self::dual(sd).pdf(D::lift(x)).eps[0]
    }

    /// Integral of the derivative up to `x`.
    fn below(sd: f64, x: f64) -> f64 {
        Self::dual(sd).cdf(D::lift(x)).eps[0]
    }
}

impl Density<f64> for Lobe {
    fn range(&self) -> [f64; 2] {
        self.range
    }
    fn pdf(&self, x: f64) -> f64 {
        (Self::derivative(self.sd, x) / self.mass).max(0.0)
    }
    fn cdf(&self, x: f64) -> f64 {
        (Self::below(self.sd, x) - Self::below(self.sd, self.range[0])) / self.mass
    }
}

/// The integrand of the test of combinations: `x^(2 pi) (1 + x)`.
#[derive(Clone, Copy, Debug)]
pub struct Ramp;

impl Integrand for Ramp {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        x.powf(pi * R::c(2.0)) * (x + R::c(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::zeltner::integration_1d::positions;

    /// [`Falling`] at parameter 1, but it depends on the parameter.
    struct Mirrored;

    impl Technique for Mirrored {
        fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
            Rising.pdf(R::one() - x, pi)
        }
        fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R {
            R::one() - Rising.sample(1.0 - u, pi)
        }
    }

    /// Mean derivative of a combination on [`Ramp`], at parameter 1. The terms are independent, so that both
    /// may use the same number.
    fn mean(second: &impl Technique, parts: [Differentiation; 2], exponent: i32) -> f64 {
        let one = |u| combined(&Ramp, (&Rising, second), parts, exponent, 1.0, [u, u]);
        expectation(one).eps[0]
    }

    fn every_combination() -> impl Iterator<Item = [Differentiation; 2]> {
        let parts = Sampling::ALL
            .iter()
            .flat_map(|&sampling| Weight::ALL.map(|weight| Differentiation { sampling, weight }));
        let parts: Vec<_> = parts.collect();
        let second = parts.clone();
        parts
            .into_iter()
            .flat_map(move |a| second.clone().into_iter().map(move |b| [a, b]))
    }

    /// All 36, balance and power heuristic: unbiased exactly where [`is_unbiased`] says so.
    #[test]
    fn valid_combinations_and_only_those_are_unbiased() {
        let expected = -2.0 * (1.0 / 9.0 + 1.0 / 16.0);
        for exponent in [1, 2] {
            for parts in every_combination() {
                let gap = (mean(&Mirrored, parts, exponent) - expected).abs();
                let fits = if is_unbiased(parts) {
                    gap < 1e-6
                } else {
                    gap > 1e-4
                };
                assert!(fits, "{parts:?}: off by {gap:e}");
            }
        }
        assert_eq!(every_combination().filter(|&p| is_unbiased(p)).count(), 13);
    }

    /// The table of errata Z-4.13f.
    #[test]
    fn known_biases() {
        use Sampling::{Attached as A, Detached as D};
        use Weight::{Attached as WA, Detached as WD, Frozen as WF};
        let part = |(sampling, weight)| Differentiation { sampling, weight };
        for (parts, expected) in [
            ([(D, WD), (D, WD)], -0.347222),
            ([(A, WA), (A, WA)], -0.347222),
            ([(D, WA), (D, WA)], -0.347222),
            ([(A, WA), (D, WA)], -0.347222),
            ([(A, WF), (A, WF)], -0.347222),
            ([(A, WD), (A, WD)], -0.398472),
            ([(A, WA), (D, WD)], -0.340278),
            ([(D, WD), (D, WA)], -0.354167),
        ] {
            let found = mean(&Falling, parts.map(part), 1);
            assert!((found - expected).abs() < 1e-6, "{parts:?}: {found}");
        }
    }

    /// Errata Z-footnote 4, in the order of binary numbers.
    #[test]
    fn factors_are_attached_together_or_not_at_all() {
        let expected = [
            0.0, -0.09375, -0.0625, -0.15625, -0.03125, -0.125, -0.09375, -0.1875,
        ];
        let found: Vec<f64> = (0..8)
            .map(|k| {
                let attached = [k & 4 != 0, k & 2 != 0, k & 1 != 0];
                let one =
                    |u| partly_attached((&Power(1.0), &Power(2.0)), &Rising, attached, 1.0, u);
                expectation(one).eps[0]
            })
            .collect();
        for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
            assert!((found - expected).abs() < 1e-6, "{k}: {found} {expected}");
        }
    }

    #[test]
    fn techniques_are_consistent() {
        fn check(t: &impl Technique, pi: f64, range: [f64; 2]) {
            let total = integrate(range, 4000, |x| t.pdf(x, pi));
            assert!((total - 1.0).abs() < 1e-6, "{total}");
            let h = 1e-5;
            for u in positions([0.02, 0.98], 50) {
                let slope = (t.sample(u + h, pi) - t.sample(u - h, pi)) / (2.0 * h);
                let p = t.pdf(t.sample(u, pi), pi);
                assert!((slope * p - 1.0).abs() < 1e-6, "{u}: {slope} {p}");
                let moved = (t.sample(u, pi + h) - t.sample(u, pi - h)) / (2.0 * h);
                let eps = t.sample(u, D::var(pi, 0)).eps[0];
                assert!((moved - eps).abs() < 1e-6, "{u}: {moved} {eps}");
            }
        }
        check(&Rising, 1.0, [0.0, 1.0]);
        check(&Falling, 1.0, [0.0, 1.0]);
        check(&Bell { range: [-1.0, 1.0] }, 0.3, [-1.0, 1.0]);
        for sd in [0.2, 1.0, 2.0] {
            check(&Wrapped, sd, [-PI, PI]);
        }
    }

    /// Lobes integrate to one, their samples invert them, and the sum of the estimates is constant; before
    /// wrapping, the mass is `2 phi(1) / sd`.
    #[test]
    fn lobes_cover_the_derivative() {
        for sd in [0.2, 0.5, 1.0, 1.5] {
            let lobes = Lobe::pair(sd);
            assert!((lobes[0].mass + lobes[1].mass).abs() < 1e-12);
            for lobe in &lobes {
                let total = integrate(lobe.range(), 4000, |x| lobe.pdf(x));
                assert!((total - 1.0).abs() < 1e-9, "{sd} {total}");
                for u in positions([0.001, 0.999], 500) {
                    assert!((lobe.cdf(lobe.sample(u)) - u).abs() < 1e-12);
                    assert!(differential(&Wrapped, &lobes, sd, u).abs() < 1e-9);
                }
            }
        }
        let mass = Lobe::pair(0.2)[0].mass * 0.2;
        assert!((mass - 0.483_941).abs() < 1e-6, "{mass}");
    }
}
