//! Samples of lights that move need weights that move with them.

use render::estimator::{Attached, Detached, DetachedWeights, Mis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Detached, Attached, DetachedWeights>>();
}
