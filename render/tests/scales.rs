//! Factors on all that an emitter emits are parameters: under one light, an image is proportional to its factor.

use std::path::Path;

use render::image_io::write_exr;
use render::instances::{Direction, Estimator};
use render::params::Theta;
use render::scene::LoadOptions;
use render::{Image, Job, Scene};

const SPP: u64 = 4;

fn scene(folder: &Path, emitter: &str) -> Scene {
    let text = format!(
        r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="4"/><integer name="rr_depth" value="100"/></integrator>
        <sensor type="perspective"><float name="fov" value="50"/>
            <transform name="to_world"><lookat origin="0, 1, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
            <film type="hdrfilm"><integer name="width" value="12"/><integer name="height" value="9"/></film></sensor>
        <shape type="rectangle"><transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/><translate y="-0.6"/></transform></shape>
        <shape type="sphere"><float name="radius" value="0.6"/><bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></shape>
        {emitter}</scene>"#
    );
    Scene::from_xml(&text, folder, &LoadOptions::default())
        .unwrap_or_else(|e| panic!("{e}"))
        .0
}

fn lights(folder: &Path) -> [(Scene, &'static str, f64); 2] {
    let data = (0..3 * 8 * 4).map(|i| 0.1 + (i * 37 % 41) as f32 / 20.0);
    let sky = Image {
        width: 8,
        height: 4,
        data: data.collect(),
    };
    write_exr(&folder.join("sky.exr"), &sky).expect("a file");
    let env = r#"<emitter type="envmap" id="env"><string name="filename" value="sky.exr"/><float name="scale" value="1.75"/></emitter>"#;
    let beam = r#"<emitter type="projector" id="beam"><transform name="to_world"><lookat origin="1, 3, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
        <float name="fov" value="60"/><float name="scale" value="2.5"/>
        <texture name="irradiance" type="bitmap"><string name="filename" value="sky.exr"/></texture></emitter>"#;
    [
        (scene(folder, env), "env.scale", 1.75),
        (scene(folder, beam), "beam.scale", 2.5),
    ]
}

#[test]
fn images_are_proportional_to_the_scale() {
    let folder = tempfile::tempdir().expect("a folder");
    for (mut scene, key, scale) in lights(folder.path()) {
        assert_eq!(scene.params().get(key).expect(key), [scale as f32]);
        let all = [
            "mis",
            "detached",
            "emitter",
            "emitter-attached",
            "attached",
            "differential-mis",
        ];
        let mut asked = 0;
        for name in all {
            let e = Estimator::from_name(name).expect("an estimator");
            // Samples of scattered light never find what is a point.
            let lost = key == "beam.scale" && !e.capabilities().samples_emitters;
            if lost || e.check(&scene).is_err() {
                continue;
            }
            asked += 1;
            let job = Job::new(&scene, &scene.settings, 5, 0..SPP, &());
            let along = [Direction::uniform(scene.params(), key).expect(key)];
            let found = e
                .forward_f32(&job, scene.params().values(), &along)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            let (image, slope) = (found.image(0).data, found.image(1).data);
            assert!(image.iter().any(|x| *x > 0.1));
            for (x, d) in image.iter().zip(&slope) {
                let expected = f64::from(*x) / scale;
                assert!(
                    (f64::from(*d) - expected).abs() <= 1e-4 * expected.abs().max(1e-3),
                    "{key} {name}: {d} {expected}"
                );
            }
            let adjoint: Vec<f32> = (0..image.len()).map(|i| (i % 7) as f32 - 2.0).collect();
            let theta = Theta::constant(scene.params().values());
            let active = e.active(&scene, &[key]).expect(name);
            let gradient = e
                .backward_f32(&job, &theta, &active, &adjoint)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            let terms = adjoint.iter().zip(&slope);
            let expected: f64 = terms.map(|(a, d)| f64::from(a * d)).sum();
            let (got, size) = (gradient.values[0][0], f64::from(adjoint.len() as f32));
            assert!(
                (got - expected).abs() < 1e-4 * size,
                "{key} {name}: {got} {expected}"
            );
        }
        assert!(asked >= 3, "{key}: {asked}");
        // Twice as much, at the same samples.
        let render = |scene: &Scene| {
            let theta = Theta::constant(scene.params().values());
            let job = Job::new(scene, &scene.settings, 5, 0..SPP, &());
            render::instances::render_f32(&job, &theta, Estimator::Mis)
                .image(0)
                .data
        };
        let before = render(&scene);
        scene.set([(key, &[2.0 * scale as f32][..])]).expect(key);
        for (a, b) in before.iter().zip(render(&scene)) {
            assert!((2.0 * a - b).abs() <= 1e-5 * b.abs(), "{key}: {a} {b}");
        }
        scene.set([(key, &[0.0][..])]).expect(key);
        assert!(render(&scene).iter().all(|x| *x == 0.0));
        assert!(scene.set([(key, &[-1.0][..])]).is_err());
    }
}

#[test]
fn the_scale_of_a_file_is_written_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let [(mut scene, key, _), _] = lights(folder.path());
    scene.set([(key, &[0.625][..])]).expect(key);
    let saved = folder.path().join("new/scene.xml");
    scene.save(&saved).unwrap_or_else(|e| panic!("{e}"));
    let (again, _) = Scene::load(&saved, &LoadOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(again.params().get(key).expect(key), [0.625]);
}
