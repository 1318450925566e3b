//! The light tracer against the path tracer.

use rayon::ThreadPoolBuilder;
use render::bsdf::kernel::Rules;
use render::instances::{Technique, particles_f32, render_f32};
use render::params::Theta;
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{cases, scene};

/// Channels of square blocks of pixels: one estimate from each of `runs` seeds.
fn blocks(data: &[f32], size: usize, block: usize) -> Vec<f64> {
    let n = size / block;
    let mut out = vec![0.0; n * n * 3];
    for y in 0..n * block {
        for x in 0..n * block {
            for c in 0..3 {
                let to = ((y / block) * n + x / block) * 3 + c;
                out[to] += f64::from(data[(y * size + x) * 3 + c]) / (block * block) as f64;
            }
        }
    }
    out
}

fn estimates(runs: &[Vec<f64>]) -> Vec<Estimate> {
    (0..runs[0].len())
        .map(|i| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>()))
        .collect()
}

fn by_particles(scene: &Scene, settings: &Settings, rules: Rules, seed: u64, spp: u64) -> Vec<f32> {
    let theta = Theta::constant(scene.params().values());
    let r = particles_f32(scene, &theta, rules, settings, seed, 0..spp, &());
    assert_eq!(r.non_finite.count, 0);
    r.image(0).data
}

fn by_paths(scene: &Scene, settings: &Settings, seed: u64, spp: u64) -> Vec<f32> {
    let theta = Theta::constant(scene.params().values());
    let technique = Technique::MisPower;
    let r = render_f32(scene, &theta, technique, settings, seed, 0..spp, &());
    r.image(0).data
}

/// Largest |z| over blocks and channels, its limit at 1e-3 over all of them (Sidak; normal tails: 64 runs, and
/// a quarter more for those of Student's t), and the relative difference of the means.
fn compare(scene: &Scene, block: usize, spp: u64, rules: Rules) -> (f64, f64, f64) {
    let runs = 64;
    let size = scene.film.crop_size[0] as usize;
    let settings = scene.settings;
    let particles: Vec<_> = (0..runs)
        .map(|s| blocks(&by_particles(scene, &settings, rules, s, spp), size, block))
        .collect();
    let paths: Vec<_> = (0..runs)
        .map(|s| blocks(&by_paths(scene, &settings, 1000 + s, spp), size, block))
        .collect();
    let (a, b) = (estimates(&particles), estimates(&paths));
    let worst = a
        .iter()
        .zip(&b)
        .map(|(a, b)| a.z(b).abs())
        .fold(0.0, f64::max);
    let sum = |e: &[Estimate]| e.iter().map(|e| e.mean).sum::<f64>();
    let limit = 1.25 * z_limit(a.len(), 1e-3);
    (worst, limit, sum(&a) / sum(&b) - 1.0)
}

fn agrees(name: &str, scene: &Scene, block: usize, spp: u64) {
    let (worst, limit, mean) = compare(scene, block, spp, Rules::default());
    println!(
        "{name}: |z| up to {worst:.2} of {limit:.2}, means differ by {:.3} %",
        mean * 100.0
    );
    assert!(worst < limit, "{name}: |z| = {worst} > {limit}");
}

/// All materials and emitters, as far as a pinhole sees them directly.
#[test]
fn particles_and_paths_agree_for_all_materials_and_emitters() {
    for case in cases::all() {
        let s = scene(&case.body);
        // A mirror or smooth glass shows nothing to particles.
        let deltas = ["conductor", "dielectric", "plastic", "mask"];
        if !deltas.contains(&case.name) {
            agrees(case.name, &s, 4, 128);
        }
    }
}

#[test]
fn particles_do_not_depend_on_threads_and_crops_are_parts() {
    let body = cases::all()[0].body.replace("value=\"8\"", "value=\"40\"");
    for filter in ["box", "gaussian"] {
        let body = body.replace("type=\"box\"", &format!("type=\"{filter}\""));
        let s = scene(&body);
        let run = |threads: usize| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            let render = || by_particles(&s, &s.settings, Rules::default(), 5, 50);
            pool.expect("a pool").install(render)
        };
        let one = run(1);
        assert!(one.iter().any(|&x| x > 0.0));
        for threads in [2, 7] {
            assert!(run(threads) == one, "{filter}: {threads} threads differ");
        }
        let crop = r#"<integer name="crop_offset_x" value="7"/><integer name="crop_offset_y" value="11"/>
            <integer name="crop_width" value="20"/><integer name="crop_height" value="9"/><rfilter"#;
        let part = scene(&body.replacen("<rfilter", crop, 1));
        let cropped = by_particles(&part, &part.settings, Rules::default(), 5, 50);
        for (i, p) in cropped.chunks_exact(3).enumerate() {
            let (x, y) = (i % 20 + 7, i / 20 + 11);
            assert_eq!(p, &one[(y * 40 + x) * 3..][..3], "{filter}: {x} {y}");
        }
    }
}
