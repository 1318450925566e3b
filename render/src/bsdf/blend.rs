//! Mixtures of two materials.

use std::sync::Arc;

use ad_core::{Const, Float, Real, Vec3};

use super::nesting::{attached_choice, check_levels, choice, choose, nested_nodes};
use super::{
    Bsdf, BsdfSample, Component, DeltaKind, Material, Part, Shading, TextureRef, TransportMode, Use,
};
use crate::error::SceneError;
use crate::math::{Frame, Rgb, both};
use crate::params::GradSink;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::ScalarTexture;

/// `(1 - w) a + w b`, with a weight that varies over the surface.
#[derive(Clone, Debug)]
pub struct Blend {
    weight: ScalarTexture,
    parts: [Arc<Material>; 2],
}

impl Blend {
    /// `parts[0]` at `weight` 0, `parts[1]` at 1.
    ///
    /// # Errors
    /// More than [`super::nesting::MAX_LEVELS`] levels of nesting.
    pub fn new(weight: ScalarTexture, parts: [Arc<Material>; 2]) -> Result<Self, SceneError> {
        check_levels(&parts)?;
        Ok(Self { weight, parts })
    }

    /// Both materials.
    pub fn parts(&self) -> &[Arc<Material>] {
        &self.parts
    }

    /// The share of the second part.
    pub(crate) fn texture(&self) -> &ScalarTexture {
        &self.weight
    }

    /// The shares of the two parts.
    #[inline]
    pub(crate) fn shares<R: Real>(&self, at: &Shading<R>) -> [R; 2] {
        let w = self.weight.scalar(&at.theta, at.uv);
        [R::one() - w, w]
    }

    /// Probability of the second part among those that can sample their derivative.
    fn differential_choice<P: Float>(&self, at: &Shading<P>) -> P {
        match [0, 1].map(|i| self.parts[i].has_differential()) {
            [true, true] => choice(self.shares(at)[1]),
            [_, second] => P::of(f64::from(u8::from(second))),
        }
    }
}

#[inline]
fn mix<R: Real>(second: R::Primal, pdf: [R; 2]) -> R {
    pdf[0] * Const(R::Primal::one() - second) + pdf[1] * Const(second)
}

impl Bsdf for Blend {
    #[inline]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        let share = self.shares(at);
        let (a, pdf_a) = self.parts[0].eval_pdf(at, wo, wi, mode);
        let (b, pdf_b) = self.parts[1].eval_pdf(at, wo, wi, mode);
        let pdf = mix(choice(share[1]), [pdf_a, pdf_b]);
        (a * share[0] + b * share[1], pdf)
    }

    #[inline]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let share = self.shares(at);
        let eval = |i: usize| self.parts[i].eval(at, wo, wi, mode);
        eval(0) * share[0] + eval(1) * share[1]
    }

    /// The part is chosen by a primal probability that keeps a little away from 0 and 1, so that it is
    /// not the weight itself.
    #[inline]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let second = choice(self.shares(at)[1]);
        let (is_second, u0) = choose(u[0], second);
        let chosen = usize::from(is_second);
        let sample = self.parts[chosen].sample(at, wo, [u0, u[1], u[2]], mode)?;
        match sample.component {
            Component::Continuous => {
                let (_, other) = self.parts[1 - chosen].eval_pdf(at, wo, sample.wi, mode);
                let mut pdf = [other; 2];
                pdf[chosen] = sample.pdf;
                Some(BsdfSample {
                    pdf: mix(second, pdf),
                    ..sample
                })
            }
            Component::Delta { kind, route } => {
                let p = if is_second {
                    second
                } else {
                    R::Primal::one() - second
                };
                Some(BsdfSample {
                    pdf: sample.pdf * Const(p),
                    component: Component::Delta {
                        kind,
                        route: route << 1 | chosen as u8,
                    },
                    ..sample
                })
            }
        }
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
        let chosen = usize::from(route & 1);
        let value = self.parts[chosen].eval_delta(at, wo, wi, kind, route >> 1, mode);
        value * self.shares(at)[chosen]
    }

    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        let second = attached_choice(self.shares(at)[1]);
        let p = [R::one() - second, second];
        let inside = |i: usize, component| self.parts[i].choice_pdf(at, wo, wi, component, mode);
        match component {
            Component::Continuous => inside(0, component) * p[0] + inside(1, component) * p[1],
            Component::Delta { kind, route } => {
                let chosen = usize::from(route & 1);
                let route = route >> 1;
                inside(chosen, Component::Delta { kind, route }) * p[chosen]
            }
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
        let share = self.shares(at);
        let weight_active = self.weight.any_param(|p| grad.active(p));
        let mut d_weight = Rgb::black();
        for u in uses {
            for (i, part) in self.parts.iter().enumerate() {
                let inside = match u.component {
                    Component::Continuous => *u,
                    Component::Delta { route, .. } if usize::from(route & 1) != i => continue,
                    Component::Delta { kind, route } => Use {
                        component: Component::Delta {
                            kind,
                            route: route >> 1,
                        },
                        ..*u
                    },
                };
                if weight_active && u.part != Part::Normals {
                    let value = part.eval_component(at, wo, inside.wi, inside.component, mode);
                    let d = value * u.d;
                    d_weight += if i == 0 { -d } else { d };
                }
                let inside = Use {
                    d: u.d * share[i],
                    ..inside
                };
                part.backward(at, wo, &[inside], mode, grad);
            }
        }
        if weight_active {
            self.weight.scatter(at.uv, d_weight, grad);
        }
    }

    fn shading_frame<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        route: u8,
        mode: TransportMode,
    ) -> Frame<R> {
        self.parts[usize::from(route & 1)].shading_frame(at, wo, route >> 1, mode)
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        f(TextureRef::Scalar(&self.weight));
        for part in &self.parts {
            part.visit_textures(f);
        }
    }

    #[inline]
    fn is_delta(&self) -> bool {
        self.parts.iter().all(|m| m.is_delta())
    }

    fn is_opaque(&self) -> bool {
        self.parts.iter().all(|m| m.is_opaque())
    }

    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2] {
        let (is_second, u0) = choose(u[0], self.differential_choice(at));
        let part = &self.parts[usize::from(is_second)];
        let pair = part.sample_differential(at, wo, [u0, u[1], u[2]], mode);
        let of_both = |sample: BsdfSample<P>| BsdfSample {
            pdf: self.pdf_differential(at, wo, sample.wi),
            ..sample
        };
        both(pair, |sample| sample.map(of_both))
    }

    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let share = self.shares(at);
        let eval = |i: usize| self.parts[i].eval_normals(at, wo, wi, mode);
        eval(0) * R::lift(share[0].primal()) + eval(1) * R::lift(share[1].primal())
    }

    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        let pdf = |i: usize| self.parts[i].pdf_differential(at, wo, wi);
        mix(self.differential_choice(at), [pdf(0), pdf(1)])
    }

    fn has_differential(&self) -> bool {
        self.parts.iter().any(|m| m.has_differential())
    }
}

impl FromNode for Blend {
    const PLUGINS: &'static [&'static str] = &["blendbsdf"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        if !node.has("weight") {
            return Err(node.missing("weight", "a number from 0 to 1, or a texture"));
        }
        let weight = registry.scalar_texture(node, "weight", 0.5, (0.0, 1.0))?;
        let nodes = nested_nodes(node, 2, 2)?;
        let a = registry.material_from_node(nodes[0], "bsdf_0")?;
        let b = registry.material_from_node(nodes[1], "bsdf_1")?;
        Self::new(weight, [a, b])
    }
}
