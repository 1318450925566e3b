//! `zeltner-3-17`: constraints of half vectors and of angles [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-17",
        "constraints of half vectors and of angles",
        zeltner::fig_3_17::figure,
    )
}
