//! [Zeltner 2021, figure 3.19]: where walks start on metal with bumps: anywhere, after a first stage over the smooth surface, or
//! where particles passed.

use render::scene::{Method, Starts};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{bumpy, metal, mirrored};
use crate::statistics::check_same;
use examples::figure::{Figure, Result};

const SEED: u64 = 319;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.12;

/// `zeltner-3-19`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 64);
    let effort = Effort::of(fig, [2, 8], SEED);
    effort.note(fig, size);
    let scene = mirrored(0.15, 3000.0, size, |b| {
        let smooth = metal(b)?;
        bumpy(b, smooth, SLOPE, SEED)
    })?;
    let way = |starts: Starts| single(Method::Sms, starts);
    let of = |starts: Starts, k: u64| measure(&scene, way(starts), false, effort.other(k));
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
        "more walks converge after a first stage, and where particles passed",
        staged.success() > 1.2 * uniform.success() && landed.success() > 1.2 * uniform.success(),
        all.map(|(_, m)| per_cent(m)).join(", "),
    );
    fig.check(
        "both take fewer trials per solution",
        landed.trials() < 0.7 * uniform.trials() && staged.trials() < 0.7 * uniform.trials(),
        all.map(|(_, m)| format!("{:.1}", m.trials())).join(", "),
    );
    for (name, m) in [("two stages", &staged), ("particles", &landed)] {
        let statement = format!("the light is the same with {name}");
        let pair = [&m.series, &uniform.series];
        check_same(fig, &[&statement], pair, effort.runs, 1e-3);
    }
    let rows = all.map(|(_, m)| {
        let steps = m.found.steps as f64;
        [m.success(), m.trials(), m.variance(), steps, m.mean()]
    });
    let columns = ["success_rate", "trials", "variance", "steps", "mean"];
    fig.csv("rates", &columns, rows);
    let panels = all.map(|(label, m)| m.panel(label, &uniform, fig.pick(10, 4)));
    fig.images("starts", 3, &panels);
    published(fig)
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
