//! `zeltner-2-5-3`: light tracing, its blind spots, and density estimation [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::figures::veach;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-2-5-3",
        "light tracing, its blind spots, and density estimation",
        veach::light_tracing::figure,
    )
}
