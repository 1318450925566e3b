//! Materials on a surface whose normal is not that of its shape.

use std::sync::Arc;

use ad_core::{Dual, Float, Real, Vec3, array};

use super::nesting::check_levels;
use super::{
    Bsdf, BsdfSample, Component, DeltaKind, Material, Part, Shading, TextureRef, TransportMode, Use,
};
use crate::error::SceneError;
use crate::math::{Frame, Rgb, both};
use crate::params::GradSink;

/// Where the normals of a [`Tilted`] material come from.
pub trait Tilt: Send + Sync {
    /// A vector along the normal at a point, in the shading frame, of any length; zero for the shading normal itself.
    fn vector<R: Real>(&self, at: &Shading<R>) -> Vec3<R>;
    /// Adds the adjoints of the texels, given that of the vector.
    fn scatter<P: Float>(&self, at: &Shading<P>, d: Vec3<P>, grad: &mut impl GradSink<P>);
    /// Calls `f` with every texture that is read.
    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef));
}

/// A material in a tilted frame, whose first axis is the projection of dp/du.
///
/// Directions that are on one side of the surface and on the other of the tilted one
/// are not scattered, neither light nor view; [`Corrections`] soften that.
///
/// # Derivatives
/// In the texels, with directions fixed. The nested material moves with the normal, so texels over a
/// mirror or smooth glass are [`crate::params::ParamKind::Delta`].
///
/// # Does not handle
/// The horizon, which attached samples cross (F9): [`crate::Scene::discontinuity`]. The jump of the value in the
/// texels where a normal turns from its viewer (along an edge on a ball; on a plane only at grazing angles) or is
/// flipped, and where a mirror turns light into the surface: no derivative sees it. Where light gets behind a
/// tilted horizon, values of rough and diffuse materials end in zero, and nothing is missed.
#[derive(Clone, Debug)]
pub struct Tilted<N> {
    pub(super) tilt: N,
    corrections: Corrections,
    nested: Arc<Material>,
}

/// What is done about directions that the surface allows and the tilted one does not. Nothing by default, and both under
/// bump maps of scene files; Mitsuba 3.9, whose options `flip_invalid_normals` and `use_shadowing_function` these are,
/// does both by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Corrections {
    /// A normal that faces away from the viewer is mirrored about the shading normal (x and y change
    /// sign), so that every viewer sees a lit side. The value jumps where that sets in.
    ///
    /// A particle does not know its viewer before it is scattered: with [`TransportMode::Importance`] no
    /// normal is flipped, and particles disagree with paths ([`super::nesting::flips_normals`]).
    pub flip: bool,
    /// Reflected and refracted light is multiplied by [`shadowing`], which darkens the edge of shadows
    /// before the horizon cuts them off. What passes through holes is not.
    pub shadowing: bool,
}

impl<N> Tilted<N> {
    /// `nested` under these normals, without corrections.
    pub(super) fn by(tilt: N, nested: Arc<Material>) -> Result<Self, SceneError> {
        check_levels(std::slice::from_ref(&nested))?;
        Ok(Self {
            tilt,
            corrections: Corrections::default(),
            nested,
        })
    }

    /// The same with `corrections`.
    #[must_use]
    pub fn corrected(self, corrections: Corrections) -> Self {
        Self {
            corrections,
            ..self
        }
    }

    /// What is done about impossible directions.
    pub fn corrections(&self) -> Corrections {
        self.corrections
    }

    /// The material on the tilted surface.
    pub fn nested(&self) -> &Arc<Material> {
        &self.nested
    }
}

impl<N: Tilt> Tilted<N> {
    /// Calls `f` with every texture that the normals are read from.
    pub(crate) fn visit_tilt(&self, f: &mut dyn FnMut(TextureRef)) {
        self.tilt.visit_textures(f);
    }

    /// The vector as it is seen along `wo`.
    #[inline]
    pub(super) fn seen<R: Real>(&self, v: Vec3<R>, wo: Vec3<R>, mode: TransportMode) -> Vec3<R> {
        if !self.corrections.flip || mode == TransportMode::Importance {
            return v;
        }
        let (w, n) = (wo.primal(), v.primal());
        if w.z * w.dot(n) <= R::Primal::zero() {
            Vec3::new(-v.x, -v.y, v.z)
        } else {
            v
        }
    }

    /// A vector along the normal that a viewer along `wo` sees; zero for the shading normal.
    #[inline]
    pub(crate) fn vector<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        mode: TransportMode,
    ) -> Vec3<R> {
        self.seen(self.tilt.vector(at), wo, mode)
    }

    /// The frame that light is scattered in, for a viewer along `wo`.
    #[inline]
    fn frame<R: Real>(&self, at: &Shading<R>, wo: Vec3<R>, mode: TransportMode) -> Frame<R> {
        tilted(self.vector(at, wo, mode))
    }

    /// What the value of the nested material is multiplied with, for directions `wo`, `wi` in the shading frame
    /// and `o`, `i` in the tilted one.
    #[inline]
    fn weight<R: Real>(
        &self,
        frame: &Frame<R>,
        mode: TransportMode,
        [wo, wi]: [Vec3<R>; 2],
        inside: [Vec3<R>; 2],
    ) -> R {
        let adjoint = adjoint(mode, [wo, wi], inside);
        if !self.corrections.shadowing {
            return adjoint;
        }
        let light = match mode {
            TransportMode::Radiance => wi,
            TransportMode::Importance => wo,
        };
        adjoint * shadowing(frame.n, light)
    }
}

/// The share of light along `w` that reaches a surface whose shading normal is z and whose tilted normal is
/// `n` (unit vectors), in [0, 1]: `2 / (1 + sqrt(1 + alpha^2 tan^2 theta_w))` with `alpha^2 = min(tan^2
/// theta_n / 8, 1)`, the masking of GGX with that roughness [Conty Estevez et al. 2019].
///
/// # Derivatives
/// In both vectors. One, with derivative zero, where nothing is tilted; `alpha` has none where it is
/// cut off.
#[inline(always)]
pub fn shadowing<R: Real>(n: Vec3<R>, w: Vec3<R>) -> R {
    let (zero, one) = (R::Primal::zero(), R::one());
    let horizontal = |v: Vec3<R>| v.x * v.x + v.y * v.y;
    let (tilt, upright) = (horizontal(n), n.z * n.z * R::c(8.0));
    let alpha2 = R::select(tilt.primal() < upright.primal(), tilt / upright, one);
    // Multiplied by the cosine, so that a grazing `w` is no division by zero.
    let cos = w.z.abs();
    let root = w.z * w.z + alpha2 * horizontal(w);
    let darkens = (tilt.primal() != zero) & (root.primal() > zero);
    R::select(darkens, cos * R::c(2.0) / (cos + root.sqrt()), one)
}

/// The frame whose normal is along `v`, in the coordinates of the shading frame. The zero vector
/// tilts nothing.
#[inline]
pub(crate) fn tilted<R: Real>(v: Vec3<R>) -> Frame<R> {
    let x = Vec3::new(R::one(), R::zero(), R::zero());
    let z = Vec3::new(R::zero(), R::zero(), R::one());
    let n = if tilts(v) { v.normalize() } else { z };
    Frame::from_normal_and_tangent(n, x)
}

/// Whether a vector is one that tilts.
#[inline(always)]
pub(crate) fn tilts<R: Real>(v: Vec3<R>) -> bool {
    let too_short = v.primal().length_squared() <= R::Primal::of(1e-12);
    !too_short
}

/// A tilted normal makes scattering non-symmetric: the factor that particles need, `|o_z| |wi_z| /
/// (|i_z| |wo_z|)`, for directions `wo`, `wi` in the shading frame and `o`, `i` in the tilted one
/// [Veach 1996, Eq. 13]. 1 for radiance.
#[inline]
fn adjoint<R: Real>(mode: TransportMode, [wo, wi]: [Vec3<R>; 2], [o, i]: [Vec3<R>; 2]) -> R {
    if mode == TransportMode::Radiance {
        return R::one();
    }
    let weight = (o.z * wi.z) / (i.z * wo.z);
    if weight.is_finite() {
        weight.abs()
    } else {
        R::zero()
    }
}

/// Whether a direction is on the same side of both frames.
#[inline]
fn same_side<R: Real>(a: Vec3<R>, b: Vec3<R>) -> bool {
    a.z.primal() * b.z.primal() > R::Primal::zero()
}

impl<N: Tilt> Bsdf for Tilted<N> {
    #[inline]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        let frame = self.frame(at, wo, mode);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if !same_side(wo, o) || !same_side(wi, i) {
            return (Rgb::black(), R::zero());
        }
        let (f, pdf) = self.nested.eval_pdf(at, o, i, mode);
        (f * self.weight(&frame, mode, [wo, wi], [o, i]), pdf)
    }

    #[inline]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let frame = self.frame(at, wo, mode);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if !same_side(wo, o) || !same_side(wi, i) {
            return Rgb::black();
        }
        self.nested.eval(at, o, i, mode) * self.weight(&frame, mode, [wo, wi], [o, i])
    }

    #[inline]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        let frame = self.frame(at, wo, mode);
        let o = frame.to_local(wo);
        let sample = self.nested.sample(at, o, u, mode)?;
        if is_passthrough(sample.component) {
            return Some(BsdfSample { wi: -wo, ..sample });
        }
        let wi = frame.to_world(sample.wi);
        if !same_side(wo, o) || !same_side(wi, sample.wi) {
            return None;
        }
        match sample.component {
            Component::Delta { .. } => Some(BsdfSample { wi, ..sample }),
            Component::Continuous => {
                // There and back again is not exact; the density has to be that of `wi`.
                let (_, pdf) = self.eval_pdf(at, wo, wi, mode);
                let valid = pdf.primal() > R::Primal::zero();
                valid.then_some(BsdfSample { wi, pdf, ..sample })
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
        let frame = self.frame(at, wo, mode);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if kind == DeltaKind::Passthrough {
            return self.nested.eval_delta(at, o, i, kind, route, mode);
        }
        if !same_side(wo, o) {
            return Rgb::black();
        }
        let value = self.nested.eval_delta(at, o, i, kind, route, mode);
        value * self.weight(&frame, mode, [wo, wi], [o, i])
    }

    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        let frame = self.frame(at, wo, mode);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        // As in `eval_pdf`.
        if component == Component::Continuous && !(same_side(wo, o) && same_side(wi, i)) {
            return R::zero();
        }
        self.nested.choice_pdf(at, o, i, component, mode)
    }

    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    ) {
        let vector = self.tilt.vector(at);
        let frame = tilted(self.seen(vector, wo, mode));
        let o = frame.to_local(wo);
        let scatters = |u: &Use<P>| {
            is_passthrough(u.component)
                || (same_side(wo, o)
                    && (u.component != Component::Continuous
                        || same_side(u.wi, frame.to_local(u.wi))))
        };
        for u in uses.iter().filter(|u| scatters(u)) {
            let wi = frame.to_local(u.wi);
            let d = if is_passthrough(u.component) {
                u.d
            } else {
                u.d * self.weight(&frame, mode, [wo, u.wi], [o, wi])
            };
            let inside = Use { wi, d, ..*u };
            self.nested.backward(at, o, &[inside], mode, grad);
        }
        let mut active = false;
        self.tilt
            .visit_textures(&mut |t| active |= t.any_param(|p| grad.active(p)));
        if !active {
            return;
        }
        // The adjoint of the vector first, then of the texels it was made from.
        let seeds: [Dual<P, 3>; 3] = array(|i| Dual::var(vector.to_array()[i], i));
        let lifted_wo = Vec3::lift(wo);
        let frame = tilted(self.seen(Vec3::from(seeds), lifted_wo, mode));
        let lifted = at.lift::<Dual<P, 3>>();
        let o = frame.to_local(lifted_wo);
        let mut d_vector = [P::zero(); 3];
        let tilts = |u: &&Use<P>| scatters(u) && u.part != Part::Normals;
        for u in uses.iter().filter(tilts) {
            let wi = Vec3::lift(u.wi);
            let i = frame.to_local(wi);
            let value = (self.nested).eval_component(&lifted, o, i, u.component, mode);
            let value = if is_passthrough(u.component) {
                value
            } else {
                value * self.weight(&frame, mode, [lifted_wo, wi], [o, i])
            };
            for (k, d) in d_vector.iter_mut().enumerate() {
                for c in 0..3 {
                    *d += value[c].eps[k] * u.d[c];
                }
            }
        }
        self.tilt.scatter(at, d_vector.into(), grad);
    }

    fn shading_frame<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        route: u8,
        mode: TransportMode,
    ) -> Frame<R> {
        let outer = self.frame(at, Vec3::lift(wo), mode);
        let wo = outer.primal().to_local(wo);
        let inner = self.nested.shading_frame(at, wo, route, mode);
        Frame {
            s: outer.to_world(inner.s),
            t: outer.to_world(inner.t),
            n: outer.to_world(inner.n),
        }
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        self.tilt.visit_textures(f);
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
        let frame = self.frame(at, wo, mode);
        let o = frame.to_local(wo);
        let pair = self.nested.sample_differential(at, o, u, mode);
        let mapped = |sample: BsdfSample<P>| {
            let wi = frame.to_world(sample.wi);
            // As in `sample`; also checks the sides.
            let pdf = self.pdf_differential(at, wo, wi);
            (pdf > P::zero()).then_some(BsdfSample { wi, pdf, ..sample })
        };
        both(pair, |sample| sample.and_then(mapped))
    }

    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        let frame = self.frame(&at.primal(), wo, mode);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if !same_side(wo, o) || !same_side(wi, i) {
            return Rgb::black();
        }
        let weight = self.weight(&frame, mode, [wo, wi], [o, i]);
        self.nested.eval_normals(at, o, i, mode) * R::lift(weight)
    }

    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        // Particles sample no derivatives.
        let frame = self.frame(at, wo, TransportMode::Radiance);
        let (o, i) = (frame.to_local(wo), frame.to_local(wi));
        if !same_side(wo, o) || !same_side(wi, i) {
            return P::zero();
        }
        self.nested.pdf_differential(at, o, i)
    }

    fn has_differential(&self) -> bool {
        self.nested.has_differential()
    }
}

#[inline]
fn is_passthrough(component: Component) -> bool {
    matches!(
        component,
        Component::Delta {
            kind: DeltaKind::Passthrough,
            ..
        }
    )
}
