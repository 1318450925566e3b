//! `zeltner-2-27`: direct light by BSDF sampling, emitter sampling and both [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-27",
        "direct light by BSDF sampling, emitter sampling and both",
        zeltner::fig_2_27::figure,
    )
}
