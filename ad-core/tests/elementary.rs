//! Every elementary function in every scalar: value, closed-form derivative, finite differences,
//! singular points.

use ad_core::check::central_difference;
use ad_core::{Const, Dual, Float, Real};
use proptest::prelude::*;

type Unary<R> = fn(R) -> R;
type Binary<R> = fn(R, R) -> R;
type Second = Dual<Dual<f64, 1>, 1>;

/// All functions of one argument.
fn unary<R: Real>() -> Vec<(&'static str, Unary<R>)> {
    vec![
        ("neg", |x| -x),
        ("recip", R::recip),
        ("div_into", |x| R::c(2.5) / x),
        ("const_sub", |x| R::c(2.5) - x),
        ("const_mul", |x| R::c(2.5) * x),
        ("div_const", |x| x / R::c(2.5)),
        ("sqrt", R::sqrt),
        ("cbrt", R::cbrt),
        ("exp", R::exp),
        ("exp_m1", R::exp_m1),
        ("ln", R::ln),
        ("ln_1p", R::ln_1p),
        ("sin", R::sin),
        ("cos", R::cos),
        ("sin_cos.0", |x| x.sin_cos().0),
        ("sin_cos.1", |x| x.sin_cos().1),
        ("tan", R::tan),
        ("asin", R::asin),
        ("acos", R::acos),
        ("atan", R::atan),
        ("sinh", R::sinh),
        ("cosh", R::cosh),
        ("tanh", R::tanh),
        ("powi(3)", |x| x.powi(3)),
        ("powi(-2)", |x| x.powi(-2)),
        ("powi(1)", |x| x.powi(1)),
        ("powi(0)", |x| x.powi(0)),
        ("powf(2.5)", |x| x.powf(R::of(2.5))),
        ("powf(0.5)", |x| x.powf(R::of(0.5))),
        ("abs", R::abs),
        ("signum", R::signum),
        ("copysign", |x| x.copysign(-R::Primal::one())),
        ("erf", R::erf),
        ("rem_euclid", |x| x.rem_euclid(R::c(0.75))),
        ("square", R::square),
        ("clamp", |x| x.clamp(R::of(-0.6), R::of(0.9))),
    ]
}

/// All functions of two arguments.
fn binary<R: Real>() -> Vec<(&'static str, Binary<R>)> {
    vec![
        ("add", |x, y| x + y),
        ("sub", |x, y| x - y),
        ("mul", |x, y| x * y),
        ("div", |x, y| x / y),
        ("atan2", R::atan2),
        ("hypot", R::hypot),
        ("powf", R::powf),
        ("min", R::min),
        ("max", R::max),
        ("mul_add", |x, y| x.mul_add(y, x)),
        ("select", |x, y| R::select(x < y, x, y)),
    ]
}

/// Derivative in closed form, written independently of the library.
fn slope(name: &str, x: f64) -> f64 {
    match name {
        "neg" | "const_sub" => -1.0,
        "recip" => -1.0 / (x * x),
        "div_into" => -2.5 / (x * x),
        "const_mul" => 2.5,
        "div_const" => 0.4,
        "sqrt" | "powf(0.5)" => 0.5 / x.sqrt(),
        "cbrt" => 1.0 / (3.0 * x.cbrt() * x.cbrt()),
        "exp" | "exp_m1" => x.exp(),
        "ln" => 1.0 / x,
        "ln_1p" => 1.0 / (1.0 + x),
        "sin" | "sin_cos.0" => x.cos(),
        "cos" | "sin_cos.1" => -x.sin(),
        "tan" => 1.0 / (x.cos() * x.cos()),
        "asin" => 1.0 / (1.0 - x * x).sqrt(),
        "acos" => -1.0 / (1.0 - x * x).sqrt(),
        "atan" => 1.0 / (1.0 + x * x),
        "sinh" => x.cosh(),
        "cosh" => x.sinh(),
        "tanh" => 1.0 / (x.cosh() * x.cosh()),
        "powi(3)" => 3.0 * x * x,
        "powi(-2)" => -2.0 / (x * x * x),
        "powi(1)" | "rem_euclid" => 1.0,
        "powi(0)" | "signum" => 0.0,
        "powf(2.5)" => 2.5 * x.powf(1.5),
        "abs" => x.signum(),
        "copysign" => -x.signum(),
        "erf" => 2.0 / std::f64::consts::PI.sqrt() * (-x * x).exp(),
        "square" => 2.0 * x,
        "clamp" => f64::from(u8::from((-0.6..=0.9).contains(&x))),
        _ => panic!("no closed form for {name}"),
    }
}

/// Points away from singularities and inside the domain.
fn regular_points(name: &str) -> Vec<f64> {
    let all = [
        -2.3, -0.95, -0.61, -0.3, -0.02, 0.004, 0.1, 0.5, 0.72, 0.93, 1.7, 4.2,
    ];
    let positive = ["sqrt", "ln", "powf(2.5)", "powf(0.5)"].contains(&name);
    let bounded = ["asin", "acos"].contains(&name);
    let inside = |x: &f64| {
        !(positive && *x <= 0.0 || bounded && x.abs() >= 1.0 || name == "ln_1p" && *x <= -1.0)
    };
    all.into_iter().filter(inside).collect()
}

#[track_caller]
fn close(name: &str, x: f64, got: f64, want: f64, tolerance: f64) {
    assert!(
        (got - want).abs() <= tolerance * (1.0 + want.abs()),
        "{name} at {x}: {got:e}, expected {want:e}"
    );
}

/// Values are those of the primal type, slopes those of the closed form.
fn first_order<P: Float>(tolerance: f64) {
    let primal = unary::<P>();
    let (one, three) = (unary::<Dual<P, 1>>(), unary::<Dual<P, 3>>());
    let (four, nine) = (unary::<Dual<P, 4>>(), unary::<Dual<P, 9>>());
    let nested = unary::<Dual<Dual<P, 2>, 1>>();
    for k in 0..primal.len() {
        let (name, f) = primal[k];
        for x in regular_points(name) {
            let want = slope(name, P::of(x).to_f64());
            let x = P::of(x);
            let y = f(x);
            let d1 = one[k].1(Dual::new(x, [P::one()]));
            let d3 = three[k].1(Dual::new(x, [P::of(2.0), P::zero(), P::of(-0.5)]));
            let d4 = four[k].1(Dual::new(
                x,
                [P::of(1.0), P::of(2.0), P::of(3.0), P::of(4.0)],
            ));
            let d9 = nine[k].1(Dual::new(x, std::array::from_fn(|i| P::of(i as f64))));
            let dn = nested[k].1(Dual::new(
                Dual::new(x, [P::one(), P::zero()]),
                [Dual::lift(P::one())],
            ));
            for value in [d1.re, d3.re, d4.re, d9.re, dn.re.re] {
                assert_eq!(value, y, "{name} at {x}");
            }
            let x = x.to_f64();
            close(name, x, d1.eps[0].to_f64(), want, tolerance);
            for (got, scale) in d3.eps.into_iter().zip([2.0, 0.0, -0.5]) {
                close(name, x, got.to_f64(), scale * want, tolerance);
            }
            for (i, got) in d4.eps.into_iter().enumerate() {
                close(name, x, got.to_f64(), (i + 1) as f64 * want, tolerance);
            }
            for (i, got) in d9.eps.into_iter().enumerate() {
                close(name, x, got.to_f64(), i as f64 * want, tolerance);
            }
            close(name, x, dn.re.eps[0].to_f64(), want, tolerance);
            close(name, x, dn.eps[0].re.to_f64(), want, tolerance);
        }
    }
}

#[test]
fn slopes_are_the_closed_forms() {
    first_order::<f64>(1e-13);
    first_order::<f32>(1e-5);
}

#[test]
fn slopes_agree_with_differences() {
    let dual = unary::<Dual<f64, 1>>();
    for (k, (name, f)) in unary::<f64>().into_iter().enumerate() {
        for x in regular_points(name) {
            let d = central_difference(f, x, 1e-3);
            close(name, x, dual[k].1(Dual::var(x, 0)).eps[0], d.value, 1e-8);
        }
    }
}

#[test]
fn second_derivatives_agree_with_differences_of_the_closed_form() {
    for (name, f) in unary::<Second>() {
        for x in regular_points(name) {
            let d = central_difference(|x| slope(name, x), x, 1e-3);
            let y = f(Dual::new(Dual::var(x, 0), [Dual::lift(1.0)]));
            close(name, x, y.eps[0].eps[0], d.value, 1e-7);
        }
    }
}

#[test]
fn functions_of_two_arguments() {
    let (primal, dual, second) = (
        binary::<f64>(),
        binary::<Dual<f64, 2>>(),
        binary::<Second>(),
    );
    for k in 0..primal.len() {
        let (name, f) = primal[k];
        for (x, y) in [(0.7, 1.9), (1.3, 0.4), (2.0, 2.5), (0.1, 3.0)] {
            let d = dual[k].1(Dual::var(x, 0), Dual::var(y, 1));
            assert_eq!(d.re, f(x, y), "{name}");
            let dx = central_difference(|x| f(x, y), x, 1e-2);
            let dy = central_difference(|y| f(x, y), y, 1e-2);
            close(name, x, d.eps[0], dx.value, 1e-9);
            close(name, y, d.eps[1], dy.value, 1e-9);
            // Mixed second derivative: x along the inner, y along the outer direction.
            let m = second[k].1(
                Dual::new(Dual::new(x, [1.0]), [Dual::lift(0.0)]),
                Dual::new(Dual::new(y, [0.0]), [Dual::lift(1.0)]),
            );
            let slope_x = |y| dual[k].1(Dual::var(x, 0), Dual::var(y, 1)).eps[0];
            close(
                name,
                x,
                m.eps[0].eps[0],
                central_difference(slope_x, y, 1e-2).value,
                1e-8,
            );
        }
    }
}

/// The table of the module documentation, as slopes at singular points.
#[test]
fn singular_points_are_as_documented() {
    let table = [
        ("sqrt", 0.0, 0.0, 0.0),
        ("cbrt", 0.0, 0.0, 0.0),
        ("recip", 0.0, f64::INFINITY, 0.0),
        ("div_into", 0.0, f64::INFINITY, 0.0),
        ("ln", 0.0, f64::NEG_INFINITY, 0.0),
        ("ln_1p", -1.0, f64::NEG_INFINITY, 0.0),
        ("exp", 1000.0, f64::INFINITY, 0.0),
        ("asin", 1.0, std::f64::consts::FRAC_PI_2, 0.0),
        ("asin", -1.0, -std::f64::consts::FRAC_PI_2, 0.0),
        ("acos", 1.0, 0.0, 0.0),
        ("acos", -1.0, std::f64::consts::PI, 0.0),
        ("powi(-2)", 0.0, f64::INFINITY, 0.0),
        ("powi(1)", 0.0, 0.0, 1.0),
        ("powi(0)", 0.0, 1.0, 0.0),
        ("powf(0.5)", 0.0, 0.0, 0.0),
        ("powf(2.5)", 0.0, 0.0, 0.0),
        ("abs", 0.0, 0.0, 0.0),
        ("signum", 0.0, 1.0, 0.0),
        ("copysign", 0.0, 0.0, -1.0),
        ("rem_euclid", 0.75, 0.0, 1.0),
        ("clamp", -0.6, -0.6, 1.0),
        ("clamp", 0.9, 0.9, 1.0),
    ];
    let f64s = unary::<Dual<f64, 1>>();
    let f32s = unary::<Dual<f32, 1>>();
    for (name, x, value, slope) in table {
        let at = f64s.iter().position(|(n, _)| *n == name).expect(name);
        let y = f64s[at].1(Dual::var(x, 0));
        assert_eq!((y.re, y.eps[0]), (value, slope), "{name} at {x}");
        let y = f32s[at].1(Dual::var(x as f32, 0));
        assert_eq!(
            (y.re, y.eps[0]),
            (value as f32, slope as f32),
            "{name} at {x}, f32"
        );
    }
    type Case = (Binary<Dual<f64, 2>>, [f64; 2], [f64; 2]);
    let both = |f: Binary<Dual<f64, 2>>, x, y| f(Dual::var(x, 0), Dual::var(y, 1));
    let cases: [Case; 9] = [
        (|x, y| x / y, [1.0, 0.0], [0.0, 0.0]),
        (|x, y| x / y, [0.0, 0.0], [0.0, 0.0]),
        (Real::atan2, [0.0, 0.0], [0.0, 0.0]),
        (Real::hypot, [0.0, 0.0], [0.0, 0.0]),
        (Real::powf, [0.0, 0.0], [0.0, 0.0]),
        (Real::powf, [0.0, 1.0], [1.0, 0.0]),
        (Real::powf, [0.0, 2.0], [0.0, 0.0]),
        (Real::powf, [0.0, -1.0], [0.0, 0.0]),
        (Real::powf, [-2.0, 3.0], [12.0, 0.0]),
    ];
    for (i, (f, [x, y], slopes)) in cases.into_iter().enumerate() {
        assert_eq!(both(f, x, y).eps, slopes, "case {i}");
    }
    assert_eq!(both(Real::min, 1.0, 1.0).eps, [1.0, 0.0]);
    assert_eq!(both(Real::max, 1.0, 1.0).eps, [1.0, 0.0]);
    assert_eq!(both(Real::max, f64::NAN, 1.0).eps, [0.0, 1.0]);
}

/// Whatever the argument: finite unit tangents in, finite tangents out; zero in, zero out.
fn tangents_stay_finite<R: Real>(unit: R, plain: R, other_unit: R, other: R) {
    // The slope of a product is a factor: finite as long as that is.
    let twice = |x: R::Primal| (x + x).is_finite();
    for (name, f) in unary::<Dual<R, 2>>() {
        if name == "square" && !twice(plain.primal()) {
            continue;
        }
        let y = f(Dual::new(unit, [R::one(), R::zero()]));
        assert!(
            y.eps.iter().all(|e| e.is_finite()),
            "{name}({unit:?}) = {y:?}"
        );
        let y = f(Dual::constant(plain));
        assert!(!y.has_tangent(), "{name}({plain:?}) = {y:?}");
    }
    for (name, f) in binary::<Dual<R, 2>>() {
        let products = ["mul", "mul_add"].contains(&name);
        if products && !(twice(unit.primal()) && twice(other.primal())) {
            continue;
        }
        let one = R::one();
        let y = f(
            Dual::new(unit, [one, R::zero()]),
            Dual::new(other_unit, [R::zero(), one]),
        );
        assert!(
            y.eps.iter().all(|e| e.is_finite()),
            "{name}({unit:?}, {other_unit:?}) = {y:?}"
        );
        let y = f(Dual::constant(plain), Dual::constant(other));
        assert!(!y.has_tangent(), "{name}({plain:?}, {other:?}) = {y:?}");
    }
}

fn all_scalars(x: f64, y: f64) {
    tangents_stay_finite::<f64>(x, x, y, y);
    let (a, b) = (x as f32, y as f32);
    tangents_stay_finite::<f32>(a, a, b, b);
    let inner = |x: f64, e: [f64; 2]| Dual::new(x, e);
    tangents_stay_finite(
        inner(x, [1.0, 0.0]),
        inner(x, [0.0; 2]),
        inner(y, [0.0, 1.0]),
        inner(y, [0.0; 2]),
    );
    let inner = |x: f32, e: [f32; 2]| Dual::new(x, e);
    tangents_stay_finite(
        inner(a, [1.0, 0.0]),
        inner(a, [0.0; 2]),
        inner(b, [0.0, 1.0]),
        inner(b, [0.0; 2]),
    );
}

#[test]
fn tangents_are_finite_at_awkward_points() {
    let one_less = f64::from_bits(1f64.to_bits() - 1);
    let magnitudes = [
        0.0,
        f64::from_bits(1),
        1e-320,
        f64::MIN_POSITIVE,
        1e-200,
        1e-154,
        1e-45,
        1e-38,
        1e-20,
        1e-8,
        0.5,
        one_less,
        1.0,
        1.0 + f64::EPSILON,
        std::f64::consts::FRAC_PI_2,
        2.0,
        3.0,
        1e3,
        1e19,
        1e30,
        1e38,
        1e154,
        1e300,
        f64::MAX,
        f64::INFINITY,
        f64::NAN,
    ];
    let points: Vec<f64> = magnitudes.iter().flat_map(|m| [*m, -m]).collect();
    for x in &points {
        for y in &points {
            all_scalars(*x, *y);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn tangents_are_finite_for_any_bits(x in any::<u64>(), y in any::<u64>(), u in any::<u32>(), v in any::<u32>()) {
        all_scalars(f64::from_bits(x), f64::from_bits(y));
        all_scalars(f64::from(f32::from_bits(u)), f64::from(f32::from_bits(v)));
    }
}

#[test]
fn error_function_to_the_last_digits() {
    // Abramowitz and Stegun, table 7.1, extended to double precision.
    let table = [
        (1e-10, 1.128_379_167_095_512_6e-10),
        (0.1, 0.112_462_916_018_284_9),
        (0.5, 0.520_499_877_813_046_5),
        (1.0, 0.842_700_792_949_714_9),
        (2.0, 0.995_322_265_018_952_7),
        (3.0, 0.999_977_909_503_001_4),
    ];
    for (x, want) in table {
        assert!(
            (Real::erf(x) / want - 1.0).abs() < 1e-15,
            "erf({x}) = {:e}",
            Real::erf(x)
        );
        assert_eq!(Real::erf(-x), -Real::erf(x));
        let single = f64::from(Real::erf(x as f32));
        assert!(
            (single / want - 1.0).abs() < 1.5e-7,
            "erf({x}) = {single:e} in f32"
        );
    }
}

#[test]
fn small_arguments_keep_their_digits() {
    let x = 1e-12;
    assert!((Real::exp_m1(x) - x).abs() < 1e-23 && (Real::ln_1p(x) - x).abs() < 1e-23);
    // 1 - tanh^2 would be zero here.
    let d = Dual::<f64, 1>::var(30.0, 0).tanh().eps[0];
    assert!((d / (4.0 * (-60f64).exp()) - 1.0).abs() < 1e-12, "{d:e}");
}

#[test]
fn constants_on_either_side() {
    let x = Dual::<f32, 2>::new(2.0, [1.0, -3.0]);
    let c = Const(5.0f32);
    for (got, value, slope) in [
        (x + c, 7.0, 1.0),
        (c + x, 7.0, 1.0),
        (x - c, -3.0, 1.0),
        (c - x, 3.0, -1.0),
        (x * c, 10.0, 5.0),
        (c * x, 10.0, 5.0),
        (x / c, 0.4, 0.2),
        (c / x, 2.5, -1.25),
    ] {
        assert!((got.re - value).abs() < 1e-6);
        assert!((got.eps[0] - slope).abs() < 1e-6 && (got.eps[1] + 3.0 * slope).abs() < 1e-6);
    }
    assert_eq!(c * 3.0f32 - 1.0, 14.0);
}

#[test]
fn detach_and_primal_strip_every_level() {
    let x = Dual::new(Dual::new(2.0f32, [1.0]), [Dual::new(3.0, [4.0])]);
    assert_eq!(x.primal(), 2.0);
    assert!(x.has_tangent() && !x.detach().has_tangent());
    // A tangent at a single level counts.
    assert!(Dual::<Dual<f32, 1>, 1>::constant(Dual::new(2.0, [1.0])).has_tangent());
    assert!(Dual::new(Dual::<f32, 1>::lift(2.0), [Dual::new(0.0f32, [1.0f32])]).has_tangent());
}

#[test]
fn unit_interval_from_bits() {
    for (bits, f) in [(0, 0.0), (1 << 63, 0.5), (u64::MAX, 1.0 - 2f64.powi(-53))] {
        assert_eq!(f64::from_bits_unit(bits), f);
    }
    assert!(f32::from_bits_unit(u64::MAX) < 1.0);
}
