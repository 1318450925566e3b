//! `zeltner-4-16`: samples of distributions of normals and of their derivatives [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-16",
        "samples of distributions of normals and of their derivatives",
        zeltner::fig_4_16::figure,
    )
}
