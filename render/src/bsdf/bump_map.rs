//! Normals that follow from an image of heights.

use std::sync::Arc;

use ad_core::{Const, Float, Real, Vec3};

use super::chart::Stretch;
use super::nesting::nested_nodes;
use super::tilted::{Tilt, Tilted};
use super::{Corrections, Material, Shading, TextureRef, TransportMode};
use crate::error::SceneError;
use crate::math::Rgb;
use crate::params::{GradSink, ParamShape, Theta};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{self, Footprint, ScalarTexture, Texture};

/// A material in the frame of a surface that heights along the shading normal displace, in units of the scene
/// [Blinn 1978].
///
/// Surface and normal stay as they are; how the normal turns along the surface is left out, as in Mitsuba 3. The slope of
/// the heights is that of the bilinear image, so the normal jumps between its texels. A point on a surface in a scene knows
/// how long dp/du and dp/dv are ([`super::Charted`]); elsewhere both are of length one and at right angles.
///
/// # Derivatives
/// In the heights and the scale.
///
/// # Does not handle
/// Mitsuba turns a normal over that is behind the geometric one; here it is on the side of the shading normal. They differ
/// where the heights and interpolated normals tilt by more than a right angle together.
pub type BumpMap = Tilted<Bumps>;

/// The heights of a [`BumpMap`].
#[derive(Clone, Debug)]
pub struct Bumps {
    height: ScalarTexture,
    scale: ScalarTexture,
}

impl BumpMap {
    /// `nested` on a surface displaced by `scale`, which is the same everywhere, times `height`.
    ///
    /// # Errors
    /// More than [`super::nesting::MAX_LEVELS`] levels of nesting.
    pub fn new(
        height: ScalarTexture,
        scale: ScalarTexture,
        nested: Arc<Material>,
    ) -> Result<Self, SceneError> {
        Self::by(Bumps { height, scale }, nested)
    }

    /// The texture of heights.
    pub fn height(&self) -> &ScalarTexture {
        &self.tilt.height
    }

    /// What they are multiplied with.
    pub(crate) fn scale(&self) -> &ScalarTexture {
        &self.tilt.scale
    }
}

/// The slope of the unscaled heights along u and v.
#[inline(always)]
fn slope<R: Real>(height: &ScalarTexture, at: &Shading<R>) -> [R; 2] {
    slope_between(&at.theta, &height.slopes(at.uv))
}

/// The same of a lookup.
#[inline(always)]
fn slope_between<R: Real>(theta: &Theta<R>, f: &Footprint<[R; 2]>) -> [R; 2] {
    let mut sum = [R::zero(); 2];
    for k in 0..4 {
        let [h]: [R; 1] = theta.texel(f.param, f.texel[k] as usize);
        let [u, v] = f.weight[k];
        sum[0] += h * u;
        sum[1] += h * v;
    }
    sum
}

/// What the normal of a displaced surface is multiplied with: one over its largest component, with the sign that
/// turns it to the front. `None` where it is none.
#[inline(always)]
fn front<R: Real>(n: Vec3<R>) -> Option<R::Primal> {
    let n = n.primal();
    let size = n.x.abs().max(n.y.abs()).max(n.z.abs());
    let by = size.recip().copysign(n.z);
    // False for NaN as well.
    (size > R::Primal::zero() && by.is_finite() && size <= R::Primal::MAX).then_some(by)
}

/// Normal to `dp/du = (a, 0, u)` and `dp/dv = (b, c, v)`.
#[inline(always)]
fn normal<R: Real>(Stretch { a, b, c }: &Stretch<R>, [u, v]: [R; 2]) -> Vec3<R> {
    Vec3::new(-(u * *c), u * *b - v * *a, *a * *c)
}

impl Bumps {
    /// [`Tilt::vector`] where heights and their scale have this slope and this value.
    #[inline(always)]
    fn vector_of<R: Real>(&self, at: &Shading<R>, [u, v]: [R; 2], scale: R) -> Vec3<R> {
        let n = normal(&at.stretch(), [u * scale, v * scale]);
        // Its length does not matter, but has to be far from the ends of the scalar.
        front(n).map_or(Vec3::zero(), |by| n * Const(by))
    }
}

impl BumpMap {
    /// [`Tilted::vector`](super::Tilted) of what stands still, where the heights were looked up before.
    #[inline(always)]
    pub(crate) fn vector_between<P: Float>(
        &self,
        at: &Shading<P>,
        heights: &Footprint<[P; 2]>,
        scale: P,
        wo: Vec3<P>,
    ) -> Vec3<P> {
        let slope = slope_between(&at.theta, heights);
        let v = self.tilt.vector_of(at, slope, scale);
        self.seen(v, wo, TransportMode::Radiance)
    }
}

impl Tilt for Bumps {
    #[inline]
    fn vector<R: Real>(&self, at: &Shading<R>) -> Vec3<R> {
        let scale = self.scale.scalar(&at.theta, at.uv);
        self.vector_of(at, slope(&self.height, at), scale)
    }

    fn scatter<P: Float>(&self, at: &Shading<P>, d: Vec3<P>, grad: &mut impl GradSink<P>) {
        let scale = self.scale.scalar(&at.theta, at.uv);
        let (stretch, slope) = (at.stretch(), slope(&self.height, at));
        let Some(by) = front(normal(&stretch, slope.map(|x| x * scale))) else {
            return;
        };
        let Stretch { a, b, c } = stretch;
        let d_u = (d.y * b - d.x * c) * by;
        let d_v = -(d.y * a) * by;
        let d_scale = d_u * slope[0] + d_v * slope[1];
        if self.scale.any_param(|p| grad.active(p)) {
            let d_scale = Rgb::new(d_scale, P::zero(), P::zero());
            self.scale.scatter(at.uv, d_scale, grad);
        }
        if !self.height.any_param(|p| grad.active(p)) {
            return;
        }
        let f = self.height.slopes(at.uv);
        for (texel, [u, v]) in f.texel.into_iter().zip(f.weight) {
            grad.add(f.param, texel as usize, (d_u * u + d_v * v) * scale);
        }
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        f(TextureRef::Height(&self.height));
        f(TextureRef::Height(&self.scale));
    }
}

impl FromNode for BumpMap {
    const PLUGINS: &'static [&'static str] = &["bumpmap"];

    /// Heights are a nested texture of any name, an image or a number, times `scale` (1). `flip_invalid_normals` and
    /// `use_shadowing_function` are on, as in Mitsuba 3.9.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let nodes = nested_nodes(node, 1, 1)?;
        let nested = registry.material_from_node(nodes[0], "nested_bsdf")?;
        let corrections = Corrections {
            flip: node.boolean_or("flip_invalid_normals", true)?,
            shadowing: node.boolean_or("use_shadowing_function", true)?,
        };
        let scale = node.float_or("scale", 1.0)?;
        let name = format!("{}.scale", registry.prefix());
        let scale = registry.push_param(&name, ParamShape::Scalar, &[scale], ANY)?;
        registry.origins.of_value(node, "scale", scale);
        let name = format!("{}.nested_texture", registry.prefix());
        let usage = texture::Use {
            name: &name,
            valid: ANY,
            substitute: &[0.5],
        };
        let child = node.child_with_tag("texture")?.cloned();
        let child = child.ok_or_else(|| node.missing("texture", "one nested <texture>"))?;
        let height = texture::from_plugin(registry, &child, &usage)?;
        if !matches!(height, Texture::Bitmap(_) | Texture::Constant(_)) {
            return Err(SceneError::Refused {
                location: child.location.clone(),
                tag: child.tag.clone(),
                plugin: child.plugin.clone(),
                what: "the slope of heights other than those of an image is",
            });
        }
        Ok(Self::new(height, Texture::Constant(scale), nested)?.corrected(corrections))
    }
}

/// Valid heights, and factors on them.
const ANY: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);
