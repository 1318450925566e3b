//! `zeltner-4-14`: densities made for a derivative [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-14",
        "densities made for a derivative",
        zeltner::fig_4_14::figure,
    )
}
