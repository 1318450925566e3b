//! All chains of one vertex by proof: the roots that an exhaustive search finds, and light without trials.

use rayon::prelude::*;
use render::Scene;
use render::bsdf::DeltaKind;
use render::manifold::{Every, Pieces, Solution, Space, Start, Target};
use render::math::Frame;
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Method, Starts, Uniqueness};
use render::statistics::z_limit;

use crate::zeltner::manifold_methods::{Effort, Measured, measure, single};
use crate::zeltner::manifold_scenes::{Waves, displaced_ball, glass, half_ball};
use crate::zeltner::specular_scenes::Laboratory;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 98;
/// Standard deviation of the slopes, and wavelength; the ball's radius is 5.
const SLOPE: f64 = 0.15;
const WAVELENGTH: f64 = 3.0;
/// Rows of triangles where roots are compared.
const ROWS: u32 = 12;
/// The ball among the shapes.
const BALL: u32 = 1;
/// Where the lamp is.
const LAMP: [f64; 3] = [15.25, 12.3, 0.0];
/// A search over directions is made finer so often, four times as many each, before what it misses counts as missed.
const FINER: u32 = 5;
/// Ends of walks are roots where these are known to this length; near folds there may be none.
const KNOWN: f64 = 1e-6;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;

/// A displaced ball of glass, of so many rows of triangles, that is half in the floor.
fn ball(size: u32, rows: u32) -> Result<Scene> {
    let waves = Waves::new(WAVELENGTH, SLOPE, SEED);
    half_ball(size, 0.4, |b, radius| {
        let smooth = glass(b)?;
        b.shape("ball", displaced_ball(radius, &waves, rows)?, &smooth);
        Ok(())
    })
}

/// `every-chain`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    check_roots(fig)?;
    check_light(fig)
}

/// Distinct ends of walks from `n` by `n` directions over the hemisphere.
fn exhaustive(space: &Space, start: &Start, target: &Target, n: u32) -> Vec<Solution> {
    let Frame { s, t, n: up } = start.si.frame;
    let mut found: Vec<Solution> = Vec::new();
    for k in 0..n * n {
        // Alike over the disk below, so that the horizon has few.
        let [a, b] = [k % n, k / n].map(|i| 2.0 * (f64::from(i) + 0.5) / f64::from(n) - 1.0);
        let square = a * a + b * b;
        if square >= 1.0 {
            continue;
        }
        let d = s * a + t * b + up * (1.0 - square).sqrt();
        let chain = space.trace_own(start, d, &[(BALL, DeltaKind::Transmission)]);
        let ended = chain.and_then(|chain| space.walk(start, chain, target).solution);
        if let Some(solution) = ended.filter(|s| !has(&found, s)) {
            found.push(solution);
        }
    }
    found
}

fn has(all: &[Solution], solution: &Solution) -> bool {
    let is = |known: &Solution| known.is(solution, Uniqueness::ErrorBounds);
    all.iter().any(is)
}

/// What both searches found from one point.
#[derive(Clone, Copy, Default)]
struct Compared {
    solutions: usize,
    boxes: u64,
    undecided: u64,
    /// Solutions that the proof does not have.
    lost: usize,
    /// Ends of walks that know where their root is no better than [`KNOWN`], where the proof has none.
    vague: usize,
    /// Those that only finer searches found.
    rare: usize,
    /// Those that no search found.
    missed: usize,
}

fn compare(space: &Space, pieces: &Pieces, start: &Start, n: u32) -> Compared {
    let target = Target::Point(LAMP.into());
    let mut every = Every::default();
    let event = (BALL, DeltaKind::Transmission);
    space.every(pieces, (start, &target), event, &mut every);
    let mut found = exhaustive(space, start, &target, n);
    let missing = |found: &[Solution]| {
        let of = every.solutions.iter().filter(|s| !has(found, s));
        of.count()
    };
    let rare = missing(&found);
    for finer in 1..=FINER {
        if missing(&found) > 0 {
            found = exhaustive(space, start, &target, n << finer);
        }
    }
    let strange = |s: &&Solution| !has(&every.solutions, s);
    let (known, vague): (Vec<_>, Vec<_>) =
        (found.iter().filter(strange)).partition(|s| s.error < KNOWN);
    Compared {
        solutions: every.solutions.len(),
        boxes: every.boxes,
        undecided: every.undecided,
        lost: known.len(),
        vague: vague.len(),
        rare,
        missed: missing(&found),
    }
}

/// Sets of roots at many points within the ball, against walks from a grid of directions.
fn check_roots(fig: &mut Figure) -> Result {
    let points: u64 = fig.pick(200, 10_000);
    let n = fig.pick(32, 48);
    fig.note("points", points);
    fig.note("directions", n * n);
    let scene = Laboratory::new(ball(1, ROWS)?);
    let space = scene.space(Constraint::Angle);
    let pieces = Pieces::of(&scene.scene, BALL)?;
    let at = |i: u64| {
        let mut rng = Independent::new(SEED, 0, i);
        let [x, z] = rng.next_2d::<f64>().map(|u| 6.4 * u - 3.2);
        let start = scene.floor(x, z).ok_or("no floor")?;
        Ok(compare(&space, &pieces, &start, n))
    };
    let all: Vec<Compared> = (0..points)
        .into_par_iter()
        .map(at)
        .collect::<std::result::Result<_, &str>>()?;
    let sum = |f: fn(&Compared) -> u64| all.iter().map(f).sum::<u64>();
    let (solutions, boxes) = (sum(|c| c.solutions as u64), sum(|c| c.boxes));
    let (lost, rare) = (sum(|c| c.lost as u64), sum(|c| c.rare as u64));
    let (missed, undecided) = (sum(|c| c.missed as u64), sum(|c| c.undecided));
    fig.check(
        "no exhaustive search finds a chain that the proof does not have",
        lost == 0 && solutions > points / 2,
        format!(
            "{solutions} chains at {points} points, {lost} lost; {} ends of walks near folds, where there is none",
            sum(|c| c.vague as u64)
        ),
    );
    fig.check(
        "and it finds all that the proof has, if it is fine enough",
        missed == 0,
        format!(
            "{rare} are found by finer searches alone, of up to {} directions, and {missed} by none",
            (n << FINER).pow(2)
        ),
    );
    fig.check(
        "no place is left undecided",
        undecided == 0,
        format!("{:.0} boxes per search", boxes as f64 / points as f64),
    );
    let most = all.iter().map(|c| c.solutions).max().unwrap_or(0);
    let with = |k: usize| all.iter().filter(|c| c.solutions == k).count() as f64;
    let chart = LineChart::new("chains over the ball", "chains", "part of the points").measured(
        "proof",
        (0..=most).map(|k| (k as f64, with(k) / points as f64)),
    );
    fig.chart("chains", &chart);
    Ok(())
}

/// The light of chains by complete searches and by unbiased random walks, and what it costs, by the number of triangles.
fn check_light(fig: &mut Figure) -> Result {
    let size = fig.pick(12, 24);
    let effort = Effort::of(fig, [4, 4], SEED);
    effort.note(fig, size);
    let rows: &[u32] = fig.pick(&[6, 24][..], &[6, 12, 24, 48, 96][..]);
    let mut gains = Vec::new();
    let (mut apart, mut louder): (f64, f64) = (0.0, 0.0);
    let mut panels = Vec::new();
    let factor = (288 / size) as usize;
    for (k, &rows) in (0..).zip(rows) {
        let scene = ball(size, rows)?;
        let of = |method: Method, k: u64| -> Result<Measured> {
            measure(
                &scene,
                single(method, Starts::default()),
                false,
                effort.other(k),
            )
        };
        let complete = of(Method::Complete, 2 * k)?;
        let random = of(Method::Sms, 2 * k + 1)?;
        fig.check(
            format!("{rows} rows: no search runs out of boxes"),
            complete.found.exhausted == 0,
            format!(
                "{} of {}",
                complete.found.exhausted, complete.found.attempts
            ),
        );
        let [a, b] = [&complete, &random].map(Measured::whole);
        apart = apart.max(a.z(&b).abs());
        louder = louder.max(complete.variance() / random.variance());
        let gain = random.variance_after(1.0) / complete.variance_after(1.0);
        let triangles = f64::from(4 * rows * rows);
        let boxes = complete.found.steps as f64 / complete.found.attempts.max(1) as f64;
        gains.push((triangles, gain, boxes));
        panels.push(complete.panel(&format!("{triangles} triangles, complete"), &random, factor));
        panels.push(random.panel(
            &format!("{triangles} triangles, random walks"),
            &random,
            factor,
        ));
    }
    let limit = z_limit(rows.len(), effort.runs, LEVEL);
    fig.check(
        "complete searches bring the light of unbiased random walks",
        apart < limit,
        format!("{apart:.2} standard errors at most, limit {limit:.2}"),
    );
    fig.check(
        "at equal samples they have no more noise",
        louder < 1.5,
        format!("{louder:.2} of the variance at most"),
    );
    let chart = LineChart::new(
        "variance times time",
        "triangles",
        "random walks over complete searches",
    )
    .log_x()
    .log_y()
    .measured("gain", gains.iter().map(|&(n, gain, _)| (n, gain)));
    fig.chart("gain", &chart);
    let chart = LineChart::new("work of a complete search", "triangles", "boxes")
        .log_x()
        .log_y()
        .measured("boxes", gains.iter().map(|&(n, _, boxes)| (n, boxes)));
    fig.chart("boxes", &chart);
    fig.images("light", 2, &panels);
    let rows = gains.iter().map(|&(n, gain, boxes)| [n, gain, boxes]);
    fig.csv("gain", &["triangles", "gain", "boxes"], rows);
    Ok(())
}
