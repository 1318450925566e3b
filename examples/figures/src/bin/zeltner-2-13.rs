//! `zeltner-2-13`: Beckmann and GGX distributions of normals [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-13",
        "Beckmann and GGX distributions of normals",
        zeltner::fig_2_13::figure,
    )
}
