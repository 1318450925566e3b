//! The noise of each pixel, measured by a gradient pass on its way.

use super::second_order::Sparse;

/// What a gradient pass tells about its noise, as if its samples were independent. What comes through samples of
/// environment maps that move is not counted, nor are particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Noise {
    /// Of each pixel, row by row.
    pub pixels: Vec<PixelNoise>,
    /// Variance of the derivatives in each range of the active set, in its order: all elements together, multiplied by
    /// the square of the range's scale.
    pub variances: Vec<f64>,
}

/// What the samples of a pixel tell about the variance of their derivatives: of the length of the vector of all
/// derivatives, each times the scale of its range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelNoise {
    /// How many there were.
    pub samples: u64,
    /// Sum of the squares of their distances from the mean.
    pub squares: f64,
    /// Sum of the squares of the squared lengths: whether many samples carry the variance, or few.
    pub spread: f64,
    /// What they cost: edges of their paths and of samples of the derivative of normals.
    pub work: u64,
}

impl PixelNoise {
    /// Adds what other samples tell, of this pixel or another.
    pub fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.squares += other.squares;
        self.spread += other.spread;
        self.work += other.work;
    }
}

/// Adds up derivatives sample by sample and pixel by pixel.
pub(super) struct Watch {
    /// Of the sample.
    derivative: Sparse,
    /// Squared lengths, per range, of what is not kept element by element.
    rest: Sparse,
    /// Sum over the samples of the pixel.
    sum: Sparse,
    /// Per range: sum over the samples of the pixel of their squared lengths.
    squares: Sparse,
    /// The range of each element that is kept.
    range: Vec<u32>,
    pixel: Option<usize>,
    found: PixelNoise,
    /// Of the pixels before.
    done: Vec<(usize, PixelNoise)>,
    /// Per range, of the pixels before.
    variances: Vec<f64>,
}

impl Watch {
    /// For so many ranges, and derivatives in these ranges that are kept element by element.
    pub fn new(ranges: usize, range: Vec<u32>) -> Self {
        Self {
            derivative: Sparse::new(range.len()),
            rest: Sparse::new(ranges),
            sum: Sparse::new(range.len()),
            squares: Sparse::new(ranges),
            range,
            pixel: None,
            found: PixelNoise::default(),
            done: Vec::new(),
            variances: vec![0.0; ranges],
        }
    }

    /// Part of derivative `i`.
    #[inline]
    pub fn add(&mut self, i: usize, d: f64) {
        self.derivative.add(i, d);
    }

    /// Part of a derivative among so many in its range that two parts hardly ever meet: its own square.
    #[inline]
    pub fn add_alone(&mut self, range: usize, d: f64) {
        self.rest.add(range, d * d);
    }

    /// The sample is complete; it belongs to `pixel`, was counted `1 / count`, and cost so much.
    pub fn finish(&mut self, pixel: usize, count: u64, work: u32) {
        if self.pixel != Some(pixel) {
            self.flush();
            self.pixel = Some(pixel);
        }
        let scale = count as f64;
        let mut square = 0.0;
        for (range, rest) in self.rest.drain() {
            let rest = rest * scale * scale;
            self.squares.add(range, rest);
            square += rest;
        }
        for (i, d) in self.derivative.drain() {
            let d = d * scale;
            self.sum.add(i, d);
            self.squares.add(self.range[i] as usize, d * d);
            square += d * d;
        }
        self.found.samples += 1;
        self.found.work += u64::from(work);
        self.found.spread += square * square;
    }

    fn flush(&mut self) {
        let mut found = std::mem::take(&mut self.found);
        let n = found.samples.max(1) as f64;
        for (i, d) in self.sum.drain() {
            self.squares.add(self.range[i] as usize, -d * d / n);
        }
        for (range, squares) in self.squares.drain() {
            let squares = squares.max(0.0);
            found.squares += squares;
            self.variances[range] += squares / (n * (n - 1.0).max(1.0));
        }
        self.done.extend(self.pixel.take().map(|p| (p, found)));
    }

    /// What was found of each pixel, and the variances of the ranges.
    pub fn finished(mut self) -> (Vec<(usize, PixelNoise)>, Vec<f64>) {
        self.flush();
        (self.done, self.variances)
    }
}
