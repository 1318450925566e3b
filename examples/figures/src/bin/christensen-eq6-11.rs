//! `christensen-eq6-11`: radiance and importance between patches [Christensen et al. 1993].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::christensen;

fn main() -> ExitCode {
    Figure::run(
        "christensen-eq6-11",
        "radiance and importance between patches",
        christensen::eq6_11::figure,
    )
}
