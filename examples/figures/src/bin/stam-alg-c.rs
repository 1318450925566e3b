//! `stam-alg-c`: Blinn-Phong weight and exponent gradient, printed and corrected [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-alg-c",
        "Blinn-Phong weight and exponent gradient, printed and corrected",
        stam::alg_c::figure,
    )
}
