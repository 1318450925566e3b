//! Recoveries that are stopped and resumed.

use std::process::Command;

use render::Image;
use render::image_io::write_exr;
use serde_json::Value;

use crate::{Folder, SCENE, WALL, bytes, fails};

#[test]
fn a_resumed_recovery_equals_an_uninterrupted_one_bit_for_bit() {
    resumes(
        "adam --sampler sobol --lights all --caustics particles --pixels-per-particle 2 --guide",
    );
    resumes("adam --estimator differential-mis");
    resumes("gauss-newton");
}

fn resumes(optimizer: &str) {
    let dir = Folder::new();
    let job = format!("--size 20 --spp 2 --iterations 10 --seed 5 --optimizer {optimizer}");
    dir.ok("recover", &format!("{job} --out whole --threads 2"));
    let stopped = dir.run(
        "recover",
        &format!("{job} --out parts --stop-after 5 --threads 1"),
    );
    assert_eq!(stopped.status.code(), Some(130));
    let half = dir.json("parts/result.json");
    assert_eq!(half["iterations"], 5);
    assert_ne!(half["params"], dir.json("whole/result.json")["params"]);
    // Another job does not continue this one.
    let others = [
        ("--spp", "3"),
        ("--sampler", "antithetic"),
        ("--estimator", "detached"),
    ];
    for (key, value) in others {
        let other = dir.run("recover", &format!("--out parts --resume {key} {value}"));
        assert_eq!(other.status.code(), Some(1));
        assert!(String::from_utf8_lossy(&other.stderr).contains(key));
        assert_eq!(dir.json("parts/result.json"), half);
    }

    dir.ok("recover", "--out parts --resume --threads 7");
    let files = [
        "checkpoint.json",
        "result.json",
        "iterations.csv",
        "before.exr",
        "after.exr",
        "target.exr",
        "before-after-target.png",
        "convergence.svg",
        "convergence.png",
    ];
    for file in files {
        let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(d).join(file)));
        assert!(!whole.is_empty() && whole == parts, "{file} differs");
    }
    // Nothing else but the lock: no leftovers of atomic writes.
    assert_eq!(
        std::fs::read_dir(dir.path("parts")).unwrap().count(),
        files.len() + 1
    );
    // Complete: resuming changes nothing.
    dir.ok("recover", "--out parts --resume");
    let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(d).join("checkpoint.json")));
    assert!(whole == parts);
}

/// A stopped recovery, to be resumed from a checkpoint that is damaged.
struct Stopped {
    dir: Folder,
    whole: Value,
}

impl Stopped {
    /// Of eight iterations after seven.
    fn of(job: &str) -> Self {
        let dir = Folder::new();
        let stopped = dir.run(
            "recover",
            &format!("--size 8 --spp 2 --iterations 8 --stop-after 7 --out d {job}"),
        );
        assert_eq!(stopped.status.code(), Some(130));
        let whole = dir.json("d/checkpoint.json");
        Self { dir, whole }
    }

    /// The list at a place without its last item.
    fn shorter_list(&self, at: &str) -> Value {
        let mut rows = self.whole.pointer(at).unwrap().as_array().unwrap().clone();
        rows.pop();
        Value::from(rows)
    }

    /// With another value at one place it is an error that names the key, and nothing changes.
    fn refused(&self, at: &str, to: Value, named: &str) {
        let Self { dir, whole } = self;
        let mut damaged = whole.clone();
        *damaged.pointer_mut(at).unwrap() = to;
        assert_ne!(damaged, *whole, "{at}");
        let text = damaged.to_string();
        std::fs::write(dir.path("d/checkpoint.json"), &text).unwrap();
        let result = bytes(dir.path("d/result.json"));
        let out = dir.run("recover", "--out d --resume");
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{at}: {stderr}");
        assert!(!stderr.contains("panicked"), "{at}: {stderr}");
        let named = format!("checkpoint.json: {named}");
        assert!(stderr.contains(&named), "{named}: {stderr}");
        assert_eq!(bytes(dir.path("d/checkpoint.json")), text.as_bytes());
        assert!(bytes(dir.path("d/result.json")) == result);
    }
}

#[test]
fn damaged_checkpoints_are_errors_that_name_the_key() {
    let damaged = Stopped::of("");
    let whole = &damaged.whole;
    assert_eq!(whole["tail"], 1);
    let text = |at: &str| whole.pointer(at).unwrap().as_str().unwrap().to_owned();
    let shorter = |at: &str, digits| Value::from(text(at)[digits..].to_owned());
    let ending = |at: &str, digits: &str| {
        let text = text(at);
        Value::from(format!("{}{digits}", &text[..text.len() - digits.len()]))
    };
    let (nan, nan32) = ("7ff8000000000000", "7fc00000");
    let row = "/history/0/values";
    let cases: Vec<(&str, Value, &str)> = vec![
        (
            row,
            shorter(row, 16),
            "history[0].values: expected 10 values, found 9",
        ),
        (
            row,
            ending(row, nan),
            "history[0].values: expected finite values, found NaN",
        ),
        (
            "/history/3/loss",
            "inf".into(),
            "history[3].loss: expected a finite number, found inf",
        ),
        (
            "/history",
            damaged.shorter_list("/history"),
            "history: expected a row for each of 7 iterations, found 6",
        ),
        (
            "/iteration",
            6.into(),
            "history: expected a row for each of 6 iterations, found 7",
        ),
        (
            "/iteration",
            4000000000u32.into(),
            "iteration: expected at most the 8 of job.iterations",
        ),
        (
            "/tail",
            0.into(),
            "tail: expected 1 after 7 of 8 iterations, found 0",
        ),
        (
            "/tail",
            u32::MAX.into(),
            "tail: expected 1 after 7 of 8 iterations, found 4294967295",
        ),
        (
            "/tail_sum",
            shorter("/tail_sum", 16),
            "tail_sum: expected 10 values with a tail of 1, found 9",
        ),
        ("/tail_sum", ending("/tail_sum", nan), "tail_sum: "),
        (
            "/version",
            1.into(),
            "version: expected 3, found 1; another version of this tool wrote it",
        ),
        (
            "/values",
            shorter("/values", 8),
            "values: expected 10 values as in the scene, found 9",
        ),
        (
            "/values",
            ending("/values", nan32),
            "values: parameter `light.emitter.radiance.value`",
        ),
    ];
    for (at, to, named) in cases {
        damaged.refused(at, to, named);
    }
}

#[test]
fn checkpoints_of_other_jobs_are_errors_that_name_the_key() {
    let damaged = Stopped::of("");
    let whole = &damaged.whole;
    let algorithm = "/optimizer/first-order";
    let group = format!("{algorithm}/groups/groups/0");
    let adam = format!("{algorithm}/inner/adam");
    let rate = format!("{adam}/rates/segments/0/rate");
    let cases: Vec<(&str, Value, &str)> = vec![
        (
            "/job/iterations",
            5.into(),
            "iteration: expected at most the 5 of job.iterations, found 7",
        ),
        (
            "/job/iterations",
            0.into(),
            "job.iterations: expected a number from 1 to 16777216, found 0",
        ),
        (
            "/job/iterations",
            (1 << 25).into(),
            "job.iterations: expected",
        ),
        (
            "/inputs/values/0",
            "".into(),
            "inputs.values: expected those of the scene, found others",
        ),
        (
            "/job/spp",
            0.into(),
            "job.spp: expected a number from 1 to 1073741824, found 0",
        ),
        (
            "/job/size",
            0.into(),
            "job.size: expected a number from 1 to 4096, found 0",
        ),
        (
            "/job/size",
            4097.into(),
            "job.size: expected a number from 1 to 4096, found 4097",
        ),
        (
            "/job/lr",
            "NaN".into(),
            "job.lr: expected a positive finite rate, found NaN",
        ),
        (
            "/job/params",
            damaged.shorter_list("/job/params"),
            "inputs.values: expected those of the unknowns, found others",
        ),
        ("/job/params", Value::Array(vec![]), "job.params: expected"),
        ("/job/estimator", "luck".into(), "job.estimator: "),
        ("/job/loss", "luck".into(), "job.loss: "),
        (
            "/job/scene",
            "scene.xml".into(),
            "job.targets: expected an image",
        ),
        (
            "/job/optimizer",
            "luck".into(),
            "expected a checkpoint of this tool: expected one of adam",
        ),
        (
            "/job/optimizer",
            "sgd".into(),
            "optimizer: expected sgd, found adam",
        ),
        (
            &group,
            {
                let mut moved = whole.pointer(&group).unwrap().clone();
                moved["name"] = "other".into();
                moved
            },
            "optimizer.groups: expected those of the scene",
        ),
        (
            &rate,
            "0.5".into(),
            "optimizer.rates: expected those of the job",
        ),
    ];
    for (at, to, named) in cases {
        damaged.refused(at, to, named);
    }
    let steps = format!("{adam}/steps");
    damaged.refused(
        &steps,
        6.into(),
        "optimizer.steps: expected 7 to 7 steps, found 6",
    );
}

#[test]
fn damaged_checkpoints_of_gauss_newton_are_errors_that_name_the_key() {
    let damaged = Stopped::of("--optimizer gauss-newton");
    damaged.refused("/job/spp", 1.into(), "job.spp: expected at least 2");
    damaged.refused("/job/loss", "l1".into(), "job.loss: expected l2");
    damaged.refused(
        "/job/estimator",
        "detached".into(),
        "job.estimator: expected mis",
    );
    damaged.refused("/tail", 1.into(), "tail: expected 0");
    let sum = "3ff0000000000000".repeat(10);
    damaged.refused(
        "/tail_sum",
        sum.into(),
        "tail_sum: expected 0 values with a tail of 0, found 10",
    );
    let steps = "/optimizer/gauss-newton/steps";
    damaged.refused(
        steps,
        8.into(),
        "optimizer.steps: expected 0 to 7 steps, found 8",
    );
}

/// [`SCENE`] with a texture of 64 x 64 texels on its walls, a picture of it, and how to recover the texture.
fn textured(dir: &Folder) -> &'static str {
    let texture = |value: f32| {
        let mut image = Image::new(64, 64);
        let texels = image.data.iter_mut().enumerate();
        texels.for_each(|(i, x)| *x = value + 0.1 * (i as f32).sin());
        image
    };
    let rgb = r#"<rgb name="reflectance" value="$red,0.4,0.2"/>"#;
    let map = r#"<texture type="bitmap" name="reflectance"><string name="filename" value="$map"/>
        <boolean name="raw" value="true"/></texture>"#;
    assert!(SCENE.contains(rgb));
    let scene = SCENE.replace(rgb, map);
    let scene = scene.replace(r#"name="red" value="0.7""#, r#"name="map" value="map.exr""#);
    std::fs::write(dir.path("scene.xml"), scene).unwrap();
    write_exr(&dir.path("map.exr"), &texture(0.5)).unwrap();
    write_exr(&dir.path("truth.exr"), &texture(0.3)).unwrap();
    dir.ok("render", "scene.xml -o photo.exr --spp 16 -D map=truth.exr");
    "scene.xml --param wall.reflectance.data --target photo.exr --spp 2 --iterations 8"
}

#[test]
fn a_checkpoint_belongs_to_its_scene_and_target() {
    let dir = Folder::new();
    let job = textured(&dir);
    let out = dir.run("recover", &format!("{job} --out d --stop-after 2"));
    assert_eq!(out.status.code(), Some(130));
    let before = bytes(dir.path("d/checkpoint.json"));
    dir.ok("render", "scene.xml -o other.exr --spp 1 --seed 2");
    let scene = std::fs::read_to_string(dir.path("scene.xml")).unwrap();
    let others = [
        ("scene.xml", scene.replace("10,8,6", "10,8,7").into_bytes()),
        ("map.exr", bytes(dir.path("truth.exr"))),
        ("photo.exr", bytes(dir.path("other.exr"))),
        ("d/target.exr", bytes(dir.path("other.exr"))),
    ];
    for (name, other) in others {
        let whole = bytes(dir.path(name));
        assert!(other != whole);
        std::fs::write(dir.path(name), other).unwrap();
        let named = format!("{name}: expected what the run was begun with, found other content");
        fails(&dir, "--out d --resume", &named);
        assert!(bytes(dir.path("d/checkpoint.json")) == before);
        std::fs::write(dir.path(name), whole).unwrap();
    }
    // The folder has all that is needed of the picture.
    std::fs::remove_file(dir.path("photo.exr")).unwrap();
    dir.ok("recover", "--out d --resume");
}

#[test]
fn two_runs_do_not_share_a_folder() {
    let dir = Folder::new();
    let job = "--size 8 --spp 1 --iterations 4";
    let out = dir.run("recover", &format!("{job} --out d --stop-after 1"));
    assert_eq!(out.status.code(), Some(130));
    let files = || {
        let names = std::fs::read_dir(dir.path("d")).unwrap();
        let mut names: Vec<String> = names
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    };
    let clean = files();
    let lock = std::fs::File::open(dir.path("d/recover.lock")).unwrap();
    lock.lock().unwrap();
    for args in [format!("{job} --out d"), "--out d --resume".into()] {
        fails(&dir, &args, "d: expected a folder that no other run uses");
    }
    assert_eq!(files(), clean);
    drop(lock);
    // What a killed run leaves, and what others do.
    let (half, bytes) = (".target.exr.77-3.tmp", "checkpoint-0123456789abcdef.bin");
    for name in [half, bytes, ".notes.tmp"] {
        std::fs::write(dir.path("d").join(name), "half").unwrap();
    }
    dir.ok("recover", "--out d --resume");
    let left = files();
    let has = |name: &str| left.iter().any(|l| l == name);
    assert!(has(".notes.tmp") && !has(half) && !has(bytes), "{left:?}");
}

/// A checkpoint of many values is a short text and a file of bytes, and resumes from every state that a kill can leave.
#[test]
fn large_checkpoints_have_their_arrays_beside_them() {
    let dir = Folder::new();
    let job = textured(&dir);
    dir.ok("recover", &format!("{job} --out whole"));
    let arrays = |folder: &str| {
        let names = std::fs::read_dir(dir.path(folder)).unwrap();
        let mut found: Vec<String> = names
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .filter(|name| name.ends_with(".bin"))
            .collect();
        assert_eq!(found.len(), 1, "{found:?}");
        format!("{folder}/{}", found.remove(0))
    };
    let stop = |args: &str| {
        let out = dir.run("recover", args);
        assert_eq!(out.status.code(), Some(130));
        let name = arrays("parts");
        let kept = [dir.path("parts/checkpoint.json"), dir.path(&name)].map(bytes);
        (name, kept)
    };
    let (first, [text, kept]) = stop(&format!("{job} --out parts --stop-after 3"));
    // Values, variables, and two means.
    assert_eq!(kept.len(), 4 * 4 * 64 * 64 * 3);
    assert!(text.len() < 10_000, "{}", text.len());
    let (second, [_, later]) = stop("--out parts --resume --stop-after 2");
    assert_ne!(first, second);
    assert!(!dir.path(&first).exists());

    // Killed after new bytes and before the text that names them.
    std::fs::write(dir.path("parts/checkpoint.json"), &text).unwrap();
    std::fs::write(dir.path(&first), &kept).unwrap();
    let (again, [_, found]) = stop("--out parts --resume --stop-after 2");
    assert!(again == second && found == later);
    // Bytes that do not belong to the text are not resumed from.
    let name = second.strip_prefix("parts/").unwrap();
    for damaged in [kept, later[..later.len() - 1].to_vec(), Vec::new()] {
        std::fs::write(dir.path(&second), damaged).unwrap();
        fails(&dir, "--out parts --resume", name);
    }
    std::fs::remove_file(dir.path(&second)).unwrap();
    fails(&dir, "--out parts --resume", name);
    std::fs::write(dir.path(&second), later).unwrap();

    dir.ok("recover", "--out parts --resume");
    for name in [
        "checkpoint.json",
        "result.json",
        "wall.reflectance.data.exr",
    ] {
        let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(d).join(name)));
        assert!(whole == parts, "{name}");
    }
    let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(&arrays(d))));
    assert!(whole == parts);
}

#[cfg(unix)]
#[test]
fn checkpoints_that_are_no_files_are_refused() {
    let dir = Folder::new();
    std::fs::create_dir(dir.path("d")).unwrap();
    let path = dir.path("d/checkpoint.json");
    std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
    let message = "checkpoint.json: cannot read the checkpoint: expected a file, found a folder, a device or a pipe";
    fails(&dir, "--out d --resume", message);
    std::fs::remove_file(&path).unwrap();
    let made = Command::new("mkfifo").arg(&path).status().unwrap();
    assert!(made.success());
    fails(&dir, "--out d --resume", message);
}

#[cfg(unix)]
#[test]
fn a_recovery_takes_paths_that_are_not_utf_8() {
    use std::os::unix::ffi::OsStringExt;
    let dir = Folder::new();
    dir.ok("render", "scene.xml -o photo.exr --spp 4");
    let name = std::ffi::OsString::from_vec(b"sc\xff\xfene.xml".to_vec());
    let path = dir.0.path().join(name);
    std::fs::write(&path, SCENE).unwrap();
    let run = |more: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_recover"));
        command.args(["--out", "d"]).args(more.split_whitespace());
        command.arg(&path).current_dir(&dir.0).output().unwrap()
    };
    let job = format!("--target photo.exr --param {WALL} --iterations 3 --spp 1 --stop-after 1");
    for (more, code) in [(job.as_str(), 130), ("--resume", 0)] {
        let out = run(more);
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{stderr}");
    }
}
