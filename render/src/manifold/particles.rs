//! Particles from the lights over casters to receivers: what landings are made of.

use smallvec::SmallVec;

use super::connector::Connector;
use super::landing::{FEWEST, Landing, Landings};
use super::normal::facet;
use crate::emitter::Emitter;
use crate::math::Ray;
use crate::parallel;
use crate::sampler::{Family, Independent, Sampler};
use crate::shape::Shape;

/// Particles are traced in this many jobs, whatever the number of threads.
const JOBS: usize = 64;
/// This part of starts goes to all casters alike, whether or not light was seen to reach them.
const PART_ALIKE: f64 = 0.5;

impl Connector<'_> {
    /// Traces so many particles, and remembers where they landed: a function of the seed. They are aimed at casters.
    pub fn learn(&mut self, seed: u64, particles: usize) {
        let per_job = particles.div_ceil(JOBS);
        let this = &*self;
        let parts = parallel::map(JOBS, |job| {
            let numbers = job * per_job..(job * per_job + per_job).min(particles);
            let particle = |i: usize| {
                let mut rng = Independent::new(Family::Landings.seed(seed), i as u64, 0);
                this.particle(&mut rng)
            };
            numbers.filter_map(particle).collect::<Vec<_>>()
        });
        let all = parts.concat();
        if all.len() >= FEWEST {
            self.reach = self.reach_of(&all);
            self.landings = Landings::new(all);
        }
    }

    /// How often starts go to each caster or one before it: half of them as particles left it for a receiver, the others to all alike,
    /// so that no solution is out of reach.
    fn reach_of(&self, landings: &[Landing]) -> Vec<f64> {
        let casters = &self.split.caster_list;
        let mut left = vec![0u32; self.space.scene.shapes().len()];
        for landing in landings {
            left[landing.like[0].0 as usize] += 1;
        }
        let alike = PART_ALIKE / casters.len() as f64;
        let each = (1.0 - PART_ALIKE) / landings.len() as f64;
        let mut sum = 0.0;
        let part = |&caster: &u32| {
            sum += alike + each * f64::from(left[caster as usize]);
            sum
        };
        casters.iter().map(part).collect()
    }

    /// A particle from a light over casters to a receiver, if it gets there.
    fn particle(&self, rng: &mut Independent) -> Option<Landing> {
        let (space, split) = (&self.space, self.split);
        let e = &space.scene.emitters()[self.any_emitter(rng) as usize];
        let caster = self.any_caster(rng) as usize;
        let caster_shape = &space.scene.shapes()[caster];
        let ([a, b], [c, d]) = (rng.next_2d::<f64>(), rng.next_2d::<f64>());
        let around = self.around[caster];
        let sent = e.sample_ray(&space.theta, space.scene.lights(), around, [a, b, c, d])?;
        let ray = if e.is_infinite() {
            // From beside the caster, whatever is before that.
            sent.ray
        } else {
            let si = sent.surface.map(|(_, si)| si);
            let o = si.map_or(sent.ray.o, |si| si.p);
            let d = caster_shape.sample(o, rng.next_2d::<f64>())?.d;
            e.leaves(d, si.as_ref())?;
            si.map_or(Ray::new(o, d), |si| si.spawn_ray(d, sent.exit))
        };
        let (mut from, mut d) = (ray.o, ray.d);
        let (mut hit, mut met) = space.meet(&ray)?;
        let mut like = SmallVec::new();
        // From this end what may happen is not known; what was not asked for is told at the end.
        let may = [!self.split.is_published(), true];
        while split.is_caster(met) {
            if like.len() as u32 == split.bounces() {
                return None;
            }
            let normal = facet(space, met, rng.next_2d());
            let (here, kind) = self.event(from, d, &hit, normal, (rng.next_1d(), may));
            like.push((met, kind));
            from = here.si.p;
            (d, hit, met) = space.onward(&here, -d, kind)?;
        }
        if like.is_empty() || !split.is_receiver(met) {
            return None;
        }
        like.reverse();
        if !self.takes(like.iter().copied()) {
            return None;
        }
        Some(Landing {
            at: (from + d * f64::from(hit.t)).to_array(),
            through: from,
            like,
        })
    }
}
