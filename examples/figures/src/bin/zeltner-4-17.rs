//! `zeltner-4-17`: where attached samples stand still [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-17",
        "where attached samples have to stand still",
        zeltner::fig_4_17::figure,
    )
}
