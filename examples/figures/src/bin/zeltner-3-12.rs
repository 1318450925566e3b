//! `zeltner-3-12`: slopes that footprints see [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-12",
        "slopes that footprints see",
        zeltner::fig_3_12::figure,
    )
}
