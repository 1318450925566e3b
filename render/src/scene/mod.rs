//! Scenes.

pub mod xml;
