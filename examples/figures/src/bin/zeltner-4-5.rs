//! `zeltner-4-5`: an adjoint image sent backward through a scene [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-5",
        "an adjoint image sent backward through a scene",
        zeltner::fig_4_5::figure,
    )
}
