//! Which flat primitives lie on the same plane.
//!
//! A ray that leaves a plane cannot meet it again, and a point on it is not hidden by what lies on it: that holds for
//! all primitives of the plane, and is known where distances of a few roundings are not.

use super::{Primitive, bounds};
use crate::math::each;
use crate::parallel;
use smallvec::SmallVec;

/// So many roundings of its coordinates lie between a point that is computed on a primitive and its plane, at most.
const ROUNDINGS: f64 = 6.0;

/// So many primitives are compared by one thread.
const COMPARED_TOGETHER: usize = 1 << 12;

/// Most primitives that one is compared with.
const MOST: usize = 256;

/// The plane of a flat primitive.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// A point.
    at: [f64; 3],
    /// Unit normal along `e1 x e2`.
    pub normal: [f64; 3],
    /// Points whose hull is the primitive, or contains it.
    corners: [[f64; 3]; 4],
    /// Largest absolute coordinates of these.
    reach: [f64; 3],
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn sum(a: [f64; 3], s: f64, b: [f64; 3]) -> [f64; 3] {
    each([0, 1, 2], |k: usize| a[k] + s * b[k])
}

/// How far the rounding of numbers up to `reach` may move a point along a normal, relative to [`f32::EPSILON`].
pub(crate) fn scale(normal: [f64; 3], reach: [f64; 3]) -> f64 {
    0.5 * f64::from(f32::EPSILON) * dot(each(normal, f64::abs), reach)
}

impl Plane {
    /// `None` for curved primitives and those without area.
    pub fn of(p: &Primitive) -> Option<Self> {
        let (at, e1, e2) = match *p {
            Primitive::Triangle { v0, e1, e2 } | Primitive::Parallelogram { v0, e1, e2 } => {
                (v0, e1, e2)
            }
            Primitive::Disk { center, e1, e2 } => (center, e1, e2),
            Primitive::Sphere { .. }
            | Primitive::Cylinder { .. }
            | Primitive::Cone { .. }
            | Primitive::Span { .. } => return None,
        };
        let [at, a, b] = each([at, e1, e2], |x| each(x, f64::from));
        let normal = cross(a, b);
        let length = dot(normal, normal).sqrt();
        if !(length > 0.0 && length.is_finite()) {
            return None;
        }
        let corners = match p {
            Primitive::Triangle { .. } => [at, at, sum(at, 1.0, a), sum(at, 1.0, b)],
            Primitive::Disk { .. } => [
                sum(at, 1.0, a),
                sum(at, -1.0, a),
                sum(at, 1.0, b),
                sum(at, -1.0, b),
            ],
            _ => {
                let far = sum(at, 1.0, a);
                [at, far, sum(at, 1.0, b), sum(far, 1.0, b)]
            }
        };
        Some(Self::new(at, each(normal, |x| x / length), corners))
    }

    /// Through a point.
    fn new(at: [f64; 3], normal: [f64; 3], corners: [[f64; 3]; 4]) -> Self {
        let reach = |k: usize| corners.iter().fold(0.0, |m: f64, c| m.max(c[k].abs()));
        Self {
            at,
            normal,
            corners,
            reach: [reach(0), reach(1), reach(2)],
        }
    }

    /// How far rays start off: beyond the rounding of points on it.
    pub fn offset(&self) -> f32 {
        self.apart() as f32
    }

    /// How far apart planes may be that are one to rays, up to what double precision makes of right angles.
    pub fn apart(&self) -> f64 {
        ROUNDINGS * scale(self.normal, self.reach)
    }

    /// Whether all of `other` lies on this plane up to rounding.
    fn holds(&self, other: &Self) -> bool {
        let reach = each([0, 1, 2], |k: usize| self.reach[k].max(other.reach[k]));
        // What double precision makes of right angles.
        let exact = 1e-14 * (reach[0] + reach[1] + reach[2]);
        let near = ROUNDINGS * scale(self.normal, reach) + exact;
        let off = |c: &[f64; 3]| dot(self.normal, sum(*c, -1.0, self.at)).abs();
        other.corners.iter().all(|c| off(c) <= near)
    }

    /// Whether both are the same plane where they meet: the smaller says little about the larger.
    fn is(&self, other: &Self) -> bool {
        self.holds(other) || other.holds(self)
    }

    /// Whether both are in each other's way, seen along the normal: by more than roundings.
    fn covers(&self, other: &Self) -> bool {
        let reach = |p: &Self| p.reach[0] + p.reach[1] + p.reach[2];
        let least = ROUNDINGS * f64::from(f32::EPSILON) * reach(self).max(reach(other));
        let sides = |p: &Self| [1, 2].map(|k: usize| sum(p.corners[k], -1.0, p.corners[0]));
        sides(self).into_iter().chain(sides(other)).all(|side| {
            let axis = cross(self.normal, side);
            let length = dot(axis, axis).sqrt();
            let range = |p: &Self| {
                let along = p.corners.map(|c| dot(sum(c, -1.0, self.at), axis));
                along
                    .into_iter()
                    .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| {
                        [low.min(x), high.max(x)]
                    })
            };
            let ([a, b], [c, d]) = (range(self), range(other));
            b.min(d) - a.max(c) > least * length
        })
    }

    /// A box around it and what touches it.
    fn bounds(&self) -> Bounds {
        let end = |k: usize, sign: f64| {
            let extents = self.corners.iter().map(|c| sign * c[k]);
            let end = extents.fold(f64::NEG_INFINITY, f64::max);
            (sign * (end + 4.0 * f64::from(f32::EPSILON) * self.reach[k])) as f32
        };
        [
            each([0, 1, 2], |k: usize| end(k, -1.0)),
            each([0, 1, 2], |k: usize| end(k, 1.0)),
        ]
    }
}

/// The flat pieces that primitives of one shape are: each by itself, but triangles only where a mesh is flat as a whole,
/// as the rectangles around what faces one way and the other.
pub(crate) fn sheets(prims: &[Primitive]) -> Vec<Plane> {
    let is_triangle = |p: &Primitive| matches!(p, Primitive::Triangle { .. });
    let mut sheets: Vec<_> = (prims.iter().filter(|p| !is_triangle(p)))
        .filter_map(Plane::of)
        .collect();
    let mut triangles = (prims.iter().filter(|p| is_triangle(p))).filter_map(Plane::of);
    let Some(first) = triangles.next() else {
        return sheets;
    };
    let side = sum(first.corners[2], -1.0, first.at);
    let length = dot(side, side).sqrt();
    let s = each(side, |x| x / length);
    let t = cross(first.normal, s);
    let mut sides = [[[f64::INFINITY, f64::NEG_INFINITY]; 2]; 2];
    for triangle in std::iter::once(first).chain(triangles) {
        if !first.is(&triangle) {
            return sheets;
        }
        let behind = usize::from(dot(first.normal, triangle.normal) < 0.0);
        for corner in triangle.corners {
            let off = sum(corner, -1.0, first.at);
            for (range, x) in sides[behind].iter_mut().zip([dot(off, s), dot(off, t)]) {
                *range = [range[0].min(x), range[1].max(x)];
            }
        }
    }
    let corner = |x: f64, y: f64| sum(sum(first.at, x, s), y, t);
    let seen = sides.iter().filter(|[x, _]| x[0] <= x[1]);
    sheets.extend(seen.map(|[x, y]| {
        let corners = [
            corner(x[0], y[0]),
            corner(x[1], y[0]),
            corner(x[0], y[1]),
            corner(x[1], y[1]),
        ];
        Plane::new(first.at, first.normal, corners)
    }));
    sheets
}

/// The first two of these sheets that single precision cannot tell apart where one covers the other, and of which
/// `matters` says that this matters.
pub(crate) fn layers(
    sheets: &[Plane],
    matters: impl Fn(usize, usize) -> bool,
) -> Option<[usize; 2]> {
    let boxes: Vec<_> = sheets.iter().map(Plane::bounds).collect();
    let all = Boxes::new((0..).zip(boxes.iter().copied()).collect());
    let mut found = Vec::new();
    for (i, sheet) in sheets.iter().enumerate() {
        found.clear();
        all.meeting(&boxes[i], &mut found);
        let among = found
            .iter()
            .map(|&k| k as usize)
            .filter(|&k| k > i && matters(i, k));
        let same = |k: &usize| sheet.is(&sheets[*k]) && sheet.covers(&sheets[*k]);
        if let Some(k) = among.filter(same).min() {
            return Some([i, k]);
        }
    }
    None
}

type Bounds = [[f32; 3]; 2];

fn meet(a: &Bounds, b: &Bounds) -> bool {
    (0..3).all(|k| a[0][k] <= b[1][k] && b[0][k] <= a[1][k])
}

/// Boxes in a binary tree: node `i` has the children `2 i + 1` and `2 i + 2`; the leaves are single boxes.
#[derive(Debug)]
struct Boxes {
    order: Vec<(u32, Bounds)>,
    nodes: Vec<(Bounds, [usize; 2])>,
}

impl Boxes {
    fn new(boxes: Vec<(u32, Bounds)>) -> Self {
        let n = boxes.len();
        let size = (2 * n.next_power_of_two()).saturating_sub(1);
        let mut tree = Self {
            order: boxes,
            nodes: vec![([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], [0, 0]); size],
        };
        tree.split(0, 0, n);
        tree
    }

    fn split(&mut self, node: usize, first: usize, end: usize) {
        if first == end {
            return;
        }
        let part = &mut self.order[first..end];
        let mut all = part[0].1;
        for (_, b) in &part[1..] {
            for k in 0..3 {
                all[0][k] = all[0][k].min(b[0][k]);
                all[1][k] = all[1][k].max(b[1][k]);
            }
        }
        self.nodes[node] = (all, [first, end]);
        let n = end - first;
        if n > 1 {
            let side = |k: usize| all[1][k] - all[0][k];
            let longest = (1..3).fold(0, |m, k| if side(k) > side(m) { k } else { m });
            let at = |b: &Bounds| b[0][longest] + b[1][longest];
            part.select_nth_unstable_by(n / 2, |a, b| {
                at(&a.1).total_cmp(&at(&b.1)).then(a.0.cmp(&b.0))
            });
            self.split(2 * node + 1, first, first + n / 2);
            self.split(2 * node + 2, first + n / 2, end);
        }
    }

    /// The index of every box that meets `bounds`.
    /// Not more than [`MOST`]: those that lie on top of each other are united with each other as well.
    fn meeting(&self, bounds: &Bounds, found: &mut Vec<u32>) {
        let mut open = SmallVec::<[usize; 64]>::new();
        open.push(0);
        while let Some(node) = open.pop()
            && found.len() < MOST
        {
            let Some((all, [first, end])) = self.nodes.get(node) else {
                continue;
            };
            if !meet(all, bounds) {
                continue;
            }
            match end - first {
                1 => found.push(self.order[*first].0),
                _ => open.extend([2 * node + 1, 2 * node + 2]),
            }
        }
    }
}

/// A box around a primitive that meets those of others on the same plane: up to rounding they touch.
fn grown(p: &Primitive) -> Bounds {
    let [low, high] = bounds(p);
    let more = |k: usize| 4.0 * f32::EPSILON * low[k].abs().max(high[k].abs());
    [
        each([0, 1, 2], |k: usize| low[k] - more(k)),
        each([0, 1, 2], |k: usize| high[k] + more(k)),
    ]
}

/// Flat primitives, to be asked whether others lie on their planes.
#[derive(Debug)]
pub(crate) struct Flats {
    all: Vec<Primitive>,
    boxes: Boxes,
}

impl Flats {
    /// `None` if none of them is flat.
    pub fn new(all: Vec<Primitive>) -> Option<Self> {
        let flat: Vec<_> = (all.iter().zip(0..))
            .filter(|(p, _)| Plane::of(p).is_some())
            .map(|(p, i)| (i, grown(p)))
            .collect();
        let boxes = (!flat.is_empty()).then(|| Boxes::new(flat))?;
        Some(Self { all, boxes })
    }

    /// Whether anything in a box may lie on a plane.
    pub fn meet(&self, bounds: &Bounds) -> bool {
        let mut found = Vec::new();
        self.boxes.meeting(bounds, &mut found);
        !found.is_empty()
    }

    /// Whether a primitive lies on a plane, and touches what is there.
    pub fn hold(&self, p: &Primitive) -> bool {
        let around = grown(p);
        if !meet(&self.boxes.nodes[0].0, &around) {
            return false;
        }
        let mut found = Vec::new();
        self.boxes.meeting(&around, &mut found);
        let Some(plane) = Plane::of(p) else {
            return false;
        };
        let same = |k: &u32| Plane::of(&self.all[*k as usize]).is_some_and(|p| plane.is(&p));
        found.iter().any(same)
    }
}

/// The set that `i` belongs to, by its lowest member.
fn root(sets: &mut [u32], i: u32) -> u32 {
    let mut at = i;
    while sets[at as usize] != at {
        let above = sets[sets[at as usize] as usize];
        sets[at as usize] = above;
        at = above;
    }
    at
}

/// The surface of every primitive: the index of the first one that lies on the same plane, up to a few roundings of
/// the coordinates, and touches it directly or through others. Curved primitives have surfaces of their own.
///
/// Triangles are compared with what is no triangle, and with those that `emit`: neighbours in a mesh overlap nowhere.
pub fn surfaces(prims: &[Primitive], emits: impl Fn(usize) -> bool) -> Vec<u32> {
    let mut sets: Vec<u32> = (0..prims.len() as u32).collect();
    let compared = |i: usize| match prims[i] {
        Primitive::Triangle { .. } => emits(i),
        Primitive::Parallelogram { .. } | Primitive::Disk { .. } => true,
        Primitive::Sphere { .. }
        | Primitive::Cylinder { .. }
        | Primitive::Cone { .. }
        | Primitive::Span { .. } => false,
    };
    let few: Vec<_> = (0..prims.len())
        .filter(|&i| compared(i) && Plane::of(&prims[i]).is_some())
        .map(|i| (i as u32, grown(&prims[i])))
        .collect();
    if few.is_empty() {
        return sets;
    }
    let few = Boxes::new(few);
    // What lies on the same plane, and is united in order.
    let pairs = parallel::ranges(prims.len(), COMPARED_TOGETHER, |range| {
        let (mut pairs, mut found) = (Vec::new(), Vec::new());
        for i in range {
            let around = grown(&prims[i]);
            if !meet(&few.nodes[0].0, &around) {
                continue;
            }
            found.clear();
            few.meeting(&around, &mut found);
            found.retain(|&k| k as usize != i);
            if found.is_empty() {
                continue;
            }
            let Some(plane) = Plane::of(&prims[i]) else {
                continue;
            };
            let same = |k: &u32| Plane::of(&prims[*k as usize]).is_some_and(|p| plane.is(&p));
            pairs.extend((found.iter().copied().filter(same)).map(|k| (i as u32, k)));
        }
        pairs
    });
    for (i, k) in pairs.into_iter().flatten() {
        let (a, b) = (root(&mut sets, i), root(&mut sets, k));
        sets[a.max(b) as usize] = a.min(b);
    }
    (0..prims.len() as u32)
        .map(|i| root(&mut sets, i))
        .collect()
}
