//! Floating-point numbers that survive any text format bit for bit.
//!
//! JSON readers may round the last digit of a number (serde_json does unless told otherwise), and
//! one bit is enough for a resumed optimisation to leave the original's track. For use with
//! `#[serde(with = "optim::exact::slice")]` and `#[serde(with = "optim::exact::number")]`, also in
//! the checkpoints of callers.

/// A `Vec` of f32 or f64 as one string of bit patterns: 8 or 16 hexadecimal digits per value.
/// Not-a-numbers pass too.
pub mod slice {
    use crate::scalar::{Scalar, sealed::Sealed};
    use serde::{Deserialize, Deserializer, Serializer, de::Error};
    use std::fmt::Write;

    /// Writes the values in order.
    pub fn serialize<T: Scalar, S: Serializer>(values: &[T], to: S) -> Result<S::Ok, S::Error> {
        let digits = <T as Sealed>::DIGITS;
        let mut text = String::with_capacity(values.len() * digits);
        for v in values {
            write!(text, "{:0digits$x}", v.bits()).map_err(serde::ser::Error::custom)?;
        }
        to.serialize_str(&text)
    }

    /// Reads what [`serialize`] wrote.
    pub fn deserialize<'de, T: Scalar, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
        let text = String::deserialize(from)?;
        let digits = <T as Sealed>::DIGITS;
        if text.len() % digits != 0 {
            return Err(D::Error::custom(format!(
                "expected {digits} hexadecimal digits per value, found {} in all",
                text.len()
            )));
        }
        let parse = |chunk: &[u8]| {
            let chunk = std::str::from_utf8(chunk).ok()?;
            let plain = chunk.bytes().all(|b| b.is_ascii_hexdigit());
            T::of_bits(u64::from_str_radix(chunk, 16).ok().filter(|_| plain)?)
        };
        text.as_bytes()
            .chunks_exact(digits)
            .enumerate()
            .map(|(i, chunk)| {
                parse(chunk).ok_or_else(|| {
                    D::Error::custom(format!(
                        "value {i}: expected {digits} hexadecimal digits, found `{}`",
                        String::from_utf8_lossy(chunk)
                    ))
                })
            })
            .collect()
    }
}

/// One f64 as the shortest decimal string that reads back as the same value. A plain number is
/// accepted too, for files that are written by hand.
pub mod number {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Text {
        Exact(String),
        Plain(f64),
    }

    /// Writes the value.
    pub fn serialize<S: Serializer>(value: &f64, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&format!("{value:?}"))
    }

    /// Reads what [`serialize`] wrote, or a number.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
        match Text::deserialize(from)? {
            Text::Plain(x) => Ok(x),
            Text::Exact(text) => text
                .parse()
                .map_err(|_| D::Error::custom(format!("expected a number, found `{text}`"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Serialize, Deserialize)]
    struct Record {
        #[serde(with = "super::slice")]
        single: Vec<f32>,
        #[serde(with = "super::slice")]
        double: Vec<f64>,
        #[serde(with = "super::number")]
        number: f64,
    }

    #[test]
    fn every_bit_survives_json() {
        let mut bits = 0x9e37_79b9_7f4a_7c15_u64;
        let mut next = || {
            bits = bits
                .wrapping_mul(6364136223846793005)
                .wrapping_add(1442695040888963407);
            bits ^ (bits >> 29)
        };
        for _ in 0..2000 {
            let finite = f64::from_bits(next() & !(1 << 62));
            let record = Record {
                single: (0..5).map(|_| f32::from_bits(next() as u32)).collect(),
                double: (0..5).map(|_| f64::from_bits(next())).collect(),
                number: finite,
            };
            let text = serde_json::to_string(&record).unwrap();
            let back: Record = serde_json::from_str(&text).unwrap();
            let bits32 = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            let bits64 = |v: &[f64]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits32(&record.single), bits32(&back.single));
            assert_eq!(bits64(&record.double), bits64(&back.double));
            assert_eq!(record.number.to_bits(), back.number.to_bits());
        }
    }

    #[test]
    fn damaged_text_is_an_error() {
        let read = |single: &str, number: &str| {
            serde_json::from_str::<Record>(&format!(
                r#"{{"single":"{single}","double":"","number":{number}}}"#
            ))
        };
        assert_eq!(read("3f800000", "0.5").unwrap().single, [1.0]);
        assert_eq!(read("3f800000", "\"0.5\"").unwrap().number, 0.5);
        for (single, number, message) in [
            ("3f8000", "1", "found 6 in all"),
            ("3f80000g", "1", "found `3f80000g`"),
            ("+f800000", "1", "found `+f800000`"),
            ("", "\"x\"", "expected a number, found `x`"),
        ] {
            let error = read(single, number).err().unwrap().to_string();
            assert!(error.contains(message), "{error}");
        }
        assert!(read("äöüß", "1").is_err());
    }
}
