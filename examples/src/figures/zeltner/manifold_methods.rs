//! Estimators of manifold connections, compared: the light of chains alone, its noise, and what walks came to.

use std::sync::{Arc, Mutex, PoisonError};

use ad_core::Vec3;
use render::bsdf::{Dielectric, Interpolation, Material, NormalMap};
use render::instances::{Estimator, render_f32};
use render::manifold::Statistics;
use render::math::warp;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::{Connections, Method};
use render::{Job, RenderError, Scene, Settings};

use crate::figure::{Figure, Result};
use crate::figures::statistics::{Series, grey};
use crate::scene_builder::SceneBuilder;

/// Pixels of each side of the blocks in which means are compared.
const BLOCK: usize = 4;

/// The light of chains in a scene, by somebody.
pub struct Measured {
    /// Its image, over independent runs.
    pub series: Series,
    /// What walks came to, over all runs.
    pub found: Statistics,
}

impl Measured {
    /// The part of walks that converged.
    pub fn success(&self) -> f64 {
        self.found.converged as f64 / self.found.walks.max(1) as f64
    }

    /// The part of estimates that found light: of first walks, but for trial sets.
    pub fn lit(&self) -> f64 {
        self.found.found as f64 / self.found.attempts.max(1) as f64
    }

    /// Trials per reciprocal that was estimated.
    pub fn trials(&self) -> f64 {
        self.found.trials as f64 / self.found.reciprocals.max(1) as f64
    }

    /// Mean over the pixels.
    pub fn mean(&self) -> f64 {
        let means = self.series.means();
        means.iter().sum::<f64>() / means.len() as f64
    }

    /// Variance of the mean of all runs, summed over the pixels.
    pub fn variance(&self) -> f64 {
        let each = self.series.pixels.iter().map(|e| e.error * e.error);
        each.sum()
    }
}

/// How often a scene is rendered.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Independent runs.
    pub runs: u64,
    /// Samples per pixel of each.
    pub spp: u64,
    /// Seed of the first.
    pub seed: u64,
}

impl Effort {
    /// Keeps it, and the size of images, beside the results.
    pub fn note(&self, fig: &mut Figure, size: u32) {
        fig.note("size", size);
        fig.note("spp", self.spp);
        fig.note("runs", self.runs);
        fig.note("seed", self.seed);
    }
}

/// The light of chains by connections, or by paths if `by_paths`: an image less that at the same seed which leaves it out.
///
/// # Errors
/// Those of rendering.
pub fn measure(
    scene: &Scene,
    connections: Connections,
    by_paths: bool,
    effort: Effort,
) -> Result<Measured> {
    let theta = Theta::constant(scene.params().values());
    let found = Mutex::new(Statistics::default());
    let width = scene.film.size[0] as usize;
    let series = Series::of(effort.runs, [width, BLOCK], |run| {
        let of = |connections: Option<Connections>| {
            let settings = Settings {
                connections,
                ..scene.settings
            };
            let job = Job::new(scene, &settings, effort.seed + run, 0..effort.spp, &());
            render_f32(&job, &theta, Estimator::Mis)
        };
        let with = of(Some(connections).filter(|_| !by_paths));
        let without = of(Some(Connections {
            method: Method::LeftOut,
            ..connections
        }));
        found
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .merge(&with.connections);
        let scale = 1.0 / effort.spp as f64;
        let pairs = with.sums[0].iter().zip(&without.sums[0]);
        let difference: Vec<f64> = pairs.map(|(a, b)| a - b).collect();
        Ok::<_, RenderError>(grey(&difference, scale))
    })?;
    Ok(Measured {
        series,
        found: found.into_inner().unwrap_or_else(PoisonError::into_inner),
    })
}

/// Encoded normals of a periodic height field of random waves, `[n][n][3]`, whose slopes have this standard deviation along
/// either axis: nearly Gaussian.
fn bumps(n: usize, slope: f64, seed: u64) -> Vec<f32> {
    const WAVES: u64 = 24;
    const MOST: f64 = 3.0;
    let waves: Vec<([f64; 2], f64)> = (0..WAVES)
        .map(|i| {
            let mut s = Independent::new(seed, 0, i);
            let [a, b] = s.next_2d::<f64>();
            let number = |u: f64| ((2.0 * u - 1.0) * (MOST + 0.5)).round();
            let k = [number(a), number(b)];
            let still = k == [0.0; 2];
            (if still { [1.0, 0.0] } else { k }, s.next_1d())
        })
        .collect();
    let slopes: Vec<[f64; 2]> = (0..n * n)
        .map(|i| {
            let at = [i % n, i / n].map(|j| (j as f64 + 0.5) / n as f64);
            let mut sum = [0.0; 2];
            for (k, phase) in &waves {
                let turns = k[0] * at[0] + k[1] * at[1] + phase;
                let (sin, _) = warp::sin_cos_of_turns(turns.rem_euclid(1.0));
                let size = (k[0] * k[0] + k[1] * k[1]).sqrt();
                sum[0] += sin * k[0] / size;
                sum[1] += sin * k[1] / size;
            }
            sum
        })
        .collect();
    let squares: f64 = slopes.iter().flatten().map(|s| s * s).sum();
    let scale = slope / (squares / (2 * n * n) as f64).sqrt();
    let encode = |[x, y]: &[f64; 2]| {
        let normal = Vec3::new(-x * scale, -y * scale, 1.0).normalize();
        [normal.x, normal.y, normal.z].map(|c| (0.5 * c + 0.5) as f32)
    };
    slopes.iter().flat_map(encode).collect()
}

/// A material on bumps of [`bumps`].
///
/// # Errors
/// None that the constants here can cause.
pub fn bumpy(
    b: &mut SceneBuilder,
    nested: Arc<Material>,
    slope: f64,
    seed: u64,
) -> Result<Arc<Material>> {
    const TEXELS: usize = 32;
    let texels = bumps(TEXELS, slope, seed);
    let map = (b.build).texels("bumps", [TEXELS as u32; 2], &texels, (-1.0, 2.0))?;
    let mapped = NormalMap::new(map, Interpolation::Slopes, nested)?;
    Ok(Arc::new(Material::from(mapped)))
}

/// Smooth glass.
///
/// # Errors
/// None that the constants here can cause.
pub fn glass(b: &mut SceneBuilder) -> Result<Arc<Material>> {
    Ok(Arc::new(Material::from(Dielectric {
        eta: b.build.scalar("glass.eta.value", 1.5, (1.01, 4.0))?,
        specular_reflectance: b.colour("glass", "specular_reflectance", [1.0; 3])?,
        specular_transmittance: b.colour("glass", "specular_transmittance", [1.0; 3])?,
    })))
}

/// A floor before a wall of metal, to which a lamp of this half side turns its front; `wall` makes the metal.
///
/// # Errors
/// Those of `wall`.
pub fn mirrored(
    lamp: f64,
    radiance: f64,
    size: u32,
    wall: impl FnOnce(&mut SceneBuilder) -> Result<Arc<Material>>,
) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-8.0, 0.0, -5.0], [0.0, 0.0, 14.0], [16.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let metal = wall(&mut b)?;
    let quad = [[-5.0, 0.0, -5.0], [10.0, 0.0, 0.0], [0.0, 8.0, 0.0]];
    b.quad("wall", quad, &metal)?;
    let black = b.matt("lamp", [0.0; 3])?;
    let side = 2.0 * lamp;
    // Towards the wall, a little down.
    let quad = [
        [lamp, 9.0 - lamp, 10.0],
        [-side, 0.0, 0.0],
        [0.0, side, 0.1 * side],
    ];
    let shape = b.quad("lamp", quad, &black)?;
    b.lamp("lamp", shape, [radiance; 3])?;
    b.finish(
        &crate::scene_builder::View {
            eye: [0.0, 16.0, 9.0],
            target: [0.0, 0.0, 1.0],
            fov: 40.0,
            size: [size; 2],
        },
        3,
    )
}
