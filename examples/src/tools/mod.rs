//! The command-line tools: arguments and what they do.

pub mod check;
pub mod compare;
pub mod gradient;
pub mod recover;
pub mod render;
pub mod stability;
