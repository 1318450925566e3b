//! Lines along which surfaces cross: depth is the same on both sides, but another surface is seen.
//!
//! Near a point of such a line there are two planes, with the normals `a` and `b`, and four halves of them, of which the two
//! are seen that are in front of the other plane. The point moves with both: with the velocities `v_a` and `v_b` of the
//! materials there, `a . v = a . v_a` and `b . v = b . v_b`. Across the line and the view, along `n = s a + t b`, it therefore
//! moves by `s a . v_a + t b . v_b`.

mod boxes;
mod contact;
mod find;
mod flat;
mod round;

use std::collections::HashMap;
use std::f64::consts::TAU;

use ad_core::Vec3;

pub(crate) use self::contact::Doubt;
use self::contact::{Guests, Side};
pub(crate) use self::find::cut_by;
use self::round::{Ellipse, Pierced};
use super::tree::{Dice, Item, Tree};
use super::{EdgePoint, INSIDE, Inside, Rim, Seeker, Spot, Surfaces};
use crate::params::Theta;
use crate::shape::{AnyShape, Shape, SurfaceCoordinates, SurfaceInteraction};

/// How far beside a line its surfaces are looked at, from the other one: relative to the distance, and to the largest
/// coordinate of both shapes.
const BESIDE: [f64; 2] = [3e-5, 4e-6];

/// A surface at a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineSide {
    pub shape: u32,
    /// Primitives of the shape, behind and in front of the other surface as its normal says: one, unless the line is a side
    /// of both.
    locals: [u32; 2],
}

/// The course of a line, over a parameter in [0, 1].
#[derive(Clone, Copy, Debug)]
pub(super) enum Path {
    Straight {
        start: Vec3<f64>,
        along: Vec3<f64>,
    },
    /// Between two parts of a turn.
    Arc(Ellipse, [f64; 2]),
    /// Between two parts of a turn around a tube.
    Pierced(Pierced, [f64; 2]),
}

/// Where two surfaces cross.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub sides: [LineSide; 2],
    pub path: Path,
}

/// What is seen beside a line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sheet {
    pub shape: u32,
    /// The point of the line.
    pub on: Inside,
    /// A point beside it that is seen.
    pub inside: Inside,
    /// The line moves across itself, along the normal of the meeting, by the velocity of the surface along this.
    pub share: Vec3<f64>,
}

/// Both surfaces at a point of a line, as seen from somewhere.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Meeting {
    /// At right angles to the line and the view, towards where the second one is seen.
    pub normal: Vec3<f64>,
    pub sheets: [Sheet; 2],
}

/// All lines of a scene.
#[derive(Debug, Default)]
pub(crate) struct Crossings {
    pub(super) lines: Vec<Line>,
    tree: Tree,
    /// Those that are sides of two faces, by shape and faces.
    bent: HashMap<(u32, [u32; 2]), Vec<Side>>,
    guests: Guests,
    doubts: Vec<(Doubt, [u32; 2])>,
}

fn ordered([a, b]: [u32; 2]) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

impl Path {
    /// A point, and how it changes with the parameter.
    pub fn at(&self, s: f64) -> (Vec3<f64>, Vec3<f64>) {
        match *self {
            Self::Straight { start, along } => (start + along * s, along),
            Self::Arc(ellipse, [from, to]) => {
                let (p, by_turn) = ellipse.at(from + (to - from) * s);
                (p, by_turn * (to - from))
            }
            Self::Pierced(curve, turns) => {
                let (turn, speed) = round::eased(turns, s);
                let (p, by_turn) = curve.at(turn);
                (p, by_turn * speed)
            }
        }
    }

    fn item(&self, edge: u32, shapes: [u32; 2]) -> Item {
        let ball = |middle: Vec3<f64>, radius: f64, [from, to]: [f64; 2]| {
            let reach = Vec3::splat(radius);
            let around = [middle - reach, middle + reach];
            (around, TAU * radius * (to - from))
        };
        let (around, length) = match *self {
            Self::Straight { start, along } => {
                let end = start + along;
                ([start.min(end), start.max(end)], along.length())
            }
            Self::Arc(ellipse, turns) => ball(ellipse.origin, ellipse.reach(), turns),
            Self::Pierced(curve, turns) => {
                let (middle, reach) = curve.ball();
                ball(middle, reach, turns)
            }
        };
        Item::new(edge, shapes, around, length)
    }
}

impl Line {
    pub fn rim(&self, s: f64) -> Rim {
        let (p, tangent) = self.path.at(s);
        Rim {
            p,
            tangent,
            // Which side is which is for a meeting to say.
            into: Vec3::zero(),
            spot: Spot::Near(self.sides[0].locals[0]),
        }
    }

    pub fn shapes(&self) -> [u32; 2] {
        self.sides.map(|side| side.shape)
    }
}

impl Crossings {
    /// Those of shapes as they are.
    pub fn of(shapes: &[AnyShape]) -> Self {
        let find::All {
            lines,
            touches,
            doubts,
        } = find::all(shapes);
        let item = |(line, i): (&Line, u32)| line.path.item(i, ordered(line.shapes()));
        let tree = Tree::over(lines.iter().zip(0..).map(item).collect());
        let mut bent: HashMap<_, Vec<_>> = HashMap::new();
        for line in &lines {
            let LineSide { shape, locals } = line.sides[0];
            if let Path::Straight { start, along } = line.path
                && locals[0] != locals[1]
            {
                let faces = (shape, ordered(locals));
                bent.entry(faces).or_default().push([start, along]);
            }
        }
        Self {
            lines,
            tree,
            bent,
            guests: Guests::of(&touches),
            doubts,
        }
    }

    /// Pairs of shapes of which it is not told how they cross, sorted by why.
    pub fn doubts(&self) -> &[(Doubt, [u32; 2])] {
        &self.doubts
    }

    /// The shapes of all lines.
    pub fn shapes(&self) -> impl Iterator<Item = [u32; 2]> {
        self.lines.iter().map(Line::shapes)
    }

    /// Whether one of two faces, at a point of the side that they have in common, is behind another surface: one that the
    /// side lies on, or one that ends there, too.
    pub fn hold(&self, faces: [u32; 2], point: &EdgePoint) -> bool {
        let lines = self.bent.get(&(point.shape, ordered(faces)));
        let bent = lines.is_some_and(|lines| {
            lines.iter().any(|&[start, along]| {
                let part = (point.p - start).dot(along) / along.length_squared();
                (0.0..=1.0).contains(&part)
            })
        });
        bent || self.guests.cover(faces, point)
    }

    /// Whether another shape, which is seen beside a point of an outline, goes on behind that: it is no outline of that shape.
    pub fn go_on(&self, point: &EdgePoint, shape: u32) -> bool {
        match point.spot {
            Spot::At(local, _) => self.guests.behind(local, point, shape),
            Spot::Normal(_) | Spot::Near(_) => false,
        }
    }

    /// Draws a point of a line, as `seeker` sees it if nothing hides it, and the surfaces that cross there. `None` where it
    /// draws none: there may be others.
    pub fn draw(&self, seeker: &Seeker, u: [f64; 2]) -> Option<(EdgePoint, [LineSide; 2])> {
        let mut dice = Dice::new(u[0]);
        let strip = |item: u32| {
            let line = &self.lines[item as usize];
            let middle = line.path.at(0.5);
            let length = middle.1.length();
            let near = seeker.eye.sight(middle.0).1.max(0.5 * length);
            let [a, b] = line.shapes().map(|i| (seeker.interest)(i..i + 1));
            length / near * (a + b)
        };
        let (item, p) = self.tree.choose(seeker, &[], &mut dice, strip)?;
        let line = &self.lines[item as usize];
        let mut point = line.rim(u[1]).drawn(&seeker.eye, line.sides[0].shape)?;
        point.weight /= p;
        point.weight.is_finite().then_some((point, line.sides))
    }
}

/// The unit normal of a primitive of a shape at a point.
fn normal(shape: &AnyShape, local: u32, p: Vec3<f64>) -> Vec3<f64> {
    let at: SurfaceCoordinates<f64> = shape.locate(local, p);
    let si: SurfaceInteraction<f64> = shape.point_at(&Theta::still(), local, at);
    si.n_geo.normalize()
}

impl Surfaces<'_> {
    fn normal(&self, shape: u32, local: u32, p: Vec3<f64>) -> Vec3<f64> {
        normal(&self.shapes[shape as usize], local, p)
    }

    /// The surfaces at a point of a line. `None` if the line is seen as a point, one of the surfaces edge on, or the line is a
    /// side of faces that are all on one side of it, which is an outline.
    pub fn meeting(&self, point: &EdgePoint, parts: [LineSide; 2]) -> Option<Meeting> {
        let EdgePoint { p, direction, .. } = *point;
        let [first, second] = parts;
        // The side of the second surface that it is seen from.
        let b = self.normal(second.shape, second.locals[0], p);
        let above = usize::from(direction.dot(b) < 0.0);
        let a = self.normal(first.shape, first.locals[above], p);
        let along = a.cross(b);
        let squared = along.length_squared();
        let across = direction.cross(along).normalize();
        // Along a surface, away from the line, in front of the other one.
        let seen = |own: Vec3<f64>, other: Vec3<f64>| {
            let m = along.cross(own).normalize();
            let in_front = m.dot(other) * direction.dot(other) < 0.0;
            if in_front { m } else { -m }
        };
        let m = [seen(a, b), seen(b, a)];
        let side = across.dot(m[1]);
        let normal = if side < 0.0 { -across } else { across };
        let apart = normal.dot(m[1]) > 0.0 && normal.dot(m[0]) < 0.0;
        if !apart {
            return None;
        }
        if first.locals[0] != first.locals[1] {
            let hidden = self.normal(first.shape, first.locals[1 - above], p);
            let behind = -seen(hidden, b);
            if normal.dot(behind) < 0.0 {
                return None;
            }
        }
        let (na, nb, c) = (normal.dot(a), normal.dot(b), a.dot(b));
        let shares = [a * ((na - c * nb) / squared), b * ((nb - c * na) / squared)];
        let extent = |part: LineSide| f64::from(self.shapes[part.shape as usize].extent());
        let scale = extent(first).max(extent(second));
        let clearance = (BESIDE[0] * point.distance).max(BESIDE[1] * scale) / squared.sqrt();
        let locals = [first.locals[above], second.locals[0]];
        let sheet = |k: usize| Sheet {
            shape: parts[k].shape,
            on: Inside {
                spot: Spot::Near(locals[k]),
                p,
                beside: None,
            },
            inside: Inside {
                spot: Spot::Near(locals[k]),
                p: p + m[k] * clearance,
                beside: None,
            },
            share: shares[k],
        };
        Some(Meeting {
            normal,
            sheets: [sheet(0), sheet(1)],
        })
    }

    /// The coordinates on a surface of the point next to one.
    pub(super) fn nearest(&self, shape: u32, local: u32, p: Vec3<f64>) -> [f64; 2] {
        let shape = &self.shapes[shape as usize];
        let at: SurfaceCoordinates<f64> = shape.locate(local, p);
        let [u, v] = at.0.to_array();
        match shape {
            AnyShape::Mesh(_) | AnyShape::Instance(_) => {
                let (u, v) = (u.max(0.0), v.max(0.0));
                let scale = (u + v).max(1.0).recip();
                [u * scale, v * scale]
            }
            AnyShape::Rectangle(_) | AnyShape::Cube(_) => [u, v].map(|x| x.clamp(0.0, 1.0)),
            AnyShape::Disk(_) => {
                let scale = (1.0 - INSIDE) / u.hypot(v).max(1.0 - INSIDE);
                [u * scale, v * scale]
            }
            AnyShape::Cylinder(_) => [u, v.clamp(0.0, 1.0)],
            AnyShape::Sphere(_) | AnyShape::Curves(_) => [u, v],
        }
    }
}

#[cfg(test)]
mod tests;
