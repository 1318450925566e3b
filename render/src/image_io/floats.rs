//! Images of numbers without an encoding: Radiance (`.hdr`) and portable float maps (`.pfm`).

use std::io::Cursor;

use super::{Mismatch, Pixels, check_size, mismatch};

/// Most bytes before the pixels of a Radiance file, whose decoder keeps them line by line.
const MAX_HEADER: usize = 1 << 16;
const RADIANCE: &str = "a complete Radiance image";
const PFM: &str = "a complete portable float map";

/// Whether a file starts as Radiance files do, by either name.
pub(super) fn is_radiance(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#?RADIANCE") || bytes.starts_with(b"#?RGBE")
}

/// Red, green and blue with a common exponent, as they are: `EXPOSURE` says what was done to them, and Mitsuba ignores it
/// too.
pub(super) fn decode_radiance(bytes: &[u8]) -> Result<Pixels, Mismatch> {
    let head = &bytes[..bytes.len().min(MAX_HEADER)];
    if !head.windows(2).any(|w| w == b"\n\n") {
        let expected = format!("an empty line within {MAX_HEADER} bytes, which ends the header");
        return Err(mismatch(expected, "none"));
    }
    let damaged = |e| mismatch(RADIANCE, e);
    // Strictly, only one of the two names would be known.
    let decoder = image::codecs::hdr::HdrDecoder::new_nonstrict(Cursor::new(bytes));
    let decoder = decoder.map_err(damaged)?;
    let (width, height) = image::ImageDecoder::dimensions(&decoder);
    let (width, height) = (width as usize, height as usize);
    check_size(width, height)?;
    // However long its runs are, a row takes four bytes.
    if 4 * height > bytes.len() {
        let found = format!("{} bytes for {width} x {height}", bytes.len());
        return Err(mismatch(RADIANCE, found));
    }
    let image = image::DynamicImage::from_decoder(decoder).map_err(damaged)?;
    Ok(Pixels {
        width,
        height,
        channels: 3,
        data: image.into_rgb32f().into_raw(),
    })
}

/// `PF` (colours) or `Pf` (grey), the size and the scale in text, whose sign is the order of bytes; then rows from the
/// bottom to the top.
pub(super) fn is_pfm(bytes: &[u8]) -> bool {
    matches!(bytes, [b'P', b'F' | b'f', space, ..] if space.is_ascii_whitespace())
}

/// Values times the magnitude of the scale, as in Mitsuba.
pub(super) fn decode_pfm(bytes: &[u8]) -> Result<Pixels, Mismatch> {
    let channels = if bytes[1] == b'F' { 3 } else { 1 };
    let mut rest = &bytes[2..];
    let mut word = |what: &str| {
        let start = rest.iter().position(|b| !b.is_ascii_whitespace());
        let text = &rest[start.unwrap_or(rest.len())..];
        let end = text.iter().position(u8::is_ascii_whitespace);
        // Numbers of so many characters are none.
        let found = end.filter(|&n| n <= 32).and_then(|n| {
            // One character ends the last of them, whatever the first byte of the pixels is.
            rest = &text[n + 1..];
            std::str::from_utf8(&text[..n]).ok()
        });
        found.ok_or_else(|| mismatch(PFM, format!("no {what}")))
    };
    let mut side = |what: &str| -> Result<usize, Mismatch> {
        let text = word(what)?;
        text.parse()
            .map_err(|_| mismatch(PFM, format!("the {what} {}", super::quoted(text))))
    };
    let (width, height) = (side("width")?, side("height")?);
    check_size(width, height)?;
    let text = word("scale")?;
    let scale = (text.parse::<f32>().ok()).filter(|s| s.is_finite() && *s != 0.0);
    let scale = scale.ok_or_else(|| mismatch(PFM, format!("the scale {}", super::quoted(text))))?;
    let count = width * height * channels;
    let (values, _) = rest.as_chunks::<4>();
    if values.len() < count {
        let found = format!(
            "{} numbers for {width} x {height} x {channels}",
            values.len()
        );
        return Err(mismatch(PFM, found));
    }
    let number = if scale < 0.0 {
        f32::from_le_bytes
    } else {
        f32::from_be_bytes
    };
    let rows = values[..count].chunks_exact(width * channels).rev();
    Ok(Pixels {
        width,
        height,
        channels,
        data: rows
            .flatten()
            .map(|&bytes| number(bytes) * scale.abs())
            .collect(),
    })
}
