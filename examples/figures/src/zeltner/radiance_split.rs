//! Radiance along one ray, split by the technique that found the direct light.

use std::ops::Range;

use render::Scene;
use render::emitter::Emitter;
use render::estimator::{Detached, DetachedWeights, Mis, Power};
use render::integrator::path::trace;
use render::integrator::record::{Contribution, Interest, Observer, Place};
use render::math::{Ray, Rgb};
use render::params::Theta;
use render::sampler::{Independent, Sampler};

/// Sums over the samples of a ray.
#[derive(Clone, Copy, Debug, Default)]
pub struct Split {
    /// Radiance.
    pub total: [f64; 3],
    /// Its part emitted by the first surface.
    pub emitted: [f64; 3],
    /// Its part that rays from the first surface found: BSDF sampling, weighted.
    pub bsdf: [f64; 3],
    /// Its part that connections from the first surface found: emitter sampling, weighted.
    pub emitter: [f64; 3],
}

fn add(sum: &mut [f64; 3], c: Rgb<f32>) {
    for (s, x) in sum.iter_mut().zip(c.to_array()) {
        *s += f64::from(x);
    }
}

/// Observer of a path that sums its contributions by technique; the emission at its vertices is read from the scene.
struct Watch<'a> {
    scene: &'a Scene,
    theta: &'a Theta<'a, f32>,
    split: Split,
    /// Throughput up to the vertex reached last.
    beta: Rgb<f32>,
    /// Surfaces reached so far.
    vertices: usize,
}

impl Interest for Watch<'_> {}

impl Observer<f32> for Watch<'_> {
    fn vertex(&mut self, beta: Rgb<f32>, _place: &Place<f32>) {
        self.beta = beta;
        self.vertices += 1;
    }

    fn contribution(&mut self, contribution: Contribution<f32>) {
        match contribution {
            Contribution::Met(light) => {
                let emitter = &self.scene.emitters()[light.emitter as usize];
                let le = emitter.eval(self.theta, &light.emission);
                let found = light.beta * le * light.weight;
                match self.vertices {
                    0 => add(&mut self.split.emitted, found),
                    1 => add(&mut self.split.bsdf, found),
                    _ => {}
                }
            }
            Contribution::Sampled(light) if self.vertices == 1 => {
                let found = self.beta * light.f * light.le * light.weight;
                add(&mut self.split.emitter, found);
            }
            _ => {}
        }
    }
}

/// Means over the samples `samples` of the ray that `ray` makes of two random numbers. `stream` tells
/// rays apart. MIS with the power heuristic; non-finite samples count as an error.
///
/// # Errors
/// A sample that is not finite.
pub fn radiance(
    scene: &Scene,
    ray: impl Fn([f32; 2]) -> Ray<f32>,
    max_depth: u32,
    seed: u64,
    stream: u64,
    samples: Range<u64>,
) -> examples::figure::Result<Split> {
    type Strategy = Mis<Detached, Detached, DetachedWeights, Power>;
    let theta = Theta::constant(scene.params().values());
    let mut settings = scene.settings;
    settings.max_depth = max_depth;
    let mut watch = Watch {
        scene,
        theta: &theta,
        split: Split::default(),
        beta: Rgb::splat(1.0),
        vertices: 0,
    };
    let n = samples.end.saturating_sub(samples.start).max(1) as f64;
    for index in samples {
        let mut sampler = Independent::new(seed, stream, index);
        let ray = ray(sampler.next_2d());
        let settings = &settings;
        watch.vertices = 0;
        let l = trace::<f32, Strategy, Independent, Watch>(
            scene, &theta, settings, ray, sampler, &mut watch,
        );
        if !l.is_finite() {
            return Err(format!("sample {index} of stream {stream} is not finite").into());
        }
        add(&mut watch.split.total, l);
    }
    let mean = |sum: [f64; 3]| sum.map(|s| s / n);
    let Split {
        total,
        emitted,
        bsdf,
        emitter,
    } = watch.split;
    Ok(Split {
        total: mean(total),
        emitted: mean(emitted),
        bsdf: mean(bsdf),
        emitter: mean(emitter),
    })
}
