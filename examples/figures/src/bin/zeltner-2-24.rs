//! `zeltner-2-24`: weights of multiple importance sampling [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-24",
        "weights of multiple importance sampling",
        zeltner::fig_2_24::figure,
    )
}
