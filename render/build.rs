//! Says so where rays will be slow: settings of this workspace are not those of packages that depend on this one.

use std::env;

/// What vectors of rays and boxes are written for, where there is more than every machine has.
const WANTED: [&str; 2] = ["avx2", "fma"];

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let features = env::var("CARGO_CFG_TARGET_FEATURE").unwrap_or_default();
    let has = |name: &str| features.split(',').any(|f| f == name);
    if env::var("CARGO_CFG_TARGET_ARCH").is_ok_and(|a| a == "x86_64")
        && !WANTED.iter().all(|name| has(name))
    {
        println!(
            "cargo::warning=built without {}, so that rays take longer; for this machine alone set \
             RUSTFLAGS=\"-C target-cpu=native\", or build.rustflags in the .cargo/config.toml of your workspace",
            WANTED.join(" and ")
        );
    }
}
