//! Normals that are read from an image.

use std::sync::Arc;

use ad_core::{Dual, Float, Real, Vec3, array};

use super::nesting::nested_nodes;
use super::tilted::{Tilt, Tilted};
use super::{Corrections, Material, Shading, TextureRef, TransportMode};
use crate::error::SceneError;
use crate::image_io::Encoding;
use crate::math::each;
use crate::params::GradSink;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{self, Bitmap, Footprint, RgbTexture, UvTransform, Wrap};

/// A material in a frame tilted by a normal map: a texel `c` encodes the normal `2c - 1` in the shading frame.
pub type NormalMap = Tilted<EncodedNormals>;

/// The texels of a [`NormalMap`].
#[derive(Clone, Debug)]
pub struct EncodedNormals {
    map: RgbTexture,
    interpolation: Interpolation,
}

/// What is interpolated between texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// The encoded normals.
    Normals,
    /// Their slopes `(-x/z, -y/z)`: a height field keeps its slopes, as in
    /// [Zeltner et al. 2020, "Specular manifold sampling"].
    Slopes,
}

impl Interpolation {
    /// The vector that is interpolated; normal to the surface, not normalised.
    #[inline]
    pub(crate) fn decode<R: Real>(self, texel: [R; 3]) -> Vec3<R> {
        let n = Vec3::from(each(texel, |c| c * R::c(2.0) - R::c(1.0)));
        match self {
            Self::Normals => n,
            Self::Slopes => {
                // Also a texel that points sideways or down gets a slope.
                let z = n.z.max(R::of(LEAST_Z));
                Vec3::new(n.x / z, n.y / z, R::one())
            }
        }
    }
}

/// Smallest z of a normal that is turned into a slope: half a degree above the surface.
const LEAST_Z: f64 = 0.01;

impl NormalMap {
    /// `nested` in the frame that `map` describes.
    ///
    /// # Errors
    /// More than [`super::nesting::MAX_LEVELS`] levels of nesting.
    pub fn new(
        map: RgbTexture,
        interpolation: Interpolation,
        nested: Arc<Material>,
    ) -> Result<Self, SceneError> {
        Self::by(EncodedNormals { map, interpolation }, nested)
    }

    /// [`Tilted::vector`](super::Tilted) of what stands still, where the normals were looked up before.
    #[inline(always)]
    pub(crate) fn vector_between<P: Float>(
        &self,
        at: &Shading<P>,
        normals: &Footprint<P>,
        wo: Vec3<P>,
    ) -> Vec3<P> {
        let decode = |texel| self.interpolation().decode(texel).to_array();
        let v = normals.value_decoded(&at.theta, decode);
        self.seen(v.into(), wo, TransportMode::Radiance)
    }

    /// The texture of encoded normals.
    pub fn map(&self) -> &RgbTexture {
        &self.tilt.map
    }

    /// What is interpolated between texels.
    pub fn interpolation(&self) -> Interpolation {
        self.tilt.interpolation
    }
}

impl Tilt for EncodedNormals {
    #[inline]
    fn vector<R: Real>(&self, at: &Shading<R>) -> Vec3<R> {
        let decode = |texel| self.interpolation.decode(texel).to_array();
        self.map.eval_decoded(&at.theta, at.uv, decode).into()
    }

    fn scatter<P: Float>(&self, at: &Shading<P>, d: Vec3<P>, grad: &mut impl GradSink<P>) {
        let d_vector = d.to_array();
        let f = self.map.footprint(at.uv);
        for k in 0..4 {
            if f.weight[k] == P::zero() {
                continue;
            }
            let texel: [P; 3] = at.theta.texel(f.param, f.texel[k] as usize);
            let seeds: [Dual<P, 3>; 3] = array(|c| Dual::var(texel[c], c));
            let decoded = self.interpolation.decode(seeds).to_array();
            for c in 0..3 {
                let d: P = (0..3).map(|i| d_vector[i] * decoded[i].eps[c]).sum();
                grad.add(f.param, f.texel[k] as usize * 3 + c, f.weight[k] * d);
            }
        }
    }

    fn visit_textures(&self, f: &mut dyn FnMut(TextureRef)) {
        f(match self.interpolation {
            Interpolation::Normals => TextureRef::Vector(&self.map),
            Interpolation::Slopes => TextureRef::Encoded(&self.map),
        });
    }
}

impl FromNode for NormalMap {
    const PLUGINS: &'static [&'static str] = &["normalmap"];

    /// The map is a nested texture `normalmap`, as in Mitsuba 3, or the image `filename`, as in the scenes of
    /// [Zeltner et al. 2020]: read as raw numbers, repeated `tiles` times, slopes
    /// interpolated unless `use_slopes` is false. `flip_invalid_normals` and `use_shadowing_function` ask for
    /// [`Corrections`]; without them there are none, unlike in Mitsuba 3.9.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let nodes = nested_nodes(node, 1, 1)?;
        let nested = registry.material_from_node(nodes[0], "nested_bsdf")?;
        let name = format!("{}.normalmap", registry.prefix());
        let usage = texture::Use {
            name: &name,
            // Files round a little beyond [0, 1].
            valid: (-1.0, 2.0),
            substitute: &[0.5, 0.5, 1.0],
        };
        let child = node.child("normalmap").cloned();
        let is_nested = child.is_some();
        let slopes = node.boolean_or("use_slopes", child.is_none())?;
        let map = match child {
            Some(child) => texture::from_plugin(registry, &child, &usage)?,
            None => map_from_file(node, registry, &usage)?,
        };
        let corrections = Corrections {
            flip: node.boolean_or("flip_invalid_normals", false)?,
            shadowing: node.boolean_or("use_shadowing_function", false)?,
        };
        // Others that name a file themselves are of versions without corrections.
        if is_nested && CORRECTIONS.iter().any(|key| !node.has(key)) {
            node.warn(UNCORRECTED);
        }
        // A prefiltered stand-in for the map, of no use to a path tracer that resolves it.
        node.ignore(&["lean_fallback"], Node::boolean)?;
        node.ignore(&["lean_fallback_alpha"], Node::float)?;
        node.ignore(&["lean_fallback_material"], Node::string)?;
        let interpolation = if slopes {
            Interpolation::Slopes
        } else {
            Interpolation::Normals
        };
        Ok(Self::new(map, interpolation, nested)?.corrected(corrections))
    }
}

/// What asks for [`Corrections`], each by default in Mitsuba 3.9.
pub(crate) const CORRECTIONS: [&str; 2] = ["flip_invalid_normals", "use_shadowing_function"];
const UNCORRECTED: &str = "normals are as in the map where `flip_invalid_normals` and `use_shadowing_function` are not set; Mitsuba 3.9 \
    turns those over that face away from the viewer, and shades where they are tilted, unless both are false";

fn map_from_file(
    node: &Node,
    registry: &mut Registry,
    usage: &texture::Use,
) -> Result<RgbTexture, SceneError> {
    let tiles = node.float_or("tiles", 1.0)? as f32;
    let layer = node.string("layer")?;
    let Some(path) = texture::file(registry, node, usage)? else {
        let name = format!("{}.value", usage.name);
        return registry.constant(&name, usage.substitute, usage.valid);
    };
    let (param, [width, height]) =
        texture::texels::<3>(registry, &path, Encoding::Raw, layer, usage)?;
    registry.origins.of_image(node, param);
    Ok(RgbTexture::Bitmap(Bitmap {
        param,
        width,
        height,
        wrap: Wrap::Repeat,
        nearest: false,
        to_uv: UvTransform {
            rows: [[tiles, 0.0, 0.0], [0.0, tiles, 0.0]],
        },
    }))
}
