//! Rooms, boards and balls for the figures: scenes that come from code, in place of assets that are not
//! public.

use std::f64::consts::TAU;
use std::sync::Arc;

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

/// A scene under construction: [`Builder`] with the few things that all figures are made of.
#[derive(Debug, Default)]
pub struct Stage {
    /// What is there so far.
    pub build: Builder,
}

impl Stage {
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
    let (technique, settings) = (Estimator::Mis, &scene.settings);
    render_f32(scene, &theta, technique, settings, seed, 0..spp, &())
}

/// What the walls of [`cornell`] are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Walls {
    /// Diffuse.
    Matt,
    /// As [`Walls::Matt`], but the back wall is metal of roughness 0.15.
    GlossyBack,
}

/// Reflectances of floor, ceiling, back wall and blocks; of the left; of the right wall.
pub const CORNELL: [[f64; 3]; 3] = [[0.73; 3], [0.63, 0.065, 0.05], [0.14, 0.45, 0.09]];

/// Half the side of the lamp of [`cornell`], and its height.
pub const CORNELL_LAMP: [f64; 2] = [0.25, 0.98];

/// The room [-1, 1]^3, open to the front, with a lamp below the ceiling and two blocks. The walls are
/// `white`, `left` and `right`, the lamp `light`.
///
/// # Errors
/// None for a size above zero.
pub fn cornell(size: u32, walls: Walls, max_depth: u32) -> Result<Scene> {
    let mut stage = Stage::default();
    let white = stage.matt("white", CORNELL[0])?;
    let left = stage.matt("left", CORNELL[1])?;
    let right = stage.matt("right", CORNELL[2])?;
    let black = stage.matt("black", [0.0; 3])?;
    let back = match walls {
        Walls::Matt => white.clone(),
        Walls::GlossyBack => stage.metal("back", [0.8; 3], 0.15)?,
    };
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    stage.quad("floor", [[-1.0, -1.0, 1.0], x, minus(z)], &white)?;
    stage.quad("ceiling", [[-1.0, 1.0, -1.0], x, z], &white)?;
    stage.quad("back", [[-1.0, -1.0, -1.0], x, y], &back)?;
    stage.quad("left", [[-1.0, -1.0, 1.0], minus(z), y], &left)?;
    stage.quad("right", [[1.0, -1.0, -1.0], z, y], &right)?;
    stage.block("tall", [-0.35, -0.4, -0.3], [0.28, 0.6, 0.28], 18.0, &white)?;
    stage.block("short", [0.38, -0.7, 0.3], [0.28, 0.3, 0.28], -17.0, &white)?;
    let [half, height] = CORNELL_LAMP;
    let side = 2.0 * half;
    let at = [-half, height, -half];
    let light = stage.quad("light", [at, [side, 0.0, 0.0], [0.0, 0.0, side]], &black)?;
    stage.lamp("light", light, [17.0, 12.0, 7.0])?;
    let view = View {
        eye: [0.0, 0.0, 3.9],
        target: [0.0; 3],
        fov: 38.0,
        size: [size; 2],
    };
    stage.finish(&view, max_depth)
}

/// Radii of the lamps of [`Plates`], left to right.
pub const LAMP_RADII: [f64; 4] = [0.03, 0.1, 0.3, 0.9];
/// Roughness of the plates of [`Plates`], top to bottom.
pub const PLATE_ALPHAS: [f64; 4] = [0.005, 0.02, 0.05, 0.1];

/// Four glossy plates below four spherical lamps of equal power [Veach 1997, figure 9.2].
#[derive(Debug)]
pub struct Plates {
    /// The scene. Plates are `plate 0` to `plate 3`, lamps `lamp 0` to `lamp 3`, and a fill light.
    pub scene: Scene,
    /// Pixel at which plate i mirrors the centre of lamp j.
    pub cells: [[[f64; 2]; 4]; 4],
}

/// Positions of the lamps.
const LAMPS: [[f64; 3]; 4] = [
    [-3.75, 4.0, 0.0],
    [-1.25, 4.0, 0.0],
    [1.25, 4.0, 0.0],
    [3.75, 4.0, 0.0],
];
/// Centres of the plates.
const PLATES: [[f64; 3]; 4] = [
    [0.0, 0.1, -2.2],
    [0.0, -1.6, -0.9],
    [0.0, -3.0, 0.9],
    [0.0, -4.1, 3.0],
];

/// The scene of the plates, `width` x 3/4 `width` pixels. Every plate is tilted so that its centre mirrors
/// the middle of the row of lamps.
///
/// # Errors
/// None for a size above zero.
pub fn plates(width: u32) -> Result<Plates> {
    plates_of(width, PLATE_ALPHAS, Ndf::Ggx, true)
}

/// The same with other roughnesses, another distribution of normals, or all of them sampled.
///
/// # Errors
/// A roughness out of range.
pub fn plates_of(width: u32, alphas: [f64; 4], kind: Ndf, visible: bool) -> Result<Plates> {
    plates_with(width, |stage, name, i| {
        let roughness = stage.ggx(name, alphas[i])?;
        Ok(Roughness {
            kind,
            visible,
            ..roughness
        })
    })
}

/// The same with images of roughness around these means, all normals of a Beckmann distribution sampled.
///
/// # Errors
/// A roughness out of range.
pub fn textured_plates(width: u32, alphas: [f64; 4]) -> Result<Plates> {
    const SIDE: usize = 32;
    plates_with(width, |stage, name, i| {
        let wave = |k: usize, n: usize| (TAU * (n * k) as f64 / SIDE as f64).sin();
        let texel = |k: usize| alphas[i] * (1.0 + 0.4 * wave(k % SIDE, 6) * wave(k / SIDE, 1));
        let texels: Vec<f32> = (0..SIDE * SIDE).map(|k| texel(k) as f32).collect();
        stage.rough_texels(name, Ndf::Beckmann, &texels)
    })
}

fn plates_with(
    width: u32,
    finish: impl Fn(&mut Stage, &str, usize) -> Result<Roughness>,
) -> Result<Plates> {
    let view = View {
        eye: [0.0, 1.0, 16.0],
        target: [0.0, -0.4, 0.0],
        fov: 36.0,
        size: [width, width * 3 / 4],
    };
    let mut stage = Stage::default();
    let ground = stage.matt("ground", [0.25; 3])?;
    let black = stage.matt("black", [0.0; 3])?;
    let (x, z) = ([40.0, 0.0, 0.0], [0.0, 0.0, -40.0]);
    stage.quad("floor", [[-20.0, -5.2, 20.0], x, z], &ground)?;
    stage.quad("wall", [[-20.0, -5.2, -6.0], x, [0.0, 30.0, 0.0]], &ground)?;
    let mut cells = [[[0.0; 2]; 4]; 4];
    for (i, center) in PLATES.into_iter().enumerate() {
        let middle = [0.0, LAMPS[0][1], LAMPS[0][2]];
        let n = unit(add(
            unit(sub(middle, center)),
            unit(sub(view.eye, center)),
            1.0,
        ));
        // Along the plate, away from the lamps; the other side is x.
        let down = [0.0, -n[2], n[1]];
        let corner = add(add(center, [-1.0, 0.0, 0.0], 4.4), down, 0.6);
        let across = [8.8, 0.0, 0.0];
        let up = down.map(|c| -1.2 * c);
        let name = format!("plate {i}");
        let roughness = finish(&mut stage, &name, i)?;
        let metal = stage.metal_of(&name, [0.9; 3], roughness)?;
        stage.quad(&format!("plate {i}"), [corner, across, up], &metal)?;
        for (cell, lamp) in cells[i].iter_mut().zip(LAMPS) {
            let height = dot(sub(lamp, center), n);
            let image = add(lamp, n, -2.0 * height);
            let to = sub(image, view.eye);
            let t = dot(sub(center, view.eye), n) / dot(to, n);
            *cell = pixel(&view, add(view.eye, to, t));
        }
    }
    let tint = [
        [1.0, 0.75, 0.5],
        [1.0, 1.0, 0.6],
        [0.6, 1.0, 0.7],
        [0.6, 0.75, 1.0],
    ];
    for (j, (center, radius)) in LAMPS.into_iter().zip(LAMP_RADII).enumerate() {
        let ball = stage.ball(&format!("lamp {j}"), center, radius, &black)?;
        let power = tint[j].map(|c| 0.8 * c / (radius * radius));
        stage.lamp(&format!("lamp {j}"), ball, power)?;
    }
    // Behind the camera, for the floor.
    let fill = stage.ball("fill", [0.0, 12.0, 22.0], 2.0, &black)?;
    stage.lamp("fill", fill, [1.5; 3])?;
    Ok(Plates {
        scene: stage.finish(&view, 2)?,
        cells,
    })
}

/// Profile of a pawn, (radius, height), from the bottom up.
pub const PAWN: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [0.32, 0.0],
    [0.32, 0.1],
    [0.24, 0.18],
    [0.14, 0.3],
    [0.1, 0.55],
    [0.2, 0.6],
    [0.1, 0.64],
    [0.17, 0.74],
    [0.17, 0.84],
    [0.1, 0.93],
    [0.0, 0.96],
];
/// Profile of a bishop.
pub const BISHOP: [[f64; 2]; 15] = [
    [0.0, 0.0],
    [0.38, 0.0],
    [0.38, 0.12],
    [0.28, 0.22],
    [0.16, 0.4],
    [0.11, 0.85],
    [0.25, 0.92],
    [0.13, 0.97],
    [0.2, 1.12],
    [0.21, 1.24],
    [0.13, 1.42],
    [0.05, 1.5],
    [0.08, 1.55],
    [0.05, 1.61],
    [0.0, 1.63],
];
/// Profile of a rook.
pub const ROOK: [[f64; 2]; 12] = [
    [0.0, 0.0],
    [0.38, 0.0],
    [0.38, 0.14],
    [0.28, 0.24],
    [0.2, 0.4],
    [0.17, 0.85],
    [0.28, 0.92],
    [0.28, 1.16],
    [0.18, 1.16],
    [0.18, 1.04],
    [0.06, 1.04],
    [0.0, 1.04],
];

/// A board with a bishop, a rook and pawns on a floor, under one lamp and dim ambient light. The
/// materials are `floor`, `table`, `bishop`, `rook` and `pawn`.
///
/// # Errors
/// None for a size above zero.
pub fn chess(size: [u32; 2], max_depth: u32) -> Result<Scene> {
    let mut stage = Stage::default();
    let floor = stage.matt("floor", [0.35, 0.32, 0.3])?;
    let table = stage.metal("table", [0.7, 0.62, 0.5], 0.25)?;
    let bishop = stage.matt("bishop", [0.6, 0.25, 0.15])?;
    let rook = stage.matt("rook", [0.75, 0.72, 0.65])?;
    let pawn = stage.matt("pawn", [0.25, 0.3, 0.4])?;
    let black = stage.matt("black", [0.0; 3])?;
    let flat = |half: f64, y: f64| {
        let side = 2.0 * half;
        [[-half, y, half], [side, 0.0, 0.0], [0.0, 0.0, -side]]
    };
    stage.quad("floor", flat(12.0, -0.6), &floor)?;
    stage.quad("table", flat(2.0, 0.0), &table)?;
    stage.turned("bishop", &BISHOP, [-0.25, 0.0, 0.35], &bishop)?;
    stage.turned("rook", &ROOK, [0.85, 0.0, -0.3], &rook)?;
    for at in [[-1.1, 0.0, -0.4], [0.2, 0.0, -0.9], [0.75, 0.0, 0.75]] {
        stage.turned("pawn", &PAWN, at, &pawn)?;
    }
    let sides = [[1.6, 0.0, 0.0], [0.0, 0.0, 1.6]];
    let light = stage.quad("light", [[-2.6, 4.0, -0.4], sides[0], sides[1]], &black)?;
    stage.lamp("light", light, [14.0, 13.0, 11.0])?;
    stage.ambient([0.15, 0.17, 0.2])?;
    let view = View {
        eye: [0.6, 2.4, 5.2],
        target: [0.05, 0.55, 0.0],
        fov: 30.0,
        size,
    };
    stage.finish(&view, max_depth)
}

/// The things on the table of [`tray`], and their roughness.
pub const TRAY: [(&str, f64); 6] = [
    ("table", 0.3),
    ("tray", 0.02),
    ("pitcher", 0.04),
    ("jug", 0.1),
    ("cup", 0.2),
    ("frame", 0.03),
];

/// Middle, half side and radiance of the lamps above [`tray`].
pub const TRAY_LAMPS: [([f64; 3], f64, [f64; 3]); 2] = [
    ([-1.6, 2.3, 1.2], 0.25, [24.0, 21.0, 16.0]),
    ([1.5, 2.1, -0.6], 0.15, [40.0, 44.0, 52.0]),
];

/// Profile of the tray.
const DISH: [[f64; 2]; 6] = [
    [0.0, 0.0],
    [0.95, 0.0],
    [1.1, 0.09],
    [1.06, 0.1],
    [0.93, 0.03],
    [0.0, 0.03],
];
/// Profile of pitcher and jug.
const PITCHER: [[f64; 2]; 9] = [
    [0.0, 0.0],
    [0.22, 0.0],
    [0.31, 0.16],
    [0.29, 0.38],
    [0.17, 0.58],
    [0.21, 0.74],
    [0.18, 0.74],
    [0.14, 0.58],
    [0.0, 0.5],
];
/// Profile of the cup.
const CUP: [[f64; 2]; 6] = [
    [0.0, 0.0],
    [0.12, 0.0],
    [0.2, 0.26],
    [0.18, 0.26],
    [0.11, 0.03],
    [0.0, 0.03],
];

/// A table with things of metal that reflect each other, [`TRAY`], below two small lamps in a dim hall.
/// The smooth ones are Beckmann, the others GGX. All normals are sampled, as in the thesis.
///
/// # Errors
/// None for a size above zero.
pub fn tray(size: [u32; 2], max_depth: u32) -> Result<Scene> {
    let mut stage = Stage::default();
    let colours = [
        [0.55, 0.42, 0.32],
        [0.92, 0.92, 0.9],
        [0.95, 0.78, 0.45],
        [0.9, 0.6, 0.5],
        [0.85, 0.88, 0.9],
        [0.9, 0.9, 0.92],
    ];
    let mut metals = Vec::new();
    for ((name, alpha), colour) in TRAY.into_iter().zip(colours) {
        let mut roughness = stage.ggx(name, alpha)?;
        roughness.visible = false;
        if alpha < 0.05 {
            roughness.kind = Ndf::Beckmann;
        }
        metals.push(stage.metal_of(name, colour, roughness)?);
    }
    let [table, dish, pitcher, jug, cup, frame] = &metals[..] else {
        return Err("one metal for each thing".into());
    };
    let black = stage.matt("black", [0.0; 3])?;
    let half = 2.5;
    let (x, z) = ([2.0 * half, 0.0, 0.0], [0.0, 0.0, -2.0 * half]);
    stage.quad("table", [[-half, 0.0, half], x, z], table)?;
    // A hair apart: surfaces that meet in a line have an edge that no shape knows of.
    stage.turned("tray", &DISH, [0.1, 0.002, 0.3], dish)?;
    stage.turned("pitcher", &PITCHER, [-0.3, 0.034, 0.15], pitcher)?;
    stage.turned("cup", &CUP, [0.45, 0.034, 0.65], cup)?;
    stage.turned("jug", &PITCHER, [1.35, 0.002, -0.5], jug)?;
    let (across, up) = ([1.3, 0.0, 0.3], [0.0, 1.0, -0.3]);
    stage.quad("frame", [[-1.5, 0.002, -0.9], across, up], frame)?;
    for (k, (at, half, radiance)) in TRAY_LAMPS.into_iter().enumerate() {
        let n = unit(sub([0.0, 0.3, 0.0], at));
        let s = unit(cross([0.0, 1.0, 0.0], n));
        let sides = [s, cross(n, s)].map(|v| v.map(|c| 2.0 * half * c));
        let corner = add(add(at, sides[0], -0.5), sides[1], -0.5);
        let name = format!("lamp {k}");
        let lamp = stage.quad(&name, [corner, sides[0], sides[1]], &black)?;
        stage.lamp(&name, lamp, radiance)?;
    }
    stage.hall(0.1)?;
    let view = View {
        eye: [0.1, 1.9, 3.6],
        target: [0.1, 0.28, 0.0],
        fov: 30.0,
        size,
    };
    stage.finish(&view, max_depth)
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
