//! Bounds by intervals, and proofs of roots by them.

use ad_core::krawczyk::{box_around, decided, rootless};
use ad_core::{DiffFn, Dual, Interval, NewtonOptions, Real, diff_fn, krawczyk, newton};
use proptest::prelude::*;

/// Every function of one number that is smooth around it.
fn all<R: Real>(x: R) -> Vec<R> {
    let positive = x.square() + R::c(0.5);
    let small = x.tanh() * R::c(0.9);
    let (s, c) = x.sin_cos();
    vec![
        -x,
        x + x * x,
        x - x.square() * R::c(0.3),
        x / positive,
        R::c(2.0) / positive,
        positive.sqrt(),
        positive.recip(),
        positive.cbrt(),
        x.exp(),
        x.exp_m1(),
        positive.ln(),
        positive.ln_1p(),
        x.sin(),
        x.cos(),
        s * c,
        small.tan(),
        small.asin(),
        small.acos(),
        x.atan(),
        x.atan2(positive),
        positive.atan2(x),
        x.sinh(),
        x.cosh(),
        x.powi(3),
        positive.powi(-2),
        positive.powf(x),
        x.hypot(positive),
        (x + R::c(9.0)).abs(),
        x.erf(),
        x.mul_add(positive, x),
        positive.div_into(R::c(3.0)),
        x.max(positive + R::c(9.0)),
    ]
}

proptest! {
    /// Values and derivatives at points lie within the bounds of a box around them, of boxes of any size down to a point.
    #[test]
    fn bounds_hold(x in -3.0f64..3.0, size in -16.0f64..0.5, at in -1.0f64..1.0) {
        let radius = 10f64.powf(size);
        let inside = (x + at * radius).clamp(x - radius, x + radius);
        let point = all(Dual::<f64, 1>::var(inside, 0));
        let bounds = all(Dual::<Interval, 1>::var(Interval::around(x, radius), 0));
        for (i, (p, b)) in point.iter().zip(&bounds).enumerate() {
            prop_assert!(b.re.contains(p.re), "{i}: {} not in {:?}", p.re, b.re);
            // Derivatives at points are rounded themselves.
            let off = 1e-12 * (1.0 + p.eps[0].abs());
            let slope = b.eps[0].hull(b.eps[0] + Interval::new(-off, off));
            prop_assert!(slope.contains(p.eps[0]), "{i}: {} not in {slope:?}", p.eps[0]);
        }
    }
}

/// Bounds are no wider than they need to be: in proportion to small boxes, and of a point to rounding.
#[test]
fn bounds_are_narrow() {
    for radius in [0.0, 1e-9, 1e-5] {
        for (i, y) in all(Interval::around(0.7, radius)).iter().enumerate() {
            assert!(y.width() < 100.0 * radius + 1e-13, "{i}: {y:?}");
        }
    }
}

/// What is undefined somewhere, or has no bound, is the whole line; nothing is no number.
#[test]
fn what_has_no_bound_is_the_whole_line() {
    let around_zero = Interval::new(-1.0, 2.0);
    let whole = [
        around_zero.sqrt(),
        around_zero.recip(),
        around_zero.ln(),
        around_zero.powf(around_zero),
        Interval::new(1.0, 2.0).tan(),
        Interval::new(f64::NAN, 1.0),
        Interval::new(2.0, 1.0),
        Interval::LINE - Interval::LINE,
        Interval::lift(0.0) * Interval::LINE,
        Interval::LINE / Interval::LINE,
        Interval::around(f64::NAN, 1.0),
    ];
    for (i, y) in whole.iter().enumerate() {
        assert!(y.contains(-1e300) && y.contains(1e300), "{i}: {y:?}");
    }
    for y in all(Interval::LINE) {
        assert!(y.lo() <= y.hi(), "{y:?}");
    }
    // Zero times infinity is zero, in any place.
    let inf = f64::INFINITY;
    let ends = [-inf, -2.0, 0.0, 1.0, inf];
    let every = || {
        let pairs = ends.iter().flat_map(|&a| ends.map(|b| (a, b)));
        pairs
            .filter(|(a, b)| a < b || (a == b && a.is_finite()))
            .map(|(a, b)| Interval::new(a, b))
    };
    for (x, y) in every().flat_map(|x| every().map(move |y| (x, y))) {
        let within = |i: Interval| [i.lo().max(-1e300), i.hi().min(1e300)];
        for (a, b) in within(x)
            .into_iter()
            .flat_map(|a| within(y).map(|b| (a, b)))
        {
            assert!((x * y).contains(a * b), "{x:?} {y:?}");
            assert!(b == 0.0 || (x / y).contains(a / b), "{x:?} {y:?}");
            assert!(
                (x + y).contains(a + b) && (x - y).contains(a - b),
                "{x:?} {y:?}"
            );
        }
    }
    let turn = Interval::new(-1.0, 1.0).atan2(Interval::new(-2.0, -1.0));
    assert!(turn.contains(3.1) && turn.contains(-3.1));
    assert!(Interval::new(1.0, 8.0).sin().contains(-1.0));
    assert!(Interval::new(-7.0, -6.0).cos().contains(1.0));
    assert!(
        Interval::new(0.5, 1.5)
            .rem_euclid(ad_core::Const(1.0))
            .contains(0.99)
    );
}

diff_fn! {
    /// z^3 - 1 in real and imaginary part.
    fn cube_roots_of_one<R>([x, y]: [R; 2]) -> [R; 2] {
        [x * (x * x - y * y * R::c(3.0)) - R::c(1.0), y * (x * x * R::c(3.0) - y * y)]
    }
}

/// Each root of z^3 = 1 is alone within a tenth, and Newton's method goes there from 0.03 around; no box with two of them, or with none, has a proof, nor does any
/// that does not fit around one.
#[test]
fn roots_are_alone_where_they_are() {
    let options = NewtonOptions {
        max_iterations: 100,
        tolerance: 1e-15,
    };
    let half = 3f64.sqrt() / 2.0;
    for exact in [[1.0, 0.0], [-0.5, half], [-0.5, -half]] {
        let x = newton(&cube_roots_of_one, exact.map(|x| x + 0.1), &options).x;
        let root = krawczyk(&cube_roots_of_one, x, 0.03).expect("alone");
        assert!(
            root.contraction < 1.0 / 3.0 && root.error < 1e-14,
            "{root:?}"
        );
        let off = (x[0] - exact[0]).abs().max((x[1] - exact[1]).abs());
        assert!(off <= root.error, "{off} {root:?}");
        // The proof is of the root, not of the point.
        let beside = krawczyk(&cube_roots_of_one, [x[0] + 0.01, x[1]], 0.1).expect("alone");
        assert!(beside.error >= 0.01 && beside.error < 0.05, "{beside:?}");
        assert!(krawczyk(&cube_roots_of_one, [x[0] + 0.3, x[1]], 0.1).is_none());
        assert!(krawczyk(&cube_roots_of_one, x, 2.0).is_none());
    }
}

/// Boxes around roots of z^3 = 1 have them; those of a grid that hold none are all shown to have none, but for few that touch one.
#[test]
fn boxes_without_roots_are_left_out() {
    let half = 3f64.sqrt() / 2.0;
    let roots = [[1.0, 0.0], [-0.5, half], [-0.5, -half]];
    let (radius, mut left) = (0.01, 0);
    for k in 0..40_000 {
        let x = [k % 200, k / 200].map(|i| 0.02 * f64::from(i) - 1.99);
        let bounds = |radius| decided(box_around(x, radius).map(|x| cube_roots_of_one.eval(x)));
        let (at, over) = (
            bounds(0.0).expect("smooth"),
            bounds(radius).expect("smooth"),
        );
        let holds = |root: &[f64; 2]| (0..2).all(|i| (root[i] - x[i]).abs() <= radius);
        let out = rootless(&at, &over, radius);
        assert!(!(out && roots.iter().any(holds)), "{x:?}");
        left += u32::from(!out);
    }
    assert!((3..30).contains(&left), "{left}");
}

diff_fn! { fn double_root<R>([x]: [R; 1]) -> [R; 1] { [x.square()] } }
diff_fn! { fn kink<R>([x]: [R; 1]) -> [R; 1] { [x + x.abs() * R::c(0.5)] } }
diff_fn! { fn lesser<R>([x, y]: [R; 2]) -> [R; 2] { [x, x.min(y + R::c(0.5)) + y] } }

/// A double root is never alone, at any size. Where a box crosses a branch there is no proof, also if both sides have bounds;
/// beside it there is.
#[test]
fn branches_and_double_roots_are_not_passed_over() {
    for radius in [1.0, 1e-4, 1e-12, 0.0] {
        assert!(krawczyk(&double_root, [0.0], radius).is_none());
        assert!(krawczyk(&kink, [0.0], radius).is_none());
    }
    let kinked = |x| decided(box_around([x], 0.2).map(|x| kink.eval(x)));
    assert!(kinked(0.1).is_none() && kinked(0.3).is_some());
    assert!(krawczyk(&lesser, [0.0, 0.0], 0.1).is_some());
    // Here the lesser of two numbers may be either.
    assert!(krawczyk(&lesser, [0.0, 0.0], 0.4).is_none());
}

/// Ten thousand sums and products of numbers with few digits, against exact integers.
#[test]
fn roundings_are_within_bounds() {
    let mut state = 1u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as i64 - (1i64 << 52)
    };
    for _ in 0..10_000 {
        let (a, b) = (next(), next());
        let (x, y) = (Interval::lift(a as f64), Interval::lift(b as f64));
        let check = |bounds: Interval, exact: i128| {
            // Bounds are whole numbers at this size.
            assert!((bounds.lo() as i128) <= exact && exact <= bounds.hi() as i128);
        };
        check(x * y, i128::from(a) * i128::from(b));
        check(x + y, i128::from(a) + i128::from(b));
        check(x - y, i128::from(a) - i128::from(b));
    }
}
