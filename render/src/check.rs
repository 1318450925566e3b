//! Whether a gradient is right: every derivative of an estimator against central differences of the image.
//!
//! The gradient is estimated as a program would, in single precision, by whatever estimator or [`Mixture`] is to be
//! judged. The differences render the image at moved parameters in double precision, with common random numbers: the same
//! seed on both sides, so that most of the noise cancels. Both are repeated with independent seeds, their means are
//! compared by a z-test that is corrected for the number of comparisons ([`crate::statistics`]), and three things can come
//! of it ([`Verdict`]). Nothing is called right only because it is noisy.
//!
//! A range of up to three values is checked value by value; of a larger one the derivatives along [`DIRECTIONS`] random
//! directions are compared, in each of which every value moves up or down. A wrong derivative of one texel among many shows
//! in them only as far as it stands out from their noise.
//!
//! # Errors of the differences
//!
//! * **The step** (F26, F27). Two steps are extrapolated to none [Richardson 1911], and a third of their difference, which is what that
//!   changes, counts as an error of the result. Where the image has a kink or a jump in the parameter no step is small
//!   enough, and this error says so only if the steps meet it.
//! * **Noise.** Where paths jump from one place to another as the parameter moves, common random numbers do not cancel, and
//!   the noise of the difference grows as the step shrinks. Short pilots of other seeds therefore choose the largest step
//!   whose error is well below the noise that is expected; if there is none, the one for which both together are least.
//!   A step that is too large all the same shows at the second look, which takes a quarter of it: what that changes
//!   beyond noise counts as an error as well. Both steps of a pair agree where they end beyond the same kink, so what would be
//!   called wrong is looked at once more, with a tenth of that.
//! * **Rare events.** If a jump is so rare that no repeat meets it, mean and error are both wrong. What differs is looked at
//!   again, with four times the repeats and seeds of its own, before it is called wrong.
//! * **Bounds.** Values near an end of their valid interval have no room on both sides. They move inwards, and a one-sided
//!   difference of the same order takes the place of the central one; in a random direction they stay, unless all are like
//!   that.
//! * **What the path tracer does not see.** The differences are those of the image by sampled emitters and scattered
//!   directions. Light that it cannot find at all, such as a caustic of a point light, is missing on both sides.
//!
//! With a loss the derivative of the loss in every pixel is a constant here, `adjoint`: what noise does to a loss is
//! another question (errata Z-4.4).
//!
//! ```
//! use render::auto::Mixture;
//! use render::check::{Options, Verdict, check};
//! use render::instances::Estimator;
//!
//! let mut scene = render::scene::room(8, 8)?;
//! let names = ["left.reflectance.value"];
//! let mis = Mixture::only(&scene, Estimator::Mis, &names);
//! let adjoint = vec![1.0 / 192.0; 192]; // of the mean of all pixels and channels
//! let settings = scene.settings; // 64 samples per pixel and repeat
//! let options = Options { repeats: 8, tolerance: 0.5, ..Options::default() };
//! let report = check(&mut scene, &settings, &names, &mis, &adjoint, &options, &())?;
//! let report = report.expect("nobody stops it");
//! assert_eq!(report.verdict(), Verdict::Right, "{report}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::fmt;

use crate::auto::Mixture;
use crate::error::RenderError;
use crate::instances::{Estimator, render_f64};
use crate::integrator::Job;
use crate::integrator::gradient::check_size;
use crate::integrator::render::Progress;
use crate::params::{ParamInfo, Params, Theta};
use crate::sampler::{Family, mix64};
use crate::scene::{Scene, Settings};
use crate::statistics::{Estimate, z_limit};

/// Random directions that a large range is checked along.
pub const DIRECTIONS: u32 = 4;
/// Ranges of more values than this are checked along random directions.
const FEW: usize = 3;
/// The largest step, over the size of a range's values, or over that of what lengths move.
const LARGEST_STEP: f64 = 0.2;
/// Less room than this up to a bound, over that size, is none.
const ROOM: f64 = 0.02;
/// How many steps are tried at most.
const HALVINGS: u32 = 10;
/// Images that a difference takes at most.
const PLACES: u64 = 3;
/// Repeats of a pilot that a step is chosen by.
pub const PILOTS: u64 = 4;
/// Repeats of a second look, for one of the first.
const SECOND_LOOK: u64 = 4;
/// Its step, over that of the first: where paths jump as the parameter moves, so many repeats see as much noise.
const SECOND_STEP: f64 = 0.25;
/// The step of a third look, over that of the second.
const THIRD_STEP: f64 = 0.1;
/// What single precision may do to a derivative, relative to those of its range.
const ROUNDING: f64 = 1e-5;

/// How much is done, and how sure it has to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Repeats of the gradient and of the differences, at least four.
    pub repeats: u32,
    /// A derivative is right if an error of this size, relative to the derivatives of its range, would have been noticed.
    pub tolerance: f64,
    /// Probability that any derivative of a right gradient differs at the first look.
    pub significance: f64,
    /// All random numbers are a function of it.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            repeats: 32,
            tolerance: 0.1,
            significance: 1e-3,
            seed: 0,
        }
    }
}

/// What a comparison says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Verdict {
    /// Both agree, and an error as large as the tolerance would have been noticed.
    Right,
    /// Both agree, or disagreed once and not again, but the noise is such that an error could hide in it; or nothing was
    /// seen of the parameter at all.
    CannotTell,
    /// Both differ beyond chance, and do so again with four times the repeats and smaller steps.
    Wrong,
}

impl Verdict {
    /// The verdict in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::CannotTell => "cannot tell",
            Self::Wrong => "wrong",
        }
    }
}

/// What the derivative is taken along.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Along {
    /// One value of a range.
    Value(u32),
    /// A random direction, in which every value of a range moves up or down.
    Random(u32),
}

impl fmt::Display for Along {
    /// As it follows the name of a range.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value(i) => write!(f, "[{i}]"),
            Self::Random(k) => write!(f, " along direction {}", k + 1),
        }
    }
}

/// One derivative, found in two ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Of what.
    pub along: Along,
    /// By the estimator, with its standard error.
    pub gradient: Estimate,
    /// By differences, extrapolated from two steps, with the standard error of their noise.
    pub differences: Estimate,
    /// The larger of both steps, in units of the parameter.
    pub step: f64,
    /// What extrapolation changes, and at a second look a smaller step: the error that the step may have left.
    pub step_error: f64,
    /// Difference of the two, over all of these errors; of the second look, if there was one.
    pub z: f64,
    /// The smallest error that would have been noticed, over the root mean square of the derivatives of the range; infinite
    /// where those are zero.
    pub resolution: f64,
    /// What that says.
    pub verdict: Verdict,
}

/// All comparisons of a range.
#[derive(Clone, Debug, PartialEq)]
pub struct Checked {
    /// Its name.
    pub name: String,
    /// One per value, or per random direction.
    pub comparisons: Vec<Comparison>,
}

impl Checked {
    /// That of the worst comparison.
    pub fn verdict(&self) -> Verdict {
        worst(self.comparisons.iter().map(|c| c.verdict))
    }
}

/// What a check found.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// Per range, in the order asked for.
    pub params: Vec<Checked>,
    /// What |z| stays below if all derivatives are right.
    pub z_limit: f64,
    /// Samples of gradients and differences that were not finite, and were left out.
    pub non_finite: u64,
}

impl Report {
    /// That of the worst comparison.
    pub fn verdict(&self) -> Verdict {
        worst(self.params.iter().map(Checked::verdict))
    }
}

fn worst(verdicts: impl Iterator<Item = Verdict>) -> Verdict {
    verdicts.max().unwrap_or(Verdict::CannotTell)
}

/// A line per comparison, and one for all.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let all = self.params.iter();
        let lines = all.flat_map(|p| p.comparisons.iter().map(move |c| (&p.name, c)));
        for (name, c) in lines {
            writeln!(
                f,
                "{name}{}: gradient {:.5e} +- {:.1e}, differences {:.5e} +- {:.1e} (noise) +- {:.1e} (step {:.1e}), \
                 z {:.2}: {}",
                c.along,
                c.gradient.mean,
                c.gradient.se,
                c.differences.mean,
                c.differences.se,
                c.step_error,
                c.step,
                c.z,
                c.verdict.name().to_uppercase(),
            )?;
            if c.resolution.is_finite() {
                let percent = 100.0 * c.resolution;
                writeln!(f, "    an error of {percent:.1} % would have been noticed")?;
            } else {
                writeln!(f, "    nothing was seen of it")?;
            }
        }
        if self.non_finite > 0 {
            writeln!(f, "{} samples were not finite", self.non_finite)?;
        }
        let verdict = self.verdict().name();
        writeln!(f, "{verdict} (limit of |z|: {:.2})", self.z_limit)
    }
}

/// How many images' worth of samples a check takes at most, for progress bars.
pub fn most_passes<N: AsRef<str>>(scene: &Scene, names: &[N], options: &Options) -> u64 {
    let directions = |name: &N| {
        let info = scene.params().find(name.as_ref());
        info.map_or(0, |info| directions(info).len() as u64)
    };
    let repeats = u64::from(options.repeats);
    let pilots = PILOTS * PLACES * u64::from(HALVINGS + 1);
    let each = pilots + 2 * PLACES * repeats * (1 + 2 * SECOND_LOOK);
    1 + repeats * (1 + SECOND_LOOK) + names.iter().map(directions).sum::<u64>() * each
}

/// Compares the derivatives of `<adjoint, image>` in the named parameters, each once, with differences, `adjoint` as for
/// [`crate::integrator::gradient::backward`]. `None` if it was cancelled. The samples per pixel of `settings` are those of a
/// repeat. The scene is left as it was; it is changed meanwhile where shapes, cameras or lights move.
///
/// Costs `repeats` gradients of all parameters together, and for every value or direction four images in double precision
/// per repeat and some for pilots; four times as much again for what differs.
///
/// # Errors
/// An unknown name, an adjoint of the wrong size, fewer than four repeats, a tolerance or significance that is no
/// probability, a parameter that an estimator of the mixture does not see, a scene in which it is refused, a
/// shape that would move out of reach, or a derivative that is not finite.
pub fn check<N: AsRef<str>>(
    scene: &mut Scene,
    settings: &Settings,
    names: &[N],
    mixture: &Mixture,
    adjoint: &[f32],
    options: &Options,
    progress: &dyn Progress,
) -> Result<Option<Report>, RenderError> {
    check_size("adjoint image", scene, adjoint)?;
    require(options)?;
    let mut infos: Vec<ParamInfo> = Vec::new();
    for name in names {
        let info = scene.params().find(name.as_ref())?;
        if !infos.contains(info) {
            infos.push(info.clone());
        }
    }
    let names: Vec<&str> = infos.iter().map(|i| i.name.as_str()).collect();
    let tests: Vec<(usize, Along)> = (infos.iter().enumerate())
        .flat_map(|(i, info)| directions(info).into_iter().map(move |along| (i, along)))
        .collect();
    let values = scene.params().values().to_vec();
    let mut run = Run {
        scene,
        names: &names,
        mixture,
        adjoint,
        settings,
        values: &values,
        options,
        progress,
        non_finite: 0,
        size: 0.0,
    };
    let found = run.all(&infos, &tests);
    // It may have been left while shapes had moved.
    let restored = run.scene.set_params(&values);
    let non_finite = run.non_finite;
    let (Some(comparisons), z_limit) = found? else {
        return Ok(None);
    };
    restored?;
    let mut params: Vec<Checked> = (infos.iter())
        .map(|info| Checked {
            name: info.name.clone(),
            comparisons: Vec::new(),
        })
        .collect();
    for ((i, _), comparison) in tests.into_iter().zip(comparisons) {
        params[i].comparisons.push(comparison);
    }
    Ok(Some(Report {
        params,
        z_limit,
        non_finite,
    }))
}

fn require(options: &Options) -> Result<(), RenderError> {
    if options.repeats < 4 {
        return Err(RenderError::Count {
            what: "repeats",
            expected: "at least four",
            found: options.repeats.into(),
        });
    }
    for (what, found) in [
        ("tolerance", options.tolerance),
        ("significance", options.significance),
    ] {
        if !(found > 0.0 && found < 1.0) {
            return Err(RenderError::Fraction { what, found });
        }
    }
    Ok(())
}

fn directions(info: &ParamInfo) -> Vec<Along> {
    let n = info.shape.len();
    if n <= FEW {
        (0..n as u32).map(Along::Value).collect()
    } else {
        (0..DIRECTIONS).map(Along::Random).collect()
    }
}

/// How far the values of a range may be moved for differences, and what single precision leaves of that.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// As large as what moves, or as the values are.
    size: f64,
    /// The largest step up and down that all values can take together, in units of the parameter; zero where one is at an
    /// end of its valid interval.
    pub most: f64,
    /// What rounding to single precision does to a step, where the scene has to follow.
    pub rounding: f64,
}

impl Span {
    /// Of a range of this scene.
    pub fn of(scene: &Scene, info: &ParamInfo) -> Self {
        let (lo, hi) = info.valid;
        let size = (scene.reach_of(info)).unwrap_or_else(|| scene.params().size(info));
        let values = scene.params().values()[info.range()].iter();
        let (mut most, mut largest) = (LARGEST_STEP * size, size);
        for v in values.map(|&v| f64::from(v)) {
            most = most.min((v - lo).min(hi - v));
            largest = largest.max(v.abs());
        }
        let moves = info.kind.is_motion();
        Self {
            size,
            most,
            rounding: if moves {
                f64::from(f32::EPSILON) * largest
            } else {
                0.0
            },
        }
    }
}

/// Of steps from `most` on, each half of the one before, the first one whose own error is well below the noise; if there is
/// none, the one with the least error in all. `errors` of a step are these two; `None` if it was cancelled.
///
/// # Errors
/// Those of `errors`.
pub fn widest_step<E>(
    most: f64,
    mut errors: impl FnMut(f64) -> Result<Option<[f64; 2]>, E>,
) -> Result<Option<f64>, E> {
    let mut best = (f64::INFINITY, most);
    let mut step = most;
    for _ in 0..HALVINGS {
        let Some([own, noise]) = errors(step)? else {
            return Ok(None);
        };
        let error = own.hypot(noise);
        if error < best.0 {
            best = (error, step);
        }
        if own <= 0.5 * noise {
            break;
        }
        step *= 0.5;
    }
    Ok(Some(best.1))
}

/// A direction, and how far it may be followed.
struct Line {
    /// First value in the parameter vector, and what is added there per unit of the step.
    offset: usize,
    along: Vec<f64>,
    /// Whether values can go one way only.
    one_sided: bool,
    /// Largest step.
    most: f64,
    /// Whether shapes, cameras or lights move: the scene has to follow then.
    moves: bool,
    /// What rounding to single precision does to a step.
    rounding: f64,
}

impl Line {
    fn new(params: &Params, info: &ParamInfo, along: Along, span: &Span) -> Self {
        let (lo, hi) = info.valid;
        let size = span.size;
        let values = params.values()[info.range()].iter().map(|&v| f64::from(v));
        let wanted = |i: usize| match along {
            Along::Value(k) => f64::from(u8::from(i == k as usize)),
            // A sign per value.
            Along::Random(k) => {
                let bits = mix64(mix64(u64::from(k) << 32 | info.offset as u64) ^ i as u64);
                if bits >> 63 == 0 { 1.0 } else { -1.0 }
            }
        };
        let room = |v: f64| (v - lo).min(hi - v);
        let free = |v: f64| room(v) >= ROOM * size;
        let moved = |(i, v): (usize, f64)| (wanted(i), v);
        let all: Vec<(f64, f64)> = values.enumerate().map(moved).collect();
        let one_sided = !all.iter().any(|&(d, v)| d != 0.0 && free(v));
        let mut most = LARGEST_STEP * size;
        let mut direction = Vec::with_capacity(all.len());
        for &(d, v) in &all {
            direction.push(if d == 0.0 {
                0.0
            } else if one_sided {
                // Twice the step, inwards.
                most = most.min(0.5 * (v - lo).max(hi - v));
                if hi - v >= v - lo { 1.0 } else { -1.0 }
            } else if free(v) {
                most = most.min(room(v));
                d
            } else {
                0.0
            });
        }
        Self {
            offset: info.offset,
            along: direction,
            one_sided,
            most,
            moves: info.kind.is_motion(),
            rounding: span.rounding,
        }
    }

    /// The derivative along it, of a gradient of the range.
    fn dot(&self, gradient: &[f64]) -> f64 {
        self.along.iter().zip(gradient).map(|(d, g)| d * g).sum()
    }

    /// Where the difference of step `h` takes values, with their weights: of second order.
    fn stencil(&self, h: f64) -> Vec<(f64, f64)> {
        if self.one_sided {
            vec![(0.0, -1.5 / h), (h, 2.0 / h), (2.0 * h, -0.5 / h)]
        } else {
            vec![(h, 0.5 / h), (-h, -0.5 / h)]
        }
    }
}

/// Differences of two steps, extrapolated to none.
struct Pair {
    /// The larger step.
    step: f64,
    extrapolated: Estimate,
    step_error: f64,
    repeats: u64,
}

impl Pair {
    /// Of differences by `step` and by half of it, with the same seeds.
    fn new(step: f64, wide: &[f64], near: &[f64]) -> Self {
        let corrections: Vec<f64> = near.iter().zip(wide).map(|(n, w)| (n - w) / 3.0).collect();
        let extrapolated: Vec<f64> = near.iter().zip(&corrections).map(|(n, c)| n + c).collect();
        Self {
            step,
            extrapolated: Estimate::of(&extrapolated),
            step_error: Estimate::of(&corrections).mean.abs(),
            repeats: wide.len() as u64,
        }
    }

    /// Beside another look: what differs between them by more than noise is an error of the step, too.
    fn beside(mut self, other: &Self) -> Self {
        let [a, b] = [other, &self].map(|pair| pair.extrapolated);
        let noise = a.se.powi(2) + b.se.powi(2);
        let beyond = ((a.mean - b.mean).powi(2) - noise).max(0.0);
        self.step_error = self.step_error.hypot(beyond.sqrt());
        self
    }

    /// The noise of so many repeats.
    fn expected(&self, repeats: u64) -> f64 {
        self.extrapolated.se * (self.repeats as f64 / repeats as f64).sqrt()
    }
}

/// Everything that a check needs.
struct Run<'a> {
    scene: &'a mut Scene,
    names: &'a [&'a str],
    mixture: &'a Mixture,
    adjoint: &'a [f32],
    settings: &'a Settings,
    /// The scene's own.
    values: &'a [f32],
    options: &'a Options,
    progress: &'a dyn Progress,
    non_finite: u64,
    /// Sum of the sizes of what pixels add to the objective.
    size: f64,
}

impl Run<'_> {
    /// A comparison per test, and the limit of |z|; none if cancelled.
    fn all(
        &mut self,
        infos: &[ParamInfo],
        tests: &[(usize, Along)],
    ) -> Result<(Option<Vec<Comparison>>, f64), RenderError> {
        let repeats = u64::from(self.options.repeats);
        let limit = z_limit(tests.len(), repeats, self.options.significance);
        let spans: Vec<_> = infos.iter().map(|i| Span::of(self.scene, i)).collect();
        let lines: Vec<Line> = (tests.iter())
            .map(|&(i, along)| Line::new(self.scene.params(), &infos[i], along, &spans[i]))
            .collect();
        let Some(gradients) = self.gradients(tests, &lines, self.options.seed, repeats)? else {
            return Ok((None, limit));
        };
        let Some(size) = self.objective(self.values_wide(), self.options.seed, f64::abs) else {
            return Ok((None, limit));
        };
        self.size = size;
        let mut pairs = Vec::with_capacity(tests.len());
        for (t, line) in lines.iter().enumerate() {
            let Some(step) = self.step(line, t as u64)? else {
                return Ok((None, limit));
            };
            let seed = Family::Differences.seed(self.options.seed) ^ ((t as u64) << 40);
            let Some(pair) = self.pair(line, step, seed, repeats)? else {
                return Ok((None, limit));
            };
            pairs.push(pair);
        }
        let scales = scales(infos.len(), tests, &pairs);
        let mut out: Vec<Comparison> = (tests.iter().zip(&lines).zip(&pairs).enumerate())
            .map(|(t, ((&(i, along), line), pair))| {
                self.compare(
                    (&infos[i].name, along),
                    line,
                    gradients[t],
                    pair,
                    scales[i],
                    limit,
                )
            })
            .collect::<Result<_, _>>()?;
        // A second look at what differs.
        let suspects: Vec<usize> = (0..out.len())
            .filter(|&t| out[t].verdict == Verdict::Wrong)
            .collect();
        if suspects.is_empty() {
            return Ok((Some(out), limit));
        }
        let seed = Family::SecondLooks.seed(self.options.seed);
        let Some(gradients) = self.gradients(tests, &lines, seed, SECOND_LOOK * repeats)? else {
            return Ok((None, limit));
        };
        for t in suspects {
            let (i, along) = tests[t];
            let what = (infos[i].name.as_str(), along);
            let mut step = pairs[t].step * SECOND_STEP;
            let mut look = |run: &mut Self, family: Family| {
                let seed = Family::Differences.seed(family.seed(run.options.seed));
                let pair = run.pair(
                    &lines[t],
                    step,
                    seed ^ ((t as u64) << 40),
                    SECOND_LOOK * repeats,
                );
                step *= THIRD_STEP;
                pair
            };
            let Some(second) = look(self, Family::SecondLooks)? else {
                return Ok((None, limit));
            };
            let mut pair = second.beside(&pairs[t]);
            let mut again = self.compare(what, &lines[t], gradients[t], &pair, scales[i], limit)?;
            if again.verdict == Verdict::Wrong {
                let Some(third) = look(self, Family::ThirdLooks)? else {
                    return Ok((None, limit));
                };
                pair = pair.beside(&third);
                again = self.compare(what, &lines[t], gradients[t], &pair, scales[i], limit)?;
            }
            if again.verdict != Verdict::Wrong || again.z * out[t].z < 0.0 {
                again.verdict = Verdict::CannotTell;
            }
            out[t] = again;
        }
        Ok((Some(out), limit))
    }

    /// The derivative of every test, from so many seeds. `None` if cancelled.
    fn gradients(
        &mut self,
        tests: &[(usize, Along)],
        lines: &[Line],
        seed: u64,
        repeats: u64,
    ) -> Result<Option<Vec<Estimate>>, RenderError> {
        let theta = Theta::constant(self.values);
        let spp = u64::from(self.settings.spp);
        let mut found_along = vec![Vec::new(); tests.len()];
        for k in 0..repeats {
            let seed = mix64(seed.wrapping_add(k));
            let job = Job::new(self.scene, self.settings, seed, 0..spp, self.progress);
            let found = self
                .mixture
                .backward_f32(&job, &theta, self.names, self.adjoint)?;
            if found.cancelled || self.progress.cancelled() {
                return Ok(None);
            }
            self.non_finite += found.non_finite.count;
            for ((along, &(i, _)), line) in found_along.iter_mut().zip(tests).zip(lines) {
                along.push(line.dot(&found.values[i]));
            }
        }
        Ok(Some(found_along.iter().map(|f| Estimate::of(f)).collect()))
    }

    /// By [`widest_step`]. `None` if cancelled.
    fn step(&mut self, line: &Line, test: u64) -> Result<Option<f64>, RenderError> {
        let repeats = u64::from(self.options.repeats);
        let seed = Family::DifferencePilots.seed(self.options.seed) ^ (test << 40);
        let Some(mut wide) = self.differences(line, line.most, seed, PILOTS)? else {
            return Ok(None);
        };
        widest_step(line.most, |step| {
            let Some(near) = self.differences(line, 0.5 * step, seed, PILOTS)? else {
                return Ok(None);
            };
            let pair = Pair::new(step, &wide, &near);
            wide = near;
            Ok(Some([pair.step_error, pair.expected(repeats)]))
        })
    }

    /// Differences of two steps, from so many seeds. `None` if cancelled.
    fn pair(
        &mut self,
        line: &Line,
        step: f64,
        seed: u64,
        repeats: u64,
    ) -> Result<Option<Pair>, RenderError> {
        let wide = self.differences(line, step, seed, repeats)?;
        let near = self.differences(line, 0.5 * step, seed, repeats)?;
        Ok(wide
            .zip(near)
            .map(|(wide, near)| Pair::new(step, &wide, &near)))
    }

    /// One difference per seed; the scene is where it was. `None` if cancelled.
    fn differences(
        &mut self,
        line: &Line,
        step: f64,
        seed: u64,
        repeats: u64,
    ) -> Result<Option<Vec<f64>>, RenderError> {
        let mut out = Vec::new();
        for k in 0..repeats {
            let seed = mix64(seed.wrapping_add(k));
            let mut sum = 0.0;
            for (at, weight) in line.stencil(step) {
                let Some(value) = self.value(line, at, seed)? else {
                    return Ok(None);
                };
                sum += weight * value;
            }
            out.push(sum);
        }
        if line.moves {
            self.scene.set_params(self.values)?;
        }
        Ok(Some(out))
    }

    /// `<adjoint, image>` at this place of the line. `None` if cancelled.
    fn value(&mut self, line: &Line, at: f64, seed: u64) -> Result<Option<f64>, RenderError> {
        let mut values = self.values_wide();
        for (v, d) in values[line.offset..].iter_mut().zip(&line.along) {
            *v += at * d;
        }
        if line.moves {
            let single: Vec<f32> = values.iter().map(|&v| v as f32).collect();
            self.scene.set_params(&single)?;
            values = single.into_iter().map(f64::from).collect();
        }
        Ok(self.objective(values, seed, |x| x))
    }

    fn values_wide(&self) -> Vec<f64> {
        self.values.iter().map(|&v| v.into()).collect()
    }

    /// The sum of what pixels add to the objective at these parameters, `of` each. `None` if cancelled.
    fn objective(&mut self, values: Vec<f64>, seed: u64, of: fn(f64) -> f64) -> Option<f64> {
        let theta = Theta::constant(&values);
        let spp = u64::from(self.settings.spp);
        let job = Job::new(self.scene, self.settings, seed, 0..spp, self.progress);
        let image = render_f64(&job, &theta, Estimator::Mis);
        if image.cancelled || self.progress.cancelled() {
            return None;
        }
        self.non_finite += image.non_finite.count;
        let products = image.sums[0].iter().zip(self.adjoint);
        let sum: f64 = products.map(|(x, &a)| of(x * f64::from(a))).sum();
        Some(sum / image.samples.max(1) as f64)
    }

    /// What the two say; `scale` is the size of the derivatives of the range.
    fn compare(
        &self,
        (name, along): (&str, Along),
        line: &Line,
        gradient: Estimate,
        pair: &Pair,
        scale: f64,
        limit: f64,
    ) -> Result<Comparison, RenderError> {
        let differences = pair.extrapolated;
        let size = gradient.mean.abs().max(differences.mean.abs());
        let step_error = pair.step_error.hypot(size * (line.rounding / pair.step));
        let noise = gradient.se.hypot(differences.se);
        // Terms that cancel leave what single precision loses of them.
        let lost = f64::from(f32::EPSILON) * self.size / line.most;
        let rounding = (ROUNDING * size.max(scale)).hypot(lost);
        let error = noise.hypot(step_error).hypot(rounding);
        if !error.is_finite() {
            return Err(RenderError::NonFiniteDerivative { name: name.into() });
        }
        let difference = gradient.mean - differences.mean;
        let z = if difference == 0.0 {
            0.0
        } else {
            difference / error
        };
        let resolution = if scale > 0.0 {
            limit * error / scale
        } else {
            f64::INFINITY
        };
        let verdict = if z.abs() > limit {
            Verdict::Wrong
        } else if resolution <= self.options.tolerance {
            Verdict::Right
        } else {
            Verdict::CannotTell
        };
        Ok(Comparison {
            along,
            gradient,
            differences,
            step: pair.step,
            step_error,
            z,
            resolution,
            verdict,
        })
    }
}

/// The root mean square of the derivatives of each range, by differences.
fn scales(ranges: usize, tests: &[(usize, Along)], pairs: &[Pair]) -> Vec<f64> {
    let scale = |i: usize| {
        let own = tests
            .iter()
            .zip(pairs)
            .filter(|((range, _), _)| *range == i);
        let squares: Vec<f64> = own.map(|(_, p)| p.extrapolated.mean.powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    (0..ranges).map(scale).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::ParamShape;

    /// Both differences are exact for parabolas.
    #[test]
    fn stencils_are_of_second_order() {
        for one_sided in [false, true] {
            let line = Line {
                offset: 0,
                along: vec![1.0],
                one_sided,
                most: 1.0,
                moves: false,
                rounding: 0.0,
            };
            let parabola = |x: f64| 2.0 - 3.0 * x + 5.0 * x * x;
            let stencil = line.stencil(0.25).into_iter();
            let slope: f64 = stencil.map(|(at, weight)| weight * parabola(at)).sum();
            assert!((slope + 3.0).abs() < 1e-12, "{slope}");
        }
    }

    /// What two looks differ by, beyond their noise, is an error of the step.
    #[test]
    fn a_second_look_doubts_steps_that_change_something() {
        let of = |mean: f64| {
            let spread = [mean - 0.1, mean + 0.1];
            Pair::new(1.0, &spread, &spread)
        };
        let noise = 2.0 * of(0.0).extrapolated.se.powi(2);
        assert_eq!(of(1.05).beside(&of(1.0)).step_error, 0.0);
        let found = of(2.0).beside(&of(1.0)).step_error;
        assert!((found - (1.0 - noise).sqrt()).abs() < 1e-12, "{found}");
    }

    /// What extrapolation changes is a third of what halving the step does: x + h^2 becomes x.
    #[test]
    fn extrapolation_removes_the_square_of_the_step() {
        let of = |h: f64| [1.0, 3.0].map(|x| x + h * h);
        let pair = Pair::new(1.0, &of(1.0), &of(0.5));
        assert_eq!(pair.extrapolated.mean, 2.0);
        assert_eq!(pair.step_error, 0.25);
        // Deviations of one: an error of one over two repeats, half of that over eight.
        assert_eq!(pair.extrapolated.se, 1.0);
        assert_eq!(pair.expected(8), 0.5);
    }

    /// Values at an end of their interval stay where others can move, and move inwards, one-sided, where none can.
    #[test]
    fn lines_stay_within_bounds() {
        let line = |values: &[f32], along: Along| {
            let mut params = Params::default();
            let shape = ParamShape::Texture {
                height: 1,
                width: values.len(),
                channels: 1,
            };
            params.push("x", shape, values, (0.0, 1.0));
            let info = &params.infos()[0];
            let span = Span {
                size: params.size(info),
                most: 0.0,
                rounding: 0.0,
            };
            Line::new(&params, info, along, &span)
        };
        let inner = line(&[0.0, 0.5, 1.0, 0.9], Along::Random(0));
        assert!(!inner.one_sided);
        assert_eq!([inner.along[0], inner.along[2]], [0.0; 2]);
        assert_eq!([inner.along[1].abs(), inner.along[3].abs()], [1.0; 2]);
        assert!(
            inner.most <= 0.1 + 1e-6 && inner.most > 0.09,
            "{}",
            inner.most
        );
        let ends = line(&[0.0, 1.0, 1.0, 0.0], Along::Random(0));
        assert!(ends.one_sided);
        assert_eq!(ends.along, [1.0, -1.0, -1.0, 1.0]);
        let one = line(&[0.5, 1.0, 0.5], Along::Value(1));
        assert_eq!(
            (one.one_sided, &one.along[..]),
            (true, &[0.0, -1.0, 0.0][..])
        );
        let zeros = line(&[0.0; 2], Along::Value(0));
        assert!(zeros.one_sided && zeros.most == LARGEST_STEP);
    }

    /// A scene that follows its parameters shows what theta shows, up to rounding.
    #[test]
    fn moved_scenes_are_those_of_moved_parameters() {
        let mut scene = crate::scene::room(4, 4).expect("a size");
        let names = ["sphere.alpha.value"];
        let settings = Settings {
            spp: 4,
            ..scene.settings
        };
        let mixture = Mixture::only(&scene, Estimator::Mis, &names);
        let info = scene.params().find(names[0]).expect("a roughness").clone();
        let values = scene.params().values().to_vec();
        let span = Span::of(&scene, &info);
        let mut line = Line::new(scene.params(), &info, Along::Value(0), &span);
        let adjoint = vec![1.0; 48];
        let options = Options::default();
        let mut run = Run {
            scene: &mut scene,
            names: &names,
            mixture: &mixture,
            adjoint: &adjoint,
            settings: &settings,
            values: &values,
            options: &options,
            progress: &(),
            non_finite: 0,
            size: 0.0,
        };
        let mut at = |moves: bool, t: f64| {
            line.moves = moves;
            run.value(&line, t, 7)
                .expect("a valid roughness")
                .expect("nobody stops it")
        };
        // A power of two, which single precision adds exactly to 0.2 but for its last bits.
        let step = 0.03125;
        let (still, moved) = (at(false, step), at(true, step));
        assert!(
            (still - moved).abs() < 1e-4 * still.abs(),
            "{still} {moved}"
        );
        assert!((still - at(false, 0.0)).abs() > 1e-3 * still.abs());
    }
}
