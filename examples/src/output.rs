//! Files that tools write and read. Every file appears complete or not at all.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use exr::prelude::{ReadChannels, ReadLayers};
use render::Image;
use serde::Serialize;

use crate::chart::{self, LineChart, Panel};
use crate::cli::ToolError;
use crate::figure;

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

/// Writes a file, all or nothing.
///
/// # Errors
/// The operating system's; the old content is still there then.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), ToolError> {
    figure::write_atomic(path, bytes)
        .map_err(|e| ToolError::file(path, format!("cannot write the file: {e}")))
}

/// Writes a value as indented JSON.
///
/// # Errors
/// The operating system's, or a value that JSON cannot hold.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), ToolError> {
    let mut text = serde_json::to_string_pretty(value).map_err(|e| ToolError::file(path, e))?;
    text.push('\n');
    write(path, text.as_bytes())
}

/// Writes a linear RGB image as OpenEXR, 32 bit.
///
/// # Errors
/// The operating system's.
pub fn write_exr(path: &Path, image: &Image) -> Result<(), ToolError> {
    use exr::prelude::*;
    let channels = SpecificChannels::rgb(|at: Vec2<usize>| {
        let [r, g, b] = image.pixel(at.x(), at.y());
        (r, g, b)
    });
    let mut bytes = Vec::new();
    exr::prelude::Image::from_channels((image.width, image.height), channels)
        .write()
        .to_buffered(Cursor::new(&mut bytes))
        .map_err(|e| ToolError::file(path, e))?;
    write(path, &bytes)
}

/// Writes a texture, `[height][width][channels]` with 1 or 3 channels, as OpenEXR; grey three times if
/// there is one.
///
/// # Errors
/// The operating system's.
pub fn write_texture(
    path: &Path,
    [height, width, channels]: [usize; 3],
    values: &[f64],
) -> Result<(), ToolError> {
    let texel = |p: &[f64]| std::array::from_fn::<f32, 3, _>(|c| p[c.min(p.len() - 1)] as f32);
    let data = values
        .chunks_exact(channels.max(1))
        .flat_map(texel)
        .collect();
    let image = Image {
        width,
        height,
        data,
    };
    write_exr(path, &image)
}

/// Reads an OpenEXR image with channels R, G and B.
///
/// # Errors
/// A file that cannot be read or has other channels.
pub fn read_exr(path: &Path) -> Result<Image, ToolError> {
    let bytes = std::fs::read(path)
        .map_err(|e| ToolError::file(path, format!("cannot read the file: {e}")))?;
    let read = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| Image::new(size.width(), size.height()),
            |image: &mut Image, at, (r, g, b): (f32, f32, f32)| {
                let i = (at.y() * image.width + at.x()) * 3;
                image.data[i..i + 3].copy_from_slice(&[r, g, b]);
            },
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| {
            ToolError::file(path, format!("expected an OpenEXR image with R, G, B: {e}"))
        })?;
    Ok(read.layer_data.channel_data.pixels)
}

/// Writes a linear image as an 8-bit PNG: see [`tone_map`].
///
/// # Errors
/// The operating system's.
pub fn write_png(path: &Path, image: &Image) -> Result<(), ToolError> {
    let data: Vec<u8> = image.data.iter().map(|&x| tone_map(x)).collect();
    let mut bytes = Vec::new();
    image::write_buffer_with_format(
        &mut Cursor::new(&mut bytes),
        &data,
        image.width as u32,
        image.height as u32,
        image::ExtendedColorType::Rgb8,
        image::ImageFormat::Png,
    )
    .map_err(|e| ToolError::file(path, e))?;
    write(path, &bytes)
}

/// Writes labelled pictures in a row.
///
/// # Errors
/// The operating system's.
pub fn write_panels(path: &Path, panels: &[Panel]) -> Result<(), ToolError> {
    let png = chart::grid(panels.len(), panels).map_err(|e| ToolError::file(path, e))?;
    write(path, &png)
}

/// Writes a chart as SVG and PNG; `path` has no extension.
///
/// # Errors
/// The operating system's.
pub fn write_chart(path: &Path, chart: &LineChart) -> Result<(), ToolError> {
    let drawn = |e| ToolError::file(path, e);
    write(
        &path.with_extension("svg"),
        chart.svg().map_err(drawn)?.as_bytes(),
    )?;
    write(&path.with_extension("png"), &chart.png().map_err(drawn)?)
}

/// Small images are enlarged to at least this width, so that their labels fit.
const PANEL_WIDTH: usize = 320;

/// A labelled image.
pub fn panel(label: &str, image: &Image) -> Panel {
    let factor = PANEL_WIDTH.div_ceil(image.width.max(1));
    Panel::tonemapped(label, image, 1.0).enlarged(factor)
}

/// Mean over the channels of every pixel in false colours, white at zero.
pub fn signed_panel(label: &str, image: &Image) -> Panel {
    let mean = |p: &[f32]| p.iter().map(|&x| f64::from(x)).sum::<f64>() / 3.0;
    let values: Vec<f64> = image.data.chunks_exact(3).map(mean).collect();
    let factor = PANEL_WIDTH.div_ceil(image.width.max(1));
    Panel::signed(label, image.width, &values, None).enlarged(factor)
}

/// [`read_exr`] of an image that must be finite and of this size, `[width, height]`.
///
/// # Errors
/// Those of [`read_exr`]; another size; a pixel that is not finite.
pub fn read_exr_of_size(path: &Path, [width, height]: [usize; 2]) -> Result<Image, ToolError> {
    let image = read_exr(path)?;
    if (image.width, image.height) != (width, height) {
        return Err(ToolError::file(
            path,
            format!(
                "expected the scene's size of {width} x {height} pixels, found {} x {}",
                image.width, image.height
            ),
        ));
    }
    match image.data.iter().position(|x| !x.is_finite()) {
        None => Ok(image),
        Some(i) => Err(ToolError::file(
            path,
            format!(
                "expected finite pixels, found {} at ({}, {})",
                image.data[i],
                i / 3 % width,
                i / 3 / width
            ),
        )),
    }
}

/// A linear value as 8-bit sRGB. Up to 0.7 it is shown as it is; brighter values approach white smoothly
/// instead of being cut.
pub fn tone_map(x: f32) -> u8 {
    const KNEE: f32 = 0.7;
    let x = if x > KNEE {
        1.0 - (1.0 - KNEE) * ((KNEE - x) / (1.0 - KNEE)).exp()
    } else {
        x.max(0.0)
    };
    let srgb = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    (srgb * 255.0 + 0.5) as u8
}

/// `stem.suffix` beside `path`, whose own extension is dropped.
pub fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(".");
    name.push(suffix);
    path.with_file_name(name)
}

/// A parameter's key as part of a file name.
pub fn file_name(key: &str) -> String {
    let keep = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    key.chars().map(|c| if keep(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_come_back_bit_for_bit_and_leave_nothing_else_behind() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let mut image = Image::new(5, 3);
        for (i, x) in image.data.iter_mut().enumerate() {
            *x = (i as f32 - 7.0) * 1.1e-3;
        }
        write_exr(&path, &image).unwrap();
        assert_eq!(read_exr(&path).unwrap(), image);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_is_no_image_is_an_error_that_names_it() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("b.exr");
        assert!(read_exr(&path).unwrap_err().to_string().contains("b.exr"));
        for bytes in [&b""[..], b"no image", &[0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0]] {
            write(&path, bytes).unwrap();
            assert!(read_exr(&path).unwrap_err().to_string().contains("b.exr"));
        }
    }

    #[test]
    fn tones_rise_from_black_to_white() {
        assert_eq!(
            (tone_map(f32::NAN), tone_map(-1.0), tone_map(0.0)),
            (0, 0, 0)
        );
        assert_eq!(tone_map(f32::INFINITY), 255);
        assert_eq!(tone_map(0.5), 188); // sRGB of 0.5
        let tones: Vec<u8> = (0..200).map(|i| tone_map(i as f32 * 0.01)).collect();
        assert!(tones.is_sorted());
    }
}
