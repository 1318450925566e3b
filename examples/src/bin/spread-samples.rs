//! `spread-samples`: what Sobol points and antithetic pairs gain, per estimator.

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "spread-samples",
        "what Sobol points and antithetic pairs gain, per estimator",
        scenes::spread::figure,
    )
}
