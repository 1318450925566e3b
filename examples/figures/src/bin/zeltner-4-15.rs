//! `zeltner-4-15`: derivatives of two distributions of normals [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-15",
        "derivatives of two distributions of normals",
        zeltner::fig_4_15::figure,
    )
}
