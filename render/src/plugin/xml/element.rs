//! XML elements that know which of their attributes are understood.

use super::value::{self, Mismatch};
use crate::error::{Location, SceneError, quoted};

/// An XML attribute.
pub(super) struct Attribute {
    pub name: String,
    pub text: String,
    pub location: Location,
}

/// An XML element whose attributes are taken one by one, so that what is left over is unknown.
pub(super) struct Element {
    pub tag: String,
    /// What messages call it.
    pub key: String,
    pub location: Location,
    pub attributes: Vec<Attribute>,
    pub asked: Vec<&'static str>,
}

impl Element {
    pub fn has(&self, name: &str) -> bool {
        self.peek(name).is_some()
    }

    pub fn peek(&self, name: &str) -> Option<&str> {
        let attribute = self.attributes.iter().find(|a| a.name == name)?;
        Some(&attribute.text)
    }

    pub fn take(&mut self, name: &'static str) -> Option<Attribute> {
        self.asked.push(name);
        let index = self.attributes.iter().position(|a| a.name == name)?;
        Some(self.attributes.swap_remove(index))
    }

    pub fn require(&mut self, name: &'static str) -> Result<Attribute, SceneError> {
        self.take(name).ok_or_else(|| SceneError::Missing {
            location: self.location.clone(),
            owner: self.name(),
            key: name.to_owned(),
            expected: "an attribute".to_owned(),
        })
    }

    pub fn parse<T>(
        &mut self,
        name: &'static str,
        convert: impl FnOnce(&str) -> Result<T, Mismatch>,
    ) -> Result<T, SceneError> {
        let attribute = self.require(name)?;
        convert(&attribute.text).map_err(|error| SceneError::Value {
            location: attribute.location,
            key: match name {
                "value" => self.key.clone(),
                _ => format!("{}.{name}", self.key),
            },
            expected: error.expected.to_owned(),
            found: error.found,
        })
    }

    /// `value="x y z"`, or some of `x`, `y` and `z`.
    pub fn coordinates(
        &mut self,
        absent: f64,
        convert: impl FnOnce(&str) -> Result<[f64; 3], Mismatch>,
    ) -> Result<[f64; 3], SceneError> {
        if self.has("value") {
            return self.parse("value", convert);
        }
        if !["x", "y", "z"].iter().any(|axis| self.has(axis)) {
            return Err(SceneError::Missing {
                location: self.location.clone(),
                owner: self.name(),
                key: "value".to_owned(),
                expected: "three numbers there, or some of `x`, `y` and `z`".to_owned(),
            });
        }
        let mut out = [absent; 3];
        for (slot, axis) in out.iter_mut().zip(["x", "y", "z"]) {
            if self.has(axis) {
                *slot = self.parse(axis, value::float)?;
            }
        }
        Ok(out)
    }

    pub fn finish(&self) -> Result<(), SceneError> {
        match self.attributes.first() {
            None => Ok(()),
            Some(attribute) => Err(SceneError::Unknown {
                location: attribute.location.clone(),
                what: format!("attribute {}", quoted(&attribute.name)),
                owner: self.name(),
                known: self.asked.iter().map(|&name| name.to_owned()).collect(),
            }),
        }
    }

    /// `<tag>`, shortened if need be.
    pub fn name(&self) -> String {
        format!("<{}>", quoted(&self.tag).trim_matches('`'))
    }

    pub fn syntax(&self, expected: &str) -> SceneError {
        SceneError::Syntax {
            location: self.location.clone(),
            expected: expected.to_owned(),
            found: self.name(),
        }
    }

    pub fn value_error(&self, expected: &str, found: &str) -> SceneError {
        SceneError::Value {
            location: self.location.clone(),
            key: self.key.clone(),
            expected: expected.to_owned(),
            found: found.to_owned(),
        }
    }
}
