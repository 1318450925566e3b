//! One program of all tests across the crates: what they compile of generic code, they compile once. Those of
//! which all tests need a release are not compiled with debug assertions.

mod attached_choice;
mod attached_emitters;
mod auto;
mod bump_maps;
mod cancellation;
mod caustics;
mod check;
mod compile_fail;
mod convolved;
mod crossings;
mod determinism;
mod documents;
#[cfg(not(debug_assertions))]
mod estimator_matrix;
mod estimators;
mod glints;
mod gradients;
mod guide;
mod hidden_lamps;
mod house_rules;
mod instancing;
mod lenses;
mod light;
mod losses;
mod manifold;
mod manifold_complete;
#[cfg(not(debug_assertions))]
mod manifold_energy;
#[cfg(not(debug_assertions))]
mod manifold_scenes;
mod mirrors;
#[cfg(not(debug_assertions))]
mod mitsuba;
mod mitsuba_plugins;
#[cfg(not(debug_assertions))]
mod motion_matrix;
#[cfg(not(debug_assertions))]
mod normal_maps;
#[cfg(not(debug_assertions))]
mod odd_places;
mod outlines;
mod pixels;
mod planes;
mod published_integrators;
mod schema;
mod second_order;
mod simple;
mod sums;
mod transport;
mod waves;
