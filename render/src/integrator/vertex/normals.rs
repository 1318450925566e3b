//! Samples of the change of normals at a vertex: who has them, and how light that is sampled there is weighed beside them.

use ad_core::{Float, Vec3};

use super::interest::Interest;
use super::light::mis_weight;
use crate::bsdf::{Bsdf, BsdfSample, Material, Shading, TransportMode};
use crate::estimator::{Sampling, Strategy};
use crate::sampler::Sampler;

/// Whether the change of normals has samples of its own at a vertex of strategy `S`. `goes_on`: whether there may be light
/// behind it. Scalars with tangents ask besides whether the roughness moves.
#[inline(always)]
pub fn splits<S: Strategy, W: Interest>(
    interest: &W,
    goes_on: bool,
    index: u32,
    material: &Material,
) -> bool {
    S::Bsdf::DIFFERENTIAL && goes_on && has_pair(interest, index, material)
}

/// The same of a path that goes on, where its strategy has such samples.
#[inline(always)]
pub fn has_pair<W: Interest>(interest: &W, index: u32, material: &Material) -> bool {
    (!W::ENABLED || interest.differentiates_roughness(index)) && material.has_differential()
}

/// The samples of the change of normals at a vertex, from `dimension` on of its numbers. Both go on as ordinary paths or
/// particles of the throughput there, made of the same numbers: what they find is alike, and its noise cancels.
#[inline(always)]
pub fn normals_pair<P: Float, X: Sampler>(
    material: &Material,
    at: &Shading<P>,
    wo: Vec3<P>,
    mode: TransportMode,
    sampler: &mut X,
    dimension: u32,
) -> impl Iterator<Item = BsdfSample<P>> + use<P, X> {
    sampler.seek(dimension);
    let pair = material.sample_differential(at, wo, sampler.next_3d(), mode);
    pair.into_iter().flatten()
}

/// Weight of a sampled light for the change of normals, as [`super::light::per_density`]: scattered directions compete with
/// the density of its own samples.
#[inline(always)]
pub fn normals_weight<S: Strategy, P: Float>(
    material: &Material,
    at: &Shading<P>,
    [wo, wi]: [Vec3<P>; 2],
    weighs: bool,
    pdf: P,
    kept: P,
) -> P {
    let pair = if weighs {
        material.pdf_differential(at, wo, wi)
    } else {
        P::zero()
    };
    mis_weight::<S, P>(weighs, pdf, pair) * kept / pdf
}
