//! Images, pixel filters and the part of the film that is rendered.

use std::f64::consts::TAU;

use ad_core::Float;

/// A linear RGB image, row-major, row 0 at the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// `[height][width][3]`.
    pub data: Vec<f32>,
}

impl Image {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            data: vec![0.0; width * height * 3],
        }
    }

    /// The colour of a pixel.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        let i = (y * self.width + x) * 3;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// Mean of all pixels, per channel.
    pub fn mean(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for p in self.data.chunks_exact(3) {
            for c in 0..3 {
                sum[c] += f64::from(p[c]);
            }
        }
        sum.map(|s| s / (self.width * self.height).max(1) as f64)
    }
}

/// A reconstruction filter. Samples are drawn *from* the filter and weigh one, so that a sample belongs
/// to one pixel: the expectation is that of the normalised splat, tiles need no borders, and the adjoint of a
/// pixel is looked up, never filtered twice (errata Z-4.15).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PixelFilter {
    /// Uniform over the pixel.
    #[default]
    Box,
    /// A Gaussian with this standard deviation in pixels, cut at four standard deviations.
    Gaussian {
        /// Standard deviation, in pixels.
        stddev: f64,
    },
}

impl PixelFilter {
    /// An offset from the pixel's centre, in pixels.
    #[inline]
    pub fn sample<P: Float>(&self, u: [P; 2]) -> [P; 2] {
        match *self {
            Self::Box => [u[0] - P::of(0.5), u[1] - P::of(0.5)],
            Self::Gaussian { stddev } => {
                // Box-Muller with the radius cut at 4 sigma: u is scaled into the inside of the disc.
                let inside = 1.0 - (-8.0f64).exp();
                let r = P::of(stddev) * (-P::of(2.0) * (-(u[0] * P::of(inside))).ln_1p()).sqrt();
                let (sin, cos) = (u[1] * P::of(TAU)).sin_cos();
                [r * cos, r * sin]
            }
        }
    }
}

/// Size of the image and the part of it that is rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Full resolution, `[width, height]`.
    pub size: [u32; 2],
    /// Top left corner of the rendered part.
    pub crop_offset: [u32; 2],
    /// Size of the rendered part: the size of the image that comes out.
    pub crop_size: [u32; 2],
    /// Reconstruction filter.
    pub filter: PixelFilter,
}

impl Film {
    /// A whole film with a box filter.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            size: [width, height],
            crop_offset: [0, 0],
            crop_size: [width, height],
            filter: PixelFilter::Box,
        }
    }

    /// Number of rendered pixels.
    pub fn pixels(&self) -> usize {
        self.crop_size[0] as usize * self.crop_size[1] as usize
    }
}
