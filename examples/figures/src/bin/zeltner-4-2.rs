//! `zeltner-4-2`: the optimisation loop [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-2",
        "the optimisation loop",
        zeltner::fig_4_2::figure,
    )
}
