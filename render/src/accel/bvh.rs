//! Eight-wide hierarchy: built as a binary one (`cluster`), widened and traversed here.
//!
//! Its planes are single precision numbers, not compressed ones, which would have to be unpacked in every test of a
//! node. A leaf is a block of up to eight flat primitives, tested in the time of one, or a curved one. The slabs are
//! wider than the rounding of any primitive test, so that a hit never depends on the shape of the tree.

use super::cluster::hierarchy;
use super::curved::{Curved, Line};
use super::node::{Child, Kind, NODE_WIDTH, Node};
use super::triangle_block::{Flat, LANES, RayLanes};
use super::widen::{Binary, Subtree};
use super::{Best, Item, Ray, Shape, Tag};
use crate::math::each;
use crate::parallel;
use crate::prefetch::prefetch;
use obvhs::{Boundable, aabb::Aabb};
use wide::f32x8;

/// Widening of the slabs, relative to the farthest point of the scene; must exceed the seam of
/// the flat test.
pub(super) const SLACK: f32 = 32.0 * f32::EPSILON;

/// Smallest direction component in a slab test: keeps reciprocals finite.
pub(super) const MIN_COMPONENT: f32 = 1e-20;

#[derive(Clone, Debug)]
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    pub blocks: Vec<Flat<[f32; LANES]>>,
    /// The primitives of each block.
    pub tags: Vec<[Tag; LANES]>,
    pub curved: Vec<(Curved, Tag)>,
    pub center: [f32; 3],
    pub half: [f32; 3],
    /// See [`Tree::visits`], when the hierarchy was made.
    built: f64,
}

impl Boundable for Item {
    fn aabb(&self) -> Aabb {
        Aabb::new(self.bounds[0].into(), self.bounds[1].into())
    }
}

impl Tree {
    /// `None` if there are too many leaves.
    pub(super) fn new(items: &[Item], points: &[[f32; 4]]) -> Option<Tree> {
        let boxes = parallel::fill(items.len(), &|i| items[i].aabb());
        let binary = hierarchy(&boxes);
        let all = boxes.iter().fold(Aabb::empty(), |sum, b| sum.union(b));
        drop(boxes);
        let mut tree = Tree {
            nodes: Vec::new(),
            blocks: Vec::new(),
            tags: Vec::new(),
            curved: Vec::new(),
            center: [0.0; 3],
            half: [0.0; 3],
            built: 0.0,
        };
        if !items.is_empty() {
            tree.lie_within(all);
            tree.widen(&Binary::new(&binary, items), points)?;
            tree.built = tree.visits();
        }
        Some(tree)
    }

    fn lie_within(&mut self, all: Aabb) {
        let (low, high) = (all.min.to_array(), all.max.to_array());
        for k in 0..3 {
            self.center[k] = 0.5 * (low[k] + high[k]);
            self.half[k] = 0.5 * (high[k] - low[k]);
        }
    }

    /// How many boxes a ray through the whole visits on average: the areas of all boxes over that of the whole
    /// [Goldsmith and Salmon 1987]. Zero where that has none.
    fn visits(&self) -> f64 {
        let area = |[a, b, c]: [f64; 3]| a * b + b * c + c * a;
        let mut sum = 0.0;
        for node in &self.nodes {
            for k in (0..NODE_WIDTH).filter(|&k| !node.children[k].is_nothing()) {
                sum += area(each([0, 1, 2], |axis: usize| {
                    let [low, high] = node.planes[axis].map(|planes| f64::from(planes[k]));
                    // Of primitives that are degenerate by now there is no box.
                    (high - low).max(0.0)
                }));
            }
        }
        let visits = sum / area(each(self.half, |x| 2.0 * f64::from(x)));
        if visits.is_finite() { visits } else { 0.0 }
    }

    /// The same hierarchy around primitives that have moved: how many times as many boxes a ray visits as when it was
    /// made. `None` if there are primitives that it does not have, or curved ones that it does not need any more: then
    /// it is left as it was.
    pub(super) fn refit(&mut self, items: &[Item], points: &[[f32; 4]]) -> Option<f64> {
        // Where each primitive stands.
        let last = items.iter().map(|i| i.tag.prim() + 1).max();
        let mut found = vec![None; last.unwrap_or(0)];
        for item in items {
            found[item.tag.prim()] = Some(item);
        }
        let find = |tag: &Tag| found.get(tag.prim()).copied().flatten();
        let flat = self.tags.iter().flatten().filter_map(find);
        let flat = flat.filter(|i| !i.is_curved()).count();
        let mut curved = Vec::with_capacity(self.curved.len());
        for (_, tag) in &self.curved {
            match find(tag).and_then(|item| Some((item.shape(points)?, item.tag))) {
                Some((Shape::Curved(c), tag)) => curved.push((c, tag)),
                _ => return None,
            }
        }
        if flat + curved.len() != items.len() {
            return None;
        }
        self.curved = curved;
        for (block, tags) in self.blocks.iter_mut().zip(&mut self.tags) {
            *block = Flat::EMPTY.splat_array();
            for (k, tag) in tags.iter_mut().enumerate() {
                if let Some(item) = find(tag)
                    && let Some(Shape::Flat(flat)) = item.shape(points)
                {
                    block.set(k, &flat);
                    *tag = item.tag;
                }
            }
        }
        self.lie_within(
            items
                .iter()
                .fold(Aabb::empty(), |sum, i| sum.union(&i.aabb())),
        );
        // Children come after their parents.
        let mut around = vec![Aabb::empty(); self.nodes.len()];
        for at in (0..self.nodes.len()).rev() {
            for k in 0..NODE_WIDTH {
                let child = self.nodes[at].children[k];
                let tags: &[Tag] = match child.kind() {
                    Kind::Inner(_) => &[],
                    Kind::Block(index, _) => &self.tags[index],
                    Kind::Curved(index) => std::slice::from_ref(&self.curved[index].1),
                    Kind::Nothing => continue,
                };
                let mut bounds = match child.kind() {
                    Kind::Inner(index) => around[index],
                    _ => Aabb::empty(),
                };
                for item in tags.iter().filter_map(find) {
                    bounds = bounds.union(&item.aabb());
                }
                around[at] = around[at].union(&bounds);
                self.place(at, k, &bounds);
            }
        }
        let visits = self.visits();
        Some(if self.built > 0.0 {
            visits / self.built
        } else if visits > 0.0 {
            f64::INFINITY
        } else {
            1.0
        })
    }

    /// Writes the box of child `k` of a node.
    fn place(&mut self, at: usize, k: usize, bounds: &Aabb) {
        self.nodes[at].place(k, bounds, self.center);
    }

    /// Takes nodes of eight children made from nodes of two, and makes all leaves, whose blocks are most of the memory.
    fn widen(&mut self, binary: &Binary, points: &[[f32; 4]]) -> Option<()> {
        let Subtree {
            nodes,
            leaves,
            curved,
        } = Subtree::of(binary, self.center)?;
        self.nodes = nodes;
        let items = binary.items;
        let curved = curved.iter().map(|&i| &items[i as usize]);
        self.curved = curved
            .filter_map(|item| match item.shape(points) {
                Some(Shape::Curved(c)) => Some((c, item.tag)),
                _ => None,
            })
            .collect();
        let item = |i: u32| items.get(i as usize);
        self.blocks = parallel::fill(leaves.len(), &|leaf| {
            let mut block = Flat::EMPTY.splat_array();
            for (k, &i) in leaves[leaf].iter().enumerate() {
                if let Some(Shape::Flat(flat)) = item(i).and_then(|item| item.shape(points)) {
                    block.set(k, &flat);
                }
            }
            block
        });
        let tags = |leaf: &[u32; LANES]| leaf.map(|i| item(i).map_or(Tag::EMPTY, |item| item.tag));
        self.tags = leaves.iter().map(tags).collect();
        Some(())
    }

    /// A search from the first node on, if there is any.
    #[inline(always)]
    fn start(&self, ray: &Ray) -> (Slabs, Search) {
        let mut search = Search::NONE;
        if !self.nodes.is_empty() {
            search.push(0.0, Child::ROOT);
        }
        (Slabs::new(self, ray), search)
    }

    /// Offers what a leaf holds.
    #[inline(always)]
    pub(super) fn offer(&self, leaf: Child, ray: &Ray, lanes: &RayLanes<f32x8>, best: &mut Best) {
        match leaf.kind() {
            Kind::Block(k, _) => {
                self.blocks[k]
                    .load()
                    .offer(ray.skip[0], lanes, &self.tags[k], best)
            }
            Kind::Curved(k) => {
                let (curved, tag) = &self.curved[k];
                if let Some((t, u, v)) = curved.intersect(&Line::of(ray), best.t) {
                    best.offer(t, u, v, *tag, ray.skip[0]);
                }
            }
            Kind::Inner(_) | Kind::Nothing => {}
        }
    }

    /// Whether a leaf is hit before `t_max`.
    #[inline(always)]
    pub(super) fn blocks(
        &self,
        leaf: Child,
        ray: &Ray,
        lanes: &RayLanes<f32x8>,
        t_max: f32,
    ) -> bool {
        match leaf.kind() {
            Kind::Block(k, _) => {
                let c = self.blocks[k].load().candidate(lanes);
                let mut hits = c.within(f32x8::splat(t_max)).to_bitmask();
                while hits != 0 {
                    let lane = hits.trailing_zeros() as usize % LANES;
                    if !ray.skips(self.tags[k][lane].surface) {
                        return true;
                    }
                    hits &= hits - 1;
                }
                false
            }
            Kind::Curved(k) => {
                let (curved, tag) = &self.curved[k];
                !ray.skips(tag.surface) && curved.occluded(&Line::of(ray), t_max)
            }
            Kind::Inner(_) | Kind::Nothing => false,
        }
    }

    // Out of line, so that small scenes do not pay for this frame.
    #[inline(never)]
    pub(super) fn intersect(&self, ray: &Ray, best: &mut Best) {
        let lanes = RayLanes::<f32x8>::new(ray);
        let (slabs, mut search) = self.start(ray);
        while let Some(child) = search.next(best.t) {
            match child.kind() {
                Kind::Inner(index) => search.enter(&slabs, &self.nodes[index], best.t),
                _ => self.offer(child, ray, &lanes, best),
            }
        }
    }

    #[inline(never)]
    pub(super) fn occluded(&self, ray: &Ray, t_max: f32) -> bool {
        let lanes = RayLanes::<f32x8>::new(ray);
        let (slabs, mut search) = self.start(ray);
        while let Some(child) = search.next(t_max) {
            match child.kind() {
                Kind::Inner(index) => search.enter_all(&slabs, &self.nodes[index], t_max),
                _ => {
                    if self.blocks(child, ray, &lanes, t_max) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Brings what a child is made of near. Who searches for many rays in turns need not wait for each.
    #[inline(always)]
    pub(super) fn fetch(&self, child: Child) {
        // One number of each line of the cache.
        match child.kind() {
            Kind::Inner(index) => {
                let node = &self.nodes[index];
                node.planes.iter().for_each(prefetch);
                prefetch(&node.children);
            }
            Kind::Block(index, _) => self.blocks[index].fetch(),
            Kind::Curved(_) | Kind::Nothing => {}
        }
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.nodes.capacity() * size_of::<Node>()
            + self.blocks.capacity() * size_of::<Flat<[f32; LANES]>>()
            + self.tags.capacity() * size_of::<[Tag; LANES]>()
            + self.curved.capacity() * size_of::<(Curved, Tag)>()
    }
}

/// What a ray meets of boxes.
#[derive(Clone, Copy)]
pub(super) struct Slabs {
    inverse: [f32; 3],
    /// Where the lower of the near planes would be met, and the upper of the far ones, if all were at zero.
    base: [[f32; 2]; 3],
    /// Per axis: which planes are met first.
    first: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    pub fn new(tree: &Tree, ray: &Ray) -> Self {
        let o: [f32; 3] = each([0, 1, 2], |k: usize| ray.o[k] - tree.center[k]);
        let far = each([0, 1, 2], |k: usize| o[k].abs() + tree.half[k]);
        let reach = far[0] + far[1] + far[2];
        let inverse = each(ray.d, |x| 1.0 / x.abs().max(MIN_COMPONENT).copysign(x));
        let base = |k: usize| {
            let slack = inverse[k].abs() * (SLACK * reach);
            let base = -o[k] * inverse[k];
            [base - slack, base + slack]
        };
        Self::of(inverse, [base(0), base(1), base(2)])
    }

    /// From one over a direction, and where planes at zero would be met, see `base`.
    #[inline(always)]
    pub fn of(inverse: [f32; 3], base: [[f32; 2]; 3]) -> Self {
        Self {
            base,
            first: each(inverse, |x| usize::from(x < 0.0)),
            inverse,
        }
    }

    /// Where the children of a node are entered, and the lanes of those that are before `limit`.
    #[inline(always)]
    fn enter(&self, node: &Node, limit: f32) -> (f32x8, f32x8) {
        let mut near = f32x8::splat(0.0);
        let mut far = f32x8::splat(limit);
        for k in 0..3 {
            let [first, last] = [self.first[k], 1 - self.first[k]];
            let first = f32x8::from(node.planes[k][first & 1]);
            let last = f32x8::from(node.planes[k][last & 1]);
            let inverse = f32x8::splat(self.inverse[k]);
            near = near.fast_max(first.mul_add(inverse, f32x8::splat(self.base[k][0])));
            far = far.fast_min(last.mul_add(inverse, f32x8::splat(self.base[k][1])));
        }
        (near, near.simd_le(far))
    }
}

/// The numbers of lanes, as bits of numbers, and the same less eight.
const LANE: [f32; NODE_WIDTH] = lane_bits(0);
const OUTSIDE: [f32; NODE_WIDTH] = lane_bits(-8);

const fn lane_bits(first: i32) -> [f32; NODE_WIDTH] {
    let mut bits = [0.0; NODE_WIDTH];
    let mut k = 0;
    while k < NODE_WIDTH {
        bits[k] = f32::from_bits((first + k as i32) as u32);
        k += 1;
    }
    bits
}

/// Children that are at hand; deeper searches go to the heap.
const AT_HAND: usize = 32;

/// What a ray has still to visit: children, and where it enters them; the nearest comes last.
#[derive(Clone)]
pub(super) struct Search {
    open: [(f32, Child); AT_HAND],
    count: usize,
    /// What comes before.
    deep: Vec<(f32, Child)>,
}

impl Search {
    /// Nothing.
    pub const NONE: Self = Self {
        open: [(0.0, Child::NOTHING); AT_HAND],
        count: 0,
        deep: Vec::new(),
    };

    /// Forgets all.
    #[inline(always)]
    pub fn clear(&mut self) {
        self.count = 0;
        self.deep.clear();
    }

    /// Adds a child.
    #[inline(always)]
    pub fn push(&mut self, near: f32, child: Child) {
        self.make_room();
        self.open[self.count % AT_HAND] = (near, child);
        self.count += 1;
    }

    /// The next child that is entered before `limit`.
    #[inline(always)]
    pub fn next(&mut self, limit: f32) -> Option<Child> {
        loop {
            if self.count == 0 {
                self.fetch_deep();
            }
            self.count = self.count.checked_sub(1)?;
            let (near, child) = self.open[self.count % AT_HAND];
            if near <= limit {
                return Some(child);
            }
        }
    }

    /// Adds the children of a node that are entered before `limit`. Which of them there are, and in which order, is
    /// hardly ever the same twice: nothing branches on it.
    #[inline(always)]
    // Iterators over several arrays are no vector instructions.
    #[allow(clippy::needless_range_loop)]
    pub fn enter(&mut self, slabs: &Slabs, node: &Node, limit: f32) {
        let (near, entered) = slabs.enter(node, limit);
        self.make_room();
        // Distances are not negative, so that their bits are in their order; the lowest ones make all different. What is
        // not entered comes behind all else.
        let high = f32x8::splat(f32::from_bits(0x7fff_fff8));
        let keys = entered.select((near & high) | f32x8::from(LANE), f32x8::from(OUTSIDE));
        let (near, keys) = (near.to_array(), keys.to_array());
        let entered = entered.to_bitmask();
        let mut places = [0_u32; NODE_WIDTH];
        for key in keys {
            for k in 0..NODE_WIDTH {
                places[k] += u32::from(key.to_bits() as i32 > keys[k].to_bits() as i32);
            }
        }
        let first = self.count.min(AT_HAND - NODE_WIDTH);
        let room: &mut [(f32, Child)] = &mut self.open[first..first + NODE_WIDTH];
        for k in 0..NODE_WIDTH {
            room[places[k] as usize % NODE_WIDTH] = (near[k], node.children[k]);
        }
        self.count = first + entered.count_ones() as usize;
    }

    /// The same in any order, for those who look for nothing in particular.
    #[inline(always)]
    #[allow(clippy::needless_range_loop)]
    pub fn enter_all(&mut self, slabs: &Slabs, node: &Node, limit: f32) {
        let entered = slabs.enter(node, limit).1.to_bitmask();
        self.make_room();
        for k in 0..NODE_WIDTH {
            self.open[self.count % AT_HAND] = (0.0, node.children[k]);
            self.count += (entered >> k & 1) as usize;
        }
    }

    /// Turns the order of what is at hand around.
    #[inline(always)]
    pub fn reverse(&mut self) {
        self.open[..self.count.min(AT_HAND)].reverse();
    }

    /// Makes room for the children of a node.
    #[inline(always)]
    fn make_room(&mut self) {
        if self.count > AT_HAND - NODE_WIDTH {
            self.put_deep();
        }
    }

    #[cold]
    #[inline(never)]
    fn put_deep(&mut self) {
        self.deep.extend_from_slice(&self.open[..self.count]);
        self.count = 0;
    }

    /// Takes up what was put away.
    #[inline(always)]
    fn fetch_deep(&mut self) {
        if let Some(last) = self.deep.pop() {
            self.open[0] = last;
            self.count = 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Primitive;

    /// Far more than is at hand, as in hierarchies that are mostly depth.
    #[test]
    fn searches_are_as_deep_as_they_have_to_be() {
        let child = |k: usize| Child::block(k, 1);
        let mut search = Search::NONE;
        let count = 5 * AT_HAND;
        for k in 0..count {
            search.push((count - k) as f32, child(k));
        }
        let limit = (count / 2) as f32;
        for k in (count / 2..count).rev() {
            assert_eq!(search.next(limit), Some(child(k)));
        }
        assert_eq!(search.next(limit), None);
    }

    /// The children that are entered, from the nearest on, whatever their order in the node; or all of them.
    #[test]
    fn children_are_visited_from_the_nearest_on() {
        let unit = Primitive::Sphere {
            center: [0.0; 3],
            radius: 1.0,
        };
        let items = super::super::prepare(&[unit], &[0], &[]).expect("a primitive");
        let tree = Tree::new(&items, &[]).expect("a tree");
        let ray = Ray::new([-2.0, 0.0, 0.0], [1.0, 0.0, 0.0], [u32::MAX; 2]).expect("a ray");
        let slabs = Slabs::new(&tree, &ray);
        for turn in 0..NODE_WIDTH {
            for missed in 0..NODE_WIDTH {
                let mut node = Node::EMPTY;
                let place = |k: usize| (3 * k + turn) % NODE_WIDTH;
                for k in 0..NODE_WIDTH {
                    // The first two begin before the ray does.
                    let low = place(k) as f32 - 3.0;
                    let side = if k == missed { 9.0 } else { 0.0 };
                    let bounds = Aabb::new([low, side, -1.0].into(), [low + 1.5, side, 1.0].into());
                    node.place(k, &bounds, [0.0; 3]);
                    node.children[k] = Child::block(k, 1);
                }
                let mut search = Search::NONE;
                search.enter(&slabs, &node, 5.5);
                let mut found = Vec::new();
                while let Some(child) = search.next(5.5) {
                    found.extend((0..NODE_WIDTH).filter(|&k| node.children[k] == child));
                }
                // The box in the last place is beyond the limit.
                let mut expected: Vec<usize> = (0..NODE_WIDTH)
                    .filter(|&k| k != missed && place(k) < NODE_WIDTH - 1)
                    .collect();
                let near = |k: &usize| place(*k).max(1);
                expected.sort_by_key(near);
                let places = |found: &[usize]| found.iter().map(near).collect::<Vec<_>>();
                assert_eq!(places(&found), places(&expected));
                search.enter_all(&slabs, &node, 5.5);
                let mut all = Vec::new();
                while let Some(child) = search.next(5.5) {
                    all.extend((0..NODE_WIDTH).filter(|&k| node.children[k] == child));
                }
                all.sort_unstable();
                expected.sort_unstable();
                assert_eq!(all, expected);
            }
        }
    }
}
