//! Newton's method: the basins of z^3 = 1, and graceful failure.

use ad_core::{DiffFn, NewtonOptions, NewtonStatus, diff_fn, newton};

diff_fn! {
    /// z^3 - 1 in real and imaginary part.
    fn cube_roots_of_one<R>([x, y]: [R; 2]) -> [R; 2] {
        [x * (x * x - y * y * R::c(3.0)) - R::c(1.0), y * (x * x * R::c(3.0) - y * y)]
    }
}

/// The root found from a start: 0 for 1, 1 for the upper, 2 for the lower one.
fn basin(x: f64, y: f64) -> Option<usize> {
    let options = NewtonOptions {
        max_iterations: 100,
        tolerance: 1e-9,
    };
    let found = newton(&cube_roots_of_one, [x, y], &options);
    found.converged().then_some(match found.x {
        [x, _] if x > 0.0 => 0,
        [_, y] if y > 0.0 => 1,
        _ => 2,
    })
}

/// Fractions of the basins over an `n` x `n` grid on `[-half, half]^2`, masked by `inside`.
fn fractions(half: f64, n: usize, inside: impl Fn(f64, f64) -> bool) -> [f64; 3] {
    let at = |i: usize| half * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
    let mut count = [0usize; 3];
    let mut all = 0;
    for i in 0..n {
        for j in 0..n {
            if inside(at(i), at(j)) {
                all += 1;
                if let Some(k) = basin(at(i), at(j)) {
                    count[k] += 1;
                }
            }
        }
    }
    count.map(|c| c as f64 / all as f64)
}

#[test]
fn basins_of_z_cubed() {
    // [Zeltner 2021, Fig. 3.15 (a)]: thirds by symmetry on a disc, not on the square.
    let disc = fractions(2.0, 500, |x, y| x * x + y * y < 4.0);
    let square = fractions(2.0, 500, |_, _| true);
    for (got, want) in disc.into_iter().zip([1.0 / 3.0; 3]) {
        assert!((got - want).abs() < 2e-3, "{disc:?}");
    }
    for (got, want) in square.into_iter().zip([0.353, 0.323, 0.323]) {
        assert!((got - want).abs() < 2e-3, "{square:?}");
    }
}

#[test]
fn converges_quadratically_in_both_precisions() {
    let double = newton(&cube_roots_of_one, [0.9, 0.1], &NewtonOptions::default());
    assert_eq!(double.status, NewtonStatus::Converged);
    assert!(
        double.iterations <= 6 && double.residual < 1e-13,
        "{double:?}"
    );
    let single = newton(&cube_roots_of_one, [0.9f32, 0.1], &NewtonOptions::default());
    assert!(
        single.converged() && (single.x[0] - 1.0).abs() < 1e-5,
        "{single:?}"
    );
}

#[test]
fn failures_are_values() {
    let options = NewtonOptions::default();
    let at = |x, y| newton(&cube_roots_of_one, [x, y], &options);
    let singular = at(0.0, 0.0);
    assert_eq!(
        (singular.status, singular.iterations),
        (NewtonStatus::Singular, 0)
    );
    assert_eq!((singular.x, singular.residual), ([0.0, 0.0], 1.0));
    assert_eq!(at(f64::NAN, 0.0).status, NewtonStatus::NotFinite);
    assert_eq!(at(1e300, 0.0).status, NewtonStatus::NotFinite);

    // No real root: x^2 + 1.
    diff_fn! { fn rootless<R>([x]: [R; 1]) -> [R; 1] { [x * x + R::c(1.0)] } }
    let lost = newton(&rootless, [0.7], &options);
    assert_eq!(
        (lost.status, lost.iterations),
        (NewtonStatus::IterationLimit, 50)
    );

    // Leaves the domain of the logarithm in one step; the last finite iterate comes back.
    diff_fn! { fn log<R>([x]: [R; 1]) -> [R; 1] { [x.ln()] } }
    let outside = newton(&log, [20.0], &options);
    assert_eq!(
        (outside.status, outside.x),
        (NewtonStatus::NotFinite, [20.0])
    );
    assert!((outside.residual - 20f64.ln()).abs() < 1e-15);
}

#[test]
fn a_root_at_the_start_takes_no_step() {
    let found = newton(&cube_roots_of_one, [1.0, 0.0], &NewtonOptions::default());
    assert_eq!(
        (found.status, found.iterations),
        (NewtonStatus::Converged, 0)
    );
    assert_eq!(cube_roots_of_one.eval(found.x), [0.0, 0.0]);
}
