//! Shared by the integration tests.

// Each test binary compiles its own copy and uses a part of it.
#![allow(dead_code)]

pub mod materials;

use std::path::{Path, PathBuf};

/// Where large scenes and references lie that are not part of the repository: `$RENDER_SHARED`, or
/// `shared` beside the workspace. `None`, with a printed message, if there is no such folder; the
/// test should then pass without them.
pub fn shared_dir() -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared");
    let dir = std::env::var_os("RENDER_SHARED").map_or_else(|| default.into(), PathBuf::from);
    if dir.is_dir() {
        return Some(dir);
    }
    println!(
        "skipped: no shared scenes at {}; set RENDER_SHARED",
        dir.display()
    );
    None
}

/// All files below `dir` with this extension, sorted.
pub fn files_below(dir: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
