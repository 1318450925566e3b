//! Which of many boxes overlap.

use crate::parallel;

/// A box: its lowest corner and its highest one.
pub(super) type Box3 = [[f32; 3]; 2];

/// Boxes of a leaf.
const LEAF: usize = 4;
/// So many boxes are looked at by one thread.
const TOGETHER: usize = 1 << 10;
const NOTHING: Box3 = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];

fn around(a: Box3, b: Box3) -> Box3 {
    let all = [0, 1, 2];
    [
        all.map(|k: usize| a[0][k].min(b[0][k])),
        all.map(|k: usize| a[1][k].max(b[1][k])),
    ]
}

fn overlap(a: &Box3, b: &Box3) -> bool {
    (0..3).all(|k| a[0][k] <= b[1][k] && b[0][k] <= a[1][k])
}

/// Bits of a number, two places between them.
fn spread(x: u64) -> u64 {
    let mut x = x & 0x1f_ffff;
    for (shift, mask) in [
        (32, 0x001f_0000_0000_ffff),
        (16, 0x001f_0000_ff00_00ff),
        (8, 0x100f_00f0_0f00_f00f),
        (4, 0x10c3_0c30_c30c_30c3),
        (2, 0x1249_2492_4924_9249),
    ] {
        x = (x | x << shift) & mask;
    }
    x
}

/// A complete binary tree over boxes in the order of a curve that fills space. Node `k` has the children `2k` and `2k + 1`.
struct Hierarchy<'a> {
    boxes: &'a [Box3],
    order: Vec<(u64, u64)>,
    /// As many as there are leaves, a power of two, twice.
    nodes: Vec<Box3>,
}

impl<'a> Hierarchy<'a> {
    fn of(boxes: &'a [Box3]) -> Self {
        let [low, high] = boxes.iter().copied().fold(NOTHING, around);
        let code = |i: usize| {
            let [a, b] = boxes[i];
            let at = |k: usize| {
                let part = (0.5 * (a[k] + b[k]) - low[k]) / (high[k] - low[k]);
                // A number that is none is zero.
                spread((part * 2_097_151.0) as u64)
            };
            (at(0) | at(1) << 1 | at(2) << 2, i as u64)
        };
        let mut order = parallel::fill(boxes.len(), &code);
        parallel::sort(&mut order);
        let leaves = boxes.len().div_ceil(LEAF).next_power_of_two();
        let mut nodes = vec![NOTHING; 2 * leaves];
        for (node, items) in nodes[leaves..].iter_mut().zip(order.chunks(LEAF)) {
            *node = (items.iter()).fold(NOTHING, |all, i| around(all, boxes[i.1 as usize]));
        }
        for k in (1..leaves).rev() {
            nodes[k] = around(nodes[2 * k], nodes[2 * k + 1]);
        }
        Self {
            boxes,
            order,
            nodes,
        }
    }

    /// Calls `each` with every box that overlaps the one in this place of the order and comes after it.
    fn after(&self, place: usize, mut each: impl FnMut(usize)) {
        let own = &self.boxes[self.order[place].1 as usize];
        let leaves = self.nodes.len() / 2;
        let mut open = vec![1];
        while let Some(k) = open.pop() {
            // The last place below it.
            let level = leaves.ilog2() - usize::ilog2(k);
            let end = ((k + 1) << level) - leaves;
            if end * LEAF <= place || !overlap(own, &self.nodes[k]) {
                continue;
            }
            if level > 0 {
                open.extend([2 * k + 1, 2 * k]);
                continue;
            }
            let first = (k - leaves) * LEAF;
            let last = (first + LEAF).min(self.order.len());
            for other in first.max(place + 1)..last {
                let i = self.order[other].1 as usize;
                if overlap(own, &self.boxes[i]) {
                    each(i);
                }
            }
        }
    }
}

/// What `each` finds in pairs of boxes that overlap, by their numbers, the smaller one first; in an order that depends on
/// boxes alone.
pub(super) fn pairs<T: Send>(
    boxes: &[Box3],
    each: impl Fn(usize, usize, &mut Vec<T>) + Sync,
) -> Vec<T> {
    if boxes.len() < 2 {
        return Vec::new();
    }
    let hierarchy = Hierarchy::of(boxes);
    let parts = parallel::ranges(boxes.len(), TOGETHER, |range| {
        let mut found = Vec::new();
        for place in range {
            let i = hierarchy.order[place].1 as usize;
            hierarchy.after(place, |j| each(i.min(j), i.max(j), &mut found));
        }
        found
    });
    parts.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pair is found once, whatever the boxes are.
    #[test]
    fn pairs_are_those_of_all_against_all() {
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        for n in [0, 1, 2, 3, 50, 777] {
            let boxes: Vec<Box3> = (0..n)
                .map(|i| {
                    let low = [random(), random(), 0.0];
                    let size = if i % 10 == 0 { 0.5 } else { 0.05 };
                    [
                        low,
                        [low[0] + size * random(), low[1] + size * random(), 0.0],
                    ]
                })
                .collect();
            let mut found = pairs(&boxes, |i, j, out| out.push((i, j)));
            found.sort_unstable();
            let mut expected = Vec::new();
            for i in 0..boxes.len() {
                for j in i + 1..boxes.len() {
                    if overlap(&boxes[i], &boxes[j]) {
                        expected.push((i, j));
                    }
                }
            }
            assert_eq!(found, expected, "{n}");
            assert!(n < 777 || expected.len() > 20, "{n}: {}", expected.len());
        }
    }
}
