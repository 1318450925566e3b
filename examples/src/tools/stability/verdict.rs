//! What else is measured, and everything in words.

use std::fmt::Write as _;
use std::path::Path;

use render::Job;
use render::bsdf::microfacet::Ndf;
use render::estimator::{Capabilities, Failure, Failures, Motion};
use render::instances::{Direction, Estimator, render_f32, render_f64};
use render::params::Theta;
use render::scene::LoadOptions;
use render::statistics::{Estimate, z_limit};
use render::{Scene, SceneError};
use serde::Serialize;

use super::setup::{EMISSION, Light, Plate, ROUGHNESS, Setup};
use super::sweeps::{self, BALL, BALL_ALPHA, BALL_INCIDENCE, STRIPES, Sweep, lobe_width};
use super::{Finding, Report, Row};
use crate::cli::ToolError;
use crate::output::Named;
use crate::progress::Interrupt;

/// Error of one estimator with so many samples.
#[derive(Clone, Debug, Serialize)]
pub struct Rung {
    /// Which.
    pub estimator: Named,
    /// Number of samples.
    pub samples: f64,
    /// Root mean square error of `d ln I / d ln alpha` over sixteen groups of pixels.
    pub error: f64,
    /// Whether their mean differs from the truth beyond chance.
    pub biased: bool,
}

/// Central differences with one step.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Step {
    /// Step over roughness.
    pub step: f64,
    /// Relative error of smooth samples in f64, against the derivative of the same samples.
    pub smooth: f64,
    /// The same in f32.
    pub smooth_f32: f64,
    /// Relative standard error of samples that jump, f64.
    pub jumps: f64,
}

/// An estimate that should be `truth`.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Check {
    /// Truth.
    pub truth: f64,
    /// Estimate.
    pub mean: f64,
    /// Its standard error.
    pub error: f64,
}

impl Check {
    fn z(&self) -> f64 {
        let found = Estimate {
            mean: self.mean,
            se: self.error,
        };
        found.z(&Estimate::exact(self.truth))
    }
}

/// What is not a sweep.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Probes {
    /// Errors against numbers of samples.
    pub ladder: Vec<Rung>,
    /// Numbers of samples, and the relative error of their sum in f32.
    pub single: Vec<(f64, f64)>,
    /// Finite differences.
    pub steps: Vec<Step>,
    /// Estimators that refuse the index of smooth glass, and those that do not.
    pub glass: [Vec<Named>; 2],
    /// Derivative in the radiance of a black environment, by each estimator (F7).
    pub dark: Vec<(Named, Check)>,
    /// Largest sample over the standard deviation, at a few and at 16 times as many samples (F30).
    pub largest: Vec<(Named, [f64; 2])>,
    /// Standard deviation of the derivative in albedo over that of `detached` (F39).
    pub albedo: Vec<(Named, f64)>,
    /// Roughness derivative of unlimited paths with roulette (F40).
    pub roulette: Vec<(Named, Check)>,
    /// True derivative of unlimited paths.
    pub unlimited: f64,
}

fn usage(e: impl ToString) -> ToolError {
    ToolError::Usage(e.to_string())
}

fn under_a_ball() -> Plate {
    Plate {
        kind: Ndf::Beckmann,
        alpha: BALL_ALPHA,
        incidence: BALL_INCIDENCE,
        light: Light::Ball(BALL),
    }
}

/// Derivatives of all pixels, summed over `samples`. `None` if interrupted.
fn pixels(
    scene: &Scene,
    param: &str,
    e: Estimator,
    seed: u64,
    samples: std::ops::Range<u64>,
    interrupt: &Interrupt,
) -> Result<Option<Vec<f64>>, ToolError> {
    let along = Direction::uniform(scene.params(), param)?;
    let (values, settings) = (scene.params().values(), &scene.settings);
    let r = e.forward_f32(
        &Job::new(scene, settings, seed, samples, interrupt),
        values,
        &[along],
    )?;
    let done = !r.cancelled;
    Ok(done.then(|| r.sums[1].iter().step_by(3).copied().collect()))
}

/// Standard deviation of one value.
fn deviation(values: &[f64]) -> f64 {
    Estimate::of(values).se * (values.len() as f64).sqrt()
}

/// Everything that is not a sweep; what is done so far if interrupted.
pub fn probe(
    quick: bool,
    seed: u64,
    estimators: &[Estimator],
    interrupt: &Interrupt,
) -> Result<Probes, ToolError> {
    let mut probes = Probes::default();
    let setup = under_a_ball().setup().map_err(usage)?;
    let usable = |scene: &Scene| -> Vec<Estimator> {
        let all = estimators.iter().copied();
        all.filter(|e| e.check(scene).is_ok()).collect()
    };
    for e in usable(&setup.scene) {
        ladder(&mut probes, &setup, e, quick, seed ^ 0x5a, interrupt)?;
    }
    single(&mut probes, &setup, quick, seed ^ 0xf32, interrupt)?;
    steps(&mut probes, &setup, quick, seed ^ 0xfd)?;
    glass(&mut probes, estimators)?;
    dark(&mut probes, &usable, quick, seed ^ 0xda, interrupt)?;
    for e in [Estimator::Differential, Estimator::DifferentialMis] {
        if !estimators.contains(&e) {
            continue;
        }
        let runs = if quick { 32 } else { 512 };
        let (mut largest, mut early, mut all) = (0.0f64, 0.0f64, Vec::new());
        for k in 0..runs {
            let Some(p) = pixels(&setup.scene, ROUGHNESS, e, seed ^ 0x30, k..k + 1, interrupt)?
            else {
                return Ok(probes);
            };
            largest = p.iter().fold(largest, |m, x| m.max(x.abs()));
            if k == runs / 16 - 1 {
                early = largest;
            }
            all.extend(p);
        }
        let std = deviation(&all);
        probes
            .largest
            .push((Named(e), [early / std, largest / std]));
    }
    let spp = if quick { 64 } else { 256 };
    let mut base = 0.0;
    for e in [
        Estimator::Detached,
        Estimator::Differential,
        Estimator::DifferentialMis,
    ] {
        let key = "metal.specular_reflectance.value";
        let found = pixels(&setup.scene, key, e, seed ^ 0x39, 0..spp, interrupt)?;
        let Some(found) = found else { break };
        let std = deviation(&found);
        if base == 0.0 {
            base = std;
        }
        probes.albedo.push((Named(e), std / base));
    }
    let furnace = sweeps::furnace(None).setup().map_err(usage)?;
    probes.unlimited = furnace.truth.slope;
    for e in usable(&furnace.scene) {
        let found = pixels(
            &furnace.scene,
            ROUGHNESS,
            e,
            seed ^ 0x40,
            0..spp / 4,
            interrupt,
        )?;
        let Some(found) = found else { break };
        let found = Estimate::of(&found);
        let n = (spp / 4) as f64;
        let check = Check {
            truth: furnace.truth.slope,
            mean: found.mean / n,
            error: (found.se / n).hypot(furnace.truth.error),
        };
        let c = e.capabilities();
        if !c.study || c.failures.contains(Failure::AttachedRoulette) {
            probes.roulette.push((Named(e), check));
        }
    }
    Ok(probes)
}

/// Sixteen groups of sixteen pixels, more and more samples.
fn ladder(
    probes: &mut Probes,
    setup: &Setup,
    e: Estimator,
    quick: bool,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<(), ToolError> {
    const GROUPS: usize = 16;
    let mut sums: Vec<f64> = Vec::new();
    let mut from = 0;
    let most = if quick { 64 } else { 1024 };
    let mut to = 1;
    while to <= most {
        let Some(new) = pixels(&setup.scene, ROUGHNESS, e, seed, from..to, interrupt)? else {
            return Ok(());
        };
        sums.resize(new.len(), 0.0);
        sums.iter_mut().zip(new).for_each(|(s, x)| *s += x);
        let size = sums.len() / GROUPS;
        let n = size as f64 * to as f64;
        let means: Vec<f64> = (sums.chunks_exact(size))
            .map(|g| g.iter().sum::<f64>() / n)
            .collect();
        let found = Estimate::of(&means);
        let square = |m: &f64| (m - setup.truth.slope).powi(2);
        let error = (means.iter().map(square).sum::<f64>() / GROUPS as f64).sqrt();
        let limit = z_limit(1, GROUPS as u64, 1e-4);
        let truth = Estimate {
            mean: setup.truth.slope,
            se: setup.truth.error,
        };
        probes.ladder.push(Rung {
            estimator: Named(e),
            samples: n,
            error: error * BALL_ALPHA / setup.truth.value,
            biased: found.z(&truth).abs() > limit && n > 100.0,
        });
        from = to;
        to *= 4;
    }
    Ok(())
}

/// Derivatives in the emitted radiance, all positive, added one by one in f32.
fn single(
    probes: &mut Probes,
    setup: &Setup,
    quick: bool,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<(), ToolError> {
    let (mut short, mut long) = (0.0f32, 0.0f64);
    let runs: u64 = if quick { 64 } else { 1 << 14 };
    let mut n = 0u64;
    for k in 0..runs {
        let e = Estimator::Emitter;
        let Some(p) = pixels(&setup.scene, EMISSION, e, seed, k..k + 1, interrupt)? else {
            return Ok(());
        };
        for x in p {
            short += x as f32;
            long += x;
            n += 1;
        }
        if (k + 1).is_power_of_two() && (k + 1).trailing_zeros().is_multiple_of(2) {
            let error = (f64::from(short) / long - 1.0).abs();
            probes.single.push((n as f64, error.max(1e-9)));
        }
    }
    Ok(())
}

fn steps(probes: &mut Probes, setup: &Setup, quick: bool, seed: u64) -> Result<(), ToolError> {
    let scene = &setup.scene;
    let info = scene.params().find(ROUGHNESS)?;
    let at = info.offset;
    let spp = if quick { 8 } else { 128 };
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let alpha = values[at];
    let image = |estimator, h: f64| -> Vec<f64> {
        let mut moved = values.clone();
        moved[at] += h;
        let theta = Theta::constant(&moved);
        let r = render_f64(
            &Job::new(scene, &scene.settings, seed, 0..spp, &()),
            &theta,
            estimator,
        );
        r.sums[0].iter().step_by(3).copied().collect()
    };
    let image_f32 = |h: f64| -> Vec<f64> {
        let mut moved: Vec<f32> = scene.params().values().to_vec();
        moved[at] += h as f32;
        let theta = Theta::constant(&moved);
        let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
        let r = render_f32(&job, &theta, Estimator::Emitter);
        r.sums[0].iter().step_by(3).copied().collect()
    };
    let difference = |up: Vec<f64>, down: Vec<f64>, h: f64| -> Vec<f64> {
        let pairs = up.iter().zip(&down);
        pairs
            .map(|(a, b)| (a - b) / (2.0 * h * spp as f64))
            .collect()
    };
    let smooth = |h: f64| {
        let t = Estimator::Emitter;
        Estimate::of(&difference(image(t, h), image(t, -h), h)).mean
    };
    // Richardson's extrapolation: the error goes with the fourth power of the step.
    let h = 2e-3 * alpha;
    let exact = (4.0 * smooth(h) - smooth(2.0 * h)) / 3.0;
    let count = if quick { 6 } else { 12 };
    for i in 0..count {
        let step = 0.3 * 10f64.powf(-10.0 * f64::from(i) / f64::from(count - 1));
        let h = step * alpha;
        let single = Estimate::of(&difference(image_f32(h), image_f32(-h), h)).mean;
        let t = Estimator::Detached;
        let jumps = difference(image(t, h), image(t, -h), h);
        let spread = Estimate::of(&jumps).se;
        probes.steps.push(Step {
            step,
            smooth: (smooth(h) / exact - 1.0).abs(),
            smooth_f32: (single / exact - 1.0).abs(),
            // With fewer samples that jump, there is nothing to see.
            jumps: if step * (jumps.len() as u64 * spp) as f64 > 16.0 {
                spread / exact.abs()
            } else {
                f64::NAN
            },
        });
    }
    Ok(())
}

const GLASS: &str = r#"<scene version="3.0.0">
    <sensor type="perspective"><float name="fov" value="40"/><film type="hdrfilm"><integer name="width" value="1"/>
    <integer name="height" value="1"/><rfilter type="box"/></film></sensor>
    <integrator type="path"/><emitter type="constant"/>
    <shape type="sphere"><bsdf type="dielectric" id="glass"/></shape></scene>"#;

/// Who refuses the index of smooth glass.
fn glass(probes: &mut Probes, estimators: &[Estimator]) -> Result<(), ToolError> {
    let loaded: Result<_, SceneError> =
        Scene::from_xml(GLASS, Path::new("."), &LoadOptions::default());
    let (scene, _) = loaded?;
    for &e in estimators {
        let refuses = e.active(&scene, &["glass.eta.value"]).is_err();
        probes.glass[usize::from(!refuses)].push(Named(e));
    }
    Ok(())
}

/// A black environment around a ball light: the derivative in its radiance is the albedo without the ball.
fn dark(
    probes: &mut Probes,
    usable: &dyn Fn(&Scene) -> Vec<Estimator>,
    quick: bool,
    seed: u64,
    interrupt: &Interrupt,
) -> Result<(), ToolError> {
    let ball = Plate {
        alpha: 0.3,
        ..under_a_ball()
    };
    let open = Plate {
        light: Light::Constant,
        ..ball
    };
    let [all, covered] = [open, ball].map(|p| p.setup());
    let truth = all.map_err(usage)?.truth.value - covered.map_err(usage)?.truth.value;
    let scene = ball.in_the_dark().map_err(usage)?;
    let spp = if quick { 64 } else { 256 };
    for e in usable(&scene) {
        let found = pixels(&scene, "ambient.radiance.value", e, seed, 0..spp, interrupt)?;
        let Some(found) = found else { break };
        let found = Estimate::of(&found);
        let (mean, error) = (found.mean / spp as f64, found.se / spp as f64);
        probes.dark.push((Named(e), Check { truth, mean, error }));
    }
    Ok(())
}

/// The report in words.
pub fn text(report: &Report) -> String {
    let mut out = Text::default();
    let sweeps = sweeps::all(false);
    let p = &report.probes;
    let limit = report.z_limit;
    out.say(
        "",
        format!(
            "{} points of {} samples; |z| below {limit:.1} is chance.",
            report.rows.len(),
            report.samples_per_point
        ),
    );

    summary(&mut out, report);
    laws(&mut out, report, &sweeps);

    wrong_on_purpose(&mut out, report);
    if let Some((worst, c)) = extreme(&p.dark) {
        out.say("F7", format!(
            "the derivative in the radiance of an environment that is black: {:.4}; {} of {} estimators \
             have it, largest |z| {:.1} ({worst}).",
            c.truth,
            p.dark.iter().filter(|(_, c)| c.z().abs() < limit).count(),
            p.dark.len(),
            c.z().abs()
        ));
    }
    outlines(&mut out, report);
    motion(&mut out, report);
    let grazing =
        |r: &Row| r.sweep == "incidence" && r.x > 80.0 && !r.estimator.0.capabilities().study;
    if let Some(worst) = worst(report, grazing) {
        out.say(
            "F9, F43",
            format!(
                "at grazing angles, where the horizon cuts the lobe, the largest difference is {}.",
                found(worst)
            ),
        );
    }
    out.say(
        "F12, F13",
        "do not arise: outlines are exact, no estimate is divided by, no trials are counted."
            .into(),
    );
    out.say("F24, F25", "concern losses of images, not derivatives of images: `gradient` draws image and adjoint from two seeds.".into());
    differences(&mut out, report);
    crossover(&mut out, report, &sweeps);
    let lobes = |r: &Row| r.estimator.0.capabilities().differential;
    if let Some(worst) = worst(report, lobes) {
        out.say("F29", format!(
            "the two lobes of the derivative of normals are summed: the largest difference is {}.",
            found(worst)
        ));
    }
    for (name, [few, many]) in &p.largest {
        out.say("F30", format!(
            "{name}: the largest sample is {few:.1} standard deviations, {many:.1} among 16 times as many."
        ));
    }
    let bad: u64 = report.rows.iter().map(|r| r.non_finite).sum();
    out.say("F31, F43", format!(
        "{bad} samples of {} million were not finite, from roughness 1e-4 to 1 and up to 89.9 degrees.",
        report.rows.len() as u64 * report.samples_per_point / 1_000_000
    ));
    cost(&mut out, report);
    out.mis(report);
    let albedo: Vec<String> = (p.albedo.iter().skip(1))
        .map(|(name, ratio)| format!("{name} {ratio:.2}"))
        .collect();
    if !albedo.is_empty() {
        out.say(
            "F39",
            format!(
                "the derivative in albedo keeps its ordinary samples: std over detached: {}.",
                albedo.join(", ")
            ),
        );
    }
    depth(&mut out, report);
    if let Some((n, error)) = p.single.last() {
        out.say("sums", format!(
            "{:.1} million derivatives in emission added one by one in f32 are off by {:.1e}; the \
             renderer adds them in f64.",
            n / 1e6,
            error
        ));
    }
    unresolved(&mut out, report);
    out.0
}

/// F2 to F6: what is refused, and what is biased by its type.
fn wrong_on_purpose(out: &mut Text, report: &Report) {
    let p = &report.probes;
    out.say("F2", format!(
        "a derivative through a Dirac delta (index of smooth glass) is refused by {} estimators, not \
         answered by a silent zero; {} has it.",
        p.glass[0].len(),
        list(&p.glass[1])
    ));
    for failure in [Failure::ConstantWeights, Failure::MixedWeights] {
        if let Some(worst) = worst(report, |r| fails_by(r.estimator, failure)) {
            out.say(
                failure.number(),
                format!(
                    "{}: {}. Such a combination does not compile without `AllowBias`.",
                    failure.name(),
                    found(worst)
                ),
            );
        }
    }
    let attached = (p.roulette.iter()).filter(|(e, _)| plays_attached(*e));
    let attached: Vec<String> = (attached)
        .map(|(name, c)| format!("{name}: z {:.1}", c.z()))
        .collect();
    out.say("F5, F6", if attached.is_empty() {
        let wrong = |f| list(&named(|c| c.failures.contains(f)));
        format!(
            "roulette and the choice of lobes take constant probabilities here ({} and {} do not).",
            wrong(Failure::AttachedRoulette),
            wrong(Failure::AttachedChoice)
        )
    } else {
        format!(
            "differentiated roulette is biased ({}); rough metal has no lobes to choose between.",
            attached.join(", ")
        )
    });
}

/// F8 to F11: samples that move across outlines, and those that stand still there.
fn outlines(out: &mut Text, report: &Report) {
    let naive = |r: &Row| fails_by(r.estimator, Failure::Discontinuities) && r.sweep != "depth";
    if let Some(worst) = worst(report, naive) {
        let all = report.rows.iter().filter(|r| naive(r));
        let edges = ["roughness-ball", "light-size"];
        let under: Vec<&Row> = all.filter(|r| edges.contains(&r.sweep)).collect();
        let wrong = under
            .iter()
            .filter(|r| r.finding == Finding::Biased)
            .count();
        out.say("F8, F10, F36", format!(
            "attached samples carry the edge of a light with them and miss its boundary term: biased at \
             {wrong} of {} points under a ball light; {}. Attached estimators that are not for study refuse such scenes.",
            under.len(),
            found(worst)
        ));
    }
    let still = |r: &Row| {
        let can = r.estimator.0.capabilities();
        can.motion == Motion::Reparameterised && !can.study && !in_motion(r)
    };
    if let Some(worst) = worst(report, still) {
        let wrong = (report.rows.iter())
            .filter(|r| still(r) && r.finding == Finding::Biased)
            .count();
        out.say("F11", format!(
            "samples that stand still at outlines (reparameterised): {wrong} points biased; the largest \
             difference: {}.",
            found(worst)
        ));
    }
}

/// F26, F27: the step of differences.
fn differences(out: &mut Text, report: &Report) {
    let p = &report.probes;
    if let (Some(best), Some(best32)) = (
        p.steps.iter().min_by(|a, b| a.smooth.total_cmp(&b.smooth)),
        p.steps
            .iter()
            .min_by(|a, b| a.smooth_f32.total_cmp(&b.smooth_f32)),
    ) {
        out.say("F26", format!(
            "central differences of smooth samples are best at a step of {:.0e} alpha in f64 (error {:.0e}) \
             and {:.0e} in f32 (error {:.0e}).",
            best.step, best.smooth, best32.step, best32.smooth_f32
        ));
        let seen = || {
            p.steps
                .iter()
                .filter(|s| s.jumps.is_finite() && s.step < 0.1)
        };
        let wide = seen().max_by(|a, b| a.step.total_cmp(&b.step));
        let narrow = seen().min_by(|a, b| a.step.total_cmp(&b.step));
        if let (Some(wide), Some(narrow)) = (wide, narrow)
            && narrow.step < wide.step
        {
            let slope = (narrow.jumps / wide.jumps).ln() / (narrow.step / wide.step).ln();
            out.say("F27", format!(
                "of samples that jump, the standard error grows from {:.3} at {:.0e} to {:.3} at {:.0e}: with \
                 the power {slope:.2} of the step (law: -0.5).",
                wide.jumps, wide.step, narrow.jumps, narrow.step
            ));
        }
    }
}

#[derive(Default)]
struct Text(String);

impl Text {
    fn say(&mut self, mode: &str, what: String) {
        let _ = writeln!(
            self.0,
            "{mode}{}{what}",
            if mode.is_empty() { "" } else { ": " }
        );
    }

    /// F38: combinations that are worse than their better ingredient.
    fn mis(&mut self, report: &Report) {
        let pairs = [
            (Estimator::Mis, Estimator::Detached),
            (Estimator::DifferentialMis, Estimator::Differential),
            (Estimator::ReparameterisedMis, Estimator::Reparameterised),
        ];
        let mut worst: Option<(f64, &Row)> = None;
        let (mut count, mut of) = (0, 0);
        for r in &report.rows {
            let Some((_, single)) = pairs.iter().find(|(both, _)| *both == r.estimator.0) else {
                continue;
            };
            let same = |o: &&Row| o.sweep == r.sweep && o.x == r.x;
            let found = |e: Estimator| {
                let own = |o: &&Row| same(o) && o.estimator.0 == e;
                let row = report.rows.iter().find(own)?;
                (row.finding == Finding::Right).then_some(row.std)
            };
            let (Some(a), Some(b)) = (found(*single), found(Estimator::Emitter)) else {
                continue;
            };
            // Where one of them hardly scatters, a ratio says little.
            if a.min(b) < 0.1 {
                continue;
            }
            let ratio = r.std / a.min(b);
            of += 1;
            count += usize::from(ratio > 1.05);
            if worst.is_none_or(|(w, _)| ratio > w) {
                worst = Some((ratio, r));
            }
        }
        if let Some((ratio, r)) = worst {
            self.say("F38", format!(
                "weights made for positive integrands: the combination with light sampling is noisier than its \
                 better half at {count} of {of} points, {ratio:.1} times at most ({} at {} = {:.3}).",
                r.estimator, r.sweep, r.x
            ));
        }
    }
}

/// The title of a sweep without the failure modes behind it.
fn short(sweep: &Sweep) -> &str {
    sweep.title.split(" (F").next().unwrap_or_default()
}

fn list(all: &[Named]) -> String {
    if all.is_empty() {
        return "none".into();
    }
    let names: Vec<&str> = all.iter().map(|e| e.0.name()).collect();
    names.join(", ")
}

fn found(r: &Row) -> String {
    let what = if in_motion(r) {
        "the derivative"
    } else {
        "d ln I / d ln alpha"
    };
    format!(
        "{} at {} = {:.3}: |z| {:.1}, {what} off by {:.1e}",
        r.estimator,
        r.sweep,
        r.x,
        r.z.abs(),
        r.relative_bias.abs()
    )
}

/// Whether it is about something that moves.
fn in_motion(r: &Row) -> bool {
    r.param != ROUGHNESS
}

/// F10, F44: who has the derivative in what moves.
fn motion(out: &mut Text, report: &Report) {
    let rows = || report.rows.iter().filter(|r| in_motion(r));
    if rows().next().is_none() {
        return;
    }
    let blind = named(|c| !c.moves_vertices);
    out.say(
        "F10",
        format!(
            "{} estimators refuse the derivative in what moves by name, and answer with no zero.",
            blind.len()
        ),
    );
    for &e in Estimator::ALL {
        let own = |r: &Row| in_motion(r) && r.estimator.0 == e;
        let c = e.capabilities();
        let Some(worst) = worst(report, own) else {
            continue;
        };
        let wrong: Vec<&Row> = rows()
            .filter(|r| own(r) && r.finding == Finding::Biased)
            .collect();
        let mut places: Vec<&str> = wrong.iter().map(|r| r.sweep).collect();
        places.dedup();
        let numbers: Vec<&str> = c.failures.iter().map(Failure::number).collect();
        let what = match (wrong.is_empty(), c.in_the_limit) {
            (true, _) => "right wherever it was measured; the largest difference".into(),
            (false, true) => format!(
                "blurs what is small, as its kernel is not narrow enough there: biased at {} points ({}); the largest",
                wrong.len(),
                places.join(", ")
            ),
            (false, false) => format!("biased at {} points ({})", wrong.len(), places.join(", ")),
        };
        let mode = if numbers.is_empty() {
            "F10, F44".to_owned()
        } else {
            numbers.join(", ")
        };
        out.say(&mode, format!("{}: {what}: {}.", e.name(), found(worst)));
    }
}

/// Whether an estimator is for the study of this failure, and of no other.
fn fails_by(estimator: Named, failure: Failure) -> bool {
    let can = estimator.0.capabilities();
    can.study && can.failures == Failures::of(&[failure])
}

/// Whether the probability of its roulette is differentiated.
fn plays_attached(estimator: Named) -> bool {
    let failures = estimator.0.capabilities().failures;
    failures.contains(Failure::AttachedRoulette)
}

/// All estimators that are like that.
fn named(like: impl Fn(Capabilities) -> bool) -> Vec<Named> {
    let all = Estimator::ALL.iter().filter(|e| like(e.capabilities()));
    all.map(|e| Named(*e)).collect()
}

/// How often each estimator is right.
fn summary(out: &mut Text, report: &Report) {
    for &e in Estimator::ALL {
        let count = |f: Finding| {
            let own = |r: &&Row| r.estimator.0 == e && r.finding == f;
            report.rows.iter().filter(own).count()
        };
        let [right, biased, unresolved, bad] = [
            Finding::Right,
            Finding::Biased,
            Finding::Unresolved,
            Finding::NonFinite,
        ]
        .map(count);
        if right + biased + unresolved + bad > 0 {
            out.say("", format!(
                "  {:<34} right {right:>3}, biased {biased:>3}, lobe not met {unresolved:>3}, not finite {bad}",
                e.name()
            ));
        }
    }
}

/// The row with the largest |z| among resolved ones that are more than rounding.
fn worst(report: &Report, of: impl Fn(&Row) -> bool) -> Option<&Row> {
    let all = || {
        report
            .rows
            .iter()
            .filter(|r| of(r) && r.finding != Finding::Unresolved)
    };
    let largest = |a: &&Row, b: &&Row| a.z.abs().total_cmp(&b.z.abs());
    let biased = all().filter(|r| r.finding == Finding::Biased);
    let relative = |a: &&Row, b: &&Row| a.relative_bias.abs().total_cmp(&b.relative_bias.abs());
    biased.max_by(relative).or_else(|| all().max_by(largest))
}

fn extreme(checks: &[(Named, Check)]) -> Option<(Named, Check)> {
    let largest =
        |a: &&(Named, Check), b: &&(Named, Check)| a.1.z().abs().total_cmp(&b.1.z().abs());
    checks.iter().max_by(largest).copied()
}

/// F1: measured spread over the laws, and growth without bound.
fn laws(out: &mut Text, report: &Report, sweeps: &[Sweep]) {
    for sweep in sweeps {
        for law in &sweep.laws {
            let rows = report.rows.iter().filter(|r| {
                r.sweep == sweep.name
                    && r.estimator.0 == law.estimator
                    && (law.range[0]..=law.range[1]).contains(&r.x)
            });
            let off = rows.map(|r| (r.std / (law.std)(r.x) - 1.0, r.x));
            let largest = off.max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
            if let Some((off, x)) = largest {
                out.say("F1", format!(
                    "{}: std of {} follows its law ({}) to {:.1} % for alpha in [{:.0e}, {}] (worst at {x:.1e}).",
                    short(sweep),
                    law.estimator.name(),
                    law.name,
                    100.0 * off.abs(),
                    law.range[0],
                    law.range[1]
                ));
            }
        }
        if sweep.over_roughness {
            let mut growing = Vec::new();
            for &e in Estimator::ALL {
                if let Some(power) = growth(report, sweep.name, e)
                    && power < -0.5
                {
                    growing.push(format!("{} ({power:.2})", e.name()));
                }
            }
            if !growing.is_empty() {
                out.say(
                    "F1",
                    format!(
                        "{}: std grows without bound as alpha falls, with the power: {}.",
                        short(sweep),
                        growing.join(", ")
                    ),
                );
            }
        }
    }
}

/// Power of alpha that the spread goes with below 1e-2, from the two ends of that range.
fn growth(report: &Report, sweep: &str, estimator: Estimator) -> Option<f64> {
    let mut rows: Vec<&Row> = (report.rows.iter())
        .filter(|r| r.sweep == sweep && r.estimator.0 == estimator && r.x <= 1.1e-2)
        .filter(|r| r.finding != Finding::Unresolved && r.std > 0.0)
        .collect();
    rows.sort_by(|a, b| a.x.total_cmp(&b.x));
    let (first, last) = (rows.first()?, rows.last()?);
    // Rounding in f32 grows as well, far below.
    let matters = first.std * first.x > 1e-2 && last.x > 2.0 * first.x;
    matters.then(|| (last.std / first.std).ln() / (last.x / first.x).ln())
}

/// F28: where moving samples stop being better than constant ones.
fn crossover(out: &mut Text, report: &Report, sweeps: &[Sweep]) {
    let Some(sweep) = sweeps.iter().find(|s| s.name == "roughness-stripes") else {
        return;
    };
    let ratio = |x: f64| {
        let std = |e: Estimator| {
            let rows = report.rows.iter();
            let mut own = rows.filter(|r| r.sweep == sweep.name && r.x == x && r.estimator.0 == e);
            own.next().map(|r| r.std)
        };
        Some((std(Estimator::Attached)? / std(Estimator::Detached)?).ln())
    };
    let mut xs: Vec<f64> = (report.rows.iter())
        .filter(|r| r.sweep == sweep.name)
        .map(|r| r.x)
        .collect();
    xs.sort_by(f64::total_cmp);
    xs.dedup();
    let cross = |f: &dyn Fn(f64) -> Option<f64>| {
        xs.windows(2).find_map(|w| {
            let (a, b) = (f(w[0])?, f(w[1])?);
            (a < 0.0 && b >= 0.0).then(|| {
                let t = a / (a - b);
                (w[0].ln() * (1.0 - t) + w[1].ln() * t).exp()
            })
        })
    };
    let law = |x: f64| Some(((sweep.laws[0].std)(x) / (sweep.laws[1].std)(x)).ln());
    if let (Some(measured), Some(expected)) = (cross(&ratio), cross(&law)) {
        let k = f64::from(STRIPES);
        out.say("F28", format!(
            "attached samples beat detached ones up to k sigma = {:.2} (the law of two dimensions crosses at {:.2}; \
             about 3).",
            k * lobe_width(measured),
            k * lobe_width(expected)
        ));
    }
}

/// F37: time against length.
fn cost(out: &mut Text, report: &Report) {
    let rows =
        || (report.rows.iter()).filter(|r| r.sweep == "depth" && r.estimator.0 == Estimator::Mis);
    let shortest = rows().min_by(|a, b| a.x.total_cmp(&b.x));
    let longest = rows().max_by(|a, b| a.x.total_cmp(&b.x));
    if let (Some(a), Some(b)) = (shortest, longest)
        && b.x > a.x
    {
        let power = (b.seconds_per_sample / a.seconds_per_sample).ln() / (b.x / a.x).ln();
        out.say("F37", format!(
            "{:.2} us a sample with {} edges, {:.2} us with {}: the power {power:.2} of the length, not 2.",
            a.seconds_per_sample * 1e6,
            a.x,
            b.seconds_per_sample * 1e6,
            b.x
        ));
    }
}

/// F40: what a limit of length loses.
fn depth(out: &mut Text, report: &Report) {
    let unlimited = report.probes.unlimited;
    if unlimited == 0.0 {
        return;
    }
    let mut rows: Vec<&Row> = (report.rows.iter())
        .filter(|r| r.sweep == "depth" && r.estimator.0 == Estimator::Mis)
        .collect();
    rows.sort_by(|a, b| a.x.total_cmp(&b.x));
    let lost: Vec<String> = (rows.iter())
        .map(|r| {
            format!(
                "{} edges {:.1} %",
                r.x,
                100.0 * (1.0 - r.truth[0] / unlimited)
            )
        })
        .collect();
    let mut parts = Vec::new();
    if !lost.is_empty() {
        let lost = lost.join(", ");
        parts.push(format!("a limit of length loses of the derivative: {lost}"));
    }
    let detached: Vec<_> = (report.probes.roulette.iter())
        .filter(|(e, _)| !plays_attached(*e))
        .copied()
        .collect();
    if let Some((name, c)) = extreme(&detached) {
        parts.push(format!(
            "roulette loses nothing (largest |z| {:.1}, {name})",
            c.z().abs()
        ));
    }
    if !parts.is_empty() {
        out.say("F40", format!("{}.", parts.join("; ")));
    }
}

fn unresolved(out: &mut Text, report: &Report) {
    for e in [Estimator::Emitter, Estimator::Detached] {
        let rows: Vec<&Row> = (report.rows.iter())
            .filter(|r| r.estimator.0 == e && r.finding == Finding::Unresolved)
            .collect();
        if let Some(first) = rows.iter().max_by(|a, b| a.x.total_cmp(&b.x)) {
            out.say("lobe not met", format!(
                "{} misses the lobe at {} points, {} = {:.1e} for example: mean and error mean nothing \
                 there.",
                e.name(),
                rows.len(),
                first.sweep,
                first.x
            ));
        }
    }
}
