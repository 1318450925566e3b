//! A tree over edges, in which a point of view draws those that are outlines for it.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

use ad_core::Vec3;
use smallvec::SmallVec;

use super::{Curve, CurveKind, Edge, EdgePoint, Edges, Eye, Spot, View, single};
use crate::emitter::Ball;
use crate::parallel;
use crate::shape::lift3;

/// Edges of a leaf, at most.
const LEAF: usize = 4;
/// So many edges are sorted by one thread.
const TOGETHER: usize = 1 << 12;
/// What a direction to edges counts at the horizon, beside one along the normal.
const LEAST_COSINE: f64 = 0.05;
/// What edges count in front of which no lamp can be, beside others.
const WITHOUT_LAMPS: f64 = 0.1;
/// How often a point of an edge is drawn where no lamp needs to be behind it.
const ANYWHERE: f64 = 0.25;
/// Cones of normals tell outlines as long as the cosine of their opening is more than this: roundings are less.
const NARROW: f64 = 0.05;

/// An angle of at most a half turn, whose sums and differences take no function of it.
#[derive(Clone, Copy, Debug)]
struct Angle {
    cos: f64,
    sin: f64,
}

impl Angle {
    const HALF_TURN: Self = Self {
        cos: -1.0,
        sin: 0.0,
    };

    fn new(radians: f64) -> Self {
        if radians >= PI {
            return Self::HALF_TURN;
        }
        let (sin, cos) = radians.sin_cos();
        Self { cos, sin }
    }

    /// Of at most a quarter turn.
    fn of_sine(sin: f64) -> Self {
        let cos = (1.0 - sin * sin).max(0.0).sqrt();
        Self { cos, sin }
    }

    fn of_cosine(cos: f64) -> Self {
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        Self { cos, sin }
    }

    /// At most a half turn.
    fn plus(self, other: Self) -> Self {
        let sin = self.sin * other.cos + self.cos * other.sin;
        if sin < 0.0 {
            return Self::HALF_TURN;
        }
        let cos = self.cos * other.cos - self.sin * other.sin;
        Self { cos, sin }
    }

    /// At least zero.
    fn minus(self, other: Self) -> Self {
        if self.cos >= other.cos {
            return Self { cos: 1.0, sin: 0.0 };
        }
        let cos = self.cos * other.cos + self.sin * other.sin;
        let sin = self.sin * other.cos - self.cos * other.sin;
        Self { cos, sin }
    }
}

/// Edges in a ball.
#[derive(Clone, Debug)]
struct Node {
    centre: [f32; 3],
    radius: f32,
    /// Sum of their lengths.
    length: f32,
    /// All normals of their faces are as near to this one as the cosine and the sine of an angle say: more than a quarter
    /// turn if that is not known.
    axis: [f32; 3],
    angle: [f32; 2],
    /// Their places among the items.
    items: Range<u32>,
    /// The second child; the first one is the next node. Zero for leaves.
    second: u32,
    /// Shapes that they belong to: the first and the last one.
    shapes: [u32; 2],
}

/// Edges as they are sorted.
pub(super) struct Item {
    pub edge: u32,
    /// The first and the last shape that it belongs to.
    pub shapes: [u32; 2],
    low: [f32; 3],
    high: [f32; 3],
    length: f32,
    /// Normals of the faces, if they are flat.
    normals: Option<[[f32; 3]; 2]>,
}

impl Item {
    /// An edge of such a length in a box.
    pub fn new(edge: u32, shapes: [u32; 2], [low, high]: [Vec3<f64>; 2], length: f64) -> Self {
        Self {
            edge,
            shapes,
            low: single(low),
            high: single(high),
            length: length as f32,
            normals: None,
        }
    }
}

#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// Numbers of edges: straight ones, then curves.
    items: Vec<u32>,
}

/// From where outlines are looked for, and what matters there.
pub(crate) struct Seeker<'a> {
    pub eye: Eye,
    /// The normal of a point of view; light from below counts little, if any does.
    pub normal: Vec3<f64>,
    /// All that emits is in these balls; `None` if it is everywhere.
    pub lamps: Option<&'a [Ball]>,
    /// Whether nothing but what emits is seen behind the edges.
    pub lamps_only: bool,
    /// What edges of a range of shapes count: because they move, or less.
    pub interest: &'a dyn Fn(Range<u32>) -> f64,
}

impl Seeker<'_> {
    /// The lamps as they are seen from there.
    pub fn cones(&self) -> SmallVec<[Cone; 4]> {
        let cone = |ball: &Ball| {
            let (axis, distance) = self.eye.sight(ball.centre.into());
            if distance <= ball.radius * 1.001 {
                return Cone {
                    axis: self.normal,
                    angle: Angle::HALF_TURN,
                };
            }
            Cone {
                axis,
                // A little more, for rounding.
                angle: Angle::new((ball.radius / distance).min(1.0).asin() * 1.001 + 1e-6),
            }
        };
        self.lamps.unwrap_or(&[]).iter().map(cone).collect()
    }
}

/// A lamp as a cone of directions.
pub(crate) struct Cone {
    axis: Vec3<f64>,
    /// Half its opening.
    angle: Angle,
}

impl Tree {
    pub fn of(straight: &[Edge], more: &HashMap<u32, Vec<[f32; 3]>>, curves: &[Curve]) -> Self {
        let of_edge = |(e, edge): (&Edge, u32)| {
            let [a, b] = e.end_points.map(lift3::<f64>);
            let along = b - a;
            // A pair of normals of faces that are one plane is one vector.
            let pair = [
                lift3::<f64>(e.into[0]).cross(along),
                along.cross(lift3(e.into[1])),
            ];
            Item {
                normals: (!e.border && !more.contains_key(&edge))
                    .then(|| pair.map(|n| single(n.normalize()))),
                ..Item::new(edge, [e.shape; 2], [a.min(b), a.max(b)], along.length())
            }
        };
        let of_curve = |(c, i): (&Curve, usize)| {
            let reach = match c.kind {
                CurveKind::Tube(_) => Vec3::splat(c.radius),
                _ => Vec3::splat(c.radius * 1.001),
            };
            let end = match c.kind {
                CurveKind::Tube(_) => c.origin + c.axes[0],
                _ => c.origin,
            };
            let edge = (straight.len() + i) as u32;
            let around = [c.origin.min(end) - reach, c.origin.max(end) + reach];
            Item::new(edge, [c.shape; 2], around, c.length())
        };
        Self::over(
            (straight.iter().zip(0..).map(of_edge))
                .chain(curves.iter().zip(0..).map(of_curve))
                .collect(),
        )
    }

    pub fn over(mut items: Vec<Item>) -> Self {
        let mut nodes = Vec::new();
        if !items.is_empty() {
            nodes.reserve(items.len());
            grow(&mut nodes, &mut items, 0);
        }
        let items = items.iter().map(|i| i.edge).collect();
        Self { nodes, items }
    }
}

/// Adds the tree over items of which the first has this place among all of them.
fn grow(nodes: &mut Vec<Node>, items: &mut [Item], first: u32) {
    let [low, high] = (items.iter()).fold(
        [Vec3::splat(f64::INFINITY), Vec3::splat(f64::NEG_INFINITY)],
        |[low, high], i| [low.min(lift3(i.low)), high.max(lift3(i.high))],
    );
    let place = nodes.len();
    nodes.push(Node::around(items, [low, high], first));
    if items.len() <= LEAF {
        return;
    }
    let size = high - low;
    let longest = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let middle = items.len() / 2;
    let key = |i: &Item| i.low[longest] + i.high[longest];
    let order = |a: &Item, b: &Item| key(a).total_cmp(&key(b)).then(a.edge.cmp(&b.edge));
    items.select_nth_unstable_by(middle, order);
    let (low, high) = items.split_at_mut(middle);
    let after = first + middle as u32;
    if low.len() <= TOGETHER {
        grow(nodes, low, first);
        nodes[place].second = nodes.len() as u32;
        grow(nodes, high, after);
        return;
    }
    let child = |items: &mut [Item], first: u32| {
        let mut nodes = Vec::with_capacity(items.len());
        grow(&mut nodes, items, first);
        nodes
    };
    let children = parallel::both(|| child(low, first), || child(high, after));
    for (second, child) in [children.0, children.1].into_iter().enumerate() {
        let start = nodes.len() as u32;
        if second == 1 {
            nodes[place].second = start;
        }
        nodes.extend(child.into_iter().map(|mut node| {
            if node.second != 0 {
                node.second += start;
            }
            node
        }));
    }
}

/// A cone around the normals of edges: more than a quarter turn if there are edges without.
fn cone_of(items: &[Item]) -> (Vec3<f64>, Angle) {
    let mut sum = Vec3::<f64>::zero();
    for item in items {
        let Some(normals) = item.normals.map(|n| n.map(lift3)) else {
            return (Vec3::zero(), Angle::HALF_TURN);
        };
        // The sign of a pair is free.
        let both = normals[0] + normals[1];
        sum += if sum.dot(both) < 0.0 { -both } else { both };
    }
    if sum.length_squared() == 0.0 {
        return (Vec3::zero(), Angle::HALF_TURN);
    }
    let axis = sum.normalize();
    let cosine = |item: &Item| {
        let normals = item.normals.map_or([axis; 2], |n| n.map(lift3));
        let sign = if axis.dot(normals[0] + normals[1]) < 0.0 {
            -1.0
        } else {
            1.0
        };
        let cosines = normals.map(|n| n.dot(axis) * sign);
        cosines[0].min(cosines[1])
    };
    let least = items.iter().map(cosine).fold(1.0, f64::min);
    (axis, Angle::new(least.max(-1.0).acos() + 1e-5))
}

impl Node {
    /// Around items in a box, of which the first has this place among all of them.
    fn around(items: &[Item], [low, high]: [Vec3<f64>; 2], first: u32) -> Self {
        let centre = (low + high) * 0.5;
        let (axis, angle) = cone_of(items);
        let firsts = items.iter().map(|i| i.shapes[0]).min();
        let lasts = items.iter().map(|i| i.shapes[1]).max();
        Self {
            centre: single(centre),
            // A little more, for rounding.
            radius: ((high - low).length() * 0.5 * (1.0 + 1e-5) + 1e-6 * centre.max_abs()) as f32,
            length: items.iter().map(|i| f64::from(i.length)).sum::<f64>() as f32,
            axis: single(axis),
            angle: [angle.cos as f32, angle.sin as f32],
            items: first..first + items.len() as u32,
            second: 0,
            shapes: [firsts.unwrap_or(0), lasts.unwrap_or(0)],
        }
    }

    /// How much it may bring; zero only if nothing.
    fn importance(&self, seeker: &Seeker, lamps: &[Cone]) -> f64 {
        let radius = f64::from(self.radius);
        let (d, distance) = seeker.eye.sight(lift3(self.centre));
        let near = distance <= radius;
        let (d, spread) = if near {
            (seeker.normal, Angle::HALF_TURN)
        } else {
            (d, Angle::of_sine(seeker.eye.sine(radius, distance)))
        };
        let [cos, sin] = self.angle.map(f64::from);
        let around = Angle { cos, sin }.plus(spread);
        // No face is seen from one side and another one from the other.
        if around.cos > NARROW && d.dot(lift3(self.axis)).abs() > around.sin {
            return 0.0;
        }
        let above = Angle::of_cosine(d.dot(seeker.normal)).minus(spread);
        let cosine = above.cos.max(0.0) + LEAST_COSINE;
        let lit = |l: &Cone| d.dot(l.axis) >= l.angle.plus(spread).cos;
        let light = if seeker.lamps.is_none() || near || lamps.iter().any(lit) {
            1.0
        } else if seeker.lamps_only {
            0.0
        } else {
            WITHOUT_LAMPS
        };
        let moving = (seeker.interest)(self.shapes[0]..self.shapes[1] + 1);
        f64::from(self.length) / distance.max(radius) * cosine * light * moving
    }
}

/// A random number that decides more than once.
pub(crate) struct Dice(f64);

impl Dice {
    pub fn new(u: f64) -> Self {
        Self(u)
    }

    /// Which of these weights is chosen, and its probability; `None` if all are zero.
    pub fn choose(&mut self, weights: &[f64]) -> Option<(usize, f64)> {
        let total: f64 = weights.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let mut last = None;
        for (i, w) in weights.iter().enumerate() {
            let p = w / total;
            if p > 0.0 {
                last = Some((i, p));
                if self.0 < p {
                    self.0 /= p;
                    return last;
                }
                self.0 -= p;
            }
        }
        // Rounding.
        self.0 = 0.5;
        last
    }
}

impl Tree {
    /// Chooses one of its items in proportion to what it may bring, about, and says with what probability. `strip`: the solid
    /// angle of a strip along an item, zero if that brings nothing.
    pub fn choose(
        &self,
        seeker: &Seeker,
        lamps: &[Cone],
        dice: &mut Dice,
        strip: impl Fn(u32) -> f64,
    ) -> Option<(u32, f64)> {
        let mut node = 0;
        let mut p = 1.0;
        let nodes = &self.nodes;
        if nodes.is_empty() || nodes[0].importance(seeker, lamps) == 0.0 {
            return None;
        }
        while nodes[node].second != 0 {
            let children = [node + 1, nodes[node].second as usize];
            let weights = children.map(|c| nodes[c].importance(seeker, lamps));
            let (k, q) = dice.choose(&weights)?;
            p *= q;
            node = children[k];
        }
        let range = nodes[node].items.clone();
        let items = &self.items[range.start as usize..range.end as usize];
        let mut weights = [0.0; LEAF];
        for (w, &item) in weights.iter_mut().zip(items) {
            *w = strip(item);
        }
        let (k, q) = dice.choose(&weights[..items.len()])?;
        Some((items[k], p * q))
    }
}

impl Edges {
    /// Draws a point on an outline that `seeker` sees, if nothing hides it. `None` where it draws none: there may be others.
    ///
    /// # Reference
    /// The tree is that of [Li et al. 2018, section 5], in three dimensions.
    pub fn draw(&self, seeker: &Seeker, lamps: &[Cone], u: [f64; 2]) -> Option<EdgePoint> {
        let mut dice = Dice::new(u[0]);
        let strip = |item: u32| self.strip(item as usize, seeker);
        let (item, p) = self.tree.choose(seeker, lamps, &mut dice, strip)?;
        let item = item as usize;
        let mut point = match self.straight.get(item) {
            Some(_) => self.draw_straight(item, seeker, lamps, [dice.0, u[1]])?,
            None => self.draw_curve(item - self.straight.len(), seeker, u[1])?,
        };
        point.weight /= p;
        point.weight.is_finite().then_some(point)
    }

    /// About the solid angle of a strip along an edge; zero if it is no outline.
    fn strip(&self, item: usize, seeker: &Seeker) -> f64 {
        let (length, middle, shape) = match self.straight.get(item) {
            Some(edge) => {
                if !matches!(self.view(item, &seeker.eye), Some((View::Outline(_), _))) {
                    return 0.0;
                }
                let along = edge.along();
                (along.length(), edge.start() + along * 0.5, edge.shape)
            }
            None => {
                let curve = &self.curves[item - self.straight.len()];
                (curve.length(), curve.origin, curve.shape)
            }
        };
        let near = seeker.eye.sight(middle).1.max(0.5 * length);
        length / near * (seeker.interest)(shape..shape + 1)
    }

    fn draw_curve(&self, curve: usize, seeker: &Seeker, u: f64) -> Option<EdgePoint> {
        let curve = &self.curves[curve];
        curve.rim(u, &seeker.eye)?.drawn(&seeker.eye, curve.shape)
    }

    fn draw_straight(
        &self,
        item: usize,
        seeker: &Seeker,
        lamps: &[Cone],
        [choice, u]: [f64; 2],
    ) -> Option<EdgePoint> {
        let edge = &self.straight[item];
        let Some((View::Outline(front), normal)) = self.view(item, &seeker.eye) else {
            return None;
        };
        let Eye::Point { at: from, .. } = seeker.eye else {
            let point = edge.rim(u, front).drawn(&seeker.eye, edge.shape)?;
            let seam = edge.seam.into();
            return Some(EdgePoint { seam, ..point });
        };
        let [a, b] = [edge.start(), edge.start() + edge.along()].map(|p| p - from);
        let start = a.normalize();
        let plane = a.cross(b);
        let length = plane.length().atan2(a.dot(b));
        let turned = plane.normalize().cross(start);
        if length.is_nan() || length <= 0.0 {
            return None;
        }
        // Where lamps may be behind it, in radians from its start.
        let mut parts = SmallVec::<[[f64; 2]; 4]>::new();
        if seeker.lamps.is_some() {
            for lamp in lamps {
                let [x, y] = [lamp.axis.dot(start), lamp.axis.dot(turned)];
                let reach = lamp.angle.cos / x.hypot(y);
                if lamp.angle.cos <= 0.0 || reach.is_nan() {
                    parts.push([0.0, length]);
                    continue;
                }
                if reach >= 1.0 {
                    continue;
                }
                let (middle, half) = (y.atan2(x), reach.max(-1.0).acos());
                for middle in [middle, middle + TAU] {
                    let part = [(middle - half).max(0.0), (middle + half).min(length)];
                    if part[0] < part[1] {
                        parts.push(part);
                    }
                }
            }
            if parts.is_empty() && seeker.lamps_only {
                return None;
            }
        }
        let lit: f64 = parts.iter().map(|[a, b]| b - a).sum();
        let anywhere = if parts.is_empty() {
            1.0
        } else if seeker.lamps_only {
            0.0
        } else {
            ANYWHERE
        };
        let at = if choice < anywhere {
            u * length
        } else {
            let mut rest = u * lit;
            let mut at = length;
            for [a, b] in &parts {
                at = a + rest.min(b - a);
                if rest < b - a {
                    break;
                }
                rest -= b - a;
            }
            at
        };
        let covers = parts.iter().filter(|[a, b]| *a <= at && at <= *b).count() as f64;
        let towards_lamps = if lit > 0.0 {
            (1.0 - anywhere) * covers / lit
        } else {
            0.0
        };
        let density = anywhere / length + towards_lamps;
        let (sin, cos) = at.sin_cos();
        let direction = start * cos + turned * sin;
        let across = turned * cos - start * sin;
        let part = a.length() * sin / edge.along().dot(across);
        let part = if part.is_finite() {
            part.clamp(0.0, 1.0)
        } else {
            0.5
        };
        let p = edge.start() + edge.along() * part;
        let face = edge.faces[front];
        Some(EdgePoint {
            p,
            direction,
            distance: (p - from).length(),
            normal,
            weight: density.recip(),
            seam: edge.seam.into(),
            shape: edge.shape,
            spot: Spot::At(face.local, face.at(part)[0]),
        })
    }
}
