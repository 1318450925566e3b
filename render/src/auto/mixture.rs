//! What was chosen, and how it is carried out.

use super::pilot::{Blocks, Finding, Findings};
use super::shares;
use crate::error::RenderError;
use crate::instances::{Direction, Estimator};
use crate::integrator::Job;
use crate::integrator::gradient::Gradient;
use crate::integrator::render::{NonFinite, Rendering};
use crate::manifold::Statistics;
use crate::params::Theta;
use crate::scene::Scene;

/// Estimators, and how work and pixels are shared among them; see [`crate::auto`].
///
/// That of one estimator is this estimator:
///
/// ```
/// use render::Job;
/// use render::auto::Mixture;
/// use render::instances::Estimator;
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let theta = Theta::constant(room.params().values());
/// let (names, e) = (["sphere.alpha.value"], Estimator::DifferentialMis);
/// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let mixture = Mixture::only(&room, e, &names);
/// let found = mixture.backward_f32(&job, &theta, &names, &adjoint)?; // a slice per name
/// let alone = e.backward_f32(&job, &theta, &e.active(&room, &names)?, &adjoint)?;
/// assert_eq!(found.values, alone.values);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Mixture {
    pub(super) clusters: Vec<Cluster>,
    pub(super) findings: Vec<Finding>,
    pub(super) spent: f64,
    blocks: Blocks,
}

/// Parameters that share passes.
#[derive(Clone, Debug)]
pub(super) struct Cluster {
    pub params: Vec<String>,
    pub members: Vec<Member>,
}

/// An estimator of a cluster.
#[derive(Clone, Debug)]
pub(super) struct Member {
    pub estimator: Estimator,
    /// Share of all work.
    pub share: f64,
    /// Work of a sample, in those of `mis`.
    cost: f64,
    /// Variance of the work of one sample of `mis`, in each block, up to a common factor.
    variance: Vec<f64>,
}

/// A member's samples and pixel weights in one call.
struct MemberPass<'a> {
    member: &'a Member,
    samples: u64,
    /// Per block.
    weights: Vec<f64>,
}

/// Groups that share passes, with what that costs.
struct Plan {
    groups: Vec<usize>,
    /// With the work of a sample, the mean over the groups.
    estimators: Vec<(Estimator, f64)>,
    variance: Vec<Vec<f64>>,
    shares: Vec<f64>,
    /// Variance per unit of work, each group in units of its best single estimator.
    total: f64,
}

impl Plan {
    /// The best mixture for these groups together; `None` if they have no estimator in common.
    fn of(findings: &[Finding], groups: Vec<usize>) -> Option<Self> {
        let (&first, rest) = groups.split_first()?;
        let mut estimators = Vec::new();
        let mut variance = Vec::new();
        for (i, (e, _)) in findings[first].efficiency.iter().enumerate() {
            let mut sum = findings[first].variance[i].clone();
            let mut cost = findings[first].costs[i];
            let everywhere = rest.iter().all(|&g| {
                let other = &findings[g];
                let Some(k) = other.efficiency.iter().position(|(o, _)| o == e) else {
                    return false;
                };
                sum.iter_mut()
                    .zip(&other.variance[k])
                    .for_each(|(s, v)| *s += v);
                cost += other.costs[k];
                true
            });
            if everywhere {
                estimators.push((*e, cost / (rest.len() + 1) as f64));
                variance.push(sum);
            }
        }
        if estimators.is_empty() {
            return None;
        }
        let (shares, total) = shares::best(&variance);
        Some(Self {
            groups,
            estimators,
            variance,
            shares,
            total,
        })
    }

    /// Work is best shared in proportion to the roots of the totals; the sum is then their square.
    fn root(&self) -> f64 {
        self.total.sqrt()
    }
}

impl Mixture {
    /// One estimator for everything: samples are samples, whatever they cost.
    pub fn only<N: AsRef<str>>(scene: &Scene, estimator: Estimator, names: &[N]) -> Self {
        let blocks = Blocks::of(scene);
        let member = Member {
            estimator,
            share: 1.0,
            cost: 1.0,
            variance: vec![1.0; blocks.len()],
        };
        let cluster = Cluster {
            params: names.iter().map(|n| n.as_ref().to_owned()).collect(),
            members: vec![member],
        };
        Self {
            clusters: vec![cluster],
            findings: Vec::new(),
            spent: 0.0,
            blocks,
        }
    }

    /// Starts from passes for each group of parameters, and lets those share passes that gain by it.
    pub(super) fn of(scene: &Scene, found: Findings) -> Self {
        let findings = found.groups;
        let mut plans: Vec<Plan> = (0..findings.len())
            .filter_map(|g| Plan::of(&findings, vec![g]))
            .collect();
        loop {
            let mut best: Option<(f64, usize, usize, Plan)> = None;
            for i in 0..plans.len() {
                for j in i + 1..plans.len() {
                    let groups = [&plans[i].groups[..], &plans[j].groups].concat();
                    let Some(both) = Plan::of(&findings, groups) else {
                        continue;
                    };
                    let gain = plans[i].root() + plans[j].root() - both.root();
                    if gain > best.as_ref().map_or(0.0, |b| b.0) {
                        best = Some((gain, i, j, both));
                    }
                }
            }
            let Some((_, i, j, both)) = best else { break };
            plans.remove(j);
            plans[i] = both;
        }
        let sum: f64 = plans.iter().map(Plan::root).sum();
        let clusters = plans.into_iter().map(|plan| {
            let part = plan.root() / sum;
            let all = plan.estimators.iter().zip(plan.variance).zip(&plan.shares);
            let members = all.filter(|(_, share)| **share > 0.0);
            let member = |((e, variance), share): ((&(Estimator, f64), Vec<f64>), &f64)| Member {
                estimator: e.0,
                share: share * part,
                cost: e.1,
                variance,
            };
            let names = plan.groups.iter().flat_map(|&g| findings[g].params.clone());
            Cluster {
                params: names.collect(),
                members: members.map(member).collect(),
            }
        });
        Self {
            clusters: clusters.collect(),
            findings,
            spent: found.spent,
            blocks: Blocks::of(scene),
        }
    }

    /// What the pilots saw, per group of parameters; nothing for [`Mixture::only`].
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// What the pilots cost, in samples of [`Estimator::Mis`] per pixel in the mode that they were for.
    pub fn spent(&self) -> f64 {
        self.spent
    }

    /// The estimators in use, with their share of the work.
    pub fn shares(&self) -> Vec<(Estimator, f64)> {
        let members = self.clusters.iter().flat_map(|c| &c.members);
        members.map(|m| (m.estimator, m.share)).collect()
    }

    /// The part of all work that a parameter gets; parameters that share passes have it in common.
    pub fn share(&self, name: &str) -> f64 {
        self.cluster(name)
            .map_or(0.0, |c| c.members.iter().map(|m| m.share).sum())
    }

    /// Per estimator: the weight of each pixel when `samples` samples are spent on one parameter alone.
    pub fn weights(&self, name: &str, samples: u64) -> Vec<(Estimator, Vec<f64>)> {
        let Some(cluster) = self.cluster(name) else {
            return Vec::new();
        };
        let of = |pass: MemberPass| {
            let pixels = 0..self.blocks.pixels();
            let weight = |i| pass.weights[self.blocks.index(i)];
            (pass.member.estimator, pixels.map(weight).collect())
        };
        let passes = self.pass(cluster, samples, self.alone(cluster));
        passes.into_iter().map(of).collect()
    }

    /// How many samples of each estimator that is.
    pub fn samples(&self, name: &str, samples: u64) -> Vec<(Estimator, u64)> {
        let passes = (self.cluster(name)).map(|c| self.pass(c, samples, self.alone(c)));
        let of = |p: &MemberPass| (p.member.estimator, p.samples);
        passes.iter().flatten().map(of).collect()
    }

    fn cluster(&self, name: &str) -> Option<&Cluster> {
        let mine = |c: &&Cluster| c.params.iter().any(|p| p == name);
        self.clusters.iter().find(mine)
    }

    /// What the shares of a cluster are parts of if nothing else is asked for; one with all the work keeps
    /// them as they are.
    fn alone(&self, cluster: &Cluster) -> f64 {
        match &self.clusters[..] {
            [_] => 1.0,
            _ => cluster.members.iter().map(|m| m.share).sum(),
        }
    }

    /// Passes over the image that [`Mixture::backward_f32`] makes, with their numbers of samples.
    pub fn passes(&self, samples: u64) -> Vec<(Estimator, u64)> {
        let of = |p: MemberPass| (p.member.estimator, p.samples);
        let passes = self
            .clusters
            .iter()
            .flat_map(|c| self.pass(c, samples, 1.0));
        passes.map(of).collect()
    }

    /// Whole numbers of samples, and the best weights for these.
    fn pass<'a>(&self, cluster: &'a Cluster, samples: u64, all: f64) -> Vec<MemberPass<'a>> {
        let wanted = |m: &Member| m.share / all * samples as f64 / m.cost;
        let mut passes: Vec<MemberPass> = cluster
            .members
            .iter()
            .map(|member| MemberPass {
                member,
                samples: wanted(member).round() as u64,
                weights: Vec::new(),
            })
            .collect();
        if let Some(most) = passes.iter_mut().max_by(|a, b| {
            let (a, b) = (wanted(a.member), wanted(b.member));
            a.total_cmp(&b)
        }) {
            most.samples = most.samples.max(1);
        }
        passes.retain(|p| p.samples > 0);
        // Variance of the mean of the samples.
        let precision =
            |p: &MemberPass, b: usize| p.samples as f64 * p.member.cost / p.member.variance[b];
        let sums: Vec<f64> = (0..self.blocks.len())
            .map(|b| passes.iter().map(|p| precision(p, b)).sum())
            .collect();
        for p in &mut passes {
            p.weights = sums
                .iter()
                .enumerate()
                .map(|(b, s)| precision(p, b) / s)
                .collect();
        }
        passes
    }

    /// The gradient of `<adjoint, image>` with the work of `samples` samples of [`Estimator::Mis`] per pixel
    /// (with [`Mixture::only`]: with as many samples), in single precision. One slice per parameter, in the order
    /// that they were given in.
    ///
    /// # Errors
    /// An adjoint image of the wrong size; an estimator that is wrong in this scene.
    pub fn backward_f32<N: AsRef<str>>(
        &self,
        job: &Job,
        theta: &Theta<f32>,
        names: &[N],
        adjoint: &[f32],
    ) -> Result<Gradient, RenderError> {
        let mut out = Gradient {
            values: vec![Vec::new(); names.len()],
            non_finite: NonFinite::default(),
            noise: None,
            connections: Statistics::default(),
            glints: Statistics::default(),
            cancelled: false,
        };
        let mut stream = 0;
        for cluster in &self.clusters {
            let places: Vec<usize> = (0..names.len())
                .filter(|&i| cluster.params.iter().any(|p| p == names[i].as_ref()))
                .collect();
            if places.is_empty() {
                continue;
            }
            let asked: Vec<&str> = places.iter().map(|&i| names[i].as_ref()).collect();
            for pass in self.pass(cluster, job.count(), 1.0) {
                let e = pass.member.estimator;
                let active = e.active(job.scene, &asked)?;
                let own = part_of(job, stream, pass.samples);
                stream += 1;
                let weighted = self.weighted(adjoint, &pass.weights);
                let part = e.backward_f32(&own, theta, &active, &weighted)?;
                out.cancelled |= part.cancelled;
                out.non_finite.merge(&part.non_finite);
                out.connections.merge(&part.connections);
                out.glints.merge(&part.glints);
                for (&i, values) in places.iter().zip(part.values) {
                    if out.values[i].is_empty() {
                        out.values[i] = values
                    } else {
                        out.values[i]
                            .iter_mut()
                            .zip(values)
                            .for_each(|(a, b)| *a += b)
                    }
                }
            }
        }
        Ok(out)
    }

    fn weighted(&self, adjoint: &[f32], weights: &[f64]) -> Vec<f32> {
        let all = adjoint.iter().enumerate();
        all.map(|(i, &a)| (f64::from(a) * weights[self.blocks.index(i / 3)]) as f32)
            .collect()
    }

    /// The image and its derivative in one parameter, as [`Estimator::forward_f32`], with the work of as many samples
    /// as the job has of [`Estimator::Mis`] per pixel on that parameter alone. The sums are means: one sample.
    ///
    /// # Errors
    /// An unknown name, or an estimator that is wrong in this scene or for this parameter.
    pub fn forward_f32(&self, job: &Job, name: &str) -> Result<Rendering, RenderError> {
        let params = job.scene.params();
        let direction = [Direction::uniform(params, name)?];
        let mut out: Option<Rendering> = None;
        let Some(cluster) = self.cluster(name) else {
            return Err(RenderError::unknown_parameter(
                name,
                self.clusters.iter().flat_map(|c| &c.params),
            ));
        };
        let all = self.alone(cluster);
        let values = params.values();
        for (stream, pass) in self.pass(cluster, job.count(), all).iter().enumerate() {
            let own = part_of(job, stream as u64, pass.samples);
            let mut part = (pass.member.estimator).forward_f32(&own, values, &direction)?;
            let scale = 1.0 / part.samples.max(1) as f64;
            for image in &mut part.sums {
                for (i, x) in image.iter_mut().enumerate() {
                    *x *= scale * pass.weights[self.blocks.index(i / 3)];
                }
            }
            part.samples = 1;
            match &mut out {
                None => out = Some(part),
                Some(sum) => {
                    sum.merge(&part);
                    sum.samples = 1;
                }
            }
        }
        out.ok_or(RenderError::Count {
            what: "estimators of a mixture",
            expected: "at least one",
            found: 0,
        })
    }
}

/// A pass of a mixture. The first one keeps the seed that was asked for.
fn part_of<'a>(job: &Job<'a>, stream: u64, samples: u64) -> Job<'a> {
    Job {
        seed: job.seed.wrapping_add(stream << 48),
        samples: 0..samples,
        ..job.clone()
    }
}
