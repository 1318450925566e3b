//! `veach-01b`: particles jump across an edge, and the weight that mends it [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-01b",
        "particles jump across an edge, and the weight that mends it",
        veach::fig_01b::figure,
    )
}
