//! Seven materials [Zeltner 2021, figure 2.6]: diffuse; smooth and rough metal; smooth and rough glass; smooth
//! and rough plastic.

use std::f64::consts::TAU;
use std::sync::Arc;

use ad_core::Vec3;
use rayon::prelude::*;
use render::Scene;
use render::bsdf::{
    Coated, Conductor, ConductorIndex, Dielectric, Diffuse, Material, Plastic, RoughConductor,
    RoughDielectric, RoughPlastic,
};
use render::math::Ray;
use render::statistics::{Estimate, z_limit};

use super::radiance_split::radiance;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder;
use examples::scene_builder::{POSITIVE, SceneBuilder, View};

const SEED: u64 = 26;
/// Independent parts of the samples of a furnace.
const BATCHES: u64 = 64;
/// Roughness of the rough ones.
const ALPHA: f64 = 0.15;
/// Index of glass and of the coat of plastic.
const INDEX: f64 = 1.5;
/// Albedo of the diffuse ball and below the coat.
const ALBEDO: f64 = 0.5;
/// Gold at the wavelengths of red, green and blue.
const GOLD: [[f64; 3]; 2] = [[0.143, 0.375, 1.442], [3.983, 2.386, 1.603]];

const NAMES: [&str; 7] = [
    "diffuse",
    "smooth metal",
    "rough metal",
    "smooth glass",
    "rough glass",
    "smooth plastic",
    "rough plastic",
];

fn material(builder: &mut SceneBuilder, k: usize) -> Result<Arc<Material>> {
    let name = NAMES[k];
    let white = |builder: &mut SceneBuilder, key| builder.colour(name, key, [1.0; 3]);
    let conductor = |builder: &mut SceneBuilder| -> Result<_> {
        let eta = builder
            .build
            .rgb(&format!("{name}.eta.value"), GOLD[0], POSITIVE)?;
        let k = builder
            .build
            .rgb(&format!("{name}.k.value"), GOLD[1], POSITIVE)?;
        Ok(Conductor {
            specular_reflectance: white(builder, "specular_reflectance")?,
            index: Some(ConductorIndex { eta, k }),
        })
    };
    let index = |builder: &mut SceneBuilder| {
        builder
            .build
            .scalar(&format!("{name}.eta.value"), INDEX, (1.0, 4.0))
    };
    let coated = |builder: &mut SceneBuilder| -> Result<_> {
        Ok(Coated {
            diffuse_reflectance: builder.colour(name, "diffuse_reflectance", [ALBEDO; 3])?,
            specular_reflectance: white(builder, "specular_reflectance")?,
            eta: index(builder)?,
            first_eta: INDEX as f32,
            // The colour shift of real plastic: light that stays below the coat is absorbed again.
            nonlinear: true,
        })
    };
    Ok(Arc::new(match k {
        0 => Diffuse {
            reflectance: builder.colour(name, "reflectance", [ALBEDO; 3])?,
        }
        .into(),
        1 => conductor(builder)?.into(),
        2 => RoughConductor {
            roughness: builder.ggx(name, ALPHA)?,
            conductor: conductor(builder)?,
        }
        .into(),
        3 => Dielectric {
            eta: index(builder)?,
            specular_reflectance: white(builder, "specular_reflectance")?,
            specular_transmittance: white(builder, "specular_transmittance")?,
        }
        .into(),
        4 => RoughDielectric {
            roughness: builder.ggx(name, ALPHA)?,
            eta: index(builder)?,
            specular_reflectance: white(builder, "specular_reflectance")?,
            specular_transmittance: white(builder, "specular_transmittance")?,
        }
        .into(),
        5 => Plastic::new(coated(builder)?).into(),
        _ => RoughPlastic::new(builder.ggx(name, ALPHA)?, coated(builder)?).into(),
    }))
}

/// A ball of radius 1 at the origin, alone under `light`.
fn single(k: usize, max_depth: u32, light: impl Fn(&mut SceneBuilder) -> Result) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let material = material(&mut builder, k)?;
    builder.ball("ball", [0.0; 3], 1.0, &material)?;
    light(&mut builder)?;
    let view = View {
        eye: [0.0, 0.0, 10.0],
        target: [0.0; 3],
        fov: 12.6,
        size: [96, 96],
    };
    builder.finish(&view, max_depth)
}

/// Mean over the channels of the light that the ball sends along parallel rays whose distances from the
/// centre are `[low, high]` (uniform in area), and its standard error.
fn furnace(scene: &Scene, [low, high]: [f64; 2], n: u64) -> Result<Estimate> {
    let ray = |u: [f32; 2]| {
        let r = (low * low + f64::from(u[0]) * (high * high - low * low)).sqrt();
        let (sin, cos) = (TAU * f64::from(u[1])).sin_cos();
        let o = [r * cos, r * sin, 8.0].map(|x| x as f32);
        Ray::new(Vec3::from(o), Vec3::new(0.0, 0.0, -1.0))
    };
    let depth = scene.settings.max_depth;
    let means: Vec<f64> = (0..BATCHES)
        .into_par_iter()
        .map(|b| {
            let samples = b * (n / BATCHES)..(b + 1) * (n / BATCHES);
            let split = radiance(scene, ray, depth, SEED, 0, samples).map_err(|e| e.to_string())?;
            Ok(split.total.iter().sum::<f64>() / 3.0)
        })
        .collect::<std::result::Result<_, String>>()?;
    Ok(Estimate::of(&means))
}

/// Peak of the reflection of a small distant light, and the number of pixels above half of it.
fn highlight(k: usize, spp: u64) -> Result<(f64, usize)> {
    let mut scene = single(k, 2, |builder| {
        builder.lobe("light", [100.0; 3], [-0.5, 0.7, 0.8], 300.0)
    })?;
    // Around the normal between camera and light.
    scene.film.crop_offset = [10, 6];
    scene.film.crop_size = [52, 52];
    let image = scene_builder::picture(&scene, SEED, spp);
    if image.non_finite.count > 0 {
        return Err(format!("{}: samples that are not finite", NAMES[k]).into());
    }
    let image = image.image(0);
    let values: Vec<f32> = image
        .data
        .chunks_exact(3)
        .map(|p| p.iter().sum::<f32>() / 3.0)
        .collect();
    let peak = values.iter().fold(0.0f32, |m, &v| m.max(v));
    let wide = values.iter().filter(|v| **v > 0.5 * peak).count();
    Ok((peak.into(), wide))
}

/// `zeltner-2-6`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(64 * 256, 64 * 2048);
    let spp = fig.pick(256, 1024);
    fig.note("roughness", ALPHA);
    fig.note("index", INDEX);
    fig.note("albedo", ALBEDO);
    fig.note("samples of a furnace", n);
    fig.note("samples per pixel of a highlight", spp);
    fig.note("seed", SEED);

    let furnaces = (0..NAMES.len()).map(|k| single(k, 64, |builder| builder.ambient([1.0; 3])));
    let furnaces = furnaces.collect::<Result<Vec<_>>>()?;
    let means = furnaces.iter().map(|f| furnace(f, [0.0, 0.999], n));
    let means = means.collect::<Result<Vec<_>>>()?;
    let limit = z_limit(NAMES.len(), BATCHES, 1e-2);
    for (name, found) in NAMES.iter().zip(&means) {
        // Single precision leaves 1e-5 of rounding on an exact 1.
        fig.check(
            format!("white furnace, {name}: at most 1"),
            found.mean <= 1.0 + limit * found.se + 1e-5 && found.mean > 0.0,
            format!(
                "{:.5} +- {:.1e}, limit {limit:.2} of these",
                found.mean, found.se
            ),
        );
    }
    let rings = 20;
    let mut rows = Vec::new();
    for ring in 0..rings {
        let edges = [ring, ring + 1].map(|i| 0.999 * f64::from(i) / f64::from(rings));
        let mut row = [0.5 * (edges[0] + edges[1]); 8];
        for (k, scene) in furnaces.iter().enumerate() {
            row[k + 1] = furnace(scene, edges, n / 8)?.mean;
        }
        rows.push(row);
    }
    let mut chart = LineChart::new(
        "Balls in a white furnace",
        "distance from the centre / radius",
        "radiance",
    )
    .y_range(0.0, 1.1);
    for (k, name) in NAMES.iter().enumerate() {
        chart = chart.line(name, rows.iter().map(|r| (r[0], r[k + 1])));
    }
    fig.chart("furnace", &chart);
    let header = [
        "distance", NAMES[0], NAMES[1], NAMES[2], NAMES[3], NAMES[4], NAMES[5], NAMES[6],
    ];
    fig.csv("furnace", &header, rows);

    let regions = [[0.0, 0.3], [0.99, 0.9999]];
    let at = |k: usize, region| furnace(&furnaces[k], region, n);
    let [centre, rim] = [at(0, regions[0])?, at(0, regions[1])?];
    let [coated, coated_rim] = [at(5, regions[0])?, at(5, regions[1])?];
    fig.check(
        "smooth plastic is darker than the diffuse ball at the centre",
        centre.z(&coated) > 5.0,
        format!("{:.4} against {:.4}", coated.mean, centre.mean),
    );
    fig.check(
        "smooth plastic is brighter than the diffuse ball at grazing angles",
        coated_rim.z(&rim) > 5.0,
        format!(
            "{:.4} against {:.4} beyond 0.99 radii",
            coated_rim.mean, rim.mean
        ),
    );

    let mut table = Vec::new();
    for (smooth, rough) in [(1, 2), (3, 4), (5, 6)] {
        let (s, r) = (highlight(smooth, spp)?, highlight(rough, spp)?);
        fig.check(
            format!("{} has a lower peak than {}", NAMES[rough], NAMES[smooth]),
            r.0 < 0.8 * s.0,
            format!("{:.3} against {:.3}", r.0, s.0),
        );
        fig.check(
            format!(
                "{} has a wider highlight than {}",
                NAMES[rough], NAMES[smooth]
            ),
            r.1 > 2 * s.1,
            format!("{} pixels above half of the peak, against {}", r.1, s.1),
        );
        table.push([s.0, s.1 as f64, r.0, r.1 as f64]);
    }
    let header = ["smooth peak", "smooth pixels", "rough peak", "rough pixels"];
    fig.csv("highlights", &header, table);
    picture(fig)
}

/// All seven on a plane in the hall.
fn picture(fig: &mut Figure) -> Result {
    let mut builder = SceneBuilder::default();
    let plane = builder.matt("plane", [0.4; 3])?;
    let (x, z) = ([40.0, 0.0, 0.0], [0.0, 0.0, -40.0]);
    builder.quad("plane", [[-20.0, -1.0, 20.0], x, z], &plane)?;
    // Smooth ones behind, rough ones in front.
    let places = [
        [-3.6, -1.2],
        [-1.2, -1.2],
        [-2.4, 1.6],
        [1.2, -1.2],
        [0.0, 1.6],
        [3.6, -1.2],
        [2.4, 1.6],
    ];
    for (k, [x, z]) in places.into_iter().enumerate() {
        let material = material(&mut builder, k)?;
        builder.ball(NAMES[k], [x, 0.0, z], 1.0, &material)?;
    }
    builder.hall(1.0)?;
    let view = View {
        eye: [0.0, 4.2, 12.0],
        target: [0.0, -0.4, 0.0],
        fov: 26.0,
        size: fig.pick([160, 80], [640, 320]),
    };
    let scene = builder.finish(&view, 12)?;
    let spp = fig.pick(48, 128);
    let image = scene_builder::picture(&scene, SEED, spp);
    fig.check(
        "every sample of the picture is finite",
        image.non_finite.count == 0,
        format!("{} are not", image.non_finite.count),
    );
    let label = "diffuse, gold, glass, plastic; in front the rough ones";
    let panel = Panel::tonemapped(label, &image.image(0), 1.0);
    fig.image("materials", &panel.enlarged(fig.pick(4, 1)));
    Ok(())
}
