//! `zeltner-4-4`: derivatives sent forward through a scene [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-4",
        "derivatives sent forward through a scene",
        zeltner::fig_4_4::figure,
    )
}
