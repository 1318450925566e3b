//! Roulette takes primal probabilities (F5).

use render::estimator::{AttachedRoulette, DetachedMis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<AttachedRoulette<DetachedMis>>();
}
