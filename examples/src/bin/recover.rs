//! Recovers a scene's parameters from images of it.

use std::process::ExitCode;

fn main() -> ExitCode {
    examples::cli::main(examples::tools::recover::run)
}
