//! One file: its text, its lines, and where it looks for others.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree as xml;

use super::Directories;
use super::value::quoted;
use crate::error::{Location, SceneError};
use crate::file;

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
    let bytes = file::read(path)?;
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
