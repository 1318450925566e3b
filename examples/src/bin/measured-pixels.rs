//! `measured-pixels`: what samples gain that go where a derivative is noisy.

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "measured-pixels",
        "what samples gain that go where a derivative is noisy",
        scenes::measured::figure,
    )
}
