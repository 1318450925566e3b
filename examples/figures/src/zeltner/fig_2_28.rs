//! The box by path length [Zeltner 2021, figure 2.28].

use render::Image;
use render::Job;
use render::Scene;
use render::instances::{Estimator, render_f32};
use render::params::Theta;

use crate::common_scenes::{CORNELL, CORNELL_LAMP, Walls, cornell};
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};

const SEED: u64 = 28;
/// Longest paths.
const LONGEST: u32 = 10;

/// Paths of one edge against the lamp as the camera's rays through the corners of pixels see it.
fn lamp_alone(fig: &mut Figure, scene: &Scene, sums: &[f64], spp: u64) -> Result {
    let size = scene.film.size[0];
    let light = scene.params().find("light.emitter.radiance.value")?;
    let radiance = &scene.params().values()[light.range()];
    let on_lamp = |x: f64, y: f64| {
        let ray = scene.camera.ray(x, y);
        let [half, height] = CORNELL_LAMP;
        let t = (height - ray.o.y) / ray.d.y;
        let [px, pz] = [ray.o.x + t * ray.d.x, ray.o.z + t * ray.d.z];
        t > 0.0 && px.abs() <= half && pz.abs() <= half
    };
    let (mut inside, mut outside, mut wrong) = (0, 0, 0);
    for (i, sum) in sums.chunks_exact(3).enumerate() {
        let (x, y) = ((i % size as usize) as f64, (i / size as usize) as f64);
        // The lamp is thin in this view: corners alone could miss it.
        let grid = (0..=8).flat_map(|a| (0..=8).map(move |b| [a, b].map(|k| f64::from(k) / 8.0)));
        let hits = grid.filter(|[a, b]| on_lamp(x + a, y + b)).count();
        let mean = [0, 1, 2].map(|c: usize| sum[c] / spp as f64);
        let full = [0, 1, 2].map(|c: usize| f64::from(radiance[c]));
        let near = |m: f64, f: f64| (m - f).abs() <= 1e-5 * f;
        match hits {
            81 => {
                inside += 1;
                wrong += usize::from(!(0..3).all(|c| near(mean[c], full[c])));
            }
            0 => {
                outside += 1;
                wrong += usize::from(mean != [0.0; 3]);
            }
            _ => {}
        }
    }
    fig.check(
        "length 1 shows only the light: its radiance inside, exactly 0 outside",
        wrong == 0 && inside > 0,
        format!("{inside} pixels inside, {outside} outside, {wrong} wrong"),
    );
    Ok(())
}

/// `zeltner-2-28`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(48, 128);
    let spp = fig.pick(64, 256);
    fig.note("spp", spp);
    fig.note("seed", SEED);
    let scene = cornell(size, Walls::Matt, LONGEST)?;
    let theta = Theta::constant(scene.params().values());
    let mut sums: Vec<Vec<f64>> = Vec::new();
    let mut means = Vec::new();
    let mut bad = 0;
    for n in 1..=LONGEST {
        let mut settings = scene.settings;
        settings.max_depth = n;
        let image = render_f32(
            &Job::new(&scene, &settings, SEED, 0..spp, &()),
            &theta,
            Estimator::Mis,
        );
        bad += image.non_finite.count;
        means.push(image.mean(0));
        sums.push(image.sums[0].clone());
    }

    let falls = sums.windows(2).map(|w| {
        let pairs = w[0].iter().zip(&w[1]);
        // Sums of the same terms and more, each rounded to f32 once.
        pairs.filter(|(a, b)| **b < **a * (1.0 - 1e-6)).count()
    });
    let falls: usize = falls.sum();
    fig.check(
        "images increase with the largest path length, pixel by pixel (common samples)",
        falls == 0 && bad == 0,
        format!(
            "{falls} decreases in {} values of {LONGEST} images",
            sums[0].len()
        ),
    );

    lamp_alone(fig, &scene, &sums[0], spp)?;

    // Areas of what is white, left and right: five walls, and two blocks without their bottoms.
    let blocks = [[0.28, 0.6, 0.28], [0.28, 0.3, 0.28]];
    let blocks = blocks.map(|[x, y, z]: [f64; 3]| 8.0 * y * (x + z) + 4.0 * x * z);
    let areas = [12.0 + blocks[0] + blocks[1], 4.0, 4.0];
    let total: f64 = areas.iter().sum();
    let albedo = [0, 1, 2].map(|c: usize| {
        let parts = areas.iter().zip(CORNELL).map(|(a, rgb)| a * rgb[c]);
        parts.sum::<f64>() / total
    });
    let increments: Vec<[f64; 3]> = means
        .windows(2)
        .map(|w| [0, 1, 2].map(|c: usize| w[1][c] - w[0][c]))
        .collect();
    let ratios: Vec<[f64; 3]> = increments
        .windows(2)
        .map(|w| [0, 1, 2].map(|c: usize| w[1][c] / w[0][c]))
        .collect();
    let largest = [0, 1, 2].map(|c: usize| ratios.iter().map(|r| r[c]).fold(0.0, f64::max));
    fig.check(
        "the sum converges: successive increments fall by more than the average albedo",
        (0..3).all(|c| largest[c] < albedo[c]),
        format!(
            "largest ratio {largest:.3?} (lengths 2 to {LONGEST}), average albedo {albedo:.3?}"
        ),
    );

    let rows = means.iter().enumerate().map(|(i, m)| {
        let nan = [f64::NAN; 3];
        let inc = if i > 0 { increments[i - 1] } else { nan };
        let ratio = if i > 1 { ratios[i - 2] } else { nan };
        [
            i as f64 + 1.0,
            m[0],
            m[1],
            m[2],
            inc[0],
            inc[1],
            inc[2],
            ratio[0],
            ratio[1],
            ratio[2],
        ]
    });
    let header = [
        "length",
        "red",
        "green",
        "blue",
        "d red",
        "d green",
        "d blue",
        "ratio red",
        "ratio green",
        "ratio blue",
    ];
    fig.csv("lengths", &header, rows);
    let at = |k: usize| (k + 2) as f64;
    let mut chart = LineChart::new("Light by path length", "length", "mean increment").log_y();
    for (c, label) in ["red", "green", "blue"].into_iter().enumerate() {
        let points = increments.iter().enumerate().map(|(k, i)| (at(k), i[c]));
        let first = increments[0][c];
        let bound = (0..increments.len()).map(|k| (at(k), first * albedo[c].powi(k as i32)));
        chart = chart.measured(label, points.collect::<Vec<_>>()).dashed(
            &format!("{label}: average albedo"),
            bound.collect::<Vec<_>>(),
        );
    }
    fig.chart("increments", &chart);
    let image = |sum: &[f64]| Image {
        width: size as usize,
        height: size as usize,
        data: sum.iter().map(|s| (s / spp as f64) as f32).collect(),
    };
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: String, sum: &[f64]| Panel::tonemapped(&label, &image(sum), 1.0).enlarged(enlarge);
    let mut panels: Vec<Panel> = [1, 2, 3, LONGEST]
        .map(|n| panel(format!("length up to {n}"), &sums[n as usize - 1]))
        .into();
    for n in [2usize, 3, 4, 5] {
        let pairs = sums[n - 1].iter().zip(&sums[n - 2]);
        let only: Vec<f64> = pairs.map(|(a, b)| (a - b).max(0.0)).collect();
        panels.push(panel(format!("length {n} only"), &only));
    }
    fig.images("lengths", 4, &panels);
    Ok(())
}
