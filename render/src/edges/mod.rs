//! Edges: where one surface ends before another, or two meet at an angle.
//!
//! What a point sees jumps across them, so that the derivative of an integral over directions has a term along every
//! outline that moves. [`Edges`] knows those of all shapes: the sides of flat faces, welded where their corners are at the
//! same place, and rims and outlines of curved shapes in closed form. Where an edge is an outline follows from the
//! directions into its faces alone: all of them are on one side of the plane through the point of view and the edge. No
//! orientation of faces is asked for, so that it holds for open, flat and badly wound meshes as well.
//!
//! An [`EdgePoint`] is a point on an outline as seen from somewhere. Outlines on the film are in [`film`]; for all other
//! points of view, [`Edges::draw`] chooses in a tree over all edges.

pub(crate) mod crossing;
mod eye;
pub(crate) mod film;
mod projection;
mod topology;
mod tree;
mod turn;

use std::collections::HashMap;

use ad_core::{Float, Vec2, Vec3};

pub(crate) use eye::Eye;
pub(crate) use tree::{Dice, Seeker};

use crate::accel::{Hit, SEAM};
use crate::math::Ray;
use crate::params::Theta;
use crate::shape::{AnyShape, Shape, SurfaceCoordinates, lift3};
use topology::Topology;
use tree::Tree;
use turn::Turn;

/// How far inside of its outline a curved surface is looked at, as the cosine to its normal; and how far inside of its
/// sides a flat one, as a part of the way to its middle, at least: where an edge is seen, so is the surface, on the side of
/// the viewer.
const INSIDE: f64 = 1e-4;
/// How far inside of its sides a flat surface is looked at, at least, relative to its size: neighbours overlap by their
/// seam, and hide light there.
const BEYOND_SEAM: f64 = 32.0 * SEAM as f64;
/// At most so far to its middle.
const MIDDLE: f64 = 0.25;

/// A face that ends at an edge.
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Primitive of the shape.
    local: u32,
    /// The side: from this corner to the next one.
    side: u8,
    /// How many sides there are.
    sides: u8,
    /// Whether it runs from the end of the edge to its start.
    reversed: bool,
    /// How far inside it is looked at, as a part of the way to its middle.
    inside: f32,
}

/// A straight edge.
#[derive(Clone, Copy, Debug)]
struct Edge {
    shape: u32,
    end_points: [[f32; 3]; 2],
    /// Unit vectors in the faces, at right angles to the edge; zero where there is none.
    into: [[f32; 3]; 2],
    faces: [Face; 2],
    /// Whether there is one face only.
    border: bool,
    /// What a curve on the film counts beside others where both faces are seen: one if normals or textures jump; where
    /// normals are interpolated, the angle between the faces, since each hides light from itself; otherwise zero.
    jump: f32,
    /// How far beyond it faces are met by rays that come from nearby, at most.
    seam: f32,
}

/// What a curve is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CurveKind {
    /// The outline of a sphere.
    Ball,
    /// The rim of a disk.
    Disk,
    /// One of the two outlines of a tube.
    Tube(u8),
    /// The rim of a tube, at the end of its axis or not.
    End(bool),
}

/// An edge of a curved shape, over a parameter in [0, 1].
#[derive(Clone, Copy, Debug)]
struct Curve {
    shape: u32,
    kind: CurveKind,
    /// Centre; the foot of the axis of a tube.
    origin: Vec3<f64>,
    /// Half axes of rims; the axis of a tube.
    axes: [Vec3<f64>; 2],
    /// From the rim of a tube along its axis; zero for all others.
    into: Vec3<f64>,
    radius: f64,
}

/// Where on its shape a point of an edge is.
#[derive(Clone, Copy, Debug)]
enum Spot {
    /// At these coordinates of a primitive.
    At(u32, [f64; 2]),
    /// Where a curved surface has this outward normal.
    Normal(Vec3<f64>),
    /// Where a primitive is next to the point.
    Near(u32),
}

/// A point of a surface just inside of an edge.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inside {
    spot: Spot,
    /// World space, where that is not part of the spot.
    p: Vec3<f64>,
    /// What meets it at a straight edge.
    pub beside: Option<Beside>,
}

/// The face on the other side of a straight edge. Points inside of the edge are so near to it that the seam by which it is
/// met beyond its sides would hide light from them that only grazes their own face.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Beside {
    /// Primitive of the shape.
    pub local: u32,
    /// Unit vectors at right angles to the edge: into the own face, and into this one.
    into: [Vec3<f64>; 2],
}

impl Beside {
    /// Whether a ray from the own face meets this one in the limit of a point on the edge.
    pub fn is_met(&self, d: Vec3<f64>) -> bool {
        let [own, other] = self.into;
        let around = own.cross(other);
        own.cross(d).dot(around) > 0.0 && other.cross(d).dot(around) > 0.0
    }
}

/// A point of a curve as seen from somewhere.
struct Rim {
    p: Vec3<f64>,
    /// The change of the point with the parameter.
    tangent: Vec3<f64>,
    /// From the edge into the occluder.
    into: Vec3<f64>,
    spot: Spot,
}

/// Faces on both sides of an edge, as seen from somewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
enum View {
    /// All faces are on one side, of which this one is in front.
    Outline(usize),
    /// The first face and the second one are on different sides, and what is seen jumps.
    Crease,
}

/// A point on an outline, seen from a point of view.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgePoint {
    /// World space.
    pub p: Vec3<f64>,
    /// Unit direction from where it is seen.
    pub direction: Vec3<f64>,
    /// Distance from there.
    pub distance: f64,
    /// Unit vector at right angles to the direction and the edge, out of the occluder.
    pub normal: Vec3<f64>,
    /// The length of the outline over the distance, in radians if it is seen from a point, over the density.
    pub weight: f64,
    /// How far beyond the edge faces are met by rays that come from nearby, at most.
    pub seam: f64,
    /// Shape and its primitive that the point belongs to.
    pub shape: u32,
    spot: Spot,
}

/// What surfaces there are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surfaces<'a> {
    /// All shapes.
    pub shapes: &'a [AnyShape],
    /// The first primitive of each.
    pub firsts: &'a [u32],
}

impl Inside {
    /// World space, of points beside lines.
    pub fn p(&self) -> Vec3<f64> {
        self.p
    }
}

impl Surfaces<'_> {
    /// Where the material of a point on an edge is: a primitive of the scene, and its coordinates.
    pub fn material<P: Float>(&self, edge: &EdgePoint) -> (u32, SurfaceCoordinates<P>) {
        self.place(edge.shape, edge.spot, edge.p)
    }

    fn place<P: Float>(
        &self,
        shape: u32,
        spot: Spot,
        p: Vec3<f64>,
    ) -> (u32, SurfaceCoordinates<P>) {
        let (local, [u, v]) = self.resolve(shape, spot, p);
        let at = Vec2::new(P::of(u), P::of(v));
        (self.firsts[shape as usize] + local, SurfaceCoordinates(at))
    }

    fn resolve(&self, shape: u32, spot: Spot, p: Vec3<f64>) -> (u32, [f64; 2]) {
        let normal = match spot {
            Spot::At(local, at) => return (local, at),
            Spot::Near(local) => return (local, self.nearest(shape, local, p)),
            Spot::Normal(normal) => normal,
        };
        // Seen from close above, whatever its axes are.
        let shape = &self.shapes[shape as usize];
        let height = f64::from(shape.extent()).max(f64::MIN_POSITIVE) * 1e-3;
        let ray = Ray::new(p + normal * height, -normal);
        let hit = Hit {
            t: height as f32,
            u: 0.0,
            v: 0.0,
            prim: 0,
        };
        let si = shape.interaction(&Theta::still(), 0, &ray, &hit);
        (0, shape.coordinates(0, &si).0.to_array())
    }
}

impl Face {
    /// The coordinates of a point of the edge, at a part of its length, and of one that lies a little inside.
    fn at(&self, part: f64) -> [[f64; 2]; 2] {
        let n = usize::from(self.sides);
        let k = usize::from(self.side);
        let [a, b] = [k, k + 1].map(|k| topology::corner(n, k));
        let part = if self.reversed { 1.0 - part } else { part };
        let middle = if n == 3 { 1.0 / 3.0 } else { 0.5 };
        let on = [0, 1].map(|i: usize| a[i] + part * (b[i] - a[i]));
        [on, on.map(|x| x + f64::from(self.inside) * (middle - x))]
    }
}

impl Edge {
    fn start(&self) -> Vec3<f64> {
        lift3(self.end_points[0])
    }

    fn along(&self) -> Vec3<f64> {
        lift3::<f64>(self.end_points[1]) - self.start()
    }

    /// The point at a part of its length, of one of its faces.
    fn rim(&self, part: f64, face: usize) -> Rim {
        let Face { local, .. } = self.faces[face];
        Rim {
            p: self.start() + self.along() * part,
            tangent: self.along(),
            into: lift3(self.into[face]),
            spot: Spot::At(local, self.faces[face].at(part)[0]),
        }
    }

    /// What the faces look like to an eye, and the unit vector at right angles to what sees the edge: out of the first
    /// face. `None` if nothing jumps, or the edge is seen as a point.
    fn view(&self, eye: &Eye, more: &[[f32; 3]]) -> Option<(View, Vec3<f64>)> {
        let to = eye.to(self.start());
        let plane = to.cross(self.along());
        let plane = (plane.length_squared() > 0.0).then(|| plane.normalize())?;
        let [m, m2] = self.into.map(lift3::<f64>);
        let side = plane.dot(m);
        let normal = if side > 0.0 { -plane } else { plane };
        if self.border {
            return Some((View::Outline(0), normal));
        }
        let side2 = plane.dot(m2);
        let inside = |side2: f64| (side2 > 0.0) == (side > 0.0);
        let all = inside(side2) && more.iter().all(|m| inside(plane.dot(lift3(*m))));
        if !all {
            return (self.jump > 0.0).then_some((View::Crease, normal));
        }
        // The face in front rises less behind the edge.
        let d = (to + eye.change(self.along() * 0.5)).normalize();
        let slope = |m: Vec3<f64>, side: f64| m.dot(d) / side.abs();
        let front = usize::from(slope(m2, side2) < slope(m, side));
        Some((View::Outline(front), normal))
    }
}

impl Curve {
    /// The point with parameter `s`, as far as an eye sees it as an outline.
    fn rim(&self, s: f64, eye: &Eye) -> Option<Rim> {
        let (sin, cos) = (std::f64::consts::TAU * s).sin_cos();
        let [e1, e2] = self.axes;
        let turn = std::f64::consts::TAU;
        match self.kind {
            CurveKind::Disk => {
                let out = e1 * cos + e2 * sin;
                Some(Rim {
                    p: self.origin + out,
                    tangent: (e2 * cos - e1 * sin) * turn,
                    into: -out,
                    spot: Spot::At(0, [cos, sin]),
                })
            }
            CurveKind::End(top) => Some(Rim {
                p: self.origin + e1 * cos + e2 * sin,
                tangent: (e2 * cos - e1 * sin) * turn,
                into: self.into,
                spot: Spot::At(0, [s, if top { 1.0 } else { 0.0 }]),
            }),
            CurveKind::Ball => {
                let (axis, sine) = self.outside(eye, -eye.to(self.origin))?;
                let frame = eye.frame(axis, self.origin);
                let cosine = (1.0 - sine * sine).sqrt();
                let out = axis * sine + (frame.s * cos + frame.t * sin) * cosine;
                Some(Rim {
                    p: self.origin + out * self.radius,
                    tangent: (frame.t * cos - frame.s * sin) * (cosine * self.radius * turn),
                    into: -out,
                    spot: Spot::Normal(out),
                })
            }
            CurveKind::Tube(side) => {
                let axis = e1.normalize();
                let to = -eye.to(self.origin);
                let (across, sine) = self.outside(eye, to - axis * axis.dot(to))?;
                let cosine = (1.0 - sine * sine).sqrt();
                let sign = if side == 0 { 1.0 } else { -1.0 };
                let out = across * sine + axis.cross(across) * (cosine * sign);
                Some(Rim {
                    p: self.origin + e1 * s + out * self.radius,
                    tangent: e1,
                    into: -out,
                    spot: Spot::Normal(out),
                })
            }
        }
    }

    /// Unit vector and radius over distance; `None` inside, where rounding counts as such, and along the axis of a tube.
    fn outside(&self, eye: &Eye, to: Vec3<f64>) -> Option<(Vec3<f64>, f64)> {
        let distance = to.length();
        let sine = eye.sine(self.radius, distance);
        (sine < 1.0 - 1e-5 && distance > 1e-9).then(|| (to.normalize(), sine))
    }

    /// How long it is.
    fn length(&self) -> f64 {
        match self.kind {
            CurveKind::Tube(_) => self.axes[0].length(),
            _ => std::f64::consts::TAU * self.radius,
        }
    }
}

impl Rim {
    /// As an eye sees it, with the derivative of the direction by the parameter: across parallel rays, how far it moves over
    /// the distance. `None` where it is seen end on.
    fn seen(&self, eye: &Eye, shape: u32) -> Option<(EdgePoint, f64)> {
        let (direction, distance) = eye.sight(self.p);
        let across = direction.cross(self.tangent);
        let speed = across.length() / distance;
        if !(speed > 0.0 && speed.is_finite()) {
            return None;
        }
        let plane = across.normalize();
        let normal = if plane.dot(self.into) > 0.0 {
            -plane
        } else {
            plane
        };
        let point = EdgePoint {
            p: self.p,
            direction,
            distance,
            normal,
            weight: 0.0,
            seam: 0.0,
            shape,
            spot: self.spot,
        };
        Some((point, speed))
    }

    /// As an eye sees it where its parameter is drawn uniformly.
    fn drawn(&self, eye: &Eye, shape: u32) -> Option<EdgePoint> {
        let (point, weight) = self.seen(eye, shape)?;
        Some(EdgePoint { weight, ..point })
    }
}

fn single(v: Vec3<f64>) -> [f32; 3] {
    v.to_array().map(|x| x as f32)
}

/// All edges of a scene.
#[derive(Debug)]
pub(crate) struct Edges {
    straight: Vec<Edge>,
    more: HashMap<u32, Vec<[f32; 3]>>,
    curves: Vec<Curve>,
    turns: Vec<Turn>,
    tree: Tree,
}

impl Edges {
    /// Those of shapes as they are.
    pub fn of(shapes: &[AnyShape]) -> Self {
        let Topology {
            straight,
            more,
            curves,
            turns,
        } = Topology::of(shapes);
        let tree = Tree::of(&straight, &more, &curves);
        Self {
            straight,
            more,
            curves,
            turns,
            tree,
        }
    }

    /// Whether any faces have other normals than their own.
    pub fn has_turns(&self) -> bool {
        !self.turns.is_empty()
    }

    fn more(&self, edge: usize) -> &[[f32; 3]] {
        (self.more.get(&(edge as u32))).map_or(&[], |m| &m[..])
    }

    /// What faces of a straight edge look like.
    fn view(&self, edge: usize, eye: &Eye) -> Option<(View, Vec3<f64>)> {
        let more = if self.more.is_empty() {
            &[]
        } else {
            self.more(edge)
        };
        self.straight[edge].view(eye, more)
    }

    /// Straight edges across which what `x` sees may jump, outlines and creases, hidden or not: shape, primitive of the shape,
    /// ends.
    pub fn straight_jumps(&self, x: Vec3<f64>) -> impl Iterator<Item = (u32, u32, [Vec3<f64>; 2])> {
        let (sides, eye) = (self.straight.iter().enumerate(), Eye::point(x));
        sides.filter_map(move |(i, e)| {
            let front = match self.view(i, &eye)?.0 {
                View::Outline(front) => front,
                View::Crease => 0,
            };
            let end_points = [e.start(), e.start() + e.along()];
            Some((e.shape, e.faces[front].local, end_points))
        })
    }

    /// Spheres: shape, centre, radius.
    pub fn balls(&self) -> impl Iterator<Item = (u32, Vec3<f64>, f64)> {
        let balls = self.curves.iter().filter(|c| c.kind == CurveKind::Ball);
        balls.map(|c| (c.shape, c.origin, c.radius))
    }
}
