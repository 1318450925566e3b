//! Shading normals gain energy [Veach 1996, figure 1 a].

use render::Job;
use render::instances::particle_map_f32;
use render::params::Theta;
use render::shape::{Mesh, Sphere};
use render::{Film, Scene, Settings};

use super::facets::{SETTINGS, camera, lamp, roof};
use super::paths;
use super::tab_2_5::albedo;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::scene_builder::SceneBuilder;

/// Two surfaces tilted by 80 degrees, shaded as if they faced the small light above them, in a black shell that
/// catches what they reflect.
fn gaining() -> Result<(Scene, u32, u32)> {
    let mut builder = SceneBuilder::default();
    let white = builder.matt("white", [1.0; 3])?;
    let black = builder.matt("black", [0.0; 3])?;
    let mesh = builder.shape("roof", Mesh::new(roof(80.0, 1.0), false)?, &white);
    let shell = Sphere::new([0.0; 3], 50.0, true).ok_or("a ball without radius")?;
    let shell = builder.shape("shell", shell, &black);
    lamp(&mut builder, [0.0, 20.0, 0.0], 400.0)?;
    let camera = camera([0.0, 6.0, 0.1], [0.0, 0.0, -1.0], 30.0, 96)?;
    let settings = Settings {
        max_depth: 3,
        ..SETTINGS
    };
    Ok((
        builder.build.build(camera, Film::new(96, 96), settings)?,
        mesh,
        shell,
    ))
}

/// `veach-01a`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
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
    let map = particle_map_f32(
        &Job::new(&scene, &scene.settings, 1, 0..spp, &()),
        &theta,
        0.1,
    )?;
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
