//! [Stam 2020, figure 6]: seven gradients by the adjoint method against central differences with four
//! steps, on one fixed path, in single precision; and what the printed pseudocode makes of the same path.

use ad_core::Float;
use render::Scene;
use render::bsdf::BlinnPhongSampling;
use render::estimator::{BsdfOnly, Detached};
use render::integrator::gradient::Active;
use render::integrator::record::{Recorder, SumSink};
use render::math::Rgb;
use render::params::{GradSink, ParamRef, Theta};

use super::cornell::{CONTROLS, Cornell, LABELS, NAMES, SPHERE};
use super::fixed_path::{FixedPath, trace};
use super::printed;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};
use examples::say;

/// Emission 0.2 and wall albedo 0.3 are the paper's (decoded from its numbers); the others are chosen so
/// that the table has its shape.
const THETA: [f64; CONTROLS] = [0.2, 0.0, 0.3, 0.13, 10.0, 0.0, 0.3];
const STEPS: [f64; 4] = [1e-1, 1e-4, 1e-7, 1e-10];
const SEED: u64 = 6;
/// Probability of absorption with which the pseudocode is evaluated.
const ABSORB: f64 = 0.3;

/// Collects the adjoint of every parameter.
struct Sink(Vec<f64>);

impl<P: Float> GradSink<P> for Sink {
    fn active(&self, _p: ParamRef) -> bool {
        true
    }
    fn add(&mut self, p: ParamRef, i: usize, d: P) {
        self.0[p.offset as usize + i] += d.to_f64();
    }
}

impl SumSink for Sink {}

/// One path with its scene, in precision `P`. All colours are grey; the first channel is looked at.
struct Case<'a, P> {
    scene: &'a Scene,
    path: FixedPath<P>,
    pixel: [u32; 2],
    index: u64,
    values: Vec<P>,
}

impl<'a, P: Float> Case<'a, P> {
    fn new(scene: &'a Scene, pixel: [u32; 2], index: u64) -> Self {
        let values: Vec<P> = scene
            .params()
            .values()
            .iter()
            .map(|&v| P::from_f32(v))
            .collect();
        let theta = Theta::constant(&values);
        let (path, _) = FixedPath::record(scene, &theta, SEED, pixel, index);
        Self {
            scene,
            path,
            pixel,
            index,
            values,
        }
    }

    /// `J = L^2 / 2`: the target is 0.
    fn cost(&self, values: &[P]) -> P {
        let l = self
            .path
            .radiance(self.scene, &Theta::<P>::constant(values))
            .r;
        P::of(0.5) * l * l
    }

    /// Where the values of a control lie in the vector of all parameters.
    fn range(&self, control: usize) -> Result<std::ops::Range<usize>> {
        Ok(self.scene.params().find(NAMES[control])?.range())
    }

    /// `dJ/d theta / J` by the renderer's recorded path and its adjoint.
    fn adjoint(&self) -> Result<[f64; CONTROLS]> {
        let theta = Theta::<P>::constant(&self.values);
        let active = Active::new(self.scene, &NAMES)?;
        let mut recorder = Recorder::of(&active);
        let l = trace(
            self.scene,
            &theta,
            SEED,
            self.pixel,
            self.index,
            &mut recorder,
        );
        let mut sink = Sink(vec![0.0; self.values.len()]);
        // dJ/dL = L, in the first channel only.
        recorder.backward::<BsdfOnly<Detached>>(
            self.scene,
            &theta,
            Rgb::new(l.r, P::zero(), P::zero()),
            &mut sink,
        );
        let j = (P::of(0.5) * l.r * l.r).to_f64();
        let mut out = [0.0; CONTROLS];
        for (k, o) in out.iter_mut().enumerate() {
            *o = self.range(k)?.map(|i| sink.0[i]).sum::<f64>() / j;
        }
        Ok(out)
    }

    /// Central difference of `J / J_0`: the two costs and the quotient, all in precision `P`.
    fn difference(&self, control: usize, step: f64) -> Result<[f64; 3]> {
        let j0 = self.cost(&self.values);
        let at = |sign: f64| -> Result<P> {
            let mut values = self.values.clone();
            for i in self.range(control)? {
                values[i] += P::of(sign * step);
            }
            Ok(self.cost(&values) / j0)
        };
        let (up, down) = (at(1.0)?, at(-1.0)?);
        let quotient = (up - down) / P::of(2.0 * step);
        Ok([up.to_f64(), down.to_f64(), quotient.to_f64()])
    }
}

/// The first path from the eye over sphere, wall, sphere and wall to the light whose gradient in the
/// specular colour is large, as in the paper.
fn find_path(scene: &Scene, size: u32) -> Result<([u32; 2], u64)> {
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let theta = Theta::<f64>::constant(&values);
    for index in 0..20_000 {
        for y in size / 4..size * 3 / 4 {
            for x in size / 4..size * 3 / 4 {
                let (path, _) = FixedPath::record(scene, &theta, SEED, [x, y], index);
                let sphere = path.hits(|s| s == SPHERE);
                if path.light.is_none() || path.vertices.len() != 4 || sphere != 2 {
                    continue;
                }
                let specular = Case::<f64>::new(scene, [x, y], index).adjoint()?[3];
                if (20.0..24.0).contains(&specular) {
                    return Ok(([x, y], index));
                }
            }
        }
    }
    Err("no path over sphere and walls was found".into())
}

/// What the pseudocode of appendix D computes for the path, with roulette: radiance over the true one; gradients in
/// emission, exponent and wall albedo, relative to J.
fn pseudocode(case: &Case<f64>) -> [f64; 4] {
    let [_, _, _, specular, exponent, _, wall] = THETA;
    let survive = 1.0 - ABSORB;
    let n = case.path.vertices.len() as i32;
    // Radiance lacks the survival probabilities; the local radiance of the update has one of them.
    let radiance = survive.powi(n);
    let (mut d_wall, mut d_exponent) = (0.0, 0.0);
    for v in &case.path.vertices {
        if v.shape != SPHERE {
            d_wall += 2.0 / wall / survive;
            continue;
        }
        let cos_m = (v.wo + v.wi).normalize().z;
        // d(spec sin) / (spec sin), as printed.
        d_exponent += 2.0 * specular * printed::weight_derivative(cos_m, exponent)
            / (specular * printed::weight(cos_m))
            / survive;
    }
    // (emission / absorb) * adjoint instead of adjoint / absorb: off by the emission.
    let d_emission = 2.0;
    [radiance, d_emission, d_exponent, d_wall]
}

/// A path in both precisions.
struct Both<'a> {
    single: Case<'a, f32>,
    double: Case<'a, f64>,
}

/// Differences in both precisions for all steps, and whether the adjoint was the same beside each.
struct Differences {
    single: [[f64; CONTROLS]; STEPS.len()],
    double: [[f64; CONTROLS]; STEPS.len()],
    evaluations: usize,
    same: bool,
}

/// The table of figure 6.
fn table(fig: &mut Figure, path: &Both, adjoint: &[f64; CONTROLS]) -> Result<Differences> {
    let Both { single, double } = path;
    let cost = single.cost(&single.values);
    say!("  J = {cost:.4e}");
    let numbers = |row: &[f64; CONTROLS]| row.map(|x| format!("{x:>11.6}")).join("");
    say!("  adjoint   {}", numbers(adjoint));
    let mut tables = [[[0.0; CONTROLS]; STEPS.len()]; 2];
    let mut rows = Vec::new();
    let mut evaluations = 0;
    let mut same = true;
    for (s, &step) in STEPS.iter().enumerate() {
        for k in 0..CONTROLS {
            let f32_row = single.difference(k, step)?;
            let f64_row = double.difference(k, step)?;
            evaluations += 2;
            tables[0][s][k] = f32_row[2];
            tables[1][s][k] = f64_row[2];
            rows.push([
                LABELS[k].to_owned(),
                step.to_string(),
                adjoint[k].to_string(),
                f32_row[0].to_string(),
                f32_row[1].to_string(),
                f32_row[2].to_string(),
                f64_row[2].to_string(),
            ]);
        }
        say!("  eps {step:<6e}{}", numbers(&tables[0][s]));
        same &= single.adjoint()? == *adjoint;
    }
    say!("  f64 1e-7  {}", numbers(&tables[1][2]));
    fig.note("path_evaluations_per_step", evaluations / STEPS.len());
    let header = [
        "control", "eps", "adjoint", "J_up", "J_down", "fd_f32", "fd_f64",
    ];
    fig.csv_text("gradients", &header, rows);
    let [single, double] = tables;
    Ok(Differences {
        single,
        double,
        evaluations,
        same,
    })
}

/// The largest of a function of two rows.
fn worst(row: &[f64; CONTROLS], of: &[f64; CONTROLS], f: impl Fn(f64, f64) -> f64) -> f64 {
    (0..CONTROLS)
        .map(|k| f(row[k], of[k]))
        .fold(0.0f64, f64::max)
}

/// How far differences in single precision agree.
fn differences(fig: &mut Figure, found: &Differences, adjoint: &[f64; CONTROLS]) {
    // Three digits, and four roundings of a cost of 1 (the square of a product of some ten factors)
    // divided by 2 eps.
    let rounding = 4.0 * f64::from(f32::EPSILON) / 2e-4;
    let miss = worst(&found.single[1], adjoint, |f, a| {
        (f - a).abs() / (1e-3 * a.abs() + rounding)
    });
    fig.check(
        "(a) single precision: adjoint and differences with eps 1e-4 agree to 3 digits",
        miss < 1.0,
        format!(
            "{miss:.2} of the tolerance 1e-3 relative + {rounding:.1e} (four roundings) at worst"
        ),
    );
    let (emission, wall, specular) = (
        found.single[0][0] / adjoint[0],
        found.single[0][6] / adjoint[6],
        found.single[0][3] / adjoint[3],
    );
    fig.check(
        "(b) eps 0.1: the control that is linear in radiance is exact to 5 digits",
        (emission - 1.0).abs() < 1e-5,
        format!("{:.6}, adjoint {:.6}", found.single[0][0], adjoint[0]),
    );
    fig.check(
        "(b) eps 0.1: the control with the fourth power is 11.1 % too large",
        (wall / (14.814816 / 13.3333) - 1.0).abs() < 1e-4,
        format!(
            "{:.6}, adjoint {:.6}: the paper's 14.814816 and 13.3333",
            found.single[0][6], adjoint[6]
        ),
    );
    fig.check(
        "(b) eps 0.1: the specular entry is off by tens of percent",
        (specular - 1.0).abs() > 0.1,
        format!(
            "{:.4}, adjoint {:.4} ({:+.0} %)",
            found.single[0][3],
            adjoint[3],
            100.0 * (specular - 1.0)
        ),
    );
    let off = worst(&found.single[2], adjoint, |f, a| {
        if a == 0.0 { 0.0 } else { (f / a - 1.0).abs() }
    });
    fig.check(
        "(c) eps 1e-7, single precision: an entry is 0 or off by more than 10 %",
        off > 0.1,
        format!("worst entry off by {:.0} %", 100.0 * off),
    );
    fig.check(
        "(d) eps 1e-10, single precision: every entry is exactly 0",
        found.single[3].iter().all(|&x| x == 0.0),
        format!("{:?}", found.single[3]),
    );
}

/// How far the adjoint does, and what double precision adds.
fn adjoints(
    fig: &mut Figure,
    found: &Differences,
    adjoint: &[f64; CONTROLS],
    adjoint64: &[f64; CONTROLS],
) {
    fig.check(
        "(e) the adjoint does not depend on eps",
        found.same,
        "bit-identical after every row",
    );
    let precise = worst(adjoint, adjoint64, |a, b| {
        if b == 0.0 {
            a.abs()
        } else {
            (a / b - 1.0).abs()
        }
    });
    fig.check(
        "(e) it is accurate to single precision",
        precise < 2e-5,
        format!("largest relative difference to double precision {precise:.1e}"),
    );
    let unused = [adjoint[1], adjoint[5], adjoint64[1], adjoint64[5]];
    fig.check(
        "(f) the unused ambient controls give exactly 0",
        unused.iter().all(|&x| x == 0.0),
        format!("{unused:?}"),
    );
    let exact = worst(&found.double[2], adjoint64, |f, a| {
        (f - a).abs() / a.abs().max(1.0)
    });
    fig.check(
        "(g) double precision: the row of eps 1e-7 agrees to 1e-6",
        exact < 1e-6,
        format!("largest difference {exact:.1e}"),
    );
    fig.check(
        "2K = 14 path evaluations per row of differences",
        found.evaluations == 14 * STEPS.len(),
        format!("{} per row", found.evaluations / STEPS.len()),
    );
}

/// What the pseudocode of the source finds on this path.
fn as_printed(fig: &mut Figure, path: &Case<f64>, adjoint: &[f64; CONTROLS]) {
    let [radiance, d_emission, d_exponent, d_wall] = pseudocode(path);
    fig.check(
        "the pseudocode on this path: radiance without survival probabilities (errata S-D3)",
        (radiance - 1.0).abs() > 0.1,
        format!("{radiance:.4} of the radiance at absorption {ABSORB}; wall entry {d_wall:.4} for {:.4}", adjoint[6]),
    );
    fig.check(
        "the pseudocode on this path: emission entry too small by the emission (errata S-D4)",
        (d_emission / adjoint[0] - THETA[0]).abs() < 1e-6,
        format!("{d_emission:.4} for {:.4}", adjoint[0]),
    );
    fig.check(
        "the pseudocode on this path: exponent entry is not the derivative (errata S-C1, S-C3)",
        (d_exponent / adjoint[4] - 1.0).abs() > 0.1,
        format!("{d_exponent:.4} for {:.4}", adjoint[4]),
    );
}

/// Error against the step.
fn steps(fig: &mut Figure, path: &Both, adjoint: &[f64; CONTROLS]) -> Result {
    let Both { single, double } = path;
    let mut chart = LineChart::new(
        "Error of central differences on one path",
        "eps",
        "relative error",
    )
    .log_x()
    .log_y();
    let sweep: Vec<f64> = (0..=40)
        .map(|i| 10f64.powf(-1.0 - 9.0 * f64::from(i) / 40.0))
        .collect();
    for k in [0, 3, 6] {
        let mut curve = Vec::new();
        for &step in &sweep {
            curve.push((
                step,
                (single.difference(k, step)?[2] / adjoint[k] - 1.0).abs(),
            ));
        }
        chart = chart.line(&format!("{}, f32", LABELS[k]), curve);
    }
    let mut curve = Vec::new();
    for &step in &sweep {
        curve.push((
            step,
            (double.difference(3, step)?[2] / adjoint[3] - 1.0).abs(),
        ));
    }
    fig.chart("step", &chart.dashed(&format!("{}, f64", LABELS[3]), curve));
    Ok(())
}

/// `stam-06`.
pub fn figure(fig: &mut Figure) -> Result {
    let size = 64;
    let sampling = BlinnPhongSampling::Importance;
    let scene = Cornell {
        theta: THETA,
        sampling,
        size,
        max_depth: 6,
    }
    .build()?;
    let (pixel, index) = find_path(&scene, size)?;
    fig.note("theta", THETA.to_vec());
    fig.note("seed", SEED);
    fig.note("pixel", pixel.to_vec());
    fig.note("sample", index);
    let path = Both {
        single: Case::new(&scene, pixel, index),
        double: Case::new(&scene, pixel, index),
    };
    let adjoint = path.single.adjoint()?;
    let adjoint64 = path.double.adjoint()?;
    let cost = path.single.cost(&path.single.values);
    fig.note("J", f64::from(cost));

    let found = table(fig, &path, &adjoint)?;
    differences(fig, &found, &adjoint);
    adjoints(fig, &found, &adjoint, &adjoint64);
    as_printed(fig, &path.double, &adjoint64);
    steps(fig, &path, &adjoint64)
}
