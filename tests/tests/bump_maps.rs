//! Bump maps on all kinds of surfaces: normals as the definition has them, derivatives in every texel, and what is refused.

use ad_core::Vec3;
use render::bsdf::{Bsdf, Material, Shading, TransportMode};
use render::estimator::DetachedMis;
use render::image_io::{Pixels, write_exr_pixels};
use render::integrator::gradient::Active;
use render::integrator::second_order::hessian_vector;
use render::math::Ray;
use render::params::Theta;
use render::sampler::Independent;
use render::scene::LoadOptions;
use render::{Scene, Settings};
use tempfile::TempDir;
use tests::stats::{Estimate, z_limit};
use tests::{dot, forward, image, mean_adjoint, reverse, smooth_params, values};

const METAL: &str = r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>"#;
const TILES: &str = r#"<bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="tiles.exr"/></texture></bsdf>"#;

/// A folder with heights, a wider image and a bent mesh with normals and coordinates of its own, clockwise ones among them.
fn folder() -> TempDir {
    let dir = TempDir::new().expect("a folder");
    let noise = |i: usize| (i * 7919 % 101) as f32 / 101.0;
    for (name, width, channels) in [("heights.exr", 5, 1), ("tiles.exr", 4, 3)] {
        let pixels = Pixels {
            width,
            height: 3,
            channels,
            data: (0..3 * width * channels).map(noise).collect(),
        };
        write_exr_pixels(&dir.path().join(name), &pixels).expect("a file");
    }
    let mut text = String::new();
    for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
        let [x, y] = [i, j].map(|k| f64::from(k) * 0.8 - 0.8);
        let (u, v) = (0.9 - 0.4 * f64::from(j), 0.3 * f64::from(i) + 0.1 * x * y);
        text += &format!("v {x} {y} {}\nvt {u} {v}\n", 0.2 * (x + 0.3 * y).cos());
        text += &format!("vn {} 0.1 1\n", 0.2 * x);
    }
    for (i, j) in (0..2).flat_map(|i| (0..2).map(move |j| (i, j))) {
        let at = |i: u32, j: u32| format!("{0}/{0}/{0}", 3 * i + j + 1);
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        text += &format!("f {a} {b} {c} {d}\n");
    }
    std::fs::write(dir.path().join("patch.obj"), text).expect("a file");
    dir
}

fn bumps(scale: f64, nested: &str) -> String {
    format!(
        r#"<bsdf type="bumpmap" id="bumps"><texture name="heights" type="bitmap"><string name="filename" value="heights.exr"/></texture>
        <float name="scale" value="{scale}"/>{nested}</bsdf>"#
    )
}

/// A shape before the camera, under a lamp and a sky.
fn load(dir: &TempDir, shape: &str, bsdf: &str) -> Scene {
    try_load(dir, shape, bsdf).unwrap_or_else(|e| panic!("{e}"))
}

fn try_load(dir: &TempDir, shape: &str, bsdf: &str) -> Result<Scene, String> {
    let text = format!(
        r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world"><lookat origin="0.3, 0.2, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="3"/></integrator>
        <shape type="rectangle" id="light"><transform name="to_world"><scale value="0.6"/><rotate y="1" angle="180"/>
        <translate x="1" y="1.5" z="4"/></transform><emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>
        <emitter type="constant" id="sky"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>
        {}</scene>"#,
        shape.replace("{}", bsdf)
    );
    let loaded = Scene::from_xml(&text, dir.path(), &LoadOptions::default());
    loaded.map(|(s, _)| s).map_err(|e| e.to_string())
}

const MESH: &str =
    r#"<shape type="obj" id="it"><string name="filename" value="patch.obj"/>{}</shape>"#;
const PLATE: &str = r#"<shape type="rectangle" id="it"><transform name="to_world"><scale x="1.4" y="0.7"/>
    <matrix value="1 0.3 0 0  0 1 0 0  0 0.1 1 0  0 0 0 1"/></transform>{}</shape>"#;
const SHAPES: [(&str, &str); 7] = [
    ("mesh", MESH),
    ("plate", PLATE),
    (
        "flat mesh",
        r#"<shape type="obj" id="it"><string name="filename" value="patch.obj"/><boolean name="face_normals" value="true"/>{}</shape>"#,
    ),
    (
        "ball",
        r#"<shape type="sphere" id="it"><transform name="to_world"><rotate x="1" y="2" angle="40"/></transform>{}</shape>"#,
    ),
    (
        "disk",
        r#"<shape type="disk" id="it"><transform name="to_world"><scale x="1.3" y="0.8"/><rotate z="1" angle="20"/></transform>{}</shape>"#,
    ),
    (
        "tube",
        r#"<shape type="cylinder" id="it"><point name="p0" x="-0.2" y="-0.9" z="0"/><point name="p1" x="0.3" y="1" z="0.1"/>
        <float name="radius" value="0.7"/>{}</shape>"#,
    ),
    (
        "cube",
        r#"<shape type="cube" id="it"><transform name="to_world"><scale x="0.9" y="0.5" z="0.6"/><rotate x="1" y="1" angle="35"/></transform>{}</shape>"#,
    ),
];

/// `n` along the cross product of dp/du and dp/dv, each with its part along the shading normal replaced by the slope of
/// the heights: in world space, from the same shape without bumps, with slopes by differences.
#[test]
fn normals_are_those_of_the_definition() {
    let dir = folder();
    let scale = 0.2;
    for (name, shape) in SHAPES {
        let (plain, bumped) = (
            load(&dir, shape, TILES),
            load(&dir, shape, &bumps(scale, TILES)),
        );
        let all = values::<f64>(&bumped);
        let theta = Theta::constant(&all);
        let number = bumped.shapes().len() as u32 - 1;
        let Material::Charted(charted) = bumped.material(number) else {
            panic!("{name} has no chart");
        };
        let Material::BumpMap(map) = &**charted.nested() else {
            panic!("another material");
        };
        let (mut right, mut crossed) = (0, 0);
        for (x, y) in (0..24).flat_map(|x| (0..24).map(move |y| (x, y))) {
            let [x, y] = [x, y].map(|k| (f64::from(k) + 0.3) / 3.0);
            let ray: Ray<f64> = plain.camera.ray(x, y);
            let (Some(a), Some(b)) = (plain.intersect(&ray), bumped.intersect(&ray)) else {
                continue;
            };
            if a.shape != number || b.shape != number {
                continue;
            }
            let si = &a.si;
            let at = plain.coordinates(a.prim, si);
            let partials = plain
                .partials::<f64>(&Theta::constant(&values::<f64>(&plain)), a.prim, at)
                .expect("coordinates");
            let h = 1e-5;
            let height = |u: f64, v: f64| {
                let uv = si.uv + ad_core::Vec2::new(u, v);
                scale * map.height().scalar(&theta, uv)
            };
            let slopes = [
                height(h, 0.0) - height(-h, 0.0),
                height(0.0, h) - height(0.0, -h),
            ];
            let n = si.frame.n;
            let raised = |d: Vec3<f64>, slope: f64| d + n * (slope / (2.0 * h) - n.dot(d));
            let expected = raised(partials.dp_du, slopes[0])
                .cross(raised(partials.dp_dv, slopes[1]))
                .normalize();
            let expected = if expected.dot(n) < 0.0 {
                -expected
            } else {
                expected
            };
            let wo = b.si.frame.to_local(n);
            let own = Shading::new(theta, b.si.uv);
            let frame = bumped
                .material(number)
                .shading_frame(&own, wo, 0, TransportMode::Radiance);
            let found = b.si.frame.to_world(frame.n);
            // A difference over a border of texels is none: few are.
            if (found - expected).length() < 1e-3 {
                right += 1;
            } else {
                crossed += 1;
            }
        }
        assert!(
            right > 50 && crossed * 50 < right,
            "{name}: {right}, {crossed}"
        );
    }
}

/// Heights that are raised by nothing leave the image as it is, whatever textures a mesh has around and below them.
#[test]
fn flat_heights_change_nothing() {
    let dir = folder();
    let weight = r#"<texture name="weight" type="bitmap"><string name="filename" value="heights.exr"/></texture>"#;
    let brushed = r#"<bsdf type="roughconductor"><float name="alpha_u" value="0.4"/><float name="alpha_v" value="0.1"/></bsdf>"#;
    for (name, shape) in SHAPES {
        let blended = |part: &str| {
            format!(
                r#"<bsdf type="twosided"><bsdf type="blendbsdf">{weight}{part}{brushed}</bsdf></bsdf>"#
            )
        };
        let [a, b] = [blended(TILES), blended(&bumps(0.0, TILES))].map(|bsdf| {
            let s = load(&dir, shape, &bsdf);
            image::<f64>(&s, &values(&s), &s.settings, 1, 16).sums[0].clone()
        });
        let size = a.iter().sum::<f64>();
        let apart: f64 = a.iter().zip(&b).map(|(a, b)| (a - b).abs()).sum();
        assert!(apart < 1e-4 * size, "{name}: {}", apart / size);
    }
}

/// A direction in which every texel moves by itself.
fn noise(i: usize) -> f64 {
    render::sampler::mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

/// Forward and reverse mode are one linear map, with heights, scale, and textures around and below them.
#[test]
fn reverse_equals_forward() {
    let dir = folder();
    for (name, shape) in SHAPES {
        let nested = format!(
            r#"<bsdf type="blendbsdf"><texture name="weight" type="bitmap"><string name="filename" value="heights.exr"/></texture>{TILES}{METAL}</bsdf>"#
        );
        let s = load(&dir, shape, &bumps(0.1, &nested));
        let params = smooth_params(&s);
        assert!(params.iter().any(|p| p.name == "bumps.nested_texture.data"));
        assert!(params.iter().any(|p| p.name == "bumps.scale"));
        let adjoint: Vec<f32> = (0..s.film.pixels() * 3).map(|i| noise(i) as f32).collect();
        let mut direction = vec![0.0; s.params().values().len()];
        for i in params.iter().flat_map(|p| p.range()) {
            direction[i] = noise(i + 7919);
        }
        let j = forward(&s, &direction, &adjoint, &s.settings, 5, 16);
        let g = reverse::<f64>(&s, &params, &adjoint, &s.settings, 5, 16).concat();
        let each = params.iter().flat_map(|p| p.range());
        let terms: Vec<_> = each.zip(&g).map(|(i, g)| direction[i] * g).collect();
        let scale: f64 = terms.iter().map(|t| t.abs()).sum();
        let jt: f64 = terms.iter().sum();
        assert!(
            scale > 0.0 && (j - jt).abs() < 1e-9 * scale,
            "{name}: {j} {jt}"
        );
    }
}

/// Second derivatives at equal seeds are a symmetric matrix, of texels that a slope alone reads too.
#[test]
fn second_derivatives_are_symmetric() {
    let dir = folder();
    for (name, shape) in [("mesh", MESH), ("plate", PLATE)] {
        let s = load(&dir, shape, &bumps(0.1, METAL));
        let names = [
            "bumps.nested_texture.data",
            "bumps.scale",
            "sky.radiance.value",
        ];
        let active = Active::new(&s, &names).expect("parameters");
        let settings = Settings {
            rr_depth: u32::MAX,
            ..s.settings
        };
        let all = values::<f64>(&s);
        let theta = Theta::constant(&all);
        let adjoint = mean_adjoint(&s);
        let still = vec![0.0; adjoint.len()];
        let product = |v: &[f64]| {
            let job = render::Job::new(&s, &settings, 7, 0..16, &());
            let found =
                hessian_vector::<f64, Independent>(&job, &theta, &active, v, [&adjoint, &still]);
            found.expect("a product").values.concat()
        };
        let along =
            |first: usize| -> Vec<f64> { (0..active.len()).map(|i| noise(i + first)).collect() };
        let (u, v) = (along(0), along(1000));
        let terms =
            |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a * b).collect() };
        let (uhv, vhu) = (terms(&u, &product(&v)), terms(&v, &product(&u)));
        let size: f64 = uhv.iter().chain(&vhu).map(|x| x.abs()).sum();
        let apart = uhv.iter().sum::<f64>() - vhu.iter().sum::<f64>();
        assert!(
            size > 0.0 && apart.abs() < 1e-9 * size,
            "{name}: {apart:e} of {size:e}"
        );
    }
}

/// Along a direction that moves every texel by itself, and the scale: 32 repeats of 64 samples per pixel.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn gradients_equal_differences() {
    const REPEATS: u64 = 32;
    let dir = folder();
    let mut found = Vec::new();
    for (name, shape, nested) in [("mesh", MESH, METAL), ("plate", PLATE, TILES)] {
        let s = load(&dir, shape, &bumps(0.1, nested));
        let settings = Settings {
            rr_depth: u32::MAX,
            ..s.settings
        };
        let adjoint = mean_adjoint(&s);
        for key in ["bumps.nested_texture.data", "bumps.scale"] {
            let p = s.params().find(key).expect("a parameter").clone();
            let direction: Vec<f64> = p.range().map(noise).collect();
            let base = values::<f64>(&s);
            let h = 1e-3;
            let at = |h: f64, seed: u64| {
                let mut v = base.clone();
                p.range().zip(&direction).for_each(|(i, d)| v[i] += h * d);
                dot(&adjoint, &image::<f64>(&s, &v, &settings, seed, 64), 0)
            };
            let [g, fd]: [Vec<f64>; 2] = [
                (0..REPEATS)
                    .map(|r| {
                        let g = reverse::<f64>(
                            &s,
                            std::slice::from_ref(&p),
                            &adjoint,
                            &settings,
                            r,
                            64,
                        );
                        g[0].iter().zip(&direction).map(|(g, d)| g * d).sum()
                    })
                    .collect(),
                (0..REPEATS)
                    .map(|r| (at(h, 100 + r) - at(-h, 100 + r)) / (2.0 * h))
                    .collect(),
            ];
            let [g, fd] = [g, fd].map(|x| Estimate::of(&x));
            println!("{name} {key}: {g:?} {fd:?}");
            assert!(g.mean.abs() > 3.0 * g.se, "{name} {key}: {g:?}");
            found.push((name, key, g.z(&fd)));
        }
    }
    let limit = z_limit(found.len(), REPEATS, 1e-3);
    assert!(found.iter().all(|(.., z)| z.abs() < limit), "{found:?}");
}

/// Values and derivatives are finite whatever the heights are, at poles as well.
#[test]
fn extreme_heights_are_harmless() {
    let dir = folder();
    for (name, shape) in SHAPES {
        let mut s = load(&dir, shape, &bumps(1.0, METAL));
        let p = s
            .params()
            .find("bumps.nested_texture.data")
            .expect("heights")
            .clone();
        for size in [1e-30f32, 1e3, 1e30, f32::MAX] {
            let mut v = s.params().values().to_vec();
            for i in p.range() {
                v[i] = size * noise(i) as f32;
            }
            s.set_params(&v).expect("finite heights");
            let adjoint = mean_adjoint(&s);
            let params = smooth_params(&s);
            let theta = Theta::constant(s.params().values());
            let job = render::Job::new(&s, &s.settings, 1, 0..16, &());
            let r = render::instances::render_f32(&job, &theta, render::instances::Estimator::Mis);
            assert_eq!(r.non_finite.count, 0, "{name} {size}");
            let g = reverse::<f32>(&s, &params, &adjoint, &s.settings, 2, 16).concat();
            assert!(g.iter().all(|g| g.is_finite()), "{name} {size}");
        }
    }
}

/// What moves has no heights in units of the scene, and what is not covered is refused by name.
#[test]
fn what_is_not_covered_is_refused() {
    let dir = folder();
    let mut s = load(&dir, MESH, &bumps(0.1, METAL));
    for key in ["it.scale", "it.vertex_positions"] {
        let error = s
            .make_movable(&[key])
            .expect_err("no parameter")
            .to_string();
        assert!(error.contains(key), "{error}");
    }
    s.make_movable(&["it.translation", "sensor.rotation"])
        .expect("parameters");
    for key in ["it.translation", "sensor.rotation"] {
        let info = s.params().find(key).expect("a parameter").clone();
        let error = s
            .admits_motion::<DetachedMis>(&info)
            .expect_err("jumps")
            .to_string();
        assert!(error.contains("jumps where it slides"), "{error}");
    }
    let lamp = r#"<emitter type="area"><texture name="radiance" type="bitmap"><string name="filename" value="tiles.exr"/></texture></emitter>"#;
    let error = try_load(&dir, MESH, &format!("{}{lamp}", bumps(0.1, METAL)));
    let error = error.expect_err("light that is an image");
    assert!(
        error.contains("under a bump map, light that is the same everywhere"),
        "{error}"
    );
    let raised = r#"<texture name="displacement" type="bitmap"><string name="filename" value="heights.exr"/></texture>"#;
    let error = try_load(&dir, MESH, &format!("{}{raised}", bumps(0.1, METAL)));
    let error = error.expect_err("points that are parameters");
    assert!(
        error.contains("under a bump map, points that stay"),
        "{error}"
    );
}

/// What is saved loads again, with the same image.
#[test]
fn bump_maps_are_saved() {
    let dir = folder();
    let mut s = load(&dir, MESH, &bumps(0.1, METAL));
    let mut v = s.params().values().to_vec();
    let range = s
        .params()
        .find("bumps.nested_texture.data")
        .expect("heights")
        .range();
    for i in range {
        v[i] *= 0.5;
    }
    v[s.params().find("bumps.scale").expect("a scale").offset] = 0.3;
    s.set_params(&v).expect("valid");
    let to = dir.path().join("saved");
    std::fs::create_dir(&to).expect("a folder");
    s.save(&to.join("scene.xml")).expect("a file");
    let (again, _) =
        Scene::load(&to.join("scene.xml"), &LoadOptions::default()).expect("what was saved");
    assert_eq!(s.params().values(), again.params().values());
    let of = |s: &Scene| image::<f32>(s, s.params().values(), &s.settings, 3, 4).sums[0].clone();
    assert_eq!(of(&s), of(&again));
}
