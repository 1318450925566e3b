//! `zeltner-2-5-3`: light tracing, its blind spots, and density estimation [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-5-3",
        "light tracing, its blind spots, and density estimation",
        zeltner::fig_2_5_3::figure,
    )
}
