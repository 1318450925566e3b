//! Meaningless estimators do not compile, and the message says what to do.

use ad_core::Real;
use render::estimator::{
    AllowBias, Capabilities, Detached, DetachedWeights, Heuristic, Mis, Unbiased,
};

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "checks the renderer once more: runs with --release"
)]
fn misuse_does_not_compile() {
    let t = trybuild::TestCases::new();
    t.compile_fail("tests/compile_fail/*.rs");
}

/// The heuristic of `compile_fail/new_heuristic.rs`.
struct Mine;

impl Heuristic for Mine {
    type Primal = Self;
    fn weight<R: Real>(a: R, _b: R) -> R {
        a
    }
}

/// What the message says does compile.
#[test]
fn what_is_new_compiles_with_allow_bias() {
    fn capabilities<S: Unbiased>() -> Capabilities {
        Capabilities::of::<S>()
    }
    type New = Mis<Detached, Detached, DetachedWeights, Mine>;
    let c = capabilities::<AllowBias<New>>();
    assert!(c.study && c.failures.is_empty());
}
