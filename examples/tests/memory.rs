//! Memory of a gradient: bounded by its size and the threads, whatever the number of samples and the depth.

use examples::memory::{self, Counting};
use rayon::ThreadPoolBuilder;
use render::Job;
use render::image_io;
use render::instances::backward_f32;
use render::integrator::gradient::Active;
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Image, Scene, Settings};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

const MIB: usize = 1 << 20;

/// A room whose back wall shows the image.
fn room(dir: &std::path::Path, texels: usize) -> Scene {
    let mut image = Image::new(texels, texels);
    for (i, x) in image.data.iter_mut().enumerate() {
        *x = 0.2 + 0.6 * ((i * 7919) % 1000) as f32 / 1000.0;
    }
    image_io::write_exr(&dir.join("wall.exr"), &image).expect("a temporary file");
    let wall = |id: &str, transform: &str, bsdf: &str| {
        format!(
            r#"<shape type="rectangle" id="{id}"><transform name="to_world">{transform}</transform>{bsdf}</shape>"#
        )
    };
    let white = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf>"#;
    let body = [
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0, 0, 3.9" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/><rfilter type="box"/></film></sensor>
            <integrator type="path"><integer name="max_depth" value="8"/></integrator>"#.to_owned(),
        wall("back", r#"<translate z="-1"/>"#, r#"<bsdf type="diffuse" id="texwall"><texture type="bitmap" name="reflectance"><string name="filename" value="wall.exr"/></texture></bsdf>"#),
        wall("floor", r#"<rotate x="1" angle="-90"/><translate y="-1"/>"#, white),
        wall("left", r#"<rotate y="1" angle="90"/><translate x="-1"/>"#, white),
        wall("right", r#"<rotate y="1" angle="-90"/><translate x="1"/>"#, white),
        wall("light", r#"<scale value="0.5"/><rotate x="1" angle="90"/><translate y="0.99"/>"#, r#"<emitter type="area"><rgb name="radiance" value="9"/></emitter>"#),
        "</scene>".to_owned(),
    ]
    .concat();
    Scene::from_xml(&body, dir, &LoadOptions::default())
        .expect("a valid scene")
        .0
}

/// Peak of the bytes allocated during one gradient pass beyond those before it.
fn peak(scene: &Scene, threads: usize, spp: u64, max_depth: u32) -> usize {
    let pool = ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a pool");
    let settings = Settings {
        max_depth,
        rr_depth: u32::MAX,
        ..scene.settings
    };
    let theta = Theta::constant(scene.params().values());
    let active = Active::new(scene, &["texwall.reflectance.data"]).expect("known");
    let adjoint = vec![1.0; scene.film.pixels() * 3];
    pool.install(|| {
        let pass = || {
            let samples = 0..spp;
            backward_f32(
                &Job::new(scene, &settings, 1, samples, &()),
                &theta,
                &active,
                &adjoint,
            )
        };
        let (gradient, bytes) = memory::peak(pass);
        let gradient = gradient.expect("an adjoint of the right size");
        assert!(gradient.values[0].iter().any(|&x| x > 0.0));
        bytes
    })
}

/// At most (threads + 2) times the size of the gradient (f32) plus 32 MiB for 3.1 million values, and the
/// same within 5 % for 16 and 1024 samples per pixel and for depth 8 and 32. One test: the counter is shared.
#[test]
fn memory_of_a_gradient_is_bounded() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let texels = 1024;
    let scene = room(dir.path(), texels);
    let size = texels * texels * 3 * 4;
    for threads in [1, 2, 4] {
        let peak = peak(&scene, threads, 1, 8);
        println!("{threads} threads: {:.1} MiB", peak as f64 / MIB as f64);
        assert!(
            peak <= (threads + 2) * size + 32 * MIB,
            "{threads} threads: {peak} bytes"
        );
    }
    let base = peak(&scene, 2, 16, 8) as f64;
    for (spp, depth) in [(1024, 8), (16, 32)] {
        let other = peak(&scene, 2, spp, depth) as f64;
        println!("{spp} spp, depth {depth}: {:.4} of the base", other / base);
        assert!(
            (other / base - 1.0).abs() < 0.05,
            "{spp} spp, depth {depth}: {other} against {base}"
        );
    }
}
