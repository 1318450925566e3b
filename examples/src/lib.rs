//! Command-line tools, and what they share with the figures.

pub mod builtin_scene;
pub mod chart;
pub mod cli;
pub mod figure;
pub mod memory;
pub mod optimise;
pub mod output;
pub mod print;
pub mod progress;
pub mod ranks;
pub mod scene_builder;
pub mod sheet;
pub mod tools;
