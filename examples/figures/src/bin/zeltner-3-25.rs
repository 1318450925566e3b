//! `zeltner-3-25`: a wall of metal and a ball of glass by several methods [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-25",
        "a wall of metal and a ball of glass by several methods",
        zeltner::fig_3_25::figure,
    )
}
