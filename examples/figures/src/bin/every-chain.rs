//! `every-chain`: all chains of one vertex by proof.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "every-chain",
        "all chains of one vertex by proof",
        own::every_chain::figure,
    )
}
