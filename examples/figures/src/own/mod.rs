//! Figures of this project's own, which reproduce no document.

pub mod auto_estimator;
pub mod caustic_ring;
pub mod every_chain;
pub mod guided_pool;
pub mod measured_pixels;
pub mod moving_outlines;
pub mod second_order;
pub mod spread_samples;
mod two_ways;
