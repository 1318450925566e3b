//! `spread-samples`: what Sobol points, antithetic pairs and weighed lights gain, per estimator.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "spread-samples",
        "what Sobol points, antithetic pairs and weighed lights gain, per estimator",
        own::spread_samples::figure,
    )
}
