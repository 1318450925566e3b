//! `zeltner-2-10`: Fresnel reflectance of glass [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-10",
        "Fresnel reflectance of glass",
        zeltner::fig_2_10::figure,
    )
}
