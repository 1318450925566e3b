//! One user function in every mode: plain, forward, reverse, second order; alone and in chains.

use ad_core::check::{self, DotProduct};
use ad_core::{
    Chain, Const, DiffFn, Dual, Real, derivative, diff_fn, gradient, gradient_composed, hessian,
    hvp, jacobian, jvp, vjp,
};

diff_fn! {
    /// Exercises products, quotients, powers and a branch.
    fn mixture<R>([x, y, z]: [R; 3]) -> [R; 2] {
        let a = (x * y + R::c(1.0)).ln() * z.sin();
        let b = if x > y { x.powf(y) } else { y.hypot(z) };
        [a / b, (a * R::c(0.5)).exp() + b.sqrt()]
    }
}

diff_fn! {
    fn scalar<R>(x: [R; 3]) -> [R; 1] {
        let [a, b] = mixture.eval(x);
        [a * b + a.square() * x[2]]
    }
}

diff_fn! {
    /// State (position, velocity), then stiffness, damping and load: one step of an oscillator.
    fn oscillator<R>([x, v, k, d, f]: [R; 5]) -> [R; 2] {
        let a = f - k * x.sin() - d * v * v.abs();
        [x + v * R::c(0.05), v + a * R::c(0.05)]
    }
}

diff_fn! {
    /// The same shape of stage with other contents.
    fn bounce<R>([x, v, k, d, f]: [R; 5]) -> [R; 2] {
        [x.tanh() * f, (k - v) * d.exp() + x]
    }
}

const POINTS: [[f64; 3]; 3] = [[0.7, 0.4, 1.1], [0.3, 0.9, -0.6], [2.1, 1.3, 0.2]];

#[test]
fn modes_agree_on_value_and_derivative() {
    for x in POINTS {
        let (y, jac) = jacobian(&mixture, x);
        assert_eq!(y, mixture.eval(x));
        let (_, forward) = jvp(&mixture, x, [0.3, -1.0, 0.5]);
        let (_, reverse) = vjp(&mixture, x, [2.0, -0.7]);
        for o in 0..2 {
            let want = jac[o][0] * 0.3 - jac[o][1] + jac[o][2] * 0.5;
            assert!((forward[o] - want).abs() < 1e-14);
        }
        for i in 0..3 {
            assert!((reverse[i] - (2.0 * jac[0][i] - 0.7 * jac[1][i])).abs() < 1e-14);
        }
        let single = jacobian(&mixture, x.map(|x| x as f32)).1;
        for (a, b) in jac.iter().flatten().zip(single.iter().flatten()) {
            assert!(
                (a - f64::from(*b)).abs() < 1e-5 * (1.0 + a.abs()),
                "{a} {b}"
            );
        }
    }
}

#[test]
fn jacobians_pass_the_checker() {
    for x in POINTS {
        let report = check::jacobian_by_differences(&mixture, x, 1e-9);
        assert!(report.passed() && report.compared == 6, "{report}");
    }
}

#[test]
fn second_order_agrees_with_differences_of_the_gradient() {
    diff_fn! {
        fn slope<R>(x: [R; 3]) -> [R; 3] { gradient(&scalar, x).1 }
    }
    for x in POINTS {
        let (y, g, h) = hessian(&scalar, x);
        assert_eq!(y, scalar.eval(x)[0]);
        assert_eq!(g, gradient(&scalar, x).1);
        let report = check::jacobian_by_differences(&slope, x, 1e-8);
        assert!(report.passed(), "{report}");
        assert_eq!(h, jacobian(&slope, x).1);
        let v = [0.2, -0.4, 1.5];
        let (hv_y, hv_g, hv) = hvp(&scalar, x, v);
        assert_eq!(hv_y, y);
        assert!(hv_g.iter().zip(g).all(|(a, b)| (a - b).abs() < 1e-14));
        for (i, row) in h.iter().enumerate() {
            let want: f64 = row.iter().zip(v).map(|(h, v)| h * v).sum();
            assert!((hv[i] - want).abs() < 1e-12, "{} {want}", hv[i]);
            for (j, h_ij) in row.iter().enumerate() {
                assert!((h_ij - h[j][i]).abs() < 1e-12, "Hessians are symmetric");
            }
        }
    }
}

#[test]
fn third_order_by_nesting_the_drivers() {
    diff_fn! { fn f<R>([x]: [R; 1]) -> [R; 1] { [x.powi(5)] } }
    diff_fn! { fn f1<R>([x]: [R; 1]) -> [R; 1] { [derivative(&f, x).1] } }
    diff_fn! { fn f2<R>([x]: [R; 1]) -> [R; 1] { [derivative(&f1, x).1] } }
    assert_eq!(derivative(&f2, 2.0f64).1, 60.0 * 4.0);
}

#[test]
fn composition_by_local_jacobians() {
    diff_fn! { fn outer<R>([a, b]: [R; 2]) -> [R; 1] { [a * b + a.square() * b.cos()] } }
    diff_fn! { fn whole<R>(x: [R; 3]) -> [R; 1] { outer.eval(mixture.eval(x)) } }
    for x in POINTS {
        let (y, g) = gradient_composed(&mixture, &outer, x);
        let (want_y, want) = gradient(&whole, x);
        assert_eq!(y, want_y);
        assert!(
            g.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-13),
            "{g:?} {want:?}"
        );
    }
}

/// Parameters of stage `i` out of a parameter vector shared by all stages.
fn local(p: &[f64], i: usize) -> [f64; 3] {
    std::array::from_fn(|k| p[(3 * i + 2 * k) % p.len()])
}

/// The chain as one function, for reference: `x` is the initial state, then the parameters.
fn whole_chain<R: Real>(x: &[R], stages: usize) -> R {
    let mut s = [x[0], x[1]];
    for i in 0..stages {
        let [k, d, f] = std::array::from_fn(|k| x[2 + (3 * i + 2 * k) % (x.len() - 2)]);
        let at = [s[0], s[1], k, d, f];
        s = if i % 3 == 2 {
            bounce.eval(at)
        } else {
            oscillator.eval(at)
        };
    }
    s[0] * s[1] + s[0]
}

#[test]
fn chain_gradient_equals_forward_mode_and_differences() {
    const STAGES: usize = 40;
    let mut x = [0.3, -0.2, 0.9, 0.1, 0.5, 0.7, 0.2, 0.4, -0.3];
    let mut chain = Chain::<f64, 5, 2>::with_capacity(STAGES);
    // Twice: the buffer of the first run must not leak into the second.
    for _ in 0..2 {
        chain.start([x[0], x[1]]);
        for i in 0..STAGES {
            let p = local(&x[2..], i);
            if i % 3 == 2 {
                chain.advance(&bounce, p)
            } else {
                chain.advance(&oscillator, p)
            };
        }
        assert_eq!(chain.len(), STAGES);
        let [a, b] = chain.state();
        assert_eq!(a * b + a, whole_chain(&x, STAGES));
        let mut g = [0.0; 9];
        let state = chain.pull_back([b + 1.0, a], |i, d: [f64; 3]| {
            for (k, d) in d.into_iter().enumerate() {
                g[2 + (3 * i + 2 * k) % 7] += d;
            }
        });
        (g[0], g[1]) = (state[0], state[1]);
        let forward = whole_chain(
            &std::array::from_fn::<_, 9, _>(|i| Dual::<f64, 9>::var(x[i], i)),
            STAGES,
        );
        for (i, (got, want)) in g.iter().zip(forward.eps).enumerate() {
            assert!((got - want).abs() < 1e-12, "{i}: {got} {want}");
        }
        let report = check::gradient_by_differences(|x| whole_chain(x, STAGES), &mut x, &g, 1e-7);
        assert!(report.passed(), "{report}");
    }
}

#[test]
fn contributions_of_every_state() {
    // L = sum of all positions: the sources enter between the stages.
    let mut chain = Chain::<f64, 5, 2>::new();
    chain.start([0.3, 0.8]);
    let p = [0.9, 0.1, 0.4];
    for _ in 0..10 {
        chain.advance(&oscillator, p);
    }
    let mut g = [0.0; 3];
    let x0 = chain.pull_back_sum(
        |_| [1.0, 0.0],
        |_, d: [f64; 3]| {
            for k in 0..3 {
                g[k] += d[k];
            }
        },
    );
    let sum = |x: &[f64]| {
        let mut s = [x[0], x[1]];
        let mut sum = 0.0;
        for _ in 0..10 {
            s = oscillator.eval([s[0], s[1], x[2], x[3], x[4]]);
            sum += s[0];
        }
        sum
    };
    let all = [x0[0], x0[1], g[0], g[1], g[2]];
    let report = check::gradient_by_differences(sum, &mut [0.3, 0.8, 0.9, 0.1, 0.4], &all, 1e-8);
    assert!(report.passed(), "{report}");
}

#[test]
fn empty_chain_hands_the_adjoint_through() {
    let chain = Chain::<f32, 5, 2>::default();
    assert!(chain.is_empty());
    let adjoint = chain.pull_back([1.0, 2.0], |_, _: [f32; 3]| panic!("no stage"));
    assert_eq!(adjoint, [1.0, 2.0]);
}

#[test]
fn forward_and_reverse_pass_the_dot_product_test() {
    for (seed, x) in POINTS.into_iter().enumerate() {
        let double = check::dot_product(&mixture, x, seed as u64);
        assert!(double.gap() < 1e-15, "{double:?}");
        let single = check::dot_product(&mixture, x.map(|x| x as f32), seed as u64);
        assert!(single.gap() < 1e-6, "{single:?}");
    }
}

/// A function that forgets a derivative: what the checker is for.
struct Forgetful;

impl DiffFn<3, 2> for Forgetful {
    fn eval<R: Real>(&self, [x, y, z]: [R; 3]) -> [R; 2] {
        [
            x * y + z,
            x * y.detach() + z * Const(<R::Primal as Real>::of(2.0)),
        ]
    }
}

#[test]
fn checker_names_the_wrong_component() {
    let report = check::jacobian_by_differences(&Forgetful, [0.5, 0.3, 0.2], 1e-6);
    assert!(!report.passed());
    assert_eq!((report.compared, report.failed), (6, 1));
    let worst = report.worst.expect("something was compared");
    assert_eq!((worst.output, worst.input, worst.automatic), (1, 1, 0.0));
    assert!((worst.numeric - 0.5).abs() < 1e-9);
    let text = report.to_string();
    assert!(
        text.contains("d out[1] / d in[1]") && text.contains("1 of 6"),
        "{text}"
    );
}

#[test]
fn checker_fails_on_non_finite_and_missing_derivatives() {
    let f = |x: &[f64]| x[0] * x[1];
    let x = &mut [2.0, 3.0];
    for wrong in [f64::NAN, f64::INFINITY] {
        assert!(!check::gradient_by_differences(f, x, &[3.0, wrong], 1e-6).passed());
    }
    assert!(!check::gradient_by_differences(f, x, &[3.0], 1e-6).passed());
    assert!(check::gradient_by_differences(f, x, &[3.0, 2.0], 1e-6).passed());
    assert_eq!(*x, [2.0, 3.0], "the point is restored");
    let nowhere = check::central_difference(|_| f64::NAN, 0.0, 1.0);
    assert!(nowhere.error.is_infinite());
}

#[test]
fn checker_selects_its_step() {
    // Scales over 16 decades; next to the end of a domain; large offset (rounding).
    for scale in [1e-8, 1.0, 1e8] {
        let d = check::central_difference(|x| (x / scale).sin(), 0.3 * scale, 0.05 * scale);
        assert!((d.value * scale - 0.3f64.cos()).abs() < 1e-9, "{d:?}");
    }
    let d = check::central_difference(f64::ln, 1e-3, 0.05);
    assert!((d.value / 1e3 - 1.0).abs() < 1e-7, "{d:?}");
    let d = check::central_difference(|x| 1e6 + x.exp(), 0.5, 0.05);
    assert!((d.value - 0.5f64.exp()).abs() < 10.0 * d.error, "{d:?}");
}

#[test]
fn dot_product_exposes_a_wrong_adjoint() {
    let right = DotProduct::new(&[1.0, 2.0], &[3.0], &[8.0], &[6.0, 9.0]);
    assert!((right.gap()).abs() < 1e-15);
    let wrong = DotProduct::new(&[1.0, 2.0], &[3.0], &[8.0], &[6.0, 9.1]);
    assert!(wrong.gap() > 1e-3);
}
