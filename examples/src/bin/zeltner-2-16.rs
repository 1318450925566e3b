//! `zeltner-2-16`: factors of the rendering equation at two points [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-16",
        "factors of the rendering equation at two points",
        scenes::factors::figure,
    )
}
