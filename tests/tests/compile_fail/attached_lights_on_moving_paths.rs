//! Lights sampled from a path that moves as a whole are sampled detached: nobody can allow a bias here, there is no such estimator.

use render::estimator::{AllowBias, Attached, EmitterOnly, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<AllowBias<EmitterOnly<Attached, Attached>>>();
}
