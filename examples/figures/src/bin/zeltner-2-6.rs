//! `zeltner-2-6`: seven materials [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run("zeltner-2-6", "seven materials", zeltner::fig_2_6::figure)
}
