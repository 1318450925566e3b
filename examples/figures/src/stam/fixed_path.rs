//! One path, kept, so that it can be evaluated again with other parameters: the setting of
//! [Stam 2020, figure 6].

use ad_core::{Float, Real, Vec2, Vec3};
use rayon::prelude::*;
use render::Scene;
use render::bsdf::{Bsdf, Component, Shading, TransportMode};
use render::emitter::{Emission, Emitter};
use render::estimator::{BsdfOnly, Detached};
use render::integrator::path;
use render::integrator::record::{Contribution, Interest, Observer, Place};
use render::math::Rgb;
use render::params::Theta;
use render::sampler::{Independent, Sampler};

/// A scattering event on the way.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<P> {
    /// Index of the shape.
    pub shape: u32,
    /// Surface coordinates.
    pub uv: Vec2<P>,
    /// Direction towards the camera, local frame.
    pub wo: Vec3<P>,
    /// Sampled direction, local frame.
    pub wi: Vec3<P>,
    /// The component of the BSDF that the direction was sampled from.
    pub component: Component,
    /// One over the density it was sampled with.
    pub weight: P,
}

/// A path from the camera to the first light it hits, or to its end.
#[derive(Clone, Debug, Default)]
pub struct FixedPath<P> {
    /// Scattering events, from the camera on.
    pub vertices: Vec<Vertex<P>>,
    /// The light at the end.
    pub light: Option<(u32, Emission<P>)>,
    /// Positions of the vertices, world space.
    pub positions: Vec<Vec3<P>>,
    open: Option<(u32, Vec2<P>, Vec3<P>)>,
    closed: bool,
}

/// The defaults of the trait ask for all events along a path.
impl<P: Float> Interest for FixedPath<P> {}

impl<P: Float> Observer<P> for FixedPath<P> {
    fn vertex(&mut self, _beta: Rgb<P>, place: &Place<P>) {
        if !self.closed {
            self.positions.push(place.si.p);
            self.open = Some((place.shape, place.si.uv, place.wo));
            self.closed = self.light.is_some();
        }
    }

    fn contribution(&mut self, contribution: Contribution<P>) {
        match contribution {
            Contribution::Met(met) if self.light.is_none() => {
                self.light = Some((met.emitter, met.emission));
            }
            Contribution::Scattered(b) => {
                if let (false, Some((shape, uv, wo))) = (self.closed, self.open.take()) {
                    self.vertices.push(Vertex {
                        shape,
                        uv,
                        wo,
                        wi: b.wi,
                        component: b.component,
                        weight: b.weight,
                    });
                }
            }
            _ => {}
        }
    }
}

/// Traces sample `index` of the pixel `[x, y]` with BSDF sampling, the only technique of the paper.
pub fn trace<P: Float, O: Observer<P>>(
    scene: &Scene,
    theta: &Theta<P>,
    seed: u64,
    [x, y]: [u32; 2],
    index: u64,
    observer: &mut O,
) -> Rgb<P> {
    let pixel = u64::from(y) * u64::from(scene.film.size[0]) + u64::from(x);
    let mut sampler = Independent::new(seed, pixel, index);
    let [dx, dy] = scene.film.filter.sample(sampler.next_2d::<P>());
    let centre = |p: u32| P::of(f64::from(p) + 0.5);
    let ray = scene.camera.ray(centre(x) + dx, centre(y) + dy);
    path::trace::<P, BsdfOnly<Detached>, Independent, O>(
        scene,
        theta,
        &scene.settings,
        ray,
        sampler,
        observer,
    )
}

impl<P: Float> FixedPath<P> {
    /// Records one path; see [`trace`].
    pub fn record(
        scene: &Scene,
        theta: &Theta<P>,
        seed: u64,
        pixel: [u32; 2],
        index: u64,
    ) -> (Self, Rgb<P>) {
        let mut path = Self::default();
        let l = trace(scene, theta, seed, pixel, index, &mut path);
        (path, l)
    }

    /// Whether the last position is on the light: at the depth limit light is counted, but the vertex
    /// on it is not visited.
    pub fn is_complete(&self) -> bool {
        self.closed
    }

    /// Number of scattering events on a shape.
    pub fn hits(&self, shape: impl Fn(u32) -> bool) -> usize {
        self.vertices.iter().filter(|v| shape(v.shape)).count()
    }

    /// Radiance along the path with parameters `theta`: directions and densities stay what they were.
    pub fn radiance<R: Real<Primal = P>>(&self, scene: &Scene, theta: &Theta<R>) -> Rgb<R> {
        self.radiance_with(scene, theta, |v| {
            let at = Shading::new(*theta, Vec2::new(R::lift(v.uv.x), R::lift(v.uv.y)));
            let (wo, wi) = (Vec3::lift(v.wo), Vec3::lift(v.wi));
            let mode = TransportMode::Radiance;
            scene
                .material(v.shape)
                .eval_component(&at, wo, wi, v.component, mode)
        })
    }

    /// As [`Self::radiance`], with another scattering law: `f |cos|` at a vertex.
    pub fn radiance_with<R: Real<Primal = P>>(
        &self,
        scene: &Scene,
        theta: &Theta<R>,
        mut scatter: impl FnMut(&Vertex<P>) -> Rgb<R>,
    ) -> Rgb<R> {
        let Some((emitter, emission)) = &self.light else {
            return Rgb::black();
        };
        let emission = Emission {
            uv: Vec2::new(R::lift(emission.uv.x), R::lift(emission.uv.y)),
            falloff: R::lift(emission.falloff),
        };
        let end = scene.emitters()[*emitter as usize].eval(theta, &emission);
        let beta = |b: Rgb<R>, v: &Vertex<P>| b * scatter(v).scale(v.weight);
        self.vertices.iter().fold(Rgb::splat(R::one()), beta) * end
    }
}

/// Means over samples of `K` numbers per path, per pixel: `[K][height][width]`.
pub fn images<const K: usize>(
    scene: &Scene,
    values: &[f64],
    seed: u64,
    samples: std::ops::Range<u64>,
    measure: impl Fn(&FixedPath<f64>) -> [f64; K] + Sync,
) -> [Vec<f64>; K] {
    let [width, height] = scene.film.size;
    let theta = Theta::<f64>::constant(values);
    let n = samples.end.saturating_sub(samples.start).max(1) as f64;
    let pixels: Vec<[f64; K]> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let mut sum = [0.0; K];
            for index in samples.clone() {
                let pixel = [i % width, i / width];
                let (path, _) = FixedPath::record(scene, &theta, seed, pixel, index);
                if path.light.is_some() {
                    sum.iter_mut()
                        .zip(measure(&path))
                        .for_each(|(s, m)| *s += m / n);
                }
            }
            sum
        })
        .collect();
    std::array::from_fn(|k| pixels.iter().map(|p| p[k]).collect())
}
