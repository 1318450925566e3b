//! Losses over images and their adjoint images.
//!
//! # Noise and bias
//!
//! The adjoint image is evaluated at a *noisy* image. Two kinds of bias follow.
//!
//! - The image of the loss and the samples of the gradient pass must be independent. With common
//!   samples even the squared error is biased: at its optimum, with N samples of variance V per
//!   pixel, the gradient of `(image - target)^2 / 2` with respect to the pixel's scale is V / N
//!   instead of 0 [Zeltner et al. 2021, Eqs. 4.4 and 4.5].
//! - Independence is enough where the adjoint is *linear* in the image: for [`L2`] and
//!   [`RelativeL2`]. The others stay biased. [`L1`] and [`RelativeL1`] pull towards the median of
//!   the pixel's estimator instead of its mean: no bias at the optimum for symmetric noise, about
//!   `N^-1/2` of the gradient's range for skewed noise such as fireflies. [`LogL2`] pulls
//!   towards the geometric mean; its bias falls as 1 / N.
//!
//! Noise in the target is harmless for `L2`; in the relative losses it also enters the weights.

use crate::error::{OptimError, require, require_len};
use crate::optimizer::require_finite;
use crate::scalar::Scalar;
use std::str::FromStr;

/// A scalar measure of the difference between two images of the same shape, as flat slices.
///
/// Every loss of this module is a mean over all entries (pixels times channels), so that its
/// magnitude is independent of the resolution.
///
/// ```
/// use optim::{Loss, loss::L2};
///
/// let (image, target) = ([0.5f32, 1.0, 0.0], [0.0f32, 1.0, 1.0]); // such as [height][width][3]
/// assert!((L2.value(&image, &target)? - (0.25 + 0.0 + 1.0) / 3.0).abs() < 1e-9);
/// let mut adjoint = [0.0; 3]; // as the image: what `backward` of the renderer takes
/// L2.gradient(&image, &target, &mut adjoint)?;
/// assert_eq!(adjoint, [2.0 * 0.5 / 3.0, 0.0, -2.0 / 3.0]);
/// # Ok::<(), optim::OptimError>(())
/// ```
pub trait Loss<T: Scalar> {
    /// The loss, 0 for equal images. Summed in double precision.
    ///
    /// # Errors
    /// Slices of different lengths or without entries, an entry that is not finite, or a loss that is not.
    fn value(&self, image: &[T], target: &[T]) -> Result<f64, OptimError>;

    /// Writes the adjoint image: the derivative of [`value`](Self::value) with respect to every
    /// entry of `image`. `d_image` is overwritten, and left alone if an error is returned.
    ///
    /// # Errors
    /// As [`value`](Self::value); a derivative beyond the range of the scalar.
    fn gradient(&self, image: &[T], target: &[T], d_image: &mut [T]) -> Result<(), OptimError>;

    /// Writes the second derivative of [`value`](Self::value) with respect to every entry of `image` by
    /// itself; entries do not mix. Like the adjoint it is free of noise for [`L2`] and [`RelativeL2`].
    ///
    /// # Errors
    /// As [`gradient`](Self::gradient).
    fn curvature(&self, image: &[T], target: &[T], dd_image: &mut [T]) -> Result<(), OptimError>;

    /// The standard error of [`value`](Self::value) at the mean of two images of equally many, independent samples: their
    /// difference times the slope at the mean. Where the image is its target but for noise this is too large, by a factor
    /// of 2^(1/2) for [`L2`]. `together` entries in a row, the channels of a pixel, share their noise.
    ///
    /// # Errors
    /// As [`value`](Self::value); no entries together.
    fn standard_error(
        &self,
        halves: [&[T]; 2],
        target: &[T],
        together: usize,
    ) -> Result<f64, OptimError>;
}

/// A loss that is the mean of a function of single entries; implements [`Loss`] for both scalars.
///
/// ```
/// use optim::{Loss, PixelLoss};
///
/// /// That of Huber: squares of what is small, and no more than the size of what is large.
/// struct Huber(f64);
///
/// impl PixelLoss for Huber {
///     fn pixel(&self, image: f64, target: f64) -> f64 {
///         let d = (image - target).abs();
///         if d < self.0 { 0.5 * d * d } else { self.0 * (d - 0.5 * self.0) }
///     }
///     fn d_pixel(&self, image: f64, target: f64) -> f64 {
///         (image - target).clamp(-self.0, self.0)
///     }
///     fn dd_pixel(&self, image: f64, target: f64) -> f64 {
///         if (image - target).abs() < self.0 { 1.0 } else { 0.0 }
///     }
/// }
///
/// let (image, target, mut adjoint) = ([0.1f64, 3.0], [0.0, 0.0], [0.0; 2]);
/// Huber(1.0).gradient(&image, &target, &mut adjoint)?; // of the mean over both entries
/// let loss = |x| Huber(1.0).value(&[0.1, x], &target);
/// let difference = (loss(3.0 + 1e-4)? - loss(3.0 - 1e-4)?) / 2e-4;
/// assert!((adjoint[1] - difference).abs() < 1e-6);
/// # Ok::<(), optim::OptimError>(())
/// ```
pub trait PixelLoss {
    /// The entry's loss; finite for moderate inputs of any sign.
    fn pixel(&self, image: f64, target: f64) -> f64;

    /// Its derivative with respect to the image. Zero where the function has a kink.
    fn d_pixel(&self, image: f64, target: f64) -> f64;

    /// Its second derivative with respect to the image. Zero where the function has a kink.
    fn dd_pixel(&self, image: f64, target: f64) -> f64;
}

impl<T: Scalar, P: PixelLoss> Loss<T> for P {
    fn value(&self, image: &[T], target: &[T]) -> Result<f64, OptimError> {
        check(image, target)?;
        let mut sum = 0.0;
        for (index, (i, t)) in image.iter().zip(target).enumerate() {
            // Divided first: the mean is finite where every entry is.
            sum += self.pixel(i.to_f64(), t.to_f64()) / image.len() as f64;
            if !sum.is_finite() {
                return Err(OptimError::Overflow {
                    what: "loss",
                    index,
                });
            }
        }
        Ok(sum)
    }

    fn gradient(&self, image: &[T], target: &[T], d_image: &mut [T]) -> Result<(), OptimError> {
        check(image, target)?;
        require_len("d_image", image.len(), d_image.len())?;
        let d = |image, target| self.d_pixel(image, target);
        write_means(d, image, target, d_image, "adjoint image")
    }

    fn curvature(&self, image: &[T], target: &[T], dd_image: &mut [T]) -> Result<(), OptimError> {
        check(image, target)?;
        require_len("dd_image", image.len(), dd_image.len())?;
        let dd = |image, target| self.dd_pixel(image, target);
        write_means(dd, image, target, dd_image, "curvature image")
    }

    fn standard_error(
        &self,
        [a, b]: [&[T]; 2],
        target: &[T],
        together: usize,
    ) -> Result<f64, OptimError> {
        check(a, target)?;
        check(b, target)?;
        require(together > 0, "entries of a pixel", "at least 1", 0.0)?;
        let n = a.len() as f64;
        // Divided before it is squared, like the mean.
        let change = |i: usize| {
            let [a, b, t] = [a[i], b[i], target[i]].map(|x| x.to_f64());
            self.d_pixel(0.5 * (a + b), t) / n * (0.5 * (a - b))
        };
        let mut sum = 0.0;
        for first in (0..a.len()).step_by(together) {
            let pixel = first..(first + together).min(a.len());
            sum += pixel.map(change).sum::<f64>().powi(2);
            if !f64::is_finite(sum) {
                return Err(OptimError::Overflow {
                    what: "standard error of the loss",
                    index: first,
                });
            }
        }
        Ok(sum.sqrt())
    }
}

/// A function of every entry over the number of entries; `out` is left alone on errors.
fn write_means<T: Scalar>(
    f: impl Fn(f64, f64) -> f64,
    image: &[T],
    target: &[T],
    out: &mut [T],
    what: &'static str,
) -> Result<(), OptimError> {
    let n = image.len() as f64;
    let entry = |i: usize| T::from_f64(f(image[i].to_f64(), target[i].to_f64()) / n);
    if let Some(index) = (0..image.len()).find(|i| !entry(*i).is_finite()) {
        return Err(OptimError::Overflow { what, index });
    }
    for (index, out) in out.iter_mut().enumerate() {
        *out = entry(index);
    }
    Ok(())
}

fn check<T: Scalar>(image: &[T], target: &[T]) -> Result<(), OptimError> {
    if image.is_empty() {
        return Err(OptimError::EmptyImage);
    }
    require_len("target", image.len(), target.len())?;
    require_finite("image", image)?;
    require_finite("target", target)
}

/// Epsilon of the losses that have one, unless told otherwise: a radiance below which differences
/// count as absolute ones.
pub const DEFAULT_EPSILON: f64 = 1e-2;

/// Mean of `|image - target|`. Robust against outliers; see the module on its bias.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct L1;

impl PixelLoss for L1 {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        (image - target).abs()
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        sign(image - target)
    }
    fn dd_pixel(&self, _image: f64, _target: f64) -> f64 {
        0.0
    }
}

/// Mean of `(image - target)^2`. Unbiased with independent gradient samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct L2;

impl PixelLoss for L2 {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        let d = image - target;
        d * d
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        2.0 * (image - target)
    }
    fn dd_pixel(&self, _image: f64, _target: f64) -> f64 {
        2.0
    }
}

macro_rules! with_epsilon {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            epsilon: f64,
        }

        impl $name {
            /// With another epsilon than [`DEFAULT_EPSILON`]; positive and finite.
            ///
            /// # Errors
            /// An epsilon that is not.
            pub fn new(epsilon: f64) -> Result<Self, OptimError> {
                let valid = epsilon > 0.0 && epsilon.is_finite();
                require(valid, "epsilon", "a positive finite value", epsilon)?;
                Ok(Self { epsilon })
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self { epsilon: DEFAULT_EPSILON }
            }
        }
    };
}

with_epsilon! {
    /// Mean of `|image - target| / (|target| + epsilon)`: dark and bright regions count alike.
    /// See the module on its bias.
    RelativeL1
}

impl PixelLoss for RelativeL1 {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        (image - target).abs() / (target.abs() + self.epsilon)
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        sign(image - target) / (target.abs() + self.epsilon)
    }
    fn dd_pixel(&self, _image: f64, _target: f64) -> f64 {
        0.0
    }
}

with_epsilon! {
    /// Mean of `(image - target)^2 / (target^2 + epsilon)`; epsilon in units of squared radiance.
    /// The weight belongs to the target alone, so the adjoint is unbiased with independent samples.
    RelativeL2
}

impl PixelLoss for RelativeL2 {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        let d = image - target;
        d * d / (target * target + self.epsilon)
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        2.0 * (image - target) / (target * target + self.epsilon)
    }
    fn dd_pixel(&self, _image: f64, target: f64) -> f64 {
        2.0 / (target * target + self.epsilon)
    }
}

with_epsilon! {
    /// Mean of `(f(image) - f(target))^2` with `f(x) = ln(1 + x / epsilon)` for `x >= 0`, the same as
    /// `(ln(image + epsilon) - ln(target + epsilon))^2`, continued as an odd function: an entry
    /// that noise or a filter made negative has a finite loss too. See the module on its bias.
    LogL2
}

impl LogL2 {
    fn compress(&self, x: f64) -> f64 {
        (x.abs() / self.epsilon).ln_1p().copysign(x)
    }
}

impl PixelLoss for LogL2 {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        let d = self.compress(image) - self.compress(target);
        d * d
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        2.0 * (self.compress(image) - self.compress(target)) / (image.abs() + self.epsilon)
    }
    fn dd_pixel(&self, image: f64, target: f64) -> f64 {
        let d = self.compress(image) - self.compress(target);
        let slope = (image.abs() + self.epsilon).recip();
        2.0 * slope * slope * (1.0 - d * 1f64.copysign(image))
    }
}

/// -1, 0 or 1; the subgradient of the absolute value that leaves a perfect pixel alone.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}

/// A loss that was chosen at run time; parses from the names in [`NAMES`](Self::NAMES).
///
/// ```
/// use optim::{Loss, LossKind};
/// let loss: LossKind = "relative-l2".parse()?;
/// assert_eq!(loss.value(&[0.5f32, 1.0], &[0.5, 1.0])?, 0.0);
/// assert!("l3".parse::<LossKind>().is_err());
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum LossKind {
    /// [`L1`]; parses from `l1` and `mae`.
    L1(L1),
    /// [`L2`]; parses from `l2` and `mse`.
    L2(L2),
    /// [`RelativeL1`]; parses from `relative-l1`.
    RelativeL1(RelativeL1),
    /// [`RelativeL2`]; parses from `relative-l2`.
    RelativeL2(RelativeL2),
    /// [`LogL2`]; parses from `log-l2`.
    LogL2(LogL2),
}

impl LossKind {
    /// The names of all losses, for help texts.
    pub const NAMES: [&'static str; 5] = ["l1", "l2", "relative-l1", "relative-l2", "log-l2"];

    fn inner(&self) -> &dyn PixelLoss {
        match self {
            Self::L1(l) => l,
            Self::L2(l) => l,
            Self::RelativeL1(l) => l,
            Self::RelativeL2(l) => l,
            Self::LogL2(l) => l,
        }
    }
}

impl FromStr for LossKind {
    type Err = OptimError;
    fn from_str(name: &str) -> Result<Self, OptimError> {
        match name {
            "l1" | "mae" => Ok(Self::L1(L1)),
            "l2" | "mse" => Ok(Self::L2(L2)),
            "relative-l1" => Ok(Self::RelativeL1(Default::default())),
            "relative-l2" => Ok(Self::RelativeL2(Default::default())),
            "log-l2" => Ok(Self::LogL2(Default::default())),
            _ => Err(OptimError::UnknownName {
                what: "loss",
                expected: Self::NAMES.join(", "),
                found: name.to_owned(),
            }),
        }
    }
}

impl PixelLoss for LossKind {
    fn pixel(&self, image: f64, target: f64) -> f64 {
        self.inner().pixel(image, target)
    }
    fn d_pixel(&self, image: f64, target: f64) -> f64 {
        self.inner().d_pixel(image, target)
    }
    fn dd_pixel(&self, image: f64, target: f64) -> f64 {
        self.inner().dd_pixel(image, target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn all() -> [LossKind; 5] {
        LossKind::NAMES.map(|name| name.parse().unwrap())
    }

    #[test]
    fn values_by_hand() {
        let expected = [
            0.75,
            1.25 / 2.0,
            (1.0 / 1.01 + 0.5 / 0.01) / 2.0,
            (1.0 / 1.01 + 0.25 / 0.01) / 2.0,
            ((2.01f64 / 1.01).ln().powi(2) + 51.0f64.ln().powi(2)) / 2.0,
        ];
        for (loss, expected) in all().iter().zip(expected) {
            assert_relative_eq!(
                loss.value(&[2.0, 0.5], &[1.0, 0.0]).unwrap(),
                expected,
                max_relative = 1e-14
            );
        }
        assert_eq!("mse".parse::<LossKind>().unwrap(), LossKind::L2(L2));
        assert_eq!("mae".parse::<LossKind>().unwrap(), LossKind::L1(L1));
    }

    #[test]
    fn adjoint_images_equal_central_differences() {
        let target = [0.0, 1e-3, 0.4, 2.0, 30.0, 0.7];
        let image = [0.02, 5e-3, 0.1, 2.5, 1.0, -0.03];
        for loss in all() {
            let mut d_image = [f64::NAN; 6];
            loss.gradient(&image, &target, &mut d_image).unwrap();
            for i in 0..6 {
                let shifted = |h: f64| {
                    let mut image = image;
                    image[i] += h;
                    loss.value(&image, &target).unwrap()
                };
                // Five points: fourth order, truncation about 1e-12.
                let h = 1e-4;
                let difference = (8.0 * (shifted(h) - shifted(-h))
                    - (shifted(2.0 * h) - shifted(-2.0 * h)))
                    / (12.0 * h);
                assert_relative_eq!(d_image[i], difference, max_relative = 1e-5, epsilon = 1e-8);
            }
            // Single precision rounds the same numbers.
            let mut single = [0f32; 6];
            loss.gradient(
                &image.map(|x| x as f32),
                &target.map(|x| x as f32),
                &mut single,
            )
            .unwrap();
            for (s, d) in single.iter().zip(d_image) {
                assert_relative_eq!(f64::from(*s), d, max_relative = 1e-5);
            }
        }
    }

    #[test]
    fn curvature_images_equal_differences_of_adjoints() {
        let target = [0.0, 1e-3, 0.4, 2.0, 30.0, 0.7];
        let image = [0.02, 5e-3, 0.1, 2.5, 1.0, -0.03];
        for loss in all() {
            let mut dd_image = [f64::NAN; 6];
            loss.curvature(&image, &target, &mut dd_image).unwrap();
            for i in 0..6 {
                let shifted = |h: f64| {
                    let mut image = image;
                    image[i] += h;
                    let mut d = [0.0; 6];
                    loss.gradient(&image, &target, &mut d).unwrap();
                    d[i]
                };
                let h = 1e-5;
                let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
                assert_relative_eq!(dd_image[i], difference, max_relative = 1e-4, epsilon = 1e-9);
            }
        }
    }

    #[test]
    fn standard_error_by_hand() {
        // Halves of differences 0.5, 0.5, 0 and 1, at slopes 2, 4, 2 and 0 over four.
        let halves = [[1.5, 2.5, 1.0, 1.0], [0.5, 1.5, 1.0, -1.0]];
        let error = |together| {
            let halves = halves.each_ref().map(|h| &h[..]);
            L2.standard_error(halves, &[0.0; 4], together).unwrap()
        };
        assert_relative_eq!(error(1), 0.25f64.hypot(0.5), max_relative = 1e-14);
        assert_relative_eq!(error(2), 0.75, max_relative = 1e-14);
        assert_relative_eq!(error(3), 0.75, max_relative = 1e-14);
        let one = [1.0f64];
        assert!(L2.standard_error([&[1e200], &[-1e200]], &one, 1).is_err());
        assert!(L2.standard_error([&one, &one], &one, 0).is_err());
        assert!(L2.standard_error([&one, &[]], &one, 1).is_err());
    }

    /// The error that is said is the spread of losses, at the optimum and away from it.
    #[test]
    fn standard_error_is_the_spread_of_losses() {
        let mut state = 1u64;
        let mut normal = || {
            // Sums of twelve uniform numbers.
            let uniform = (0..12).map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1u64 << 53) as f64
            });
            uniform.sum::<f64>() - 6.0
        };
        for loss in [
            LossKind::L2(L2),
            LossKind::RelativeL2(RelativeL2::default()),
        ] {
            for shift in [0.0, 0.3] {
                let target = [0.5; 24];
                let (runs, mut said) = (4000, 0.0);
                let mut losses = Vec::new();
                for _ in 0..runs {
                    let mut half = || -> Vec<f64> {
                        let pixel = |_| [0.5 + shift + 0.2 * normal(); 3];
                        (0..8).flat_map(pixel).collect()
                    };
                    let (a, b) = (half(), half());
                    let mean: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
                    losses.push(loss.value(&mean, &target).unwrap());
                    said += loss.standard_error([&a, &b], &target, 3).unwrap().powi(2);
                }
                let mean = losses.iter().sum::<f64>() / f64::from(runs);
                let variance = losses.iter().map(|l| (l - mean).powi(2)).sum::<f64>();
                // 4000 runs know a variance to 2 or 3 %.
                let ratio = said / variance;
                let expected = if shift == 0.0 { 2.0 } else { 1.0 };
                assert!(
                    (ratio / expected - 1.0).abs() < 0.15,
                    "{loss:?} {shift}: {ratio}"
                );
            }
        }
    }

    #[test]
    fn equal_images_have_no_loss_and_no_gradient() {
        let image = [0.0, -1.0, 3.0, 1e30, -0.0];
        let target = [-0.0, -1.0, 3.0, 1e30, 0.0];
        for loss in all() {
            let mut d_image = [1.0; 5];
            loss.gradient(&image, &target, &mut d_image).unwrap();
            assert_eq!(loss.value(&image, &target).unwrap(), 0.0);
            assert_eq!(d_image, [0.0; 5]);
        }
    }

    #[test]
    fn symmetric_noise_does_not_bias_the_absolute_error() {
        for loss in [
            LossKind::L1(L1),
            LossKind::RelativeL1(RelativeL1::default()),
        ] {
            let mut d = [0.0; 8];
            let noisy = [0.1, -0.1, 0.7, -0.7, 0.01, -0.01, 2.0, -2.0].map(|n| 1.0 + n);
            loss.gradient(&noisy, &[1.0; 8], &mut d).unwrap();
            assert_eq!(d.iter().sum::<f64>(), 0.0);
            assert!(d.iter().all(|d| *d != 0.0));
        }
    }

    #[test]
    fn errors_name_what_was_expected() {
        let loss: LossKind = "l2".parse().unwrap();
        let mut d = [7.0f32; 2];
        let message = |r: Result<(), OptimError>| r.unwrap_err().to_string();
        for (image, target, expected) in [
            (
                &[1.0f32, 2.0][..],
                &[1.0f32][..],
                "target: expected 2 entries, found 1",
            ),
            (&[1.0], &[1.0], "d_image: expected 1 entries, found 2"),
            (&[], &[], "image: expected at least one entry, found none"),
            (
                &[1.0, f32::NAN],
                &[1.0, 1.0],
                "image: expected a finite value, found NaN at index 1",
            ),
            (
                &[1.0, 1.0],
                &[f32::INFINITY, 1.0],
                "target: expected a finite value, found inf at index 0",
            ),
        ] {
            assert_eq!(message(loss.gradient(image, target, &mut d)), expected);
            assert_eq!(d, [7.0; 2]);
        }
        assert_eq!(
            loss.value(&[1e200], &[-1e200]).unwrap_err().to_string(),
            "loss: the result at index 0 exceeds the range of the scalar type"
        );
        assert_eq!(
            "L2".parse::<LossKind>().unwrap_err().to_string(),
            "loss: expected one of l1, l2, relative-l1, relative-l2, log-l2, found `L2`"
        );
        assert!(RelativeL1::new(0.0).is_err() && LogL2::new(f64::NAN).is_err());
        assert_relative_eq!(
            RelativeL2::new(1.0).unwrap().value(&[2.0], &[1.0]).unwrap(),
            0.5
        );
    }

    proptest! {
        #[test]
        fn never_a_panic_nor_a_nan(
            pairs in prop::collection::vec((any::<f64>(), any::<f64>()), 0..4),
        ) {
            let (image, target): (Vec<_>, Vec<_>) = pairs.into_iter().unzip();
            for loss in all() {
                if let Ok(value) = loss.value(&image, &target) {
                    prop_assert!(value >= 0.0 && value.is_finite());
                }
                let mut d_image = image.clone();
                if loss.gradient(&image, &target, &mut d_image).is_ok() {
                    prop_assert!(d_image.iter().all(|d| d.is_finite()));
                }
            }
        }
    }
}
