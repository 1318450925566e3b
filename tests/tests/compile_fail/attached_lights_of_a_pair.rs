//! Lights sampled beside a differential pair are sampled detached: nobody can allow a bias here, there is no such estimator.

use render::estimator::{AllowBias, Attached, AttachedWeights, Differential, Mis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<AllowBias<Mis<Differential, Attached, AttachedWeights>>>();
}
