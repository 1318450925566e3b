//! `zeltner-tab-4-5-1`: the tables of estimator combinations [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-tab-4-5-1",
        "which combinations of sampling and weights estimate a derivative",
        zeltner::tab_4_5_1::figure,
    )
}
