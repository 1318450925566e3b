//! Attached sampling with detached MIS weights is biased (errata Z-4.13f).

use render::estimator::{Attached, Detached, DetachedWeights, Mis, Unbiased};

fn estimate<S: Unbiased>() {}

fn main() {
    estimate::<Mis<Attached, Detached, DetachedWeights>>();
}
