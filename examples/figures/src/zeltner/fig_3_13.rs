//! [Zeltner 2021, figure 3.13]: a half-buried ball of glass with bumps, by one start towards the lamp and by random
//! ones: half vectors, angles, two stages and particles, unbiased and in trial sets; and by paths alone.
//!
//! These bumps are long waves, with about one solution per point: what two stages gain where there are many is seen in figure
//! 3.19.

use render::scene::{Connections, Constraint, Method, Starts};
use render::statistics::{Estimate, z_limit};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{bumpy, glass, half_ball};
use crate::statistics::check_same;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 313;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.08;
/// Walks of a trial set.
const TRIALS: u32 = 16;

/// Connections over chains of one vertex.
fn way(method: Method, starts: Starts, constraint: Constraint) -> Connections {
    Connections {
        constraint,
        ..single(method, starts)
    }
}

/// `zeltner-3-13`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort::of(fig, [2, 8], SEED);
    effort.note(fig, size);
    let angle = Constraint::Angle;

    let scene = half_ball(size, 0.4, |b, radius| {
        let smooth = glass(b)?;
        let material = bumpy(b, smooth, SLOPE, SEED)?;
        b.ball("ball", [0.0; 3], radius, &material)?;
        Ok(())
    })?;
    let methods = [
        ("mnee", Method::Mnee, Starts::Uniform, angle),
        (
            "half vectors",
            Method::Sms,
            Starts::Uniform,
            Constraint::HalfVector,
        ),
        ("angles", Method::Sms, Starts::Uniform, angle),
        ("two stages", Method::Sms, Starts::TwoStage, angle),
        ("particles", Method::Sms, Starts::Particles, angle),
        (
            "biased, angles",
            Method::SmsBiased(TRIALS),
            Starts::Uniform,
            angle,
        ),
        (
            "biased, two stages",
            Method::SmsBiased(TRIALS),
            Starts::TwoStage,
            angle,
        ),
        (
            "biased, particles",
            Method::SmsBiased(TRIALS),
            Starts::Particles,
            angle,
        ),
    ];
    let mut measured = Vec::new();
    for (k, (label, method, starts, constraint)) in (0..).zip(methods) {
        let connections = way(method, starts, constraint);
        let found = measure(&scene, connections, false, effort.other(k))?;
        measured.push((label, found));
    }
    let of = |k: usize| &measured[k].1;
    let many = Effort {
        spp: fig.pick(1024, 4096),
        ..effort.other(20)
    };
    fig.note("spp of paths", many.spp);
    let all = way(Method::Sms, Starts::Particles, angle);
    let paths = measure(&scene, all, true, many)?;
    // Four unbiased means, three of trial sets, and what these lose.
    let all: Vec<_> = measured.iter().map(|(_, m)| m).chain([&paths]).collect();
    let limit = z_limit(8, Measured::repeats(&all), 1e-2);
    let paths = paths.whole();
    // Of all walks that converge, some by half vectors end behind the surface: what counts is light.
    let rates = measured
        .iter()
        .map(|(l, m)| format!("{l} {:.1} %", 100.0 * m.lit()));
    fig.check(
        "more first walks find light by angles than by half vectors, and more yet where particles passed",
        of(2).lit() > 1.2 * of(1).lit() && of(4).lit() > of(2).lit(),
        rates.collect::<Vec<_>>().join(", "),
    );
    fig.check(
        "trial sets find light more often where particles passed than from anywhere",
        of(7).lit() > of(5).lit(),
        format!(
            "{:.1} % and {:.1} %; trials per solution of unbiased estimates {:.1}, {:.1}, {:.1} by angles, two stages, particles",
            100.0 * of(7).lit(),
            100.0 * of(5).lit(),
            of(2).trials(),
            of(3).trials(),
            of(4).trials()
        ),
    );
    for k in [3, 4] {
        let statement = format!(
            "unbiased estimates have one mean: angles and {}",
            measured[k].0
        );
        let pair = [&of(k).series, &of(2).series];
        check_same(fig, &[&statement], pair, effort.runs, 1e-3);
    }
    let shown = |e: Estimate| format!("{:.4} ± {:.4}", e.mean, e.se);
    let unbiased = [1, 2, 3, 4].map(|k: usize| of(k).whole());
    let z = unbiased.map(|e| e.z(&paths));
    fig.check(
        "unbiased estimates have the mean of paths, by half vectors, angles, two stages and particles",
        z.iter().all(|z| z.abs() < limit) && paths.se < 0.1 * paths.mean,
        format!("{} of {} by paths, deviates {z:.2?}, limit {limit:.2}", unbiased.map(shown).join(", "), shown(paths)),
    );
    let sets = [5, 6, 7].map(|k: usize| of(k).whole());
    fig.check(
        "trial sets find no more than there is",
        sets.iter().all(|e| e.z(&paths) < limit),
        format!("{} of {}", sets.map(shown).join(", "), shown(paths)),
    );
    // What they lose, against the unbiased estimate of the same starts.
    let lost = [(5, 2), (7, 4)].map(|(set, all): (usize, usize)| {
        let (set, all) = (of(set).whole(), of(all).whole());
        Estimate {
            mean: 1.0 - set.mean / all.mean,
            se: (set.se / set.mean).hypot(all.se / all.mean),
        }
    });
    fig.check(
        "trial sets lose no more where walks find light more often",
        lost[1].mean < lost[0].mean + limit * lost[1].se.hypot(lost[0].se),
        format!(
            "{} from anywhere, {} where particles passed",
            shown(lost[0]),
            shown(lost[1])
        ),
    );
    let rows: Vec<[f64; 5]> = measured
        .iter()
        .map(|(_, m)| [m.success(), m.lit(), m.trials(), m.mean(), m.variance()])
        .collect();
    fig.csv(
        "methods",
        &["success_rate", "with_light", "trials", "mean", "variance"],
        rows,
    );
    let panels = measured.iter();
    let panels: Vec<Panel> = panels
        .map(|(label, m)| m.panel(label, of(4), fig.pick(8, 4)))
        .collect();
    fig.images("methods", 4, &panels);
    published(fig)
}

/// The ball of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_6_Sequence/sphere_sms.xml";
    let of = authors.scene(fig, "authors' ball", file, fig.pick(16, 48), &[])?;
    let (angle, set) = (Constraint::Angle, Method::SmsBiased(TRIALS));
    let half = Constraint::HalfVector;
    let ways = [
        ("angles", way(Method::Sms, Starts::Uniform, angle)),
        ("two stages", way(Method::Sms, Starts::TwoStage, angle)),
        ("particles", way(Method::Sms, Starts::Particles, angle)),
        ("mnee", way(Method::Mnee, Starts::Uniform, angle)),
        ("biased, half vectors", way(set, Starts::Uniform, half)),
        ("biased, angles", way(set, Starts::Uniform, angle)),
        ("biased, particles", way(set, Starts::Particles, angle)),
    ];
    let effort = Effort::of(fig, [2, 4], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.3), (1 << 17, 0.1));
    let found = compare(fig, &of, &ways, effort, accuracy)?;
    let lit = |k: usize| found.ways[k].lit();
    fig.check(
        "authors' ball: trial sets find light more often by angles than by half vectors, and more often yet where particles passed",
        lit(5) > 1.2 * lit(4) && lit(6) > lit(5) && lit(2) > lit(0),
        format!("{:.3?} of all estimates", [0, 1, 2, 3, 4, 5, 6].map(lit)),
    );
    let shares = [3, 4, 5, 6].map(|k| found.share(k));
    let limit = z_limit(shares.len(), effort.runs, 1e-2);
    fig.check(
        "authors' ball: one walk and trial sets bring no more than there is",
        shares.iter().all(|[x, error]| *x < 1.0 + limit * error),
        format!("{shares:.3?}"),
    );
    fig.check(
        "authors' ball: and sets less by half vectors than by angles",
        shares[1][0] < shares[2][0],
        format!("{:.3} and {:.3} of it", shares[1][0], shares[2][0]),
    );
    Ok(())
}
