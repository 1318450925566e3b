//! `zeltner-2-14`: shadowing and masking of Beckmann and GGX [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-14",
        "shadowing and masking of Beckmann and GGX",
        zeltner::fig_2_14::figure,
    )
}
