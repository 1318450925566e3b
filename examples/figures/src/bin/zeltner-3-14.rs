//! `zeltner-3-14`: reflections in a ring that light a point of the floor [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-3-14",
        "reflections in a ring that light a point of the floor",
        zeltner::fig_3_14::figure,
    )
}
