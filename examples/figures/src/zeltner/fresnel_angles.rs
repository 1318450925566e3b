//! Angles of Fresnel reflectance [Zeltner 2021, figures 2.10 and 2.11].

/// Where `f` is smallest in `[a, b]` (one minimum), degrees.
pub(super) fn lowest([mut a, mut b]: [f64; 2], f: impl Fn(f64) -> f64) -> f64 {
    for _ in 0..100 {
        let (l, r) = (a + (b - a) / 3.0, b - (b - a) / 3.0);
        if f(l) < f(r) { b = r } else { a = l }
    }
    0.5 * (a + b)
}

/// The cosine of an angle.
pub(super) fn cos(degrees: f64) -> f64 {
    // The cosine of 90 degrees, as rounded, is not zero.
    if degrees == 90.0 {
        0.0
    } else {
        degrees.to_radians().cos()
    }
}
