//! Binary hierarchies: clustering from below, and halving from above where clustering would not get on.
//!
//! Parallel locally-ordered clustering [Meister and Bittner 2018] joins boxes that are each other's best neighbour among
//! those near on a space-filling curve, in rounds. The rounds, with all their ties, are those of `obvhs::ploc`, which has
//! no bound on their number: of boxes that contain each other, such as the triangles of a fan or concentric balls, each
//! prefers the one inside, so that a round joins a single pair. Here the work is bounded. What is left when it is used
//! up is halved, so that any set of boxes takes a time of n log n.

use std::collections::VecDeque;

use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::bvh2::reinsertion::{Reinsertion, find_reinsertion, reinsert_node};
use obvhs::ploc::morton::morton_encode_u64_unorm;

use crate::parallel;

/// Deepest hierarchy: traversal and its stack stay short.
const MAX_DEPTH: usize = 500;
/// Most rounds of clustering, so that a hierarchy is no deeper than that and a few levels. Regular grids take most of
/// all ordinary scenes.
const MAX_ROUNDS: usize = 448;
/// Most boxes that all rounds look at together, per box of the scene: several times what ordinary scenes take.
const WORK_PER_BOX: usize = 16;
/// This many more may be looked at in any scene: small ones build in no time however they are made.
const FREE_WORK: usize = 1 << 16;
/// Neighbours that are compared with a box, on either side.
const REACH: usize = 14;
/// Rounds in which only the next neighbours are compared: most boxes find their partner then, at little cost.
const NARROW_ROUNDS: usize = 3;
/// Part of the nodes that the optimiser tries to move first.
const REINSERTED: f32 = 0.05;
/// How often it tries, each time fewer of them.
const REINSERTIONS: usize = 16;
/// So many boxes are looked at by one thread, and so many reinsertions.
const TOGETHER: usize = 1 << 13;
const TRIED_TOGETHER: usize = 1 << 8;
/// Trees of more nodes are walked in parts.
const MANY_NODES: usize = 1 << 14;
/// So many parts at least, if there are.
const PARTS: usize = 64;

/// A hierarchy of these boxes, one per leaf.
pub(super) fn hierarchy(boxes: &[Aabb]) -> Bvh2 {
    let (mut binary, left) = clustered(boxes);
    // Of boxes that contain each other the optimiser makes lists, and gains nothing.
    if left > 1 + boxes.len() / 8 {
        return binary;
    }
    reinsert(&mut binary);
    if levels(&binary) <= MAX_DEPTH {
        binary
    } else {
        clustered(boxes).0
    }
}

/// Moves nodes, the largest first, to where they make the boxes above them smaller: what `obvhs::bvh2::reinsertion` does,
/// with its searches on all threads, and an order of equals that does not depend on them.
fn reinsert(tree: &mut Bvh2) {
    if tree.nodes.len() < 3 {
        return;
    }
    tree.init_parents_if_uninit();
    tree.children_are_ordered_after_parents = false;
    let mut touched = vec![0; tree.nodes.len()];
    let mut candidates: Vec<(u32, u32)> = Vec::new();
    for round in 0..REINSERTIONS {
        let part = REINSERTED / (2 * round + 1) as f32;
        let count = ((tree.nodes.len() as f32 * part) as usize).clamp(1, tree.nodes.len() - 1);
        // Nodes near the root come early: those of most of the largest boxes.
        let early = tree.nodes.iter().zip(0..).take(2 * (count + 1)).skip(1);
        candidates.clear();
        // Areas are not negative, so that their bits are in their order.
        candidates.extend(early.map(|(node, i)| (!node.aabb().half_area().to_bits(), i)));
        if count < candidates.len() {
            candidates.select_nth_unstable(count);
            candidates.truncate(count);
        }
        let found = parallel::ranges(candidates.len(), TRIED_TOGETHER, |range| {
            let tried = candidates[range].iter();
            let found = tried.map(|&(_, node)| find_reinsertion(tree, node as usize));
            found.filter(|r| r.area_diff > 0.0).collect::<Vec<_>>()
        });
        let mut found: Vec<Reinsertion> = found.into_iter().flatten().collect();
        found.sort_unstable_by(|a, b| {
            (b.area_diff.total_cmp(&a.area_diff)).then(a.from.cmp(&b.from))
        });
        for Reinsertion { from, to, .. } in found {
            let [from, to] = [from as usize, to as usize];
            let sibling = Bvh2Node::get_sibling_id(from);
            let above = [to, from].map(|i| tree.parents[i] as usize);
            let all = [to, from, sibling, above[0], above[1]];
            // Its place may have changed in this round.
            if all.iter().all(|&i| touched[i] != round + 1) {
                all.iter().for_each(|&i| touched[i] = round + 1);
                reinsert_node(tree, from, to);
            }
        }
    }
}

/// By clustering, and how many clusters were left to be halved.
fn clustered(boxes: &[Aabb]) -> (Bvh2, usize) {
    let mut current = in_order(boxes);
    let mut nodes = vec![Bvh2Node::default(); (2 * boxes.len()).saturating_sub(1)];
    // Pairs are stored from the end on, so that parents come before children.
    let mut end = nodes.len();
    let mut work = FREE_WORK.saturating_add(WORK_PER_BOX.saturating_mul(boxes.len()));
    let (mut partners, mut next) = (Vec::new(), Vec::with_capacity(current.len()));
    let mut rounds = 0;
    while current.len() > 1 && rounds < MAX_ROUNDS && work >= current.len() {
        work -= current.len();
        if rounds < NARROW_ROUNDS {
            next_partners(&current, &mut partners)
        } else {
            best_partners(&current, &mut partners)
        }
        rounds += 1;
        next.clear();
        for at in 0..current.len() {
            let partner = partners[at];
            if partners[partner] != at {
                next.push(current[at]);
            } else if partner < at {
                // Joined where the second of the two stands.
                end -= 2;
                next.push(join(&mut nodes, end, [current[at], current[partner]]));
            }
        }
        std::mem::swap(&mut current, &mut next);
    }
    halve(&mut nodes[..end], &mut current);
    let tree = Bvh2 {
        nodes,
        primitive_indices: (0..boxes.len() as u32).collect(),
        children_are_ordered_after_parents: true,
        ..Bvh2::default()
    };
    (tree, current.len())
}

/// The leaves along a space-filling curve.
fn in_order(boxes: &[Aabb]) -> Vec<Bvh2Node> {
    let all = boxes.iter().fold(Aabb::empty(), |sum, b| sum.union(b));
    let scale = 1.0 / all.diagonal().as_dvec3();
    let offset = -all.min.as_dvec3() * scale;
    let mut order = parallel::fill(boxes.len(), &|i| {
        let code = morton_encode_u64_unorm(boxes[i].center().as_dvec3() * scale + offset);
        (code, i as u64)
    });
    parallel::sort(&mut order);
    let leaf = |&(_, i): &(u64, u64)| Bvh2Node::new(boxes[i as usize], 1, i as u32);
    order.iter().map(leaf).collect()
}

fn join(nodes: &mut [Bvh2Node], first: usize, [left, right]: [Bvh2Node; 2]) -> Bvh2Node {
    nodes[first] = left;
    nodes[first + 1] = right;
    Bvh2Node::new(left.aabb().union(right.aabb()), 0, first as u32)
}

fn cost(a: &Bvh2Node, b: &Bvh2Node) -> f32 {
    a.aabb().union(b.aabb()).half_area()
}

/// For each box the better of the one before and the one behind.
fn next_partners(boxes: &[Bvh2Node], partners: &mut Vec<usize>) {
    partners.clear();
    let mut before = f32::INFINITY;
    for (at, pair) in boxes.windows(2).enumerate() {
        let behind = cost(&pair[0], &pair[1]);
        partners.push(if before < behind { at - 1 } else { at + 1 });
        before = behind;
    }
    partners.push(boxes.len() - 2);
}

/// For each box the best of those within [`REACH`], the last of equals.
fn best_partners(boxes: &[Bvh2Node], partners: &mut Vec<usize>) {
    partners.resize(boxes.len(), 0);
    let parts = partners.chunks_mut(TOGETHER);
    parallel::over(parts, |k, part| best_of(boxes, k * TOGETHER, part));
}

/// The same for the boxes from the `first` on.
fn best_of(boxes: &[Bvh2Node], first: usize, partners: &mut [usize]) {
    // Costs of the pairs of each recent box with those behind it.
    let mut recent = [[0.0_f32; REACH]; REACH];
    let begin = first.saturating_sub(REACH);
    for (at, own) in boxes[..first + partners.len()]
        .iter()
        .enumerate()
        .skip(begin)
    {
        let (mut best, mut least) = (at, f32::INFINITY);
        for other in at.saturating_sub(REACH).max(begin)..at {
            let cost = recent[other % REACH][at % REACH];
            if cost <= least {
                (best, least) = (other, cost);
            }
        }
        for other in at + 1..(at + REACH + 1).min(boxes.len()) {
            let cost = cost(own, &boxes[other]);
            recent[at % REACH][other % REACH] = cost;
            if cost <= least {
                (best, least) = (other, cost);
            }
        }
        if let Some(at) = at.checked_sub(first) {
            partners[at] = best;
        }
    }
}

/// Fills `nodes`, which have room for just that, with a hierarchy of clusters. Each set is halved by what gives the
/// least area: the place of the centres along an axis, or the size.
fn halve(nodes: &mut [Bvh2Node], clusters: &mut [Bvh2Node]) {
    let around = |set: &[Bvh2Node]| set.iter().fold(Aabb::empty(), |sum, c| sum.union(c.aabb()));
    let mut open = vec![(0, 0..clusters.len())];
    let mut next = 1;
    while let Some((at, range)) = open.pop() {
        let set = &mut clusters[range.clone()];
        let half = match *set {
            [] => continue,
            [only] => {
                nodes[at] = only;
                continue;
            }
            _ => set.len() / 2,
        };
        let mut split = |axis: usize| {
            let key = |c: &Bvh2Node| match axis {
                3 => c.aabb().half_area(),
                _ => c.aabb().center()[axis],
            };
            set.select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)));
            let (low, high) = set.split_at(half);
            let weighted = |set: &[Bvh2Node]| around(set).half_area() * set.len() as f32;
            weighted(low) + weighted(high)
        };
        let costs = [0, 1, 2, 3].map(&mut split);
        let best = (0..4).min_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        split(best.unwrap_or(0));
        nodes[at] = Bvh2Node::new(around(set), 0, next as u32);
        open.push((next, range.start..range.start + half));
        open.push((next + 1, range.start + half..range.end));
        next += 2;
    }
}

/// The children of a node that is no leaf.
pub(super) fn children(node: &Bvh2Node) -> [usize; 2] {
    let first = node.first_index as usize;
    [first, first + 1]
}

/// Nodes with nothing but each other above them, parents before children, and those below them with their levels, which
/// several threads may go on from.
pub(super) fn parts(nodes: &[Bvh2Node]) -> (Vec<usize>, Vec<(usize, usize)>) {
    let (mut top, mut below) = (Vec::new(), VecDeque::from([(0, 1)]));
    let most = if nodes.len() < MANY_NODES { 1 } else { PARTS };
    // Leaves at the end of the list are parts as well.
    let mut leaves = Vec::new();
    while below.len() < most
        && let Some((at, level)) = below.pop_front()
    {
        if nodes[at].is_leaf() {
            leaves.push((at, level));
        } else {
            top.push(at);
            below.extend(children(&nodes[at]).map(|c| (c, level + 1)));
        }
    }
    leaves.extend(below);
    (top, leaves)
}

/// Number of levels of a binary hierarchy.
fn levels(tree: &Bvh2) -> usize {
    if tree.nodes.is_empty() {
        return 0;
    }
    let (_, parts) = parts(&tree.nodes);
    let deepest = parallel::map(parts.len(), |k| {
        let mut open = vec![parts[k]];
        let mut deepest = 0;
        while let Some((at, level)) = open.pop() {
            deepest = deepest.max(level);
            let node = &tree.nodes[at];
            if !node.is_leaf() {
                open.extend(children(node).map(|c| (c, level + 1)));
            }
        }
        deepest
    });
    deepest.into_iter().max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use obvhs::BvhBuildParams;
    use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
    use obvhs::ploc::PlocBuilder;

    fn boxes(n: usize, of: impl Fn(usize) -> [[f32; 3]; 2]) -> Vec<Aabb> {
        let made = |i| {
            let [low, high] = of(i);
            Aabb::new(low.into(), high.into())
        };
        (0..n).map(made).collect()
    }

    /// Some number in [0, 1) for every `i`.
    fn scattered(i: usize) -> f32 {
        (i as f32 * 0.754_877_7).fract()
    }

    #[test]
    fn ordinary_sets_are_clustered_as_by_the_crate() {
        let width = 60;
        let grid = boxes(width * width, |i| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            [[x, y, 0.0], [x + 1.0, y + 1.0, (x * 0.3).sin().abs()]]
        });
        let cloud = boxes(5000, |i| {
            let at = [i, 7 * i + 1, 13 * i + 2].map(scattered);
            [at, at.map(|x| x + 0.02 * scattered(3 * i))]
        });
        let few = boxes(3, |i| [[i as f32; 3], [i as f32 + 0.5; 3]]);
        for set in [grid, cloud, few] {
            let params = BvhBuildParams::medium_build();
            let crates = PlocBuilder::with_capacity(set.len()).build(
                params.ploc_search_distance,
                &set,
                (0..set.len() as u32).collect(),
                params.sort_precision,
                params.search_depth_threshold,
            );
            let (own, left) = clustered(&set);
            assert_eq!(left, 1);
            assert_eq!(
                format!("{:?}", own.nodes),
                format!("{:?}", crates.nodes),
                "{} boxes",
                set.len()
            );
        }
    }

    /// Sets on which rounds of clustering join next to nothing. Without a bound they take minutes.
    #[test]
    fn no_set_takes_quadratic_time() {
        let n = 100_000;
        let along = |i: usize| i as f32 / n as f32;
        let nested = boxes(n, |i| [[-1.0 - along(i); 3], [1.0 + along(i); 3]]);
        let corner = boxes(n, |i| [[0.0; 3], [1.0 + i as f32, 1.0 + i as f32, 0.0]]);
        let comb = boxes(n, |i| [[i as f32, 0.0, 0.0], [i as f32, 1e6, 1.0]]);
        let same = boxes(n, |_| [[0.0; 3], [1.0; 3]]);
        let shrinking = boxes(n, |i| {
            let half = 1.01_f32.powi(i as i32 % 2700);
            [[-half; 3], [half; 3]]
        });
        let fan = boxes(n, |i| {
            let end = (along(i) * std::f32::consts::TAU).sin_cos();
            let (x, y) = (f32::min, f32::max);
            [
                [x(end.0, 0.0), x(end.1, 0.0), 0.0],
                [y(end.0, 0.0), y(end.1, 0.0), 0.0],
            ]
        });
        for set in [nested, corner, comb, same, shrinking, fan] {
            let mut tree = hierarchy(&set);
            assert!(levels(&tree) <= MAX_DEPTH);
            tree.max_depth = MAX_DEPTH + 1;
            tree.validate(&set, false, true);
        }
    }

    /// Whatever the number of threads.
    #[test]
    fn a_hierarchy_depends_on_its_boxes_alone() {
        let set = boxes(40_000, |i| {
            // Many of the same size, on a grid of few places.
            let at = [i, 7 * i + 1, 13 * i + 2].map(|k| (8.0 * scattered(k)).floor());
            [at, at.map(|x| x + 1.0 + scattered(i).floor())]
        });
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().expect("threads");
            pool.install(|| format!("{:?}", hierarchy(&set).nodes))
        };
        let one = with(1);
        assert!(with(2) == one && with(7) == one);
    }

    /// Moving nodes makes boxes smaller, as much as the crate does it.
    #[test]
    fn reinsertions_are_worth_those_of_the_crate() {
        let cloud = boxes(20_000, |i| {
            let at = [i, 7 * i + 1, 13 * i + 2].map(scattered);
            [at, at.map(|x| x + 0.1 * scattered(3 * i).powi(4))]
        });
        let area = |tree: &Bvh2| -> f64 {
            let inner = tree.nodes.iter().filter(|n| !n.is_leaf());
            inner.map(|n| f64::from(n.aabb().half_area())).sum()
        };
        let (start, _) = clustered(&cloud);
        let (mut own, mut crates) = (start.clone(), start.clone());
        reinsert(&mut own);
        ReinsertionOptimizer::default().run(&mut crates, REINSERTED, None);
        own.validate(&cloud, false, true);
        let [start, own, crates] = [&start, &own, &crates].map(area);
        assert!(
            own < 0.99 * start && own < 1.002 * crates,
            "{start} {own} {crates}"
        );
    }

    #[test]
    fn empty_sets_have_no_nodes() {
        assert!(hierarchy(&[]).nodes.is_empty());
        assert_eq!(
            hierarchy(&boxes(1, |_| [[0.0; 3], [1.0; 3]])).nodes.len(),
            1
        );
    }
}
