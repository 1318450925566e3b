//! `veach-plate-1`: bumps and facets by particles, with and without adjoint BSDFs [Veach 1996].

use std::process::ExitCode;

use examples::figure::Figure;
use figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "veach-plate-1",
        "bumps and facets by particles, with and without adjoint BSDFs",
        veach::plate_1::figure,
    )
}
