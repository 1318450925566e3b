//! The recursion along a recorded path, from its end to its start.

use ad_core::{Float, Real, Vec3};
use smallvec::SmallVec;

use super::{
    Bounce, Contribution, NormalsLight, PathRecord, Place, SampledLight, SeenVertex, Vertex,
};
use crate::bsdf::{Component, Part, Use};
use crate::emitter::Emission;
use crate::integrator::direct::{Found, FoundLight};
use crate::math::Rgb;

/// The light that arrives along the edge from a vertex.
#[derive(Clone, Copy, Debug)]
pub struct Arriving<R> {
    /// What leaves the next vertex.
    pub next: Rgb<R>,
    /// What the edge met, where that is differentiated as the path is.
    pub met: Rgb<R>,
    /// What it met, where that is differentiated by itself.
    pub apart: Rgb<R>,
}

impl<R: Real> Arriving<R> {
    /// What is differentiated as the path is.
    #[inline(always)]
    pub fn along(&self) -> Rgb<R> {
        self.next + self.met
    }

    /// All of it.
    #[inline(always)]
    pub fn all(&self) -> Rgb<R> {
        self.next + self.met + self.apart
    }
}

/// What a sweep asks for, and is told, on its way.
///
/// The values are those of the record where nothing else is asked for; second derivatives evaluate them once more. What is
/// told is enough for the adjoint of each value: the throughput up to it and what arrives behind it.
pub trait Visitor<P: Float> {
    /// Scalar of the radiance.
    type Scalar: Real<Primal = P>;

    /// Emitted radiance. `beta` is what it is multiplied with on its way along the path.
    fn emitted(&mut self, emitter: u32, emission: &Emission<P>, beta: Rgb<P>) -> Rgb<Self::Scalar>;

    /// Value of the BSDF, which the record has as `f`.
    fn value(
        &mut self,
        place: &Place<P>,
        wi: Vec3<P>,
        component: Component,
        f: Rgb<P>,
    ) -> Rgb<Self::Scalar>;

    /// A sampled light.
    fn sampled(&mut self, _vertex: &Vertex<P>, _place: &Place<P>, _light: &SampledLight<P>) {}

    /// What arrives along a sample of the derivative of normals.
    fn normals(&mut self, _place: &Place<P>, _light: &NormalsLight<P>) {}

    /// The sampled continuation.
    fn scattered(
        &mut self,
        _vertex: &Vertex<P>,
        _place: &Place<P>,
        _bounce: &Bounce<P>,
        _arriving: &Arriving<Self::Scalar>,
    ) {
    }

    /// The camera sees a vertex of a particle.
    fn seen(&mut self, _vertex: &Vertex<P>, _place: &Place<P>, _seen: &SeenVertex<P>) {}

    /// Nothing else happens at a vertex. `found` is the light that its edge found, if that is differentiated by itself.
    fn leave(&mut self, _vertex: &Vertex<P>, _place: &Place<P>, _found: Option<Found<P>>) {}
}

/// The radiance of the path; of a particle, the part of the measurement that it carries.
pub fn sweep<P: Float, V: Visitor<P>>(path: &PathRecord<P>, visitor: &mut V) -> Rgb<V::Scalar> {
    let mut next = Rgb::black();
    for (k, vertex) in path.vertices().iter().enumerate().rev() {
        let mut arriving = Arriving {
            next,
            met: Rgb::black(),
            apart: Rgb::black(),
        };
        let mut edge = None;
        let mut lights = SmallVec::<[FoundLight<P>; 1]>::new();
        let mut leaves = Rgb::black();
        for contribution in path.contributions(k).iter().rev() {
            match contribution {
                Contribution::Edge(from, found) => edge = Some((from, found)),
                Contribution::Met(met) => {
                    let le = visitor.emitted(met.emitter, &met.emission, met.beta * met.weight);
                    let l = le.scale(met.weight);
                    if edge.is_some() {
                        arriving.apart += l;
                        lights.push(FoundLight {
                            emitter: met.emitter,
                            emission: met.emission,
                            share: met.share,
                        });
                    } else {
                        arriving.met += l;
                    }
                }
                Contribution::Emitted(start) => {
                    let beta = arriving.next.primal() * start.weight;
                    let le = visitor.emitted(start.emitter, &start.emission, beta);
                    leaves += le * arriving.next.scale(start.weight);
                }
                Contribution::SeenEmitter(emitter, emission, importance) => {
                    let le = visitor.emitted(*emitter, emission, *importance);
                    leaves += le * Rgb::lift(*importance);
                }
                at_surface => {
                    if let Some(place) = &vertex.place {
                        leaves += reflected(vertex, place, at_surface, &arriving, visitor);
                    }
                }
            }
        }
        match &vertex.place {
            Some(place) => {
                lights.reverse();
                let found = edge.map(|(from, edge)| Found {
                    from,
                    edge,
                    lights: &lights,
                });
                visitor.leave(vertex, place, found);
                next = leaves;
            }
            // The camera takes what arrives as it is; an emitter has been asked above.
            None => {
                let camera = !path
                    .contributions(k)
                    .iter()
                    .any(|c| matches!(c, Contribution::Emitted(_) | Contribution::SeenEmitter(..)));
                next = if camera { arriving.all() } else { leaves };
            }
        }
    }
    next
}

/// What a contribution at a surface adds to the radiance that leaves it.
#[inline(always)]
fn reflected<P: Float, V: Visitor<P>>(
    vertex: &Vertex<P>,
    place: &Place<P>,
    contribution: &Contribution<P>,
    arriving: &Arriving<V::Scalar>,
    visitor: &mut V,
) -> Rgb<V::Scalar> {
    match contribution {
        Contribution::Scattered(b) => {
            visitor.scattered(vertex, place, b, arriving);
            let f = visitor.value(place, b.wi, b.component, b.f);
            f * arriving.all().scale(b.weight)
        }
        Contribution::Sampled(s) => {
            visitor.sampled(vertex, place, s);
            let le = visitor.emitted(s.emitter, &s.emission, vertex.beta * s.f * s.weight);
            let f = visitor.value(place, s.wi, Component::Continuous, s.f);
            f * le.scale(s.weight)
        }
        Contribution::Seen(s) => {
            visitor.seen(vertex, place, s);
            let f = visitor.value(place, s.wi, Component::Continuous, s.f);
            f * Rgb::lift(s.importance)
        }
        Contribution::Normals(n) => {
            visitor.normals(place, n);
            Rgb::black()
        }
        _ => Rgb::black(),
    }
}

/// How the material of one vertex was used: what single paths and waves hand to their sinks.
#[derive(Clone, Debug, Default)]
pub struct Uses<P: Float>(pub SmallVec<[Use<P>; 5]>);

impl<P: Float> Uses<P> {
    /// A value with the adjoint `d`.
    #[inline(always)]
    pub fn push(&mut self, wi: Vec3<P>, component: Component, part: Part, d: Rgb<P>) {
        if !d.is_black() {
            self.0.push(Use {
                wi,
                component,
                part,
                d,
            });
        }
    }

    /// A sampled light whose radiance times weight is `light`, at throughput `d`. `normals`: the same for the change of
    /// normals, where that has samples of its own. `weighed`: the rest is differentiated together with its weight.
    #[inline(always)]
    pub fn sampled(
        &mut self,
        wi: Vec3<P>,
        light: Rgb<P>,
        normals: Option<Rgb<P>>,
        weighed: bool,
        d: Rgb<P>,
    ) {
        let part = match normals {
            Some(_) => Part::Rest,
            None => Part::All,
        };
        if !weighed {
            self.push(wi, Component::Continuous, part, d * light);
        }
        if let Some(light) = normals {
            self.push(wi, Component::Continuous, Part::Normals, d * light);
        }
    }
}
