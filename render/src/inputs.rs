//! Which files are read while a scene is loaded.

use std::cell::RefCell;
use std::path::{Path, PathBuf};

thread_local! {
    static FILES: RefCell<Option<Vec<PathBuf>>> = const { RefCell::new(None) };
}

/// Says that a file was read, by the thread that loads the scene.
pub(crate) fn note(path: &Path) {
    FILES.with_borrow_mut(|files| {
        if let Some(files) = files.as_mut().filter(|f| !f.iter().any(|f| f == path)) {
            files.push(path.to_owned());
        }
    });
}

/// What `load` returns, and the files that it read, each once, the first one first.
pub(crate) fn during<R>(load: impl FnOnce() -> R) -> (R, Vec<PathBuf>) {
    /// Ends the list, also when a panic passes by.
    struct End;
    impl Drop for End {
        fn drop(&mut self) {
            FILES.set(None);
        }
    }
    FILES.set(Some(Vec::new()));
    let _end = End;
    let result = load();
    (result, FILES.take().unwrap_or_default())
}
