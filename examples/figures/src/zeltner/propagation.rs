//! Derivatives sent forward from the parameters and backward from the image [Zeltner 2021, figures 4.4 and
//! 4.5]: the same linear map and its transpose.

use ad_core::Dual;
use optim::{Loss, LossKind};
use render::Job;
use render::estimator::{Detached, DetachedWeights, Mis, Power};
use render::instances::{
    Direction, Estimator, backward_f32, backward_f64, forward_f32, render_f32,
};
use render::integrator::gradient::Active;
use render::integrator::render::{Rendering, render};
use render::params::{Tangent, Theta};
use render::sampler::Independent;
use render::statistics::{Estimate, z_limit};
use render::{Image, Scene, Settings};

use crate::common_scenes::chess;
use examples::figure::{Figure, Result};
use examples::memory;

pub(super) const NAME: &str = "bishop.reflectance.value";
/// Change of the bishop's colour that is followed.
pub(super) const CHANGE: [f64; 3] = [0.2, -0.1, 0.3];
pub(super) const SEED: u64 = 44;
/// Independent runs behind every standard error.
pub(super) const RUNS: u64 = 16;

pub(super) struct Board {
    pub(super) scene: Scene,
    /// What the loss compares with: the same board with another bishop.
    pub(super) target: Image,
    pub(super) image: Image,
    /// Derivative of the loss by the image.
    pub(super) adjoint: Vec<f32>,
    pub(super) spp: u64,
}

pub(super) fn board(fig: &mut Figure) -> Result<Board> {
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
        let job = Job::new(&scene, &scene.settings, seed, 0..spp, &());
        render_f32(&job, &theta, Estimator::Mis).image(0)
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
    pub(super) fn forward(&self, seed: u64) -> Result<Rendering> {
        let settings = &self.scene.settings;
        push_f64(&self.scene, NAME, &CHANGE, settings, seed, self.spp)
    }

    /// <adjoint, J d> of sums over samples.
    pub(super) fn against_adjoint(&self, sums: &[f64]) -> f64 {
        let products = sums.iter().zip(&self.adjoint);
        products.map(|(s, &a)| s * f64::from(a)).sum::<f64>() / self.spp as f64
    }

    /// J^T adjoint, in double precision.
    pub(super) fn gradient(&self, seed: u64) -> Result<Vec<f64>> {
        let params = self.scene.params();
        let values: Vec<f64> = params.values().iter().map(|&v| v.into()).collect();
        let theta = Theta::constant(&values);
        let active = Active::new(&self.scene, &[NAME])?;
        let gradient = backward_f64(
            &Job::new(&self.scene, &self.scene.settings, seed, 0..self.spp, &()),
            &theta,
            &active,
            &self.adjoint,
        )?;
        Ok(gradient.values.concat())
    }

    /// <J^T adjoint, d>, in single precision.
    pub(super) fn pulled_f32(&self, seed: u64) -> Result<f64> {
        let theta = Theta::constant(self.scene.params().values());
        let active = Active::new(&self.scene, &[NAME])?;
        let gradient = backward_f32(
            &Job::new(&self.scene, &self.scene.settings, seed, 0..self.spp, &()),
            &theta,
            &active,
            &self.adjoint,
        )?;
        Ok(along(&gradient.values.concat()))
    }

    /// The derivative image in single precision.
    pub(super) fn derivative(&self, seed: u64) -> Result<Rendering> {
        let params = self.scene.params();
        let handle = params.handle(params.find(NAME)?);
        let direction = Direction::Dense(handle, CHANGE.map(|d| d as f32).to_vec());
        Ok(forward_f32(
            &Job::new(&self.scene, &self.scene.settings, seed, 0..self.spp, &()),
            params.values(),
            &[direction],
        )?)
    }

    /// Checks the identities between forward and reverse mode that both figures show.
    pub(super) fn identities(&self, fig: &mut Figure) -> Result {
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
        let of = |i: usize| Estimate::of(&runs.iter().map(|r| r[i]).collect::<Vec<_>>());
        let (f, b) = (of(0), of(1));
        let (z, limit) = (f.z(&b), z_limit(1, RUNS, 1e-2));
        fig.check(
            "<dI, J dpi> = <J^T dI, dpi> with independent seeds, within chance",
            z.abs() < limit,
            format!(
                "{:.6e} +- {:.1e} and {:.6e} +- {:.1e} ({RUNS} seeds each): z = {z:.2}, limit {limit:.2}",
                f.mean, f.se, b.mean, b.se
            ),
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
    render::<Real, Strategy, Independent>(&Job::new(scene, settings, seed, 0..spp, &()), &theta)
        .map_err(Into::into)
}

pub(super) fn along(gradient: &[f64]) -> f64 {
    gradient.iter().zip(CHANGE).map(|(g, d)| g * d).sum()
}

pub(super) fn list(values: &[f64]) -> String {
    let texts: Vec<String> = values.iter().map(|v| format!("{v:.6e}")).collect();
    texts.join(", ")
}

/// Mean of the channels of each pixel.
pub(super) fn grey(data: impl IntoIterator<Item = f64>) -> Vec<f64> {
    let data: Vec<f64> = data.into_iter().collect();
    data.chunks_exact(3)
        .map(|p| p.iter().sum::<f64>() / 3.0)
        .collect()
}

/// Per pixel, whether its middle shows the bishop.
pub(super) fn bishop(scene: &Scene) -> Vec<bool> {
    let [width, height] = scene.film.crop_size;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x, y]));
    let seen = pixels.map(|p| {
        let [x, y] = p.map(|p| p as f32 + 0.5);
        let hit = scene.intersect(&scene.camera.ray(x, y));
        hit.is_some_and(|h| scene.shape_info(h.shape).name == "bishop")
    });
    seen.collect()
}

/// Checks that the memory of a pass on one thread does not grow with its samples per pixel. The peaks in KiB.
///
/// # Errors
/// Those of the pass.
pub(super) fn memory_stays(
    fig: &mut Figure,
    ladder: &[u64],
    pass: impl Fn(u64) -> std::result::Result<(), String> + Sync,
) -> Result<Vec<f64>> {
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut peaks = Vec::new();
    for &spp in ladder {
        let (done, bytes) = memory::peak(|| alone.install(|| pass(spp)));
        done?;
        peaks.push(bytes as f64 / 1024.0);
    }
    let least = peaks.iter().fold(f64::INFINITY, |m, p| m.min(*p));
    let most = peaks.iter().fold(0.0f64, |m, p| m.max(*p));
    fig.check(
        "memory does not grow with the samples: within 5 %",
        least > 0.0 && most < 1.05 * least,
        format!(
            "{least:.0} to {most:.0} KiB for {} to {} samples per pixel",
            ladder[0],
            ladder[ladder.len() - 1]
        ),
    );
    Ok(peaks)
}
