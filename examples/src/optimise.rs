//! The loop of inverse rendering: render, loss, adjoint image, backpropagate, step [Zeltner 2021, figure
//! 4.2].

use std::ops::Range;

use optim::{
    AnyOptimizer, Constrained, Evaluation, GaussNewton, Loss, LossKind, NormalMatrix, Optimizer,
};
use render::Job;
use render::instances::{Estimator, gauss_newton_f32, hessian_vector_f32, render_f32, tangent_f32};
use render::integrator::gradient::{Active, Gradient};
use render::integrator::render::{NonFinite, Progress, Rendering};
use render::integrator::second_order;
use render::params::Theta;
use render::{Image, RenderError, Scene, Settings};
use serde::{Deserialize, Serialize};

use crate::cli::ToolError;

/// A scene with unknown parameters, and what they are judged by.
#[derive(Debug)]
pub struct Problem {
    /// The scene; its unknowns hold the values of the last [`Problem::set`].
    pub scene: Scene,
    /// Depths and samples per pixel of one step.
    pub settings: Settings,
    /// The unknowns.
    pub active: Active,
    /// Where the gradient comes from; [`Estimator::Mis`] unless there is a reason.
    pub estimator: Estimator,
    /// How images are compared.
    pub loss: LossKind,
    /// What the image is compared with.
    pub target: Image,
}

/// What a step saw before it moved.
#[derive(Debug)]
pub struct Step {
    /// The loss.
    pub loss: f64,
    /// The image that the loss was taken of.
    pub seen: Rendering,
    /// Derivative of the loss by every pixel and channel of the image.
    pub adjoint: Vec<f32>,
    /// Derivative of the loss by the unknowns.
    pub gradient: Gradient,
}

/// What moves the unknowns, with all that it remembers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// By the gradient.
    FirstOrder(Constrained<AnyOptimizer<f32>, f32>),
    /// By the gradient and the Gauss-Newton matrix.
    GaussNewton(GaussNewton<f32>),
}

/// What is reported of a step of any [`Algorithm`].
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// The loss before it.
    pub loss: f64,
    /// What went wrong in the image and in the pass of derivatives.
    pub non_finite: [NonFinite; 2],
}

/// Gauss-Newton matrix and gradient, and what they were taken of.
#[derive(Debug)]
pub struct Curved {
    /// The loss.
    pub loss: f64,
    /// Its standard error, see [`Loss::standard_error`].
    pub loss_error: f64,
    /// The image that the loss was taken of.
    pub seen: Rendering,
    /// Derivatives of the loss by the unknowns.
    pub derivatives: second_order::NormalEquations,
}

impl Problem {
    /// Values of the unknowns, in the order of the active set.
    pub fn values(&self) -> Vec<f32> {
        let all = self.scene.params().values();
        let ranges = self.active.ranges().iter();
        ranges.flat_map(|r| &all[r.range()]).copied().collect()
    }

    /// Gives the unknowns their values.
    ///
    /// # Errors
    /// A value out of its range.
    pub fn set(&mut self, values: &[f32]) -> Result<(), RenderError> {
        let mut all = self.scene.params().values().to_vec();
        if values.len() != self.active.len() {
            return Err(RenderError::WrongLength {
                what: "vector of unknowns",
                expected: self.active.len(),
                found: values.len(),
            });
        }
        let mut at = 0;
        for range in self.active.ranges().iter().map(|r| r.range()) {
            let n = range.len();
            all[range].copy_from_slice(&values[at..at + n]);
            at += n;
        }
        self.scene.set_params(&all)
    }

    /// The image with its loss, and its derivative with other random numbers: with common ones even
    /// the squared error is biased (errata Z-4.4). `None` if stopped early.
    ///
    /// # Errors
    /// A target that is not of the film's size.
    pub fn evaluate(
        &self,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Step>, ToolError> {
        let Some((seen, image)) = self.see(seeds[0], progress) else {
            return Ok(None);
        };
        let loss = self.loss.value(&image.data, &self.target.data)?;
        let mut adjoint = vec![0.0; image.data.len()];
        self.loss
            .gradient(&image.data, &self.target.data, &mut adjoint)?;
        let gradient = self.estimator.backward_f32(
            &Job::new(
                &self.scene,
                &self.settings,
                seeds[1],
                self.samples(),
                progress,
            ),
            &self.theta(),
            &self.active,
            &adjoint,
        )?;
        Ok((!gradient.cancelled).then_some(Step {
            loss,
            seen,
            adjoint,
            gradient,
        }))
    }

    fn theta(&self) -> Theta<'_, f32> {
        Theta::constant(self.scene.params().values())
    }

    fn samples(&self) -> Range<u64> {
        0..self.settings.spp.into()
    }

    /// The image; `None` if stopped early.
    fn see(&self, seed: u64, progress: &dyn Progress) -> Option<(Rendering, Image)> {
        let seen = render_f32(
            &Job::new(&self.scene, &self.settings, seed, self.samples(), progress),
            &self.theta(),
            Estimator::Mis,
        );
        let image = seen.image(0);
        (!seen.cancelled).then_some((seen, image))
    }

    /// [`Problem::evaluate`] with the Gauss-Newton matrix of the loss, for up to
    /// [`second_order::MAX_VALUES`] unknowns. Where the loss is concave in a pixel, that pixel is left out.
    ///
    /// # Errors
    /// As [`Problem::evaluate`]; too many unknowns, or less than two samples per pixel.
    pub fn evaluate_curved(
        &self,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Curved>, ToolError> {
        let Some((seen, image)) = self.see(seeds[0], progress) else {
            return Ok(None);
        };
        let (image, target) = (&image.data, &self.target.data);
        let loss = self.loss.value(image, target)?;
        let loss_error = self.loss.standard_error(image, target)?;
        let mut adjoint = vec![0.0; image.len()];
        self.loss.gradient(image, target, &mut adjoint)?;
        let mut weights = vec![0.0; image.len()];
        self.loss.curvature(image, target, &mut weights)?;
        weights.iter_mut().for_each(|w| *w = w.max(0.0));
        let derivatives = gauss_newton_f32(
            &Job::new(
                &self.scene,
                &self.settings,
                seeds[1],
                self.samples(),
                progress,
            ),
            &self.theta(),
            &self.active,
            [&adjoint, &weights],
        )?;
        Ok((!derivatives.cancelled).then_some(Curved {
            loss,
            loss_error,
            seen,
            derivatives,
        }))
    }

    /// The Hessian of the loss times a direction, with one number per unknown; unbiased for squared
    /// errors (see [`second_order`]). `None` if stopped early.
    ///
    /// # Errors
    /// As [`Problem::evaluate`]; a direction of the wrong length.
    pub fn hessian_vector(
        &self,
        direction: &[f32],
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Gradient>, ToolError> {
        let seen = tangent_f32(
            &Job::new(
                &self.scene,
                &self.settings,
                seeds[0],
                self.samples(),
                progress,
            ),
            self.scene.params().values(),
            &self.active,
            direction,
        )?;
        if seen.cancelled {
            return Ok(None);
        }
        let [image, tangent] = [0, 1].map(|k| seen.image(k).data);
        let mut adjoint = vec![0.0; image.len()];
        let mut change = vec![0.0; image.len()];
        self.loss
            .gradient(&image, &self.target.data, &mut adjoint)?;
        self.loss
            .curvature(&image, &self.target.data, &mut change)?;
        change.iter_mut().zip(&tangent).for_each(|(c, t)| *c *= t);
        let product = hessian_vector_f32(
            &Job::new(
                &self.scene,
                &self.settings,
                seeds[1],
                self.samples(),
                progress,
            ),
            &self.theta(),
            &self.active,
            direction,
            [&adjoint, &change],
        )?;
        Ok((!product.cancelled).then_some(product))
    }

    /// Evaluates at `values` and moves them by one step of `algorithm`. `None` if stopped early:
    /// nothing has moved then.
    ///
    /// # Errors
    /// As [`Problem::step`] and [`Problem::evaluate_curved`].
    pub fn advance(
        &mut self,
        values: &mut [f32],
        algorithm: &mut Algorithm,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Report>, ToolError> {
        match algorithm {
            Algorithm::FirstOrder(optimizer) => {
                let step = self.step(values, optimizer, seeds, progress)?;
                Ok(step.map(|s| Report {
                    loss: s.loss,
                    non_finite: [s.seen.non_finite, s.gradient.non_finite],
                }))
            }
            Algorithm::GaussNewton(optimizer) => {
                self.set(values)?;
                let Some(curved) = self.evaluate_curved(seeds, progress)? else {
                    return Ok(None);
                };
                let derivatives = curved.derivatives;
                let gradient: Vec<f32> = derivatives.gradient.iter().map(|&g| g as f32).collect();
                let here = Evaluation {
                    loss: curved.loss,
                    loss_error: curved.loss_error,
                    gradient: &gradient,
                };
                let matrix = NormalMatrix::new(gradient.len(), derivatives.matrix)?;
                optimizer.step(values, &here, &matrix)?;
                Ok(Some(Report {
                    loss: curved.loss,
                    non_finite: [curved.seen.non_finite, derivatives.non_finite],
                }))
            }
        }
    }

    /// Evaluates at `values` and moves them by one step of `optimizer`. `None` if stopped early: nothing
    /// has moved then.
    ///
    /// # Errors
    /// A value out of its range, or a gradient that the optimiser refuses; nothing has moved then, either.
    pub fn step(
        &mut self,
        values: &mut [f32],
        optimizer: &mut impl Optimizer<f32>,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Step>, ToolError> {
        self.set(values)?;
        let Some(step) = self.evaluate(seeds, progress)? else {
            return Ok(None);
        };
        let gradient = step.gradient.values.iter().flatten();
        let gradient: Vec<f32> = gradient.map(|&g| g as f32).collect();
        optimizer.step(values, &gradient)?;
        Ok(Some(step))
    }
}
