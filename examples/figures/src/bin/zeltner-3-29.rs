//! `zeltner-3-29`: a slab of glass with waves on both faces [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-29",
        "a slab of glass with waves on both faces",
        zeltner::fig_3_29::figure,
    )
}
