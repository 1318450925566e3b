//! `zeltner-2-21`: good and bad sampling densities [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-21",
        "good and bad sampling densities",
        zeltner::fig_2_21::figure,
    )
}
