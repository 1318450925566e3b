//! Outlines, borders and creases on the film.

use std::ops::Range;

use ad_core::{Float, Vec3};

use super::crossing::{Crossings, Part, Path};
use super::{Curve, CurveKind, EdgePoint, Edges, INSIDE, Inside, Rim, Spot, Surfaces, View};
use crate::camera::Camera;
use crate::film::Film;
use crate::shape::{SurfaceCoordinates, lift3};

/// Pieces of curves are at most this long on the film, in pixels, ..
const LONGEST: f64 = 4.0;
/// .. or this often halved.
const HALVINGS: u32 = 9;
/// Nearer to the plane of the pinhole than this, relative to the distance, nothing is on the film.
const NEAR: f64 = 1e-6;

/// The camera as linear maps: its rays, and where it sees what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Projection {
    origin: Vec3<f64>,
    dx: Vec3<f64>,
    dy: Vec3<f64>,
    corner: Vec3<f64>,
    rows: [Vec3<f64>; 3],
    /// Of the matrix of the three vectors.
    determinant: f64,
}

/// Which faces meet at a point of a curve on the film.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Sides {
    /// The surface here, and whatever is behind the edge.
    Outline(Inside),
    /// This surface, and another one that the normal of the curve points to.
    Crease(Inside, Inside),
    /// The same surface on both sides of where its normals turn away, the second one where the normal of the curve points
    /// to. The cosine between the view and the unit shading normal has this slope along that, per radian.
    Turn([Inside; 2], f64, Vec3<f64>),
    /// Surfaces that cross there.
    Crossing([Part; 2]),
}

impl Sides {
    /// Primitives of the shape that have a crease in common.
    pub fn faces(&self) -> Option<[u32; 2]> {
        let Self::Crease(near, far) = self else {
            return None;
        };
        match [near.spot, far.spot] {
            [Spot::At(a, _), Spot::At(b, _)] => Some([a, b]),
            _ => None,
        }
    }
}

/// A point of a curve on the film.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FilmPoint {
    /// On the full film, in pixels.
    pub at: [f64; 2],
    /// Seen from the pinhole. Its weight takes a speed, in radians, to an area of the film in pixels, and is over the
    /// density.
    pub edge: EdgePoint,
    pub sides: Sides,
}

/// A piece of a curve on the film, in a range of its parameter.
struct Piece {
    /// Straight edges, then curves, then two for each face where normals may turn away, then lines along which surfaces
    /// cross.
    item: u32,
    span: [f64; 2],
}

/// All curves on the film that move.
pub(crate) struct FilmCurves {
    projection: Projection,
    pieces: Vec<Piece>,
    /// Running sums of their lengths.
    lengths: Vec<f64>,
}

impl Projection {
    fn of(camera: &Camera) -> Self {
        let corner: Vec3<f64> = camera.direction(0.0, 0.0);
        let dx = camera.direction(1.0, 0.0) - corner;
        let dy = camera.direction(0.0, 1.0) - corner;
        let determinant: f64 = dx.dot(dy.cross(corner));
        let scale = determinant.recip();
        Self {
            origin: camera.origin().into(),
            dx,
            dy,
            corner,
            rows: [dy.cross(corner), corner.cross(dx), dx.cross(dy)].map(|v| v * scale),
            determinant,
        }
    }

    /// The point `(x, y)` of the film and the depth, as homogeneous coordinates `(x z, y z, z)`.
    fn homogeneous(&self, v: Vec3<f64>) -> [f64; 3] {
        self.rows.map(|row| row.dot(v))
    }

    /// The area on the film, in pixels, of a unit of solid angle around this point of it.
    fn pixels_per_steradian(&self, [x, y]: [f64; 2]) -> f64 {
        let d = self.dx * x + self.dy * y + self.corner;
        d.length().powi(3) / self.determinant.abs()
    }
}

impl Edges {
    /// The curves on a film that edges of `moving` shapes draw, and lines along which pairs of shapes cross of which
    /// `moving_pair` holds.
    pub fn on_film(
        &self,
        camera: &Camera,
        film: &Film,
        moving: &dyn Fn(Range<u32>) -> bool,
        crossings: &Crossings,
        moving_pair: &dyn Fn([u32; 2]) -> bool,
    ) -> FilmCurves {
        let projection = Projection::of(camera);
        let mut curves = FilmCurves {
            projection,
            pieces: Vec::new(),
            lengths: Vec::new(),
        };
        let reach = film.reach();
        for (edge, i) in self.straight.iter().zip(0..) {
            if !moving(edge.shape..edge.shape + 1) {
                continue;
            }
            let Some((view, _)) = self.view(i, projection.origin) else {
                continue;
            };
            let share = match view {
                View::Outline(_) => 1.0,
                View::Crease => f64::from(edge.jump),
            };
            curves.straight(i as u32, edge.start(), edge.along(), reach, share);
        }
        for (curve, i) in self.curves.iter().zip(0..) {
            if !moving(curve.shape..curve.shape + 1) {
                continue;
            }
            let item = (self.straight.len() + i) as u32;
            let at = |s: f64| {
                let rim = curve.rim(s, projection.origin)?;
                Some(projection.homogeneous(rim.p - projection.origin))
            };
            for k in 0..16 {
                let span = [k, k + 1].map(|k| f64::from(k) / 16.0);
                curves.split(item, span, &at, reach, 0);
            }
        }
        let first = self.straight.len() + self.curves.len();
        for (turn, i) in self.turns.iter().zip(0..) {
            if !moving(turn.shape..turn.shape + 1) || !turn.may_turn(projection.origin) {
                continue;
            }
            for root in 0..2 {
                let at = |s: f64| {
                    let (rim, _) = turn.rim(s, root, projection.origin)?;
                    Some(projection.homogeneous(rim.p - projection.origin))
                };
                for k in 0..8 {
                    let span = [k, k + 1].map(|k| f64::from(k) / 8.0);
                    curves.split((first + 2 * i + root) as u32, span, &at, reach, 0);
                }
            }
        }
        for (line, i) in crossings.lines.iter().zip(0..) {
            if !moving_pair(line.shapes()) {
                continue;
            }
            let item = (self.before_crossings() + i) as u32;
            match line.path {
                Path::Straight { start, along } => {
                    curves.straight(item, start, along, reach, 1.0);
                }
                path => {
                    let at =
                        |s: f64| Some(projection.homogeneous(path.at(s).0 - projection.origin));
                    for k in 0..16 {
                        let span = [k, k + 1].map(|k| f64::from(k) / 16.0);
                        curves.split(item, span, &at, reach, 0);
                    }
                }
            }
        }
        curves
    }

    /// Start and direction of an item, if it is straight.
    fn segment(&self, crossings: &Crossings, item: usize) -> Option<[Vec3<f64>; 2]> {
        if let Some(edge) = self.straight.get(item) {
            return Some([edge.start(), edge.along()]);
        }
        let i = item.checked_sub(self.before_crossings())?;
        match crossings.lines[i].path {
            Path::Straight { start, along } => Some([start, along]),
            Path::Arc(..) | Path::Pierced(..) => None,
        }
    }

    /// How many items come before those.
    fn before_crossings(&self) -> usize {
        self.straight.len() + self.curves.len() + 2 * self.turns.len()
    }

    fn film_rim(
        &self,
        crossings: &Crossings,
        item: usize,
        s: f64,
        x: Vec3<f64>,
    ) -> Option<(Rim, u32, Sides)> {
        if let Some(i) = item.checked_sub(self.before_crossings()) {
            let line = &crossings.lines[i];
            let [first, _] = line.shapes();
            return Some((line.rim(s), first, Sides::Crossing(line.sides)));
        }
        let Some(edge) = self.straight.get(item) else {
            let i = item - self.straight.len();
            let Some(curve) = self.curves.get(i) else {
                return self.film_turn(i - self.curves.len(), s, x);
            };
            let rim = curve.rim(s, x)?;
            let inside = curve.inside(&rim, x);
            return Some((rim, curve.shape, Sides::Outline(inside)));
        };
        let (view, _) = self.view(item, x)?;
        let inside = |k: usize| Inside {
            spot: Spot::At(edge.faces[k].local, edge.faces[k].at(s)[1]),
            p: Vec3::zero(),
        };
        let (front, sides) = match view {
            View::Outline(k) => (k, Sides::Outline(inside(k))),
            View::Crease => (0, Sides::Crease(inside(0), inside(1))),
        };
        let face = edge.faces[front];
        let rim = Rim {
            p: edge.start() + edge.along() * s,
            tangent: edge.along(),
            into: lift3(edge.into[front]),
            spot: Spot::At(face.local, face.at(s)[0]),
        };
        Some((rim, edge.shape, sides))
    }

    fn film_turn(&self, i: usize, s: f64, x: Vec3<f64>) -> Option<(Rim, u32, Sides)> {
        let turn = &self.turns[i / 2];
        let (rim, insides) = turn.rim(s, i % 2, x)?;
        let (seen, _) = rim.seen(x, turn.shape)?;
        let Spot::At(_, at) = rim.spot else {
            return None;
        };
        let (slope, n) = turn.slope(at, seen.direction, seen.normal, seen.distance);
        let usable = slope != 0.0 && slope.is_finite();
        usable.then_some((rim, turn.shape, Sides::Turn(insides, slope, n)))
    }
}

impl Curve {
    /// Just inside of a point of the curve as `x` sees it.
    fn inside(&self, rim: &Rim, x: Vec3<f64>) -> Inside {
        let Rim { p, spot, .. } = *rim;
        let spot = match spot {
            Spot::At(local, [u, v]) if self.kind == CurveKind::Disk => {
                Spot::At(local, [u, v].map(|x| x * (1.0 - INSIDE)))
            }
            Spot::At(local, [u, v]) => Spot::At(local, [u, v + INSIDE * (0.5 - v)]),
            Spot::Near(_) => spot,
            Spot::Normal(out) => {
                let axis = self.axes[0].normalize();
                let d = (p - x).normalize();
                // Round a tube, if it is one.
                let towards = (out - (d - axis * axis.dot(d)) * INSIDE).normalize();
                let p = p + (towards - out) * self.radius;
                return Inside {
                    spot: Spot::Normal(towards),
                    p,
                };
            }
        };
        Inside { spot, p }
    }
}

/// A point of a segment.
fn between(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] + t * (b[k] - a[k]))
}

fn flat([x, y, z]: [f64; 3]) -> [f64; 2] {
    [x / z, y / z]
}

/// The part of a segment in homogeneous coordinates that is in front of the camera and within reach of the film.
fn clip(a: [f64; 3], b: [f64; 3], reach: [[f64; 2]; 2]) -> Option<[f64; 2]> {
    let near = NEAR * a.iter().chain(&b).fold(0.0, |m: f64, x| m.max(x.abs()))
        / reach.iter().flatten().fold(1.0, |m: f64, x| m.max(x.abs()));
    let inside: [&dyn Fn([f64; 3]) -> f64; 5] = [
        &|p| p[2] - near,
        &|p| p[0] - reach[0][0] * p[2],
        &|p| reach[0][1] * p[2] - p[0],
        &|p| p[1] - reach[1][0] * p[2],
        &|p| reach[1][1] * p[2] - p[1],
    ];
    let mut span = [0.0f64, 1.0];
    for f in inside {
        let (x, y) = (f(a), f(b));
        if x < 0.0 && y < 0.0 {
            return None;
        }
        let cut = x / (x - y);
        if x < 0.0 {
            span[0] = span[0].max(cut);
        } else if y < 0.0 {
            span[1] = span[1].min(cut);
        }
    }
    (span[0] < span[1]).then_some(span)
}

impl FilmCurves {
    fn push(&mut self, item: u32, span: [f64; 2], length: f64) {
        if length > 0.0 && length.is_finite() {
            self.pieces.push(Piece { item, span });
            self.lengths.push(self.length() + length);
        }
    }

    fn straight(
        &mut self,
        item: u32,
        start: Vec3<f64>,
        along: Vec3<f64>,
        reach: [[f64; 2]; 2],
        share: f64,
    ) {
        let start = start - self.projection.origin;
        let [a, b] = [start, start + along].map(|p| self.projection.homogeneous(p));
        let Some(span) = clip(a, b, reach) else {
            return;
        };
        let [p, q] = span.map(|t| flat(between(a, b, t)));
        self.push(item, span, (q[0] - p[0]).hypot(q[1] - p[1]) * share);
    }

    fn split(
        &mut self,
        item: u32,
        span: [f64; 2],
        at: &dyn Fn(f64) -> Option<[f64; 3]>,
        reach: [[f64; 2]; 2],
        halvings: u32,
    ) {
        let middle = 0.5 * (span[0] + span[1]);
        let ends = [span[0], middle, span[1]].map(at);
        let mut halves = || {
            for span in [[span[0], middle], [middle, span[1]]] {
                self.split(item, span, at, reach, halvings + 1);
            }
        };
        let [Some(a), Some(m), Some(b)] = ends else {
            // Up to where it ends.
            if halvings < HALVINGS && ends.iter().any(Option::is_some) {
                halves();
            }
            return;
        };
        let points = [a, m, b];
        if points.iter().any(|p| p[2] <= 0.0) {
            if halvings < HALVINGS && points.iter().any(|p| p[2] > 0.0) {
                halves();
            }
            return;
        }
        let [p, m, q] = points.map(flat);
        let length = (m[0] - p[0]).hypot(m[1] - p[1]) + (q[0] - m[0]).hypot(q[1] - m[1]);
        let outside = (0..2).any(|k| {
            let (low, high) = (p[k].min(q[k]).min(m[k]), p[k].max(q[k]).max(m[k]));
            low - length > reach[k][1] || high + length < reach[k][0]
        });
        if outside {
            return;
        }
        if length > LONGEST && halvings < HALVINGS {
            halves();
            return;
        }
        self.push(item, span, length);
    }

    /// Length of all of them, in pixels.
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// A point in proportion to length on the film, exactly on straight edges and nearly on curves, with the weight of its
    /// exact density. `None` where a curve is seen end on.
    pub fn point(&self, edges: &Edges, crossings: &Crossings, u: f64) -> Option<FilmPoint> {
        let total = self.length();
        let along = u * total;
        let i = self
            .lengths
            .partition_point(|&l| l <= along)
            .min(self.pieces.len().checked_sub(1)?);
        let before = if i == 0 { 0.0 } else { self.lengths[i - 1] };
        let length = self.lengths[i] - before;
        let part = ((along - before) / length).clamp(0.0, 1.0);
        let Piece { item, span } = self.pieces[i];
        let x = self.projection.origin;
        let straight = edges.segment(crossings, item as usize);
        let s = match straight {
            Some([start, along]) => {
                // Uniform on the film, where depth shortens.
                let start = start - x;
                let depth = |t: f64| self.projection.rows[2].dot(start + along * t);
                let [near, far] = span.map(depth);
                let t = part * near / (part * near + (1.0 - part) * far);
                span[0] + t * (span[1] - span[0])
            }
            None => span[0] + part * (span[1] - span[0]),
        };
        let (rim, shape, sides) = edges.film_rim(crossings, item as usize, s, x)?;
        let tangent = rim.tangent;
        let (mut edge, speed) = rim.seen(x, shape)?;
        let p = self.projection.homogeneous(edge.p - x);
        let at = flat(p);
        let d = self.projection.homogeneous(tangent);
        let on_film = [0, 1].map(|k| (d[k] - at[k] * d[2]) / p[2]);
        let density = match straight {
            Some(_) => {
                let share = match sides {
                    Sides::Crease(..) => f64::from(edges.straight[item as usize].jump),
                    _ => 1.0,
                };
                on_film[0].hypot(on_film[1]) / total * share
            }
            None => length / total / (span[1] - span[0]),
        };
        edge.weight = self.projection.pixels_per_steradian(at) * speed / density;
        edge.weight
            .is_finite()
            .then_some(FilmPoint { at, edge, sides })
    }
}

impl Surfaces<'_> {
    /// The material of a surface just inside of an edge: primitive of the scene and coordinates.
    pub fn inside<P: Float>(&self, shape: u32, inside: &Inside) -> (u32, SurfaceCoordinates<P>) {
        self.place(shape, inside.spot, inside.p)
    }
}
