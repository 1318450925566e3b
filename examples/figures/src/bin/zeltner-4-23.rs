//! `zeltner-4-23`: time and memory of adjoints along paths and of a tape [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::memory::Counting;
use figures::zeltner;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-4-23",
        "time and memory of a derivative in a position, along paths and by a tape",
        zeltner::fig_4_23::figure,
    )
}
