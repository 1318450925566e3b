//! `zeltner-4-11`: attached sampling of one factor and of a product [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-11",
        "attached sampling of one factor and of a product",
        zeltner::fig_4_11::figure,
    )
}
