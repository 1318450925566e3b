//! Second derivatives of image losses: Hessian-vector products and the Gauss-Newton matrix.
//!
//! For a loss that is a sum over the entries of an image, `l(theta) = sum_p phi_p(I_p(theta))`,
//!
//! ```text
//! H = J^T diag(phi'') J + sum_p phi'_p  d2 I_p / d theta2
//! ```
//!
//! [`hessian_vector`] is `H v` for adjoint images `phi'` and `phi'' (J v)`; `J v` is a derivative image.
//! [`gauss_newton`] is the first term, written out, with the gradient.
//!
//! # Derivatives
//! Samples, densities and weights are constants (detached), in the first and the second derivative:
//! the estimate is the integrand's second derivative over a density that does not move, right for
//! the same reasons. Paths are recorded with plain numbers and evaluated once more over
//! `Dual<Dual<P, 1>, 8>`: the inner tangent along `v`, the outer ones in eight texels at a time. No
//! ray is traced for it.
//!
//! # Noise and bias
//! A product of two estimates is unbiased if they are independent. So `phi'` and `phi'' (J v)` must
//! come from other random numbers than the pass (they may share theirs if `phi''` does not depend
//! on the image: squared errors). `J^T diag(phi'') J` of one set of samples would count their
//! covariance over n on top, which is positive: a pixel's `(sum_s j_s)(sum_s j_s)^T` is therefore
//! taken without its terms of equal samples, and divided by `n (n - 1)`. It uses all other pairs,
//! has the right expectation, and may have a negative eigenvalue where noise rules.
//!
//! # Does not handle
//! Geometry, deltas in the parameter, estimators other than detached MIS.
//!
//! ```
//! use render::Job;
//! use render::instances::{Estimator, gauss_newton_f32, render_f32};
//! use render::params::Theta;
//!
//! let room = render::scene::room(16, 16)?;
//! let theta = Theta::constant(room.params().values());
//! let job = |seed| Job::new(&room, &room.settings, seed, 0..16, &());
//! let image = render_f32(&job(0), &theta, Estimator::Mis).image(0);
//! // Half the squared distance to a target that is black: its first derivative, and its second.
//! let n = image.data.len();
//! let active = Estimator::Mis.active(&room, &["left.reflectance.value"])?;
//! let found = gauss_newton_f32(&job(1), &theta, &active, [&image.data, &vec![1.0; n]])?;
//! assert_eq!((found.gradient.len(), found.matrix.len()), (3, 9));
//! assert!(found.diagonal().iter().all(|d| *d > 0.0));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use ad_core::Float;

use super::active::Active;
use super::integrals::check_paths_alone;
use super::job::Job;
use super::pass::Pass;
use super::path::Context;
use super::record::{Recorder, SumSink};
use super::rendering::NonFinite;
use super::sink::{Gradient, Sink, check_size, check_values, collect};
use super::sparse::Sparse;
use super::tile::{Sample, place};
use crate::error::RenderError;
use crate::estimator::DetachedMis;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta};
use crate::sampler::Sampler;
use crate::scene::Caustics;

/// Most values that [`gauss_newton`] writes a matrix for.
pub const MAX_VALUES: usize = 1024;

/// The image is split into this many jobs with a matrix each, whatever the number of threads.
const JOBS: usize = 16;

/// The derivative of the gradient of `<adjoint, image>` with respect to `active` when the
/// parameters move along `direction` and the adjoint by `adjoint_tangent`: with `adjoint = phi'`
/// and `adjoint_tangent = phi'' (J direction)` the Hessian of the loss times the direction.
///
/// `direction` has one number per value of `active`, range after range; the images are
/// `[height][width][3]`. With equal random numbers the product is symmetric to rounding as long as
/// the adjoint does not move.
///
/// Memory: as the gradient. The result depends on the arguments only, not on the number of threads.
///
/// # Errors
/// Values, images or a direction of the wrong size, or parameters that move something.
pub fn hessian_vector<P: Float, X: Sampler>(
    job: &Job,
    theta: &Theta<P>,
    active: &Active,
    direction: &[P],
    [adjoint, adjoint_tangent]: [&[f32]; 2],
) -> Result<Gradient, RenderError> {
    let &Job {
        scene, progress, ..
    } = job;
    check_values(scene, theta)?;
    check_size("adjoint image", scene, adjoint)?;
    check_size("tangent of the adjoint image", scene, adjoint_tangent)?;
    active.check_motion::<DetachedMis>()?;
    if direction.len() != active.len() {
        return Err(RenderError::WrongLength {
            what: "direction",
            expected: active.len(),
            found: direction.len(),
        });
    }
    check_paths_alone(job.settings, "second derivatives")?;
    let pass = Pass::new(job, theta, Caustics::Paths);
    let along = |p: ParamRef, element: u32| {
        let place = active.place(p).map(|at| at + element as usize);
        place.map_or(P::zero(), |i| direction[i])
    };
    let each = |_: &Context<P>, at: Sample, path: &mut Recorder<'_, P>, sink: &mut Sink| {
        let scale = P::of(at.scale());
        let d = [adjoint, adjoint_tangent].map(|a| at.of_image::<P>(a, scene) * scale);
        path.backward_second(scene, theta, along, d, sink);
    };
    let largest = pass.largest(adjoint).max(pass.largest(adjoint_tangent));
    Ok(collect(scene, active, largest, progress, &|large| {
        pass.sums::<DetachedMis, X>(active, large, each)
    }))
}

/// Gradient and Gauss-Newton matrix of a loss.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// The derivative of `<adjoint, image>`, range after range.
    pub gradient: Vec<f64>,
    /// `J^T diag(weights) J`, symmetric, row by row.
    pub matrix: Vec<f64>,
    /// What went wrong.
    pub non_finite: NonFinite,
    /// Whether it was stopped early; the sums are then incomplete.
    pub cancelled: bool,
}

impl NormalEquations {
    /// The Gauss-Newton diagonal.
    pub fn diagonal(&self) -> Vec<f64> {
        let stride = self.gradient.len() + 1;
        self.matrix.iter().step_by(stride).copied().collect()
    }
}

/// The gradient of `<adjoint, image>` and `J^T diag(weights) J`, unbiased, where `J` is the
/// derivative of the mean over the samples with respect to the values of `active`: one pass over
/// recorded paths, in which every path is pulled back once per channel.
///
/// `adjoint` and `weights` are `[height][width][3]`: the first and the second derivative of the
/// loss by the image.
///
/// Memory: 16 halves of the matrix, of 8 bytes per entry. The result depends on the arguments only,
/// not on the number of threads.
///
/// # Errors
/// Values or images of the wrong size, more than [`MAX_VALUES`] values, fewer than two samples, or parameters that move
/// something.
pub fn gauss_newton<P: Float, X: Sampler>(
    job: &Job,
    theta: &Theta<P>,
    active: &Active,
    [adjoint, weights]: [&[f32]; 2],
) -> Result<NormalEquations, RenderError> {
    let &Job {
        scene, progress, ..
    } = job;
    check_values(scene, theta)?;
    check_size("adjoint image", scene, adjoint)?;
    check_size("weights", scene, weights)?;
    active.check_motion::<DetachedMis>()?;
    let n = active.len();
    if n > MAX_VALUES {
        return Err(RenderError::Count {
            what: "unknown values of a Gauss-Newton matrix",
            expected: "at most 1024",
            found: n as u64,
        });
    }
    check_paths_alone(job.settings, "second derivatives")?;
    let pass = Pass::new(job, theta, Caustics::Paths);
    let spp = pass.samples.end.saturating_sub(pass.samples.start);
    if spp < 2 {
        return Err(RenderError::Count {
            what: "samples per pixel of a Gauss-Newton matrix",
            expected: "at least 2",
            found: spp,
        });
    }
    let at = |image: &[f32], pixel: usize, c: usize| f64::from(image[pixel * 3 + c]);
    // What a pair of samples counts.
    let pairs = |pixel: usize, c: usize| {
        let count = pass.count(pixel) as f64;
        at(weights, pixel, c) / (count * (count - 1.0))
    };
    let each = |_: &Context<P>, sample: Sample, path: &mut Recorder<'_, P>, sums: &mut JobSums| {
        let pixel = place(scene, sample.pixel);
        sums.go_to(pixel, pairs);
        for c in 0..3 {
            let mut d = [P::zero(); 3];
            d[c] = P::of(sample.weight);
            path.backward::<DetachedMis>(scene, theta, Rgb::from(d), &mut sums.sample);
            sums.add_sample(
                c,
                at(adjoint, pixel, c) / sample.count as f64,
                -pairs(pixel, c),
            );
        }
    };
    let new = || JobSums::new(active);
    let (parts, non_finite) = pass.paths::<DetachedMis, X, _>(active, JOBS, new, each);
    let mut gradient = vec![0.0; n];
    let mut lower = vec![0.0; n * (n + 1) / 2];
    for mut part in parts {
        part.flush(pairs);
        gradient
            .iter_mut()
            .zip(&part.gradient)
            .for_each(|(g, p)| *g += p);
        lower.iter_mut().zip(&part.lower).for_each(|(m, p)| *m += p);
    }
    let entry = |k: usize| lower[below(k / n, k % n)];
    Ok(NormalEquations {
        gradient,
        matrix: (0..n * n).map(entry).collect(),
        non_finite,
        cancelled: progress.cancelled(),
    })
}

/// Where an entry of a symmetric matrix is kept.
#[inline]
fn below(i: usize, j: usize) -> usize {
    let (i, j) = (i.max(j), i.min(j));
    i * (i + 1) / 2 + j
}

/// The derivative of one channel of one sample.
struct Row<'a> {
    active: &'a Active,
    derivative: Sparse,
}

impl<P: Float> GradSink<P> for Row<'_> {
    #[inline]
    fn active(&self, p: ParamRef) -> bool {
        self.active.contains(p)
    }
    #[inline]
    fn add(&mut self, p: ParamRef, i: usize, d: P) {
        if let Some(at) = self.active.place(p) {
            self.derivative.add(at + i, d.to_f64());
        }
    }
}

impl SumSink for Row<'_> {}

/// The sums of one job.
struct JobSums<'a> {
    sample: Row<'a>,
    /// The pixel that samples are being added to, and the sums of their derivatives per channel.
    pixel: Option<usize>,
    channels: [Sparse; 3],
    gradient: Vec<f64>,
    lower: Vec<f64>,
}

impl<'a> JobSums<'a> {
    fn new(active: &'a Active) -> Self {
        let n = active.len();
        Self {
            sample: Row {
                active,
                derivative: Sparse::new(n),
            },
            pixel: None,
            channels: std::array::from_fn(|_| Sparse::new(n)),
            gradient: vec![0.0; n],
            lower: vec![0.0; n * (n + 1) / 2],
        }
    }

    /// Samples of `pixel` follow.
    fn go_to(&mut self, pixel: usize, weight: impl Fn(usize, usize) -> f64) {
        if self.pixel != Some(pixel) {
            self.flush(weight);
            self.pixel = Some(pixel);
        }
    }

    /// Adds the pixel's square, all pairs of samples.
    fn flush(&mut self, weight: impl Fn(usize, usize) -> f64) {
        let Some(pixel) = self.pixel.take() else {
            return;
        };
        for (c, sum) in self.channels.iter_mut().enumerate() {
            add_square(&mut self.lower, sum, weight(pixel, c));
            sum.clear();
        }
    }

    /// Adds the derivative of channel `c` of a sample to gradient and pixel, and its square, which is to be
    /// left out of the pixel's, with a negative weight.
    fn add_sample(&mut self, c: usize, adjoint: f64, own: f64) {
        let j = &mut self.sample.derivative;
        for &i in &j.touched {
            let x = j.values[i as usize];
            self.gradient[i as usize] += adjoint * x;
            self.channels[c].add(i as usize, x);
        }
        add_square(&mut self.lower, j, own);
        j.clear();
    }
}

/// Adds `weight v v^T`.
fn add_square(lower: &mut [f64], v: &Sparse, weight: f64) {
    for (k, &i) in v.touched.iter().enumerate() {
        let x = weight * v.values[i as usize];
        for &j in &v.touched[..=k] {
            lower[below(i as usize, j as usize)] += x * v.values[j as usize];
        }
    }
}
