//! Nor is a new heuristic, even with constant samples.

use ad_core::Real;
use render::estimator::{Detached, DetachedWeights, Heuristic, Mis, Unbiased};

struct Mine;

impl Heuristic for Mine {
    type Primal = Self;
    fn weight<R: Real>(a: R, _b: R) -> R {
        a
    }
}

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Detached, Detached, DetachedWeights, Mine>>();
}
