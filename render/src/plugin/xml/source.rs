//! One file: its text, its lines, and where it looks for others.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree as xml;

use super::{Directories, MAX_ATTRIBUTES, MAX_NAMESPACES, MAX_TEXT, check_limit};
use crate::error::{Location, SceneError, quoted};
use crate::files;

/// One file.
pub(super) struct Source {
    /// As messages name it.
    name: Arc<Path>,
    pub directories: Directories,
    /// Byte offsets of the line ends.
    line_ends: Vec<usize>,
}

impl Source {
    pub fn new(name: &Path, directories: Directories, text: &str) -> Self {
        Self {
            name: name.into(),
            directories,
            line_ends: text.match_indices('\n').map(|(i, _)| i).collect(),
        }
    }

    pub fn at(&self, byte: usize) -> Location {
        let line = 1 + self.line_ends.partition_point(|&end| end < byte);
        Location::new(self.name.clone(), u32::try_from(line).unwrap_or(u32::MAX))
    }

    /// The elements of `text`, which is that given to [`new`](Self::new).
    pub fn parse<'t>(&self, text: &'t str) -> Result<xml::Document<'t>, SceneError> {
        self.check_tags(text)?;
        xml::Document::parse(text).map_err(|error| {
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

/// The text of a file.
pub(super) fn read(path: &Path) -> Result<String, SceneError> {
    let bytes = files::read(path, MAX_TEXT as u64)?;
    String::from_utf8(bytes).map_err(|error| {
        let valid = error.utf8_error().valid_up_to();
        let lines = error.as_bytes()[..valid].iter().filter(|b| **b == b'\n');
        let line = u32::try_from(1 + lines.count()).unwrap_or(u32::MAX);
        SceneError::Syntax {
            location: Location::new(path, line),
            expected: "text in UTF-8".to_owned(),
            found: format!("the byte {:#04x}", error.as_bytes()[valid]),
        }
    })
}

/// One name per file, for comparison only.
pub(super) fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}
