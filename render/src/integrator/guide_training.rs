//! Paths that remember where they met light.

use std::ops::Range;

use ad_core::Vec3;

use super::path::Context;
use super::progress::Progress;
use super::record::sweep::{Arriving, Visitor, sweep};
use super::record::{Bounce, PathRecord, Place, Vertex};
use super::tile::{Paths, tiles};
use super::vertex::light::is_led;
use crate::bsdf::Component;
use crate::emitter::{Emission, Emitter};
use crate::estimator::Strategy;
use crate::guide::{Arrival, square};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{Scene, Settings};

/// Keeps what a [`Guide`](crate::guide::Guide) is made of.
struct ArrivalCollector<'a> {
    scene: &'a Scene,
    theta: &'a Theta<'a, f32>,
    arrivals: &'a mut Vec<Arrival>,
}

impl Visitor<f32> for ArrivalCollector<'_> {
    type Scalar = f32;

    fn emitted(&mut self, emitter: u32, emission: &Emission<f32>, _beta: Rgb<f32>) -> Rgb<f32> {
        self.scene.emitters()[emitter as usize].eval(self.theta, emission)
    }

    fn value(&mut self, _: &Place<f32>, _: Vec3<f32>, _: Component, f: Rgb<f32>) -> Rgb<f32> {
        f
    }

    fn scattered(
        &mut self,
        _vertex: &Vertex<f32>,
        place: &Place<f32>,
        bounce: &Bounce<f32>,
        arriving: &Arriving<f32>,
    ) {
        let x = f64::from(arriving.all().mean() * bounce.wi.z.abs());
        let energy = x * x * f64::from(bounce.weight);
        if is_led(self.scene.shape_info(place.shape)) && energy > 0.0 && energy.is_finite() {
            self.arrivals.push(Arrival {
                p: place.si.p.to_array(),
                from: square(place.si.frame.to_world(bounce.wi)),
                energy,
            });
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
        let caustics = settings.caustics_of::<S>(scene);
        let context = Context::new(scene, &theta, settings, caustics, progress);
        let mut paths = Paths::<f32, S, X, _>::new(PathRecord::default());
        tiles[i].trace(&context, (seed, &samples), &mut paths, |_, _, _, path| {
            let arrivals = &mut out;
            sweep(
                path,
                &mut ArrivalCollector {
                    scene,
                    theta: &theta,
                    arrivals,
                },
            );
            path.clear();
        });
        out
    });
    parts.concat()
}
