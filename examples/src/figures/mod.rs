//! The figures of the seed documents, one module per document.

pub mod christensen;
pub mod scenes;
pub mod stage;
pub mod stam;
pub mod statistics;
pub mod veach;
pub mod zeltner;
