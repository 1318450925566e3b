//! `stam-alg-d`: roulette, emission gradient and cost of the pseudocode, printed and corrected [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-alg-d",
        "roulette, emission gradient and cost of the pseudocode, printed and corrected",
        stam::alg_d::figure,
    )
}
