//! `zeltner-3-27`: normal maps and displaced balls of glass [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-27",
        "normal maps and displaced balls of glass",
        zeltner::fig_3_27::figure,
    )
}
