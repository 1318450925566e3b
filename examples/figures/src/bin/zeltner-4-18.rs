//! `zeltner-4-18`: attached samples at discontinuities, naive and reparameterised [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-18",
        "attached samples at discontinuities, naive and reparameterised",
        zeltner::fig_4_18::figure,
    )
}
