//! Image files: reading textures and references, writing results.
//!
//! Files are recognised by their content, not their name. Reading never panics and never allocates
//! more than follows from the limits below, whatever the bytes: they are checked before anything is decoded. Writing is atomic: the file appears complete
//! under its name, or not at all.
//!
//! ```
//! use render::{Image, image_io};
//!
//! let folder = std::env::temp_dir().join(format!("image_io-{}", std::process::id()));
//! std::fs::create_dir_all(&folder)?;
//! let mut image = Image::new(4, 2);
//! image.data.fill(0.25);
//! image_io::write_exr(&folder.join("grey.exr"), &image)?; // every bit
//! image_io::write_png(&folder.join("grey.png"), &image, 1.0)?; // one stop brighter, for the eye
//! assert_eq!(image_io::read_rgb(&folder.join("grey.exr"))?, image);
//! # std::fs::remove_dir_all(&folder)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use exr::WritableImage;
use exr::prelude as exr;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::error::{SceneError, quoted};
use crate::files;
use crate::film::Image;

mod anymap;
mod floats;
mod layers;

pub use crate::files::{require_regular, target, try_to_write, write_atomically};

/// Largest number of rows and of columns.
pub const MAX_SIDE: usize = 1 << 16;
/// Largest number of pixels that an image read may have, such as 8192 x 8192 or 11 585 x 5792: as three numbers in
/// single precision each they take 800 megabytes.
pub const MAX_PIXELS: usize = 1 << 26;
/// Largest number of samples (pixels times channels) that an OpenEXR file may hold, in all of its layers.
pub const MAX_SAMPLES: usize = 1 << 28;
/// Largest size of a file in bytes.
const MAX_BYTES: u64 = 1 << 31;

/// Pixels as read from or written to a file.
///
/// ```
/// use render::Image;
/// use render::image_io::{Encoding, Pixels, read, write_exr_pixels};
///
/// let file = std::env::temp_dir().join(format!("pixels-{}.exr", std::process::id()));
/// let ramp = Pixels { width: 3, height: 1, channels: 1, data: vec![0.0, 0.5, 1.0] };
/// write_exr_pixels(&file, &ramp)?; // one channel, `Y`
/// let found = read(&file, Encoding::Raw)?; // of linear files the encoding says nothing
/// assert_eq!(found, ramp);
///
/// let image = Image::from(found); // grey three times, [1][3][3]
/// assert_eq!(image.pixel(1, 0), [0.5; 3]);
/// let green = Pixels { width: 1, height: 1, channels: 3, data: vec![0.0, 1.0, 0.0] };
/// assert!((green.into_grey().data[0] - 0.7152).abs() < 1e-3); // luminance
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Pixels {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// 1 (grey) or 3 (red, green, blue).
    pub channels: usize,
    /// `[height][width][channels]`, row 0 at the top; finite when read.
    pub data: Vec<f32>,
}

/// What the samples of 8- and 16-bit files mean. EXR, Radiance and PFM files are linear in any case.
///
/// ```
/// use render::image_io::{Encoding, read, write_png};
///
/// let file = std::env::temp_dir().join(format!("encoding-{}.png", std::process::id()));
/// let mut image = render::Image::new(1, 1);
/// image.data.fill(0.5);
/// write_png(&file, &image, 0.0)?; // eight bits on the curve of sRGB
/// let (colours, numbers) = (read(&file, Encoding::Srgb)?, read(&file, Encoding::Raw)?);
/// assert!((colours.data[0] - 0.5).abs() < 0.005); // linear again, but for rounding to 256 levels
/// assert!((numbers.data[0] - 188.0 / 255.0).abs() < 1e-6); // what the file holds
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Encoding {
    /// Colours on the sRGB curve; read as linear values.
    Srgb,
    /// Numbers in [0, 1] that are no colours: value over largest value.
    Raw,
    /// Values to this power.
    Gamma(f64),
}

impl Encoding {
    /// The value of a sample in [0, 1].
    fn decode(self, x: f64) -> f32 {
        match self {
            Self::Srgb => srgb_to_linear(x) as f32,
            Self::Raw => x as f32,
            Self::Gamma(gamma) => x.powf(gamma) as f32,
        }
    }
}

impl Pixels {
    /// One channel: the values themselves, or the luminance of colours.
    pub fn into_grey(self) -> Self {
        if self.channels == 1 {
            return self;
        }
        let luminance = |c: &[f32]| {
            crate::math::Rgb::new(f64::from(c[0]), f64::from(c[1]), f64::from(c[2])).luminance()
        };
        Self {
            channels: 1,
            data: (self.data.chunks_exact(3))
                .map(|c| luminance(c) as f32)
                .collect(),
            ..self
        }
    }

    /// Three channels: the values themselves, or grey three times.
    pub fn into_rgb(self) -> Self {
        if self.channels == 3 {
            return self;
        }
        Self {
            channels: 3,
            data: self.data.iter().flat_map(|&x| [x; 3]).collect(),
            ..self
        }
    }
}

impl From<Pixels> for Image {
    fn from(pixels: Pixels) -> Self {
        let pixels = pixels.into_rgb();
        Self {
            width: pixels.width,
            height: pixels.height,
            data: pixels.data,
        }
    }
}

/// Reads an EXR, Radiance (HDR), PFM, PNG, JPEG, BMP, TGA, PBM, PGM or PPM file. Alpha is dropped. Of an EXR file, the layer
/// that [`read_layer`] finds without a name.
///
/// # Errors
/// As [`read_layer`].
pub fn read(path: &Path, encoding: Encoding) -> Result<Pixels, SceneError> {
    read_layer(path, encoding, None)
}

/// [`read`], for a layer of an EXR file. Layers are the parts of the file, and within these the channels whose names agree
/// up to the last dot: `ViewLayer.Combined.R` belongs to `ViewLayer.Combined`, which the name `Combined` finds too
/// where it is the only one. Without a name it is the unnamed layer, or else the only one called `Combined`, `beauty`
/// or `RGBA`, or else the only one that is a picture: that has channels `R`, `G`, `B`, or `Y`. Channels `X`, `Y`, `Z`
/// without a layer's name are CIE XYZ, which becomes linear RGB. What else has `X`, `Z`, `RY` or `BY` beside its `Y` is none.
///
/// ```
/// use render::image_io::{Encoding, read_layer, split_layer, write_exr_planes};
///
/// let file = std::env::temp_dir().join(format!("layers-{}.exr", std::process::id()));
/// let planes = vec![("R", vec![0.1; 6]), ("G", vec![0.2; 6]), ("B", vec![0.3; 6]), ("depth.Y", vec![4.0; 6])];
/// write_exr_planes(&file, 3, 2, planes)?; // [2][3] under each name
/// let picture = read_layer(&file, Encoding::Raw, None)?; // the unnamed one
/// assert_eq!((picture.height, picture.width, picture.channels), (2, 3, 3));
/// assert_eq!(picture.data[..3], [0.1, 0.2, 0.3]);
/// let depth = read_layer(&file, Encoding::Raw, Some("depth"))?;
/// assert_eq!((depth.channels, depth.data), (1, vec![4.0; 6]));
///
/// // As tools name a layer on their command lines.
/// let named = format!("{}:depth", file.display());
/// assert_eq!(split_layer(named.as_ref()), (file.clone(), Some("depth".to_owned())));
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The file cannot be read or is no such image, is cut off or damaged, exceeds [`MAX_SIDE`], [`MAX_PIXELS`] or
/// [`MAX_SAMPLES`], or has a pixel that is not finite. It has several pictures or none, and then all layers are listed; a
/// layer is asked of a file that cannot have any.
pub fn read_layer(
    path: &Path,
    encoding: Encoding,
    layer: Option<&str>,
) -> Result<Pixels, SceneError> {
    let bytes = files::read(path, MAX_BYTES)?;
    // The decoders promise errors, not panics, but they are large and their input is anybody's. They run
    // on this thread only, so that a panic can be turned into the error it should have been.
    let decoded = catch_unwind(AssertUnwindSafe(|| {
        if bytes.starts_with(&EXR_MAGIC) && matches!(encoding, Encoding::Gamma(_)) {
            Err(has_no_gamma())
        } else if bytes.starts_with(&EXR_MAGIC) {
            layers::decode(&bytes, layer)
        } else if let Some(name) = layer {
            let expected = format!(
                "an OpenEXR image, which has layers such as {}",
                quoted(name)
            );
            Err(mismatch(expected, "a file of another format"))
        } else {
            decode(&bytes, encoding)
        }
    }));
    let pixels = match decoded {
        Ok(Ok(pixels)) => pixels,
        Ok(Err(Mismatch { expected, found })) => return Err(asset(path, expected, found)),
        Err(_) => {
            let found = "data that the decoder cannot handle";
            return Err(asset(path, "an undamaged image", found));
        }
    };
    if let Some(i) = pixels.data.iter().position(|x| !x.is_finite()) {
        let (pixel, channel) = (i / pixels.channels, i % pixels.channels);
        let (x, y) = (pixel % pixels.width, pixel / pixels.width);
        let found = format!(
            "{} at column {x}, row {y}, channel {channel}",
            pixels.data[i]
        );
        return Err(asset(path, "finite pixels", found));
    }
    Ok(pixels)
}

/// The file and the layer that `FILE.EXR:LAYER` names: what stands before the first `:` behind which there is a file. A name
/// that is one of a file itself has no layer.
pub fn split_layer(name: &Path) -> (PathBuf, Option<String>) {
    let whole = (name.to_owned(), None);
    let Some(text) = name.to_str().filter(|_| !name.exists()) else {
        return whole;
    };
    let mut parts = text
        .match_indices(':')
        .map(|(i, _)| (&text[..i], &text[i + 1..]));
    let found = parts.find(|(file, layer)| !layer.is_empty() && Path::new(file).is_file());
    found.map_or(whole, |(file, layer)| (file.into(), Some(layer.to_owned())))
}

/// [`read`] as a linear RGB image.
///
/// # Errors
/// As [`read`].
pub fn read_rgb(path: &Path) -> Result<Image, SceneError> {
    read(path, Encoding::Srgb).map(Image::from)
}

const EXR_MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];

struct Mismatch {
    expected: String,
    found: String,
}

fn mismatch(expected: impl Into<String>, found: impl ToString) -> Mismatch {
    Mismatch {
        expected: expected.into(),
        found: found.to_string(),
    }
}

fn asset(path: &Path, expected: impl Into<String>, found: impl Into<String>) -> SceneError {
    SceneError::Asset {
        path: path.to_owned(),
        line: None,
        expected: expected.into(),
        found: found.into(),
    }
}

fn check_size(width: usize, height: usize) -> Result<(), Mismatch> {
    let sides = 1..=MAX_SIDE;
    let expected = if !sides.contains(&width) || !sides.contains(&height) {
        format!("from 1 to {MAX_SIDE} rows and columns")
    } else if width * height > MAX_PIXELS {
        format!("at most {MAX_PIXELS} pixels")
    } else {
        return Ok(());
    };
    Err(mismatch(expected, format!("{width} x {height}")))
}

fn check_samples(samples: usize) -> Result<(), Mismatch> {
    if samples <= MAX_SAMPLES {
        return Ok(());
    }
    let expected = format!("at most {MAX_SAMPLES} samples in all layers");
    Err(mismatch(expected, samples))
}

fn has_no_gamma() -> Mismatch {
    mismatch(
        "an image of 8 or 16 bits, which has a gamma",
        "one of linear numbers",
    )
}

/// Whether the picture of a file, without the name of a layer, is read from channels `X`, `Y` and `Z`.
pub(crate) fn is_in_xyz(path: &Path) -> bool {
    files::read(path, MAX_BYTES).is_ok_and(|bytes| layers::is_in_xyz(&bytes))
}

/// Anything but OpenEXR.
fn decode(bytes: &[u8], encoding: Encoding) -> Result<Pixels, Mismatch> {
    let of_floats = floats::is_radiance(bytes) || floats::is_pfm(bytes);
    if of_floats && matches!(encoding, Encoding::Gamma(_)) {
        return Err(has_no_gamma());
    }
    if floats::is_radiance(bytes) {
        floats::decode_radiance(bytes)
    } else if floats::is_pfm(bytes) {
        floats::decode_pfm(bytes)
    } else if anymap::is_anymap(bytes) {
        anymap::decode(bytes, encoding)
    } else {
        decode_8_or_16_bit(bytes, encoding)
    }
}

/// Whether the first bytes are the header of a TGA file, which has no mark: every field that has few values has one of
/// them.
fn is_tga(bytes: &[u8]) -> bool {
    let Some(&[_, colour_map, kind, .., bits, descriptor]) = bytes.first_chunk::<18>() else {
        return false;
    };
    let mapped = matches!(kind, 1 | 9);
    let true_colour = matches!(kind, 2 | 3 | 10 | 11);
    (mapped && colour_map == 1 || true_colour && colour_map <= 1)
        && matches!(bits, 8 | 15 | 16 | 24 | 32)
        && descriptor & 0xc0 == 0
}

fn decode_8_or_16_bit(bytes: &[u8], encoding: Encoding) -> Result<Pixels, Mismatch> {
    let formats = "an OpenEXR, Radiance, PFM, PNG, JPEG, BMP, TGA, PBM, PGM or PPM image";
    let mut reader = image::ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| mismatch(formats, e))?;
    if reader.format().is_none() && is_tga(bytes) {
        reader.set_format(image::ImageFormat::Tga);
    }
    let Some(format) = reader.format() else {
        let start: Vec<_> = bytes.iter().take(4).map(|b| format!("{b:02x}")).collect();
        let found = if start.is_empty() {
            "an empty file".to_owned()
        } else {
            format!("a file that starts with bytes {}", start.join(" "))
        };
        return Err(mismatch(formats, found));
    };
    if !format.reading_enabled() {
        // Of Netpbm's, those of any number of channels are left.
        let name = match format {
            image::ImageFormat::Pnm => "PAM".into(),
            other => format!("{other:?}"),
        };
        return Err(mismatch(formats, format!("a {name} image")));
    }
    if format == image::ImageFormat::Jpeg {
        return decode_jpeg(bytes, encoding);
    }
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(16 * MAX_PIXELS as u64);
    reader.limits(limits);
    let damaged = |e| mismatch(format!("a complete {format:?} image"), e);
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = image::ImageDecoder::dimensions(&decoder);
    let (width, height) = (width as usize, height as usize);
    check_size(width, height)?;
    // A byte is at most a run of 128 pixels.
    if format == image::ImageFormat::Tga && (width * height).div_ceil(128) > bytes.len() {
        let found = format!("{} bytes for {width} x {height}", bytes.len());
        return Err(mismatch("a complete Tga image", found));
    }
    let image = image::DynamicImage::from_decoder(decoder).map_err(damaged)?;
    let channels = if image.color().has_color() { 3 } else { 1 };
    let bytes_per_channel = image.color().bytes_per_pixel() / image.color().channel_count();
    let data = match (bytes_per_channel, channels) {
        (1, 1) => bytes_to_values(&image.into_luma8(), encoding),
        (1, _) => bytes_to_values(&image.into_rgb8(), encoding),
        _ => {
            let values = match channels {
                1 => image.into_luma16().into_raw(),
                _ => image.into_rgb16().into_raw(),
            };
            let unit = |&v: &u16| encoding.decode(f64::from(v) / 65535.0);
            values.iter().map(unit).collect()
        }
    };
    Ok(Pixels {
        width,
        height,
        channels,
        data,
    })
}

fn bytes_to_values(bytes: &[u8], encoding: Encoding) -> Vec<f32> {
    let table: Vec<f32> = (0..256)
        .map(|i| encoding.decode(f64::from(i) / 255.0))
        .collect();
    bytes.iter().map(|&v| table[usize::from(v)]).collect()
}

/// By the decoder that `image` uses, but strictly: otherwise it fills in what is missing.
fn decode_jpeg(bytes: &[u8], encoding: Encoding) -> Result<Pixels, Mismatch> {
    const EXPECTED: &str = "a complete Jpeg image";
    let damaged = |e: zune_jpeg::errors::DecodeErrors| mismatch(EXPECTED, format!("{e:?}"));
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE)
        .set_max_height(MAX_SIDE);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(damaged)?;
    let missing = || mismatch(EXPECTED, "no size");
    let (width, height) = decoder.dimensions().ok_or_else(missing)?;
    check_size(width, height)?;
    let cut_off = || {
        let found = format!(
            "the end cut off: {} bytes for {width} x {height}",
            bytes.len()
        );
        mismatch(EXPECTED, found)
    };
    let scan = JpegScan::find(bytes).ok_or_else(cut_off)?;
    // There is a bit at least for each block of the finest component.
    if width.div_ceil(8) * height.div_ceil(8) > 8 * (scan.end - scan.data) {
        return Err(cut_off());
    }
    // Behind an end mark the decoder goes on with zeros, where it meets the end of the file it does not. It reads a few
    // bytes ahead. In progressive files the mark must stay.
    let padded = [&bytes[..scan.end], &[0; 16]].concat();
    let mut decoder = if scan.sequential {
        zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(&padded[..]), options)
    } else {
        decoder
    };
    decoder.decode_headers().map_err(damaged)?;
    let (space, channels) = match decoder.input_colorspace() {
        Some(ColorSpace::Luma) => (ColorSpace::Luma, 1),
        _ => (ColorSpace::RGB, 3),
    };
    decoder.set_options(options.jpeg_set_out_colorspace(space));
    let values = decoder.decode().map_err(damaged)?;
    if values.len() != width * height * channels {
        return Err(mismatch(EXPECTED, format!("{} values", values.len())));
    }
    Ok(Pixels {
        width,
        height,
        channels,
        data: bytes_to_values(&values, encoding),
    })
}

/// Where a JPEG file keeps its data.
struct JpegScan {
    /// Whether every coefficient is coded at once.
    sequential: bool,
    /// Where the first scan's data starts.
    data: usize,
    /// Where the mark of the end stands.
    end: usize,
}

impl JpegScan {
    /// `None` where there is no scan, or no end.
    fn find(bytes: &[u8]) -> Option<Self> {
        let (mut at, mut sequential) = (2, false);
        loop {
            let marker = match (bytes.get(at)?, bytes.get(at + 1)?) {
                (0xff, &marker @ 1..=0xfe) => marker,
                // Fill bytes.
                _ => {
                    at += 1;
                    continue;
                }
            };
            let length = match marker {
                // These stand alone.
                0x01 | 0xd0..=0xd8 => 0,
                _ => usize::from(u16::from_be_bytes([
                    *bytes.get(at + 2)?,
                    *bytes.get(at + 3)?,
                ])),
            };
            at += 2 + length;
            match marker {
                0xc0 | 0xc1 => sequential = true,
                // Inside a scan the byte ff is always followed by 00 or a restart marker, so that the end marker
                // cannot occur by chance.
                0xda => {
                    let rest = bytes.get(at..)?;
                    let end = rest.windows(2).rposition(|w| w == [0xff, 0xd9])?;
                    return Some(Self {
                        sequential,
                        data: at,
                        end: at + end,
                    });
                }
                _ => {}
            }
        }
    }
}

/// The linear value of an sRGB-encoded one (IEC 61966-2-1).
pub fn srgb_to_linear(x: f64) -> f64 {
    if x <= 0.04045 {
        x / 12.92
    } else {
        ((x + 0.055) / 1.055).powf(2.4)
    }
}

/// The sRGB-encoded value of a linear one (IEC 61966-2-1).
///
/// ```
/// use render::image_io::{linear_to_srgb, srgb_to_linear};
///
/// assert!((linear_to_srgb(0.2140) - 0.5).abs() < 1e-3);
/// assert!((srgb_to_linear(linear_to_srgb(0.7)) - 0.7).abs() < 1e-9);
/// ```
pub fn linear_to_srgb(x: f64) -> f64 {
    if x <= 0.003_130_8 {
        x * 12.92
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    }
}

/// Writes a linear RGB image as an OpenEXR file in f32, without loss.
///
/// # Errors
/// The file cannot be written; none is left behind then.
pub fn write_exr(path: &Path, image: &Image) -> Result<(), SceneError> {
    write_exr_with(path, image, None, &Labels::new())
}

/// Texts of the header of an OpenEXR file by name, in Latin-1. The name `comments` is that of the format for remarks; its other
/// attributes are no labels.
///
/// ```
/// use render::image_io::{Labels, read_labels, write_exr_with};
///
/// let file = std::env::temp_dir().join(format!("labels-{}.exr", std::process::id()));
/// let labels = Labels::from([("comments".into(), "noisy".into()), ("samples".into(), "4".into())]);
/// write_exr_with(&file, &render::Image::new(2, 1), None, &labels)?;
/// assert_eq!(read_labels(&file)?, labels);
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub type Labels = BTreeMap<String, String>;

/// The name of the format for remarks.
const COMMENTS: &str = "comments";

/// The labels of an OpenEXR file, of the first of its parts.
///
/// # Errors
/// The file cannot be read or is no OpenEXR file.
pub fn read_labels(path: &Path) -> Result<Labels, SceneError> {
    let bytes = files::read(path, MAX_BYTES)?;
    let found = catch_unwind(AssertUnwindSafe(|| layers::labels(&bytes)));
    let expected = "an undamaged OpenEXR image";
    match found {
        Ok(Ok(labels)) => Ok(labels),
        Ok(Err(Mismatch { expected, found })) => Err(asset(path, expected, found)),
        Err(_) => Err(asset(path, expected, "data that the decoder cannot handle")),
    }
}

/// [`write_exr`] with labels and, if there is `alpha`, a fourth channel `A`: how much of each pixel is covered, row by row. Colours
/// are as they are, those of what covers the pixel in part multiplied by that part.
///
/// ```
/// use render::image_io::{Labels, read_rgb, write_exr_with};
///
/// let file = std::env::temp_dir().join(format!("alpha-{}.exr", std::process::id()));
/// let mut image = render::Image::new(2, 1);
/// image.data[..3].fill(0.25); // half covered by a grey of 0.5
/// write_exr_with(&file, &image, Some(&[0.5, 0.0]), &Labels::new())?; // [height][width]
/// assert_eq!(read_rgb(&file)?, image); // alpha is dropped, and nothing is divided by it
/// assert!(write_exr_with(&file, &image, Some(&[0.5]), &Labels::new()).is_err());
/// # std::fs::remove_file(&file)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As there; another number of values than pixels; a label that is not in Latin-1.
pub fn write_exr_with(
    path: &Path,
    image: &Image,
    alpha: Option<&[f32]>,
    labels: &Labels,
) -> Result<(), SceneError> {
    let Image {
        width,
        height,
        ref data,
    } = *image;
    check_written(path, width, height, 3, data)?;
    let mut planes = colour_planes(&["R", "G", "B"], data);
    if let Some(alpha) = alpha {
        check_written(path, width, height, 1, alpha)?;
        planes.push(("A", alpha.to_vec()));
    }
    encode_planes(path, width, height, planes, labels)
}

/// Writes one (`Y`) or three (`R`, `G`, `B`) channels as an OpenEXR file in f32, without loss.
///
/// # Errors
/// Another number of channels, or the file cannot be written; none is left behind then.
pub fn write_exr_pixels(path: &Path, pixels: &Pixels) -> Result<(), SceneError> {
    let Pixels {
        width,
        height,
        channels,
        ref data,
    } = *pixels;
    check_written(path, width, height, channels, data)?;
    let names: &[&str] = match channels {
        1 => &["Y"],
        _ => &["R", "G", "B"],
    };
    let planes = colour_planes(names, data);
    encode_planes(path, width, height, planes, &Labels::new())
}

/// Channels that stand next to each other in every pixel, one after another.
fn colour_planes<'n>(names: &[&'n str], data: &[f32]) -> Vec<(&'n str, Vec<f32>)> {
    let plane = |c: usize| data.iter().skip(c).step_by(names.len()).copied().collect();
    (0..)
        .zip(names)
        .map(|(c, &name)| (name, plane(c)))
        .collect()
}

/// Writes numbers of any meaning, `[height][width]` under each name, as the channels of an OpenEXR file in f32.
///
/// # Errors
/// Another number of values, or the file cannot be written; none is left behind then.
pub fn write_exr_planes(
    path: &Path,
    width: usize,
    height: usize,
    planes: Vec<(&str, Vec<f32>)>,
) -> Result<(), SceneError> {
    for (_, plane) in &planes {
        check_written(path, width, height, 1, plane)?;
    }
    encode_planes(path, width, height, planes, &Labels::new())
}

fn encode_planes(
    path: &Path,
    width: usize,
    height: usize,
    planes: Vec<(&str, Vec<f32>)>,
    labels: &Labels,
) -> Result<(), SceneError> {
    let mut attributes = exr::LayerAttributes::default();
    for (name, text) in labels {
        let [key, value] = [name, text].map(exr::Text::new_or_none);
        let (Some(key), Some(value)) = (key, value) else {
            let found = format!("{} that is {}", quoted(name), quoted(text));
            return Err(asset(path, "labels in Latin-1", found));
        };
        if name == COMMENTS {
            attributes.comments = Some(value);
        } else {
            (attributes.other).insert(key, exr::AttributeValue::Text(value));
        }
    }
    let list = planes
        .into_iter()
        .map(|(name, plane)| exr::AnyChannel::new(name, exr::FlatSamples::F32(plane)));
    let layer = exr::Layer::new(
        (width, height),
        attributes,
        // Tiles in any order are in that in which threads have compressed them.
        exr::Encoding {
            line_order: exr::LineOrder::Increasing,
            ..exr::Encoding::SMALL_FAST_LOSSLESS
        },
        exr::AnyChannels::sort(list.collect()),
    );
    let mut bytes = Cursor::new(Vec::new());
    exr::Image::from_layer(layer)
        .write()
        .to_buffered(&mut bytes)
        .map_err(|e| unwritable(path, std::io::Error::other(e)))?;
    let mut bytes = bytes.into_inner();
    if sort_attributes(&mut bytes).is_none() {
        let found = std::io::Error::other("a header that does not end");
        return Err(unwritable(path, found));
    }
    write_atomically(path, &bytes)
}

/// Sorts the attributes in the header of an OpenEXR file of one part: the encoder writes labels in an order of chance, and what
/// is written is a function of the image. `None` if the header does not end.
fn sort_attributes(file: &mut [u8]) -> Option<()> {
    /// Where they begin: behind the format's number and version.
    const BEGIN: usize = 8;
    let after_text = |at: usize| Some(at + file.get(at..)?.iter().position(|&b| b == 0)? + 1);
    let mut attributes = Vec::new();
    let mut at = BEGIN;
    while *file.get(at)? != 0 {
        // A name, a type, the size of the value, and the value.
        let size = after_text(after_text(at)?)?;
        let value = size + 4;
        let bytes = file.get(size..value)?.try_into().ok()?;
        let end = value.checked_add(u32::from_le_bytes(bytes) as usize)?;
        attributes.push(file.get(at..end)?.to_vec());
        at = end;
    }
    attributes.sort();
    file[BEGIN..at].copy_from_slice(&attributes.concat());
    Some(())
}

/// Writes an 8-bit PNG for viewing: `2^stops` times the image, cut to [0, 1], on the sRGB curve.
/// Values that are not numbers come out black.
///
/// # Errors
/// The file cannot be written; none is left behind then.
pub fn write_png(path: &Path, image: &Image, stops: f64) -> Result<(), SceneError> {
    check_written(path, image.width, image.height, 3, &image.data)?;
    let gain = stops.exp2();
    let encode = |&x: &f32| (255.0 * linear_to_srgb((f64::from(x) * gain).clamp(0.0, 1.0))).round();
    let values: Vec<u8> = image.data.iter().map(|x| encode(x) as u8).collect();
    let mut bytes = Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut bytes,
        &values,
        image.width as u32,
        image.height as u32,
        image::ExtendedColorType::Rgb8,
        image::ImageFormat::Png,
    )
    .map_err(|e| unwritable(path, std::io::Error::other(e)))?;
    write_atomically(path, bytes.get_ref())
}

fn check_written(
    path: &Path,
    width: usize,
    height: usize,
    channels: usize,
    data: &[f32],
) -> Result<(), SceneError> {
    let sides = 1..=MAX_SIDE;
    let fits = sides.contains(&width) && sides.contains(&height) && matches!(channels, 1 | 3);
    if fits && width * height * channels == data.len() {
        return Ok(());
    }
    let n = data.len();
    Err(asset(
        path,
        format!("1 or 3 channels, from 1 to {MAX_SIDE} rows and columns, all of their values"),
        format!("{channels} channels, {width} x {height} pixels, {n} values"),
    ))
}

fn unwritable(path: &Path, source: std::io::Error) -> SceneError {
    SceneError::Write {
        path: path.to_owned(),
        source,
    }
}
