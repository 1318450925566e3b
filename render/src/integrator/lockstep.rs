//! Many paths at once: their rays are traced together.

use ad_core::{Float, Real, Vec3};

use super::progress::Progress;
use crate::accel::{Hit, PACKET_SIZE, RayPacket};
use crate::math::{NOWHERE, Ray, Segment};
use crate::params::Theta;
use crate::scene::{Intersection, Scene, single};

/// Paths that are followed at a time. More fill the packets better, fewer stay in the cache.
pub(super) const GROUP: usize = 64;

/// Rays on the way to be traced, and the paths that asked for them.
#[derive(Default)]
struct Queue {
    rays: RayPacket,
    paths: [usize; PACKET_SIZE],
}

impl Queue {
    #[inline(always)]
    fn push<P: Float>(&mut self, ray: &Ray<P>, t_max: f32, to: u32, path: usize) {
        self.paths[self.rays.len() % PACKET_SIZE] = path;
        let (o, d) = single(ray);
        self.rays.push(o, d, t_max, [ray.from, to]);
    }

    /// The paths, in the order of the rays.
    #[inline(always)]
    fn paths(&self) -> &[usize] {
        &self.paths[..self.rays.len()]
    }
}

/// What asks for rays: one to its next vertex, one to what may be seen from the last.
pub(super) trait Traveller {
    /// Scalar of the geometry.
    type Geometry: Real;
    /// Whether what may be seen from its last vertex is the camera.
    const IS_SEEN: bool;
    /// To the next vertex.
    fn ray(&self) -> Option<&Ray<Self::Geometry>>;
    /// Whether nothing is in the way.
    fn shadow(&self) -> Option<&Segment<<Self::Geometry as Real>::Primal>>;
    /// Whether the ray to its next vertex is one of the camera.
    fn looks(&self) -> bool;
    /// Whether no ray is asked for.
    #[inline(always)]
    fn ended(&self) -> bool {
        self.ray().is_none() && self.shadow().is_none()
    }
}

/// How many edges of a path alone are followed between two looks at whether to stop.
const LOOK: u32 = 64;

/// Follows one path to its end, ray by ray; `hidden` and `step` as in [`trace`]. Where `progress` is cancelled, a long path
/// ends early.
pub(super) fn trace_alone<T: Traveller>(
    scene: &Scene,
    theta: &Theta<T::Geometry>,
    hidden: bool,
    progress: &dyn Progress,
    traveller: &mut T,
    mut step: impl FnMut(&mut T, Option<Intersection<T::Geometry>>, bool),
) {
    for edge in 1u32.. {
        if traveller.ended() || (edge % LOOK == 0 && progress.cancelled()) {
            break;
        }
        let hit = (traveller.ray()).and_then(|ray| {
            let hit = scene.seen(ray, hidden && traveller.looks())?;
            Some(scene.interaction(theta, ray, &hit))
        });
        let free = |s| !scene.out_of_sight(s, hidden && T::IS_SEEN);
        let visible = traveller.shadow().is_some_and(free);
        step(traveller, hit, visible);
    }
}

/// Signs of a direction.
#[inline(always)]
pub(super) fn octant<P: Float>(d: Vec3<P>) -> usize {
    let bit = |x: P, k: usize| usize::from(x < P::zero()) << k;
    bit(d.x, 0) | bit(d.y, 1) | bit(d.z, 2)
}

/// Paths in the order of their keys, at most 8.
#[inline(always)]
pub(super) fn sorted<'a>(
    paths: &[usize],
    key: impl Fn(usize) -> usize,
    order: &'a mut [usize; GROUP],
) -> &'a [usize] {
    let mut ends = [0; 9];
    let mut keys = [0; GROUP];
    for (&path, k) in paths.iter().zip(&mut keys) {
        *k = key(path) % 9;
        ends[*k] += 1;
    }
    let mut first = 0;
    for end in &mut ends {
        first += std::mem::replace(end, first);
    }
    for (&path, k) in paths.iter().zip(&keys) {
        order[ends[*k] % GROUP] = path;
        ends[*k] += 1;
    }
    &order[..paths.len()]
}

/// Follows up to [`GROUP`] paths to their ends. `step` takes one on, given its index, what its ray met and
/// whether its shadow ray was free; `hidden`: whether the camera looks through lamps. Where `progress` is cancelled, they
/// stay where they are.
pub(super) fn trace<T: Traveller>(
    scene: &Scene,
    theta: &Theta<T::Geometry>,
    hidden: bool,
    progress: &dyn Progress,
    travellers: &mut [T],
    mut step: impl FnMut(usize, &mut T, Option<Intersection<T::Geometry>>, bool),
) {
    let mut hits: [Option<Hit>; GROUP] = [None; GROUP];
    let mut visible = [false; GROUP];
    let (mut nearest, mut shadow) = (Queue::default(), Queue::default());
    let mut open: [usize; GROUP] = std::array::from_fn(|i| i);
    let mut order = [0; GROUP];
    let mut met = Vec::with_capacity(travellers.len());
    let mut n = travellers.len();
    while n > 0 && !progress.cancelled() {
        let mut find = |queue: &mut Queue| {
            let found = scene.nearest_packet(&queue.rays);
            for (&path, hit) in queue.paths().iter().zip(found) {
                hits[path] = hit;
            }
            queue.rays.clear();
        };
        let mut test = |queue: &mut Queue| {
            let occluded = scene.occluded_packet(&queue.rays);
            for (i, &path) in queue.paths().iter().enumerate() {
                visible[path] = occluded >> i & 1 == 0;
            }
            queue.rays.clear();
        };
        // Together with their like: few nodes of a hierarchy, in an order that suits them all.
        let key = |path: usize| travellers[path].ray().map_or(8, |r| octant(r.primal().d));
        let like = if scene.has_hierarchy() {
            sorted(&open[..n], key, &mut order)
        } else {
            &open[..n]
        };
        for &path in like {
            if let Some(ray) = travellers[path].ray() {
                nearest.push(&ray.primal(), f32::INFINITY, NOWHERE, path);
                if nearest.rays.is_full() {
                    find(&mut nearest);
                }
            }
        }
        for &path in &open[..n] {
            if let Some(Segment { ray, length, to }) = travellers[path].shadow() {
                shadow.push(ray, length.to_f32(), *to, path);
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
            let ray = travellers[path].ray()?;
            let mut hit = hits[path].take()?;
            if hidden && travellers[path].looks() {
                hit = scene.behind_lamps(ray, hit)?;
            }
            Some(scene.interaction(theta, ray, &hit))
        }));
        if T::IS_SEEN && hidden {
            for &path in &open[..n] {
                let shadow = travellers[path].shadow().filter(|_| !visible[path]);
                visible[path] |= shadow.is_some_and(|s| scene.only_lamps_occlude(s));
            }
        }
        let mut left = 0;
        for k in 0..n {
            let path = open[k];
            let traveller = &mut travellers[path];
            step(path, traveller, met[k], visible[path]);
            open[left] = path;
            left += usize::from(!traveller.ended());
        }
        n = left;
    }
}
