//! `zeltner-3-19`: where walks start on metal and water with bumps [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-19",
        "where walks start on metal and water with bumps",
        zeltner::fig_3_19::figure,
    )
}
