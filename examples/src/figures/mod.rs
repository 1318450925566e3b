//! The figures of the seed documents, one module per document.

pub mod stam;
