//! `zeltner-alg-3-2`: unbiased estimates with known solutions [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-alg-3-2",
        "unbiased estimates with known solutions",
        zeltner::alg_3_2::figure,
    )
}
