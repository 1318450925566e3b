//! `guided-pool`: paths that have learned where light comes from: the same derivatives, less noise below water.

use std::process::ExitCode;

use examples::figure::Figure;
use figures::own;

fn main() -> ExitCode {
    Figure::run(
        "guided-pool",
        "paths that have learned where light comes from: the same derivatives, less noise below water",
        own::guided_pool::figure,
    )
}
