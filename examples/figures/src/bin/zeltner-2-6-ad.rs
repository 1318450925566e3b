//! `zeltner-2-6-ad`: forward and reverse mode on the example of section 2.6 [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-6-ad",
        "forward and reverse mode on the example of section 2.6",
        zeltner::fig_2_6_ad::figure,
    )
}
