//! Spectra as linear RGB, which is all that this renderer knows.
//!
//! A spectrum is seen by the standard observer ([CIE 1931], two degrees) and taken to linear sRGB,
//! as in the RGB variants of Mitsuba 3: emission as it is, so that a flat spectrum is that of equal energy and
//! somewhat pink; everything else under daylight (CIE D65), so that a flat one is grey.

use super::observer::observer;
use super::value::{self, Mismatch};
use crate::math::rgb_of_xyz;

/// Plugins that are a constant spectrum.
pub(crate) const PLUGINS: &[&str] = &[
    "blackbody",
    "d65",
    "irregular",
    "rawconstant",
    "regular",
    "srgb",
    "uniform",
];

/// What a spectrum stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    /// Light.
    Emission,
    /// What is between 0 and 1 at every wavelength.
    Reflectance,
    /// Anything else, such as an index of refraction.
    Other,
}

/// Visible wavelengths and the step of integrals over them, nanometres.
const VISIBLE: [f64; 2] = [360.0, 830.0];
const STEP: f64 = 1.0;

/// Relative power of the illuminant D65 every 10 nm from 360 nm on (CIE 15).
const D65: [f64; 43] = [
    46.6383, 52.0891, 49.9755, 54.6482, 82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008,
    117.812, 114.861, 115.923, 108.811, 109.354, 107.802, 104.79, 107.689, 104.405, 104.046, 100.0,
    96.3342, 95.788, 88.6856, 90.0062, 89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146,
    82.2778, 78.2842, 69.7213, 71.6091, 74.349, 61.604, 69.8856, 75.087, 63.5927, 46.4182, 66.8054,
    63.3828,
];

/// Values at increasing wavelengths in nanometres, linear between and zero beyond them.
#[derive(Clone, Debug)]
pub(super) struct Samples(Vec<[f64; 2]>);

impl Samples {
    /// At least two wavelengths, finite and increasing.
    pub fn new(pairs: Vec<[f64; 2]>) -> Option<Self> {
        let finite = pairs.as_flattened().iter().all(|x| x.is_finite());
        let increasing = pairs.windows(2).all(|p| p[0][0] < p[1][0]);
        (finite && increasing && pairs.len() >= 2).then_some(Self(pairs))
    }

    /// "400:0.5, 500:0.7"
    pub fn parse(text: &str) -> Result<Self, Mismatch> {
        let expected = "at least two wavelengths with values, such as `400:0.5, 700:0.7`, wavelengths increasing";
        let pair = |token: &str| {
            let (wavelength, value) = token.split_once(':')?;
            Some([value::float(wavelength).ok()?, value::float(value).ok()?])
        };
        let pairs: Option<Vec<_>> = (text.split(|c: char| c == ',' || c.is_whitespace()))
            .filter(|token| !token.is_empty())
            .map(pair)
            .collect();
        (pairs.and_then(Self::new)).ok_or_else(|| value::mismatch(expected, text))
    }

    /// The lines of a file: a wavelength and a value each, `#` before comments.
    pub fn of_lines(text: &str) -> Result<Self, Mismatch> {
        let expected = "at least two lines with a wavelength and a value, wavelengths increasing";
        let mut pairs = Vec::new();
        for line in text.lines() {
            let line = line.split('#').next().unwrap_or_default();
            let mut numbers = line.split_whitespace().map(value::float);
            match [numbers.next(), numbers.next(), numbers.next()] {
                [None, ..] => {}
                [Some(Ok(wavelength)), Some(Ok(value)), None] => pairs.push([wavelength, value]),
                _ => return Err(value::mismatch(expected, line)),
            }
        }
        Self::new(pairs).ok_or_else(|| value::mismatch(expected, "others"))
    }

    fn at(&self, wavelength: f64) -> f64 {
        let after = self.0.partition_point(|p| p[0] < wavelength);
        match (after.checked_sub(1).map(|i| self.0[i]), self.0.get(after)) {
            (_, Some(&[w, v])) if w == wavelength => v,
            (Some([w0, v0]), Some(&[w1, v1])) => v0 + (v1 - v0) * (wavelength - w0) / (w1 - w0),
            _ => 0.0,
        }
    }
}

/// The colour of a spectrum, and whether it lies outside of what RGB can show, so that it was cut: at zero, and
/// reflectances at one.
pub(super) fn rgb(spectrum: &Samples, role: Role) -> ([f64; 3], bool) {
    rgb_of(|w| spectrum.at(w), role)
}

/// The colour of a flat spectrum.
pub(super) fn flat(value: f64, role: Role) -> [f64; 3] {
    match role {
        Role::Emission => rgb_of_xyz([value; 3]),
        _ => [value; 3],
    }
}

/// The colour of a black body of this temperature in kelvin, whose radiance is that of Planck's law in watts per square
/// metre, steradian and nanometre.
pub(super) fn blackbody(temperature: f64) -> [f64; 3] {
    // 2 h c^2, h c / k, with wavelengths in metres; exact in SI.
    const FIRST: f64 = 1.191_042_972_397_188_4e-16;
    const SECOND: f64 = 1.438_776_877_503_933_3e-2;
    let planck = |nanometres: f64| {
        let w = nanometres * 1e-9;
        1e-9 * FIRST / (w.powi(5) * (SECOND / (w * temperature)).exp_m1())
    };
    rgb_of(planck, Role::Emission).0
}

fn rgb_of(spectrum: impl Fn(f64) -> f64, role: Role) -> ([f64; 3], bool) {
    let lit = role != Role::Emission;
    let (mut sum, mut white) = ([0.0; 3], [0.0; 3]);
    let steps = ((VISIBLE[1] - VISIBLE[0]) / STEP) as u32;
    for i in 0..=steps {
        let w = VISIBLE[0] + f64::from(i) * STEP;
        let light = if lit { daylight(w) } else { 1.0 };
        let (observer, value) = (observer(w), spectrum(w));
        for c in 0..3 {
            sum[c] += observer[c] * light * value;
            white[c] += observer[c] * light;
        }
    }
    // Flat spectra come out exactly.
    let rgb = if lit {
        let (rgb, white) = (rgb_of_xyz(sum), rgb_of_xyz(white));
        [0, 1, 2].map(|c| rgb[c] / white[c])
    } else {
        rgb_of_xyz([0, 1, 2].map(|c| sum[c] / white[c]))
    };
    let most = match role {
        Role::Reflectance => 1.0,
        _ => f64::INFINITY,
    };
    // Rounding of a white one is no colour beyond all.
    let outside = rgb.iter().any(|&x| x < -1e-9 || x > most + 1e-9);
    (rgb.map(|x| x.clamp(0.0, most)), outside)
}

/// D65, linear between its samples; beyond 780 nm, where the observer is blind, the last one.
fn daylight(wavelength: f64) -> f64 {
    let x = (wavelength - VISIBLE[0]) / 10.0;
    let i = (x.max(0.0) as usize).min(D65.len() - 2);
    let f = (x - i as f64).clamp(0.0, 1.0);
    D65[i] + (D65[i + 1] - D65[i]) * f
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: [f64; 3], b: [f64; 3], tolerance: f64) {
        assert!(
            (0..3).all(|c| (a[c] - b[c]).abs() <= tolerance),
            "{a:?} {b:?}"
        );
    }

    #[test]
    fn flat_spectra_are_grey_under_daylight_and_of_equal_energy_as_lamps() {
        let list = Samples::parse("300:0.5, 900:0.5").unwrap();
        close(rgb(&list, Role::Reflectance).0, [0.5; 3], 1e-12);
        close(rgb(&list, Role::Other).0, [0.5; 3], 1e-12);
        let lamp = rgb(&list, Role::Emission).0;
        close(lamp, flat(0.5, Role::Emission), 1e-12);
        // What Mitsuba 3.9 shows.
        close(lamp, [0.602, 0.474, 0.454], 6e-4);
    }

    /// The white point of daylight by the fits is that of the standard, (0.3127, 0.3290), and its colour white.
    #[test]
    fn daylight_is_white() {
        let mut xyz = [0.0; 3];
        for w in 360..=830 {
            let (o, light) = (observer(f64::from(w)), daylight(f64::from(w)));
            (0..3).for_each(|c| xyz[c] += o[c] * light);
        }
        let sum: f64 = xyz.iter().sum();
        assert!((xyz[0] / sum - 0.3127).abs() < 1e-4 && (xyz[1] / sum - 0.3290).abs() < 1e-4);
        close(rgb_of_xyz(xyz.map(|x| x / xyz[1])), [1.0; 3], 1e-3);
    }

    /// The chromaticities of black bodies of 2856 K (illuminant A) and of 6504 K, which lies near daylight.
    #[test]
    fn black_bodies_have_their_colours() {
        let warm = blackbody(2856.0);
        assert!(
            warm[0] > 2.0 * warm[1] && warm[1] > 2.0 * warm[2],
            "{warm:?}"
        );
        let cool = blackbody(6504.0);
        close(cool.map(|x| x / cool[1]), [1.0; 3], 0.08);
        assert!(blackbody(1.0).iter().all(|x| x.is_finite()));
    }

    /// Against an integral in steps of 0.01 nm, by another program.
    #[test]
    fn colours_of_lists_are_those_of_the_standard() {
        let lamp = Samples::parse("400:1, 500:3, 600:0.5, 700:2").unwrap();
        let found = rgb(&lamp, Role::Emission).0;
        close(found, [0.40372, 1.91115, 1.90798], 5e-4);
    }

    #[test]
    fn lists_are_linear_between_their_wavelengths_and_zero_beyond() {
        let s = Samples::parse(" 400:1  500:3,600:0 ").unwrap();
        for (w, v) in [
            (399.0, 0.0),
            (400.0, 1.0),
            (450.0, 2.0),
            (500.0, 3.0),
            (600.0, 0.0),
            (601.0, 0.0),
        ] {
            assert_eq!(s.at(w), v, "{w}");
        }
        for bad in [
            "",
            "400:1",
            "500:1, 400:1",
            "400:1, 400:2",
            "400:1, 0.5",
            "400:nan, 500:1",
        ] {
            assert!(Samples::parse(bad).is_err(), "{bad}");
        }
        let lines = Samples::of_lines("# nm value\n400 1\n\n500 3 # peak\n600 0\n").unwrap();
        assert_eq!(lines.0, s.0);
        assert!(Samples::of_lines("400 1\n500\n").is_err() && Samples::of_lines("").is_err());
    }

    #[test]
    fn colours_beyond_all_displays_are_cut() {
        let green = Samples::parse("505:0, 510:1, 515:0").unwrap();
        let (colour, outside) = rgb(&green, Role::Reflectance);
        assert!(outside && colour[0] == 0.0 && colour[1] > 0.0);
        assert!(!rgb(&Samples::parse("300:1, 900:1").unwrap(), Role::Reflectance).1);
    }
}
