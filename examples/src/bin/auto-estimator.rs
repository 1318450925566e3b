//! `auto-estimator`: an estimator that chooses by itself, against every single one.

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "auto-estimator",
        "an estimator that chooses by itself, against every single one",
        scenes::automatic::figure,
    )
}
