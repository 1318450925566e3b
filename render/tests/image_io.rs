//! Image files: what is written is read back, damaged files are errors, nothing is half-written.

use std::path::{Path, PathBuf};

use ex::WritableImage;
use exr::prelude as ex;
use image::DynamicImage;
use render::image_io::{
    Encoding, Labels, MAX_SIDE, Pixels, linear_to_srgb, read, read_labels, read_layer, read_rgb,
    split_layer, srgb_to_linear, write_atomically, write_exr, write_exr_pixels, write_exr_planes,
    write_exr_with, write_png,
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
fn exr_returns_its_labels() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    let image = ramp(5, 3);
    let labels = |pairs: &[[&str; 2]]| -> Labels {
        let pairs = pairs.iter().map(|pair| pair.map(str::to_owned));
        pairs.map(|[name, text]| (name, text)).collect()
    };
    let two = labels(&[["comments", "biased: a b\u{fc}dget"], ["walks.n", "12"]]);
    for alpha in [None, Some(&[0.5; 15][..])] {
        write_exr_with(&path, &image, alpha, &two).unwrap();
        assert_eq!(read_labels(&path).unwrap(), two);
        assert_eq!(read_rgb(&path).unwrap(), image);
    }
    // What cannot be kept is refused, and the file stays.
    for bad in [["a", "\u{3b1}"], ["\u{3b1}", "a"], ["", "a"]] {
        assert!(write_exr_with(&path, &image, None, &labels(&[bad])).is_err());
        assert_eq!(read_labels(&path).unwrap(), two);
    }
    write_exr(&path, &image).unwrap();
    assert_eq!(read_labels(&path).unwrap(), Labels::new());
    let png = dir.path().join("a.png");
    write_png(&png, &image, 0.0).unwrap();
    assert!(read_labels(&png).is_err());
}

/// Files with the same image and labels are the same, byte by byte.
#[test]
fn exr_files_are_a_function_of_what_is_in_them() {
    let dir = tempfile::tempdir().unwrap();
    // Several tiles, which threads compress.
    let image = ramp(700, 500);
    let names = ["a.one", "b.two", "comments", "d.four", "e.five", "f.six"];
    let labels: Labels = names.map(|n| (n.to_owned(), n.repeat(2))).into();
    let written = |i: i32| {
        let path = dir.path().join(format!("{i}.exr"));
        write_exr_with(&path, &image, None, &labels).unwrap();
        assert_eq!(read_labels(&path).unwrap(), labels);
        assert_eq!(read_rgb(&path).unwrap(), image);
        std::fs::read(&path).unwrap()
    };
    let first = written(0);
    assert!((1..16).all(|i| written(i) == first));
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
        found.contains(
            "a.exr: expected a layer with channels `R`, `G` and `B`, or `Y` alone, found the layers an unnamed one (Z)"
        ),
        "{found}"
    );
}

/// A file with these layers, named as Blender does in one part or, if they have names, in one part each.
fn layered(path: &Path, parts: &[(Option<&str>, &[&str])]) {
    let layers: Vec<_> = (parts.iter())
        .map(|(name, channels)| {
            let list = channels.iter().map(|c| {
                // Told apart by what they hold: the number of bytes in their name.
                let samples = ex::FlatSamples::F32(vec![c.len() as f32; 2]);
                ex::AnyChannel::new(*c, samples)
            });
            let attributes = match name {
                Some(name) => ex::LayerAttributes::named(*name),
                None => ex::LayerAttributes::default(),
            };
            let list = ex::AnyChannels::sort(list.collect());
            ex::Layer::new((2, 1), attributes, ex::Encoding::FAST_LOSSLESS, list)
        })
        .collect();
    let attributes = ex::ImageAttributes::new(ex::IntegerBounds::from_dimensions((2, 1)));
    ex::Image::from_layers(attributes, layers)
        .write()
        .to_file(path)
        .unwrap();
}

#[test]
fn the_picture_of_an_exr_file_is_found_or_asked_for() {
    const AO: &[&str] = &["V.AO.R", "V.AO.G", "V.AO.B"];
    const COMBINED: &[&str] = &[
        "V.Combined.R",
        "V.Combined.G",
        "V.Combined.B",
        "V.Combined.A",
    ];
    const RGB: &[&str] = &["R", "G", "B"];
    const NORMAL: &[&str] = &["N.X", "N.Y", "N.Z"];
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.exr");
    let one = |channels: &[&[&'static str]]| {
        layered(&path, &[(None, &channels.concat())]);
        read(&path, Encoding::Srgb).map(|p| (p.channels, p.data[0]))
    };
    // In which order ever.
    assert_eq!(one(&[AO, COMBINED]).unwrap(), (3, 12.0));
    assert_eq!(one(&[COMBINED, RGB, AO]).unwrap(), (3, 1.0));
    assert_eq!(one(&[NORMAL, AO]).unwrap(), (3, 6.0));
    assert_eq!(
        one(&[&["beauty.R", "beauty.G", "beauty.B"], AO]).unwrap(),
        (3, 8.0)
    );
    assert_eq!(one(&[&["Y"], NORMAL]).unwrap(), (1, 1.0));
    // CIE XYZ of a file without layers' names; coordinates have a name.
    for channels in [&["X", "Y", "Z"][..], &["A", "X", "Y", "Z"]] {
        layered(&path, &[(None, channels)]);
        let white = read(&path, Encoding::Srgb).unwrap();
        assert_eq!(white.channels, 3);
        // Of equal energy (IEC 61966-2-1).
        for (found, expected) in white.data.iter().zip([1.2048, 0.9483, 0.9089]) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
    let refused = |channels: &[&[&'static str]]| one(channels).unwrap_err().to_string();
    let two = refused(&[AO, &["V.Mist.R", "V.Mist.G", "V.Mist.B"]]);
    let expected = "a.exr: expected the name of a layer, since there are several (`layer` in a scene file, FILE.EXR:LAYER on a command line), \
        found the layers `V.AO` (B, G, R), `V.Mist` (B, G, R)";
    assert!(two.ends_with(expected), "{two}");
    for (channels, listed) in [
        (NORMAL, "`N` (X, Y, Z)"),
        (&["X", "Y"], "an unnamed one (X, Y)"),
        (&["Y", "RY", "BY"], "an unnamed one (BY, RY, Y)"),
        (&["P.Y", "P.Z"], "`P` (Y, Z)"),
    ] {
        let found = refused(&[channels]);
        let expected = format!(
            "a.exr: expected a layer with channels `R`, `G` and `B`, or `Y` alone, found the layers {listed}"
        );
        assert!(found.ends_with(&expected), "{found}");
    }
    // A name chooses, in full or by its end.
    layered(&path, &[(None, &[AO, COMBINED, NORMAL].concat())]);
    let named = |name: &str| read_layer(&path, Encoding::Srgb, Some(name)).map(|p| p.data[0]);
    assert_eq!(named("V.AO").unwrap(), 6.0);
    assert_eq!(named("AO").unwrap(), 6.0);
    for name in ["N", "V", ""] {
        let found = named(name).unwrap_err().to_string();
        let expected = format!(
            "expected one layer `{name}` with channels `R`, `G` and `B`, or `Y`, found the layers"
        );
        assert!(
            found.contains(&expected) && found.contains("`N` (X, Y, Z)"),
            "{found}"
        );
    }
    // Parts are layers too, and one whose channels repeat its name is called so once.
    let of_part = ["d.R", "d.G", "d.B"];
    layered(
        &path,
        &[
            (Some("d"), &of_part),
            (Some("rgba"), RGB),
            (Some("n"), NORMAL),
        ],
    );
    let named = |name: &str| read_layer(&path, Encoding::Srgb, Some(name)).map(|p| p.data[0]);
    assert_eq!(read(&path, Encoding::Srgb).unwrap().data[0], 1.0);
    assert_eq!((named("d").unwrap(), named("rgba").unwrap()), (3.0, 1.0));
    assert!(
        named("n")
            .unwrap_err()
            .to_string()
            .contains("`n.N` (X, Y, Z)")
    );
    let png = dir.path().join("a.png");
    write_png(&png, &ramp(2, 2), 0.0).unwrap();
    let found = message(read_layer(&png, Encoding::Srgb, Some("AO")));
    assert!(found.ends_with("a.png: expected an OpenEXR image, which has layers such as `AO`, found a file of another format"), "{found}");
}

#[test]
fn eight_and_sixteen_bit_files_are_decoded() {
    let dir = TempDir::new().unwrap();
    for name in ["a.png", "a.bmp", "a.jpg", "a.tga"] {
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
        found.contains("an OpenEXR, Radiance, PFM, PNG, JPEG, BMP, TGA, PBM, PGM or PPM image"),
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

fn float_image(image: &Image) -> image::Rgb32FImage {
    let (width, height) = (image.width as u32, image.height as u32);
    image::Rgb32FImage::from_raw(width, height, image.data.clone()).unwrap()
}

/// A portable float map of the first of three channels, or of all; in little endian if `scale` is negative.
fn pfm(image: &Image, channels: usize, scale: f32) -> Vec<u8> {
    let kind = if channels == 3 { "PF" } else { "Pf" };
    let mut bytes = format!("{kind}\n{} {}\n{scale}\n", image.width, image.height).into_bytes();
    for row in image.data.chunks_exact(3 * image.width).rev() {
        for pixel in row.chunks_exact(3) {
            for &x in &pixel[..channels] {
                let little = scale < 0.0;
                bytes.extend(if little {
                    x.to_le_bytes()
                } else {
                    x.to_be_bytes()
                });
            }
        }
    }
    bytes
}

/// Nine bits or more of each number, whatever its size, by either name of the format and either way of packing.
#[test]
fn radiance_files_are_read() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.hdr");
    let mut image = ramp(40, 3);
    image.data[..6].copy_from_slice(&[1e4, 2e3, 0.0, 1e-6, 1e-6, 0.0]);
    DynamicImage::from(float_image(&image)).save(&path).unwrap();
    let read = || read(&path, Encoding::Srgb);
    let close = |found: &Pixels| {
        assert_eq!((found.width, found.height, found.channels), (40, 3, 3));
        for (a, b) in found.data.chunks_exact(3).zip(image.data.chunks_exact(3)) {
            let largest = b.iter().fold(0.0f32, |m, x| m.max(*x));
            assert!(
                (0..3).all(|c| (a[c] - b[c]).abs() <= largest / 120.0),
                "{a:?} {b:?}"
            );
        }
    };
    close(&read().unwrap());
    let bytes = std::fs::read(&path).unwrap();
    assert!(bytes.starts_with(b"#?RADIANCE\n"));
    std::fs::write(&path, [b"#?RGBE\n", &bytes[11..]].concat()).unwrap();
    close(&read().unwrap());
    // Without runs: 128 x 2^(129 - 136) = 1.
    let flat = |head: &str| [head.as_bytes(), &[128, 64, 0, 129].repeat(2)].concat();
    std::fs::write(&path, flat("#?RGBE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 1\n")).unwrap();
    assert_eq!(read().unwrap().data, [1.0, 0.5, 0.0, 1.0, 0.5, 0.0]);
    for (head, found) in [
        ("#?RGBE\nFORMAT=32-bit_rle_xyze\n\n-Y 2 +X 1\n", "xyze"),
        ("#?RGBE\n\n+X 2 -Y 1\n", "+X -Y"),
        ("#?RGBE\n\n-Y 70000 +X 1\n", "1 x 70000"),
        ("#?RGBE\n\n-Y 60000 +X 1000\n", "bytes for 1000 x 60000"),
        ("#?RGBE\n-Y 2 +X 1\n", "none"),
    ] {
        std::fs::write(&path, flat(head)).unwrap();
        let error = message(read());
        assert!(
            error.contains("a.hdr: expected ") && error.contains(found),
            "{error}"
        );
    }
}

#[test]
fn float_maps_are_read_bit_by_bit() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.pfm");
    let mut image = ramp(5, 3);
    image.data[0] = -1.5e-30;
    let read = || read(&path, Encoding::Srgb);
    for scale in [-1.0, 1.0, 2.0] {
        std::fs::write(&path, pfm(&image, 3, scale)).unwrap();
        let found = read().unwrap();
        assert_eq!((found.width, found.height, found.channels), (5, 3, 3));
        let scaled: Vec<_> = image.data.iter().map(|x| x * scale.abs()).collect();
        assert_eq!(found.data, scaled);
        std::fs::write(&path, pfm(&image, 1, scale)).unwrap();
        let found = read().unwrap();
        let first: Vec<_> = scaled.chunks_exact(3).map(|p| p[0]).collect();
        assert_eq!((found.channels, found.data), (1, first));
    }
    for (text, found) in [
        ("PF\n", "no width"),
        ("PF\n5 x 1\n", "the height `x`"),
        ("PF\n5 -3 1\n", "the height `-3`"),
        ("PF\n0 3 1\n", "0 x 3"),
        ("PF\n5 3 0\n", "the scale `0`"),
        ("PF\n5 3 nan\n", "the scale `nan`"),
        ("PF\n5 3 1", "no scale"),
        ("PF\n5 3 1\nabcd", "1 numbers for 5 x 3 x 3"),
        ("PF\n60000 60000 1\n", "60000 x 60000"),
    ] {
        std::fs::write(&path, text).unwrap();
        let error = message(read());
        assert!(
            error.contains("a.pfm: expected ") && error.contains(found),
            "{error}"
        );
    }
}

/// Rows from the bottom or the top, with runs or without, grey or in colours.
#[test]
fn tga_files_are_read_by_their_content() {
    let dir = TempDir::new().unwrap();
    // Under any name.
    let path = dir.path().join("a.png");
    let header = |kind: u8, bits: u8, descriptor: u8| {
        let mut header = vec![0, 0, kind, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0];
        header.extend([bits, descriptor]);
        header
    };
    let read = |bytes: Vec<u8>| {
        std::fs::write(&path, bytes).unwrap();
        read(&path, Encoding::Raw)
    };
    let rows = |kind, descriptor| {
        let mut bytes = header(kind, 24, descriptor);
        // Blue, green, red.
        for pixel in [[0, 0, 255], [0, 51, 0], [51, 0, 0], [0, 0, 0]] {
            if kind == 10 {
                bytes.push(0);
            }
            bytes.extend(pixel);
        }
        bytes
    };
    let top = [1.0, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0];
    for kind in [2, 10] {
        let found = read(rows(kind, 0x20)).unwrap();
        assert_eq!((found.channels, found.data), (3, top.to_vec()));
        let found = read(rows(kind, 0)).unwrap();
        assert_eq!(found.data, [&top[6..], &top[..6]].concat());
    }
    let mut grey = header(3, 8, 0x20);
    grey.extend([0, 51, 102, 255]);
    let found = read(grey).unwrap();
    assert_eq!((found.channels, found.data), (1, vec![0.0, 0.2, 0.4, 1.0]));
    let mut large = rows(10, 0);
    large[12..16].copy_from_slice(&[0xff; 4]);
    let error = message(read(large));
    assert!(error.contains("found 65535 x 65535"), "{error}");
}

/// Bits, grey and colours, in text and binary; values are parts of the largest, exactly.
#[test]
fn netpbm_images_are_read() {
    let dir = TempDir::new().unwrap();
    // Under any name.
    let path = dir.path().join("a.png");
    let read = |head: &str, raster: &[u8], encoding| {
        std::fs::write(&path, [head.as_bytes(), raster].concat()).unwrap();
        read(&path, encoding)
    };
    let colours = [1.0, 0.5, 0.0, 0.25, 0.75, 1.0];
    let in_hundreds = [100, 50, 0, 25, 75, 100];
    let in_thousands = [1000u16, 500, 0, 250, 750, 1000].map(u16::to_be_bytes);
    for (head, raster) in [
        ("P3 2 1 100 100 50 0 25 75 100", &[][..]),
        (
            "P3#c\n2 # of 9\n1\n100\n100 50\t0\r\n25 75 # 1\n0100\n",
            &[],
        ),
        ("P6\n# c\n2 1\n100\n", &in_hundreds),
        ("P6 2 1 100# c\n", &in_hundreds),
        ("P6\n2 1\n1000\n", in_thousands.as_flattened()),
    ] {
        let found = read(head, raster, Encoding::Raw).unwrap();
        assert_eq!((found.width, found.height, found.channels), (2, 1, 3));
        assert_eq!(found.data, colours, "{head}");
    }
    for (head, raster) in [
        ("P2 1 2 255 0 51", &[][..]),
        ("P5 1 2 255\n", &[0, 51]),
        // The first of several.
        ("P5 1 2 255\n", &[0, 51, b'P', b'5']),
    ] {
        let found = read(head, raster, Encoding::Raw).unwrap();
        assert_eq!((found.width, found.height, found.channels), (1, 2, 1));
        assert_eq!(found.data, [0.0, 0.2], "{head}");
    }
    for (head, raster) in [
        ("P1 9 2 100000001 0111\n 1 1 1 1 0", &[][..]),
        ("P4 9 2\n", &[0x80, 0x80, 0x7f, 0x00]),
    ] {
        let found = read(head, raster, Encoding::Srgb).unwrap();
        let mut bits = [1.0; 18];
        bits[0] = 0.0;
        bits[8..17].fill(0.0);
        bits[9] = 1.0;
        assert_eq!(found.data, bits, "{head}");
    }
    let curve = read("P2 1 1 2 1", &[], Encoding::Srgb).unwrap().data[0];
    assert!((curve - 0.21404).abs() < 1e-5, "{curve}");
    for (head, raster, found) in [
        ("P5", &[][..], "no width"),
        ("P5 1 x 255\n", &[0], "the height `x`"),
        ("P5 1 -1 255\n", &[0], "the height `-1`"),
        ("P5 1 1 0\n", &[0], "largest value, found 0"),
        ("P5 1 1 65536\n", &[0, 0], "largest value, found 65536"),
        (
            "P5 1 1 100\n",
            &[101],
            "values up to 100, found 101 at column 0, row 0, channel 0",
        ),
        (
            "P6 1 1 300\n",
            &[0, 0, 0, 0, 1, 45],
            "found 301 at column 0, row 0, channel 2",
        ),
        (
            "P3 1 1 9 1 2 10",
            &[],
            "found 10 at column 0, row 0, channel 2",
        ),
        ("P3 1 1 255 1", &[], "2 bytes for 1 x 1"),
        ("P3 1 1 255 1  2     ", &[], "no value"),
        ("P3 1 1 255 1 2 z", &[], "the value `z`"),
        ("P1 3 1 012", &[], "the bit `2`"),
        ("P6 1 1 255\n", &[1, 2], "2 bytes for 1 x 1"),
        ("P4 8000 8000\n", &[0], "1 bytes for 8000 x 8000"),
        ("P5 65536 65536 255\n", &[0], "65536 x 65536"),
        ("P5 1234567890 1 255\n", &[0], "the width `1234567890`"),
        (
            "P7\nWIDTH 1\nHEIGHT 1\nDEPTH 1\nMAXVAL 1\nENDHDR\n",
            &[1],
            "a PAM image",
        ),
        ("GIF89a", &[0; 32], "a Gif image"),
    ] {
        let error = message(read(head, raster, Encoding::Raw));
        assert!(
            error.contains("a.png: expected ") && error.contains(found),
            "{head}: {error}"
        );
    }
}

/// One small valid file of each kind, and the ending it is known by.
fn samples() -> Vec<(&'static str, Vec<u8>)> {
    let dir = TempDir::new().unwrap();
    let image = ramp(9, 7);
    let bytes: Vec<u8> = image.data.iter().map(|x| (x * 255.0) as u8).collect();
    let eight = image::RgbImage::from_raw(9, 7, bytes).unwrap();
    [
        "exr", "half.exr", "png", "jpg", "bmp", "tga", "hdr", "pfm", "ppm",
    ]
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
            "hdr" => DynamicImage::from(float_image(&image)).save(&path).unwrap(),
            "pfm" => std::fs::write(&path, pfm(&image, 3, -1.0)).unwrap(),
            "ppm" => {
                std::fs::write(&path, [b"P6 9 7 255\n", &eight.as_raw()[..]].concat()).unwrap()
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

/// A name with a colon is a file with a layer where only what stands before the colon is a file.
#[test]
fn names_of_files_may_have_a_layer() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    std::fs::write(at("a.exr"), "").unwrap();
    let layer = |name: &str| {
        let (file, layer) = split_layer(&at(name));
        (
            file.file_name().unwrap().to_str().unwrap().to_owned(),
            layer,
        )
    };
    assert_eq!(layer("a.exr"), ("a.exr".into(), None));
    assert_eq!(
        layer("a.exr:View.AO"),
        ("a.exr".into(), Some("View.AO".into()))
    );
    assert_eq!(
        layer("a.exr:one:two"),
        ("a.exr".into(), Some("one:two".into()))
    );
    for name in ["b.exr:AO", "a.exr:"] {
        assert_eq!(layer(name), (name.to_owned(), None));
    }
    #[cfg(unix)]
    {
        std::fs::write(at("a.exr:AO"), "").unwrap();
        assert_eq!(layer("a.exr:AO"), ("a.exr:AO".into(), None));
    }
}

/// Texels that are none in red, green and blue, from a file in CIE XYZ: the message says where they come from.
#[test]
fn colours_beyond_rgb_name_the_conversion() {
    let dir = tempfile::tempdir().unwrap();
    // Light of about 500 nm: red is negative.
    let planes = [("X", 0.005), ("Y", 0.32), ("Z", 0.27)].map(|(name, x)| (name, vec![x; 4]));
    write_exr_planes(&dir.path().join("xyz.exr"), 2, 2, planes.to_vec()).unwrap();
    let red = [("R", -0.5), ("G", 0.5), ("B", 0.3)].map(|(name, x)| (name, vec![x; 4]));
    write_exr_planes(&dir.path().join("rgb.exr"), 2, 2, red.to_vec()).unwrap();
    let error = |image: &str| {
        let text = format!(
            "<scene version=\"3.0.0\"><sensor type=\"perspective\"/><shape type=\"sphere\"><bsdf type=\"diffuse\">
            <texture type=\"bitmap\" name=\"reflectance\"><string name=\"filename\" value=\"{image}\"/></texture></bsdf>
            </shape></scene>"
        );
        let loaded = render::Scene::from_xml(&text, dir.path(), &Default::default());
        loaded.unwrap_err().to_string()
    };
    let said = "at column 0, row 0, in red, green and blue from its channels X, Y and Z";
    let found = error("xyz.exr");
    assert!(
        found.ends_with(said) && found.contains("found -"),
        "{found}"
    );
    assert!(error("rgb.exr").ends_with("found -0.5 at column 0, row 0"));
}
