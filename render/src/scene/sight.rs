//! What the camera sees where lamps are hidden ([`Settings::hide_emitters`](super::Settings::hide_emitters)): whatever lies
//! behind them.
//!
//! A ray of the camera that meets a lamp is traced once more against all that is none, from where it started. What it meets is
//! then, bit by bit, what it would meet if there were no lamps: nothing starts behind a lamp, and nothing has to be told from
//! it by its distance, be it as near as a ceiling that a lamp lies in. What is traced against is made when the first ray asks.

use ad_core::{Float, Real};

use super::{Scene, single};
use crate::accel::Hit;
use crate::math::{Ray, Segment};

impl Scene {
    /// [`Scene::nearest`] for a ray of the camera, which lamps do not stop if they are `hidden`. Its distance is counted
    /// from the start of the ray.
    #[inline(always)]
    pub fn seen<R: Real>(&self, ray: &Ray<R>, hidden: bool) -> Option<Hit> {
        let hit = self.nearest(ray)?;
        if hidden {
            self.behind_lamps(ray, hit)
        } else {
            Some(hit)
        }
    }

    /// What a ray of the camera sees where lamps are hidden, given what it meets.
    #[cold]
    #[inline(never)]
    pub(crate) fn behind_lamps<R: Real>(&self, ray: &Ray<R>, hit: Hit) -> Option<Hit> {
        if !self.is_lamp(self.shape_of(hit.prim)) {
            return Some(hit);
        }
        let (o, d) = single(&ray.primal());
        let others = self.geometry.without_lamps(&self.infos, &self.camera);
        others.intersect(o, d, f32::INFINITY, ray.from)
    }

    /// [`Scene::occluded`] for a segment that ends at the camera, which lamps do not block if they are `hidden`.
    #[inline(always)]
    pub fn out_of_sight<P: Float>(&self, segment: &Segment<P>, hidden: bool) -> bool {
        self.occluded(segment) && !(hidden && self.only_lamps_occlude(segment))
    }

    /// Whether lamps are all that lies in between, if anything does.
    #[cold]
    #[inline(never)]
    pub(crate) fn only_lamps_occlude<P: Float>(&self, segment: &Segment<P>) -> bool {
        let Segment { ray, length, to } = segment;
        let (o, d) = single(ray);
        let others = self.geometry.without_lamps(&self.infos, &self.camera);
        !others.occluded(o, d, length.to_f32(), [ray.from, *to])
    }

    /// Whether a shape emits.
    #[inline]
    pub(crate) fn is_lamp(&self, shape: u32) -> bool {
        self.shape_info(shape).emitter.is_some()
    }
}
