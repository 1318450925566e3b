//! `christensen-01`: four boxes, path-traced and by finite elements [Christensen et al. 1993].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::christensen;

fn main() -> ExitCode {
    Figure::run(
        "christensen-01",
        "four boxes, path-traced and by finite elements",
        christensen::fig_01::figure,
    )
}
