//! [Stam 2020, appendix D]: the pseudocode of the path tracer in a closed furnace, as printed and as
//! corrected, beside the renderer of this repository.

use render::Job;
use render::bsdf::Diffuse;
use render::camera::{Camera, FovAxis};
use render::emitter::Area;
use render::instances::{Estimator, backward_f64, render_f64};
use render::integrator::gradient::Active;
use render::math::Transform;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::Builder;
use render::statistics::{Estimate, z_limit};
use render::{Film, Scene, Settings};

use super::cornell::faces;
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const ALBEDO: f64 = 0.5;
const ABSORB: f64 = 0.3;

/// Mean of `n` numbers and its standard error.
fn mean(n: u64, f: impl FnMut(u64) -> f64) -> Estimate {
    (0..n).map(f).collect::<Moments>().of_mean()
}

/// A path in a closed furnace: number of scatterings, and whether it ended by absorption (and not by
/// the depth limit).
fn make_path(index: u64, absorb: f64, max_depth: usize) -> (usize, bool) {
    let mut sampler = Independent::new(21, 0, index);
    for scatterings in 0..max_depth {
        if sampler.next_1d::<f64>() < absorb {
            return (scatterings, true);
        }
    }
    (max_depth - 1, false)
}

/// Forward and backward pass of one path: radiance, and derivatives in albedo and emission.
fn pass(index: u64, emission: f64, printed: bool, max_depth: usize) -> [f64; 3] {
    let (scatterings, absorbed) = make_path(index, ABSORB, max_depth);
    if !absorbed && !printed {
        return [0.0; 3]; // errata S-D6
    }
    let survive = 1.0 - ABSORB;
    let end = emission / ABSORB;
    if printed {
        let radiance = end * ALBEDO.powi(scatterings as i32);
        let (mut adjoint, mut d_albedo) = (1.0, 0.0);
        for k in 0..scatterings {
            let arriving = end * ALBEDO.powi((scatterings - 1 - k) as i32);
            d_albedo += arriving / survive * adjoint;
            adjoint *= ALBEDO;
        }
        return [radiance, d_albedo, end * adjoint];
    }
    let step = ALBEDO / survive;
    let radiance = end * step.powi(scatterings as i32);
    let (mut adjoint, mut d_albedo) = (1.0, 0.0);
    for k in 0..scatterings {
        let arriving = end * step.powi((scatterings - 1 - k) as i32);
        d_albedo += arriving * adjoint / survive;
        adjoint *= step;
    }
    [radiance, d_albedo, adjoint / ABSORB]
}

/// The same furnace for the renderer: a closed box whose walls emit 1 and reflect a half.
fn furnace() -> Result<Scene> {
    let mut b = Builder::new();
    let reflectance = b.rgb("walls.reflectance.value", [ALBEDO; 3], (0.0, 1.0))?;
    let radiance = b.rgb("walls.radiance.value", [1.0; 3], (0.0, f64::INFINITY))?;
    let walls = b.add_material(Diffuse { reflectance });
    for wall in faces()? {
        let shape = b.add_shape("wall", wall, walls);
        let light = Area {
            radiance: radiance.clone(),
            exponent: 0.0,
            shape,
        };
        b.add_emitter(light, Some(shape));
    }
    let to_world = Transform::look_at([0.1, 0.2, 0.3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]);
    let camera = Camera::new(to_world.ok_or("no camera")?, 90.0, FovAxis::X, [8; 2])?;
    let settings = Settings {
        max_depth: u32::MAX,
        rr_depth: 4,
        spp: 1,
        ..Settings::default()
    };
    Ok(b.build(camera, Film::new(8, 8), settings)?)
}

/// A depth that no path reaches.
const DEEP: usize = 1000;

fn text(found: Estimate, x: f64) -> String {
    let Estimate { mean, se } = found;
    format!("{mean:.4} ± {se:.4}, expected {x}")
}

/// The cost is one of pixels, not of samples (S-D5).
fn cost_per_pixel(fig: &mut Figure) {
    // Samples are theta x with x exponential of mean 1; the target is 1, so theta = 1 is right.
    let spp = 16u64;
    let pixels = fig.pick(20_000u64, 200_000);
    let x = |i: u64| -(-Independent::new(22, 0, i).next_1d::<f64>()).ln_1p();
    // Minimisers of sum (theta a_j - 1)^2: sum a_j / sum a_j^2.
    let minimiser = |values: &dyn Fn(u64) -> f64, count: u64| {
        let (mut a, mut b) = (0.0, 0.0);
        for i in 0..count {
            let v = values(i);
            a += v;
            b += v * v;
        }
        a / b
    };
    // Unbiased: the product of two independent pixel estimates takes the place of the square.
    let (mut sum, mut product) = (0.0, 0.0);
    for p in 0..pixels {
        let m =
            |offset: u64| (0..spp).map(|s| x((2 * p + offset) * spp + s)).sum::<f64>() / spp as f64;
        let (a, b) = (m(0), m(1));
        sum += 0.5 * (a + b);
        product += a * b;
    }
    let per_pixel = sum / product;
    let per_sample = minimiser(&|i| x(i) / spp as f64, pixels * spp);
    let undivided = minimiser(&|i| x(i), pixels * spp);
    fig.check(
        "(c) cost per pixel, adjoint from independent samples: the minimiser is the true parameter",
        (per_pixel - 1.0).abs() < 0.02,
        format!("{per_pixel:.4}, true 1"),
    );
    fig.check(
        "(c) cost per sample, as printed, misses by N/2 (errata S-D5)",
        (per_sample - 8.0).abs() < 0.2 && (undivided - 0.5).abs() < 0.02,
        format!("{per_sample:.3} with radiance/N (N = 16), {undivided:.3} without"),
    );
}

/// The renderer in the same furnace.
fn by_the_renderer(fig: &mut Figure) -> Result {
    let scene = furnace()?;
    let spp = fig.pick(64, 1024);
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let theta = Theta::<f64>::constant(&values);
    let active = Active::new(&scene, &["walls.reflectance.value", "walls.radiance.value"])?;
    let adjoint = vec![1.0f32 / (64.0 * 3.0); 64 * 3];
    let batches = 16;
    let (mut l, mut d, mut e) = (Vec::new(), Vec::new(), Vec::new());
    for b in 0..batches {
        let (samples, settings) = (b * spp..(b + 1) * spp, &scene.settings);
        let image = render_f64(
            &Job::new(&scene, settings, 31, samples.clone(), &()),
            &theta,
            Estimator::Detached,
        );
        l.push(image.mean(0)[0]);
        let g = backward_f64(
            &Job::new(&scene, settings, 32, samples, &()),
            &theta,
            &active,
            &adjoint,
        )?;
        d.push(g.values[0].iter().sum::<f64>());
        e.push(g.values[1].iter().sum::<f64>());
    }
    let limit = z_limit(3, batches, 1e-2);
    for (what, found, expected) in [
        ("radiance", l, 2.0),
        ("albedo derivative", d, 4.0),
        ("emission derivative", e, 2.0),
    ] {
        let m = Estimate::of(&found);
        fig.check(
            format!("(b) this renderer in the same furnace: {what}"),
            (m.mean - expected).abs() < limit * m.se + 1e-6,
            text(m, expected),
        );
    }
    Ok(())
}

/// Radiance against the absorption probability.
fn absorption(fig: &mut Figure, n: u64) {
    let mut rows = Vec::new();
    for k in 1..10 {
        let absorb = f64::from(k) / 10.0;
        let survive = 1.0 - absorb;
        let m = mean(n / 10, |i| {
            let (s, _) = make_path(i, absorb, DEEP);
            (ALBEDO / survive).powi(s as i32) / absorb
        });
        rows.push([absorb, m.mean, 1.0 / (1.0 - ALBEDO * survive)]);
    }
    let chart = LineChart::new(
        "Closed furnace: roulette must not matter",
        "absorption probability",
        "radiance",
    )
    .points("corrected, sampled", rows.iter().map(|r| (r[0], r[1])))
    .line("E / (1 - albedo)", rows.iter().map(|r| (r[0], 2.0)))
    .line("printed", rows.iter().map(|r| (r[0], r[2])))
    .y_range(0.8, 2.4);
    fig.csv("roulette", &["absorb", "corrected", "printed"], rows);
    fig.chart("roulette", &chart);
}

/// `stam-alg-d`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(400_000u64, 10_000_000);
    fig.note("paths", n);
    fig.note("seed", 21);
    // Eight means: radiance and derivatives, as they should be and as printed, and with a limit of depth.
    let limit = z_limit(8, n, 1e-2);
    let near = |found: Estimate, x: f64| found.z(&Estimate::exact(x)).abs() < limit;
    let of = |k: usize, emission: f64, printed: bool, depth: usize| {
        mean(n, |i| pass(i, emission, printed, depth)[k])
    };

    // ---- Roulette (S-D3) ----
    let radiance = of(0, 1.0, false, DEEP);
    let gradient = of(1, 1.0, false, DEEP);
    fig.check(
        "(b) closed furnace: radiance E / (1 - albedo)",
        near(radiance, 2.0),
        text(radiance, 2.0),
    );
    fig.check(
        "(b) its derivative in the albedo",
        near(gradient, 4.0),
        text(gradient, 4.0),
    );
    let printed = [of(0, 1.0, true, DEEP), of(1, 1.0, true, DEEP)];
    let survive = 1.0 - ABSORB;
    let expected = 1.0 / (1.0 - ALBEDO * survive);
    fig.check(
        "(b) printed: radiance without the survival probability (errata S-D3)",
        near(printed[0], expected) && !near(printed[0], 2.0),
        text(printed[0], (expected * 1e4).round() / 1e4) + " for the printed form, 2 is true",
    );
    let expected = expected * expected;
    let own = survive * (1.0 / (1.0 - ALBEDO * survive)).powi(2);
    fig.check(
        "(b) printed: gradient that is neither that of its own forward pass nor the true one",
        near(printed[1], expected) && !near(printed[1], own) && !near(printed[1], 4.0),
        text(printed[1], (expected * 1e4).round() / 1e4)
            + &format!("; own forward pass {own:.4}, true 4"),
    );

    // ---- Emission (S-D4) ----
    let (right, wrong) = (of(2, 3.0, false, DEEP), of(2, 3.0, true, DEEP));
    fig.check(
        "derivative in the emission, 1 / (1 - albedo) at emission 3",
        near(right, 2.0),
        text(right, 2.0),
    );
    fig.check(
        "printed: too large by the emission itself (errata S-D4)",
        near(wrong, 3.0 / (1.0 - ALBEDO * survive)),
        format!(
            "{:.3} for 1.538 of the printed forward pass, 2 is true",
            wrong.mean
        ),
    );

    // ---- Depth limit (S-D6) ----
    let (right, wrong) = (
        of(0, 1.0, false, 4),
        mean(n, |i| {
            let (s, absorbed) = make_path(i, ABSORB, 4);
            let end = if absorbed { s } else { 4 };
            // Corrected roulette, but cut paths count as if absorbed.
            (ALBEDO / survive).powi(end.min(3) as i32) / ABSORB
        }),
    );
    fig.check(
        "depth limit 4: the first four terms of the series, only absorbed paths count",
        near(right, 1.875),
        text(right, 1.875),
    );
    fig.check(
        "counting paths that were cut as well is wrong (errata S-D6)",
        !near(wrong, 1.875) && wrong.mean > 1.9,
        format!("{:.3} instead of 1.875", wrong.mean),
    );

    cost_per_pixel(fig);
    by_the_renderer(fig)?;
    absorption(fig, n);
    Ok(())
}
