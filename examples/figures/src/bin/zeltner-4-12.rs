//! `zeltner-4-12`: discontinuities moved by sampling [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-12",
        "discontinuities moved by sampling",
        zeltner::fig_4_12::figure,
    )
}
