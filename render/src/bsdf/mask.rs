//! Materials with holes.

use std::sync::Arc;

use ad_core::{Const, Float, Real, Vec3};

use super::nesting::{attached_choice, check_levels, choice, choose, nested_nodes};
use super::{
    Bsdf, BsdfSample, Component, DeltaKind, Material, Part, Shading, TextureRef, TransportMode,
    Use, upright,
};
use crate::error::SceneError;
use crate::math::{Frame, Rgb};
use crate::params::GradSink;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::ScalarTexture;

/// A material of which the share `opacity` is there; through the rest light goes straight on.
#[derive(Clone, Debug)]
pub struct Mask {
    opacity: ScalarTexture,
    nested: Arc<Material>,
}

/// Lowest bit of the route: what light went through.
const HOLE: u8 = 0;
const MATERIAL: u8 = 1;

impl Mask {
    /// `nested` at `opacity` 1, nothing at 0.
    ///
    /// # Errors
    /// More than [`super::nesting::MAX_LEVELS`] levels of nesting.
    pub fn new(opacity: ScalarTexture, nested: Arc<Material>) -> Result<Self, SceneError> {
        check_levels(std::slice::from_ref(&nested))?;
        Ok(Self { opacity, nested })
    }

    /// The material that is masked.
    pub fn nested(&self) -> &Arc<Material> {
        &self.nested
    }

    /// What is there, and what is not.
    pub(crate) fn texture(&self) -> &ScalarTexture {
        &self.opacity
    }

    /// The part that is there.
    #[inline]
    pub(crate) fn opacity<R: Real>(&self, at: &Shading<R>) -> R {
        self.opacity.scalar(&at.theta, at.uv)
    }
}

/// What a delta of the mask is to the nested material; `None` for the hole.
#[inline]
fn inside(component: Component) -> Option<Component> {
    match component {
        Component::Continuous => Some(component),
        Component::Delta { route, .. } if route & 1 == HOLE => None,
        Component::Delta { kind, route } => Some(Component::Delta {
            kind,
            route: route >> 1,
        }),
    }
}

impl Bsdf for Mask {
    #[inline]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        let opacity = self.opacity(at);
        let (f, pdf) = self.nested.eval_pdf(at, wo, wi, mode);
        (f * opacity, pdf * Const(choice(opacity)))
    }

    #[inline]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        self.nested.eval(at, wo, wi, mode) * self.opacity(at)
    }

    /// Hole or material are chosen by a primal probability that keeps a little away from 0 and 1.
    #[inline]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let second = choice(self.opacity(at));
        let (is_material, u0) = choose(u[0], second);
        if !is_material {
            return Some(BsdfSample {
                wi: -wo,
                pdf: R::lift(R::Primal::one() - second),
                component: Component::Delta {
                    kind: DeltaKind::Passthrough,
                    route: HOLE,
                },
                eta: R::Primal::one(),
            });
        }
        let sample = self.nested.sample(at, wo, [u0, u[1], u[2]], mode)?;
        let component = match sample.component {
            Component::Continuous => Component::Continuous,
            Component::Delta { kind, route } => Component::Delta {
                kind,
                route: route << 1 | MATERIAL,
            },
        };
        Some(BsdfSample {
            pdf: sample.pdf * Const(second),
            component,
            ..sample
        })
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
        let opacity = self.opacity(at);
        match inside(Component::Delta { kind, route }) {
            None => Rgb::splat(R::one() - opacity),
            Some(c) => self.nested.eval_component(at, wo, wi, c, mode) * opacity,
        }
    }

    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        let material = attached_choice(self.opacity(at));
        match inside(component) {
            None => R::one() - material,
            Some(c) => self.nested.choice_pdf(at, wo, wi, c, mode) * material,
        }
    }

    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    ) {
        let opacity = self.opacity(at);
        let opacity_active = self.opacity.any_param(|p| grad.active(p));
        let mut d_opacity = Rgb::black();
        for u in uses {
            let Some(component) = inside(u.component) else {
                d_opacity += -u.d;
                continue;
            };
            if opacity_active && u.part != Part::Normals {
                let value = self.nested.eval_component(at, wo, u.wi, component, mode);
                d_opacity += value * u.d;
            }
            let nested = Use {
                component,
                d: u.d * opacity,
                ..*u
            };
            self.nested.backward(at, wo, &[nested], mode, grad);
        }
        if opacity_active {
            self.opacity.scatter(at.uv, d_opacity, grad);
        }
    }

    fn shading_frame<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        route: u8,
        mode: TransportMode,
    ) -> Frame<R> {
        match route & 1 {
            HOLE => upright(),
            _ => self.nested.shading_frame(at, wo, route >> 1, mode),
        }
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        f(TextureRef::Scalar(&self.opacity));
        self.nested.visit_textures(f);
    }

    #[inline]
    fn is_delta(&self) -> bool {
        self.nested.is_delta()
    }

    fn is_opaque(&self) -> bool {
        false
    }

    /// The hole has no roughness, so the material is always chosen.
    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2] {
        self.nested.sample_differential(at, wo, u, mode)
    }

    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let opacity = R::lift(self.opacity(at).primal());
        self.nested.eval_normals(at, wo, wi, mode) * opacity
    }

    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        self.nested.pdf_differential(at, wo, wi)
    }

    fn has_differential(&self) -> bool {
        self.nested.has_differential()
    }
}

impl FromNode for Mask {
    const PLUGINS: &'static [&'static str] = &["mask"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let opacity = registry.scalar_texture(node, "opacity", 0.5, (0.0, 1.0))?;
        let nodes = nested_nodes(node, 1, 1)?;
        let nested = registry.material_from_node(nodes[0], "nested_bsdf")?;
        Self::new(opacity, nested)
    }
}
