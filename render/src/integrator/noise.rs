//! The noise of each pixel, measured by a gradient pass on its way.

use super::second_order::Sparse;

/// What the samples of a pixel tell about the variance of their derivatives: of the length of the vector of all
/// derivatives, each times the size of its parameter.
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
    /// Squared length of what is not kept element by element.
    rest: f64,
    /// Sum over the samples of the pixel.
    sum: Sparse,
    pixel: Option<usize>,
    found: PixelNoise,
    /// Of the pixels before.
    done: Vec<(usize, PixelNoise)>,
}

impl Watch {
    /// For so many derivatives that are kept element by element.
    pub fn new(len: usize) -> Self {
        Self {
            derivative: Sparse::new(len),
            rest: 0.0,
            sum: Sparse::new(len),
            pixel: None,
            found: PixelNoise::default(),
            done: Vec::new(),
        }
    }

    /// Part of derivative `i`.
    #[inline]
    pub fn add(&mut self, i: usize, d: f64) {
        self.derivative.add(i, d);
    }

    /// Part of a derivative among so many that two parts hardly ever meet: its own square.
    #[inline]
    pub fn add_alone(&mut self, d: f64) {
        self.rest += d * d;
    }

    /// The sample is complete; it belongs to `pixel`, was counted `1 / count`, and cost so much.
    pub fn finish(&mut self, pixel: usize, count: u64, work: u32) {
        if self.pixel != Some(pixel) {
            self.flush();
            self.pixel = Some(pixel);
        }
        let scale = count as f64;
        let mut square = self.rest * scale * scale;
        self.rest = 0.0;
        for (i, d) in self.derivative.drain() {
            let d = d * scale;
            self.sum.add(i, d);
            square += d * d;
        }
        self.found.samples += 1;
        self.found.work += u64::from(work);
        self.found.squares += square;
        self.found.spread += square * square;
    }

    fn flush(&mut self) {
        let mut found = std::mem::take(&mut self.found);
        let mean: f64 = self.sum.drain().map(|(_, d)| d * d).sum();
        found.squares = (found.squares - mean / found.samples.max(1) as f64).max(0.0);
        self.done.extend(self.pixel.take().map(|p| (p, found)));
    }

    /// What was found of each pixel.
    pub fn into_pixels(mut self) -> Vec<(usize, PixelNoise)> {
        self.flush();
        self.done
    }
}
