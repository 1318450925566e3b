//! How much of each pixel is covered: the fourth channel of an image.

use ad_core::Vec2;

use super::job::Job;
use super::tile::{Tile, place, spot, tiles};
use crate::bsdf::Shading;
use crate::bsdf::nesting::opacity;
use crate::math::Ray;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Spread;
use crate::scene::{Intersection, Scene};

/// Surfaces that a ray may pass straight through; what lies behind them covers.
const MOST_PASSED: u32 = 256;

/// The covered part of every pixel of the crop window, row by row: the mean over the image's own samples of what the
/// camera's rays meet, one for a surface, zero for nothing, and in between for what has holes. Everything is covered
/// where the sky is seen, unless [`crate::Settings::hide_emitters`] is set: then alpha and image agree on what is there. Smooth
/// panes cover by what does not pass them, on average over the channels; other glass covers, and lamps do, if they are not
/// hidden or if there is something to look through in front of them.
///
/// It depends on the arguments only, not on the number of threads. `None` if it was cancelled.
pub fn coverage(job: &Job) -> Option<Vec<f32>> {
    let scene = job.scene;
    let [width, height] = scene.film.crop_size;
    let tiles = tiles(width, height);
    let parts = parallel::map(tiles.len(), |i| of_tile(job, &tiles[i]));
    if job.progress.cancelled() {
        return None;
    }
    let mut all = vec![0.0; scene.film.pixels()];
    for (tile, part) in tiles.iter().zip(parts) {
        for (k, x) in part.into_iter().enumerate() {
            all[place(scene, tile.pixel(k))] = x as f32;
        }
    }
    Some(all)
}

fn of_tile(job: &Job, tile: &Tile) -> Vec<f64> {
    let &Job {
        scene,
        settings,
        seed,
        ref samples,
        ..
    } = job;
    let theta = Theta::constant(scene.params().values());
    let sky = !settings.hide_emitters && scene.has_sky();
    let mut sums = vec![0.0; tile.pixels()];
    if job.progress.cancelled() {
        return sums;
    }
    for (at, sample) in tile.samples::<f32, Spread>(scene, settings.points, seed, samples) {
        let covered = if sky {
            1.0
        } else {
            let (seen, _) =
                spot::<f32, Spread>(scene, settings.points, seed, sample.pixel, sample.index);
            let ray = scene.camera.ray_of(&seen);
            f64::from(along(scene, &theta, settings.hides(1), ray))
        };
        sums[at] += covered * sample.scale();
    }
    sums
}

/// How much of what a ray of the camera meets is there; `hidden`: whether it looks through lamps.
fn along(scene: &Scene, theta: &Theta<f32>, hidden: bool, mut ray: Ray<f32>) -> f32 {
    let mut open = 1.0;
    for passed in 0..MOST_PASSED {
        let Some(hit) = scene.seen(&ray, hidden && passed == 0) else {
            return 1.0 - open;
        };
        let Intersection { shape, prim, si } = scene.interaction(&Theta::still(), &ray, &hit);
        let at = Shading::new(*theta, Vec2::new(si.uv.x, si.uv.y));
        let wo = si.frame.to_local(-ray.d);
        open *= 1.0 - opacity(scene.material(shape), &at, wo);
        if open <= 0.0 {
            break;
        }
        ray = si.spawn_ray(ray.d, scene.exit(prim));
    }
    1.0
}
