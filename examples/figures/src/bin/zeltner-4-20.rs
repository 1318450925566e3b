//! `zeltner-4-20`: all estimators in a glossy scene [Zeltner 2021, figures 4.1, 4.20 and 4.21].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-20",
        "all estimators of the derivative in roughness, where everything reflects everything",
        zeltner::fig_4_20::figure,
    )
}
