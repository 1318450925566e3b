//! Shading normals gain energy, and without the adjoint they make particles jump across edges [Veach 1996,
//! figure 1].

use ad_core::Vec3;
use render::bsdf::kernel::Rules;
use render::camera::{Camera, FovAxis};
use render::emitter::Point;
use render::instances::particle_map_f32;
use render::math::Transform;
use render::params::Theta;
use render::shape::{Mesh, MeshData, Sphere};
use render::{Film, Scene, Settings};

use super::kernel::albedo;
use super::{IGNORED, particles, paths};
use crate::chart::{LineChart, Panel};
use crate::figure::{Figure, Result};
use crate::figures::stage::{POSITIVE, Stage};

/// Two quads that share the z axis as their edge, seen from above; each falls off by `degrees`.
/// All their shading normals point up.
fn roof(degrees: f64, half: f64) -> MeshData {
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

fn camera(eye: [f64; 3], up: [f64; 3], fov: f64, size: u32) -> Result<Camera> {
    let view = Transform::look_at(eye, [0.0; 3], up).ok_or("a camera that looks nowhere")?;
    Ok(Camera::new(view, fov, FovAxis::X, [size; 2])?)
}

fn lamp(stage: &mut Stage, position: [f64; 3], intensity: f64) -> Result<()> {
    let intensity = stage
        .build
        .rgb("lamp.intensity.value", [intensity; 3], POSITIVE)?;
    let position = position.map(|x| x as f32);
    stage.build.add_emitter(
        Point {
            intensity,
            position,
        },
        None,
    );
    Ok(())
}

const SETTINGS: Settings = Settings {
    max_depth: 2,
    rr_depth: u32::MAX,
    spp: 1,
    points: render::sampler::Points::Independent,
    lights: render::scene::LightChoice::One,
    caustics: render::scene::Caustics::Paths,
    pixels_per_particle: 1,
};

/// Two surfaces tilted by 80 degrees, shaded as if they faced the small light above them, in a black shell that
/// catches what they reflect.
fn gaining() -> Result<(Scene, u32, u32)> {
    let mut stage = Stage::default();
    let white = stage.matt("white", [1.0; 3])?;
    let black = stage.matt("black", [0.0; 3])?;
    let mesh = stage.shape("roof", Mesh::new(roof(80.0, 1.0), false)?, &white);
    let shell = Sphere::new([0.0; 3], 50.0, true).ok_or("a ball without radius")?;
    let shell = stage.shape("shell", shell, &black);
    lamp(&mut stage, [0.0, 20.0, 0.0], 400.0)?;
    let camera = camera([0.0, 6.0, 0.1], [0.0, 0.0, -1.0], 30.0, 96)?;
    let settings = Settings {
        max_depth: 3,
        ..SETTINGS
    };
    Ok((
        stage.build.build(camera, Film::new(96, 96), settings)?,
        mesh,
        shell,
    ))
}

/// `veach-01a`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure_a(fig: &mut Figure) -> Result {
    let n = fig.pick(400, 1200);
    let expected = [(30.0, 3.45), (60.0, 4.06), (80.0, 3.38)];
    let mut found = Vec::new();
    for (tilt, value) in expected {
        let a = albedo(80f64.to_radians(), f64::to_radians(tilt), n)?;
        fig.check(
            format!("white surface, light at 80 degrees, shading normal tilted by {tilt}: it reflects {value} times the power it receives, to 1 %"),
            (a / value - 1.0).abs() < 0.01 && a > 1.0,
            format!("{a:.4}"),
        );
        found.push((tilt, a));
    }
    let flat = albedo(80f64.to_radians(), 0.0, n)?;
    fig.check(
        "without a tilt it reflects all, not more",
        (flat - 1.0).abs() < 1e-3,
        format!("{flat:.5}"),
    );
    let (scene, roof, shell) = gaining()?;
    let theta = Theta::constant(scene.params().values());
    let spp = fig.pick(100, 1000);
    fig.note("particles", spp * scene.film.pixels() as u64);
    let map = particle_map_f32(&scene, &theta, 0.1, &scene.settings, 1, 0..spp)?;
    let received = map.power_on(roof, 1)[0];
    let reflected = map.power_on(shell, 2)[0] + map.power_on(roof, 2)[0];
    fig.check(
        "particles: the two surfaces of the figure reflect more power than they receive",
        reflected > 1.5 * received,
        format!(
            "received {received:.4}, reflected {reflected:.4}: {:.3} times",
            reflected / received
        ),
    );
    let rows = (0..=16).map(|i| {
        let tilt = 5.0 * f64::from(i);
        [
            tilt,
            albedo(80f64.to_radians(), tilt.to_radians(), 400).unwrap_or(f64::NAN),
        ]
    });
    let rows: Vec<_> = rows.collect();
    fig.csv(
        "albedo",
        &["tilt in degrees", "reflected over received"],
        rows.clone(),
    );
    let chart = LineChart::new(
        "White surface, light at 80 degrees",
        "tilt of the shading normal",
        "reflected over received",
    )
    .measured(
        "quadrature",
        rows.iter().map(|r| (r[0], r[1])).collect::<Vec<_>>(),
    )
    .dashed("conservation", [(0.0, 1.0), (80.0, 1.0)]);
    fig.chart("albedo", &chart);
    let image = paths(&scene, &SETTINGS, 1, 64).image(0);
    fig.image(
        "roof",
        &Panel::tonemapped("seen from above: as bright as a flat sheet", &image, 1.0).enlarged(3),
    );
    Ok(())
}

/// Tilt of the two facets, and the angles of light and eye from the vertical, on opposite sides.
const FACET: f64 = 20.0;
const LIGHT: f64 = -33.0;
const EYE: f64 = 33.0;

/// `veach-01b`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure_b(fig: &mut Figure) -> Result {
    let size = 64u32;
    let mut stage = Stage::default();
    let white = stage.matt("white", [0.8; 3])?;
    stage.shape("facets", Mesh::new(roof(FACET, 3.0), false)?, &white);
    // As good as parallel, both of them.
    let far = 500.0;
    let at = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [far * sin, far * cos, 0.0]
    };
    let (light, eye) = (at(LIGHT), at(EYE));
    // Only what the facets need: a spot would do as well, but its edge is a function of the angle.
    let axis = light.map(|x| -x);
    let intensity = stage
        .build
        .rgb("lamp.intensity.value", [far * far; 3], POSITIVE)?;
    let spot = render::emitter::Spot::new(intensity, light, axis, 0.45, 0.46)
        .ok_or("a spot without axis")?;
    stage.build.add_emitter(spot, None);
    let camera = camera(eye, [0.0, 0.0, 1.0], 0.2, size)?;
    let scene = stage.build.build(camera, Film::new(size, size), SETTINGS)?;

    let normal = |s: f64| {
        let (sin, cos) = FACET.to_radians().sin_cos();
        Vec3::new(s * sin, cos, 0.0)
    };
    let (o, i) = (Vec3::from(light).normalize(), Vec3::from(eye).normalize());
    let (a, b) = (normal(-1.0), normal(1.0));
    let expected = o.dot(a) * i.dot(b) / (o.dot(b) * i.dot(a));
    let spp = fig.pick(400, 4000);
    fig.note("spp", spp);
    // The edge is the middle column or row of the picture: A is where the light is.
    let ratio = |image: &render::Image| {
        let mut sums = [0.0f64; 2];
        let (pinhole, origin) = (scene.camera.pinhole(&scene.film), Vec3::from(eye));
        for (k, sign) in [-1.0, 1.0].into_iter().enumerate() {
            for v in -20..=20 {
                for u in 2..=14 {
                    let (sin, cos) = FACET.to_radians().sin_cos();
                    let along = f64::from(u) * 0.04;
                    let p = Vec3::new(sign * along * cos, -along * sin, f64::from(v) * 0.03);
                    if let Some(([x, y], _)) = pinhole.project(p - origin) {
                        let (x, y) = (x as usize, y as usize);
                        sums[k] += f64::from(
                            image.pixel(x.min(size as usize - 1), y.min(size as usize - 1))[0],
                        );
                    }
                }
            }
        }
        sums[0] / sums[1]
    };
    let right = particles(&scene, &SETTINGS, Rules::default(), 1, spp)?.image(0);
    let wrong = particles(&scene, &SETTINGS, IGNORED, 1, spp)?.image(0);
    let reference = paths(&scene, &SETTINGS, 1, 64).image(0);
    let (r, w, p) = (ratio(&right), ratio(&wrong), ratio(&reference));
    fig.check(
        format!("without the adjoint, the facets' brightnesses are in the ratio |o.A||i.B| / (|o.B||i.A|) = {expected:.3}, to 2 %"),
        (w / expected - 1.0).abs() < 0.02,
        format!("{w:.4}"),
    );
    fig.check(
        "with it, there is no jump: ratio 1 to 2 %",
        (r - 1.0).abs() < 0.02,
        format!("{r:.4}"),
    );
    fig.check(
        "nor is there one for viewing rays",
        (p - 1.0).abs() < 0.02,
        format!("{p:.4}"),
    );
    let (m, q) = (right.mean()[0], reference.mean()[0]);
    fig.check(
        "particles are as bright as paths, to 1 %",
        (m / q - 1.0).abs() < 0.01,
        format!("{m:.5} and {q:.5}"),
    );
    fig.csv(
        "ratio",
        &[
            "expected without adjoint",
            "without adjoint",
            "with adjoint",
            "paths",
        ],
        [[expected, w, r, p]],
    );
    let panel = |label: &str, image| Panel::tonemapped(label, image, 1.0).enlarged(4);
    fig.images(
        "facets",
        3,
        &[
            panel("adjoint weights", &right),
            panel("scattered like viewing rays", &wrong),
            panel("path tracer", &reference),
        ],
    );
    Ok(())
}
