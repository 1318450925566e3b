//! The chart.

use render::instances::Estimator;

use super::sweeps::{Of, STRIPES, Sweep, lobe_width};
use super::{Finding, Report, Row};
use crate::sheet::{Curve, Look, Mark, Plot, Sheet};

/// How the curves of estimators look: a colour, and whether they are dashed.
type Looks = [(Estimator, [u8; 3], bool)];

/// One colour per way of sampling the BSDF [Okabe and Ito 2008]; dashed together with light sampling.
const LOOKS: &Looks = &[
    (Estimator::Emitter, [86, 180, 233], false),
    (Estimator::Detached, [213, 94, 0], false),
    (Estimator::Attached, [0, 158, 115], false),
    (Estimator::Reparameterised, [0, 114, 178], false),
    (Estimator::Differential, [204, 121, 167], false),
    (Estimator::BiasedWeights, [120, 120, 120], false),
    (Estimator::BiasedMixed, [60, 60, 60], false),
    (Estimator::Mis, [213, 94, 0], true),
    (Estimator::AttachedMis, [0, 158, 115], true),
    (Estimator::ReparameterisedMis, [0, 114, 178], true),
    (Estimator::DifferentialMis, [204, 121, 167], true),
];

/// Those of what moves.
const MOVING: &Looks = &[
    (Estimator::Edges, [213, 94, 0], false),
    (Estimator::Reparameterised, [0, 114, 178], false),
    (Estimator::ReparameterisedMis, [0, 114, 178], true),
    (Estimator::ReparameterisedExact, [0, 158, 115], false),
    (Estimator::Interior, [120, 120, 120], false),
    (Estimator::BiasedRays, [60, 60, 60], true),
];

/// Whether an estimator is the other one where that is refused.
fn is_naive(estimator: Estimator, other: Estimator) -> bool {
    (estimator.capabilities()).is_naive_form_of(&other.capabilities())
}

/// Whether an estimator has the look of `other`.
fn shows(other: Estimator, estimator: Estimator) -> bool {
    estimator == other || is_naive(estimator, other)
}

fn mark(finding: Finding) -> Option<Mark> {
    match finding {
        Finding::Right => None,
        Finding::Unresolved => Some(Mark::Unresolved),
        Finding::Biased | Finding::NonFinite => Some(Mark::Failed),
    }
}

/// Smallest |z| that is shown.
const LEAST_Z: f64 = 0.1;
/// Smallest spread that is shown: some outlines are found without any.
const LEAST_STD: f64 = 1e-2;

/// A decade or more around all points.
fn span(values: impl Iterator<Item = f64>, [low, high]: [f64; 2]) -> [f64; 2] {
    let usable = values.filter(|v| v.is_finite() && *v > 0.0);
    let (l, h) = usable.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
    if l > h {
        return [low, high];
    }
    [
        10f64.powf(l.log10().floor()).max(low),
        10f64.powf((h * 1.05).log10().ceil()).min(high),
    ]
}

fn plot(sweep: &Sweep, looks: &Looks, report: &Report, bias: bool) -> Plot {
    let value = |r: &Row| {
        if bias {
            r.z.abs().max(LEAST_Z)
        } else {
            r.std.max(LEAST_STD)
        }
    };
    let rows = || report.rows.iter().filter(|r| r.sweep == sweep.name);
    let mut curves = Vec::new();
    if !bias {
        for law in &sweep.laws {
            curves.push(Curve {
                look: Look::law([0; 3]),
                points: sweep.points.iter().map(|&x| (x, (law.std)(x))).collect(),
                marks: Vec::new(),
            });
        }
    }
    for &(of, colour, dashed) in looks {
        let own = || {
            let of_look = |r: &&Row| {
                let is_admitted = || rows().any(|o| o.estimator.0 == of && o.x == r.x);
                shows(of, r.estimator.0) && (r.estimator.0 == of || !is_admitted())
            };
            // A difference that means nothing is not shown.
            let says = |r: &&Row| !bias || r.finding != Finding::Unresolved;
            rows().filter(of_look).filter(says)
        };
        curves.push(Curve {
            look: Look::measured(colour, dashed),
            points: own().map(|r| (r.x, value(r))).collect(),
            marks: own()
                .filter_map(|r| Some(((r.x, value(r)), mark(r.finding)?)))
                .collect(),
        });
    }
    let first = sweep.points.first().copied().unwrap_or(0.0);
    let last = sweep.points.last().copied().unwrap_or(1.0);
    let x = if sweep.log {
        [first / 1.25, last * 1.25]
    } else {
        [first - 2.0, last + 2.0]
    };
    let mut places = Vec::new();
    let mut notes = Vec::new();
    if sweep.name == "roughness-stripes" {
        let crossover = 3.0 / lobe_width(f64::from(STRIPES));
        places.push((crossover, if bias { "" } else { "kσ = 3" }.to_owned()));
    }
    if bias && sweep.name == "depth" && report.probes.unlimited != 0.0 {
        let lost: Vec<(f64, f64)> = rows()
            .filter(|r| r.estimator.0 == Estimator::Mis)
            .map(|r| {
                (
                    r.x,
                    (r.truth[0] - report.probes.unlimited).abs() / r.mean[1],
                )
            })
            .collect();
        notes.push("black: mis against paths without limit".to_owned());
        curves.push(Curve {
            look: Look::law([0; 3]),
            marks: (lost.iter().filter(|p| p.1 > report.z_limit))
                .map(|p| (*p, Mark::Failed))
                .collect(),
            points: lost,
        });
    }
    if !bias {
        let laws: Vec<&str> = sweep.laws.iter().map(|l| l.name).collect();
        if !laws.is_empty() {
            notes.push(format!("black: law {}", laws.join(", ")));
        }
    }
    Plot {
        title: sweep.title.into(),
        axes: [
            sweep.axis.into(),
            if bias {
                "bias, |z|".into()
            } else if matches!(sweep.of, Of::Motion) {
                "std of a sample / derivative".into()
            } else {
                "std of a sample / radiance".into()
            },
        ],
        log_x: sweep.log,
        x,
        y: if bias {
            [LEAST_Z, 1e3]
        } else {
            span(
                curves.iter().flat_map(|c| c.points.iter().map(|p| p.1)),
                [LEAST_STD, 1e5],
            )
        },
        curves,
        levels: if bias {
            vec![(report.z_limit, "chance".into())]
        } else {
            Vec::new()
        },
        places,
        notes,
    }
}

/// Error against the number of samples, and where sums in f32 stop.
fn samples(report: &Report) -> Plot {
    let probes = &report.probes;
    let mut curves: Vec<Curve> = Vec::new();
    for &(of, colour, dashed) in LOOKS {
        let own = || probes.ladder.iter().filter(|l| shows(of, l.estimator.0));
        curves.push(Curve {
            look: Look::measured(colour, dashed),
            points: own().map(|l| (l.samples, l.error)).collect(),
            marks: own()
                .filter(|l| l.biased)
                .map(|l| ((l.samples, l.error), Mark::Failed))
                .collect(),
        });
    }
    curves.push(Curve {
        look: Look::measured([0; 3], false),
        points: probes.single.clone(),
        marks: Vec::new(),
    });
    let all = || curves.iter().flat_map(|c| c.points.iter());
    let x = span(all().map(|p| p.0), [1.0, 1e9]);
    Plot {
        title: "Number of samples, ball light (F8)".into(),
        axes: ["samples".into(), "error of d ln I / d ln α".into()],
        log_x: true,
        x,
        y: span(all().map(|p| p.1), [1e-9, 1e4]),
        curves,
        levels: Vec::new(),
        places: Vec::new(),
        notes: vec!["black: error of a plain f32 sum".into()],
    }
}

/// Differences, of smooth and of jumping integrands.
fn steps(report: &Report) -> Plot {
    let steps = &report.probes.steps;
    let of = |f: fn(&super::verdict::Step) -> f64| -> Vec<(f64, f64)> {
        let shown = |v: f64| if v.is_nan() { v } else { v.max(1e-13) };
        steps.iter().map(|s| (s.step, shown(f(s)))).collect()
    };
    let curve = |colour, dashed, points| Curve {
        look: Look::measured(colour, dashed),
        points,
        marks: Vec::new(),
    };
    let curves = vec![
        curve([86, 180, 233], false, of(|s| s.smooth)),
        curve([86, 180, 233], true, of(|s| s.smooth_f32)),
        curve([213, 94, 0], false, of(|s| s.jumps)),
    ];
    let x = steps.iter().map(|s| s.step);
    let [low, high] = span(x, [1e-12, 1.0]);
    Plot {
        title: "Finite differences, ball light (F26, F27)".into(),
        axes: ["step / α".into(), "relative error".into()],
        log_x: true,
        x: [low / 1.25, high * 1.25],
        y: span(
            curves.iter().flat_map(|c| c.points.iter().map(|p| p.1)),
            [1e-13, 1e6],
        ),
        curves,
        levels: Vec::new(),
        places: Vec::new(),
        notes: vec![
            "blue: light sampling in f64, dashed in f32".into(),
            "red: standard error of samples that jump".into(),
        ],
    }
}

/// Spread above bias for every sweep, by the name of its file: derivatives in roughness, four sweeps in a row, with samples
/// and steps last; and in what moves, if anybody has them.
pub fn sheets(sweeps: &[Sweep], report: &Report) -> Vec<(&'static str, Sheet)> {
    let (moving, rough): (Vec<&Sweep>, Vec<&Sweep>) =
        sweeps.iter().partition(|s| matches!(s.of, Of::Motion));
    let mut plots = Vec::new();
    for four in rough.chunks(4) {
        for bias in [false, true] {
            plots.extend(four.iter().map(|s| plot(s, LOOKS, report, bias)));
            if four.len() < 4 {
                plots.push(if bias { steps(report) } else { samples(report) });
            }
        }
    }
    let mut out = vec![("stability", sheet("roughness", 4, plots, LOOKS))];
    let any = |s: &&Sweep| report.rows.iter().any(|r| r.sweep == s.name);
    if moving.iter().any(any) {
        let both = [false, true].into_iter();
        let plots = both.flat_map(|bias| moving.iter().map(move |s| plot(s, MOVING, report, bias)));
        let plots = plots.collect();
        out.push(("motion", sheet("what moves", moving.len(), plots, MOVING)));
    }
    out
}

fn sheet(of: &str, columns: usize, plots: Vec<Plot>, looks: &Looks) -> Sheet {
    let named = |&(of, colour, dashed): &(Estimator, [u8; 3], bool)| {
        let naive = Estimator::ALL.iter().any(|e| is_naive(*e, of));
        let text = format!("{}{}", of.name(), if naive { " (naive)" } else { "" });
        (text, Look::measured(colour, dashed))
    };
    Sheet {
        title: format!(
            "Estimators of the derivative in {of}: where they are noisy, and where they are wrong"
        ),
        columns,
        plots,
        legend: looks.iter().map(named).collect(),
        marks: vec![
            ("biased".into(), Mark::Failed),
            ("lobe not met".into(), Mark::Unresolved),
        ],
    }
}
