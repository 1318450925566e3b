//! What is kept of a path, and the one recursion that differentiates it.
//!
//! A path is a list of typed vertices, the first of which is the camera (or, for particles, the emitter), and what each of
//! them [contributes](Contribution). [`sweep`](sweep::sweep) goes through it from its end to its start and knows the radiance
//! at every vertex from `L_k = sampled_k + f_k w_k (met_k + L_(k+1))`: no tape of operations, no second ray tracing, and no
//! subtraction or division of radiances, so nothing cancels and a zero albedo is no special case. Where the derivatives of the
//! values go is decided at its [sinks](derivatives::DerivativeSink).

pub mod derivatives;
mod recorder;
mod second;
pub mod sweep;

use ad_core::{Real, Vec3};
pub use derivatives::SumSink;
pub use recorder::Recorder;

use super::direct::{Departure, EmitterDraw, FoundEdge};
pub use super::vertex::interest::Interest;
use crate::bsdf::{Component, Part, TransportMode};
use crate::emitter::{Emission, EmitterSample};
use crate::math::Rgb;
use crate::scene::Scene;
use crate::shape::{SurfaceCoordinates, SurfaceInteraction};

/// Where a path met a surface.
#[derive(Clone, Copy, Debug)]
pub struct Place<R> {
    /// Index of the shape.
    pub shape: u32,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// Where on it.
    pub si: SurfaceInteraction<R>,
    /// Unit direction that the path came from, local frame.
    pub wo: Vec3<R>,
}

impl<R: Real> Place<R> {
    /// The numbers that stay when the surface moves. They follow from the point and are found when they are asked for;
    /// [`Scene::point_at`] is the way back.
    pub fn coordinates(&self, scene: &Scene) -> SurfaceCoordinates<R::Primal> {
        scene.coordinates(self.prim, &self.si.primal())
    }
}

/// A vertex of a path.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<R: Real> {
    /// Throughput up to it: from the camera, or the power of a particle.
    pub beta: Rgb<R>,
    /// The surface; none at the camera or emitter that the path starts at.
    pub place: Option<Place<R>>,
    /// Where its contributions start.
    first: u32,
}

/// What happened at a vertex and on the edge from there.
#[derive(Clone, Copy, Debug)]
pub enum Contribution<R: Real> {
    /// A sample of the derivative of the distribution of normals met light, or was seen by the camera.
    Normals(NormalsLight<R>),
    /// The path goes on.
    Scattered(Bounce<R>),
    /// A light was sampled, and is visible.
    Sampled(SampledLight<R>),
    /// The edge from here found light.
    Met(MetLight<R>),
    /// All light that this edge found is differentiated by itself.
    Edge(Departure<R::Primal>, FoundEdge<R::Primal>),
    /// Of a particle: the emitter that it starts at sent it.
    Emitted(EmittedLight<R>),
    /// Of a particle: the camera sees this vertex.
    Seen(SeenVertex<R>),
    /// Of a particle: the camera sees the emitter that it starts at. The weight is what that is worth.
    SeenEmitter(u32, Emission<R>, Rgb<R::Primal>),
}

/// Light found by a ray that hit an emitter, or left the scene towards one.
#[derive(Clone, Copy, Debug)]
pub struct MetLight<R: Real> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// MIS weight.
    pub weight: R,
    /// Throughput along the edge.
    pub beta: Rgb<R>,
    /// The emitter's share of the samples of emitters, see [`crate::scene::LightChoice::share`].
    pub share: R::Primal,
}

/// A connection to a sampled light.
#[derive(Clone, Copy, Debug)]
pub struct SampledLight<R: Real> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// Direction to it, local frame of the vertex.
    pub wi: Vec3<R>,
    /// Emitted radiance.
    pub le: Rgb<R>,
    /// MIS weight over density and the probability of being kept.
    pub weight: R,
    /// Value of the BSDF.
    pub f: Rgb<R>,
    /// The same weight for the derivative through normals, where that has samples of its own.
    pub normals_weight: Option<R>,
    /// Density per solid angle that the MIS weight is made of; zero where there is none.
    pub mis_pdf: R::Primal,
    /// One over the probability that this emitter's sample was kept, see [`crate::scene::LightChoice::All`].
    pub kept: R::Primal,
    /// How the sample moves with the emitter, where a strategy wants to know.
    pub draw: Option<EmitterDraw<R::Primal>>,
}

/// What arrives along a sample of the derivative of a distribution of normals.
#[derive(Clone, Copy, Debug)]
pub struct NormalsLight<R> {
    /// Direction it comes from, local frame.
    pub wi: Vec3<R>,
    /// The mode in which the material is evaluated.
    pub mode: TransportMode,
    /// Radiance (or importance) over density, times the throughput up to the vertex, MIS weights included.
    pub li: Rgb<R>,
}

/// The sampled continuation of a path.
#[derive(Clone, Copy, Debug)]
pub struct Bounce<R: Real> {
    /// Sampled direction, local frame of the vertex.
    pub wi: Vec3<R>,
    /// What the direction belongs to.
    pub component: Component,
    /// The mode in which the material was evaluated.
    pub mode: TransportMode,
    /// One over density (or probability) and survival probability; of particles, times the kernel's weight for shading
    /// normals.
    pub weight: R,
    /// Value of the BSDF.
    pub f: Rgb<R>,
    /// What of it is differentiated.
    pub part: Part,
    /// The channel of the throughput that the survival probability is proportional to, where that is differentiated.
    pub deciding: Option<usize>,
}

/// The start of a particle.
#[derive(Clone, Copy, Debug)]
pub struct EmittedLight<R: Real> {
    /// Index of the emitter.
    pub emitter: u32,
    /// Where on it.
    pub emission: Emission<R>,
    /// The cosine over all densities.
    pub weight: R::Primal,
}

/// A vertex of a particle that the camera sees.
#[derive(Clone, Copy, Debug)]
pub struct SeenVertex<R: Real> {
    /// Direction to the camera, local frame of the vertex.
    pub wi: Vec3<R>,
    /// The mode in which the material was evaluated.
    pub mode: TransportMode,
    /// Value of the BSDF.
    pub f: Rgb<R>,
    /// What light that leaves that way is worth.
    pub importance: Rgb<R::Primal>,
}

/// Follows a path as it grows. All methods do nothing by default.
pub trait Observer<R: Real>: Interest {
    /// A surface was reached, with this throughput.
    fn vertex(&mut self, _beta: Rgb<R>, _place: &Place<R>) {}
    /// Something happened at the vertex reached last, or at the start, or on the edge from there.
    fn contribution(&mut self, _contribution: Contribution<R>) {}
    /// The edge from the last vertex, or from the start, ended at this primitive, whether or not it becomes a vertex.
    fn arrives(&mut self, _prim: u32, _si: &SurfaceInteraction<R>) {}
    /// A light was sampled at the vertex reached last, visible or not.
    fn sampled(&mut self, _sample: &EmitterSample<R::Primal>) {}
    /// A sample of the derivative of the distribution of normals took so many edges, whatever it met.
    fn branch(&mut self, _edges: u32) {}
}

/// An observer that keeps nothing.
impl<R: Real> Observer<R> for () {}

/// The vertices of one path and their contributions. Reused from path to path, it stops allocating soon.
#[derive(Clone, Debug)]
pub struct PathRecord<R: Real> {
    vertices: Vec<Vertex<R>>,
    contributions: Vec<Contribution<R>>,
    /// Edges of samples of the derivative of normals.
    branch_edges: u32,
}

impl<R: Real> Default for PathRecord<R> {
    fn default() -> Self {
        let mut record = Self {
            vertices: Vec::new(),
            contributions: Vec::new(),
            branch_edges: 0,
        };
        record.clear();
        record
    }
}

impl<R: Real> PathRecord<R> {
    /// Forgets the path: what comes next happens at the start of another one.
    pub fn clear(&mut self) {
        self.vertices.clear();
        self.contributions.clear();
        self.branch_edges = 0;
        self.push(Rgb::splat(R::one()), None);
    }

    #[inline]
    fn push(&mut self, beta: Rgb<R>, place: Option<Place<R>>) {
        let first = self.contributions.len() as u32;
        self.vertices.push(Vertex { beta, place, first });
    }

    /// All vertices; the first is the start of the path.
    pub fn vertices(&self) -> &[Vertex<R>] {
        &self.vertices
    }

    /// What happened at vertex `k` and on the edge from there, in the order of its happening.
    pub fn contributions(&self, k: usize) -> &[Contribution<R>] {
        let first = self.vertices[k].first as usize;
        let end = (self.vertices.get(k + 1)).map_or(self.contributions.len(), |v| v.first as usize);
        &self.contributions[first..end]
    }

    /// What happened anywhere.
    pub fn all_contributions(&self) -> &[Contribution<R>] {
        &self.contributions
    }

    /// What the path cost, in edges.
    pub(super) fn work(&self) -> u32 {
        let last = self.contributions(self.vertices.len() - 1);
        let beyond = last.iter().any(|c| matches!(c, Contribution::Met(_)));
        (self.vertices.len() + usize::from(beyond)) as u32 + self.branch_edges
    }
}

/// Everything is wanted.
impl<R: Real> Interest for PathRecord<R> {}

impl<R: Real> Observer<R> for PathRecord<R> {
    #[inline]
    fn vertex(&mut self, beta: Rgb<R>, place: &Place<R>) {
        self.push(beta, Some(*place));
    }

    #[inline]
    fn contribution(&mut self, contribution: Contribution<R>) {
        self.contributions.push(contribution);
    }

    #[inline]
    fn branch(&mut self, edges: u32) {
        self.branch_edges += edges;
    }
}
