//! A pool with small waves: what refraction does to radiance and not to particles [Veach 1996, plate 2 and
//! section 3.1.4].

use std::f64::consts::TAU;
use std::sync::Arc;

use render::bsdf::kernel::Rules;
use render::bsdf::{Dielectric, Material};
use render::instances::density_f32;
use render::integrator::density::Convention;
use render::integrator::render::Rendering;
use render::params::Theta;
use render::shape::{Mesh, MeshData, smooth_normals};
use render::{Scene, Settings};

use super::{IGNORED, paths};
use crate::chart::Panel;
use crate::figure::{Figure, Result};
use crate::figures::stage::{Stage, UNIT, View};

/// Index of water.
pub const WATER: f64 = 1.33;

/// Water between air above and itself below. `reflects` is the factor on the reflectance.
///
/// # Errors
/// None.
pub fn water(stage: &mut Stage, reflects: f64) -> Result<Arc<Material>> {
    let build = &mut stage.build;
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
fn pool(width: u32, reflects: f64) -> Result<(Scene, u32)> {
    let mut stage = Stage::default();
    let tiles = stage.matt("tiles", [0.55, 0.7, 0.75])?;
    let deck = stage.matt("deck", [0.6, 0.5, 0.4])?;
    let black = stage.matt("black", [0.0; 3])?;
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    let rim = 0.12;
    let tall = y.map(|c| c * (0.8 + rim));
    stage.quad("bottom", [[-1.0, -0.8, 1.0], x, minus(z)], &tiles)?;
    stage.quad("back", [[-1.0, -0.8, -1.0], x, tall], &tiles)?;
    stage.quad("front", [[1.0, -0.8, 1.0], minus(x), tall], &tiles)?;
    stage.quad("left", [[-1.0, -0.8, 1.0], minus(z), tall], &tiles)?;
    stage.quad("right", [[1.0, -0.8, -1.0], z, tall], &tiles)?;
    let wide = [0.7, 0.0, 0.0];
    stage.quad("deck left", [[-1.7, rim, 1.0], wide, minus(z)], &deck)?;
    stage.quad("deck right", [[1.0, rim, 1.0], wide, minus(z)], &deck)?;
    stage.quad(
        "deck back",
        [[-1.7, rim, -1.0], [3.4, 0.0, 0.0], [0.0, 0.0, -0.7]],
        &deck,
    )?;
    let water = water(&mut stage, reflects)?;
    let surface = stage.shape("water", Mesh::new(waves(96, 0.012), false)?, &water);
    for (name, at, colour) in [
        ("lamp a", -1.0, [34.0, 30.0, 24.0]),
        ("lamp b", 0.6, [18.0, 22.0, 30.0]),
    ] {
        let lamp = stage.quad(
            name,
            [[at, 2.4, -0.2], [0.4, 0.0, 0.0], [0.0, 0.0, 0.4]],
            &black,
        )?;
        stage.lamp(name, lamp, colour)?;
    }
    let view = View {
        eye: [0.0, 2.6, 2.9],
        target: [0.0, -0.25, -0.05],
        fov: 34.0,
        size: [width, width * 3 / 4],
    };
    Ok((stage.finish(&view, 7)?, surface))
}

/// Radius of the kernel, in pool widths of 2.
const RADIUS: f64 = 0.025;

fn gather(scene: &Scene, rules: Rules, convention: Convention, spp: u64) -> Result<Rendering> {
    let theta = Theta::constant(scene.params().values());
    let settings = Settings {
        rr_depth: 100,
        ..scene.settings
    };
    Ok(density_f32(
        scene,
        &theta,
        rules,
        convention,
        RADIUS,
        &settings,
        5,
        0..spp,
        &(),
    )?)
}

/// Whether a pixel sees the surface of the water, at its centre and all corners.
fn mask(scene: &Scene, surface: u32) -> Vec<[bool; 2]> {
    let [width, height] = scene.film.size;
    (0..width * height)
        .map(|i| {
            let (x, y) = (f64::from(i % width), f64::from(i / width));
            let sees =
                [(0.5, 0.5), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)].map(|(dx, dy)| {
                    let hit = scene.intersect(&scene.camera.ray(x + dx, y + dy));
                    hit.is_some_and(|h| h.shape == surface)
                });
            [sees.iter().all(|&s| s), sees.iter().all(|&s| !s)]
        })
        .collect()
}

/// `veach-plate-2`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width = fig.pick(64, 192);
    let spp = fig.pick(32, 128);
    fig.note("particles and viewing rays per pixel", spp);
    fig.note("radius", RADIUS);
    let (scene, surface) = pool(width, 1.0)?;
    let mask = mask(&scene, surface);
    let a = gather(&scene, Rules::default(), Convention::Radiance, spp)?;
    let b = gather(&scene, IGNORED, Convention::Radiance, spp)?;
    // All light is transmitted, as in the paper's derivation: reflections are not scaled.
    let (clear, _) = pool(width, 0.0)?;
    let ca = gather(&clear, Rules::default(), Convention::Radiance, spp)?;
    let cb = gather(&clear, IGNORED, Convention::Radiance, spp)?;
    let expected = WATER * WATER;
    let ratios = |a: &Rendering, b: &Rendering, k: usize| -> Vec<f64> {
        let pixels = a.sums[0].chunks_exact(3).zip(b.sums[0].chunks_exact(3));
        let mut out: Vec<f64> = (pixels.zip(&mask))
            .filter(|((a, _), m)| m[k] && a.iter().sum::<f64>() > 0.0)
            .map(|((a, b), _)| b.iter().sum::<f64>() / a.iter().sum::<f64>())
            .collect();
        out.sort_by(f64::total_cmp);
        out
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let transmitted = ratios(&ca, &cb, 0);
    fig.check(
        format!("below the water, light that is transmitted: mean of (b) / (a) is 1.33^2 = {expected:.4}, to 1 %"),
        (mean(&transmitted) / expected - 1.0).abs() < 0.01,
        format!("{:.4} in {} pixels", mean(&transmitted), transmitted.len()),
    );
    let all = ratios(&a, &b, 0);
    let median = all[all.len() / 2];
    fig.check(
        "with reflections (which are not scaled): the median of the pixels below the water is no larger, and within 5 % of it",
        median < 1.001 * expected && median > 0.95 * expected,
        format!("median {median:.4}, mean {:.4}", mean(&all)),
    );
    let dry = ratios(&a, &b, 1);
    fig.check(
        "pixels above the water are unchanged, to 1 % in the mean",
        (mean(&dry) - 1.0).abs() < 0.01 && dry.len() > 100,
        format!("{:.5} in {} pixels", mean(&dry), dry.len()),
    );
    // The path tracer hits the large lamps through the water.
    let reference = paths(&scene, &scene.settings, 9, fig.pick(512, 2048));
    let brightness = |r: &Rendering, k: usize| {
        let pixels = r.sums[0].chunks_exact(3).zip(&mask).filter(|(_, m)| m[k]);
        pixels.map(|(p, _)| p.iter().sum::<f64>()).sum::<f64>() / r.samples as f64
    };
    for (k, name, tolerance) in [(0, "below", 0.03), (1, "above", 0.02)] {
        let ratio = brightness(&a, k) / brightness(&reference, k);
        fig.check(
            format!("(a) is as bright as the path tracer {name} the water, to {} % (bias at edges included)", tolerance * 100.0),
            (ratio - 1.0).abs() < tolerance,
            format!("{:+.2} %", (ratio - 1.0) * 100.0),
        );
    }
    fig.csv(
        "ratios",
        &["eta^2", "transmitted", "median", "mean", "above the water"],
        [[expected, mean(&transmitted), median, mean(&all), mean(&dry)]],
    );
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, r: &Rendering| Panel::tonemapped(label, &r.image(0), 1.0).enlarged(enlarge);
    fig.images(
        "plate",
        3,
        &[
            panel("(a) radiance scaled, particles not", &a),
            panel("(b) neither scaled", &b),
            panel("path tracer", &reference),
        ],
    );
    Ok(())
}

/// `veach-eq9-invariant`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn invariant(fig: &mut Figure) -> Result {
    let width = fig.pick(64, 192);
    let spp = fig.pick(16, 64);
    fig.note("particles and viewing rays per pixel", spp);
    let (scene, _) = pool(width, 1.0)?;
    let radiance = gather(&scene, Rules::default(), Convention::Radiance, spp)?;
    let basic = gather(&scene, Rules::default(), Convention::Basic, spp)?;
    let scale = radiance.sums[0].iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let largest = (radiance.sums[0].iter().zip(&basic.sums[0]))
        .map(|(a, b)| (a - b).abs() / (a.abs() + 1e-3 * scale))
        .fold(0.0, f64::max);
    fig.check(
        "L / eta^2 along viewing rays and the same rules as for importance: the image of plate 2 (a), to rounding (1e-5)",
        largest < 1e-5 && scale > 0.0,
        format!("largest relative difference {largest:.1e}"),
    );
    let counts = radiance.non_finite.count + basic.non_finite.count;
    fig.check(
        "no sample is lost",
        counts == 0,
        format!("{counts} not finite"),
    );
    fig.csv("difference", &["largest relative difference"], [[largest]]);
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, r: &Rendering| Panel::tonemapped(label, &r.image(0), 1.0).enlarged(enlarge);
    fig.images(
        "conventions",
        2,
        &[
            panel("radiance", &radiance),
            panel("basic radiance", &basic),
        ],
    );
    Ok(())
}
