//! Small dense matrices and the block-tridiagonal solve of specular manifolds.

use std::ops::{Add, Mul, Sub};

use crate::real::{Float, Real, array};
use crate::vec::{Vec2, Vec3};

/// A 2x2 matrix, stored by rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mat2<R> {
    /// Rows.
    pub rows: [[R; 2]; 2],
}

/// A 3x3 matrix, stored by rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mat3<R> {
    /// Rows.
    pub rows: [[R; 3]; 3],
}

/// Whether a determinant can be divided by: finite, and its reciprocal too.
#[inline]
fn invertible<R: Real>(det: R) -> bool {
    det.primal().abs() >= R::Primal::MIN_POSITIVE && det.primal().is_finite()
}

macro_rules! matrix {
    ($M:ident, $V:ident, $n:literal, $($f:ident = $i:tt),*) => {
        impl<R: Real> $M<R> {
            /// A matrix from its rows.
            #[inline]
            pub fn from_rows(rows: [[R; $n]; $n]) -> Self {
                Self { rows }
            }
            /// A matrix from its columns.
            #[inline]
            pub fn from_cols(cols: [$V<R>; $n]) -> Self {
                Self { rows: [$(array(|j| cols[j][$i])),*] }
            }
            /// The identity.
            #[inline]
            pub fn identity() -> Self {
                Self::diagonal($V::splat(R::one()))
            }
            /// The diagonal matrix of `d`.
            #[inline]
            pub fn diagonal(d: $V<R>) -> Self {
                Self {
                    rows: [$(array(|j| if j == $i { d[j] } else { R::zero() })),*],
                }
            }
            /// Row `i`.
            #[inline]
            pub fn row(&self, i: usize) -> $V<R> {
                self.rows[i].into()
            }
            /// Column `j`.
            #[inline]
            pub fn col(&self, j: usize) -> $V<R> {
                $V { $($f: self.rows[$i][j]),* }
            }
            /// The transpose.
            #[inline]
            pub fn transpose(self) -> Self {
                Self { rows: [$(array(|j| self.rows[j][$i])),*] }
            }
            /// The inverse, or `None` if the matrix is singular or not finite.
            #[inline]
            pub fn inverse(self) -> Option<Self> {
                let det = self.determinant();
                invertible(det).then(|| {
                    let r = det.recip();
                    self.adjugate() * r
                })
            }
            /// Solves `self x = b`; `None` if the matrix is singular or not finite.
            #[inline]
            pub fn solve(self, b: $V<R>) -> Option<$V<R>> {
                let det = self.determinant();
                invertible(det).then(|| self.adjugate() * b / det)
            }
            /// Whether all values and tangents are finite.
            #[inline]
            pub fn is_finite(self) -> bool {
                self.rows.iter().flatten().all(|x| x.is_finite())
            }
        }

        impl<R: Real> Mul<$V<R>> for $M<R> {
            type Output = $V<R>;
            #[inline]
            fn mul(self, v: $V<R>) -> $V<R> {
                $V { $($f: self.row($i).dot(v)),* }
            }
        }
        impl<R: Real> Mul for $M<R> {
            type Output = Self;
            #[inline]
            fn mul(self, o: Self) -> Self {
                Self {
                    rows: [$(array(|j| self.row($i).dot(o.col(j)))),*],
                }
            }
        }
        impl<R: Real> Mul<R> for $M<R> {
            type Output = Self;
            #[inline]
            fn mul(self, s: R) -> Self {
                Self { rows: [$(array(|j| self.rows[$i][j] * s)),*] }
            }
        }
        impl<R: Real> Add for $M<R> {
            type Output = Self;
            #[inline]
            fn add(self, o: Self) -> Self {
                Self {
                    rows: [$(array(|j| self.rows[$i][j] + o.rows[$i][j])),*],
                }
            }
        }
        impl<R: Real> Sub for $M<R> {
            type Output = Self;
            #[inline]
            fn sub(self, o: Self) -> Self {
                Self {
                    rows: [$(array(|j| self.rows[$i][j] - o.rows[$i][j])),*],
                }
            }
        }
    };
}

matrix!(Mat2, Vec2, 2, x = 0, y = 1);
matrix!(Mat3, Vec3, 3, x = 0, y = 1, z = 2);

impl<R: Real> Mat2<R> {
    /// The determinant.
    #[inline]
    pub fn determinant(self) -> R {
        let [[a, b], [c, d]] = self.rows;
        a * d - b * c
    }

    fn adjugate(self) -> Self {
        let [[a, b], [c, d]] = self.rows;
        Self {
            rows: [[d, -b], [-c, a]],
        }
    }
}

impl<R: Real> Mat3<R> {
    /// The determinant.
    #[inline]
    pub fn determinant(self) -> R {
        self.row(0).dot(self.row(1).cross(self.row(2)))
    }

    fn adjugate(self) -> Self {
        let [a, b, c] = [self.row(0), self.row(1), self.row(2)];
        Self::from_cols([b.cross(c), c.cross(a), a.cross(b)])
    }
}

/// Solves a block-tridiagonal system of `n` 2x2 blocks by block elimination (block Thomas).
///
/// Row `i` reads `lower[i] x[i-1] + diag[i] x[i] + upper[i] x[i+1] = rhs[i]`; `lower[0]` and
/// `upper[n-1]` are ignored. The solution replaces `rhs`, and `diag` is overwritten: no memory is
/// allocated. Returns false, with `rhs` unspecified, if an elimination step meets a singular block
/// or the slices differ in length. Blocks are not pivoted against each other, which is sound for
/// the block-diagonally dominant systems of manifold walks.
pub fn block_tridiagonal_solve<R: Real>(
    lower: &[Mat2<R>],
    diag: &mut [Mat2<R>],
    upper: &[Mat2<R>],
    rhs: &mut [Vec2<R>],
) -> bool {
    let n = diag.len();
    if lower.len() != n || upper.len() != n || rhs.len() != n {
        return false;
    }
    for i in 1..n {
        let Some(inv) = diag[i - 1].inverse() else {
            return false;
        };
        let factor = lower[i] * inv;
        diag[i] = diag[i] - factor * upper[i - 1];
        rhs[i] -= factor * rhs[i - 1];
    }
    for i in (0..n).rev() {
        let known = if i + 1 < n {
            rhs[i] - upper[i] * rhs[i + 1]
        } else {
            rhs[i]
        };
        let Some(x) = diag[i].solve(known) else {
            return false;
        };
        rhs[i] = x;
    }
    true
}

/// Solves a dense `N x N` system by elimination with partial pivoting on primal values; `None` if
/// the matrix is singular to the last pivot or not finite.
pub fn solve_dense<R: Real, const N: usize>(mut a: [[R; N]; N], mut b: [R; N]) -> Option<[R; N]> {
    for k in 0..N {
        let mut p = k;
        for i in k + 1..N {
            if a[i][k].primal().abs() > a[p][k].primal().abs() {
                p = i;
            }
        }
        if !invertible(a[p][k]) {
            return None;
        }
        a.swap(k, p);
        b.swap(k, p);
        let pivot = a[k];
        for i in k + 1..N {
            let factor = a[i][k] / pivot[k];
            for (x, p) in a[i][k..].iter_mut().zip(&pivot[k..]) {
                *x -= factor * *p;
            }
            let known = b[k];
            b[i] -= factor * known;
        }
    }
    for k in (0..N).rev() {
        let mut x = b[k];
        for j in k + 1..N {
            x -= a[k][j] * b[j];
        }
        b[k] = x / a[k][k];
    }
    b.iter().all(|x| x.is_finite()).then_some(b)
}
