//! The noise of each pixel, measured by a gradient pass on its way.

use super::sparse::Sparse;

/// What a gradient pass tells about its noise, as if its samples were independent. What comes through samples of
/// environment maps that move is not counted, nor are particles, nor what moves where anything else is asked for.
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

/// Part of the squares of derivatives in single precision that may be rounding: less of it is no variance.
const ROUNDING: f64 = 1e-10;

/// Adds up derivatives sample by sample and pixel by pixel.
pub(super) struct Watch {
    /// Of the sample.
    derivative: Sparse,
    /// Squared lengths, per range, of what is not kept element by element.
    rest: Sparse,
    /// Sum over the samples of the pixel.
    sum: Sparse,
    /// Per range: sum over the samples of the pixel of their squared lengths.
    squares: Vec<f64>,
    /// Per range: squared length of the sum over the samples of the pixel.
    means: Vec<f64>,
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
            squares: vec![0.0; ranges],
            means: vec![0.0; ranges],
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
            self.squares[range] += rest;
            square += rest;
        }
        for (i, d) in self.derivative.drain() {
            let d = d * scale;
            self.sum.add(i, d);
            self.squares[self.range[i] as usize] += d * d;
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
            self.means[self.range[i] as usize] += d * d;
        }
        let each = self.squares.iter_mut().zip(&mut self.means);
        for ((squares, mean), variance) in each.zip(&mut self.variances) {
            let all = std::mem::take(squares);
            let around_mean = all - std::mem::take(mean) / n;
            if around_mean > ROUNDING * all {
                found.squares += around_mean;
                *variance += around_mean / (n * (n - 1.0).max(1.0));
            }
        }
        self.done.extend(self.pixel.take().map(|p| (p, found)));
    }

    /// What was found of each pixel, and the variances of the ranges.
    pub fn finished(mut self) -> (Vec<(usize, PixelNoise)>, Vec<f64>) {
        self.flush();
        (self.done, self.variances)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two ranges, the second of two elements: equal derivatives have no variance, rounded as they are, and others
    /// theirs, pixel by pixel.
    #[test]
    fn equal_derivatives_are_no_noise() {
        let mut watch = Watch::new(3, vec![0, 1, 1]);
        let samples = [[1.0, 0.0], [3.0, 4.0], [2.0, -1.0]];
        for pixel in [5, 8] {
            for (k, [a, b]) in samples.into_iter().enumerate() {
                watch.add(0, 0.1 * (1.0 + k as f64 * 1e-7));
                watch.add(1, a / 3.0);
                watch.add(2, b / 3.0);
                watch.add_alone(2, 2.0 / 3.0);
                watch.finish(pixel, 3, 7);
            }
        }
        let (pixels, variances) = watch.finished();
        // Around the means 2 and 1, and around nothing.
        let (squares, alone) = (2.0 + 14.0, 12.0);
        assert_eq!(pixels.iter().map(|p| p.0).collect::<Vec<_>>(), [5, 8]);
        for (_, p) in pixels {
            assert_eq!((p.samples, p.work), (3, 21));
            assert!((p.squares - squares - alone).abs() < 1e-12, "{p:?}");
        }
        let expected = [0.0, 2.0 * squares / 6.0, 2.0 * alone / 6.0];
        for (v, e) in variances.iter().zip(expected) {
            assert!((v - e).abs() < 1e-12, "{variances:?}");
        }
    }
}
