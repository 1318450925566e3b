//! `zeltner-4-2-2-env`: a rough mirror over directions and over random numbers [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-2-2-env",
        "a rough mirror over directions and over random numbers",
        zeltner::fig_4_2_2_env::figure,
    )
}
