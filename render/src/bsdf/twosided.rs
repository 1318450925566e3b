//! Materials that look the same, or different, from both sides.

use std::sync::Arc;

use ad_core::{Float, Real, Vec3};

use super::nesting::{check_levels, nested_nodes};
use super::{
    Bsdf, BsdfSample, Component, DeltaKind, Material, Scattered, Shading, TextureRef,
    TransportMode, Use,
};
use crate::error::SceneError;
use crate::math::{Frame, Rgb, both};
use crate::params::GradSink;
use crate::plugin::{FromNode, Node, Registry};

/// One material in front, the same or another behind. Meant for materials that only reflect.
#[derive(Clone, Debug)]
pub struct TwoSided {
    sides: [Arc<Material>; 2],
}

impl TwoSided {
    /// `sides[0]` is seen from where the shading normal points, `sides[1]` from behind.
    ///
    /// # Errors
    /// More than [`super::nesting::MAX_LEVELS`] levels of nesting.
    pub fn new(sides: [Arc<Material>; 2]) -> Result<Self, SceneError> {
        check_levels(&sides)?;
        Ok(Self { sides })
    }

    /// Front and back.
    pub fn sides(&self) -> &[Arc<Material>] {
        &self.sides
    }

    /// The material of both sides, if it is one.
    #[inline]
    pub(crate) fn same(&self) -> Option<&Material> {
        let [front, back] = &self.sides;
        Arc::ptr_eq(front, back).then_some(front)
    }

    /// The side that is seen along `wo`, and whether it has to be turned to the front.
    #[inline]
    fn side<R: Real>(&self, wo: Vec3<R>) -> (&Material, bool) {
        let behind = wo.z.primal() < R::Primal::zero();
        (&self.sides[usize::from(behind)], behind)
    }
}

/// Mirrors `v` at the surface if `behind`.
#[inline]
fn turn<R: Real>(v: Vec3<R>, behind: bool) -> Vec3<R> {
    if behind { Vec3::new(v.x, v.y, -v.z) } else { v }
}

/// Calls `side` with the uses of one side, a few at a time.
#[inline(always)]
fn turned<P: Float>(uses: &[Use<P>], behind: bool, mut side: impl FnMut(&[Use<P>])) {
    for uses in uses.chunks(2) {
        let mut turned = [uses[0]; 2];
        for (t, u) in turned.iter_mut().zip(uses) {
            *t = Use {
                wi: turn(u.wi, behind),
                ..*u
            };
        }
        side(&turned[..uses.len()]);
    }
}

impl Bsdf for TwoSided {
    #[inline]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        let (side, behind) = self.side(wo);
        side.eval_pdf(at, turn(wo, behind), turn(wi, behind), mode)
    }

    #[inline]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let (side, behind) = self.side(wo);
        side.eval(at, turn(wo, behind), turn(wi, behind), mode)
    }

    #[inline]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let (side, behind) = self.side(wo);
        let sample = side.sample(at, turn(wo, behind), u, mode)?;
        Some(BsdfSample {
            wi: turn(sample.wi, behind),
            ..sample
        })
    }

    #[inline]
    fn sample_eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let (side, behind) = self.side(wo);
        let (sample, f) = side.sample_eval(at, turn(wo, behind), u, mode)?;
        let wi = turn(sample.wi, behind);
        Some((BsdfSample { wi, ..sample }, f))
    }

    #[inline]
    fn sample_weight<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<(Vec3<R>, Rgb<R>)> {
        let (side, behind) = self.side(wo);
        let (wi, weight) = side.sample_weight(at, turn(wo, behind), u, mode)?;
        Some((turn(wi, behind), weight))
    }

    #[inline]
    fn eval_delta<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        kind: DeltaKind,
        route: u8,
        mode: TransportMode,
    ) -> Rgb<R> {
        let (side, behind) = self.side(wo);
        side.eval_delta(at, turn(wo, behind), turn(wi, behind), kind, route, mode)
    }

    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        let (side, behind) = self.side(wo);
        side.choice_pdf(at, turn(wo, behind), turn(wi, behind), component, mode)
    }

    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    ) {
        let (side, behind) = self.side(wo);
        turned(uses, behind, |uses| {
            side.backward(at, turn(wo, behind), uses, mode, grad);
        });
    }

    fn forward<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        uses: &[Use<R::Primal>],
        mode: TransportMode,
    ) -> Rgb<R> {
        let (side, behind) = self.side(wo);
        let mut sum = Rgb::black();
        turned(uses, behind, |uses| {
            sum += side.forward(at, turn(wo, behind), uses, mode);
        });
        sum
    }

    fn shading_frame<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        route: u8,
        mode: TransportMode,
    ) -> Frame<R> {
        let (side, behind) = self.side(wo);
        let frame = side.shading_frame(at, turn(wo, behind), route, mode);
        if !behind {
            return frame;
        }
        // Mirrored, and the normal on the front again: two reflections leave it right-handed.
        Frame {
            s: turn(frame.s, true),
            t: turn(frame.t, true),
            n: -turn(frame.n, true),
        }
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        for side in &self.sides {
            side.visit_textures(f);
        }
    }

    #[inline]
    fn is_delta(&self) -> bool {
        self.sides.iter().all(|m| m.is_delta())
    }

    fn is_opaque(&self) -> bool {
        self.sides.iter().all(|m| m.is_opaque())
    }

    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2] {
        let (side, behind) = self.side(wo);
        let pair = side.sample_differential(at, turn(wo, behind), u, mode);
        let turned = |sample: BsdfSample<P>| BsdfSample {
            wi: turn(sample.wi, behind),
            ..sample
        };
        both(pair, |sample| sample.map(turned))
    }

    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let (side, behind) = self.side(wo);
        side.eval_normals(at, turn(wo, behind), turn(wi, behind), mode)
    }

    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        let (side, behind) = self.side(wo);
        side.pdf_differential(at, turn(wo, behind), turn(wi, behind))
    }

    fn has_differential(&self) -> bool {
        self.sides.iter().any(|m| m.has_differential())
    }
}

impl FromNode for TwoSided {
    const PLUGINS: &'static [&'static str] = &["twosided"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let nodes = nested_nodes(node, 1, 2)?;
        let mut sides = Vec::with_capacity(2);
        for (node, label) in nodes.into_iter().zip(["brdf_0", "brdf_1"]) {
            let side = registry.material_from_node(node, label)?;
            if !side.is_opaque() {
                return Err(SceneError::Value {
                    location: node.location.clone(),
                    key: "twosided".into(),
                    expected: "a nested <bsdf> that only reflects".into(),
                    found: node.describe(),
                });
            }
            sides.push(side);
        }
        let front = sides[0].clone();
        let back = sides.get(1).unwrap_or(&front).clone();
        Self::new([front, back])
    }
}
