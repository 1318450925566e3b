//! The command-line tools, run as a user runs them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use clap::Parser;
use examples::cli::Outcome;
use examples::progress::Interrupt;
use examples::tools::recover;
use render::Image;
use render::image_io::{read_rgb as read_exr, write_exr};
use serde_json::Value;

/// A lamp over a wall. At most four edges: below the depth of roulette, so that image and gradient see
/// the same paths.
const SCENE: &str = r#"<scene version="3.0.0">
  <default name="red" value="0.7"/>
  <integrator type="path"><integer name="max_depth" value="4"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="60"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="36"/><integer name="height" value="24"/>
      <rfilter type="box"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="8"/></sampler>
  </sensor>
  <bsdf type="diffuse" id="wall"><rgb name="reflectance" value="$red,0.4,0.2"/></bsdf>
  <shape type="rectangle"><ref id="wall"/></shape>
  <shape type="rectangle">
    <transform name="to_world"><rotate y="1" angle="90"/><translate x="-1" z="1"/></transform>
    <ref id="wall"/>
  </shape>
  <shape type="rectangle" id="lamp">
    <transform name="to_world">
      <scale value="0.3"/><rotate x="1" angle="180"/><translate x="0.5" z="1.5"/>
    </transform>
    <emitter type="area"><rgb name="radiance" value="10,8,6"/></emitter>
  </shape>
</scene>"#;
/// Instead of the wall's material: normals that particles cannot flip.
const FLIPPED: &str = r#"<bsdf type="normalmap" id="wall">
    <boolean name="flip_invalid_normals" value="true"/><texture name="normalmap" type="checkerboard"/>
    <bsdf type="diffuse">"#;
/// A ball of tinted glass under a constant light.
const GLASS: &str = r#"<scene version="3.0.0">
  <default name="eta" value="1.5"/>
  <integrator type="path"><integer name="max_depth" value="6"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="16"/><integer name="height" value="16"/>
      <rfilter type="box"/>
    </film>
  </sensor>
  <bsdf type="dielectric" id="m">
    <float name="int_ior" value="$eta"/><rgb name="specular_transmittance" value="0.5"/>
  </bsdf>
  <shape type="sphere"><ref id="m"/></shape>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
</scene>"#;
const WALL: &str = "wall.reflectance.value";
const LAMP: &str = "lamp.emitter.radiance.value";

/// An empty folder with a scene in it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        let dir = Self(tempfile::tempdir().unwrap());
        std::fs::write(dir.path("scene.xml"), SCENE).unwrap();
        dir
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs a tool in the folder; the arguments are separated by spaces.
    fn run(&self, tool: &str, args: &str) -> Output {
        self.command(tool, args).output().unwrap()
    }

    fn command(&self, tool: &str, args: &str) -> Command {
        let program = match tool {
            "render" => env!("CARGO_BIN_EXE_render"),
            "gradient" => env!("CARGO_BIN_EXE_gradient"),
            "compare" => env!("CARGO_BIN_EXE_compare"),
            "stability" => env!("CARGO_BIN_EXE_stability"),
            "stam-alg-c" => env!("CARGO_BIN_EXE_stam-alg-c"),
            _ => env!("CARGO_BIN_EXE_recover"),
        };
        let mut command = Command::new(program);
        command.args(args.split_whitespace()).current_dir(&self.0);
        command
    }

    /// [`Folder::run`] that must succeed.
    fn ok(&self, tool: &str, args: &str) {
        let out = self.run(tool, args);
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success(), "{tool} {args}: {stderr}");
        assert!(!stderr.contains("not finite"), "{stderr}");
    }

    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(&self.0)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_str(&std::fs::read_to_string(self.path(name)).unwrap()).unwrap()
    }
}

fn keys(value: &Value) -> Vec<&str> {
    value
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect()
}

/// How a report says its samples were made.
fn samples(report: &Value) -> [&str; 3] {
    ["sampler", "lights", "caustics"].map(|key| report[key].as_str().unwrap())
}

fn numbers(value: &Value) -> Vec<f64> {
    let numbers = value.as_array().unwrap().iter();
    numbers.map(|x| x.as_f64().unwrap()).collect()
}

fn bytes(path: impl AsRef<Path>) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

#[test]
fn mistakes_end_with_a_message_and_without_a_file() {
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

    let wall = format!("scene.xml --param {WALL}");
    let cases = [
        ("render", "nowhere.xml".into(), 1, "nowhere.xml"),
        ("render", "broken.xml".into(), 1, "difuse"),
        ("render", ".".into(), 1, "."),
        ("render", String::new(), 2, "<SCENE>"),
        ("render", "scene.xml -o image.tif".into(), 1, "image.tif"),
        (
            "render",
            "scene.xml -o scene.xml/a.exr".into(),
            1,
            "scene.xml",
        ),
        (
            "render",
            "scene.xml -o a.exr --json scene.xml/a.json".into(),
            1,
            "scene.xml: cannot create the folder",
        ),
        (
            "render",
            "scene.xml -o a.exr --json damaged".into(),
            1,
            "damaged: expected a file, found a folder",
        ),
        (
            "render",
            "scene.xml -o a.exr --json damaged/../a.png".into(),
            1,
            "a.png: expected a file of its own, found one that would be written twice",
        ),
        (
            "render",
            "scene.xml -o a.exr --json scene.xml".into(),
            1,
            "scene.xml: expected a file of its own, found one that is read",
        ),
        ("render", "scene.xml --spp 0".into(), 2, "--spp"),
        ("render", "scene.xml --spp many".into(), 2, "--spp"),
        ("render", "scene.xml --threads 0".into(), 2, "--threads"),
        (
            "render",
            "scene.xml --max-depth -2".into(),
            2,
            "--max-depth",
        ),
        ("render", "scene.xml --seed 1.5".into(), 2, "--seed"),
        ("render", "scene.xml -D red".into(), 2, "NAME=VALUE"),
        ("render", "scene.xml -D green=1".into(), 1, "green"),
        ("render", "scene.xml -D red=2".into(), 1, "reflectance"),
        ("render", "scene.xml --strategy luck".into(), 2, "luck"),
        ("render", "scene.xml --lights luck".into(), 2, "one, all"),
        (
            "render",
            "scene.xml --lights all --integrator particle -o a.exr".into(),
            1,
            "--lights",
        ),
        (
            "render",
            "scene.xml --caustics particles --integrator particle -o a.exr".into(),
            1,
            "--caustics",
        ),
        (
            "render",
            "scene.xml --strategy bsdf --lights all -o a.exr".into(),
            1,
            "--lights: BSDF sampling chooses no lights",
        ),
        (
            "render",
            "scene.xml --strategy emitter --heuristic balance -o a.exr".into(),
            1,
            "--heuristic: a single technique has no weights",
        ),
        (
            "render",
            "scene.xml --integrator particle --strategy bsdf -o a.exr".into(),
            1,
            "--strategy: particles",
        ),
        (
            "render",
            "scene.xml --integrator particle --heuristic balance -o a.exr".into(),
            1,
            "--heuristic: particles",
        ),
        (
            "render",
            "scene.xml --pixels-per-particle 2 -o a.exr".into(),
            1,
            "expected --caustics particles",
        ),
        (
            "gradient",
            "flipped.xml --param lamp.emitter.radiance.value --caustics particles".into(),
            1,
            "flip_invalid_normals",
        ),
        (
            "render",
            "flipped.xml --integrator particle -o a.exr".into(),
            1,
            "flip_invalid_normals",
        ),
        ("gradient", "scene.xml".into(), 2, "--param"),
        (
            "gradient",
            format!("{wall} --estimator mis-f64"),
            2,
            "differential-mis",
        ),
        (
            "gradient",
            "scene.xml --param wall.alpha.value --json a.json".into(),
            1,
            "wall.alpha",
        ),
        ("gradient", format!("{wall} --estimator luck"), 2, "luck"),
        (
            "gradient",
            format!("{wall} --adjoint large.exr --json a.json"),
            1,
            "gradient: expected a finite value",
        ),
        (
            "gradient",
            format!(
                "bright.xml --param {WALL} --estimator differential-mis --repeats 2 --json a.json"
            ),
            1,
            "(in `wall.reflectance.value`)",
        ),
        ("gradient", format!("{wall} --repeats 0"), 2, "--repeats"),
        (
            "gradient",
            format!("{wall} --lights all --measure-lights --json a.json"),
            1,
            "--measure-lights",
        ),
        (
            "gradient",
            format!("{wall} --guide --estimator mis-attached-weights --json a.json"),
            1,
            "weights of mis-attached-weights move",
        ),
        (
            "render",
            "scene.xml --guide --integrator particle -o a.exr".into(),
            1,
            "--guide: particles are not guided",
        ),
        (
            "gradient",
            format!("{wall} --loss l3 --target small.exr"),
            2,
            "l3",
        ),
        ("gradient", format!("{wall} --loss l2"), 2, "--target"),
        (
            "gradient",
            format!("{wall} --loss l2 --target small.exr --json a.json"),
            1,
            "small.exr",
        ),
        (
            "gradient",
            format!("{wall} --loss l2 --target text.exr --json a.json"),
            1,
            "text.exr",
        ),
        (
            "gradient",
            format!("{wall} --adjoint infinite.exr --json a.json"),
            1,
            "column 5, row 1",
        ),
        (
            "gradient",
            format!("{wall} --adjoint nowhere.exr --images d"),
            1,
            "nowhere.exr",
        ),
        (
            "gradient",
            format!("{wall} --json scene.xml/a.json --images ."),
            1,
            "scene.xml: cannot create the folder",
        ),
        (
            "gradient",
            format!("{wall} --images . --json {WALL}.exr"),
            1,
            "would be written twice",
        ),
        (
            "gradient",
            format!("{wall} --estimator attached --images d"),
            1,
            "discontinuities",
        ),
        ("recover", format!("{wall} --out d"), 1, "--target"),
        (
            "recover",
            "scene.xml --target small.exr --out d".into(),
            1,
            "--param",
        ),
        (
            "recover",
            format!("{wall} --target small.exr --out d"),
            1,
            "small.exr",
        ),
        ("recover", "--param nothing --out d".into(), 1, "nothing"),
        ("recover", "--out d --lr -1 --size 8".into(), 1, "rate"),
        (
            "recover",
            "--out d --optimizer gauss-newton --loss l1".into(),
            1,
            "curvature",
        ),
        (
            "recover",
            "--out d --optimizer gauss-newton --size 8 --spp 1".into(),
            1,
            "samples per pixel",
        ),
        (
            "recover",
            "--out d --optimizer gauss-newton --estimator detached".into(),
            1,
            "--estimator",
        ),
        (
            "recover",
            "--out d --estimator nope".into(),
            2,
            "mis-balance",
        ),
        (
            "recover",
            "--out d --estimator attached --size 8".into(),
            1,
            "discontinuities",
        ),
        ("recover", "--out d -D foo=1".into(), 2, "SCENE"),
        ("recover", "--out d --allow-missing".into(), 2, "SCENE"),
        ("recover", "--out d -D foo=1 --size 8".into(), 2, "--define"),
        (
            "recover",
            "--out d --allow-missing --size 8".into(),
            2,
            "--allow-missing",
        ),
        (
            "recover",
            "--out d --target small.exr --size 8".into(),
            2,
            "--target",
        ),
        ("recover", "--out d --lr nan --size 8".into(), 1, "rate"),
        (
            "recover",
            "--out d --iterations 0".into(),
            2,
            "--iterations",
        ),
        ("recover", "--out d --resume".into(), 1, "checkpoint.json"),
        (
            "recover",
            "--out damaged --resume".into(),
            1,
            "checkpoint.json",
        ),
    ];
    for (tool, args, code, named) in cases {
        let out = dir.run(tool, &args);
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(code), "{tool} {args}: {stderr}");
        assert!(stderr.contains(named), "{tool} {args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{tool} {args}: {stderr}");
        assert_eq!(dir.names(), before, "{tool} {args} left files");
    }
}

#[test]
fn render_writes_image_picture_and_report() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml --json new/report.json");
    assert_eq!(dir.names(), ["new", "scene.exr", "scene.png", "scene.xml"]);
    let report = dir.json("new/report.json");
    assert_eq!(
        keys(&report),
        [
            "caustics",
            "height",
            "lights",
            "sampler",
            "scene",
            "seconds_load",
            "seconds_render",
            "spp",
            "threads",
            "width"
        ]
    );
    assert_eq!(report["scene"], "scene.xml");
    assert_eq!((&report["width"], &report["spp"]), (&36.into(), &8.into()));
    assert_eq!(samples(&report), ["sobol", "one", "paths"]);
    let image = read_exr(&dir.path("scene.exr")).unwrap();
    assert_eq!((image.width, image.height), (36, 24));
    assert!(bytes(dir.path("scene.png")).starts_with(b"\x89PNG"));
    let chosen = "--sampler antithetic --lights all --caustics particles";
    dir.ok("render", &format!("scene.xml {chosen} --json all.json"));
    assert_eq!(
        samples(&dir.json("all.json")),
        ["antithetic", "all", "particles"]
    );
    assert_eq!(dir.json("all.json")["pixels_per_particle"], 4);
    assert!(report.get("pixels_per_particle").is_none());
    // Options arrive.
    let mean = |args: &str| {
        dir.ok("render", &format!("scene.xml -o other.exr {args}"));
        read_exr(&dir.path("other.exr")).unwrap().mean()
    };
    assert_eq!(mean(""), image.mean());
    assert_ne!(mean("--seed 1"), image.mean());
    assert!(mean("-D red=0.1")[0] < image.mean()[0]);
    assert!(mean("--max-depth 1")[1] < mean("--max-depth 2")[1]);
    assert!(mean("--max-depth 2")[1] < mean("--max-depth -1")[1]);
}

/// A ball of glass on a floor under a lamp: connections are reported, checked against particles, and their options refused where
/// they would have no effect.
#[test]
fn manifold_connections_are_rendered_reported_and_checked() {
    let dir = Folder::new();
    let text = r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="5"/></integrator>
        <sensor type="perspective"><float name="fov" value="40"/>
        <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0.2, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
        <shape type="rectangle"><bsdf type="diffuse" id="floor"/>
        <transform name="to_world"><scale value="4"/><rotate x="1" angle="-90"/></transform></shape>
        <shape type="sphere"><point name="center" value="0, 0.9, 0"/><float name="radius" value="0.7"/>
        <bsdf type="dielectric" id="glass"/></shape>
        <shape type="rectangle"><transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate y="3"/>
        </transform><emitter type="area"/></shape></scene>"#;
    std::fs::write(dir.path("ball.xml"), text).unwrap();
    dir.ok(
        "render",
        "ball.xml --manifold sms --spp 32 --manifold-check --manifold-picture rates.exr --json sms.json",
    );
    assert!(dir.path("rates.exr").exists());
    let report = dir.json("sms.json");
    let manifold = &report["manifold"];
    assert_eq!(
        (&manifold["method"], &manifold["unbiased"]),
        (&"sms".into(), &true.into())
    );
    let number = |key: &str| manifold[key].as_f64().unwrap();
    assert!(
        number("found") > 0.0
            && number("success_rate") > 0.0
            && number("trials_per_solution") >= 1.0
            && number("share_of_light") > 0.0
    );
    let check = &report["manifold_check"];
    let (z, limit) = (
        check["worst_z"].as_f64().unwrap(),
        check["limit_z"].as_f64().unwrap(),
    );
    assert!(z < limit, "{check}");
    dir.ok(
        "render",
        "ball.xml --manifold mnee --bounces 2 --spp 4 --json mnee.json",
    );
    assert_eq!(dir.json("mnee.json")["manifold"]["unbiased"], false);
    dir.ok(
        "render",
        "ball.xml --manifold mnee-unbiased --bounces 2 --spp 16 --json both.json",
    );
    let both = &dir.json("both.json")["manifold"];
    assert_eq!(both["unbiased"], true);
    assert!(
        both["paths_met"].as_u64() >= both["paths_counted"].as_u64(),
        "{both}"
    );
    let point = r#"<emitter type="point" id="bulb"><point name="position" value="0, 3, 0"/></emitter></scene>"#;
    std::fs::write(dir.path("bulb.xml"), text.replace("</scene>", point)).unwrap();
    dir.ok("render", "ball.xml --manifold off --spp 4 --json off.json");
    assert!(dir.json("off.json").get("manifold").is_none());
    // Chains that are named are left out: the rest of the image, which both halves have.
    let mean = |args: &str| {
        dir.ok("render", args);
        read_exr(&dir.path("x.exr")).unwrap().mean()[1]
    };
    let off = mean("ball.xml --manifold off --spp 32 -o x.exr");
    let rest = mean("ball.xml --manifold off --bounces 2 --spp 32 -o x.exr --json rest.json");
    assert_eq!(dir.json("rest.json")["manifold"]["method"], "left out");
    assert!(rest < off, "{rest} {off}");
    for (args, expected) in [
        ("ball.xml --trials 4", "--manifold"),
        (
            "ball.xml --manifold off --constraint angle",
            "without effect",
        ),
        ("ball.xml --manifold mnee --trials 4", "sms-biased"),
        ("ball.xml --manifold mnee-unbiased --trials 4", "sms-biased"),
        ("bulb.xml --manifold mnee-unbiased", "bulb.intensity.value"),
        (
            "ball.xml --manifold sms --caustics particles",
            "one of them",
        ),
        (
            "ball.xml --manifold sms --integrator particle",
            "--integrator path",
        ),
        ("ball.xml --manifold sms --bounces 9", "1..=8"),
        ("ball.xml --manifold-check", "no connections to check"),
        (
            "ball.xml --manifold off --bounces 1 --manifold-check",
            "no connections to check",
        ),
        (
            "ball.xml --manifold-picture p.exr",
            "no connections to picture",
        ),
        (
            "ball.xml --manifold mnee --starts two-stage",
            "without effect",
        ),
        ("ball.xml --manifold off --starts uniform", "without effect"),
        ("ball.xml --manifold sms --caster-roughness 2", "[0, 1]"),
    ] {
        let output = dir.run("render", &format!("{args} -o refused.exr"));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && message.contains(expected),
            "{args}: {message}"
        );
        assert!(!dir.path("refused.exr").exists(), "{args}");
    }
    let output = dir.run(
        "gradient",
        "ball.xml --manifold sms --param glass.eta.value --estimator mis",
    );
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && message.contains("glass.eta.value"),
        "{message}"
    );
    dir.ok(
        "gradient",
        "ball.xml --manifold sms --param floor.reflectance.value --spp 8 --repeats 2 --json g.json",
    );
}

#[test]
fn glints_are_rendered_reported_and_refused() {
    let dir = Folder::new();
    let mut map = Image::new(8, 8);
    for (i, texel) in map.data.chunks_exact_mut(3).enumerate() {
        let (x, y) = ((i % 8) as f32, (i / 8) as f32);
        let wave = |x: f32| 0.5 + 0.05 * (0.8 * x).sin();
        texel.copy_from_slice(&[wave(x), wave(y), 1.0]);
    }
    write_exr(&dir.path("map.exr"), &map).unwrap();
    let scene = |metal: &str| {
        format!(
            r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="3"/></integrator>
            <sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0, 3, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="12"/></film></sensor>
            <shape type="rectangle">{metal}
            <transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform></shape>
            <emitter type="point"><point name="position" value="0, 3, -4"/></emitter></scene>"#
        )
    };
    let mapped = r#"<bsdf type="normalmap" id="map"><string name="filename" value="map.exr"/>
        <bsdf type="conductor" id="metal"/></bsdf>"#;
    std::fs::write(dir.path("metal.xml"), scene(mapped)).unwrap();
    std::fs::write(dir.path("matt.xml"), scene(r#"<bsdf type="diffuse"/>"#)).unwrap();
    dir.ok(
        "render",
        "metal.xml --glints unbiased --spp 8 --json a.json -o a.exr",
    );
    let report = &dir.json("a.json")["glints"];
    assert_eq!(report["unbiased"], true);
    assert!(report["found"].as_u64().unwrap() > 0, "{report}");
    assert!(report["trials_per_solution"].as_f64().unwrap() >= 1.0);
    assert!(read_exr(&dir.path("a.exr")).unwrap().mean()[1] > 0.0);
    dir.ok(
        "render",
        "metal.xml --glints biased --glint-trials 8 --glint-region footprint --glint-weights lobe --spp 4 --json b.json",
    );
    assert_eq!(dir.json("b.json")["glints"]["unbiased"], false);
    dir.ok("render", "metal.xml --glints off --spp 4 --json off.json");
    assert!(dir.json("off.json").get("glints").is_none());
    for (args, expected) in [
        ("matt.xml --glints unbiased", "no shape of the scene"),
        ("metal.xml --glint-trials 4", "--glints"),
        ("metal.xml --glints off --glint-trials 4", "without effect"),
        (
            "metal.xml --glints unbiased --integrator particle",
            "--integrator path",
        ),
    ] {
        let output = dir.run("render", &format!("{args} -o refused.exr"));
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(
            !output.status.success() && message.contains(expected),
            "{args}: {message}"
        );
        assert!(!dir.path("refused.exr").exists(), "{args}");
    }
    let gradient = |parameter: &str| {
        dir.run(
            "gradient",
            &format!("metal.xml --glints unbiased --param {parameter} --estimator mis --spp 4 --repeats 2"),
        )
    };
    let refused = gradient("map.normalmap.data");
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && message.contains("map.normalmap.data"),
        "{message}"
    );
    let output = gradient("metal.specular_reflectance.value");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn strategies_agree_on_the_mean() {
    let dir = Folder::new();
    let mean = |args: &str| {
        dir.ok("render", &format!("scene.xml -o a.exr --spp 256 {args}"));
        read_exr(&dir.path("a.exr")).unwrap().mean()[1]
    };
    let expected = mean("");
    for args in [
        "--heuristic balance",
        "--strategy emitter",
        "--strategy bsdf",
    ] {
        let relative = mean(args) / expected - 1.0;
        // 0 is far from all: BSDF sampling, the worst, has a standard error of 0.2 %.
        assert!(
            relative.abs() < 0.01 && relative != 0.0,
            "{args}: {relative}"
        );
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let dir = Folder::new();
    for threads in [1, 2, 7] {
        let args = format!("scene.xml --threads {threads}");
        dir.ok("render", &format!("{args} -o {threads}.exr"));
        let args = format!("{args} --param {WALL} --param {LAMP}");
        dir.ok(
            "gradient",
            &format!("{args} --json {threads}.json --images {threads}"),
        );
        let files = ["exr", "png"].map(|e| bytes(dir.path(&format!("{threads}.{e}"))));
        assert_eq!(files, ["1.exr", "1.png"].map(|f| bytes(dir.path(f))));
        let report = dir.json(&format!("{threads}.json"));
        assert_eq!(report["threads"], threads);
        assert_eq!(report["params"], dir.json("1.json")["params"]);
        let image = format!("{WALL}.exr");
        let (a, b) = (
            dir.path("1").join(&image),
            dir.path(&threads.to_string()).join(image),
        );
        assert_eq!(bytes(a), bytes(b));
    }
}

#[test]
fn gradient_of_the_mean_is_right_and_reported() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml -o a.exr --seed 3");
    let args = format!("scene.xml --param {WALL} --param {LAMP} --seed 3");
    dir.ok("gradient", &format!("{args} --json a.json --images d"));
    let report = dir.json("a.json");
    assert_eq!(
        keys(&report),
        [
            "caustics",
            "estimator",
            "lights",
            "params",
            "repeats",
            "sampler",
            "scene",
            "seconds_gradient",
            "seconds_pilots",
            "seconds_primal",
            "spp",
            "threads"
        ]
    );
    assert_eq!(report["estimator"], "mis");
    let lamp = &report["params"][LAMP];
    assert_eq!(keys(lamp), ["gradient", "std_error", "value"]);
    assert_eq!(numbers(&lamp["value"]), [10.0, 8.0, 6.0]);
    assert!(lamp["std_error"].is_null());
    // The image is linear in the light: with the same samples L dJ/dL is the mean / 3.
    let mean = read_exr(&dir.path("a.exr")).unwrap().mean();
    for (c, d) in numbers(&lamp["gradient"]).iter().enumerate() {
        let value = lamp["value"][c].as_f64().unwrap();
        assert!(
            (3.0 * value * d / mean[c] - 1.0).abs() < 1e-5,
            "channel {c}"
        );
    }
    // Forward mode: the mean of the derivative image.
    for key in [WALL, LAMP] {
        let mean = read_exr(&dir.path("d").join(format!("{key}.exr")))
            .unwrap()
            .mean();
        let gradient = numbers(&report["params"][key]["gradient"]);
        for c in 0..3 {
            assert!(
                (3.0 * gradient[c] / mean[c] - 1.0).abs() < 1e-5,
                "{key}[{c}]"
            );
        }
        assert!(dir.path("d").join(format!("{key}.png")).is_file());
    }
    // The default objective, as an explicit adjoint.
    let mut adjoint = Image::new(36, 24);
    adjoint.data.fill(1.0 / (36.0 * 24.0 * 3.0));
    write_exr(&dir.path("adjoint.exr"), &adjoint).unwrap();
    dir.ok(
        "gradient",
        &format!("{args} --adjoint adjoint.exr --json b.json"),
    );
    assert_eq!(dir.json("b.json")["params"], report["params"]);
    // The only light is always sampled.
    dir.ok(
        "gradient",
        &format!("{args} --measure-lights --json c.json"),
    );
    let measured = dir.json("c.json");
    assert_eq!(measured["params"], report["params"]);
    assert_eq!(numbers(&measured["sampling_weights"]), [1.0]);
    // Directions go elsewhere, and the report says so.
    dir.ok("gradient", &format!("{args} --guide --json e.json"));
    let guided = dir.json("e.json");
    assert_ne!(guided["params"], report["params"]);
    assert_eq!(
        (&guided["guide"], report.get("guide")),
        (&true.into(), None)
    );
    // Pixels are measured, and samples go elsewhere; the image of that is beside the report.
    dir.ok(
        "gradient",
        &format!("{args} --measure-pixels --json d.json"),
    );
    let measured = dir.json("d.json");
    assert_ne!(measured["params"], report["params"]);
    assert_eq!(measured["pixel_weights"], "d.pixel_weights.exr");
    let weights = read_exr(&dir.path("d.pixel_weights.exr")).unwrap();
    assert_eq!((weights.width, weights.height), (36, 24));
    assert!(weights.data.iter().any(|w| *w != weights.data[0]));
}

#[test]
fn gradient_of_a_texture_is_an_image() {
    let dir = Folder::new();
    let mut texture = Image::new(5, 3);
    for (i, x) in texture.data.iter_mut().enumerate() {
        *x = 0.2 + 0.01 * i as f32;
    }
    write_exr(&dir.path("wall.exr"), &texture).unwrap();
    let colour = r#"<rgb name="reflectance" value="$red,0.4,0.2"/>"#;
    let bitmap = r#"<texture type="bitmap" name="reflectance">
        <string name="filename" value="wall.exr"/></texture>"#;
    let scene = SCENE.replace(colour, bitmap);
    let scene = scene.replace(r#"<default name="red" value="0.7"/>"#, "");
    std::fs::write(dir.path("scene.xml"), scene).unwrap();
    let key = "wall.reflectance.data";
    let chosen = "--sampler antithetic --lights all";
    let args = format!("scene.xml --param {key} --repeats 3 {chosen} --json a.json --images d");
    dir.ok("gradient", &args);
    let report = dir.json("a.json");
    assert_eq!(samples(&report), ["antithetic", "all", "paths"]);
    let names = ["value", "gradient", "std_error"].map(|what| {
        let name = report["params"][key][what].as_str().unwrap();
        assert_eq!(name, format!("a.{key}.{what}.exr"));
        read_exr(&dir.path(name)).unwrap()
    });
    let [value, gradient, error] = names;
    assert_eq!(value, texture);
    assert_eq!((gradient.width, gradient.height), (5, 3));
    assert!(
        gradient
            .data
            .iter()
            .zip(&error.data)
            .all(|(g, e)| *g > 0.0 && *e > 0.0)
    );
    // The sum over all texels is the derivative in a uniform change. Three repeats against the first:
    // within 10 %, where a wrong factor would be far off.
    let uniform = read_exr(&dir.path("d").join(format!("{key}.exr")))
        .unwrap()
        .mean();
    for (c, uniform) in uniform.iter().enumerate() {
        let sum: f64 = gradient
            .data
            .iter()
            .skip(c)
            .step_by(3)
            .map(|&g| f64::from(g))
            .sum();
        assert!((3.0 * sum / uniform - 1.0).abs() < 0.1, "channel {c}");
    }
}

/// At its optimum the gradient of a loss is zero in the mean only if image and gradient have
/// different random numbers (errata Z-4.4): with common ones it is off by 38 standard errors here.
/// Three channels, significance 1e-3 in all.
#[test]
fn gradient_of_a_loss_is_unbiased() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml -o target.exr --spp 4096 --seed 77");
    let loss = "--loss l2 --target target.exr --spp 2 --repeats 64";
    dir.ok(
        "gradient",
        &format!("scene.xml --param {WALL} {loss} --json a.json"),
    );
    let report = dir.json("a.json");
    assert!(report["loss"].as_f64().unwrap() > 0.0);
    let wall = &report["params"][WALL];
    let (gradient, error) = (numbers(&wall["gradient"]), numbers(&wall["std_error"]));
    for c in 0..3 {
        let z = gradient[c] / error[c];
        // The t distribution with 63 degrees of freedom.
        assert!(z.abs() < 3.8, "channel {c}: {z} standard errors from zero");
    }
}

#[test]
fn parameters_are_listed() {
    let dir = Folder::new();
    let out = dir.run("gradient", "scene.xml --list");
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success());
    for needed in [WALL, LAMP, "rgb", "[0.7, 0.4, 0.2]", "[0, 1]", "sensor.fov"] {
        assert!(text.contains(needed), "{needed} not in:\n{text}");
    }
    assert_eq!(dir.names(), ["scene.xml"]);
}

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

#[test]
fn damaged_checkpoints_are_errors_that_name_the_key() {
    let dir = Folder::new();
    let of = |job: &str| {
        let stopped = dir.run(
            "recover",
            &format!("--size 8 --spp 2 --iterations 8 --stop-after 7 --out d {job}"),
        );
        assert_eq!(stopped.status.code(), Some(130));
        dir.json("d/checkpoint.json")
    };
    let refused = |whole: &Value, at: &str, to: Value, named: &str| {
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
    };

    let whole = of("");
    assert_eq!(whole["tail"], 1);
    let text = |at: &str| whole.pointer(at).unwrap().as_str().unwrap().to_owned();
    let shorter = |at: &str, digits| Value::from(text(at)[digits..].to_owned());
    let ending = |at: &str, digits: &str| {
        let text = text(at);
        Value::from(format!("{}{digits}", &text[..text.len() - digits.len()]))
    };
    let (nan, nan32) = ("7ff8000000000000", "7fc00000");
    let without = |at: &str| {
        let mut rows = whole.pointer(at).unwrap().as_array().unwrap().clone();
        rows.pop();
        Value::from(rows)
    };
    let (row, algorithm) = ("/history/0/values", "/optimizer/first-order");
    let group = format!("{algorithm}/groups/groups/0");
    let adam = format!("{algorithm}/inner/adam");
    let rate = format!("{adam}/rates/segments/0/rate");
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
            without("/history"),
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
            "/inputs/values/0",
            "".into(),
            "inputs.values: expected those of the scene, found others",
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
            without("/job/params"),
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
        refused(&whole, at, to, named);
    }
    let steps = format!("{adam}/steps");
    refused(
        &whole,
        &steps,
        6.into(),
        "optimizer.steps: expected 7 to 7 steps, found 6",
    );

    let newton = of("--optimizer gauss-newton");
    refused(
        &newton,
        "/job/spp",
        1.into(),
        "job.spp: expected at least 2",
    );
    refused(&newton, "/job/loss", "l1".into(), "job.loss: expected l2");
    refused(
        &newton,
        "/job/estimator",
        "detached".into(),
        "job.estimator: expected mis",
    );
    refused(&newton, "/tail", 1.into(), "tail: expected 0");
    let sum = "3ff0000000000000".repeat(10);
    refused(
        &newton,
        "/tail_sum",
        sum.into(),
        "tail_sum: expected 0 values with a tail of 0, found 10",
    );
    let steps = "/optimizer/gauss-newton/steps";
    refused(
        &newton,
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

fn fails(dir: &Folder, args: &str, named: &str) {
    let out = dir.run("recover", args);
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{args}: {stderr}");
    assert!(stderr.contains(named), "{named}: {stderr}");
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

/// How bright a picture is does not decide whether Adam moves; where plain gradient descent does not, it says so.
#[test]
fn dim_scenes_are_recovered_like_bright_ones() {
    let dir = Folder::new();
    let dim = SCENE.replace("10,8,6", "1e-5,8e-6,6e-6");
    std::fs::write(dir.path("dim.xml"), dim).unwrap();
    dir.ok(
        "render",
        "dim.xml -o photo.exr --spp 512 --seed 9 -D red=0.3",
    );
    let job = format!("dim.xml --param {WALL} --target photo.exr --loss l2 -D red=0.6 --spp 4");
    let out = dir.run("recover", &format!("{job} --iterations 150 --out adam"));
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{stderr}");
    assert!(!stderr.contains("no unknown has moved"), "{stderr}");
    let report = dir.json("adam/result.json");
    for (c, truth) in [0.3, 0.4, 0.2].into_iter().enumerate() {
        let found = report["params"][format!("{WALL}[{c}]")]["value"]
            .as_f64()
            .unwrap();
        assert!((found / truth - 1.0).abs() < 0.02, "{c}: {found}");
    }
    let sgd = format!("{job} --iterations 12 --optimizer sgd --out sgd");
    let out = dir.run("recover", &sgd);
    let stderr = String::from_utf8_lossy(&out.stderr);
    let warning = "in 10 steps of sgd at --lr 1: its steps are --lr times the derivative";
    assert_eq!(stderr.matches(warning).count(), 1, "{stderr}");
}

/// Ctrl-C while the pictures are made, or just before, costs pictures and nothing else.
#[test]
fn an_interrupted_recovery_lacks_pictures_that_resuming_makes() {
    let dir = Folder::new();
    dir.ok("render", "scene.xml -o photo.exr --spp 16");
    let run = |out: &str, more: &str, interrupt: &Interrupt| {
        let [scene, photo, out] = ["scene.xml", "photo.exr", out].map(|n| dir.path(n));
        let mut args = vec!["recover".into(), scene.into_os_string()];
        args.extend(["--target".into(), photo.into_os_string()]);
        args.extend(["--out".into(), out.into_os_string()]);
        args.extend(["--param", WALL].map(Into::into));
        args.extend(more.split_whitespace().map(Into::into));
        recover::run(&recover::Args::try_parse_from(args).unwrap(), interrupt).unwrap()
    };
    let (quiet, pressed) = (Interrupt::default(), Interrupt::default());
    pressed.set();
    let exists = |name: &str| dir.path(name).exists();
    let pictures = ["before.exr", "after.exr", "before-after-target.png"];

    let job = "--iterations 3 --spp 2";
    assert_eq!(run("whole", job, &quiet), Outcome::Done);
    // A folder that another job has used.
    std::fs::create_dir(dir.path("parts")).unwrap();
    for name in pictures {
        std::fs::write(dir.path("parts").join(name), "of another job").unwrap();
    }
    assert_eq!(run("parts", job, &pressed), Outcome::Interrupted);
    assert_eq!(dir.json("parts/result.json")["iterations"], 0);
    assert!(exists("parts/target.exr") && exists("parts/iterations.csv"));
    assert!(!pictures.iter().any(|p| exists(&format!("parts/{p}"))));
    assert_eq!(run("parts", "--resume", &quiet), Outcome::Done);
    let same = || {
        for file in pictures.iter().chain(&["checkpoint.json", "result.json"]) {
            let [whole, parts] = ["whole", "parts"].map(|d| bytes(dir.path(d).join(file)));
            assert!(whole == parts, "{file}");
        }
    };
    same();
    // Nothing has moved: the pictures still show the values.
    assert_eq!(run("parts", "--resume", &pressed), Outcome::Interrupted);
    same();

    let long = "--iterations 1000000 --spp 1";
    run("long", &format!("{long} --stop-after 1"), &quiet);
    assert!(pictures.iter().all(|p| exists(&format!("long/{p}"))));
    let mut wait = std::time::Duration::from_millis(50);
    while dir.json("long/checkpoint.json")["iteration"] == 1 {
        wait *= 2;
        let late = Interrupt::default();
        std::thread::scope(|s| {
            s.spawn(|| {
                std::thread::sleep(wait);
                late.set();
            });
            assert_eq!(run("long", "--resume", &late), Outcome::Interrupted);
        });
    }
    assert_eq!(
        pictures.map(|p| exists(&format!("long/{p}"))),
        [true, false, false]
    );
}

#[test]
fn a_colour_is_recovered_from_a_picture() {
    let dir = Folder::new();
    dir.ok(
        "render",
        "scene.xml -o photo.exr --spp 512 --seed 9 -D red=0.3",
    );
    let unknown = format!("scene.xml --param {WALL} --target photo.exr");
    let steps = "--iterations 150 --spp 4 --out found";
    for optimizer in [
        "--optimizer adam",
        "--optimizer sgd --lr 2",
        "--optimizer gauss-newton",
    ] {
        dir.ok(
            "recover",
            &format!("{unknown} {steps} {optimizer} -D red=0.6"),
        );
        let report = dir.json("found/result.json");
        for (c, truth) in [0.3, 0.4, 0.2].into_iter().enumerate() {
            let found = report["params"][format!("{WALL}[{c}]")]["value"]
                .as_f64()
                .unwrap();
            assert!(
                (found / truth - 1.0).abs() < 0.02,
                "{optimizer} {c}: {found}"
            );
        }
        assert_eq!(report["scene"], "scene.xml");
        assert!(dir.path("found/values.svg").is_file());
    }
}

/// Two walls behind each other's sensors, which see one of them each: only the sum over both views knows both colours.
#[test]
fn a_recovery_looks_through_several_sensors() {
    let dir = Folder::new();
    let sensor = |name: &str, z: i32, size: u32| {
        format!(
            r#"<sensor type="perspective" id="{name}"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0,0,0" target="0,0,{z}" up="0,1,0"/></transform>
            <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
            </film></sensor>"#
        )
    };
    let wall = |name: &str, z: i32, colour: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="5"/>
            <lookat origin="0,0,{z}" target="0,0,0" up="0,1,0"/></transform>
            <bsdf type="diffuse" id="{name}"><rgb name="reflectance" value="{colour}"/></bsdf></shape>"#
        )
    };
    let scene = |near: &str, far: &str| {
        format!(
            r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/></integrator>
            {}{}{}{}<emitter type="constant"/></scene>"#,
            sensor("front", 1, 16),
            sensor("back", -1, 12),
            wall("near", 3, near),
            wall("far", -3, far),
        )
    };
    std::fs::write(dir.path("truth.xml"), scene("0.2,0.4,0.6", "0.7,0.3,0.1")).unwrap();
    std::fs::write(dir.path("start.xml"), scene("0.5,0.5,0.5", "0.5,0.5,0.5")).unwrap();
    dir.ok("render", "truth.xml -o front.exr --spp 256");
    dir.ok("render", "truth.xml -o back.exr --spp 256 --sensor back");
    let job = "start.xml --param near.reflectance.value --param far.reflectance.value --spp 4 --iterations 120";
    let views = "--target front=front.exr --target back=back.exr";
    dir.ok("recover", &format!("{job} {views} --out both"));
    let report = dir.json("both/result.json");
    for (wall, truth) in [("near", [0.2, 0.4, 0.6]), ("far", [0.7, 0.3, 0.1])] {
        for (c, truth) in truth.into_iter().enumerate() {
            let value = &report["params"][format!("{wall}.reflectance.value[{c}]")]["value"];
            let found = value.as_f64().unwrap();
            assert!((found - truth).abs() < 0.01, "{wall} {c}: {found}");
        }
    }
    for kind in ["before", "after", "target"] {
        for view in ["front", "back"] {
            assert!(dir.path(&format!("both/{kind}-{view}.exr")).is_file());
        }
    }
    // In parts it is the same run; one target is the first sensor's.
    let parts = format!("{job} --target front.exr --target 1=back.exr --out parts --stop-after 50");
    let out = dir.run("recover", &parts);
    assert_eq!(out.status.code(), Some(130));
    dir.ok("recover", "--out parts --resume");
    let found = |folder: &str| dir.json(&format!("{folder}/result.json"))["params"].clone();
    assert_eq!(found("parts"), found("both"));

    let unknown = format!("{job} --target side=back.exr --out none");
    let message = "--target: parameter `sensor`: expected a number below 2 or one of `front`, `back`, found `side`";
    fails(&dir, &unknown, message);
    fails(
        &dir,
        &format!("{job} --target back=front.exr --out none"),
        "12",
    );
}

/// The index of smooth glass moves a Dirac delta: for whole paths that move and for nothing else.
#[test]
fn the_index_of_smooth_glass_is_recovered() {
    let dir = Folder::new();
    std::fs::write(dir.path("glass.xml"), GLASS).unwrap();
    dir.ok("render", "glass.xml -o photo.exr --spp 512");
    let unknown = "glass.xml --param m.eta.value --target photo.exr -D eta=1.3 --out found";
    let detached = dir.run("recover", unknown);
    assert_eq!(detached.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&detached.stderr).contains("m.eta.value"));
    assert!(!dir.path("found").exists());

    let steps = "--iterations 100 --spp 16 --loss l2";
    dir.ok(
        "recover",
        &format!("{unknown} {steps} --estimator attached-path"),
    );
    let report = dir.json("found/result.json");
    let found = report["params"]["m.eta.value"]["value"].as_f64().unwrap();
    assert!((found / 1.5 - 1.0).abs() < 0.02, "{found}");
}

#[test]
fn estimators_are_compared_and_the_numbers_depend_on_the_seed_alone() {
    let dir = Folder::new();
    let names = "mis,detached,differential-mis,attached,attached-naive";
    let args = format!("scene.xml --param {WALL} --estimators {names} --spp 4 --repeats 6");
    dir.ok("compare", &format!("{args} --out a --threads 1"));
    dir.ok(
        "compare",
        &format!("{args} --out b --threads 3 --json b.json"),
    );
    let (a, b) = (dir.json("a/report.json"), dir.json("b/report.json"));
    assert_eq!(dir.json("b.json"), b);
    assert_eq!(samples(&a), ["sobol", "one", "paths"]);
    let rows = |v: &Value| v["rows"].as_array().unwrap().clone();
    assert_eq!(rows(&a).len(), 4);
    for (a, b) in rows(&a).iter().zip(&rows(&b)) {
        for key in ["estimator", "mean", "z", "z_block", "variance", "finding"] {
            assert_eq!(a[key], b[key], "{key}");
        }
        assert!(a["efficiency"].as_f64().unwrap() > 0.0);
    }
    assert_eq!(rows(&a)[0]["finding"], "right");
    let refused = a["refused"].as_array().unwrap();
    assert_eq!(refused.len(), 1);
    assert!(
        refused[0]["reason"]
            .as_str()
            .unwrap()
            .contains("discontinuities")
    );
    for file in ["table.csv", "ladder.csv", "verdict.txt"] {
        assert!(dir.path("a").join(file).exists(), "{file}");
    }
    let chart = format!("{WALL}.error.svg");
    assert!(dir.path("a").join(chart).exists());
    assert!(dir.path("a").join(format!("{WALL}.std.mis.exr")).exists());

    let out = dir.run(
        "compare",
        &format!("scene.xml --param {WALL} --estimators best"),
    );
    assert_eq!(out.status.code(), Some(1));
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(
        stderr.contains("`best`; known: auto, mis-f64, ") && stderr.contains("differential-mis"),
        "{stderr}"
    );
}

#[test]
fn estimators_that_never_meet_the_light_are_not_called_biased() {
    let dir = Folder::new();
    let tiny = SCENE.replace(r#"<scale value="0.3"/>"#, r#"<scale value="2e-4"/>"#);
    let tiny = tiny.replace("10,8,6", "1e7,8e6,6e6");
    std::fs::write(dir.path("tiny.xml"), tiny).unwrap();
    let args = format!("--param {LAMP} --estimators mis,detached --spp 4 --repeats 6 --out a");
    dir.ok("compare", &format!("tiny.xml {args}"));
    let report = dir.json("a/report.json");
    let rows = report["rows"].as_array().unwrap().iter();
    let findings: Vec<_> = rows.map(|r| r["finding"].as_str().unwrap()).collect();
    assert_eq!(findings, ["right", "unresolved"]);
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(
        verdict.contains("unresolved: detached") && !verdict.contains("biased:"),
        "{verdict}"
    );
}

/// Against a reference that is wrong, a right estimator differs and differs again; finite differences are not wrong
/// by their step.
#[test]
fn differences_are_looked_at_twice_and_steps_are_no_bias() {
    let dir = Folder::new();
    let metal =
        r#"<bsdf type="roughconductor" id="metal"><float name="alpha" value="0.3"/></bsdf>"#;
    let shiny = SCENE.replace(
        r#"<shape type="rectangle"><ref id="wall"/></shape>"#,
        &format!(r#"<shape type="rectangle">{metal}</shape>"#),
    );
    std::fs::write(dir.path("shiny.xml"), shiny).unwrap();
    let args =
        "--param metal.alpha.value --estimators mis,attached-naive --reference attached-naive";
    dir.ok("compare", &format!("shiny.xml {args} --spp 64 --out a"));
    let rows = dir.json("a/report.json")["rows"].clone();
    assert_eq!(rows[0]["finding"], "biased", "{rows}");
    assert_eq!(rows[1]["finding"], "right", "{rows}");
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(verdict.contains("again so with four times"), "{verdict}");

    // A mirror: differences of a hundredth of the normal are off by three.
    let mirror = r#"<bsdf type="normalmap" id="wall"><texture name="normalmap" type="checkerboard">
            <rgb name="color0" value="0.6, 0.45, 0.95"/><rgb name="color1" value="0.48, 0.55, 0.98"/></texture>
        <bsdf type="conductor"/></bsdf>
        <emitter type="vmf"><vector name="direction" value="0.1, -0.2, 1"/><float name="kappa" value="12"/></emitter>"#;
    let start = SCENE.split("<bsdf").next().unwrap();
    let wall = r#"<shape type="rectangle"><ref id="wall"/></shape></scene>"#;
    std::fs::write(dir.path("mirror.xml"), format!("{start}{mirror}{wall}")).unwrap();
    let args =
        "--param wall.normalmap.color0.value --estimators attached-path --reference fd --out b";
    dir.ok("compare", &format!("mirror.xml {args}"));
    let report = dir.json("b/report.json");
    assert_eq!(report["rows"][0]["finding"], "right", "{report}");
    assert!(report["rows"][0]["mean"][0].as_f64().unwrap().abs() > 0.01);

    // Nobody left is a mistake.
    let refused = dir.run(
        "compare",
        &args
            .replace("attached-path", "mis,detached")
            .replace("--param", "mirror.xml --param"),
    );
    assert_eq!(refused.status.code(), Some(1));
}

#[test]
fn failures_of_estimators_are_marked_and_depend_on_the_seed_alone() {
    let dir = Folder::new();
    let names = "emitter,detached,attached,attached-naive,differential-mis";
    let args = format!("--quick --estimators {names}");
    dir.ok("stability", &format!("{args} --out a --threads 1"));
    dir.ok(
        "stability",
        &format!("{args} --out b --threads 3 --json b.json"),
    );
    let (a, b) = (dir.json("a/report.json"), dir.json("b/report.json"));
    assert_eq!(dir.json("b.json"), b);
    let rows = |v: &Value| v["rows"].as_array().unwrap().clone();
    assert_eq!(rows(&a).len(), rows(&b).len());
    let mut biased = 0;
    for (a, b) in rows(&a).iter().zip(&rows(&b)) {
        for key in ["sweep", "x", "estimator", "mean", "z", "std", "finding"] {
            assert_eq!(a[key], b[key], "{key}");
        }
        assert_eq!(a["non_finite"], 0);
        if a["finding"] == "biased" {
            assert_eq!(a["estimator"], "attached-naive", "{a}");
            biased += 1;
        }
    }
    assert!(biased > 0);
    // The law of roughness: 2 / alpha.
    let smooth = rows(&a).into_iter().find(|r| {
        r["sweep"] == "roughness-beckmann" && r["estimator"] == "detached" && r["x"] == 1e-4
    });
    let std = smooth.unwrap()["std"].as_f64().unwrap();
    assert!((std / 2e4 - 1.0).abs() < 0.2, "{std}");
    for file in [
        "points.csv",
        "verdict.txt",
        "stability.png",
        "stability.svg",
    ] {
        assert!(!bytes(dir.path("a").join(file)).is_empty(), "{file}");
    }
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    for mode in ["F1:", "F2:", "F8, F10", "F40:"] {
        assert!(verdict.contains(mode), "{mode} not in:\n{verdict}");
    }
    let out = dir.run("stability", "--estimators best");
    assert_eq!(out.status.code(), Some(1));
}

/// Edges are right however things move; what has no term for them, or forgets that rays start from what moves, is marked
/// where that matters.
#[test]
fn failures_of_what_moves_are_marked() {
    let dir = Folder::new();
    dir.ok(
        "stability",
        "--quick --estimators edges,interior,biased-rays,reparameterised-mis,reparameterised-exact --out a",
    );
    let report = dir.json("a/report.json");
    let all = report["rows"].as_array().unwrap();
    let moving = || all.iter().filter(|r| r["param"] != "metal.alpha.value");
    let mut outlines = 0;
    for r in moving() {
        let (sweep, x) = (r["sweep"].as_str().unwrap(), r["x"].as_f64().unwrap());
        let right = match r["estimator"].as_str().unwrap() {
            // What is smaller than a pixel is met by edges alone.
            "reparameterised-exact" if r["finding"] == "unresolved" => continue,
            "edges" | "reparameterised-exact" => true,
            "interior" => sweep == "bounces",
            "biased-rays" => sweep != "bounces" || x == 2.0,
            _ => continue,
        };
        let expected = if right { "right" } else { "biased" };
        assert_eq!(r["finding"], expected, "{r}");
        outlines += usize::from(!right);
    }
    assert!(outlines > 8, "{report}");
    for file in ["motion.png", "motion.svg", "stability.png"] {
        assert!(!bytes(dir.path("a").join(file)).is_empty(), "{file}");
    }
    let verdict = String::from_utf8(bytes(dir.path("a").join("verdict.txt"))).unwrap();
    assert!(verdict.contains("F44: biased-rays: biased"), "{verdict}");
}

/// Each tool, and the files of a short run.
const SHORT_RUNS: [(&str, &str, &[&str]); 6] = [
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
    ("stam-alg-c", "--quick --out f", &["f/manifest.json"]),
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
        let failed = if tool.contains('-') { 2 } else { 1 };
        for (what, code) in [("full", failed), ("closed", 0), ("deaf", 0)] {
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

/// Alone, without a scene; beside anything else it is refused.
#[test]
fn estimators_are_listed_with_what_they_refuse() {
    let dir = Folder::new();
    for tool in ["compare", "gradient", "recover", "stability"] {
        let out = dir.command(tool, "--list-estimators").output().unwrap();
        assert!(
            out.status.success(),
            "{tool}: {}",
            String::from_utf8_lossy(&out.stderr)
        );
        let text = String::from_utf8(out.stdout).unwrap();
        for e in render::instances::Estimator::ALL {
            let row = format!(
                "{}\n    {}\n    {}\n",
                e.name(),
                e.summary(),
                e.capabilities()
            );
            assert!(text.contains(&row), "{tool}: no {row}in\n{text}");
            for refusal in e.capabilities().refusals() {
                assert!(text.contains(&refusal.to_string()), "{tool}: {refusal}");
            }
        }
        assert!(
            text.contains("positions of shapes") && text.contains("cameras"),
            "{text}"
        );
        let out = dir
            .command(tool, "--list-estimators --seed 1")
            .output()
            .unwrap();
        assert_eq!(out.status.code(), Some(2), "{tool}");
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

#[cfg(unix)]
#[test]
fn images_are_written_through_links_and_left_overs_removed() {
    let dir = Folder::new();
    std::os::unix::fs::symlink("target.exr", dir.path("link.exr")).unwrap();
    std::os::unix::fs::symlink("scene.xml", dir.path("own.exr")).unwrap();
    std::fs::write(dir.path(".target.exr.1-0.tmp"), "of a run that was killed").unwrap();
    dir.ok("render", "scene.xml --spp 1 -o link.exr");
    assert!(dir.path("link.exr").is_symlink());
    assert!(read_exr(&dir.path("target.exr")).is_ok());
    assert!(!dir.path(".target.exr.1-0.tmp").exists());
    let out = dir.run("render", "scene.xml --spp 1 -o own.exr");
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert!(stderr.contains("one that is read"), "{stderr}");
    assert_eq!(bytes(dir.path("scene.xml")), SCENE.as_bytes());
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
    for (tool, args) in [("render", "scene.xml"), ("stam-alg-c", "--quick")] {
        let mut command = dir.command(tool, args);
        let out = command.env("RAYON_NUM_THREADS", "100000").output().unwrap();
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(!out.status.success(), "{tool}");
        assert!(stderr.contains("at most 1024 threads"), "{tool}: {stderr}");
        let out = dir.run(tool, &format!("{args} --threads 100000"));
        assert_eq!(out.status.code(), Some(2), "{tool}");
    }
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
        ("stam-alg-c", vec!["--out", "f", "--threads", long]),
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

/// What of a scene is understood, line by line, and an exit code that says whether it would render.
#[test]
fn a_check_says_what_is_understood() {
    let dir = Folder::new();
    let check = |text: &str| {
        std::fs::write(dir.path("checked.xml"), text).unwrap();
        let json = dir.path("found.json");
        let output = Command::new(env!("CARGO_BIN_EXE_render"))
            .arg(dir.path("checked.xml"))
            .args(["--check", "--json"])
            .arg(&json)
            .output()
            .unwrap();
        let report: Value = serde_json::from_slice(&std::fs::read(json).unwrap()).unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        (output.status.code(), text, report)
    };
    let (code, text, report) = check(SCENE);
    assert_eq!(
        (code, report["outcome"].as_str()),
        (Some(0), Some("renders")),
        "{text}"
    );
    assert!(
        text.contains("understood       3  shape `rectangle`: 14, 15, 19"),
        "{text}"
    );
    let wall = SCENE.replace(
        "<bsdf type=\"diffuse\" id=\"wall\">",
        "<bsdf type=\"polarizer\" id=\"wall\">",
    );
    let (code, text, report) = check(&wall);
    assert_eq!(
        (code, report["outcome"].as_str()),
        (Some(1), Some("refused")),
        "{text}"
    );
    assert!(
        text.starts_with("refused         13  bsdf `polarizer`: polarisation is not there"),
        "{text}"
    );
    assert_eq!(report["findings"][0]["line"], 13);
    let texture = "<texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"none.png\"/></texture>";
    let wall = SCENE.replace(
        "<rgb name=\"reflectance\" value=\"$red,0.4,0.2\"/>",
        texture,
    );
    let (code, text, report) = check(&wall);
    assert_eq!(
        (code, report["outcome"].as_str()),
        (Some(1), Some("incomplete")),
        "{text}"
    );
    assert!(
        text.contains("missing         13  `filename`: expected an existing file"),
        "{text}"
    );
    let (code, _, report) = check(&SCENE.replace("fov", "fow"));
    assert_eq!((code, report["outcome"].as_str()), (Some(1), Some("wrong")));
    // Nothing else is done.
    assert!(!Path::new("checked.exr").exists());
}

/// Any parameter may be set, by its own name, by that of Mitsuba 3 or by a pattern, to numbers or to an image.
#[test]
fn parameters_are_set_on_the_command_line() {
    let dir = Folder::new();
    let list = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_gradient"))
            .arg(dir.path("scene.xml"))
            .arg("--list")
            .args(args)
            .current_dir(&dir.0)
            .output()
            .unwrap();
        let text = String::from_utf8(output.stdout).unwrap();
        let error = String::from_utf8(output.stderr).unwrap();
        (output.status.code(), text, error)
    };
    let value = |args: &[&str], name: &str| {
        let (code, text, error) = list(args);
        assert_eq!(code, Some(0), "{error}");
        let line = text
            .lines()
            .find(|l| l.starts_with(name))
            .map(str::to_owned);
        line.unwrap_or_else(|| panic!("{text}"))
    };
    assert!(value(&[], WALL).contains("[0.7, 0.4, 0.2]  also Rectangle.bsdf.reflectance.value"));
    for key in [
        WALL,
        "Rectangle_1.bsdf.reflectance",
        "wall.*",
        "Rect*.reflectance.value",
    ] {
        assert!(
            value(&["-P", &format!("{key}=0.25")], WALL).contains("[0.25, 0.25, 0.25]"),
            "{key}"
        );
        let three = format!("{key}=0.1, 0.2 0.3");
        assert!(
            value(&["-P", &three], WALL).contains("[0.1, 0.2, 0.3]"),
            "{key}"
        );
    }
    for (argument, expected) in [
        ("wall.reflectence=0.2", "closest: wall.reflectance.value"),
        (
            "wall.reflectance=1.5",
            "expected a value in [0, 1], found 1.5",
        ),
        ("wall.reflectance=0.1,0.2", "expected one or three numbers"),
        ("wall.reflectance=a.exr", "expected one or three numbers"),
        ("*.alpha=1", "no parameter `*.alpha`"),
    ] {
        let (code, _, error) = list(&["-P", argument]);
        assert!(
            code == Some(1) && error.contains(expected),
            "{argument}: {error}"
        );
    }
    // Texels take an image of their size.
    let image = |width: usize, value: f32| Image {
        width,
        height: 1,
        data: vec![value; 3 * width],
    };
    write_exr(&dir.path("own.exr"), &image(2, 0.5)).unwrap();
    write_exr(&dir.path("new.exr"), &image(2, 0.75)).unwrap();
    write_exr(&dir.path("wide.exr"), &image(3, 0.75)).unwrap();
    let texture = "<texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"own.exr\"/></texture>";
    let wall = SCENE.replace(
        "<rgb name=\"reflectance\" value=\"$red,0.4,0.2\"/>",
        texture,
    );
    std::fs::write(dir.path("scene.xml"), wall).unwrap();
    let texels = "wall.reflectance.data";
    assert!(value(&[], texels).contains("mean 0.500000"));
    assert!(value(&["-P", "wall.reflectance=new.exr"], texels).contains("mean 0.750000"));
    assert!(value(&["-P", "wall.reflectance=0.1"], texels).contains("mean 0.100000"));
    let (code, _, error) = list(&["-P", "wall.reflectance=wide.exr"]);
    assert!(
        code == Some(1) && error.contains("an image of 2 x 1, found one of 3 x 1"),
        "{error}"
    );
}

/// A tent before a lamp, whose points and colours are unknown.
const TENT: &str = r#"<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="3"/></integrator>
  <sensor type="perspective" id="eye"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="12"/><rfilter type="box"/></film>
  </sensor>
  <shape type="obj" id="it"><string name="filename" value="tent.obj"/>
    <bsdf type="diffuse" id="cloth"><texture name="reflectance" type="bitmap" id="weave">
      <string name="filename" value="weave.exr"/><boolean name="raw" value="true"/></texture></bsdf></shape>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
</scene>"#;

/// Points of a mesh and texels are recovered together, with options behind their keys, and written as a scene that renders:
/// its mesh beside it. Cameras are, by Gauss-Newton steps.
#[test]
fn shapes_are_recovered_and_written() {
    let dir = Folder::new();
    std::fs::write(dir.path("tent.xml"), TENT).unwrap();
    let mut tent = String::new();
    for j in 0..5 {
        for i in 0..5 {
            let [x, y] = [i, j].map(|k| f64::from(k) / 4.0);
            let z = 0.3 * (3.0 * x).sin();
            tent += &format!("v {} {} {z}\nvt {x} {y}\n", 2.0 * x - 1.0, 2.0 * y - 1.0);
        }
    }
    for a in (0..20).filter(|a| a % 5 < 4).map(|a| a + 1) {
        let b = a + 5;
        tent += &format!("f {a}/{a} {0}/{0} {1}/{1} {b}/{b}\n", a + 1, b + 1);
    }
    std::fs::write(dir.path("tent.obj"), tent).unwrap();
    let mut weave = Image::new(8, 8);
    weave
        .data
        .iter_mut()
        .enumerate()
        .for_each(|(i, x)| *x = 0.3 + 0.05 * (i % 7) as f32);
    write_exr(&dir.path("weave.exr"), &weave).unwrap();
    dir.ok("render", "tent.xml --spp 64 -o t.exr");

    let common = "tent.xml --target t.exr --estimator edges --spp 2 --iterations 6";
    let points = "--param it.vertex_positions:smooth=4,lr=0.01";
    let texels = "--param cloth.reflectance.data:coarse=2";
    dir.ok(
        "recover",
        &format!("{common} {points} {texels} -P cloth.reflectance.data=0.5 --out d"),
    );
    assert!(dir.path("d/scene/scene.xml").exists() && dir.path("d/scene/meshes/it.ply").exists());
    dir.ok("render", "d/scene/scene.xml --spp 4 -o again.exr");
    // Six steps of two texels along each side, then four, then eight: the checkpoint knows.
    dir.ok(
        "recover",
        &format!("{common} {texels} --stop-after 6 --out e"),
    );
    assert_eq!(
        dir.run("recover", "--resume --out e --iterations 6")
            .status
            .code(),
        Some(0)
    );

    for (option, needed) in [
        ("it.vertex_positions:coarse=2", "texels for coarse"),
        (
            "cloth.reflectance.data:smooth=2",
            "points of a mesh for smooth",
        ),
        (
            "it.vertex_positions:smooth=-1",
            "a positive number for smooth",
        ),
        ("it.vertex_positions:rough=1", "lr, smooth or coarse"),
    ] {
        let out = dir.run("recover", &format!("{common} --param {option} --out f"));
        let stderr = String::from_utf8_lossy(&out.stderr);
        assert!(
            !out.status.success() && stderr.contains(needed),
            "{option}: {stderr}"
        );
    }

    let newton =
        "tent.xml --target t.exr --estimator edges --optimizer gauss-newton --spp 8 --iterations 3";
    dir.ok(
        "recover",
        &format!("{newton} --param sensor.translation -P sensor.translation=0.2,0,0 --out g"),
    );
    let found = dir.json("g/result.json");
    let x = found["params"]["sensor.translation[0]"]["value"]
        .as_f64()
        .unwrap();
    assert!(x.abs() < 0.2, "{x}");
}
