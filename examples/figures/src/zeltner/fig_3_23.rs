//! [Zeltner 2021, figures 3.1 and 3.23]: a shop window, behind which spots light pedestals of bumpy gold and a lamp shines
//! inside a hollow ball of glass. All of this light is out of reach of paths if the surfaces are smooth.
//!
//! The shoes are left out: the renderer looks for glints at first vertices, which the window is here.

use std::sync::Arc;

use rayon::prelude::*;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{
    Conductor, Dielectric, Material, RoughConductor, RoughDielectric, Roughness, ThinDielectric,
};
use render::emitter::{Point, Spot};
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::{Connections, Method};
use render::shape::{Cylinder, Sphere};
use render::statistics::z_limit;
use render::{Job, Scene, Settings};

use super::manifold_methods::{Effort, Measured, measure};
use super::manifold_scenes::bumpy;
use crate::statistics::{grey, variance};
use examples::figure::{Figure, Result};
use examples::scene_builder::{POSITIVE, SceneBuilder, View};

const SEED: u64 = 323;
/// Beckmann roughness of the figure, and one at which paths converge.
const ALPHA: f64 = 0.005;
const ROUGH: f64 = 0.08;
/// Slopes of the gold.
const SLOPE: f64 = 0.05;

/// Gold, smooth or of this roughness, under bumps.
fn gold(b: &mut SceneBuilder, alpha: Option<f64>) -> Result<Arc<Material>> {
    let conductor = Conductor {
        specular_reflectance: b.colour("gold", "specular_reflectance", [1.0, 0.78, 0.34])?,
        index: None,
    };
    let metal: Material = match alpha {
        None => conductor.into(),
        Some(alpha) => RoughConductor {
            roughness: beckmann(b, "gold", alpha)?,
            conductor,
        }
        .into(),
    };
    bumpy(b, Arc::new(metal), SLOPE, SEED)
}

/// Glass, smooth or of this roughness.
fn shell(b: &mut SceneBuilder, alpha: Option<f64>) -> Result<Arc<Material>> {
    let eta = b.build.scalar("shell.eta.value", 1.5, (1.01, 4.0))?;
    let specular_reflectance = b.colour("shell", "specular_reflectance", [1.0; 3])?;
    let specular_transmittance = b.colour("shell", "specular_transmittance", [1.0; 3])?;
    Ok(Arc::new(match alpha {
        None => Dielectric {
            eta,
            specular_reflectance,
            specular_transmittance,
        }
        .into(),
        Some(alpha) => RoughDielectric {
            roughness: beckmann(b, "shell", alpha)?,
            eta,
            specular_reflectance,
            specular_transmittance,
        }
        .into(),
    }))
}

fn beckmann(b: &mut SceneBuilder, name: &str, alpha: f64) -> Result<Roughness> {
    let name = format!("{name}.alpha.value");
    Ok(Roughness {
        kind: Ndf::Beckmann,
        alpha: b.build.scalar(&name, alpha, (1e-4, 1.0))?,
        visible: true,
    })
}

/// The room behind the window, for paths of so many edges.
fn shop(size: u32, alpha: Option<f64>, depth: u32) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("room", [0.5, 0.47, 0.43])?;
    let floor = [[-4.0, 0.0, -3.0], [0.0, 0.0, 6.0], [8.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let back = [[-4.0, 0.0, -3.0], [8.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
    b.quad("back", back, &matt)?;
    let pane = ThinDielectric {
        eta: b.build.scalar("window.eta.value", 1.5, (1.01, 4.0))?,
        specular_reflectance: b.colour("window", "specular_reflectance", [1.0; 3])?,
        specular_transmittance: b.colour("window", "specular_transmittance", [1.0; 3])?,
    };
    let window = [[-4.0, 0.0, 3.0], [8.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
    b.quad("window", window, &Arc::new(pane.into()))?;
    let metal = gold(&mut b, alpha)?;
    for (name, x) in [("left", -1.8), ("right", 1.8)] {
        let pedestal = Cylinder::new([x, 0.0, -0.5], [x, 1.2, -0.5], 0.6, false);
        b.shape(name, pedestal.ok_or("no pedestal")?, &metal);
        let name = format!("{name} spot.intensity.value");
        let intensity = b.build.rgb(&name, [30.0; 3], POSITIVE)?;
        let at = [1.3 * x, 3.5, 2.2];
        let axis = [x - at[0], 0.6 - at[1], -0.5 - at[2]];
        let spot = Spot::new(intensity, at, axis, 8.0, 12.0);
        b.build.add_emitter(spot.ok_or("no spot")?, None);
    }
    let glass = shell(&mut b, alpha)?;
    let middle = [0.0, 0.62, -0.2];
    for (name, radius, flip) in [("outer", 0.6, false), ("inner", 0.45, true)] {
        let ball = Sphere::new(middle, radius, flip).ok_or("no ball")?;
        b.shape(name, ball, &glass);
    }
    let intensity = b.build.rgb("lamp.intensity.value", [2.0; 3], POSITIVE)?;
    let lamp = Point::new(intensity, [0.1, 0.75, -0.15]);
    b.build.add_emitter(lamp, None);
    let view = View {
        eye: [0.0, 2.6, 9.0],
        target: [0.0, 0.7, 0.0],
        fov: 34.0,
        size: [size; 2],
    };
    b.finish(&view, depth)
}

/// Variance of the whole image with connections by this method, of one run, summed over its pixels.
fn whole(scene: &Scene, method: Method, effort: Effort) -> f64 {
    let theta = Theta::constant(scene.params().values());
    let settings = Settings {
        connections: Some(Connections::new(method)),
        ..scene.settings
    };
    let run = |run: u64| {
        let job = Job::new(scene, &settings, effort.seed + run, 0..effort.spp, &());
        let image = render_f32(&job, &theta, Estimator::Mis);
        grey(&image.sums[0], 1.0 / effort.spp as f64)
    };
    let images: Vec<Vec<f64>> = (0..effort.runs).into_par_iter().map(run).collect();
    variance(&images)
}

/// `zeltner-3-23`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 64);
    let effort = Effort::of(fig, [6, 32], SEED);
    effort.note(fig, size);
    let of = |k: u64, scene: &Scene, by_paths: bool, spp: u64| {
        let connections = Connections {
            roughness: 1.0,
            ..Connections::new(Method::Sms)
        };
        let effort = Effort {
            spp,
            ..effort.other(k)
        };
        measure(scene, connections, by_paths, effort)
    };
    let spp = effort.spp;

    // ---- Smooth ----
    let smooth = shop(size, None, 6)?;
    let (chains, paths) = (of(1, &smooth, false, spp)?, of(2, &smooth, true, 32 * spp)?);
    let nothing = paths
        .series
        .pixels
        .iter()
        .all(|e| e.mean == 0.0 && e.se == 0.0);
    fig.check(
        "on smooth surfaces paths find none of this light, at all",
        nothing && chains.mean() > 0.0,
        format!("connections bring {:.4} on average", chains.mean()),
    );
    // Where it comes from, and where noise does: edges beyond the first that leaves the floor.
    let direct = of(3, &shop(size, None, 5)?, false, spp)?;
    let further = of(4, &shop(size, None, 7)?, false, spp)?;
    let light = 1.0 - direct.mean() / further.mean();
    let noise = 1.0 - direct.variance() / further.variance();
    let of_image = |method: Method, depth: u32| -> Result<f64> {
        Ok(whole(&shop(size, None, depth)?, method, effort))
    };
    let (lit, all) = (of_image(Method::Sms, 5)?, of_image(Method::Sms, 7)?);
    let others = of_image(Method::LeftOut, 7)?;
    fig.check(
        "most noise of caustics is in what they light in turn, which is little of their light",
        noise > 0.5 && light < 0.5,
        format!(
            "{:.1} % of the variance, {:.1} % of the light; of the whole image, longer paths are {:.1} % of the variance, and without \
             any light of caustics {:.1} % of it is left",
            100.0 * noise,
            100.0 * light,
            100.0 * (1.0 - lit / all),
            100.0 * others / all
        ),
    );

    // ---- Rough ----
    let slightly = shop(size, Some(ALPHA), 6)?;
    let (few, many) = (
        of(5, &slightly, false, spp)?,
        of(6, &slightly, true, fig.pick(128, 64) * spp)?,
    );
    let gain = (many.variance_after(few.seconds) / few.variance()).sqrt();
    fig.check(
        "on slightly rough ones their error is five times as large in the same time",
        gain > 5.0,
        format!("{gain:.1} times"),
    );
    let (a, b) = (few.series.whole, many.series.whole);
    let (z, bound) = (a.z(&b), z_limit(1, effort.runs, 1e-3));
    // In few samples paths hardly meet it.
    fig.check(
        "and both bring the same light",
        z.abs() < bound && b.se < fig.pick(1.0, 0.25) * a.mean,
        format!(
            "{:.4} ± {:.4} by connections, {:.4} ± {:.4} by paths, deviate {z:.2}, limit {bound:.2}",
            a.mean, a.se, b.mean, b.se
        ),
    );
    let rough = shop(size, Some(ROUGH), 6)?;
    let (a, b) = (
        of(7, &rough, false, spp)?,
        of(8, &rough, true, fig.pick(128, 64) * spp)?,
    );
    let repeats = Measured::repeats(&[&a, &b]);
    let (a, b) = (a.whole(), b.whole());
    let (z, bound) = (a.z(&b), z_limit(1, repeats, 1e-3));
    fig.check(
        "on rough ones, where paths converge, both bring the same light",
        z.abs() < bound && a.se < 0.1 * a.mean && b.se < fig.pick(0.25, 0.1) * b.mean,
        format!(
            "{:.4} ± {:.4} by connections, {:.4} ± {:.4} by paths, deviate {z:.2}, limit {bound:.2}",
            a.mean, a.se, b.mean, b.se
        ),
    );
    let factor = fig.pick(10, 4);
    let all = [
        ("smooth: paths", &paths, &chains),
        ("smooth: chains", &chains, &chains),
        ("0.005: paths", &many, &few),
        ("0.005: chains", &few, &few),
    ];
    fig.images(
        "caustics",
        2,
        &all.map(|(label, m, of)| m.panel(label, of, factor)),
    );
    let rows = all.map(|(label, m, _)| {
        let numbers = [m.mean(), m.variance(), m.seconds].map(|x| x.to_string());
        let [mean, variance, seconds] = numbers;
        [label.to_owned(), mean, variance, seconds]
    });
    fig.csv_text("methods", &["method", "mean", "variance", "seconds"], rows);
    Ok(())
}
