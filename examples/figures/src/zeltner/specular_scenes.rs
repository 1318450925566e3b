//! Scenes of smooth metal and glass, after those of [Zeltner et al. 2020].

use std::path::Path;

use ad_core::Vec3;
use render::manifold::{Space, Split, Start};
use render::math::Ray;
use render::params::Theta;
use render::scene::{Connections, Constraint, LoadOptions, Steps};
use render::{Scene, Settings};

use examples::figure::Result;

/// A mirrored cylinder that stands on a floor, and a lamp outside of it.
pub const RING: &str = r#"
    <shape type="rectangle"><transform name="to_world"><scale value="0.1"/><rotate x="1" angle="90"/>
        <translate x="-12" y="10" z="8"/></transform>
        <emitter type="area"><rgb name="radiance" value="70000"/></emitter></shape>
    <shape type="cylinder"><bsdf type="twosided"><bsdf type="conductor"/></bsdf>
        <transform name="to_world"><scale x="10" y="10" z="4"/><rotate x="1" angle="-90"/>
        <rotate y="1" angle="140"/></transform></shape>
    <shape type="rectangle"><bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.1, 0.14"/></bsdf>
        <transform name="to_world"><scale value="100"/><rotate x="1" angle="-90"/></transform></shape>"#;

/// A half-buried ball of glass, lit from 60 degrees by a lamp of half the side `half`.
pub fn buried_ball(half: f64, radiance: f64) -> String {
    format!(
        r#"<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><scale x="{half}" y="1" z="{half}"/>
            <translate y="50"/><rotate x="1" angle="60"/><rotate y="1" angle="90"/></transform>
            <emitter type="area"><rgb name="radiance" value="{radiance}"/></emitter></shape>
        <shape type="rectangle"><bsdf type="diffuse"/>
            <transform name="to_world"><scale value="400"/><rotate x="1" angle="-90"/></transform></shape>
        <shape type="sphere"><float name="radius" value="6.5"/><bsdf type="dielectric"/></shape>"#
    )
}

/// A view.
pub struct View {
    /// From where, and what is in the middle.
    pub lookat: [[f64; 3]; 2],
    /// Angle, degrees.
    pub fov: f64,
    /// Pixels of each side.
    pub size: u32,
}

/// The view of a scene with paths of at most so many edges.
///
/// # Errors
/// None that the constants here can cause.
pub fn load(body: &str, view: &View, depth: u32) -> Result<Scene> {
    let point = |p: [f64; 3]| format!("{}, {}, {}", p[0], p[1], p[2]);
    let View { lookat, fov, size } = view;
    let [origin, target] = lookat.map(point);
    let text = format!(
        r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
        <sensor type="perspective"><float name="fov" value="{fov}"/>
            <transform name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
            <rfilter type="box"/></film></sensor>{body}</scene>"#
    );
    let (scene, _) = Scene::from_xml(&text, Path::new("."), &LoadOptions::default())?;
    Ok(scene)
}

/// With connections like these.
pub fn connected(scene: &Scene, connections: Option<Connections>) -> Settings {
    Settings {
        connections,
        ..scene.settings
    }
}

/// A scene whose chains are looked at one by one.
pub struct Laboratory {
    /// The scene.
    pub scene: Scene,
    values: Vec<f64>,
}

impl Laboratory {
    /// In a scene.
    pub fn new(scene: Scene) -> Self {
        let values = scene.params().values().iter().map(|&x| f64::from(x));
        Self {
            values: values.collect(),
            scene,
        }
    }

    /// Where chains are sought.
    pub fn space(&self, constraint: Constraint) -> Space<'_> {
        Space {
            scene: &self.scene,
            theta: Theta::constant(&self.values),
            constraint,
            steps: Steps::default(),
        }
    }

    /// Who is connected.
    ///
    /// # Errors
    /// Nothing to connect.
    pub fn split(&self, connections: &Connections) -> Result<Split> {
        Ok(Split::of(&self.scene, connections).ok_or("nothing to connect")?)
    }

    /// A point of the floor, which lies at height zero. `None` where something stands on it that low.
    pub fn floor(&self, x: f64, z: f64) -> Option<Start> {
        let ray = Ray::new(Vec3::new(x, 0.01, z), Vec3::new(0.0, -1.0, 0.0));
        let found = self.scene.intersect(&ray)?;
        Some(Start {
            si: found.si,
            exit: self.scene.exit(found.prim),
        })
    }
}
