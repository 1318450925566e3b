//! The tests of the Python package, run by its own interpreter where there is one: `python3`, or what `RENDER_PYTHON`
//! names, with numpy and pytest.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The interpreter, if it can run the tests.
fn interpreter() -> Option<String> {
    let python = env::var("RENDER_PYTHON").unwrap_or_else(|_| "python3".into());
    let needed = "import sys, numpy, pytest; sys.exit(sys.version_info < (3, 10))";
    let output = Command::new(&python).args(["-c", needed]).output();
    if output.as_ref().is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    println!(
        "skipped: {python} is not there, is older than 3.10, or has no numpy or pytest; RENDER_PYTHON names another one"
    );
    None
}

/// The module that cargo has built beside this test.
fn module() -> PathBuf {
    let test = env::current_exe().expect("the path of this test");
    let folder = test.parent().expect("the folder of tests");
    let (prefix, suffix) = (env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    folder.join(format!("{prefix}_native{suffix}"))
}

/// Puts the package together, as maturin does.
fn install(into: &Path) {
    let package = into.join("render_gradients");
    fs::create_dir(&package).expect("a folder");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/render_gradients");
    for entry in fs::read_dir(source).expect("the package") {
        let path = entry.expect("an entry").path();
        if path.is_file() {
            fs::copy(&path, package.join(path.file_name().expect("a name"))).expect("a copy");
        }
    }
    let extension = if cfg!(windows) { "pyd" } else { "abi3.so" };
    let module = module();
    fs::copy(&module, package.join(format!("_native.{extension}")))
        .unwrap_or_else(|e| panic!("{}: {e}", module.display()));
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_package_passes_its_tests() {
    let Some(python) = interpreter() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    install(folder.path());
    let output = Command::new(&python)
        .args(["-m", "pytest", "-p", "no:cacheprovider", "--durations=5"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .env("PYTHONPATH", folder.path())
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("the interpreter");
    let [text, errors] =
        [output.stdout, output.stderr].map(|o| String::from_utf8_lossy(&o).into_owned());
    println!("{text}");
    assert!(output.status.success(), "{text}\n{errors}");
}
