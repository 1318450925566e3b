//! `zeltner-2-23`: rejection sampling [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-23",
        "rejection sampling",
        zeltner::fig_2_23::figure,
    )
}
