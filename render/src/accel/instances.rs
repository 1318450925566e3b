//! Sets of primitives that are placed in the world many times, and there once.
//!
//! The upper of two levels: a binary hierarchy over the boxes of all instances. A ray that enters one goes to where it
//! does so, is carried into the space of the primitives, and through their own structure, the lower level. As it starts
//! at the box, the numbers there are no larger than the primitives', however far it came.
//!
//! One ray at a time: packets follow their rays one after the other, so that hits are the same bits.

use std::collections::HashSet;
use std::sync::Arc;

use obvhs::aabb::Aabb;
use obvhs::bvh2::node::Bvh2Node;
use smallvec::SmallVec;

use super::bvh::{MIN_COMPONENT, SLACK};
use super::cluster::{children, hierarchy};
use super::ray_packet::{PACKET_SIZE, RayPacket};
use super::{Accel, Best, Hit, Ray, Tag};
use crate::math::{NOWHERE, Transform, each};

/// Farther than by the rounding of its distance, so that the offer decides between equal ones.
const REACH: f32 = 1.0 + 8.0 * f32::EPSILON;

/// Primitives somewhere in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    /// In a space of their own, each on a surface of its own.
    pub accel: Arc<Accel>,
    /// From the world to there.
    pub to_local: Transform,
    /// Corners of a box around them, world space.
    pub bounds: [[f32; 3]; 2],
    /// Their first index in the world, which is that of its surface, too.
    pub first: u32,
    /// How many they are.
    pub count: u32,
}

/// All instances.
#[derive(Clone, Debug)]
pub(super) struct Instances {
    all: Vec<Instance>,
    nodes: Vec<Bvh2Node>,
    /// Instances in the order of the leaves.
    order: Vec<u32>,
    /// Largest coordinates.
    reach: f32,
}

/// A ray in the space of an instance.
struct Local {
    ray: Ray,
    /// Where it starts on the ray in the world.
    start: f32,
    /// Its distances over those in the world.
    scale: f32,
}

impl Instance {
    /// Those of these primitives that a ray leaves or goes to.
    #[inline(always)]
    fn own(&self, surface: u32) -> u32 {
        let local = surface.wrapping_sub(self.first);
        if local < self.count { local } else { NOWHERE }
    }

    /// `None` where it is out of reach.
    #[inline]
    fn enter(&self, ray: &Ray, start: f32) -> Option<Local> {
        let along = |k: usize| f64::from(ray.o[k]) + f64::from(ray.d[k]) * f64::from(start);
        let single = |v: [f64; 3]| each(v, |x| x as f32);
        let o = single(self.to_local.point([along(0), along(1), along(2)]));
        let d = single(self.to_local.vector(each(ray.d, f64::from)));
        let skip = ray.skip.map(|surface| self.own(surface));
        let (ray, scale) = match Ray::new(o, d, skip) {
            Some(ray) => (ray, 1.0),
            None => Ray::rescaled(o, d, skip)?,
        };
        Some(Local { ray, start, scale })
    }
}

impl Local {
    /// A distance of the world.
    #[inline(always)]
    fn limit(&self, t: f32) -> f32 {
        super::capped((t - self.start) * self.scale)
    }
}

/// A ray against boxes.
struct Slabs {
    inverse: [f32; 3],
    /// Where the lower of the near planes would be met, and the upper of the far ones, if all were at zero.
    base: [[f32; 2]; 3],
}

impl Slabs {
    #[inline(always)]
    fn new(ray: &Ray, reach: f32) -> Self {
        let o = ray.o;
        let far = 3.0 * reach + o[0].abs() + o[1].abs() + o[2].abs();
        let inverse = each(ray.d, |x| 1.0 / x.abs().max(MIN_COMPONENT).copysign(x));
        let base = |k: usize| {
            let slack = inverse[k].abs() * (SLACK * far);
            let base = -o[k] * inverse[k];
            [base - slack, base + slack]
        };
        Self {
            base: [base(0), base(1), base(2)],
            inverse,
        }
    }

    /// Where the ray enters, if it does so before `limit`.
    #[inline(always)]
    fn near(&self, bounds: &Aabb, limit: f32) -> Option<f32> {
        let (low, high) = (bounds.min.to_array(), bounds.max.to_array());
        let (mut near, mut far) = (0.0f32, limit);
        for k in 0..3 {
            let (first, last) = if self.inverse[k] < 0.0 {
                (high[k], low[k])
            } else {
                (low[k], high[k])
            };
            near = near.max(first * self.inverse[k] + self.base[k][0]);
            far = far.min(last * self.inverse[k] + self.base[k][1]);
        }
        (near <= far).then_some(near)
    }
}

impl Instances {
    /// `None` if there are none.
    pub fn new(all: Vec<Instance>) -> Option<Self> {
        if all.is_empty() {
            return None;
        }
        let boxes: Vec<Aabb> = (all.iter())
            .map(|i| Aabb::new(i.bounds[0].into(), i.bounds[1].into()))
            .collect();
        let numbers = all.iter().flat_map(|i| i.bounds.as_flattened());
        let reach = numbers.fold(0.0, |m: f32, x| m.max(x.abs()));
        let tree = hierarchy(&boxes);
        Some(Self {
            nodes: tree.nodes,
            order: tree.primitive_indices,
            all,
            reach,
        })
    }

    /// Calls `f` with instances whose boxes the ray enters, roughly from the nearest on, and where it does so, as long as
    /// it says how far to look.
    #[inline(always)]
    fn visit(&self, ray: &Ray, limit: f32, mut f: impl FnMut(&Instance, f32) -> Option<f32>) {
        let slabs = Slabs::new(ray, self.reach);
        let nodes = &self.nodes;
        let mut limit = limit;
        let mut open = SmallVec::<[(f32, usize); 64]>::new();
        open.extend(slabs.near(nodes[0].aabb(), limit).map(|near| (near, 0)));
        while let Some((near, at)) = open.pop() {
            if near > limit {
                continue;
            }
            let node = &nodes[at];
            if node.is_leaf() {
                let first = node.first_index as usize;
                let found = &self.order[first..][..node.prim_count as usize];
                for &i in found {
                    match f(&self.all[i as usize], near) {
                        Some(reach) => limit = reach,
                        None => return,
                    }
                }
                continue;
            }
            let entered =
                children(node).map(|child| (slabs.near(nodes[child].aabb(), limit), child));
            match entered {
                [(Some(a), left), (Some(b), right)] if a < b => {
                    open.extend([(b, right), (a, left)]);
                }
                _ => open.extend((entered.into_iter()).filter_map(|(near, i)| Some((near?, i)))),
            }
        }
    }

    /// Offers the nearest hit.
    #[inline(never)]
    pub fn intersect(&self, ray: &Ray, best: &mut Best) {
        self.visit(ray, best.t, |instance, start| {
            if let Some(local) = instance.enter(ray, start) {
                let mut found = Best::new(local.limit(best.t * REACH));
                instance.accel.search(&local.ray, &mut found);
                if found.found {
                    let id = (instance.first << 2) + found.id;
                    // Surfaces that the ray leaves were left out below.
                    let tag = Tag {
                        id,
                        surface: id >> 2,
                    };
                    let t = start + found.t / local.scale;
                    best.offer(t, found.u, found.v, tag, NOWHERE);
                }
            }
            Some(best.t)
        });
    }

    /// Whether anything is hit before `t_max`.
    #[inline(never)]
    pub fn occluded(&self, ray: &Ray, t_max: f32) -> bool {
        let mut blocked = false;
        self.visit(ray, t_max, |instance, start| {
            if let Some(local) = instance.enter(ray, start) {
                blocked = instance.accel.blocks(&local.ray, local.limit(t_max));
            }
            (!blocked).then_some(t_max)
        });
        blocked
    }

    /// Offers the nearest hits to the rays of a packet.
    #[inline(never)]
    pub fn intersect_packet(&self, packet: &RayPacket, hits: &mut [Option<Hit>; PACKET_SIZE]) {
        for (i, hit) in hits.iter_mut().enumerate().take(packet.len()) {
            let (o, d, t_max, [from, _]) = packet.ray(i);
            let Some(ray) = Ray::new(o, d, [from, NOWHERE]) else {
                continue;
            };
            let mut best = match *hit {
                // Its coordinates are those of the triangle as it was given.
                Some(Hit { t, u, v, prim }) => Best {
                    t,
                    u,
                    v,
                    id: prim << 2,
                    found: true,
                },
                None => Best::new(super::capped(t_max)),
            };
            self.intersect(&ray, &mut best);
            *hit = best.hit();
        }
    }

    /// Adds the rays of a packet that are blocked to those that are.
    #[inline(never)]
    pub fn occluded_packet(&self, packet: &RayPacket, mut blocked: u32) -> u32 {
        for i in 0..packet.len() {
            let (o, d, t_max, skip) = packet.ray(i);
            if blocked >> i & 1 == 0
                && let Some(ray) = Ray::new(o, d, skip)
            {
                blocked |= u32::from(self.occluded(&ray, super::capped(t_max))) << i;
            }
        }
        blocked
    }

    pub fn memory_bytes(&self) -> usize {
        let mut counted = HashSet::new();
        let groups = self
            .all
            .iter()
            .filter(|i| counted.insert(Arc::as_ptr(&i.accel)));
        groups.map(|i| i.accel.memory_bytes()).sum::<usize>()
            + self.all.capacity() * size_of::<Instance>()
            + size_of_val(&self.nodes[..])
            + size_of_val(&self.order[..])
    }
}
