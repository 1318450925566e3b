//! [Zeltner 2021, figure 3.13]: a half-buried ball of glass with bumps, by one start towards the lamp and by random
//! ones: half vectors, angles, two stages and particles, unbiased and in trial sets.
//!
//! These bumps are long waves, with about one solution per point: what two stages gain where there are many is seen in figure
//! 3.19.

use render::scene::{Connections, Constraint, Method, Starts};

use super::manifold_methods::{Effort, measure};
use super::manifold_scenes::{bumpy, glass, half_ball};
use crate::chart::Panel;
use crate::figure::{Figure, Result};
use crate::figures::statistics::check_same;

const SEED: u64 = 313;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.08;
/// Walks of a trial set.
const TRIALS: u32 = 16;

/// `zeltner-3-13`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort {
        runs: fig.pick(8, 16),
        spp: fig.pick(2, 8),
        seed: SEED,
    };
    effort.note(fig, size);
    let single = |method: Method, starts: Starts, constraint: Constraint| Connections {
        bounces: 1,
        starts,
        constraint,
        ..Connections::new(method)
    };
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
        let connections = single(method, starts, constraint);
        let found = measure(&scene, connections, false, effort.other(k))?;
        measured.push((label, found));
    }
    let of = |k: usize| &measured[k].1;
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
    let means = [4, 5, 6, 7].map(|k: usize| of(k).mean());
    fig.check(
        "trial sets find no more than there is, within a tenth",
        means[1..].iter().all(|m| *m < 1.1 * means[0]),
        format!("unbiased {:.4}, trial sets {:.4?}", means[0], &means[1..]),
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
    Ok(())
}
