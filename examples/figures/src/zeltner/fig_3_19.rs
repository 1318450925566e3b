//! [Zeltner 2021, figure 3.19]: where walks start on metal and on water with bumps: anywhere, after a first stage over the smooth
//! surface, or where particles passed.

use render::Scene;
use render::scene::{Method, Starts};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{Waves, bumpy, metal, mirrored, pool};
use crate::statistics::check_same;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 319;
/// Standard deviation of the slopes of metal, and of water, which turns rays less.
const SLOPE: f64 = 0.12;
const STEEP: f64 = 0.2;
/// Wavelength of the water, of a pool of side four, and half a side of the lamp above.
const WAVELENGTH: f64 = 0.25;
const LAMP: f64 = 0.1;

/// `zeltner-3-19`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 64);
    let effort = Effort::of(fig, [2, 8], SEED);
    effort.note(fig, size);
    let metal = mirrored(0.15, 3000.0, size, |b| {
        let smooth = metal(b)?;
        bumpy(b, smooth, SLOPE, SEED)
    })?;
    starts(fig, "metal", &metal, effort)?;
    let water = pool(size, LAMP, &Waves::new(WAVELENGTH, STEEP, SEED))?;
    starts(fig, "water", &water, effort.other(10))?;
    published(fig)
}

/// Estimates in one scene whose walks start in several ways: their rates, and their errors.
fn starts(fig: &mut Figure, scene_name: &str, scene: &Scene, effort: Effort) -> Result {
    let way = |starts: Starts| single(Method::Sms, starts);
    let of = |starts: Starts, k: u64| measure(scene, way(starts), false, effort.other(k));
    let uniform = of(Starts::Uniform, 0)?;
    let staged = of(Starts::TwoStage, 1)?;
    let landed = of(Starts::Particles, 2)?;
    let all = [
        ("uniform", &uniform),
        ("two stages", &staged),
        ("particles", &landed),
    ];
    let per_cent = |m: &Measured| format!("{:.1} %", 100.0 * m.success());
    fig.check(
        format!(
            "{scene_name}: more walks converge after a first stage, and where particles passed"
        ),
        staged.success() > 1.2 * uniform.success() && landed.success() > 1.2 * uniform.success(),
        all.map(|(_, m)| per_cent(m)).join(", "),
    );
    fig.check(
        format!("{scene_name}: both take fewer trials per solution"),
        landed.trials() < 0.7 * uniform.trials() && staged.trials() < 0.7 * uniform.trials(),
        all.map(|(_, m)| format!("{:.1}", m.trials())).join(", "),
    );
    for (name, m) in [("two stages", &staged), ("particles", &landed)] {
        let statement = format!("{scene_name}: the light is the same with {name}");
        let pair = [&m.series, &uniform.series];
        check_same(fig, &[&statement], pair, effort.runs, 1e-3);
    }
    // ---- Errors ----
    let seconds = uniform.seconds;
    let samples = all.map(|(_, m)| (effort.runs * m.spp) as f64 * seconds / m.seconds);
    let after = all.map(|(_, m)| m.error_after(seconds));
    let equal = all.map(|(_, m)| m.error_after(m.seconds));
    fig.check(
        format!("{scene_name}: at equal samples errors are smaller with two stages, and where particles passed"),
        equal[1] < equal[0] && equal[2] < equal[0],
        format!("{equal:.4?} of {:.4}", uniform.mean()),
    );
    let found = format!("errors {after:.4?} after {samples:.0?} samples per pixel");
    fig.note(&format!("{scene_name}: in the same time"), found.as_str());
    // Times of a moment say little.
    if fig.pick(false, true) {
        fig.check(
            format!("{scene_name}: in the same time, too"),
            after[1] < after[0] && after[2] < after[0],
            &found,
        );
        fig.check(
            format!("{scene_name}: in that time two stages get at least two thirds of the samples"),
            samples[1] > samples[0] / 1.5,
            &found,
        );
    }
    let rows = (0..all.len()).map(|k| {
        let m = all[k].1;
        let steps = m.found.steps as f64;
        [
            m.success(),
            m.trials(),
            m.variance(),
            steps,
            m.mean(),
            samples[k],
            after[k],
        ]
    });
    let columns = [
        "success_rate",
        "trials",
        "variance",
        "steps",
        "mean",
        "samples_in_the_same_time",
        "error_in_the_same_time",
    ];
    let rows: Vec<_> = rows.collect();
    fig.csv(&format!("rates-{scene_name}"), &columns, rows);
    let panels = (0..all.len()).map(|k| {
        let (label, m) = all[k];
        let label = format!(
            "{label}: {:.0} spp, error {:.2}, {}",
            samples[k],
            after[k] / uniform.mean(),
            per_cent(m)
        );
        m.panel(&label, &uniform, fig.pick(16, 4))
    });
    let panels: Vec<_> = panels.collect();
    fig.images(&format!("starts-{scene_name}"), 3, &panels);
    let times: Vec<f64> = (-4..=6).map(|k| seconds * 2f64.powi(k)).collect();
    let mut chart = LineChart::new(&format!("{scene_name}: error and time"), "seconds", "error")
        .log_x()
        .log_y();
    for (label, m) in all {
        chart = chart.line(label, times.iter().map(|t| (*t, m.error_after(*t))));
    }
    fig.chart(&format!("errors-{scene_name}"), &chart);
    Ok(())
}

/// The plane and the ball of the authors, where they are.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let effort = Effort::of(fig, [1, 4], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.4), (1 << 17, 0.1));
    for (name, file) in [
        ("authors' plane", "Figure_9_Twostage/plane.xml"),
        ("authors' ball", "Figure_9_Twostage/sphere.xml"),
    ] {
        let of = authors.scene(fig, name, file, fig.pick(16, 32), &[])?;
        let way = |starts: Starts| single(Method::Sms, starts);
        let ways = [
            ("uniform", way(Starts::Uniform)),
            ("two stages", way(Starts::TwoStage)),
            ("from particles", way(Starts::Particles)),
        ];
        let found = compare(fig, &of, &ways, effort, accuracy)?;
        let rates = [0, 1, 2].map(|k: usize| found.ways[k].success());
        let trials = [0, 1, 2].map(|k: usize| found.ways[k].trials());
        fig.check(
            format!("{name}: more walks converge after a first stage, and where particles passed"),
            rates[1] > rates[0] && rates[2] > rates[0],
            format!("{:.1?} %", rates.map(|r| 100.0 * r)),
        );
        fig.check(
            format!("{name}: both take fewer trials per solution"),
            trials[1] < trials[0] && trials[2] < trials[0],
            format!("{trials:.1?}"),
        );
    }
    Ok(())
}
