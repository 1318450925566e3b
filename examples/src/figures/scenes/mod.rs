//! Figures of [Zeltner 2021] that show whole scenes: chapters 1 and 2, and the passes of chapter 4.
//!
//! The scenes come from [`super::stage`].

pub mod automatic;
pub mod backpropagation;
pub mod caustics;
pub mod direct_light;
pub mod environment;
pub mod estimators;
pub mod factors;
pub mod freezing;
pub mod guided;
pub mod materials;
pub mod measured;
pub mod moved_edges;
pub mod outlines;
pub mod path_length;
pub mod propagation;
pub mod recovery;
pub mod roughness_texture;
pub mod second_order;
pub mod split;
pub mod spread;
pub mod table;
pub mod texels;
pub mod tray;
