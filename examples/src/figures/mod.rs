//! The figures, by the document that they come from; `docs/figures.md` lists them all.

pub mod christensen;
pub mod scenes;
pub mod stage;
pub mod stam;
pub mod statistics;
pub mod veach;
pub mod zeltner;
