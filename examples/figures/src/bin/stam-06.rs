//! `stam-06`: seven gradients on one path against central differences [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-06",
        "seven gradients on one path against central differences",
        stam::fig_06::figure,
    )
}
