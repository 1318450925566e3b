//! A pool with small waves [Veach 1996, plate 2 and section 3.1.4].

use std::f64::consts::TAU;
use std::sync::Arc;

use render::Job;
use render::bsdf::kernel::Rules;
use render::bsdf::{Dielectric, Material};
use render::instances::density_f32;
use render::integrator::density::Convention;
use render::integrator::render::Rendering;
use render::params::Theta;
use render::shape::{Mesh, MeshData, smooth_normals};
use render::{Scene, Settings};

use examples::figure::Result;
use examples::scene_builder::{SceneBuilder, UNIT, View};

/// Index of water.
pub const WATER: f64 = 1.33;

/// Water between air above and itself below. `reflects` is the factor on the reflectance.
///
/// # Errors
/// None.
pub fn water(builder: &mut SceneBuilder, reflects: f64) -> Result<Arc<Material>> {
    let build = &mut builder.build;
    Ok(Arc::new(Material::from(Dielectric {
        eta: build.scalar("water.eta.value", WATER, (1.01, 4.0))?,
        specular_reflectance: build.rgb("water.specular_reflectance.value", [reflects; 3], UNIT)?,
        specular_transmittance: build.rgb("water.specular_transmittance.value", [1.0; 3], UNIT)?,
    })))
}

/// The surface of [-1, 1]^2 with small waves, interpolated normals.
pub fn waves(n: u32, height: f64) -> MeshData {
    let at = |i: u32| 2.0 * f64::from(i) / f64::from(n) - 1.0;
    let level = |x: f64, z: f64| {
        let wave = |kx: f64, kz: f64, phase: f64| (TAU * (kx * x + kz * z) / 2.0 + phase).sin();
        height * (wave(2.0, 0.6, 0.3) + 0.7 * wave(-1.1, 2.7, 1.0) + 0.5 * wave(3.1, -2.2, 4.0))
    };
    let mut mesh = MeshData::default();
    for i in 0..=n {
        for j in 0..=n {
            let (x, z) = (at(i), at(j));
            mesh.positions.push([x, level(x, z), z].map(|c| c as f32));
        }
    }
    for i in 0..n {
        for j in 0..n {
            let a = i * (n + 1) + j;
            let (b, c, d) = (a + 1, a + n + 1, a + n + 2);
            mesh.triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    mesh.normals = smooth_normals(&mesh.positions, &mesh.triangles);
    mesh
}

/// The pool below two lamps; the index of its surface.
pub(super) fn pool(width: u32, reflects: f64) -> Result<(Scene, u32)> {
    let mut builder = SceneBuilder::default();
    let tiles = builder.matt("tiles", [0.55, 0.7, 0.75])?;
    let deck = builder.matt("deck", [0.6, 0.5, 0.4])?;
    let black = builder.matt("black", [0.0; 3])?;
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    let rim = 0.12;
    let tall = y.map(|c| c * (0.8 + rim));
    builder.quad("bottom", [[-1.0, -0.8, 1.0], x, minus(z)], &tiles)?;
    builder.quad("back", [[-1.0, -0.8, -1.0], x, tall], &tiles)?;
    builder.quad("front", [[1.0, -0.8, 1.0], minus(x), tall], &tiles)?;
    builder.quad("left", [[-1.0, -0.8, 1.0], minus(z), tall], &tiles)?;
    builder.quad("right", [[1.0, -0.8, -1.0], z, tall], &tiles)?;
    let wide = [0.7, 0.0, 0.0];
    builder.quad("deck left", [[-1.7, rim, 1.0], wide, minus(z)], &deck)?;
    builder.quad("deck right", [[1.0, rim, 1.0], wide, minus(z)], &deck)?;
    builder.quad(
        "deck back",
        [[-1.7, rim, -1.0], [3.4, 0.0, 0.0], [0.0, 0.0, -0.7]],
        &deck,
    )?;
    let water = water(&mut builder, reflects)?;
    let surface = builder.shape("water", Mesh::new(waves(96, 0.012), false)?, &water);
    for (name, at, colour) in [
        ("lamp a", -1.0, [34.0, 30.0, 24.0]),
        ("lamp b", 0.6, [18.0, 22.0, 30.0]),
    ] {
        let lamp = builder.quad(
            name,
            [[at, 2.4, -0.2], [0.4, 0.0, 0.0], [0.0, 0.0, 0.4]],
            &black,
        )?;
        builder.lamp(name, lamp, colour)?;
    }
    let view = View {
        eye: [0.0, 2.6, 2.9],
        target: [0.0, -0.25, -0.05],
        fov: 34.0,
        size: [width, width * 3 / 4],
    };
    Ok((builder.finish(&view, 7)?, surface))
}

/// Radius of the kernel, in pool widths of 2.
pub(super) const RADIUS: f64 = 0.025;

pub(super) fn gather(
    scene: &Scene,
    rules: Rules,
    convention: Convention,
    spp: u64,
) -> Result<Rendering> {
    let theta = Theta::constant(scene.params().values());
    let settings = Settings {
        rr_depth: 100,
        ..scene.settings
    };
    Ok(density_f32(
        &Job::new(scene, &settings, 5, 0..spp, &()),
        &theta,
        rules,
        convention,
        RADIUS,
    )?)
}
