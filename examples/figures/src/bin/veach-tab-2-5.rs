//! `veach-tab-2-5`: four transport operators, and the scattering kernel with its adjoint [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-tab-2-5",
        "four transport operators, and the scattering kernel with its adjoint",
        veach::tab_2_5::figure,
    )
}
