//! `zeltner-3-30`: glints, their memory and their noise [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-30",
        "glints, their memory and their noise",
        zeltner::fig_3_30::figure,
    )
}
