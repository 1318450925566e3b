//! `zeltner-3-22`: glints by walks and by scattered directions [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-22",
        "glints by walks and by scattered directions",
        zeltner::fig_3_22::figure,
    )
}
