//! Materials on surfaces that they know more of than texture coordinates.

use std::sync::Arc;

use ad_core::{Float, Real, Vec3};

use super::chart::Chart;
use super::{
    Bsdf, BsdfSample, Component, DeltaKind, Material, OnChart, Scattered, Shading, TextureRef,
    TransportMode, Use,
};
use crate::error::SceneError;
use crate::math::{Frame, Rgb};
use crate::params::GradSink;
use crate::plugin::{FromNode, Node, Registry};

/// A material with the [`Chart`] of the one surface that it is on: outermost, and put there when a scene is built, where a
/// bump map is inside.
#[derive(Clone, Debug)]
pub struct Charted {
    chart: Arc<Chart>,
    nested: Arc<Material>,
}

impl Charted {
    pub(crate) fn new(chart: Chart, nested: Arc<Material>) -> Self {
        Self {
            chart: Arc::new(chart),
            nested,
        }
    }

    /// The chart of the surface.
    pub fn chart(&self) -> &Arc<Chart> {
        &self.chart
    }

    /// The material itself.
    pub fn nested(&self) -> &Arc<Material> {
        &self.nested
    }

    /// A point as materials inside see it: in the surface's own coordinates.
    #[inline]
    pub(crate) fn inside<'a, R: Real>(&'a self, at: &Shading<'a, R>) -> Shading<'a, R> {
        let (uv, triangle) = self.chart.own(at.uv);
        Shading {
            theta: at.theta,
            uv,
            on: Some(OnChart {
                chart: &self.chart,
                triangle,
            }),
        }
    }
}

impl Bsdf for Charted {
    #[inline]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        self.nested.eval_pdf(&self.inside(at), wo, wi, mode)
    }

    #[inline]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        self.nested.eval(&self.inside(at), wo, wi, mode)
    }

    #[inline]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        self.nested.sample(&self.inside(at), wo, u, mode)
    }

    #[inline]
    fn sample_eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        self.nested.sample_eval(&self.inside(at), wo, u, mode)
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
        let at = self.inside(at);
        self.nested.eval_delta(&at, wo, wi, kind, route, mode)
    }

    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        let at = self.inside(at);
        self.nested.choice_pdf(&at, wo, wi, component, mode)
    }

    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    ) {
        self.nested.backward(&self.inside(at), wo, uses, mode, grad);
    }

    fn shading_frame<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        route: u8,
        mode: TransportMode,
    ) -> Frame<R> {
        self.nested.shading_frame(&self.inside(at), wo, route, mode)
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        self.nested.visit_textures(f);
    }

    #[inline]
    fn is_delta(&self) -> bool {
        self.nested.is_delta()
    }

    fn is_opaque(&self) -> bool {
        self.nested.is_opaque()
    }

    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2] {
        self.nested
            .sample_differential(&self.inside(at), wo, u, mode)
    }

    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        self.nested.eval_normals(&self.inside(at), wo, wi, mode)
    }

    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        self.nested.pdf_differential(&self.inside(at), wo, wi)
    }

    fn has_differential(&self) -> bool {
        self.nested.has_differential()
    }
}

/// Nothing in a scene file is called so.
impl FromNode for Charted {
    const PLUGINS: &'static [&'static str] = &[];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        Err(node.unknown_plugin(Self::PLUGINS))
    }
}
