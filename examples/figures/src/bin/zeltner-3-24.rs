//! `zeltner-3-24`: light through the waves of a pool [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-24",
        "light through the waves of a pool",
        zeltner::fig_3_24::figure,
    )
}
