//! Where a path is on its way over a chain of specular vertices: for those who ask what it met at the end.

use ad_core::{Float, Real, Vec3};
use smallvec::SmallVec;

use super::record::{Bounce, Place};
use crate::bsdf::{Component, DeltaKind};
use crate::manifold::{Link, Met, Run, Split, Start, cast};
use crate::shape::SurfaceInteraction;

/// The chain that a path is on.
#[derive(Clone, Debug)]
pub(super) struct ChainTrail {
    run: Run,
    /// Whether the path left its last vertex, or the camera, along a delta.
    along_delta: bool,
    /// The material of the last vertex, and the side that the path came from.
    material: u32,
    wo_z: f64,
    /// The last receiver, and most vertices of a chain from there.
    start: Option<(Start, u32)>,
    /// Casters since then.
    links: SmallVec<[Link; 2]>,
    /// Where the last edge ended, if it met a surface.
    end: Option<(u32, SurfaceInteraction<f64>)>,
}

impl Default for ChainTrail {
    fn default() -> Self {
        Self {
            run: Run::default(),
            along_delta: true,
            material: 0,
            wo_z: 0.0,
            start: None,
            links: SmallVec::new(),
            end: None,
        }
    }
}

fn double<R: Real>(v: Vec3<R>) -> Vec3<f64> {
    v.map(|x| x.primal().to_f64())
}

impl ChainTrail {
    /// Back at the camera.
    pub fn restart(&mut self) {
        (self.run, self.along_delta, self.start) = (Run::default(), true, None);
        self.links.clear();
        self.end = None;
    }

    /// The path arrives at a vertex of a material, from which chains of at most `most` vertices may start.
    pub fn vertex<R: Real>(
        &mut self,
        split: &Split,
        (place, material): (&Place<R>, u32),
        start: Start,
        most: u32,
    ) {
        (self.material, self.wo_z) = (material, place.wo.z.primal().to_f64());
        self.run = split.next(self.run, place.shape, self.along_delta);
        match self.run.behind() {
            Some(0) => {
                self.start = Some((start, most));
                self.links.clear();
            }
            // What is not known yet follows when the path goes on.
            Some(_) => self.links.push(Link {
                shape: place.shape,
                prim: place.prim,
                si: start.si,
                wo: double(place.wo),
                wi: Vec3::zero(),
                kind: DeltaKind::Reflection,
                density: None,
            }),
            None => {}
        }
    }

    /// The path leaves its last vertex.
    pub fn leaves<R: Real>(&mut self, split: &Split, bounce: &Bounce<R>) {
        self.end = None;
        self.along_delta = matches!(bounce.component, Component::Delta { .. });
        let reflects = self.wo_z * bounce.wi.z.primal().to_f64() > 0.0;
        self.run = split.leaves(self.run, self.material, self.along_delta, reflects);
        if let Some(link) = self.links.last_mut() {
            link.wi = double(bounce.wi);
            link.kind = match bounce.component {
                Component::Delta { kind, .. } => kind,
                Component::Continuous if link.wo.z * link.wi.z > 0.0 => DeltaKind::Reflection,
                Component::Continuous => DeltaKind::Transmission,
            };
        }
    }

    /// An edge ends at a surface.
    pub fn arrives<R: Real>(&mut self, prim: u32, si: &SurfaceInteraction<R>) {
        self.end = Some((prim, cast(&si.primal())));
    }

    /// The chain that ends at this emitter, where manifold connections find such light.
    pub fn met(&self, split: &Split, emitter: u32) -> Option<Met<'_>> {
        let whole = split.finds(self.run, emitter);
        let (start, most) = self.start.as_ref().filter(|_| whole)?;
        Some(Met {
            start,
            links: &self.links,
            most: *most,
            emitter,
            end: self.end,
        })
    }
}
