//! Chains of specular vertices: how they are traced, and how their last constraint changes.

use ad_core::{Dual, Mat2, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::constraint::{self, Facet};
use super::normal::{Normal, is_mapped};
use super::space::{Space, Start, Target};
use crate::accel::Hit;
use crate::bsdf::nesting::{Specular, facets};
use crate::bsdf::{Bsdf, DeltaKind, Shading, TransportMode};
use crate::math::{Frame, Ray};
use crate::scene::Intersection;
use crate::shape::SurfaceInteraction;

/// A number that changes with the position of one vertex.
type Moving = Dual<f64, 2>;
/// A number that changes with the positions of a vertex (2, 3) and its neighbours before (0, 1) and after (4, 5).
type Local = Dual<f64, 6>;

/// A specular vertex.
#[derive(Clone, Debug)]
pub struct Vertex {
    /// Index of the shape.
    pub shape: u32,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// Where on it.
    pub si: SurfaceInteraction<f64>,
    /// What happens there.
    pub kind: DeltaKind,
    /// Which normal scatters.
    pub normal_is: Normal,
    /// Unit direction to the vertex before, world space.
    pub wo: Vec3<f64>,
    /// Position, and the surface, as they change with two lengths along orthonormal tangents.
    p: Vec3<Moving>,
    facet: Facet<Moving>,
}

impl Vertex {
    /// The direction that light goes on in. `None` at total reflection.
    fn scattered(&self) -> Option<Vec3<f64>> {
        let value = |v: Vec3<Moving>| v.map(|x| x.re);
        let n = value(self.facet.n);
        constraint::scatter(self.kind, self.wo, n, self.facet.eta.re)
    }

    /// The normal that scatters, world space.
    pub fn normal(&self) -> Vec3<f64> {
        self.facet.n.map(|x| x.re)
    }

    /// Index behind the normal over that in front of it.
    pub fn eta(&self) -> f64 {
        self.facet.eta.re
    }

    /// What stays the same while a walk moves it.
    pub(super) fn event(&self) -> Event {
        Event {
            shape: self.shape,
            kind: self.kind,
            normal: self.normal_is,
        }
    }
}

/// The surface at a specular vertex, seen along a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface<R> {
    /// Index of the shape.
    pub shape: u32,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// Where on it.
    pub si: SurfaceInteraction<R>,
    /// What scatters there.
    pub facet: Facet<R>,
}

/// What happens at a vertex of a chain, wherever that is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Event {
    /// Index of the shape.
    pub shape: u32,
    /// Reflection or refraction.
    pub kind: DeltaKind,
    /// Which normal scatters.
    pub normal: Normal,
}

/// The events of a chain.
pub(super) type Events = SmallVec<[Event; 2]>;

/// Specular vertices, from a start on. All constraints but the last hold: the chain was traced.
pub type Chain = Vec<Vertex>;

/// How the last constraint of a chain changes.
#[derive(Clone, Copy, Debug)]
pub struct Derivative {
    /// Its value.
    pub value: Vec2<f64>,
    /// With the position of the first vertex, the others being traced; per length along orthonormal tangents.
    pub first: Mat2<f64>,
    /// With the target: per length across the last edge, or per radian of its direction.
    pub target: Mat2<f64>,
}

/// The blocks of the constraint's Jacobian in one row: with the positions of the vertex before, of the vertex, and of the
/// one after, or of the target; per length along orthonormal tangents. Of the start, which stays, the block is zero.
pub type Row = [Mat2<f64>; 3];

fn place<const AT: usize>(x: Moving) -> Local {
    let mut eps = [0.0; 6];
    eps[AT] = x.eps[0];
    eps[AT + 1] = x.eps[1];
    Dual::new(x.re, eps)
}

fn constant(v: Vec3<f64>) -> Vec3<Local> {
    v.map(Dual::constant)
}

impl<'a> Space<'a> {
    /// What a ray meets.
    pub(super) fn meet(&self, ray: &Ray<f64>) -> Option<(Hit, u32)> {
        let hit = self.scene.nearest(ray)?;
        Some((hit, self.scene.patch(&hit).0))
    }

    /// The surface that a ray meets which moves as its scalar says; `wo` is the way back, and does not.
    ///
    /// From `ray.o` itself, not from where the search for hits began: constraints hold to rounding.
    #[inline]
    pub(super) fn surface<R: Real<Primal = f64>>(
        &self,
        ray: &Ray<R>,
        wo: Vec3<f64>,
        hit: &Hit,
        normal: Normal,
    ) -> Surface<R> {
        let theta = self.theta.lift::<R>();
        let Intersection { shape, prim, si } = self.scene.interaction(&theta, ray, hit);
        let material = self.scene.material(shape);
        let at = Shading::new(theta, si.uv);
        let n = match normal {
            Normal::Own if !is_mapped(material) => si.frame.n,
            _ => {
                let wo = si.frame.primal().to_local(wo);
                let mapped = || material.shading_frame(&at, wo, 0, TransportMode::Radiance);
                si.frame.to_world(normal.vector(mapped))
            }
        };
        let eta = match facets(material).map(|f| f.specular) {
            Some(Specular::Interface(eta)) => eta.scalar(&theta, si.uv),
            _ => R::one(),
        };
        Surface {
            shape,
            prim,
            si,
            facet: Facet { n, eta },
        }
    }

    /// The vertex at a hit of a ray from the point `from`, with this event.
    fn vertex(&self, from: Vec3<f64>, d: Vec3<f64>, hit: &Hit, event: &Event) -> Vertex {
        let found = self.scene.interaction(&self.theta, &Ray::new(from, d), hit);
        let Intersection { shape, prim, si } = found;
        // Along the normal, the surface is met again wherever the point moves to, whatever coordinates the shape has.
        let Frame { s, t, n } = Frame::from_normal(si.n_geo);
        let tangents = [Dual::var(0.0, 0), Dual::var(0.0, 1)];
        let still = |v: Vec3<f64>| v.map(Moving::constant);
        let o = still(si.p) + still(s) * tangents[0] + still(t) * tangents[1];
        let here = Hit { t: 0.0, ..*hit };
        let moving = self.surface(&Ray::new(o, -still(n)), -d, &here, event.normal);
        Vertex {
            shape,
            prim,
            si,
            kind: event.kind,
            normal_is: event.normal,
            wo: -d,
            p: moving.si.p,
            facet: moving.facet,
        }
    }

    /// The chain with the same events on the same shapes as `like`, by the surfaces' own normals, that leaves in the unit
    /// direction `d`. `None` where it meets something else, or light goes on otherwise.
    pub fn trace_own(
        &self,
        start: &Start,
        d: Vec3<f64>,
        like: &[(u32, DeltaKind)],
    ) -> Option<Chain> {
        let own = |&(shape, kind): &(u32, DeltaKind)| Event {
            shape,
            kind,
            normal: Normal::Own,
        };
        self.trace(start, d, &like.iter().map(own).collect::<Events>())
    }

    /// [`Space::trace_own`] with normals of any kind.
    pub fn trace(&self, start: &Start, d: Vec3<f64>, like: &[Event]) -> Option<Chain> {
        let mut chain = Chain::new();
        let (mut si, mut exit, mut d) = (start.si, start.exit, d);
        for (i, event) in like.iter().enumerate() {
            let (hit, met) = self.meet(&si.spawn_ray(d, exit))?;
            if met != event.shape {
                return None;
            }
            let vertex = self.vertex(si.p, d, &hit, event);
            if i + 1 < like.len() {
                (si, exit) = (vertex.si, self.scene.exit(vertex.prim));
                d = vertex.scattered()?;
            }
            chain.push(vertex);
        }
        Some(chain)
    }

    /// Where light goes on that came from `wo`, over this event.
    pub(super) fn onward(
        &self,
        here: &Surface<f64>,
        wo: Vec3<f64>,
        kind: DeltaKind,
    ) -> Option<(Vec3<f64>, Hit, u32)> {
        let d = constraint::scatter(kind, wo, here.facet.n, here.facet.eta)?;
        let (hit, shape) = self.meet(&here.si.spawn_ray(d, self.scene.exit(here.prim)))?;
        Some((d, hit, shape))
    }

    /// The constraint of vertex `i` of a chain, and its blocks of the Jacobian [Zeltner 2021, figure 3.6]; tangents are those of
    /// [`Frame::from_normal`] at the geometric normal. `None` where it has no value.
    pub fn row(
        &self,
        start: Vec3<f64>,
        chain: &[Vertex],
        i: usize,
        target: &Target,
        frame: &Frame<f64>,
    ) -> Option<(Vec2<f64>, Row)> {
        let here = &chain[i];
        let p = here.p.map(place::<2>);
        let before = match i {
            0 => constant(start),
            _ => chain[i - 1].p.map(place::<0>),
        };
        let next = match (chain.get(i + 1), target) {
            (Some(next), _) => (next.p.map(place::<4>) - p).normalize(),
            (None, Target::Point(at)) => {
                let Frame { s, t, .. } = Frame::from_normal((*at - here.si.p).normalize());
                (moved(*at, s, t) - p).normalize()
            }
            (None, Target::Direction(d)) => {
                let Frame { s, t, .. } = Frame::from_normal(*d);
                moved(*d, s, t).normalize()
            }
        };
        let facet = Facet {
            n: here.facet.n.map(place::<2>),
            eta: place::<2>(here.facet.eta),
        };
        let w = (before - p).normalize();
        let [a, b] = constraint::value(self.constraint, here.kind, w, next, &facet, frame)?;
        let block =
            |k: usize| Mat2::from_rows([[a.eps[k], a.eps[k + 1]], [b.eps[k], b.eps[k + 1]]]);
        let finite = a.is_finite() && b.is_finite();
        finite.then(|| (Vec2::new(a.re, b.re), [block(0), block(2), block(4)]))
    }

    /// How the last constraint changes when the first vertex moves and the others are traced, and when the target does: the
    /// block-tridiagonal system of all constraints, eliminated from the first row on. `None` where it has no value, or an
    /// edge of the chain is tangent to its end.
    pub fn derivative(
        &self,
        start: Vec3<f64>,
        chain: &[Vertex],
        target: &Target,
        frame: &Frame<f64>,
    ) -> Option<Derivative> {
        // How the vertex before, and this one, move with the first.
        let (mut before, mut here) = (Mat2::default(), Mat2::identity());
        for i in 0..chain.len() {
            let (value, [a, b, c]) = self.row(start, chain, i, target, frame)?;
            let change = a * before + b * here;
            if i + 1 == chain.len() {
                return Some(Derivative {
                    value,
                    first: change,
                    target: c,
                });
            }
            let next = c.inverse()? * change;
            (before, here) = (here, Mat2::default() - next);
        }
        None
    }
}

/// The unit direction from a point to a target.
pub(super) fn towards(from: Vec3<f64>, target: &Target) -> Vec3<f64> {
    match target {
        Target::Point(at) => (*at - from).normalize(),
        Target::Direction(d) => *d,
    }
}

/// A point that moves along two vectors, in the place of a vertex after another.
fn moved(p: Vec3<f64>, s: Vec3<f64>, t: Vec3<f64>) -> Vec3<Local> {
    let along = [Dual::var(0.0, 4), Dual::var(0.0, 5)];
    constant(p) + constant(s) * along[0] + constant(t) * along[1]
}
