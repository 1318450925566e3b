//! Light tracing, what it cannot see, and density estimation that can [Zeltner 2021, sections 2.5.3 and 2.5.4].

use ad_core::Vec3;
use render::Job;
use render::bsdf::kernel::Rules;
use render::emitter::Point;
use render::instances::{density_f32, particle_map_f32};
use render::integrator::density::Convention;
use render::integrator::render::Rendering;
use render::params::Theta;
use render::statistics::{Estimate, z_limit};
use render::{Scene, Settings};

use crate::common_scenes::{Walls, cornell};
use crate::statistics::per_pixel;
use crate::veach::pool::{WATER, water};
use crate::veach::{particles, paths};
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::{POSITIVE, SceneBuilder, View};

/// Height of the lamp over the water, depth of the water, intensity.
const LAMP: [f64; 3] = [0.5, 0.4, 1.0];

/// A flat pool under a point light.
fn still_pool(size: u32) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let tiles = builder.matt("tiles", [0.6; 3])?;
    let [height, depth, intensity] = LAMP;
    let square = |y: f64| [[-2.0, y, 2.0], [4.0, 0.0, 0.0], [0.0, 0.0, -4.0]];
    builder.quad("bottom", square(-depth), &tiles)?;
    let water = water(&mut builder, 1.0)?;
    builder.quad("water", square(0.0), &water)?;
    let intensity = builder
        .build
        .rgb("lamp.intensity.value", [intensity; 3], POSITIVE)?;
    let position = [0.0, height as f32, 0.0];
    builder
        .build
        .add_emitter(Point::new(intensity, position), None);
    let view = View {
        eye: [0.0, 2.5, 2.0],
        target: [0.0, -0.3, 0.0],
        fov: 40.0,
        size: [size; 2],
    };
    builder.finish(&view, 4)
}

/// Irradiance on the bottom right below the lamp: the light spreads over `(h + d / n)^2`.
fn irradiance() -> f64 {
    let [h, d, i] = LAMP;
    let mirror = ((WATER - 1.0) / (WATER + 1.0)).powi(2);
    i * (1.0 - mirror) / (h + d / WATER).powi(2)
}

/// The box by paths and by particles.
fn the_box(fig: &mut Figure) -> Result {
    let size = fig.pick(32u32, 64);
    let scene = cornell(size, Walls::Matt, 6)?;
    let settings = scene.settings;
    let (runs, spp, block) = (32u64, fig.pick(32, 128), 8usize);
    let n = size as usize / block;
    let blocks = |r: &Rendering| {
        let mut out = vec![0.0; n * n * 3];
        for (i, v) in r.sums[0].iter().enumerate() {
            let (x, y, c) = (i / 3 % size as usize, i / 3 / size as usize, i % 3);
            out[(y / block * n + x / block) * 3 + c] +=
                v / (r.samples as f64 * (block * block) as f64);
        }
        out
    };
    let by_light = (0..runs)
        .map(|s| particles(&scene, &settings, Rules::default(), s, spp).map(|r| blocks(&r)))
        .collect::<Result<Vec<_>>>()?;
    let by_path: Vec<_> = (0..runs)
        .map(|s| blocks(&paths(&scene, &settings, 100 + s, spp)))
        .collect();
    let [by_light, by_path] = [by_light, by_path].map(|images| per_pixel(&images));
    let z: Vec<f64> = (by_light.iter().zip(&by_path))
        .filter(|(a, b)| a.se + b.se > 0.0)
        .map(|(a, b)| a.z(b))
        .collect();
    let largest = z.iter().fold(0.0, |m: f64, z| m.max(z.abs()));
    let limit = z_limit(z.len(), runs, 1e-2);
    let spread = (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
    // A small difference of many blocks shows in their root mean square.
    fig.check(
        format!(
            "light tracer and path tracer agree on the box in {} blocks and channels",
            z.len()
        ),
        largest < limit && spread < 1.3,
        format!("largest |z| {largest:.2}, limit {limit:.2}; root mean square {spread:.3}"),
    );
    Ok(())
}

/// A mirror ball, by paths and by particles.
fn mirror_ball(fig: &mut Figure) -> Result<[Rendering; 2]> {
    let mut builder = SceneBuilder::default();
    let matt = builder.matt("floor", [0.5; 3])?;
    let black = builder.matt("black", [0.0; 3])?;
    builder.quad(
        "floor",
        [[-3.0, 0.0, 3.0], [6.0, 0.0, 0.0], [0.0, 0.0, -6.0]],
        &matt,
    )?;
    let white = builder.colour("mirror", "specular_reflectance", [0.9; 3])?;
    let mirror = std::sync::Arc::new(render::bsdf::Material::from(render::bsdf::Conductor {
        specular_reflectance: white,
        index: None,
    }));
    let ball = builder.ball("ball", [0.0, 0.7, 0.0], 0.7, &mirror)?;
    let above = [[-1.0, 3.0, -1.0], [2.0, 0.0, 0.0], [0.0, 0.0, 2.0]];
    let lamp = builder.quad("lamp", above, &black)?;
    builder.lamp("lamp", lamp, [6.0; 3])?;
    let view = View {
        eye: [0.0, 1.5, 4.5],
        target: [0.0, 0.6, 0.0],
        fov: 32.0,
        size: [fig.pick(48, 128); 2],
    };
    let with_mirror = builder.finish(&view, 5)?;
    let by_light = particles(
        &with_mirror,
        &with_mirror.settings,
        Rules::default(),
        1,
        fig.pick(64, 256),
    )?;
    let by_path = paths(&with_mirror, &with_mirror.settings, 1, fig.pick(64, 256));
    let width = view.size[0];
    let mut seen = [0.0f64; 2];
    for y in 0..width {
        for x in 0..width {
            let corners = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
            let inside = corners.iter().all(|(dx, dy)| {
                let ray = with_mirror.camera.ray(f64::from(x) + dx, f64::from(y) + dy);
                with_mirror.intersect(&ray).is_some_and(|h| h.shape == ball)
            });
            if inside {
                let i = (y * width + x) as usize * 3;
                seen[0] += by_light.sums[0][i];
                seen[1] += by_path.sums[0][i];
            }
        }
    }
    fig.check(
        "the light tracer cannot see specular objects: a mirror ball is black, for paths it is not",
        seen[0] == 0.0 && seen[1] > 0.0,
        format!("sums over its pixels {} and {:.1}", seen[0], seen[1]),
    );
    Ok([by_path, by_light])
}

/// Light that is seen through water: specular, diffuse, specular.
fn through_water(fig: &mut Figure, pool: &Scene) -> Result<Rendering> {
    let spp = fig.pick(32, 128);
    let p = paths(pool, &pool.settings, 1, spp).mean(0)[0];
    let l = particles(pool, &pool.settings, Rules::default(), 1, spp)?.mean(0)[0];
    let theta = Theta::constant(pool.params().values());
    let gathered = density_f32(
        &Job::new(pool, &pool.settings, 1, 0..spp, &()),
        &theta,
        Rules::default(),
        Convention::Radiance,
        0.04,
    )?;
    let d = gathered.mean(0)[0];
    fig.check(
        "a point light seen through water: 0 for the path tracer and for the light tracer, density estimation finds it",
        p == 0.0 && l == 0.0 && d > 0.0,
        format!("means {p}, {l} and {d:.4}"),
    );
    Ok(gathered)
}

/// Bias and variance against the radius.
fn radii(fig: &mut Figure, pool: &Scene) -> Result {
    let exact = irradiance();
    let theta = Theta::constant(pool.params().values());
    let settings = Settings {
        max_depth: 3,
        ..pool.settings
    };
    let at = Vec3::new(0.0, -LAMP[1] as f32, 0.0);
    let up = Vec3::new(0.0, 1.0, 0.0);
    let radii = [0.4, 0.2, 0.1, 0.05];
    let runs = fig.pick(24u64, 64);
    let samples = (fig.pick(200_000u64, 1_000_000) / pool.film.pixels() as u64).max(1);
    let mut rows = Vec::new();
    for r in radii {
        let mut values = Vec::new();
        for seed in 0..runs {
            let map = particle_map_f32(
                &Job::new(pool, &settings, 1000 + seed, 0..samples, &()),
                &theta,
                r,
            )?;
            values.push(f64::from(map.irradiance(at, up).value.r));
        }
        let found = Estimate::of(&values);
        let relative = found.se / exact;
        rows.push([
            r,
            found.mean / exact - 1.0,
            relative,
            relative * relative * runs as f64,
        ]);
    }
    let found = rows
        .iter()
        .map(|r| format!("{}: {:+.3} +- {:.3} %", r[0], r[1] * 100.0, r[2] * 100.0));
    let found = found.collect::<Vec<_>>().join(", ");
    let ratio = rows[0][1] / rows[1][1];
    fig.check(
        "its bias shrinks with the radius, towards zero (at the smallest within chance and half a per cent)",
        rows[0][1].abs() > rows[1][1].abs() && rows[1][1].abs() > rows[2][1].abs()
            && rows[3][1].abs() < z_limit(1, runs, 1e-2) * rows[3][2] + 0.005,
        format!("bias at radius {found}"),
    );
    fig.check(
        "halving the large radius divides the bias by 2.5 to 5 (4 in the limit)",
        (2.5..5.0).contains(&ratio),
        format!("{ratio:.2}"),
    );
    let growth = (rows[3][3] / rows[1][3]).sqrt();
    fig.check(
        "halving the radius multiplies the variance by about 4 (2.5 to 6.5)",
        (2.5..6.5).contains(&growth),
        format!("{growth:.2} per halving"),
    );
    fig.csv(
        "radius",
        &[
            "radius",
            "relative bias",
            "standard error",
            "relative variance of one map",
        ],
        rows.clone(),
    );
    let chart = LineChart::new(
        "Density estimate on the bottom of a pool",
        "radius",
        "relative",
    )
    .log_x()
    .log_y()
    .measured(
        "bias",
        rows.iter().map(|r| (r[0], r[1].abs())).collect::<Vec<_>>(),
    )
    .measured(
        "standard deviation",
        rows.iter().map(|r| (r[0], r[3].sqrt())).collect::<Vec<_>>(),
    );
    fig.chart("radius", &chart);
    Ok(())
}

/// `zeltner-2-5-3`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    the_box(fig)?;
    let [by_path, by_light] = mirror_ball(fig)?;
    let pool = still_pool(fig.pick(32, 96))?;
    let gathered = through_water(fig, &pool)?;
    radii(fig, &pool)?;
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, image: &render::Image| Panel::tonemapped(label, image, 1.0).enlarged(enlarge);
    fig.images(
        "blind",
        3,
        &[
            panel("mirror ball: paths", &by_path.image(0)),
            panel("mirror ball: particles", &by_light.image(0)),
            panel("pool, point light: density", &gathered.image(0)),
        ],
    );
    Ok(())
}
