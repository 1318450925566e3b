//! Figures of [Veach 1996]: scattering that is not symmetric.

pub mod eq9_invariant;
mod facets;
pub mod fig_01a;
pub mod fig_01b;
pub mod plate_1;
pub mod plate_2;
pub mod pool;
pub mod tab_2_5;

use render::Job;
use render::bsdf::kernel::{Rules, Symmetry};
use render::instances::{Estimator, particles_f32, render_f32};
use render::integrator::render::Rendering;
use render::params::Theta;
use render::{Scene, Settings};

use examples::figure::Result;

/// Rules under which particles scatter like viewing rays, which is wrong: to be compared with the right ones.
pub const IGNORED: Rules = Rules {
    symmetry: Symmetry::Ignored,
    side_tests: false,
};

/// The image by particles.
///
/// # Errors
/// Normals that are flipped to the viewer.
pub fn particles(
    scene: &Scene,
    settings: &Settings,
    rules: Rules,
    seed: u64,
    spp: u64,
) -> Result<Rendering> {
    let theta = Theta::constant(scene.params().values());
    let r = particles_f32(&Job::new(scene, settings, seed, 0..spp, &()), &theta, rules)?;
    Ok(r)
}

/// The image by paths.
pub fn paths(scene: &Scene, settings: &Settings, seed: u64, spp: u64) -> Rendering {
    let theta = Theta::constant(scene.params().values());
    render_f32(
        &Job::new(scene, settings, seed, 0..spp, &()),
        &theta,
        Estimator::Mis,
    )
}
