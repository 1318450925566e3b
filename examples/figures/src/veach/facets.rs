//! Facets whose shading normals point up, under a point light [Veach 1996, figure 1].

use render::Settings;
use render::camera::{Camera, FovAxis};
use render::emitter::Point;
use render::math::Transform;
use render::shape::MeshData;

use examples::figure::Result;
use examples::scene_builder::{POSITIVE, SceneBuilder};

/// Two quads that share the z axis as their upper edge, each tilted downwards by `degrees`. All their shading normals
/// point up.
pub(super) fn roof(degrees: f64, half: f64) -> MeshData {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let side = |s: f64, z: f64| [s * half * cos, -half * sin, z * half].map(|x| x as f32);
    let ridge = |z: f64| [0.0, 0.0, z * half].map(|x| x as f32);
    MeshData {
        positions: vec![
            side(-1.0, -1.0),
            side(-1.0, 1.0),
            ridge(-1.0),
            ridge(1.0),
            side(1.0, -1.0),
            side(1.0, 1.0),
        ],
        normals: vec![[0.0, 1.0, 0.0]; 6],
        uvs: Vec::new(),
        triangles: vec![[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4]],
    }
}

pub(super) fn camera(eye: [f64; 3], up: [f64; 3], fov: f64, size: u32) -> Result<Camera> {
    let view = Transform::look_at(eye, [0.0; 3], up).ok_or("a camera that looks nowhere")?;
    Ok(Camera::new(view, fov, FovAxis::X, [size; 2])?)
}

pub(super) fn lamp(builder: &mut SceneBuilder, position: [f64; 3], intensity: f64) -> Result<()> {
    let intensity = builder
        .build
        .rgb("lamp.intensity.value", [intensity; 3], POSITIVE)?;
    let position = position.map(|x| x as f32);
    builder
        .build
        .add_emitter(Point::new(intensity, position), None);
    Ok(())
}

pub(super) const SETTINGS: Settings = Settings {
    max_depth: 2,
    rr_depth: u32::MAX,
    spp: 1,
    points: render::sampler::Points::Independent,
    lights: render::scene::LightChoice::One,
    caustics: render::scene::Caustics::Paths,
    connections: None,
    hide_emitters: false,
    glints: None,
    pixels_per_particle: 1,
};
