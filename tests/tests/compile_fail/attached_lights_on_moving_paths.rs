//! Lights sampled from a path that moves as a whole are sampled detached.

use render::estimator::{Attached, EmitterOnly, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<EmitterOnly<Attached, Attached>>();
}
