//! Nor are new weights.

use ad_core::Real;
use render::estimator::memory::Forget;
use render::estimator::{Detached, Heuristic, Mis, Unbiased, Weights};

struct Mine;

impl Weights for Mine {
    type Edge = Forget;
    fn hit<H: Heuristic, R: Real>(a: R, b: R) -> R {
        H::weight(a, b)
    }
}

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Detached, Detached, Mine>>();
}
