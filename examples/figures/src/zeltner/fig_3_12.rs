//! [Zeltner 2021, figure 3.12]: the slopes of a Gaussian normal map that footprints of growing size see.

use std::f64::consts::TAU;

use ad_core::Vec2;
use render::glint::{Moments, SlopeMap};
use render::params::Theta;
use render::scene::Builder;

use super::glint_scenes::Slopes;
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};

const SEED: u64 = 312;
const DEVIATION: f64 = 0.15;
/// Bins of a side, over four deviations to either side.
const BINS: usize = 40;
const REACH: f64 = 4.0 * DEVIATION;
/// Pixels of a side of a bin.
const FACTOR: usize = 6;

/// The slopes of `n` by `n` points of a square footprint.
fn slopes(
    map: &SlopeMap,
    theta: &Theta<f32>,
    at: Vec2<f64>,
    side: f64,
    n: usize,
) -> Vec<Vec2<f64>> {
    let of = |i: usize| side * ((i as f64 + 0.5) / n as f64 - 0.5);
    let point = |k: usize| at + Vec2::new(of(k % n), of(k / n));
    let slope = |k: usize| Some(map.slope(theta, point(k))?.0);
    (0..n * n).filter_map(slope).collect()
}

/// Shares of slopes by bins.
fn histogram(slopes: &[Vec2<f64>]) -> Vec<f64> {
    let mut bins = vec![0.0; BINS * BINS];
    let bin = |x: f64| ((x / REACH + 1.0) * 0.5 * BINS as f64).clamp(0.0, BINS as f64 - 1.0);
    for s in slopes {
        bins[bin(s.y) as usize * BINS + bin(s.x) as usize] += 1.0 / slopes.len() as f64;
    }
    bins
}

/// The slope at an angle on the ellipse of so many deviations of a normal distribution.
fn on_ellipse(moments: &Moments, deviations: f64, angle: f64) -> Vec2<f64> {
    // The root of the covariance that is a triangle.
    let [xx, xy, yy] = moments.covariance;
    let a = xx.sqrt();
    let b = xy / a.max(f64::MIN_POSITIVE);
    let c = (yy - b * b).max(0.0).sqrt();
    let (sin, cos) = angle.sin_cos();
    moments.mean + Vec2::new(a * cos, b * cos + c * sin) * deviations
}

/// Draws the ellipses of one and two deviations of `moments` over a picture of bins, each `factor` pixels wide.
fn draw_ellipses(panel: &mut Panel, moments: &Moments, factor: usize) {
    const SIDES: usize = 96;
    const ORANGE: [u8; 3] = [255, 120, 0];
    let pixel = |s: Vec2<f64>| [s.x, s.y].map(|x| (x / REACH + 1.0) * 0.5 * (BINS * factor) as f64);
    let corner = |deviations: f64, k: usize| {
        let angle = TAU * k as f64 / SIDES as f64;
        pixel(on_ellipse(moments, deviations, angle))
    };
    for deviations in [1.0, 2.0] {
        for k in 0..SIDES {
            panel.line(corner(deviations, k), corner(deviations, k + 1), ORANGE);
        }
    }
}

/// Mean of the squared distance from the mean in the metric of the covariance, and the shares within one and two deviations.
fn within(moments: &Moments, slopes: &[Vec2<f64>]) -> [f64; 3] {
    let [xx, xy, yy] = moments.covariance;
    let det = xx * yy - xy * xy;
    let squares = slopes.iter().map(|s| {
        let d = *s - moments.mean;
        (yy * d.x * d.x - 2.0 * xy * d.x * d.y + xx * d.y * d.y) / det
    });
    let mut sums = [0.0; 3];
    for square in squares {
        sums[0] += square;
        sums[1] += f64::from(u8::from(square < 1.0));
        sums[2] += f64::from(u8::from(square < 4.0));
    }
    sums.map(|x| x / slopes.len() as f64)
}

/// Shares of bins of a normal distribution, by the midpoint rule.
fn limit(moments: &Moments) -> Vec<f64> {
    let width = 2.0 * REACH / BINS as f64;
    let of = |k: usize| (k as f64 + 0.5) * width - REACH;
    (0..BINS * BINS)
        .map(|k| moments.density(Vec2::new(of(k % BINS), of(k / BINS))) * width * width)
        .collect()
}

fn variation(a: &[f64], b: &[f64]) -> f64 {
    0.5 * a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>()
}

/// How much of the histograms lies within the ellipses that are drawn over them: `inside` are the means of [`within`] for each side.
fn drawn_inside(fig: &mut Figure, sides: &[f64], inside: &[[f64; 3]]) {
    let [first, last] = [&inside[0], &inside[inside.len() - 1]];
    fig.check(
        "in the metric of the ellipses the slopes of the whole map are two from the mean, squared, as there are two of them",
        (last[0] / 2.0 - 1.0).abs() < 0.01,
        format!("{:.4}, {:.2} over the smallest footprints", last[0], first[0]),
    );
    // Of a normal distribution.
    let expected = [1.0, 2.0].map(|deviations: f64| 1.0 - (-0.5 * deviations * deviations).exp());
    let off = |found: &[f64; 3]| [0, 1].map(|k| (found[k + 1] - expected[k]).abs());
    let (small, large) = (off(first), off(last));
    fig.check(
        "ellipses of one and two deviations hold what they hold of a normal distribution on the whole map, not so in small footprints",
        (0..2).all(|k| large[k] < 0.02 && large[k] < small[k]),
        format!(
            "{:.3} and {:.3} of {expected:.3?}; {:.3} and {:.3} in the smallest",
            last[1], last[2], first[1], first[2]
        ),
    );
    let of = |k: usize| {
        sides
            .iter()
            .zip(inside)
            .map(move |(side, x)| (side * side, x[k]))
    };
    let ends = [sides[0], sides[sides.len() - 1]].map(|side| side * side);
    let chart = LineChart::new("slopes within ellipses", "texels", "share")
        .log_x()
        .y_range(0.0, 1.05)
        .measured("one deviation", of(1))
        .measured("two deviations", of(2))
        .dashed("normal distribution", ends.map(|x| (x, expected[0])))
        .dashed("", ends.map(|x| (x, expected[1])));
    fig.chart("ellipses", &chart);
}

/// Bins that are higher than twice the limit and than all around them.
fn peaks(bins: &[f64], limit: &[f64]) -> usize {
    let inner = 1..BINS - 1;
    let all = inner
        .clone()
        .flat_map(|y| inner.clone().map(move |x| y * BINS + x));
    all.filter(|&k| {
        let around = [
            k - BINS - 1,
            k - BINS,
            k - BINS + 1,
            k - 1,
            k + 1,
            k + BINS - 1,
            k + BINS,
            k + BINS + 1,
        ];
        bins[k] > 2.0 * limit[k] && bins[k] > 1e-3 && around.iter().all(|&i| bins[i] < bins[k])
    })
    .count()
}

/// `zeltner-3-12`.
///
/// # Errors
/// None that the built-in map can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (size, points, places) = (fig.pick(256, 1024), fig.pick(300, 1000), fig.pick(6, 12));
    fig.note("size", size);
    fig.note("points", points * points);
    fig.note("places", places);
    fig.note("seed", SEED);
    let mut build = Builder::new();
    let metal = Slopes::gaussian(size, DEVIATION, SEED).metal(&mut build, 1.0)?;
    let theta = Theta::<f32>::constant(build.params().values());
    let map = SlopeMap::new(&metal, &theta).ok_or("a map that is no image")?;
    let whole = map.moments(&theta, Vec2::zero(), [size as f64; 2]);
    let normal = limit(&whole);
    let high = 4.0 * normal.iter().copied().fold(0.0, f64::max);
    let sides: Vec<f64> = (2..)
        .map(|k| f64::from(1 << k))
        .take_while(|&s| s <= size as f64)
        .collect();
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    let (mut off, mut most): (f64, f64) = (0.0, 0.0);
    let mut inside = Vec::new();
    for &side in &sides {
        let (mut distance, mut count) = (0.0, 0.0);
        let mut ellipses = [0.0; 3];
        for place in 0..places {
            let place = f64::from(place);
            let at = Vec2::new(17.3 + 41.7 * place, 29.1 + 77.3 * place);
            let seen = slopes(&map, &theta, at, side, points);
            let bins = histogram(&seen);
            distance += variation(&bins, &normal) / f64::from(places);
            count += peaks(&bins, &normal) as f64 / f64::from(places);
            // Moments of the pyramid against those of the points.
            let width = 2.0 * REACH / BINS as f64;
            let of = |k: usize| (k as f64 + 0.5) * width - REACH;
            let mean: f64 = bins.iter().enumerate().map(|(k, b)| b * of(k % BINS)).sum();
            let square: f64 = (bins.iter().enumerate())
                .map(|(k, b)| b * of(k % BINS).powi(2))
                .sum();
            let found = map.moments(&theta, at, [0.5 * side; 2]);
            let deviation = (square - mean * mean).max(0.0).sqrt();
            off = off.max((found.mean.x - mean).abs());
            most = most.max((found.covariance[0].sqrt() - deviation).abs());
            for (sum, x) in ellipses.iter_mut().zip(within(&found, &seen)) {
                *sum += x / f64::from(places);
            }
            if place == 0.0 {
                let label = format!("{side} texels");
                let mut panel =
                    Panel::false_colour(&label, BINS, &bins, 0.0, high).enlarged(FACTOR);
                draw_ellipses(&mut panel, &found, FACTOR);
                panels.push(panel);
            }
        }
        rows.push([side * side, distance, count]);
        inside.push(ellipses);
    }
    let mut panel = Panel::false_colour("limit", BINS, &normal, 0.0, high).enlarged(FACTOR);
    draw_ellipses(&mut panel, &whole, FACTOR);
    panels.push(panel);
    let texels: Vec<f64> = (0..size * size)
        .map(|k| {
            let t = Vec2::new((k % size) as f64, (k / size) as f64);
            map.slope(&theta, t).map_or(0.0, |(s, _)| s.x)
        })
        .collect();
    let decreasing = rows.windows(2).all(|w| w[1][1] < w[0][1]);
    fig.check(
        "the larger the footprint, the nearer to a normal distribution",
        decreasing,
        format!(
            "total variation falls from {:.3} at {} texels to {:.3} at {}",
            rows[0][1],
            rows[0][0],
            rows[rows.len() - 1][1],
            rows[rows.len() - 1][0]
        ),
    );
    fig.check(
        "small footprints have many peaks, the whole map has none",
        rows[0][2] > 3.0 && rows[rows.len() - 1][2] < 1.0,
        format!(
            "{:.1} on average, and {:.1}",
            rows[0][2],
            rows[rows.len() - 1][2]
        ),
    );
    fig.check(
        "the pyramid has the moments of footprints",
        off < 0.35 * DEVIATION && most < 0.35 * DEVIATION,
        format!("means are at most {off:.4} off, deviations {most:.4}, of {DEVIATION}"),
    );
    drawn_inside(fig, &sides, &inside);
    let bytes = map.bytes();
    fig.check(
        "moments take less than the map",
        bytes < size * size * 12,
        format!(
            "{:.2} bytes a texel, of 12",
            bytes as f64 / (size * size) as f64
        ),
    );
    fig.image(
        "map",
        &Panel::signed("slopes along x", size, &texels, Some(3.0 * DEVIATION)),
    );
    fig.images("footprints", 4, &panels);
    let chart = LineChart::new("slopes of footprints", "texels", "total variation")
        .log_x()
        .line("to the limit", rows.iter().map(|r| (r[0], r[1])));
    fig.chart("variation", &chart);
    fig.csv("variation", &["texels", "total_variation", "peaks"], rows);
    Ok(())
}
