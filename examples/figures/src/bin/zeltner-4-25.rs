//! `zeltner-4-25`: displacement and albedo found from five pictures [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-25",
        "shape and texture of an object, found from five pictures",
        zeltner::fig_4_25::figure,
    )
}
