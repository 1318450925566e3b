//! `zeltner-2-28`: a box by path length [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-28",
        "a box by path length",
        zeltner::fig_2_28::figure,
    )
}
