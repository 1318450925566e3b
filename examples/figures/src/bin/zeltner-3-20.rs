//! `zeltner-3-20`: basins on bumpy metal, and first stages [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-20",
        "basins on bumpy metal, and first stages",
        zeltner::fig_3_20::figure,
    )
}
