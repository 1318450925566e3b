//! A tree over edges, in which a point of view draws those that are outlines for it.

use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use ad_core::Vec3;
use smallvec::SmallVec;

use super::{Curve, CurveKind, Edge, EdgePoint, Edges, Eye, Spot, View};
use crate::emitter::Ball;
use crate::shape::lift3;

/// Edges of a leaf, at most.
const LEAF: usize = 4;
/// What a direction to edges counts at the horizon, beside one along the normal.
const LEAST_COSINE: f64 = 0.05;
/// What edges count in front of which no lamp can be, beside others.
const WITHOUT_LAMPS: f64 = 0.1;
/// How often a point of an edge is drawn where no lamp needs to be behind it.
const ANYWHERE: f64 = 0.25;

/// Edges in a ball.
#[derive(Clone, Debug)]
struct Node {
    centre: [f32; 3],
    radius: f32,
    /// Sum of their lengths.
    length: f32,
    /// All normals of their faces are as near to this one as `angle` says: more than a quarter turn if that is not known.
    axis: [f32; 3],
    angle: f32,
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
    pub low: Vec3<f64>,
    pub high: Vec3<f64>,
    pub length: f64,
    /// Normals of the faces, if they are flat.
    pub normals: Option<[Vec3<f64>; 2]>,
}

#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    /// Numbers of edges: straight ones, then curves.
    items: Vec<u32>,
}

/// The point from which outlines are looked for, and what matters there.
pub(crate) struct Seeker<'a> {
    /// The point of view.
    pub from: Vec3<f64>,
    /// Its normal; light from below counts little, if any does.
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
            let to = Vec3::from(ball.centre) - self.from;
            let distance = to.length();
            if distance <= ball.radius * 1.001 {
                return Cone {
                    axis: self.normal,
                    angle: PI,
                };
            }
            Cone {
                axis: to * distance.recip(),
                // A little more, for rounding.
                angle: (ball.radius / distance).min(1.0).asin() * 1.001,
            }
        };
        self.lamps.unwrap_or(&[]).iter().map(cone).collect()
    }
}

/// A lamp as a cone of directions.
pub(crate) struct Cone {
    axis: Vec3<f64>,
    /// Half its opening.
    angle: f64,
}

impl Tree {
    pub fn of(straight: &[Edge], more: &HashMap<u32, Vec<[f32; 3]>>, curves: &[Curve]) -> Self {
        let of_edge = |(e, edge): (&Edge, u32)| {
            let [a, b] = e.ends.map(lift3::<f64>);
            let along = b - a;
            // A pair of normals of faces that are one plane is one vector.
            let pair = [
                lift3::<f64>(e.into[0]).cross(along),
                along.cross(lift3(e.into[1])),
            ];
            Item {
                edge,
                shapes: [e.shape; 2],
                low: a.min(b),
                high: a.max(b),
                length: along.length(),
                normals: (!e.border && !more.contains_key(&edge))
                    .then(|| pair.map(|n| n.normalize())),
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
            Item {
                edge: (straight.len() + i) as u32,
                shapes: [c.shape; 2],
                low: c.origin.min(end) - reach,
                high: c.origin.max(end) + reach,
                length: c.length(),
                normals: None,
            }
        };
        Self::over(
            (straight.iter().zip(0..).map(of_edge))
                .chain(curves.iter().zip(0..).map(of_curve))
                .collect(),
        )
    }

    pub fn over(mut items: Vec<Item>) -> Self {
        let mut tree = Self::default();
        if !items.is_empty() {
            tree.nodes.reserve(items.len());
            let n = items.len();
            tree.build(&mut items, 0..n);
        }
        tree.items = items.iter().map(|i| i.edge).collect();
        tree
    }

    fn build(&mut self, items: &mut [Item], range: Range<usize>) {
        let own = &items[range.clone()];
        let low = own.iter().fold(own[0].low, |l, i| l.min(i.low));
        let high = own.iter().fold(own[0].high, |h, i| h.max(i.high));
        let centre = (low + high) * 0.5;
        let (axis, angle) = cone_of(own);
        let first = own.iter().map(|i| i.shapes[0]).min();
        let last = own.iter().map(|i| i.shapes[1]).max();
        let place = self.nodes.len();
        self.nodes.push(Node {
            centre: centre.to_array().map(|x| x as f32),
            // A little more, for rounding.
            radius: ((high - low).length() * 0.5 * (1.0 + 1e-5) + 1e-6 * centre.max_abs()) as f32,
            length: own.iter().map(|i| i.length).sum::<f64>() as f32,
            axis: axis.to_array().map(|x| x as f32),
            angle: angle as f32,
            items: range.start as u32..range.end as u32,
            second: 0,
            shapes: [first.unwrap_or(0), last.unwrap_or(0)],
        });
        if range.len() <= LEAF {
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
        let middle = range.len() / 2;
        let key = |i: &Item| i.low[longest] + i.high[longest];
        let order = |a: &Item, b: &Item| key(a).total_cmp(&key(b)).then(a.edge.cmp(&b.edge));
        items[range.clone()].select_nth_unstable_by(middle, order);
        self.build(items, range.start..range.start + middle);
        self.nodes[place].second = self.nodes.len() as u32;
        self.build(items, range.start + middle..range.end);
    }
}

/// A cone around the normals of edges: more than a quarter turn if there are edges without.
fn cone_of(items: &[Item]) -> (Vec3<f64>, f64) {
    let mut sum = Vec3::zero();
    for item in items {
        let Some(normals) = item.normals else {
            return (Vec3::zero(), PI);
        };
        // The sign of a pair is free.
        let both = normals[0] + normals[1];
        sum += if sum.dot(both) < 0.0 { -both } else { both };
    }
    if sum.length_squared() == 0.0 {
        return (Vec3::zero(), PI);
    }
    let axis = sum.normalize();
    let angle = |item: &Item| {
        let normals = item.normals.unwrap_or([axis; 2]);
        let sign = if axis.dot(normals[0] + normals[1]) < 0.0 {
            -1.0
        } else {
            1.0
        };
        normals
            .map(|n| (n.dot(axis) * sign).clamp(-1.0, 1.0).acos())
            .into_iter()
            .fold(0.0, f64::max)
    };
    let widest = items.iter().map(angle).fold(0.0, f64::max);
    (axis, widest + 1e-5)
}

impl Node {
    /// How much it may bring; zero only if nothing.
    fn importance(&self, seeker: &Seeker, lamps: &[Cone]) -> f64 {
        let to = lift3::<f64>(self.centre) - seeker.from;
        let radius = f64::from(self.radius);
        let distance = to.length();
        let near = distance <= radius;
        let spread = if near { PI } else { (radius / distance).asin() };
        let d = if near {
            seeker.normal
        } else {
            to * distance.recip()
        };
        let angle = f64::from(self.angle);
        if angle + spread < FRAC_PI_2 {
            let facing = (-d.dot(lift3(self.axis))).clamp(-1.0, 1.0).acos();
            let all = angle + spread;
            if facing + all < FRAC_PI_2 || facing - all > FRAC_PI_2 {
                return 0.0;
            }
        }
        let above = (d.dot(seeker.normal).clamp(-1.0, 1.0).acos() - spread).max(0.0);
        let cosine = above.cos().max(0.0) + LEAST_COSINE;
        let lit = |l: &Cone| d.dot(l.axis) >= (l.angle + spread + 1e-6).min(PI).cos();
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
pub(super) struct Dice(f64);

impl Dice {
    pub fn new(u: f64) -> Self {
        Self(u)
    }

    /// Which of these weights is chosen, and its probability; `None` if all are zero.
    fn choose(&mut self, weights: &[f64]) -> Option<(usize, f64)> {
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
                if !matches!(
                    self.view(item, &Eye::point(seeker.from)),
                    Some((View::Outline(_), _))
                ) {
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
        let near = (middle - seeker.from).length().max(0.5 * length);
        length / near * (seeker.interest)(shape..shape + 1)
    }

    fn draw_curve(&self, curve: usize, seeker: &Seeker, u: f64) -> Option<EdgePoint> {
        let curve = &self.curves[curve];
        let eye = Eye::point(seeker.from);
        let rim = curve.rim(u, &eye)?;
        let (mut point, speed) = rim.seen(&eye, curve.shape)?;
        point.weight = speed;
        Some(point)
    }

    fn draw_straight(
        &self,
        item: usize,
        seeker: &Seeker,
        lamps: &[Cone],
        [choice, u]: [f64; 2],
    ) -> Option<EdgePoint> {
        let edge = &self.straight[item];
        let Some((View::Outline(front), normal)) = self.view(item, &Eye::point(seeker.from)) else {
            return None;
        };
        let [a, b] = [edge.start(), edge.start() + edge.along()].map(|p| p - seeker.from);
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
                let reach = lamp.angle.min(PI).cos() / x.hypot(y);
                if lamp.angle >= FRAC_PI_2 || reach.is_nan() {
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
            distance: (p - seeker.from).length(),
            normal,
            weight: density.recip(),
            shape: edge.shape,
            spot: Spot::At(face.local, face.at(part)[0]),
        })
    }
}
