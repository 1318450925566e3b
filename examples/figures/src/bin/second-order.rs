//! `second-order`: Gauss-Newton steps against Adam.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "second-order",
        "Gauss-Newton steps against Adam, and the Hessian of an image loss",
        own::second_order::figure,
    )
}
