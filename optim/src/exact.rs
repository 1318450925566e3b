//! Floating-point numbers that survive any text format bit for bit.
//!
//! JSON readers may round the last digit of a number (serde_json does unless told otherwise), and
//! one bit is enough for a resumed optimisation to leave the original's track. For use with
//! `#[serde(with = "optim::exact::slice")]`, `#[serde(with = "optim::exact::number")]` and
//! `#[serde(with = "optim::exact::optional")]`, also in the checkpoints of callers.

/// A `Vec` of f32 or f64 as one string of bit patterns: 8 or 16 hexadecimal digits per value.
/// Not-a-numbers pass too. Long ones may go [`beside`] the text.
pub mod slice {
    use super::beside;
    use crate::scalar::{Scalar, sealed::Sealed};
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};
    use std::fmt::Write;

    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Text {
        Inside(String),
        Beside(beside::Place),
    }

    /// Writes the values in order.
    pub fn serialize<T: Scalar, S: Serializer>(values: &[T], to: S) -> Result<S::Ok, S::Error> {
        if let Some(place) = beside::put(values).map_err(serde::ser::Error::custom)? {
            return place.serialize(to);
        }
        let digits = <T as Sealed>::DIGITS;
        let mut text = String::with_capacity(values.len() * digits);
        for v in values {
            write!(text, "{:0digits$x}", v.bits()).map_err(serde::ser::Error::custom)?;
        }
        to.serialize_str(&text)
    }

    /// Reads what [`serialize`] wrote.
    pub fn deserialize<'de, T: Scalar, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
        let text = if beside::is_reading() {
            match Text::deserialize(from)? {
                Text::Inside(text) => text,
                Text::Beside(place) => return beside::get(&place).map_err(D::Error::custom),
            }
        } else {
            String::deserialize(from)?
        };
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

/// [`number`](mod@number), or none; with `#[serde(default)]` also where it is left out.
pub mod optional {
    use super::number;
    use serde::{Deserialize, Deserializer, Serializer};

    #[derive(Deserialize)]
    struct Number(#[serde(with = "number")] f64);

    /// Writes the value.
    pub fn serialize<S: Serializer>(value: &Option<f64>, to: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(x) => number::serialize(x, to),
            None => to.serialize_none(),
        }
    }

    /// Reads what [`serialize`] wrote, or a number.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Option<f64>, D::Error> {
        Ok(Option::<Number>::deserialize(from)?.map(|Number(x)| x))
    }
}

/// Long arrays in a file of bytes beside the text: there a value takes 4 or 8 bytes instead of 8 or 16 characters, and
/// no copy of all is made in memory. Inside of [`beside::write`] and [`beside::read`] what
/// [`slice`](mod@slice) leaves in the text of a long array is where its bytes are; the values lie there one after
/// another, little-endian.
pub mod beside {
    use std::cell::RefCell;
    use std::io::{self, Read, Seek, SeekFrom, Write};
    use std::rc::Rc;

    use crate::scalar::Scalar;
    use serde::{Deserialize, Serialize};

    /// Arrays of so many values and more go beside the text.
    pub const LONG: usize = 4096;

    /// Where the bytes of an array are.
    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields)]
    pub(super) struct Place {
        /// The first byte.
        at: u64,
        /// Number of values.
        len: u64,
    }

    struct Sink {
        to: Rc<RefCell<dyn Write>>,
        at: u64,
    }

    trait Bytes: Read + Seek {}
    impl<T: Read + Seek> Bytes for T {}

    // Serde hands no context to the values that it writes and reads.
    thread_local! {
        static SINK: RefCell<Option<Sink>> = const { RefCell::new(None) };
        static SOURCE: RefCell<Option<Rc<RefCell<dyn Bytes>>>> = const { RefCell::new(None) };
    }

    /// Takes a sink or source back, also when a panic passes by.
    struct Scope(fn());
    impl Drop for Scope {
        fn drop(&mut self) {
            (self.0)();
        }
    }

    /// Runs `serialize`, which must write on this thread; long arrays go to `to`, which is given back.
    pub fn write<W: Write + 'static, R>(to: W, serialize: impl FnOnce() -> R) -> (R, W) {
        let shared = Rc::new(RefCell::new(to));
        let sink = Sink {
            to: shared.clone(),
            at: 0,
        };
        SINK.set(Some(sink));
        let scope = Scope(|| SINK.set(None));
        let result = serialize();
        drop(scope);
        match Rc::try_unwrap(shared) {
            Ok(to) => (result, to.into_inner()),
            Err(_) => unreachable!("the scope gave its share back"),
        }
    }

    /// Runs `deserialize`, which must read on this thread; long arrays come from `from`.
    pub fn read<S: Read + Seek + 'static, R>(from: S, deserialize: impl FnOnce() -> R) -> R {
        SOURCE.set(Some(Rc::new(RefCell::new(from))));
        let _scope = Scope(|| SOURCE.set(None));
        deserialize()
    }

    /// Puts values beside the text, if there is such a place and they are many.
    pub(super) fn put<T: Scalar>(values: &[T]) -> io::Result<Option<Place>> {
        if values.len() < LONG {
            return Ok(None);
        }
        SINK.with_borrow_mut(|sink| {
            let Some(sink) = sink else {
                return Ok(None);
            };
            let place = Place {
                at: sink.at,
                len: values.len() as u64,
            };
            let mut to = sink.to.borrow_mut();
            let mut bytes = Vec::new();
            for part in values.chunks(1 << 14) {
                bytes.clear();
                let each = part.iter().map(|v| v.bits().to_le_bytes());
                each.for_each(|b| bytes.extend_from_slice(&b[..T::DIGITS / 2]));
                to.write_all(&bytes)?;
                sink.at += bytes.len() as u64;
            }
            Ok(Some(place))
        })
    }

    /// Whether arrays may be beside the text.
    pub(super) fn is_reading() -> bool {
        SOURCE.with_borrow(Option::is_some)
    }

    /// The values of a place.
    pub(super) fn get<T: Scalar>(place: &Place) -> io::Result<Vec<T>> {
        let Some(source) = SOURCE.with_borrow(Clone::clone) else {
            return Err(io::ErrorKind::NotFound.into());
        };
        let mut source = source.borrow_mut();
        let width = T::DIGITS / 2;
        let found = source.seek(SeekFrom::End(0))?;
        let end = (place.len.checked_mul(width as u64)).and_then(|n| n.checked_add(place.at));
        if end.is_none_or(|end| end > found) {
            let (at, len) = (place.at, place.len);
            return Err(io::Error::other(format!(
                "expected {len} values of {width} bytes from byte {at} on, found {found} bytes in all"
            )));
        }
        source.seek(SeekFrom::Start(place.at))?;
        let mut values = Vec::with_capacity(place.len as usize);
        let mut bytes = vec![0; width << 14];
        while values.len() < place.len as usize {
            let n = (place.len as usize - values.len()).min(1 << 14);
            source.read_exact(&mut bytes[..n * width])?;
            values.extend(bytes[..n * width].chunks_exact(width).filter_map(|b| {
                let mut whole = [0; 8];
                whole[..width].copy_from_slice(b);
                T::of_bits(u64::from_le_bytes(whole))
            }));
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::beside;
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
    fn long_arrays_go_beside_the_text() {
        use std::io::Cursor;
        let values = |n: usize| (0..n).map(|i| (i as f64).sin() / 3.0);
        let record = Record {
            single: values(beside::LONG).map(|x| x as f32).collect(),
            double: values(beside::LONG + 77).collect(),
            number: 0.1,
        };
        let (text, bytes) = beside::write(Vec::new(), || serde_json::to_string(&record).unwrap());
        assert_eq!(
            text,
            r#"{"single":{"at":0,"len":4096},"double":{"at":16384,"len":4173},"number":"0.1"}"#
        );
        assert_eq!(bytes.len(), 4096 * 4 + 4173 * 8);
        let read = |bytes: Vec<u8>, text: &str| {
            beside::read(Cursor::new(bytes), || serde_json::from_str::<Record>(text))
        };
        let back = read(bytes.clone(), &text).unwrap();
        assert!(back.single == record.single && back.double == record.double);
        // Short ones stay, and without such a place all do.
        let short = r#"{"single":"3f800000","double":"","number":"0.1"}"#;
        assert_eq!(read(Vec::new(), short).unwrap().single, [1.0]);
        assert!(serde_json::to_string(&record).unwrap().len() > 2 * bytes.len());

        for (bytes, text) in [
            (bytes[..bytes.len() - 1].to_vec(), text.clone()),
            (bytes.clone(), text.replace("4173", "18446744073709551615")),
            (bytes.clone(), text.replace("16384", "18446744073709551615")),
            (bytes.clone(), text.replace("\"len\"", "\"length\"")),
        ] {
            assert!(read(bytes, &text).is_err(), "{text}");
        }
        assert!(serde_json::from_str::<Record>(&text).is_err());
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
