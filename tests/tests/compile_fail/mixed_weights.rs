//! Weights are differentiated for all techniques or for none (errata Z-4.13f, F4).

use render::estimator::{Detached, Mis, MixedWeights, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Detached, Detached, MixedWeights>>();
}
