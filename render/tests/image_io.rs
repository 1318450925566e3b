//! Image files: what is written is read back, damaged files are errors, nothing is half-written.

use std::path::{Path, PathBuf};

use ex::WritableImage;
use exr::prelude as ex;
use render::image_io::{
    Encoding, MAX_SIDE, Pixels, linear_to_srgb, read, read_rgb, srgb_to_linear, write_atomically,
    write_exr, write_exr_pixels, write_png,
};
use render::{Image, SceneError};
use tempfile::TempDir;

fn ramp(width: usize, height: usize) -> Image {
    let data = (0..width * height * 3).map(|i| (i as f32 * 0.37).sin() * 0.5 + 0.5);
    Image {
        width,
        height,
        data: data.collect(),
    }
}

fn files(dir: &TempDir) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(dir.path()).unwrap();
    entries.map(|e| e.unwrap().path()).collect()
}

fn message(result: Result<Pixels, SceneError>) -> String {
    result.unwrap_err().to_string()
}

/// Size, channel names and samples.
type Layer<'a> = (usize, usize, Vec<(&'a str, ex::FlatSamples)>);

/// An EXR file with these layers.
fn exr_file(path: &Path, layers: Vec<Layer>) {
    let layers = layers.into_iter().enumerate().map(|(i, (w, h, channels))| {
        let list = channels
            .into_iter()
            .map(|(name, samples)| ex::AnyChannel::new(name, samples));
        ex::Layer::new(
            (w, h),
            ex::LayerAttributes::named(format!("layer{i}").as_str()),
            ex::Encoding::FAST_LOSSLESS,
            ex::AnyChannels::sort(list.collect()),
        )
    });
    let attributes = ex::ImageAttributes::new(ex::IntegerBounds::from_dimensions((9, 9)));
    ex::Image::from_layers(attributes, layers.collect::<Vec<_>>())
        .write()
        .to_file(path)
        .unwrap();
}

#[test]
fn exr_returns_every_bit() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    for (width, height) in [(1, 1), (7, 3), (65, 33)] {
        let mut image = ramp(width, height);
        image.data[0] = -1.5e-30;
        image.data[2] = f32::MAX;
        write_exr(&path, &image).unwrap();
        assert_eq!(read_rgb(&path).unwrap(), image);
        let grey = Pixels {
            width,
            height,
            channels: 1,
            data: image.data[..width * height].to_vec(),
        };
        write_exr_pixels(&path, &grey).unwrap();
        assert_eq!(read(&path, Encoding::Srgb).unwrap(), grey);
    }
    assert_eq!(files(&dir), [path]);
}

#[test]
fn exr_channels_are_found_by_name() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    let f16 = |x: f32| ex::FlatSamples::F16(vec![ex::f16::from_f32(x); 2]);
    let f32s = |x: f32| ex::FlatSamples::F32(vec![x; 2]);
    let u32s = |x: u32| ex::FlatSamples::U32(vec![x; 2]);
    let read = |p: &Path| read(p, Encoding::Srgb);

    let rgba = vec![
        ("A", f16(0.1)),
        ("B", f16(0.75)),
        ("G", f16(0.5)),
        ("R", f16(0.25)),
    ];
    exr_file(&path, vec![(2, 1, rgba)]);
    let p = read(&path).unwrap();
    assert_eq!((p.channels, &p.data[..3]), (3, &[0.25, 0.5, 0.75][..]));

    let mixed = vec![
        ("B", f32s(0.75)),
        ("G", u32s(7)),
        ("R", f16(0.25)),
        ("Z", f32s(9.0)),
    ];
    exr_file(&path, vec![(2, 1, mixed)]);
    assert_eq!(read(&path).unwrap().data[..3], [0.25, 7.0, 0.75]);

    let named = vec![
        ("n.X", f32s(3.0)),
        ("d.B", f32s(3.0)),
        ("d.G", f32s(2.0)),
        ("d.R", f32s(1.0)),
    ];
    exr_file(&path, vec![(2, 1, named)]);
    assert_eq!(read(&path).unwrap().data[..3], [1.0, 2.0, 3.0]);

    let depth = vec![("Z", f32s(3.0))];
    let colour = vec![("Y", f32s(2.0))];
    exr_file(&path, vec![(2, 1, depth.clone()), (1, 2, colour)]);
    let p = read(&path).unwrap();
    assert_eq!((p.width, p.height, p.data), (1, 2, vec![2.0, 2.0]));

    exr_file(&path, vec![(2, 1, depth)]);
    let found = message(read(&path));
    assert!(
        found.contains("a.exr: expected channels `R`, `G` and `B`, or `Y`, found `Z`"),
        "{found}"
    );
}

#[test]
fn eight_and_sixteen_bit_files_are_decoded() {
    let dir = TempDir::new().unwrap();
    for name in ["a.png", "a.bmp", "a.jpg"] {
        let path = dir.path().join(name);
        image::RgbImage::from_pixel(8, 8, image::Rgb([255, 128, 0]))
            .save(&path)
            .unwrap();
        let raw = read(&path, Encoding::Raw).unwrap();
        assert_eq!((raw.width, raw.height, raw.channels), (8, 8, 3));
        let tolerance = if name == "a.jpg" { 2.5 / 255.0 } else { 1e-7 };
        for (value, expected) in raw.data.iter().zip([1.0, 128.0 / 255.0, 0.0]) {
            assert!((value - expected).abs() <= tolerance, "{name} {value}");
        }
        let linear = read(&path, Encoding::Srgb).unwrap();
        for (l, r) in linear.data.iter().zip(&raw.data) {
            assert!((f64::from(*l) - srgb_to_linear(f64::from(*r))).abs() < 1e-7);
        }
    }
    let path = dir.path().join("grey16.png");
    let grey = image::ImageBuffer::<image::Luma<u16>, _>::from_pixel(3, 2, image::Luma([13107]));
    grey.save(&path).unwrap();
    let p = read(&path, Encoding::Raw).unwrap();
    assert_eq!((p.channels, p.data[0]), (1, 0.2));
    assert_eq!(p.into_rgb().data[..3], [0.2; 3]);
    let path = dir.path().join("alpha.png");
    let rgba = image::RgbaImage::from_pixel(2, 2, image::Rgba([51, 102, 153, 7]));
    rgba.save(&path).unwrap();
    let p = read(&path, Encoding::Raw).unwrap();
    assert_eq!((p.channels, &p.data[..3]), (3, &[0.2, 0.4, 0.6][..]));
    let grey = p.into_grey();
    let expected = 0.2 * 0.212_671 + 0.4 * 0.715_160 + 0.6 * 0.072_169;
    assert_eq!((grey.channels, grey.data.len()), (1, 4));
    assert!((grey.data[0] - expected).abs() < 1e-7);
}

#[test]
fn the_srgb_curve_is_the_standard_one() {
    assert!((srgb_to_linear(0.5) - 0.214_041_140_482_232).abs() < 1e-12);
    assert!((linear_to_srgb(0.18) - 0.461_356_129_500_442).abs() < 1e-12);
    for i in 0..=1000 {
        let x = f64::from(i) / 1000.0;
        assert!((linear_to_srgb(srgb_to_linear(x)) - x).abs() < 1e-6);
    }
}

#[test]
fn png_is_exposed_cut_and_encoded() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.png");
    let image = Image {
        width: 2,
        height: 1,
        data: vec![0.25, -1.0, 1e30, f32::NAN, 0.5, 0.001],
    };
    write_png(&path, &image, 1.0).unwrap();
    let bytes = image::open(&path).unwrap().into_rgb8().into_raw();
    let encoded = |x: f64| (255.0 * linear_to_srgb(x)).round() as u8;
    assert_eq!(bytes, [encoded(0.5), 0, 255, 0, 255, encoded(0.002)]);
}

#[test]
fn writing_is_all_or_nothing() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    let image = ramp(4, 4);
    write_exr(&path, &image).unwrap();
    // A folder in the way: neither that nor a temporary file is left changed.
    let folder = dir.path().join("folder.exr");
    std::fs::create_dir(&folder).unwrap();
    std::fs::write(folder.join("x"), "").unwrap();
    let error = write_exr(&folder, &image).unwrap_err().to_string();
    assert!(
        error.contains("folder.exr: cannot write the file"),
        "{error}"
    );
    let missing = dir.path().join("none").join("a.png");
    assert!(write_png(&missing, &image, 0.0).is_err());
    assert!(write_atomically(Path::new("/"), b"").is_err());
    // Wrong sizes are errors before anything is touched.
    let short = Image {
        data: vec![0.0; 5],
        ..image.clone()
    };
    assert!(write_exr(&path, &short).is_err() && write_png(&path, &short, 0.0).is_err());
    assert!(write_exr(&path, &Image::new(0, 4)).is_err());
    assert!(write_png(&path, &Image::new(MAX_SIDE + 1, 1), 0.0).is_err());
    assert_eq!(read_rgb(&path).unwrap(), image);
    let mut left = files(&dir);
    left.sort();
    assert_eq!(left, [path, folder]);
}

#[test]
fn unreadable_files_are_named() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.png");
    let read = |p: &Path| message(read(p, Encoding::Srgb));
    assert!(read(&path).contains("a.png: cannot read the file"));
    std::fs::write(&path, "").unwrap();
    assert!(read(&path).contains("found an empty file"));
    std::fs::write(&path, "hello").unwrap();
    let found = read(&path);
    assert!(
        found.contains("an OpenEXR, PNG, JPEG or BMP image"),
        "{found}"
    );
    assert!(read(dir.path()).contains("expected a regular file, found a directory"));
    if cfg!(unix) {
        let found = read(Path::new("/dev/zero"));
        assert!(
            found.contains("/dev/zero: expected a regular file, found a device"),
            "{found}"
        );
    }
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let path = dir.path().join("a.exr");
        let mut image = ramp(4, 3);
        image.data[(2 * 4 + 1) * 3 + 2] = bad;
        write_exr(&path, &image).unwrap();
        let found = read(&path);
        assert!(found.contains("column 1, row 2, channel 2"), "{found}");
    }
}

#[test]
fn absurd_sizes_are_refused_before_memory_is_taken() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    write_exr(&path, &ramp(4, 4)).unwrap();
    let good = std::fs::read(&path).unwrap();
    let at = |needle: &[u8]| {
        good.windows(needle.len())
            .position(|w| w == needle)
            .unwrap()
    };
    // Name, type `box2i`, its length, then min x, min y, max x, max y.
    let window = at(b"dataWindow\0box2i\0") + 17 + 4;
    for (x, y) in [(65_535i32, 65_535i32), (i32::MAX - 1, 3), (3, 1 << 20)] {
        let mut bytes = good.clone();
        bytes[window + 8..window + 12].copy_from_slice(&x.to_le_bytes());
        bytes[window + 12..window + 16].copy_from_slice(&y.to_le_bytes());
        std::fs::write(&path, bytes).unwrap();
        assert!(read(&path, Encoding::Raw).is_err());
    }
    // A PNG header that promises 2^31 - 1 columns; the decoder checks its checksum only later.
    let path = dir.path().join("a.png");
    write_png(&path, &ramp(4, 4), 0.0).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[16..20].copy_from_slice(&0x7fff_ffffu32.to_be_bytes());
    std::fs::write(&path, bytes).unwrap();
    assert!(read(&path, Encoding::Raw).is_err());
}

/// One small valid file of each kind, and the ending it is known by.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let dir = TempDir::new().unwrap();
    let image = ramp(9, 7);
    let bytes: Vec<u8> = image.data.iter().map(|x| (x * 255.0) as u8).collect();
    let eight = image::RgbImage::from_raw(9, 7, bytes).unwrap();
    ["exr", "half.exr", "png", "jpg", "bmp"]
        .into_iter()
        .map(|ending| {
            let path = dir.path().join(format!("a.{ending}"));
            match ending {
                "exr" => write_exr(&path, &image).unwrap(),
                "half.exr" => {
                    let plane = |c| {
                        (0..63usize)
                            .map(|i| ex::f16::from_f32(image.data[3 * i + c]))
                            .collect()
                    };
                    let channel = |c| ex::FlatSamples::F16(plane(c));
                    exr_file(
                        &path,
                        vec![(
                            9,
                            7,
                            vec![("B", channel(2)), ("G", channel(1)), ("R", channel(0))],
                        )],
                    );
                }
                _ => eight.save(&path).unwrap(),
            }
            (ending, std::fs::read(path).unwrap())
        })
        .collect()
}

#[test]
fn files_cut_off_anywhere_are_errors() {
    let dir = TempDir::new().unwrap();
    for (ending, bytes) in samples() {
        let path = dir.path().join(format!("cut.{ending}"));
        std::fs::write(&path, &bytes).unwrap();
        assert!(read(&path, Encoding::Srgb).is_ok(), "{ending}");
        // The last 16 bytes may be padding or an end mark that holds no pixels.
        for n in 0..bytes.len() - 16 {
            std::fs::write(&path, &bytes[..n]).unwrap();
            let found = read(&path, Encoding::Srgb);
            assert!(found.is_err(), "{ending} cut at {n} of {}", bytes.len());
        }
    }
}

/// A JPEG whose end mark was put back behind what is left of its data, or behind none.
#[test]
fn jpegs_without_their_data_are_errors() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.jpg");
    let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
    let image = image::RgbImage::from_fn(64, 48, |x, y| {
        image::Rgb([noise(x + 64 * y), noise(7 * x + y), noise(3 * y + x)])
    });
    image.save(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    assert!(read(&path, Encoding::Srgb).is_ok());
    let scan = whole.windows(2).rposition(|w| w == [0xff, 0xda]).unwrap();
    let header = 2 + usize::from(u16::from_be_bytes([whole[scan + 2], whole[scan + 3]]));
    let data = scan + header;
    // The last row of blocks is a sixth of the data.
    for kept in [
        0,
        1,
        10,
        100,
        (whole.len() - data) / 2,
        (whole.len() - data) * 3 / 4,
    ] {
        let cut = [&whole[..data + kept], &[0xff, 0xd9]].concat();
        std::fs::write(&path, &cut).unwrap();
        let result = read(&path, Encoding::Srgb);
        let Err(found) = result.map_err(|e| e.to_string()) else {
            panic!("{kept} bytes were enough")
        };
        assert!(
            found.contains("a.jpg: expected a complete Jpeg image"),
            "{kept}: {found}"
        );
    }
    std::fs::write(&path, [&whole[..scan], &[0xff, 0xd9]].concat()).unwrap();
    assert!(message(read(&path, Encoding::Srgb)).contains("a.jpg: expected a complete Jpeg image"));
}

/// Small files that promise large images are refused for what they promise.
#[test]
fn bombs_are_refused_before_they_are_decoded() {
    let dir = TempDir::new().unwrap();
    let side = 1 << 14;
    let png = dir.path().join("a.png");
    // 16384 x 16384 black pixels.
    image::GrayImage::new(side, side).save(&png).unwrap();
    let found = message(read(&png, Encoding::Raw));
    assert!(
        found.ends_with("a.png: expected at most 67108864 pixels, found 16384 x 16384"),
        "{found}"
    );
    let jpg = dir.path().join("a.jpg");
    image::RgbImage::new(64, 64).save(&jpg).unwrap();
    let small = std::fs::read(&jpg).unwrap();
    let frame = small.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    for (height, width, expected) in [
        (
            30_000_u16,
            30_000_u16,
            "expected at most 67108864 pixels, found 30000 x 30000",
        ),
        (8000, 8000, "the end cut off"),
    ] {
        let mut bytes = small.clone();
        bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
        bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
        std::fs::write(&jpg, bytes).unwrap();
        let found = message(read(&jpg, Encoding::Raw));
        assert!(found.contains(expected), "{found}");
    }
}
