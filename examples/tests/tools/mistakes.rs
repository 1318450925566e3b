//! What is asked wrongly, cannot be printed or never ends.

use std::process::Command;
use std::process::Stdio;
use std::time::Duration;
use std::time::Instant;

use render::Image;
use render::image_io::write_exr;

use crate::{Folder, SCENE, WALL};

/// Instead of the wall's material: normals that particles cannot flip.
const FLIPPED: &str = r#"<bsdf type="normalmap" id="wall">
    <boolean name="flip_invalid_normals" value="true"/><texture name="normalmap" type="checkerboard"/>
    <bsdf type="diffuse">"#;

/// Arguments of a tool, the exit code that they end with, and what its message names.
type Mistake = (String, i32, &'static str);

/// Each of them ends with its message, and leaves no file.
fn assert_refused(tool: &str, mistakes: &[Mistake]) {
    let dir = Folder::new();
    write_exr(&dir.path("small.exr"), &Image::new(3, 2)).unwrap();
    let mut infinite = Image::new(36, 24);
    infinite.data[3 * (36 + 5)] = f32::INFINITY;
    write_exr(&dir.path("infinite.exr"), &infinite).unwrap();
    std::fs::write(dir.path("text.exr"), "no image").unwrap();
    std::fs::write(dir.path("broken.xml"), SCENE.replace("diffuse", "difuse")).unwrap();
    let flipped = SCENE
        .replace(r#"<bsdf type="diffuse" id="wall">"#, FLIPPED)
        .replacen("</bsdf>", "</bsdf></bsdf>", 1);
    std::fs::write(dir.path("flipped.xml"), flipped).unwrap();
    let bright = SCENE.replace(
        "</scene>",
        r#"<emitter type="constant" id="sky"><rgb name="radiance" value="3.4e38"/></emitter></scene>"#,
    );
    std::fs::write(dir.path("bright.xml"), bright).unwrap();
    let mut large = Image::new(36, 24);
    large.data.fill(3e38);
    write_exr(&dir.path("large.exr"), &large).unwrap();
    std::fs::create_dir(dir.path("damaged")).unwrap();
    std::fs::write(dir.path("damaged/checkpoint.json"), "{}").unwrap();
    let before = dir.names();
    for (args, code, named) in mistakes {
        let out = dir.run(tool, args);
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(*code), "{tool} {args}: {stderr}");
        assert!(stderr.contains(named), "{tool} {args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{tool} {args}: {stderr}");
        assert_eq!(dir.names(), before, "{tool} {args} left files");
    }
}

#[test]
fn mistakes_of_render_end_with_a_message_and_without_a_file() {
    assert_refused(
        "render",
        &[
            ("nowhere.xml".into(), 1, "nowhere.xml"),
            ("broken.xml".into(), 1, "difuse"),
            (".".into(), 1, "."),
            (String::new(), 2, "<SCENE>"),
            ("scene.xml -o image.tif".into(), 1, "image.tif"),
            ("scene.xml -o scene.xml/a.exr".into(), 1, "scene.xml"),
            (
                "scene.xml -o a.exr --json scene.xml/a.json".into(),
                1,
                "scene.xml: cannot create the folder",
            ),
            (
                "scene.xml -o a.exr --json damaged".into(),
                1,
                "damaged: expected a file, found a folder",
            ),
            (
                "scene.xml -o a.exr --json damaged/../a.png".into(),
                1,
                "a.png: expected a file of its own, found one that would be written twice",
            ),
            (
                "scene.xml -o a.exr --json scene.xml".into(),
                1,
                "scene.xml: expected a file of its own, found one that is read",
            ),
            ("scene.xml --spp 0".into(), 2, "--spp"),
            ("scene.xml --spp many".into(), 2, "--spp"),
            ("scene.xml --spp -4".into(), 2, "'-4' for '--spp"),
            ("scene.xml --threads 0".into(), 2, "--threads"),
            ("scene.xml --max-depth -2".into(), 2, "--max-depth"),
            ("scene.xml --seed 1.5".into(), 2, "--seed"),
            ("scene.xml -D red".into(), 2, "NAME=VALUE"),
            ("scene.xml -D green=1".into(), 1, "green"),
            ("scene.xml -D red=2".into(), 1, "reflectance"),
            ("scene.xml --strategy luck".into(), 2, "luck"),
            ("scene.xml --lights luck".into(), 2, "one, all"),
            (
                "scene.xml --lights all --integrator particle -o a.exr".into(),
                1,
                "--lights",
            ),
            (
                "scene.xml --caustics particles --integrator particle -o a.exr".into(),
                1,
                "--caustics",
            ),
            (
                "scene.xml --strategy bsdf --lights all -o a.exr".into(),
                1,
                "--lights: BSDF sampling chooses no lights",
            ),
            (
                "scene.xml --strategy emitter --heuristic balance -o a.exr".into(),
                1,
                "--heuristic: a single technique has no weights",
            ),
            (
                "scene.xml --integrator particle --strategy bsdf -o a.exr".into(),
                1,
                "--strategy: particles",
            ),
            (
                "scene.xml --integrator particle --heuristic balance -o a.exr".into(),
                1,
                "--heuristic: particles",
            ),
            (
                "scene.xml --pixels-per-particle 2 -o a.exr".into(),
                1,
                "expected --caustics particles",
            ),
            (
                "flipped.xml --integrator particle -o a.exr".into(),
                1,
                "flip_invalid_normals",
            ),
            (
                "flipped.xml --manifold sms --manifold-check -o a.exr".into(),
                1,
                "--manifold-check: flip_invalid_normals",
            ),
            (
                "scene.xml --guide --integrator particle -o a.exr".into(),
                1,
                "--guide: particles are not guided",
            ),
        ],
    );
}

#[test]
fn mistakes_of_gradient_end_with_a_message_and_without_a_file() {
    let wall = format!("scene.xml --param {WALL}");
    assert_refused(
        "gradient",
        &[
            (
                "flipped.xml --param lamp.emitter.radiance.value --caustics particles".into(),
                1,
                "flip_invalid_normals",
            ),
            ("scene.xml".into(), 2, "--param"),
            (format!("{wall} --estimator mis-f64"), 2, "differential-mis"),
            (
                "scene.xml --param wall.alpha.value --json a.json".into(),
                1,
                "wall.alpha",
            ),
            (format!("{wall} --estimator luck"), 2, "luck"),
            (
                format!("{wall} --adjoint large.exr --json a.json"),
                1,
                "gradient: expected a finite value",
            ),
            (
                format!(
                    "bright.xml --param {WALL} --estimator differential-mis --repeats 2 --json a.json"
                ),
                1,
                "(in `wall.reflectance.value`)",
            ),
            (format!("{wall} --repeats 0"), 2, "--repeats"),
            (
                format!("{wall} --lights all --measure-lights --json a.json"),
                1,
                "--measure-lights",
            ),
            (
                format!("{wall} --guide --estimator mis-attached-weights --json a.json"),
                1,
                "weights of mis-attached-weights move",
            ),
            (format!("{wall} --loss l3 --target small.exr"), 2, "l3"),
            (format!("{wall} --loss l2"), 2, "--target"),
            (
                format!("{wall} --loss l2 --target small.exr --json a.json"),
                1,
                "small.exr",
            ),
            (
                format!("{wall} --loss l2 --target text.exr --json a.json"),
                1,
                "text.exr",
            ),
            (
                format!("{wall} --adjoint infinite.exr --json a.json"),
                1,
                "column 5, row 1",
            ),
            (
                format!("{wall} --adjoint nowhere.exr --images d"),
                1,
                "nowhere.exr",
            ),
            (
                format!("{wall} --json scene.xml/a.json --images ."),
                1,
                "scene.xml: cannot create the folder",
            ),
            (
                format!("{wall} --images . --json {WALL}.exr"),
                1,
                "would be written twice",
            ),
            (
                format!("{wall} --estimator attached --images d"),
                1,
                "discontinuities",
            ),
        ],
    );
}

#[test]
fn mistakes_of_recover_end_with_a_message_and_without_a_file() {
    let wall = format!("scene.xml --param {WALL}");
    assert_refused(
        "recover",
        &[
            (format!("{wall} --out d"), 1, "--target"),
            ("scene.xml --target small.exr --out d".into(), 1, "--param"),
            (format!("{wall} --target small.exr --out d"), 1, "small.exr"),
            ("--param nothing --out d".into(), 1, "nothing"),
            ("--out d --lr -1 --size 8".into(), 1, "rate"),
            (
                "--out d --optimizer gauss-newton --loss l1".into(),
                1,
                "curvature",
            ),
            (
                "--out d --optimizer gauss-newton --size 8 --spp 1".into(),
                1,
                "samples per pixel",
            ),
            (
                "--out d --optimizer gauss-newton --estimator detached".into(),
                1,
                "--estimator",
            ),
            ("--out d --estimator nope".into(), 2, "mis-balance"),
            (
                "--out d --estimator attached --size 8".into(),
                1,
                "discontinuities",
            ),
            ("--out d -D foo=1".into(), 2, "SCENE"),
            ("--out d --allow-missing".into(), 2, "SCENE"),
            ("--out d -D foo=1 --size 8".into(), 2, "--define"),
            (
                "--out d --allow-missing --size 8".into(),
                2,
                "--allow-missing",
            ),
            ("--out d --target small.exr --size 8".into(), 2, "--target"),
            ("--out d --lr nan --size 8".into(), 1, "rate"),
            ("--out d --iterations 0".into(), 2, "--iterations"),
            ("--out d --resume".into(), 1, "checkpoint.json"),
            ("--out damaged --resume".into(), 1, "checkpoint.json"),
        ],
    );
}

/// Each tool, and the files of a short run.
const SHORT_RUNS: [(&str, &str, &[&str]); 5] = [
    ("render", "scene.xml --spp 2 -o a.exr", &["a.exr", "a.png"]),
    (
        "gradient",
        "scene.xml --param wall.reflectance.value --spp 2 --json g.json --images d",
        &["g.json", "d/wall.reflectance.value.exr"],
    ),
    (
        "compare",
        "scene.xml --param wall.reflectance.value --spp 1 --repeats 4 --reference mis --estimators mis --out c",
        &["c/report.json", "c/verdict.txt"],
    ),
    (
        "stability",
        "--quick --spp 1 --estimators detached --out s",
        &["s/report.json", "s/stability.png"],
    ),
    (
        "recover",
        "--size 8 --iterations 1 --out r",
        &["r/result.json", "r/checkpoint.json"],
    ),
];

/// What cannot be printed costs no result.
#[cfg(target_os = "linux")]
#[test]
fn output_with_nowhere_to_go_costs_no_file() {
    let full = || {
        std::fs::File::options()
            .write(true)
            .open("/dev/full")
            .unwrap()
    };
    for (tool, args, files) in SHORT_RUNS {
        for (what, code) in [("full", 1), ("closed", 0), ("deaf", 0)] {
            let dir = Folder::new();
            let mut command = dir.command(tool, args);
            match what {
                "full" => command.stdout(full()).stderr(Stdio::piped()),
                "closed" => {
                    let (reader, writer) = std::io::pipe().unwrap();
                    drop(reader);
                    command.stdout(writer).stderr(Stdio::piped())
                }
                _ => command.stdout(Stdio::piped()).stderr(full()),
            };
            let out = command.spawn().unwrap().wait_with_output().unwrap();
            let stderr = String::from_utf8_lossy(&out.stderr);
            assert_eq!(out.status.code(), Some(code), "{tool} {what}: {stderr}");
            let told = stderr.contains("standard output: No space left");
            assert_eq!(told, what == "full", "{tool} {what}: {stderr}");
            for file in files {
                assert!(dir.path(file).is_file(), "{tool} {what}: no {file}");
            }
        }
    }
    // Nothing but what is printed.
    let dir = Folder::new();
    for args in ["scene.xml --list", "--help"] {
        let out = dir
            .command("gradient", args)
            .stdout(full())
            .output()
            .unwrap();
        assert_eq!(out.status.code(), Some(1), "{args}");
    }
}

/// Mirrors all around a lamp, which is one itself: paths never end.
fn closed_mirrors() -> String {
    let mirror = |turn: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="2"/><translate z="-2"/>{turn}</transform><ref id="mirror"/></shape>"#
        )
    };
    let mirrors = [
        "",
        r#"<rotate y="1" angle="180"/>"#,
        r#"<rotate y="1" angle="90"/>"#,
        r#"<rotate y="1" angle="-90"/>"#,
        r#"<rotate x="1" angle="90"/>"#,
        r#"<rotate x="1" angle="-90"/>"#,
    ];
    format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="60"/>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="-1"/><integer name="rr_depth" value="2000000000"/></integrator>
        <bsdf type="conductor" id="mirror"><string name="material" value="none"/></bsdf>{}
        <shape type="sphere" id="lamp"><float name="radius" value="0.1"/><point name="center" value="1, 1, 1"/>
        <ref id="mirror"/><emitter type="area"><rgb name="radiance" value="9"/></emitter></shape></scene>"#,
        mirrors.map(mirror).concat()
    )
}

/// Jobs that nobody would wait for end soon after the signal, with nothing half-done left.
#[cfg(unix)]
#[test]
fn signals_are_noticed_within_jobs() {
    let mirror = "lamp.emitter.radiance.value";
    let cases = [
        ("render", "mirrors.xml --spp 4".to_owned()),
        ("render", "mirrors.xml --spp 4 --integrator particle".into()),
        ("render", "mirrors.xml --guide".into()),
        (
            "gradient",
            format!("scene.xml --param {WALL} --spp 10000000 --json g.json"),
        ),
        (
            "gradient",
            format!("scene.xml --param {WALL} --spp 10000000 --estimator auto"),
        ),
        (
            "compare",
            format!("mirrors.xml --param {mirror} --repeats 4 --out c --estimators mis-f64,auto"),
        ),
        ("stability", "--spp 10000000 --out s".into()),
        ("recover", "--size 16 --spp 10000000 --out r".into()),
    ];
    for (tool, args) in cases {
        let dir = Folder::new();
        std::fs::write(dir.path("mirrors.xml"), closed_mirrors()).unwrap();
        let mut command = dir.command(tool, &args);
        let child = command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let child = child.spawn().unwrap();
        std::thread::sleep(Duration::from_millis(1500));
        let start = Instant::now();
        let kill = Command::new("kill")
            .args(["-TERM", &child.id().to_string()])
            .status();
        assert!(kill.unwrap().success(), "{tool} {args} had ended");
        let out = child.wait_with_output().unwrap();
        // A second, on machines that do something else as well.
        let seconds = start.elapsed().as_secs_f64();
        assert!(seconds < 5.0, "{tool} {args}: {seconds:.1} s");
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(130), "{tool} {args}: {stderr}");
        let temporary = |name: &String| name.ends_with(".tmp") || name.ends_with(".json");
        assert!(!dir.names().iter().any(temporary), "{tool} {args}");
    }
}

/// Devices and pipes may never end: they are refused by name. So are more threads than anybody has.
#[cfg(unix)]
#[test]
fn what_never_ends_is_refused() {
    let dir = Folder::new();
    let made = Command::new("mkfifo").arg(dir.path("pipe")).status();
    assert!(made.unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", dir.path("zero.exr")).unwrap();
    std::os::unix::fs::symlink("pipe", dir.path("pipe.exr")).unwrap();
    for file in ["mesh.obj", "mesh.ply", "mesh.serialized"] {
        std::os::unix::fs::symlink("/dev/zero", dir.path(file)).unwrap();
    }
    let mesh = |kind: &str| {
        let shape = format!(
            r#"<shape type="{kind}"><string name="filename" value="mesh.{kind}"/></shape></scene>"#
        );
        std::fs::write(
            dir.path(&format!("{kind}.xml")),
            SCENE.replace("</scene>", &shape),
        )
        .unwrap();
    };
    mesh("obj");
    let include = SCENE.replace("</scene>", r#"<include filename="pipe"/></scene>"#);
    std::fs::write(dir.path("include.xml"), include).unwrap();
    let texture = SCENE.replace(
        r#"<rgb name="reflectance" value="$red,0.4,0.2"/>"#,
        r#"<texture type="bitmap" name="reflectance"><string name="filename" value="pipe.exr"/></texture>"#,
    );
    std::fs::write(dir.path("texture.xml"), texture).unwrap();
    let wall = format!("scene.xml --param {WALL}");
    let before = dir.names();
    for (tool, args, named) in [
        ("render", "/dev/zero".to_owned(), "/dev/zero"),
        ("render", "pipe -o a.exr".into(), "pipe"),
        ("render", "obj.xml".into(), "mesh.obj"),
        ("render", "include.xml".into(), "pipe"),
        ("render", "texture.xml".into(), "pipe.exr"),
        ("render", "scene.xml -o zero.exr".into(), "zero.exr"),
        ("render", "scene.xml -o pipe.exr".into(), "pipe.exr"),
        ("render", "scene.xml --json /dev/full".into(), "/dev/full"),
        (
            "gradient",
            format!("{wall} --adjoint /dev/zero"),
            "/dev/zero",
        ),
        ("gradient", format!("{wall} --adjoint pipe"), "pipe"),
        (
            "gradient",
            format!("{wall} --loss l2 --target pipe.exr"),
            "pipe.exr",
        ),
        (
            "recover",
            format!("{wall} --target zero.exr --out r"),
            "zero.exr",
        ),
    ] {
        let out = dir.run(tool, &args);
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{tool} {args}: {stderr}");
        assert!(stderr.contains(named), "{tool} {args}: {stderr}");
        assert!(stderr.contains("expected a"), "{tool} {args}: {stderr}");
        assert_eq!(dir.names(), before, "{tool} {args}");
    }
    let mut command = dir.command("render", "scene.xml");
    let out = command.env("RAYON_NUM_THREADS", "100000").output().unwrap();
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(!out.status.success());
    assert!(stderr.contains("at most 1024 threads"), "{stderr}");
    let out = dir.run("render", "scene.xml --threads 100000");
    assert_eq!(out.status.code(), Some(2));
    assert_eq!(dir.names(), before);
}

/// Whatever is wrong with a long word, nobody reads all of it.
#[test]
fn long_words_are_quoted_in_part() {
    let dir = Folder::new();
    let long = "a".repeat(100_000);
    let very_long = "b".repeat(1 << 21);
    for (name, from, to) in [
        (
            "attribute.xml",
            "name=\"radiance\"",
            format!("name=\"{very_long}\""),
        ),
        (
            "value.xml",
            "value=\"10,8,6\"",
            format!("value=\"{very_long}\""),
        ),
        (
            "plugin.xml",
            "type=\"diffuse\"",
            format!("type=\"{very_long}\""),
        ),
        (
            "id.xml",
            "<ref id=\"wall\"",
            format!("<ref id=\"{very_long}\""),
        ),
        ("name.xml", "$red", format!("${very_long}")),
        ("tag.xml", "<ref id=\"wall\"/>", format!("<{very_long}/>")),
        ("text.xml", "<ref id=\"wall\"/>", very_long.clone()),
        ("not.xml", SCENE, very_long.clone()),
        ("comment.xml", SCENE, format!("<!-- {very_long}")),
        ("version.xml", "3.0.0", very_long.clone()),
        (
            "file.xml",
            "<ref id=\"wall\"/>",
            format!("<include filename=\"{very_long}\"/>"),
        ),
    ] {
        std::fs::write(dir.path(name), SCENE.replace(from, &to)).unwrap();
    }
    let long = long.as_str();
    let mut cases: Vec<(&str, Vec<&str>)> = vec![
        ("render", vec!["scene.xml", "--spp", long]),
        ("render", vec!["scene.xml", "--strategy", long]),
        ("render", vec!["scene.xml", long]),
        ("render", vec!["scene.xml", "-D", long]),
        ("render", vec![long]),
        ("gradient", vec!["scene.xml", "--param", long]),
        (
            "gradient",
            vec!["scene.xml", "--param", WALL, "--estimator", long],
        ),
        (
            "compare",
            vec!["scene.xml", "--param", WALL, "--estimators", long],
        ),
        ("stability", vec!["--estimators", long]),
        ("recover", vec!["--param", long, "--out", "r"]),
    ];
    let names = dir.names();
    cases.extend(
        (names.iter().filter(|name| *name != "scene.xml"))
            .map(|name| ("render", vec![name.as_str()])),
    );
    for (tool, args) in cases {
        let mut command = dir.command(tool, "");
        let out = command.args(&args).output().unwrap();
        let args: Vec<&str> = args.iter().map(|a| &a[..a.len().min(20)]).collect();
        let length = out.stderr.len();
        assert!(!out.status.success(), "{tool} {args:?}");
        assert!(length < 9000, "{tool} {args:?}: {length} bytes");
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(!stderr.contains("panicked"), "{tool} {args:?}: {stderr}");
    }
}
