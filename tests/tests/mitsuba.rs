//! Images and gradients of Mitsuba's scenes against converged references; skipped without the shared
//! data.
//!
//! Rules: means over the image and gradients agree at a significance of 1 in 1000 together. A block of pixels agrees at one of
//! 1 in 200 by itself, and 99 % of the blocks must (one may always miss: its channels share their samples).

use std::path::Path;

use render::Scene;
use render::scene::LoadOptions;
use serde_json::Value;
use tests::stats::{Estimate, z_limit};
use tests::{image, mean_adjoint, reverse, shared_dir, values};

const REPEATS: u64 = 32;

fn load(shared: &Path, name: &str, res: usize) -> Scene {
    let options = LoadOptions {
        defines: vec![("res".into(), res.to_string())],
        ..LoadOptions::default()
    };
    let path = shared.join(format!("peer/scenes/{name}.xml"));
    Scene::load(&path, &options)
        .unwrap_or_else(|e| panic!("{e}"))
        .0
}

fn references(shared: &Path) -> Value {
    let text = std::fs::read_to_string(shared.join("peer/references/references.json"));
    serde_json::from_str(&text.expect("references.json")).expect("valid JSON")
}

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn check_image(name: &str, spp: u64) {
    let Some(shared) = shared_dir() else { return };
    let reference = &references(&shared)["primal"][name];
    let res = number(&reference["res"]) as usize;
    let scene = load(&shared, name, res);
    let v = values::<f32>(&scene);
    let runs: Vec<_> = (0..REPEATS)
        .map(|r| image::<f32>(&scene, &v, &scene.settings, 77 + r, spp))
        .collect();
    assert!(runs.iter().all(|r| r.non_finite.count == 0));

    let whole: Vec<f64> = (0..3)
        .map(|c| {
            let ours = Estimate::of(&runs.iter().map(|r| r.mean(0)[c]).collect::<Vec<_>>());
            ours.z(&Estimate {
                mean: number(&reference["mean_rgb"][c]),
                se: number(&reference["mean_rgb_se"][c]),
            })
        })
        .collect();
    println!("{name}: z of the mean {whole:.2?}");
    let limit = z_limit(3, REPEATS, 1e-3);
    assert!(
        whole.iter().all(|z| z.abs() < limit),
        "{name}: mean, z = {whole:?}"
    );

    let (blocks, block_se) = (&reference["block8x8_rgb"], &reference["block8x8_se"]);
    let rows = blocks.as_array().expect("rows").len();
    let size = res / rows;
    let limit = z_limit(1, REPEATS, 5e-3);
    let (mut outside, mut total, mut worst) = (0, 0, 0.0f64);
    for by in 0..rows {
        for bx in 0..rows {
            for c in 0..3 {
                let mean = |r: &render::integrator::render::Rendering| {
                    let mut sum = 0.0;
                    for y in 0..size {
                        for x in 0..size {
                            sum += r.sums[0][((by * size + y) * res + bx * size + x) * 3 + c];
                        }
                    }
                    sum / (size * size) as f64 / spp as f64
                };
                let ours = Estimate::of(&runs.iter().map(mean).collect::<Vec<_>>());
                let theirs = Estimate {
                    mean: number(&blocks[by][bx][c]),
                    se: number(&block_se[by][bx][c]),
                };
                let z = ours.z(&theirs);
                total += 1;
                // A block that both see as exactly black has z = 0; one that only we see has z = inf.
                outside += u32::from(z.is_nan() || z.abs() > limit);
                worst = worst.max(z.abs());
            }
        }
    }
    println!(
        "{name}: {outside} of {total} blocks outside {limit:.2} standard errors, worst {worst:.2}"
    );
    assert!(
        f64::from(outside) <= (0.01 * f64::from(total)).max(3.0),
        "{name}: {outside} of {total}"
    );
}

/// 32 x 16 samples per pixel at 128 x 128.
#[test]
fn cornell() {
    check_image("cornell", 16);
}

/// 32 x 16 samples per pixel at 128 x 128.
#[test]
fn cornell_texture() {
    check_image("cornell-texture", 16);
}

/// 32 x 16 samples per pixel at 128 x 128.
#[test]
fn veach_plates() {
    check_image("veach-plates", 16);
}

/// 32 x 64 samples per pixel at 64 x 64.
#[test]
fn pool_caustic() {
    check_image("pool-caustic", 64);
}

/// 32 x 16 samples per pixel at 128 x 128.
#[test]
fn shadow_translate() {
    check_image("shadow-translate", 16);
}

fn check_gradient(scene: &str, key: &str, spp: u64) {
    let Some(shared) = shared_dir() else { return };
    let reference = &references(&shared)["gradients"][key];
    let scene = load(&shared, scene, 64);
    let params: Vec<_> = reference["keys"]
        .as_array()
        .expect("keys")
        .iter()
        .map(|k| {
            scene
                .params()
                .find(k.as_str().expect("a name"))
                .expect("known")
                .clone()
        })
        .collect();
    let adjoint = mean_adjoint(&scene);
    let runs: Vec<Vec<f64>> = (0..REPEATS)
        .map(|r| reverse::<f32>(&scene, &params, &adjoint, &scene.settings, 9 + r, spp).concat())
        .collect();
    let n = runs[0].len();
    let limit = z_limit(n, REPEATS, 1e-3);
    for i in 0..n {
        let ours = Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>());
        let theirs = Estimate {
            mean: number(&reference["mean"][i]),
            se: number(&reference["se"][i]),
        };
        let z = ours.z(&theirs);
        println!(
            "{key}[{i}]: {:.5e} against {:.5e}, z {z:+.2}",
            ours.mean, theirs.mean
        );
        assert!(z.abs() < limit, "{key}[{i}]: z = {z}");
    }
}

/// 32 x 32 samples per pixel at 64 x 64 (the objective does not depend on the resolution).
#[test]
fn cornell_gradients() {
    check_gradient("cornell", "cornell/albedos-prb", 32);
    check_gradient("cornell", "cornell/light-prb", 32);
}

/// As above.
#[test]
fn pool_gradients() {
    check_gradient("pool-caustic", "pool-caustic/floor_albedo-prb", 64);
    check_gradient("pool-caustic", "pool-caustic/light-prb", 64);
}

/// As above.
#[test]
fn plates_gradients() {
    check_gradient("veach-plates", "veach-plates/light-prb", 32);
    check_gradient("veach-plates", "veach-plates/alphas-prb", 64);
}
