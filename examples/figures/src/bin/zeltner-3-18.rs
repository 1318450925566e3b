//! `zeltner-3-18`: azimuths that wrap around [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-18",
        "azimuths that wrap around",
        zeltner::fig_3_18::figure,
    )
}
