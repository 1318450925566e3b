//! Textures: parameters as a function of surface coordinates.
//!
//! Every texture is *linear* in its texels. A lookup is a [`Footprint`], a few texels with weights;
//! evaluation is the weighted sum and the adjoint is scattered through the same weights, so there is
//! one definition of a texture for both directions.
//!
//! ```
//! use ad_core::Vec2;
//! use render::params::{ParamShape, Params, Theta};
//! use render::texture::{RgbTexture, Texture};
//!
//! let mut params = Params::default();
//! let red = params.push("wall.reflectance.value", ParamShape::Rgb, &[0.7, 0.1, 0.1], (0.0, 1.0));
//! let wall: RgbTexture = Texture::Constant(red);
//! let theta = Theta::<f32>::constant(params.values());
//! assert_eq!(wall.eval(&theta, Vec2::new(0.2, 0.9)), [0.7, 0.1, 0.1]);
//! assert!(wall.any_param(|p| p == red));
//! ```

mod attribute;
mod bitmap;
mod checkerboard;
mod load;

pub use attribute::Attribute;
pub(crate) use attribute::{CELL_BEGIN, CELL_FILLED, columns, place};
pub(crate) use bitmap::Corners;
pub use bitmap::{Bitmap, UvTransform, Wrap};
pub use checkerboard::{Checkerboard, Square};
pub(crate) use load::{PLUGINS, Use, encoding, file, from_plugin, texels, times};

use ad_core::{Const, Float, Real, Vec2, array};

use crate::dispatch::outline;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta, per_channel};

/// Texels and weights of one lookup; unused entries have weight zero and repeat a valid texel.
#[derive(Clone, Copy, Debug)]
pub struct Footprint<R> {
    /// The range of each texel.
    pub param: ParamRef,
    /// Texel index within its range.
    pub texel: [u32; 4],
    /// Interpolation weight; sums to one.
    pub weight: [R; 4],
}

impl<R: Real> Footprint<R> {
    /// Of a constant.
    #[inline(always)]
    fn single(param: ParamRef) -> Self {
        Self {
            param,
            texel: [0; 4],
            weight: [R::one(), R::zero(), R::zero(), R::zero()],
        }
    }
}

impl<R: Real> Footprint<[R; 2]> {
    /// No slopes.
    #[inline(always)]
    fn flat(param: ParamRef) -> Self {
        Self {
            param,
            texel: [0; 4],
            weight: [[R::zero(); 2]; 4],
        }
    }
}

impl<P: Float> Footprint<P> {
    /// The value there, all channels.
    #[inline(always)]
    pub(crate) fn value<const C: usize>(&self, theta: &Theta<P>) -> [P; C] {
        self.value_decoded(theta, |texel| texel)
    }

    /// The same of what `decode` makes of each texel.
    #[inline(always)]
    pub(crate) fn value_decoded<const C: usize>(
        &self,
        theta: &Theta<P>,
        decode: impl Fn([P; C]) -> [P; C],
    ) -> [P; C] {
        gather(theta, self, decode, |texel, w| texel * Const(w))
    }

    /// Adds `d`, the adjoint of one of three channels of the lookup, to its texels.
    pub(crate) fn scatter_channel(&self, channel: u32, d: P, grad: &mut impl GradSink<P>) {
        for (texel, weight) in self.texel.into_iter().zip(self.weight) {
            if weight != P::zero() {
                grad.add(self.param, (texel * 3 + channel) as usize, weight * d);
            }
        }
    }
}

/// A texture with `C` channels: 1 (roughness, weights, opacity) or 3 (colours).
#[derive(Clone, Debug)]
pub enum Texture<const C: usize> {
    /// The same value everywhere.
    Constant(ParamRef),
    /// An image.
    Bitmap(Bitmap),
    /// Two colours in alternating squares.
    Checkerboard(Checkerboard),
    /// The same with images in some of the squares.
    Squares(Box<Checkerboard<Square>>),
    /// Numbers of a mesh.
    Attribute(Attribute),
}

/// A colour texture.
pub type RgbTexture = Texture<3>;
/// A scalar texture.
pub type ScalarTexture = Texture<1>;

impl<const C: usize> Texture<C> {
    /// The value at `uv`, all channels.
    ///
    /// # Derivatives
    /// In theta and in `uv` (through the interpolation weights).
    #[inline(always)]
    pub fn eval<R: Real>(&self, theta: &Theta<R>, uv: Vec2<R>) -> [R; C] {
        self.eval_decoded(theta, uv, |texel| texel)
    }

    /// [`Texture::eval`] of what `decode` makes of each texel.
    #[inline(always)]
    pub(crate) fn eval_decoded<R: Real>(
        &self,
        theta: &Theta<R>,
        uv: Vec2<R>,
        decode: impl Fn([R; C]) -> [R; C],
    ) -> [R; C] {
        match self {
            Self::Constant(p) => decode(theta.texel(*p, 0)),
            Self::Bitmap(t) => outline(|| interpolated(t, theta, uv, decode)),
            Self::Attribute(t) => outline(|| interpolated(t, theta, uv, decode)),
            Self::Checkerboard(t) => decode(theta.texel(*t.select(uv.primal()), 0)),
            Self::Squares(t) => outline(|| interpolated(t.select(uv.primal()), theta, uv, decode)),
        }
    }

    /// [`Texture::eval`] of what stands still, for loops over many lookups: no call, which would wait for `uv`.
    #[inline(always)]
    pub(crate) fn eval_in_line<P: Float>(&self, theta: &Theta<P>, uv: Vec2<P>) -> [P; C] {
        match self {
            Self::Bitmap(t) => t.footprint(uv).value(theta),
            _ => self.eval(theta, uv),
        }
    }

    /// Adds the adjoint `d` of the value at `uv` to the texels it was made from. A scalar texture
    /// takes the sum over the channels.
    #[inline(always)]
    pub fn scatter<P: Float>(&self, uv: Vec2<P>, d: Rgb<P>, grad: &mut impl GradSink<P>) {
        let d: [P; C] = per_channel(d);
        match self {
            Self::Constant(p) => put(grad, *p, 0, P::one(), d),
            Self::Bitmap(t) => outline(move || scatter(&t.footprint(uv), d, grad)),
            Self::Attribute(t) => outline(move || scatter(&t.footprint(uv), d, grad)),
            Self::Checkerboard(t) => put(grad, *t.select(uv), 0, P::one(), d),
            Self::Squares(t) => outline(move || scatter(&t.select(uv).footprint(uv), d, grad)),
        }
    }

    /// Says that [`Texture::eval`] will soon be called with the same `uv`.
    #[inline(always)]
    pub(crate) fn expect<P: Float>(&self, theta: &Theta<P>, uv: Vec2<P>) {
        self.rows(uv, |param, i| theta.expect(param, i));
    }

    /// Says that [`Texture::scatter`] will soon be called with the same `uv`.
    #[inline(always)]
    pub(crate) fn expect_scatter<P: Float>(&self, uv: Vec2<P>, grad: &mut impl GradSink<P>) {
        self.rows(uv, |param, i| grad.expect(param, i));
    }

    /// Calls `f` with the first values of the rows of a footprint: neighbours are mostly in one line of the cache.
    #[inline(always)]
    fn rows<P: Float>(&self, uv: Vec2<P>, mut f: impl FnMut(ParamRef, usize)) {
        if let Self::Bitmap(t) = self {
            let footprint = t.footprint(uv);
            for texel in [footprint.texel[0], footprint.texel[2]] {
                f(t.param, texel as usize * C);
            }
        }
    }

    /// The texels and weights of a lookup at `uv`.
    #[inline]
    pub(crate) fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        match self {
            Self::Constant(p) => Footprint::single(*p),
            Self::Bitmap(t) => t.footprint(uv),
            Self::Checkerboard(t) => Footprint::single(*t.select(uv.primal())),
            Self::Squares(t) => t.select(uv.primal()).footprint(uv),
            Self::Attribute(t) => t.footprint(uv),
        }
    }

    /// Texels of a lookup at `uv`, and how their weights change with u and v. None do unless it is an image that is
    /// interpolated: there is no slope of what is the same everywhere, or jumps.
    #[inline]
    pub(crate) fn slopes<R: Real>(&self, uv: Vec2<R>) -> Footprint<[R; 2]> {
        match self {
            Self::Constant(p) => Footprint::flat(*p),
            Self::Bitmap(t) if t.nearest => Footprint::flat(t.param),
            Self::Bitmap(t) => t.slopes(uv),
            Self::Checkerboard(t) => Footprint::flat(t.colors[0]),
            Self::Squares(t) => t.select(uv.primal()).slopes(uv),
            Self::Attribute(t) => Footprint::flat(t.param),
        }
    }

    /// The same texture under another number of channels: a handle does not know it.
    pub(crate) fn with_channels<const D: usize>(self) -> Texture<D> {
        match self {
            Self::Constant(p) => Texture::Constant(p),
            Self::Bitmap(t) => Texture::Bitmap(t),
            Self::Checkerboard(t) => Texture::Checkerboard(t),
            Self::Squares(t) => Texture::Squares(t),
            Self::Attribute(t) => Texture::Attribute(t),
        }
    }

    /// Calls `f` with every range the texture reads.
    pub fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
        match self {
            Self::Constant(p) => f(*p),
            Self::Bitmap(t) => f(t.param),
            Self::Checkerboard(t) => t.colors.iter().for_each(|&p| f(p)),
            Self::Squares(t) => t.colors.iter().for_each(|square| f(square.param())),
            Self::Attribute(t) => f(t.param),
        }
    }

    /// Whether its values are continuous on a surface around which this coordinate runs from 0 to 1.
    pub(crate) fn closes(&self, around: usize) -> bool {
        match self {
            Self::Constant(_) => true,
            Self::Bitmap(t) => {
                let whole = |row: &[f32; 3]| row[around].fract() == 0.0;
                !t.nearest && t.wrap == Wrap::Repeat && t.to_uv.rows.iter().all(whole)
            }
            Self::Checkerboard(_) | Self::Squares(_) | Self::Attribute(_) => false,
        }
    }

    /// Whether its values jump between texels or fields.
    pub(crate) fn jumps(&self) -> bool {
        match self {
            Self::Constant(_) => false,
            Self::Bitmap(t) => t.nearest,
            Self::Checkerboard(_) | Self::Squares(_) | Self::Attribute(_) => true,
        }
    }

    /// Whether any of its ranges satisfies `f`.
    #[inline]
    pub fn any_param(&self, mut f: impl FnMut(ParamRef) -> bool) -> bool {
        match self {
            Self::Constant(p) => f(*p),
            Self::Bitmap(t) => f(t.param),
            Self::Checkerboard(t) => t.colors.iter().any(|&p| f(p)),
            Self::Squares(t) => t.colors.iter().any(|square| f(square.param())),
            Self::Attribute(t) => f(t.param),
        }
    }
}

impl Texture<3> {
    /// [`Texture::eval`] as a colour.
    #[inline(always)]
    pub fn rgb<R: Real>(&self, theta: &Theta<R>, uv: Vec2<R>) -> Rgb<R> {
        self.eval(theta, uv).into()
    }
}

impl Texture<1> {
    /// [`Texture::eval`] as a scalar.
    #[inline(always)]
    pub fn scalar<R: Real>(&self, theta: &Theta<R>, uv: Vec2<R>) -> R {
        self.eval(theta, uv)[0]
    }
}

/// A texture of which several texels make a value.
trait Interpolated {
    /// The range of the texels.
    fn param(&self) -> ParamRef;
    /// Those of a lookup.
    fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R>;
}

impl Interpolated for Bitmap {
    #[inline(always)]
    fn param(&self) -> ParamRef {
        self.param
    }
    #[inline(always)]
    fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        Bitmap::footprint(self, uv)
    }
}

impl Interpolated for Attribute {
    #[inline(always)]
    fn param(&self) -> ParamRef {
        self.param
    }
    #[inline(always)]
    fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        Attribute::footprint(self, uv)
    }
}

/// The value at `uv` of what `decode` makes of each texel.
#[inline(always)]
fn interpolated<R: Real, const C: usize>(
    t: &impl Interpolated,
    theta: &Theta<R>,
    uv: Vec2<R>,
    decode: impl Fn([R; C]) -> [R; C],
) -> [R; C] {
    if !(uv.x.has_tangent() || uv.y.has_tangent()) {
        // On paths that stand still only texels move.
        let f = t.footprint(uv.primal());
        return gather(theta, &f, decode, |texel, w| texel * Const(w));
    }
    let f = t.footprint(uv);
    if theta.moves(t.param()) {
        gather(theta, &f, decode, |texel, w| texel * w)
    } else {
        let fixed = theta.primal().lift();
        gather(&fixed, &f, decode, |texel, w| w * Const(texel.primal()))
    }
}

/// Adds the adjoint of a value to the texels that it was made of.
#[inline(always)]
fn scatter<P: Float, const C: usize>(f: &Footprint<P>, d: [P; C], grad: &mut impl GradSink<P>) {
    for k in 0..4 {
        if f.weight[k] != P::zero() {
            put(grad, f.param, f.texel[k], f.weight[k], d);
        }
    }
}

/// Adds `weight d` to a texel.
#[inline(always)]
fn put<P: Float, const C: usize>(
    grad: &mut impl GradSink<P>,
    p: ParamRef,
    texel: u32,
    weight: P,
    d: [P; C],
) {
    grad.add_all::<C>(p, texel as usize * C, array(|c| weight * d[c]));
}

#[inline(always)]
fn gather<R: Real, W: Copy, const C: usize>(
    theta: &Theta<R>,
    f: &Footprint<W>,
    decode: impl Fn([R; C]) -> [R; C],
    weighted: impl Fn(R, W) -> R,
) -> [R; C] {
    let mut value = [R::zero(); C];
    // By a plain loop: iterators over two arrays become calls.
    for k in 0..4 {
        let texel = decode(theta.texel(f.param, f.texel[k] as usize));
        for c in 0..C {
            value[c] += weighted(texel[c], f.weight[k]);
        }
    }
    value
}
