//! [Zeltner 2021, figure 3.27]: balls of glass with growing bumps, once as a normal map and once displaced.
//!
//! Both are made from the same waves. Walks start anywhere: two stages are off.

use render::scene::{Method, Starts};

use super::authors::{Authors, Found, attribute, compare};
use super::integrated_normals::displaced_sphere;
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{Waves, displaced_ball, glass, half_ball, mapped_ball};
use super::specular_scenes::Laboratory;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 327;
/// Standard deviations of the slopes.
const SLOPES: [f64; 3] = [0.03, 0.07, 0.15];
/// Wavelength, of a ball of radius 5.
const WAVELENGTH: f64 = 3.0;

/// A ball with bumps of one size, mapped or displaced.
struct Ball {
    displaced: bool,
    slope: f64,
    light: Measured,
}

impl Ball {
    /// Samples per pixel in so many seconds, of so many runs.
    fn samples_in(&self, runs: u64, seconds: f64) -> f64 {
        (self.light.spp * runs) as f64 * seconds / self.light.seconds
    }
}

/// `zeltner-3-27`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort {
        runs: fig.pick(4, 16),
        spp: fig.pick(4, 16),
        seed: SEED,
    };
    effort.note(fig, size);
    // Texels and vertices of half a turn.
    let rows = fig.pick(96, 256);
    fig.note("rows", rows);
    let mut balls = Vec::new();
    // One after the other, so that both meet the same load.
    for (k, slope) in (0..).zip(SLOPES) {
        for displaced in [false, true] {
            let waves = Waves::new(WAVELENGTH, slope, SEED);
            let scene = half_ball(size, 0.4, |b, radius| {
                let smooth = glass(b)?;
                if displaced {
                    b.shape("ball", displaced_ball(radius, &waves, rows)?, &smooth);
                } else {
                    let material = mapped_ball(b, radius, &waves, rows as usize, smooth)?;
                    b.ball("ball", [0.0; 3], radius, &material)?;
                }
                Ok(())
            })?;
            let connections = single(Method::Sms, Starts::Uniform);
            let seed = effort.seed + 1000 * k + 500 * u64::from(displaced);
            let light = measure(&scene, connections, false, Effort { seed, ..effort })?;
            balls.push(Ball {
                displaced,
                slope,
                light,
            });
        }
    }
    let (displaced, mapped): (Vec<Ball>, Vec<Ball>) = balls.into_iter().partition(|b| b.displaced);
    check_rates(fig, &mapped, &displaced);
    check_cost(fig, &mapped, &displaced, effort.runs);
    published(fig)
}

/// How many walks find light.
fn check_rates(fig: &mut Figure, mapped: &[Ball], displaced: &[Ball]) {
    let rates = |balls: &[Ball]| balls.iter().map(|b| b.light.lit()).collect::<Vec<f64>>();
    let (mapped, displaced) = (rates(mapped), rates(displaced));
    let falls = |r: &[f64]| r.windows(2).all(|w| w[1] < w[0]);
    let found = format!("{mapped:.3?} with normal maps, {displaced:.3?} displaced");
    fig.check(
        "fewer walks find light the larger the bumps, on either",
        falls(&mapped) && falls(&displaced),
        &found,
    );
    let apart = mapped.iter().zip(&displaced);
    let worst = apart.map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f64::max);
    fig.check(
        "displaced or mapped, success rates are within 30 %",
        worst < 0.3,
        format!("{:.1} % apart at most: {found}", 100.0 * worst),
    );
    let chart = LineChart::new("walks that find light", "slope", "success rate")
        .log_x()
        .measured("normal map", SLOPES.into_iter().zip(mapped))
        .measured("displaced", SLOPES.into_iter().zip(displaced));
    fig.chart("rates", &chart);
}

/// What a solution costs: trials, steps and samples in the same time.
fn check_cost(fig: &mut Figure, mapped: &[Ball], displaced: &[Ball], runs: u64) {
    let both = || [mapped, displaced];
    let trials = both().map(|balls| balls.iter().map(|b| b.light.trials()).collect::<Vec<_>>());
    let grows = |t: &Vec<f64>| t[t.len() - 1] > t[0];
    let apart = (trials[0].iter().zip(&trials[1])).map(|(a, b)| (b / a).max(a / b));
    let apart = apart.fold(1.0, f64::max);
    fig.check(
        "trials per solution grow with the bumps, and are alike on displaced and mapped balls",
        trials.iter().all(grows) && apart < 1.5,
        format!(
            "{:.2?} with normal maps, {:.2?} displaced: {apart:.2} times as many at most",
            trials[0], trials[1]
        ),
    );
    // In the time of the first.
    let seconds = mapped[0].light.seconds;
    let samples = both().map(|balls| {
        let each = balls.iter().map(|b| b.samples_in(runs, seconds));
        each.collect::<Vec<f64>>()
    });
    let ratio = samples[1].iter().sum::<f64>() / samples[0].iter().sum::<f64>();
    let found = format!(
        "{:.1?} per pixel with normal maps, {:.1?} displaced, {ratio:.2} times as many all in all",
        samples[0], samples[1]
    );
    fig.note("samples in the same time", found.as_str());
    // Times of a moment say little.
    if fig.pick(false, true) {
        fig.check(
            "displaced balls get fewer samples in the same time, but no less than a fifth as many",
            (0.2..1.0).contains(&ratio),
            found,
        );
    }
    let chart = LineChart::new("what bumps cost", "slope", "trials per solution, samples")
        .log_x()
        .log_y()
        .measured(
            "trials, normal map",
            SLOPES.into_iter().zip(trials[0].clone()),
        )
        .measured(
            "trials, displaced",
            SLOPES.into_iter().zip(trials[1].clone()),
        )
        .measured(
            "samples, normal map",
            SLOPES.into_iter().zip(samples[0].clone()),
        )
        .measured(
            "samples, displaced",
            SLOPES.into_iter().zip(samples[1].clone()),
        );
    fig.chart("cost", &chart);
    let all = || mapped.iter().chain(displaced);
    let panels = all().map(|b| {
        let kind = if b.displaced {
            "displaced"
        } else {
            "normal map"
        };
        let label = format!(
            "{kind}, {}: {:.0} spp, {:.1} %",
            b.slope,
            b.samples_in(runs, seconds),
            100.0 * b.light.lit()
        );
        b.light.panel(&label, &b.light, fig.pick(14, 5))
    });
    let panels: Vec<_> = panels.collect();
    fig.images("bumps", 3, &panels);
    let rows = all().map(|b| {
        let m = &b.light;
        [
            f64::from(u8::from(b.displaced)),
            b.slope,
            m.lit(),
            m.success(),
            m.trials(),
            m.found.steps as f64 / m.found.walks.max(1) as f64,
            m.mean(),
            b.samples_in(runs, seconds),
        ]
    });
    let columns = [
        "displaced",
        "slope",
        "with_light",
        "success_rate",
        "trials",
        "steps_per_walk",
        "mean",
        "samples_in_the_same_time",
    ];
    let rows: Vec<_> = rows.collect();
    fig.csv("rates", &columns, rows);
}

/// The balls of the authors, where they are; those that are displaced are not there, and come from what the normal maps say.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let effort = Effort {
        runs: fig.pick(8, 16),
        spp: 4,
        seed: 2 * SEED,
    };
    let accuracy = fig.pick((1 << 14, 0.8), (1 << 17, 0.1));
    let (columns, rows) = (fig.pick(16, 32), fig.pick(192, 512));
    let ways = [
        ("unbiased", single(Method::Sms, Starts::Uniform)),
        ("from particles", single(Method::Sms, Starts::Particles)),
    ];
    let mut rates = [Vec::new(), Vec::new()];
    for (k, [mapped, displaced]) in [
        ["authors' map 1", "authors' shape 1"],
        ["authors' map 2", "authors' shape 2"],
        ["authors' map 3", "authors' shape 3"],
    ]
    .into_iter()
    .enumerate()
    {
        let n = k + 1;
        let file = |kind: &str| format!("Figure_16_Displacement/sphere_{n}_{kind}.xml");
        let lit = |found: &Found| found.ways[0].lit();
        let of = authors.scene(fig, mapped, &file("nrm"), columns, &[])?;
        rates[0].push(lit(&compare(
            fig,
            &of,
            &ways,
            effort.other(n as u64),
            accuracy,
        )?));
        let missing = format!("sphere_d_{n}.obj");
        let mesh = displaced_sphere(&Laboratory::new(of.scene), rows)?;
        fig.write(&missing, mesh.as_bytes());
        let path = attribute(&std::path::absolute(fig.path(&missing))?);
        let changes = [(&*format!("meshes/{missing}"), path.as_str())];
        let of = authors.scene(fig, displaced, &file("disp"), columns, &changes)?;
        rates[1].push(lit(&compare(
            fig,
            &of,
            &ways,
            effort.other(10 + n as u64),
            accuracy,
        )?));
    }
    let [mapped, displaced] = &rates;
    let found = format!("{mapped:.3?} with normal maps, {displaced:.3?} displaced");
    let falls = |r: &[f64]| r.windows(2).all(|w| w[1] < w[0]);
    fig.check(
        "authors' balls: fewer walks find light the larger the bumps, on either",
        falls(mapped) && falls(displaced),
        &found,
    );
    let apart = mapped.iter().zip(displaced);
    let apart = apart.map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f64::max);
    fig.check(
        "authors' balls: displaced or mapped, success rates are within 30 %",
        apart < 0.3,
        format!("{:.1} % apart at most: {found}", 100.0 * apart),
    );
    Ok(())
}
