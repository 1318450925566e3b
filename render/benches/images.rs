//! Whole images and gradients on one thread: what a change costs or saves for those who render.
//!
//! Criterion keeps a baseline per machine in `target/criterion`:
//!
//! ```text
//! cargo bench -p render --bench images -- --save-baseline before
//! cargo bench -p render --bench images -- --baseline before
//! ```

use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, Throughput};
use rayon::ThreadPoolBuilder;
use render::instances::{Estimator, render_f32};
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Image, Job, Scene, image_io};

const SIZE: u32 = 64;
const SPP: u64 = 16;
/// Texels per side of the textured wall.
const TEXELS: usize = 256;

/// Four rough plates under four balls of light, after figure 4.19 of [Zeltner 2021].
const PLATES: &str = r#"<scene version="3.0.0"><default name="res" value="64"/>
    <integrator type="path"><integer name="max_depth" value="4"/></integrator>
    <sensor type="perspective"><float name="fov" value="28"/>
        <transform name="to_world"><lookat origin="0, 2, 15" target="0, 0, 2.5" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="$res"/>
        <rfilter type="box"/></film></sensor>
    <shape type="rectangle"><transform name="to_world"><scale value="12"/><rotate x="1" angle="-90"/><translate y="-4"/></transform>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.4"/></bsdf></shape>"#;

/// The file with more inside, by the name that it has in `examples/scenes`.
fn file(name: &str, change: impl Fn(String) -> String) -> Scene {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples/scenes");
    let text = std::fs::read_to_string(folder.join(name)).expect("a scene of the examples");
    scene(&change(text))
}

fn scene(text: &str) -> Scene {
    let options = LoadOptions {
        defines: vec![("res".into(), SIZE.to_string())],
        ..LoadOptions::default()
    };
    let (scene, _) = Scene::from_xml(text, Path::new("."), &options).expect("a scene");
    scene
}

fn plates() -> Scene {
    let mut text = PLATES.to_owned();
    for (k, (alpha, angle)) in [(0.01, -35.0), (0.05, -48.0), (0.1, -60.0), (0.3, -72.0)]
        .into_iter()
        .enumerate()
    {
        let (y, z) = (1.0 - 1.2 * k as f64, 0.5 + 1.4 * k as f64);
        text += &format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale x="4" y="0.6" z="1"/><rotate x="1" angle="{angle}"/><translate y="{y}" z="{z}"/></transform>
            <bsdf type="roughconductor" id="plate-{k}"><string name="material" value="Cu"/><float name="alpha" value="{alpha}"/></bsdf></shape>"#
        );
    }
    for (x, radius) in [(-3.75, 0.033), (-1.25, 0.1), (1.25, 0.3), (3.75, 0.9)] {
        let power = 1.0 / (radius * radius);
        text += &format!(
            r#"<shape type="sphere"><point name="center" value="{x}, 5, 0"/><float name="radius" value="{radius}"/>
            <emitter type="area"><rgb name="radiance" value="{power}"/></emitter></shape>"#
        );
    }
    scene(&(text + "</scene>"))
}

/// The Cornell box with a left wall of many texels.
fn textured() -> Scene {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("wall.exr");
    let mut wall = Image::new(TEXELS, TEXELS);
    for (i, x) in wall.data.iter_mut().enumerate() {
        *x = 0.2 + 0.6 * (i % 7) as f32 / 6.0;
    }
    image_io::write_exr(&path, &wall).expect("a picture");
    let map = format!(
        r#"<texture name="reflectance" type="bitmap"><string name="filename" value="{}"/></texture>"#,
        path.display()
    );
    let plain = r#"<rgb name="reflectance" value="0.65, 0.05, 0.05"/>"#;
    file("cornell.xml", |text| {
        assert!(text.contains(plain), "a red wall");
        text.replace(plain, &map)
    })
}

fn main() {
    let mut criterion = Criterion::default()
        .configure_from_args()
        .sample_size(20)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_secs(5));
    let same = |text| text;
    let albedos = ["red.reflectance.value", "white.reflectance.value"];
    let cases = [
        (
            "cornell",
            file("cornell.xml", same),
            Estimator::Mis,
            &albedos[..],
        ),
        (
            "textured-box",
            textured(),
            Estimator::Mis,
            &["red.reflectance.data"],
        ),
        (
            "plates",
            plates(),
            Estimator::Mis,
            &["plate-0.alpha.value", "plate-3.alpha.value"],
        ),
        (
            "metal-boxes",
            file("metal-boxes.xml", same),
            Estimator::DifferentialMis,
            &["gold.alpha.value", "copper.alpha.value"],
        ),
    ];
    let pool = ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a thread");
    for (name, scene, estimator, names) in &cases {
        let theta = Theta::constant(scene.params().values());
        let adjoint = vec![1.0; scene.film.pixels() * 3];
        let active = estimator.active(scene, names).expect("parameters");
        let job = Job::new(scene, &scene.settings, 0, 0..SPP, &());
        let mut group = criterion.benchmark_group(*name);
        group.throughput(Throughput::Elements(scene.film.pixels() as u64 * SPP));
        group.bench_function("image", |b| {
            let image = || render_f32(&job, &theta, Estimator::Mis);
            pool.install(|| b.iter(|| black_box(image())));
        });
        group.bench_function("gradient", |b| {
            let gradient = || estimator.backward_f32(&job, &theta, &active, &adjoint);
            pool.install(|| b.iter(|| black_box(gradient().expect("a gradient"))));
        });
        group.finish();
    }
    criterion.final_summary();
}
