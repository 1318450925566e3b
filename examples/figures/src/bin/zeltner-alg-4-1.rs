//! `zeltner-alg-4-1`: radiative backpropagation against forward mode and differences [Zeltner 2021].

use std::process::ExitCode;

use examples::figure::Figure;
use examples::memory::Counting;
use figures::zeltner;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn main() -> ExitCode {
    Figure::run(
        "zeltner-alg-4-1",
        "ten derivatives by one pass of radiative backpropagation",
        zeltner::alg_4_1::figure,
    )
}
