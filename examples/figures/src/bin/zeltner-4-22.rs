//! `zeltner-4-22`: a roughness texture found with three estimators of the gradient [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-22",
        "a texture of roughness found by gradient descent with three estimators",
        zeltner::fig_4_22::figure,
    )
}
