//! Choices between lobes take primal probabilities (F6).

use render::estimator::{AttachedChoice, DetachedMis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<AttachedChoice<DetachedMis>>();
}
