//! The text of attributes as numbers, lists and colours.

use crate::error::quoted;
use crate::math::Transform;

/// A typed property of a plugin.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Float(f64),
    Integer(i64),
    Boolean(bool),
    String(String),
    Color([f64; 3]),
    Point([f64; 3]),
    Vector([f64; 3]),
    Transform(Transform),
}

/// What a value should have been, and the offending text.
#[derive(Debug)]
pub(super) struct Mismatch {
    pub expected: &'static str,
    pub found: String,
}

pub(super) fn mismatch(expected: &'static str, found: &str) -> Mismatch {
    Mismatch {
        expected,
        found: quoted(found),
    }
}

/// A number that is finite also in the single precision that geometry uses.
pub(super) fn float(text: &str) -> Result<f64, Mismatch> {
    let in_range = |x: &f64| x.abs() <= f64::from(f32::MAX);
    text.trim()
        .parse()
        .ok()
        .filter(in_range)
        .ok_or_else(|| mismatch("a finite number", text))
}

pub(super) fn integer(text: &str) -> Result<i64, Mismatch> {
    text.trim()
        .parse()
        .map_err(|_| mismatch("an integer", text))
}

pub(super) fn boolean(text: &str) -> Result<bool, Mismatch> {
    match text.trim() {
        t if t.eq_ignore_ascii_case("true") => Ok(true),
        t if t.eq_ignore_ascii_case("false") => Ok(false),
        _ => Err(mismatch("`true` or `false`", text)),
    }
}

/// Numbers separated by commas, spaces or both.
pub(super) fn list(text: &str) -> Result<Vec<f64>, Mismatch> {
    text.split(|c: char| c == ',' || c.is_whitespace())
        .filter(|token| !token.is_empty())
        .map(float)
        .collect()
}

/// Three numbers.
pub(super) fn triple(text: &str) -> Result<[f64; 3], Mismatch> {
    <[f64; 3]>::try_from(list(text)?).map_err(|_| mismatch("three numbers", text))
}

/// Three numbers, or one for all three.
pub(super) fn triple_or_uniform(text: &str) -> Result<[f64; 3], Mismatch> {
    match list(text)?[..] {
        [all] => Ok([all; 3]),
        [x, y, z] => Ok([x, y, z]),
        _ => Err(mismatch("one or three numbers", text)),
    }
}

/// `#rrggbb`, each from 0 to 1.
pub(super) fn hexadecimal(text: &str) -> Option<[f64; 3]> {
    let digits = text.trim().strip_prefix('#')?;
    let valid = digits.len() == 6 && digits.bytes().all(|b| b.is_ascii_hexdigit());
    let number = u32::from_str_radix(digits, 16).ok().filter(|_| valid)?;
    Some([16, 8, 0].map(|shift| f64::from(number >> shift & 0xff) / 255.0))
}

/// Three numbers, one for all three, or `#rrggbb`.
pub(super) fn colour(text: &str) -> Result<[f64; 3], Mismatch> {
    if text.trim_start().starts_with('#') {
        let expected = "`#` and six hexadecimal digits";
        return hexadecimal(text).ok_or_else(|| mismatch(expected, text));
    }
    triple_or_uniform(text)
}

/// A row-major 4x4 matrix with last row 0 0 0 1, or the 3x3 matrix of its linear part.
pub(super) fn matrix(text: &str) -> Result<Transform, Mismatch> {
    let numbers = list(text)?;
    if let Ok(m) = <[f64; 9]>::try_from(&numbers[..]) {
        return Ok(Transform::from_linear(&m));
    }
    <[f64; 16]>::try_from(&numbers[..])
        .ok()
        .and_then(|m| Transform::from_matrix(&m))
        .ok_or_else(|| mismatch("9 numbers, or 16 with last row 0 0 0 1", text))
}

/// `toWorld` -> `to_world`, `intIOR` -> `int_ior`; names without a lower-upper boundary stay as
/// they are.
pub(super) fn snake_case(name: &str) -> String {
    let mut out = String::with_capacity(name.len() + 2);
    let mut converting = false;
    let mut previous_lower = false;
    for c in name.chars() {
        if c.is_ascii_uppercase() && (previous_lower || converting) {
            if previous_lower {
                out.push('_');
            }
            converting = true;
            out.push(c.to_ascii_lowercase());
        } else {
            converting = false;
            out.push(c);
        }
        previous_lower = c.is_ascii_lowercase();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_must_be_finite_in_single_precision() {
        for good in ["1", " -2.5e-3 ", ".5", "5.", "+7", "3e38"] {
            assert!(float(good).is_ok(), "{good}");
        }
        for bad in [
            "",
            "nan",
            "NaN",
            "inf",
            "-infinity",
            "1e39",
            "1e999",
            "1,5",
            "0x10",
            "1f",
        ] {
            let error = float(bad).unwrap_err();
            assert_eq!(error.found, format!("`{bad}`"));
        }
        assert_eq!(integer("-1").unwrap(), -1);
        assert_eq!(integer("4294967295").unwrap(), 4294967295);
        assert!(integer("1.0").is_err() && integer("99999999999999999999").is_err());
        assert!(boolean("True").unwrap() && !boolean(" false").unwrap());
        assert!(boolean("1").is_err() && boolean("").is_err());
    }

    #[test]
    fn lists_take_commas_and_spaces() {
        assert_eq!(triple("1, 2,3").unwrap(), [1.0, 2.0, 3.0]);
        assert_eq!(triple("  0,   1 \t 2").unwrap(), [0.0, 1.0, 2.0]);
        assert!(triple("1 2").is_err() && triple("1 2 3 4").is_err() && triple("1 2 x").is_err());
        assert_eq!(triple_or_uniform("0.5").unwrap(), [0.5; 3]);
        assert!(triple_or_uniform("").is_err() && triple_or_uniform("1 2").is_err());
        // Wavelength:value pairs are not mistaken for numbers.
        assert!(triple_or_uniform("400:0.1, 700:0.2").is_err());
    }

    #[test]
    fn hexadecimal_colours_have_six_digits() {
        assert_eq!(colour(" #ff3300 ").unwrap(), [1.0, 0.2, 0.0]);
        assert_eq!(colour("0.5").unwrap(), [0.5; 3]);
        for bad in [
            "#", "#fff", "#ff33001", "#+f3300", "#gg0000", "ff3300", "#é33",
        ] {
            assert!(colour(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn matrices_have_nine_or_sixteen_numbers() {
        let linear = matrix("1 0 0  0 2 0  0 0 3").unwrap();
        assert_eq!(linear, Transform::scale([1.0, 2.0, 3.0]));
        let affine = matrix("1 0 0 4  0 1 0 5  0 0 1 6  0 0 0 1").unwrap();
        assert_eq!(affine, Transform::translate([4.0, 5.0, 6.0]));
        assert!(matrix("1 0 0 4  0 1 0 5  0 0 1 6  0 0 1 1").is_err());
        assert!(matrix("1 0 0 4").is_err());
    }

    #[test]
    fn old_names_become_new_ones() {
        for (old, new) in [
            ("toWorld", "to_world"),
            ("intIOR", "int_ior"),
            ("diffuseReflectance", "diffuse_reflectance"),
            ("focusDistanceX", "focus_distance_x"),
            ("to_world", "to_world"),
            ("p0", "p0"),
            ("D", "D"),
        ] {
            assert_eq!(snake_case(old), new);
        }
    }
}
