//! Renders a scene.

use std::process::ExitCode;

fn main() -> ExitCode {
    examples::cli::main(examples::tools::render::run)
}
