//! Netpbm's images of whole numbers: bits (`.pbm`), grey (`.pgm`) and colours (`.ppm`), in text and binary.

use super::{Encoding, Mismatch, Pixels, check_size, mismatch, quoted};

const EXPECTED: &str = "a complete Netpbm image";
/// The largest value that the format admits.
const MOST: usize = 65535;
/// Numbers of more digits are none.
const MOST_DIGITS: usize = 9;

/// Whether a file starts as these do.
pub(super) fn is_anymap(bytes: &[u8]) -> bool {
    matches!(bytes, [b'P', b'1'..=b'6', ..])
}

/// What is between white space and comments, which reach from `#` to the end of the line.
struct Words<'a> {
    rest: &'a [u8],
}

impl<'a> Words<'a> {
    fn skip_comment(&mut self) {
        let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        self.rest = &self.rest[end.unwrap_or(self.rest.len())..];
    }

    /// The next word, or its first bytes.
    fn next(&mut self, most: usize) -> &'a [u8] {
        self.rest = self.rest.trim_ascii_start();
        while self.rest.starts_with(b"#") {
            self.skip_comment();
            self.rest = self.rest.trim_ascii_start();
        }
        let ends = |b: &u8| b.is_ascii_whitespace() || *b == b'#';
        let most = most.min(self.rest.len());
        let end = self.rest[..most].iter().position(ends);
        let (word, rest) = self.rest.split_at(end.unwrap_or(most));
        self.rest = rest;
        word
    }

    fn number(&mut self, what: &str) -> Result<usize, Mismatch> {
        let word = self.next(MOST_DIGITS + 1);
        let is_number = word.len() <= MOST_DIGITS && word.iter().all(u8::is_ascii_digit);
        let text = std::str::from_utf8(word).ok().filter(|_| is_number);
        text.and_then(|t| t.parse().ok())
            .ok_or_else(|| wrong(what, word))
    }

    /// A bit, which needs nothing between it and the next.
    fn bit(&mut self) -> Result<usize, Mismatch> {
        match self.next(1) {
            b"0" => Ok(0),
            b"1" => Ok(1),
            other => Err(wrong("bit", other)),
        }
    }

    /// The bytes behind the header, which one character ends, whatever the first of them is.
    fn raster(mut self) -> &'a [u8] {
        if self.rest.starts_with(b"#") {
            self.skip_comment();
        }
        self.rest.get(1..).unwrap_or_default()
    }
}

fn wrong(what: &str, found: &[u8]) -> Mismatch {
    if found.is_empty() {
        return mismatch(EXPECTED, format!("no {what}"));
    }
    let found = quoted(&String::from_utf8_lossy(found));
    mismatch(EXPECTED, format!("the {what} {found}"))
}

/// The first image of a file. A bit that is set is black; other numbers are parts of the largest.
pub(super) fn decode(bytes: &[u8], encoding: Encoding) -> Result<Pixels, Mismatch> {
    let kind = bytes[1];
    let is_text = matches!(kind, b'1'..=b'3');
    let is_bits = matches!(kind, b'1' | b'4');
    let channels = if matches!(kind, b'3' | b'6') { 3 } else { 1 };
    let mut words = Words { rest: &bytes[2..] };
    let (width, height) = (words.number("width")?, words.number("height")?);
    check_size(width, height)?;
    let largest = if is_bits {
        1
    } else {
        words.number("largest value")?
    };
    if !(1..=MOST).contains(&largest) {
        let expected = format!("from 1 to {MOST} as the largest value");
        return Err(mismatch(expected, largest));
    }
    let across = width * channels;
    let count = across * height;
    let complete = |raster: &[u8], row: usize| {
        let found = || {
            mismatch(
                EXPECTED,
                format!("{} bytes for {width} x {height}", raster.len()),
            )
        };
        (raster.len() >= row * height)
            .then_some(())
            .ok_or_else(found)
    };
    let table: Vec<f32> = (0..=largest)
        .map(|i| encoding.decode(i as f64 / largest as f64))
        .collect();
    let value = |(i, number): (usize, usize)| {
        table.get(number).copied().ok_or_else(|| {
            let (x, y, channel) = (i / channels % width, i / across, i % channels);
            let found = format!("{number} at column {x}, row {y}, channel {channel}");
            mismatch(format!("values up to {largest}"), found)
        })
    };
    let data: Result<Vec<f32>, Mismatch> = if is_text {
        // A digit each.
        complete(words.rest, across)?;
        let mut number = || {
            if is_bits {
                words.bit().map(|bit| 1 - bit)
            } else {
                words.number("value")
            }
        };
        (0..count).map(|i| value((i, number()?))).collect()
    } else if is_bits {
        let (raster, row) = (words.raster(), width.div_ceil(8));
        complete(raster, row)?;
        let bit = |x: usize, line: &[u8]| usize::from(line[x / 8] >> (7 - x % 8) & 1);
        let lines = raster.chunks_exact(row).take(height);
        let white = lines.flat_map(|line| (0..width).map(move |x| 1 - bit(x, line)));
        white.enumerate().map(value).collect()
    } else if largest < 256 {
        let raster = words.raster();
        complete(raster, across)?;
        let bytes = raster[..count].iter().map(|&byte| byte.into());
        bytes.enumerate().map(value).collect()
    } else {
        let raster = words.raster();
        complete(raster, 2 * across)?;
        let (pairs, _) = raster.as_chunks::<2>();
        let pairs = (pairs[..count].iter()).map(|&pair| u16::from_be_bytes(pair).into());
        pairs.enumerate().map(value).collect()
    };
    Ok(Pixels {
        width,
        height,
        channels,
        data: data?,
    })
}
