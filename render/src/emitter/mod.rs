//! Light sources.
//!
//! Every emitter is linear in one RGB texture: what it emits at a point or in a direction is
//! the texture there times a scalar [`Emission::falloff`], and times one number that is a parameter, if it has such
//! a [`Emitter::scale`]. Evaluation and adjoint share that form.
//!
//! Direct light at the point that a pixel sees, by one sample of a lamp:
//!
//! ```
//! use render::emitter::Emitter;
//! use render::params::Theta;
//!
//! let room = render::scene::room(64, 64)?;
//! let theta = Theta::constant(room.params().values());
//! let seen = room.intersect(&room.camera.ray(32.5f32, 50.5)).expect("the room is closed");
//! let lamp = &room.emitters()[0];
//! let sample = lamp.sample(room.lights(), seen.si.p, [0.3, 0.6]).expect("the lamp faces it");
//! let way = seen.si.shadow_ray(sample.d, sample.distance, room.exit(seen.prim), sample.surface);
//! if !room.occluded(&way) {
//!     let radiance = lamp.eval(&theta, &sample.emission);
//!     let irradiance = radiance * (sample.d.dot(seen.si.frame.n).max(0.0) / sample.pdf);
//!     assert!(irradiance.is_finite());
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! To add an emitter: one file here, one line in `emitters!` below.

mod area;
mod constant;
mod directional;
mod directional_area;
mod envmap;
mod point;
mod projector;
mod spot;
mod vmf;

pub use area::Area;
pub use constant::Constant;
pub use directional::Directional;
pub use directional_area::DirectionalArea;
pub use envmap::{Envmap, Moved, MovingDraw, Shift};
pub(crate) use envmap::{Local as LocalSums, MapPoint};
pub use point::Point;
pub(crate) use point::towards_in_line;
pub(crate) use projector::Plane;
pub use projector::{Projector, Slide};
pub(crate) use spot::Cone;
pub use spot::Spot;
pub use vmf::Vmf;

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec2, Vec3};

use crate::error::SceneError;
use crate::math::{Frame, NOWHERE, Ray, Rgb, each, warp};
use crate::motion::Placement;
use crate::params::{GradSink, ParamRef, ParamShape, Params, Theta};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{AnyShape, Exit, Prim, Shape, SurfaceInteraction};
use crate::texture::RgbTexture;

/// Where an emitter's texture is read, and the factor it is multiplied with.
#[derive(Clone, Copy, Debug)]
pub struct Emission<R> {
    /// Texture coordinates.
    pub uv: Vec2<R>,
    /// Everything that is not the texture: directional lobe, inverse square law, scale.
    pub falloff: R,
}

impl<R: Real> Emission<R> {
    /// Nothing but the texture, which is the same everywhere.
    #[inline]
    pub fn whole() -> Self {
        Self {
            uv: Vec2::zero(),
            falloff: R::one(),
        }
    }

    /// The same without tangents.
    #[inline]
    pub fn primal(&self) -> Emission<R::Primal> {
        Emission {
            uv: self.uv.primal(),
            falloff: self.falloff.primal(),
        }
    }
}

impl<P: Float> Emission<P> {
    /// The same over a scalar with tangents, all of them zero.
    #[inline]
    pub fn lift<R: Real<Primal = P>>(&self) -> Emission<R> {
        Emission {
            uv: Vec2::lift(self.uv),
            falloff: R::lift(self.falloff),
        }
    }
}

/// A direction towards an emitter.
#[derive(Clone, Copy, Debug)]
pub struct EmitterSample<P> {
    /// Unit direction from the reference point to the light, world space.
    pub d: Vec3<P>,
    /// Distance to the light; infinite for environments.
    pub distance: P,
    /// Unit shading and geometric normals of the light's surface there; zero without one.
    pub normals: [Vec3<P>; 2],
    /// The surface that the point on the light belongs to, see [`crate::math::Segment::to`].
    pub surface: u32,
    /// The primitive of the light's shape that it lies on; zero without one.
    pub prim: u32,
    /// Density per solid angle; 1 for a delta light.
    pub pdf: P,
    /// What arrives.
    pub emission: Emission<P>,
}

impl<P: Float> EmitterSample<P> {
    /// Of light that has no surface: from the unit direction `d`, at this distance, with this density per solid angle (one
    /// for Dirac deltas).
    #[inline(always)]
    pub(crate) fn without_surface(d: Vec3<P>, distance: P, pdf: P, emission: Emission<P>) -> Self {
        Self {
            d,
            distance,
            normals: [Vec3::zero(); 2],
            surface: NOWHERE,
            prim: 0,
            pdf,
            emission,
        }
    }
}

/// An [`EmitterSample`] as seen from a moving point.
#[derive(Clone, Copy, Debug)]
pub struct Connection<R> {
    /// Unit direction to the light, world space.
    pub d: Vec3<R>,
    /// Density per solid angle; 1 for a delta light.
    pub pdf: R,
    /// What arrives.
    pub emission: Emission<R>,
}

/// A particle's start.
#[derive(Clone, Copy, Debug)]
pub struct EmittedRay<P> {
    /// Origin and unit direction, world space; environments start outside the scene.
    pub ray: Ray<P>,
    /// The light's shape and the point on it; none without one.
    pub surface: Option<(u32, SurfaceInteraction<P>)>,
    /// How it leaves that.
    pub exit: Exit,
    /// Density of the origin: per area of the surface, per area across the direction for environments,
    /// 1 for a delta.
    pub pdf_position: P,
    /// Density of the direction, per solid angle.
    pub pdf_direction: P,
    /// What is emitted: radiance, or intensity for points.
    pub emission: Emission<P>,
}

/// How a Dirac delta sends light.
#[derive(Clone, Copy, Debug)]
pub enum Rays {
    /// From this point, world space.
    From([f32; 3]),
    /// Along this unit direction, world space.
    Along(Vec3<f64>),
}

/// How far inside of their borders, relative to their size, lights are looked at.
const INSIDE_BORDER: f64 = 1e-5;

/// A point of the sides of a quadrilateral, each of which has a quarter of the numbers in [0, 1), and its change with the
/// number.
fn around(corners: [Vec3<f64>; 4], u: f64) -> [Vec3<f64>; 2] {
    let side = ((4.0 * u) as usize).min(3);
    let along = corners[(side + 1) % 4] - corners[side];
    let p = corners[side] + along * (4.0 * u - side as f64);
    [p, along * 4.0]
}

/// A point just inside of where the light of a Dirac delta ends: across that it jumps.
#[derive(Clone, Copy, Debug)]
pub struct Border<P> {
    /// From the light along its border, world space.
    pub ray: Ray<P>,
    /// Unit vector across the ray and the border, towards the light.
    pub inside: Vec3<f64>,
    /// The change of the point with the number that it is chosen with: of its direction, in radians, where light comes from a
    /// point.
    pub length: f64,
    /// What goes along the ray: of points, per solid angle.
    pub emission: Emission<P>,
}

impl<P: Float> EmittedRay<P> {
    /// What the emitted radiance is multiplied with to give the power of the particle: the cosine to
    /// the surface over both densities.
    #[inline]
    pub fn weight(&self) -> P {
        let cos = match &self.surface {
            Some((_, si)) => si.n_geo.dot(self.ray.d).abs(),
            None => P::one(),
        };
        cos / (self.pdf_position * self.pdf_direction)
    }
}

/// A ball around surfaces: all of a scene, for particles from infinitely far away, or what particles are aimed at, or
/// lamps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    /// Centre, world space.
    pub centre: [f64; 3],
    /// Positive.
    pub radius: f64,
}

impl Ball {
    /// The ball around the bounds of these shapes; `None` if there are none.
    pub fn around<'a>(shapes: impl IntoIterator<Item = &'a AnyShape>) -> Option<Self> {
        let mut low = [f64::INFINITY; 3];
        let mut high = [f64::NEG_INFINITY; 3];
        for [a, b] in shapes.into_iter().map(Shape::bounds) {
            for k in 0..3 {
                low[k] = low[k].min(f64::from(a[k]));
                high[k] = high[k].max(f64::from(b[k]));
            }
        }
        let half = Vec3::from(std::array::from_fn(|k| 0.5 * (high[k] - low[k])));
        // A little more than all of it, for rounding.
        let radius = half.length() * 1.001;
        (radius > 0.0 && radius.is_finite()).then(|| Self {
            centre: std::array::from_fn(|k| 0.5 * (low[k] + high[k])),
            radius,
        })
    }

    /// Whether a ray may meet anything within: false only where it certainly does not, whatever its rounding.
    #[inline]
    pub(crate) fn may_be_met<P: Float>(&self, ray: &Ray<P>) -> bool {
        let centre = Vec3::from(each(self.centre, P::of));
        let to = centre - ray.o;
        let radius2 = P::of(1.01 * self.radius * self.radius);
        let distance2 = to.length_squared();
        // A few roundings of the distance and of the coordinates.
        let reach2 = radius2 + P::of(1e-10) * (distance2 + centre.length_squared());
        let passes = to.cross(ray.d).length_squared() <= reach2;
        // Without branches, for loops over many rays.
        (distance2 <= reach2) | (passes & (to.dot(ray.d) > P::zero()))
    }
}

/// A particle from an environment: it arrives from `sample.d`, on a disc that hides the scene. Uses
/// the density of [`Emitter::sample`], which does not depend on the point of reference.
fn from_afar<P: Float>(ball: Ball, sample: &EmitterSample<P>, u: [P; 2]) -> EmittedRay<P> {
    let frame = Frame::from_normal(sample.d);
    let disc = warp::square_to_disk(u);
    let radius = P::of(ball.radius);
    let centre = Vec3::from(each(ball.centre, P::of));
    let local = Vec3::new(disc.x, disc.y, P::one()) * radius;
    EmittedRay {
        ray: Ray::new(centre + frame.to_world(local), -sample.d),
        surface: None,
        exit: Exit::default(),
        pdf_position: (P::of(PI) * radius * radius).recip(),
        pdf_direction: sample.pdf,
        emission: sample.emission,
    }
}

/// What the scene knows that emitters need.
#[derive(Clone, Copy, Debug)]
pub struct Lights<'a> {
    /// All shapes of the scene.
    pub shapes: &'a [AnyShape],
    /// Their primitives.
    pub(crate) prims: &'a [Prim],
    /// The first primitive of each.
    pub(crate) firsts: &'a [u32],
}

impl Lights<'_> {
    #[inline(always)]
    fn prim(&self, shape: u32, local: u32) -> &Prim {
        &self.prims[(self.firsts[shape as usize] + local) as usize]
    }

    /// The surface that primitive `local` of a shape lies on.
    #[inline(always)]
    pub(crate) fn surface(&self, shape: u32, local: u32) -> u32 {
        self.prim(shape, local).surface
    }
}

/// A light source.
pub trait Emitter: Send + Sync {
    /// The parameters that emission is linear in.
    fn radiance(&self) -> &RgbTexture;

    /// One number that all of it is multiplied with, if that is a parameter.
    #[inline(always)]
    fn scale(&self) -> Option<ParamRef> {
        None
    }

    /// Calls `f` with every range that scales what is emitted.
    fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
        self.radiance().visit_params(f);
        self.scale().into_iter().for_each(f);
    }

    /// What a ray with unit direction `d` receives that hits the emitter's shape at `si`, or that
    /// leaves the scene (`si` is `None`). `None` if nothing.
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>>;

    /// The same where it is known but for tangents: `at`.
    ///
    /// # Derivatives
    /// Of first order, those of [`Emitter::hit`].
    fn hit_again<R: Real>(
        &self,
        d: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
        _at: &Emission<R::Primal>,
    ) -> Option<Emission<R>> {
        self.hit(d, si)
    }

    /// Samples a direction from the point `from` (world space).
    fn sample<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        u: [P; 2],
    ) -> Option<EmitterSample<P>>;

    /// Samples where a particle starts: its position with `u[0..2]`, its direction with `u[2..4]`.
    /// `ball` is that of the scene. `None` where nothing is emitted: an environment around an empty scene,
    /// or a direction with density zero.
    ///
    /// The default is that of environments.
    fn sample_ray<P: Float>(
        &self,
        _theta: &Theta<P>,
        lights: Lights,
        ball: Option<Ball>,
        [u0, u1, u2, u3]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let sample = self.sample(lights, Vec3::zero(), [u2, u3])?;
        (sample.pdf > P::zero()).then_some(from_afar(ball?, &sample, [u0, u1]))
    }

    /// What leaves the surface point `si`, or the emitter if that is a point, in the unit direction `d`, and the
    /// density of such a direction in [`Emitter::sample_ray`], per solid angle. `None` if nothing does.
    ///
    /// The default is that of environments: what they emit comes from everywhere.
    fn leaves<P: Float>(
        &self,
        _d: Vec3<P>,
        _si: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        None
    }

    /// Density of [`Emitter::sample`] for the direction `d` that hits it at `si`, per solid angle;
    /// zero for delta lights, which is the default.
    ///
    /// # Derivatives
    /// In the direction and what it hits.
    #[inline]
    fn pdf<R: Real>(
        &self,
        _lights: Lights,
        _from: Vec3<R>,
        _d: Vec3<R>,
        _si: Option<&SurfaceInteraction<R>>,
    ) -> R {
        R::zero()
    }

    /// The same sample of the light seen from a reference point that moves: direction, density and
    /// emission, in area form: the *point* on the light stays where it is (environments keep the
    /// direction instead).
    ///
    /// # Derivatives
    /// In `from`, whose primal is the point that the sample was drawn for.
    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, _from: Vec3<R>) -> Connection<R> {
        Connection {
            d: Vec3::lift(sample.d),
            pdf: R::lift(sample.pdf),
            emission: sample.emission.lift(),
        }
    }

    /// How it sends light, if that is a Dirac delta.
    fn rays(&self, _lights: Lights) -> Option<Rays> {
        None
    }

    /// A point of its border, chosen by a number in [0, 1), if it has one.
    fn border<P: Float>(&self, _lights: Lights, _u: f64) -> Option<Border<P>> {
        None
    }

    /// Whether it can be hit only by sampling it.
    fn is_delta(&self) -> bool {
        false
    }

    /// Whether it surrounds the scene.
    fn is_infinite(&self) -> bool {
        false
    }

    /// Whether scattered directions find it without help: its light, were it the same everywhere, would cover a fraction
    /// [`WIDE`] of the sphere, by its squared mean over the mean of its square.
    fn is_wide(&self) -> bool {
        false
    }

    /// Follows parameters that have changed: its place, and sampling tables.
    fn update(&mut self, _params: &Params) {}

    /// What of it a parameter of three numbers can move, with its value now: the `position` of points, world space, the
    /// `rotation` of what shines from afar, a rotation vector about the world's axes.
    fn mobility(&self) -> Option<(&'static str, [f32; 3])> {
        self.turned().map(|_| ("rotation", [0.0; 3]))
    }

    /// Says that this parameter is that.
    fn make_movable(&mut self, _p: ParamRef) {}

    /// The parameter that moves it, if there is one.
    fn moved_by(&self) -> Option<ParamRef> {
        self.turned()?.rotation
    }

    /// How what shines from afar is turned, if it may be.
    fn turned(&self) -> Option<&Placement> {
        None
    }

    /// The emitted radiance (intensity over squared distance for points).
    #[inline(always)]
    fn eval<R: Real>(&self, theta: &Theta<R>, e: &Emission<R>) -> Rgb<R> {
        self.scaled(theta, self.radiance().rgb(theta, e.uv) * e.falloff)
    }

    /// [`Emitter::eval`] of what stands still, for loops over many lookups.
    #[inline(always)]
    fn eval_in_line<P: Float>(&self, theta: &Theta<P>, e: &Emission<P>) -> Rgb<P> {
        let radiance: Rgb<P> = self.radiance().eval_in_line(theta, e.uv).into();
        self.scaled(theta, radiance * e.falloff)
    }

    /// `value` times [`Emitter::scale`].
    #[inline(always)]
    fn scaled<R: Real>(&self, theta: &Theta<R>, value: Rgb<R>) -> Rgb<R> {
        match self.scale() {
            None => value,
            Some(p) => value * theta.get(p, 0),
        }
    }

    /// Adds the adjoints of the texture and of the scale, given that of [`Emitter::eval`].
    #[inline]
    fn backward<P: Float>(
        &self,
        theta: &Theta<P>,
        e: &Emission<P>,
        d: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) {
        if self.radiance().any_param(|p| grad.active(p)) {
            let d = self.scaled(theta, d * e.falloff);
            self.radiance().scatter(e.uv, d, grad);
        }
        if let Some(p) = self.scale().filter(|p| grad.active(*p)) {
            let unscaled = self.radiance().rgb(theta, e.uv) * e.falloff;
            grad.add(p, 0, (unscaled * d).sum());
        }
    }
}

/// The number `scale` (1) of `node`, a parameter of the emitter that is being built: that many times what its
/// image says is emitted.
fn scale_of(node: &Node, registry: &mut Registry) -> Result<ParamRef, SceneError> {
    let scale = scale_given(node)?;
    let name = format!("{}.scale", registry.prefix());
    let p = registry.push_param(&name, ParamShape::Scalar, &[scale], SCALES)?;
    registry.origins.of_value(node, "scale", p);
    Ok(p)
}

fn scale_given(node: &Node) -> Result<f64, SceneError> {
    let scale = node.float_or("scale", 1.0)?;
    if scale < 0.0 {
        return Err(node.invalid("scale", "a number of at least 0"));
    }
    Ok(scale)
}

/// Smallest fraction of the sphere that a wide light covers.
pub const WIDE: f64 = 0.01;

/// Valid factors on all that is emitted.
const SCALES: (f64, f64) = (0.0, f64::INFINITY);

macro_rules! emitters {
    (inline { $($hot:ident),* $(,)? } $($name:ident),* $(,)?) => {
        /// Any emitter.
        #[derive(Clone, Debug)]
        pub enum AnyEmitter {
            $(#[doc = concat!("See [`", stringify!($hot), "`].")] $hot($hot),)*
            $(#[doc = concat!("See [`", stringify!($name), "`].")] $name($name),)*
        }

        $(impl From<$hot> for AnyEmitter {
            fn from(e: $hot) -> Self {
                Self::$hot(e)
            }
        })*
        $(impl From<$name> for AnyEmitter {
            fn from(e: $name) -> Self {
                Self::$name(e)
            }
        })*

        impl AnyEmitter {
            /// Plugin names of all emitters.
            pub const PLUGINS: &'static [&'static [&'static str]] =
                &[$(<$hot as FromNode>::PLUGINS,)* $(<$name as FromNode>::PLUGINS),*];

            /// Builds the emitter that the node's plugin names.
            ///
            /// # Errors
            /// Unknown plugin, or anything wrong with its description.
            pub fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
                $(if <$hot as FromNode>::takes(node) {
                    return Ok(Self::$hot(<$hot as FromNode>::from_node(node, registry)?));
                })*
                $(if <$name as FromNode>::takes(node) {
                    return Ok(Self::$name(<$name as FromNode>::from_node(node, registry)?));
                })*
                Err(node.unknown_plugin(&Self::PLUGINS.concat()))
            }
        }

        impl Emitter for AnyEmitter {
            #[inline]
            fn radiance(&self) -> &RgbTexture {
                match self { $(Self::$hot(e) => e.radiance(),)* $(Self::$name(e) => e.radiance(),)* }
            }
            #[inline(always)]
            fn scale(&self) -> Option<ParamRef> {
                match self { $(Self::$hot(e) => e.scale(),)* $(Self::$name(e) => e.scale(),)* }
            }
            #[inline(always)]
            fn hit<R: Real>(
                &self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>,
            ) -> Option<Emission<R>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], e => e.hit(d, si))
            }
            #[inline(always)]
            fn hit_again<R: Real>(
                &self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>, at: &Emission<R::Primal>,
            ) -> Option<Emission<R>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], e => e.hit_again(d, si, at))
            }
            #[inline(always)]
            fn sample<P: Float>(
                &self, lights: Lights, from: Vec3<P>, u: [P; 2],
            ) -> Option<EmitterSample<P>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], e => e.sample(lights, from, u))
            }
            #[inline(always)]
            fn pdf<R: Real>(
                &self, lights: Lights, from: Vec3<R>, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>,
            ) -> R {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], e => e.pdf(lights, from, d, si))
            }
            #[inline(always)]
            fn sample_ray<P: Float>(
                &self, theta: &Theta<P>, lights: Lights, ball: Option<Ball>, u: [P; 4],
            ) -> Option<EmittedRay<P>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], e => e.sample_ray(theta, lights, ball, u))
            }
            fn leaves<P: Float>(
                &self, d: Vec3<P>, si: Option<&SurfaceInteraction<P>>,
            ) -> Option<(Emission<P>, P)> {
                match self { $(Self::$hot(e) => e.leaves(d, si),)* $(Self::$name(e) => e.leaves(d, si),)* }
            }
            fn connect<R: Real>(
                &self, sample: &EmitterSample<R::Primal>, from: Vec3<R>,
            ) -> Connection<R> {
                match self { $(Self::$hot(e) => e.connect(sample, from),)* $(Self::$name(e) => e.connect(sample, from),)* }
            }
            fn rays(&self, lights: Lights) -> Option<Rays> {
                match self { $(Self::$hot(e) => e.rays(lights),)* $(Self::$name(e) => e.rays(lights),)* }
            }
            fn border<P: Float>(&self, lights: Lights, u: f64) -> Option<Border<P>> {
                match self { $(Self::$hot(e) => e.border(lights, u),)* $(Self::$name(e) => e.border(lights, u),)* }
            }
            fn is_delta(&self) -> bool {
                match self { $(Self::$hot(e) => e.is_delta(),)* $(Self::$name(e) => e.is_delta(),)* }
            }
            fn is_infinite(&self) -> bool {
                match self { $(Self::$hot(e) => e.is_infinite(),)* $(Self::$name(e) => e.is_infinite(),)* }
            }
            fn is_wide(&self) -> bool {
                match self { $(Self::$hot(e) => e.is_wide(),)* $(Self::$name(e) => e.is_wide(),)* }
            }
            fn update(&mut self, params: &Params) {
                match self { $(Self::$hot(e) => e.update(params),)* $(Self::$name(e) => e.update(params),)* }
            }
            fn mobility(&self) -> Option<(&'static str, [f32; 3])> {
                match self { $(Self::$hot(e) => e.mobility(),)* $(Self::$name(e) => e.mobility(),)* }
            }
            fn make_movable(&mut self, p: ParamRef) {
                match self { $(Self::$hot(e) => e.make_movable(p),)* $(Self::$name(e) => e.make_movable(p),)* }
            }
            fn moved_by(&self) -> Option<ParamRef> {
                match self { $(Self::$hot(e) => e.moved_by(),)* $(Self::$name(e) => e.moved_by(),)* }
            }
            fn turned(&self) -> Option<&Placement> {
                match self { $(Self::$hot(e) => e.turned(),)* $(Self::$name(e) => e.turned(),)* }
            }
        }
    };
}

impl AnyEmitter {
    /// The emitter, if its samples move with its parameters. Points on areas, cones and lobes do not: the
    /// parameters of all other emitters scale what they emit, not where.
    pub fn moving(&self) -> Option<&Envmap> {
        match self {
            Self::Envmap(e) => Some(e),
            _ => None,
        }
    }

    /// Whether each point of it sends light in one direction only.
    pub(crate) fn is_beam(&self) -> bool {
        matches!(self, Self::DirectionalArea(_))
    }

    /// Whether outlines of shadows are drawn from it: it does not surround the scene.
    pub(crate) fn draws_shadows(&self) -> bool {
        matches!(self, Self::Area(_)) || self.is_delta()
    }

    /// Whether it throws an image that jumps between texels or fields.
    pub(crate) fn throws_jumps(&self) -> bool {
        matches!(self, Self::Projector(_) | Self::Slide(_)) && self.radiance().jumps()
    }

    /// Whether its light ends at a border, across which it jumps.
    pub(crate) fn has_border(&self) -> bool {
        match self {
            Self::Projector(_) | Self::DirectionalArea(_) => true,
            Self::Spot(spot) => spot.has_border(),
            _ => false,
        }
    }
}

emitters! {
    inline { Area }
    Point,
    Slide,
    Spot,
    Constant,
    Envmap,
    Vmf,
    Directional,
    DirectionalArea,
    Projector,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Independent, Sampler};

    /// A ray at a point in the ball, from any distance up to a million radii, in single precision, may meet it; one
    /// that passes well beside it does not, nor one that leaves.
    #[test]
    fn a_ray_at_a_point_in_a_ball_may_meet_it() {
        for i in 0..10_000 {
            let mut s = Independent::new(3, 0, i);
            let mut unit = || warp::square_to_sphere(s.next_2d::<f64>());
            let (centre, out, across) = (unit() * 50.0, unit(), unit());
            let radius = 10f64.powf(5.0 * s.next_1d::<f64>() - 2.0);
            let away = 10f64.powf(6.0 * s.next_1d::<f64>());
            let ball = Ball {
                centre: centre.to_array(),
                radius,
            };
            let o = centre + out * (radius * (1.0 + away));
            let single = |v: Vec3<f64>| Vec3::new(v.x as f32, v.y as f32, v.z as f32);
            let at = |p: Vec3<f64>| {
                let (o, p) = (single(o), single(p));
                Ray::new(o, (p - o).normalize())
            };
            let inside = centre + across * (radius * s.next_1d::<f64>());
            assert!(ball.may_be_met(&at(inside)), "{i}");
            let back = at(inside);
            assert!(!ball.may_be_met(&Ray::new(back.o, -back.d)), "{i}");
            // So far out that the ball is hardly more than a rounding of its place.
            let out_there = Ball {
                centre: (centre * (1e5 * radius)).to_array(),
                radius,
            };
            let shift = centre * (1e5 * radius - 1.0);
            let (o, p) = (single(o + shift), single(inside + shift));
            let ray = Ray::new(o, (p - o).normalize());
            assert!(out_there.may_be_met(&ray), "{i}");
            if away < 1e3 {
                let side = Frame::from_normal(out).s;
                let tangent = centre + side * (radius * 1.2 * (1.0 + away) / away);
                assert!(!ball.may_be_met(&at(tangent)), "{i}");
            }
        }
    }
}
