//! `zeltner-4-24`: pose of a camera and position of a lamp found from a picture [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-24",
        "where a camera and a lamp are, found from one picture",
        zeltner::fig_4_24::figure,
    )
}
