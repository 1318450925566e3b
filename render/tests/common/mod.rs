//! Shared by the integration tests.

pub mod materials;
pub mod shapes;

use std::ops::AddAssign;
use std::path::{Path, PathBuf};

use ad_core::Float;
use render::bsdf::kernel::Rules;
use render::instances::{self, Direction, Estimator};
use render::integrator::density::Convention;
use render::params::{GradSink, ParamRef, Theta};
use render::{Image, Job, Scene};

/// The adjoints of all parameters.
pub struct Gradient<P>(pub Vec<P>);

impl<P: Float + AddAssign> GradSink<P> for Gradient<P> {
    fn active(&self, _: ParamRef) -> bool {
        true
    }

    fn add(&mut self, p: ParamRef, i: usize, d: P) {
        self.0[p.offset as usize + i] += d;
    }
}

/// Where large scenes and references lie that are not part of the repository: `$RENDER_SHARED`, or
/// `shared` beside the workspace. `None`, with a printed message, if there is no such folder; the
/// test should then pass without them.
pub fn shared_dir() -> Option<PathBuf> {
    let default = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared");
    let dir = std::env::var_os("RENDER_SHARED").map_or_else(|| default.into(), PathBuf::from);
    if dir.is_dir() {
        return Some(dir);
    }
    println!(
        "skipped: no shared scenes at {}; set RENDER_SHARED",
        dir.display()
    );
    None
}

/// All files below `dir` with this extension, sorted.
pub fn files_below(dir: &Path, extension: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == extension) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The image of `spp` samples per pixel by the default estimator.
pub fn image(scene: &Scene, spp: u64) -> Image {
    image_of_seed(scene, 1, spp)
}

/// The same with another seed.
pub fn image_of_seed(scene: &Scene, seed: u64, spp: u64) -> Image {
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    instances::render_f32(&job, &theta, Estimator::Mis).image(0)
}

/// The image by particles.
pub fn image_by_particles(scene: &Scene, seed: u64, spp: u64) -> Image {
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let rendering = instances::particles_f32(&job, &theta, Rules::default());
    rendering.unwrap().image(0)
}

/// The image by particles that viewing rays collect.
pub fn image_by_density(scene: &Scene, seed: u64, spp: u64) -> Image {
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(scene, &scene.settings, seed, 0..spp, &());
    let (rules, convention) = (Rules::default(), Convention::default());
    let rendering = instances::density_f32(&job, &theta, rules, convention, 0.1);
    rendering.unwrap().image(0)
}

/// The gradient of `<adjoint, image>` in the parameter `name` and the matrix `J^T J`, as Gauss-Newton has them.
pub fn normal_equations(
    scene: &Scene,
    name: &str,
    adjoint: &[f32],
    spp: u64,
) -> (Vec<f64>, Vec<f64>) {
    let theta = Theta::constant(scene.params().values());
    let active = Estimator::Mis.active(scene, &[name]).unwrap();
    let ones = vec![1.0; adjoint.len()];
    let job = Job::new(scene, &scene.settings, 1, 0..spp, &());
    let found = instances::gauss_newton_f32(&job, &theta, &active, [adjoint, &ones]).unwrap();
    (found.gradient, found.matrix)
}

/// The derivative of `<adjoint, image>` in the parameter `name`.
pub fn gradient(scene: &Scene, name: &str, adjoint: &[f32], spp: u64) -> Vec<f64> {
    let theta = Theta::constant(scene.params().values());
    let active = Estimator::Mis.active(scene, &[name]).unwrap();
    let job = Job::new(scene, &scene.settings, 1, 0..spp, &());
    let gradient = Estimator::Mis.backward_f32(&job, &theta, &active, adjoint);
    gradient.unwrap().values[0].clone()
}

/// The derivative of the image when all elements of the parameter `name` grow alike.
pub fn derivative(scene: &Scene, name: &str, spp: u64) -> Image {
    let directions = [Direction::uniform(scene.params(), name).unwrap()];
    let job = Job::new(scene, &scene.settings, 1, 0..spp, &());
    let rendering = Estimator::Mis.forward_f32(&job, scene.params().values(), &directions);
    rendering.unwrap().image(1)
}
