//! Counter-based random numbers: a sample is a pure function of (seed, pixel, sample index,
//! dimension), so results do not depend on threads or tile order, and paired passes (common random
//! numbers, antithetic lobes) are a matter of asking for the same counter again.

use ad_core::Float;

/// Dimensions reserved for the camera: pixel position.
pub const CAMERA_DIMENSIONS: u32 = 2;
/// Dimensions reserved for each bounce of a path: see [`crate::integrator`].
pub const BOUNCE_DIMENSIONS: u32 = 8;

/// From this dimension on: auxiliary rays of reparameterised estimators, by depth.
pub const AUXILIARY_DIMENSIONS: u32 = 1 << 20;

/// A stream of numbers in [0, 1) for one sample of one pixel.
pub trait Sampler {
    /// Starts the stream of sample `index` of pixel `pixel`.
    fn new(seed: u64, pixel: u64, index: u64) -> Self;

    /// Moves to a dimension: the next number drawn is that of dimension `dim`.
    fn seek(&mut self, dim: u32);

    /// The next dimension's 64 random bits.
    fn next_bits(&mut self) -> u64;

    /// One number in [0, 1).
    #[inline]
    fn next_1d<P: Float>(&mut self) -> P {
        P::from_bits_unit(self.next_bits())
    }

    /// Two numbers in [0, 1).
    #[inline]
    fn next_2d<P: Float>(&mut self) -> [P; 2] {
        [self.next_1d(), self.next_1d()]
    }

    /// Three numbers in [0, 1).
    #[inline]
    fn next_3d<P: Float>(&mut self) -> [P; 3] {
        [self.next_1d(), self.next_1d(), self.next_1d()]
    }
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64 [Steele et al. 2014]: a bijection whose output bits all depend on all
/// input bits.
#[inline]
pub fn mix64(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Independent uniform numbers.
#[derive(Clone, Copy, Debug)]
pub struct Independent {
    key: u64,
    dim: u64,
}

impl Sampler for Independent {
    #[inline]
    fn new(seed: u64, pixel: u64, index: u64) -> Self {
        let key =
            mix64(mix64(mix64(seed ^ GOLDEN).wrapping_add(pixel)) ^ index.wrapping_mul(GOLDEN));
        Self { key, dim: 0 }
    }

    #[inline]
    fn seek(&mut self, dim: u32) {
        self.dim = u64::from(dim);
    }

    #[inline]
    fn next_bits(&mut self) -> u64 {
        self.dim += 1;
        mix64(self.key.wrapping_add(self.dim.wrapping_mul(GOLDEN)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_is_a_function_of_its_counter() {
        let mut a = Independent::new(7, 11, 13);
        let first: Vec<f64> = (0..10).map(|_| a.next_1d()).collect();
        let mut b = Independent::new(7, 11, 13);
        b.seek(6);
        assert_eq!(b.next_1d::<f64>(), first[6]);
        assert!((b.next_1d::<f32>() as f64 - first[7]).abs() < 1e-7);
        assert_ne!(
            Independent::new(8, 11, 13).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
        assert_ne!(
            Independent::new(7, 12, 13).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
        assert_ne!(
            Independent::new(7, 11, 14).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
    }

    /// Mean, variance and correlation between neighbouring pixels, samples and dimensions, each
    /// within 4 standard errors (8 tests, significance 6e-5 each).
    #[test]
    fn streams_are_uniform_and_uncorrelated() {
        let n = 200_000u64;
        let draw = |pixel: u64, index: u64, dim: u32| -> f64 {
            let mut s = Independent::new(1, pixel, index);
            s.seek(dim);
            s.next_1d::<f64>() - 0.5
        };
        let z = |values: &mut dyn Iterator<Item = f64>, mean: f64, sd: f64| {
            let sum: f64 = values.sum();
            (sum / n as f64 - mean) / (sd / (n as f64).sqrt())
        };
        let sd = (1.0f64 / 12.0).sqrt();
        assert!(z(&mut (0..n).map(|i| draw(i, 0, 0)), 0.0, sd).abs() < 4.0);
        assert!(z(&mut (0..n).map(|i| draw(0, i, 0)), 0.0, sd).abs() < 4.0);
        assert!(z(&mut (0..n).map(|i| draw(0, 0, i as u32)), 0.0, sd).abs() < 4.0);
        let square_sd = (1.0f64 / 180.0).sqrt();
        assert!(
            z(
                &mut (0..n).map(|i| draw(i, 3, 5).powi(2)),
                sd * sd,
                square_sd
            )
            .abs()
                < 4.0
        );
        let product_sd = 1.0 / 12.0;
        for (dp, di, dd) in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)] {
            let pairs = &mut (0..n).map(|i| draw(i, i, 2) * draw(i + dp, i + di, 2 + dd));
            assert!(
                z(pairs, 0.0, product_sd).abs() < 4.0,
                "offset {dp} {di} {dd}"
            );
        }
    }
}
