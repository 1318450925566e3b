//! The combinations of scalar, strategy and sampler that are compiled, as plain functions.
//!
//! The renderer is generic; a program that calls [`render::render`] with types of its own compiles the
//! whole of light transport for them. Tools and figures call these functions instead, and link in a
//! second. A new combination is one line in the list of [`Estimator`]s.
//!
//! An image and its derivative as another image, by forward mode:
//!
//! ```
//! use render::{Job, Scene};
//! use render::instances::{Direction, Estimator, forward_f32};
//! use render::scene::LoadOptions;
//!
//! let path = "../examples/scenes/cornell.xml".as_ref();
//! let small = LoadOptions { defines: vec![("res".into(), "16".into())], ..Default::default() };
//! let (scene, _warnings) = Scene::load(path, &small)?;
//! let (values, settings) = (scene.params().values(), scene.settings);
//! let along = [
//!     Direction::uniform(scene.params(), "gold.alpha.value")?,
//!     Direction::uniform(scene.params(), "light.emitter.radiance.value")?,
//! ];
//! let job = Job::new(&scene, &settings, 0, 0..4, &());
//! let found = forward_f32(&job, values, &along)?;
//! let (image, by_light) = (found.image(0), found.image(2));
//! // Light is linear in emission: channel by channel the derivative is image over radiance.
//! for (i, d) in image.data.iter().zip(&by_light.data).step_by(3) {
//!     assert!((i - 18.0 * d).abs() <= 1e-3 * i.max(0.01));
//! }
//! // Other estimators go by name; where one would be wrong it is refused.
//! let attached = Estimator::from_name("attached")?;
//! let refused = attached.forward_f32(&job, values, &along[..1]);
//! assert!(refused.unwrap_err().to_string().contains("discontinuities"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use ad_core::{Dual, Float};

use crate::bsdf::kernel::Rules;
use crate::error::RenderError;
pub use crate::estimator::Mode;
use crate::estimator::{
    self, AllowBias, Attached, AttachedChoice, AttachedDirect, AttachedRoulette, AttachedWeights,
    Balance, BsdfOnly, Capabilities, Convolved, Detached, DetachedMis, DetachedWeights,
    Differential, EmitterOnly, Followed, FrozenWeights, Interior, Mis, MixedWeights, Outlines,
    RaysAtRest, Reparameterised, Strategy, TrustBsdf, TrustLights, Unbiased,
};
use crate::integrator::Job;
use crate::integrator::chain_density;
use crate::integrator::density::{Convention, Map};
use crate::integrator::gradient::{self, Active, Gradient};
use crate::integrator::particle;
use crate::integrator::particle_gradient::{self, Measurement};
use crate::integrator::render::{self, Components, Rendering};
use crate::integrator::second_order::{self, NormalEquations};
use crate::integrator::work::count_work;
use crate::params::{ParamInfo, ParamRef, Params, Tangent, Theta};
use crate::sampler::{Independent, Spread};
use crate::scene::Scene;

fn run<R: Components, S: Unbiased>(job: &Job, theta: &Theta<R>) -> Result<Rendering, RenderError> {
    render::render::<R, S, Spread>(job, theta)
}

/// The image, in single precision, `[height][width][3]`, linear RGB: [`render::render`] with the points that `settings` asks
/// for, by the techniques of an estimator ([`Strategy::Primal`]): sampled emitters, scattered directions, or both by either
/// heuristic. Where nothing is differentiated many estimators are the same.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, render_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(16, 8)?; // 16 columns, 8 rows
/// let theta = Theta::constant(room.params().values());
/// let pass = |samples| {
///     let job = Job::new(&room, &room.settings, 1, samples, &());
///     render_f32(&job, &theta, Estimator::Mis)
/// };
/// let all = pass(0..8);
/// let image = all.image(0); // component 0 is the image
/// assert_eq!((image.height, image.width, image.data.len()), (8, 16, 8 * 16 * 3));
///
/// // What comes back are sums over samples: later samples add up with earlier ones.
/// let mut halves = pass(0..4);
/// halves.merge(&pass(4..8));
/// assert_eq!((halves.samples, halves.sums[0].len()), (8, image.data.len()));
/// assert!((halves.mean(0)[0] / all.mean(0)[0] - 1.0).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Panics
/// If `theta` has fewer values than the scene.
pub fn render_f32(job: &Job, theta: &Theta<f32>, estimator: Estimator) -> Rendering {
    estimator.primal()(job, theta)
}

/// The image by particles, in single precision: [`particle::render`] with the points that `settings` asks
/// for.
///
/// Particles begin at lights and paths at the camera, so that each checks the other:
///
/// ```
/// use render::Job;
/// use render::bsdf::kernel::Rules;
/// use render::instances::{Estimator, particles_f32, render_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let theta = Theta::constant(room.params().values());
/// let job = Job::new(&room, &room.settings, 1, 0..256, &());
/// let particles = particles_f32(&job, &theta, Rules::default())?; // one per pixel and sample
/// let paths = render_f32(&job, &theta, Estimator::Mis);
/// assert_eq!(particles.sums[0].len(), paths.sums[0].len()); // [height][width][3] both
/// for (a, b) in particles.mean(0).iter().zip(paths.mean(0)) {
///     assert!((a / b - 1.0).abs() < 0.1, "{a} {b}"); // within their noise
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A scene that particles see otherwise than paths do.
pub fn particles_f32(
    job: &Job,
    theta: &Theta<f32>,
    rules: Rules,
) -> Result<Rendering, RenderError> {
    let Job {
        scene,
        settings,
        seed,
        samples,
        progress,
    } = job.clone();
    let context = particle::Context {
        rules,
        ..particle::Context::new(scene, theta, settings)?
    };
    let r = particle::render::<f32, Spread>(&context, seed, samples, progress);
    Ok(r)
}

/// The image by particles that land and viewing rays that collect them within `radius`, in single precision:
/// [`Map`] with the points that `settings` asks for. As many particles are sent per sample as there are pixels.
///
/// A lamp of intensity `I` at height `h` over a floor of reflectance `rho`: its radiance below is `rho I / (pi h^2)`.
///
/// ```
/// use std::f64::consts::PI;
///
/// use render::bsdf::kernel::Rules;
/// use render::instances::density_f32;
/// use render::integrator::density::Convention;
/// use render::params::Theta;
/// use render::{Job, Scene};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="perspective">
///         <float name="fov" value="10"/>
///         <transform name="to_world"><lookat origin="0, 2, 0" target="0, 0, 0" up="0, 0, 1"/></transform>
///         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
///     </sensor>
///     <emitter type="point"><point name="position" y="2"/><rgb name="intensity" value="4, 8, 12"/></emitter>
///     <shape type="rectangle">
///         <transform name="to_world"><scale value="20"/><rotate x="1" angle="-90"/></transform>
///         <bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>
///     </shape>
/// </scene>"#;
/// let (scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// let theta = Theta::constant(scene.params().values());
/// let job = Job::new(&scene, &scene.settings, 1, 0..1024, &());
/// let found = density_f32(&job, &theta, Rules::default(), Convention::Radiance, 0.3)?;
/// assert_eq!(found.sums[0].len(), 8 * 8 * 3); // [height][width][3]
/// for (radiance, intensity) in found.mean(0).iter().zip([4.0, 8.0, 12.0]) {
///     let expected = 0.5 * intensity / (PI * 2.0 * 2.0);
///     assert!((radiance / expected - 1.0).abs() < 0.1, "{radiance} {expected}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A scene that particles see otherwise than paths do; a radius that is not positive; too many particles.
pub fn density_f32(
    job: &Job,
    theta: &Theta<f32>,
    rules: Rules,
    convention: Convention,
    radius: f64,
) -> Result<Rendering, RenderError> {
    let Job {
        scene,
        settings,
        seed,
        samples,
        progress,
    } = job.clone();
    let context = particle::Context {
        rules,
        ..particle::Context::new(scene, theta, settings)?
    };
    let map = Map::new::<Spread>(&context, radius, seed, samples.clone(), progress)?;
    Ok(map.render::<Spread>(&context, convention, seed, samples, progress))
}

/// The light of manifold connections by so many particles instead, in single precision: [`chain_density::image`] with the
/// points that `settings` asks for.
///
/// What a mirror throws on a wall, by connections and by particles:
///
/// ```
/// use render::instances::{Estimator, chains_by_particles_f32, render_f32};
/// use render::params::Theta;
/// use render::scene::{Connections, Method};
/// use render::{Job, Scene, Settings};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="perspective">
///         <float name="fov" value="30"/>
///         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
///     </sensor>
///     <shape type="rectangle" id="wall">
///         <transform name="to_world"><scale value="3"/><rotate y="1" angle="180"/><translate z="5"/></transform>
///     </shape>
///     <shape type="rectangle" id="mirror">
///         <transform name="to_world"><rotate y="1" angle="-90"/><translate x="2" z="3.5"/></transform>
///         <bsdf type="conductor"/>
///     </shape>
///     <shape type="sphere" id="lamp">
///         <point name="center" x="-1.5" z="3"/><float name="radius" value="0.2"/>
///         <emitter type="area"><rgb name="radiance" value="20"/></emitter>
///     </shape>
/// </scene>"#;
/// let (scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// let theta = Theta::constant(scene.params().values());
/// let with = |method| Settings { connections: Some(Connections::new(method)), ..scene.settings };
/// let (connected, left_out) = (with(Method::Sms), with(Method::LeftOut));
/// let job = |settings| Job::new(&scene, settings, 1, 0..16, &());
/// let mean = |settings| render_f32(&job(settings), &theta, Estimator::Mis).mean(0)[0];
/// let by_connections = mean(&connected) - mean(&left_out);
///
/// let by_particles = chains_by_particles_f32(&job(&connected), &theta, 1 << 16)?;
/// let by_particles = by_particles.image.mean(0)[0]; // the light of chains alone, [height][width][3]
/// assert!((by_particles / by_connections - 1.0).abs() < 0.1, "{by_particles} {by_connections}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As those of [`chain_density::image`].
pub fn chains_by_particles_f32(
    job: &Job,
    theta: &Theta<f32>,
    particles: u64,
) -> Result<chain_density::ChainLight, RenderError> {
    chain_density::image::<f32, Spread>(job, theta, particles)
}

/// The particles of [`density_f32`], to be gathered at chosen points.
///
/// The irradiance below a lamp of intensity `I` at height `h` is `I / h^2`:
///
/// ```
/// use render::instances::particle_map_f32;
/// use render::params::Theta;
/// use render::{Job, Scene};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="perspective">
///         <float name="fov" value="40"/>
///         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
///     </sensor>
///     <emitter type="point"><point name="position" y="2"/><rgb name="intensity" value="4, 8, 12"/></emitter>
///     <shape type="rectangle">
///         <transform name="to_world"><scale value="20"/><rotate x="1" angle="-90"/></transform>
///     </shape>
/// </scene>"#;
/// let (scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// let theta = Theta::constant(scene.params().values());
/// let job = Job::new(&scene, &scene.settings, 1, 0..1024, &());
/// let map = particle_map_f32(&job, &theta, 0.3)?; // 8 x 8 particles for each of 1024 samples
/// let below = map.irradiance([0.0, 0.0, 0.0].into(), [0.0, 1.0, 0.0].into()); // a point, the normal there
/// for (c, intensity) in [4.0f32, 8.0, 12.0].into_iter().enumerate() {
///     let expected = intensity / (2.0 * 2.0);
///     assert!((below.value[c] / expected - 1.0).abs() < 0.1, "{} {expected}", below.value[c]);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As those of [`density_f32`].
pub fn particle_map_f32(
    job: &Job,
    theta: &Theta<f32>,
    radius: f64,
) -> Result<Map<f32>, RenderError> {
    let Job {
        scene,
        settings,
        seed,
        samples,
        ..
    } = job.clone();
    let context = particle::Context::new(scene, theta, settings)?;
    Map::new::<Spread>(&context, radius, seed, samples, &())
}

/// The gradient of `<adjoint, image>` by particles, in single precision: [`particle_gradient::backward`] with
/// the points that `settings` asks for. `adjoint` is `[height][width][3]`.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, backward_particles_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let theta = Theta::constant(room.params().values());
/// let lamp = "light.emitter.radiance.value";
/// let active = Estimator::Mis.active(&room, &[lamp])?;
/// let adjoint = vec![1.0 / 192.0; 192]; // of the mean of all pixels and channels
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let found = backward_particles_f32(&job, &theta, &active, &adjoint)?;
/// // The mean is linear in what the only lamp emits.
/// let emitted = room.params().get(lamp)?.iter().map(|&e| f64::from(e));
/// let mean: f64 = found.gradient.values[0].iter().zip(emitted).map(|(d, e)| d * e).sum();
/// assert!((mean / found.value - 1.0).abs() < 1e-3, "{mean} {}", found.value);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// An adjoint image of the wrong size; a parameter that moves something; a scene that particles see otherwise than paths do.
pub fn backward_particles_f32(
    job: &Job,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
) -> Result<Measurement, RenderError> {
    let Job {
        scene,
        settings,
        seed,
        samples,
        progress,
    } = job.clone();
    let context = particle::Context::new(scene, theta, settings)?;
    particle_gradient::backward::<f32, Spread>(&context, active, adjoint, seed, samples, progress)
}

/// The image, in double precision: a reference for [`render_f32`] and for differences.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, render_f32, render_f64};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let single = room.params().values();
/// let double: Vec<f64> = single.iter().map(|&v| v.into()).collect();
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let a = render_f32(&job, &Theta::constant(single), Estimator::Mis).mean(0);
/// let b = render_f64(&job, &Theta::constant(&double), Estimator::Mis).mean(0);
/// for (a, b) in a.iter().zip(b) {
///     assert!((a / b - 1.0).abs() < 1e-3, "{a} {b}"); // the same paths, but for rounding
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Panics
/// If `theta` has fewer values than the scene.
pub fn render_f64(job: &Job, theta: &Theta<f64>, estimator: Estimator) -> Rendering {
    estimator.primal()(job, theta)
}

/// The gradient of `<adjoint, image>`, in single precision: [`gradient::backward`] with detached MIS and
/// the points that `settings` asks for. `adjoint` is `[height][width][3]`; one slice for each range of `active`.
///
/// Reverse and forward mode at one seed follow the same paths: the derivative along a direction is the gradient times
/// that direction.
///
/// ```
/// use render::Job;
/// use render::instances::{Direction, Estimator, backward_f32, forward_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let theta = Theta::constant(room.params().values());
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let active = Estimator::Mis.active(&room, &["sphere.alpha.value", "left.reflectance.value"])?;
/// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
/// let gradient = backward_f32(&job, &theta, &active, &adjoint)?;
/// assert_eq!(gradient.values.iter().map(Vec::len).collect::<Vec<_>>(), [1, 3]); // a slice per range
///
/// let along = Direction::uniform(room.params(), "left.reflectance.value")?;
/// let change = forward_f32(&job, theta.values(), &[along])?.mean(1).iter().sum::<f64>() / 3.0;
/// let summed: f64 = gradient.values[1].iter().sum();
/// assert!((summed / change - 1.0).abs() < 1e-3, "{summed} {change}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// An adjoint image of the wrong size; a parameter that moves something.
pub fn backward_f32(
    job: &Job,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
) -> Result<Gradient, RenderError> {
    gradient::backward::<f32, DetachedMis, Spread>(job, theta, active, adjoint)
}

/// [`backward_f32`] in double precision.
///
/// ```
/// use render::instances::{Estimator, backward_f64, render_f64};
/// use render::params::Theta;
/// use render::{Job, Settings};
///
/// let room = render::scene::room(8, 8)?;
/// // Without roulette paths are the same for all colours of a wall, and differences are exact but for their step.
/// let settings = Settings { rr_depth: u32::MAX, ..room.settings };
/// let job = Job::new(&room, &settings, 1, 0..4, &());
/// let mut values: Vec<f64> = room.params().values().iter().map(|&v| v.into()).collect();
/// let active = Estimator::DOUBLE.active(&room, &["right.reflectance.value"])?;
/// let adjoint = vec![1.0; 8 * 8 * 3]; // of the sum of all pixels and channels
/// let gradient = backward_f64(&job, &Theta::constant(&values), &active, &adjoint)?;
///
/// let green = room.params().find("right.reflectance.value")?.range().start + 1;
/// let mut moved = |step: f64| {
///     values[green] += step;
///     let image = render_f64(&job, &Theta::constant(&values), Estimator::DOUBLE);
///     values[green] -= step;
///     64.0 * image.mean(0).iter().sum::<f64>() // over 8 x 8 pixels
/// };
/// let difference = (moved(1e-4) - moved(-1e-4)) / 2e-4;
/// let derivative = gradient.values[0][1];
/// assert!((derivative / difference - 1.0).abs() < 1e-6, "{derivative} {difference}");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Those of [`backward_f32`].
pub fn backward_f64(
    job: &Job,
    theta: &Theta<f64>,
    active: &Active,
    adjoint: &[f32],
) -> Result<Gradient, RenderError> {
    gradient::backward::<f64, DetachedMis, Spread>(job, theta, active, adjoint)
}

/// The image and its derivative when all values of `active` move along `direction`, which has one
/// number per value, in single precision: components 0 and 1. Detached MIS.
///
/// Light is linear in emission: along all that the lamp emits, the derivative is the image.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, tangent_f32};
///
/// let room = render::scene::room(8, 8)?;
/// let (values, lamp) = (room.params().values(), "light.emitter.radiance.value");
/// let active = Estimator::Mis.active(&room, &[lamp])?;
/// let emitted = room.params().get(lamp)?;
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let found = tangent_f32(&job, values, &active, emitted)?; // one number per value of `active`, three here
/// let (image, change) = (found.image(0), found.image(1)); // [height][width][3] both
/// for (i, d) in image.data.iter().zip(&change.data) {
///     assert!((i - d).abs() <= 1e-3 * i.max(0.01), "{i} {d}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A direction of the wrong length; a parameter that moves something, or a Dirac delta.
pub fn tangent_f32(
    job: &Job,
    values: &[f32],
    active: &Active,
    direction: &[f32],
) -> Result<Rendering, RenderError> {
    let &Job { scene, .. } = job;
    if direction.len() != active.len() {
        return Err(RenderError::WrongLength {
            what: "direction",
            expected: active.len(),
            found: direction.len(),
        });
    }
    let mut tangents = vec![Tangent::None; scene.params().infos().len()];
    let mut rest = direction;
    for info in active.ranges() {
        let (own, later) = rest.split_at(info.shape.len());
        rest = later;
        let own = own.iter().map(|&d| Dual::new(0.0, [d])).collect();
        tangents[scene.params().handle(info).id as usize] = Tangent::Dense(own);
    }
    let theta = Theta::<Dual<f32, 1>>::with_tangents(values, &tangents);
    run::<Dual<f32, 1>, DetachedMis>(job, &theta)
}

/// The Hessian of an image loss times a direction, in single precision:
/// [`second_order::hessian_vector`] with independent samples. `direction` has one number per value of `active`; both images
/// are `[height][width][3]`, the derivative of the loss and what that changes by along the direction. One slice for each range
/// of `active`.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, hessian_vector_f32, tangent_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let values = room.params().values();
/// let active = Estimator::SECOND_ORDER.active(&room, &["light.emitter.radiance.value"])?;
/// let direction = vec![1.0; active.len()];
/// // Of half the squared distance to black: the image is its first derivative, and what the image does along the
/// // direction is the second one times that.
/// let job = |seed| Job::new(&room, &room.settings, seed, 0..16, &());
/// let along = tangent_f32(&job(0), values, &active, &direction)?;
/// let (image, change) = (along.image(0), along.image(1));
/// let adjoints = [&image.data[..], &change.data];
/// let found = hessian_vector_f32(&job(1), &Theta::constant(values), &active, &direction, adjoints)?;
/// // The loss is a square of what the lamp emits.
/// assert!(found.values[0].iter().all(|h| *h > 0.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Images or a direction of the wrong size, parameters that move something, manifold connections, glints that are not left
/// to paths.
pub fn hessian_vector_f32(
    job: &Job,
    theta: &Theta<f32>,
    active: &Active,
    direction: &[f32],
    adjoints: [&[f32]; 2],
) -> Result<Gradient, RenderError> {
    second_order::hessian_vector::<f32, Independent>(job, theta, active, direction, adjoints)
}

/// Gradient and Gauss-Newton matrix of an image loss, in single precision: [`second_order::gauss_newton`]
/// with independent samples. Both images are `[height][width][3]`, the first and the second derivative of the loss in every
/// pixel and channel; what comes back has one number, and a row, per value of `active`.
///
/// ```
/// use render::Job;
/// use render::instances::{Estimator, gauss_newton_f32, render_f32};
/// use render::params::Theta;
///
/// let room = render::scene::room(8, 8)?;
/// let (lamp, theta) = ("light.emitter.radiance.value", Theta::constant(room.params().values()));
/// let active = Estimator::SECOND_ORDER.active(&room, &[lamp])?;
/// let job = |seed| Job::new(&room, &room.settings, seed, 0..64, &());
/// // Half the squared distance to a black target: its first and second derivative, [height][width][3] each.
/// let image = render_f32(&job(0), &theta, Estimator::Mis).image(0);
/// let ones = vec![1.0; image.data.len()];
/// let found = gauss_newton_f32(&job(1), &theta, &active, [&image.data, &ones])?;
/// assert_eq!((found.gradient.len(), found.matrix.len()), (3, 9)); // n numbers, n x n row by row
/// assert_eq!(found.matrix[1], 0.0); // colours do not mix
/// // The loss is a square of what the lamp emits, and the step of Newton's method puts it out.
/// for c in 0..3 {
///     let step = found.gradient[c] / found.matrix[4 * c];
///     let emitted = f64::from(room.params().get(lamp)?[c]);
///     assert!((step / emitted - 1.0).abs() < 0.05, "{step} {emitted}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Those of [`hessian_vector_f32`]; more than [`second_order::MAX_VALUES`] values, or fewer than two samples.
pub fn gauss_newton_f32(
    job: &Job,
    theta: &Theta<f32>,
    active: &Active,
    derivatives: [&[f32]; 2],
) -> Result<NormalEquations, RenderError> {
    second_order::gauss_newton::<f32, Independent>(job, theta, active, derivatives)
}

/// A direction in parameter space along which forward mode differentiates.
///
/// Colours do not mix, so adding one number to all three channels of an RGB parameter gives, in channel c of
/// the image, the derivative with respect to channel c.
///
/// ```
/// use render::Job;
/// use render::instances::{Direction, forward_f32};
///
/// let room = render::scene::room(8, 8)?;
/// let params = room.params();
/// let grey = Direction::uniform(params, "left.reflectance.value")?;
/// let left = params.handle(params.find("left.reflectance.value")?);
/// let red = Direction::Dense(left, vec![1.0, 0.0, 0.0]); // one number per value of the range
/// let job = Job::new(&room, &room.settings, 1, 0..16, &());
/// let found = forward_f32(&job, params.values(), &[grey, red])?;
/// let (by_grey, by_red) = (found.image(1), found.image(2));
/// // The red of the image depends on the red of the wall, and nothing else does.
/// for (grey, red) in by_grey.data.chunks(3).zip(by_red.data.chunks(3)) {
///     assert_eq!(red, [grey[0], 0.0, 0.0]);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub enum Direction {
    /// One number added to every element of a range.
    Uniform(ParamRef),
    /// A multiple of this vector, one number per element, added to a range.
    Dense(ParamRef, Vec<f32>),
}

impl Direction {
    /// [`Direction::Uniform`] for the range called `name`.
    ///
    /// # Errors
    /// An unknown name.
    pub fn uniform(params: &Params, name: &str) -> Result<Self, RenderError> {
        Ok(Self::Uniform(params.handle(params.find(name)?)))
    }

    fn param(&self) -> ParamRef {
        match self {
            Self::Uniform(p) | Self::Dense(p, _) => *p,
        }
    }
}

/// Derivative images along any number of directions, in single precision (forward mode): component 0 of the
/// result is the image, component `k` the derivative along `directions[k - 1]`.
///
/// Renders `Dual<f32, N>` with N in 8, 4, 1, so eleven directions cost two passes over the same samples. Detached MIS.
///
/// ```
/// use render::instances::{Direction, Estimator, forward_f32, render_f32};
/// use render::params::Theta;
/// use render::{Job, Settings};
///
/// let room = render::scene::room(8, 8)?;
/// let settings = Settings { rr_depth: u32::MAX, ..room.settings }; // no roulette: differences see the same paths
/// let job = Job::new(&room, &settings, 1, 0..4, &());
/// let names = ["left.reflectance.value", "right.reflectance.value", "white.reflectance.value"];
/// let along = names.map(|name| Direction::uniform(room.params(), name)).into_iter();
/// let along = along.collect::<Result<Vec<_>, _>>()?;
/// let found = forward_f32(&job, room.params().values(), &along)?;
/// assert_eq!(found.sums.len(), 1 + 3); // the image and three derivatives, [height][width][3] each
///
/// let mean = |name: &str, step: f32| -> Result<f64, render::RenderError> {
///     let mut values = room.params().values().to_vec();
///     values[room.params().find(name)?.range()].iter_mut().for_each(|v| *v += step);
///     Ok(render_f32(&job, &Theta::constant(&values), Estimator::Mis).mean(0)[0])
/// };
/// for (k, name) in names.iter().enumerate() {
///     let difference = (mean(name, 0.02)? - mean(name, -0.02)?) / 0.04;
///     let derivative = found.mean(1 + k)[0]; // of the red of the mean, by the red of the wall
///     assert!((derivative / difference - 1.0).abs() < 0.01, "{name}: {derivative} {difference}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A dense direction of the wrong length; a parameter that moves something, or a Dirac delta.
pub fn forward_f32(
    job: &Job,
    values: &[f32],
    directions: &[Direction],
) -> Result<Rendering, RenderError> {
    check_directions(job.scene, directions)?;
    let pass = |directions: &[Direction]| -> Result<Rendering, RenderError> {
        let run = match directions.len() {
            5.. => forward::<8>,
            2.. => forward::<4>,
            _ => forward::<1>,
        };
        let mut part = run(job, values, directions)?;
        part.sums.truncate(1 + directions.len());
        Ok(part)
    };
    in_passes(directions, pass)
}

/// [`forward_f32`] by [`Estimator::Edges`], for what moves: eight directions at a time over the same samples.
///
/// The light of a square lamp under parallel rays is proportional to its area: to the square of its scale.
///
/// ```
/// use render::instances::{Direction, forward_edges_f32};
/// use render::{Job, Scene};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="orthographic">
///         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
///     </sensor>
///     <shape type="rectangle" id="lamp">
///         <transform name="to_world"><scale value="0.5"/><rotate y="1" angle="180"/><translate z="2"/></transform>
///         <emitter type="area"><rgb name="radiance" value="1"/></emitter>
///     </shape>
/// </scene>"#;
/// let (mut scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// scene.make_movable(&["lamp.scale", "lamp.translation"])?;
/// let (params, settings) = (scene.params(), scene.settings);
/// let right = params.handle(params.find("lamp.translation")?);
/// let along = [
///     Direction::uniform(params, "lamp.scale")?,
///     Direction::Dense(right, vec![1.0, 0.0, 0.0]), // a unit of the scene along x
/// ];
/// let job = Job::new(&scene, &settings, 1, 0..256, &());
/// let found = forward_edges_f32(&job, params.values(), &along)?;
/// let [light, by_scale, by_shift] = [0, 1, 2].map(|k| found.mean(k)[0]); // means over pixels
/// assert!((light - 0.25).abs() < 0.01, "{light}"); // a quarter of the picture
/// assert!((by_scale - 2.0 * light).abs() < 0.05, "{by_scale}");
/// assert!(by_shift.abs() < 0.05, "{by_shift}"); // what one side loses the other gains
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A dense direction of the wrong length; a scene or a parameter that edges do not admit.
pub fn forward_edges_f32(
    job: &Job,
    values: &[f32],
    directions: &[Direction],
) -> Result<Rendering, RenderError> {
    check_directions(job.scene, directions)?;
    let pass = |directions: &[Direction]| -> Result<Rendering, RenderError> {
        let tangents = tangents::<8>(job.scene.params(), directions.iter().enumerate());
        let theta = Theta::<Dual<f32, 8>>::with_tangents(values, &tangents);
        let mut part = run::<Dual<f32, 8>, Outlines<Interior<DetachedMis>>>(job, &theta)?;
        part.sums.truncate(1 + directions.len());
        Ok(part)
    };
    in_passes(directions, pass)
}

/// Components of several passes over the same samples, each with the next eight directions.
fn in_passes<'a>(
    directions: &'a [Direction],
    pass: impl Fn(&[Direction]) -> Result<Rendering, RenderError>,
) -> Result<Rendering, RenderError> {
    let next = |rest: &'a [Direction]| rest.split_at(rest.len().min(8));
    let (now, mut rest) = next(directions);
    let mut out = pass(now)?;
    while !rest.is_empty() {
        let (now, later) = next(rest);
        let part = pass(now)?;
        out.sums.extend(part.sums.into_iter().skip(1));
        out.cancelled |= part.cancelled;
        // A sample may fail in the tangents of one pass only.
        if part.non_finite.count > out.non_finite.count {
            out.non_finite = part.non_finite;
        }
        rest = later;
    }
    Ok(out)
}

fn check_directions(scene: &Scene, directions: &[Direction]) -> Result<(), RenderError> {
    for d in directions {
        let expected = scene.params().infos()[d.param().id as usize].shape.len();
        match d {
            Direction::Dense(_, v) if v.len() != expected => {
                return Err(RenderError::WrongLength {
                    what: "direction",
                    expected,
                    found: v.len(),
                });
            }
            _ => {}
        }
    }
    Ok(())
}

fn forward<const N: usize>(
    job: &Job,
    values: &[f32],
    directions: &[Direction],
) -> Result<Rendering, RenderError> {
    let &Job { scene, .. } = job;
    let tangents = tangents::<N>(scene.params(), directions.iter().enumerate());
    let theta = Theta::<Dual<f32, N>>::with_tangents(values, &tangents);
    run::<Dual<f32, N>, DetachedMis>(job, &theta)
}

/// The image and its derivative along one direction with [`Estimator::Mis`] in double precision, at the values that the scene
/// has: components 0 and 1. What single precision costs in accuracy, and gains in time.
///
/// ```
/// use render::instances::{Direction, Estimator, forward_f64, render_f64};
/// use render::params::Theta;
/// use render::{Job, Settings};
///
/// let room = render::scene::room(8, 8)?;
/// // Without roulette paths are the same for all colours of a wall, and differences are exact but for their step.
/// let settings = Settings { rr_depth: u32::MAX, ..room.settings };
/// let job = Job::new(&room, &settings, 1, 0..4, &());
/// let wall = room.params().find("left.reflectance.value")?;
/// let mean = |step: f64| {
///     let mut values: Vec<f64> = room.params().values().iter().map(|&v| v.into()).collect();
///     values[wall.range()].iter_mut().for_each(|v| *v += step);
///     render_f64(&job, &Theta::constant(&values), Estimator::DOUBLE).mean(0)
/// };
/// let found = forward_f64(&job, &Direction::uniform(room.params(), &wall.name)?)?;
/// for c in 0..3 {
///     let (derivative, difference) = (found.mean(1)[c], (mean(1e-4)[c] - mean(-1e-4)[c]) / 2e-4);
///     assert!((derivative / difference - 1.0).abs() < 1e-6, "{derivative} {difference}");
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A dense direction of the wrong length; a parameter that moves something, or a Dirac delta.
pub fn forward_f64(job: &Job, direction: &Direction) -> Result<Rendering, RenderError> {
    let &Job { scene, .. } = job;
    check_directions(scene, std::slice::from_ref(direction))?;
    let widened = |t: &Dual<f32, 1>| Dual::<f64, 1>::new(0.0, [t.eps[0].into()]);
    let tangents = tangents::<1>(scene.params(), [(0, direction)]);
    let tangents: Vec<Tangent<Dual<f64, 1>>> = tangents
        .iter()
        .map(|t| match t {
            Tangent::None => Tangent::None,
            Tangent::Uniform(t) => Tangent::Uniform(widened(t)),
            Tangent::Dense(t) => Tangent::Dense(t.iter().map(widened).collect()),
        })
        .collect();
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
    let theta = Theta::<Dual<f64, 1>>::with_tangents(&values, &tangents);
    run::<Dual<f64, 1>, DetachedMis>(job, &theta)
}

/// One tangent per range of the layout; component `k` of the dual numbers is the sum of the directions
/// that come with `k`.
fn tangents<'a, const N: usize>(
    params: &Params,
    directions: impl IntoIterator<Item = (usize, &'a Direction)>,
) -> Vec<Tangent<Dual<f32, N>>> {
    let zero = Dual::new(0.0, [0.0; N]);
    let mut out = vec![Tangent::None; params.infos().len()];
    for (k, direction) in directions {
        let id = direction.param().id as usize;
        let len = params.infos()[id].shape.len();
        let tangent = &mut out[id];
        match (direction, &mut *tangent) {
            (Direction::Uniform(_), Tangent::None) => {
                let mut t = zero;
                t.eps[k] = 1.0;
                *tangent = Tangent::Uniform(t);
            }
            (Direction::Uniform(_), Tangent::Uniform(t)) => t.eps[k] += 1.0,
            (Direction::Uniform(_), Tangent::Dense(t)) => {
                t.iter_mut().for_each(|t| t.eps[k] += 1.0);
            }
            (Direction::Dense(_, v), current) => {
                let mut dense = match std::mem::replace(current, Tangent::None) {
                    Tangent::None => vec![zero; len],
                    Tangent::Uniform(t) => vec![t; len],
                    Tangent::Dense(t) => t,
                };
                for (t, v) in dense.iter_mut().zip(v) {
                    t.eps[k] += *v;
                }
                *current = Tangent::Dense(dense);
            }
        }
    }
    out
}

/// All estimators that are compiled for comparison: variant, name, type, a sentence. What else is known of them follows
/// from the type.
macro_rules! estimators {
    ($($variant:ident $name:literal $strategy:ty, $summary:literal;)*) => {
        /// An estimator of derivatives, by name; see [`crate::estimator`] for what the parts mean.
        ///
        /// ```
        /// use render::instances::Estimator;
        ///
        /// let room = render::scene::room(8, 8)?;
        /// let attached = Estimator::from_name("attached")?;
        /// assert_eq!(attached.summary(), "BSDF samples that move through one bounce.");
        /// // What moves its samples is wrong where something may hide something else, and is refused there.
        /// let right: Vec<_> = Estimator::ALL.iter().filter(|e| e.check(&room).is_ok()).collect();
        /// assert!(right.contains(&&Estimator::Mis) && !right.contains(&&attached));
        /// // What it can do is known without a scene.
        /// let can = Estimator::Edges.capabilities();
        /// assert!(can.samples_edges && can.modes.reverse && !can.modes.double);
        /// // Parameters are asked for by name. Their slices of a gradient come in the same order.
        /// let active = Estimator::Mis.active(&room, &["sphere.alpha.value", "left.reflectance.value"])?;
        /// assert_eq!((active.ranges().len(), active.len()), (2, 1 + 3));
        /// assert!(Estimator::Mis.active(&room, &["sphere.alfa.value"]).is_err());
        /// # Ok::<(), Box<dyn std::error::Error>>(())
        /// ```
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum Estimator {
            $(#[doc = $summary] $variant,)*
        }

        impl Estimator {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Its name on command lines and in tables.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => $name,)*
                }
            }

            /// What it is, in a sentence.
            pub fn summary(self) -> &'static str {
                match self {
                    $(Self::$variant => $summary,)*
                }
            }

            /// What it can do, and what it refuses.
            pub const fn capabilities(self) -> Capabilities {
                let mut own = match self {
                    $(Self::$variant => Capabilities::of::<$strategy>(),)*
                };
                own.modes.second_order = matches!(self, Self::SECOND_ORDER);
                own.modes.double = matches!(self, Self::DOUBLE);
                own
            }

            /// Whether it is right in this scene.
            ///
            /// # Errors
            /// See [`Scene::admits`].
            pub fn check(self, scene: &Scene) -> Result<(), RenderError> {
                match self {
                    $(Self::$variant => scene.admits::<$strategy>(),)*
                }
            }

            /// The named parameters of a scene, as [`Active::seen_by`] this estimator.
            ///
            /// # Errors
            /// An unknown name, or a parameter whose derivative this estimator cannot see.
            pub fn active<N: AsRef<str>>(
                self,
                scene: &Scene,
                names: &[N],
            ) -> Result<Active, RenderError> {
                match self {
                    $(Self::$variant => Active::seen_by::<$strategy, N>(scene, names),)*
                }
            }

            pub(crate) fn check_parameter(self, info: &ParamInfo) -> Result<(), RenderError> {
                match self {
                    $(Self::$variant => estimator::check_parameter::<$strategy>(info),)*
                }
            }

            /// Work of a sample of derivatives in these parameters, in edges: see [`count_work`].
            pub(crate) fn work(self, job: &Job, active: &Active, mode: Mode) -> f64 {
                let count = match self {
                    $(Self::$variant => count_work::<<$strategy as Strategy>::Paths, Spread>,)*
                };
                count(job, active, mode).work()
            }

            fn primal<P: Components + Float>(self) -> Primal<P> {
                match self {
                    $(Self::$variant => {
                        render::unchecked::<P, <$strategy as Strategy>::Primal, Spread>
                    })*
                }
            }

            fn forward<R: Components>(self) -> Forward<R> {
                match self {
                    $(Self::$variant => run::<R, $strategy>,)*
                }
            }

            fn reverse(self) -> Reverse {
                match self {
                    $(Self::$variant => pull_back::<$strategy>,)*
                }
            }
        }
    };
}

type Primal<P> = fn(&Job, &Theta<P>) -> Rendering;
type Forward<R> = fn(&Job, &Theta<R>) -> Result<Rendering, RenderError>;
type Reverse = fn(&Job, &Theta<f32>, &Active, &[f32]) -> Result<Gradient, RenderError>;

fn pull_back<S: Unbiased>(
    job: &Job,
    theta: &Theta<f32>,
    active: &Active,
    adjoint: &[f32],
) -> Result<Gradient, RenderError> {
    gradient::backward::<f32, S, Spread>(job, theta, active, adjoint)
}

impl Estimator {
    /// The one of [`hessian_vector_f32`] and [`gauss_newton_f32`].
    pub const SECOND_ORDER: Self = Self::Mis;
    /// The one of [`forward_f64`] and [`backward_f64`].
    pub const DOUBLE: Self = Self::Mis;

    /// What its derivatives in these parameters of a scene may be wrong about, sentence by sentence:
    /// [`Scene::doubts_of_tilts`], and [`Scene::doubts_of_crossings`] where it samples edges. Others pay nothing for finding where
    /// shapes cross. Of names that the scene does not have nothing is said.
    pub fn doubts<N: AsRef<str>>(self, scene: &Scene, names: &[N]) -> Vec<String> {
        let known = names.iter().map(|name| scene.params().find(name.as_ref()));
        let infos: Vec<&ParamInfo> = known.filter_map(Result::ok).collect();
        let mut doubts = Scene::doubts_of_tilts(&infos);
        if self.capabilities().samples_edges {
            doubts.extend(scene.doubts_of_crossings(&infos));
        }
        doubts
    }

    /// The estimator called `name`.
    ///
    /// # Errors
    /// An unknown name, with the known ones.
    pub fn from_name(name: &str) -> Result<Self, RenderError> {
        let found = Self::ALL.iter().find(|e| e.name() == name);
        found.copied().ok_or_else(|| RenderError::UnknownEstimator {
            name: name.into(),
            known: Self::ALL
                .iter()
                .map(|e| e.name())
                .collect::<Vec<_>>()
                .join(", "),
        })
    }

    /// The image and its derivative along the sum of `directions`, such as one number added to every
    /// roughness, in single precision (forward mode): components 0 and 1 of the result, `[height][width][3]` each. `values` is
    /// the whole parameter vector.
    ///
    /// ```
    /// use render::Job;
    /// use render::instances::{Direction, Estimator};
    ///
    /// let room = render::scene::room(8, 8)?;
    /// let (params, e) = (room.params(), Estimator::DifferentialMis);
    /// let job = Job::new(&room, &room.settings, 1, 0..16, &());
    /// let left = Direction::uniform(params, "left.reflectance.value")?;
    /// let alpha = Direction::uniform(params, "sphere.alpha.value")?;
    /// let change = |along: &[Direction]| Ok::<_, render::RenderError>(e.forward_f32(&job, params.values(), along)?.image(1));
    /// let (left, alpha, both) =
    ///     (change(&[left.clone()])?, change(&[alpha.clone()])?, change(&[left, alpha])?);
    /// // Directions add up, pixel by pixel: [height][width][3].
    /// for (i, both) in both.data.iter().enumerate() {
    ///     let sum = left.data[i] + alpha.data[i];
    ///     assert!((sum - both).abs() <= 1e-3 * (left.data[i].abs() + alpha.data[i].abs() + 0.1));
    /// }
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// A direction of the wrong length; an estimator that is wrong in this scene or for this parameter.
    pub fn forward_f32(
        self,
        job: &Job,
        values: &[f32],
        directions: &[Direction],
    ) -> Result<Rendering, RenderError> {
        let &Job { scene, .. } = job;
        check_directions(scene, directions)?;
        let tangents = tangents::<1>(scene.params(), directions.iter().map(|d| (0, d)));
        let theta = Theta::<Dual<f32, 1>>::with_tangents(values, &tangents);
        self.forward()(job, &theta)
    }

    /// The gradient of `<adjoint, image>` (reverse mode), in single precision: one slice for each range of `active`.
    /// `adjoint` is `[height][width][3]`, the derivative of the loss in every pixel and channel of the crop window, from an image
    /// with another seed (errata Z-4.4).
    ///
    /// ```
    /// use render::Job;
    /// use render::instances::{Estimator, render_f32};
    /// use render::params::Theta;
    ///
    /// let room = render::scene::room(8, 8)?;
    /// let theta = Theta::constant(room.params().values());
    /// let e = Estimator::Detached;
    /// let active = e.active(&room, &["light.emitter.radiance.value"])?;
    /// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
    /// let job = Job::new(&room, &room.settings, 1, 0..64, &());
    /// let gradient = e.backward_f32(&job, &theta, &active, &adjoint)?;
    /// // The mean is linear in what the only lamp emits; here the seed is the same, so that even the noise is.
    /// let emitted = room.params().get("light.emitter.radiance.value")?;
    /// let mean: f64 = gradient.values[0].iter().zip(emitted).map(|(d, &e)| d * f64::from(e)).sum();
    /// let image = render_f32(&job, &theta, e);
    /// let expected = image.mean(0).iter().sum::<f64>() / 3.0;
    /// assert!((mean / expected - 1.0).abs() < 1e-3, "{mean} {expected}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// An adjoint image of the wrong size; an estimator that is wrong in this scene, or has no terms for what moves.
    pub fn backward_f32(
        self,
        job: &Job,
        theta: &Theta<f32>,
        active: &Active,
        adjoint: &[f32],
    ) -> Result<Gradient, RenderError> {
        self.reverse()(job, theta, active, adjoint)
    }
}

estimators! {
    Emitter "emitter" EmitterOnly<Detached>,
        "Sampled lights alone, constant.";
    EmitterAttached "emitter-attached" EmitterOnly<Detached, Attached>,
        "Sampled lights alone; samples of environment maps move with the texels.";
    Detached "detached" BsdfOnly<Detached>,
        "BSDF samples, constant.";
    Attached "attached" BsdfOnly<AttachedDirect>,
        "BSDF samples that move through one bounce.";
    AttachedNaive "attached-naive" AllowBias<BsdfOnly<AttachedDirect>>,
        "`attached` in any scene.";
    AttachedPath "attached-path" BsdfOnly<Attached>,
        "BSDF samples that move, and the whole path behind them.";
    Reparameterised "reparameterised" Convolved<BsdfOnly<Reparameterised>>,
        "BSDF samples that move, but stand still at outlines; what moves, by directions that follow it, in the limit of a narrow kernel.";
    Differential "differential" BsdfOnly<Differential>,
        "BSDF samples, and an antithetic pair from the derivative of the distribution of normals.";
    Mis "mis" DetachedMis,
        "BSDF samples and sampled lights, constant, power heuristic: the default.";
    MisBalance "mis-balance" Mis<Detached, Detached, DetachedWeights, Balance>,
        "`mis` with the balance heuristic.";
    MisTrustLights "mis-trust-lights" Mis<Detached, Detached, DetachedWeights, TrustLights>,
        "For study: `mis` with weights that trust sampled lights eight times as much.";
    MisTrustBsdf "mis-trust-bsdf" Mis<Detached, Detached, DetachedWeights, TrustBsdf>,
        "For study: `mis` with weights that trust BSDF samples eight times as much.";
    MisAttachedWeights "mis-attached-weights" Mis<Detached, Detached, AttachedWeights>,
        "`mis` with differentiated weights.";
    DifferentialMis "differential-mis" Mis<Differential, Detached, DetachedWeights>,
        "`differential` and sampled lights, power heuristic.";
    DifferentialMisBalance "differential-mis-balance" Mis<Differential, Detached, DetachedWeights, Balance>,
        "`differential-mis` with the balance heuristic.";
    DifferentialMisAttachedWeights "differential-mis-attached-weights" Mis<Differential, Detached, AttachedWeights>,
        "`differential-mis` with differentiated weights for values.";
    AttachedMis "attached-mis" Mis<AttachedDirect, Detached, AttachedWeights>,
        "`attached` and sampled lights, differentiated weights.";
    AttachedMisNaive "attached-mis-naive" AllowBias<Mis<AttachedDirect, Detached, AttachedWeights>>,
        "`attached-mis` in any scene.";
    AttachedMisFrozen "attached-mis-frozen" Mis<AttachedDirect, Detached, FrozenWeights>,
        "`attached-mis` with weights that follow the samples only.";
    AttachedBoth "attached-both" Mis<AttachedDirect, Attached, AttachedWeights>,
        "`attached-mis` whose samples of environment maps move with the texels.";
    ReparameterisedMis "reparameterised-mis" Convolved<Mis<Reparameterised, Detached, AttachedWeights>>,
        "`reparameterised` and sampled lights, differentiated weights.";
    ReparameterisedExact "reparameterised-exact" Followed<Mis<Reparameterised, Detached, AttachedWeights>>,
        "`reparameterised-mis`; what moves, by directions that follow outlines in closed form, of spheres and flat faces.";
    BiasedWeights "biased-weights" AllowBias<Mis<Reparameterised, Detached, DetachedWeights>>,
        "`reparameterised-mis` with constant weights [Zeltner 2021, Eq. 4.38].";
    BiasedAttachedWeights "biased-attached-weights" AllowBias<Mis<AttachedDirect, Detached, DetachedWeights>>,
        "`attached-mis` with constant weights, in any scene.";
    BiasedRoulette "biased-roulette" AllowBias<AttachedRoulette<DetachedMis>>,
        "`mis` whose roulette takes a differentiated probability: biased where it is played.";
    BiasedMixed "biased-mixed" AllowBias<Mis<Reparameterised, Detached, MixedWeights>>,
        "`reparameterised-mis` with differentiated weights for one technique only (errata Z-4.13f).";
    BiasedChoice "biased-choice" AllowBias<AttachedChoice<DetachedMis>>,
        "`mis` that divides by differentiated probabilities of lobes: biased where they depend on the parameter.";
    Edges "edges" Outlines<Interior<DetachedMis>>,
        "`mis`, and what moves: vertices of paths, and samples of edges for what becomes visible or hidden.";
    Interior "interior" AllowBias<Interior<DetachedMis>>,
        "`mis`, and what moves, as long as nothing becomes visible or hidden: biased where something does.";
    BiasedRays "biased-rays" AllowBias<RaysAtRest<Outlines<Interior<DetachedMis>>>>,
        "`edges` whose rays beyond the first vertex do not move with the vertices that they start from.";
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::{Failures, Scenes};

    /// Estimators for study say by what they are biased; all others have no such reason.
    #[test]
    fn only_what_is_for_study_is_biased() {
        for &e in Estimator::ALL {
            let c = e.capabilities();
            assert_eq!(c.study, !c.failures.is_empty(), "{}: {c}", e.name());
            assert!(!c.study || c.scenes == Scenes::Any, "{}: {c}", e.name());
            // A sentence without the layout of a table.
            assert!(e.summary().ends_with('.') && !e.summary().contains('|'));
        }
        let failures = |e: Estimator| e.capabilities().failures;
        assert_eq!(
            Estimator::ALL
                .iter()
                .filter(|e| e.capabilities().modes.double)
                .count(),
            1
        );
        let all = Estimator::ALL.iter().map(|&e| failures(e));
        for failure in crate::estimator::Failure::ALL {
            let alone = Failures::of(&[failure]);
            assert!(
                all.clone().any(|f| f == alone),
                "nobody shows {}",
                failure.number()
            );
        }
    }
}
