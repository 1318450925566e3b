//! Glints: the same light as paths find by themselves, where these do.

use std::sync::Arc;

use render::Job;
use render::bsdf::{Conductor, Diffuse, Interpolation, Material, NormalMap, TwoSided};
use render::camera::{Camera, FovAxis};
use render::emitter::{Area, Constant, Point, Vmf};
use render::estimator::DetachedMis;
use render::film::{Lobed, PixelFilter};
use render::instances::{Direction, Estimator, backward_f32, render_f32};
use render::integrator::gradient::Active;
use render::integrator::render::render;
use render::math::Transform;
use render::params::Theta;
use render::sampler::{Independent, mix64};
use render::scene::{
    Builder, GlintMethod, GlintRegion, GlintTechniques, GlintWeights, Glints, LoadOptions,
};
use render::shape::{Mesh, MeshData, Patch, Rectangle, Sphere};
use render::texture::{RgbTexture, Wrap};
use render::{Film, Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{
    forward_by, mean_adjoint, on_any_threads, picture, reverse_by, shared_dir, smooth_params,
    values,
};

const ALPHA: f64 = 1e-3;

#[derive(Clone, Copy, PartialEq)]
enum Form {
    Plane,
    Ball,
    /// The ball as triangles with interpolated normals.
    Mesh,
}

#[derive(Clone, Copy)]
enum Lit {
    /// A quad overhead, of this half side, as wide as bright.
    Lamp(f64),
    /// A lobe of the sky, this narrow.
    Sky(f64),
    Point,
    /// A ball of this radius where the point is, as bright.
    Bulb(f64),
}

/// A piece of metal under a normal map, and a light.
#[derive(Clone, Copy)]
struct Piece {
    form: Form,
    /// Texels of a side, and how often they repeat.
    texels: u32,
    tiles: f32,
    /// Size of slopes, and whether each texel has its own or they are waves.
    slope: f64,
    noise: bool,
    interpolation: Interpolation,
    wrap: Wrap,
    nearest: bool,
    two_sided: bool,
    parallel: bool,
    filter: PixelFilter,
    lit: Lit,
    /// Angle of view, degrees: of a ball, only the top is near enough to flat for a pixel.
    fov: f64,
    /// Pixels of a side.
    pixels: u32,
}

const PLANE: Piece = Piece {
    form: Form::Plane,
    texels: 16,
    tiles: 2.0,
    slope: 0.1,
    noise: true,
    interpolation: Interpolation::Slopes,
    wrap: Wrap::Repeat,
    nearest: false,
    two_sided: false,
    parallel: false,
    filter: PixelFilter::Box,
    lit: Lit::Lamp(0.6),
    fov: 30.0,
    pixels: 8,
};

const BALL: Piece = Piece {
    form: Form::Ball,
    texels: 16,
    tiles: 3.0,
    slope: 0.05,
    noise: false,
    fov: 6.0,
    ..PLANE
};

/// A number in [-1, 1) of a texel.
fn noise(i: u32, j: u32, k: u64) -> f64 {
    let bits = mix64(mix64(u64::from(i) ^ (k << 40)) ^ u64::from(j));
    (bits >> 11) as f64 * 2.0 / (1u64 << 53) as f64 - 1.0
}

fn normals(build: &mut Builder, piece: &Piece) -> RgbTexture {
    let n = piece.texels;
    let wave = |i: u32, j: u32| {
        let turn = |k: u32| std::f64::consts::TAU * f64::from(k) / f64::from(n);
        [turn(i).sin() * turn(j).cos(), (turn(j) + 0.4).sin()]
    };
    let texels: Vec<f32> = (0..n * n)
        .flat_map(|k| {
            let (i, j) = (k % n, k / n);
            let [x, y] = if piece.noise {
                [noise(i, j, 0), noise(i, j, 1)]
            } else {
                wave(i, j)
            };
            let [x, y] = [x, y].map(|x| -x * piece.slope);
            let z = (x * x + y * y + 1.0).sqrt().recip();
            [x * z, y * z, z].map(|c| (0.5 * c + 0.5) as f32)
        })
        .collect();
    let map = build.texels("normals", [n; 2], &texels, (-1.0, 2.0));
    let mut map = map.expect("valid");
    if let RgbTexture::Bitmap(b) = &mut map {
        b.wrap = piece.wrap;
        b.nearest = piece.nearest;
        b.to_uv.rows[0][0] = piece.tiles;
        b.to_uv.rows[1][1] = piece.tiles;
    }
    map
}

/// The unit ball as triangles, with its normals and the coordinates of its meridians.
fn globe() -> MeshData {
    let (rings, around) = (24u32, 48u32);
    let mut globe = MeshData::default();
    for i in 0..=rings {
        let turn = std::f64::consts::PI * f64::from(i) / f64::from(rings);
        for j in 0..=around {
            let phi = std::f64::consts::TAU * f64::from(j) / f64::from(around);
            let p = [turn.sin() * phi.cos(), turn.cos(), -turn.sin() * phi.sin()].map(|x| x as f32);
            globe.positions.push(p);
            globe.normals.push(p);
            globe
                .uvs
                .push([j as f32 / around as f32, i as f32 / rings as f32]);
        }
    }
    let at = |i: u32, j: u32| i * (around + 1) + j;
    for i in 0..rings {
        for j in 0..around {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            globe.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    globe
}

fn glittering(piece: &Piece) -> Scene {
    let mut build = Builder::new();
    let rgb = |build: &mut Builder, name: &str, c: [f64; 3], most: f64| {
        build.rgb(name, c, (0.0, most)).expect("valid")
    };
    let reflectance = rgb(
        &mut build,
        "metal.specular_reflectance.value",
        [0.9, 0.7, 0.5],
        1.0,
    );
    let metal = Conductor {
        specular_reflectance: reflectance,
        index: None,
    };
    let map = normals(&mut build, piece);
    let mapped = NormalMap::new(map, piece.interpolation, Arc::new(metal.into()));
    let mapped: Material = mapped.expect("few levels").into();
    let material = if piece.two_sided {
        let side = Arc::new(mapped);
        TwoSided::new([side.clone(), side])
            .expect("few levels")
            .into()
    } else {
        mapped
    };
    let material = build.add_material(material);
    match piece.form {
        Form::Ball => {
            let ball = Sphere::new([0.0, 0.0, 0.0], 1.0, false).expect("a ball");
            build.add_shape("metal", ball, material);
        }
        Form::Mesh => {
            let globe = Mesh::new(globe(), false).expect("a globe");
            build.add_shape("metal", globe, material);
        }
        Form::Plane => {
            // Seen from behind if it has two sides.
            let edges = [[0.0, 0.0, 4.0], [4.0, 0.0, 0.0]];
            let [a, b] = if piece.two_sided {
                [edges[1], edges[0]]
            } else {
                edges
            };
            let patch = Patch::new([-2.0, 0.0, -2.0], a, b, false).expect("an area");
            build.add_shape("metal", Rectangle(patch), material);
        }
    }
    let endless = f64::INFINITY;
    match piece.lit {
        Lit::Lamp(half) => {
            let black = rgb(&mut build, "lamp.reflectance.value", [0.0; 3], 1.0);
            let black = build.add_material(Diffuse { reflectance: black });
            let corner = [-half, 4.0, -3.0 - half];
            let side = 2.0 * half;
            let patch = Patch::new(corner, [side, 0.0, 0.0], [0.0, 0.0, side], false);
            let shape = build.add_shape("lamp", Rectangle(patch.expect("an area")), black);
            let radiance = [9.0, 8.0, 7.0].map(|x| x * 0.36 / (half * half));
            let radiance = rgb(&mut build, "lamp.emitter.radiance.value", radiance, endless);
            let light = Area {
                radiance,
                exponent: 0.0,
                shape,
            };
            build.add_emitter(light, Some(shape));
            let dim = rgb(&mut build, "sky.radiance.value", [0.1; 3], endless);
            build.add_emitter(Constant { radiance: dim }, None);
        }
        Lit::Sky(kappa) => {
            let radiance = [9.0, 8.0, 7.0].map(|x| x * kappa / 150.0);
            let radiance = rgb(&mut build, "sky.radiance.value", radiance, endless);
            let lobe = Vmf::new(radiance, [0.0, 4.0, -3.0], kappa);
            build.add_emitter(lobe.expect("a direction"), None);
        }
        Lit::Bulb(radius) => {
            let black = rgb(&mut build, "lamp.reflectance.value", [0.0; 3], 1.0);
            let black = build.add_material(Diffuse { reflectance: black });
            let ball = Sphere::new([0.0, 4.0, -3.0], radius, false).expect("a ball");
            let shape = build.add_shape("lamp", ball, black);
            let scale = (std::f64::consts::PI * radius * radius).recip();
            let radiance = [9.0, 8.0, 7.0].map(|x| x * scale);
            let radiance = rgb(&mut build, "lamp.emitter.radiance.value", radiance, endless);
            let light = Area {
                radiance,
                exponent: 0.0,
                shape,
            };
            build.add_emitter(light, Some(shape));
        }
        Lit::Point => {
            let intensity = rgb(&mut build, "lamp.intensity.value", [9.0, 8.0, 7.0], endless);
            build.add_emitter(Point::new(intensity, [0.0, 4.0, -3.0]), None);
        }
    }
    let target = [0.0, if piece.form == Form::Plane { 0.1 } else { 1.0 }, 0.0];
    let view = Transform::look_at([0.3, 4.0, 3.0], target, [0.0, 1.0, 0.0]);
    let view = view.expect("a view");
    let size = [piece.pixels; 2];
    let camera = if piece.parallel {
        Camera::orthographic(view, size)
    } else {
        Camera::new(view, piece.fov, FovAxis::Smaller, size)
    };
    let film = Film {
        filter: piece.filter,
        ..Film::new(piece.pixels, piece.pixels)
    };
    let settings = Settings {
        max_depth: 3,
        ..Settings::default()
    };
    build
        .build(camera.expect("a camera"), film, settings)
        .expect("a scene")
}

fn with(s: &Scene, glints: Option<Glints>) -> Settings {
    Settings {
        glints,
        ..s.settings
    }
}

fn unbiased() -> Glints {
    Glints::new(GlintMethod::Unbiased)
}

/// Blocks of pixels agree with paths alone, for every way to walk and to weigh, where maps are no finer than pixels, so that
/// light is found by either: on a ball and on a plane, for every kind of texture, camera and filter. 24 runs of 64 samples
/// against 24 of 512; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn glints_are_the_light_that_paths_leave_out() {
    let lobe = Glints {
        weights: GlintWeights::Lobe,
        ..unbiased()
    };
    let published = Glints::published(GlintMethod::Unbiased);
    let mitchell = Lobed::cubic(1.0 / 3.0, 1.0 / 3.0).expect("a filter");
    let cases = [
        ("ball", BALL, unbiased()),
        (
            "ball, trial set",
            BALL,
            Glints::new(GlintMethod::Biased(32)),
        ),
        ("ball, lobe", BALL, lobe),
        ("ball, published", BALL, published),
        (
            "flat map on a ball",
            Piece { slope: 0.0, ..BALL },
            unbiased(),
        ),
        ("plane", PLANE, unbiased()),
        (
            "plane, sky",
            Piece {
                lit: Lit::Sky(150.0),
                ..PLANE
            },
            unbiased(),
        ),
        ("plane, published", PLANE, published),
        (
            "plane, normals, mirrored, tent",
            Piece {
                interpolation: Interpolation::Normals,
                wrap: Wrap::Mirror,
                filter: PixelFilter::Tent { radius: 1.0 },
                ..PLANE
            },
            unbiased(),
        ),
        (
            "plane, clamped, from behind, parallel rays",
            Piece {
                wrap: Wrap::Clamp,
                two_sided: true,
                parallel: true,
                ..PLANE
            },
            unbiased(),
        ),
        (
            "ball, nearest, negative lobes",
            Piece {
                nearest: true,
                filter: PixelFilter::Lobed(mitchell),
                ..BALL
            },
            unbiased(),
        ),
    ];
    let limit = z_limit(cases.len() * 4 * 3, 24, ALPHA);
    let mut worst_of_all: f64 = 0.0;
    for (i, (name, piece, glints)) in (0..).zip(cases) {
        let s = glittering(&piece);
        let paths = picture(&s, &with(&s, None), 1000 * i + 500, 24, 512);
        let ours = picture(&s, &with(&s, Some(glints)), 1000 * i, 24, 64);
        let worst = (ours.iter().zip(&paths))
            .map(|(a, b)| a.z(b).abs())
            .fold(0.0, f64::max);
        let of = |e: &[Estimate]| {
            let mean = e.iter().map(|e| e.mean).sum::<f64>() / e.len() as f64;
            let error = e.iter().map(|e| e.se.powi(2)).sum::<f64>().sqrt() / e.len() as f64;
            (mean, error)
        };
        let ((mean, error), (other, error_of_other)) = (of(&ours), of(&paths));
        println!(
            "{name}: |z| up to {worst:.2} of {limit:.2}; mean {mean:.5} ± {error:.5}, of {other:.5} ± {error_of_other:.5}"
        );
        worst_of_all = worst_of_all.max(worst);
    }
    assert!(worst_of_all < limit, "|z| = {worst_of_all}");
}

/// The mean of an image and its error.
fn mean(s: &Scene, glints: Option<Glints>, seed: u64, runs: u64, spp: u64) -> Estimate {
    let settings = with(s, glints);
    let theta = Theta::constant(s.params().values());
    let means: Vec<f64> = (0..runs)
        .map(|r| {
            let job = Job::new(s, &settings, seed + r, 0..spp, &());
            let r = render_f32(&job, &theta, Estimator::Mis);
            assert_eq!(r.non_finite.count, 0);
            r.mean(0)[1]
        })
        .collect();
    Estimate::of(&means)
}

/// Fine maps and narrow lights, where paths find something now and then: within 3 % of paths or within chance (four
/// comparisons, significance 1 in 100 together), whichever is more, also where a pixel sees many copies of the map; and in less
/// noise by far. 16 runs of 64 samples against 16 of 8192.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn fine_glitter_keeps_its_energy() {
    let near = Piece {
        texels: 128,
        tiles: 1.0,
        lit: Lit::Sky(20_000.0),
        ..PLANE
    };
    let far = Piece {
        texels: 16,
        tiles: 200.0,
        ..near
    };
    let limit = z_limit(4, 16, 1e-2);
    for (name, piece) in [("near", near), ("far", far)] {
        let s = glittering(&piece);
        let paths = mean(&s, None, 10, 16, 8192);
        let ours = mean(&s, Some(unbiased()), 20, 16, 64);
        let sets = mean(&s, Some(Glints::new(GlintMethod::Biased(16))), 30, 16, 64);
        let gain = (paths.se / ours.se).powi(2) * 8192.0 / 64.0;
        println!(
            "{name}: paths {paths:?}, unbiased {ours:?}, sets {sets:?}; {gain:.1} times less variance"
        );
        for e in [ours, sets] {
            let error = paths.se.hypot(e.se);
            let within = (0.03 * paths.mean).max(limit * error);
            assert!(
                (e.mean - paths.mean).abs() < within,
                "{name}: {e:?} {paths:?}"
            );
            assert!(error < 0.05 * paths.mean, "{name}: {error}");
        }
        assert!(gain > 4.0, "{name}: {gain}");
    }
}

/// Round things in few pixels, whose footprints are far from affine, also with filters as wide as what they show: the light is
/// that of paths, within 1 % or within chance (significance 1 in 100 over all comparisons), whichever is more. 16 runs of 256
/// samples a pixel of 8 x 8 against 16 of 4096, and as many of the whole film where it has more pixels or fewer.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn round_things_in_few_pixels_keep_their_energy() {
    let ball = Piece {
        form: Form::Ball,
        texels: 64,
        tiles: 1.0,
        fov: 30.0,
        ..PLANE
    };
    let mesh = Piece {
        form: Form::Mesh,
        ..ball
    };
    let small = Piece {
        lit: Lit::Lamp(0.15),
        ..ball
    };
    let tent = PixelFilter::Tent { radius: 1.5 };
    let gauss = PixelFilter::Gaussian { stddev: 0.5 };
    let cases = [
        ("ball", ball, 2),
        ("ball", ball, 5),
        ("ball", ball, 10),
        ("ball", ball, 20),
        ("small lamp", small, 5),
        ("small lamp", small, 10),
        ("mesh", mesh, 5),
        ("mesh", mesh, 10),
        (
            "tent",
            Piece {
                filter: tent,
                ..ball
            },
            5,
        ),
        (
            "gauss",
            Piece {
                filter: gauss,
                ..mesh
            },
            5,
        ),
    ];
    let limit = z_limit(cases.len(), 16, 1e-2);
    let mut wrong = Vec::new();
    for (name, piece, pixels) in cases {
        let s = glittering(&Piece { pixels, ..piece });
        let spp = |at_8: u64| at_8 * 64 / u64::from(pixels * pixels);
        let paths = mean(&s, None, 10, 16, spp(4096));
        let ours = mean(&s, Some(unbiased()), 50, 16, spp(256));
        let ratio = ours.mean / paths.mean;
        let error = paths.se.hypot(ours.se) / paths.mean;
        println!("{name}, {pixels} pixels: {ratio:.4} ± {error:.4}");
        if (ratio - 1.0).abs() > f64::max(0.01, limit * error) {
            wrong.push((name, pixels, ratio, error));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// A point light, which paths cannot find in metal at all, is the limit of a small bulb: 16 runs of 256 samples of each, within
/// 3 % or within chance (two comparisons, significance 1 in 100 together). Walks alone are as right as both techniques.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn point_lights_glitter() {
    let fine = Piece {
        texels: 64,
        tiles: 2.0,
        lit: Lit::Point,
        ..PLANE
    };
    let point = glittering(&fine);
    assert_eq!(mean(&point, None, 1, 1, 64).mean, 0.0);
    let bulb = glittering(&Piece {
        lit: Lit::Bulb(0.002),
        ..fine
    });
    let walks = Glints {
        techniques: GlintTechniques::Walks,
        ..unbiased()
    };
    let a = mean(&point, Some(unbiased()), 2, 16, 256);
    let b = mean(&bulb, Some(walks), 3, 16, 256);
    let c = mean(&bulb, Some(unbiased()), 4, 16, 256);
    println!("point {a:?}, bulb by walks {b:?}, by both {c:?}");
    assert!(c.mean > 0.0 && c.se < 0.05 * c.mean);
    let limit = z_limit(2, 16, 1e-2);
    for e in [a, b] {
        let within = (0.03 * c.mean).max(limit * e.se.hypot(c.se));
        assert!((e.mean - c.mean).abs() < within, "{e:?} {c:?}");
    }
}

/// Nothing is infinite, and nothing hangs, where there is nothing to find or everything is degenerate: flat maps in front of a
/// point, grazing views, poles, copies without end; in single and in double precision.
#[test]
fn degenerate_glints_are_finite() {
    let flat = Piece {
        slope: 0.0,
        lit: Lit::Point,
        ..PLANE
    };
    let steep = Piece {
        slope: 50.0,
        ..PLANE
    };
    let endless = Piece {
        tiles: 1e9,
        ..PLANE
    };
    let one = Piece { texels: 1, ..BALL };
    let pieces = [
        flat,
        Piece {
            parallel: true,
            ..flat
        },
        Piece {
            lit: Lit::Sky(1e7),
            parallel: true,
            ..flat
        },
        steep,
        Piece {
            interpolation: Interpolation::Normals,
            ..steep
        },
        endless,
        one,
        Piece {
            form: Form::Ball,
            fov: 40.0,
            lit: Lit::Point,
            ..PLANE
        },
        Piece {
            form: Form::Ball,
            fov: 40.0,
            tiles: 0.0,
            ..PLANE
        },
    ];
    for (i, piece) in pieces.iter().enumerate() {
        let s = glittering(piece);
        for mut glints in [
            unbiased(),
            Glints::new(GlintMethod::Biased(4)),
            Glints::published(GlintMethod::Unbiased),
        ] {
            glints.budget = 1000;
            let settings = with(&s, Some(glints));
            let job = Job::new(&s, &settings, 3, 0..4, &());
            let theta = Theta::constant(s.params().values());
            let image = render_f32(&job, &theta, Estimator::Mis);
            assert_eq!(image.non_finite.count, 0, "{i}");
            let values = values::<f64>(&s);
            let double = render::<f64, DetachedMis, Independent>(&job, &Theta::constant(&values));
            let double = double.expect("nothing moves");
            assert_eq!(double.non_finite.count, 0, "{i}");
            assert!(
                double.sums[0].iter().all(|x| x.is_finite() && *x >= 0.0),
                "{i}"
            );
        }
    }
}

#[test]
fn results_depend_on_the_seed_alone() {
    let s = glittering(&PLANE);
    let settings = with(&s, Some(unbiased()));
    let name = "metal.specular_reflectance.value";
    let active = Active::new(&s, &[name]).expect("a parameter");
    let theta = Theta::constant(s.params().values());
    let (sums, statistics, gradient) = on_any_threads(|| {
        let job = Job::new(&s, &settings, 3, 0..4, &());
        let image = render_f32(&job, &theta, Estimator::Mis);
        let adjoint = mean_adjoint(&s);
        let g = backward_f32(&job, &theta, &active, &adjoint).expect("a gradient");
        (image.sums, image.glints, g.values)
    });
    assert!(sums[0].iter().any(|x| *x > 0.0) && gradient[0].iter().any(|x| *x > 0.0));
    assert!(
        statistics.found > 0 && statistics.trials >= statistics.solutions,
        "{statistics:?}"
    );
}

/// Where nothing is glinty, images are those without glints, bit by bit.
#[test]
fn nothing_changes_where_nothing_glitters() {
    let (plain, _) = render::scene::room(16, 16)
        .map(|s| (s, ()))
        .expect("the room");
    let theta = Theta::constant(plain.params().values());
    let image = |glints| {
        let settings = with(&plain, glints);
        let job = Job::new(&plain, &settings, 1, 0..1, &());
        render_f32(&job, &theta, Estimator::Mis).sums
    };
    assert_eq!(image(Some(unbiased())), image(None));
}

/// Forward and reverse mode are one linear map and its transpose, in f64, at equal seeds; both are the central difference of
/// the image with common random numbers: emission and reflectance, which leave glints where they are.
#[test]
fn derivatives_of_glints_that_stay_are_right() {
    let s = glittering(&PLANE);
    let settings = with(&s, Some(unbiased()));
    let adjoint = mean_adjoint(&s);
    let keys = [
        "metal.specular_reflectance.value",
        "lamp.emitter.radiance.value",
    ];
    let params: Vec<_> = (smooth_params(&s).into_iter())
        .filter(|p| keys.contains(&p.name.as_str()))
        .collect();
    assert_eq!(params.len(), keys.len());
    let (seed, spp) = (5, 8);
    let gradient = reverse_by::<f64, DetachedMis>(&s, &params, &adjoint, &settings, seed, spp);
    for (info, gradient) in params.iter().zip(&gradient) {
        let mut direction = vec![0.0; s.params().values().len()];
        direction[info.range()].fill(1.0);
        let forward = forward_by::<DetachedMis>(&s, &direction, &adjoint, &settings, seed, spp);
        let reverse: f64 = gradient.iter().sum();
        let size = reverse.abs();
        assert!(size > 1e-6, "{}", info.name);
        let close = |a: f64, within: f64| {
            assert!(
                (a - reverse).abs() < within * size,
                "{}: {a} {reverse}",
                info.name
            );
        };
        close(forward, 1e-9);
        let value = |h: f64| {
            let mut v = values::<f64>(&s);
            for i in info.range() {
                v[i] += h;
            }
            let job = Job::new(&s, &settings, seed, 0..spp, &());
            let r = render::<f64, DetachedMis, Independent>(&job, &Theta::constant(&v));
            r.expect("nothing moves").mean(0).iter().sum::<f64>() / 3.0
        };
        close((value(1e-4) - value(-1e-4)) / 2e-4, 1e-5);
    }
}

#[test]
fn what_is_not_covered_is_refused() {
    let s = glittering(&PLANE);
    let settings = with(&s, Some(unbiased()));
    let job = Job::new(&s, &settings, 0, 0..1, &());
    let refused = |estimator: Estimator, name: &str| {
        let along = [Direction::uniform(s.params(), name).expect("a parameter")];
        let error = estimator.forward_f32(&job, s.params().values(), &along);
        error.unwrap_err().to_string()
    };
    let error = refused(Estimator::Mis, "normals");
    assert!(error.contains("normals.data"), "{error}");
    let attached = Estimator::from_name("attached-path").expect("an estimator");
    let error = refused(attached, "metal.specular_reflectance.value");
    assert!(
        error.contains("glints") || error.contains("discontinuities"),
        "{error}"
    );
}

/// The integrator of the authors' files says how glints are found.
#[test]
fn integrators_of_scene_files_mean_what_they_say() {
    let load = |inside: &str| {
        let text = format!(
            r#"<scene version="2.0.0"><integrator type="path_sms_glints">{inside}</integrator>
            <sensor type="perspective"><float name="fov" value="40"/></sensor></scene>"#
        );
        Scene::from_xml(&text, std::path::Path::new("."), &LoadOptions::default())
            .map(|(s, warnings)| (s.settings.glints.expect("glints"), warnings))
            .map_err(|e| e.to_string())
    };
    let (found, warnings) = load("").expect("valid");
    assert_eq!(found, Glints::published(GlintMethod::Unbiased));
    assert!(warnings.is_empty(), "{warnings:?}");
    let options = r#"<boolean name="biased" value="true"/><integer name="max_trials" value="8"/>
        <integer name="max_iterations" value="12"/><float name="uniqueness_threshold" value="0.0002"/>
        <boolean name="sms_strategy_only" value="true"/>"#;
    let (found, _) = load(options).expect("valid");
    assert_eq!(found.method, GlintMethod::Biased(8));
    assert_eq!((found.steps, found.threshold), (12, Some(0.0002)));
    assert_eq!(found.techniques, GlintTechniques::Walks);
    assert_eq!(found.region, GlintRegion::Footprint);
    let error = load(r#"<integer name="max_iterations" value="0"/>"#).unwrap_err();
    assert!(error.contains("max_iterations"), "{error}");
    let error = load(r#"<float name="uniqueness_threshold" value="-1"/>"#).unwrap_err();
    assert!(error.contains("uniqueness_threshold"), "{error}");
}

/// The tip of one of the authors' shoes, where glints are, with the normal map that their other scenes have: the light of
/// glints is that of paths, within 3 % or four standard errors; skipped where the scenes are not there.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn the_authors_shoes_keep_their_energy() {
    let Some(shared) = shared_dir() else {
        return;
    };
    let folder = shared.join("scenes/sms/Figure_19_GlintsComparison");
    let map = shared.join("scenes/sms/Figure_6_Sequence/textures/normalmap_gaussian.exr");
    if !folder.is_dir() || !map.is_file() {
        println!("skipped: no scenes of the authors");
        return;
    }
    let text = std::fs::read_to_string(folder.join("shoes_sms.xml")).expect("a file");
    let crop = [
        ("offset_x", 144),
        ("offset_y", 576),
        ("width", 32),
        ("height", 32),
    ];
    let crop = crop.map(|(key, n)| format!(r#"<integer name="crop_{key}" value="{n}"/>"#));
    let format = r#"<string name="pixel_format" value="rgb"/>"#;
    assert!(text.contains(format));
    let text = text
        .replace(
            "textures/normalmap_gaussian.exr",
            &map.display().to_string(),
        )
        .replace(format, &format!("{format}{}", crop.concat()));
    let (s, warnings) = Scene::from_xml(&text, &folder, &LoadOptions::default()).expect("valid");
    assert!(
        warnings.iter().all(|w| !w.contains("glinty")),
        "{warnings:?}"
    );
    let read = s.settings.glints.expect("glints");
    let mut settings = s.settings;
    settings.max_depth = 2;
    let theta = Theta::constant(s.params().values());
    let mean = |glints: Option<Glints>, seed: u64, spp: u64| {
        let settings = Settings { glints, ..settings };
        let each: Vec<f64> = (0..8)
            .map(|r| {
                let job = Job::new(&s, &settings, seed + r, 0..spp, &());
                let r = render_f32(&job, &theta, Estimator::Mis);
                assert_eq!(r.non_finite.count, 0);
                assert!(glints.is_none() || r.glints.found > 100, "{:?}", r.glints);
                r.mean(0)[1]
            })
            .collect();
        Estimate::of(&each)
    };
    let paths = mean(None, 1, 512);
    let ours = mean(Some(unbiased()), 100, 64);
    let file = mean(
        Some(Glints {
            budget: 1 << 20,
            ..read
        }),
        200,
        16,
    );
    println!("paths {paths:?}, ours {ours:?}, as published {file:?}");
    let within = (0.03 * paths.mean).max(z_limit(1, 8, 1e-2) * paths.se.hypot(ours.se));
    assert!(
        (ours.mean - paths.mean).abs() < within,
        "{ours:?} {paths:?}"
    );
}
