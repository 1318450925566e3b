//! `veach-eq9-invariant`: basic radiance gives the same image [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-eq9-invariant",
        "basic radiance gives the same image",
        veach::eq9_invariant::figure,
    )
}
