//! `christensen-03`: error against links with and without importance [Christensen et al. 1993].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::christensen;

fn main() -> ExitCode {
    Figure::run(
        "christensen-03",
        "error against links with and without importance",
        christensen::fig_03::figure,
    )
}
