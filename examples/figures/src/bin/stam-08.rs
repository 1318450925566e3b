//! `stam-08`: image and seven derivative images, Blinn-Phong importance sampling [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-08",
        "image and seven derivative images, Blinn-Phong importance sampling",
        stam::fig_08::figure,
    )
}
