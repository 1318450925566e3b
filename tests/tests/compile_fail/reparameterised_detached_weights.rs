//! Constant weights at samples that move: biased [Zeltner 2021, Eq. 4.38] (F3).

use render::estimator::{Detached, DetachedWeights, Mis, Reparameterised, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Reparameterised, Detached, DetachedWeights>>();
}
