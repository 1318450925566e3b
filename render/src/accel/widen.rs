//! Nodes of eight children from nodes of two.

use super::Item;
use super::cluster::{children, parts};
use super::node::{Child, NODE_WIDTH, Node};
use super::triangle_block::LANES;
use crate::math::both;
use crate::parallel;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use smallvec::SmallVec;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU8, AtomicU32, Ordering};

/// Trees of more primitives are widened in parts.
const MANY_ITEMS: usize = 1 << 13;

/// So many parts at least, if there are.
const PARTS: usize = 64;

/// A part of a tree: nodes whose children are in it, and items by their indices.
pub(super) struct Subtree {
    pub nodes: Vec<Node>,
    /// Those of each block; beyond the last there is none.
    pub leaves: Vec<[u32; LANES]>,
    pub curved: Vec<u32>,
}

impl Subtree {
    /// The whole: the top of the tree first, then what is below on all threads. `None` if there are too many of anything.
    pub fn of(binary: &Binary, center: [f32; 3]) -> Option<Self> {
        let mut all = Subtree::new();
        let mut open = VecDeque::from([(0, 0)]);
        let most = match binary.items.len() {
            0..MANY_ITEMS => 1,
            _ => PARTS,
        };
        while open.len() < most
            && let Some((at, from)) = open.pop_front()
        {
            all.open(at, from, binary, center, |child| open.push_back(child));
        }
        let parts = parallel::map(open.len(), |k| {
            let mut part = Subtree::new();
            let mut below = vec![(0, open[k].1)];
            while let Some((at, from)) = below.pop() {
                part.open(at, from, binary, center, |child| below.push(child));
            }
            part
        });
        for (&(at, _), part) in open.iter().zip(parts) {
            all.append(at, part)?;
        }
        all.count()?;
        Some(all)
    }

    fn new() -> Self {
        Self {
            nodes: vec![Node::EMPTY],
            leaves: Vec::new(),
            curved: Vec::new(),
        }
    }

    /// Fills node `at`, which stands for the binary node `from`. Its children that are nodes are to be filled next, and
    /// stand for others.
    #[inline(always)]
    fn open(
        &mut self,
        at: usize,
        from: usize,
        binary: &Binary,
        center: [f32; 3],
        mut next: impl FnMut((usize, usize)),
    ) {
        let mut children = SmallVec::<[usize; NODE_WIDTH]>::new();
        binary.stand_in(from, &mut children);
        for (k, &child) in children.iter().enumerate() {
            self.nodes[at].place(k, binary.node(child).aabb(), center);
            self.nodes[at].children[k] = if binary.is_leaf(child) {
                self.leaf(&binary.primitives(child), binary)
            } else {
                let index = self.nodes.len();
                next((index, child));
                self.nodes.push(Node::EMPTY);
                Child::inner(index)
            };
        }
    }

    fn leaf(&mut self, primitives: &[u32], binary: &Binary) -> Child {
        if let [one] = primitives
            && binary.items[*one as usize].is_curved()
        {
            self.curved.push(*one);
            return Child::curved(self.curved.len() - 1);
        }
        let mut leaf = [u32::MAX; LANES];
        leaf[..primitives.len()].copy_from_slice(primitives);
        self.leaves.push(leaf);
        Child::block(self.leaves.len() - 1, primitives.len())
    }

    /// Takes in a part whose first node is node `at`. `None` if there are too many of anything.
    fn append(&mut self, at: usize, part: Self) -> Option<()> {
        // The first node has a place already.
        let nodes = self.nodes.len() - 1;
        let (leaves, curved) = (self.leaves.len(), self.curved.len());
        for (k, mut node) in part.nodes.into_iter().enumerate() {
            for child in &mut node.children {
                *child = child.behind(nodes, leaves, curved);
            }
            match k {
                0 => self.nodes[at] = node,
                _ => self.nodes.push(node),
            }
        }
        self.leaves.extend(part.leaves);
        self.curved.extend(part.curved);
        self.count()
    }

    /// `None` if there are too many of anything for an index: one less than there are of these, because the last one
    /// with all tags is nothing.
    fn count(&self) -> Option<()> {
        let counts = [self.nodes.len(), self.leaves.len(), self.curved.len()];
        counts.iter().all(|&n| n < Child::MANY).then_some(())
    }
}

/// A binary hierarchy, and what is below its nodes.
pub(super) struct Binary<'a> {
    tree: &'a Bvh2,
    pub items: &'a [Item],
    /// Per node: how many primitives there are below, or more than fit a leaf.
    counts: Vec<AtomicU8>,
    /// Per node that is no leaf, and number of places: the least sum of the areas of all boxes from it downwards, where it and what
    /// is below stand in at most so many places of a node.
    sums: Vec<[AtomicU32; NODE_WIDTH - 1]>,
}

/// More primitives than fit a leaf.
const MANY: u8 = LANES as u8 + 1;

impl<'a> Binary<'a> {
    pub fn new(tree: &'a Bvh2, items: &'a [Item]) -> Self {
        let binary = Self {
            tree,
            items,
            counts: parallel::fill(tree.nodes.len(), &|_| AtomicU8::new(0)),
            sums: parallel::fill(tree.nodes.len(), &|_| {
                [const { AtomicU32::new(0) }; NODE_WIDTH - 1]
            }),
        };
        let (top, parts) = parts(&tree.nodes);
        // Every node is written by one thread, after those below it.
        let parts_below = parallel::map(parts.len(), |k| {
            let mut order = vec![parts[k].0];
            let mut next = 0;
            while let Some(&at) = order.get(next) {
                next += 1;
                if !tree.nodes[at].is_leaf() {
                    order.extend(binary.children(at));
                }
            }
            order.iter().rev().for_each(|&at| binary.sum_up(at));
        });
        drop(parts_below);
        top.iter().rev().for_each(|&at| binary.sum_up(at));
        binary
    }

    /// Counts and sums up what is below a node, when that is known of its children.
    fn sum_up(&self, at: usize) {
        let node = &self.tree.nodes[at];
        let count = if node.is_leaf() {
            let mut count = node.prim_count.min(u32::from(MANY)) as u8;
            for &i in self.leaf(node) {
                if self.items[i as usize].is_curved() {
                    // Joined with nothing.
                    count = MANY;
                }
            }
            count
        } else {
            let [a, b] = both(self.children(at), |c| self.below(c));
            (a + b).min(MANY)
        };
        self.counts[at].store(count, Ordering::Relaxed);
        if self.is_leaf(at) {
            return;
        }
        // In one place it is a node, whose children have all of its own.
        let mut least = self.area(at) + self.split(at, NODE_WIDTH).0;
        for (places, sum) in (1..).zip(&self.sums[at]) {
            if places > 1 {
                least = least.min(self.split(at, places).0);
            }
            sum.store(least.to_bits(), Ordering::Relaxed);
        }
    }

    /// The least sum of the areas of all boxes from a node downwards, in so many places: its box alone where it is a leaf.
    fn sum(&self, at: usize, places: usize) -> f32 {
        if self.is_leaf(at) {
            return self.area(at);
        }
        f32::from_bits(self.sums[at][places - 1].load(Ordering::Relaxed))
    }

    /// The least sum of the areas below a node that is opened, if its children have so many places, and how many the first of
    /// them has.
    fn split(&self, at: usize, places: usize) -> (f32, usize) {
        let [a, b] = self.children(at);
        let mut best = (f32::INFINITY, places / 2);
        for first in 1..places {
            let sum = self.sum(a, first) + self.sum(b, places - first);
            if sum < best.0 {
                best = (sum, first);
            }
        }
        best
    }

    /// What stands in the places of the node that is made of a binary one, so that the sum of the areas of all boxes is least
    /// [Ylitie et al. 2017, section 3.1, with leaves that hold all that they can].
    fn stand_in(&self, at: usize, children: &mut SmallVec<[usize; NODE_WIDTH]>) {
        if self.is_leaf(at) {
            children.push(at);
        } else {
            self.open(at, NODE_WIDTH, children);
        }
    }

    /// The same of a node that is opened, in so many places.
    fn open(&self, at: usize, places: usize, children: &mut SmallVec<[usize; NODE_WIDTH]>) {
        let (_, first) = self.split(at, places);
        let places = [first, places - first];
        for (child, places) in self.children(at).into_iter().zip(places) {
            // Of equals the one with more places.
            if places > 1
                && !self.is_leaf(child)
                && self.split(child, places).0 <= self.sum(child, 1)
            {
                self.open(child, places, children);
            } else {
                children.push(child);
            }
        }
    }

    fn below(&self, at: usize) -> u8 {
        self.counts[at].load(Ordering::Relaxed)
    }

    /// What a leaf of it holds: indices of items.
    fn leaf(&self, node: &Bvh2Node) -> &'a [u32] {
        let first = node.first_index as usize;
        &self.tree.primitive_indices[first..first + node.prim_count as usize]
    }

    fn node(&self, at: usize) -> &'a Bvh2Node {
        &self.tree.nodes[at]
    }

    fn children(&self, at: usize) -> [usize; 2] {
        children(self.node(at))
    }

    /// Whether all below becomes one leaf.
    fn is_leaf(&self, at: usize) -> bool {
        self.below(at) < MANY || self.node(at).is_leaf()
    }

    fn area(&self, at: usize) -> f32 {
        self.node(at).aabb().half_area()
    }

    /// All below, which becomes one leaf: indices of items.
    fn primitives(&self, at: usize) -> SmallVec<[u32; LANES]> {
        let mut found = SmallVec::new();
        let mut open = SmallVec::<[usize; 2 * LANES]>::new();
        open.push(at);
        while let Some(at) = open.pop() {
            let node = self.node(at);
            if node.is_leaf() {
                found.extend_from_slice(self.leaf(node));
            } else {
                open.extend_from_slice(&self.children(at));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Primitive, cluster::hierarchy, prepare};
    use super::*;
    use obvhs::Boundable;

    /// The least sum of areas from a node downwards, over all nodes that may stand in the places of it.
    fn least(binary: &Binary, at: usize) -> f64 {
        let own = f64::from(binary.area(at));
        if binary.is_leaf(at) {
            return own;
        }
        let [a, b] = both(binary.children(at), |c| cuts(binary, c));
        let pairs = a.iter().flat_map(|x| b.iter().map(move |y| (x, y)));
        let sums = pairs
            .filter(|((m, _), (n, _))| m + n <= NODE_WIDTH)
            .map(|((_, x), (_, y))| x + y);
        own + sums.fold(f64::INFINITY, f64::min)
    }

    /// All ways to let a node, or nodes below it, stand in places of a node: how many these are, and their sum.
    fn cuts(binary: &Binary, at: usize) -> Vec<(usize, f64)> {
        let mut all = vec![(1, least(binary, at))];
        if !binary.is_leaf(at) {
            let [a, b] = both(binary.children(at), |c| cuts(binary, c));
            for (m, x) in &a {
                all.extend(b.iter().map(|(n, y)| (m + n, x + y)));
            }
        }
        all
    }

    /// Nodes are those whose areas have the least sum there is, and hold every primitive once.
    #[test]
    fn areas_have_the_least_sum() {
        for count in [2, 9, 17, 24] {
            let ball = |k: usize| {
                let at = |by: f32| (by * (k * k + 3 * k) as f32).sin() * 5.0;
                Primitive::Sphere {
                    center: [at(0.37), at(0.71), at(1.13)],
                    radius: 0.1 + 0.9 * at(0.19).abs(),
                }
            };
            let balls: Vec<Primitive> = (0..count).map(ball).collect();
            let surfaces: Vec<u32> = (0..count as u32).collect();
            let items = prepare(&balls, &surfaces, &[]).expect("balls");
            let boxes: Vec<_> = items.iter().map(|i| i.aabb()).collect();
            let tree = hierarchy(&boxes);
            let binary = Binary::new(&tree, &items);
            let wide = Subtree::of(&binary, [0.0; 3]).expect("a tree");
            let mut sum = f64::from(binary.area(0));
            for node in &wide.nodes {
                for k in (0..NODE_WIDTH).filter(|&k| !node.children[k].is_nothing()) {
                    let [a, b, c] = node.planes.map(|[low, high]| f64::from(high[k] - low[k]));
                    sum += a * b + b * c + c * a;
                }
            }
            let least = least(&binary, 0);
            assert!((sum / least - 1.0).abs() < 1e-5, "{count}: {sum} {least}");
            let mut found = wide.curved.clone();
            found.sort_unstable();
            assert_eq!(found, surfaces, "{count}");
        }
    }
}
