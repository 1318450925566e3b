//! Texels of an environment as parameters: samples that stay and samples that move with the light they were
//! chosen for [Zeltner 2021, section 4.2.2].

use std::f64::consts::{PI, TAU};

use render::Job;
use render::emitter::Envmap;
use render::instances::Estimator;
use render::math::Transform;
use render::params::Theta;
use render::sampler::mix64;
use render::{Image, Scene};

use crate::statistics::variance;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 4220;
/// Samples per pixel.
const SPP: u64 = 64;
/// Texels of the map.
const SIZE: [usize; 2] = [16, 8];

/// The environment map: smooth and bright on one side of the horizon, or of independent texels.
fn sky(smooth: bool) -> Image {
    let [width, height] = SIZE;
    let mut image = Image::new(width, height);
    for (i, texel) in image.data.chunks_exact_mut(3).enumerate() {
        let x = (i % width) as f64 / width as f64 * TAU;
        let y = (i / width) as f64 / (height - 1) as f64 * PI;
        let any = mix64(i as u64 + 1) as f64 / u64::MAX as f64;
        let light = if smooth {
            1.0 + 0.5 * (x + 1.0).sin() * y.sin()
        } else {
            (2.0 * any).powi(3)
        };
        texel.fill(light as f32);
    }
    image
}

/// A floor under the map.
fn floor(map: &Image) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let material = builder.matt("floor", [0.5; 3])?;
    let sides = [[2.0, 0.0, 0.0], [0.0, 0.0, -2.0]];
    builder.quad("floor", [[-1.0, 0.0, 1.0], sides[0], sides[1]], &material)?;
    let sky = Envmap::new(
        builder.build.registry(),
        "sky",
        map,
        &Transform::IDENTITY,
        1.0,
    )?;
    builder.build.add_emitter(sky, None);
    let view = View {
        eye: [0.0, 1.6, 2.8],
        target: [0.0; 3],
        fov: 30.0,
        size: [8, 8],
    };
    builder.finish(&view, 2)
}

/// Variances of the gradient of the mean of the picture: of single texels, added up, and of a common factor of
/// all.
fn spread(scene: &Scene, e: Estimator, repeats: u64) -> Result<[f64; 2]> {
    let active = e.active(scene, &["sky.data"])?;
    let values = scene.params().values();
    let sky = &values[scene.params().find("sky.data")?.range()];
    let theta = Theta::constant(values);
    let n = scene.film.pixels() * 3;
    let adjoint = vec![1.0 / n as f32; n];
    let (mut texels, mut factors) = (Vec::new(), Vec::new());
    for r in 0..repeats {
        let seed = SEED + 1000 * u64::from(e == Estimator::EmitterAttached) + r;
        let samples = 0..SPP;
        let settings = &scene.settings;
        let g = e.backward_f32(
            &Job::new(scene, settings, seed, samples, &()),
            &theta,
            &active,
            &adjoint,
        )?;
        let g = &g.values[0];
        texels.push(g.chunks_exact(3).map(|t| t.iter().sum()).collect());
        let factor = g.iter().zip(sky).map(|(g, v)| g * f64::from(*v));
        factors.push(vec![factor.sum()]);
    }
    Ok([variance(&texels), variance(&factors)])
}

/// Checks under which maps samples that move with the texels reduce the variance.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn measure(fig: &mut Figure) -> Result {
    let repeats = fig.pick(48, 512);
    let mut rows = Vec::new();
    for smooth in [true, false] {
        let scene = floor(&sky(smooth))?;
        let detached = spread(&scene, Estimator::Emitter, repeats)?;
        let attached = spread(&scene, Estimator::EmitterAttached, repeats)?;
        let [texels, factor] = [0, 1].map(|k| attached[k] / detached[k]);
        let (statement, right) = if smooth {
            (
                "under a smooth map, derivatives by single texels vary less if samples move with them",
                texels < 0.5,
            )
        } else {
            (
                "under a map of independent texels, they vary more",
                texels > 2.0,
            )
        };
        fig.check(
            statement,
            right,
            format!("variance {texels:.3} of that of samples that stay"),
        );
        fig.check(
            "a common factor of all texels moves nothing, so that its derivative varies as much",
            (0.4..2.5).contains(&factor),
            format!("{factor:.2}"),
        );
        let kind = f64::from(u8::from(smooth));
        rows.push([kind, detached[0], attached[0], detached[1], attached[1]]);
    }
    let header = [
        "smooth",
        "texels_detached",
        "texels_attached",
        "factor_detached",
        "factor_attached",
    ];
    fig.csv("texels", &header, rows);
    Ok(())
}
