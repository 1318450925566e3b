//! Lights sampled beside a differential pair are sampled detached.

use render::estimator::{Attached, AttachedWeights, Differential, Mis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Differential, Attached, AttachedWeights>>();
}
