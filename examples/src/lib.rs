//! Command-line tools and reproduced figures, and what they share.

pub mod chart;
pub mod figure;
pub mod figures;
