//! `zeltner-2-22`: inverse-transform sampling [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-22",
        "inverse-transform sampling",
        zeltner::fig_2_22::figure,
    )
}
