//! `stam-07`: image and seven derivative images, cosine sampling [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-07",
        "image and seven derivative images, cosine sampling",
        stam::fig_07::figure,
    )
}
