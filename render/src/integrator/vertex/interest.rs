//! What of a path is wanted: by an observer, and of light on its next edge.

use ad_core::Float;

use crate::bsdf::{Component, DeltaKind};
use crate::manifold::{Run, Split};
use crate::scene::{Caustics, ShapeInfo};

/// What an observer of paths wants to know.
pub trait Interest {
    /// Whether events are wanted; if not, none is made, and nothing that only derivatives need is done.
    const ENABLED: bool = true;
    /// Whether it looks for light, if nothing else says so; otherwise it wants to know vertices alone.
    const LIGHT: bool = true;
    /// Whether it wants to know the light behind a vertex of this material: because that is differentiated.
    fn differentiates(&self, _material: u32) -> bool {
        Self::LIGHT
    }
    /// Whether the roughness of this material is: only then its normals have samples of their own.
    fn differentiates_roughness(&self, _material: u32) -> bool {
        Self::LIGHT
    }
    /// Whether it wants to know all light, since emission is differentiated.
    fn differentiates_emission(&self) -> bool {
        Self::LIGHT
    }
}

/// An observer that wants nothing but the radiance.
impl Interest for () {
    const ENABLED: bool = false;
}

/// Why light on the next edge of a path counts, or does not.
#[derive(Clone, Copy, Debug, Default)]
pub struct PathInterest {
    /// Whether a vertex so far is one that the observer differentiates.
    pub active: bool,
    /// Whether others find caustics on the first vertex.
    pub caustics_excluded: bool,
    /// Whether light on this edge would be one, or is found by others for another reason.
    pub caustic: bool,
    /// Where it is on its way over a specular chain, where manifold connections find light.
    pub run: Run,
    /// Whether anything so far did more to it than to let it pass straight: what is behind holes and panes is seen.
    pub bent: bool,
}

impl PathInterest {
    /// Whether light on the edge counts: what no derivative needs is not looked at.
    #[inline(always)]
    pub fn lit<W: Interest>(&self, interest: &W) -> bool {
        (!W::ENABLED || self.active || interest.differentiates_emission()) && !self.caustic
    }

    /// The path, which has `depth` edges, reaches a surface.
    #[inline(always)]
    pub fn arrive<W: Interest>(
        &mut self,
        interest: &W,
        caustics: Caustics,
        depth: u32,
        info: &ShapeInfo,
    ) {
        self.active |= !W::ENABLED || interest.differentiates(info.material);
        if depth == 1 {
            self.caustics_excluded = caustics == Caustics::Particles && info.shows_caustics();
        }
        self.caustic = self.caustics_excluded && info.throws_caustics();
    }

    /// The path reaches a surface, where manifold connections find light; `along_delta`: by an edge that left its vertex
    /// along a delta.
    #[inline(always)]
    pub fn arrive_on(&mut self, split: Option<&Split>, shape: u32, along_delta: bool) {
        if let Some(split) = split {
            self.run = split.next(self.run, shape, along_delta);
        }
    }

    /// The path leaves a vertex of a material; see [`PathInterest::arrive_on`].
    #[inline(always)]
    pub fn leave_by(
        &mut self,
        split: Option<&Split>,
        material: u32,
        along_delta: bool,
        reflects: bool,
    ) {
        if let Some(split) = split {
            self.run = split.leaves(self.run, material, along_delta, reflects);
        }
    }

    /// The path goes on from a vertex by this part of its material, `eta`: its relative index before and behind.
    #[inline(always)]
    pub fn bend<P: Float>(&mut self, component: Component, eta: [P; 2]) {
        self.bent |= !is_straight(component, eta);
    }

    /// That of a path which starts with a sample of the change of normals at a vertex of a material: nothing behind it is
    /// differentiated.
    #[inline(always)]
    pub fn branch(mut self, split: Option<&Split>, material: u32, reflects: bool) -> Self {
        self.leave_by(split, material, false, reflects);
        Self {
            active: false,
            bent: true,
            ..self
        }
    }

    /// Whether light of this emitter on the edge is left to others, or out.
    #[inline(always)]
    pub fn leaves(&self, split: Option<&Split>, emitter: u32) -> bool {
        split.is_some_and(|split| split.excludes(self.run, emitter))
    }

    /// The same of light that is sampled from a vertex of a material.
    #[inline(always)]
    pub fn leaves_sampled(
        mut self,
        split: Option<&Split>,
        emitter: u32,
        material: u32,
        reflects: bool,
    ) -> bool {
        self.leave_by(split, material, false, reflects);
        self.leaves(split, emitter)
    }
}

/// Whether a path goes on as if nothing were there: through holes, and through panes, which refract twice. `eta`: its relative
/// index before and behind.
#[inline(always)]
fn is_straight<P: Float>(component: Component, eta: [P; 2]) -> bool {
    match component {
        Component::Continuous => false,
        Component::Delta { kind, .. } => match kind {
            DeltaKind::Reflection => false,
            DeltaKind::Transmission => eta[0] == eta[1],
            DeltaKind::Passthrough => true,
        },
    }
}
