//! [Zeltner 2021, figure 3.8]: a half-buried ball of smooth glass, by one walk towards the lamp and by paths.

use render::manifold::Statistics;
use render::scene::{Method, Starts};
use render::statistics::z_limit;

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{glass, half_ball};
use crate::statistics::check_same;
use examples::figure::{Figure, Result};

const SEED: u64 = 38;

/// `zeltner-3-8`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(24, 64);
    let effort = Effort {
        runs: 16,
        spp: fig.pick(2, 16),
        seed: SEED,
    };
    effort.note(fig, size);
    let scene = half_ball(size, 0.2, |b, radius| {
        let smooth = glass(b)?;
        b.ball("ball", [0.0; 3], radius, &smooth)?;
        Ok(())
    })?;
    let of = |k: u64, method: Method, by_paths: bool| {
        let connections = single(method, Starts::Uniform);
        // Paths are quick, and seldom meet the lamp.
        let spp = effort.spp * if by_paths { 64 } else { 1 };
        let effort = Effort {
            spp,
            ..effort.other(k)
        };
        measure(&scene, connections, by_paths, effort)
    };
    let (one, all) = (of(1, Method::Mnee, false)?, of(2, Method::Sms, false)?);
    let paths = of(3, Method::Sms, true)?;
    finds(fig, "", &one, &all);
    let gain = (paths.variance_after(one.seconds) / one.variance()).sqrt();
    fig.check(
        "in the same time its error is ten times smaller than that of paths",
        gain > 10.0,
        format!("{gain:.0} times"),
    );
    let both = Effort {
        spp: 16 * effort.spp,
        ..effort.other(4)
    };
    let connections = single(Method::MneeUnbiased, Starts::Particles);
    let both = measure(&scene, connections, false, both)?;
    let Statistics { met, missed, .. } = both.found;
    fig.check(
        "next to none of the paths that meet the lamp through the ball are missed by it",
        met >= 10 && missed * 50 <= met,
        format!("{missed} of {met}"),
    );
    let z = both.series.whole.z(&all.series.whole);
    let limit = z_limit(1, effort.runs, 1e-3);
    fig.check(
        "with paths for these, all light is found",
        z.abs() < limit,
        format!(
            "|z| {:.2}, limit {limit:.2}; without them it has {:.3} of the light",
            z.abs(),
            one.mean() / all.mean()
        ),
    );
    let factor = fig.pick(8, 4);
    let panels = [("paths", &paths), ("one walk", &one), ("unbiased", &all)];
    let panels = panels.map(|(label, m)| m.panel(label, &all, factor));
    fig.images("ball", 3, &panels);
    let rows = [&paths, &one, &all].map(|m| [m.mean(), m.variance(), m.success(), m.seconds]);
    fig.csv(
        "methods",
        &["mean", "variance", "success_rate", "seconds"],
        rows,
    );
    published(fig)
}

/// Whether one walk finds light where there is any.
fn finds(fig: &mut Figure, scene: &str, one: &Measured, all: &Measured) {
    let lit = |m: &Measured| {
        let means = m.series.pixels.iter().map(|e| e.mean > 0.0);
        means.collect::<Vec<_>>()
    };
    let (found, lit) = (lit(one), lit(all));
    let both = found.iter().zip(&lit).filter(|(a, b)| **a && **b).count();
    let pixels = lit.iter().filter(|l| **l).count();
    fig.check(
        format!("{scene}one walk towards the lamp finds light in nine of ten pixels that have any"),
        both * 10 > pixels * 9,
        format!("{both} of {pixels}"),
    );
}

/// The ball of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_8_Constraints/sphere.xml";
    let of = authors.scene(fig, "authors' ball", file, fig.pick(24, 64), &[])?;
    let ways = [
        ("one walk", single(Method::Mnee, Starts::Particles)),
        ("unbiased", single(Method::Sms, Starts::Particles)),
    ];
    let effort = Effort {
        runs: 16,
        spp: fig.pick(2, 16),
        seed: 2 * SEED,
    };
    let accuracy = fig.pick((1 << 14, 0.1), (1 << 18, 0.02));
    let found = compare(fig, &of, &ways, effort, accuracy)?;
    finds(fig, "authors' ball: ", &found.ways[0], &found.ways[1]);
    let statement = "authors' ball: one walk finds all light";
    let pair = [&found.ways[0].series, &found.ways[1].series];
    check_same(fig, &[statement], pair, effort.runs, 1e-3);
    if fig.pick(false, true) {
        let gain = found.gain(0).sqrt();
        fig.check(
            "authors' ball: in the same time its error is ten times smaller than that of paths",
            gain > 10.0,
            format!("{gain:.0} times"),
        );
    }
    Ok(())
}
