//! Finite elements: duality, derivatives, energy, agreement with the path tracer, messages.

use render::Job;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{Conductor, Diffuse, RoughConductor, Roughness};
use render::camera::{Camera, FovAxis};
use render::emitter::Area;
use render::finite_element::discrete::Patches;
use render::finite_element::{FiniteElementError, FiniteElements, Options};
use render::instances::{Estimator, render_f32};
use render::math::Transform;
use render::params::Theta;
use render::scene::Builder;
use render::shape::{Patch, Rectangle, Sphere};
use render::{Film, Scene, Settings};

/// A box seen from the front with a lamp below the ceiling; the back wall is metal if `glossy`.
fn room(glossy: bool, power: f64, exponent: f32) -> Scene {
    seen_from([0.0, 0.0, 3.9], glossy, power, exponent)
}

/// The same box with the eye elsewhere, looking at the middle.
fn seen_from(eye: [f64; 3], glossy: bool, power: f64, exponent: f32) -> Scene {
    let mut b = Builder::new();
    let unit = (0.0, 1.0);
    let mut matt = |name: &str, rgb| {
        let reflectance = b
            .rgb(&format!("{name}.reflectance.value"), rgb, unit)
            .unwrap();
        b.add_material(Diffuse { reflectance })
    };
    let white = matt("white", [0.7, 0.6, 0.5]);
    let red = matt("red", [0.6, 0.1, 0.05]);
    let black = matt("black", [0.0; 3]);
    let alpha = b.scalar("metal.alpha.value", 0.3, (1e-4, 1.0)).unwrap();
    let specular_reflectance = b
        .rgb("metal.reflectance.value", [0.8, 0.7, 0.6], unit)
        .unwrap();
    let roughness = Roughness {
        kind: Ndf::Ggx,
        alpha,
        visible: true,
    };
    let conductor = Conductor {
        specular_reflectance,
        index: None,
    };
    let metal = b.add_material(RoughConductor {
        roughness,
        conductor,
    });
    let mut quad = |name: &str, [c, e1, e2]: [[f64; 3]; 3], m| {
        b.add_shape(name, Rectangle(Patch::new(c, e1, e2, false).unwrap()), m)
    };
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c| -c);
    quad("floor", [[-1.0, -1.0, 1.0], x, minus(z)], white);
    quad("ceiling", [[-1.0, 1.0, -1.0], x, z], white);
    quad(
        "back",
        [[-1.0, -1.0, -1.0], x, y],
        if glossy { metal } else { white },
    );
    quad("left", [[-1.0, -1.0, 1.0], minus(z), y], red);
    quad("right", [[1.0, -1.0, -1.0], z, y], white);
    let lamp = [[-0.3, 0.9, -0.3], [0.6, 0.0, 0.0], [0.0, 0.0, 0.6]];
    let shape = quad("lamp", lamp, black);
    let radiance = b
        .rgb(
            "lamp.radiance.value",
            [power, power, 0.5 * power],
            (0.0, 1e9),
        )
        .unwrap();
    b.add_emitter(
        Area {
            radiance,
            exponent,
            shape,
        },
        Some(shape),
    );
    let view = Transform::look_at(eye, [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
    let camera = Camera::new(view, 30.0, FovAxis::Smaller, [48, 48]).unwrap();
    let settings = Settings {
        max_depth: 24,
        rr_depth: 5,
        spp: 1,
        ..Settings::default()
    };
    b.build(camera, Film::new(48, 48), settings).unwrap()
}

fn options(importance: bool) -> Options {
    Options {
        directions: 10,
        importance,
        finest: 1.0 / 1024.0,
        ..Options::default()
    }
}

fn solved(scene: &Scene, tolerance: f64) -> FiniteElements<'_> {
    let mut fem = FiniteElements::new(scene, options(true)).unwrap();
    for k in [4.0, 2.0, 1.0] {
        fem.solve().unwrap();
        fem.refine(k * tolerance);
    }
    fem.solve_to(1e-14, true).unwrap();
    fem
}

#[test]
fn importance_and_radiance_measure_the_same() {
    for (glossy, exponent) in [(false, 0.0), (true, 0.0), (true, 30.0)] {
        let scene = room(glossy, 5.0, exponent);
        let fem = solved(&scene, 1e-3);
        let (a, b) = (fem.cost(), fem.cost_by_importance());
        assert!(fem.links().len() > 500, "{} links", fem.links().len());
        assert!(
            a > 0.0 && (a - b).abs() < 1e-12 * a,
            "{glossy} {exponent}: {a} {b}"
        );
    }
}

#[test]
fn one_importance_solution_gives_all_derivatives() {
    let scene = room(true, 5.0, 5.0);
    let mut fem = solved(&scene, 3e-3);
    let names: Vec<String> = scene
        .params()
        .infos()
        .iter()
        .map(|i| i.name.clone())
        .collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let gradient = fem.gradient(&names).unwrap();
    let theta: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let mut checked = 0;
    for (info, g) in scene.params().infos().iter().zip(&gradient) {
        for (i, value) in info.range().zip(&g.values) {
            let mut at = |h: f64| {
                let mut moved = theta.clone();
                moved[i] += h;
                fem.set_params(&moved).unwrap();
                fem.solve_to(1e-14, false).unwrap();
                fem.cost()
            };
            // Fourth order: 1e-12 of truncation, 1e-13 of rounding over the step.
            let h = 1e-3 * theta[i].max(0.1);
            let d = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
            assert!(
                (d - value).abs() <= 1e-6 * value.abs() + 1e-12,
                "{}: {d} {value}",
                info.name
            );
            checked += usize::from(value.abs() > 1e-4);
        }
    }
    assert!(checked >= 12, "only {checked} derivatives are not zero");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_picture_is_that_of_the_path_tracer() {
    for (glossy, exponent) in [(false, 0.0), (true, 0.0), (false, 10.0)] {
        let scene = room(glossy, 5.0, exponent);
        let fem = solved(&scene, 3e-5);
        let theta = Theta::constant(scene.params().values());
        let settings = scene.settings;
        let traced = render_f32(
            &Job::new(&scene, &settings, 3, 0..256, &()),
            &theta,
            Estimator::Mis,
        )
        .image(0);
        let (ours, cells) = (fem.flat(), fem.surfaces());
        // Means over 4 x 4 patches of each surface.
        let mut sums = std::collections::BTreeMap::<(u32, usize, usize), [f64; 3]>::new();
        for (i, c) in cells.iter().enumerate() {
            if let Some((root, [u, v])) = c {
                let key = (*root, (u * 4.0) as usize, (v * 4.0) as usize);
                let s = sums.entry(key).or_default();
                s[0] += f64::from(ours.data[3 * i..3 * i + 3].iter().sum::<f32>());
                s[1] += f64::from(traced.data[3 * i..3 * i + 3].iter().sum::<f32>());
                s[2] += 1.0;
            }
        }
        let patches: Vec<_> = sums.values().filter(|s| s[2] >= 6.0).collect();
        let n = patches.len() as f64;
        let mean = patches.iter().map(|s| s[1] / s[2]).sum::<f64>() / n;
        let square = patches
            .iter()
            .map(|s| ((s[0] - s[1]) / s[2]).powi(2))
            .sum::<f64>()
            / n;
        let rms = square.sqrt() / mean;
        assert!(rms < 0.03, "glossy {glossy} exponent {exponent}: rms {rms}");
    }
}

/// A basis whose steps are wider than the lobe of the metal: the last reflection does not go through it.
#[test]
fn lobes_that_are_seen_are_sharper_than_the_basis() {
    let scene = room(true, 5.0, 0.0);
    let picture = |directions| {
        let mut fem = FiniteElements::new(
            &scene,
            Options {
                directions,
                ..options(false)
            },
        )
        .unwrap();
        for _ in 0..6 {
            fem.solve().unwrap();
            fem.refine(1e-3);
        }
        fem.solve().unwrap();
        let seen = fem.surfaces();
        let metal = |i: &usize| {
            seen[*i].is_some_and(|(root, _)| fem.mesh().roots[root as usize].directions.side > 1)
        };
        let image = fem.flat();
        (0..seen.len())
            .filter(metal)
            .map(|i| f64::from(image.data[3 * i]))
            .collect::<Vec<_>>()
    };
    let (coarse, fine) = (picture(6), picture(20));
    let square = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>();
    let off = square(&mut coarse.iter().zip(&fine).map(|(a, b)| a - b));
    let rms = (off / square(&mut fine.iter().copied())).sqrt();
    assert!(
        coarse.len() > 100 && rms < 0.02,
        "{rms} over {}",
        coarse.len()
    );
}

#[test]
fn the_result_does_not_depend_on_threads() {
    let scene = room(true, 5.0, 0.0);
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let fem = solved(&scene, 3e-3);
            let mut bits: Vec<u32> = fem.flat().data.iter().map(|v| v.to_bits()).collect();
            bits.push(fem.links().len() as u32);
            bits.push(fem.cost_by_importance().to_bits() as u32);
            bits
        })
    };
    assert_eq!(bits(1), bits(3));
}

#[test]
fn a_lamp_without_power_is_dark_and_not_refined() {
    let scene = room(true, 0.0, 30.0);
    let mut fem = FiniteElements::new(&scene, options(true)).unwrap();
    fem.solve().unwrap();
    assert_eq!(fem.refine(1e-3), 0);
    assert_eq!((fem.cost(), fem.cost_by_importance()), (0.0, 0.0));
    assert!(fem.flat().data.iter().all(|&v| v == 0.0));
    let g = fem.gradient(&["lamp.radiance.value"]).unwrap();
    assert!(g[0].values.iter().all(|v| v.is_finite() && *v > 0.0));
}

/// In the plane of the floor, in the back wall, on the lamp, behind the wall: numbers, and the same from both ends.
#[test]
fn eyes_in_walls_are_no_accident() {
    for eye in [
        [0.2, -1.0, 0.5],
        [0.1, 0.2, -1.0],
        [0.1, 0.9, 0.1],
        [0.0, 0.1, -2.0],
    ] {
        let scene = seen_from(eye, true, 5.0, 5.0);
        let fem = solved(&scene, 1e-2);
        let (a, b) = (fem.cost(), fem.cost_by_importance());
        assert!(
            a.is_finite() && (a - b).abs() <= 1e-12 * a.abs(),
            "{eye:?}: {a} {b}"
        );
        let all = [fem.flat(), fem.interpolated()];
        assert!(
            all.iter().all(|i| i.data.iter().all(|v| v.is_finite())),
            "{eye:?}"
        );
    }
}

/// Rectangles without an area are no shapes; a sliver is an element like others.
#[test]
fn slivers_have_finite_light() {
    assert!(Patch::new([0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], false).is_none());
    assert!(Patch::new([0.0; 3], [0.0; 3], [0.0, 1.0, 0.0], false).is_none());
    let mut b = Builder::new();
    let reflectance = b.rgb("white", [0.5; 3], (0.0, 1.0)).unwrap();
    let white = b.add_material(Diffuse { reflectance });
    let mut quad = |name: &str, c, e1, e2| {
        let patch = Patch::new(c, e1, e2, false).unwrap();
        b.add_shape(name, Rectangle(patch), white)
    };
    quad("wall", [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    quad(
        "sliver",
        [-1.0, 0.3, 0.5],
        [2.0, 0.0, 0.0],
        [0.0, 0.0, 1e-3],
    );
    let lamp = quad("lamp", [-0.5, 0.5, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]);
    let radiance = b.rgb("radiance", [3.0; 3], (0.0, 1e9)).unwrap();
    let exponent = 0.0;
    let light = Area {
        radiance,
        exponent,
        shape: lamp,
    };
    b.add_emitter(light, Some(lamp));
    let view = Transform::look_at([0.0, -0.5, 3.9], [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
    let camera = Camera::new(view, 40.0, FovAxis::Smaller, [16, 16]).unwrap();
    let film = Film::new(16, 16);
    let scene = b.build(camera, film, Settings::default()).unwrap();
    let fem = solved(&scene, 1e-3);
    let (a, b) = (fem.cost(), fem.cost_by_importance());
    assert!(a > 0.0 && (a - b).abs() < 1e-12 * a, "{a} {b}");
    assert!(fem.flat().data.iter().all(|v| v.is_finite() && *v >= 0.0));
}

#[test]
fn what_is_not_supported_is_named() {
    let mut b = Builder::new();
    let reflectance = b.rgb("white", [0.5; 3], (0.0, 1.0)).unwrap();
    let white = b.add_material(Diffuse { reflectance });
    b.add_shape("marble", Sphere::new([0.0; 3], 1.0, false).unwrap(), white);
    let view = Transform::look_at([0.0, 0.0, 3.9], [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
    let camera = Camera::new(view, 30.0, FovAxis::Smaller, [8, 8]).unwrap();
    let scene = b
        .build(camera, Film::new(8, 8), Settings::default())
        .unwrap();
    let error = FiniteElements::new(&scene, Options::default()).unwrap_err();
    assert!(error.to_string().contains("marble"), "{error}");

    let scene = room(true, 1.0, 0.0);
    let few = Options {
        directions: 1,
        ..Options::default()
    };
    assert!(matches!(
        FiniteElements::new(&scene, few),
        Err(FiniteElementError::Value {
            what: "directions",
            ..
        })
    ));
    let mut fem = FiniteElements::new(&scene, options(true)).unwrap();
    assert!(fem.set_params(&[0.5; 3]).is_err());
    assert!(fem.gradient(&["nobody"]).is_err());
}

/// Random patches with a reciprocal BRDF, or one that is not.
fn patches(reciprocal: bool) -> (Patches, Vec<f64>, Vec<f64>) {
    let n = 7;
    let mut state = 1u64;
    let mut random = move || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut p = Patches {
        patches: n,
        geometry: vec![0.0; n * n],
        brdf: vec![0.0; n * n * n],
    };
    for x in 0..n {
        for y in 0..x {
            let g = random();
            p.geometry[x * n + y] = g;
            p.geometry[y * n + x] = g;
        }
    }
    for k in 0..n * n * n {
        p.brdf[k] = random() * 0.2;
    }
    if reciprocal {
        for (x, y, z) in (0..n * n * n).map(|k| (k / n / n, k / n % n, k % n)) {
            p.brdf[(z * n + y) * n + x] = p.brdf[(x * n + y) * n + z];
        }
    }
    let field = |f: &mut dyn FnMut() -> f64| (0..n * n).map(|_| f()).collect::<Vec<_>>();
    let (light, eye) = (field(&mut random), field(&mut random));
    (p, light, eye)
}

#[test]
fn operators_between_patches_are_adjoint_and_importance_is_radiance() {
    for reciprocal in [true, false] {
        let (p, light, outgoing) = patches(reciprocal);
        let eye = p.arriving(&outgoing);
        let l = Patches::solve(&light, |x| p.transport(x)).unwrap();
        let gamma = Patches::solve(&eye, |x| p.adjoint(x)).unwrap();
        let close = |a: f64, b: f64| (a - b).abs() < 1e-12 * a.abs();
        assert!(close(
            Patches::inner(&p.transport(&l), &gamma),
            Patches::inner(&l, &p.adjoint(&gamma))
        ));
        assert!(close(
            Patches::inner(&eye, &l),
            Patches::inner(&gamma, &light)
        ));
        // Outgoing importance as if it were radiance.
        let out = Patches::solve(&outgoing, |x| p.transport(x)).unwrap();
        let arrives = p.arriving(&out);
        let largest = gamma.iter().fold(0.0, |m: f64, v| m.max(*v));
        let off = arrives
            .iter()
            .zip(&gamma)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert_eq!(off < 1e-12 * largest, reciprocal, "{}", off / largest);
    }
}
