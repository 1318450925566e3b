//! `zeltner-2-16`: factors of the rendering equation at two points [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-16",
        "factors of the rendering equation at two points",
        zeltner::fig_2_16::figure,
    )
}
