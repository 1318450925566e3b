//! `zeltner-4-7`: directions that follow, and how many neighbours it takes [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-7",
        "directions that follow, and how many neighbours it takes",
        zeltner::fig_4_7::figure,
    )
}
