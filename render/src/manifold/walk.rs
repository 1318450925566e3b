//! Newton's method on chains.

use ad_core::{Dual, Mat2, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::chain::{Chain, Derivative, Event, Events, Surface, Vertex};
use super::constraint::{self, equator};
use super::space::{Space, Start, Target};
use crate::accel::Hit;
use crate::math::{Frame, Ray, both};
use crate::scene::{Steps, Uniqueness};

/// A walk has ended before its tolerance, with no more than this, if the last step was Newton's whole one and left so small a
/// part: of Newton's method there, which squares what is left, that is nearly sure.
const NEAR: f64 = 1e-5;
const CONTRACTION: f64 = 1e-2;
/// Most further steps, which bring it to rounding.
const POLISH: u32 = 3;
/// Shortest part of a step that is tried.
const LEAST_PART: f64 = 1.0 / 64.0;
/// Rounding of constraints, and of positions relative to the first edge.
const ROUNDING: [f64; 2] = [1e-13, 1e-12];

/// A chain whose constraints all hold.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Its vertices.
    pub chain: Chain,
    /// Position of its start.
    pub start: Vec3<f64>,
    /// How its last constraint changes.
    pub derivative: Derivative,
    /// How far the first vertex may be from that of the exact root.
    pub error: f64,
}

impl Solution {
    /// Solid angle at the start per area across the last edge at the target, or per solid angle of its direction: the
    /// generalised geometric term without the cosine of the start, by the determinant over orthonormal tangents, where the
    /// elements of area that (3.9) lacks are one.
    ///
    /// It is anchored at the start: radiance is scaled by squared indices, as [`crate::bsdf::TransportMode::Radiance`] does.
    ///
    /// # Source
    /// [Zeltner 2021, Eq. 3.9] with errata Z-3.9.
    pub fn angle_per_target(&self) -> f64 {
        let Derivative { first, target, .. } = self.derivative;
        let si = &self.chain[0].si;
        let edge = si.p - self.start;
        let d2 = edge.length_squared();
        let cos = si.n_geo.dot(edge).abs() / d2.sqrt();
        (target.determinant() / first.determinant()).abs() * cos / d2
    }

    /// Unit direction that the chain leaves its start in.
    pub fn direction(&self) -> Vec3<f64> {
        -self.chain[0].wo
    }

    /// Whether it has the same events on the same shapes.
    pub(super) fn has(&self, like: impl ExactSizeIterator<Item = Event>) -> bool {
        let same = |(v, e): (&Vertex, Event)| v.shape == e.shape && v.kind == e.kind;
        self.chain.len() == like.len() && self.chain.iter().zip(like).all(same)
    }

    /// Whether another solution, of the same start and target, is this one.
    pub fn is(&self, other: &Self, uniqueness: Uniqueness) -> bool {
        let same = |a: &super::Vertex, b: &super::Vertex| a.kind == b.kind;
        let alike = self.chain.len() == other.chain.len()
            && self.chain.iter().zip(&other.chain).all(|(a, b)| same(a, b));
        alike
            && match uniqueness {
                Uniqueness::ErrorBounds => {
                    let apart = (self.chain[0].si.p - other.chain[0].si.p).length();
                    apart <= self.error + other.error
                }
                Uniqueness::Threshold(threshold) => {
                    1.0 - self.direction().dot(other.direction()) < threshold
                }
            }
    }
}

/// A number that changes with two angles of the direction that a chain leaves its start in.
type Turning = Dual<f64, 2>;

/// Where rays of a chain meet its shapes.
pub(super) type Hits = SmallVec<[Hit; 2]>;

/// Where a walk starts.
#[derive(Clone, Debug)]
pub(super) struct Seed {
    /// Unit direction that the chain leaves its start in.
    pub d: Vec3<f64>,
    /// What happens on its way.
    pub like: Events,
}

/// A chain on a walk.
#[derive(Clone, Debug)]
pub(super) struct Point {
    /// Unit direction that it leaves its start in.
    d: Vec3<f64>,
    /// Where its rays meet its shapes.
    pub hits: Hits,
    /// Its first vertex, and how that moves with two angles of the direction.
    pub p: Vec3<f64>,
    slopes: [Vec3<f64>; 2],
    /// The last constraint, and how it changes with these.
    value: Vec2<f64>,
    jacobian: Mat2<f64>,
}

/// Where a walk ended: near a root.
#[derive(Clone, Debug)]
pub(super) struct End {
    pub at: Point,
    /// Newton's step from there.
    step: Vec2<f64>,
    inverse: Mat2<f64>,
    /// Whether Newton's method was seen to square what is left.
    certain: bool,
    pub like: Events,
}

/// How a walk went.
#[derive(Clone, Debug)]
pub struct Walked {
    /// Where to; `None` if nowhere.
    pub solution: Option<Solution>,
    /// How many steps were taken or tried.
    pub steps: u32,
}

/// Largest component.
fn size(c: Vec2<f64>) -> f64 {
    c.x.abs().max(c.y.abs())
}

fn length(v: Vec2<f64>) -> f64 {
    (v.x * v.x + v.y * v.y).sqrt()
}

/// Largest stretch of a matrix, at most.
fn norm(m: &Mat2<f64>) -> f64 {
    let squares = m.rows.iter().flatten().map(|x| x * x);
    squares.sum::<f64>().sqrt()
}

impl Point {
    /// The direction to the first vertex moved by `by`, in the tangent plane, seen from the start.
    fn moved(&self, start: Vec3<f64>, by: Vec2<f64>) -> Vec3<f64> {
        (self.p + self.along(by) - start).normalize()
    }

    fn along(&self, by: Vec2<f64>) -> Vec3<f64> {
        self.slopes[0] * by.x + self.slopes[1] * by.y
    }
}

impl End {
    /// How far the first vertex may be from that of the exact root.
    pub fn error(&self, start: Vec3<f64>) -> f64 {
        let [angles, lengths] = ROUNDING;
        let column = |k| self.at.along(self.inverse.col(k)).length_squared();
        let stretch = (column(0) + column(1)).sqrt();
        let edge = (self.at.p - start).length();
        2.0 * self.at.along(self.step).length() + stretch * angles + lengths * edge
    }

    /// Unit direction that the chain leaves its start in.
    pub fn direction(&self) -> Vec3<f64> {
        self.at.d
    }
}

/// All that stays the same on a walk.
pub(super) struct Way<'w> {
    pub space: &'w Space<'w>,
    start: &'w Start,
    target: &'w Target,
    like: &'w [Event],
    /// Of the angles of the last constraint.
    frame: Frame<f64>,
}

impl<'w> Way<'w> {
    pub fn new(space: &'w Space, start: &'w Start, target: &'w Target, like: &'w [Event]) -> Self {
        let frame = match target {
            Target::Point(p) => equator(*p - start.si.p),
            Target::Direction(d) => equator(*d),
        };
        Self {
            space,
            start,
            target,
            like,
            frame,
        }
    }

    /// The first vertex and the last constraint of the chain in a direction, which may turn. `None` where it meets something
    /// else, or light goes on otherwise. `hits` says where it meets its shapes, as far as that is known, and becomes complete; `seen`
    /// is called with each surface.
    pub fn shoot<R: Real<Primal = f64>>(
        &self,
        d: Vec3<R>,
        hits: &mut Hits,
        mut seen: impl FnMut(&mut Surface<R>),
    ) -> Option<(Vec3<R>, [R; 2])> {
        let Self { space, start, .. } = *self;
        let mut ray = Ray::new(Vec3::lift(start.si.p), d);
        let mut search = start.si.spawn_ray(d.primal(), start.exit);
        let mut first = None;
        for (i, event) in self.like.iter().enumerate() {
            if i == hits.len() {
                let (hit, met) = space.meet(&search)?;
                if met != event.shape {
                    return None;
                }
                hits.push(hit);
            }
            let w = -ray.d;
            let mut here = space.surface(&ray, w.primal(), &hits[i], event.normal);
            seen(&mut here);
            let p = here.si.p;
            let first = *first.get_or_insert(p);
            if i + 1 == self.like.len() {
                let next = match self.target {
                    Target::Point(at) => (Vec3::lift(*at) - p).normalize(),
                    Target::Direction(d) => Vec3::lift(*d),
                };
                let (which, kind) = (space.constraint, event.kind);
                let value = constraint::value(which, kind, w, next, &here.facet, &self.frame)?;
                let finite = value[0].is_finite() && value[1].is_finite();
                return finite.then_some((first, value));
            }
            let onward = constraint::scatter(event.kind, w, here.facet.n, here.facet.eta)?;
            let exit = space.scene.exit(here.prim);
            search = here.si.primal().spawn_ray(onward.primal(), exit);
            ray = Ray::new(p, onward);
        }
        None
    }

    /// The chain in a direction, and how it changes.
    fn point(&self, d: Vec3<f64>, mut hits: Hits) -> Option<Point> {
        let Frame { s, t, .. } = Frame::from_normal(d);
        let turning = |k: usize| Turning::new(d[k], [s[k], t[k]]);
        let turned = Vec3::new(turning(0), turning(1), turning(2));
        let (p, [a, b]) = self.shoot(turned, &mut hits, |_| ())?;
        Some(Point {
            d,
            hits,
            p: p.primal(),
            slopes: both([0, 1], |k: usize| p.map(|x| x.eps[k])),
            value: Vec2::new(a.re, b.re),
            jacobian: Mat2::from_rows([a.eps, b.eps]),
        })
    }

    /// The chain in a direction, if its last constraint is smaller than `than`. Where that is likely, all is looked at once.
    fn less(&self, d: Vec3<f64>, than: f64, likely: bool) -> Option<Point> {
        if !d.is_finite() {
            return None;
        }
        let mut hits = Hits::new();
        if !likely {
            let (_, [a, b]) = self.shoot(d, &mut hits, |_| ())?;
            if length(Vec2::new(a, b)) >= than {
                return None;
            }
        }
        let found = self.point(d, hits)?;
        (length(found.value) < than).then_some(found)
    }

    /// Walks until Newton's method is sure to converge, or has. `tried` counts steps.
    fn approach(
        &self,
        d: Vec3<f64>,
        tried: &mut u32,
    ) -> Option<(Point, Mat2<f64>, Vec2<f64>, bool)> {
        let Steps {
            most,
            scale,
            tolerance,
        } = self.space.steps;
        let mut here = self.point(d, Hits::new())?;
        let (mut part, mut certain) = (1.0, false);
        for _ in 0..most {
            let inverse = here.jacobian.inverse()?;
            let step = inverse * here.value;
            if size(here.value) <= tolerance || certain {
                return Some((here, inverse, step, certain));
            }
            // A part of the step that leaves less.
            let before = length(here.value);
            let mut likely = part == 1.0;
            here = loop {
                *tried += 1;
                let d = here.moved(self.start.si.p, step * -(part * scale));
                if let Some(next) = self.less(d, before, likely) {
                    break next;
                }
                likely = false;
                part *= 0.5;
                if part < LEAST_PART {
                    return None;
                }
            };
            let left = length(here.value);
            certain = part * scale == 1.0 && left <= NEAR && left <= CONTRACTION * before;
            part = (2.0 * part).min(1.0);
        }
        None
    }
}

impl Space<'_> {
    /// Walks from a chain to one with the same events on the same shapes that meets the target.
    ///
    /// The unknown is the direction from the start; the vertices are traced, so that all constraints but the last hold, and
    /// the step is that of the whole block-tridiagonal system. It is halved while the ray
    /// misses, meets another shape, or leaves the last constraint larger than it was ([`Steps`]).
    ///
    /// # Source
    /// [Zeltner 2021, Eq. 3.11]; step control and tolerances are ours (errata Z-3.11).
    pub fn walk(&self, start: &Start, chain: Chain, target: &Target) -> Walked {
        let seed = Seed {
            d: chain.first().map_or(Vec3::zero(), |v| -v.wo),
            like: chain.iter().map(Vertex::event).collect(),
        };
        let mut steps = 0;
        let end = self.approach(start, seed, target, &mut steps);
        let solution = end.and_then(|end| self.polish(start, &end, target, &mut steps));
        Walked { solution, steps }
    }

    /// [`Space::walk`] until the root is certain, but not yet known to rounding. `steps` counts them.
    pub(super) fn approach(
        &self,
        start: &Start,
        seed: Seed,
        target: &Target,
        steps: &mut u32,
    ) -> Option<End> {
        let way = Way::new(self, start, target, &seed.like);
        let (at, inverse, step, certain) = way.approach(seed.d, steps)?;
        let like = seed.like;
        Some(End {
            at,
            step,
            inverse,
            certain,
            like,
        })
    }

    /// The solution that a walk ended near.
    pub(super) fn polish(
        &self,
        start: &Start,
        end: &End,
        target: &Target,
        steps: &mut u32,
    ) -> Option<Solution> {
        let way = Way::new(self, start, target, &end.like);
        let [angles, lengths] = ROUNDING;
        let (x1, mut here, mut step) = (start.si.p, end.at.clone(), end.step);
        for _ in 0..POLISH {
            *steps += 1;
            let left = length(here.value);
            let Some(next) = way.less(here.moved(x1, step * -1.0), left, true) else {
                // No better than this.
                break;
            };
            here = next;
            step = here.jacobian.inverse()? * here.value;
            if size(here.value) <= angles {
                break;
            }
        }
        let chain = self.trace(start, here.d, &end.like)?;
        let derivative = self.derivative(x1, &chain, target, &way.frame)?;
        let inverse = derivative.first.inverse()?;
        let edge = (chain[0].si.p - x1).length();
        let left = length(inverse * derivative.value);
        let error = 2.0 * left + norm(&inverse) * angles + lengths * edge;
        error.is_finite().then_some(Solution {
            chain,
            start: x1,
            derivative,
            error,
        })
    }

    /// Whether a walk ended near this solution, of the same start and target. `steps` counts those that it takes to know.
    pub(super) fn is_near(
        &self,
        start: &Start,
        end: &End,
        target: &Target,
        solution: &Solution,
        uniqueness: Uniqueness,
        steps: &mut u32,
    ) -> bool {
        if !end.certain || uniqueness != Uniqueness::ErrorBounds {
            let ended = self.polish(start, end, target, steps);
            return ended.is_some_and(|ended| ended.is(solution, uniqueness));
        }
        let apart = (end.at.p - solution.chain[0].si.p).length();
        let alike = solution.has(end.like.iter().copied());
        alike && apart <= end.error(start.si.p) + solution.error
    }
}
