//! Bundles of rays through the hierarchy.
//!
//! Paths of one pixel stay close for a vertex or two: their rays visit the same nodes, which are then unpacked
//! once and tested with a lane per ray. Where only a few rays of a bundle are left, these go on alone.

use super::bundle::{BUNDLE, Bundle};
use super::bvh::{MIN_COMPONENT, SLACK, Tree, widen};
use super::curved::Line;
use super::packet::RayLanes;
use super::{Best, Hit, Ray};
use crate::math::each;
use obvhs::cwbvh::node::CwBvhNode;
use wide::{f32x8, f32x16};

/// Up to this number of rays are faster one by one. Measured.
const FEW: u32 = 2;

/// A node that some rays of a bundle still have to visit.
struct Visit {
    node: u32,
    /// One bit per ray.
    rays: u32,
    /// Where each ray enters it.
    near: f32x16,
}

/// A bundle prepared for node tests.
struct Convoy<'a> {
    bundle: &'a Bundle,
    lanes: RayLanes<f32x16>,
    o: [f32x16; 3],
    inverse: [f32x16; 3],
    /// Widening of every box.
    slack: f32,
    /// Order in which children are visited: that of the first ray.
    octant: u32,
}

/// The children of a node that rays enter.
struct Entered {
    rays: [u32; 8],
    near: [f32x16; 8],
}

impl<'a> Convoy<'a> {
    #[inline(always)]
    fn new(bundle: &'a Bundle, tree: &Tree) -> Self {
        let (o, d) = bundle.lanes();
        let mut reach = f32x16::splat(0.0);
        for (o, (center, half)) in o.iter().zip(tree.center.iter().zip(tree.half)) {
            reach += (*o - f32x16::splat(*center)).abs() + f32x16::splat(half);
        }
        let reach = reach.to_array()[..bundle.len()]
            .iter()
            .fold(0.0, |m: f32, x| m.max(*x));
        let inverse = each(d, |d| {
            let mut d = d.to_array();
            for x in &mut d {
                *x = 1.0 / x.abs().max(MIN_COMPONENT).copysign(*x);
            }
            f32x16::from(d)
        });
        let negative = |k: usize| u32::from(bundle.ray(0).1[k] < 0.0);
        Self {
            bundle,
            lanes: RayLanes::of(o, d),
            o,
            inverse,
            slack: SLACK * reach,
            octant: 7 ^ (negative(0) << 2 | negative(1) << 1 | negative(2)),
        }
    }

    /// Which of `rays` enter which children before their `limit`.
    #[inline(always)]
    fn test(&self, node: &CwBvhNode, rays: u32, limit: f32x16) -> Entered {
        let p = node.p.to_array();
        let slack = f32x8::splat(self.slack);
        let plane = |k: usize, lo: &[u8; 8], hi: &[u8; 8]| {
            let scale = f32x8::splat(f32::from_bits(u32::from(node.e[k]) << 23));
            let lo = (widen(lo) * scale - slack).to_array();
            let hi = (widen(hi) * scale + slack).to_array();
            let base = (f32x16::splat(p[k]) - self.o[k]) * self.inverse[k];
            (lo, hi, base)
        };
        let planes = [
            plane(0, &node.child_min_x, &node.child_max_x),
            plane(1, &node.child_min_y, &node.child_max_y),
            plane(2, &node.child_min_z, &node.child_max_z),
        ];
        let mut entered = Entered {
            rays: [0; 8],
            near: [f32x16::splat(0.0); 8],
        };
        for child in 0..8 {
            let mut near = f32x16::splat(0.0);
            let mut far = limit;
            for (k, (lo, hi, base)) in planes.iter().enumerate() {
                let a = f32x16::splat(lo[child]).mul_add(self.inverse[k], *base);
                let b = f32x16::splat(hi[child]).mul_add(self.inverse[k], *base);
                near = near.fast_max(a.fast_min(b));
                far = far.fast_min(a.fast_max(b));
            }
            let present = if node.child_meta[child] == 0 { 0 } else { rays };
            entered.rays[child] = near.simd_le(far).to_bitmask() & present;
            entered.near[child] = near;
        }
        entered
    }

    #[inline(always)]
    fn ray(&self, lane: usize) -> Option<Ray> {
        let (o, d, _) = self.bundle.ray(lane);
        Ray::new(o, d)
    }
}

/// The lanes of a mask.
#[inline(always)]
fn lanes(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        mask &= mask.wrapping_sub(1);
        (lane < BUNDLE).then_some(lane)
    })
}

/// The nearest hits so far.
struct Nearest {
    t: f32x16,
    best: [Best; BUNDLE],
}

impl Tree {
    /// The nearest hit of every ray, or `None` if one of them needs special care.
    #[inline(never)]
    pub(super) fn intersect_bundle(
        &self,
        bundle: &Bundle,
        hits: &mut [Option<Hit>; BUNDLE],
    ) -> Option<()> {
        let start = bundle.limits()?;
        let mut nearest = Nearest {
            t: f32x16::from(start),
            best: [Best::new(0.0); BUNDLE],
        };
        for (best, t) in nearest.best.iter_mut().zip(&start) {
            *best = Best::new(*t);
        }
        let convoy = Convoy::new(bundle, self);
        self.follow(
            &convoy,
            &mut nearest,
            |nearest| (nearest.t, u32::MAX),
            |nearest, slot, rays| self.offer_lanes(&convoy, slot, rays, nearest),
            |nearest, node, lane, ray| {
                self.intersect_from(node, ray, &mut nearest.best[lane]);
                let mut t = nearest.t.to_array();
                t[lane] = nearest.best[lane].t;
                nearest.t = f32x16::from(t);
            },
        );
        for (hit, best) in hits.iter_mut().zip(&nearest.best).take(bundle.len()) {
            *hit = best.hit();
        }
        Some(())
    }

    /// One bit per ray that hits anything, or `None` if a ray needs special care.
    #[inline(never)]
    pub(super) fn occluded_bundle(&self, bundle: &Bundle) -> Option<u32> {
        let limits = bundle.limits()?;
        let t_max = f32x16::from(limits);
        let convoy = Convoy::new(bundle, self);
        let mut occluded = 0;
        self.follow(
            &convoy,
            &mut occluded,
            |occluded| (t_max, !*occluded),
            |occluded, slot, rays| match self.curved_at(slot) {
                Some(c) => {
                    for lane in lanes(rays) {
                        let hit = convoy
                            .ray(lane)
                            .is_some_and(|r| c.occluded(&Line::of(&r), limits[lane]));
                        *occluded |= u32::from(hit) << lane;
                    }
                }
                None => {
                    let (hit, ..) = self.flat[slot].test_lanes(&convoy.lanes, t_max);
                    *occluded |= hit.to_bitmask() & rays;
                }
            },
            |occluded, node, lane, ray| {
                *occluded |= u32::from(self.occluded_from(node, ray, limits[lane])) << lane;
            },
        );
        Some(occluded)
    }

    /// Offers the primitive of a slot to some rays.
    #[inline(always)]
    fn offer_lanes(&self, convoy: &Convoy, slot: usize, rays: u32, nearest: &mut Nearest) {
        let prim = self.prims[slot];
        if let Some(c) = self.curved_at(slot) {
            let mut t = nearest.t.to_array();
            for lane in lanes(rays) {
                let best = &mut nearest.best[lane];
                let hit = convoy
                    .ray(lane)
                    .and_then(|r| c.intersect(&Line::of(&r), best.t));
                if let Some((t, u, v)) = hit {
                    best.offer(t, u, v, prim);
                }
                t[lane] = best.t;
            }
            nearest.t = f32x16::from(t);
            return;
        }
        // One rounding more, so that equal distances pass; the offer decides.
        let reach = nearest.t * f32x16::splat(1.0 + f32::EPSILON);
        let (hit, t, u, v) = self.flat[slot].test_lanes(&convoy.lanes, reach);
        let hit = hit.to_bitmask() & rays;
        if hit != 0 {
            let (t, u, v) = (t.to_array(), u.to_array(), v.to_array());
            for lane in lanes(hit) {
                nearest.best[lane].offer(t[lane], u[lane], v[lane], prim);
            }
            let mut t = [0.0; BUNDLE];
            for (t, best) in t.iter_mut().zip(&nearest.best) {
                *t = best.t;
            }
            nearest.t = f32x16::from(t);
        }
    }

    /// Visits the nodes that rays of a bundle enter, roughly front to back. `limit` tells the distances up to
    /// which the rays look and which of them still do, `leaf` tests a leaf slot for some rays, and `alone`
    /// everything below a node for one.
    #[inline(always)]
    fn follow<T>(
        &self,
        convoy: &Convoy,
        state: &mut T,
        limit: impl Fn(&T) -> (f32x16, u32),
        mut leaf: impl FnMut(&mut T, usize, u32),
        mut alone: impl FnMut(&mut T, u32, usize, &Ray),
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let mut open = Vec::with_capacity(64);
        open.push(Visit {
            node: 0,
            rays: (1 << convoy.bundle.len()) - 1,
            near: f32x16::splat(0.0),
        });
        while let Some(visit) = open.pop() {
            let (far, looking) = limit(state);
            let rays = visit.rays & looking & visit.near.simd_le(far).to_bitmask();
            if rays.count_ones() <= FEW {
                for lane in lanes(rays) {
                    if let Some(ray) = convoy.ray(lane) {
                        alone(state, visit.node, lane, &ray);
                    }
                }
                continue;
            }
            let node = &self.nodes[visit.node as usize];
            let entered = convoy.test(node, rays, far);
            for child in 0..8 {
                let rays = entered.rays[child];
                if rays == 0 || node.imask >> child & 1 != 0 {
                    continue;
                }
                let meta = node.child_meta[child];
                let first = (node.primitive_base_idx + u32::from(meta & 31)) as usize;
                for slot in first..first + (meta >> 5).count_ones() as usize {
                    leaf(state, slot, rays);
                }
            }
            for k in 0..8 {
                let child = k ^ convoy.octant;
                let rays = entered.rays[child as usize];
                if rays != 0 && node.imask >> child & 1 != 0 {
                    let before = u32::from(node.imask) & !(u32::MAX << child);
                    open.push(Visit {
                        node: node.child_base_idx + before.count_ones(),
                        rays,
                        near: entered.near[child as usize],
                    });
                }
            }
        }
    }
}
