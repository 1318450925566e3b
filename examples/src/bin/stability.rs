//! Charts where estimators of derivatives fail.

use std::process::ExitCode;

fn main() -> ExitCode {
    examples::cli::main(examples::tools::stability::run)
}
