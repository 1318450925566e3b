//! `zeltner-alg-3-1`: one walk, and its geometric term [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-alg-3-1",
        "one walk, and its geometric term",
        zeltner::alg_3_1::figure,
    )
}
