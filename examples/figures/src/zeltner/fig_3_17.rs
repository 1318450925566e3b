//! [Zeltner 2021, figure 3.17]: constraints of half vectors and of angles, on a ball of glass.
//!
//! Walks start uniformly on casters, as the figure's do: where particles passed, half vectors are already near a root.
//! That both have the same expectation is a matter of `tests/tests/manifold.rs`: here half vectors find some chains so seldom
//! that their means are far from normal.

use std::time::Instant;

use render::Job;
use render::RenderError;
use render::instances::{Estimator, render_f32};
use render::manifold::Statistics;
use render::params::Theta;
use render::scene::{Connections, Constraint, Method, Starts};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, single};
use super::specular_scenes::{View, buried_ball, connected, load};
use crate::statistics::{Series, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 17;

/// Unbiased connections over chains of one vertex.
fn way(starts: Starts, constraint: Constraint) -> Connections {
    Connections {
        constraint,
        ..single(Method::Sms, starts)
    }
}

/// `zeltner-3-17`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let (size, spp, runs) = (fig.pick(32, 96), fig.pick(4, 16), 16);
    fig.note("size", size);
    fig.note("spp", spp);
    fig.note("runs", runs);
    fig.note("seed", SEED);
    let view = View {
        lookat: [[10.0, 11.0, 10.0], [0.0, 0.5, 0.0]],
        fov: 48.0,
        size,
    };
    let scene = load(&buried_ball(0.2, 30000.0), &view, 4)?;
    let theta = Theta::constant(scene.params().values());
    let measure = |constraint: Constraint, seed: u64| {
        let connections = way(Starts::Uniform, constraint);
        let settings = connected(&scene, Some(connections));
        let statistics = std::sync::Mutex::new(Statistics::default());
        let start = Instant::now();
        let series = Series::of(runs, [size as usize, 8], |run| {
            let job = Job::new(&scene, &settings, seed + run, 0..spp, &());
            let r = render_f32(&job, &theta, Estimator::Mis);
            if let Ok(mut s) = statistics.lock() {
                s.merge(&r.connections);
            }
            Ok::<_, RenderError>(grey(&r.sums[0], 1.0 / spp as f64))
        })?;
        let seconds = start.elapsed().as_secs_f64();
        let found = statistics.into_inner().unwrap_or_default();
        Ok::<_, RenderError>((series, found, seconds))
    };
    let (angle, by_angle, seconds_angle) = measure(Constraint::Angle, SEED)?;
    let (half, by_half, seconds_half) = measure(Constraint::HalfVector, 10 * SEED)?;
    let rate = |s: &Statistics| s.converged as f64 / s.walks.max(1) as f64;
    // Every start whose walk ends anywhere counts, roots behind the surface of half vectors among them; only those with light
    // are of use.
    let useful = |s: &Statistics| s.found as f64 / s.attempts.max(1) as f64;
    let (a, h) = (useful(&by_angle), useful(&by_half));
    fig.check(
        "three times as many first walks find light by angles",
        a > 3.0 * h,
        format!(
            "{:.2} % by angles, {:.2} % by half vectors, of all pixels",
            100.0 * a,
            100.0 * h
        ),
    );
    let variance = |s: &Series| s.pixels.iter().map(|e| e.se * e.se).sum::<f64>();
    let efficiency = |s: &Series, seconds: f64| 1.0 / (variance(s) * seconds);
    let gain = efficiency(&angle, seconds_angle) / efficiency(&half, seconds_half);
    fig.check(
        "less noise in the same time by angles",
        gain > 1.0,
        format!("variance times time is {gain:.1} times smaller"),
    );
    let mean = |s: &Series| s.means().iter().sum::<f64>() / s.means().len() as f64;
    let exposure = 0.4 / mean(&angle).max(1e-9);
    let panels = [("angles", &angle), ("half vectors", &half)].map(|(label, s)| {
        let values = s.means().iter().map(|x| x * exposure).collect::<Vec<_>>();
        Panel::false_colour(label, size as usize, &values, 0.0, 2.0).enlarged(fig.pick(8, 3))
    });
    fig.images("constraints", 2, &panels);
    let rows = [
        (rate(&by_angle), a, seconds_angle),
        (rate(&by_half), h, seconds_half),
    ];
    fig.csv(
        "rates",
        &["converged", "with_light", "seconds"],
        rows.map(|(r, u, s)| [r, u, s]),
    );
    published(fig)
}

/// The ball of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_8_Constraints/sphere.xml";
    let of = authors.scene(fig, "authors' ball", file, fig.pick(16, 48), &[])?;
    let ways = [
        ("particles", way(Starts::Particles, Constraint::Angle)),
        ("angles", way(Starts::Uniform, Constraint::Angle)),
        ("half vectors", way(Starts::Uniform, Constraint::HalfVector)),
    ];
    let effort = Effort {
        runs: 8,
        spp: fig.pick(4, 16),
        seed: 2 * SEED,
    };
    let accuracy = fig.pick((1 << 14, 0.3), (1 << 17, 0.1));
    let found = compare(fig, &of, &ways, effort, accuracy)?;
    let [angle, half] = [1, 2].map(|k| &found.ways[k]);
    fig.check(
        "authors' ball: three times as many first walks find light by angles",
        angle.lit() > 3.0 * half.lit(),
        format!(
            "{:.2} % by angles, {:.2} % by half vectors, of all pixels",
            100.0 * angle.lit(),
            100.0 * half.lit()
        ),
    );
    let gain = half.variance_after(angle.seconds) / angle.variance();
    fig.check(
        "authors' ball: less noise in the same time by angles",
        gain > 1.0,
        format!("variance times time is {gain:.1} times smaller"),
    );
    Ok(())
}
