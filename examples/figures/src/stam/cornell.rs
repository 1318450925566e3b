//! The scene of [Stam 2020, section 6]: a closed box of six diffuse quads (M3), one quad light at the ceiling
//! (M1), a Blinn-Phong sphere in the centre (M2), and a pinhole camera inside the box.

use render::bsdf::{BlinnPhong, BlinnPhongSampling, Diffuse};
use render::camera::{Camera, FovAxis};
use render::emitter::Area;
use render::math::Transform;
use render::scene::Builder;
use render::shape::{Patch, Rectangle, Sphere};
use render::{Film, Scene, Settings};

use examples::figure::Result;

/// Number of controls, theta_1 to theta_7.
pub const CONTROLS: usize = 7;
/// Names of the controls in the paper, in its order.
pub const LABELS: [&str; CONTROLS] = [
    "emission",
    "sphere ambient",
    "sphere diffuse",
    "sphere specular",
    "sphere exponent",
    "wall ambient",
    "wall diffuse",
];
/// Names of the controls as parameters of the scene. No equation of the paper uses the ambient terms: the image does
/// not depend on these parameters.
pub const NAMES: [&str; CONTROLS] = [
    "light.radiance.value",
    "sphere.ambient.value",
    "sphere.diffuse_reflectance.value",
    "sphere.specular_reflectance.value",
    "sphere.exponent.value",
    "walls.ambient.value",
    "walls.reflectance.value",
];

/// Half the side of the light.
pub const LIGHT_HALF: f64 = 0.25;
/// Height of the light.
pub const LIGHT_Y: f64 = 0.98;
/// Radius of the sphere.
pub const RADIUS: f64 = 0.45;
/// Where the camera stands; it looks along -z.
pub const EYE: [f64; 3] = [0.0, 0.0, 0.98];
/// Full angle of view, degrees.
pub const FOV: f64 = 80.0;

/// Index of the sphere among the scene's shapes.
pub const SPHERE: u32 = 6;

/// Values of the controls and how the sphere is sampled.
#[derive(Clone, Copy, Debug)]
pub struct Cornell {
    /// theta_1 to theta_7.
    pub theta: [f64; CONTROLS],
    /// How directions are drawn at the sphere.
    pub sampling: BlinnPhongSampling,
    /// Width and height, pixels.
    pub size: u32,
    /// Largest number of path edges.
    pub max_depth: u32,
}

/// The faces of the cube from -1 to 1 in each coordinate, as seen from within.
///
/// # Errors
/// None: no face is without area.
pub fn faces() -> Result<Vec<Rectangle>> {
    let face = |i: usize| {
        let (axis, side) = (i / 2, [-1.0, 1.0][i % 2]);
        let along = |i: usize| std::array::from_fn(|k| if k == i { 2.0 } else { 0.0 });
        let corner = std::array::from_fn(|k| if k == axis { side } else { -1.0 });
        let sides = [along((axis + 1) % 3), along((axis + 2) % 3)];
        let patch = Patch::new(corner, sides[0], sides[1], side > 0.0);
        Ok(Rectangle(patch.ok_or("a wall without area")?))
    };
    (0..6).map(face).collect()
}

impl Cornell {
    /// The scene. Roulette is off: a path ends at the light or at `max_depth`.
    ///
    /// # Errors
    /// A control outside its range.
    pub fn build(&self) -> Result<Scene> {
        let any = (0.0, f64::INFINITY);
        let unit = (0.0, 1.0);
        let mut b = Builder::new();
        let mut rgb = |k: usize, valid| b.rgb(NAMES[k], [self.theta[k]; 3], valid);
        let radiance = rgb(0, any)?;
        let _sphere_ambient = rgb(1, any)?;
        let diffuse = rgb(2, unit)?;
        let specular = rgb(3, unit)?;
        let exponent = b.scalar(NAMES[4], self.theta[4], (0.0, 1e6))?;
        let _wall_ambient = b.rgb(NAMES[5], [self.theta[5]; 3], any)?;
        let reflectance = b.rgb(NAMES[6], [self.theta[6]; 3], unit)?;
        let black = b.rgb("light.reflectance.value", [0.0; 3], unit)?;

        let walls = b.add_material(Diffuse { reflectance });
        for wall in faces()? {
            b.add_shape("wall", wall, walls);
        }
        let sphere = b.add_material(BlinnPhong {
            diffuse,
            specular,
            exponent,
            sampling: self.sampling,
        });
        let ball = Sphere::new([0.0; 3], RADIUS, false).ok_or("a sphere without radius")?;
        b.add_shape("sphere", ball, sphere);
        let dark = b.add_material(Diffuse { reflectance: black });
        let (h, side) = (LIGHT_HALF, 2.0 * LIGHT_HALF);
        let patch = Patch::new([-h, LIGHT_Y, -h], [side, 0.0, 0.0], [0.0, 0.0, side], false);
        let patch = patch.ok_or("a light without area")?;
        let shape = b.add_shape("light", Rectangle(patch), dark);
        let light = Area {
            radiance,
            exponent: 0.0,
            shape,
        };
        b.add_emitter(light, Some(shape));

        let to_world = Transform::look_at(EYE, [0.0; 3], [0.0, 1.0, 0.0]);
        let to_world = to_world.ok_or("no camera")?;
        let camera = Camera::new(to_world, FOV, FovAxis::X, [self.size; 2])?;
        let settings = Settings {
            max_depth: self.max_depth,
            rr_depth: u32::MAX,
            spp: 1,
            ..Settings::default()
        };
        Ok(b.build(camera, Film::new(self.size, self.size), settings)?)
    }
}

/// The values of all parameters of a scene in f64, with one control moved by `step`.
pub fn perturbed(scene: &Scene, control: usize, step: f64) -> Result<Vec<f64>> {
    let mut values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    for i in scene.params().find(NAMES[control])?.range() {
        values[i] += step;
    }
    Ok(values)
}

/// Distance of a point from the nearest surface of the scene.
pub fn distance_to_geometry(p: [f64; 3]) -> f64 {
    let [x, y, z] = p;
    let wall = p
        .iter()
        .fold(f64::INFINITY, |m, c| m.min((c.abs() - 1.0).abs()));
    let sphere = (x.hypot(y).hypot(z) - RADIUS).abs();
    wall.min(sphere).min(distance_to_light(p))
}

/// Distance of a point from the light.
pub fn distance_to_light([x, y, z]: [f64; 3]) -> f64 {
    let out = |c: f64| (c.abs() - LIGHT_HALF).max(0.0);
    out(x).hypot(out(z)).hypot(y - LIGHT_Y)
}
