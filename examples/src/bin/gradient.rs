//! Differentiates an image of a scene.

use std::process::ExitCode;

fn main() -> ExitCode {
    examples::cli::main(examples::tools::gradient::run)
}
