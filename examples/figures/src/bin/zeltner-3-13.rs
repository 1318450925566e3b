//! `zeltner-3-13`: a ball of glass with bumps by ten estimators [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-13",
        "a ball of glass with bumps by ten estimators",
        zeltner::fig_3_13::figure,
    )
}
