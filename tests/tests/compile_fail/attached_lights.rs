//! Lights are sampled detached: there is no such estimator.

use render::estimator::{Attached, AttachedWeights, Detached, Mis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Detached, Attached, AttachedWeights>>();
}
