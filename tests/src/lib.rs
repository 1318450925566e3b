//! What the cross-crate tests share: small scenes, statistics, common gradients and differences.

pub mod cases;
pub mod moving;
pub mod stats;

use std::path::{Path, PathBuf};

use ad_core::{Dual, Float};
use render::Job;
use render::estimator::{Capabilities, DetachedMis, Unbiased};
use render::instances::{Estimator, render_f32};
use render::integrator::gradient::{Active, backward};
use render::integrator::render::{Rendering, render};
use render::params::{ParamInfo, Tangent, Theta};
use render::sampler::Independent;
use render::scene::LoadOptions;
use render::{Scene, Settings};

use stats::Estimate;

/// The shared scenes and references that are not part of the repository: `$RENDER_SHARED`, or
/// `shared` beside the workspace; `None` with a message if absent.
pub fn shared_dir() -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared");
    let dir = std::env::var_os("RENDER_SHARED").map_or_else(|| default.into(), PathBuf::from);
    if dir.is_dir() {
        return Some(dir);
    }
    println!(
        "skipped: no shared scenes at {}; set RENDER_SHARED",
        dir.display()
    );
    None
}

/// A scene from the elements inside `<scene>`.
///
/// # Panics
/// If the text is not a valid scene: test data is written by hand.
pub fn scene(body: &str) -> Scene {
    with_warnings(body).0
}

/// The same, and what it warns of.
///
/// # Panics
/// As [`scene`].
pub fn with_warnings(body: &str) -> (Scene, Vec<String>) {
    let text = format!("<scene version=\"3.0.0\">{body}</scene>");
    match Scene::from_xml(&text, Path::new("."), &LoadOptions::default()) {
        Ok(loaded) => loaded,
        Err(e) => panic!("{e}\n{text}"),
    }
}

/// All parameters of a scene that detached sampling can differentiate.
pub fn smooth_params(scene: &Scene) -> Vec<ParamInfo> {
    let smooth = |i: &&ParamInfo| Capabilities::of::<DetachedMis>().sees(i.kind);
    scene
        .params()
        .infos()
        .iter()
        .filter(smooth)
        .cloned()
        .collect()
}

/// The parameter values in the scalar of a test.
pub fn values<P: Float>(scene: &Scene) -> Vec<P> {
    scene
        .params()
        .values()
        .iter()
        .map(|&v| P::from_f32(v))
        .collect()
}

/// The image over `P`.
pub fn image<P>(scene: &Scene, values: &[P], settings: &Settings, seed: u64, spp: u64) -> Rendering
where
    P: Float + render::integrator::render::Components,
{
    let theta = Theta::constant(values);
    render::<P, DetachedMis, Independent>(&Job::new(scene, settings, seed, 0..spp, &()), &theta)
        .expect("nothing moves")
}

/// One estimate per block of 4 x 4 pixels and channel, from `runs` seeds.
///
/// # Panics
/// If a sample is not finite.
pub fn picture(s: &Scene, settings: &Settings, seed: u64, runs: u64, spp: u64) -> Vec<Estimate> {
    let theta = Theta::constant(s.params().values());
    let images: Vec<_> = (0..runs)
        .map(|r| {
            let estimator = Estimator::Mis;
            let r = render_f32(
                &Job::new(s, settings, seed + r, 0..spp, &()),
                &theta,
                estimator,
            );
            assert_eq!(r.non_finite.count, 0);
            r.image(0).data
        })
        .collect();
    let size = s.film.crop_size[0] as usize;
    let block = |image: &[f32], x: usize, y: usize, c: usize| {
        let pixels = (0..16).map(|k| (y * 4 + k / 4) * size + x * 4 + k % 4);
        pixels.map(|p| f64::from(image[p * 3 + c])).sum::<f64>() / 16.0
    };
    let n = size / 4;
    (0..n * n * 3)
        .map(|i| {
            let of = |image: &Vec<f32>| block(image, i / 3 % n, i / 3 / n, i % 3);
            Estimate::of(&images.iter().map(of).collect::<Vec<_>>())
        })
        .collect()
}

/// `sum(adjoint x image)`.
pub fn dot(adjoint: &[f32], r: &Rendering, component: usize) -> f64 {
    let n = r.samples as f64;
    adjoint
        .iter()
        .zip(&r.sums[component])
        .map(|(a, s)| f64::from(*a) * s / n)
        .sum()
}

/// Derivative of `<adjoint, image>` along `direction` (one number per parameter), forward mode in f64.
pub fn forward(
    scene: &Scene,
    direction: &[f64],
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> f64 {
    forward_by::<DetachedMis>(scene, direction, adjoint, settings, seed, spp)
}

/// [`forward`] with another estimator.
///
/// # Panics
/// If it is refused there.
pub fn forward_by<S: Unbiased>(
    scene: &Scene,
    direction: &[f64],
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> f64 {
    let r = derivative_image::<S>(scene, direction, settings, seed, spp);
    dot(adjoint, &r, 1)
}

/// The image and its derivative along `direction`, forward mode over `f64`.
///
/// # Panics
/// As [`forward_by`], and on non-finite samples.
pub fn derivative_image<S: Unbiased>(
    scene: &Scene,
    direction: &[f64],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> Rendering {
    let values = values::<f64>(scene);
    let dual = |d: &f64| Dual::<f64, 1>::new(0.0, [*d]);
    let tangent = |d: &[f64]| {
        if d.iter().all(|d| *d == 0.0) {
            Tangent::None
        } else {
            Tangent::Dense(d.iter().map(dual).collect())
        }
    };
    let infos = scene.params().infos();
    let tangents: Vec<_> = infos
        .iter()
        .map(|i| tangent(&direction[i.range()]))
        .collect();
    let theta = Theta::with_tangents(&values, &tangents);
    let r = render::<Dual<f64, 1>, S, Independent>(
        &Job::new(scene, settings, seed, 0..spp, &()),
        &theta,
    )
    .expect("an estimator for this scene and these parameters");
    assert_eq!(r.non_finite.count, 0);
    r
}

/// Gradient of `<adjoint, image>` with respect to `params`, reverse mode over `P`.
///
/// # Panics
/// On non-finite samples and unknown names.
pub fn reverse<P: Float>(
    scene: &Scene,
    params: &[ParamInfo],
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> Vec<Vec<f64>> {
    reverse_by::<P, DetachedMis>(scene, params, adjoint, settings, seed, spp)
}

/// [`reverse`] with another estimator.
///
/// # Panics
/// As that.
pub fn reverse_by<P: Float, S: Unbiased>(
    scene: &Scene,
    params: &[ParamInfo],
    adjoint: &[f32],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> Vec<Vec<f64>> {
    let values = values::<P>(scene);
    let theta = Theta::constant(&values);
    let names: Vec<&str> = params.iter().map(|i| i.name.as_str()).collect();
    let active = Active::new(scene, &names).expect("known names");
    let g = backward::<P, S, Independent>(
        &Job::new(scene, settings, seed, 0..spp, &()),
        &theta,
        &active,
        adjoint,
    )
    .expect("an adjoint of the right size");
    assert_eq!(g.non_finite.count, 0);
    g.values
}

/// The adjoint of the mean over pixels and channels.
pub fn mean_adjoint(scene: &Scene) -> Vec<f32> {
    let n = scene.film.pixels() * 3;
    vec![1.0 / n as f32; n]
}

/// Asserts that a result is the same on 1, 2 and 7 threads, and returns it.
///
/// # Panics
/// If it is not.
pub fn on_any_threads<T: PartialEq + Send>(result: impl Fn() -> T + Sync) -> T {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool").install(&result)
    };
    let one = run(1);
    for threads in [2, 7] {
        assert!(run(threads) == one, "{threads} threads differ");
    }
    one
}
