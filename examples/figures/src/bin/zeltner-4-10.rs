//! `zeltner-4-10`: detached sampling of a wrapped normal distribution [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-10",
        "detached sampling of a wrapped normal distribution",
        zeltner::fig_4_10::figure,
    )
}
