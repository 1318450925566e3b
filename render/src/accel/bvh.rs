//! Compressed eight-wide hierarchy: built by `obvhs`, traversed here.
//!
//! The node test is our own because the library's clamps distances at an absolute 1e-4 and rounds
//! its slabs inwards; ours widens them by more than the rounding of any primitive test, so that a
//! hit never depends on the shape of the tree.

use super::curved::{Curved, Line};
use super::packet::{Flat, RayLanes};
use super::{Best, Item, Ray, Shape};
use crate::math::each;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::{Bvh2, reinsertion::ReinsertionOptimizer};
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::cwbvh::node::CwBvhNode;
use obvhs::ploc::PlocBuilder;
use obvhs::{Boundable, BvhBuildParams, aabb::Aabb};
use std::collections::HashMap;
use wide::{f32x8, i32x8, u8x16, u16x8};

/// Levels of ordinary hierarchies: a million primitives need about ten. A larger stack costs more to
/// set up, seven per cent of a coherent ray at 48.
const USUAL_DEPTH: usize = 16;

/// Deepest hierarchy that is traversed. Sizes that shrink geometrically lead to long chains.
const MAX_DEPTH: usize = 256;

/// Clustering can chain coinciding primitives into a list, on which the conversion would recurse out
/// of its stack; such hierarchies are built again, balanced.
const MAX_BINARY_DEPTH: usize = 500;

/// Widening of the slabs, relative to the farthest point of the scene; must exceed the seam of
/// the flat test.
pub(super) const SLACK: f32 = 32.0 * f32::EPSILON;

/// Smallest direction component in a slab test: keeps reciprocals finite.
pub(super) const MIN_COMPONENT: f32 = 1e-20;

/// Marks leaf slots that hold a flat primitive.
const FLAT: u32 = u32::MAX;

#[derive(Clone, Debug)]
pub(super) struct Tree {
    pub(super) nodes: Vec<CwBvhNode>,
    depth: usize,
    /// Leaf slots in traversal order.
    pub(super) flat: Vec<Flat<f32>>,
    pub(super) prims: Vec<u32>,
    /// Per slot an index into `curved` or [`FLAT`]; empty if everything is flat.
    kinds: Vec<u32>,
    curved: Vec<Curved>,
    pub(super) center: [f32; 3],
    pub(super) half: [f32; 3],
}

impl Boundable for Item {
    fn aabb(&self) -> Aabb {
        Aabb::new(self.bounds[0].into(), self.bounds[1].into())
    }
}

impl Tree {
    /// `None` if the hierarchy is too deep for the stack.
    pub(super) fn new(items: &[Item]) -> Option<Tree> {
        let boxes: Vec<Aabb> = items.iter().map(Item::aabb).collect();
        let clustered = if crowded(&boxes) {
            None
        } else {
            clustered(&boxes)
        };
        let binary = clustered.unwrap_or_else(|| balanced(&boxes));
        let wide = bvh2_to_cwbvh(&binary, 3, true, false);
        let depth = depth(&wide.nodes);
        if depth > MAX_DEPTH {
            return None;
        }
        let mut tree = Tree {
            nodes: wide.nodes,
            depth,
            flat: Vec::with_capacity(items.len()),
            prims: Vec::with_capacity(items.len()),
            kinds: Vec::new(),
            curved: Vec::new(),
            center: [0.0; 3],
            half: [0.0; 3],
        };
        let mut kinds = Vec::with_capacity(items.len());
        for &i in &wide.primitive_indices {
            let item = &items[i as usize];
            tree.prims.push(item.prim);
            match item.shape {
                Shape::Flat(f) => {
                    tree.flat.push(f);
                    kinds.push(FLAT);
                }
                Shape::Curved(c) => {
                    tree.flat.push(Flat::EMPTY);
                    kinds.push(tree.curved.len() as u32);
                    tree.curved.push(c);
                }
            }
        }
        if !tree.curved.is_empty() {
            tree.kinds = kinds;
        }
        for k in 0..3 {
            let lo = items
                .iter()
                .map(|i| i.bounds[0][k])
                .fold(f32::INFINITY, f32::min);
            let hi = items
                .iter()
                .map(|i| i.bounds[1][k])
                .fold(f32::NEG_INFINITY, f32::max);
            if lo <= hi {
                tree.center[k] = 0.5 * (lo + hi);
                tree.half[k] = 0.5 * (hi - lo);
            }
        }
        Some(tree)
    }

    // Out of line, so that small scenes do not pay for this frame.
    #[inline(never)]
    pub(super) fn intersect(&self, ray: &Ray, best: &mut Best) {
        self.intersect_from(0, ray, best);
    }

    #[inline(never)]
    pub(super) fn occluded(&self, ray: &Ray, t_max: f32) -> bool {
        self.occluded_from(0, ray, t_max)
    }

    /// Everything below `node`.
    #[inline(always)]
    pub(super) fn intersect_from(&self, node: u32, ray: &Ray, best: &mut Best) {
        if self.depth <= USUAL_DEPTH {
            self.intersect_within::<USUAL_DEPTH>(node, ray, best);
        } else {
            self.intersect_within::<MAX_DEPTH>(node, ray, best);
        }
    }

    /// Everything below `node`.
    #[inline(always)]
    pub(super) fn occluded_from(&self, node: u32, ray: &Ray, t_max: f32) -> bool {
        if self.depth <= USUAL_DEPTH {
            self.occluded_within::<USUAL_DEPTH>(node, ray, t_max)
        } else {
            self.occluded_within::<MAX_DEPTH>(node, ray, t_max)
        }
    }

    /// The curved primitive in a slot, if it is one.
    #[inline(always)]
    pub(super) fn curved_at(&self, slot: usize) -> Option<&Curved> {
        let kind = *self.kinds.get(slot)?;
        self.curved.get(kind as usize)
    }

    #[inline(never)]
    fn intersect_within<const DEPTH: usize>(&self, node: u32, ray: &Ray, best: &mut Best) {
        let lanes = RayLanes::<f32>::new(ray);
        if self.kinds.is_empty() {
            self.traverse::<DEPTH>(node, ray, best.t, |slot| {
                self.flat[slot].intersect(&lanes, self.prims[slot], best);
                Some(best.t)
            });
        } else {
            let line = Line::of(ray);
            self.traverse::<DEPTH>(node, ray, best.t, |slot| {
                match self.curved_at(slot) {
                    Some(c) => {
                        if let Some((t, u, v)) = c.intersect(&line, best.t) {
                            best.offer(t, u, v, self.prims[slot]);
                        }
                    }
                    None => self.flat[slot].intersect(&lanes, self.prims[slot], best),
                }
                Some(best.t)
            });
        }
    }

    #[inline(never)]
    fn occluded_within<const DEPTH: usize>(&self, node: u32, ray: &Ray, t_max: f32) -> bool {
        let lanes = RayLanes::<f32>::new(ray);
        self.traverse::<DEPTH>(node, ray, t_max, |slot| {
            let hit = match self.curved_at(slot) {
                Some(c) => c.occluded(&Line::of(ray), t_max),
                None => self.flat[slot].occluded(&lanes, t_max),
            };
            (!hit).then_some(t_max)
        })
    }

    /// Calls `test` on leaf slots below `node`, roughly front to back. It returns the new limit, or `None` to
    /// stop; the result tells whether it did.
    #[inline(always)]
    fn traverse<const DEPTH: usize>(
        &self,
        node: u32,
        ray: &Ray,
        t_max: f32,
        mut test: impl FnMut(usize) -> Option<f32>,
    ) -> bool {
        let slabs = Slabs::new(ray, &self.center, &self.half);
        let mut limit = t_max;
        let mut stack = [(0u32, 0u32); DEPTH];
        let mut top = 0;
        // Child base and, in the high byte, the children still to visit; the low byte is the mask
        // of inner children. We start with the only child of a virtual node.
        let mut group = (node, 0x8000_0000u32);
        if self.nodes.is_empty() {
            return false;
        }
        loop {
            let bit = 31 - group.1.leading_zeros();
            let slot = (bit - 24) ^ slabs.octant;
            let relative = (group.1 & !(u32::MAX << slot)).count_ones();
            let child = group.0 + relative;
            group.1 &= !(1 << bit);
            if group.1 & 0xff00_0000 != 0 {
                stack[top] = group;
                top += 1;
            }
            let node = &self.nodes[child as usize];
            let hits = slabs.test(node, limit);
            let mut leaves = hits & 0x00ff_ffff;
            while leaves != 0 {
                let slot = node.primitive_base_idx + leaves.trailing_zeros();
                leaves &= leaves - 1;
                match test(slot as usize) {
                    Some(t) => limit = t,
                    None => return true,
                }
            }
            group = (
                node.child_base_idx,
                (hits & 0xff00_0000) | u32::from(node.imask),
            );
            if hits & 0xff00_0000 == 0 {
                if top == 0 {
                    return false;
                }
                top -= 1;
                group = stack[top];
            }
        }
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.nodes.capacity() * size_of::<CwBvhNode>()
            + self.flat.capacity() * size_of::<Flat<f32>>()
            + (self.prims.capacity() + self.kinds.capacity()) * size_of::<u32>()
            + self.curved.capacity() * size_of::<Curved>()
    }
}

/// Whether a good part of the boxes coincides, on which clustering takes quadratic time. Looks at a
/// sample: fewer are harmless.
fn crowded(boxes: &[Aabb]) -> bool {
    const SAMPLE: usize = 1024;
    let mut counts = HashMap::new();
    boxes.len() > SAMPLE
        && boxes.iter().step_by(boxes.len() / SAMPLE).any(|b| {
            let key = [b.min, b.max].map(|p| p.to_array().map(f32::to_bits));
            let count = counts.entry(key).or_insert(0);
            *count += 1;
            *count > SAMPLE / 32
        })
}

/// The better hierarchy, unless it is a list.
fn clustered(boxes: &[Aabb]) -> Option<Bvh2> {
    let params = BvhBuildParams::medium_build();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        params.ploc_search_distance,
        boxes,
        (0..boxes.len() as u32).collect(),
        params.sort_precision,
        params.search_depth_threshold,
    );
    if levels(&binary) > MAX_BINARY_DEPTH {
        return None;
    }
    ReinsertionOptimizer::default().run(&mut binary, params.reinsertion_batch_ratio, None);
    (levels(&binary) <= MAX_BINARY_DEPTH).then_some(binary)
}

/// Number of levels of a binary hierarchy.
fn levels(tree: &Bvh2) -> usize {
    let mut deepest = 0;
    let mut open = vec![(0, 1)];
    while let Some((at, level)) = open.pop() {
        let Some(node) = tree.nodes.get(at) else {
            continue;
        };
        deepest = deepest.max(level);
        if !node.is_leaf() {
            let first = node.first_index as usize;
            open.extend([(first, level + 1), (first + 1, level + 1)]);
        }
    }
    deepest
}

/// Halves the set along the longest side of its centres until single primitives are left.
fn balanced(boxes: &[Aabb]) -> Bvh2 {
    let mut order: Vec<u32> = (0..boxes.len() as u32).collect();
    let mut nodes = vec![Bvh2Node::default()];
    let mut open = vec![(0, 0..boxes.len())];
    while let Some((at, range)) = open.pop() {
        let part = &mut order[range.clone()];
        let around = |sum: Aabb, &i: &u32| sum.union(&boxes[i as usize]);
        let bounds = part.iter().fold(Aabb::empty(), around);
        if part.len() == 1 {
            nodes[at] = Bvh2Node::new(bounds, 1, range.start as u32);
            continue;
        }
        let center = |i: u32| boxes[i as usize].center();
        let spread = part
            .iter()
            .fold(Aabb::empty(), |mut sum, &i| *sum.extend(center(i)));
        let axis = (spread.max - spread.min).max_position();
        let half = part.len() / 2;
        part.select_nth_unstable_by(half, |&i, &j| center(i)[axis].total_cmp(&center(j)[axis]));
        let first = nodes.len();
        nodes[at] = Bvh2Node::new(bounds, 0, first as u32);
        nodes.extend([Bvh2Node::default(); 2]);
        open.push((first, range.start..range.start + half));
        open.push((first + 1, range.start + half..range.end));
    }
    Bvh2 {
        nodes,
        primitive_indices: order,
        ..Bvh2::default()
    }
}

/// Number of levels. Children always come after their parent.
fn depth(nodes: &[CwBvhNode]) -> usize {
    let mut level = vec![1; nodes.len()];
    for (i, n) in nodes.iter().enumerate() {
        let first = n.child_base_idx as usize;
        for child in first..first + n.imask.count_ones() as usize {
            level[child] = level[i] + 1;
        }
    }
    level.into_iter().max().unwrap_or(0)
}

/// A ray prepared for node tests.
struct Slabs {
    o: [f32; 3],
    inverse: [f32; 3],
    /// Widening of each slab in units of `t`.
    slack: [f32; 3],
    /// Order in which children are visited.
    octant: u32,
}

impl Slabs {
    #[inline(always)]
    fn new(ray: &Ray, center: &[f32; 3], half: &[f32; 3]) -> Slabs {
        let mut reach = 0.0;
        for k in 0..3 {
            reach += (ray.o[k] - center[k]).abs() + half[k];
        }
        let inverse = each(ray.d, |x| 1.0 / x.abs().max(MIN_COMPONENT).copysign(x));
        let negative = |k: usize| u32::from(inverse[k] < 0.0);
        Slabs {
            o: ray.o,
            inverse,
            slack: each(inverse, |x| x.abs() * (SLACK * reach)),
            octant: 7 ^ (negative(0) << 2 | negative(1) << 1 | negative(2)),
        }
    }

    /// One bit per hit leaf slot (low 24) and per hit inner child (high 8, in visiting order).
    #[inline(always)]
    fn test(&self, node: &CwBvhNode, limit: f32) -> u32 {
        let mut near = f32x8::splat(0.0);
        let mut far = f32x8::splat(limit);
        let p = node.p.to_array();
        let mut axis = |k: usize, lo: &[u8; 8], hi: &[u8; 8]| {
            let scale = f32::from_bits(u32::from(node.e[k]) << 23) * self.inverse[k];
            let base = (p[k] - self.o[k]) * self.inverse[k];
            let (first, last) = if self.inverse[k] < 0.0 {
                (hi, lo)
            } else {
                (lo, hi)
            };
            let scale = f32x8::splat(scale);
            near = near.fast_max(widen(first).mul_add(scale, f32x8::splat(base - self.slack[k])));
            far = far.fast_min(widen(last).mul_add(scale, f32x8::splat(base + self.slack[k])));
        };
        axis(0, &node.child_min_x, &node.child_max_x);
        axis(1, &node.child_min_y, &node.child_max_y);
        axis(2, &node.child_min_z, &node.child_max_z);
        let mut overlap = near.simd_le(far).to_bitmask();
        let (bits, index) = node.get_child_and_index_bits(self.octant * 0x0101_0101);
        let mut hits = 0;
        while overlap != 0 {
            let shift = overlap.trailing_zeros() * 8;
            hits |= ((bits >> shift) as u32 & 0xff) << ((index >> shift) as u32 & 0x1f);
            overlap &= overlap - 1;
        }
        hits
    }
}

/// Eight bytes as eight floats; spelled so that it becomes one widening load.
#[inline(always)]
pub(super) fn widen(q: &[u8; 8]) -> f32x8 {
    let padded = u128::from(u64::from_le_bytes(*q)).to_le_bytes();
    let bytes = u16x8::from_u8x16_low(u8x16::from(padded));
    f32x8::from_i32x8(i32x8::from_u16x8(bytes))
}
