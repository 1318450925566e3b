//! What the command lines of figures, which are all the same, do with mistakes.

use std::process::Command;

fn figure(folder: &tempfile::TempDir, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stam-alg-c"));
    command.arg("--quick").args(args).current_dir(folder);
    command
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a folder")
}

/// What cannot be printed costs no result. A figure that fails ends with 1, one that cannot print with 2.
#[cfg(target_os = "linux")]
#[test]
fn output_with_nowhere_to_go_costs_no_file() {
    use std::process::Stdio;

    let full = || {
        let options = std::fs::File::options().write(true).open("/dev/full");
        options.expect("a device")
    };
    for (what, code) in [("full", 2), ("closed", 0), ("deaf", 0)] {
        let folder = folder();
        let mut command = figure(&folder, &["--out", "f"]);
        match what {
            "full" => command.stdout(full()).stderr(Stdio::piped()),
            "closed" => {
                let (reader, writer) = std::io::pipe().expect("a pipe");
                drop(reader);
                command.stdout(writer).stderr(Stdio::piped())
            }
            _ => command.stdout(Stdio::piped()).stderr(full()),
        };
        let running = command.spawn().expect("a figure");
        let out = running.wait_with_output().expect("an end");
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{what}: {stderr}");
        let told = stderr.contains("standard output: No space left");
        assert_eq!(told, what == "full", "{what}: {stderr}");
        let manifest = folder.path().join("f/manifest.json");
        assert!(manifest.is_file(), "{what}: no manifest");
    }
}

#[test]
fn too_many_threads_are_refused() {
    let folder = folder();
    let mut command = figure(&folder, &[]);
    let out = command.env("RAYON_NUM_THREADS", "100000").output();
    let out = out.expect("a figure");
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success());
    assert!(stderr.contains("at most 1024 threads"), "{stderr}");
    let out = figure(&folder, &["--threads", "100000"]).output();
    assert_eq!(out.expect("a figure").status.code(), Some(2));
    let left = std::fs::read_dir(folder.path()).expect("a folder").count();
    assert_eq!(left, 0);
}

/// Nobody reads all of a long word.
#[test]
fn long_words_are_quoted_in_part() {
    let long = "a".repeat(100_000);
    let out = figure(&folder(), &["--out", "f", "--threads", &long]).output();
    let out = out.expect("a figure");
    assert!(!out.status.success());
    assert!(out.stderr.len() < 9000, "{} bytes", out.stderr.len());
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(!stderr.contains("panicked"), "{stderr}");
}
