//! `zeltner-3-8`: a ball of smooth glass by one walk [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-8",
        "a ball of smooth glass by one walk",
        zeltner::fig_3_8::figure,
    )
}
