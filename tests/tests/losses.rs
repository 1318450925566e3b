//! What noise in an image does to losses, as `optim::loss` says it.

use optim::{Loss, LossKind};
use render::sampler::{Independent, Sampler};
use tests::stats::{Estimate, z_limit};

const RUNS: u64 = 200_000;

/// Mean adjoint of one pixel of mean 1 at the optimum, for `spp` samples of exponential noise (the mean of the image's
/// distribution is the target).
fn bias(loss: LossKind, spp: u32) -> Estimate {
    let adjoint = |run: u64| {
        let mut sampler = Independent::new(u64::from(spp), 0, run);
        let sample = |_| -(-sampler.next_1d::<f64>()).ln_1p();
        let pixel = (0..spp).map(sample).sum::<f64>() / f64::from(spp);
        let mut d = [0.0];
        loss.gradient(&[pixel], &[1.0], &mut d)
            .expect("one pixel each");
        d[0]
    };
    Estimate::of(&(0..RUNS).map(adjoint).collect::<Vec<_>>())
}

/// Which losses are biased by skewed noise, and how fast the bias falls: two that are not, significance 1 in 1000 together.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn bias_under_skewed_noise_is_as_documented() {
    let [l1, l2, relative_l1, relative_l2, log_l2] = LossKind::NAMES.map(|name| {
        let loss: LossKind = name.parse().expect("a loss");
        loss
    });
    let limit = z_limit(2, RUNS, 1e-3);
    for loss in [l2, relative_l2] {
        let found = bias(loss, 4);
        let z = found.z(&Estimate::exact(0.0)).abs();
        assert!(z < limit, "{loss:?}: {found:?}");
    }
    // Expected ratio of the biases at 4 and 64 samples: 4 for N^-1/2, 16 for 1/N (and the higher orders of so few samples).
    for (loss, lowest, highest) in [
        (l1, 3.0, 5.0),
        (relative_l1, 3.0, 5.0),
        (log_l2, 13.0, 40.0),
    ] {
        let (few, many) = (bias(loss, 4), bias(loss, 64));
        assert!(many.mean.abs() > 8.0 * many.se, "{loss:?}: {many:?}");
        let ratio = few.mean / many.mean;
        assert!(
            ratio > lowest && ratio < highest,
            "{loss:?}: {few:?} / {many:?} = {ratio}"
        );
    }
}
