//! `auto-estimator`: an estimator that chooses by itself, against every single one.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "auto-estimator",
        "an estimator that chooses by itself, against every single one",
        own::auto_estimator::figure,
    )
}
