//! `zeltner-3-26`: trial sets of growing size [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-26",
        "trial sets of growing size",
        zeltner::fig_3_26::figure,
    )
}
