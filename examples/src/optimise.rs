//! The loop of inverse rendering: render, loss, adjoint image, backpropagate, step [Zeltner 2021, figure
//! 4.2].

use std::ops::Range;

use optim::{
    AnyOptimizer, Constrained, Evaluation, GaussNewton, Loss, LossKind, NormalMatrix, Optimizer,
};
use render::Job;
use render::instances::{
    Direction, Estimator, forward_edges_f32, gauss_newton_f32, hessian_vector_f32, render_f32,
    tangent_f32,
};
use render::integrator::gradient::{Active, Gradient};
use render::integrator::render::{NonFinite, Progress, Rendering};
use render::integrator::second_order;
use render::params::Theta;
use render::sampler::mix64;
use render::{Image, RenderError, Scene, Settings};
use serde::{Deserialize, Serialize};

use crate::cli::ToolError;
use crate::solved::Walks;

/// A scene with unknown parameters, and what they are judged by.
#[derive(Debug)]
pub struct Problem {
    /// The scene; its unknowns hold the values of the last [`Problem::set`].
    pub scene: Scene,
    /// Depths, and samples per pixel of derivatives.
    pub settings: Settings,
    /// Samples per pixel of the images that a step takes its loss of; `None`: as many as of derivatives. Samples of images
    /// cost less, and near the solution it is the noise of images that moves the unknowns.
    pub image_spp: Option<u32>,
    /// The unknowns.
    pub active: Active,
    /// Where the gradient comes from; [`Estimator::Mis`] unless there is a reason.
    pub estimator: Estimator,
    /// How images are compared.
    pub loss: LossKind,
    /// What is compared; the loss is the sum over them.
    pub targets: Vec<Target>,
}

/// An image, and what the scene is looked at through to be compared with it.
#[derive(Clone, Debug)]
pub struct Target {
    /// The number of the sensor, see [`Scene::look_through`]; `None`: the one that is looked through already.
    pub sensor: Option<usize>,
    /// What the image is compared with.
    pub image: Image,
}

impl Target {
    /// Through the sensor that the scene is looked at through already.
    pub fn of(image: Image) -> Self {
        Self {
            sensor: None,
            image,
        }
    }
}

/// What a step saw before it moved.
#[derive(Debug)]
pub struct Step {
    /// The loss.
    pub loss: f64,
    /// The images that the loss was taken of, one per view.
    pub seen: Vec<Rendering>,
    /// Derivative of the loss by every pixel and channel of each image.
    pub adjoints: Vec<Vec<f32>>,
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
    /// What walks to solutions came to, in both.
    pub walks: Walks,
}

/// Gauss-Newton matrix and gradient, and what they were taken of.
#[derive(Debug)]
pub struct Curved {
    /// The loss.
    pub loss: f64,
    /// Its standard error, see [`Loss::standard_error`].
    pub loss_error: f64,
    /// The images that the loss was taken of, one per view.
    pub seen: Vec<Rendering>,
    /// Derivatives of the loss by the unknowns.
    pub derivatives: second_order::NormalEquations,
}

/// The gradient of a sum of losses, without what is known of the noise of single views.
fn sum_of(mut sum: Gradient, other: &Gradient) -> Gradient {
    for (sum, other) in sum.values.iter_mut().zip(&other.values) {
        add(sum, other);
    }
    add_non_finite(&mut sum.non_finite, other.non_finite);
    sum.connections.merge(&other.connections);
    sum.glints.merge(&other.glints);
    sum.noise = None;
    sum
}

fn add(sum: &mut [f64], other: &[f64]) {
    sum.iter_mut().zip(other).for_each(|(s, x)| *s += x);
}

fn add_non_finite(sum: &mut NonFinite, other: NonFinite) {
    sum.count += other.count;
    sum.first = sum.first.or(other.first);
}

/// What went wrong in any of these.
fn wrong_in(seen: &[Rendering]) -> NonFinite {
    let mut sum = NonFinite::default();
    seen.iter()
        .for_each(|s| add_non_finite(&mut sum, s.non_finite));
    sum
}

/// What walks came to in any of these.
fn walks_in(seen: &[Rendering]) -> Walks {
    let mut sum = Walks::default();
    seen.iter().for_each(|s| sum.merge(&Walks::of_image(s)));
    sum
}

impl Problem {
    /// A scene that is to look like `target`, with its own settings: the unknowns bear these names, and their gradient comes from
    /// [`Estimator::Mis`].
    ///
    /// # Errors
    /// An unknown name, or a parameter whose derivative that estimator does not see.
    pub fn of(
        scene: Scene,
        names: &[&str],
        loss: LossKind,
        target: Image,
    ) -> Result<Self, RenderError> {
        Ok(Self {
            settings: scene.settings,
            image_spp: None,
            active: Estimator::Mis.active(&scene, names)?,
            estimator: Estimator::Mis,
            loss,
            targets: vec![Target::of(target)],
            scene,
        })
    }

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

    /// The images with their loss, and its derivative with other random numbers: with common ones even
    /// the squared error is biased (errata Z-4.4). `None` if stopped early.
    ///
    /// # Errors
    /// A target that is not of its film's size, or a view through a sensor that the scene does not have.
    pub fn evaluate(
        &mut self,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Step>, ToolError> {
        let mut step: Option<Step> = None;
        for k in 0..self.targets.len() {
            let seeds = self.look_at(k, seeds)?;
            let Some((seen, image)) = self.see(seeds[0], progress) else {
                return Ok(None);
            };
            let target = &self.targets[k].image;
            let loss = self.loss.value(&image.data, &target.data)?;
            let mut adjoint = vec![0.0; image.data.len()];
            (self.loss).gradient(&image.data, &target.data, &mut adjoint)?;
            let gradient = self.estimator.backward_f32(
                &self.job(seeds[1], progress),
                &self.theta(),
                &self.active,
                &adjoint,
            )?;
            if gradient.cancelled {
                return Ok(None);
            }
            step = Some(match step {
                None => Step {
                    loss,
                    seen: vec![seen],
                    adjoints: vec![adjoint],
                    gradient,
                },
                Some(mut sum) => {
                    sum.loss += loss;
                    sum.seen.push(seen);
                    sum.adjoints.push(adjoint);
                    sum.gradient = sum_of(sum.gradient, &gradient);
                    sum
                }
            });
        }
        Ok(step)
    }

    /// Looks through the sensor of a view, and says which random numbers are its own: the first one has those that it
    /// would have alone.
    fn look_at(&mut self, view: usize, seeds: [u64; 2]) -> Result<[u64; 2], RenderError> {
        if let Some(sensor) = self.targets[view].sensor {
            self.scene.look_through(sensor)?;
        }
        Ok(match view {
            0 => seeds,
            _ => seeds.map(|seed| mix64(seed ^ mix64(view as u64))),
        })
    }

    fn image_spp(&self) -> u32 {
        self.image_spp.unwrap_or(self.settings.spp)
    }

    /// The image; `None` if stopped early.
    fn see(&self, seed: u64, progress: &dyn Progress) -> Option<(Rendering, Image)> {
        let seen = self.see_samples(seed, 0..self.image_spp().into(), progress);
        let image = seen.image(0);
        (!seen.cancelled).then_some((seen, image))
    }

    fn see_samples(&self, seed: u64, samples: Range<u64>, progress: &dyn Progress) -> Rendering {
        let job = Job::new(&self.scene, &self.settings, seed, samples, progress);
        render_f32(&job, &self.theta(), Estimator::Mis)
    }

    /// The image from two halves of its samples, and these; `None` if stopped early.
    fn see_halves(
        &self,
        seed: u64,
        progress: &dyn Progress,
    ) -> Option<(Rendering, Image, [Image; 2])> {
        let spp = u64::from(self.image_spp());
        let (half, all) = (spp / 2, spp);
        let mut seen = self.see_samples(seed, 0..half, progress);
        let later = self.see_samples(seed, half..all, progress);
        let halves = [&seen, &later].map(|part| part.image(0));
        seen.merge(&later);
        let image = seen.image(0);
        (!seen.cancelled).then_some((seen, image, halves))
    }

    fn job<'a>(&'a self, seed: u64, progress: &'a dyn Progress) -> Job<'a> {
        Job::new(&self.scene, &self.settings, seed, self.samples(), progress)
    }

    fn theta(&self) -> Theta<'_, f32> {
        Theta::constant(self.scene.params().values())
    }

    fn samples(&self) -> Range<u64> {
        0..self.settings.spp.into()
    }

    /// [`Problem::evaluate`] with the Gauss-Newton matrix of the loss, for up to
    /// [`second_order::MAX_VALUES`] unknowns. Where the loss is concave in a pixel, that pixel is left out. [`Estimator::Edges`],
    /// for what moves, takes a derivative image by each unknown.
    ///
    /// # Errors
    /// As [`Problem::evaluate`]; too many unknowns, or less than two samples per pixel.
    pub fn evaluate_curved(
        &mut self,
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Curved>, ToolError> {
        if self.image_spp() < 2 {
            return Err(RenderError::Count {
                what: "samples per pixel of images",
                expected: "at least 2",
                found: self.image_spp().into(),
            }
            .into());
        }
        let mut curved: Option<Curved> = None;
        for k in 0..self.targets.len() {
            let seeds = self.look_at(k, seeds)?;
            let Some((seen, image, halves)) = self.see_halves(seeds[0], progress) else {
                return Ok(None);
            };
            let (image, target) = (&image.data, &self.targets[k].image.data);
            let loss = self.loss.value(image, target)?;
            let halves = halves.each_ref().map(|half| &half.data[..]);
            let loss_error = self.loss.standard_error(halves, target, 3)?;
            let mut adjoint = vec![0.0; image.len()];
            self.loss.gradient(image, target, &mut adjoint)?;
            let mut weights = vec![0.0; image.len()];
            self.loss.curvature(image, target, &mut weights)?;
            weights.iter_mut().for_each(|w| *w = w.max(0.0));
            let can = self.estimator.capabilities();
            let derivatives = if can.samples_edges && !can.study {
                self.forward_curved(seeds[1], [&adjoint, &weights], progress)?
            } else {
                gauss_newton_f32(
                    &self.job(seeds[1], progress),
                    &self.theta(),
                    &self.active,
                    [&adjoint, &weights],
                )?
            };
            if derivatives.cancelled {
                return Ok(None);
            }
            match &mut curved {
                None => {
                    curved = Some(Curved {
                        loss,
                        loss_error,
                        seen: vec![seen],
                        derivatives,
                    });
                }
                Some(sum) => {
                    sum.loss += loss;
                    sum.loss_error = sum.loss_error.hypot(loss_error);
                    sum.seen.push(seen);
                    add(&mut sum.derivatives.gradient, &derivatives.gradient);
                    add(&mut sum.derivatives.matrix, &derivatives.matrix);
                    add_non_finite(&mut sum.derivatives.non_finite, derivatives.non_finite);
                }
            }
        }
        Ok(curved)
    }

    /// Gradient and Gauss-Newton matrix by derivative images. Products of two of them are of independent samples, half of
    /// them each, so that noise adds nothing in the mean.
    fn forward_curved(
        &self,
        seed: u64,
        [adjoint, weights]: [&[f32]; 2],
        progress: &dyn Progress,
    ) -> Result<second_order::NormalEquations, ToolError> {
        let n = self.active.len();
        if n > second_order::MAX_VALUES {
            return Err(RenderError::Count {
                what: "unknown values",
                expected: "at most 1024",
                found: n as u64,
            }
            .into());
        }
        let mut out = second_order::NormalEquations {
            gradient: vec![0.0; n],
            matrix: vec![0.0; n * n],
            non_finite: NonFinite::default(),
            cancelled: false,
        };
        let params = self.scene.params();
        let mut directions = Vec::new();
        for info in self.active.ranges() {
            for i in 0..info.shape.len() {
                let mut unit = vec![0.0; info.shape.len()];
                unit[i] = 1.0;
                directions.push(Direction::Dense(params.handle(info), unit));
            }
        }
        let seen = forward_edges_f32(&self.job(seed, progress), params.values(), &directions)?;
        out.non_finite = seen.non_finite;
        out.cancelled = seen.cancelled;
        let images: Vec<Vec<f32>> = (1..=n).map(|k| seen.image(k).data).collect();
        let dot = |x: &[f32], y: &[f32]| -> f64 {
            let terms = x.iter().zip(y);
            terms.map(|(x, y)| f64::from(*x) * f64::from(*y)).sum()
        };
        for i in 0..n {
            out.gradient[i] = dot(&images[i], adjoint);
            let terms = images[i].iter().zip(weights);
            let weighed: Vec<f32> = terms.map(|(x, w)| x * w).collect();
            for (j, image) in images[..=i].iter().enumerate() {
                let entry = dot(&weighed, image);
                out.matrix[i * n + j] = entry;
                out.matrix[j * n + i] = entry;
            }
        }
        Ok(out)
    }

    /// The Hessian of the loss times a direction, with one number per unknown; unbiased for squared
    /// errors (see [`second_order`]). `None` if stopped early.
    ///
    /// # Errors
    /// As [`Problem::evaluate`]; a direction of the wrong length.
    pub fn hessian_vector(
        &mut self,
        direction: &[f32],
        seeds: [u64; 2],
        progress: &dyn Progress,
    ) -> Result<Option<Gradient>, ToolError> {
        let mut sum: Option<Gradient> = None;
        for k in 0..self.targets.len() {
            let seeds = self.look_at(k, seeds)?;
            let seen = tangent_f32(
                &self.job(seeds[0], progress),
                self.scene.params().values(),
                &self.active,
                direction,
            )?;
            if seen.cancelled {
                return Ok(None);
            }
            let target = &self.targets[k].image.data;
            let [image, tangent] = [0, 1].map(|k| seen.image(k).data);
            let mut adjoint = vec![0.0; image.len()];
            let mut change = vec![0.0; image.len()];
            self.loss.gradient(&image, target, &mut adjoint)?;
            self.loss.curvature(&image, target, &mut change)?;
            change.iter_mut().zip(&tangent).for_each(|(c, t)| *c *= t);
            let product = hessian_vector_f32(
                &self.job(seeds[1], progress),
                &self.theta(),
                &self.active,
                direction,
                [&adjoint, &change],
            )?;
            if product.cancelled {
                return Ok(None);
            }
            sum = Some(match sum {
                None => product,
                Some(sum) => sum_of(sum, &product),
            });
        }
        Ok(sum)
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
                Ok(step.map(|s| {
                    let mut walks = walks_in(&s.seen);
                    walks.merge(&Walks::of_gradient(&s.gradient));
                    Report {
                        loss: s.loss,
                        non_finite: [wrong_in(&s.seen), s.gradient.non_finite],
                        walks,
                    }
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
                    non_finite: [wrong_in(&curved.seen), derivatives.non_finite],
                    walks: walks_in(&curved.seen),
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
