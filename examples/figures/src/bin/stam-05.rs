//! `stam-05`: one path, and an image with some of its paths [Stam 2020].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::stam;

fn main() -> ExitCode {
    Figure::run(
        "stam-05",
        "one path, and an image with some of its paths",
        stam::fig_05::figure,
    )
}
