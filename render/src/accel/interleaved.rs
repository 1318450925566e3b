//! Packets of rays through the hierarchy.
//!
//! Paths of one pixel stay close for a vertex or two: their rays visit the same nodes, which are then tested with a
//! lane per ray. Where only a few rays of a packet are left, these go on alone, but in turns: what each visits next is
//! fetched before the first of them needs it, because most of the time of such a ray is waiting for memory.

use super::bvh::{MIN_COMPONENT, SLACK, Search, Slabs, Tree};
use super::curved::Line;
use super::node::{Child, Kind, NODE_WIDTH, Node};
use super::ray_packet::{PACKET_SIZE, RayPacket};
use super::triangle_block::RayLanes;
use super::{Best, Hit, Ray};
use crate::math::each;
use smallvec::SmallVec;
use std::cell::Cell;
use wide::{f32x8, f32x16};

/// Up to this number of rays are faster one by one (decision 0031).
const FEW: u32 = 6;

/// Vectors that a number of each ray of a packet is.
const VECTORS: usize = if cfg!(target_feature = "avx512f") {
    1
} else {
    2
};

/// A child that some rays of a packet still have to visit.
#[derive(Clone, Copy)]
struct Visit {
    node: Child,
    /// One bit per ray.
    rays: u32,
    /// Where each ray enters it.
    near: f32x16,
}

/// Which visit it is, and where those of the same node end. All behind these are over by then.
#[derive(Clone, Copy)]
struct Turn {
    visit: u32,
    end: u32,
}

/// What a packet has still to visit. Visits stay where they are written, since one is as large as a packet; turns are put in
/// order in their place.
#[derive(Default)]
struct Open {
    /// With room for the children of a node behind `end`.
    visits: Vec<Visit>,
    end: usize,
    /// With room behind the `count` that there are; what comes next is last. Where visits have no order, the last one is
    /// next, and there are none of these.
    turns: Vec<Turn>,
    count: usize,
}

thread_local! {
    /// What the last packet had to visit: long enough for most, and not made anew for each.
    static OPEN: Cell<Open> = const { Cell::new(Open::NOTHING) };
}

impl Open {
    const NOTHING: Self = Self {
        visits: Vec::new(),
        end: 0,
        turns: Vec::new(),
        count: 0,
    };

    /// The root, for all of these rays.
    #[inline(always)]
    fn new(rays: u32) -> Self {
        let mut open = OPEN.take();
        (open.end, open.count) = (0, 0);
        let (visits, turns) = open.room();
        visits[0] = Visit {
            node: Child::ROOT,
            rays,
            near: f32x16::splat(0.0),
        };
        turns[0] = Turn { visit: 0, end: 1 };
        (open.end, open.count) = (1, 1);
        open
    }

    #[inline(always)]
    fn pop<const ORDERED: bool>(&mut self) -> Option<Visit> {
        if !ORDERED {
            self.end = self.end.checked_sub(1)?;
            return self.visits.get(self.end).copied();
        }
        self.count = self.count.checked_sub(1)?;
        let turn = self.turns.get(self.count)?;
        self.end = turn.end as usize;
        self.visits.get(turn.visit as usize).copied()
    }

    /// Room for the children of a node, behind those that there are.
    #[inline(always)]
    fn room(&mut self) -> (&mut [Visit], &mut [Turn]) {
        let (end, count) = (self.end + NODE_WIDTH, self.count + NODE_WIDTH);
        if self.visits.len() < end || self.turns.len() < count {
            self.grow();
        }
        let visits = &mut self.visits[self.end..end];
        (visits, &mut self.turns[self.count..count])
    }

    #[cold]
    #[inline(never)]
    fn grow(&mut self) {
        let nothing = Visit {
            node: Child::ROOT,
            rays: 0,
            near: f32x16::splat(0.0),
        };
        self.visits.resize(2 * self.end + 64, nothing);
        (self.turns).resize(2 * self.count + 64, Turn { visit: 0, end: 0 });
    }

    /// Keeps the memory for the next packet.
    #[inline(always)]
    fn close(self) {
        OPEN.set(self);
    }
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
    /// What rays that go on alone take along, lane by lane: `inverse`, and `base` less and more what that widening is along
    /// them.
    alone: [[[f32; PACKET_SIZE]; 3]; 3],
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
        let slack = SLACK * reach;
        let axis = |k: usize| {
            let base = -from[k] * inverse[k];
            let along = inverse[k].abs() * f32x16::splat(slack);
            [base, base - along, base + along]
        };
        let [x, y, z] = [axis(0), axis(1), axis(2)];
        let of = |k: usize| [x[k].to_array(), y[k].to_array(), z[k].to_array()];
        Self {
            packet,
            lanes: RayLanes::of(o, d),
            inverse,
            base: [x[0], y[0], z[0]],
            slack,
            alone: [each(inverse, f32x16::to_array), of(1), of(2)],
        }
    }

    /// Those of a ray that goes on alone.
    #[inline(always)]
    fn slabs(&self, lane: usize) -> Slabs {
        let lane = lane % PACKET_SIZE;
        let [inverse, low, high] = &self.alone;
        let base = |k: usize| [low[k][lane], high[k][lane]];
        Slabs::of(
            [inverse[0][lane], inverse[1][lane], inverse[2][lane]],
            [base(0), base(1), base(2)],
        )
    }

    /// The planes of a node's children, moved outwards.
    #[inline(always)]
    fn widened(&self, node: &Node) -> [[[f32; NODE_WIDTH]; 2]; 3] {
        let slack = f32x8::splat(self.slack);
        each(node.planes, |[lower, upper]: [[f32; NODE_WIDTH]; 2]| {
            let (lower, upper) = (f32x8::from(lower) - slack, f32x8::from(upper) + slack);
            [lower.to_array(), upper.to_array()]
        })
    }

    /// Which rays enter child `k` before their `limit`, and where.
    #[inline(always)]
    fn test(&self, planes: &[[[f32; NODE_WIDTH]; 2]; 3], k: usize, limit: f32x16) -> (u32, f32x16) {
        let mut near = f32x16::splat(0.0);
        let mut far = limit;
        for (axis, [lower, upper]) in planes.iter().enumerate() {
            let plane = |x: f32| f32x16::splat(x).mul_add(self.inverse[axis], self.base[axis]);
            let (a, b) = (plane(lower[k]), plane(upper[k]));
            near = near.fast_max(a.fast_min(b));
            far = far.fast_min(a.fast_max(b));
        }
        (near.simd_le(far).to_bitmask(), near)
    }

    /// Adds the children that some of `rays` enter before their `limit`: the nearest comes next, by where the first ray of each
    /// enters it, if `ORDERED`. Which there are is hardly ever the same twice: nothing branches on it.
    #[inline(always)]
    // Iterators over several arrays are no vector instructions.
    #[allow(clippy::needless_range_loop)]
    fn enter<const ORDERED: bool>(&self, node: &Node, rays: u32, limit: f32x16, open: &mut Open) {
        let planes = self.widened(node);
        let first = open.end;
        let (visits, turns) = open.room();
        let mut count = 0;
        // Distances are not negative, so that their bits are in their order, but for the sign of zero; the lowest ones make all
        // different. What is not entered comes behind all else.
        let mut keys: [i32; NODE_WIDTH] = [-8, -7, -6, -5, -4, -3, -2, -1];
        for k in 0..NODE_WIDTH {
            let (entered, near) = self.test(&planes, k, limit);
            let child = node.children[k];
            let rays = if child.is_nothing() {
                0
            } else {
                entered & rays
            };
            visits[count % NODE_WIDTH] = Visit {
                node: child,
                rays,
                near,
            };
            if ORDERED {
                let distance = near.to_array()[rays.trailing_zeros() as usize % PACKET_SIZE];
                let key = (distance.to_bits() & 0x7fff_fff8) as i32 | k as i32;
                keys[count % NODE_WIDTH] = if rays != 0 { key } else { count as i32 - 8 };
            }
            count += usize::from(rays != 0);
        }
        let end = (first + count) as u32;
        if ORDERED {
            let mut places = [0_u32; NODE_WIDTH];
            for key in keys {
                for k in 0..NODE_WIDTH {
                    places[k] += u32::from(key > keys[k]);
                }
            }
            for k in 0..NODE_WIDTH {
                turns[places[k] as usize % NODE_WIDTH] = Turn {
                    visit: (first + k) as u32,
                    end,
                };
            }
            open.count += count;
        }
        open.end = first + count;
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
    fn visit(&mut self, packet: &Interleaved, lane: usize, near: f32, child: Child) {
        let searches = self.searches.get_or_insert_with(|| {
            let made = || Box::new([const { Search::NONE }; PACKET_SIZE]);
            SEARCHES.take().unwrap_or_else(made)
        });
        let search = &mut searches[lane % PACKET_SIZE];
        if self.started >> lane & 1 == 0 {
            self.started |= 1 << lane;
            search.clear();
            if let Some(ray) = packet.ray(lane) {
                let slabs = packet.slabs(lane);
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
        let rays = &self.rays[..];
        for (k, single) in rays.iter().enumerate() {
            let search = &mut searches[single.lane % PACKET_SIZE];
            search.reverse();
            if let Some(child) = step(single, search, None) {
                tree.fetch(child);
                left[count % PACKET_SIZE] = (k, Some(child));
                count += 1;
            }
        }
        while count > 0 {
            let before = std::mem::take(&mut count);
            for at in 0..before.min(PACKET_SIZE) {
                let (k, child) = left[at];
                let single = &rays[k];
                let search = &mut searches[single.lane % PACKET_SIZE];
                let next = step(single, search, child);
                // Near before it is the ray's turn again.
                next.iter().for_each(|&child| tree.fetch(child));
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
        self.descend::<_, true>(
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
        self.descend::<_, false>(
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
            Kind::Block(_, count) if (rays.count_ones() as usize) < VECTORS * count => {
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

    /// Visits the nodes that rays of a packet enter, roughly front to back if `ORDERED`; rays that are left with a part of
    /// the tree go to `alone`. `limit` tells the distances up to which the rays look and which of them still do, `leaf`
    /// tests a leaf for some rays.
    #[inline(always)]
    fn descend<T, const ORDERED: bool>(
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
        let mut open = Open::new((1 << rays_in_flight.packet.len()) - 1);
        while let Some(visit) = open.pop::<ORDERED>() {
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
                    alone.visit(rays_in_flight, lane, near[lane], visit.node);
                }
                continue;
            }
            let node = &self.nodes[index];
            rays_in_flight.enter::<ORDERED>(node, rays, far, &mut open);
        }
        open.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Primitive;

    /// Children are in the order in which they are entered, wherever they are in the node; one that is entered at a zero
    /// that is negative is among them.
    #[test]
    fn packets_enter_children_from_the_nearest_on() {
        let unit = Primitive::Sphere {
            center: [0.0; 3],
            radius: 1.0,
        };
        let items = super::super::prepare(&[unit], &[0], &[]).expect("a primitive");
        let tree = Tree::new(&items, &[]).expect("a tree");
        let mut packet = RayPacket::default();
        packet.fill(PACKET_SIZE, |_| ([0.0; 3], [-1.0, 0.0, 0.0], 9.0, [7; 2]));
        let mut rays = Interleaved::new(&packet, &tree);
        rays.slack = 0.0;
        rays.inverse = [f32x16::splat(-1.0); 3];
        rays.base = [f32x16::splat(-0.0); 3];
        for turn in 0..NODE_WIDTH {
            let mut node = tree.nodes[0].clone();
            let place = |k: usize| (3 * k + turn) % NODE_WIDTH;
            for k in 0..NODE_WIDTH {
                node.planes = each([0, 1, 2], |axis: usize| {
                    let [mut lower, mut upper] = node.planes[axis];
                    // Where the last one begins, all rays have ended.
                    let from = if place(k) == NODE_WIDTH - 1 {
                        10.0
                    } else {
                        place(k) as f32
                    };
                    (upper[k], lower[k]) = (if place(k) == 0 { 0.0 } else { -from }, -12.0);
                    [lower, upper]
                });
                node.children[k] = tree.nodes[0].children[0];
            }
            let limit = f32x16::splat(9.0);
            let near = |visit: Visit| visit.near.to_array()[0];
            let mut open = Open::new(0);
            assert!(open.pop::<true>().is_some());
            rays.enter::<true>(&node, u32::MAX >> 16, limit, &mut open);
            let found: Vec<f32> = std::iter::from_fn(|| open.pop::<true>().map(near)).collect();
            assert_eq!(found, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "{turn}");
            let mut open = Open::new(0);
            assert!(open.pop::<false>().is_some());
            rays.enter::<false>(&node, u32::MAX >> 16, limit, &mut open);
            let mut all: Vec<f32> = std::iter::from_fn(|| open.pop::<false>().map(near)).collect();
            all.sort_by(f32::total_cmp);
            assert_eq!(all, found);
        }
    }
}
