//! One file: its text, its lines, and where it looks for others.

use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree as xml;

use super::{Directories, MAX_ATTRIBUTES, MAX_NAMESPACES, MAX_TEXT, check_limit};
use crate::error::{Location, SceneError, quoted};
use crate::files;

/// Of the format: major and minor.
pub(super) type Version = (u32, u32);

/// What texts without a version are taken for.
const CURRENT: Version = (3, 0);

/// One file.
pub(super) struct Source {
    /// As messages name it.
    name: Arc<Path>,
    directories: RefCell<Directories>,
    /// Of the format that it is written in: its first two numbers.
    pub version: Cell<Version>,
    /// Byte offsets of the line ends.
    line_ends: Vec<usize>,
}

impl Source {
    pub fn new(name: &Path, directories: Directories, text: &str) -> Self {
        Self {
            name: name.into(),
            directories: RefCell::new(directories),
            version: Cell::new(CURRENT),
            line_ends: text.match_indices('\n').map(|(i, _)| i).collect(),
        }
    }

    /// Where its file names are looked up, from here on.
    pub fn directories(&self) -> Directories {
        self.directories.borrow().clone()
    }

    /// Looks first in another folder from here on.
    pub fn look_in(&self, folder: &Path) {
        let directories = Directories::new(folder, Some(&self.directories()));
        *self.directories.borrow_mut() = directories;
    }

    pub fn at(&self, byte: usize) -> Location {
        let line = 1 + self.line_ends.partition_point(|&end| end < byte);
        Location::new(self.name.clone(), u32::try_from(line).unwrap_or(u32::MAX)).at_byte(byte)
    }

    /// The elements of `text`, which is that given to [`new`](Self::new).
    pub fn parse<'t>(&self, text: &'t str) -> Result<xml::Document<'t>, SceneError> {
        self.check_tags(text)?;
        // A document type says nothing about a scene, but its entities would be text from nowhere.
        if let Some(entity) = text.find("<!ENTITY") {
            return Err(SceneError::Syntax {
                location: self.at(entity),
                expected: "no entities".to_owned(),
                found: "<!ENTITY".to_owned(),
            });
        }
        let options = xml::ParsingOptions {
            allow_dtd: true,
            ..xml::ParsingOptions::default()
        };
        xml::Document::parse_with_options(text, options).map_err(|error| {
            let line = match error {
                // These carry no position.
                xml::Error::UnexpectedEndOfStream
                | xml::Error::UnclosedRootNode
                | xml::Error::NoRootNode => self.at(text.len()).line,
                _ => error.pos().row,
            };
            SceneError::Syntax {
                location: Location::new(self.name.clone(), line),
                expected: "well-formed XML".to_owned(),
                found: format!("an error: {error}"),
            }
        })
    }

    /// Limits the attributes of each tag, and the namespaces of all: the parser compares each with all others.
    fn check_tags(&self, text: &str) -> Result<(), SceneError> {
        let mut namespaces = 0;
        let mut at = 0;
        while let Some(open) = text[at..].find('<') {
            at += open + 1;
            let rest = &text[at..];
            let skipped = [("!--", "-->"), ("![CDATA[", "]]>"), ("?", "?>"), ("!", ">")];
            if let Some((_, end)) = skipped.iter().find(|(start, _)| rest.starts_with(start)) {
                match rest.find(end) {
                    Some(length) => at += length + end.len(),
                    None => break,
                }
                continue;
            }
            let (mut quote, mut attributes, mut previous) = (None, 0, b' ');
            let mut length = rest.len();
            for (i, byte) in rest.bytes().enumerate() {
                match (quote, byte) {
                    (Some(q), _) if q == byte => quote = None,
                    (Some(_), _) => {}
                    (None, b'"' | b'\'') => {
                        quote = Some(byte);
                        attributes += 1;
                        let here = || self.at(at + i);
                        if attributes > MAX_ATTRIBUTES {
                            let what = "attributes of an element";
                            check_limit(attributes, MAX_ATTRIBUTES, what, &here())?;
                        }
                        if namespaces > MAX_NAMESPACES {
                            check_limit(namespaces, MAX_NAMESPACES, "namespaces", &here())?;
                        }
                    }
                    (None, b'>' | b'<') => {
                        length = i;
                        break;
                    }
                    (None, b'x') if previous.is_ascii_whitespace() => {
                        namespaces += usize::from(rest[i..].starts_with("xmlns"));
                    }
                    _ => {}
                }
                previous = byte;
            }
            at += length;
        }
        Ok(())
    }

    /// The child elements. Text between them is an error: nothing in the format is written as text.
    pub fn elements<'a, 'i: 'a>(
        &self,
        parent: xml::Node<'a, 'i>,
    ) -> impl Iterator<Item = Result<xml::Node<'a, 'i>, SceneError>> {
        parent.children().filter_map(move |node| {
            if node.is_element() {
                return Some(Ok(node));
            }
            let text = node.text().filter(|_| node.is_text())?;
            let word = text.trim();
            (!word.is_empty()).then(|| {
                let indent = text.len() - text.trim_start().len();
                Err(SceneError::Syntax {
                    location: self.at(node.range().start + indent),
                    expected: "an element".to_owned(),
                    found: format!("the text {}", quoted(word)),
                })
            })
        })
    }
}

/// The text of a file: in UTF-16 if it starts with its mark, in Latin-1 if it says so, or else in UTF-8.
pub(super) fn read(path: &Path) -> Result<String, SceneError> {
    let bytes = files::read(path, MAX_TEXT as u64)?;
    let error = |valid: &[u8], expected: String, found: String| {
        let lines = valid.iter().filter(|b| **b == b'\n');
        let line = u32::try_from(1 + lines.count()).unwrap_or(u32::MAX);
        SceneError::Syntax {
            location: Location::new(path, line),
            expected,
            found,
        }
    };
    let unit: Option<fn([u8; 2]) -> u16> = match bytes[..] {
        [0xff, 0xfe, ..] => Some(u16::from_le_bytes),
        [0xfe, 0xff, ..] => Some(u16::from_be_bytes),
        _ => None,
    };
    if let Some(unit) = unit {
        let (pairs, rest) = bytes[2..].as_chunks::<2>();
        let units = pairs.iter().map(|&pair| unit(pair));
        let text: Option<String> = char::decode_utf16(units).map(Result::ok).collect();
        return (text.filter(|_| rest.is_empty())).ok_or_else(|| {
            let expected = "text in UTF-16, as its first two bytes say";
            error(&[], expected.to_owned(), "half a character".to_owned())
        });
    }
    let encoding = declared_encoding(&bytes);
    let latin = ["iso-8859-1", "iso8859-1", "latin1", "latin-1", "l1"];
    if let Some(name) = &encoding
        && latin.contains(&name.as_str())
    {
        return Ok(bytes.iter().map(|&b| char::from(b)).collect());
    }
    String::from_utf8(bytes).map_err(|utf8| {
        let (valid, rest) = utf8.as_bytes().split_at(utf8.utf8_error().valid_up_to());
        let said = match encoding.as_deref() {
            None | Some("utf-8" | "utf8") => String::new(),
            Some(name) => format!(" or Latin-1, not {}", quoted(name)),
        };
        let found = format!("the byte {:#04x}", rest[0]);
        error(valid, format!("text in UTF-8{said}"), found)
    })
}

/// The encoding of an XML declaration, in lower case.
fn declared_encoding(bytes: &[u8]) -> Option<String> {
    let end = bytes.windows(2).take(256).position(|w| w == b"?>")?;
    let declaration = std::str::from_utf8(&bytes[..end]).ok()?;
    let after = declaration
        .strip_prefix("<?xml")?
        .split_once("encoding")?
        .1
        .trim_start()
        .strip_prefix('=')?
        .trim_start();
    let quote = after.chars().next().filter(|c| ['"', '\''].contains(c))?;
    let name = after[1..].split(quote).next()?;
    Some(name.to_ascii_lowercase())
}

/// One name per file, for comparison only.
pub(super) fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
