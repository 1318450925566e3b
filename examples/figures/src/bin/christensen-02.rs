//! `christensen-02`: piecewise-constant solutions against the path tracer [Christensen et al. 1993].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::christensen;

fn main() -> ExitCode {
    Figure::run(
        "christensen-02",
        "piecewise-constant solutions against the path tracer",
        christensen::fig_02::figure,
    )
}
