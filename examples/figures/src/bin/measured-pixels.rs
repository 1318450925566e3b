//! `measured-pixels`: what samples gain that go where a derivative is noisy.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "measured-pixels",
        "what samples gain that go where a derivative is noisy",
        own::measured_pixels::figure,
    )
}
