//! Scenes: everything a light path can meet, and the parameters of it all.

mod builder;
mod check;
mod clip;
mod connections;
mod doubts;
mod geometry;
mod glints;
mod load;
mod matrix;
mod movable;
mod pixels;
mod precision;
mod published;
mod room;
mod save;
mod schema;
mod sensor;
mod shares;
mod sight;
mod stand_ins;

use geometry::Geometry;

pub use builder::Builder;
pub use check::{Check, Finding, Outcome, Verdict};
pub use connections::{
    CasterLight, ChainKind, ChainKinds, Connections, Constraint, Hints, Method, Seen, Starts,
    Steps, Uniqueness,
};
pub use glints::{GlintMethod, GlintRegion, GlintTechniques, GlintWeights, Glints};
pub use load::LoadOptions;
pub use movable::Movable;
pub use room::room;
pub use sensor::Sensor;

use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;

use ad_core::{Dual, Float, Real, Vec2, Vec3};

use crate::accel::{Hit, PACKET_SIZE, RayPacket};
use crate::bsdf::{Bsdf, Material, Shading, TextureRef, TransportMode};
use crate::camera::Camera;
use crate::edges::crossing::Crossings;
use crate::edges::{Edges, Surfaces};
use crate::emitter::{AnyEmitter, Ball, Emitter, Lights};
use crate::error::RenderError;
use crate::estimator::{Direct, Sampling, Strategy};
use crate::film::Film;
use crate::guide::Guide;
use crate::math::{Frame, Ray, RayAdjoint, Segment};
use crate::params::{GradSink, ParamRef, Params, Theta};
use crate::prefetch::prefetch;
use crate::sampler::Points;
use crate::shape::{
    AnyShape, Exit, Mesh, Partials, Patch, Prim, Shape, Sphere, SurfaceAdjoint, SurfaceCoordinates,
    SurfaceInteraction,
};

pub(crate) use pixels::PixelShares;
pub(crate) use shares::Shares;

/// How a scene file wants to be rendered.
///
/// A scene has those of its file, and every [`Job`](crate::Job) is given some, which may be others. How samples are spread
/// is no matter of the file: they are [independent](Points::Independent) unless told otherwise, since the variance of an
/// estimator is defined by such samples. The tools and Python take [Sobol points](Points::Sobol), which have the least error.
/// One line switches:
///
/// ```
/// use render::instances::{Estimator, render_f32};
/// use render::params::Theta;
/// use render::sampler::Points;
/// use render::{Job, Settings};
///
/// let room = render::scene::room(8, 8)?;
/// let independent = Settings { max_depth: 2, ..room.settings }; // emission and direct light only
/// let sobol = Settings { points: Points::Sobol, ..independent };
///
/// let theta = Theta::constant(room.params().values());
/// let image = |settings, seed, spp| {
///     render_f32(&Job::new(&room, settings, seed, 0..spp, &()), &theta, Estimator::Mis).image(0)
/// };
/// let converged = image(&sobol, 1, 1024);
/// let error = |settings| {
///     let noisy = image(settings, 0, 64); // Sobol points are best in powers of two
///     let pairs = noisy.data.iter().zip(&converged.data);
///     pairs.map(|(a, b)| (a - b).powi(2)).sum::<f32>()
/// };
/// assert!(2.0 * error(&sobol) < error(&independent)); // of squares, summed over [height][width][3]
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Largest number of path edges: 1 is emission only, 2 direct light.
    pub max_depth: u32,
    /// Number of edges from which Russian roulette is played.
    pub rr_depth: u32,
    /// Samples per pixel.
    pub spp: u32,
    /// How those of paths and particles are spread; second order takes independent ones.
    pub points: Points,
    /// How paths choose among emitters; particles start at any one in proportion to its sampling weight.
    pub lights: LightChoice,
    /// Who finds caustics.
    pub caustics: Caustics,
    /// How many pixels share one of the particles that find caustics, per sample; 0 counts as 1. Particles say so
    /// much more than paths that few will do, except where caustics are what is looked at.
    pub pixels_per_particle: u32,
    /// How manifold connections are made, if they are; then they find caustics, and not particles.
    pub connections: Option<Connections>,
    /// Whether the camera sees no lights without a reflection in between: it looks through lamps, which light the scene all
    /// the same, at what lies behind them, and the sky is not there, neither by itself nor behind holes, `null` and smooth panes
    /// ([`crate::integrator::coverage`]).
    pub hide_emitters: bool,
    /// How glints are found, if not by paths.
    pub glints: Option<Glints>,
}

/// Who finds the light that something glossy throws on a diffuse surface which the camera sees, be it there or
/// by further reflections: paths whose first vertex is diffuse and whose last one is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Caustics {
    /// Paths from the camera, as all light.
    #[default]
    Paths,
    /// Particles from the emitters ([`Settings::pixels_per_particle`]), connected to the pinhole where they meet a
    /// diffuse surface; paths leave this light out. The expectation is the same, with what paths cannot find
    /// besides: caustics of point and spot lights in mirrors and smooth glass. Particles scatter as detached BSDF
    /// sampling does, with a pair for the change of normals where the estimator has one. Where the whole path is
    /// attached, where the camera is no pinhole, or where normals are flipped to the viewer, paths find everything all
    /// the same.
    Particles,
}

impl Caustics {
    /// All of them, by name.
    pub const NAMES: [(&'static str, Self); 2] =
        [("paths", Self::Paths), ("particles", Self::Particles)];
}

/// How a vertex chooses the emitter that it samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightChoice {
    /// Any one of them, in proportion to their sampling weights ([`Scene::set_sampling_weights`]).
    #[default]
    One,
    /// All are sampled, and one sample is kept in proportion to the light that it would bring without occlusion.
    /// Worth its time where few of a handful of lights matter at a point. Discrete choices are primal, as
    /// everywhere.
    All,
}

impl LightChoice {
    /// All of them, by name.
    pub const NAMES: [(&'static str, Self); 2] = [("one", Self::One), ("all", Self::All)];

    /// How many samples of an emitter there are at a vertex, on average: what its density is multiplied by in
    /// MIS weights.
    #[inline(always)]
    pub fn share<P: Float>(self, scene: &Scene, emitter: u32) -> P {
        match self {
            Self::One => P::of(scene.shares.of(emitter as usize)),
            Self::All => P::one(),
        }
    }
}

impl Settings {
    /// Whether lights at the end of the `depth`-th edge are left out.
    #[inline(always)]
    pub(crate) fn hides(&self, depth: u32) -> bool {
        self.hide_emitters && depth == 1
    }

    /// Whether the sky is left out at the end of a path that something has reflected or refracted (`bent`) or not.
    #[inline(always)]
    pub(crate) fn hides_sky(&self, bent: bool) -> bool {
        self.hide_emitters && !bent
    }

    /// Who finds caustics if these are made so: particles only where there is something for them to find.
    pub(crate) fn caustics_of<S: Strategy>(&self, scene: &Scene) -> Caustics {
        let found = scene.camera.is_pinhole() && !scene.geometry.casters.is_empty();
        let connected = self.connections.is_some();
        if !found || connected || self.max_depth < 3 || !S::Bsdf::DETACHED_PATH {
            Caustics::Paths
        } else {
            self.caustics
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_depth: 8,
            rr_depth: 5,
            spp: 16,
            points: Points::default(),
            lights: LightChoice::default(),
            caustics: Caustics::default(),
            pixels_per_particle: 4,
            connections: None,
            hide_emitters: false,
            glints: None,
        }
    }
}

/// What belongs to a shape.
#[derive(Clone, Debug)]
pub struct ShapeInfo {
    /// Its id in the scene file, or a made-up one.
    pub name: String,
    /// Index of its material.
    pub material: u32,
    /// Whether that scatters along deltas only.
    pub delta: bool,
    /// Whether it is anything but diffuse.
    pub glossy: bool,
    /// Index of its emitter, if it emits.
    pub emitter: Option<u32>,
    /// What the scene file says of manifold connections.
    pub hints: Hints,
}

impl ShapeInfo {
    /// Whether light that it scatters first, if it falls on what [shows](ShapeInfo::shows_caustics) them, is that of caustics.
    #[inline(always)]
    pub(crate) fn throws_caustics(&self) -> bool {
        self.glossy
    }

    /// Whether caustics are told from other light where the camera sees it.
    #[inline(always)]
    pub(crate) fn shows_caustics(&self) -> bool {
        !self.glossy
    }
}

/// A scene. Which shapes there are is fixed; parameters can be changed with [`Scene::set_params`].
///
/// Under an even sky a convex body of reflectance `rho` has the radiance `rho` times that of the sky, whatever its shape:
///
/// ```
/// use render::instances::{Estimator, render_f32};
/// use render::params::Theta;
/// use render::{Job, Scene};
///
/// let text = r#"<scene version="3.0.0">
///     <sensor type="perspective">
///         <float name="fov" value="10"/>
///         <film type="hdrfilm"><integer name="width" value="6"/><integer name="height" value="4"/></film>
///     </sensor>
///     <bsdf type="diffuse" id="clay"><rgb name="reflectance" value="0.5"/></bsdf>
///     <shape type="sphere"><point name="center" z="5"/><ref id="clay"/></shape>
///     <emitter type="constant"><rgb name="radiance" value="1, 2, 3"/></emitter>
/// </scene>"#;
/// let (mut scene, warnings) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// assert!(warnings.is_empty());
/// scene.set([("clay.reflectance.value", &[0.5, 0.5, 0.25][..])])?;
///
/// let theta = Theta::constant(scene.params().values());
/// let job = Job::new(&scene, &scene.settings, 0, 0..4, &());
/// // Scattered directions alone have no noise here.
/// let image = render_f32(&job, &theta, Estimator::Detached).image(0);
/// assert_eq!((image.height, image.width), (4, 6)); // `data` is [height][width][3], linear RGB
/// for pixel in image.data.chunks(3) {
///     for (found, expected) in pixel.iter().zip([0.5, 1.0, 0.75]) {
///         assert!((found - expected).abs() < 1e-5, "{found}");
///     }
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// Code builds scenes with a [`Builder`]; [`Scene::load`] reads those of files.
#[derive(Debug)]
pub struct Scene {
    params: Params,
    materials: Vec<Arc<Material>>,
    geometry: Geometry,
    infos: Vec<ShapeInfo>,
    emitters: Vec<AnyEmitter>,
    infinite: Vec<u32>,
    /// What the scene file says of each of them.
    emitter_hints: Vec<Hints>,
    /// How often each emitter is sampled.
    shares: Shares,
    /// How often each pixel is.
    pixels: PixelShares,
    /// Where light comes from, if that was learned.
    guide: Option<Guide>,
    /// What it was read from.
    files: Vec<PathBuf>,
    /// The same as it was understood, to be written again.
    source: Option<save::Source>,
    /// All that it can be looked at through.
    sensors: Vec<Sensor>,
    /// The number of the one that is.
    through: usize,
    /// The camera.
    pub camera: Camera,
    /// Resolution, crop and filter.
    pub film: Film,
    /// Depths and sample count.
    pub settings: Settings,
}

/// A ray's nearest hit.
#[derive(Clone, Copy, Debug)]
pub struct Intersection<R> {
    /// Index of the shape.
    pub shape: u32,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// Where on it.
    pub si: SurfaceInteraction<R>,
}

/// What a surface that was hit is made of: the kinds that waves have loops for.
pub(crate) enum HitSurface<'a> {
    /// And the index of the triangle.
    Mesh(&'a Mesh, u32),
    Sphere(&'a Sphere),
    Other,
}

impl Scene {
    /// The files that [`Scene::load`] read, each once, the scene file first: included ones, textures and meshes. Empty
    /// if the scene was made otherwise.
    pub fn files(&self) -> &[PathBuf] {
        &self.files
    }

    /// The parameter vector.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// Replaces the values of all parameters and rebuilds what depends on them.
    ///
    /// # Errors
    /// Wrong length, a value outside its valid range (named), or a shape out of reach. The scene is unchanged then.
    ///
    /// ```
    /// use render::{Scene, scene::LoadOptions};
    ///
    /// let path = "../examples/scenes/cornell.xml".as_ref();
    /// let small = LoadOptions { defines: vec![("res".into(), "16".into())], ..Default::default() };
    /// let (mut scene, warnings) = Scene::load(path, &small)?;
    /// assert!(warnings.is_empty());
    ///
    /// let mut values = scene.params().values().to_vec();
    /// let alpha = scene.params().find("gold.alpha.value")?.range();
    /// values[alpha.clone()].fill(0.3);
    /// scene.set_params(&values)?;
    ///
    /// values[alpha].fill(1.5);
    /// let error = scene.set_params(&values).unwrap_err();
    /// assert!(error.to_string().starts_with("parameter `gold.alpha.value`[0]: expected a value in ["));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set_params(&mut self, values: &[f32]) -> Result<(), RenderError> {
        if values.len() != self.params.values().len() {
            return Err(RenderError::WrongLength {
                what: "parameter vector",
                expected: self.params.values().len(),
                found: values.len(),
            });
        }
        for info in self.params.infos() {
            for i in info.range() {
                let (lo, hi) = info.valid;
                let v = f64::from(values[i]);
                if !(v.is_finite() && v >= f64::from(lo as f32) && v <= f64::from(hi as f32)) {
                    return Err(RenderError::ParameterOutOfRange {
                        name: info.name.clone(),
                        index: i - info.offset,
                        valid: info.valid,
                        found: v,
                    });
                }
            }
        }
        let changed = |p: ParamRef| {
            let range = self.params.infos()[p.id as usize].range();
            values[range.clone()] != self.params.values()[range]
        };
        let camera_moves = self.camera.depends_on(changed);
        if camera_moves || self.geometry.depends_on(changed) {
            let mut params = self.params.clone();
            params.values_mut().copy_from_slice(values);
            let mut camera = self.camera.clone();
            if camera_moves {
                camera = camera.at(&params).map_err(|e| RenderError::OutOfReach {
                    shape: None,
                    reason: e.to_string(),
                })?;
            }
            (self.geometry)
                .update(
                    &params,
                    changed,
                    &self.infos,
                    sensor::farthest(&self.sensors, &camera),
                )
                .map_err(|e| RenderError::OutOfReach {
                    shape: e.shape.map(|shape| self.infos[shape as usize].name.clone()),
                    reason: e.reason,
                })?;
            self.camera = camera;
        }
        self.params.values_mut().copy_from_slice(values);
        for e in &mut self.emitters {
            e.update(&self.params);
        }
        Ok(())
    }

    /// Replaces the values of some ranges and keeps the others; [`Params::get`] reads them. Matrices may be among them
    /// ([`Scene::to_world`]), before what moves the same thing in another way.
    ///
    /// # Errors
    /// An unknown name, with the closest ones; a wrong number of values; and as [`Scene::set_params`]. The scene is
    /// unchanged then, but for parameters at rest that matrices stand for.
    ///
    /// ```
    /// let mut scene = render::scene::room(8, 8)?;
    /// scene.set([("sphere.alpha.value", &[0.4][..]), ("left.reflectance.value", &[0.1, 0.2, 0.3])])?;
    /// assert_eq!(scene.params().get("left.reflectance.value")?, [0.1, 0.2, 0.3]);
    ///
    /// let error = scene.set([("spere.alpha.value", &[0.4][..])]).unwrap_err().to_string();
    /// assert!(error.starts_with("no parameter `spere.alpha.value`; closest: sphere.alpha.value"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set<'a, N: AsRef<str>>(
        &mut self,
        ranges: impl IntoIterator<Item = (N, &'a [f32])>,
    ) -> Result<(), RenderError> {
        let mut all = Vec::new();
        for (name, own) in ranges {
            let name = name.as_ref();
            if Self::is_matrix(name) {
                let parts = self.placed_by(name, own)?;
                all.extend(parts.into_iter().map(|(name, own)| (name, Cow::Owned(own))));
            } else {
                all.push((name.to_owned(), Cow::Borrowed(own)));
            }
        }
        let parts = all.iter().filter(|(_, own)| matches!(own, Cow::Owned(_)));
        let parts: Vec<&String> = parts.map(|(name, _)| name).collect();
        self.make_movable(&parts)?;
        let mut values = self.params.values().to_vec();
        for (name, own) in &all {
            let info = self.params.find(name)?;
            if own.len() != info.shape.len() {
                return Err(RenderError::ParameterLength {
                    name: info.name.clone(),
                    expected: info.shape.len(),
                    found: own.len(),
                });
            }
            values[info.range()].copy_from_slice(own);
        }
        self.set_params(&values)
    }

    /// Materials, by index.
    pub fn materials(&self) -> &[Arc<Material>] {
        &self.materials
    }

    /// Emitters, by index.
    pub fn emitters(&self) -> &[AnyEmitter] {
        &self.emitters
    }

    /// What the scene file says of emitters and manifold connections, by index.
    pub fn emitter_hints(&self) -> &[Hints] {
        &self.emitter_hints
    }

    /// Whether rays that leave the scene may meet light.
    pub(crate) fn has_sky(&self) -> bool {
        let met = |&e: &u32| !self.emitters[e as usize].is_delta();
        self.infinite.iter().any(met)
    }

    /// Emitters that surround the scene, by index.
    pub fn infinite_emitters(&self) -> &[u32] {
        &self.infinite
    }

    /// How often each emitter is sampled.
    #[inline(always)]
    pub(crate) fn shares(&self) -> &Shares {
        &self.shares
    }

    /// Makes emitters be sampled in proportion to these weights, one each. They are equal unless the scene file
    /// says otherwise (`sampling_weight`); `auto::sampling_weights` measures which are best. No expectation
    /// changes, only variances do.
    ///
    /// ```
    /// use render::instances::{Estimator, render_f32};
    /// use render::params::Theta;
    /// use render::{Job, Scene, auto};
    ///
    /// let text = r#"<scene version="3.0.0">
    ///     <sensor type="perspective">
    ///         <float name="fov" value="30"/>
    ///         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    ///     </sensor>
    ///     <shape type="rectangle">
    ///         <transform name="to_world"><scale value="3"/><rotate y="1" angle="180"/><translate z="5"/></transform>
    ///     </shape>
    ///     <emitter type="point"><rgb name="intensity" value="99"/></emitter>
    ///     <emitter type="point"><rgb name="intensity" value="1"/></emitter>
    /// </scene>"#;
    /// let (mut scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
    /// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
    /// let (none, settings): (&[&str], _) = (&[], scene.settings); // of the image, and of no derivative
    /// let weights = auto::sampling_weights(&scene, none, &adjoint, Estimator::Mis, &settings, 1, &())?;
    /// assert!(weights[0] > 5.0 * weights[1]); // one per emitter
    ///
    /// let mean = |scene: &Scene| {
    ///     let (job, values) = (Job::new(scene, &settings, 0, 0..64, &()), scene.params().values());
    ///     render_f32(&job, &Theta::constant(values), Estimator::Mis).mean(0)[0]
    /// };
    /// let even = mean(&scene);
    /// scene.set_sampling_weights(&weights)?;
    /// assert!((mean(&scene) / even - 1.0).abs() < 0.05); // the same but for noise
    /// assert!(scene.set_sampling_weights(&[1.0]).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Wrong length, or a weight that is not a positive number.
    pub fn set_sampling_weights(&mut self, weights: &[f64]) -> Result<(), RenderError> {
        if weights.len() != self.emitters.len() {
            return Err(RenderError::WrongLength {
                what: "sampling weights",
                expected: self.emitters.len(),
                found: weights.len(),
            });
        }
        if let Some(emitter) = weights.iter().position(|w| !(*w > 0.0 && w.is_finite())) {
            return Err(RenderError::SamplingWeight {
                emitter,
                found: weights[emitter],
            });
        }
        self.shares = Shares::new(weights);
        Ok(())
    }

    /// How often each pixel is sampled.
    #[inline]
    pub(crate) fn pixel_shares(&self) -> &PixelShares {
        &self.pixels
    }

    /// Makes the pixels of the crop window, row by row, be sampled in proportion to these weights: a quarter to
    /// 64 times the samples per pixel asked for, by powers of two. They are equal at first, and as many samples are
    /// taken in all; `auto::pixel_weights` measures which are best. No expectation changes, only variances do.
    /// Particles are not concerned.
    ///
    /// ```
    /// use render::instances::{Estimator, render_f32};
    /// use render::params::Theta;
    /// use render::{Job, Scene};
    ///
    /// let mut room = render::scene::room(8, 8)?;
    /// let mean = |room: &Scene| {
    ///     let (job, values) = (Job::new(room, &room.settings, 0, 0..64, &()), room.params().values());
    ///     render_f32(&job, &Theta::constant(values), Estimator::Mis).mean(0)[0]
    /// };
    /// let even = mean(&room);
    /// // [height][width]: four times the samples for the upper half, where the lamp is.
    /// let weights: Vec<f32> = (0..64).map(|pixel| if pixel < 32 { 4.0 } else { 1.0 }).collect();
    /// room.set_pixel_weights(&weights)?;
    /// assert!((mean(&room) / even - 1.0).abs() < 0.05); // the same but for noise
    /// assert!(room.set_pixel_weights(&weights[1..]).is_err());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// Wrong length, or a weight that is negative or not finite.
    pub fn set_pixel_weights(&mut self, weights: &[f32]) -> Result<(), RenderError> {
        let (expected, found) = (self.film.pixels(), weights.len());
        if expected != found {
            return Err(RenderError::WrongLength {
                what: "pixel weights",
                expected,
                found,
            });
        }
        if let Some(pixel) = weights.iter().position(|w| !(*w >= 0.0 && w.is_finite())) {
            return Err(RenderError::PixelWeight {
                pixel,
                found: weights[pixel],
            });
        }
        self.pixels = PixelShares::new(weights);
        Ok(())
    }

    /// Where light comes from.
    #[inline(always)]
    pub(crate) fn guide(&self) -> Option<&Guide> {
        self.guide.as_ref()
    }

    /// Makes half of the directions that paths scatter from diffuse surfaces go where light comes from, as
    /// `auto::guide` has learned. No expectation changes, only variances do. Estimators whose samples or weights
    /// move with the parameters, particles and finite elements are not concerned.
    ///
    /// ```
    /// use render::instances::{Estimator, render_f32};
    /// use render::params::Theta;
    /// use render::{Job, Scene, Settings, auto};
    ///
    /// let mut room = render::scene::room(8, 8)?;
    /// let settings = Settings { max_depth: 3, ..room.settings };
    /// let mean = |room: &Scene| {
    ///     let (job, values) = (Job::new(room, &settings, 0, 0..64, &()), room.params().values());
    ///     render_f32(&job, &Theta::constant(values), Estimator::Detached).mean(0)[0]
    /// };
    /// let blind = mean(&room);
    /// assert!(auto::guide(&mut room, &settings, 1, &())); // learns, and sets what it has learned
    /// let guided = mean(&room);
    /// assert!((guided / blind - 1.0).abs() < 0.1 && guided != blind); // the same but for noise
    /// room.set_guide(None);
    /// assert_eq!(mean(&room), blind);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn set_guide(&mut self, guide: Option<Guide>) {
        self.guide = guide;
    }

    /// Balls around what throws caustics: particles that are to find them are sent towards one.
    pub(crate) fn casters(&self) -> &[Ball] {
        &self.geometry.casters
    }

    /// Balls around all that emits; `None` if that is everywhere.
    pub(crate) fn lamps(&self) -> Option<&[Ball]> {
        self.geometry.lamps.as_deref()
    }

    /// Whether a ray may meet something that emits, or leave towards it: false only where it certainly does not.
    #[inline]
    pub(crate) fn may_meet_light<P: Float>(&self, ray: &Ray<P>) -> bool {
        (self.geometry.lamps.as_ref())
            .is_none_or(|lamps| lamps.iter().any(|ball| ball.may_be_met(ray)))
    }

    /// The same of many rays, one in `meets` for each that may: without branches.
    #[inline(always)]
    pub(crate) fn may_meet_light_each<P: Float>(
        &self,
        meets: &mut [u32],
        ray: impl Fn(usize) -> Ray<P>,
    ) {
        let Some(lamps) = &self.geometry.lamps else {
            meets.fill(1);
            return;
        };
        for ball in lamps {
            for (i, meets) in meets.iter_mut().enumerate() {
                *meets |= u32::from(ball.may_be_met(&ray(i)));
            }
        }
    }

    /// Shapes, by index.
    pub fn shapes(&self) -> &[AnyShape] {
        &self.geometry.shapes
    }

    /// What belongs to a shape.
    #[inline]
    pub fn shape_info(&self, shape: u32) -> &ShapeInfo {
        &self.infos[shape as usize]
    }

    /// The material of a shape.
    #[inline(always)]
    pub fn material(&self, shape: u32) -> &Material {
        &self.materials[self.infos[shape as usize].material as usize]
    }

    /// What emitters need to know.
    #[inline]
    pub fn lights(&self) -> Lights<'_> {
        Lights {
            shapes: &self.geometry.shapes,
            prims: &self.geometry.prims,
            firsts: &self.geometry.firsts,
        }
    }

    /// The nearest primitive along a ray: a primal search.
    #[inline(always)]
    pub fn nearest<R: Real>(&self, ray: &Ray<R>) -> Option<Hit> {
        let (o, d) = single(&ray.primal());
        self.geometry.accel.intersect(o, d, f32::INFINITY, ray.from)
    }

    /// What lies at a hit of this ray. It follows the tangents of the ray and of the parameters.
    #[inline(always)]
    pub fn interaction<R: Real>(
        &self,
        theta: &Theta<R>,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> Intersection<R> {
        let Prim { shape, local, .. } = self.geometry.prim(hit.prim);
        let own = &self.geometry.shapes[shape as usize];
        let si = match self.geometry.drift(shape, theta) {
            None => own.interaction(theta, local, ray, hit),
            // Seen from the shape that moves, it is the ray that moves, the other way.
            Some(drift) => {
                let seen = own.interaction(theta, local, &drift.ray_back(ray), hit);
                seen.carried(&drift, own.carries_frame(local))
            }
        };
        Intersection {
            shape,
            prim: hit.prim,
            si,
        }
    }

    /// The shape that was hit, how rays leave it, and the parallelogram, if it was one.
    #[inline(always)]
    pub(crate) fn patch(&self, hit: &Hit) -> (u32, Exit, Option<&Patch>) {
        let Prim {
            shape, patch, exit, ..
        } = self.geometry.prim(hit.prim);
        (shape, exit, self.geometry.patches.get(patch as usize))
    }

    /// Whether there are parallelograms and instances alone.
    #[inline]
    pub(crate) fn has_patches_only(&self) -> bool {
        self.geometry.prims.len() == self.geometry.patches.len()
    }

    /// What was hit.
    #[inline(always)]
    pub(crate) fn surface(&self, hit: &Hit) -> HitSurface<'_> {
        let Some(&Prim { shape, local, .. }) = self.geometry.prims.get(hit.prim as usize) else {
            return HitSurface::Other;
        };
        match &self.geometry.shapes[shape as usize] {
            AnyShape::Mesh(mesh) => HitSurface::Mesh(mesh, local),
            AnyShape::Sphere(sphere) => HitSurface::Sphere(sphere),
            _ => HitSurface::Other,
        }
    }

    /// Says that [`Scene::fetch`] will be asked.
    #[inline(always)]
    pub(crate) fn expect(&self, hit: &Hit) {
        let prim = self.geometry.prims.get(hit.prim as usize);
        prim.into_iter().for_each(prefetch);
    }

    /// Brings what [`Scene::interaction`] looks up near.
    #[inline]
    pub(crate) fn fetch(&self, hit: &Hit) {
        let Prim { shape, local, .. } = self.geometry.prim(hit.prim);
        self.geometry.shapes[shape as usize].fetch(local);
    }

    /// [`Scene::nearest`], and what lies there.
    #[inline]
    pub fn intersect<P: Float>(&self, ray: &Ray<P>) -> Option<Intersection<P>> {
        self.intersect_moving(&Theta::still(), ray)
    }

    /// [`Scene::intersect`] over any scalar: what lies there follows the tangents of the ray and of the parameters.
    #[inline]
    pub fn intersect_moving<R: Real>(
        &self,
        theta: &Theta<R>,
        ray: &Ray<R>,
    ) -> Option<Intersection<R>> {
        self.nearest(ray)
            .map(|hit| self.interaction(theta, ray, &hit))
    }

    /// Where a point of a primitive is on its material: [`Shape::coordinates`].
    pub fn coordinates<P: Float>(
        &self,
        prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        self.geometry.shapes[shape as usize].coordinates(local, si)
    }

    /// The point of a primitive with these surface coordinates: [`Shape::point_at`].
    ///
    /// # Derivatives
    /// In `theta` and in `at`.
    pub fn point_at<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        let own = &self.geometry.shapes[shape as usize];
        let si = own.point_at(theta, local, at);
        match self.geometry.drift(shape, theta) {
            None => si,
            Some(drift) => si.carried(&drift, own.carries_frame(local)),
        }
    }

    /// Area of a primitive per constant measure of its surface coordinates: [`Shape::area_element`].
    ///
    /// # Derivatives
    /// In `theta`.
    pub fn area_element<R: Real>(&self, theta: &Theta<R>, prim: u32) -> R {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        let area = self.geometry.shapes[shape as usize].area_element(theta, local);
        match self.geometry.drift(shape, theta) {
            None => area,
            Some(drift) => area * drift.area(),
        }
    }

    /// Adds the adjoints of parameters that move a shape, given those of the point `si` of its primitive `prim`, which
    /// stays on its material, and of the logarithm of the area there: the transpose of [`Scene::point_at`] and
    /// [`Scene::area_element`].
    pub fn scatter_point<P: Float>(
        &self,
        theta: &Theta<P>,
        prim: u32,
        si: &SurfaceInteraction<P>,
        d: &SurfaceAdjoint<P>,
        d_log_area: P,
        grad: &mut impl GradSink<P>,
    ) {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        let own = &self.geometry.shapes[shape as usize];
        own.scatter_point(local, own.coordinates(local, si), d, grad);
        if d_log_area != P::zero() {
            let area: P = own.area_element(&Theta::still(), local);
            own.scatter_area(local, d_log_area / area, grad);
        }
        if let Some(placement) = self.geometry.placement(shape) {
            let mut wrench = placement.wrench(theta);
            d.act(si, own.carries_frame(local), &mut wrench);
            wrench.area(d_log_area);
            placement.scatter(theta, &wrench, grad);
        }
    }

    /// Adds the adjoints of parameters that move a shape, given those of what `ray` meets there: the transpose of
    /// [`Scene::interaction`]. The adjoints of the ray.
    pub fn scatter_interaction<P: Float>(
        &self,
        theta: &Theta<P>,
        prim: u32,
        ray: &Ray<P>,
        si: &SurfaceInteraction<P>,
        d: &SurfaceAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) -> RayAdjoint<P> {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        let own = &self.geometry.shapes[shape as usize];
        // Where along the ray is all that shapes take from it.
        let hit = Hit {
            t: si.t.to_f32(),
            u: 0.0,
            v: 0.0,
            prim,
        };
        own.scatter_interaction(local, ray, &hit, d, grad);
        let vary = |v: Vec3<P>, first: usize| {
            let var = |i: usize| Dual::<P, 6>::var(v[i], first + i);
            Vec3::new(var(0), var(1), var(2))
        };
        let moving = Ray::new(vary(ray.o, 0), vary(ray.d, 3));
        let seen = own.interaction(&Theta::still(), local, &moving, &hit);
        let [ox, oy, oz, dx, dy, dz] = d.of(&seen).eps;
        let back = RayAdjoint {
            o: Vec3::new(ox, oy, oz),
            d: Vec3::new(dx, dy, dz),
        };
        if let Some(placement) = self.geometry.placement(shape) {
            let mut wrench = placement.wrench(theta);
            d.act(si, own.carries_frame(local), &mut wrench);
            wrench.point(ray.o, -back.o);
            wrench.vector(ray.d, -back.d);
            placement.scatter(theta, &wrench, grad);
        }
        back
    }

    /// How the surface changes with its texture coordinates there, as the shape has it: [`Shape::partials`].
    ///
    /// # Derivatives
    /// In `theta` and in `at`. The axes of the frame turn along, also where [`Shape::carries_frame`] says otherwise.
    pub fn partials<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let Prim { shape, local, .. } = self.geometry.prim(prim);
        let partials = self.geometry.shapes[shape as usize].partials(theta, local, at)?;
        Some(match self.geometry.drift(shape, theta) {
            None => partials,
            Some(drift) => partials.carried(&drift),
        })
    }

    /// The same with normal maps, and the frame that they give, world space: [`Bsdf::shading_frame`]. `wo` is the unit
    /// direction to the viewer, world space, and `route` the part of blends and masks.
    pub fn mapped_partials<P: Float>(
        &self,
        theta: &Theta<P>,
        prim: u32,
        at: SurfaceCoordinates<P>,
        wo: Vec3<P>,
        route: u8,
    ) -> Option<(Frame<P>, Partials<P>)> {
        let partials = self.partials(theta, prim, at)?;
        let si = self.point_at(theta, prim, at);
        let shading = Shading::new(
            theta.lift::<Dual<P, 2>>(),
            Vec2::new(Dual::var(si.uv.x, 0), Dual::var(si.uv.y, 1)),
        );
        let wo = si.frame.to_local(wo);
        let material = self.material(self.geometry.prim(prim).shape);
        let local = material.shading_frame(&shading, wo, route, TransportMode::Radiance);
        Some(partials.mapped(&si.frame, &local))
    }

    /// Whether anything lies in between.
    #[inline(always)]
    pub fn occluded<P: Float>(&self, segment: &Segment<P>) -> bool {
        let Segment { ray, length, to } = segment;
        let (o, d) = single(ray);
        self.geometry
            .accel
            .occluded(o, d, length.to_f32(), [ray.from, *to])
    }

    /// Edges of all shapes as they are: found by the first call after every change.
    pub(crate) fn edges(&self) -> &Edges {
        self.geometry.edges()
    }

    /// Lines along which surfaces cross, likewise.
    pub(crate) fn crossings(&self) -> &Crossings {
        self.geometry.crossings()
    }

    /// What edges need to know.
    pub(crate) fn surfaces(&self) -> Surfaces<'_> {
        Surfaces {
            shapes: &self.geometry.shapes,
            firsts: &self.geometry.firsts,
        }
    }

    /// Index of the shape that a primitive belongs to.
    #[inline]
    pub(crate) fn shape_of(&self, prim: u32) -> u32 {
        self.geometry.prim(prim).shape
    }

    /// Parameters that move shapes, each with one of the shapes.
    pub(crate) fn movers(&self) -> &[(u32, ParamRef)] {
        self.geometry.reads()
    }

    /// Index in the scene of a shape's primitive.
    pub(crate) fn primitive(&self, shape: u32, local: u32) -> u32 {
        self.geometry.firsts[shape as usize] + local
    }

    /// How rays leave a primitive.
    #[inline(always)]
    pub fn exit(&self, prim: u32) -> Exit {
        self.geometry.prim(prim).exit
    }

    /// Whether rays go through a hierarchy.
    #[inline]
    pub(crate) fn has_hierarchy(&self) -> bool {
        self.geometry.accel.has_hierarchy()
    }

    /// [`Scene::nearest`] for a packet of rays.
    #[inline]
    pub fn nearest_packet(&self, rays: &RayPacket) -> [Option<Hit>; PACKET_SIZE] {
        self.geometry.accel.intersect_packet(rays)
    }

    /// [`Scene::occluded`] for a packet of rays: one bit each.
    #[inline]
    pub fn occluded_packet(&self, rays: &RayPacket) -> u32 {
        self.geometry.accel.occluded_packet(rays)
    }

    /// Whether an estimator is right in this scene: samples that move by themselves must not meet discontinuities.
    ///
    /// # Errors
    /// Naive attached sampling in a scene where something may occlude something else, or where whole paths slide over edges
    /// or textures that jump: [`Scene::discontinuity`].
    pub fn admits<S: Strategy>(&self) -> Result<(), RenderError> {
        if S::NEEDS_CONTINUITY
            && let Some(culprit) = self.discontinuity(!S::Bsdf::DETACHED_PATH)
        {
            return Err(RenderError::Discontinuous { culprit });
        }
        if matches!(S::Bsdf::DIRECT, Direct::Reparameterised { .. })
            && let Some(shape) = self.curves()
        {
            let culprit = format!(
                "the outlines of the curves `{}`, which are not known",
                shape.name
            );
            return Err(RenderError::Discontinuous { culprit });
        }
        Ok(())
    }

    /// A shape that is made of curves, whose outlines have no edges yet.
    pub(crate) fn curves(&self) -> Option<&ShapeInfo> {
        let mut all = self.infos.iter().zip(&self.geometry.shapes);
        all.find_map(|(info, shape)| matches!(shape, AnyShape::Curves(_)).then_some(info))
    }

    /// Something that makes the integrand at a surface discontinuous in direction: an [`Scene::outline`] or a
    /// [`Scene::horizon`]. `None` for a single flat or convex shape without mapped normals, lit by points and
    /// environments.
    pub fn discontinuity(&self, paths_move: bool) -> Option<String> {
        self.outline(paths_move).or_else(|| self.horizon())
    }

    /// The horizon of a rough surface with mapped normals, whose lobe does not vanish there (F9).
    pub fn horizon(&self) -> Option<String> {
        let mapped = |m: &Material| {
            let mut any = false;
            m.visit_textures(&mut |t| {
                any |= matches!(
                    t,
                    TextureRef::Vector(_) | TextureRef::Encoded(_) | TextureRef::Height(_)
                )
            });
            any && !m.is_delta()
        };
        let tilted = |i: &&ShapeInfo| mapped(&self.materials[i.material as usize]);
        let info = self.infos.iter().find(tilted)?;
        let name = &info.name;
        Some(format!("the horizon of `{name}`, whose normals are mapped"))
    }

    /// An outline of a light or a border in what it throws, or a shape that may stand in front of another or of itself.
    ///
    /// If `paths_move`, vertices slide over what is behind them, too: over the edges of a cube, and over textures of a
    /// sphere that jump somewhere. What flat shapes scatter never meets them again.
    pub fn outline(&self, paths_move: bool) -> Option<String> {
        if let Some(info) = self.infos.iter().find(|i| i.emitter.is_some()) {
            return Some(format!("the outline of the light `{}`", info.name));
        }
        let thrown = |e: &AnyEmitter| e.has_border() || e.throws_jumps();
        if !self.infos.is_empty() && self.emitters.iter().any(thrown) {
            return Some("a border in what a light throws".into());
        }
        let convex = |s: &AnyShape| {
            use AnyShape::{Curves, Cylinder, Instance, Mesh};
            !matches!(s, Mesh(_) | Instance(_) | Cylinder(_) | Curves(_))
        };
        match (&self.infos[..], &self.geometry.shapes[..]) {
            ([], _) => None,
            ([info], [AnyShape::Cube(_)]) if paths_move => Some(format!(
                "the edges of `{}`, over which paths move",
                info.name
            )),
            ([info], [AnyShape::Sphere(_)]) if paths_move => {
                let mut jumps = false;
                self.materials[info.material as usize]
                    .visit_textures(&mut |t| jumps |= !t.closes(0));
                jumps.then(|| {
                    format!(
                        "a texture of `{}` that jumps where paths move over it",
                        info.name
                    )
                })
            }
            ([_], [shape]) if convex(shape) => None,
            ([.., info], _) => Some(format!("occlusion by `{}`", info.name)),
        }
    }

    /// Distance of a ray from the outline of the primitive that another ray hit, as [`Shape::border`].
    pub fn border<R: Real>(&self, ray: &Ray<R>, hit: &Hit) -> R {
        let Prim { shape, local, .. } = self.geometry.prim(hit.prim);
        self.geometry.shapes[shape as usize].border(local, ray)
    }

    /// Bytes held by geometry, acceleration structure and parameters.
    pub fn memory_bytes(&self) -> usize {
        self.geometry.accel.memory_bytes()
            + size_of_val(&self.geometry.prims[..])
            + size_of_val(self.params.values())
    }
}

/// A ray as the acceleration structure takes it.
#[inline]
pub(crate) fn single<P: Float>(ray: &Ray<P>) -> ([f32; 3], [f32; 3]) {
    (
        ray.o.map(P::to_f32).to_array(),
        ray.d.map(P::to_f32).to_array(),
    )
}
