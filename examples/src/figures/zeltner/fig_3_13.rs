//! [Zeltner 2021, figures 3.8 and 3.13]: a half-buried ball of glass with bumps, by one start towards the lamp and by random
//! ones: half vectors, angles, two stages and particles, unbiased and in trial sets.
//!
//! These bumps are long waves, with about one solution per point: what two stages gain where there are many is seen in figure
//! 3.19.

use render::scene::{Connections, Constraint, Method, Starts};

use super::manifold_methods::{Effort, Measured, bumpy, glass, measure};
use crate::chart::Panel;
use crate::figure::{Figure, Result};
use crate::figures::statistics::check_same;
use crate::scene_builder::{SceneBuilder, View};

const SEED: u64 = 313;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.08;
/// Walks of a trial set.
const TRIALS: u32 = 16;

/// The ball, over a floor that it stands in; half of it is seen.
fn ball(size: u32, slope: f64) -> Result<render::Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let smooth = glass(&mut b)?;
    let material = if slope > 0.0 {
        bumpy(&mut b, smooth, slope, SEED)?
    } else {
        smooth
    };
    b.ball("ball", [0.0; 3], 5.0, &material)?;
    let black = b.matt("lamp", [0.0; 3])?;
    // 50 degrees from above, towards the ball.
    let quad = [[15.0, 12.6, -0.4], [0.5, -0.6, 0.0], [0.0, 0.0, 0.8]];
    let shape = b.quad("lamp", quad, &black)?;
    b.lamp("lamp", shape, [2000.0; 3])?;
    let view = View {
        eye: [8.0, 10.0, 8.0],
        target: [0.0, 0.5, 0.0],
        fov: 45.0,
        size: [size; 2],
    };
    b.finish(&view, 4)
}

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

    // ---- Without bumps ----
    let smooth = ball(size, 0.0)?;
    let by = |k: u64, method: Method| {
        let seed = effort.seed + 1000 * k;
        let connections = single(method, Starts::Uniform, angle);
        measure(&smooth, connections, false, Effort { seed, ..effort })
    };
    let (one, all) = (by(20, Method::Mnee)?, by(21, Method::Sms)?);
    let lit = |m: &Measured| {
        m.series
            .pixels
            .iter()
            .map(|e| e.mean > 0.0)
            .collect::<Vec<_>>()
    };
    let (found, lit) = (lit(&one), lit(&all));
    let both = found.iter().zip(&lit).filter(|(a, b)| **a && **b).count();
    let pixels = lit.iter().filter(|l| **l).count();
    fig.check(
        "one walk towards the lamp finds light in nine of ten pixels that have any, on the smooth ball (figure 3.8)",
        both * 10 > pixels * 9,
        format!("{both} of {pixels}"),
    );

    // ---- With bumps ----
    let scene = ball(size, SLOPE)?;
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
        let seed = effort.seed + 1000 * k;
        measured.push((
            label,
            measure(&scene, connections, false, Effort { seed, ..effort })?,
        ));
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
        "starts where particles passed take fewer trials per solution than uniform ones",
        of(4).trials() < of(2).trials(),
        format!(
            "{:.1}, {:.1}, {:.1} by angles, two stages, particles",
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
    let exposure = 0.5 / of(4).mean().max(1e-9);
    let panels: Vec<Panel> = measured
        .iter()
        .map(|(label, m)| {
            let values: Vec<f64> = m.series.means().iter().map(|x| x * exposure).collect();
            Panel::false_colour(label, size as usize, &values, 0.0, 2.0).enlarged(fig.pick(8, 4))
        })
        .collect();
    fig.images("methods", 4, &panels);
    Ok(())
}
