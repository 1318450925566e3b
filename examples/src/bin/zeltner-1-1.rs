//! `zeltner-1-1`: a scene rendered forward and recovered backward [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-1-1",
        "a scene rendered forward and recovered backward",
        scenes::recovery::pair,
    )
}
