//! Whether two walks ended in the same root, by proof.

use ad_core::krawczyk::{Bounded, box_around, decided, isolated, newton_step, tightened};
use ad_core::{Dual, Interval, Vec2, Vec3};
use smallvec::SmallVec;

use super::chain::{Events, Surface, Vertex};
use super::space::{Space, Start, Target};
use super::walk::{End, Hits, Solution, Way};
use crate::accel::Hit;
use crate::bsdf::Material;
use crate::math::Frame;
use crate::texture::Texture;

/// Two ends no farther apart than this angle are looked at, in radians. It limits work alone: proofs fail in larger boxes.
const REACH: f64 = 1e-4;
/// A box is so much wider than what it has to hold, so that a ball around its root that holds both ends lies in it.
const MARGIN: f64 = 2.5;
/// And so much wider than Newton's step, as rounding bounds it: the least of which [`CONTRACTION`] lets a proof succeed.
const STEPS: f64 = 3.0;
/// Newton's method goes to the root of a box from everywhere around it where simplified steps contract by less.
const CONTRACTION: f64 = 1.0 / 3.0;

/// Whether two walks ended in the same root.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sameness {
    /// Other shapes or events, or farther apart than both may be off.
    Apart,
    /// A box around both ends holds one root alone: proved by interval arithmetic, rounding included.
    Proved,
    /// Nearer than both may be off, and no proof: near folds, and across edges of triangles and texels. Taken for one.
    Unproved,
}

impl Sameness {
    /// Whether they count as one.
    pub fn is_same(self) -> bool {
        self != Self::Apart
    }
}

/// Where a walk ended.
struct Ended<'e> {
    d: Vec3<f64>,
    p: Vec3<f64>,
    error: f64,
    hits: &'e Hits,
}

/// A bound of a number that changes with two angles of the direction that a chain leaves its start in.
type Bound = Dual<Interval, 2>;

/// Bounds of position and normal at the vertices of a chain.
type Middles = SmallVec<[[Interval; 6]; 2]>;

impl Solution {
    /// Where its rays meet its shapes.
    fn hits(&self) -> Hits {
        let hit = |v: &Vertex| Hit {
            t: v.si.t as f32,
            u: 0.0,
            v: 0.0,
            prim: v.prim,
        };
        self.chain.iter().map(hit).collect()
    }

    fn ended<'e>(&self, hits: &'e Hits) -> Ended<'e> {
        Ended {
            d: self.direction(),
            p: self.chain[0].si.p,
            error: self.error,
            hits,
        }
    }
}

impl Space<'_> {
    /// Whether two solutions between the same start and target are one.
    ///
    /// They are if a box around both has one root and no other, which [`ad_core::krawczyk()`] proves over intervals. The
    /// constraint is that of the triangles and texels that are met at the first of them; a box that is met by others has no
    /// proof.
    pub fn sameness(&self, start: &Start, target: &Target, a: &Solution, b: &Solution) -> Sameness {
        if !a.has(b.chain.iter().map(Vertex::event)) {
            return Sameness::Apart;
        }
        let like: Events = a.chain.iter().map(Vertex::event).collect();
        let way = Way::new(self, start, target, &like);
        way.sameness(&a.ended(&a.hits()), &b.ended(&b.hits()))
    }

    /// The same of a walk with the same events that ended near a root: there, or where it goes on to.
    pub(super) fn sameness_of_end(
        &self,
        start: &Start,
        target: &Target,
        known: &Solution,
        end: &End,
    ) -> Sameness {
        let way = Way::new(self, start, target, &end.like);
        let ended = Ended {
            d: end.direction(),
            p: end.at.p,
            error: end.error(start.si.p),
            hits: &end.at.hits,
        };
        let near = way.sameness(&known.ended(&known.hits()), &ended);
        if near == Sameness::Proved {
            return near;
        }
        let ended = self.polish(start, end, target, &mut 0);
        ended.map_or(near, |ended| self.sameness(start, target, known, &ended))
    }
}

/// How many texels of the map of normals an interval of surface coordinates spans. Infinite of what is no image.
fn texels(material: &Material, uv: Vec2<Interval>) -> f64 {
    match material {
        Material::NormalMap(m) => match m.map() {
            Texture::Constant(_) => 0.0,
            Texture::Bitmap(image) => {
                let at = image.to_uv.apply(uv);
                let [w, h] = [image.width, image.height].map(f64::from);
                f64::max(at.x.width() * w, at.y.width() * h)
            }
            _ => f64::INFINITY,
        },
        Material::TwoSided(m) => (m.sides().iter())
            .map(|side| texels(side, uv))
            .fold(0.0, f64::max),
        _ => 0.0,
    }
}

impl Way<'_> {
    fn sameness(&self, a: &Ended, b: &Ended) -> Sameness {
        let Frame { s, t, n } = Frame::from_normal(a.d);
        let along = b.d.dot(n);
        let angle = f64::max(b.d.dot(s).abs(), b.d.dot(t).abs()) / along;
        let same = |(a, b): (&Hit, &Hit)| a.prim == b.prim;
        let met = a.hits.len() == b.hits.len() && a.hits.iter().zip(b.hits).all(same);
        if along > 0.0 && angle <= REACH && met && self.is_alone(a, angle) {
            return Sameness::Proved;
        }
        if (a.p - b.p).length() <= a.error + b.error {
            Sameness::Unproved
        } else {
            Sameness::Apart
        }
    }

    /// Whether a box around an end has one root alone, where Newton's method goes from everywhere up to `angle` from the end.
    fn is_alone(&self, end: &Ended, angle: f64) -> bool {
        let proof = || {
            let mut middles = Middles::new();
            // What is decided in the box is decided here.
            let [here, _] = box_around([0.0; 2], 0.0);
            let at = self.bound(end, here, 0.0, &mut middles)?;
            let radius = f64::max(MARGIN * angle, STEPS * newton_step(&at)?);
            let over = self.bounds(end, radius, &mut middles)?;
            let root = isolated(&at, &over, radius)?;
            let holds = root.error <= 0.5 * (radius - angle);
            Some(holds && root.contraction < CONTRACTION)
        };
        proof().unwrap_or(false)
    }

    /// Bounds of the last constraint over a box of directions around an end, in which all is decided; `middles` are those at
    /// the end itself.
    fn bounds(&self, end: &Ended, radius: f64, middles: &mut Middles) -> Option<Bounded<2>> {
        let [lower, upper] = box_around([0.0; 2], radius);
        let lower = self.bound(end, lower, radius, middles)?;
        decided([lower, self.bound(end, upper, radius, middles)?])
    }

    /// Bounds of the last constraint over a box of directions. Where there are no `middles`, they become what is found.
    fn bound(
        &self,
        end: &Ended,
        [a, b]: [Bound; 2],
        radius: f64,
        middles: &mut Middles,
    ) -> Option<Bounded<2>> {
        let Frame { s, t, n } = Frame::from_normal(end.d);
        let d = Vec3::<Bound>::lift(n) + Vec3::lift(s) * a + Vec3::lift(t) * b;
        let (mut within, mut i) = (true, 0);
        let seen = |here: &mut Surface<Bound>| {
            let material = self.space.scene.material(here.shape);
            within &= texels(material, here.si.uv.map(|x| x.re)) < 1.0;
            let (p, n) = (&mut here.si.p, &mut here.facet.n);
            let numbers = [&mut p.x, &mut p.y, &mut p.z, &mut n.x, &mut n.y, &mut n.z];
            match middles.get(i) {
                None => middles.push(numbers.map(|x| x.re)),
                Some(middle) => {
                    for (x, at) in numbers.into_iter().zip(middle) {
                        *x = tightened(*x, *at, radius);
                    }
                }
            }
            i += 1;
        };
        let (_, value) = self.shoot(d.normalize(), &mut end.hits.clone(), seen)?;
        within.then_some(value)
    }
}
