//! The command-line tools, run as a user runs them.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

mod checkpoints;
mod estimators;
mod gradients;
mod images;
mod mistakes;
mod recovery;

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
  <shape type="sphere" id="ball"><ref id="m"/></shape>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
</scene>"#;

/// Two walls `near_wall` and `far_wall`, of this size, with paints `near` and `far` of these colours, behind each other's
/// sensors `front` and `back`, which see one of them each, under a sky.
fn back_to_back(size: f64, colours: [&str; 2]) -> String {
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
            r#"<shape type="rectangle" id="{name}_wall"><transform name="to_world"><scale value="{size}"/>
            <lookat origin="0,0,{z}" target="0,0,0" up="0,1,0"/></transform>
            <bsdf type="diffuse" id="{name}"><rgb name="reflectance" value="{colour}"/></bsdf></shape>"#
        )
    };
    format!(
        r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/></integrator>
        {}{}{}{}<emitter type="constant"/></scene>"#,
        sensor("front", 1, 16),
        sensor("back", -1, 12),
        wall("near", 3, colours[0]),
        wall("far", -3, colours[1]),
    )
}

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

fn fails(dir: &Folder, args: &str, named: &str) {
    let out = dir.run("recover", args);
    let stderr = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{args}: {stderr}");
    assert!(stderr.contains(named), "{named}: {stderr}");
}
