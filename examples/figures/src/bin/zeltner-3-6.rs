//! `zeltner-3-6`: blocks of the Jacobian of constraints [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-6",
        "blocks of the Jacobian of constraints",
        zeltner::fig_3_6::figure,
    )
}
