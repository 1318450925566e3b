//! Outlines, borders and creases on the film.

use std::ops::Range;

use ad_core::{Float, Vec3};
use smallvec::SmallVec;

use super::crossing::{Crossings, LineSide, Path};
use super::projection::{Projected, Projection, flat};
use super::turn::Turn;
use super::{
    Beside, Curve, CurveKind, Edge, EdgePoint, Edges, Eye, INSIDE, Inside, Rim, Spot, Surfaces,
    View,
};
use crate::camera::Camera;
use crate::film::Film;
use crate::shape::{SurfaceCoordinates, lift3};

/// Pieces of curves are at most this long on the film, in pixels, ..
const LONGEST: f64 = 4.0;
/// .. or this often halved.
const HALVINGS: u32 = 9;
/// Nearer to the plane of the camera than this, relative to the distance, nothing is on the film.
const NEAR: f64 = 1e-6;
/// By how much lenses blur more than they do, so that rounding loses nothing.
const BLURRED: f64 = 0.01;

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
    Crossing([LineSide; 2]),
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
    /// From where it is seen.
    pub eye: Eye,
    /// Its weight takes a speed over the distance, in radians if it is seen from a point, to an area of the film in pixels,
    /// and is over the density.
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

/// How a lens blurs what is not in focus.
#[derive(Clone, Copy, Debug)]
struct Blur {
    /// Its radius, in units of the scene.
    radius: f64,
    /// The depth of what it sees sharply, ..
    focus: f64,
    /// .. and how far what is at infinity is moved along both axes of the film, times the depth of focus.
    spread: [f64; 2],
}

/// All curves on the film that move, wherever on its lens a camera sees them from.
///
/// What is drawn is a piece of a curve and a point of it, neither of which depends on the place on the lens. On which film
/// that is seen, and whether it is a curve from there at all, does: pieces are all that may be seen from any place, and
/// count as much as they are long on the film on average over a few.
pub(crate) struct FilmCurves {
    /// From the middle of the lens, and from the corners of a square around it, if there is one.
    views: SmallVec<[Projection; 5]>,
    blur: Option<Blur>,
    reach: [[f64; 2]; 2],
    pieces: Vec<Piece>,
    /// Running sums of their lengths.
    lengths: Vec<f64>,
}

impl Blur {
    /// How far a point is moved along both axes at most, times its depth. Linear in the point on both sides of the focus.
    fn margin(&self, p: Projected) -> [f64; 2] {
        let depth = p[2] / self.focus;
        let most = (1.0 + BLURRED) * (depth - 1.0).abs() + BLURRED * (depth + 1.0);
        self.spread.map(|spread| spread * most)
    }
}

impl Edge {
    /// Whether the plane of a face is so near to a point: from both sides of that the edge may be seen as another one.
    fn may_turn(&self, x: Vec3<f64>, radius: f64, more: &[[f32; 3]]) -> bool {
        let to = x - self.start();
        let slack = radius + 1e-5 * to.length();
        (self.into.iter().chain(more)).any(|into| {
            let normal = self.along().cross(lift3(*into));
            normal.dot(to).abs() <= slack * normal.length()
        })
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
        let mut curves = FilmCurves::none(camera, film);
        for (edge, i) in self.straight.iter().zip(0..) {
            if moving(edge.shape..edge.shape + 1)
                && let Some(share) = self.share_on_film(i, &curves)
            {
                curves.straight(i as u32, edge.start(), edge.along(), share);
            }
        }
        for (curve, i) in self.curves.iter().zip(0..) {
            if moving(curve.shape..curve.shape + 1) {
                let item = (self.straight.len() + i) as u32;
                let at = |view: &Projection, s: f64| Some(curve.rim(s, &view.eye)?.p);
                curves.all_of(item, 16, &at);
            }
        }
        let first = self.straight.len() + self.curves.len();
        for (turn, i) in self.turns.iter().zip(0..) {
            if moving(turn.shape..turn.shape + 1) {
                curves.turn((first + 2 * i) as u32, turn);
            }
        }
        for (line, i) in crossings.lines.iter().zip(0..) {
            if !moving_pair(line.shapes()) {
                continue;
            }
            let item = (self.before_crossings() + i) as u32;
            match line.path {
                Path::Straight { start, along } => curves.straight(item, start, along, 1.0),
                path => curves.all_of(item, 16, &|_, s| Some(path.at(s).0)),
            }
        }
        curves
    }

    /// What a straight edge counts beside others of its length on the film, if it may be seen there.
    fn share_on_film(&self, i: usize, curves: &FilmCurves) -> Option<f64> {
        let edge = &self.straight[i];
        let view = &curves.views[0];
        if let Some(blur) = &curves.blur
            && edge.may_turn(view.origin(), blur.radius, self.more(i))
        {
            return Some(1.0);
        }
        match self.view(i, &view.eye)?.0 {
            View::Outline(_) => Some(1.0),
            View::Crease => Some(f64::from(edge.jump)),
        }
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
        eye: &Eye,
    ) -> Option<(Rim, u32, Sides)> {
        if let Some(i) = item.checked_sub(self.before_crossings()) {
            let line = &crossings.lines[i];
            let [first, _] = line.shapes();
            return Some((line.rim(s), first, Sides::Crossing(line.sides)));
        }
        let Some(edge) = self.straight.get(item) else {
            let i = item - self.straight.len();
            let Some(curve) = self.curves.get(i) else {
                return self.film_turn(i - self.curves.len(), s, eye);
            };
            let rim = curve.rim(s, eye)?;
            let inside = curve.inside(&rim, eye);
            return Some((rim, curve.shape, Sides::Outline(inside)));
        };
        let (view, _) = self.view(item, eye)?;
        let inside = |k: usize| Inside {
            spot: Spot::At(edge.faces[k].local, edge.faces[k].at(s)[1]),
            p: Vec3::zero(),
            beside: (!edge.border).then(|| Beside {
                local: edge.faces[1 - k].local,
                into: [k, 1 - k].map(|k| lift3(edge.into[k])),
            }),
        };
        let (front, sides) = match view {
            View::Outline(k) => (k, Sides::Outline(inside(k))),
            View::Crease => (0, Sides::Crease(inside(0), inside(1))),
        };
        Some((edge.rim(s, front), edge.shape, sides))
    }

    fn film_turn(&self, i: usize, s: f64, eye: &Eye) -> Option<(Rim, u32, Sides)> {
        let turn = &self.turns[i / 2];
        let (rim, insides) = turn.rim(s, i % 2, eye)?;
        let (seen, _) = rim.seen(eye, turn.shape)?;
        let Spot::At(_, at) = rim.spot else {
            return None;
        };
        let (slope, n) = turn.slope(at, eye, &seen);
        let usable = slope != 0.0 && slope.is_finite();
        usable.then_some((rim, turn.shape, Sides::Turn(insides, slope, n)))
    }
}

impl Curve {
    /// Just inside of a point of the curve as an eye sees it.
    fn inside(&self, rim: &Rim, eye: &Eye) -> Inside {
        let Rim { p, spot, .. } = *rim;
        let spot = match spot {
            Spot::At(local, [u, v]) if self.kind == CurveKind::Disk => {
                Spot::At(local, [u, v].map(|x| x * (1.0 - INSIDE)))
            }
            Spot::At(local, [u, v]) => Spot::At(local, [u, v + INSIDE * (0.5 - v)]),
            Spot::Near(_) => spot,
            Spot::Normal(out) => {
                let axis = self.axes[0].normalize();
                let d = eye.to(p).normalize();
                // Round a tube, if it is one.
                let towards = (out - (d - axis * axis.dot(d)) * INSIDE).normalize();
                let p = p + (towards - out) * self.radius;
                return Inside {
                    spot: Spot::Normal(towards),
                    p,
                    beside: None,
                };
            }
        };
        Inside {
            spot,
            p,
            beside: None,
        }
    }
}

/// A point of a segment.
fn between(a: Projected, b: Projected, t: f64) -> Projected {
    [0, 1, 2, 3].map(|k| a[k] + t * (b[k] - a[k]))
}

/// A box on the film.
#[derive(Clone, Copy)]
struct Extent([[f64; 2]; 2]);

impl Extent {
    fn of(points: [[f64; 2]; 3]) -> Self {
        Self([0, 1].map(|k: usize| {
            let [p, m, q] = points.map(|p| p[k]);
            [p.min(q).min(m), p.max(q).max(m)]
        }))
    }

    fn with(self, other: Self) -> Self {
        Self([0, 1].map(|k: usize| {
            let [a, b] = [self.0[k], other.0[k]];
            [a[0].min(b[0]), a[1].max(b[1])]
        }))
    }

    /// Whether it is farther from another one than this.
    fn beyond(&self, reach: [[f64; 2]; 2], by: f64) -> bool {
        let [x, y] = [0, 1].map(|k: usize| {
            let [low, high] = self.0[k];
            low - by > reach[k][1] || high + by < reach[k][0]
        });
        x || y
    }
}

/// A piece of a curve from one place.
enum Stretch {
    /// All of it, with its length.
    Whole(f64, Extent),
    /// Some of it, or its ends are not all there.
    Part,
    Nothing,
}

impl Stretch {
    fn of([a, m, b]: [Option<Projected>; 3]) -> Self {
        let any = [a, m, b].iter().any(Option::is_some);
        let (Some(a), Some(m), Some(b)) = (a, m, b) else {
            // Up to where it ends.
            return if any { Self::Part } else { Self::Nothing };
        };
        let points = [a, m, b];
        if points.iter().any(|p| p[3] <= 0.0) {
            let any = points.iter().any(|p| p[3] > 0.0);
            return if any { Self::Part } else { Self::Nothing };
        }
        let [p, m, q] = points.map(flat);
        let length = (m[0] - p[0]).hypot(m[1] - p[1]) + (q[0] - m[0]).hypot(q[1] - m[1]);
        Self::Whole(length, Extent::of([p, m, q]))
    }
}

impl FilmCurves {
    fn none(camera: &Camera, film: &Film) -> Self {
        let middle = Projection::of(camera);
        let mut views = SmallVec::from_iter([middle]);
        let blur = camera.thin_lens().map(|lens| {
            let corners = lens.corners();
            views.extend(corners.map(|off| middle.beside(camera, off)));
            Blur {
                radius: lens.radius(),
                focus: lens.depth(camera.direction(0.0, 0.0)).recip(),
                spread: middle.spread(&corners),
            }
        });
        Self {
            views,
            blur,
            reach: film.reach(),
            pieces: Vec::new(),
            lengths: Vec::new(),
        }
    }

    /// The part of a segment that is in front of the camera and within reach of the film from some place of the lens.
    fn clip(&self, a: Projected, b: Projected) -> Option<[f64; 2]> {
        let reach = self.reach;
        let near = NEAR * a.iter().chain(&b).fold(0.0, |m: f64, x| m.max(x.abs()))
            / reach.iter().flatten().fold(1.0, |m: f64, x| m.max(x.abs()));
        let margin = |p: Projected, k: usize| self.blur.map_or(0.0, |blur| blur.margin(p)[k]);
        let inside: [&dyn Fn(Projected) -> f64; 5] = [
            &|p| p[3] - near,
            &|p| p[0] - reach[0][0] * p[2] + margin(p, 0),
            &|p| reach[0][1] * p[2] - p[0] + margin(p, 0),
            &|p| p[1] - reach[1][0] * p[2] + margin(p, 1),
            &|p| reach[1][1] * p[2] - p[1] + margin(p, 1),
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

    fn push(&mut self, item: u32, span: [f64; 2], length: f64) {
        if length > 0.0 && length.is_finite() {
            self.pieces.push(Piece { item, span });
            self.lengths.push(self.length() + length);
        }
    }

    fn straight(&mut self, item: u32, start: Vec3<f64>, along: Vec3<f64>, share: f64) {
        let end_points = |view: &Projection| {
            let start = start - view.origin();
            [start, start + along].map(|p| view.seen_from_origin(p))
        };
        let [a, b] = end_points(&self.views[0]);
        // Blur grows on both sides of the focus.
        let focus = self.blur.map(|blur| (blur.focus - a[2]) / (b[2] - a[2]));
        let parts: &[[f64; 2]] = match focus {
            Some(t) if t > 0.0 && t < 1.0 => &[[0.0, t], [t, 1.0]],
            _ => &[[0.0, 1.0]],
        };
        for &[from, to] in parts {
            let [p, q] = match parts {
                [_] => [a, b],
                _ => [from, to].map(|t| between(a, b, t)),
            };
            let Some(span) = self.clip(p, q) else {
                continue;
            };
            let length = |view: &Projection| {
                let [a, b] = end_points(view);
                let span = span.map(|t| from + t * (to - from));
                let [p, q] = span.map(|t| flat(between(a, b, t)));
                (q[0] - p[0]).hypot(q[1] - p[1])
            };
            let length = self.views.iter().map(length).sum::<f64>() / self.views.len() as f64;
            let span = span.map(|t| from + t * (to - from));
            self.push(item, span, length * share);
        }
    }

    /// All of a curve, in so many pieces to begin with. `at` is where it is as it is seen.
    fn all_of(
        &mut self,
        item: u32,
        pieces: u32,
        at: &dyn Fn(&Projection, f64) -> Option<Vec3<f64>>,
    ) {
        for k in 0..pieces {
            let span = [k, k + 1].map(|k| f64::from(k) / f64::from(pieces));
            self.split(item, span, at, 0);
        }
    }

    fn split(
        &mut self,
        item: u32,
        span: [f64; 2],
        at: &dyn Fn(&Projection, f64) -> Option<Vec3<f64>>,
        halvings: u32,
    ) {
        let middle = 0.5 * (span[0] + span[1]);
        let (mut seen, mut parts, mut length) = (0, 0, 0.0);
        let mut extent: Option<Extent> = None;
        for view in &self.views {
            let points = [span[0], middle, span[1]].map(|s| at(view, s).map(|p| view.seen(p)));
            match Stretch::of(points) {
                Stretch::Whole(own, within) => {
                    seen += 1;
                    length += own;
                    extent = Some(extent.map_or(within, |e| e.with(within)));
                }
                Stretch::Part => parts += 1,
                Stretch::Nothing => {}
            }
        }
        if seen + parts == 0 {
            return;
        }
        let all = seen == self.views.len();
        let length = length / self.views.len() as f64;
        if all && extent.is_some_and(|e| e.beyond(self.reach, length)) {
            return;
        }
        if halvings < HALVINGS && (!all || length > LONGEST) {
            for span in [[span[0], middle], [middle, span[1]]] {
                self.split(item, span, at, halvings + 1);
            }
            return;
        }
        self.push(item, span, length);
    }

    /// Both parts of where the normals of a face turn away from the camera.
    fn turn(&mut self, item: u32, turn: &Turn) {
        let eye = &self.views[0].eye;
        let Some(blur) = &self.blur else {
            if turn.may_turn(eye, 0.0) {
                for root in 0..2 {
                    let at = |view: &Projection, s: f64| Some(turn.rim(s, root, &view.eye)?.0.p);
                    self.all_of(item + root as u32, 8, &at);
                }
            }
            return;
        };
        if !turn.may_turn(eye, blur.radius) {
            return;
        }
        // How parts are numbered depends on the place on the lens: all of both, wherever they are.
        let [[left, right], [top, bottom]] = self.reach;
        let most = (right - left).hypot(bottom - top);
        let mut length = 0.0;
        let mut extent: Option<Extent> = None;
        for view in &self.views {
            let corners = turn.corners.map(|c| Some(view.seen(lift3(c))));
            match Stretch::of(corners) {
                Stretch::Whole(own, within) => {
                    length += own.min(most);
                    extent = Some(extent.map_or(within, |e| e.with(within)));
                }
                Stretch::Part => {
                    length += most;
                    extent = Some(Extent(self.reach));
                }
                Stretch::Nothing => {}
            }
        }
        if extent.is_some_and(|e| !e.beyond(self.reach, 0.0)) {
            for root in 0..2 {
                self.push(item + root, [0.0, 1.0], length);
            }
        }
    }

    /// Length of all of them, in pixels.
    pub fn length(&self) -> f64 {
        self.lengths.last().copied().unwrap_or(0.0)
    }

    /// From the middle of the lens.
    pub fn middle(&self) -> &Projection {
        &self.views[0]
    }

    /// A point as it is seen from somewhere on the lens: in proportion to length on the film, exactly on straight edges and
    /// nearly on curves, with the weight of its exact density. `None` where a curve is seen end on, or not from there.
    pub fn point(
        &self,
        (edges, crossings): (&Edges, &Crossings),
        view: &Projection,
        u: f64,
    ) -> Option<FilmPoint> {
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
        let straight = edges.segment(crossings, item as usize);
        let s = match straight {
            Some([start, along]) => {
                // Uniform on the film, where depth shortens.
                let start = start - view.origin();
                let depth = |t: f64| view.seen_from_origin(start + along * t)[2];
                let [near, far] = span.map(depth);
                let t = part * near / (part * near + (1.0 - part) * far);
                span[0] + t * (span[1] - span[0])
            }
            None => span[0] + part * (span[1] - span[0]),
        };
        let (rim, shape, sides) = edges.film_rim(crossings, item as usize, s, &view.eye)?;
        let tangent = rim.tangent;
        let (mut edge, speed) = rim.seen(&view.eye, shape)?;
        let p = view.seen(edge.p);
        if p[3] <= 0.0 {
            return None;
        }
        let at = flat(p);
        let density = match straight {
            Some([start, along]) => {
                let share = match sides {
                    // What it counts, and how long it is from there.
                    _ if self.blur.is_some() => {
                        let end_points = span.map(|t| flat(view.seen(start + along * t)));
                        let [p, q] = end_points;
                        length / (q[0] - p[0]).hypot(q[1] - p[1])
                    }
                    Sides::Crease(..) => f64::from(edges.straight[item as usize].jump),
                    _ => 1.0,
                };
                view.speed(p, tangent) / total * share
            }
            None => length / total / (span[1] - span[0]),
        };
        edge.weight = view.pixels(at, edge.distance) * speed / density;
        edge.seam = (edges.straight.get(item as usize)).map_or(0.0, |e| e.seam.into());
        edge.weight.is_finite().then_some(FilmPoint {
            at,
            eye: view.eye,
            edge,
            sides,
        })
    }
}

impl Surfaces<'_> {
    /// The material of a surface just inside of an edge: primitive of the scene and coordinates.
    pub fn inside<P: Float>(&self, shape: u32, inside: &Inside) -> (u32, SurfaceCoordinates<P>) {
        self.place(shape, inside.spot, inside.p)
    }
}
