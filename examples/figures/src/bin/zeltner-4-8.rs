//! `zeltner-4-8`: following rays and harmonic convolution [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-8",
        "following rays and harmonic convolution",
        zeltner::fig_4_8::figure,
    )
}
