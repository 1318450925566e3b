//! `moving-outlines`: edges, directions that follow, and differences.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "moving-outlines",
        "edges, directions that follow, and differences",
        own::moving_outlines::figure,
    )
}
