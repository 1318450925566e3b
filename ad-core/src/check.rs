//! Checking derivatives: central differences with step selection, and the dot-product test between
//! forward and reverse mode.

use std::fmt;

use crate::real::Float;
use crate::vjp::{DiffFn, jacobian, jvp, vjp};

/// One derivative, as differentiated automatically and as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Component {
    /// Index of the output.
    pub output: usize,
    /// Index of the input.
    pub input: usize,
    /// The derivative under test.
    pub automatic: f64,
    /// The derivative by central differences.
    pub numeric: f64,
    /// Estimated error of `numeric`.
    pub numeric_error: f64,
    /// Deviation divided by what is allowed: above 1 is a failure.
    pub excess: f64,
}

/// Result of a derivative check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// Number of derivatives compared.
    pub compared: usize,
    /// Number of derivatives that deviate by more than allowed.
    pub failed: usize,
    /// The worst component; `None` if there was nothing to compare.
    pub worst: Option<Component>,
}

impl Report {
    const EMPTY: Report = Report {
        compared: 0,
        failed: 0,
        worst: None,
    };

    /// Whether every derivative agrees.
    pub fn passed(&self) -> bool {
        self.failed == 0
    }

    fn add(&mut self, output: usize, input: usize, automatic: f64, d: Difference, tolerance: f64) {
        let deviation = (automatic - d.value).abs();
        // The extrapolation's own error estimate is optimistic by a small factor.
        let allowed = tolerance * automatic.abs().max(d.value.abs()) + 8.0 * d.error;
        let finite = automatic.is_finite() && d.error.is_finite();
        let agrees = finite && deviation <= allowed;
        // 0 / 0 is agreement: `max` drops the NaN.
        let excess = if finite {
            (deviation / allowed).max(0.0)
        } else {
            f64::INFINITY
        };
        self.compared += 1;
        self.failed += usize::from(!agrees);
        if self.worst.is_none_or(|w| excess > w.excess) {
            self.worst = Some(Component {
                output,
                input,
                automatic,
                numeric: d.value,
                numeric_error: d.error,
                excess,
            });
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "{} of {} derivatives deviate",
            self.failed, self.compared
        )?;
        if let Some(w) = self.worst {
            write!(
                f,
                "; worst: d out[{}] / d in[{}] is {:e}, central differences give {:e} +- {:.1e} \
                 ({:.3} of the allowed deviation)",
                w.output, w.input, w.automatic, w.numeric, w.numeric_error, w.excess
            )?;
        }
        Ok(())
    }
}

/// A derivative by finite differences, with an error estimate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The derivative.
    pub value: f64,
    /// Estimated absolute error; infinite if the function was nowhere finite around the point.
    pub error: f64,
}

/// Derivative of `f` at `x` by central differences, extrapolated to zero step over a sequence of
/// shrinking steps [Ridders 1982]; the entry with the smallest error estimate wins, so the step
/// selects itself between truncation and rounding.
///
/// `h` is the first step; it is shortened until `f` is finite on both sides.
pub fn central_difference(mut f: impl FnMut(f64) -> f64, x: f64, h: f64) -> Difference {
    const SHRINK: f64 = 1.6;
    const STEPS: usize = 14;
    const SAFE: f64 = 2.0;
    let mut quotient = |h: f64| {
        // The step as represented, so that rounding of x + h does not enter the quotient.
        let (hi, lo) = (x + h, x - h);
        (f(hi) - f(lo)) / (hi - lo)
    };
    let mut h = h;
    for _ in 0..60 {
        if quotient(h).is_finite() {
            break;
        }
        h *= 0.5;
    }
    let mut table = [[0.0f64; STEPS]; STEPS];
    table[0][0] = quotient(h);
    let mut best = Difference {
        value: table[0][0],
        error: f64::INFINITY,
    };
    for i in 1..STEPS {
        h /= SHRINK;
        table[i][0] = quotient(h);
        let mut factor = SHRINK * SHRINK;
        for j in 1..=i {
            let (finer, coarser) = (table[i][j - 1], table[i - 1][j - 1]);
            table[i][j] = finer + (finer - coarser) / (factor - 1.0);
            factor *= SHRINK * SHRINK;
            let error = (table[i][j] - finer)
                .abs()
                .max((table[i][j] - coarser).abs());
            if error < best.error {
                best = Difference {
                    value: table[i][j],
                    error,
                };
            }
        }
        if (table[i][i] - table[i - 1][i - 1]).abs() >= SAFE * best.error {
            break;
        }
    }
    // Rounding of the function values limits every entry.
    best.error = best.error.max(4.0 * f64::EPSILON * best.value.abs());
    best
}

/// First step for an input of size `x`.
fn first_step(x: f64) -> f64 {
    0.05 * x.abs().max(0.1)
}

/// Compares the Jacobian of `f` at `x` with central differences, each to relative `tolerance`.
///
/// ```
/// use ad_core::{check, diff_fn};
/// diff_fn! { fn f<R>([x, y]: [R; 2]) -> [R; 2] { [x.exp() * y, (x / y).atan()] } }
/// let report = check::jacobian_by_differences(&f, [0.3, 0.7], 1e-8);
/// assert!(report.passed(), "{report}");
/// ```
pub fn jacobian_by_differences<F: DiffFn<I, O>, const I: usize, const O: usize>(
    f: &F,
    x: [f64; I],
    tolerance: f64,
) -> Report {
    let (_, jac) = jacobian(f, x);
    let mut report = Report::EMPTY;
    for (o, row) in jac.iter().enumerate() {
        for (i, automatic) in row.iter().enumerate() {
            let along = |v| {
                let mut at = x;
                at[i] = v;
                f.eval(at)[o]
            };
            let numeric = central_difference(along, x[i], first_step(x[i]));
            report.add(o, i, *automatic, numeric, tolerance);
        }
    }
    report
}

/// Compares any gradient, however it was computed, with central differences of the scalar function
/// `f` at `x`. `x` is perturbed in place and restored. A gradient shorter or longer than `x` fails.
pub fn gradient_by_differences(
    mut f: impl FnMut(&[f64]) -> f64,
    x: &mut [f64],
    gradient: &[f64],
    tolerance: f64,
) -> Report {
    let mut report = Report::EMPTY;
    report.failed = x.len().abs_diff(gradient.len());
    for (i, automatic) in gradient.iter().enumerate().take(x.len()) {
        let x_i = x[i];
        let along = |v| {
            x[i] = v;
            f(x)
        };
        let numeric = central_difference(along, x_i, first_step(x_i));
        x[i] = x_i;
        report.add(0, i, *automatic, numeric, tolerance);
    }
    report
}

/// The two sides of `<w, J v> = <J^T w, v>`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DotProduct {
    /// `<w, J v>`, from forward mode.
    pub forward: f64,
    /// `<J^T w, v>`, from reverse mode.
    pub reverse: f64,
    /// Sum of the absolute values of the terms on either side: the scale of rounding errors.
    pub scale: f64,
}

impl DotProduct {
    /// Both sides from vectors computed elsewhere: directions `v` and `w`, `jv = J v` and
    /// `jtw = J^T w`.
    pub fn new<P: Float>(v: &[P], w: &[P], jv: &[P], jtw: &[P]) -> Self {
        let terms = |a: &[P], b: &[P]| {
            a.iter().zip(b).fold((0.0, 0.0), |(sum, abs), (a, b)| {
                let t = a.to_f64() * b.to_f64();
                (sum + t, abs + t.abs())
            })
        };
        let (forward, scale_f) = terms(w, jv);
        let (reverse, scale_r) = terms(v, jtw);
        Self {
            forward,
            reverse,
            scale: f64::max(scale_f, scale_r),
        }
    }

    /// Difference of the two sides relative to the terms summed; NaN if they are not finite.
    pub fn gap(&self) -> f64 {
        if self.forward == self.reverse {
            return 0.0;
        }
        (self.forward - self.reverse).abs() / self.scale
    }
}

/// The dot-product test of `f` at `x` with pseudo-random directions drawn from `seed`: forward and
/// reverse mode must agree to rounding.
pub fn dot_product<P: Float, F: DiffFn<I, O>, const I: usize, const O: usize>(
    f: &F,
    x: [P; I],
    seed: u64,
) -> DotProduct {
    let mut counter = seed;
    let mut next = || {
        counter = counter.wrapping_add(1);
        P::from_bits_unit(mix(counter)) * P::of(2.0) - P::one()
    };
    let v: [P; I] = std::array::from_fn(|_| next());
    let w: [P; O] = std::array::from_fn(|_| next());
    let (_, jv) = jvp(f, x, v);
    let (_, jtw) = vjp(f, x, w);
    DotProduct::new(&v, &w, &jv, &jtw)
}

/// SplitMix64's output function: 64 well-mixed bits of a counter [Steele et al. 2014].
fn mix(counter: u64) -> u64 {
    let mut z = counter.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
