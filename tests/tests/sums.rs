//! Gradients of textures are as good for dim scenes and small adjoints as for bright and large ones, also beside each
//! other. Large ranges are summed in integers, whose quantum must not decide about that.

use render::Job;
use render::instances::{
    Direction, Estimator, backward_particles_f32, forward_f32, hessian_vector_f32,
};
use render::integrator::gradient::Active;
use render::params::{ParamInfo, Theta};
use render::sampler::mix64;
use render::{Image, Scene, image_io};
use tests::{dot, on_any_threads, reverse, scene};

const SIDE: usize = 64;
const TEXTURES: [&str; 2] = ["floor.reflectance.data", "wall.reflectance.data"];

/// Two textured plates, one standing on the other, under a lamp of this radiance, 16 x 16 pixels.
fn plates(radiance: f64, max_depth: u32) -> Scene {
    let dir = tempfile::tempdir().expect("a folder");
    let mut image = Image::new(SIDE, SIDE);
    let texels = image.data.iter_mut().enumerate();
    texels.for_each(|(i, x)| *x = 0.5 + 0.3 * (i as f32).sin());
    let path = dir.path().join("texture.exr");
    image_io::write_exr(&path, &image).expect("a folder to write to");
    let plate = |id: &str, at: &str| {
        format!(
            r#"<shape type="rectangle"><transform name="to_world"><scale value="2"/>{at}</transform>
            <bsdf type="diffuse" id="{id}"><texture type="bitmap" name="reflectance">
            <string name="filename" value="{}"/><boolean name="raw" value="true"/></texture></bsdf></shape>"#,
            path.display()
        )
    };
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="50"/>
        <transform name="to_world"><lookat origin="0, 2, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="16"/><integer name="height" value="16"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="{max_depth}"/></integrator>{}{}
        <shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/>
        <translate y="3"/></transform><emitter type="area" id="lamp"><rgb name="radiance" value="{radiance:e}"/>
        </emitter></shape>"#,
        plate("floor", r#"<rotate x="1" angle="-90"/><translate y="-1"/>"#),
        plate("wall", r#"<translate z="-1.5"/>"#),
    ))
}

fn textures(s: &Scene) -> Vec<ParamInfo> {
    TEXTURES
        .map(|name| s.params().find(name).expect("a texture").clone())
        .to_vec()
}

fn noise(i: usize) -> f64 {
    mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

/// Forward and reverse mode of the same paths along directions that move one of sixteen tiles of a texture each,
/// against the sum of the magnitudes in the tile. Both follow the paths in single precision.
fn modes_agree(s: &Scene, adjoint: &[f32], what: &str) {
    let params = textures(s);
    let (seed, spp) = (3, 8);
    let gradient = reverse::<f32>(s, &params, adjoint, &s.settings, seed, spp);
    for (info, gradient) in params.iter().zip(&gradient) {
        let tile = |i: usize| (i / 3 % SIDE) / 16 + (i / 3 / SIDE) / 16 * 4;
        let moved = |k: usize, i: usize| if tile(i) == k { noise(i) as f32 } else { 0.0 };
        let directions: Vec<Direction> = (0..16)
            .map(|k| {
                let v = (0..gradient.len()).map(|i| moved(k, i)).collect();
                Direction::Dense(s.params().handle(info), v)
            })
            .collect();
        let values = s.params().values();
        let forward = forward_f32(
            &Job::new(s, &s.settings, seed, 0..spp, &()),
            values,
            &directions,
        );
        let forward = forward.expect("directions of the right size");
        let mut seen = 0;
        for k in 0..16 {
            let expected = dot(adjoint, &forward, k + 1);
            let terms = || {
                gradient
                    .iter()
                    .enumerate()
                    .map(|(i, g)| g * f64::from(moved(k, i)))
            };
            let (found, scale) = (terms().sum::<f64>(), terms().map(f64::abs).sum::<f64>());
            assert!(
                (found - expected).abs() <= 2e-4 * scale && scale.is_finite(),
                "{what}, {}, tile {k}: reverse {found:e}, forward {expected:e}, of {scale:e}",
                info.name
            );
            seen += usize::from(scale > 0.0);
        }
        assert!(seen >= 8, "{what}: only {seen} tiles are seen");
    }
}

#[test]
fn every_radiance_has_its_gradient() {
    for exponent in (-30..=30).step_by(4) {
        let s = plates(10f64.powi(exponent), 4);
        modes_agree(&s, &adjoint_of(&s), &format!("radiance 1e{exponent}"));
    }
}

#[test]
fn adjoints_of_mixed_sizes_have_their_gradient() {
    for (radiance, lo, hi) in [
        (1.0, -6, 6),
        (1.0, -25, 25),
        (1e-12, -15, 30),
        (1e12, -30, 15),
    ] {
        // Paths that see one another's tiles, and paths that do not.
        for depth in [2, 4] {
            let s = plates(radiance, depth);
            let size =
                |pixel: usize| 10f64.powi(lo + (mix64(pixel as u64) % (hi - lo + 1) as u64) as i32);
            let adjoint: Vec<f32> = (0..s.film.pixels() * 3)
                .map(|i| (noise(i) * size(i / 3)) as f32)
                .collect();
            modes_agree(&s, &adjoint, &format!("adjoints from 1e{lo} to 1e{hi}"));
            on_any_threads(|| reverse::<f32>(&s, &textures(&s), &adjoint, &s.settings, 3, 8));
        }
    }
}

/// One pixel of the background with a huge adjoint costs the texels that it does not see nothing, each by itself.
#[test]
fn one_large_adjoint_costs_the_others_nothing() {
    let s = plates(1.0, 2);
    let params = textures(&s);
    let ordinary = vec![1e-3f32; s.film.pixels() * 3];
    let of = |adjoint: &[f32]| reverse::<f32>(&s, &params, adjoint, &s.settings, 3, 64).concat();
    let expected = of(&ordinary);
    for size in [1e10, 1e12, 1e30] {
        // The upper left one, above the plates, and one on the floor.
        for pixel in [0, 13 * 16 + 8] {
            let mut adjoint = ordinary.clone();
            adjoint[pixel * 3..][..3].fill(size);
            let mut alone = vec![0.0; adjoint.len()];
            alone[pixel * 3..][..3].fill(1.0);
            let touched = of(&alone);
            let found = of(&adjoint);
            let mut checked = 0;
            for ((found, expected), touched) in found.iter().zip(&expected).zip(&touched) {
                if *touched == 0.0 {
                    assert!(
                        (found - expected).abs() <= 1e-4 * expected.abs(),
                        "{size:e}: {found:e}, alone {expected:e}"
                    );
                    checked += usize::from(*expected > 0.0);
                }
            }
            assert!(checked > 1000, "{checked}");
        }
    }
}

/// Light is linear in the lamp, and so are all derivatives by texels: by paths, by particles, and of second order.
#[test]
fn all_passes_follow_the_scale_of_light() {
    type Pass = fn(&Scene, &Active) -> Vec<f64>;
    let paths: Pass = |s, active| {
        let image = adjoint_of(s);
        let theta = Theta::constant(s.params().values());
        let mut all = Vec::new();
        for estimator in [Estimator::Mis, Estimator::Detached] {
            let g = estimator.backward_f32(
                &Job::new(s, &s.settings, 1, 0..8, &()),
                &theta,
                active,
                &image,
            );
            all.extend(g.expect("an adjoint of the right size").values.concat());
        }
        all
    };
    let particles: Pass = |s, active| {
        let image = adjoint_of(s);
        let theta = Theta::constant(s.params().values());
        let g = backward_particles_f32(
            &Job::new(s, &s.settings, 1, 0..64, &()),
            &theta,
            active,
            &image,
        );
        g.expect("an adjoint of the right size")
            .gradient
            .values
            .concat()
    };
    let second: Pass = |s, active| {
        let image = adjoint_of(s);
        let theta = Theta::constant(s.params().values());
        let direction: Vec<f32> = (0..active.len()).map(|i| noise(i + 17) as f32).collect();
        let images = [&image[..], &image[..]];
        let g = hessian_vector_f32(
            &Job::new(s, &s.settings, 1, 0..8, &()),
            &theta,
            active,
            &direction,
            images,
        );
        g.expect("images of the right size").values.concat()
    };
    for (name, pass) in [
        ("paths", paths),
        ("particles", particles),
        ("second order", second),
    ] {
        let of = |radiance: f64| {
            let s = plates(radiance, 4);
            pass(&s, &Active::new(&s, &TEXTURES).expect("textures"))
        };
        let expected = of(1.0);
        let size = expected.iter().map(|g| g.abs()).fold(0.0, f64::max);
        assert!(size > 0.0, "{name}");
        for exponent in [-90, -40, 40, 90] {
            let scale = f64::from(exponent).exp2();
            for (found, expected) in of(scale).iter().zip(&expected) {
                let error = (found / scale - expected).abs();
                assert!(
                    error <= 1e-3 * expected.abs() + 1e-7 * size,
                    "{name}, 2^{exponent}: {found:e} for {expected:e} x {scale:e}"
                );
            }
        }
    }
}

fn adjoint_of(s: &Scene) -> Vec<f32> {
    (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect()
}
