//! `zeltner-1-1`: a scene rendered forward and recovered backward [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-1-1",
        "a scene rendered forward and recovered backward",
        zeltner::fig_1_1::figure,
    )
}
