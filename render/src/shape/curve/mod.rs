//! Curves with a thickness, such as hair: many of them in one shape, from a file.
//!
//! As in Mitsuba 3, rays meet them from outside only, radii stay what they are in the file whatever `to_world` does to the
//! points, and texture coordinates are `(around, along)`: the angle in turns about the curve, from where its normal lies at
//! right angles to the world's z axis, and the number of the segment and the part of it, over the number of all segments
//! of the shape. The shading frame has its first axis around the curve, and its second one along it; on linear curves,
//! too, where Mitsuba 3.9.1 takes any frame.

mod cone;
mod file;
mod spline;

use std::sync::{Arc, OnceLock};

use ad_core::{Dual, Float, Real, Vec2, Vec3};

use super::mesh::pick;
use super::partials::variables;
use super::{
    FAR, Partials, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction, double, lift3,
    misplaced, turn,
};
use crate::accel::{self, Hit, MAX_COORDINATE, MIN_THICKNESS, Primitive};
use crate::error::SceneError;
use crate::math::{Frame, Ray, Transform, each};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// What joins the control points of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveKind {
    /// Segments from one point to the next, round at joints and ends: all balls whose centres and radii are on them.
    Linear,
    /// Uniform cubic B-splines: tubes whose circular cross section has that radius, open at the ends.
    Spline,
}

impl CurveKind {
    /// Fewest control points of a curve.
    pub fn fewest(self) -> usize {
        match self {
            Self::Linear => 2,
            Self::Spline => 4,
        }
    }
}

/// The part of a segment that a primitive is.
#[derive(Clone, Copy, Debug)]
struct Piece {
    segment: u32,
    /// Which of how many.
    part: [u8; 2],
}

/// Curves. Cheap to clone.
///
/// Texture coordinates and frames are told by the module's documentation. [`SurfaceCoordinates`] are the angle in turns,
/// and on splines the parameter between the four control points; on linear curves the part of the segment, less than zero
/// and more than one on the balls at its ends, down to -1 and up to 2 at their poles.
#[derive(Clone, Debug)]
pub struct Curves {
    data: Arc<Data>,
    /// See [`Shape::skip_uv`].
    skips_uv: bool,
}

#[derive(Debug)]
struct Data {
    kind: CurveKind,
    /// Position and radius.
    points: Vec<[f32; 4]>,
    /// The first control point of each segment.
    segments: Vec<u32>,
    pieces: Vec<Piece>,
    /// The angle is one quarter of a turn towards the first of these, as far as that is across the curve; towards the
    /// second one on curves along the first.
    guides: [[f32; 3]; 2],
    bounds: [[f32; 3]; 2],
    /// Running sums of the areas of pieces, made when the first of them is sampled.
    running: OnceLock<Vec<f64>>,
}

impl Curves {
    /// Of control points, position and radius, world space; `starts` are the numbers of the first point of each curve, in
    /// their order, from zero on.
    ///
    /// # Errors
    /// What was expected, and what was found.
    pub fn new(kind: CurveKind, points: Vec<[f32; 4]>, starts: &[u32]) -> Result<Self, String> {
        if starts.first() != Some(&0) || starts.windows(2).any(|w| w[0] >= w[1]) {
            return Err("expected curves from the first point on, in the order of points".into());
        }
        let ends = starts[1..].iter().map(|&s| s as usize);
        let (mut segments, fewest) = (Vec::new(), kind.fewest());
        for (&start, end) in starts.iter().zip(ends.chain([points.len()])) {
            let count = end.saturating_sub(start as usize);
            if count < fewest {
                return Err(format!(
                    "expected at least {fewest} points of a curve, found {count}"
                ));
            }
            segments.extend(start..=(end - fewest) as u32);
        }
        Self::of(kind, points, segments, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    }

    fn of(
        kind: CurveKind,
        points: Vec<[f32; 4]>,
        segments: Vec<u32>,
        guides: [[f32; 3]; 2],
    ) -> Result<Self, String> {
        let reach = points
            .as_flattened()
            .iter()
            .find(|x| x.is_nan() || x.abs() > MAX_COORDINATE);
        if let Some(found) = reach {
            return Err(format!(
                "expected finite coordinates of magnitude at most {MAX_COORDINATE:e}, found {found}"
            ));
        }
        if let Some(point) = points.iter().find(|p| p[3] < 0.0) {
            return Err(format!("expected radii of at least 0, found {}", point[3]));
        }
        let mut data = Data {
            kind,
            points,
            segments,
            pieces: Vec::new(),
            guides,
            bounds: [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]],
            running: OnceLock::new(),
        };
        for segment in 0..data.segments.len() as u32 {
            let count = match kind {
                CurveKind::Linear => 1,
                CurveKind::Spline => spline::parts(&data.four(segment)),
            };
            let pieces = (0..count).map(|k| Piece {
                segment,
                part: [k, count],
            });
            data.pieces.extend(pieces);
        }
        for piece in &data.pieces {
            let [low, high] = accel::bounds(&data.primitive(piece));
            for k in 0..3 {
                data.bounds[0][k] = data.bounds[0][k].min(low[k]);
                data.bounds[1][k] = data.bounds[1][k].max(high[k]);
            }
        }
        // One with an area is enough, and most have one.
        let has_area = || data.pieces.iter().any(|p| data.area_of(p) > 0.0);
        if !(data.points.iter().any(|p| p[3] >= MIN_THICKNESS) && has_area()) {
            return Err("expected a radius that is not zero and a length, found none".into());
        }
        Ok(Self {
            data: Arc::new(data),
            skips_uv: false,
        })
    }

    /// What joins the control points.
    pub fn kind(&self) -> CurveKind {
        self.data.kind
    }

    /// Control points of all curves, world space: position and radius.
    pub fn points(&self) -> &[[f32; 4]] {
        &self.data.points
    }

    /// Number of segments of all curves.
    pub fn segments(&self) -> usize {
        self.data.segments.len()
    }
}

impl Data {
    /// Control points of a segment of a spline.
    fn four(&self, segment: u32) -> [[f32; 4]; 4] {
        let first = self.segments[segment as usize] as usize;
        [0, 1, 2, 3].map(|k: usize| self.points[first + k])
    }

    /// Ends of a segment of a linear curve.
    fn two(&self, segment: u32) -> [[f32; 4]; 2] {
        let first = self.segments[segment as usize] as usize;
        [self.points[first], self.points[first + 1]]
    }

    fn primitive(&self, piece: &Piece) -> Primitive {
        match self.kind {
            CurveKind::Linear => cone::primitive(&self.two(piece.segment)),
            CurveKind::Spline => {
                let first = self.segments[piece.segment as usize];
                spline::primitive(&self.four(piece.segment), first, piece.part)
            }
        }
    }

    /// Running sums of the areas of pieces.
    fn running(&self) -> &[f64] {
        self.running.get_or_init(|| {
            let mut sum = 0.0;
            let areas = self.pieces.iter().map(|p| {
                sum += self.area_of(p);
                sum
            });
            areas.collect()
        })
    }

    fn area_of(&self, piece: &Piece) -> f64 {
        match self.kind {
            CurveKind::Linear => cone::area(&self.two(piece.segment)),
            CurveKind::Spline => spline::area(&self.four(piece.segment), piece.part),
        }
    }

    /// Unit vectors across a curve in the unit direction `along`: where the angle is a quarter of a turn, and where it is
    /// zero.
    fn across<R: Real>(&self, along: Vec3<R>) -> [Vec3<R>; 2] {
        let [guide, aside] = self.guides.map(lift3::<R>);
        let beside = |v: Vec3<R>| v - along * along.dot(v);
        let (first, second) = (beside(guide), beside(aside));
        let parallel = first.primal().length_squared() <= R::Primal::of(1e-12);
        let quarter = Vec3::select(parallel, second, first).normalize();
        [quarter, quarter.cross(along)]
    }
}

/// A point on a segment.
struct Point<R> {
    p: Vec3<R>,
    /// Unit normal.
    n: Vec3<R>,
    /// The unit direction of the curve.
    along: Vec3<R>,
    /// Where in the segment, from zero to one.
    v: R,
}

impl Curves {
    fn seen<R: Real>(&self, piece: Piece, at: &Point<R>, t: R, u: R) -> SurfaceInteraction<R> {
        let count = R::Primal::of(self.data.segments.len() as f64);
        let segment = R::Primal::of(f64::from(piece.segment));
        let v = (at.v + R::lift(segment)) * R::lift(count.recip());
        SurfaceInteraction {
            p: at.p,
            t,
            n_geo: at.n,
            frame: Frame::from_normal_and_tangent(at.n, at.along.cross(at.n)),
            uv: Vec2::new(u, v),
        }
    }

    /// The angle of a direction across a curve, in turns.
    fn turns<R: Real>(&self, along: Vec3<R>, outward: Vec3<R>) -> R {
        if self.skips_uv {
            return R::zero();
        }
        let [quarter, start] = self.data.across(along);
        turn(quarter.dot(outward), start.dot(outward))
    }

    fn point<R: Real>(&self, piece: Piece, at: SurfaceCoordinates<R>) -> SurfaceInteraction<R> {
        let SurfaceCoordinates(Vec2 { x, y }) = at;
        let (sin, cos) = (x * R::c(2.0 * std::f64::consts::PI)).sin_cos();
        let outward = |along: Vec3<R>| {
            let [quarter, start] = self.data.across(along);
            start * cos + quarter * sin
        };
        let point = match self.data.kind {
            CurveKind::Linear => cone::Segment::new(&self.data.two(piece.segment)).at(y, outward),
            CurveKind::Spline => spline::at(&self.data.four(piece.segment), y, outward),
        };
        self.seen(piece, &point, R::zero(), x)
    }
}

impl Shape for Curves {
    fn primitives(&self) -> Vec<Primitive> {
        let data = &self.data;
        data.pieces.iter().map(|p| data.primitive(p)).collect()
    }

    fn control_points(&self) -> &[[f32; 4]] {
        match self.data.kind {
            CurveKind::Linear => &[],
            CurveKind::Spline => &self.data.points,
        }
    }

    fn interaction<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        let piece = self.data.pieces[prim as usize];
        let (t, point) = match self.data.kind {
            CurveKind::Linear => cone::Segment::new(&self.data.two(piece.segment)).hit(ray, hit),
            CurveKind::Spline => {
                let fallback = |along: Vec3<R>| self.data.across(along)[1];
                spline::hit(
                    &self.data.four(piece.segment),
                    piece.part,
                    ray,
                    hit,
                    fallback,
                )
            }
        };
        let u = self.turns(point.along, point.n);
        self.seen(piece, &point, t, u)
    }

    fn coordinates<P: Float>(
        &self,
        prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        self.locate(prim, si.p)
    }

    fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        let piece = self.data.pieces[prim as usize];
        let p = p.map(P::to_f64);
        let (along, outward, y) = match self.data.kind {
            CurveKind::Linear => cone::Segment::new(&self.data.two(piece.segment)).locate(p),
            CurveKind::Spline => spline::locate(&self.data.four(piece.segment), piece.part, p),
        };
        let [quarter, start] = self.data.across(along);
        let x = turn(quarter.dot(outward), start.dot(outward));
        SurfaceCoordinates(Vec2::new(P::of(x), P::of(y)))
    }

    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        self.point(self.data.pieces[prim as usize], at)
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let [x, y] = variables(at.0.x, at.0.y);
        let at = SurfaceCoordinates(Vec2::<Dual<R, 2>>::new(x, y));
        let si = self.point(self.data.pieces[prim as usize], at);
        Partials::of(si.p, &si.frame).with_respect_to(si.uv)
    }

    /// The mean over the primitive: the area per coordinate changes along it.
    fn area_element<R: Real>(&self, _theta: &Theta<R>, prim: u32) -> R {
        let piece = &self.data.pieces[prim as usize];
        let [low, high] = self.range(piece);
        R::of(self.data.area_of(piece) / (high - low))
    }

    fn centroid(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for point in &self.data.points {
            for k in 0..3 {
                sum[k] += f64::from(point[k]);
            }
        }
        each(sum, |x| x / self.data.points.len() as f64)
    }

    /// A scale is one of the radii, too.
    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let turned = self.data.guides.map(|g| Vec3::from(by.vector(double(g))));
        let scale = turned[0].length();
        let single = |v: [f64; 3]| each(v, |x| x as f32);
        let moved = |&[x, y, z, r]: &[f32; 4]| {
            let [x, y, z] = single(by.point(double([x, y, z])));
            [x, y, z, (f64::from(r) * scale) as f32]
        };
        let points = self.data.points.iter().map(moved).collect();
        let guides = turned.map(|g| single(g.normalize().to_array()));
        let placed = Self::of(self.data.kind, points, self.data.segments.clone(), guides);
        placed
            .map(|c| Self {
                skips_uv: self.skips_uv,
                ..c
            })
            .map_err(|_| misplaced())
    }

    /// Both sides of what overlaps at joints, and the mean of circles across splines.
    fn area(&self) -> f64 {
        let running = self.data.running();
        running[running.len() - 1]
    }

    /// Uniform over the pieces by their areas, and over the coordinates of each: the density is that.
    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let data = &self.data;
        let (prim, share, along) = pick(data.running(), u[0].to_f64());
        let piece = data.pieces[prim];
        let [low, high] = self.range(&piece);
        let y = low + (high - low) * along;
        let at = [u[1].to_f64(), y];
        let [x, y] = variables(at[0], at[1]);
        let moving = self.point(piece, SurfaceCoordinates(Vec2::<Dual<f64, 2>>::new(x, y)));
        let slope = |k: usize| moving.p.map(|x| x.eps[k]);
        let element = slope(0).cross(slope(1)).length();
        let coordinates = SurfaceCoordinates(Vec2::from(at.map(R::Primal::of)));
        let si = self.point(piece, SurfaceCoordinates::<R>::lift(coordinates));
        ShapeSample {
            p: si.p,
            n: si.n_geo,
            uv: si.uv,
            pdf: R::Primal::of((share / self.area() / ((high - low) * element)).min(1e30)),
            prim: prim as u32,
            coordinates,
        }
    }

    /// None: who needs outlines is refused where there are curves ([`crate::Scene::admits`]).
    fn border<R: Real>(&self, _prim: u32, _ray: &Ray<R>) -> R {
        R::of(FAR)
    }

    fn skip_uv(&mut self) {
        self.skips_uv = true;
    }

    fn extent(&self) -> f32 {
        let numbers = self.data.bounds.as_flattened().iter();
        numbers.fold(0.0f32, |m, x| m.max(x.abs()))
    }

    fn bounds(&self) -> [[f32; 3]; 2] {
        self.data.bounds
    }
}

impl Curves {
    /// Of the second coordinate of a piece.
    fn range(&self, piece: &Piece) -> [f64; 2] {
        match self.data.kind {
            CurveKind::Linear => [-1.0, 2.0],
            CurveKind::Spline => accel::range(piece.part),
        }
    }
}

impl FromNode for Curves {
    const PLUGINS: &'static [&'static str] = &["bsplinecurve", "linearcurve"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let kind = match node.plugin.as_str() {
            "linearcurve" => CurveKind::Linear,
            _ => CurveKind::Spline,
        };
        let to_world = node.transform("to_world")?.unwrap_or_default();
        // How often Mitsuba draws outlines, which are not drawn here.
        if kind == CurveKind::Spline {
            node.float_or("silhouette_sampling_weight", 1.0)?;
        }
        let path = node
            .path("filename")?
            .ok_or_else(|| node.missing("filename", "a file of control points"))?;
        let (curves, ignored) = Self::from_file(&path, kind, &to_world)?;
        registry.warnings.extend(ignored);
        Ok(curves)
    }
}
