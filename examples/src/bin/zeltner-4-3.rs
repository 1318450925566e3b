//! `zeltner-4-3`: images of derivatives [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-3",
        "images of derivatives",
        zeltner::fig_4_3::figure,
    )
}
