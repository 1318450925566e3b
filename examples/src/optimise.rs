//! The loop of inverse rendering: render, loss, adjoint image, backpropagate, step [Zeltner 2021, figure
//! 4.2].

use std::ops::Range;

use optim::{Loss, LossKind, Optimizer};
use render::instances::{Technique, backward_f32, render_f32};
use render::integrator::gradient::{Active, Gradient};
use render::integrator::render::{Progress, Rendering};
use render::params::Theta;
use render::{Image, RenderError, Scene, Settings};

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
        let scene = &self.scene;
        let theta = Theta::constant(scene.params().values());
        let technique = Technique::MisPower;
        let settings = &self.settings;
        let samples: Range<u64> = 0..settings.spp.into();
        let seen = render_f32(
            scene,
            &theta,
            technique,
            settings,
            seeds[0],
            samples.clone(),
            progress,
        );
        if seen.cancelled {
            return Ok(None);
        }
        let image = seen.image(0);
        let loss = self.loss.value(&image.data, &self.target.data)?;
        let mut adjoint = vec![0.0; image.data.len()];
        self.loss
            .gradient(&image.data, &self.target.data, &mut adjoint)?;
        let gradient = backward_f32(
            scene,
            &theta,
            &self.active,
            &adjoint,
            settings,
            seeds[1],
            samples,
            progress,
        )?;
        Ok((!gradient.cancelled).then_some(Step {
            loss,
            seen,
            adjoint,
            gradient,
        }))
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
