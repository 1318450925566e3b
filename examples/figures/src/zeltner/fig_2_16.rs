//! The factors of the rendering equation at two points [Zeltner 2021, figure 2.16].

use ad_core::Vec3;
use rayon::prelude::*;
use render::bsdf::{Bsdf, Shading, TransportMode};
use render::params::Theta;
use render::{Image, Scene};

use super::radiance_split::radiance;
use crate::common_scenes::{Walls, cornell};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::picture;

const SEED: u64 = 216;
/// Longest paths.
const DEPTH: u32 = 6;
/// Positions in the picture, as fractions of it.
const POINTS: [(&str, [f64; 2]); 2] = [
    ("glossy back wall", [0.68, 0.42]),
    ("diffuse floor", [0.3, 0.93]),
];

/// The upper hemisphere at a point, seen from above: `[size][size]`, black outside the unit disc.
struct Hemisphere {
    bsdf: Image,
    incident: Image,
    product: Image,
    /// Integral of the product.
    integral: [f64; 3],
}

/// `zeltner-2-16`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(96, 256);
    let cells = fig.pick(64, 128);
    let per_cell = fig.pick(48, 192);
    let pixel_samples = fig.pick(200_000, 2_000_000);
    fig.note("cells", cells);
    fig.note("samples per cell", per_cell);
    fig.note("samples of the pixel value", pixel_samples);
    fig.note("seed", SEED);
    let scene = cornell(size, Walls::GlossyBack, DEPTH)?;
    let image = picture(&scene, SEED, fig.pick(32, 256));
    let mut whole = Panel::tonemapped("where", &image.image(0), 1.0).enlarged(fig.pick(4, 2));
    let side = f64::from(size * fig.pick(4, 2));
    let mut rows = Vec::new();
    for (k, (name, at)) in POINTS.into_iter().enumerate() {
        let position = at.map(|f| f * f64::from(size));
        whole.dot(at.map(|f| f * side), 5.0, [255, 220, 0]);
        let camera = scene.camera.ray(position[0] as f32, position[1] as f32);
        let stream = 1 << 40 | k as u64;
        // In parts, so that all cores help.
        let parts: Vec<_> = (0..64u64)
            .into_par_iter()
            .map(|part| {
                let n = pixel_samples / 64;
                let samples = part * n..(part + 1) * n;
                radiance(&scene, |_| camera, DEPTH, SEED, stream, samples)
                    .map_err(|e| e.to_string())
            })
            .collect::<std::result::Result<_, String>>()?;
        let mean = |f: &dyn Fn(usize) -> [f64; 3]| {
            let mut sum = [0.0; 3];
            for i in 0..parts.len() {
                let x = f(i);
                (0..3).for_each(|c| sum[c] += x[c] / parts.len() as f64);
            }
            sum
        };
        let value = mean(&|i| parts[i].total);
        let emitted = mean(&|i| parts[i].emitted);
        let h = hemisphere(&scene, position, cells, per_cell, SEED + 1 + k as u64)?;
        let found = [0, 1, 2].map(|c: usize| h.integral[c] + emitted[c]);
        let errors = [0, 1, 2].map(|c: usize| (found[c] / value[c] - 1.0).abs());
        let worst = errors.into_iter().fold(0.0, f64::max);
        fig.check(
            format!("{name}: integral of the product plus emission is the pixel value within 1 %"),
            worst < 0.01,
            format!(
                "{found:.4?} and {value:.4?}, emission {emitted:?}: {:.2} % apart",
                100.0 * worst
            ),
        );
        for c in 0..3 {
            rows.push([k as f64, c as f64, h.integral[c], emitted[c], value[c]]);
        }
        let brightest = h.bsdf.data.iter().fold(0.0f32, |m, &x| m.max(x));
        let panels = [
            Panel::tonemapped("BSDF", &h.bsdf, 1.0 / f64::from(brightest.max(1e-6))),
            Panel::tonemapped("incident light", &h.incident, 1.5),
            Panel::tonemapped("BSDF x light x cosine", &h.product, 3.0),
        ];
        let panels = panels.map(|p| p.enlarged(fig.pick(4, 2)));
        fig.images(&format!("point-{k}"), 3, &panels);
    }
    fig.image("points", &whole);
    let header = ["point", "channel", "integral", "emission", "pixel"];
    fig.csv("integrals", &header, rows);
    Ok(())
}

/// The factors at what the camera sees at `position`, on a grid over the projected hemisphere: a cell of
/// the unit disc holds the same projected solid angle as any other.
fn hemisphere(
    scene: &Scene,
    position: [f64; 2],
    cells: usize,
    per_cell: u64,
    seed: u64,
) -> Result<Hemisphere> {
    let camera = scene.camera.ray(position[0] as f32, position[1] as f32);
    let hit = scene.intersect(&camera).ok_or("nothing there")?;
    let exit = scene.exit(hit.prim);
    let (si, material) = (hit.si, scene.material(hit.shape));
    let at = Shading::new(Theta::constant(scene.params().values()), si.uv);
    let wo = si.frame.to_local(-camera.d);
    // A jittered place within the cell; cells on the rim count with the part that is inside.
    let direction = |x: usize, y: usize, u: [f32; 2]| {
        let place = |i: usize, u: f32| 2.0 * (i as f32 + u) / cells as f32 - 1.0;
        let (x, y) = (place(x, u[0]), -place(y, u[1]));
        let squared = 1.0 - x * x - y * y;
        (squared > 1e-6).then(|| Vec3::new(x, y, squared.sqrt()))
    };
    let rows: Vec<Vec<[[f64; 3]; 3]>> = (0..cells)
        .into_par_iter()
        .map(|y| {
            let row = (0..cells).map(|x| {
                let mut sums = [[0.0; 3]; 3];
                for s in 0..per_cell {
                    let stream = ((y * cells + x) as u64) * per_cell + s;
                    let u = jitter(seed, stream, s, per_cell);
                    let Some(wi) = direction(x, y, u) else {
                        continue;
                    };
                    let (f, _) = material.eval_pdf(&at, wo, wi, TransportMode::Radiance);
                    let ray = si.spawn_ray(si.frame.to_world(wi), exit);
                    let l = radiance(scene, |_| ray, DEPTH - 1, seed, stream, 0..1)
                        .map_err(|e| e.to_string())?;
                    for c in 0..3 {
                        let f = f64::from(f[c]);
                        // `f` has the cosine, the projected measure has it as well.
                        let bare = f / f64::from(wi.z);
                        sums[0][c] += bare;
                        sums[1][c] += l.total[c];
                        sums[2][c] += bare * l.total[c];
                    }
                }
                Ok(sums.map(|s| s.map(|s| s / per_cell as f64)))
            });
            row.collect()
        })
        .collect::<std::result::Result<_, String>>()?;
    let image = |k: usize| {
        let mut image = Image::new(cells, cells);
        let values = rows.iter().flatten().flat_map(|cell| cell[k]);
        for (out, v) in image.data.iter_mut().zip(values) {
            *out = v as f32;
        }
        image
    };
    let area = (2.0 / cells as f64).powi(2);
    let mut integral = [0.0; 3];
    for cell in rows.iter().flatten() {
        (0..3).for_each(|c| integral[c] += cell[2][c] * area);
    }
    Ok(Hemisphere {
        bsdf: image(0),
        incident: image(1),
        product: image(2),
        integral,
    })
}

/// Sample `s` of `n` in a cell, stratified on a square grid if `n` is large enough.
fn jitter(seed: u64, stream: u64, s: u64, n: u64) -> [f32; 2] {
    use render::sampler::{Independent, Sampler};
    let side = (n as f64).sqrt() as u64;
    let mut sampler = Independent::new(seed ^ 0x6a69_7474, stream, 0);
    let u: [f32; 2] = sampler.next_2d();
    if s >= side * side {
        return u;
    }
    let k = [(s % side) as f32, (s / side) as f32];
    [0, 1].map(|i: usize| (k[i] + u[i]) / side as f32)
}
