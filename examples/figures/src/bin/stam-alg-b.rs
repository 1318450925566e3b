//! `stam-alg-b`: sampled Blinn-Phong normals against their density [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-alg-b",
        "sampled Blinn-Phong normals against their density",
        stam::alg_b::figure,
    )
}
