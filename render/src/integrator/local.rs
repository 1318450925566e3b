//! Local derivatives: any function of the material at one vertex, pulled back to the texels there.
//!
//! The generic code that renders is run once more over dual numbers whose tangents are the active
//! textures' values at this point, and contracted with the adjoint at once.

use ad_core::{Dual, Float, Real, Vec2};

use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Seed, Theta};
use crate::texture::{Footprint, RgbTexture, ScalarTexture};

/// Tangents per evaluation; a vertex with more active textures is evaluated several times.
const WIDTH: usize = 4;

/// A colour that depends on the parameters of one material.
pub trait LocalFn<P: Float> {
    /// Its value over any scalar.
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R>;
}

/// Where the adjoint of one tangent goes.
enum Slot<P> {
    /// A texture: channels stay apart, and its texels share by their weights.
    Rgb(RgbTexture, Vec2<P>),
    /// The same with one channel.
    Scalar(ScalarTexture, Vec2<P>),
    /// A texel of a range with 1 or 3 channels, which stay apart.
    Texel(ParamRef, u32, u32),
    /// One element of a range.
    Element(ParamRef, u32),
}

/// Adds `d . df/d texels` for the active textures of `material` at `uv`, which `f` reads nowhere else.
pub fn pull_back<P: Float>(
    material: &Material,
    theta: &Theta<P>,
    uv: Vec2<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let mut slots = Vec::new();
    let mut seen = Vec::new();
    material.visit_textures(&mut |t| {
        // Both sides of a surface may share a material.
        let (mut any, mut again) = (false, false);
        t.visit_params(&mut |p| {
            any |= grad.active(p);
            again |= seen.contains(&p.id);
            seen.push(p.id);
        });
        if !any || again {
            return;
        }
        match t {
            TextureRef::Rgb(t) => slots.push(Slot::Rgb(t.clone(), uv)),
            TextureRef::Scalar(t) => slots.push(Slot::Scalar(t.clone(), uv)),
            TextureRef::Vector(map) => texels(&map.footprint(uv), |p, texel| {
                slots.extend((0..3).map(|c| Slot::Element(p, texel * 3 + c)));
            }),
        }
    });
    pull_back_slots(theta, f, d, &slots, grad);
}

/// Adds `d . df/d texels` for all active texels that are read at `vertices` (material, uv), and that `f`
/// may read at several of them.
pub fn pull_back_texels<'a, P: Float>(
    vertices: impl Iterator<Item = (&'a Material, Vec2<P>)>,
    theta: &Theta<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let mut found: Vec<(ParamRef, u32, u32, bool)> = Vec::new();
    for (material, uv) in vertices {
        material.visit_textures(&mut |t| {
            let (f, channels, mixes) = match t {
                TextureRef::Rgb(t) => (t.footprint(uv), 3, false),
                TextureRef::Scalar(t) => (t.footprint(uv), 1, false),
                TextureRef::Vector(t) => (t.footprint(uv), 3, true),
            };
            texels(&f, |p, texel| {
                let texel = (p, texel, channels, mixes);
                if grad.active(p) && !found.contains(&texel) {
                    found.push(texel);
                }
            });
        });
    }
    let mut slots = Vec::new();
    for (p, texel, channels, mixes) in found {
        if mixes {
            slots.extend((0..channels).map(|c| Slot::Element(p, texel * channels + c)));
        } else {
            slots.push(Slot::Texel(p, texel, channels));
        }
    }
    pull_back_slots(theta, f, d, &slots, grad);
}

/// The different texels of a footprint.
fn texels<P: Float>(f: &Footprint<P>, mut each: impl FnMut(ParamRef, u32)) {
    for k in 0..4 {
        if f.weight[k] != P::zero() && !f.texel[..k].contains(&f.texel[k]) {
            each(f.param, f.texel[k]);
        }
    }
}

fn pull_back_slots<P: Float>(
    theta: &Theta<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    slots: &[Slot<P>],
    grad: &mut impl GradSink<P>,
) {
    if slots.len() == 1 {
        chunk::<P, 1>(theta, f, d, slots, grad);
    } else {
        for slots in slots.chunks(WIDTH) {
            chunk::<P, WIDTH>(theta, f, d, slots, grad);
        }
    }
}

fn chunk<P: Float, const K: usize>(
    theta: &Theta<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    slots: &[Slot<P>],
    grad: &mut impl GradSink<P>,
) {
    let mut seeds = Vec::with_capacity(slots.len());
    for (k, slot) in slots.iter().enumerate() {
        let tangent = Dual::<P, K>::var(P::zero(), k);
        let mut seed = |p: ParamRef, element| {
            seeds.push(Seed {
                param: p.id,
                element,
                tangent,
            });
        };
        match slot {
            Slot::Rgb(t, _) => t.visit_params(&mut |p| seed(p, None)),
            Slot::Scalar(t, _) => t.visit_params(&mut |p| seed(p, None)),
            Slot::Texel(p, texel, channels) => {
                (0..*channels).for_each(|c| seed(*p, Some(texel * channels + c)));
            }
            Slot::Element(p, element) => seed(*p, Some(*element)),
        }
    }
    let value = f.eval::<Dual<P, K>>(&Theta::seeded(theta, &seeds));
    for (k, slot) in slots.iter().enumerate() {
        let adjoint = Rgb::new(value.r.eps[k], value.g.eps[k], value.b.eps[k]) * d;
        match slot {
            Slot::Rgb(t, uv) => t.scatter(*uv, adjoint, grad),
            Slot::Scalar(t, uv) => t.scatter(*uv, adjoint, grad),
            Slot::Texel(p, texel, 1) => grad.add(*p, *texel as usize, adjoint.sum()),
            Slot::Texel(p, texel, _) => {
                (0..3).for_each(|c| grad.add(*p, *texel as usize * 3 + c, adjoint[c]));
            }
            Slot::Element(p, element) => grad.add(*p, *element as usize, adjoint.sum()),
        }
    }
}
