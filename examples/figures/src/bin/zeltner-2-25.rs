//! `zeltner-2-25`: antithetic sampling [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-25",
        "antithetic sampling",
        zeltner::fig_2_25::figure,
    )
}
