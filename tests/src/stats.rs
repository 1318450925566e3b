//! How far apart estimates may lie by chance: [`render::statistics`].

pub use render::statistics::{Estimate, z_limit};
