//! Derivatives sent forward from the parameters and backward from the image [Zeltner 2021, figures 4.4 and
//! 4.5]: the same linear map and its transpose.

use ad_core::Dual;
use optim::{Loss, LossKind};
use render::estimator::{Detached, DetachedWeights, Mis, Power};
use render::instances::{
    Direction, Estimator, backward_f32, backward_f64, forward_f32, render_f32,
};
use render::integrator::gradient::Active;
use render::integrator::render::{Rendering, render};
use render::params::{Tangent, Theta};
use render::sampler::Independent;
use render::{Image, Scene, Settings};

use crate::chart::Panel;
use crate::figure::{Figure, Result};
use crate::figures::stage::chess;

const NAME: &str = "bishop.reflectance.value";
/// Change of the bishop's colour that is followed.
const CHANGE: [f64; 3] = [0.2, -0.1, 0.3];
const SEED: u64 = 44;
/// Independent runs behind every standard error.
const RUNS: u64 = 16;

struct Board {
    scene: Scene,
    /// What the loss compares with: the same board with another bishop.
    target: Image,
    image: Image,
    /// Derivative of the loss by the image.
    adjoint: Vec<f32>,
    spp: u64,
}

fn board(fig: &mut Figure) -> Result<Board> {
    let size = fig.pick([64, 48], [192, 144]);
    let spp = fig.pick(16, 64);
    fig.note("spp", spp);
    fig.note("seed", SEED);
    fig.note("direction", CHANGE.to_vec());
    let scene = chess(size, 5)?;
    let info = scene.params().find(NAME)?.clone();
    let mut other = scene.params().values().to_vec();
    for (v, d) in other[info.range()].iter_mut().zip(CHANGE) {
        *v += d as f32;
    }
    let shot = |values: &[f32], seed| {
        let theta = Theta::constant(values);
        let technique = Estimator::Mis;
        render_f32(
            &scene,
            &theta,
            technique,
            &scene.settings,
            seed,
            0..spp,
            &(),
        )
        .image(0)
    };
    let target = shot(&other, SEED + 1);
    let image = shot(scene.params().values(), SEED + 2);
    let mut adjoint = vec![0.0; image.data.len()];
    "l2".parse::<LossKind>()?
        .gradient(&image.data, &target.data, &mut adjoint)?;
    Ok(Board {
        scene,
        target,
        image,
        adjoint,
        spp,
    })
}

impl Board {
    /// J d in double precision: image and derivative image.
    fn forward(&self, seed: u64) -> Result<Rendering> {
        let settings = &self.scene.settings;
        push_f64(&self.scene, NAME, &CHANGE, settings, seed, self.spp)
    }

    /// <adjoint, J d> of sums over samples.
    fn against_adjoint(&self, sums: &[f64]) -> f64 {
        let products = sums.iter().zip(&self.adjoint);
        products.map(|(s, &a)| s * f64::from(a)).sum::<f64>() / self.spp as f64
    }

    /// J^T adjoint, in double precision.
    fn gradient(&self, seed: u64) -> Result<Vec<f64>> {
        let params = self.scene.params();
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let theta = Theta::constant(&values);
        let active = Active::new(&self.scene, &[NAME])?;
        let gradient = backward_f64(
            &self.scene,
            &theta,
            &active,
            &self.adjoint,
            &self.scene.settings,
            seed,
            0..self.spp,
            &(),
        )?;
        Ok(gradient.values.concat())
    }

    /// <J^T adjoint, d>, in single precision.
    fn pulled_f32(&self, seed: u64) -> Result<f64> {
        let theta = Theta::constant(self.scene.params().values());
        let active = Active::new(&self.scene, &[NAME])?;
        let gradient = backward_f32(
            &self.scene,
            &theta,
            &active,
            &self.adjoint,
            &self.scene.settings,
            seed,
            0..self.spp,
            &(),
        )?;
        Ok(along(&gradient.values.concat()))
    }

    /// The derivative image in single precision.
    fn derivative(&self, seed: u64) -> Result<Rendering> {
        let params = self.scene.params();
        let handle = params.handle(params.find(NAME)?);
        let direction = Direction::Dense(handle, CHANGE.map(|d| d as f32).to_vec());
        Ok(forward_f32(
            &self.scene,
            params.values(),
            &[direction],
            &self.scene.settings,
            seed,
            0..self.spp,
            &(),
        )?)
    }

    /// The identities of both figures.
    fn identities(&self, fig: &mut Figure) -> Result {
        let forward = self.forward(SEED)?;
        let pushed = self.against_adjoint(&forward.sums[1]);
        let gradient = self.gradient(SEED)?;
        let pulled = along(&gradient);
        let relative = (pushed - pulled).abs() / pulled.abs();
        fig.check(
            "<dI, J dpi> = <J^T dI, dpi> with the same seeds: 1e-6 in f64",
            relative < 1e-6 && forward.non_finite.count == 0,
            format!("{pushed:.12e} and {pulled:.12e}: {relative:.1e} relative"),
        );
        let mut worst: f64 = 0.0;
        for c in 0..3 {
            let products = forward.sums[1].iter().zip(&self.adjoint);
            let channel = products.skip(c).step_by(3);
            let sum: f64 = channel.map(|(s, &a)| s * f64::from(a)).sum();
            let sum = sum / (self.spp as f64 * CHANGE[c]);
            worst = worst.max((sum - gradient[c]).abs() / gradient[c].abs());
        }
        fig.check(
            "gradient image times adjoint image sums to the parameter gradient, per channel",
            worst < 1e-6,
            format!("{}, worst {worst:.1e} relative", list(&gradient)),
        );

        let mut runs = Vec::new();
        for k in 0..RUNS {
            let rendering = self.derivative(1000 + k)?;
            runs.push([
                self.against_adjoint(&rendering.sums[1]),
                self.pulled_f32(2000 + k)?,
            ]);
        }
        let [(f, ef), (b, eb)] = [0, 1].map(|i: usize| mean_and_error(runs.iter().map(|r| r[i])));
        let z = (f - b) / ef.hypot(eb);
        fig.check(
            "<dI, J dpi> = <J^T dI, dpi> with independent seeds: 3 standard errors",
            z.abs() < 3.0,
            format!("{f:.6e} +- {ef:.1e} and {b:.6e} +- {eb:.1e} ({RUNS} seeds each): z = {z:.2}"),
        );
        let rows = runs.iter().enumerate();
        let rows = rows.map(|(k, r)| [k as f64, r[0], r[1]]);
        fig.csv("independent", &["run", "forward", "reverse"], rows);
        fig.csv(
            "gradient",
            &["red", "green", "blue", "along", "forward"],
            [[gradient[0], gradient[1], gradient[2], pulled, pushed]],
        );
        Ok(())
    }
}

/// Image and derivative image in double precision, along `direction` in the parameter `name`: forward mode,
/// detached MIS.
pub(super) fn push_f64(
    scene: &Scene,
    name: &str,
    direction: &[f64],
    settings: &Settings,
    seed: u64,
    spp: u64,
) -> Result<Rendering> {
    type Real = Dual<f64, 1>;
    type Strategy = Mis<Detached, Detached, DetachedWeights, Power>;
    let params = scene.params();
    let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
    let mut tangents = vec![Tangent::None; params.infos().len()];
    let handle = params.handle(params.find(name)?);
    let dense = direction.iter().map(|d| Real::new(0.0, [*d])).collect();
    tangents[handle.id as usize] = Tangent::Dense(dense);
    let theta = Theta::<Real>::with_tangents(&values, &tangents);
    render::<Real, Strategy, Independent>(scene, &theta, settings, seed, 0..spp, &())
        .map_err(Into::into)
}

fn along(gradient: &[f64]) -> f64 {
    gradient.iter().zip(CHANGE).map(|(g, d)| g * d).sum()
}

fn list(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|v| format!("{v:.6e}")).collect();
    texts.join(", ")
}

/// Mean, and its standard error.
fn mean_and_error(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let square: f64 = values.map(|v| (v - mean).powi(2)).sum();
    (mean, (square / (n - 1.0) / n).sqrt())
}

/// Mean of the channels of each pixel.
fn grey(data: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let data: Vec<f64> = data.into_iter().collect();
    data.chunks_exact(3)
        .map(|p| p.iter().sum::<f64>() / 3.0)
        .collect()
}

/// Per pixel, whether its middle shows the bishop.
fn bishop(scene: &Scene) -> Vec<bool> {
    let [width, height] = scene.film.crop_size;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    let seen = pixels.map(|p| {
        let [x, y] = p.map(|p| p as f32 + 0.5);
        let hit = scene.intersect(&scene.camera.ray(x, y));
        hit.is_some_and(|h| scene.shape_info(h.shape).name == "bishop")
    });
    seen.collect()
}

/// `zeltner-4-4`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn forward(fig: &mut Figure) -> Result {
    let board = board(fig)?;
    board.identities(fig)?;
    let rendering = board.derivative(SEED)?;

    // Differences of images with the same samples; the image is a polynomial in the colour.
    let step = 0.05;
    let info = board.scene.params().find(NAME)?.clone();
    let moved = |sign: f32| {
        let mut values = board.scene.params().values().to_vec();
        for (v, d) in values[info.range()].iter_mut().zip(CHANGE) {
            *v += sign * step * d as f32;
        }
        let theta = Theta::constant(&values);
        let settings = &board.scene.settings;
        let technique = Estimator::Mis;
        let samples = 0..board.spp;
        render_f32(
            &board.scene,
            &theta,
            technique,
            settings,
            SEED,
            samples,
            &(),
        )
    };
    let (plus, minus) = (moved(1.0), moved(-1.0));
    let n = board.spp as f64;
    let pairs = plus.sums[0].iter().zip(&minus.sums[0]);
    let difference: Vec<f64> = pairs
        .map(|(p, m)| (p - m) / (2.0 * f64::from(step) * n))
        .collect();
    let derivative: Vec<f64> = rendering.sums[1].iter().map(|s| s / n).collect();
    let norm = |x: &mut dyn Iterator<Item = f64>| x.map(|x| x * x).sum::<f64>().sqrt();
    let mut errors = difference.iter().zip(&derivative).map(|(a, b)| a - b);
    let error = norm(&mut errors) / norm(&mut derivative.iter().copied());
    fig.check(
        "the derivative image equals central differences with common samples",
        error < 0.01,
        format!("relative L2 distance {error:.1e}, step {step} of the change"),
    );

    let shown = bishop(&board.scene);
    let colour = grey(derivative.iter().map(|d| d.abs()));
    let sum = |inside: bool| -> f64 {
        let chosen = colour.iter().zip(&shown).filter(|(_, s)| **s == inside);
        chosen.map(|(c, _)| c).sum()
    };
    let reached = colour
        .iter()
        .zip(&shown)
        .filter(|(c, s)| !**s && **c > 1e-4);
    let reached = reached.count();
    let others = shown.iter().filter(|s| !**s).count();
    let (on, off) = (sum(true), sum(false));
    fig.check(
        "differential radiance is emitted by the bishop and scattered by everything else",
        on > off && off > 0.01 * on && reached * 10 > others,
        format!(
            "{:.1} % of it on the bishop; {reached} of {others} other pixels above 1e-4",
            100.0 * on / (on + off)
        ),
    );

    let width = board.image.width;
    let enlarge = fig.pick(4, 2);
    let colours = |k: usize| {
        derivative
            .iter()
            .skip(k)
            .step_by(3)
            .copied()
            .collect::<Vec<_>>()
    };
    let panel = |label: &str, values: &[f64], scale| {
        Panel::signed(label, width, values, scale).enlarged(enlarge)
    };
    let panels = [
        Panel::tonemapped("image", &board.image, 1.0).enlarged(enlarge),
        panel("derivative, red", &colours(0), None),
        panel("derivative, green", &colours(1), None),
        panel("red, scattered light: scale / 10", &colours(0), Some(0.01)),
    ];
    fig.images("forward", 2, &panels);
    Ok(())
}

/// `zeltner-4-5`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn reverse(fig: &mut Figure) -> Result {
    let board = board(fig)?;
    board.identities(fig)?;
    let gradient = board.gradient(SEED)?;
    let signs = gradient.iter().zip(CHANGE).all(|(g, d)| g * d < 0.0);
    fig.check(
        "the adjoint pass says which way to change the bishop: towards the target in every channel",
        signs,
        format!(
            "gradient {}, change that would fit {CHANGE:?}",
            list(&gradient)
        ),
    );
    let width = board.image.width;
    let enlarge = fig.pick(4, 2);
    let adjoint = |c: usize| -> Vec<f64> {
        let channel = board.adjoint.iter().skip(c).step_by(3);
        channel
            .map(|&a| f64::from(a) * board.adjoint.len() as f64)
            .collect()
    };
    // Where in the image the gradient comes from: its summands.
    let derivative = board.derivative(SEED)?;
    let products = derivative.sums[1].iter().zip(&board.adjoint);
    let n = board.spp as f64;
    let products = products.map(|(s, &a)| s / n * f64::from(a) * board.adjoint.len() as f64);
    let products = grey(products);
    let panels = [
        Panel::tonemapped("image", &board.image, 1.0).enlarged(enlarge),
        Panel::tonemapped("target", &board.target, 1.0).enlarged(enlarge),
        Panel::signed("adjoint image sent in, red", width, &adjoint(0), None).enlarged(enlarge),
        Panel::signed("adjoint times derivative", width, &products, None).enlarged(enlarge),
    ];
    fig.images("reverse", 2, &panels);
    Ok(())
}
