//! `zeltner-2-11`: complex index and reflectance of gold [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-11",
        "complex index and reflectance of gold",
        zeltner::fig_2_11::figure,
    )
}
