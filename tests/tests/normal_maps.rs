//! What derivatives in a normal map miss is the edge along which tilted normals turn from their viewer, all of it and
//! nothing else: on a ball with such an edge they are compared with differences, pixel by pixel.

use ad_core::Vec3;
use rayon::prelude::*;
use render::Job;
use render::Scene;
use render::bsdf::{Bsdf, Shading, TransportMode};
use render::instances::{Direction, Estimator, render_f64};
use render::params::Theta;
use tests::stats::{Estimate, z_limit};
use tests::{scene, values};

/// Pixels per side.
const SIZE: usize = 8;
/// Step of the differences.
const STEP: f64 = 1e-2;
const REPEATS: u64 = 48;
const SPP: u64 = 256;
const COLOURS: [&str; 2] = ["map.normalmap.color0.value", "map.normalmap.color1.value"];
/// Encoded: the second axis, which leads away from the viewer, is what moves.
const NORMAL: [f64; 3] = [0.6, 0.35, 0.9];

/// A ball that fills the film and whose normals are all tilted alike. Its poles are in front and behind.
fn ball(nested: &str, around: &str) -> Scene {
    let [x, y, z] = NORMAL;
    scene(&format!(
        r#"<sensor type="perspective"><float name="fov" value="18"/>
        <transform name="to_world"><lookat origin="0, 1.2, 4" target="0, 0.6, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
        <rfilter type="box"/></film></sensor>
        <integrator type="path"><integer name="max_depth" value="2"/></integrator>
        <shape type="sphere"><point name="center" value="0, 0.6, 0"/><float name="radius" value="0.6"/>
        <bsdf type="normalmap" id="map"><texture name="normalmap" type="checkerboard">
            <rgb name="color0" value="{x}, {y}, {z}"/><rgb name="color1" value="{x}, {y}, {z}"/></texture>
        {nested}</bsdf></shape>{around}"#
    ))
}

/// Per pixel, the part where the ball is hit and a viewer sees a lit side, by rays through a regular grid.
fn lit(s: &Scene, v: &[f64]) -> Vec<f64> {
    const SIDE: usize = 128;
    let theta = Theta::constant(v);
    let is_lit = |x: f64, y: f64| {
        let ray = s.camera.ray::<f64>(x, y);
        s.intersect(&ray).is_some_and(|hit| {
            let wo = hit.si.frame.to_local(-ray.d);
            let uv = hit.si.uv;
            let (at, up) = (Shading::new(theta, uv), Vec3::new(0.0, 0.0, 1.0));
            let f = s
                .material(hit.shape)
                .eval(&at, wo, up, TransportMode::Radiance);
            hit.shape == 0 && !f.is_black()
        })
    };
    let of = |p: usize| {
        let place = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / SIDE as f64;
        let rays = 0..SIDE * SIDE;
        let n = rays.filter(|k| is_lit(place(p % SIZE, k % SIDE), place(p / SIZE, k / SIDE)));
        n.count() as f64 / (SIDE * SIDE) as f64
    };
    (0..SIZE * SIZE).into_par_iter().map(of).collect()
}

/// All parameters, with the second axis of all normals moved by `h`.
fn moved(s: &Scene, h: f64) -> Vec<f64> {
    let mut v = values::<f64>(s);
    for name in COLOURS {
        v[s.params().find(name).expect("a parameter").offset + 1] += h;
    }
    v
}

/// Per pixel: central differences of the image, and its derivative.
fn both(s: &Scene) -> [Vec<Estimate>; 2] {
    let image = |h: f64, seed: u64| {
        let v = moved(s, h);
        let (theta, t) = (Theta::constant(&v), Estimator::Mis);
        render_f64(&Job::new(s, &s.settings, seed, 0..SPP, &()), &theta, t)
    };
    let directions = COLOURS.map(|name| {
        let handle = s
            .params()
            .handle(s.params().find(name).expect("a parameter"));
        Direction::Dense(handle, vec![0.0, 1.0, 0.0])
    });
    let grey = |sums: &[f64], scale: f64| -> Vec<f64> {
        let mean = |c: &[f64]| c.iter().sum::<f64>() / 3.0 * scale;
        sums.chunks_exact(3).map(mean).collect()
    };
    let runs: Vec<[Vec<f64>; 2]> = (0..REPEATS)
        .into_par_iter()
        .map(|r| {
            let (a, b) = (image(STEP, r), image(-STEP, r));
            let apart: Vec<f64> = (a.sums[0].iter().zip(&b.sums[0]))
                .map(|(a, b)| a - b)
                .collect();
            let (v, seed) = (s.params().values(), 1000 + r);
            let d = Estimator::Mis
                .forward_f32(&Job::new(s, &s.settings, seed, 0..SPP, &()), v, &directions)
                .expect("smooth parameters");
            let one = 1.0 / SPP as f64;
            [grey(&apart, one / (2.0 * STEP)), grey(&d.sums[1], one)]
        })
        .collect();
    [0, 1].map(|k| {
        let of = |p: usize| Estimate::of(&runs.iter().map(|r| r[k][p]).collect::<Vec<_>>());
        (0..SIZE * SIZE).map(of).collect()
    })
}

/// Under a constant sky L the radiance of a diffuse ball is `rho L (1 + cos tilt) / 2` wherever the tilted normal faces
/// the viewer, and nothing elsewhere. Differences see that change and the edge move, derivatives see the change
/// alone.
#[test]
fn the_edge_is_what_a_derivative_misses() {
    let diffuse = r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf>"#;
    let sky = r#"<emitter type="constant"><rgb name="radiance" value="0.5"/></emitter>"#;
    let s = ball(diffuse, sky);
    let radiance = |h: f64| {
        let [x, y, z] = NORMAL.map(|c| 2.0 * c - 1.0);
        0.7 * 0.5 * (1.0 + Vec3::new(x, y + 2.0 * h, z).normalize().z) / 2.0
    };
    let slope = |a: f64, b: f64| (a - b) / (2.0 * STEP);
    let [more, less, now] = [STEP, -STEP, 0.0].map(|h| lit(&s, &moved(&s, h)));
    let [fd, d] = both(&s);
    let change = slope(radiance(STEP), radiance(-STEP));
    let limit = z_limit(2 * SIZE * SIZE, REPEATS, 1e-3);
    // As fine as the grid of rays.
    let exact = |mean: f64, found: &Estimate| {
        let se = 0.02 * mean.abs();
        found.z(&Estimate { mean, se })
    };
    let mut missed = 0.0;
    for p in 0..SIZE * SIZE {
        let all = slope(radiance(STEP) * more[p], radiance(-STEP) * less[p]);
        let alone = change * now[p];
        let z = [exact(all, &fd[p]), exact(alone, &d[p])];
        assert!(
            z.iter().all(|z| z.abs() < limit),
            "pixel {p}: {:?} is {all}, {:?} is {alone}",
            fd[p],
            d[p]
        );
        missed += all - alone;
    }
    println!("missed {:.4}", missed / (SIZE * SIZE) as f64);
    assert!(
        missed > 0.2 * (SIZE * SIZE) as f64,
        "{missed}: no edge in sight"
    );
}

/// Among lights that go behind the horizon of tilted normals, too: every pixel agrees where no normal turns from the
/// viewer, and all others together do not.
#[test]
fn derivatives_are_right_away_from_the_edge() {
    let around = r#"<emitter type="constant"><rgb name="radiance" value="0.4, 0.5, 0.6"/></emitter>
        <shape type="rectangle">
            <transform name="to_world"><scale value="3"/><rotate x="1" angle="-90"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf></shape>
        <shape type="rectangle">
            <transform name="to_world"><scale value="0.8"/><rotate x="1" angle="90"/><translate x="0.5" y="3" z="1"/></transform>
            <bsdf type="diffuse"><rgb name="reflectance" value="0.1"/></bsdf>
            <emitter type="area"><rgb name="radiance" value="5, 4, 3"/></emitter></shape>"#;
    for nested in [
        r#"<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf>"#,
        r#"<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>"#,
    ] {
        let s = ball(nested, around);
        let [more, less] = [STEP, -STEP].map(|h| lit(&s, &moved(&s, h)));
        let [fd, d] = both(&s);
        let limit = z_limit(SIZE * SIZE, REPEATS, 1e-3);
        let (mut smooth, mut edges, mut apart, mut spread) = (0, 0, 0.0, 0.0f64);
        for p in 0..SIZE * SIZE {
            if more[p] == less[p] {
                smooth += 1;
                let z = d[p].z(&fd[p]);
                assert!(
                    z.abs() < limit,
                    "{nested} pixel {p}: {:?} {:?}",
                    d[p],
                    fd[p]
                );
            } else {
                edges += 1;
                apart += fd[p].mean - d[p].mean;
                spread = spread.hypot(fd[p].se.hypot(d[p].se));
            }
        }
        println!("{smooth} pixels agree, {edges} are {apart:.2} +- {spread:.2} apart");
        assert!(smooth > 16 && edges > 16, "{smooth} {edges}");
        assert!(apart.abs() > 20.0 * spread, "{nested}: {apart} +- {spread}");
    }
}
