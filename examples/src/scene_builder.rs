//! [`SceneBuilder`]: scenes from code, of the few materials, shapes and lights that figures and `stability` need.

use std::f64::consts::TAU;
use std::sync::Arc;

use render::Job;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{Conductor, Diffuse, Material, RoughConductor, Roughness, TwoSided};
use render::camera::{Camera, FovAxis};
use render::emitter::{Area, Constant, Envmap, Vmf};
use render::instances::{Estimator, render_f32};
use render::integrator::render::Rendering;
use render::math::Transform;
use render::params::Theta;
use render::scene::Builder;
use render::shape::{AnyShape, Cube, Mesh, MeshData, Patch, Rectangle, Sphere, smooth_normals};
use render::texture::RgbTexture;
use render::{Film, Image, Scene, Settings};

use crate::figure::Result;

/// Range of reflectances.
pub const UNIT: (f64, f64) = (0.0, 1.0);
/// Range of radiances.
pub const POSITIVE: (f64, f64) = (0.0, f64::INFINITY);

/// A camera at `eye` that looks at `target`, y up.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Where it stands.
    pub eye: [f64; 3],
    /// What is in the middle of the picture.
    pub target: [f64; 3],
    /// Angle of view along the smaller side, degrees.
    pub fov: f64,
    /// Pixels.
    pub size: [u32; 2],
}

/// A scene under construction: a [`Builder`] with methods for materials, shapes and lights that figures have in common.
#[derive(Debug, Default)]
pub struct SceneBuilder {
    /// The scene so far.
    pub build: Builder,
}

impl SceneBuilder {
    /// A reflectance parameter `{name}.{key}.value`.
    ///
    /// # Errors
    /// A value outside [0, 1].
    pub fn colour(&mut self, name: &str, key: &str, rgb: [f64; 3]) -> Result<RgbTexture> {
        Ok(self.build.rgb(&format!("{name}.{key}.value"), rgb, UNIT)?)
    }

    /// A diffuse material, black from behind.
    ///
    /// # Errors
    /// A value outside [0, 1].
    pub fn matt(&mut self, name: &str, rgb: [f64; 3]) -> Result<Arc<Material>> {
        let reflectance = self.colour(name, "reflectance", rgb)?;
        Ok(Arc::new(Diffuse { reflectance }.into()))
    }

    /// GGX metal of constant reflectance, on both sides.
    ///
    /// # Errors
    /// A value out of range.
    pub fn metal(&mut self, name: &str, rgb: [f64; 3], alpha: f64) -> Result<Arc<Material>> {
        let side = self.front_metal(name, rgb, alpha)?;
        let both = TwoSided::new([side.clone(), side])?;
        Ok(Arc::new(both.into()))
    }

    /// GGX metal of constant reflectance, black from behind.
    ///
    /// # Errors
    /// A value out of range.
    pub fn front_metal(&mut self, name: &str, rgb: [f64; 3], alpha: f64) -> Result<Arc<Material>> {
        let roughness = self.ggx(name, alpha)?;
        self.metal_of(name, rgb, roughness)
    }

    /// Metal of constant reflectance with this roughness, on both sides.
    ///
    /// # Errors
    /// A value out of range.
    pub fn metal_of(
        &mut self,
        name: &str,
        rgb: [f64; 3],
        roughness: Roughness,
    ) -> Result<Arc<Material>> {
        let specular_reflectance = self.colour(name, "specular_reflectance", rgb)?;
        let conductor = Conductor {
            specular_reflectance,
            index: None,
        };
        let metal = RoughConductor {
            roughness,
            conductor,
        };
        Ok(Arc::new(Material::from(metal)))
    }

    /// A GGX roughness parameter `{name}.alpha.value`.
    ///
    /// # Errors
    /// A value outside [1e-4, 1].
    pub fn ggx(&mut self, name: &str, alpha: f64) -> Result<Roughness> {
        let name = format!("{name}.alpha.value");
        Ok(Roughness {
            kind: Ndf::Ggx,
            alpha: self.build.scalar(&name, alpha, (1e-4, 1.0))?,
            visible: true,
        })
    }

    /// A square image of roughness `{name}.alpha.data`; all normals are sampled, as in the thesis.
    ///
    /// # Errors
    /// A value outside [1e-4, 1].
    pub fn rough_texels(&mut self, name: &str, kind: Ndf, texels: &[f32]) -> Result<Roughness> {
        let side = texels.len().isqrt() as u32;
        let name = format!("{name}.alpha");
        Ok(Roughness {
            kind,
            alpha: self.build.texels(&name, [side; 2], texels, (1e-4, 1.0))?,
            visible: false,
        })
    }

    /// Any shape.
    pub fn shape(
        &mut self,
        name: &str,
        shape: impl Into<AnyShape>,
        material: &Arc<Material>,
    ) -> u32 {
        let material = self.build.add_shared_material(material.clone());
        self.build.add_shape(name, shape, material)
    }

    /// A parallelogram; its front is towards `e1 x e2`.
    ///
    /// # Errors
    /// No area.
    pub fn quad(
        &mut self,
        name: &str,
        [corner, e1, e2]: [[f64; 3]; 3],
        material: &Arc<Material>,
    ) -> Result<u32> {
        let patch = Patch::new(corner, e1, e2, false).ok_or("a quad without area")?;
        Ok(self.shape(name, Rectangle(patch), material))
    }

    /// A sphere.
    ///
    /// # Errors
    /// No radius.
    pub fn ball(
        &mut self,
        name: &str,
        center: [f64; 3],
        radius: f64,
        material: &Arc<Material>,
    ) -> Result<u32> {
        let ball = Sphere::new(center, radius, false).ok_or("a ball without radius")?;
        Ok(self.shape(name, ball, material))
    }

    /// A box of these half sizes, turned about the y axis.
    ///
    /// # Errors
    /// No volume.
    pub fn block(
        &mut self,
        name: &str,
        center: [f64; 3],
        half: [f64; 3],
        degrees: f64,
        material: &Arc<Material>,
    ) -> Result<u32> {
        let turn = Transform::rotate([0.0, 1.0, 0.0], degrees).ok_or("no axis")?;
        let place = Transform::scale(half)
            .then(&turn)
            .then(&Transform::translate(center));
        let cube = Cube::new(&place, false).ok_or("a block without volume")?;
        Ok(self.shape(name, cube, material))
    }

    /// A surface of revolution, see [`lathe`].
    ///
    /// # Errors
    /// A profile without area.
    pub fn turned(
        &mut self,
        name: &str,
        profile: &[[f64; 2]],
        at: [f64; 3],
        material: &Arc<Material>,
    ) -> Result<u32> {
        let mesh = Mesh::new(lathe(profile, 48, at), false)?;
        Ok(self.shape(name, mesh, material))
    }

    /// Makes the last shape, `shape`, a lamp of the radiance `{name}.emitter.radiance.value`.
    ///
    /// # Errors
    /// A negative radiance.
    pub fn lamp(&mut self, name: &str, shape: u32, radiance: [f64; 3]) -> Result<()> {
        let name = format!("{name}.emitter.radiance.value");
        let radiance = self.build.rgb(&name, radiance, POSITIVE)?;
        let light = Area {
            radiance,
            exponent: 0.0,
            shape,
        };
        self.build.add_emitter(light, Some(shape));
        Ok(())
    }

    /// The same light from everywhere.
    ///
    /// # Errors
    /// A negative radiance.
    pub fn ambient(&mut self, radiance: [f64; 3]) -> Result<()> {
        let radiance = self
            .build
            .rgb("ambient.radiance.value", radiance, POSITIVE)?;
        self.build.add_emitter(Constant { radiance }, None);
        Ok(())
    }

    /// Light from around a direction, as a von Mises-Fisher lobe of the given concentration with the parameter
    /// `{name}.radiance.value`.
    ///
    /// # Errors
    /// A negative radiance, no direction, or a concentration outside [1e-3, 1e7].
    pub fn lobe(
        &mut self,
        name: &str,
        radiance: [f64; 3],
        direction: [f64; 3],
        concentration: f64,
    ) -> Result<()> {
        let name = format!("{name}.radiance.value");
        let radiance = self.build.rgb(&name, radiance, POSITIVE)?;
        let lobe = Vmf::new(radiance, direction, concentration).ok_or("a lobe without axis")?;
        self.build.add_emitter(lobe, None);
        Ok(())
    }

    /// The light of [`hall`], times `scale`.
    ///
    /// # Errors
    /// None that [`hall`] can cause.
    pub fn hall(&mut self, scale: f64) -> Result<()> {
        let axes = Transform::scale([1.0; 3]);
        let light = Envmap::new(self.build.registry(), "hall", &hall(256, 128), &axes, scale)?;
        self.build.add_emitter(light, None);
        Ok(())
    }

    /// The scene, seen by `view`. Roulette is off: a path has `max_depth` edges at most.
    ///
    /// # Errors
    /// A camera that looks nowhere.
    pub fn finish(self, view: &View, max_depth: u32) -> Result<Scene> {
        let to_world = Transform::look_at(view.eye, view.target, [0.0, 1.0, 0.0]);
        let to_world = to_world.ok_or("a camera that looks nowhere")?;
        let camera = Camera::new(to_world, view.fov, FovAxis::Smaller, view.size)?;
        let [width, height] = view.size;
        let settings = Settings {
            max_depth,
            rr_depth: u32::MAX,
            spp: 1,
            ..Settings::default()
        };
        Ok(self
            .build
            .build(camera, Film::new(width, height), settings)?)
    }
}

/// The image of a scene, by detached MIS.
pub fn picture(scene: &Scene, seed: u64, spp: u64) -> Rendering {
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    render_f32(&job, &theta, Estimator::Mis)
}

/// Light of a hall, as an environment map: dim walls, a floor and ceiling, and eight bright rectangles
/// of different colours.
pub fn hall(width: usize, height: usize) -> Image {
    // Centre (u, v), half size (u, v), radiance.
    const LIGHTS: [([f64; 4], [f32; 3]); 8] = [
        ([0.06, 0.33, 0.03, 0.07], [14.0, 12.0, 9.0]),
        ([0.19, 0.36, 0.02, 0.1], [5.0, 7.0, 10.0]),
        ([0.31, 0.3, 0.035, 0.04], [12.0, 6.0, 3.0]),
        ([0.44, 0.38, 0.02, 0.09], [4.0, 8.0, 5.0]),
        ([0.56, 0.34, 0.03, 0.06], [11.0, 11.0, 11.0]),
        ([0.69, 0.32, 0.025, 0.05], [10.0, 4.0, 4.0]),
        ([0.81, 0.37, 0.02, 0.1], [6.0, 6.0, 12.0]),
        ([0.93, 0.3, 0.03, 0.04], [12.0, 9.0, 4.0]),
    ];
    let mut image = Image::new(width, height);
    for (i, texel) in image.data.chunks_exact_mut(3).enumerate() {
        let u = ((i % width) as f64 + 0.5) / width as f64;
        let v = ((i / width) as f64 + 0.5) / height as f64;
        let dim = if v < 0.2 {
            [0.3, 0.29, 0.27]
        } else if v < 0.6 {
            [0.16, 0.15, 0.14]
        } else {
            [0.09, 0.07, 0.05]
        };
        let inside = |r: &[f64; 4]| (u - r[0]).abs() <= r[2] && (v - r[1]).abs() <= r[3];
        let light = LIGHTS.iter().find(|(r, _)| inside(r));
        texel.copy_from_slice(&light.map_or(dim, |(_, radiance)| *radiance));
    }
    image
}

/// The surface that the polyline `profile` of (radius, height) sweeps out about the y axis, moved by `at`:
/// `around` segments, smooth where the profile bends by less than 50 degrees. Going up, the outside
/// is in front.
pub fn lathe(profile: &[[f64; 2]], around: u32, at: [f64; 3]) -> MeshData {
    let mut mesh = MeshData::default();
    let mut previous: Option<[f64; 2]> = None;
    let bend = |a: [f64; 2], b: [f64; 2]| {
        let cos = (a[0] * b[0] + a[1] * b[1]) / (a[0].hypot(a[1]) * b[0].hypot(b[1]));
        cos < 50f64.to_radians().cos()
    };
    let ring = |mesh: &mut MeshData, [r, h]: [f64; 2]| {
        for k in 0..around {
            let (sin, cos) = (TAU * f64::from(k) / f64::from(around)).sin_cos();
            let p = [at[0] + r * cos, at[1] + h, at[2] + r * sin];
            mesh.positions.push(p.map(|x| x as f32));
        }
    };
    for pair in profile.windows(2) {
        let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
        // A sharp edge gets vertices, and so normals, of its own on either side.
        if previous.is_none_or(|p| bend(p, along)) {
            ring(&mut mesh, pair[0]);
        }
        ring(&mut mesh, pair[1]);
        previous = Some(along);
        let end = mesh.positions.len() as u32;
        let (low, high) = (end - 2 * around, end - around);
        for k in 0..around {
            let next = (k + 1) % around;
            mesh.triangles.push([low + k, high + k, high + next]);
            mesh.triangles.push([low + k, high + next, low + next]);
        }
    }
    mesh.normals = smooth_normals(&mesh.positions, &mesh.triangles);
    mesh
}

/// Where a point appears, in pixels from the top left corner.
pub fn pixel(view: &View, p: [f64; 3]) -> [f64; 2] {
    let forward = unit(sub(view.target, view.eye));
    let right = unit(cross(forward, [0.0, 1.0, 0.0]));
    let up = cross(right, forward);
    let to = sub(p, view.eye);
    let [width, height] = view.size.map(f64::from);
    let per = 0.5 * width.min(height) / (0.5 * view.fov).to_radians().tan() / dot(to, forward);
    [
        0.5 * width + per * dot(to, right),
        0.5 * height - per * dot(to, up),
    ]
}

/// a - b
pub fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    add(a, b, -1.0)
}

/// a + s b
pub fn add(a: [f64; 3], b: [f64; 3], s: f64) -> [f64; 3] {
    [0, 1, 2].map(|i: usize| a[i] + s * b[i])
}

/// Inner product.
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product.
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i: usize| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        a[j] * b[k] - a[k] * b[j]
    })
}

/// The vector of length 1 along `a`.
pub fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|x| x / dot(a, a).sqrt())
}
