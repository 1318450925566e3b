//! Figure 3: error against links, with and without importance.
//!
//! The reference is the model with importance, two steps beyond the last one that is compared. The paper's, without
//! importance, is not good enough for (d): with three times the links it is still several per cent away. Numbers against
//! a reference of that kind are printed as well.

use render::{Image, Scene};

use super::boxes::{
    self, Step, Which, difference, mask, noiseless_patch_difference, patch_difference, refine,
    traced,
};
use crate::common_scenes::{Walls, cornell};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::say;

/// The error at which the numbers of links are compared.
const ERROR: f64 = 0.01;
/// Patches along one side of a surface.
const CELLS: f64 = 8.0;
/// A model without importance is refined until it has this many times the links that suffice with importance.
const PATIENCE: f64 = 2.2;

/// One refinement step of a model.
#[derive(Clone, Copy, Debug)]
struct Row {
    links: f64,
    radiance_links: f64,
    seconds: f64,
    bytes: f64,
    error: f64,
}

fn rows(steps: &[Step], reference: &Image, inside: &[bool]) -> Vec<Row> {
    let row = |s: &Step| Row {
        links: s.size.links() as f64,
        radiance_links: s.size.radiance_links as f64,
        seconds: s.seconds,
        bytes: s.size.bytes as f64,
        error: difference(&s.flat, reference, inside),
    };
    steps.iter().map(row).collect()
}

/// A number where the error passes `error`, between steps on logarithmic scales. The last passage counts:
/// errors need not fall from step to step.
fn at(run: &[Row], error: f64, number: impl Fn(&Row) -> f64) -> Option<f64> {
    let passes = |w: &&[Row]| w[0].error > error && w[1].error <= error;
    let w = run.windows(2).rfind(passes)?;
    let t = (w[0].error / error).ln() / (w[0].error / w[1].error.max(1e-9)).ln();
    let (a, b) = (number(&w[0]), number(&w[1]));
    Some(a * (b / a).powf(t))
}

struct Comparison {
    without: Vec<Row>,
    with: Vec<Row>,
    /// Both runs against the finest model without importance as reference; the last two steps of that run are left out.
    other: [Vec<Row>; 2],
    first: [usize; 2],
}

/// Links with importance over links without, at an error.
#[derive(Clone, Copy)]
struct Ratio {
    all: f64,
    radiance: f64,
    seconds: f64,
    /// The model without importance does not get there: the ratio is smaller yet.
    bound: bool,
}

impl Comparison {
    fn ratio(&self, error: f64) -> Option<Ratio> {
        // What a run has spent that does not reach the error is a lower bound.
        let without = |number: fn(&Row) -> f64| {
            at(&self.without, error, number).or(self.without.last().map(number))
        };
        let links = without(|r| r.links)?;
        Some(Ratio {
            all: at(&self.with, error, |r| r.links)? / links,
            radiance: at(&self.with, error, |r| r.radiance_links)? / links,
            seconds: at(&self.with, error, |r| r.seconds)? / without(|r| r.seconds)?,
            bound: at(&self.without, error, |r| r.links).is_none(),
        })
    }

    /// The smallest error that both reach, not below the one in question.
    fn reached(&self) -> f64 {
        let least = |run: &[Row]| run.iter().map(|r| r.error).fold(f64::INFINITY, f64::min);
        1.001 * least(&self.without).max(least(&self.with)).max(ERROR)
    }
}

fn compare(scene: &Scene, steps: usize, most: usize) -> Result<Comparison> {
    let (model, with) = refine(scene, boxes::options(true), 0.04, |s| s.len() >= steps)?;
    let inside = mask(&model);
    let reference = &with[with.len() - 1].flat;
    let run = rows(&with[..with.len() - 2], reference, &inside);
    let enough = at(&run, ERROR, |r| r.links).map_or(f64::INFINITY, |l| PATIENCE * l);
    let (_, without) = refine(scene, boxes::options(false), 0.04, |s: &[Step]| {
        s.len() >= most
            || s.last().is_some_and(|s| {
                s.size.links() as f64 > enough
                    || difference(&s.flat, reference, &inside) < 0.6 * ERROR
            })
    })?;
    let theirs = &without[without.len() - 1].flat;
    let shorter = &without[..without.len().saturating_sub(2)];
    Ok(Comparison {
        without: rows(&without, reference, &inside),
        other: [shorter, &with].map(|steps| rows(steps, theirs, &inside)),
        with: run,
        first: [&without, &with].map(|s| s[0].size.links()),
    })
}

fn show(r: Option<Ratio>) -> String {
    match r {
        Some(r) => {
            let least = if r.bound { "less than " } else { "" };
            format!(
                "links of both kinds {least}{:.3}, radiance links {least}{:.3} of those without; time {least}{:.2}",
                r.all, r.radiance, r.seconds
            )
        }
        None => "not reached with importance".into(),
    }
}

/// `christensen-03`.
///
/// # Errors
/// None that the boxes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(48, 64);
    let mut table = Vec::new();
    let mut found = Vec::new();
    let cornell_box = cornell(size, Walls::Matt, 24)?;
    let (glossy, many) = fig.pick((10, 9), (14, 13));
    let (d, dark) = (
        boxes::scene(Which::D, size, 0)?,
        boxes::scene(Which::D, size, 16)?,
    );
    let cases = [
        ("b", &boxes::scene(Which::B, size, 0)?, fig.pick(12, 17)),
        ("d", &d, glossy),
        ("d and 16 lamps", &dark, many),
        ("Cornell box with blocks", &cornell_box, fig.pick(12, 14)),
    ];
    for (name, scene, steps) in cases {
        let c = compare(scene, steps, steps)?;
        for (i, run) in [(0, &c.without), (1, &c.with)] {
            for r in run {
                let numbers = [r.links, r.radiance_links, r.seconds, r.bytes, r.error];
                let [a, b, c, d, e] = numbers.map(|x| x.to_string());
                table.push([name.to_string(), i.to_string(), a, b, c, d, e]);
            }
        }
        let number = [
            ("links", (|r| r.links) as fn(&Row) -> f64),
            ("seconds", |r| r.seconds),
        ];
        for (label, number) in number {
            let line = |run: &[Row]| run.iter().map(|r| (number(r), r.error)).collect::<Vec<_>>();
            let title = format!("({name}) error against {label}");
            let chart = LineChart::new(&title, label, "RMS error")
                .log_x()
                .log_y()
                .measured("without importance", line(&c.without))
                .measured("with importance", line(&c.with));
            fig.chart(&format!("{label} {name}").replace(' ', "-"), &chart);
        }
        found.push(c);
    }
    let header = [
        "box",
        "importance",
        "links",
        "radiance links",
        "seconds",
        "bytes",
        "error",
    ];
    fig.csv_text("runs", &header, table);
    let [b, d, many, ..] = &found[..] else {
        return Err("a case is missing".into());
    };
    for (name, c) in [("b", b), ("d", d)] {
        let [without, with] = c.first;
        fig.check(
            format!("(a) ({name}) at the first level importance doubles the links"),
            with == 2 * without,
            format!("{without} and {with}"),
        );
    }
    let error = fig.pick(10.0 * ERROR, ERROR);
    let percent = 100.0 * error;
    let level = b.reached();
    let (rb, rd) = (b.ratio(level), d.ratio(error));
    let below = |r: Option<Ratio>, limit: f64| r.is_some_and(|r| r.all < limit);
    fig.check(
        format!("(b) the curves cross: at {percent} % importance needs fewer links in (d)"),
        below(rd, 1.0),
        show(rd),
    );
    fig.check(
        format!("(c) at {percent} % error at most 0.7 of the links in (d) (the paper: 0.5, radiance links 0.25)"),
        below(rd, 0.7),
        show(rd),
    );
    let smaller = rb.zip(rd).is_some_and(|(b, d)| d.all < b.all);
    fig.check(
        format!(
            "(d) in (b) importance saves radiance links, but less than in (d), at {:.1} %",
            100.0 * level
        ),
        rb.is_some_and(|r| r.radiance < 1.0) && smaller,
        show(rb),
    );
    // Errors fall in steps, which one level would catch by chance.
    let reached = d.reached().max(many.reached());
    let mean = |c: &Comparison| {
        let ratios = (0..8).map(|k| c.ratio(reached * 2f64.powf(f64::from(k) / 8.0)));
        let logs: Option<f64> = ratios.map(|r| r.map(|r| r.all.ln())).sum();
        logs.map_or(f64::NAN, |l| (l / 8.0).exp())
    };
    let (few, more) = (mean(d), mean(many));
    let found = format!(
        "links over links without importance, mean over errors from {:.1} to {:.1} %: {few:.3} with 4 lamps, {more:.3} with 20",
        100.0 * reached,
        200.0 * reached
    );
    // Coarse solutions do not resolve yet which lamps matter.
    if fig.quick() {
        say!("  (e) is judged at full length only; {found}");
    } else {
        fig.check(
            "(e) 16 lamps that do not shine at the eye increase the gain",
            more < few,
            found,
        );
    }
    let [without, with] = &d.other;
    let links = |r: &Row| r.links;
    let theirs = [0.2, 0.15, 0.1].map(|e| {
        let ratio = at(with, e, links).zip(at(without, e, links));
        ratio.map_or(f64::NAN, |(a, b)| a / b)
    });
    say!(
        "  (d) against a reference without importance, ratio of all links at 20, 15, 10 %: {theirs:.2?}"
    );
    fig.note("ratio-d-reference-without-importance", &theirs[..]);
    let (model, steps) = refine(&cornell_box, boxes::options(true), 0.04, |s| s.len() >= 14)?;
    let end = &steps[steps.len() - 1];
    let off = |s: &Step| patch_difference(&model, &s.flat, &end.flat, CELLS);
    let last = steps.iter().rposition(|s| off(s) > ERROR).unwrap_or(0);
    let solved = &steps[(last + 1).min(steps.len() - 1)];
    fig.check(
        "the Cornell box is solved to 1 % over patches in under 10 s",
        solved.seconds < 10.0,
        format!(
            "{:.2} s, {} elements, {} radiance and as many importance links, {:.1} MB, {:.2} % off; pixels of flat elements are {:.1} % off",
            solved.seconds,
            solved.size.elements,
            solved.size.radiance_links,
            solved.size.bytes as f64 * 1e-6,
            100.0 * off(solved),
            100.0 * difference(&solved.flat, &end.flat, &mask(&model)),
        ),
    );
    let [r, s] = &traced(&cornell_box, 3, 256);
    // Elements larger than a patch: read between their corners.
    let picture = &solved.interpolated;
    let (off, patches) = noiseless_patch_difference(&model, picture, [r, s], CELLS);
    fig.check(
        "its patches agree with the path tracer within 3 % RMS",
        off.most < 0.03,
        format!("{off} over {patches} patches"),
    );
    Ok(())
}
