//! `zeltner-4-13`: mixing attached and detached techniques [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-13",
        "mixing attached and detached techniques",
        zeltner::fig_4_13::figure,
    )
}
