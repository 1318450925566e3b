//! `veach-01a`: shading normals gain energy [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-01a",
        "shading normals gain energy",
        veach::fig_01a::figure,
    )
}
