//! What of a path anybody wants to know.

use crate::bsdf::{Bsdf, Material};
use crate::estimator::{Sampling, Strategy};
use crate::scene::{Caustics, ShapeInfo};

/// What an observer of paths wants to know.
pub trait Wishes {
    /// Whether events are wanted; if not, none is made, and nothing that only derivatives need is done.
    const ENABLED: bool = true;
    /// Whether it wants to know the light behind a vertex of this material: because that is differentiated.
    fn follows(&self, _material: u32) -> bool {
        true
    }
    /// Whether the roughness of this material is: only then its normals have samples of their own.
    fn follows_normals(&self, _material: u32) -> bool {
        true
    }
    /// Whether it wants to know all light, since emission is differentiated.
    fn follows_light(&self) -> bool {
        true
    }
}

/// An observer that wants nothing but the radiance.
impl Wishes for () {
    const ENABLED: bool = false;
}

/// Why light on the next edge of a path counts, or does not.
#[derive(Clone, Copy, Debug, Default)]
pub struct Regard {
    /// Whether a vertex so far is one that the observer follows.
    pub followed: bool,
    /// Whether others find caustics on the first vertex.
    pub left_out: bool,
    /// Whether light on this edge would be one.
    pub caustic: bool,
}

impl Regard {
    /// Whether light on the edge counts: what no derivative needs is not looked at.
    #[inline(always)]
    pub fn lit<W: Wishes>(&self, wishes: &W) -> bool {
        (!W::ENABLED || self.followed || wishes.follows_light()) && !self.caustic
    }

    /// The path, which has `depth` edges, reaches a surface.
    #[inline(always)]
    pub fn arrive<W: Wishes>(
        &mut self,
        wishes: &W,
        caustics: Caustics,
        depth: u32,
        info: &ShapeInfo,
    ) {
        self.followed |= !W::ENABLED || wishes.follows(info.material);
        if depth == 1 {
            self.left_out = caustics == Caustics::Particles && !info.glossy;
        }
        self.caustic = self.left_out && info.glossy;
    }
}

/// Whether the change of normals has samples of its own at a vertex of strategy `S`. `goes_on`: whether there may be light
/// behind it. Scalars with tangents ask besides whether the roughness moves.
#[inline(always)]
pub fn splits<S: Strategy, W: Wishes>(
    wishes: &W,
    goes_on: bool,
    index: u32,
    material: &Material,
) -> bool {
    S::Bsdf::DIFFERENTIAL
        && goes_on
        && (!W::ENABLED || wishes.follows_normals(index))
        && material.has_differential()
}
