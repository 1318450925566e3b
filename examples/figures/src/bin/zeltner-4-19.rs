//! `zeltner-4-19`: all estimators of the derivative in roughness, on the plates [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-19",
        "all estimators of the derivative in roughness, on the plates",
        zeltner::fig_4_19::figure,
    )
}
