//! Without the adjoint, shading normals make particles jump across edges [Veach 1996, figure 1 b].

use ad_core::Vec3;
use render::Film;
use render::bsdf::kernel::Rules;
use render::shape::Mesh;

use super::facets::{SETTINGS, camera, roof};
use super::{IGNORED, particles, paths};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{POSITIVE, SceneBuilder};

/// Tilt of the two facets, and the angles of light and eye from the vertical, on opposite sides.
const FACET: f64 = 20.0;
const LIGHT: f64 = -33.0;
const EYE: f64 = 33.0;

/// `veach-01b`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = 64u32;
    let mut builder = SceneBuilder::default();
    let white = builder.matt("white", [0.8; 3])?;
    builder.shape("facets", Mesh::new(roof(FACET, 3.0), false)?, &white);
    // Light and view are practically parallel.
    let far = 500.0;
    let at = |degrees: f64| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        [far * sin, far * cos, 0.0]
    };
    let (light, eye) = (at(LIGHT), at(EYE));
    // Only what the facets need: a spot would do as well, but its edge is a function of the angle.
    let axis = light.map(|x| -x);
    let intensity = builder
        .build
        .rgb("lamp.intensity.value", [far * far; 3], POSITIVE)?;
    let spot = render::emitter::Spot::new(intensity, light, axis, 0.45, 0.46)
        .ok_or("a spot without axis")?;
    builder.build.add_emitter(spot, None);
    let camera = camera(eye, [0.0, 0.0, 1.0], 0.2, size)?;
    let scene = builder
        .build
        .build(camera, Film::new(size, size), SETTINGS)?;

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
