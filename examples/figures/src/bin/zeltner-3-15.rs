//! `zeltner-3-15`: the Newton fractal of z^3 = 1, and basins in a bumpy ring [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-15",
        "the Newton fractal of z^3 = 1",
        zeltner::fig_3_15::figure,
    )
}
