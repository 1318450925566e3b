//! Many paths at once: their rays are traced together.

use ad_core::{Float, Real};

use super::path::{Context, Observer, Walk};
use crate::accel::{BUNDLE, Bundle, Hit};
use crate::estimator::Strategy;
use crate::math::Ray;
use crate::sampler::Sampler;
use crate::scene::single;

/// Paths that are followed at a time. More fill the bundles better, fewer stay in the cache.
pub(super) const PATHS: usize = 64;

/// Rays on the way to be traced, and the paths that asked for them.
#[derive(Default)]
struct Queue {
    rays: Bundle,
    paths: [usize; BUNDLE],
}

impl Queue {
    #[inline(always)]
    fn push<P: Float>(&mut self, ray: &Ray<P>, t_max: f32, path: usize) {
        self.paths[self.rays.len() % BUNDLE] = path;
        let (o, d) = single(ray);
        self.rays.push(o, d, t_max);
    }

    /// The paths, in the order of the rays.
    #[inline(always)]
    fn paths(&self) -> &[usize] {
        &self.paths[..self.rays.len()]
    }
}

/// Follows up to [`PATHS`] paths to their ends; each has an observer of its own.
pub(super) fn trace<R: Real, S: Strategy, X: Sampler, O: Observer<R>>(
    context: &Context<R>,
    walks: &mut [Walk<R, S, X>],
    observers: &mut [O],
) {
    let scene = context.scene;
    let mut hits: [Option<Hit>; PATHS] = [None; PATHS];
    let mut visible = [false; PATHS];
    let (mut nearest, mut shadow) = (Queue::default(), Queue::default());
    let mut open: [usize; PATHS] = std::array::from_fn(|i| i);
    let mut met = Vec::with_capacity(walks.len());
    let mut n = walks.len();
    while n > 0 {
        let mut find = |queue: &mut Queue| {
            let found = scene.nearest_bundle(&queue.rays);
            for (&path, hit) in queue.paths().iter().zip(found) {
                hits[path] = hit;
            }
            queue.rays.clear();
        };
        let mut test = |queue: &mut Queue| {
            let occluded = scene.occluded_bundle(&queue.rays);
            for (i, &path) in queue.paths().iter().enumerate() {
                visible[path] = occluded >> i & 1 == 0;
            }
            queue.rays.clear();
        };
        for &path in &open[..n] {
            let walk = &walks[path];
            if let Some(ray) = &walk.ray {
                nearest.push(&ray.primal(), f32::INFINITY, path);
                if nearest.rays.is_full() {
                    find(&mut nearest);
                }
            }
            if let Some((ray, t_max)) = &walk.shadow {
                shadow.push(ray, t_max.to_f32(), path);
                if shadow.rays.is_full() {
                    test(&mut shadow);
                }
            }
        }
        if !nearest.rays.is_empty() {
            find(&mut nearest);
        }
        if !shadow.rays.is_empty() {
            test(&mut shadow);
        }
        // A loop of its own, so that it waits for the memory of several surfaces at a time.
        met.clear();
        met.extend(open[..n].iter().map(|&path| {
            let ray = walks[path].ray.as_ref()?;
            hits[path].take().map(|hit| scene.interaction(ray, &hit))
        }));
        let mut left = 0;
        for k in 0..n {
            let path = open[k];
            let walk = &mut walks[path];
            walk.step(context, met[k], visible[path], &mut observers[path]);
            open[left] = path;
            left += usize::from(!walk.ended());
        }
        n = left;
    }
}
