//! Small matrices and linear solves, in numbers and in duals.

use ad_core::{
    Dual, Float, Mat2, Mat3, Real, Vec2, Vec3, block_tridiagonal_solve, check, diff_fn, solve_dense,
};

/// A deterministic stream of numbers in [-1, 1).
struct Stream(u64);

impl Stream {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        2.0 * f64::from_bits_unit(self.0) - 1.0
    }

    fn mat2(&mut self, diagonal: f64) -> Mat2<f64> {
        let [a, b, c, d] = std::array::from_fn(|_| self.next());
        Mat2::from_rows([[a + diagonal, b], [c, d + diagonal]])
    }
}

const BLOCKS: usize = 6;
const SIZE: usize = 2 * BLOCKS;

struct System {
    lower: [Mat2<f64>; BLOCKS],
    diag: [Mat2<f64>; BLOCKS],
    upper: [Mat2<f64>; BLOCKS],
    rhs: [Vec2<f64>; BLOCKS],
}

impl System {
    fn new(seed: u64) -> Self {
        let mut s = Stream(seed);
        Self {
            lower: std::array::from_fn(|_| s.mat2(0.0)),
            diag: std::array::from_fn(|_| s.mat2(4.0)),
            upper: std::array::from_fn(|_| s.mat2(0.0)),
            rhs: std::array::from_fn(|_| Vec2::new(s.next(), s.next())),
        }
    }

    fn dense(&self) -> ([[f64; SIZE]; SIZE], [f64; SIZE]) {
        let mut a = [[0.0; SIZE]; SIZE];
        for i in 0..BLOCKS {
            for (r, c) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                a[2 * i + r][2 * i + c] = self.diag[i].rows[r][c];
                if i > 0 {
                    a[2 * i + r][2 * i - 2 + c] = self.lower[i].rows[r][c];
                }
                if i + 1 < BLOCKS {
                    a[2 * i + r][2 * i + 2 + c] = self.upper[i].rows[r][c];
                }
            }
        }
        (a, std::array::from_fn(|k| self.rhs[k / 2][k % 2]))
    }
}

#[test]
fn block_tridiagonal_equals_dense() {
    for seed in 1..20 {
        let mut s = System::new(seed);
        let (a, b) = s.dense();
        let dense = solve_dense(a, b).expect("diagonally dominant");
        let ok = block_tridiagonal_solve(&s.lower, &mut s.diag, &s.upper, &mut s.rhs);
        assert!(ok);
        for (k, x) in dense.into_iter().enumerate() {
            assert!(
                (s.rhs[k / 2][k % 2] - x).abs() < 1e-13,
                "seed {seed}, row {k}"
            );
        }
        // And both solve the system.
        for (row, b) in a.iter().zip(b) {
            let ax: f64 = row.iter().zip(dense).map(|(a, x)| a * x).sum();
            assert!((ax - b).abs() < 1e-13);
        }
    }
}

#[test]
fn block_tridiagonal_refuses_what_it_cannot_solve() {
    let mut s = System::new(3);
    s.diag[0] = Mat2::default();
    assert!(!block_tridiagonal_solve(
        &s.lower,
        &mut s.diag,
        &s.upper,
        &mut s.rhs
    ));
    let mut s = System::new(3);
    assert!(!block_tridiagonal_solve(
        &s.lower[1..],
        &mut s.diag,
        &s.upper,
        &mut s.rhs
    ));
    let mut s = System::new(3);
    s.diag[BLOCKS - 1].rows[0][0] = f64::NAN;
    assert!(!block_tridiagonal_solve(
        &s.lower,
        &mut s.diag,
        &s.upper,
        &mut s.rhs
    ));
    assert!(block_tridiagonal_solve::<f64>(&[], &mut [], &[], &mut []));
}

#[test]
fn inverse_and_solve() {
    let mut s = Stream(7);
    for _ in 0..50 {
        let a = s.mat2(1.0);
        let b = Mat3::from_rows(std::array::from_fn(|_| std::array::from_fn(|_| s.next())));
        let (v2, v3) = (
            Vec2::new(s.next(), s.next()),
            Vec3::new(s.next(), s.next(), s.next()),
        );
        if a.determinant().abs() < 0.1 || b.determinant().abs() < 0.1 {
            continue;
        }
        let i2 = a * a.inverse().expect("regular");
        let i3 = b * b.inverse().expect("regular");
        let id2: f64 = (i2 - Mat2::identity())
            .rows
            .iter()
            .flatten()
            .map(|x| x.abs())
            .sum();
        let id3: f64 = (i3 - Mat3::identity())
            .rows
            .iter()
            .flatten()
            .map(|x| x.abs())
            .sum();
        assert!(id2 < 1e-13 && id3 < 1e-12, "{id2} {id3}");
        let (x2, x3) = (a.solve(v2).expect("regular"), b.solve(v3).expect("regular"));
        assert!((a * x2 - v2).length() < 1e-13 && (b * x3 - v3).length() < 1e-12);
        // Transposition: (b^T x) . y = x . (b y).
        assert!(((b.transpose() * x3).dot(v3) - x3.dot(b * v3)).abs() < 1e-12);
        assert_eq!(Mat3::from_cols([b.col(0), b.col(1), b.col(2)]), b);
    }
}

#[test]
fn singular_and_non_finite_matrices_have_no_inverse() {
    let flat = Mat3::from_rows([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [0.0, 1.0, 0.0]]);
    assert!(flat.inverse().is_none() && flat.solve(Vec3::splat(1.0)).is_none());
    let mut nan = Mat2::<f32>::identity();
    nan.rows[1][0] = f32::NAN;
    assert!(nan.inverse().is_none());
    assert!(solve_dense([[0.0f32]], [1.0]).is_none());
    assert!(solve_dense([[1.0, f64::NAN], [0.0, 1.0]], [1.0, 1.0]).is_none());
}

#[test]
fn elimination_pivots() {
    // Fails without row exchanges: the first pivot is zero.
    let x = solve_dense(
        [[0.0, 1.0, 0.0], [2.0, 0.0, 1.0], [0.0, 1.0, 1.0]],
        [3.0, 4.0, 5.0],
    );
    assert_eq!(x, Some([1.0, 3.0, 2.0]));
}

diff_fn! {
    /// The solution of a 3x3 and of a block-tridiagonal system as functions of their entries.
    fn solutions<R>([a, b, c]: [R; 3]) -> [R; 7] {
        let m = Mat3::from_rows([
            [a, b, R::of(0.2)],
            [R::of(-0.3), c, b * a],
            [R::of(0.5), a * c, R::of(2.0)],
        ]);
        let x = m.solve(Vec3::new(b, R::one(), c)).expect("regular");
        let block = |s: R| Mat2::from_rows([[s + R::c(4.0), b], [c, a + R::c(3.0)]]);
        let off = [Mat2::from_rows([[a, R::zero()], [b, c]]); 3];
        let mut rhs = [Vec2::new(a, b), Vec2::new(c, a), Vec2::new(b, c)];
        let mut diag = [block(a), block(b), block(c)];
        assert!(block_tridiagonal_solve(&off, &mut diag, &off, &mut rhs));
        let dense = solve_dense(m.rows, [c, a, b]).expect("regular");
        [x.x, x.y, x.z, rhs[0].x, rhs[2].y, dense[0], dense[2]]
    }
}

#[test]
fn solves_are_differentiable() {
    let report = check::jacobian_by_differences(&solutions, [1.2, 0.4, 1.7], 1e-9);
    assert!(report.passed(), "{report}");
}

#[test]
fn vectors() {
    let (a, b) = (Vec3::new(1.0, 2.0, 3.0f32), Vec3::new(-2.0, 0.5, 4.0));
    assert_eq!(a.cross(b).dot(a), 0.0);
    assert_eq!(a.cross(b), Vec3::new(6.5, -10.0, 4.5));
    assert_eq!(a.dot(b), a.dot_const(b));
    assert_eq!(a.lerp(b, 0.5), Vec3::new(-0.5, 1.25, 3.5));
    assert_eq!(
        (b.min_component(), b.max_component(), b.max_abs()),
        (-2.0, 4.0, 4.0)
    );
    assert_eq!(Vec2::new(1.0, 2.0).perp_dot(Vec2::new(3.0, 5.0)), -1.0);
    assert_eq!([a[0], a[1], a[2]], a.to_array());
    assert!(!Vec3::new(f32::NAN, 0.0, 0.0).is_finite());
    let d = Vec3::<Dual<f32, 1>>::lift(a);
    assert_eq!(d.primal(), a);
    assert!(!(d * d.x).y.has_tangent());
}
