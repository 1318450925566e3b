//! Command-line tools and reproduced figures, and what they share.

pub mod builtin_scene;
pub mod chart;
pub mod cli;
pub mod figure;
pub mod figures;
pub mod memory;
pub mod optimise;
pub mod output;
pub mod print;
pub mod progress;
pub mod scene_builder;
pub mod sheet;
pub mod tools;
