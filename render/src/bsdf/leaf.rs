//! Materials without children: all that a material does follows from how its lobe is read.

use ad_core::{Dual, Float, Real, Vec2, Vec3};

use super::shading::{Reader, Shading, TextureRef};
use super::{Bsdf, BsdfSample, Component, DeltaKind, Lobe, Part, Scattered, TransportMode, Use};
use crate::math::Rgb;
use crate::params::GradSink;
use crate::texture::{RgbTexture, ScalarTexture};

/// A material without children.
pub trait Leaf: Send + Sync {
    /// Its scattering law.
    type Lobe<R: Real>: Lobe<R>;
    /// Reads the parameters.
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> Self::Lobe<R>;
    /// Whether it scatters along deltas only, so that connecting it to a light is pointless.
    const DELTA: bool = false;
    /// Whether light may pass to the other side, so that it has no place in [`super::TwoSided`].
    fn transmits(&self) -> bool {
        false
    }
    /// Whether its lobe has [`Lobe::sample_differential`].
    const DIFFERENTIAL: bool = false;
    /// Whether it may have more than [`MAX_SLOTS`] textures, up to [`MOST_SLOTS`]: one that is [`Reader::mixed`] counts
    /// three times.
    const MANY: bool = false;
}

impl<L: Leaf> Bsdf for L {
    #[inline(always)]
    fn eval_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        self.lobe(&mut &*at).eval_pdf(wo, wi, mode)
    }

    #[inline(always)]
    fn eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        mode: TransportMode,
    ) -> Rgb<R> {
        self.lobe(&mut &*at).eval(wo, wi, mode)
    }

    #[inline(always)]
    fn sample<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        self.lobe(&mut &*at).sample(wo, u, mode)
    }

    #[inline(always)]
    fn eval_delta<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        _wi: Vec3<R>,
        kind: DeltaKind,
        _route: u8,
        mode: TransportMode,
    ) -> Rgb<R> {
        self.lobe(&mut &*at).eval_delta(wo, kind, mode)
    }

    #[inline]
    fn choice_pdf<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        wi: Vec3<R>,
        component: Component,
        mode: TransportMode,
    ) -> R {
        self.lobe(&mut &*at).choice_pdf(wo, wi, component, mode)
    }

    #[inline(always)]
    fn sample_eval<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        self.lobe(&mut &*at).sample_eval(wo, u, mode)
    }

    #[inline(always)]
    fn sample_weight<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<(Vec3<R>, Rgb<R>)> {
        self.lobe(&mut &*at).sample_weight(wo, u, mode)
    }

    #[inline(always)]
    fn backward<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
        grad: &mut impl GradSink<P>,
    ) {
        let mut count = CountActive { grad: &*grad, n: 0 };
        self.lobe::<P>(&mut count);
        match count.n {
            0 => {}
            1 => leaf_backward::<L, P, 1>(self, at, wo, uses, mode, grad),
            n => {
                if const { L::MANY } && n > MANY_SLOTS {
                    leaf_backward::<L, P, MOST_SLOTS>(self, at, wo, uses, mode, grad);
                } else if const { L::MANY } && n > MAX_SLOTS {
                    leaf_backward::<L, P, MANY_SLOTS>(self, at, wo, uses, mode, grad);
                } else {
                    leaf_backward::<L, P, MAX_SLOTS>(self, at, wo, uses, mode, grad);
                }
            }
        }
    }

    #[inline(always)]
    fn forward<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        uses: &[Use<R::Primal>],
        mode: TransportMode,
    ) -> Rgb<R> {
        let lobe: L::Lobe<R> = self.lobe(&mut &*at);
        uses.iter().fold(Rgb::black(), |sum, u| {
            sum + still::<L, R>(&lobe, wo, u, mode) * Rgb::lift(u.d)
        })
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        self.lobe::<f32>(&mut List(f));
    }

    fn most_textures(&self) -> usize {
        if L::MANY { MOST_SLOTS } else { MAX_SLOTS }
    }

    #[inline]
    fn is_delta(&self) -> bool {
        L::DELTA
    }

    fn is_opaque(&self) -> bool {
        !self.transmits()
    }

    #[inline]
    fn sample_differential<P: Float>(
        &self,
        at: &Shading<P>,
        wo: Vec3<P>,
        u: [P; 3],
        mode: TransportMode,
    ) -> [Option<BsdfSample<P>>; 2] {
        if !L::DIFFERENTIAL {
            return [None; 2];
        }
        let lobe: L::Lobe<P> = self.lobe(&mut &*at);
        lobe.sample_differential(wo, u, mode)
    }

    #[inline]
    fn pdf_differential<P: Float>(&self, at: &Shading<P>, wo: Vec3<P>, wi: Vec3<P>) -> P {
        if !L::DIFFERENTIAL {
            return P::zero();
        }
        let lobe: L::Lobe<P> = self.lobe(&mut &*at);
        lobe.pdf_differential(wo, wi)
    }

    #[inline]
    fn eval_normals<R: Real>(
        &self,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        mode: TransportMode,
    ) -> Rgb<R> {
        if !L::DIFFERENTIAL {
            return Rgb::black();
        }
        self.lobe(&mut &*at).eval_normals(wo, wi, mode)
    }

    #[inline]
    fn has_differential(&self) -> bool {
        L::DIFFERENTIAL
    }
}

/// Most textures a leaf may have: scenes with more are refused when they are built.
pub const MAX_SLOTS: usize = 4;
/// The same for a leaf that says so ([`Leaf::MANY`]).
pub const MANY_SLOTS: usize = 10;
/// The same for one that reads more than those.
pub const MOST_SLOTS: usize = 14;

/// The value of a lobe that was used. Without samples of its own, the change of normals is part of the rest.
#[inline(always)]
fn still<L: Leaf, R: Real>(
    lobe: &L::Lobe<R>,
    wo: Vec3<R::Primal>,
    u: &Use<R::Primal>,
    mode: TransportMode,
) -> Rgb<R> {
    let part = match u.part {
        Part::Normals if !L::DIFFERENTIAL => return Rgb::black(),
        Part::Rest if !L::DIFFERENTIAL => Part::All,
        part => part,
    };
    match u.component {
        Component::Continuous => lobe.eval_still(wo, u.wi, part, mode),
        Component::Delta { kind, .. } => lobe.eval_delta(Vec3::lift(wo), kind, mode),
    }
}

/// The local vector-Jacobian product: the lobe is evaluated over duals whose `K` tangents are
/// the active textures' values at this point, and contracted with the adjoints at once. Channels
/// do not mix, so one tangent per RGB texture is enough (see [`crate::params`]).
#[inline(always)]
fn leaf_backward<L: Leaf, P: Float, const K: usize>(
    leaf: &L,
    at: &Shading<P>,
    wo: Vec3<P>,
    uses: &[Use<P>],
    mode: TransportMode,
    grad: &mut impl GradSink<P>,
) {
    let mut seeds = Seeds::<P, _, K> {
        at: *at,
        grad: &*grad,
        n: 0,
    };
    let lobe = leaf.lobe::<Dual<P, K>>(&mut seeds);
    let mut d_slot = [Rgb::<P>::black(); K];
    for u in uses {
        let value = still::<L, Dual<P, K>>(&lobe, wo, u, mode);
        for (k, d) in d_slot.iter_mut().enumerate() {
            *d += Rgb::new(value.r.eps[k], value.g.eps[k], value.b.eps[k]) * u.d;
        }
    }
    leaf.lobe::<P>(&mut Scatter {
        uv: at.uv,
        grad,
        d_slot: &d_slot,
        n: 0,
    });
}

/// What readers that do not look at values return.
const PLACEHOLDER: f64 = 0.5;

/// Counts the active textures; the values are placeholders.
struct CountActive<'a, G> {
    grad: &'a G,
    n: usize,
}

impl<P: Float, G: GradSink<P>> Reader<P> for CountActive<'_, G> {
    #[inline(always)]
    fn mixed(&mut self, t: &RgbTexture) -> Rgb<P> {
        self.n += 3 * usize::from(t.any_param(|p| self.grad.active(p)));
        Rgb::splat(P::of(PLACEHOLDER))
    }
    #[inline(always)]
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<P> {
        self.n += usize::from(t.any_param(|p| self.grad.active(p)));
        Rgb::splat(P::of(PLACEHOLDER))
    }
    #[inline(always)]
    fn scalar(&mut self, t: &ScalarTexture) -> P {
        self.n += usize::from(t.any_param(|p| self.grad.active(p)));
        P::of(PLACEHOLDER)
    }
}

/// Reads values and gives each active texture the next tangent slot.
struct Seeds<'a, P: Float, G, const K: usize> {
    at: Shading<'a, P>,
    grad: &'a G,
    n: usize,
}

impl<P: Float, G: GradSink<P>, const K: usize> Seeds<'_, P, G, K> {
    #[inline(always)]
    fn slot(&mut self, active: bool) -> Option<usize> {
        let slot = self.n;
        self.n += usize::from(active);
        active.then_some(slot)
    }
}

#[inline(always)]
fn seed<P: Float, const K: usize>(x: P, slot: Option<usize>) -> Dual<P, K> {
    match slot {
        Some(k) => Dual::var(x, k),
        None => Dual::lift(x),
    }
}

impl<P: Float, G: GradSink<P>, const K: usize> Reader<Dual<P, K>> for Seeds<'_, P, G, K> {
    #[inline(always)]
    fn mixed(&mut self, t: &RgbTexture) -> Rgb<Dual<P, K>> {
        let colour = t.rgb(&self.at.theta, self.at.uv);
        let active = t.any_param(|p| self.grad.active(p));
        Rgb::from(colour.to_array().map(|x| {
            let slot = self.slot(active);
            seed(x, slot)
        }))
    }
    #[inline(always)]
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<Dual<P, K>> {
        let slot = self.slot(t.any_param(|p| self.grad.active(p)));
        t.rgb(&self.at.theta, self.at.uv).map(|x| seed(x, slot))
    }
    #[inline(always)]
    fn scalar(&mut self, t: &ScalarTexture) -> Dual<P, K> {
        let slot = self.slot(t.any_param(|p| self.grad.active(p)));
        seed(t.scalar(&self.at.theta, self.at.uv), slot)
    }
}

/// Visits the textures in the same order once more and hands out the slots' adjoints; the values are
/// placeholders.
struct Scatter<'a, P: Float, G, const K: usize> {
    uv: Vec2<P>,
    grad: &'a mut G,
    d_slot: &'a [Rgb<P>; K],
    n: usize,
}

impl<P: Float, G: GradSink<P>, const K: usize> Scatter<'_, P, G, K> {
    #[inline(always)]
    fn give<const C: usize>(&mut self, t: &crate::texture::Texture<C>) {
        if t.any_param(|p| self.grad.active(p)) {
            t.scatter(self.uv, self.d_slot[self.n], self.grad);
            self.n += 1;
        }
    }
}

impl<P: Float, G: GradSink<P>, const K: usize> Reader<P> for Scatter<'_, P, G, K> {
    #[inline(always)]
    fn mixed(&mut self, t: &RgbTexture) -> Rgb<P> {
        if t.any_param(|p| self.grad.active(p)) {
            let d = [0, 1, 2].map(|k| self.d_slot[self.n + k].sum());
            t.scatter(self.uv, d.into(), self.grad);
            self.n += 3;
        }
        Rgb::splat(P::of(PLACEHOLDER))
    }
    #[inline(always)]
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<P> {
        self.give(t);
        Rgb::splat(P::of(PLACEHOLDER))
    }
    #[inline(always)]
    fn scalar(&mut self, t: &ScalarTexture) -> P {
        self.give(t);
        P::of(PLACEHOLDER)
    }
}

/// Lists textures; the values are placeholders.
struct List<'a>(&'a mut dyn FnMut(TextureRef));

impl Reader<f32> for List<'_> {
    fn mixed(&mut self, t: &RgbTexture) -> Rgb<f32> {
        (self.0)(TextureRef::Mixed(t));
        Rgb::splat(PLACEHOLDER as f32)
    }
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<f32> {
        (self.0)(TextureRef::Rgb(t));
        Rgb::splat(PLACEHOLDER as f32)
    }
    fn scalar(&mut self, t: &ScalarTexture) -> f32 {
        (self.0)(TextureRef::Scalar(t));
        PLACEHOLDER as f32
    }
    fn alpha(&mut self, t: &ScalarTexture) -> f32 {
        (self.0)(TextureRef::Alpha(t));
        PLACEHOLDER as f32
    }
    fn exponent(&mut self, t: &ScalarTexture) -> f32 {
        (self.0)(TextureRef::Exponent(t));
        PLACEHOLDER as f32
    }
}
