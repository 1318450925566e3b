//! What can go wrong, as values.

use std::ops::Range;

/// An error of this crate. Whatever returns one has changed nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OptimError {
    /// A slice has the wrong number of entries.
    #[error("{what}: expected {expected} entries, found {found}")]
    Length {
        /// The slice's role: `params`, `grad`, `target`, ...
        what: &'static str,
        /// Number of entries that was expected.
        expected: usize,
        /// Number of entries that was found.
        found: usize,
    },
    /// An image without entries has no mean loss.
    #[error("image: expected at least one entry, found none")]
    EmptyImage,
    /// A gradient entry is NaN or infinite; usually a division by a vanishing density.
    #[error("gradient: expected a finite value, found {value} at {}", place(*.index, group))]
    NonFiniteGradient {
        /// Index into the flat gradient.
        index: usize,
        /// The entry.
        value: f64,
        /// The named range that holds it, where there is one.
        group: Option<String>,
    },
    /// A parameter, image or target entry is NaN or infinite.
    #[error("{what}: expected a finite value, found {value} at {}", place(*.index, group))]
    NonFiniteValue {
        /// The slice's role.
        what: &'static str,
        /// Index into the flat slice.
        index: usize,
        /// The entry.
        value: f64,
        /// The named range that holds it, where there is one.
        group: Option<String>,
    },
    /// Finite inputs whose result exceeds the range of the scalar type.
    #[error("{what}: the result at index {index} exceeds the range of the scalar type")]
    Overflow {
        /// What overflowed.
        what: &'static str,
        /// Index into the flat slice.
        index: usize,
    },
    /// A hyper-parameter or bound is outside its range.
    #[error("{name}: expected {expected}, found {found}")]
    Option {
        /// The option's name.
        name: &'static str,
        /// Its valid values.
        expected: &'static str,
        /// The value that was found.
        found: f64,
    },
    /// A named or numbered range does not fit into the parameter vector.
    #[error("range {}..{}: expected a non-empty range within 0..{len}", .range.start, .range.end)]
    Range {
        /// The range.
        range: Range<usize>,
        /// Number of parameters.
        len: usize,
    },
    /// Two groups share entries or a name.
    #[error("group `{second}`: expected names and ranges that differ from those of `{first}`")]
    GroupConflict {
        /// The group that came first.
        first: String,
        /// The group that clashes with it.
        second: String,
    },
    /// The entries of a group cannot move together as was asked for.
    #[error("group `{group}`: expected {expected}, found {found}")]
    Tied {
        /// The group.
        group: String,
        /// What such a group needs.
        expected: String,
        /// What it has.
        found: String,
    },
    /// A physical value outside the domain of its reparameterisation.
    #[error("parameter: expected {expected}, found {value} at {}", place(*.index, group))]
    OutOfDomain {
        /// Index into the flat parameters.
        index: usize,
        /// The value.
        value: f64,
        /// The named range that holds it.
        group: Option<String>,
        /// The domain.
        expected: String,
    },
    /// A name that this crate does not know.
    #[error("{what}: expected one of {expected}, found `{found}`")]
    UnknownName {
        /// What was to be named.
        what: &'static str,
        /// The known names.
        expected: String,
        /// The name that was found.
        found: String,
    },
}

fn place(index: usize, group: &Option<String>) -> String {
    match group {
        Some(name) => format!("index {index} (in `{name}`)"),
        None => format!("index {index}"),
    }
}

/// `Ok` where the condition holds, else the error of a bad hyper-parameter.
pub(crate) fn require(
    holds: bool,
    name: &'static str,
    expected: &'static str,
    found: f64,
) -> Result<(), OptimError> {
    if holds {
        Ok(())
    } else {
        Err(OptimError::Option {
            name,
            expected,
            found,
        })
    }
}

/// Checks the length of a slice.
pub(crate) fn require_len(
    what: &'static str,
    expected: usize,
    found: usize,
) -> Result<(), OptimError> {
    if expected == found {
        Ok(())
    } else {
        Err(OptimError::Length {
            what,
            expected,
            found,
        })
    }
}
