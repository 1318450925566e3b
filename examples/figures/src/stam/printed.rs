//! The paper's own rules where they are wrong, word by word, to be measured beside the corrected ones.

/// Weight of a sampled microfacet as printed in [Stam 2020, appendix C]: a second sine has crept
/// into the density. Correct: 1 (errata S-C1).
pub fn weight(cos_m: f64) -> f64 {
    (1.0 - cos_m * cos_m).max(0.0).sqrt()
}

/// Derivative of the weight in the exponent as printed, `cos^2 ln cos / ((e + 2) sin)`; 0 at
/// `theta_m = 0`, where the printed form is 0/0 (errata S-C4).
///
/// It is the derivative of [`weight`] for a fixed random number, and so only one of the two terms of the
/// attached derivative: the motion of the sampled direction is missing (errata S-C3).
pub fn weight_derivative(cos_m: f64, exponent: f64) -> f64 {
    let sin = weight(cos_m);
    if sin == 0.0 || cos_m <= 0.0 {
        return 0.0;
    }
    cos_m * cos_m * cos_m.ln() / ((exponent + 2.0) * sin)
}

/// The vector of [Stam 2020, appendix B]: sine and cosine are swapped (errata S-B2).
pub fn vector(theta: f64, phi: f64) -> [f64; 3] {
    let (sin, cos) = theta.sin_cos();
    [phi.cos() * cos, phi.sin() * cos, sin]
}

/// `sin_m = sqrt(1 - dir_m * dir_m)` of appendix D, in single precision: one minus the square of a unit
/// vector (errata S-D1).
pub fn sin_m_of_code(m: [f32; 3]) -> f32 {
    (1.0 - (m[0] * m[0] + m[1] * m[1] + m[2] * m[2])).sqrt()
}
