//! `stam-alg-5-2`: forward and backward recursion of a Lambertian path, two controls [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-alg-5-2",
        "forward and backward recursion of a Lambertian path, two controls",
        stam::alg_5_2::figure,
    )
}
