//! `zeltner-2-28`: a box by path length [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-28",
        "a box by path length",
        scenes::path_length::figure,
    )
}
