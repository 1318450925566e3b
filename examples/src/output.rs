//! Files that tools write and read. Every file appears complete or not at all.

use std::collections::HashMap;
use std::fmt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use render::Image;
use render::image_io::{self, Encoding, Pixels};
use render::instances::Estimator;
use serde::{Serialize, Serializer};

use crate::chart::{self, LineChart, Panel};
use crate::cli::ToolError;

/// An estimator in a report, which names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named(pub Estimator);

impl fmt::Display for Named {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.0.name())
    }
}

impl Serialize for Named {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(self.0.name())
    }
}

/// Makes sure, before the work, that all these files can be written in the end: creates their folders, and
/// tries each of them. They must differ from each other, and from what is read: the last one written would
/// replace it.
///
/// # Errors
/// The operating system's, or two paths to the same file.
pub fn prepare(written: &[PathBuf], read: &[&Path]) -> Result<(), ToolError> {
    let mut uses: HashMap<PathBuf, &str> = HashMap::new();
    for path in read {
        // One that cannot be found has been complained about, or will be.
        let (file, _) = image_io::split_layer(path);
        if let Ok(place) = image_io::target(&file) {
            uses.insert(place, "is read");
        }
    }
    for path in written {
        create_parent(path)?;
        let unwritable = |e: std::io::Error| match e.kind() {
            // A folder or a device, say.
            ErrorKind::InvalidInput => ToolError::file(path, e),
            _ => ToolError::file(path, format!("cannot write the file: {e}")),
        };
        image_io::try_to_write(path).map_err(unwritable)?;
        let place = image_io::target(path).map_err(unwritable)?;
        if let Some(first) = uses.insert(place, "would be written twice") {
            let message = format!("expected a file of its own, found one that {first}");
            return Err(ToolError::file(path, message));
        }
    }
    Ok(())
}

/// Creates the folder that `path` lies in.
///
/// # Errors
/// The operating system's.
pub fn create_parent(path: &Path) -> Result<(), ToolError> {
    match path.parent() {
        Some(dir) if !dir.as_os_str().is_empty() => create_dir(dir),
        _ => Ok(()),
    }
}

/// Creates a folder and those above it.
///
/// # Errors
/// The operating system's.
pub fn create_dir(dir: &Path) -> Result<(), ToolError> {
    std::fs::create_dir_all(dir)
        .map_err(|e| ToolError::file(dir, format!("cannot create the folder: {e}")))
}

/// Removes a file, if it is there.
///
/// # Errors
/// The operating system's.
pub fn remove(path: &Path) -> Result<(), ToolError> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != ErrorKind::NotFound => {
            Err(ToolError::file(path, format!("cannot remove it: {e}")))
        }
        _ => Ok(()),
    }
}

/// Writes a value as indented JSON.
///
/// # Errors
/// The operating system's, or a value that JSON cannot hold.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), ToolError> {
    let mut text = serde_json::to_string_pretty(value).map_err(|e| ToolError::file(path, e))?;
    text.push('\n');
    Ok(image_io::write_atomically(path, text.as_bytes())?)
}

/// Writes a texture, `[height][width][channels]` with 1 or 3 channels, as OpenEXR in f32.
///
/// # Errors
/// The operating system's.
pub fn write_texture(
    path: &Path,
    [height, width, channels]: [usize; 3],
    values: &[f64],
) -> Result<(), ToolError> {
    let pixels = Pixels {
        width,
        height,
        channels,
        data: values.iter().map(|&v| v as f32).collect(),
    };
    Ok(image_io::write_exr_pixels(path, &pixels)?)
}

/// Writes a linear image as an 8-bit sRGB picture: see [`tone_map`].
///
/// # Errors
/// The operating system's.
pub fn write_png(path: &Path, image: &Image) -> Result<(), ToolError> {
    let mut mapped = image.clone();
    mapped.data.iter_mut().for_each(|x| *x = tone_map(*x));
    Ok(image_io::write_png(path, &mapped, 0.0)?)
}

/// Writes labelled pictures in a row.
///
/// # Errors
/// The operating system's.
pub fn write_panels(path: &Path, columns: usize, panels: &[Panel]) -> Result<(), ToolError> {
    let png = chart::grid(columns, panels).map_err(|e| ToolError::file(path, e))?;
    Ok(image_io::write_atomically(path, &png)?)
}

/// Writes a chart as SVG and PNG; `path` has no extension.
///
/// # Errors
/// The operating system's.
pub fn write_chart(path: &Path, chart: &LineChart) -> Result<(), ToolError> {
    let drawn = |e| ToolError::file(path, e);
    let (svg, png) = (chart.svg().map_err(drawn)?, chart.png().map_err(drawn)?);
    image_io::write_atomically(&path.with_extension("svg"), svg.as_bytes())?;
    Ok(image_io::write_atomically(
        &path.with_extension("png"),
        &png,
    )?)
}

/// Small images are enlarged to at least this width, so that their labels fit,
const PANEL_WIDTH: usize = 320;
/// unless they become higher than this: the rest of the width is white then.
const PANEL_HEIGHT: usize = 2048;

/// A picture as large as its label needs.
pub fn readable(panel: Panel) -> Panel {
    let [width, height] = panel.size().map(|n| n.max(1));
    let factor = PANEL_WIDTH.div_ceil(width).min(PANEL_HEIGHT / height);
    panel.enlarged(factor.max(1)).widened(PANEL_WIDTH)
}

/// A labelled image.
pub fn panel(label: &str, image: &Image) -> Panel {
    readable(Panel::tonemapped(label, image, 1.0))
}

/// Mean over the channels of every pixel in false colours, white at zero.
pub fn signed_panel(label: &str, image: &Image) -> Panel {
    let mean = |p: &[f32]| p.iter().map(|&x| f64::from(x)).sum::<f64>() / 3.0;
    let values: Vec<f64> = image.data.chunks_exact(3).map(mean).collect();
    readable(Panel::signed(label, image.width, &values, None))
}

/// Reads an image that must have this size, `[width, height]`; `FILE.EXR:LAYER` is a layer of one.
///
/// # Errors
/// No image, one with a pixel that is not finite, or another size.
pub fn read_image(path: &Path, [width, height]: [usize; 2]) -> Result<Image, ToolError> {
    let (file, layer) = image_io::split_layer(path);
    let image = image_io::read_layer(&file, Encoding::Srgb, layer.as_deref()).map(Image::from)?;
    if (image.width, image.height) != (width, height) {
        return Err(ToolError::file(
            path,
            format!(
                "expected the scene's size of {width} x {height} pixels, found {} x {}",
                image.width, image.height
            ),
        ));
    }
    Ok(image)
}

/// Up to 0.7 a value is shown as it is; brighter ones approach 1 smoothly instead of being cut.
pub fn tone_map(x: f32) -> f32 {
    const KNEE: f32 = 0.7;
    if x > KNEE {
        1.0 - (1.0 - KNEE) * ((KNEE - x) / (1.0 - KNEE)).exp()
    } else {
        x
    }
}

/// `stem.suffix` beside `path`, whose own extension is dropped.
pub fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(".");
    name.push(suffix);
    path.with_file_name(name)
}

/// A parameter's key as part of a file name: different for different keys, and the same in an address.
pub fn file_name(key: &str) -> String {
    let name = |b: u8| {
        if b.is_ascii_alphanumeric() || b"._-".contains(&b) {
            char::from(b).to_string()
        } else {
            format!("~{b:02X}")
        }
    };
    key.bytes().map(name).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn tones_are_kept_up_to_the_knee_and_rise_to_white() {
        assert_eq!((tone_map(0.0), tone_map(0.5)), (0.0, 0.5));
        assert_eq!(tone_map(f32::INFINITY), 1.0);
        let tones: Vec<f32> = (0..300).map(|i| tone_map(i as f32 * 0.01)).collect();
        let steps: Vec<f32> = tones.windows(2).map(|t| t[1] - t[0]).collect();
        // Monotone, and no kink: the slope falls slowly from 1.
        assert!(steps.iter().all(|s| *s > 0.0 && *s < 0.0101));
        assert!(steps.windows(2).all(|s| (s[1] - s[0]).abs() < 4e-4));
    }

    #[test]
    fn pictures_of_narrow_images_stay_small() {
        for (width, height) in [(1, 4096), (4096, 1), (1, 1 << 16), (2, 3), (36, 24), (1, 1)] {
            let image = Image::new(width, height);
            let [w, h] = readable(Panel::tonemapped("", &image, 1.0)).size();
            assert!(w >= PANEL_WIDTH && w <= width.max(2 * PANEL_WIDTH), "{w}");
            assert!(h >= height && h <= height.max(PANEL_HEIGHT), "{h}");
        }
        // Where it fits, pixels are squares as large as the label needs.
        let small = Panel::tonemapped("", &Image::new(36, 24), 1.0);
        assert_eq!(readable(small).size(), [9 * 36, 9 * 24]);
    }

    #[test]
    fn what_cannot_be_written_is_known_before() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let input = at("in.xml");
        fs::write(&input, "in").unwrap();
        fs::create_dir(at("folder")).unwrap();
        let refused = |names: &[&str]| {
            let files: Vec<PathBuf> = names.iter().map(|n| at(n)).collect();
            prepare(&files, &[&input]).unwrap_err().to_string()
        };
        for (names, named) in [
            (
                &["a.exr", "folder/../a.exr"][..],
                "folder/../a.exr: expected a file of its own, found one that would be written twice",
            ),
            (
                &["a.exr", "in.xml"],
                "in.xml: expected a file of its own, found one that is read",
            ),
            (&["folder"], "folder: expected a file, found a folder"),
            (&["in.xml/a.exr"], "in.xml: cannot create the folder"),
            (&["a/.."], "a/..: cannot write the file"),
        ] {
            let error = refused(names);
            assert!(error.contains(named), "{names:?}: {error}");
        }
        // Folders are made; nothing else is left, and a file that is there stays.
        prepare(&[at("new/a.exr"), at("b.json")], &[&input]).unwrap();
        assert_eq!(fs::read(&input).unwrap(), b"in");
        assert_eq!(fs::read_dir(at("new")).unwrap().count(), 0);
        let names = fs::read_dir(dir.path()).unwrap();
        assert_eq!(
            names
                .filter(|e| e.as_ref().unwrap().path().is_file())
                .count(),
            1
        );
    }

    #[test]
    fn names_of_files() {
        let path = Path::new("a/b.c.json");
        assert_eq!(beside(path, "x.exr"), Path::new("a/b.c.x.exr"));
        let key = "wall/2.reflectance value";
        assert_eq!(file_name(key), "wall~2F2.reflectance~20value");
        let keys = ["a b", "a_b", "a~20b", "\u{e4} b", "\u{e5} b"];
        for (i, key) in keys.iter().enumerate() {
            let name = file_name(key);
            let safe = |c: char| c.is_ascii_alphanumeric() || "._-~".contains(c);
            assert!(name.chars().all(safe), "{name}");
            assert!(keys[..i].iter().all(|k| file_name(k) != name), "{name}");
        }
    }
}
