//! Rules of the house that the compiler cannot check.

use std::collections::{BTreeMap, BTreeSet};
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
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut folders = vec![root.join("examples/src"), root.join("examples/figures/src")];
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

/// Functions that fit a look: as rustfmt lays them out, one ends with a brace below its first line.
#[test]
fn functions_are_short() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut found = 0;
    for part in [
        "ad-core/src",
        "render/src",
        "optim/src",
        "examples/src",
        "examples/figures/src",
        "render/tests",
        "examples/tests",
        "tests/src",
        "tests/tests",
    ] {
        for file in sources(&root.join(part)) {
            let text = std::fs::read_to_string(root.join(part).join(&file)).expect("source text");
            let lines: Vec<&str> = text.lines().collect();
            for (i, line) in lines.iter().enumerate() {
                let start = line.trim_start();
                let words = start.split(['(', ' ']);
                let qualifiers = ["pub", "const", "unsafe", "crate)", "super)", "in"];
                let is = |w: &&str| !qualifiers.contains(w) && !w.contains("::");
                if words.clone().find(is) != Some("fn") {
                    continue;
                }
                let indent = &line[..line.len() - start.len()];
                let header = lines[i..].iter().position(|l| l.ends_with(['{', ';', '}']));
                let Some(header) = header.filter(|&n| lines[i + n].ends_with('{')) else {
                    continue;
                };
                let end = format!("{indent}}}");
                let rest = lines[i + header..].iter().position(|l| *l == end);
                let length = header + rest.expect("an end") + 1;
                assert!(length <= 150, "{part}/{file}: {start} has {length} lines");
                found += 1;
            }
        }
    }
    assert!(found > 3000, "only {found} functions found");
}

/// Integration tests are one program for each crate: a file that it does not name would not run.
#[test]
fn all_tests_are_named() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    for part in ["render", "tests"] {
        let folder = root.join(part).join("tests");
        let program = std::fs::read_to_string(folder.join("all.rs")).expect("source text");
        let named: BTreeSet<&str> = (program.lines())
            .filter_map(|l| l.strip_prefix("mod ")?.strip_suffix(';'))
            .collect();
        let mut found = 0;
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let name = path.file_stem().expect("a name").to_string_lossy();
            if path.extension().is_some_and(|e| e == "rs") && name != "all" {
                assert!(named.contains(&*name), "{part}/tests/all.rs lacks {name}");
                found += 1;
            }
        }
        assert!(found > 15, "only {found} files of tests in {part}");
    }
}

/// Modules of `render`, lowest first: each may use those before it, and nothing after it.
const LAYERS: &[&str] = &[
    "prefetch",
    "parallel",
    "dispatch",
    "math",
    "statistics",
    "sampler",
    "error",
    "inputs",
    "files",
    "film",
    "image_io",
    "params",
    "motion",
    "camera",
    "accel",
    "guide",
    "plugin",
    "texture",
    "bsdf",
    "shape",
    "emitter",
    "edges",
    "estimator",
    "scene",
    "manifold",
    "glint",
    "integrator",
    "finite_element",
    "instances",
    "auto",
    "check",
];

/// The same within `integrator`.
const TRANSPORT: &[&str] = &[
    "progress",
    "job",
    "rendering",
    "exact",
    "sparse",
    "noise",
    "local",
    "active",
    "vertex",
    "reparameterisation",
    "direct",
    "record",
    "lockstep",
    "path",
    "simple",
    "wave",
    "tile",
    "coverage",
    "sink",
    "pass",
    "solved",
    "projection_map",
    "particle",
    "particle_gradient",
    "density",
    "paths",
    "motion",
    "delta",
    "convolved",
    "chain_trail",
    "connections",
    "chain_density",
    "glints",
    "boundary",
    "integrals",
    "render",
    "gradient",
    "second_order",
    "guide_training",
    "work",
];

/// All `.rs` files below a folder, as paths relative to it.
fn sources(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let relative = path.strip_prefix(folder).expect("a path below the folder");
                found.push(relative.to_string_lossy().into_owned());
            }
        }
    }
    found
}

/// The names that follow `path` in the code, comments and unit tests left out.
fn named_after(code: &str, path: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices(path) {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = &code[at + path.len()..];
        let word = |text: &str| -> String {
            (text.trim_start().chars())
                .take_while(|c| c.is_alphanumeric() || *c == '_')
                .collect()
        };
        match rest.strip_prefix('{') {
            // The first word of each item of the list, not of lists within it.
            Some(list) => {
                let mut depth = 0;
                let mut item = String::new();
                for c in list.chars() {
                    match c {
                        '{' => depth += 1,
                        '}' if depth == 0 => break,
                        '}' => depth -= 1,
                        ',' if depth == 0 => names.push(word(&std::mem::take(&mut item))),
                        _ if depth == 0 => item.push(c),
                        _ => {}
                    }
                }
                names.push(word(&item));
            }
            None => names.push(word(rest)),
        }
    }
    names
}

/// Source text without comments and unit tests.
fn code_of(path: &Path) -> String {
    let text = std::fs::read_to_string(path).expect("source text");
    let code = text
        .split("#[cfg(test)]\nmod tests")
        .next()
        .unwrap_or(&text);
    let lines: Vec<&str> = code
        .lines()
        .map(|l| l.split("//").next().unwrap_or(l))
        .collect();
    lines.join("\n")
}

/// The names that the head of a folder takes from its files, and the files: who takes such a name from the head uses them.
fn taken_by_head(folder: &Path) -> BTreeMap<String, String> {
    let head = folder.join("mod.rs");
    if !head.exists() {
        return BTreeMap::new();
    }
    let code = code_of(&head);
    let files = code.lines().filter_map(|l| {
        let declared = l.rsplit_once("mod ")?.1.strip_suffix(';')?;
        Some(declared.to_owned())
    });
    let mut taken = BTreeMap::new();
    for file in files {
        for path in [format!("use {file}::"), format!("use self::{file}::")] {
            let names = named_after(&code, &path).into_iter();
            taken.extend(names.map(|name| (name, file.clone())));
        }
    }
    taken
}

/// Which modules of `folder`, whose path in the crate is `prefix`, use which others.
fn uses(folder: &Path, prefix: &str) -> Vec<(String, String)> {
    let taken = taken_by_head(folder);
    let mut uses = Vec::new();
    for file in sources(folder) {
        let module = file
            .split('/')
            .next()
            .unwrap_or(&file)
            .trim_end_matches(".rs")
            .to_owned();
        if ["mod", "lib"].contains(&module.as_str()) {
            continue;
        }
        let code = code_of(&folder.join(&file));
        let levels = file.matches('/').count() + usize::from(!file.ends_with("/mod.rs"));
        let parent = "super::".repeat(levels);
        for path in [prefix, &parent] {
            let named = named_after(&code, path).into_iter();
            let of = |name: String| taken.get(&name).cloned().unwrap_or(name);
            uses.extend(named.map(|name| (module.clone(), of(name))));
        }
    }
    uses
}

/// The files of `folder` that use each other in a circle, if any do.
fn circle(folder: &Path, prefix: &str) -> Option<Vec<String>> {
    let mut left: Vec<(String, String)> = uses(folder, prefix);
    let files: BTreeSet<String> = left.iter().map(|(user, _)| user.clone()).collect();
    left.retain(|(user, used)| user != used && files.contains(used));
    // Whoever uses nobody that is left is in no circle.
    loop {
        let users: BTreeSet<String> = left.iter().map(|(user, _)| user.clone()).collect();
        let before = left.len();
        left.retain(|(_, used)| users.contains(used));
        if left.len() == before {
            return (!users.is_empty()).then(|| users.into_iter().collect());
        }
    }
}

fn assert_layers(folder: &Path, prefix: &str, layers: &[&str]) {
    let place = |name: &str| layers.iter().position(|l| *l == name);
    let mut seen = 0;
    for (user, used) in uses(folder, prefix) {
        let Some(above) = place(&user) else {
            panic!(
                "{user} has no place among the layers of {}",
                folder.display()
            );
        };
        // Items of the folder itself are re-exports.
        let Some(below) = place(&used) else { continue };
        assert!(below <= above, "{user} uses {used}, which lies above it");
        seen += usize::from(below < above);
    }
    assert!(seen > layers.len(), "only {seen} uses found");
}

/// Nor are there circles between the files of one folder. Its head, `mod.rs`, belongs to all of them: it defines what they have
/// in common, traits, types and constants, lists them and calls them. What it only takes from one of them to pass it on is
/// used where it is defined.
#[test]
fn files_use_each_other_one_way() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let crates = ["examples/src", "examples/figures/src"];
    let mut folders = Vec::from(crates.map(|c| (root.join(c), "crate::".to_owned())));
    let render = root.join("render/src");
    let mut below = vec![render.clone()];
    while let Some(folder) = below.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                below.push(path);
            }
        }
        let relative = folder
            .strip_prefix(&render)
            .expect("a path below the folder");
        let relative = relative.to_string_lossy().replace('\\', "/");
        let path = relative.split('/').filter(|p| !p.is_empty());
        let path: String = path.map(|p| format!("{p}::")).collect();
        folders.push((folder, format!("crate::{path}")));
    }
    assert!(folders.len() > 20, "only {} folders found", folders.len());
    for (folder, prefix) in folders {
        let found = circle(&folder, &prefix);
        assert!(
            found.is_none(),
            "{}: {found:?} use each other",
            folder.display()
        );
    }
}

/// A circle of three files is one, and what is not part of it is not.
#[test]
fn circles_are_noticed() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = [
        (
            "list",
            "use super::{\n    ball::Ball,\n    plate::Plate,\n};\n",
        ),
        ("ball", "use crate::things::rules::check;\n"),
        ("rules", "// use super::nothing;\nuse super::list::All;\n"),
        ("plate", "use crate::math::Vec3;\n"),
    ];
    for (name, text) in files {
        let path = folder.path().join(name).with_extension("rs");
        std::fs::write(path, text).expect("a file");
    }
    let find = || circle(folder.path(), "crate::things::");
    let found = find().expect("a circle");
    for (name, is_part) in [
        ("list", true),
        ("ball", true),
        ("rules", true),
        ("plate", false),
    ] {
        assert_eq!(
            found.iter().any(|f| f == name),
            is_part,
            "{name}: {found:?}"
        );
    }
    // What the head passes on is that of the file behind it; what it defines is no file's.
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name).with_extension("rs");
        std::fs::write(path, text).expect("a file");
    };
    write("rules", "use super::{All, Common};\n");
    assert_eq!(find(), None);
    let head = "mod ball;\nmod list;\n\npub use ball::Ball;\npub use self::list::{All, None};\npub struct Common;\n";
    write("mod", head);
    assert!(find().is_some_and(|found| found.iter().any(|f| f == "list")));
    std::fs::remove_file(folder.path().join("rules.rs")).expect("a file");
    assert_eq!(find(), None);
}

/// There are no circles between modules: what a plugin needs to read itself lies below all plugins, the scene above
/// them, and estimators know no scene.
#[test]
fn modules_use_what_lies_below() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../render/src");
    assert_layers(&source, "crate::", LAYERS);
    assert_layers(&source.join("integrator"), "crate::integrator::", TRANSPORT);
}
