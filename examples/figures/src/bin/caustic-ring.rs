//! `caustic-ring`: caustics by paths and by particles: the same derivatives, and where which has less noise.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "caustic-ring",
        "caustics by paths and by particles: the same derivatives, and where which has less noise",
        own::caustic_ring::figure,
    )
}
