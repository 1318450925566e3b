//! What linkers need to know to leave the names of Python open, and which instructions the module may use.

use std::env;

fn main() {
    pyo3_build_config::add_extension_module_link_args();
    let features = env::var("CARGO_CFG_TARGET_FEATURE").unwrap_or_default();
    println!("cargo::rustc-env=TARGET_FEATURES={features}");
}
