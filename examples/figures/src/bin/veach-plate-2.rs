//! `veach-plate-2`: a pool by particles: what refraction scales [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-plate-2",
        "a pool by particles: what refraction scales",
        veach::plate_2::figure,
    )
}
