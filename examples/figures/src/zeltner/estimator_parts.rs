//! Parts of an estimator by name, and when one is wrong [Zeltner 2021, footnote 4 and figure 4.13].

use super::taxonomy::{Differentiation, Sampling, Weight};

/// Distance in standard errors beyond which a mean is wrong; one below 4 is not suspicious.
pub(super) const DETECTED: f64 = 8.0;

/// A short name: `d.` and `a.` for the sampling, and what becomes of its weight.
pub(super) fn name(p: Differentiation) -> &'static str {
    match (p.sampling, p.weight) {
        (Sampling::Detached, Weight::Detached) => "d./detached",
        (Sampling::Detached, Weight::Frozen) => "d./frozen",
        (Sampling::Detached, Weight::Attached) => "d./attached",
        (Sampling::Attached, Weight::Detached) => "a./detached",
        (Sampling::Attached, Weight::Frozen) => "a./frozen",
        (Sampling::Attached, Weight::Attached) => "a./attached",
    }
}
