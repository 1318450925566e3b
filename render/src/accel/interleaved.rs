//! Packets of rays through the hierarchy.
//!
//! Paths of one pixel stay close for a vertex or two: their rays visit the same nodes, which are then tested with a
//! lane per ray. Where only a few rays of a packet are left, these go on alone, but in turns: what each visits next is
//! fetched before the first of them needs it, because most of the time of such a ray is waiting for memory.

use super::bvh::{Child, Kind, MIN_COMPONENT, NODE_WIDTH, Node, SLACK, Search, Slabs, Tree};
use super::curved::Line;
use super::ray_packet::{PACKET_SIZE, RayPacket};
use super::triangle_block::RayLanes;
use super::{Best, Hit, Ray};
use crate::math::each;
use smallvec::SmallVec;
use std::cell::Cell;
use wide::f32x16;

/// Up to this number of rays are faster one by one (decision 0031).
const FEW: u32 = 6;

/// A child that some rays of a packet still have to visit.
struct Visit {
    node: Child,
    /// One bit per ray.
    rays: u32,
    /// Where each ray enters it.
    near: f32x16,
}

/// A packet prepared for node tests.
struct Interleaved<'a> {
    packet: &'a RayPacket,
    lanes: RayLanes<f32x16>,
    inverse: [f32x16; 3],
    /// Where planes at zero are met.
    base: [f32x16; 3],
    /// Widening of every box.
    slack: f32,
}

impl<'a> Interleaved<'a> {
    #[inline(always)]
    fn new(packet: &'a RayPacket, tree: &Tree) -> Self {
        let (o, d) = packet.lanes();
        let mut from = o;
        let mut reach = f32x16::splat(0.0);
        for (o, (center, half)) in from.iter_mut().zip(tree.center.iter().zip(tree.half)) {
            *o -= f32x16::splat(*center);
            reach += o.abs() + f32x16::splat(half);
        }
        let reach = reach.to_array()[..packet.len()]
            .iter()
            .fold(0.0, |m: f32, x| m.max(*x));
        let inverse = each(d, |d| {
            let mut d = d.to_array();
            for x in &mut d {
                *x = 1.0 / x.abs().max(MIN_COMPONENT).copysign(*x);
            }
            f32x16::from(d)
        });
        let base = |k: usize| -from[k] * inverse[k];
        Self {
            packet,
            lanes: RayLanes::of(o, d),
            inverse,
            base: [base(0), base(1), base(2)],
            slack: SLACK * reach,
        }
    }

    /// Which of `rays` enter child `k` before their `limit`, and where.
    #[inline(always)]
    fn test(&self, node: &Node, k: usize, rays: u32, limit: f32x16) -> (u32, f32x16) {
        let mut near = f32x16::splat(0.0);
        let mut far = limit;
        for axis in 0..3 {
            let [lower, upper] = &node.planes[axis];
            let plane = |x: f32| f32x16::splat(x).mul_add(self.inverse[axis], self.base[axis]);
            let (a, b) = (plane(lower[k] - self.slack), plane(upper[k] + self.slack));
            near = near.fast_max(a.fast_min(b));
            far = far.fast_min(a.fast_max(b));
        }
        (near.simd_le(far).to_bitmask() & rays, near)
    }

    #[inline(always)]
    fn ray(&self, lane: usize) -> Option<Ray> {
        let (o, d, _, skip) = self.packet.ray(lane);
        Ray::new(o, d, skip)
    }
}

/// The lanes of a mask.
#[inline(always)]
fn lanes(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (lane < PACKET_SIZE).then_some(lane)
    })
}

/// A ray that goes on alone.
struct Single {
    lane: usize,
    ray: Ray,
    slabs: Slabs,
}

/// Per lane: what a ray that goes on alone has still to visit.
type Searches = [Search; PACKET_SIZE];

thread_local! {
    /// Those of the last packet: some kilobytes, which would take as long to make anew as a ray to follow.
    static SEARCHES: Cell<Option<Box<Searches>>> = const { Cell::new(None) };
}

/// Rays that go on alone, and all that each of them has still to visit.
struct Alone {
    rays: SmallVec<[Single; PACKET_SIZE]>,
    /// Per lane: whether it is among the rays.
    started: u32,
    /// Once there are any.
    searches: Option<Box<Searches>>,
}

impl Alone {
    #[inline(always)]
    fn new() -> Self {
        Self {
            rays: SmallVec::new(),
            started: 0,
            searches: None,
        }
    }

    /// A ray of a packet visits a child by itself, after those that it did not yet.
    #[inline(always)]
    fn visit(&mut self, tree: &Tree, packet: &Interleaved, lane: usize, near: f32, child: Child) {
        let searches = self.searches.get_or_insert_with(|| {
            let made = || Box::new([const { Search::NONE }; PACKET_SIZE]);
            SEARCHES.take().unwrap_or_else(made)
        });
        let search = &mut searches[lane % PACKET_SIZE];
        if self.started >> lane & 1 == 0 {
            self.started |= 1 << lane;
            search.clear();
            if let Some(ray) = packet.ray(lane) {
                let slabs = Slabs::new(tree, &ray);
                self.rays.push(Single { lane, ray, slabs });
            }
        }
        search.push(near, child);
    }

    /// Follows the rays step by step, in turns. `step` visits a ray's child, if there is one yet, and tells its next.
    #[inline(always)]
    fn in_turns(
        &mut self,
        tree: &Tree,
        mut step: impl FnMut(&Single, &mut Search, Option<Child>) -> Option<Child>,
    ) {
        let Some(mut searches) = self.searches.take() else {
            return;
        };
        // Those that are still on their way, and what they visit next.
        let mut left = [(0, None); PACKET_SIZE];
        let mut count = 0;
        for (k, single) in self.rays.iter().enumerate() {
            let search = &mut searches[single.lane % PACKET_SIZE];
            search.reverse();
            if let Some(child) = step(single, search, None) {
                left[count % PACKET_SIZE] = (k, Some(child));
                count += 1;
            }
        }
        while count > 0 {
            for (_, child) in &left[..count.min(PACKET_SIZE)] {
                child.iter().for_each(|&child| tree.fetch(child));
            }
            let before = std::mem::take(&mut count);
            for at in 0..before.min(PACKET_SIZE) {
                let (k, child) = left[at];
                let single = &self.rays[k];
                let search = &mut searches[single.lane % PACKET_SIZE];
                let next = step(single, search, child);
                left[count % PACKET_SIZE] = (k, next);
                count += usize::from(next.is_some());
            }
        }
        SEARCHES.set(Some(searches));
    }
}

/// The nearest hits so far.
struct Nearest {
    t: f32x16,
    best: [Best; PACKET_SIZE],
}

impl Tree {
    /// The nearest hit of every ray, or `None` if one of them needs special care.
    #[inline(never)]
    pub(super) fn intersect_packet(
        &self,
        packet: &RayPacket,
        hits: &mut [Option<Hit>; PACKET_SIZE],
    ) -> Option<()> {
        let start = packet.limits()?;
        let mut nearest = Nearest {
            t: f32x16::from(start),
            best: [Best::new(0.0); PACKET_SIZE],
        };
        for (best, t) in nearest.best.iter_mut().zip(&start) {
            *best = Best::new(*t);
        }
        let rays_in_flight = Interleaved::new(packet, self);
        let mut alone = Alone::new();
        self.descend(
            &rays_in_flight,
            &mut nearest,
            &mut alone,
            |nearest| (nearest.t, u32::MAX),
            |nearest, leaf, rays| self.offer_lanes(&rays_in_flight, leaf, rays, nearest),
        );
        let mut best = nearest.best;
        alone.in_turns(self, |single, search, child| {
            let best = &mut best[single.lane % PACKET_SIZE];
            if let Some(child) = child {
                match child.kind() {
                    Kind::Inner(index) => {
                        search.enter(&single.slabs, &self.nodes[index], best.t);
                    }
                    _ => {
                        let lanes = RayLanes::new(&single.ray);
                        self.offer(child, &single.ray, &lanes, best);
                    }
                }
            }
            search.next(best.t)
        });
        for (hit, best) in hits.iter_mut().zip(&best).take(packet.len()) {
            *hit = best.hit();
        }
        Some(())
    }

    /// One bit per ray that hits anything, or `None` if a ray needs special care.
    #[inline(never)]
    pub(super) fn occluded_packet(&self, packet: &RayPacket) -> Option<u32> {
        let limits = packet.limits()?;
        let t_max = f32x16::from(limits);
        let rays_in_flight = Interleaved::new(packet, self);
        let mut occluded = 0;
        let mut alone = Alone::new();
        self.descend(
            &rays_in_flight,
            &mut occluded,
            &mut alone,
            |occluded| (t_max, !*occluded),
            |occluded, leaf, rays| match leaf.kind() {
                Kind::Curved(k) => {
                    for lane in lanes(rays) {
                        let (curved, tag) = &self.curved[k];
                        let hit = rays_in_flight.ray(lane).is_some_and(|r| {
                            !r.skips(tag.surface) && curved.occluded(&Line::of(&r), limits[lane])
                        });
                        *occluded |= u32::from(hit) << lane;
                    }
                }
                Kind::Block(index, count) => {
                    for k in 0..count {
                        let one = self.blocks[index].splat::<f32x16>(k);
                        let (hit, ..) = one.test(&rays_in_flight.lanes, t_max);
                        let hit = hit.to_bitmask() & rays & !*occluded;
                        let surface = self.tags[index][k].surface;
                        for lane in lanes(hit) {
                            let (.., skip) = rays_in_flight.packet.ray(lane);
                            *occluded |= u32::from(!skip.contains(&surface)) << lane;
                        }
                    }
                }
                Kind::Inner(_) | Kind::Nothing => {}
            },
        );
        alone.in_turns(self, |single, search, child| {
            let limit = limits[single.lane % PACKET_SIZE];
            if let Some(child) = child {
                match child.kind() {
                    Kind::Inner(index) => {
                        search.enter_all(&single.slabs, &self.nodes[index], limit);
                    }
                    _ => {
                        let lanes = RayLanes::new(&single.ray);
                        let blocked = self.blocks(child, &single.ray, &lanes, limit);
                        occluded |= u32::from(blocked) << single.lane;
                    }
                }
            }
            let looking = occluded >> single.lane & 1 == 0;
            search.next(limit).filter(|_| looking)
        });
        Some(occluded)
    }

    /// Offers the primitives of a leaf to some rays.
    #[inline(always)]
    fn offer_lanes(
        &self,
        rays_in_flight: &Interleaved,
        leaf: Child,
        rays: u32,
        nearest: &mut Nearest,
    ) {
        match leaf.kind() {
            Kind::Curved(k) => {
                let (curved, tag) = &self.curved[k];
                let mut t = nearest.t.to_array();
                for lane in lanes(rays) {
                    let best = &mut nearest.best[lane];
                    if let Some(ray) = rays_in_flight.ray(lane)
                        && let Some((t, u, v)) = curved.intersect(&Line::of(&ray), best.t)
                    {
                        best.offer(t, u, v, *tag, ray.skip[0]);
                    }
                    t[lane] = best.t;
                }
                nearest.t = f32x16::from(t);
            }
            Kind::Block(_, count) if (rays.count_ones() as usize) < count => {
                let mut t = nearest.t.to_array();
                for lane in lanes(rays) {
                    if let Some(ray) = rays_in_flight.ray(lane) {
                        let best = &mut nearest.best[lane];
                        self.offer(leaf, &ray, &RayLanes::new(&ray), best);
                        t[lane] = best.t;
                    }
                }
                nearest.t = f32x16::from(t);
            }
            Kind::Block(index, count) => {
                for k in 0..count {
                    // One rounding more, so that equal distances pass; the offer decides.
                    let reach = nearest.t * f32x16::splat(1.0 + f32::EPSILON);
                    let one = self.blocks[index].splat::<f32x16>(k);
                    let (hit, t, u, v) = one.test(&rays_in_flight.lanes, reach);
                    let hit = hit.to_bitmask() & rays;
                    if hit == 0 {
                        continue;
                    }
                    let (t, u, v) = (t.to_array(), u.to_array(), v.to_array());
                    for lane in lanes(hit) {
                        let (.., [from, _]) = rays_in_flight.packet.ray(lane);
                        let tag = self.tags[index][k];
                        nearest.best[lane].offer(t[lane], u[lane], v[lane], tag, from);
                    }
                    let mut t = [0.0; PACKET_SIZE];
                    for (t, best) in t.iter_mut().zip(&nearest.best) {
                        *t = best.t;
                    }
                    nearest.t = f32x16::from(t);
                }
            }
            Kind::Inner(_) | Kind::Nothing => {}
        }
    }

    /// Visits the nodes that rays of a packet enter, roughly front to back; rays that are left with a part of the tree
    /// go to `alone`. `limit` tells the distances up to which the rays look and which of them still do, `leaf` tests a
    /// leaf for some rays.
    #[inline(always)]
    fn descend<T>(
        &self,
        rays_in_flight: &Interleaved,
        state: &mut T,
        alone: &mut Alone,
        limit: impl Fn(&T) -> (f32x16, u32),
        mut leaf: impl FnMut(&mut T, Child, u32),
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut open = SmallVec::<[Visit; 32]>::new();
        open.push(Visit {
            node: Child::ROOT,
            rays: (1 << rays_in_flight.packet.len()) - 1,
            near: f32x16::splat(0.0),
        });
        while let Some(visit) = open.pop() {
            let (far, looking) = limit(state);
            let rays = visit.rays & looking & visit.near.simd_le(far).to_bitmask();
            let Kind::Inner(index) = visit.node.kind() else {
                if rays != 0 {
                    leaf(state, visit.node, rays);
                }
                continue;
            };
            if rays.count_ones() <= FEW {
                let near = visit.near.to_array();
                for lane in lanes(rays) {
                    alone.visit(self, rays_in_flight, lane, near[lane], visit.node);
                }
                continue;
            }
            let node = &self.nodes[index];
            // In the order in which the first ray of each enters them, the nearest last.
            let mut entered = [(0, f32x16::splat(0.0)); NODE_WIDTH];
            let mut order = [(0.0, 0); NODE_WIDTH];
            let mut n = 0;
            for (k, &child) in node.children.iter().enumerate() {
                if child.is_nothing() {
                    break;
                }
                entered[k] = rays_in_flight.test(node, k, rays, far);
                let (rays, near) = &entered[k];
                if *rays != 0 {
                    let distance = near.to_array()[rays.trailing_zeros() as usize % PACKET_SIZE];
                    let mut at = n;
                    while at > 0 && order[at - 1].0 < distance {
                        order[at] = order[at - 1];
                        at -= 1;
                    }
                    order[at] = (distance, k);
                    n += 1;
                }
            }
            for &(_, k) in &order[..n] {
                let (rays, near) = entered[k];
                open.push(Visit {
                    node: node.children[k],
                    rays,
                    near,
                });
            }
        }
    }
}
