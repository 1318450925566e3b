//! What is kept of a path whose vertices move: where each edge ends, besides what records keep.

use ad_core::Float;
use smallvec::SmallVec;

use crate::emitter::{AnyEmitter, Emitter, EmitterSample};
use crate::integrator::record::{
    Bounce, Contribution, Interest, MetLight, Observer, Place, SampledLight,
};
use crate::math::Rgb;
use crate::params::Theta;
use crate::scene::Scene;
use crate::shape::{Shape, SurfaceInteraction};

/// What an edge met.
#[derive(Clone, Debug)]
pub(in crate::integrator) struct Edge<P: Float> {
    /// The primitive and the point; none where it left the scene.
    pub end: Option<(u32, SurfaceInteraction<P>)>,
    pub met: SmallVec<[MetLight<P>; 1]>,
}

impl<P: Float> Default for Edge<P> {
    fn default() -> Self {
        Self {
            end: None,
            met: SmallVec::new(),
        }
    }
}

/// A vertex, and what happened there and on the edge from there.
#[derive(Clone, Debug)]
pub(in crate::integrator) struct Stop<P: Float> {
    pub beta: Rgb<P>,
    pub place: Place<P>,
    pub bounce: Option<Bounce<P>>,
    pub edge: Edge<P>,
    pub sampled: Option<(SampledLight<P>, EmitterSample<P>)>,
}

/// Radiance at a stop.
#[derive(Clone, Copy, Debug)]
pub(in crate::integrator) struct Radiance<P> {
    /// What arrives along the scattered direction, over its density.
    pub arriving: Rgb<P>,
    /// What leaves towards the vertex before.
    pub leaving: Rgb<P>,
}

impl<P: Float> Stop<P> {
    /// The radiance here, where `next` leaves the vertex behind.
    pub fn radiance(&self, scene: &Scene, theta: &Theta<P>, next: Rgb<P>) -> Radiance<P> {
        let mut arriving = Rgb::black();
        let mut leaving = Rgb::black();
        if let Some(b) = &self.bounce {
            arriving = (next + met(scene, theta, &self.edge)).scale(b.weight);
            leaving += b.f * arriving;
        }
        if let Some((s, _)) = &self.sampled {
            leaving += s.f * s.le.scale(s.weight);
        }
        Radiance { arriving, leaving }
    }
}

/// A path from the camera.
#[derive(Clone, Debug)]
pub(in crate::integrator) struct Trail<P: Float> {
    /// From the camera.
    pub first: Edge<P>,
    pub stops: Vec<Stop<P>>,
    /// The light that was sampled last, seen or not.
    sampled: Option<EmitterSample<P>>,
}

impl<P: Float> Default for Trail<P> {
    fn default() -> Self {
        Self {
            first: Edge::default(),
            stops: Vec::new(),
            sampled: None,
        }
    }
}

impl<P: Float> Trail<P> {
    /// Forgets the path.
    pub fn clear(&mut self) {
        self.first = Edge::default();
        self.stops.clear();
        self.sampled = None;
    }

    fn edge(&mut self) -> &mut Edge<P> {
        match self.stops.last_mut() {
            Some(stop) => &mut stop.edge,
            None => &mut self.first,
        }
    }
}

/// Everything is wanted.
impl<P: Float> Interest for Trail<P> {}

impl<P: Float> Observer<P> for Trail<P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.stops.push(Stop {
            beta,
            place: *place,
            bounce: None,
            edge: Edge::default(),
            sampled: None,
        });
    }

    fn contribution(&mut self, contribution: Contribution<P>) {
        match contribution {
            Contribution::Met(met) => self.edge().met.push(met),
            Contribution::Scattered(bounce) => {
                if let Some(stop) = self.stops.last_mut() {
                    stop.bounce = Some(bounce);
                }
            }
            Contribution::Sampled(light) => {
                if let (Some(stop), Some(sample)) = (self.stops.last_mut(), self.sampled) {
                    stop.sampled = Some((light, sample));
                }
            }
            // Of other strategies, and of particles.
            _ => {}
        }
    }

    fn arrives(&mut self, prim: u32, si: &SurfaceInteraction<P>) {
        self.edge().end = Some((prim, *si));
    }

    fn sampled(&mut self, sample: &EmitterSample<P>) {
        self.sampled = Some(*sample);
    }
}

/// Light that an edge met, weighed.
pub(in crate::integrator) fn met<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    edge: &Edge<P>,
) -> Rgb<P> {
    let le = |m: &MetLight<P>| {
        let e = &scene.emitters()[m.emitter as usize];
        e.eval(theta, &m.emission).scale(m.weight)
    };
    edge.met.iter().map(le).fold(Rgb::black(), |a, b| a + b)
}

/// The point on a surface that was sampled from a place; `None` for what is no surface.
pub(in crate::integrator) fn sampled_point<P: Float>(
    scene: &Scene,
    e: &AnyEmitter,
    place: &Place<P>,
    sample: &EmitterSample<P>,
) -> Option<(u32, SurfaceInteraction<P>)> {
    let AnyEmitter::Area(area) = e else {
        return None;
    };
    let prim = scene.primitive(area.shape, sample.prim);
    let at = place.si.p + sample.d * sample.distance;
    let coordinates = scene.shapes()[area.shape as usize].locate(sample.prim, at);
    Some((prim, scene.point_at(&Theta::still(), prim, coordinates)))
}
