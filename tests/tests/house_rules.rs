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
