//! OpenEXR files: which of their channels are the picture.

use std::collections::BTreeMap;
use std::io::Cursor;

use exr::prelude as exr;
use exr::{ReadChannels, ReadLayers};

use super::{COMMENTS, Labels, Mismatch, Pixels, check_samples, check_size, mismatch};
use crate::math::rgb_of_xyz;

/// Names of layers that hold the picture itself, by which renderers call it, most telling first.
const PICTURES: &[&str] = &["combined", "beauty", "rgba"];
/// Channels of colours in CIE XYZ.
const XYZ: [&str; 3] = ["X", "Y", "Z"];

/// Channels that belong together: those of one part whose names agree up to the last dot.
struct Group<'a> {
    /// Of the part where a file has several, and of the channels; empty for a file's unnamed layer.
    name: String,
    size: (usize, usize),
    /// By what follows the last dot.
    channels: BTreeMap<String, &'a exr::AnyChannel<exr::FlatSamples>>,
}

impl<'a> Group<'a> {
    /// Red, green and blue, or grey, or CIE XYZ in a file's unnamed layer; `None` for what is no colour. Luminance is none
    /// where it stands beside chroma (`RY`, `BY`), and `X`, `Y` and `Z` are coordinates in a layer with a name.
    fn colours(&self) -> Option<Vec<&'a exr::AnyChannel<exr::FlatSamples>>> {
        let channel = |name: &str| self.channels.get(name).copied();
        let three = |names: &[&str; 3]| names.map(channel).into_iter().collect::<Option<Vec<_>>>();
        if let Some(rgb) = three(&["R", "G", "B"]) {
            return Some(rgb);
        }
        if self.is_xyz() {
            return three(&XYZ);
        }
        let others = ["X", "Z", "RY", "BY"];
        if others.iter().any(|name| self.channels.contains_key(*name)) {
            return None;
        }
        channel("Y").map(|y| vec![y])
    }

    /// Whether its colours are in CIE XYZ.
    fn is_xyz(&self) -> bool {
        self.name.is_empty() && (self.channels.keys()).filter(|c| *c != "A").eq(&XYZ)
    }

    /// The last part of its name.
    fn last(&self) -> &str {
        self.name.rsplit('.').next().unwrap_or_default()
    }

    /// "`N` (X, Y, Z)"
    fn describe(&self) -> String {
        let channels: Vec<_> = self.channels.keys().map(String::as_str).collect();
        let channels = channels.join(", ");
        if self.name.is_empty() {
            format!("an unnamed one ({channels})")
        } else {
            format!("`{}` ({channels})", self.name)
        }
    }

    fn pixels(&self, colours: &[&exr::AnyChannel<exr::FlatSamples>]) -> Pixels {
        let (width, height) = self.size;
        let channels = colours.len();
        let mut data = vec![0.0; width * height * channels];
        for (c, channel) in colours.iter().enumerate() {
            let values = channel.sample_data.values_as_f32();
            for (pixel, value) in data.chunks_exact_mut(channels).zip(values) {
                pixel[c] = value;
            }
        }
        if self.is_xyz() {
            for pixel in data.chunks_exact_mut(channels) {
                let rgb = rgb_of_xyz([0, 1, 2].map(|c| f64::from(pixel[c])));
                pixel.copy_from_slice(&rgb.map(|x| x as f32));
            }
        }
        Pixels {
            width,
            height,
            channels,
            data,
        }
    }
}

/// The picture of an OpenEXR file, or the layer of that name.
pub(super) fn decode(bytes: &[u8], layer: Option<&str>) -> Result<Pixels, Mismatch> {
    let bad = |e: exr::Error| mismatch("a complete OpenEXR image", e);
    let meta = exr::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    let mut samples = 0usize;
    for header in &meta.headers {
        let exr::Vec2(width, height) = header.layer_size;
        check_size(width, height)?;
        for channel in &header.channels.list {
            if channel.sampling != exr::Vec2(1, 1) {
                return Err(mismatch(
                    "a sample per pixel in every channel",
                    format!("subsampled channel `{}`", channel.name),
                ));
            }
        }
        let pixels = (width * height).saturating_mul(header.channels.list.len());
        samples = samples.saturating_add(pixels);
    }
    check_samples(samples)?;
    let image = exr::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        // A panic in a pool's thread could not be caught.
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    let groups = groups(&image.layer_data);
    let (group, colours) = choose(&groups, layer)?;
    Ok(group.pixels(&colours))
}

/// The texts in the header of the first part.
pub(super) fn labels(bytes: &[u8]) -> Result<Labels, Mismatch> {
    let bad = |e: exr::Error| mismatch("an OpenEXR image", e);
    let meta = exr::MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    let Some(header) = meta.headers.first() else {
        return Ok(Labels::new());
    };
    let attributes = &header.own_attributes;
    let texts = attributes.other.iter().filter_map(|(name, value)| {
        let exr::AttributeValue::Text(text) = value else {
            return None;
        };
        Some((name.to_string(), text.to_string()))
    });
    let comments = attributes.comments.iter();
    let comments = comments.map(|text| (COMMENTS.to_owned(), text.to_string()));
    Ok(texts.chain(comments).collect())
}

/// Whether all that a file has are channels `X`, `Y` and `Z`, with or without alpha.
pub(super) fn is_in_xyz(bytes: &[u8]) -> bool {
    let meta = exr::MetaData::read_from_buffered(Cursor::new(bytes), false);
    meta.is_ok_and(|meta| {
        let names = meta.headers.iter().flat_map(|h| &h.channels.list);
        let names = names.map(|c| c.name.to_string()).filter(|c| c != "A");
        names.eq(XYZ)
    })
}

/// The layers of a file, in its order.
fn groups(parts: &[exr::Layer<exr::AnyChannels<exr::FlatSamples>>]) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for part in parts {
        // The name of a file's only part says nothing about its channels.
        let part_name = match &part.attributes.layer_name {
            Some(name) if parts.len() > 1 => name.to_string(),
            _ => String::new(),
        };
        let first = groups.len();
        for channel in &part.channel_data.list {
            let full = channel.name.to_string();
            let (prefix, last) = full.rsplit_once('.').unwrap_or(("", &full));
            let name = if prefix.is_empty() || prefix == part_name {
                part_name.clone()
            } else if part_name.is_empty() || prefix.starts_with(&format!("{part_name}.")) {
                prefix.to_owned()
            } else {
                format!("{part_name}.{prefix}")
            };
            let at = match groups[first..].iter().position(|g| g.name == name) {
                Some(i) => first + i,
                None => {
                    groups.push(Group {
                        name,
                        size: (part.size.0, part.size.1),
                        channels: BTreeMap::new(),
                    });
                    groups.len() - 1
                }
            };
            groups[at].channels.insert(last.to_owned(), channel);
        }
    }
    groups
}

type Chosen<'g, 'a> = (&'g Group<'a>, Vec<&'a exr::AnyChannel<exr::FlatSamples>>);

/// By name, if one is given; else the unnamed layer, or one that is called as pictures are, or the only one of colours.
fn choose<'g, 'a>(
    groups: &'g [Group<'a>],
    layer: Option<&str>,
) -> Result<Chosen<'g, 'a>, Mismatch> {
    let all = || {
        let all: Vec<_> = groups.iter().map(Group::describe).collect();
        match all.len() {
            0 => "no layers".to_owned(),
            _ => format!("the layers {}", all.join(", ")),
        }
    };
    let coloured: Vec<_> = (groups.iter())
        .filter_map(|g| Some((g, g.colours()?)))
        .collect();
    let only = |matches: &dyn Fn(&Group) -> bool| {
        let mut found = coloured.iter().filter(|(g, _)| matches(g));
        match (found.next(), found.next()) {
            (Some(one), None) => Some(one.clone()),
            _ => None,
        }
    };
    if let Some(name) = layer {
        return only(&|g| g.name == name)
            .or_else(|| only(&|g| g.last() == name))
            .ok_or_else(|| {
                let expected = format!("one layer `{name}` with channels `R`, `G` and `B`, or `Y`");
                mismatch(expected, all())
            });
    }
    if coloured.is_empty() {
        let expected = "a layer with channels `R`, `G` and `B`, or `Y` alone";
        return Err(mismatch(expected, all()));
    }
    let pictures =
        (PICTURES.iter()).find_map(|name| only(&|g| g.last().eq_ignore_ascii_case(name)));
    only(&|g| g.name.is_empty())
        .or(pictures)
        .or_else(|| only(&|_| true))
        .ok_or_else(|| {
            mismatch(
                "the name of a layer, since there are several (`layer` in a scene file, FILE.EXR:LAYER on a command line)",
                all(),
            )
        })
}
