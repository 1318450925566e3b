//! Damped Gauss-Newton steps.

use crate::error::{OptimError, require, require_len};
use crate::groups::Groups;
use crate::optimizer::{check_inputs, require_finite};
use crate::rates::Rates;
use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};

/// The curvature of an objective: a symmetric matrix `H`, positive semidefinite but for noise, that is
/// known through its products. For least squares `J^T W J`, with the Jacobian of the residuals.
pub trait Curvature {
    /// The diagonal of `H`.
    fn diagonal(&self) -> &[f64];
    /// Writes `H v`.
    fn product(&self, v: &[f64], out: &mut [f64]);
}

/// [`Curvature`] that is written out; for up to a few hundred parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct NormalMatrix {
    diagonal: Vec<f64>,
    entries: Vec<f64>,
}

impl NormalMatrix {
    /// From `len * len` entries, row by row. The matrix must be symmetric; only its lower half is looked at.
    ///
    /// # Errors
    /// A wrong number of entries, or one that is not finite.
    pub fn new(len: usize, mut entries: Vec<f64>) -> Result<Self, OptimError> {
        require_len("curvature", len * len, entries.len())?;
        for i in 0..len {
            for j in 0..i {
                entries[j * len + i] = entries[i * len + j];
            }
        }
        require_finite("curvature", &entries)?;
        Ok(Self {
            diagonal: (0..len).map(|i| entries[i * len + i]).collect(),
            entries,
        })
    }
}

impl Curvature for NormalMatrix {
    fn diagonal(&self) -> &[f64] {
        &self.diagonal
    }
    fn product(&self, v: &[f64], out: &mut [f64]) {
        let n = v.len().max(1);
        for (out, row) in out.iter_mut().zip(self.entries.chunks_exact(n)) {
            *out = dot(row, v);
        }
    }
}

/// What is known of the objective where a step starts.
#[derive(Clone, Copy, Debug)]
pub struct Evaluation<'a, T> {
    /// Its value.
    pub loss: f64,
    /// The standard error of that value, 0 if it is exact: smaller changes tell nothing about a step.
    pub loss_error: f64,
    /// Its gradient.
    pub gradient: &'a [T],
}

/// What a step did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The parameters moved.
    Moved,
    /// The loss had grown by the step before, which was undone: the parameters are where that one started,
    /// the next will be shorter.
    TakenBack,
}

/// Options of [`GaussNewton`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaussNewtonOptions {
    /// Damping of the first step, as a fraction of the curvature's diagonal; positive.
    #[serde(with = "crate::exact::number")]
    pub damping: f64,
    /// Largest change of any variable in one step; positive, maybe infinite. In units of the variables: 0.5
    /// for a logarithm is a factor of 1.6.
    #[serde(with = "crate::exact::number")]
    pub max_step: f64,
    /// Conjugate gradients end when the residual has fallen to this fraction; in (0, 1).
    #[serde(with = "crate::exact::number")]
    pub tolerance: f64,
    /// Or after this many products with the curvature; at least 1.
    pub products: u32,
}

impl Default for GaussNewtonOptions {
    fn default() -> Self {
        Self {
            damping: 1e-2,
            max_step: 0.5,
            tolerance: 1e-6,
            products: 500,
        }
    }
}

impl GaussNewtonOptions {
    fn validate(&self) -> Result<(), OptimError> {
        let Self {
            damping,
            max_step,
            tolerance,
            products,
        } = *self;
        let range = "a value in [1e-9, 1e9]";
        require(DAMPING.contains(&damping), "damping", range, damping)?;
        require(max_step > 0.0, "max_step", "a positive value", max_step)?;
        let fraction = tolerance > 0.0 && tolerance < 1.0;
        require(fraction, "tolerance", "a value in (0, 1)", tolerance)?;
        require(products >= 1, "products", "at least 1", products.into())
    }
}

const DAMPING: std::ops::RangeInclusive<f64> = 1e-9..=1e9;

/// The diagonal counts at least as this fraction of its largest entry: a parameter that hardly matters has
/// a limit to its step.
const LEAST_DIAGONAL: f64 = 1e-8;

/// Relative rounding of a loss that claims to be exact.
const ROUNDING: f64 = 1e-13;

/// Damped Gauss-Newton steps for least squares within bounds [Levenberg 1944; Marquardt 1963]:
/// `(H + damping diag H) step = -gradient`, solved by conjugate gradients preconditioned with the diagonal.
///
/// - *Damping* falls to a third where the loss fell by at least three quarters of what the quadratic model
///   said, doubles below one quarter, and a step after which the loss has grown is undone on the next call.
///   Steps that were to change it by less than twice the standard error of the losses are not judged.
/// - *Bounds* are those of the [`Groups`], whose variables are what moves; the curvature is that of the
///   parameters and is carried over by the first derivatives of the change of variables. A
///   variable that the step would carry beyond its bound or by more than
///   [`max_step`](GaussNewtonOptions::max_step) goes that far, and the rest is solved again around it.
/// - *Noise.* Under a [`Rates`] schedule that ends as one over the step number,
///   [`Schedule::Harmonic`](crate::Schedule::Harmonic), noisy steps average. A product or diagonal
///   that noise has made negative does no harm.
///
/// Gradient and curvature must be independent of the image behind the loss, see [`crate::loss`]; they may
/// share their samples with each other where the residuals vanish at the solution.
///
/// ```
/// use optim::{
///     Evaluation, GaussNewton, Groups, NormalMatrix, Parameterisation, Rates,
/// };
///
/// // Residuals 10 (y - x^2) and 1 - x, x at least 0.5.
/// let mut groups = Groups::new(2);
/// groups.add("x", 0..1, Parameterisation::bounded(0.5, f64::INFINITY)?)?;
/// let mut optimizer = GaussNewton::new(Rates::new(2, 1.0)?, groups, Default::default())?;
/// let mut p = [2.0f64, -1.0];
/// for _ in 0..40 {
///     let [x, y] = p;
///     let (r, jacobian) = ([10.0 * (y - x * x), 1.0 - x], [[-20.0 * x, 10.0], [-1.0, 0.0]]);
///     let column = |i: usize, j: usize| (0..2).map(|k| jacobian[k][i] * jacobian[k][j]).sum();
///     let normal = NormalMatrix::new(2, vec![column(0, 0), 0.0, column(1, 0), column(1, 1)])?;
///     let gradient = [0, 1].map(|i| (0..2).map(|k| jacobian[k][i] * r[k]).sum::<f64>());
///     let loss = 0.5 * (r[0] * r[0] + r[1] * r[1]);
///     let here = Evaluation { loss, loss_error: 0.0, gradient: &gradient };
///     optimizer.step(&mut p, &here, &normal)?;
/// }
/// assert!((p[0] - 1.0).abs() < 1e-9 && (p[1] - 1.0).abs() < 1e-9);
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawGaussNewton<T>", bound = "")]
pub struct GaussNewton<T: Scalar> {
    options: GaussNewtonOptions,
    rates: Rates,
    groups: Groups,
    steps: u64,
    #[serde(with = "crate::exact::number")]
    damping: f64,
    #[serde(with = "crate::exact::slice")]
    variables: Vec<T>,
    last: Option<Last<T>>,
}

/// The last step, until the next call judges it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(bound = "")]
struct Last<T: Scalar> {
    #[serde(with = "crate::exact::number")]
    loss: f64,
    #[serde(with = "crate::exact::number")]
    loss_error: f64,
    /// By how much the loss was to fall.
    #[serde(with = "crate::exact::number")]
    predicted: f64,
    /// Where it started and ended.
    #[serde(with = "crate::exact::slice")]
    from: Vec<T>,
    #[serde(with = "crate::exact::slice")]
    to: Vec<T>,
}

#[derive(Deserialize)]
#[serde(bound = "")]
struct RawGaussNewton<T: Scalar> {
    options: GaussNewtonOptions,
    rates: Rates,
    groups: Groups,
    steps: u64,
    #[serde(with = "crate::exact::number")]
    damping: f64,
    #[serde(with = "crate::exact::slice")]
    variables: Vec<T>,
    last: Option<Last<T>>,
}

impl<T: Scalar> TryFrom<RawGaussNewton<T>> for GaussNewton<T> {
    type Error = OptimError;
    fn try_from(raw: RawGaussNewton<T>) -> Result<Self, OptimError> {
        let RawGaussNewton {
            options,
            rates,
            groups,
            steps,
            damping,
            variables,
            last,
        } = raw;
        let mut out = Self::new(rates, groups, options)?;
        let in_range = DAMPING.contains(&damping);
        require(in_range, "damping", "a value in [1e-9, 1e9]", damping)?;
        let check = |what, values: &[T]| {
            require_len(what, out.groups.len(), values.len())?;
            require_finite(what, values)
        };
        check("variables", &variables)?;
        if let Some(l) = &last {
            check("last step", &l.from)?;
            check("last step", &l.to)?;
            require_finite("last step", &[l.loss, l.loss_error, l.predicted])?;
        }
        out.steps = steps;
        out.damping = damping;
        out.variables = variables;
        out.last = last;
        Ok(out)
    }
}

impl<T: Scalar> GaussNewton<T> {
    /// For the parameters of `groups`. Rates are fractions of a step, usually 1.
    ///
    /// # Errors
    /// Rates for another number of parameters, options out of their range, or a group whose entries move together
    /// ([`Groups::tie`]): the matrix is taken one entry at a time.
    pub fn new(
        rates: Rates,
        groups: Groups,
        options: GaussNewtonOptions,
    ) -> Result<Self, OptimError> {
        options.validate()?;
        require_len("rates", groups.len(), rates.len())?;
        if let Some(tied) = groups
            .iter()
            .find(|g| g.diffusion.is_some() || g.coarse.is_some())
        {
            return Err(OptimError::Tied {
                group: tied.name.clone(),
                expected: "entries that move by themselves, for Gauss-Newton steps".to_owned(),
                found: "a group that moves along a graph".to_owned(),
            });
        }
        Ok(Self {
            damping: options.damping,
            // The first step replaces what does not stand for its value.
            variables: vec![T::default(); groups.len()],
            options,
            rates,
            groups,
            steps: 0,
            last: None,
        })
    }

    /// The current damping.
    pub fn damping(&self) -> f64 {
        self.damping
    }

    /// Number of steps so far, without those that were taken back.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The fractions of a step and their schedule.
    pub fn rates(&self) -> &Rates {
        &self.rates
    }

    /// The groups.
    pub fn groups(&self) -> &Groups {
        &self.groups
    }

    /// Judges the last step by the loss that it led to, and takes it back or makes the next.
    ///
    /// # Errors
    /// A wrong length, a non-finite entry (also of a product with the curvature), or a result outside the
    /// scalar's range. Neither the parameters nor the optimiser have changed then.
    pub fn step(
        &mut self,
        params: &mut [T],
        here: &Evaluation<T>,
        curvature: &impl Curvature,
    ) -> Result<Outcome, OptimError> {
        let groups = &self.groups;
        let n = groups.len();
        check_inputs(n, params, here.gradient).map_err(|e| groups.locate(e))?;
        require_finite("loss", &[here.loss, here.loss_error])?;
        require_len("curvature", n, curvature.diagonal().len())?;
        require_finite("curvature", curvature.diagonal()).map_err(|e| groups.locate(e))?;
        let mut old = self.variables.clone();
        groups.refresh(0, params, &mut old)?;

        let judged = match self.last.as_ref().filter(|last| last.to == params) {
            Some(last) => last.verdict(here),
            None => Verdict::Unknown,
        };
        let damping = match judged {
            Verdict::Good => self.damping / 3.0,
            Verdict::Unknown => self.damping,
            Verdict::Poor => self.damping * 2.0,
            Verdict::Worse => self.damping * 4.0,
        };
        let damping = damping.clamp(*DAMPING.start(), *DAMPING.end());
        if let (Verdict::Worse, Some(last)) = (&judged, self.last.take()) {
            params.copy_from_slice(&last.from);
            self.damping = damping;
            return Ok(Outcome::TakenBack);
        }

        let gradient = groups.pull_back(0, &old, here.gradient)?;
        let model = Model {
            curvature,
            slopes: (0..n)
                .map(|i| groups.map_of(i).derivative(old[i]).to_f64())
                .collect(),
            gradient: gradient.iter().map(|g| g.to_f64()).collect(),
        };
        let bounds: Vec<_> = (0..n).map(|i| self.reach(i, old[i])).collect();
        let mut change = model.solve(damping, &bounds, &self.options)?;
        for (range, rate) in self.rates.at(self.steps) {
            change[range].iter_mut().for_each(|c| *c *= rate);
        }
        let mut new = old.clone();
        for (index, (u, c)) in new.iter_mut().zip(&change).enumerate() {
            *u = T::from_f64(u.to_f64() + c);
            if !u.is_finite() {
                let what = "Gauss-Newton step";
                return Err(OptimError::Overflow { what, index });
            }
        }
        let from = params.to_vec();
        groups.apply(0, &old, &mut new, params);
        self.last = Some(Last {
            loss: here.loss,
            loss_error: here.loss_error,
            predicted: model.decrease(&change)?,
            from,
            to: params.to_vec(),
        });
        self.variables = new;
        self.damping = damping;
        self.steps = self.steps.saturating_add(1);
        Ok(Outcome::Moved)
    }

    /// How far variable `i` may move, down and up.
    fn reach(&self, i: usize, u: T) -> [f64; 2] {
        let map = self.groups.map_of(i);
        [-1.0, 1.0].map(|sign| {
            let end = map.project(T::from_f64(sign * T::MAX.to_f64())).to_f64();
            let free = end - u.to_f64();
            if sign < 0.0 {
                free.clamp(-self.options.max_step, 0.0)
            } else {
                free.clamp(0.0, self.options.max_step)
            }
        })
    }
}

enum Verdict {
    Good,
    Unknown,
    Poor,
    Worse,
}

impl<T: Scalar> Last<T> {
    /// What the loss at the end of the step says about it.
    fn verdict(&self, here: &Evaluation<T>) -> Verdict {
        let rounding = ROUNDING * (self.loss.abs() + here.loss.abs());
        let margin = 2.0 * self.loss_error.hypot(here.loss_error) + rounding;
        let fell = self.loss - here.loss;
        if self.predicted <= margin {
            Verdict::Unknown
        } else if fell < -margin {
            Verdict::Worse
        } else if fell < 0.25 * self.predicted {
            Verdict::Poor
        } else if fell > 0.75 * self.predicted {
            Verdict::Good
        } else {
            Verdict::Unknown
        }
    }
}

/// The quadratic model of the objective in the variables.
struct Model<'a, C> {
    curvature: &'a C,
    /// dp/du.
    slopes: Vec<f64>,
    gradient: Vec<f64>,
}

impl<C: Curvature> Model<'_, C> {
    fn product(&self, v: &[f64]) -> Result<Vec<f64>, OptimError> {
        let scaled: Vec<f64> = v.iter().zip(&self.slopes).map(|(v, s)| v * s).collect();
        let mut out = vec![0.0; v.len()];
        self.curvature.product(&scaled, &mut out);
        out.iter_mut().zip(&self.slopes).for_each(|(o, s)| *o *= s);
        require_finite("curvature", &out)?;
        Ok(out)
    }

    /// By how much the objective falls.
    fn decrease(&self, change: &[f64]) -> Result<f64, OptimError> {
        let curved = 0.5 * dot(change, &self.product(change)?);
        let decrease = -(dot(&self.gradient, change) + curved);
        require_finite("curvature", &[decrease])?;
        Ok(decrease)
    }

    /// The minimum of the damped model among the changes within `reach`.
    fn solve(
        &self,
        damping: f64,
        reach: &[[f64; 2]],
        options: &GaussNewtonOptions,
    ) -> Result<Vec<f64>, OptimError> {
        let n = self.gradient.len();
        let squares = self.slopes.iter().map(|s| s * s);
        let diagonal: Vec<f64> = squares
            .zip(self.curvature.diagonal())
            .map(|(s, h)| s * h)
            .collect();
        let largest = diagonal.iter().copied().fold(0.0, f64::max);
        let least = (largest * LEAST_DIAGONAL).max(f64::MIN_POSITIVE);
        let scale: Vec<f64> = diagonal.iter().map(|d| d.max(least)).collect();
        // What stands at a bound and is pushed against it stays there.
        let mut fixed: Vec<Option<f64>> = (0..n)
            .map(|i| {
                let outwards = if self.gradient[i] > 0.0 {
                    reach[i][0]
                } else {
                    reach[i][1]
                };
                (outwards == 0.0).then_some(0.0)
            })
            .collect();
        // Every round fixes one more variable at least.
        loop {
            let change = self.conjugate_gradients(damping, &scale, &fixed, options)?;
            let mut again = false;
            for i in 0..n {
                let within = change[i].clamp(reach[i][0], reach[i][1]);
                if fixed[i].is_none() && within != change[i] {
                    fixed[i] = Some(within);
                    again = true;
                }
            }
            if !again {
                return Ok(change);
            }
        }
    }

    /// The minimum of the damped model over the variables that are not fixed.
    fn conjugate_gradients(
        &self,
        damping: f64,
        scale: &[f64],
        fixed: &[Option<f64>],
        options: &GaussNewtonOptions,
    ) -> Result<Vec<f64>, OptimError> {
        let damped = |v: &[f64]| -> Result<Vec<f64>, OptimError> {
            let mut out = self.product(v)?;
            for i in 0..v.len() {
                out[i] = match fixed[i] {
                    None => out[i] + damping * scale[i] * v[i],
                    Some(_) => 0.0,
                };
            }
            Ok(out)
        };
        let mut x: Vec<f64> = fixed.iter().map(|f| f.unwrap_or(0.0)).collect();
        let start = damped(&x)?;
        let residual = |i: usize| match fixed[i] {
            None => -self.gradient[i] - start[i],
            Some(_) => 0.0,
        };
        let mut r: Vec<f64> = (0..x.len()).map(residual).collect();
        let precondition = |r: &[f64]| -> Vec<f64> {
            let parts = r.iter().zip(scale);
            parts.map(|(r, s)| r / (s * (1.0 + damping))).collect()
        };
        let mut z = precondition(&r);
        let mut p = z.clone();
        let mut rz = dot(&r, &z);
        let goal = rz * options.tolerance * options.tolerance;
        for k in 0..options.products {
            if rz <= goal || rz <= 0.0 {
                break;
            }
            let hp = damped(&p)?;
            let curved = dot(&p, &hp);
            if curved <= 0.0 {
                // Noise. The preconditioned gradient is all that is known then.
                if k == 0 {
                    x.iter_mut().zip(&p).for_each(|(x, p)| *x += p);
                }
                break;
            }
            let a = rz / curved;
            x.iter_mut().zip(&p).for_each(|(x, p)| *x += a * p);
            r.iter_mut().zip(&hp).for_each(|(r, h)| *r -= a * h);
            z = precondition(&r);
            let next = dot(&r, &z);
            let b = next / rz;
            rz = next;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + b * *p);
        }
        require_finite("curvature", &x)?;
        Ok(x)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Parameterisation, Schedule};
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    /// Residuals and their Jacobian, row by row.
    type Residuals = fn(&[f64]) -> (Vec<f64>, Vec<Vec<f64>>);

    struct Problem {
        loss: f64,
        gradient: Vec<f64>,
        normal: NormalMatrix,
    }

    /// Half the sum of squares.
    fn least_squares((r, j): (Vec<f64>, Vec<Vec<f64>>)) -> Problem {
        let n = j[0].len();
        let sum = |f: &dyn Fn(usize) -> f64| (0..r.len()).map(f).sum::<f64>();
        let entries = (0..n * n).map(|k| sum(&|i| j[i][k / n] * j[i][k % n]));
        Problem {
            loss: sum(&|i| 0.5 * r[i] * r[i]),
            gradient: (0..n).map(|k| sum(&|i| j[i][k] * r[i])).collect(),
            normal: NormalMatrix::new(n, entries.collect()).unwrap(),
        }
    }

    fn optimizer<T: Scalar>(groups: Groups, options: GaussNewtonOptions) -> GaussNewton<T> {
        let rates = Rates::new(groups.len(), 1.0).unwrap();
        GaussNewton::new(rates, groups, options).unwrap()
    }

    fn free(n: usize) -> GaussNewton<f64> {
        let options = GaussNewtonOptions {
            max_step: f64::INFINITY,
            ..Default::default()
        };
        optimizer(Groups::new(n), options)
    }

    fn descend<T: Scalar>(
        o: &mut GaussNewton<T>,
        f: Residuals,
        p: &mut [T],
        steps: usize,
    ) -> Vec<Outcome> {
        let run = |_| {
            let x: Vec<f64> = p.iter().map(|x| x.to_f64()).collect();
            let problem = least_squares(f(&x));
            let gradient: Vec<T> = problem.gradient.iter().map(|g| T::from_f64(*g)).collect();
            let here = Evaluation {
                loss: problem.loss,
                loss_error: 0.0,
                gradient: &gradient,
            };
            o.step(p, &here, &problem.normal).unwrap()
        };
        (0..steps).map(run).collect()
    }

    fn rosenbrock(p: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let [x, y] = [p[0], p[1]];
        let r = vec![10.0 * (y - x * x), 1.0 - x];
        (r, vec![vec![-20.0 * x, 10.0], vec![-1.0, 0.0]])
    }

    /// Powell's singular function: the Jacobian at the solution 0 has rank 2 of 4.
    fn powell(p: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let (c, s) = (10f64.sqrt(), 5f64.sqrt());
        let (a, b) = (p[1] - 2.0 * p[2], p[0] - p[3]);
        (
            vec![p[0] + 10.0 * p[1], s * (p[2] - p[3]), a * a, c * b * b],
            vec![
                vec![1.0, 10.0, 0.0, 0.0],
                vec![0.0, 0.0, s, -s],
                vec![0.0, 2.0 * a, -4.0 * a, 0.0],
                vec![2.0 * c * b, 0.0, 0.0, -2.0 * c * b],
            ],
        )
    }

    /// Damping and the least diagonal are fractions of the curvature: an objective that is multiplied by a power of two
    /// gives the same steps bit by bit.
    #[test]
    fn the_scale_of_the_objective_does_not_matter() {
        let path = |scale: f64| {
            let mut groups = Groups::new(2);
            let bounded = Parameterisation::bounded(0.5, f64::INFINITY).unwrap();
            groups.add("x", 0..1, bounded).unwrap();
            let rates = Rates::new(2, 1.0).unwrap();
            let mut optimizer = GaussNewton::new(rates, groups, Default::default()).unwrap();
            let mut p = [2.0f64, -1.0];
            let mut path = Vec::new();
            for _ in 0..12 {
                let [x, y] = p;
                let r = [10.0 * (y - x * x), 1.0 - x];
                let gradient = [-20.0 * x * r[0] - r[1], 10.0 * r[0]].map(|g| g * scale);
                let matrix = [400.0 * x * x + 1.0, 0.0, -200.0 * x, 100.0].map(|m| m * scale);
                let here = Evaluation {
                    loss: 0.5 * (r[0] * r[0] + r[1] * r[1]) * scale,
                    loss_error: 0.0,
                    gradient: &gradient,
                };
                let matrix = NormalMatrix::new(2, matrix.to_vec()).unwrap();
                optimizer.step(&mut p, &here, &matrix).unwrap();
                path.extend(p);
            }
            path
        };
        let expected = path(1.0);
        assert!((expected[22] - 1.0).abs() < 1e-2, "{expected:?}");
        for exponent in [-300, -60, 60, 300] {
            assert_eq!(path(f64::from(exponent).exp2()), expected, "2^{exponent}");
        }
    }

    /// Linear with singular values from 1 to 1e-6, rotated by a Hilbert-like matrix.
    fn ill_conditioned(p: &[f64]) -> (Vec<f64>, Vec<Vec<f64>>) {
        let j: Vec<Vec<f64>> = (0..6)
            .map(|i| (0..6).map(|k| 1.0 / (1.0 + (i + k) as f64)).collect())
            .collect();
        let r = j.iter().map(|row| {
            let each = row.iter().zip(p).zip(1..);
            each.map(|((j, p), k)| j * (p - f64::from(k))).sum()
        });
        (r.collect(), j)
    }

    #[test]
    fn one_step_by_hand() {
        // H = diag(4, 1), g = (8, -3), damping 1: (H + H) step = -g.
        let options = GaussNewtonOptions {
            damping: 1.0,
            max_step: 10.0,
            ..Default::default()
        };
        let mut o = optimizer(Groups::new(2), options);
        let h = NormalMatrix::new(2, vec![4.0, 0.0, 0.0, 1.0]).unwrap();
        let mut p = [1.0, 1.0];
        let here = |gradient| Evaluation {
            loss: 9.0,
            loss_error: 0.0,
            gradient,
        };
        o.step(&mut p, &here(&[8.0, -3.0]), &h).unwrap();
        assert_relative_eq!(p[..], [0.0, 2.5], epsilon = 1e-12);
        // Predicted: 8 * 1 + 3 * 1.5 - (4 + 2.25) / 2 = 9.375; the loss fell by 9: damping 1/3.
        let end = Evaluation {
            loss: 0.0,
            ..here(&[0.0, 0.0])
        };
        o.step(&mut p, &end, &h).unwrap();
        assert_relative_eq!(o.damping(), 1.0 / 3.0);
        assert_relative_eq!(p[..], [0.0, 2.5], epsilon = 1e-12);
    }

    #[test]
    fn rosenbrock_is_solved_in_few_steps() {
        let mut p = [-1.2, 1.0];
        descend(&mut free(2), rosenbrock, &mut p, 60);
        assert_relative_eq!(p[..], [1.0, 1.0], epsilon = 1e-9);
        // In single precision, and with steps of limited length.
        let mut o = optimizer::<f32>(Groups::new(2), Default::default());
        let mut p = [-1.2f32, 1.0];
        descend(&mut o, rosenbrock, &mut p, 60);
        assert_relative_eq!(p[..], [1.0, 1.0], epsilon = 1e-5);
    }

    #[test]
    fn singular_jacobians_converge() {
        let mut p = [3.0, -1.0, 0.0, 1.0];
        descend(&mut free(4), powell, &mut p, 60);
        assert!(p.iter().all(|p| p.abs() < 1e-3), "{p:?}");
        // A parameter that nothing depends on stays where it is.
        let blind: Residuals = |p| (vec![p[0] - 2.0], vec![vec![1.0, 0.0]]);
        let mut p = [0.0, 7.0];
        descend(&mut free(2), blind, &mut p, 30);
        assert_relative_eq!(p[0], 2.0, epsilon = 1e-9);
        assert_eq!(p[1], 7.0);
    }

    #[test]
    fn ill_conditioned_quadratics_are_solved() {
        // Condition of the Jacobian 1.5e7, of the normal matrix 2e14.
        let mut p = [0.0; 6];
        descend(&mut free(6), ill_conditioned, &mut p, 200);
        let loss = least_squares(ill_conditioned(&p)).loss;
        let start = least_squares(ill_conditioned(&[0.0; 6])).loss;
        assert!(loss < 1e-12 * start, "{loss} of {start}");
    }

    #[test]
    fn a_step_that_failed_is_taken_back() {
        // The model says 10, the loss grows: back, and shorter.
        let mut o = free(1);
        let flat = NormalMatrix::new(1, vec![0.1]).unwrap();
        let mut p = [0.0];
        let here = |loss, gradient| Evaluation {
            loss,
            loss_error: 0.0,
            gradient,
        };
        assert_eq!(
            o.step(&mut p, &here(1.0, &[-1.0]), &flat),
            Ok(Outcome::Moved)
        );
        let (far, damping) = (p[0], o.damping());
        assert!(far > 9.0);
        let back = o.step(&mut p, &here(5.0, &[3.0]), &flat);
        assert_eq!((back, p[0]), (Ok(Outcome::TakenBack), 0.0));
        assert_relative_eq!(o.damping(), 4.0 * damping);
        o.step(&mut p, &here(1.0, &[-1.0]), &flat).unwrap();
        assert!(p[0] > 0.0 && p[0] < far);
        assert_eq!(o.steps(), 2);
        // Within its error the same growth tells nothing.
        let noisy = Evaluation {
            loss_error: 2.0,
            ..here(1.5, &[0.0][..])
        };
        assert_eq!(o.step(&mut p, &noisy, &flat), Ok(Outcome::Moved));
    }

    #[test]
    fn bounds_hold_and_the_rest_is_solved_around_them() {
        // Minimum at (-1, 2) without bounds; with x >= 0 at (0, 1), as the residuals couple: y = 1 - x.
        let coupled: Residuals = |p| {
            let (r, s) = (p[0] + p[1] - 1.0, 0.5 * (p[0] + 1.0));
            (vec![r, s], vec![vec![1.0, 1.0], vec![0.5, 0.0]])
        };
        let mut groups = Groups::new(2);
        let positive = Parameterisation::bounded(0.0, f64::INFINITY).unwrap();
        groups.add("x", 0..1, positive).unwrap();
        let mut o = optimizer::<f64>(groups.clone(), Default::default());
        let mut p = [3.0, 3.0];
        descend(&mut o, coupled, &mut p, 40);
        assert_eq!(p[0], 0.0);
        assert_relative_eq!(p[1], 1.0, epsilon = 1e-8);
        // And is let go when the minimum moves inside.
        let inside: Residuals = |p| {
            let (r, s) = (p[0] + p[1] - 1.0, 0.5 * (p[0] - 1.0));
            (vec![r, s], vec![vec![1.0, 1.0], vec![0.5, 0.0]])
        };
        let mut o = optimizer::<f64>(groups, Default::default());
        descend(&mut o, inside, &mut p, 40);
        assert_relative_eq!(p[..], [1.0, 0.0], epsilon = 1e-8);
    }

    #[test]
    fn variables_of_unknown_magnitude_move_by_factors() {
        // ln p - ln 0.02 over two orders of magnitude, at most a factor of e^0.5 per step.
        let f: Residuals = |p| (vec![(p[0] / 0.02).ln()], vec![vec![1.0 / p[0]]]);
        let mut groups = Groups::new(1);
        groups.add("alpha", 0..1, Parameterisation::log()).unwrap();
        let mut o = optimizer::<f64>(groups, Default::default());
        let mut p = [2.0];
        descend(&mut o, f, &mut p, 1);
        assert_relative_eq!(p[0], 2.0 * (-0.5f64).exp(), epsilon = 1e-12);
        descend(&mut o, f, &mut p, 20);
        assert_relative_eq!(p[0], 0.02, epsilon = 1e-9);
    }

    /// Harmonic steps average the noise of the gradient, and a noisy curvature (even a negative one) does
    /// not move the minimum.
    #[test]
    fn noisy_steps_average() {
        let rates = Rates::new(1, 1.0).unwrap();
        let rates = rates.with_schedule(Schedule::Harmonic { hold: 2 }).unwrap();
        let mut o = GaussNewton::new(rates, Groups::new(1), Default::default()).unwrap();
        let mut p = [1.0f64];
        let mut state = 7u64;
        let mut noise = || {
            state = state
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
        };
        for _ in 0..2000 {
            let (g, h) = (p[0] + noise(), 1.0 + 3.0 * noise());
            let h = NormalMatrix::new(1, vec![h]).unwrap();
            let here = Evaluation {
                loss: 1.0,
                loss_error: 1.0,
                gradient: &[g],
            };
            o.step(&mut p, &here, &h).unwrap();
        }
        // One step has an error of 0.3.
        assert!(p[0].abs() < 0.05, "{}", p[0]);
    }

    #[test]
    fn resumes_bit_by_bit() {
        let mut groups = Groups::new(2);
        let bounded = Parameterisation::bounded(-2.0, 2.0).unwrap();
        groups.add("x", 0..1, bounded).unwrap();
        let mut a = optimizer::<f32>(groups, Default::default());
        let mut p = [-1.2f32, 1.0];
        descend(&mut a, rosenbrock, &mut p, 5);
        let text = serde_json::to_string(&a).unwrap();
        let mut b: GaussNewton<f32> = serde_json::from_str(&text).unwrap();
        assert_eq!(a, b);
        let mut q = p;
        let (x, y) = (
            descend(&mut a, rosenbrock, &mut p, 7),
            descend(&mut b, rosenbrock, &mut q, 7),
        );
        assert_eq!((x, p, a), (y, q, b));
        for (from, to) in [
            ("\"steps\":", "\"steps\":-"),
            ("\"damping\":\"", "\"damping\":\"-"),
            ("\"variables\":\"", "\"variables\":\"00000000"),
            ("\"tolerance\":\"1e-6\"", "\"tolerance\":\"2\""),
        ] {
            assert!(text.contains(from), "{text}");
            let damaged = text.replacen(from, to, 1);
            assert!(
                serde_json::from_str::<GaussNewton<f32>>(&damaged).is_err(),
                "{to}"
            );
        }
    }

    #[test]
    fn errors_name_what_was_expected_and_change_nothing() {
        let mut groups = Groups::new(2);
        groups
            .add("wall", 0..2, Parameterisation::Identity)
            .unwrap();
        let mut o = optimizer::<f64>(groups, Default::default());
        let h = NormalMatrix::new(2, vec![1.0, 0.0, 0.0, 1.0]).unwrap();
        let small = NormalMatrix::new(1, vec![1.0]).unwrap();
        let before = o.clone();
        let mut p = [1.0, 2.0];
        let mut message = |loss, gradient: &[f64], h: &NormalMatrix| {
            let here = Evaluation {
                loss,
                loss_error: 0.0,
                gradient,
            };
            o.step(&mut p, &here, h).unwrap_err().to_string()
        };
        assert_eq!(
            message(1.0, &[1.0, f64::NAN], &h),
            "gradient: expected a finite value, found NaN at index 1 (in `wall`)"
        );
        assert_eq!(
            message(f64::INFINITY, &[1.0, 1.0], &h),
            "loss: expected a finite value, found inf at index 0"
        );
        assert_eq!(
            message(1.0, &[1.0, 1.0], &small),
            "curvature: expected 2 entries, found 1"
        );
        assert_eq!((o, p), (before, [1.0, 2.0]));
        assert_eq!(
            NormalMatrix::new(1, vec![f64::NAN])
                .unwrap_err()
                .to_string(),
            "curvature: expected a finite value, found NaN at index 0"
        );
        for (options, name) in [
            ((0.0, 1.0, 0.5, 1), "damping"),
            ((1.0, f64::NAN, 0.5, 1), "max_step"),
            ((1.0, 1.0, 1.0, 1), "tolerance"),
            ((1.0, 1.0, 0.5, 0), "products"),
        ] {
            let (damping, max_step, tolerance, products) = options;
            let options = GaussNewtonOptions {
                damping,
                max_step,
                tolerance,
                products,
            };
            let rates = Rates::new(1, 1.0).unwrap();
            let error = GaussNewton::<f32>::new(rates, Groups::new(1), options).unwrap_err();
            assert!(error.to_string().starts_with(name), "{error}");
        }
    }

    proptest! {
        #[test]
        fn never_a_panic_nor_a_nan(
            p in prop::collection::vec(any::<f32>(), 3),
            g in prop::collection::vec(any::<f32>(), 3),
            h in prop::collection::vec(any::<f64>(), 9),
            loss in any::<f64>(),
        ) {
            let mut groups = Groups::new(3);
            groups.add("a", 0..1, Parameterisation::bounded(0.0, 1.0).unwrap()).unwrap();
            groups.add("b", 1..2, Parameterisation::log()).unwrap();
            let mut o = optimizer::<f32>(groups, Default::default());
            let mut p = p;
            if let Ok(h) = NormalMatrix::new(3, h) {
                for _ in 0..2 {
                    let here = Evaluation { loss, loss_error: 0.0, gradient: &g };
                    if o.step(&mut p, &here, &h).is_ok() {
                        prop_assert!(p.iter().all(|p| p.is_finite()));
                        prop_assert!((0.0..=1.0).contains(&p[0]) && p[1] > 0.0);
                    }
                }
            }
        }
    }
}
