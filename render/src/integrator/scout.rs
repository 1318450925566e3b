//! Paths that remember where they met light.

use std::ops::Range;

use ad_core::{Vec2, Vec3};

use super::path::{Bounce, Context, HitLight, Observer, SampledLight};
use super::render::{Paths, Progress, tiles};
use crate::emitter::Emitter;
use crate::estimator::Strategy;
use crate::guide::{Arrival, square};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{Scene, Settings};

/// An edge that left a vertex.
#[derive(Clone, Copy, Debug)]
struct Edge {
    /// Whether the vertex is diffuse.
    diffuse: bool,
    p: Vec3<f32>,
    d: Vec3<f32>,
    cosine: f32,
    /// One over density and survival probability.
    weight: f32,
    f: Rgb<f32>,
    /// Light found at its end, and light sampled at its start.
    hit: Rgb<f32>,
    sampled: Rgb<f32>,
}

/// Keeps what a [`Guide`](crate::guide::Guide) is made of.
#[derive(Clone)]
struct Scout<'a> {
    scene: &'a Scene,
    theta: &'a Theta<'a, f32>,
    /// The vertex that was reached last.
    at: (u32, Vec3<f32>),
    edges: Vec<Edge>,
    /// Light sampled at a vertex that no edge left.
    last: Rgb<f32>,
}

impl Observer<f32> for Scout<'_> {
    fn light(&mut self, _depth: u32, _beta: Rgb<f32>, light: HitLight<f32>) {
        if let Some(edge) = self.edges.last_mut() {
            let e = &self.scene.emitters()[light.emitter as usize];
            edge.hit += e.eval(self.theta, &light.emission) * light.weight;
        }
    }

    fn vertex(
        &mut self,
        _depth: u32,
        _beta: Rgb<f32>,
        shape: u32,
        _uv: Vec2<f32>,
        _wo: Vec3<f32>,
        p: Vec3<f32>,
    ) {
        self.at = (shape, p);
    }

    fn sampled(&mut self, depth: u32, light: SampledLight<f32>) {
        let edge = self.edges.get_mut(depth as usize - 1);
        *edge.map_or(&mut self.last, |e| &mut e.sampled) += light.f * light.le * light.weight;
    }

    fn bounce(&mut self, bounce: Bounce<f32>) {
        let (shape, p) = self.at;
        self.edges.push(Edge {
            diffuse: !self.scene.shape_info(shape).glossy,
            p,
            d: Vec3::zero(),
            cosine: bounce.wi.z.abs(),
            weight: bounce.weight,
            f: bounce.f,
            hit: Rgb::black(),
            sampled: Rgb::black(),
        });
    }

    fn departs(&mut self, d: Vec3<f32>) {
        if let Some(edge) = self.edges.last_mut() {
            edge.d = d;
        }
    }
}

impl Scout<'_> {
    /// What the path met, and forgets it.
    fn report(&mut self, out: &mut Vec<Arrival>) {
        let mut l = std::mem::replace(&mut self.last, Rgb::black());
        for edge in self.edges.drain(..).rev() {
            let arrives = edge.hit + l;
            l = edge.sampled + edge.f * arrives * edge.weight;
            let x = f64::from(arrives.mean() * edge.cosine);
            let energy = x * x * f64::from(edge.weight);
            if edge.diffuse && energy > 0.0 && energy.is_finite() {
                out.push(Arrival {
                    p: edge.p.to_array(),
                    from: square(edge.d),
                    energy,
                });
            }
        }
    }
}

/// Light that meets diffuse surfaces, along paths of these samples of every pixel; incomplete if stopped.
pub(crate) fn arrivals<S: Strategy, X: Sampler>(
    scene: &Scene,
    settings: &Settings,
    seed: u64,
    samples: Range<u64>,
    progress: &dyn Progress,
) -> Vec<Arrival> {
    let [width, height] = scene.film.crop_size;
    let tiles = tiles(width, height);
    let theta = Theta::constant(scene.params().values());
    let parts = parallel::map(tiles.len(), |i| {
        let mut out = Vec::new();
        if progress.cancelled() {
            return out;
        }
        let context = Context {
            scene,
            theta: &theta,
            settings,
            shifts: &[],
            caustics: settings.caustics_of::<S>(scene),
            progress,
        };
        let mut paths = Paths::<f32, S, X, _>::new(Scout {
            scene,
            theta: &theta,
            at: (0, Vec3::zero()),
            edges: Vec::new(),
            last: Rgb::black(),
        });
        tiles[i].trace(&context, seed, &samples, &mut paths, |_, _, _, scout| {
            scout.report(&mut out);
        });
        out
    });
    parts.concat()
}
