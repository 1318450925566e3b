//! `zeltner-4-4`: derivatives sent forward through a scene [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::scenes;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-4",
        "derivatives sent forward through a scene",
        scenes::propagation::forward,
    )
}
