//! `zeltner-3-23`: a shop window [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run("zeltner-3-23", "a shop window", zeltner::fig_3_23::figure)
}
