//! Proofs of roots: one and no other within a box.

use crate::dual::Dual;
use crate::interval::Interval;
use crate::mat::solve_dense;
use crate::real::{Real, array};
use crate::vjp::DiffFn;

/// What is known of a root that is the only one in its box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Isolated {
    /// Largest distance of a component from the middle of the box.
    pub error: f64,
    /// By how much simplified Newton steps contract in the box, at least. Where it is below a third, Newton's method goes to
    /// the root from everywhere in the largest ball around it, in the maximum norm, that lies in the box.
    pub contraction: f64,
}

/// Values and derivatives of a function of `N` numbers that are bounded over a box: `y[i].eps[j]` by number `j`.
pub type Bounded<const N: usize> = [Dual<Interval, N>; N];

/// Largest difference of bounds that are the same but for roundings, over their size.
const SAME: f64 = 1e-6;

/// The numbers at most `radius` from `x`, as variables; twice, with different ends deciding. See [`Interval`].
pub fn box_around<const N: usize>(x: [f64; N], radius: f64) -> [[Dual<Interval, N>; N]; 2] {
    let bounds = array(|i| Interval::around(x[i], radius));
    let variables = |b: [Interval; N]| array(|i| Dual::var(b[i], i));
    [
        variables(bounds),
        variables(array(|i| bounds[i].deciding_by_upper())),
    ]
}

/// The bounds of a function that was evaluated both ways ([`box_around`]); `None` where some decision is not the same in the
/// whole box, unless it moves all bounds by less than a millionth, as roundings do.
pub fn decided<const N: usize>([a, b]: [Bounded<N>; 2]) -> Option<Bounded<N>> {
    let agree = |a: Interval, b: Interval| {
        let off = f64::max((a.lo() - b.lo()).abs(), (a.hi() - b.hi()).abs());
        // Written so that NaN, of bounds that are none, fails.
        off <= SAME * (1.0 + a.magnitude())
    };
    let same = |a: &Dual<Interval, N>, b: &Dual<Interval, N>| {
        agree(a.re, b.re) && (0..N).all(|j| agree(a.eps[j], b.eps[j]))
    };
    let joined = |i: usize| {
        let (a, b): (Dual<Interval, N>, Dual<Interval, N>) = (a[i], b[i]);
        Dual::new(a.re.hull(b.re), array(|j| a.eps[j].hull(b.eps[j])))
    };
    let all = a.iter().zip(&b).all(|(a, b)| same(a, b));
    all.then(|| array(joined))
}

/// A number that is bounded over a box, no wider than the mean value theorem says: it differs from its value in the middle,
/// `at`, by no more than its derivatives over the box let it. Long computations over intervals forget that their numbers
/// depend on each other; this brings back what is of first order.
#[must_use]
pub fn tightened<const N: usize>(
    x: Dual<Interval, N>,
    at: Interval,
    radius: f64,
) -> Dual<Interval, N> {
    let off = Interval::new(-radius, radius);
    let near = (x.eps.iter()).fold(at, |sum, slope| sum + *slope * off);
    Dual::new(x.re.and(near), x.eps)
}

/// Bounds of the Newton step from a point, in the maximum norm: how large a box has to be at least. `at` bounds the function
/// there and its derivatives. `None` where these may be singular.
pub fn newton_step<const N: usize>(at: &Bounded<N>) -> Option<f64> {
    Some(step(&inverse(at)?, at))
}

/// An approximate inverse of the Jacobian.
fn inverse<const N: usize>(of: &Bounded<N>) -> Option<[[f64; N]; N]> {
    let middle: [[f64; N]; N] = array_of(|i, j| of[i].eps[j].middle());
    let mut inverse: [[f64; N]; N] = [[0.0; N]; N];
    for k in 0..N {
        let unit = array(|i| if i == k { 1.0 } else { 0.0 });
        for (row, x) in inverse.iter_mut().zip(solve_dense(middle, unit)?) {
            row[k] = x;
        }
    }
    Some(inverse)
}

fn product<const N: usize>(row: &[f64; N], column: impl Fn(usize) -> Interval) -> Interval {
    (0..N).map(|k| Interval::lift(row[k]) * column(k)).sum()
}

fn step<const N: usize>(inverse: &[[f64; N]; N], at: &Bounded<N>) -> f64 {
    let rows = inverse
        .iter()
        .map(|row| product(row, |k| at[k].re).magnitude());
    rows.fold(0.0, f64::max)
}

/// Proves that a function has one root and no other at most `radius` from a point, in the maximum norm, and says how near.
/// `None` where that cannot be shown: it is no proof that there is none. Never panics.
///
/// `at` bounds the function at the point, `over` its derivatives in the box; both from [`decided`] or from functions without
/// branches.
///
/// # Source
/// [Krawczyk 1969] in the form of [Neumaier 1990, section 5.1]: with `Y` an approximate inverse of the Jacobian in the middle,
/// `-Y f(x) + (1 - Y J) [-r, r]` in the inside of `[-r, r]`.
pub fn isolated<const N: usize>(
    at: &Bounded<N>,
    over: &Bounded<N>,
    radius: f64,
) -> Option<Isolated> {
    let inverse = inverse(over)?;
    let step = step(&inverse, at);
    // Of `1 - Y J`, in the maximum norm.
    let mut contraction: f64 = 0.0;
    for (i, row) in inverse.iter().enumerate() {
        let off = (0..N).map(|j| {
            let one = if i == j { 1.0 } else { 0.0 };
            let entry = product(row, |k| over[k].eps[j]) - Interval::lift(one);
            Interval::lift(entry.magnitude())
        });
        contraction = contraction.max(off.sum::<Interval>().hi());
    }
    let moved = Interval::lift(step) + Interval::lift(contraction) * Interval::lift(radius);
    let shown = contraction < 1.0 && moved.hi() < radius;
    let error = Interval::lift(step) / (Interval::lift(1.0) - Interval::lift(contraction));
    shown.then(|| Isolated {
        error: error.hi(),
        contraction,
    })
}

/// Proves that a function has no root at most `radius` from a point, in the maximum norm. `false` where that cannot be shown.
/// Never panics.
///
/// `at` bounds the function at the point, `over` its values and derivatives in the box, as for [`isolated`].
///
/// # Source
/// The mean value form, as it is and times an approximate inverse of the Jacobian [Neumaier 1990, section 5.1].
pub fn rootless<const N: usize>(at: &Bounded<N>, over: &Bounded<N>, radius: f64) -> bool {
    let off = Interval::new(-radius, radius);
    let apart = |x: Interval| x.lo() > 0.0 || x.hi() < 0.0;
    let own = at.iter().zip(over).any(|(at, over)| {
        let near = (over.eps.iter()).fold(at.re, |sum, slope| sum + *slope * off);
        apart(over.re) || apart(near)
    });
    let across = || {
        let row = |row: &[f64; N]| {
            let here = product(row, |k| at[k].re);
            let slopes = (0..N).map(|j| product(row, |k| over[k].eps[j]) * off);
            here + slopes.sum::<Interval>()
        };
        inverse(over).is_some_and(|inverse| inverse.iter().any(|r| apart(row(r))))
    };
    own || across()
}

fn array_of<const N: usize>(f: impl Fn(usize, usize) -> f64) -> [[f64; N]; N] {
    let mut all = [[0.0; N]; N];
    for (i, row) in all.iter_mut().enumerate() {
        for (j, x) in row.iter_mut().enumerate() {
            *x = f(i, j);
        }
    }
    all
}

/// Proves that `f` has one root and no other at most `radius` from `x` in every component: [`isolated`] of a function that
/// is smooth there. `None` where that cannot be shown.
///
/// ```
/// use ad_core::{diff_fn, krawczyk};
/// diff_fn! { fn circle_and_line<R>([x, y]: [R; 2]) -> [R; 2] {
///     [x * x + y * y - R::c(2.0), x - y]
/// } }
/// let root = krawczyk(&circle_and_line, [1.0 + 1e-9, 1.0], 0.2).expect("one root");
/// assert!(root.error < 2e-9 && root.contraction < 0.5);
/// // The other one is at (-1, -1).
/// assert!(krawczyk(&circle_and_line, [0.0, 0.0], 1.5).is_none());
/// ```
pub fn krawczyk<F: DiffFn<N, N>, const N: usize>(
    f: &F,
    x: [f64; N],
    radius: f64,
) -> Option<Isolated> {
    let bounds = |radius: f64| decided(box_around(x, radius).map(|x| f.eval(x)));
    isolated(&bounds(0.0)?, &bounds(radius)?, radius)
}
