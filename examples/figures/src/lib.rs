//! The figures, by the document that they come from; `docs/figures.md` lists them all.
//!
//! A figure's module has the name of its id, `SOURCE-REST`: it is `SOURCE::REST`, with `_` for `-`, and `fig_` before
//! a number. Figures that come from no document are in [`own`]. Modules of other names are shared by several figures.

pub mod christensen;
pub mod common_scenes;
pub mod differences;
pub mod own;
pub mod stam;
pub mod statistics;
pub mod veach;
pub mod zeltner;
