//! Surfaces that are not there.

use ad_core::{Real, Vec3};

use super::{BsdfSample, Component, DeltaKind, Leaf, Lobe, Reader, TransportMode};
use crate::error::SceneError;
use crate::math::Rgb;
use crate::plugin::{FromNode, Node, Registry};

/// A surface that light goes through unchanged. It is a vertex of paths all the same, and counts in their depth, as in
/// Mitsuba.
#[derive(Clone, Copy, Debug)]
pub struct Null;

/// Straight on.
#[derive(Clone, Copy, Debug)]
pub struct NullLobe;

impl Leaf for Null {
    type Lobe<R: Real> = NullLobe;
    const DELTA: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    #[inline]
    fn lobe<R: Real>(&self, _: &mut impl Reader<R>) -> NullLobe {
        NullLobe
    }
}

impl<R: Real> Lobe<R> for NullLobe {
    #[inline]
    fn eval(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        Rgb::black()
    }

    #[inline]
    fn pdf(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> R {
        R::zero()
    }

    #[inline]
    fn sample(
        &self,
        wo: Vec3<R>,
        _u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        Some(BsdfSample {
            wi: -wo,
            pdf: R::one(),
            component: Component::Delta {
                kind: DeltaKind::Passthrough,
                route: 0,
            },
            eta: R::Primal::one(),
        })
    }

    #[inline]
    fn eval_delta(&self, _wo: Vec3<R>, kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
        match kind {
            DeltaKind::Passthrough => Rgb::splat(R::one()),
            _ => Rgb::black(),
        }
    }
}

impl FromNode for Null {
    const PLUGINS: &'static [&'static str] = &["null"];

    fn from_node(_: &Node, _: &mut Registry) -> Result<Self, SceneError> {
        Ok(Self)
    }
}
