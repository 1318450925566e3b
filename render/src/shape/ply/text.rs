//! Elements of polygon files in text: one to a line, numbers as programs write them.

use std::str::SplitAsciiWhitespace;

use ply_rs_bw::ply::{ElementDef, PropertyType, ScalarType};

use super::{Element, FACE, WHOLE_INDICES};
use crate::error::quoted;

/// What was expected of a line, and what was found.
type Wrong = (String, String);

/// Largest and smallest whole number of a type, if it is one of whole numbers.
fn whole(of: &ScalarType) -> Option<[i64; 2]> {
    Some(match of {
        ScalarType::Char => [i8::MIN.into(), i8::MAX.into()],
        ScalarType::UChar => [0, u8::MAX.into()],
        ScalarType::Short => [i16::MIN.into(), i16::MAX.into()],
        ScalarType::UShort => [0, u16::MAX.into()],
        ScalarType::Int => [i32::MIN.into(), i32::MAX.into()],
        ScalarType::UInt => [0, u32::MAX.into()],
        ScalarType::Float | ScalarType::Double => return None,
    })
}

/// The words of a line that are still to be read.
struct Words<'a> {
    rest: SplitAsciiWhitespace<'a>,
    /// What they belong to, such as "`vertex` 3 of 8".
    of: &'a str,
}

impl<'a> Words<'a> {
    fn next(&mut self, name: &str) -> Result<&'a str, Wrong> {
        let found = self.rest.next();
        found.ok_or_else(|| (self.expected(name), "the end of the line".to_owned()))
    }

    fn expected(&self, name: &str) -> String {
        format!("a number for {} of {}", quoted(name), self.of)
    }

    fn integer(&mut self, name: &str, [least, most]: [i64; 2]) -> Result<i64, Wrong> {
        let word = self.next(name)?;
        let number = word.parse().ok();
        number
            .filter(|n| (least..=most).contains(n))
            .ok_or_else(|| {
                let expected = format!(
                    "a whole number from {least} to {most} for {} of {}",
                    quoted(name),
                    self.of
                );
                (expected, quoted(word))
            })
    }

    /// In the precision of its type, as in binary. Some programs write `-nan(ind)` for what is no number.
    fn float(&mut self, name: &str, kind: &ScalarType) -> Result<f64, Wrong> {
        let word = self.next(name)?;
        let bare = word.trim_start_matches(['+', '-']).as_bytes();
        let parsed = match kind {
            ScalarType::Double => word.parse(),
            _ => word.parse::<f32>().map(f64::from),
        };
        match parsed {
            Ok(number) => Ok(number),
            Err(_) if bare.len() > 2 && bare[..3].eq_ignore_ascii_case(b"nan") => Ok(f64::NAN),
            Err(_) => Err((self.expected(name), quoted(word))),
        }
    }
}

/// The element that a line holds, which is called `of` in messages.
///
/// # Errors
/// Another number of words than the element has, or another kind.
pub(super) fn element(line: &str, def: &ElementDef, of: &str) -> Result<Element, Wrong> {
    let mut words = Words {
        rest: line.split_ascii_whitespace(),
        of,
    };
    let mut out = <Element as ply_rs_bw::ply::PropertyAccess>::new();
    for (name, property) in &def.properties {
        match &property.data_type {
            PropertyType::Scalar(kind) => {
                let (value, most) = match whole(kind) {
                    Some(range) => (words.integer(name, range)? as f64, range[1] as f64),
                    None => (words.float(name, kind)?, 0.0),
                };
                out.number(name, value, most);
            }
            PropertyType::List(_, kind) => {
                let count = words.integer(name, [0, u32::MAX.into()])?;
                let is_face = FACE.contains(&name.as_str());
                match whole(kind) {
                    Some(range) => {
                        for _ in 0..count {
                            let index = words.integer(name, range)?;
                            if is_face {
                                out.indices.push(index);
                            }
                        }
                    }
                    None if is_face => return Err((WHOLE_INDICES.to_owned(), "others".to_owned())),
                    None => {
                        for _ in 0..count {
                            words.float(name, kind)?;
                        }
                    }
                }
            }
        }
    }
    match words.rest.next() {
        None => Ok(out),
        Some(more) => Err((format!("the end of the line behind {of}"), quoted(more))),
    }
}
