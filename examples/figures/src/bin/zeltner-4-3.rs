//! `zeltner-4-3`: derivative images in the roughness of a table and the place of a rook [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::zeltner;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-3",
        "derivative images: a table becomes rougher, a rook moves to the left",
        zeltner::fig_4_3::figure,
    )
}
