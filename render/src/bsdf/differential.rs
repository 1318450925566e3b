//! Sampling of the *derivative* of a microfacet distribution [Zeltner 2021, section 4.3.1 and
//! appendix B, corrected].
//!
//! A change of roughness moves normals from the middle of the distribution to its outside: with
//! `s = tan^2(theta) / alpha^2`, the derivative of `D cos(theta)` with respect to roughness is negative
//! for `s < 1`, positive for `s > 1`, and both parts have the same mass, `1 / (2 alpha)` for GGX and
//! `2 / (e alpha)` for Beckmann. Each part is sampled by a density of its own, proportional to it:
//!
//! | | density of normals, per solid angle | `s` below which the fraction `u` of it lies |
//! |---|---|---|
//! | GGX | `4 D cos abs(s - 1) / (s + 1)` | minus `u / (1 + sqrt(1 - u))^2`, plus `(1 + sqrt u)^2 / (1 - u)` |
//! | Beckmann | `e D cos abs(s - 1)` | `s e^(1 - s) = u` for minus, `= 1 - u` for plus |
//!
//! The two estimates are *summed*, not averaged: each density is normalised on its own part
//! (errata Z-B-lobes). With the same random numbers they form an antithetic pair whose sum does not
//! vary at all under constant light. All normals are sampled, not the visible ones only, whatever the
//! material does to sample its value.
//!
//! The densities vanish at `s = 1`, where derivatives of masking, reflectance and everything else do
//! not. Alone, the pair has infinite variance there (errata Z-4.43): it is meant to be combined
//! with ordinary sampling by multiple importance sampling.

use std::f64::consts::E;

use ad_core::{Const, Float, Real, Vec3};

use super::microfacet::{Alpha, Microfacet, Ndf};
use crate::math::{both, warp};

/// A part of the derivative of a distribution of normals with respect to roughness.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DiffLobe {
    /// Where a rougher surface has more normals, `tan(theta) > alpha`.
    Plus,
    /// Where it has fewer.
    Minus,
}

impl DiffLobe {
    /// The antithetic pair.
    pub const BOTH: [Self; 2] = [Self::Plus, Self::Minus];
}

/// Which derivatives of a value are meant: [`DiffLobe`] samples those through the distribution of normals,
/// everything else (masking, reflectance, other parameters) is left to ordinary sampling
/// (errata Z-4.43).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Part {
    /// All of them.
    #[default]
    All,
    /// Those through `D`, with respect to its roughness.
    Normals,
    /// The others.
    Rest,
}

impl<R: Real, A: Alpha<Scalar = R>> Microfacet<A> {
    /// Relative change of `D(m)` with roughness: `D / D_0 - 1`, zero without tangents.
    #[inline]
    pub fn change(&self, m: Vec3<R::Primal>) -> R {
        let d = self.d(Vec3::lift(m));
        let value = d.primal();
        if value > R::Primal::zero() {
            (d - Const(value)) / Const(value)
        } else {
            R::zero()
        }
    }
}

impl<P: Float> Microfacet<P> {
    /// A normal from each part of the derivative of `D cos(theta)`, in the order of [`DiffLobe::BOTH`]; both have the
    /// same azimuth.
    #[inline]
    pub fn sample_differential(&self, u: [P; 2]) -> [Vec3<P>; 2] {
        let (sin, cos) = warp::sin_cos_of_turns(u[1]);
        both(DiffLobe::BOTH, |sign| {
            // tan(theta) / alpha
            let t = match self.kind {
                Ndf::Ggx => ggx_tangent(u[0], sign),
                Ndf::Beckmann => beckmann_square(u[0], sign).sqrt(),
            };
            let r = self.alpha * t;
            Vec3::new(r * cos, r * sin, P::one()).normalize()
        })
    }

    /// `cos^2` and `sin^2 / alpha^2` of a normal: `s` is the second over the first.
    #[inline]
    fn squares(&self, m: Vec3<P>) -> [P; 2] {
        let outwards = (m.x / self.alpha).square() + (m.y / self.alpha).square();
        [m.z.square(), outwards]
    }

    /// The part that a normal belongs to.
    #[inline]
    pub fn part_of(&self, m: Vec3<P>) -> DiffLobe {
        let [a, b] = self.squares(m);
        if b > a {
            DiffLobe::Plus
        } else {
            DiffLobe::Minus
        }
    }

    /// Density of [`Microfacet::sample_differential`] for the part that the normal belongs to, per solid
    /// angle of the normal: that of both parts together, since only one of them ever gives it.
    #[inline]
    pub fn pdf_differential(&self, m: Vec3<P>) -> P {
        let d = self.d(m);
        if d <= P::zero() {
            return P::zero();
        }
        let [a, b] = self.squares(m);
        let off = (b - a).abs();
        d * m.z
            * match self.kind {
                Ndf::Ggx => P::of(4.0) * off / (a + b),
                Ndf::Beckmann => P::of(E) * (off / a),
            }
    }

    /// Density of the reflected direction when [`Microfacet::sample_differential`] gave `m`.
    #[inline]
    pub fn pdf_differential_reflected(&self, w: Vec3<P>, m: Vec3<P>) -> P {
        let cos = w.dot(m).abs();
        // As in `pdf_reflected`.
        if cos < P::of(1e-8) {
            return P::zero();
        }
        self.pdf_differential(m) / (P::of(4.0) * cos)
    }
}

/// `tan(theta) / alpha`. The printed inverses [Eqs. B.11, B.12] are the same functions, but lose all
/// digits in single precision at small roughness.
#[inline]
fn ggx_tangent<P: Float>(u: P, sign: DiffLobe) -> P {
    let one = P::one();
    match sign {
        DiffLobe::Minus => u.sqrt() / (one + (one - u).sqrt()),
        DiffLobe::Plus => (one + u.sqrt()) / rest(u).sqrt(),
    }
}

/// `1 - u`; a random number that was rounded to 1 stands for those below it.
#[inline]
fn rest<P: Float>(u: P) -> P {
    (P::one() - u).max(P::EPSILON * P::of(0.5))
}

/// `s / u` as a function of `sqrt(2 (1 - u))`, where `s e^(1 - s) = u` and `s < 1`: best relative approximation, to 1.2e-7.
const MINUS: [f64; 10] = [
    0.999999885,
    -0.99998414,
    0.832962772,
    -0.649323543,
    0.479387895,
    -0.321118054,
    0.178426968,
    -0.0729273864,
    0.0187035243,
    -0.0022060438,
];

/// `s` as a function of `sqrt(2 (s - 1 - ln s))`, where `s > 1`: best relative approximation, to 7e-8 up to the largest
/// random number of single precision.
const PLUS: [f64; 10] = [
    0.999999933,
    1.0000036,
    0.333303521,
    0.0278697217,
    -0.00384439451,
    0.000354474175,
    -7.4161524e-6,
    -3.03291549e-6,
    3.94443675e-7,
    -1.637144e-8,
];

/// `s` with `s e^(1 - s) = u` below 1 (minus) or `= 1 - u` above 1 (plus): by polynomials, not by Lambert's W [Eqs. B.13,
/// B.14], whose argument rounds to its branch point.
#[inline]
fn beckmann_square<P: Float>(u: P, sign: DiffLobe) -> P {
    let (two, rest) = (P::of(2.0), rest(u));
    let is_single = P::EPSILON > P::of(1e-10);
    match sign {
        DiffLobe::Minus => {
            let p = (rest * two).sqrt();
            let s = u * polynomial(p, &MINUS);
            // Zero has no logarithm, and what is next to it needs none.
            if is_single || u < P::EPSILON {
                s
            } else {
                refine(s, -u.ln(), -p)
            }
        }
        DiffLobe::Plus => {
            // -ln(1 - u); the quotient takes back what rounding did to 1 - u.
            let off = P::one() - rest;
            let l = P::select(off > P::zero(), -rest.ln() * (u / off), u);
            let s = polynomial((l * two).sqrt(), &PLUS);
            if is_single {
                s
            } else {
                refine(s, l, (u * two).sqrt())
            }
        }
    }
}

/// The solution of `s - 1 - ln s = l` near `s` in double precision, by Halley's method. `p` is its distance from 1 to
/// first order.
fn refine<P: Float>(mut s: P, l: P, p: P) -> P {
    let one = P::one();
    let p2 = p.square();
    // The next term is 0.016 p^7.
    if p2 * p2 * p2 * p.abs() < P::EPSILON * P::of(64.0) {
        let terms = [
            1.0,
            1.0,
            1.0 / 3.0,
            11.0 / 72.0,
            43.0 / 540.0,
            769.0 / 17280.0,
            221.0 / 8505.0,
        ];
        return polynomial(p, &terms);
    }
    // One step, or two for the largest numbers.
    for _ in 0..4 {
        let off = s - one;
        let h = off - s.ln() - l;
        let squared = off.square();
        let step = h * s * off / (squared - h * P::of(0.5));
        s -= step;
        // What is left is about (step / s)^3 s / (4 (s - 1)^2).
        if step.abs() * step.square() <= P::EPSILON * P::of(0.1) * squared * (s * s * s) {
            break;
        }
    }
    s
}

/// The polynomial with these coefficients, constant first.
#[inline]
fn polynomial<P: Float>(x: P, coefficients: &[f64]) -> P {
    let terms = coefficients.iter().rev();
    terms.fold(P::zero(), |sum, &c| sum * x + P::of(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [Ndf; 2] = [Ndf::Ggx, Ndf::Beckmann];

    fn square<P: Float>(kind: Ndf, u: P, sign: DiffLobe) -> P {
        match kind {
            Ndf::Ggx => ggx_tangent(u, sign).square(),
            Ndf::Beckmann => beckmann_square(u, sign),
        }
    }

    /// The distribution function of a part, and of what is above `s` [Eqs. B.7 to B.10].
    fn below(kind: Ndf, s: f64, sign: DiffLobe) -> [f64; 2] {
        let minus = match kind {
            Ndf::Ggx => 4.0 * s / (1.0 + s).powi(2),
            Ndf::Beckmann => s * (1.0 - s).exp(),
        };
        let plus = match kind {
            Ndf::Ggx => ((s - 1.0) / (s + 1.0)).powi(2),
            // 1 - s e^(1 - s) without cancellation
            Ndf::Beckmann => -((1.0 - s) + s.ln()).exp_m1(),
        };
        match sign {
            DiffLobe::Minus => [minus, plus],
            DiffLobe::Plus => [plus, minus],
        }
    }

    /// A dense set of numbers in [0, 1): even, towards 0, and towards 1.
    fn numbers() -> impl Iterator<Item = f64> {
        let even = (0..100_000).map(|i| (f64::from(i) + 0.5) / 1e5);
        let small = (0..200).map(|i| 10f64.powf(-0.05 * f64::from(i)));
        let large = small.clone().map(|u| 1.0 - 0.5 * u);
        even.chain(small.map(|u| 0.5 * u)).chain(large)
    }

    #[test]
    fn inverses_invert_in_double_precision() {
        for kind in KINDS {
            for sign in DiffLobe::BOTH {
                for u in numbers() {
                    let s = square(kind, u, sign);
                    assert!((s >= 1.0) == (sign == DiffLobe::Plus), "{kind:?} {u} {s}");
                    let [lower, upper] = below(kind, s, sign);
                    // Relative to whichever is smaller; close to s = 1 the position is what counts.
                    let near_one = (s - 1.0).abs() * 4.0 * f64::EPSILON;
                    let error = ((lower - u).abs() / u).min((upper - (1.0 - u)).abs() / (1.0 - u));
                    assert!(
                        error < 2e-14 || (lower - u).abs() < near_one,
                        "{kind:?} {sign:?} {u}: {s} {error:e}"
                    );
                }
            }
        }
    }

    /// Single against double precision at the same numbers, 0 and the largest below 1 included.
    #[test]
    fn inverses_are_accurate_in_single_precision() {
        let last = 1.0 - f32::EPSILON / 2.0;
        for kind in KINDS {
            for sign in DiffLobe::BOTH {
                for u in numbers().map(|u| (u as f32).min(last)).chain([0.0, last]) {
                    let single = f64::from(square(kind, u, sign));
                    let double = square(kind, f64::from(u), sign);
                    let gap = (single - double).abs();
                    assert!(
                        gap <= 3e-6 * double,
                        "{kind:?} {sign:?} {u}: {single} {double}"
                    );
                }
            }
        }
    }
}
