//! Rules of the house that the compiler cannot check.

use std::path::Path;

/// Derivative policy lives in `estimator/`: materials, emitters and shapes never detach anything.
#[test]
fn models_do_not_detach() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../render/src");
    let mut read = 0;
    for folder in ["bsdf", "emitter", "emitter/envmap", "shape", "texture"] {
        for entry in std::fs::read_dir(source.join(folder)).expect("a folder of models") {
            let path = entry.expect("an entry").path();
            if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).expect("source text");
                assert!(!text.contains(".detach("), "{} detaches", path.display());
                read += 1;
            }
        }
    }
    assert!(read > 20, "only {read} files found");
}

/// Tools and figures print through one layer, which never panics where output goes nowhere: `println!` does.
#[test]
fn tools_print_without_panics() {
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/src")];
    let mut read = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of tools") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).expect("source text");
                for name in ["println!(", "print!(", "eprintln!(", "eprint!(", "dbg!("] {
                    assert!(!text.contains(name), "{}: {name}", path.display());
                }
                read += 1;
            }
        }
    }
    assert!(read > 100, "only {read} files found");
}
