//! `gradient --check`, run as a user runs it.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

/// A plate of rough metal that mirrors a ball light.
const SCENE: &str = r#"<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="2"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="24"/>
    <transform name="to_world"><lookat origin="0, 2.2, 3.6" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/>
    </film>
  </sensor>
  <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.2"/></bsdf>
  <bsdf type="dielectric" id="glass"/>
  <shape type="rectangle">
    <transform name="to_world"><rotate x="1" angle="-90"/></transform><ref id="metal"/>
  </shape>
  <shape type="sphere">
    <point name="center" value="9, 9, 9"/><float name="radius" value="0.1"/><ref id="glass"/>
  </shape>
  <shape type="sphere" id="sun">
    <point name="center" value="-0.6, 2, -3.2"/><float name="radius" value="0.6"/>
    <emitter type="area"><rgb name="radiance" value="4, 3, 2"/></emitter>
  </shape>
</scene>"#;

fn run(folder: &Path, args: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_gradient"))
        .current_dir(folder)
        .args(args.split_whitespace())
        .output()
        .expect("the tool")
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("scene.xml"), SCENE).expect("a scene");
    folder
}

/// 32 repeats of 64 samples: the exit code and the report say the same, and nothing else is written.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn a_check_says_right_wrong_or_neither() {
    let folder = folder();
    for (args, code, verdict) in [
        ("--tolerance 0.3", 0, "right"),
        ("--estimator attached-naive", 3, "wrong"),
        ("--spp 1 --repeats 4 --tolerance 0.01", 4, "cannot tell"),
    ] {
        let args =
            format!("scene.xml --check --param metal.alpha.value --spp 64 --json out.json {args}");
        let args = match args.matches("--spp").count() {
            2 => args.replacen("--spp 64 ", "", 1),
            _ => args,
        };
        let output = run(folder.path(), &args);
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(code), "{text}");
        assert!(text.contains(verdict), "{text}");
        let json = std::fs::read_to_string(folder.path().join("out.json")).expect("a report");
        let report: Value = serde_json::from_str(&json).expect("JSON");
        assert_eq!(report["verdict"], verdict);
        let found = &report["params"]["metal.alpha.value"];
        assert_eq!(found["verdict"], verdict);
        let one = &found["comparisons"][0];
        assert_eq!(one["index"], 0);
        for key in [
            "gradient",
            "std_error",
            "differences",
            "differences_std_error",
            "step",
            "step_error",
            "z",
        ] {
            assert!(one[key].is_f64(), "{key}: {one}");
        }
        let z = one["z"].as_f64().expect("a number").abs();
        assert_eq!(z > report["z_limit"].as_f64().expect("a number"), code == 3);
        assert_eq!(
            std::fs::read_dir(folder.path()).expect("a folder").count(),
            2
        );
    }
}

/// Without names: all parameters, and those that the estimator does not see are named.
#[test]
fn all_parameters_are_checked_if_none_is_named() {
    let folder = folder();
    let output = run(
        folder.path(),
        "scene.xml --check --spp 1 --repeats 4 --json out.json",
    );
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    let json = std::fs::read_to_string(folder.path().join("out.json")).expect("a report");
    let report: Value = serde_json::from_str(&json).expect("JSON");
    let params = report["params"].as_object().expect("parameters");
    assert!(
        params.contains_key("metal.alpha.value")
            && params.contains_key("sun.emitter.radiance.value")
    );
    let refused = report["refused"].as_object().expect("refusals");
    let reason = refused
        .values()
        .next()
        .expect("the index of glass")
        .as_str()
        .expect("a reason");
    assert!(reason.contains("moves a Dirac delta"), "{reason}");
    assert!(String::from_utf8_lossy(&output.stdout).contains("not seen: "));
    // A number depends on the seed alone.
    let again = run(
        folder.path(),
        "scene.xml --check --spp 1 --repeats 4 --threads 1",
    );
    assert_eq!(again.stdout, output.stdout);
}

#[test]
fn mistakes_end_with_a_message() {
    let folder = folder();
    for (args, code, message) in [
        ("scene.xml", 2, "--param"),
        ("scene.xml --check --list", 2, "--list"),
        ("scene.xml --check --images out", 2, "--images"),
        (
            "scene.xml --param metal.alpha.value --tolerance 0.1",
            2,
            "--check",
        ),
        (
            "scene.xml --check --tolerance 2",
            2,
            "expected a number between 0 and 1",
        ),
        (
            "scene.xml --check --repeats 3",
            1,
            "repeats: expected at least four, found 3",
        ),
        (
            "scene.xml --check --param metal.alhpa.value",
            1,
            "closest: metal.alpha.value",
        ),
        (
            "scene.xml --check --estimator attached",
            1,
            "discontinuities",
        ),
        ("scene.xml --check --json scene.xml", 1, "is read"),
    ] {
        let output = run(folder.path(), args);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args}: {text}");
        assert!(text.contains(message), "{args}: {text}");
    }
    assert_eq!(
        std::fs::read_dir(folder.path()).expect("a folder").count(),
        1
    );
}
