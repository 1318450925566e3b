//! `zeltner-3-28`: rough metal by offset normals and by paths [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-28",
        "rough metal by offset normals and by paths",
        zeltner::fig_3_28::figure,
    )
}
