//! Textures from scene files.

use std::path::Path;
use std::sync::Arc;

use super::{Bitmap, Checkerboard, RgbTexture, ScalarTexture, Square, Texture, UvTransform, Wrap};
use crate::error::{SceneError, quoted};
use crate::image_io::{self, Encoding};
use crate::params::{ParamRef, ParamShape};
use crate::plugin::{Node, Registry, range_text};

/// Texture plugins of scene files.
pub(crate) const PLUGINS: &[&str] = &["bitmap", "checkerboard", "mesh_attribute", "scale"];

/// What stands in for a missing file.
const GREY: f64 = 0.5;

/// What a texture is loaded for.
pub(crate) struct Use<'a> {
    /// What its parameters' names start with, such as `wall.bsdf.reflectance`.
    pub name: &'a str,
    /// Smallest and largest valid value.
    pub valid: (f64, f64),
    /// The value where a file is missing and may be.
    pub substitute: &'a [f64],
}

/// What a texture that is built of a node depends on besides.
fn details(channels: usize, valid: (f64, f64)) -> [u64; 3] {
    [channels as u64, valid.0.to_bits(), valid.1.to_bits()]
}

/// Textures.
impl Registry {
    /// A constant colour parameter; `valid` bounds each channel.
    ///
    /// # Errors
    /// A channel outside `valid`.
    pub fn rgb(
        &mut self,
        name: &str,
        value: [f64; 3],
        valid: (f64, f64),
    ) -> Result<RgbTexture, SceneError> {
        self.constant(name, &value, valid)
    }

    /// A constant scalar parameter within `valid`.
    ///
    /// # Errors
    /// A value outside `valid`.
    pub fn scalar(
        &mut self,
        name: &str,
        value: f64,
        valid: (f64, f64),
    ) -> Result<ScalarTexture, SceneError> {
        self.constant(name, &[value], valid)
    }

    /// An image as a texture whose texels, `[height][width][C]`, become the parameter `{name}.data`: repeated,
    /// bilinear, row 0 at v = 0; `valid` bounds each texel. 1 or 3 channels.
    ///
    /// # Errors
    /// A wrong number of texels, or one outside `valid`.
    pub fn texels<const C: usize>(
        &mut self,
        name: &str,
        [width, height]: [u32; 2],
        texels: &[f32],
        valid: (f64, f64),
    ) -> Result<Texture<C>, SceneError> {
        let name = format!("{name}.data");
        let error = |expected: String, found: String| SceneError::Parameter {
            key: name.clone(),
            expected,
            found,
        };
        let shape = ParamShape::Texture {
            height: height as usize,
            width: width as usize,
            channels: C,
        };
        if texels.is_empty() || shape.len() != texels.len() {
            let expected = format!("{width} x {height} x {C} texels");
            return Err(error(expected, texels.len().to_string()));
        }
        let inside = |v: &&f32| (valid.0 as f32..=valid.1 as f32).contains(*v);
        if let Some(bad) = texels.iter().find(|v| !inside(v)) {
            return Err(error(range_text(valid), bad.to_string()));
        }
        let param = self
            .push_texels(&name, shape, texels, valid)
            .ok_or_else(|| error("at most 2^32 parameters".into(), "more".into()))?;
        Ok(Texture::Bitmap(Bitmap {
            param,
            width,
            height,
            wrap: Wrap::Repeat,
            nearest: false,
            to_uv: UvTransform::IDENTITY,
        }))
    }

    pub(crate) fn constant<const C: usize>(
        &mut self,
        name: &str,
        value: &[f64],
        valid: (f64, f64),
    ) -> Result<Texture<C>, SceneError> {
        let shape = if C == 1 {
            ParamShape::Scalar
        } else {
            ParamShape::Rgb
        };
        self.push_param(name, shape, value, valid)
            .map(Texture::Constant)
    }

    /// A colour of a scene file: a constant, or a texture.
    ///
    /// # Errors
    /// Anything wrong with the value or its file.
    pub fn rgb_texture(
        &mut self,
        node: &Node,
        key: &str,
        default: [f64; 3],
        valid: (f64, f64),
    ) -> Result<RgbTexture, SceneError> {
        from_node(self, node, key, &default, valid)
    }

    /// A number of a scene file: a constant, or a texture.
    ///
    /// # Errors
    /// Anything wrong with the value or its file.
    pub fn scalar_texture(
        &mut self,
        node: &Node,
        key: &str,
        default: f64,
        valid: (f64, f64),
    ) -> Result<ScalarTexture, SceneError> {
        from_node(self, node, key, &[default], valid)
    }
}

/// The texture `key` of `node`: a nested texture plugin, a constant, or the default.
pub(crate) fn from_node<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    key: &str,
    default: &[f64],
    valid: (f64, f64),
) -> Result<Texture<C>, SceneError> {
    let name = format!("{}.{key}", registry.prefix());
    let texture = node.child(key).filter(|t| !t.is_constant());
    if let Some(texture) = texture {
        if texture.tag != "texture" {
            return Err(node.invalid(key, "a texture, a colour or a number"));
        }
        let usage = Use {
            name: &name,
            valid,
            substitute: if C == 1 { default } else { &[GREY; 3] },
        };
        return from_plugin(registry, texture, &usage);
    }
    let mut value = constant_of::<C>(node, key)?.unwrap_or_else(|| default.to_vec());
    raise(node, key, &mut value, valid);
    let name = format!("{name}.value");
    let texture = registry.constant(&name, &value, valid);
    let texture = texture.map_err(|e| e.at(node.place(key)))?;
    texture.visit_params(&mut |p| registry.origins.of_value(node, key, p));
    Ok(texture)
}

/// The constant `key` of `node` in so many channels: a number is grey, and a colour has a luminance.
fn constant_of<const C: usize>(node: &Node, key: &str) -> Result<Option<Vec<f64>>, SceneError> {
    Ok(match C {
        1 => node.grey(key)?.map(|x| vec![x]),
        _ => node.rgb(key)?.map(|c| c.to_vec()),
    })
}

/// A smallest valid number, other than zero, that stands for zero and what is between, with a warning: roughness has one, as in
/// Mitsuba. Not that of ranges whose smallest number means something else than next to nothing.
fn next_to_zero((lo, _): (f64, f64)) -> Option<f64> {
    (lo > 0.0 && lo < 1e-3).then_some(lo)
}

fn raise(node: &Node, key: &str, values: &mut [f64], valid: (f64, f64)) {
    let Some(lo) = next_to_zero(valid) else {
        return;
    };
    for value in values.iter_mut().filter(|v| (0.0..lo).contains(*v)) {
        node.warn(format!(
            "`{key}` is {lo} instead of {value}, the least that it may be"
        ));
        *value = lo;
    }
}

/// The texture that `node` describes times a colour: one of its own, whatever else refers to the description.
pub(crate) fn times(
    registry: &mut Registry,
    node: &Arc<Node>,
    usage: &Use,
    by: [f64; 3],
) -> Result<RgbTexture, SceneError> {
    let texture: RgbTexture = described(registry, node, usage)?;
    let params = registry.params_mut();
    let mut finite = true;
    texture.visit_params(&mut |p| {
        let range = params.infos()[p.id as usize].range();
        for (value, by) in params.values_mut()[range].iter_mut().zip(by.iter().cycle()) {
            *value = (f64::from(*value) * by) as f32;
            finite &= value.is_finite();
        }
    });
    // The product of two parts of the file stands in neither.
    registry.origins.forget(node);
    if finite {
        Ok(texture)
    } else {
        Err(node.invalid("filename", "texels that stay finite when they are scaled"))
    }
}

/// A texture that several places refer to, and what its parameters' names start with.
struct Shared {
    texture: RgbTexture,
    name: String,
}

/// The texture that `node` describes; one that several places refer to has its parameters once, which answer to the names of
/// all these places, and to its id.
pub(crate) fn from_plugin<const C: usize>(
    registry: &mut Registry,
    node: &Arc<Node>,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let mut details = details(C, usage.valid);
    if node.plugin == "mesh_attribute" {
        // What it reads is another shape's next time.
        let serial = registry.attributes.as_ref().map_or(0, |a| a.serial);
        details[0] |= serial << 8;
    }
    if let Some(shared) = registry.shared::<Shared>(node, details) {
        (registry.params_mut()).answer(usage.name.to_owned(), &shared.name);
        return Ok(shared.texture.clone().with_channels());
    }
    let texture: Texture<C> = described(registry, node, usage)?;
    let shared = Shared {
        texture: texture.clone().with_channels(),
        name: usage.name.to_owned(),
    };
    registry.share(node, details, Arc::new(shared));
    if let Some(id) = &node.id {
        registry.params_mut().answer_of_one(id, usage.name);
    }
    Ok(texture)
}

fn described<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let texture = match node.plugin.as_str() {
        "bitmap" => bitmap(registry, node, usage)?,
        "checkerboard" => checkerboard(registry, node, usage)?,
        "mesh_attribute" => attribute(registry, node, usage)?,
        "scale" => scaled(registry, node, usage)?,
        _ => return Err(node.unknown_plugin(PLUGINS)),
    };
    node.finish()?;
    Ok(texture)
}

fn bitmap<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let encoding = encoding(node)?;
    let filters = [("bilinear", false), ("nearest", true)];
    let nearest = node.choice("filter_type", &filters)?.unwrap_or(false);
    let wraps = [
        ("repeat", Wrap::Repeat),
        ("clamp", Wrap::Clamp),
        ("mirror", Wrap::Mirror),
    ];
    let wrap = node.choice("wrap_mode", &wraps)?.unwrap_or_default();
    let to_uv = to_uv(node)?;
    // How Mitsuba 3 stores texels; here they are always f32.
    node.string("format")?;
    node.boolean("accel")?;
    let layer = node.string("layer")?;
    let Some(path) = file(registry, node, usage)? else {
        let (name, value) = (format!("{}.value", usage.name), usage.substitute);
        return registry.constant(&name, value, usage.valid);
    };
    let (param, [width, height]) = texels::<C>(registry, &path, encoding, layer, usage)?;
    registry.origins.of_image(node, param);
    Ok(Texture::Bitmap(Bitmap {
        param,
        width,
        height,
        wrap,
        nearest,
        to_uv,
    }))
}

/// What the samples of an image of 8 or 16 bits mean: `raw` (false), or the `gamma` of old files.
pub(crate) fn encoding(node: &Node) -> Result<Encoding, SceneError> {
    let raw = node.boolean_or("raw", false)?;
    match node.float("gamma")? {
        Some(_) if raw => Err(node.invalid("gamma", "none beside `raw`")),
        Some(gamma) if gamma > 0.0 => Ok(Encoding::Gamma(gamma)),
        Some(_) => Err(node.invalid("gamma", "a positive number")),
        None if raw => Ok(Encoding::Raw),
        None => Ok(Encoding::Srgb),
    }
}

/// The texture inside times a number or a colour, `scale` (1), with parameters of its own: one of versions before 2.
fn scaled<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let nested = node.child_with_tag("texture")?;
    let nested = nested.ok_or_else(|| node.missing("texture", "one nested <texture>"))?;
    let by = constant_of::<C>(node, "scale")?.unwrap_or_else(|| vec![1.0; C]);
    // Only the product has to be valid.
    let free = Use {
        valid: (f64::NEG_INFINITY, f64::INFINITY),
        ..*usage
    };
    let texture: Texture<C> = described(registry, nested, &free)?;
    let (lo, hi) = usage.valid;
    let params = registry.params_mut();
    let mut bad = None;
    texture.visit_params(&mut |p| {
        let range = params.infos()[p.id as usize].range();
        for (value, by) in params.values_mut()[range].iter_mut().zip(by.iter().cycle()) {
            *value = (f64::from(*value) * by) as f32;
            let valid = value.is_finite() && (lo as f32..=hi as f32).contains(value);
            bad = bad.or((!valid).then_some(*value));
        }
        params.bound(p, usage.valid);
    });
    if let Some(bad) = bad {
        let expected = format!(
            "a factor that leaves {}, none of them {bad}",
            range_text(usage.valid)
        );
        return Err(node.invalid("scale", &expected));
    }
    // What is written in its place is the texture inside with these values.
    registry.origins.hand_on(nested, node);
    Ok(texture)
}

/// The existing file that the attribute `filename` names; `None`, with a warning, if it is missing and
/// may be.
pub(crate) fn file(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Option<std::path::PathBuf>, SceneError> {
    match node.path("filename") {
        Ok(Some(path)) => Ok(Some(path)),
        Ok(None) => Err(node.missing("filename", "the name of an image file")),
        Err(error @ SceneError::NoFile { .. }) if registry.allow_missing => {
            let value = usage.substitute;
            node.warn_of_file(
                &error,
                &format!("{} is {value:?} instead", quoted(usage.name)),
            );
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Emission may be negative by this much of its mean in image files: what filters that sharpen leave at the borders of
/// bright things when an image is resampled. Such numbers become zero, with a warning.
const RINGING: f64 = 0.1;

/// Reads an image, or a layer of one, into the parameters `{name}.data`; returns its width and height too.
pub(crate) fn texels<const C: usize>(
    registry: &mut Registry,
    path: &Path,
    encoding: Encoding,
    layer: Option<&str>,
    usage: &Use,
) -> Result<(ParamRef, [u32; 2]), SceneError> {
    let pixels = image_io::read_layer(path, encoding, layer)?;
    let mut pixels = match C {
        1 => pixels.into_grey(),
        _ => pixels.into_rgb(),
    };
    if usage.valid == (0.0, f64::INFINITY) {
        let sum: f64 = pixels.data.iter().map(|&v| f64::from(v)).sum();
        let least = -RINGING * sum / pixels.data.len() as f64;
        let ringing = |v: f32| v < 0.0 && f64::from(v) >= least;
        let count = pixels.data.iter().filter(|v| ringing(**v)).count();
        if count > 0 {
            let all = pixels.data.len();
            let what = format!("{count} of {all} numbers for {}", quoted(usage.name));
            let warning = format!(
                "{}: {what} are slightly negative; they are zero instead",
                path.display()
            );
            registry.warnings.push(warning);
            for v in pixels.data.iter_mut().filter(|v| ringing(**v)) {
                *v = 0.0;
            }
        }
    }
    if let Some(lo) = next_to_zero(usage.valid) {
        let lo = lo as f32;
        let few = (pixels.data.iter_mut()).filter(|v| (0.0..lo).contains(*v));
        let count = few.map(|v| *v = lo).count();
        if count > 0 {
            let what = format!("{count} numbers for {}", quoted(usage.name));
            let warning = format!(
                "{}: {what} are less than {lo}; they are that instead",
                path.display()
            );
            registry.warnings.push(warning);
        }
    }
    let (lo, hi) = (usage.valid.0 as f32, usage.valid.1 as f32);
    let asset = |expected: String, found: String| SceneError::Asset {
        path: path.to_owned(),
        line: None,
        expected,
        found,
    };
    let valid = |v: &f32| v.is_finite() && (lo..=hi).contains(v);
    if let Some(i) = pixels.data.iter().position(|v| !valid(v)) {
        let (x, y) = (i / C % pixels.width, i / C / pixels.width);
        let converted = match layer {
            None if image_io::is_in_xyz(path) => {
                ", in red, green and blue from its channels X, Y and Z"
            }
            _ => "",
        };
        return Err(asset(
            format!("texels from {lo} to {hi} for {}", quoted(usage.name)),
            format!("{} at column {x}, row {y}{converted}", pixels.data[i]),
        ));
    }
    let shape = ParamShape::Texture {
        height: pixels.height,
        width: pixels.width,
        channels: C,
    };
    let name = format!("{}.data", usage.name);
    let param = registry
        .push_texels(&name, shape, &pixels.data, usage.valid)
        .inspect(|p| registry.params_mut().encode(*p, encoding))
        .ok_or_else(|| {
            let found = "more with this image".to_owned();
            asset(format!("at most {} parameters", u32::MAX), found)
        })?;
    Ok((param, [pixels.width as u32, pixels.height as u32]))
}

fn checkerboard<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let mut colors = [
        square::<C>(registry, node, usage, "color0", 0.4)?,
        square::<C>(registry, node, usage, "color1", 0.2)?,
    ];
    // As Mitsuba 3 draws it, where numbers have the other squares than colours.
    if C == 1 {
        colors.swap(0, 1);
    }
    let to_uv = to_uv(node)?;
    Ok(match colors {
        [Square::Constant(a), Square::Constant(b)] => Texture::Checkerboard(Checkerboard {
            colors: [a, b],
            to_uv,
        }),
        colors => Texture::Squares(Box::new(Checkerboard { colors, to_uv })),
    })
}

/// What is in every other square of a checkerboard: a constant or an image.
fn square<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
    key: &str,
    default: f64,
) -> Result<Square, SceneError> {
    let name = format!("{}.{key}", usage.name);
    let inside = (node.child(key)).filter(|t| t.tag == "texture" && !t.is_constant());
    if let Some(inside) = inside {
        if ["checkerboard", "mesh_attribute"].contains(&inside.plugin.as_str()) {
            return Err(inside.refused("textures in a `checkerboard` other than images are"));
        }
        let usage = Use {
            name: &name,
            ..*usage
        };
        return match from_plugin::<C>(registry, inside, &usage)? {
            Texture::Constant(p) => Ok(Square::Constant(p)),
            Texture::Bitmap(t) => Ok(Square::Bitmap(t)),
            _ => Err(inside.refused("textures in a `checkerboard` other than images are")),
        };
    }
    let mut value = constant_of::<C>(node, key)?.unwrap_or_else(|| vec![default; C]);
    raise(node, key, &mut value, usage.valid);
    let shape = match C {
        1 => ParamShape::Scalar,
        _ => ParamShape::Rgb,
    };
    let param = registry.push_param(&format!("{name}.value"), shape, &value, usage.valid)?;
    registry.origins.of_value(node, key, param);
    Ok(Square::Constant(param))
}

/// An attribute of the mesh whose shape is being built; its values are the parameter of that name of the shape.
fn attribute<const C: usize>(
    registry: &mut Registry,
    node: &Node,
    usage: &Use,
) -> Result<Texture<C>, SceneError> {
    let name = node.string("name")?;
    let expected = "the name of an attribute, such as `vertex_color`";
    let name = name.ok_or_else(|| node.missing("name", expected))?;
    let scale = node.float_or("scale", 1.0)?;
    let (found, triangles, shape) = match &registry.attributes {
        Some(a) if a.absent => {
            return registry.constant(
                &format!("{}.value", usage.name),
                usage.substitute,
                usage.valid,
            );
        }
        Some(a) => (a.found.as_ref(), a.triangles.clone(), &a.shape),
        None => (None, Arc::default(), &usage.name.to_owned()),
    };
    let found = found.ok_or_else(|| node.invalid("name", "an attribute of a PLY mesh"))?;
    let Some(attribute) = found.get(name) else {
        let known: Vec<_> = found.keys().map(|k| quoted(k)).collect();
        let expected = format!("one of the attributes of the mesh: {}", known.join(", "));
        return Err(node.invalid("name", &expected));
    };
    if attribute.channels != C {
        let expected = format!("an attribute of {C} numbers, not {}", attribute.channels);
        return Err(node.invalid("name", &expected));
    }
    let values: Vec<f32> = (attribute.values.iter())
        .map(|&v| (f64::from(v) * scale) as f32)
        .collect();
    let (lo, hi) = (usage.valid.0 as f32, usage.valid.1 as f32);
    if let Some(bad) = values
        .iter()
        .find(|v| !(v.is_finite() && (lo..=hi).contains(*v)))
    {
        let expected = format!("an attribute of numbers from {lo} to {hi}, none of them {bad}");
        return Err(node.invalid("name", &expected));
    }
    let range = ParamShape::Texture {
        height: 1,
        width: values.len() / C,
        channels: C,
    };
    let (name, of_faces) = (format!("{shape}.{name}"), attribute.of_faces);
    let param = registry.push_texels(&name, range, &values, usage.valid);
    let texture = param.and_then(|p| super::Attribute::new(p, &triangles, of_faces));
    (texture.map(Texture::Attribute))
        .ok_or_else(|| node.invalid("name", "an attribute of fewer triangles"))
}

/// The attribute `to_uv`: what a transform of space does to its xy plane.
pub(crate) fn to_uv(node: &Node) -> Result<UvTransform, SceneError> {
    let t = node.transform("to_uv")?.unwrap_or_default();
    let row = |i: usize| [t.linear[i][0], t.linear[i][1], t.translation[i]].map(|x| x as f32);
    Ok(UvTransform {
        rows: [row(0), row(1)],
    })
}
