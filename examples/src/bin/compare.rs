//! Compares estimators of derivatives.

use std::process::ExitCode;

fn main() -> ExitCode {
    examples::cli::main(examples::tools::compare::run)
}
