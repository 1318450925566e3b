//! [Zeltner 2021, figure 3.13]: a half-buried ball of glass with bumps, by one start towards the lamp and by random
//! ones: half vectors, angles, two stages and particles, unbiased and in trial sets; and by paths alone.

use render::scene::{Connections, Constraint, Method, Starts};
use render::statistics::{Estimate, z_limit};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, Rare, measure, single};
use super::manifold_scenes::{Waves, glass, half_ball, mapped_ball};
use crate::statistics::check_same;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 313;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.1;
/// Wavelength, of a ball of radius 5.
const WAVELENGTH: f64 = 1.5;
/// Walks of a trial set.
const TRIALS: u32 = 16;

/// Connections over chains of one vertex.
fn way(method: Method, starts: Starts, constraint: Constraint) -> Connections {
    Connections {
        constraint,
        ..single(method, starts)
    }
}

/// What was measured, by what it is called.
struct All(Vec<(&'static str, Measured)>);

/// Places in [`All`]: one walk with paths for what it misses, unbiased estimates, and trial sets with the same starts.
const ONE: usize = 1;
const UNBIASED: [usize; 4] = [2, 3, 4, 5];
const SETS: [usize; 4] = [6, 7, 8, 9];

impl All {
    fn of(&self, k: usize) -> &Measured {
        &self.0[k].1
    }

    /// A number of some of them.
    fn map<const N: usize>(&self, of: [usize; N], f: fn(&Measured) -> f64) -> [f64; N] {
        of.map(|k| f(self.of(k)))
    }
}

fn shown(e: Estimate) -> String {
    format!("{:.4} ± {:.4}", e.mean, e.se)
}

/// `zeltner-3-13`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort::of(fig, [2, 8], SEED);
    effort.note(fig, size);
    let rows = 128;
    let waves = Waves::new(WAVELENGTH, SLOPE, SEED);
    let scene = half_ball(size, 0.4, |b, radius| {
        let smooth = glass(b)?;
        let material = mapped_ball(b, radius, &waves, rows, smooth)?;
        b.ball("ball", [0.0; 3], radius, &material)?;
        Ok(())
    })?;
    let (angle, half) = (Constraint::Angle, Constraint::HalfVector);
    let (uniform, staged, landed) = (Starts::Uniform, Starts::TwoStage, Starts::Particles);
    let (sms, set) = (Method::Sms, Method::SmsBiased(TRIALS));
    let methods = [
        ("mnee", Method::Mnee, uniform, angle),
        ("mnee and paths", Method::MneeUnbiased, uniform, angle),
        ("half vectors", sms, uniform, half),
        ("angles", sms, uniform, angle),
        ("two stages", sms, staged, angle),
        ("particles", sms, landed, angle),
        ("biased, half vectors", set, uniform, half),
        ("biased, angles", set, uniform, angle),
        ("biased, two stages", set, staged, angle),
        ("biased, particles", set, landed, angle),
    ];
    let mut measured = Vec::new();
    for (k, (label, method, starts, constraint)) in (0..).zip(methods) {
        // Few of the paths that meet the lamp went over chains that one walk misses.
        let more = if method == Method::MneeUnbiased {
            16
        } else {
            1
        };
        let effort = Effort {
            spp: more * effort.spp,
            ..effort.other(k)
        };
        let connections = way(method, starts, constraint);
        measured.push((label, measure(&scene, connections, false, effort)?));
    }
    let all = All(measured);
    let many = Effort {
        spp: 1024,
        ..effort.other(20)
    };
    fig.note("spp of paths", many.spp);
    let paths = measure(&scene, way(sms, landed, angle), true, many)?;
    check_rates(fig, &all);
    check_light(fig, &all, &paths, effort.runs);
    let rare = Rare::of(&scene, way(sms, uniform, angle), effort.other(30))?;
    let more = Effort {
        spp: fig.pick(8, 4) * effort.spp,
        ..effort.other(31)
    };
    let reference = measure(&scene, way(sms, landed, angle), false, more)?;
    check_losses(fig, &all, &reference, &rare);
    let rows = all.0.iter().map(|(label, m)| {
        let numbers = [
            m.success(),
            m.lit(),
            m.trials(),
            m.mean(),
            m.variance_of_one(),
        ];
        let [a, b, c, d, e] = numbers.map(|x| x.to_string());
        [(*label).to_owned(), a, b, c, d, e]
    });
    let columns = [
        "method",
        "success_rate",
        "with_light",
        "trials",
        "mean",
        "variance_of_a_sample",
    ];
    let rows: Vec<_> = rows.collect();
    fig.csv_text("methods", &columns, rows);
    let factor = fig.pick(12, 5);
    let inset = |label: &str, m: &Measured| match label {
        "mnee" | "mnee and paths" => label.to_owned(),
        _ if m.found.trials > 0 => {
            format!(
                "{label}: {:.0} %, {:.1} trials",
                100.0 * m.lit(),
                m.trials()
            )
        }
        _ => format!("{label}: {:.0} %", 100.0 * m.lit()),
    };
    let panels = all.0.iter();
    let panels = panels.map(|(label, m)| m.panel(&inset(label, m), &reference, factor));
    let panels = panels.chain([paths.panel("paths", &reference, factor)]);
    let panels: Vec<Panel> = panels.collect();
    fig.images("methods", 4, &panels);
    published(fig)
}

/// How many walks find light, and how many trials a solution takes.
fn check_rates(fig: &mut Figure, all: &All) {
    let rates = all.map(UNBIASED, Measured::lit);
    let sets = all.map(SETS, Measured::lit);
    // Of all walks that converge, some by half vectors end behind the surface: what counts is light.
    fig.check(
        "more first walks find light by angles than by half vectors, more in two stages, and more where particles passed",
        rates[1] > 1.2 * rates[0] && rates[2] > rates[1] && rates[3] > rates[1],
        format!("{rates:.3?} of estimates"),
    );
    fig.check(
        "and so do more trial sets",
        sets[1] > sets[0] && sets[2] > sets[1] && sets[3] > sets[1],
        format!("{sets:.3?}"),
    );
    let trials = all.map(UNBIASED, Measured::trials);
    fig.check(
        "unbiased estimates take fewer trials in the same order",
        trials[1] < trials[0] && trials[2] < trials[1] && trials[3] < trials[1],
        format!("{trials:.2?} per solution"),
    );
}

/// Unbiased estimates bring the light of paths, with less noise than one walk and paths.
fn check_light(fig: &mut Figure, all: &All, paths: &Measured, runs: u64) {
    for k in [4, 5] {
        let statement = format!(
            "unbiased estimates have one mean: angles and {}",
            all.0[k].0
        );
        let pair = [&all.of(k).series, &all.of(UNBIASED[1]).series];
        check_same(fig, &[&statement], pair, runs, 1e-3);
    }
    // Five unbiased means, four of trial sets.
    let each = all.0.iter().map(|(_, m)| m).chain([paths]);
    let limit = z_limit(9, Measured::repeats(&each.collect::<Vec<_>>()), 1e-2);
    let paths = paths.whole();
    let [a, b, c, d] = UNBIASED;
    let unbiased = [ONE, a, b, c, d].map(|k| all.of(k).whole());
    let z = unbiased.map(|e| e.z(&paths));
    fig.check(
        "one walk with paths and unbiased estimates have the mean of paths: by half vectors, angles, two stages and particles",
        z.iter().all(|z| z.abs() < limit) && paths.se < 0.1 * paths.mean,
        format!(
            "{} of {} by paths, deviates {z:.2?}, limit {limit:.2}",
            unbiased.map(shown).join(", "),
            shown(paths)
        ),
    );
    let sets = SETS.map(|k| all.of(k).whole());
    fig.check(
        "trial sets find no more than there is",
        sets.iter().all(|e| e.z(&paths) < limit),
        format!("{} of {}", sets.map(shown).join(", "), shown(paths)),
    );
    let one = all.of(ONE).variance_of_one();
    let others = [a, b, c, d, SETS[0], SETS[1], SETS[2], SETS[3]];
    let noise = all.map(others, Measured::variance_of_one);
    fig.check(
        "at equal samples one walk with paths has more noise than all others",
        noise.iter().all(|x| *x < one),
        format!("variance {one:.1}, and {noise:.1?}"),
    );
}

/// What trial sets lose, against unbiased estimates of least noise, and where.
fn check_losses(fig: &mut Figure, all: &All, reference: &Measured, rare: &Rare) {
    let losses = SETS.map(|k| all.of(k).loss(reference, |_| true));
    // Those of four kinds, one after the other, and those of two places.
    let limit = z_limit(4, Measured::repeats(&[all.of(SETS[0]), reference]), 1e-2);
    let grows = |w: &[Estimate]| w[1].z(&w[0]) > limit;
    fig.check(
        "trial sets lose less where walks find light more often: by half vectors, angles, two stages, particles",
        !losses.windows(2).any(grows) && losses[0].z(&losses[3]) > limit,
        losses.map(shown).join(", "),
    );
    // Few samples do not tell what angles lose where.
    let kinds: &[usize] = fig.pick(&SETS[..1], &SETS[..2]);
    let mut z = Vec::new();
    let found = kinds.iter().map(|&k| {
        let [a, b] = rare.losses(all.of(k), reference);
        z.push(a.z(&b));
        format!("{} {} and {}", all.0[k].0, shown(a), shown(b))
    });
    let found = found.collect::<Vec<_>>().join("; ");
    fig.check(
        "and more where unbiased estimates are noisy: in the half of the pixels where solutions take most trials",
        z.iter().all(|z| *z > limit),
        format!("{found}; deviates {z:.1?}, limit {limit:.2}"),
    );
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
