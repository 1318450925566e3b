//! Local derivatives: any function of the material at one vertex, pulled back to the texels there.
//!
//! The generic code that renders is run once more over dual numbers whose tangents are the active
//! textures' values at this point, and contracted with the adjoint at once.

use std::sync::Arc;

use ad_core::{Dual, Float, Real, Vec2};
use smallvec::SmallVec;

use crate::bsdf::chart::Chart;
use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Seed, Theta, Which};
use crate::texture::{Footprint, RgbTexture, ScalarTexture};

/// Tangents per evaluation at one vertex, of the values that its textures have there: few materials have more, and
/// those are evaluated several times.
const FEW: usize = 4;
/// The same for the texels that whole paths read, which are many.
const TEXELS: usize = 8;

/// What most materials read at a vertex fits without a trip to the heap.
type Short<T> = SmallVec<[T; 8]>;

/// A colour that depends on the parameters of one material.
pub trait LocalFn<P: Float> {
    /// Whether its channels depend on other channels of textures.
    const MIXES: bool = false;
    /// Its value over any scalar.
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R>;
}

/// A texture of a material that is differentiated.
#[derive(Clone, Debug)]
pub struct ActiveTexture {
    read: Read,
    /// Of the surface, if the texture is read at other coordinates than interactions have.
    chart: Option<Arc<Chart>>,
}

/// By how results depend on it: see [`TextureRef`].
#[derive(Clone, Debug)]
enum Read {
    Rgb(RgbTexture),
    Scalar(ScalarTexture),
    Vector(RgbTexture),
    Encoded(RgbTexture),
    Height(ScalarTexture),
}

impl ActiveTexture {
    /// Those of `material` that read a range for which `active` holds, each of them once: its parts may share one.
    pub fn of(material: &Material, active: impl Fn(ParamRef) -> bool) -> Vec<Self> {
        let chart = match material {
            Material::Charted(m) => Some(m.chart()),
            _ => None,
        };
        let mut found = Vec::new();
        let mut seen = Vec::new();
        let mut list = |t: TextureRef| {
            if !t.any_param(&active) || t.any_param(|p| seen.contains(&p.id)) {
                return;
            }
            t.visit_params(&mut |p| seen.push(p.id));
            let read = match t {
                TextureRef::Rgb(t) => Read::Rgb(t.clone()),
                TextureRef::Scalar(t) | TextureRef::Alpha(t) | TextureRef::Exponent(t) => {
                    Read::Scalar(t.clone())
                }
                TextureRef::Mixed(t) | TextureRef::Vector(t) => Read::Vector(t.clone()),
                TextureRef::Encoded(t) => Read::Encoded(t.clone()),
                TextureRef::Height(t) => Read::Height(t.clone()),
            };
            let chart = chart.cloned();
            found.push(Self { read, chart });
        };
        // What is right for values that are not linear in the texels is right for those that are.
        for encoded in [true, false] {
            material.visit_textures(&mut |t| {
                if matches!(t, TextureRef::Encoded(_) | TextureRef::Height(_)) == encoded {
                    list(t);
                }
            });
        }
        found
    }

    fn as_ref(&self) -> TextureRef<'_> {
        match &self.read {
            Read::Rgb(t) => TextureRef::Rgb(t),
            Read::Scalar(t) => TextureRef::Scalar(t),
            Read::Vector(t) => TextureRef::Vector(t),
            Read::Encoded(t) => TextureRef::Encoded(t),
            Read::Height(t) => TextureRef::Height(t),
        }
    }

    /// Where it is read, at a point with these coordinates.
    fn place<P: Float>(&self, uv: Vec2<P>) -> Vec2<P> {
        self.chart.as_ref().map_or(uv, |chart| chart.own(uv).0)
    }
}

/// Where the adjoint of one tangent goes.
enum Slot<'a, P> {
    /// A texture: channels stay apart, and its texels share by their weights.
    Rgb(&'a RgbTexture, Vec2<P>),
    /// The same with one channel.
    Scalar(&'a ScalarTexture, Vec2<P>),
    /// One channel of a texture whose channels mix.
    Channel(Footprint<P>, u32),
    /// A texel of a range with 1 or 3 channels, which stay apart.
    Texel(ParamRef, u32, u32),
    /// One element of a range.
    Element(ParamRef, u32),
}

/// Adds `d . df/d texels` for the `textures` of a material at `uv`, which `f` reads nowhere else.
pub fn pull_back<P: Float, F: LocalFn<P>>(
    textures: &[ActiveTexture],
    theta: &Theta<P>,
    uv: Vec2<P>,
    f: &F,
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let mut slots = Short::new();
    for t in textures {
        let uv = t.place(uv);
        match &t.read {
            Read::Rgb(t) if !F::MIXES => slots.push(Slot::Rgb(t, uv)),
            Read::Scalar(t) => slots.push(Slot::Scalar(t, uv)),
            Read::Rgb(map) | Read::Vector(map) => {
                let f = map.footprint(uv);
                slots.extend((0..3).map(|c| Slot::Channel(f, c)));
            }
            Read::Encoded(map) => texels(&map.footprint(uv), |p, texel| {
                slots.extend((0..3).map(|c| Slot::Element(p, texel * 3 + c)));
            }),
            Read::Height(map) => all_texels(&map.footprint(uv), |p, texel| {
                slots.push(Slot::Element(p, texel));
            }),
        }
    }
    pull_back_slots::<P, FEW>(theta, f, d, &slots, grad);
}

/// Texels that a function of the parameters reads, each of them once.
#[derive(Clone, Debug, Default)]
pub struct Texels {
    found: Vec<Texel>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Texel {
    param: ParamRef,
    texel: u32,
    channels: u32,
    /// Whether its channels mix.
    mixes: bool,
}

impl Texels {
    /// Adds those of the `textures` of a material at `uv`, of the ranges for which `active` holds.
    pub fn add_all<P: Float>(
        &mut self,
        textures: &[ActiveTexture],
        uv: Vec2<P>,
        active: impl Fn(ParamRef) -> bool,
    ) {
        for t in textures {
            self.add(t.as_ref(), t.place(uv), &active);
        }
    }

    /// The same of one texture.
    pub fn add<P: Float>(
        &mut self,
        texture: TextureRef,
        uv: Vec2<P>,
        active: impl Fn(ParamRef) -> bool,
    ) {
        let (f, channels, mixes) = match texture {
            TextureRef::Rgb(t) => (t.footprint(uv), 3, false),
            TextureRef::Scalar(t) | TextureRef::Alpha(t) | TextureRef::Exponent(t) => {
                (t.footprint(uv), 1, false)
            }
            TextureRef::Mixed(t) | TextureRef::Vector(t) | TextureRef::Encoded(t) => {
                (t.footprint(uv), 3, true)
            }
            TextureRef::Height(t) => (t.footprint(uv), 1, false),
        };
        let slopes = matches!(texture, TextureRef::Height(_));
        let add = |param, texel| {
            let texel = Texel {
                param,
                texel,
                channels,
                mixes,
            };
            if active(param) && !self.found.contains(&texel) {
                self.found.push(texel);
            }
        };
        if slopes {
            all_texels(&f, add);
        } else {
            texels(&f, add);
        }
    }

    /// All elements.
    fn elements(&self) -> impl Iterator<Item = (ParamRef, u32)> {
        let each = |t: &Texel| {
            let Texel {
                param,
                texel,
                channels,
                ..
            } = *t;
            (0..channels).map(move |c| (param, texel * channels + c))
        };
        self.found.iter().flat_map(each)
    }

    fn slots<P>(&self) -> Vec<Slot<'_, P>> {
        let mut slots = Vec::new();
        for t in &self.found {
            if t.mixes {
                let element = |c| Slot::Element(t.param, t.texel * t.channels + c);
                slots.extend((0..t.channels).map(element));
            } else {
                slots.push(Slot::Texel(t.param, t.texel, t.channels));
            }
        }
        slots
    }
}

/// Adds `d . df/d texels` for all active texels that are read at `vertices` (textures of the material, uv), and that
/// `f` may read at several of them.
pub fn pull_back_texels<'a, P: Float>(
    vertices: impl Iterator<Item = (&'a [ActiveTexture], Vec2<P>)>,
    theta: &Theta<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let mut texels = Texels::default();
    for (textures, uv) in vertices {
        texels.add_all(textures, uv, |p| grad.active(p));
    }
    pull_back_slots::<P, TEXELS>(theta, f, d, &texels.slots(), grad);
}

/// Adds, for all `texels`, the change of the gradient of `d . f` when the parameters move along a
/// direction and `d` changes by `change`: `d . d2f/(d texel d direction) + change . df/d texel`.
/// `direction` gives the components of the direction, and is asked for these texels only.
pub fn pull_back_second<P: Float>(
    texels: &Texels,
    theta: &Theta<P>,
    direction: impl Fn(ParamRef, u32) -> P,
    f: &impl LocalFn<P>,
    [d, change]: [Rgb<P>; 2],
    grad: &mut impl GradSink<P>,
) {
    type Twice<P> = Dual<Dual<P, 1>, TEXELS>;
    let moving: Short<Seed<Twice<P>>> = texels
        .elements()
        .map(|(p, element)| Seed {
            param: p.id,
            which: Which::One(element),
            tangent: Dual::constant(Dual::new(P::zero(), [direction(p, element)])),
        })
        .filter(|s| s.tangent.re.eps[0] != P::zero())
        .collect();
    for slots in texels.slots().chunks(TEXELS) {
        let mut seeds = moving.clone();
        let inner = Dual::constant(P::zero());
        push_seeds(slots, |k| Dual::var(inner, k), &mut seeds);
        let value = f.eval::<Twice<P>>(&Theta::seeded(theta, &seeds));
        for (k, slot) in slots.iter().enumerate() {
            let each = |c: usize| {
                let Dual { re, eps: [twice] } = value[c].eps[k];
                d[c] * twice + change[c] * re
            };
            slot.give(Rgb::new(each(0), each(1), each(2)), grad);
        }
    }
}

/// The different texels of a footprint, also those without weight: their slope may have some.
fn all_texels<P: Float>(f: &Footprint<P>, mut each: impl FnMut(ParamRef, u32)) {
    for k in 0..4 {
        if !f.texel[..k].contains(&f.texel[k]) {
            each(f.param, f.texel[k]);
        }
    }
}

/// The different texels of a footprint.
fn texels<P: Float>(f: &Footprint<P>, mut each: impl FnMut(ParamRef, u32)) {
    for k in 0..4 {
        if f.weight[k] != P::zero() && !f.texel[..k].contains(&f.texel[k]) {
            each(f.param, f.texel[k]);
        }
    }
}

fn pull_back_slots<P: Float, const K: usize>(
    theta: &Theta<P>,
    f: &impl LocalFn<P>,
    d: Rgb<P>,
    slots: &[Slot<P>],
    grad: &mut impl GradSink<P>,
) {
    for slots in slots.chunks(K) {
        match slots.len() {
            1 => chunk::<P, 1>(theta, f, d, slots, grad),
            _ => chunk::<P, K>(theta, f, d, slots, grad),
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
    let mut seeds = Short::new();
    push_seeds(slots, |k| Dual::<P, K>::var(P::zero(), k), &mut seeds);
    let value = f.eval::<Dual<P, K>>(&Theta::seeded(theta, &seeds));
    for (k, slot) in slots.iter().enumerate() {
        let adjoint = Rgb::new(value.r.eps[k], value.g.eps[k], value.b.eps[k]) * d;
        slot.give(adjoint, grad);
    }
}

/// The tangent `tangent(k)` for everything that slot `k` stands for.
fn push_seeds<P, R>(slots: &[Slot<P>], tangent: impl Fn(usize) -> R, seeds: &mut Short<Seed<R>>) {
    for (k, slot) in slots.iter().enumerate() {
        let mut seed = |p: ParamRef, which| {
            seeds.push(Seed {
                param: p.id,
                which,
                tangent: tangent(k),
            });
        };
        match slot {
            Slot::Rgb(t, _) => t.visit_params(&mut |p| seed(p, Which::All)),
            Slot::Scalar(t, _) => t.visit_params(&mut |p| seed(p, Which::All)),
            Slot::Channel(f, c) => seed(f.param, Which::Channel(*c)),
            Slot::Texel(p, texel, channels) => {
                (0..*channels).for_each(|c| seed(*p, Which::One(texel * channels + c)));
            }
            Slot::Element(p, element) => seed(*p, Which::One(*element)),
        }
    }
}

impl<P: Float> Slot<'_, P> {
    /// Adds its adjoint, channel by channel.
    fn give(&self, adjoint: Rgb<P>, grad: &mut impl GradSink<P>) {
        match self {
            Self::Rgb(t, uv) => t.scatter(*uv, adjoint, grad),
            Self::Scalar(t, uv) => t.scatter(*uv, adjoint, grad),
            Self::Channel(f, c) => f.scatter_channel(*c, adjoint.sum(), grad),
            Self::Texel(p, texel, 1) => grad.add(*p, *texel as usize, adjoint.sum()),
            Self::Texel(p, texel, _) => {
                (0..3).for_each(|c| grad.add(*p, *texel as usize * 3 + c, adjoint[c]));
            }
            Self::Element(p, element) => grad.add(*p, *element as usize, adjoint.sum()),
        }
    }
}
