//! Pilots: short runs of the candidates in forward mode, in pairs whose differences are the variance.

use super::costs::PATHS;
use crate::error::RenderError;
use crate::instances::{Direction, Estimator, Mode};
use crate::integrator::Job;
use crate::integrator::gradient::Active;
use crate::integrator::render::{Progress, TILE};
use crate::params::{ParamInfo, ParamShape, Params};
use crate::sampler::{Family, Independent, Points, Sampler};
use crate::scene::{Scene, Settings};

/// Largest part of the budget that pilots cost.
pub const PILOTS: f64 = 0.03;
/// Part of that which counting what samples cost may take, and fewest paths of each candidate that it is worth
/// starting with.
const COUNTING: f64 = 0.1;
const FEWEST_PATHS: u64 = 8;
/// More pairs than this tell little more.
const MOST_PAIRS: u64 = 16;
/// Variance that fewer samples than this carry, effectively, says little about that of the next ones.
const EVIDENCE: f64 = 64.0;
/// No candidate is given up before this many pairs, if the budget allows.
const FEWEST_PAIRS: u64 = 4;
/// A candidate this many times worse than the best for all parameters is not tried again.
const HOPELESS: f64 = 4.0;
/// The differential pair is preferred to `mis-balance`, as long as nothing else is known, if it costs this many times as
/// much or less.
const AFFORDABLE: f64 = 1.4;
/// Squares of derivatives further apart than this many standard errors disagree.
const DISAGREEMENT: f64 = 4.0;

/// What pilots found out about parameters that were measured together.
#[derive(Clone, Debug)]
pub struct Finding {
    /// Their names.
    pub params: Vec<String>,
    /// Pairs of samples per pixel for the best; 0 if the budget did not suffice for pilots.
    pub pairs: usize,
    /// `1 / (variance x work)` of the candidates as far as pilots can tell, over that of the best; zero where
    /// they cannot. The hopeless were measured less.
    pub efficiency: Vec<(Estimator, f64)>,
    /// Per candidate of `efficiency`: variance of a sample times its work in each block, in units of that of
    /// the best in all blocks.
    pub(super) variance: Vec<Vec<f64>>,
    /// Per candidate of `efficiency`: work of a sample, in those of [`Estimator::Mis`].
    pub(super) costs: Vec<f64>,
}

/// All findings, and what they cost.
pub(super) struct Findings {
    pub groups: Vec<Finding>,
    /// Samples of [`Estimator::Mis`] per pixel in passes to come.
    pub spent: f64,
}

/// An estimator, and the work of its samples in those of [`Estimator::Mis`] in passes to come: of a pilot, and of such a
/// pass.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Candidate {
    estimator: Estimator,
    pilot: f64,
    pass: f64,
}

/// Parameters measured together.
struct Group {
    params: Vec<ParamInfo>,
    candidates: Vec<Candidate>,
}

/// Everything a pilot needs.
pub(super) struct Pilots<'a> {
    scene: &'a Scene,
    adjoint: &'a [f32],
    settings: Settings,
    seed: u64,
    params: Vec<(ParamInfo, Vec<Candidate>)>,
    /// The candidates for all of these together.
    joint: Vec<Candidate>,
    /// Samples of [`Estimator::Mis`] per pixel that may be spent.
    budget: f64,
    /// What was spent on counting; `None` if not even that was worth it.
    counted: Option<f64>,
}

/// What one candidate gave for one group: of each pair, the blocks.
#[derive(Clone, Default)]
struct Trials {
    pairs: Vec<Vec<Block>>,
}

/// Sums over the pixels of a block, from two independent samples of each.
#[derive(Clone, Copy, Default, PartialEq)]
struct Block {
    /// Variance of a sample.
    noise: f64,
    /// The derivative.
    sum: f64,
    /// Square of the derivative: the product of both.
    signal: f64,
    /// Variance of `signal` as far as it comes from noise.
    spread: f64,
}

/// How many samples carry the variance: all if each has the same part of it, one if one has all [Kish 1965].
fn evidence<'a>(blocks: impl Iterator<Item = &'a Block>) -> f64 {
    let (noise, squares) = blocks.fold((0.0, 0.0), |(n, s), b| (n + b.noise, s + b.spread));
    if squares > 0.0 {
        noise * noise / squares
    } else {
        0.0
    }
}

impl Trials {
    fn evidence(&self) -> f64 {
        evidence(self.pairs.iter().flatten())
    }

    fn evidence_in(&self, block: usize) -> f64 {
        evidence(self.pairs.iter().map(|p| &p[block]))
    }
}

/// The candidates that see a parameter: without those that are right for what moves in a limit only, where there are others,
/// since a sum of estimators has the biases of all of them.
///
/// # Errors
/// No candidate sees it, with the reason of the last one, or there are no candidates.
pub fn able(
    scene: &Scene,
    info: &ParamInfo,
    candidates: &[Estimator],
) -> Result<Vec<Estimator>, RenderError> {
    let mut able = Vec::new();
    let mut limited = Vec::new();
    let mut refused = Err(RenderError::Count {
        what: "candidates",
        expected: "at least one",
        found: 0,
    });
    for &e in candidates {
        match e.check(scene).and_then(|()| e.check_parameter(info)) {
            Ok(()) if info.kind.is_motion() && e.capabilities().in_the_limit => limited.push(e),
            Ok(()) => able.push(e),
            reason => refused = reason,
        }
    }
    if able.is_empty() {
        able = limited;
    }
    if able.is_empty() {
        refused?;
    }
    Ok(able)
}

impl<'a> Pilots<'a> {
    pub fn new<N: AsRef<str>>(
        job: &Job<'a>,
        names: &[N],
        adjoint: &'a [f32],
        candidates: &[Estimator],
        mode: Mode,
        budget: f64,
    ) -> Result<Self, RenderError> {
        let &Job {
            scene,
            settings,
            seed,
            progress,
            ..
        } = job;
        // Pairs of samples must know nothing of each other.
        let settings = Settings {
            points: Points::Independent,
            ..*settings
        };
        let mut infos: Vec<(&ParamInfo, Vec<Estimator>)> = Vec::new();
        for name in names {
            let info = scene.params().find(name.as_ref())?;
            if infos.iter().all(|(p, _)| p.name != info.name) {
                infos.push((info, able(scene, info, candidates)?));
            }
        }
        let pixels = scene.film.pixels().max(1) as f64;
        let counts = ((candidates.len() + 1) * (infos.len() + 2)) as f64;
        let paths = ((COUNTING * budget * pixels / counts) as u64).min(PATHS);
        let measured = paths >= FEWEST_PATHS;
        // Of the candidates, and of the unit.
        let works = |infos: &[&ParamInfo], mode| {
            if measured {
                let active = Active::of(scene, infos);
                let job = Job::new(scene, &settings, seed, 0..paths, progress);
                let work = |e: &Estimator| e.work(&job, &active, mode);
                let works = candidates.iter().map(work).collect();
                (works, work(&Estimator::Mis))
            } else {
                (vec![1.0; candidates.len()], 1.0)
            }
        };
        let together: Vec<&ParamInfo> = infos.iter().map(|(info, _)| *info).collect();
        // In forward mode each parameter has passes of its own.
        let reverse = (mode == Mode::Reverse).then(|| works(&together, Mode::Reverse));
        let known = |infos: &[&ParamInfo]| {
            let forward = works(infos, Mode::Forward);
            let (passes, unit) = reverse.as_ref().unwrap_or(&forward);
            let candidate = |(k, &estimator): (usize, &Estimator)| Candidate {
                estimator,
                pilot: forward.0[k] / unit,
                pass: passes[k] / unit,
            };
            let all = candidates.iter().enumerate().map(candidate);
            all.collect::<Vec<Candidate>>()
        };
        let params = infos.iter().map(|(info, able)| {
            let mut known = known(&[*info]);
            known.retain(|c| able.contains(&c.estimator));
            ((*info).clone(), known)
        });
        Ok(Self {
            scene,
            adjoint,
            params: params.collect(),
            joint: known(&together),
            settings,
            seed,
            budget,
            counted: measured.then_some(paths as f64 * counts / pixels),
        })
    }

    /// By themselves, by material or emitter, all together: the finest of which one pair fits.
    fn groups(&self, budget: f64) -> Option<Vec<Group>> {
        let owner = |info: &ParamInfo| info.name.split('.').next().unwrap_or("").to_owned();
        let keys: [&dyn Fn(&ParamInfo) -> String; 3] =
            [&|info| info.name.clone(), &owner, &|_| String::new()];
        keys.into_iter().find_map(|key| {
            let mut groups: Vec<(String, Group)> = Vec::new();
            for (info, able) in &self.params {
                let key = key(info);
                match groups.iter_mut().find(|(k, _)| *k == key) {
                    Some((_, group)) => {
                        group.params.push(info.clone());
                        let both = |a: &Candidate| able.iter().any(|b| b.estimator == a.estimator);
                        group.candidates.retain(both);
                        for c in &mut group.candidates {
                            let joint = self.joint.iter().find(|j| j.estimator == c.estimator);
                            *c = *joint.unwrap_or(c);
                        }
                    }
                    None => groups.push((
                        key,
                        Group {
                            params: vec![info.clone()],
                            candidates: able.clone(),
                        },
                    )),
                }
            }
            let mut groups: Vec<Group> = groups.into_iter().map(|(_, g)| g).collect();
            for g in &mut groups {
                if let Some(kept) = kept(&g.candidates) {
                    g.candidates.swap(0, kept);
                }
            }
            let work: f64 = groups.iter().map(|g| pair_cost(&g.candidates)).sum();
            let sound = groups.iter().all(|g| !g.candidates.is_empty());
            (sound && work <= budget).then_some(groups)
        })
    }

    /// Measures until the budget is spent or nothing is left to decide.
    pub fn run(&self, progress: &dyn Progress) -> Result<Findings, RenderError> {
        let Some(counted) = self.counted else {
            return Ok(self.unseen());
        };
        let budget = self.budget - counted;
        // What was counted is not complete then.
        if progress.cancelled() {
            return Ok(self.unseen());
        }
        let Some(groups) = self.groups(budget) else {
            return Ok(self.unseen());
        };
        let mut sums: Vec<Vec<Trials>> = groups
            .iter()
            .map(|g| vec![Trials::default(); g.candidates.len()])
            .collect();
        let mut alive: Vec<Vec<usize>> = groups
            .iter()
            .map(|g| (0..g.candidates.len()).collect())
            .collect();
        let once: f64 = groups.iter().map(|g| pair_cost(&g.candidates)).sum();
        let fair = ((budget / once) as u64).min(FEWEST_PAIRS);
        let mut spent = 0.0;
        for pair in 0..MOST_PAIRS {
            let work = |g: usize| -> f64 {
                let of = |&k: &usize| 2.0 * groups[g].candidates[k].pilot;
                alive[g].iter().map(of).sum()
            };
            let undecided = |g: &usize| pair == 0 || alive[*g].len() > 1;
            let open: Vec<usize> = (0..groups.len()).filter(undecided).collect();
            let next: f64 = open.iter().map(|&g| work(g)).sum();
            if open.is_empty() || spent + next > budget || progress.cancelled() {
                break;
            }
            spent += next;
            for g in open {
                let along = directions(self.scene.params(), &groups[g].params, self.seed, pair);
                for &k in &alive[g] {
                    let e = groups[g].candidates[k].estimator;
                    self.pair(e, &along, pair, &mut sums[g][k], progress)?;
                }
                if pair + 1 >= fair {
                    alive[g] = hopeful(&groups[g].candidates, &sums[g], &alive[g]);
                }
            }
        }
        if progress.cancelled() {
            return Ok(self.unseen());
        }
        let findings = groups.iter().zip(&sums);
        Ok(Findings {
            groups: findings.map(|(g, s)| finding(g, s)).collect(),
            spent: spent + counted,
        })
    }

    /// Without pilots: the first candidate of each parameter.
    fn unseen(&self) -> Findings {
        let even = vec![1.0; Blocks::of(self.scene).len()];
        let groups = self.params.iter().map(|(info, able)| Finding {
            params: vec![info.name.clone()],
            pairs: 0,
            efficiency: able.iter().take(1).map(|c| (c.estimator, 1.0)).collect(),
            variance: vec![even.clone()],
            costs: able.iter().take(1).map(|c| c.pass).collect(),
        });
        Findings {
            groups: groups.collect(),
            spent: self.counted.unwrap_or(0.0),
        }
    }

    fn pair(
        &self,
        e: Estimator,
        along: &[Direction],
        pair: u64,
        sums: &mut Trials,
        progress: &dyn Progress,
    ) -> Result<(), RenderError> {
        let values = self.scene.params().values();
        let sample = |i: u64| {
            let i = 2 * pair + i;
            let s = &self.settings;
            e.forward_f32(
                &Job::new(self.scene, s, self.seed, i..i + 1, progress),
                values,
                along,
            )
        };
        let (a, b) = (sample(0)?, sample(1)?);
        let blocks = Blocks::of(self.scene);
        let mut found = vec![Block::default(); blocks.len()];
        let values = a.sums[1].iter().zip(&b.sums[1]).zip(self.adjoint);
        for (i, ((a, b), &d)) in values.enumerate() {
            let [a, b] = [a, b].map(|x| f64::from(d) * x);
            let noise = noise([a, b]);
            let block = &mut found[blocks.index(i / 3)];
            block.noise += noise;
            block.sum += 0.5 * (a + b);
            block.signal += a * b;
            block.spread += noise * noise;
        }
        sums.pairs.push(found);
        Ok(())
    }
}

/// One number added to a scalar or a colour. Many values move by random signs: the variance of
/// that derivative is the sum of all variances on average [Hutchinson 1989]. Parameters that are measured
/// together move in proportion to their size.
pub(super) fn directions(
    all: &Params,
    params: &[ParamInfo],
    seed: u64,
    pair: u64,
) -> Vec<Direction> {
    let of = |info: &ParamInfo| {
        let handle = all.handle(info);
        if params.len() == 1 && matches!(info.shape, ParamShape::Scalar | ParamShape::Rgb) {
            return Direction::Uniform(handle);
        }
        let values = &all.values()[info.range()];
        let size = if params.len() > 1 {
            all.size(info) as f32
        } else {
            1.0
        };
        let seed = Family::Directions.seed(seed);
        let mut random = Independent::new(seed, u64::from(handle.id), pair);
        let signs = values.iter().map(|_| {
            if random.next_1d::<f64>() < 0.5 {
                size
            } else {
                -size
            }
        });
        Direction::Dense(handle, signs.collect())
    };
    params.iter().map(of).collect()
}

/// Variance of a sample, from two.
#[inline]
pub(super) fn noise([a, b]: [f64; 2]) -> f64 {
    0.5 * (a - b) * (a - b)
}

/// Who should be in the first place, and is kept where pilots cannot tell, if that is another one: instead of
/// `mis-balance` the differential pair, which suffers less from rare samples, where it costs hardly more.
fn kept(candidates: &[Candidate]) -> Option<usize> {
    let first = candidates.first()?;
    let affordable = |c: &Candidate| {
        c.estimator == Estimator::DifferentialMisBalance && c.pass <= AFFORDABLE * first.pass
    };
    let pair = candidates.iter().position(affordable);
    pair.filter(|_| first.estimator == Estimator::MisBalance)
}

/// Work of one pair of each.
fn pair_cost(candidates: &[Candidate]) -> f64 {
    candidates.iter().map(|c| 2.0 * c.pilot).sum()
}

/// Variance of one sample in each block, of each of `chosen`. One that saw less there than another one, in all
/// or pixel by pixel, has missed something, such as a small light that it finds less than once in as many
/// samples: what would make up for that counts as well. One that has seen nothing at all where others have is out.
fn variances(sums: &[Trials], chosen: &[usize]) -> Vec<Vec<f64>> {
    let blind = |k: usize| {
        sums[k]
            .pairs
            .iter()
            .flatten()
            .all(|b| *b == Block::default())
    };
    let all_blind = chosen.iter().all(|&k| blind(k));
    let of = |k: usize, b: usize| {
        let own = &sums[k].pairs;
        let missed = |&other: &usize| {
            let both = own.iter().zip(&sums[other].pairs);
            let n = both.len() as f64;
            let [mut apart, mut more, mut signal, mut spread] = [0.0; 4];
            for (a, o) in both {
                let (a, o) = (a[b], o[b]);
                let noise = 0.5 * (a.noise + o.noise);
                apart += (a.sum - o.sum).powi(2) - DISAGREEMENT.powi(2) * noise;
                more += o.sum * o.sum - a.sum * a.sum;
                signal += o.signal - a.signal;
                spread += a.spread + o.spread;
            }
            let in_all = if more > 0.0 { apart } else { 0.0 };
            let by_pixel = signal - DISAGREEMENT * spread.sqrt();
            2.0 * in_all.max(by_pixel * f64::from(TILE * TILE)) / n
        };
        let missed = chosen.iter().map(missed).fold(0.0, f64::max);
        let noise: f64 = own.iter().map(|pair| pair[b].noise).sum();
        noise / own.len() as f64 + missed
    };
    let blocks = sums[chosen[0]].pairs[0].len();
    let row = |&k: &usize| {
        if blind(k) && !all_blind {
            vec![f64::INFINITY; blocks]
        } else {
            (0..blocks).map(|b| of(k, b)).collect()
        }
    };
    chosen.iter().map(row).collect()
}

/// Variance times work of each of `chosen`, the first of which stands above the others unless it is blind: it is
/// believed to be as good, and they as bad, as the samples that carry the variance leave open; without
/// evidence they are out.
fn works(
    candidates: &[Candidate],
    sums: &[Trials],
    chosen: &[usize],
    blocks: &[Vec<f64>],
) -> Vec<f64> {
    let sees = |v: &[f64]| v.iter().all(|v| v.is_finite());
    let rivals = !sees(&blocks[0]) || sums[chosen[0]].evidence() >= EVIDENCE;
    let work = |(&k, v): (&usize, &Vec<f64>)| {
        let evidence = sums[k].evidence();
        let doubt = 1.0 + evidence.max(1.0).sqrt().recip();
        let work = v.iter().sum::<f64>() * candidates[k].pass;
        let trusted = rivals && (evidence >= EVIDENCE || !sees(&blocks[0]));
        if k == chosen[0] {
            work / doubt
        } else if trusted {
            work * doubt
        } else {
            f64::INFINITY
        }
    };
    chosen.iter().zip(blocks).map(work).collect()
}

/// Those of `alive` that may still be the best; the first always.
fn hopeful(candidates: &[Candidate], sums: &[Trials], alive: &[usize]) -> Vec<usize> {
    let variances = variances(sums, alive);
    let work = |(&k, v): (&usize, &Vec<f64>)| v.iter().sum::<f64>() * candidates[k].pass;
    let works: Vec<f64> = alive.iter().zip(&variances).map(work).collect();
    let least = works.iter().copied().fold(f64::INFINITY, f64::min);
    let kept = alive.iter().zip(&works);
    kept.filter(|(k, w)| **k == alive[0] || **w <= HOPELESS * least)
        .map(|(&k, _)| k)
        .collect()
}

/// Variances per block that can be trusted with weights: a block is believed as far as there is evidence, and
/// otherwise to be like the others.
fn finding(group: &Group, sums: &[Trials]) -> Finding {
    let all: Vec<usize> = (0..sums.len()).collect();
    let variances = variances(sums, &all);
    let works = works(&group.candidates, sums, &all, &variances);
    let finite = || works.iter().copied().filter(|w| w.is_finite());
    let most = finite().fold(0.0, f64::max);
    // Without any variance all are alike.
    let floor = if most > 0.0 { 1e-9 * most } else { 1.0 };
    let works: Vec<f64> = works.iter().map(|w| w.max(floor)).collect();
    let least = works.iter().copied().fold(f64::INFINITY, f64::min);
    let blocks = variances[0].len();
    let totals: Vec<f64> = variances.iter().map(|v| v.iter().sum()).collect();
    // Part of an estimator's variance.
    let part = |k: usize, b: usize| {
        if works[k].is_finite() && totals[k] > 0.0 {
            variances[k][b] / totals[k]
        } else {
            0.0
        }
    };
    let sighted = works.iter().filter(|w| w.is_finite()).count().max(1) as f64;
    // How much of the variance a block has, as far as the candidates agree.
    let like: Vec<f64> = (0..blocks)
        .map(|b| {
            let mean = all.iter().map(|&k| part(k, b)).sum::<f64>() / sighted;
            mean.max(1e-6 / blocks as f64)
        })
        .collect();
    let believed = |k: usize, b: usize| {
        let evidence = sums[k].evidence_in(b);
        let part = (evidence * part(k, b) + EVIDENCE * like[b]) / (evidence + EVIDENCE);
        part.max(1e-9 * like[b]) * works[k] / least
    };
    let measured = group.candidates.iter().zip(&works);
    Finding {
        params: group.params.iter().map(|p| p.name.clone()).collect(),
        pairs: sums.iter().map(|s| s.pairs.len()).max().unwrap_or(0),
        efficiency: measured.map(|(c, w)| (c.estimator, least / w)).collect(),
        variance: (all.iter())
            .map(|&k| (0..blocks).map(|b| believed(k, b)).collect())
            .collect(),
        costs: group.candidates.iter().map(|c| c.pass).collect(),
    }
}

/// Squares of pixels that share a weight.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blocks {
    width: usize,
    height: usize,
    columns: usize,
    rows: usize,
}

impl Blocks {
    pub fn of(scene: &Scene) -> Self {
        let [width, height] = scene.film.crop_size.map(|n| n as usize);
        let side = TILE as usize;
        Self {
            width,
            height,
            columns: width.div_ceil(side),
            rows: height.div_ceil(side),
        }
    }

    pub fn len(&self) -> usize {
        self.columns * self.rows
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// The block of a pixel.
    pub fn index(&self, pixel: usize) -> usize {
        let side = TILE as usize;
        pixel / self.width / side * self.columns + pixel % self.width / side
    }
}
