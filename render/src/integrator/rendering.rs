//! Images as sums over samples, with the derivative images of their tangents.

use std::ops::Range;

use ad_core::{Dual, Float, Real};

use crate::film::Image;
use crate::manifold::Statistics;

/// Samples that were not finite. They are left out of the sums, counted and reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NonFinite {
    /// How many.
    pub count: u64,
    /// Pixel and sample index of the first one.
    pub first: Option<(u64, u64)>,
}

impl NonFinite {
    pub(super) fn add(&mut self, pixel: u64, sample: u64) {
        self.count += 1;
        self.first.get_or_insert((pixel, sample));
    }

    /// Joins the counts of two disjoint sets of samples; `self` comes first.
    pub fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.first = self.first.or(other.first);
    }
}

/// A scalar as a list of numbers: its value and its tangents.
pub trait Components: Real {
    /// How many numbers.
    const COUNT: usize;
    /// How often tangents have tangents: zero without any.
    const ORDER: u32;
    /// Number `k`; 0 is the value.
    fn component(&self, k: usize) -> f64;
}

macro_rules! single_component {
    ($($float:ty),*) => {$(
        impl Components for $float {
            const COUNT: usize = 1;
            const ORDER: u32 = 0;
            #[inline]
            fn component(&self, _k: usize) -> f64 {
                self.to_f64()
            }
        }
    )*};
}
single_component!(f32, f64);

/// The components of the value, then those of each tangent.
impl<P: Components, const N: usize> Components for Dual<P, N> {
    const COUNT: usize = P::COUNT * (N + 1);
    const ORDER: u32 = P::ORDER + 1;
    #[inline]
    fn component(&self, k: usize) -> f64 {
        let (outer, inner) = (k / P::COUNT, k % P::COUNT);
        if outer == 0 {
            self.re.component(inner)
        } else {
            self.eps[outer - 1].component(inner)
        }
    }
}

/// What manifold connections came to in a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PixelConnections {
    /// Sums over its samples.
    pub statistics: Statistics,
    /// The light that they brought, a mean over channels, summed over samples like [`Rendering::sums`].
    pub light: f64,
}

impl PixelConnections {
    fn merge(&mut self, other: &Self) {
        self.statistics.merge(&other.statistics);
        self.light += other.light;
    }
}

/// Sums over samples, per pixel.
#[derive(Clone, Debug)]
pub struct Rendering {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Samples per pixel in the sums: where pixels have more or fewer, they weigh as much as these.
    pub samples: u64,
    /// `[component][height][width][3]`: the image, then one derivative image per tangent.
    pub sums: Vec<Vec<f64>>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// What manifold connections came to.
    pub connections: Statistics,
    /// The light that they brought, a mean over channels, summed over pixels and samples like [`Rendering::sums`].
    pub light_of_connections: f64,
    /// The same by pixel, `[height][width]`, where [`crate::scene::Connections::by_pixel`] asks for it; else empty.
    pub connections_by_pixel: Vec<PixelConnections>,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

impl Rendering {
    /// Nothing yet of an image of this size, with so many components.
    pub(super) fn black([width, height]: [u32; 2], samples: &Range<u64>, count: usize) -> Self {
        let (width, height) = (width as usize, height as usize);
        Self {
            width,
            height,
            samples: samples.end.saturating_sub(samples.start),
            sums: vec![vec![0.0; width * height * 3]; count],
            non_finite: NonFinite::default(),
            connections: Statistics::default(),
            light_of_connections: 0.0,
            connections_by_pixel: Vec::new(),
            cancelled: false,
        }
    }

    /// Mean over the samples of component `k`: 0 is the image, `k` the derivative along tangent `k - 1`.
    pub fn image(&self, k: usize) -> Image {
        let mut image = Image::new(self.width, self.height);
        let scale = 1.0 / self.samples.max(1) as f64;
        for (out, sum) in image.data.iter_mut().zip(&self.sums[k]) {
            *out = (sum * scale) as f32;
        }
        image
    }

    /// Mean over pixels of component `k`, per channel, in full precision.
    pub fn mean(&self, k: usize) -> [f64; 3] {
        let n = self.samples.max(1) as f64 * (self.width * self.height).max(1) as f64;
        let mut sum = [0.0; 3];
        for p in self.sums[k].chunks_exact(3) {
            for c in 0..3 {
                sum[c] += p[c];
            }
        }
        sum.map(|s| s / n)
    }

    /// Adds further samples of the same image.
    pub fn merge(&mut self, other: &Self) {
        self.samples += other.samples;
        self.add(other);
    }

    /// Adds another part of the light, of as many samples.
    pub(super) fn add(&mut self, other: &Self) {
        self.non_finite.merge(&other.non_finite);
        self.connections.merge(&other.connections);
        self.light_of_connections += other.light_of_connections;
        let (ours, theirs) = (&mut self.connections_by_pixel, &other.connections_by_pixel);
        if ours.is_empty() {
            ours.clone_from(theirs);
        } else {
            ours.iter_mut().zip(theirs).for_each(|(a, b)| a.merge(b));
        }
        self.cancelled |= other.cancelled;
        for (a, b) in self.sums.iter_mut().zip(&other.sums) {
            for (a, b) in a.iter_mut().zip(b) {
                *a += b;
            }
        }
    }
}

/// Whether a number has single precision.
pub(super) const fn is_single<P: Float>() -> bool {
    size_of::<P>() == size_of::<f32>()
}
