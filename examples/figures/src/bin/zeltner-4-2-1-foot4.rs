//! `zeltner-4-2-1-foot4`: attaching some factors of a product only [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-2-1-foot4",
        "attaching some factors of a product only",
        zeltner::fig_4_2_1_foot4::figure,
    )
}
