//! Command-line tools and reproduced figures, and what they share.

pub mod chart;
pub mod cli;
pub mod figure;
pub mod figures;
pub mod memory;
pub mod optimise;
pub mod output;
pub mod print;
pub mod progress;
pub mod scenes;
pub mod sheet;
pub mod tools;
