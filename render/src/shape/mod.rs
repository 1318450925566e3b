//! Shapes: what rays hit, and where on it.
//!
//! A shape gives the acceleration structure [`Primitive`]s in f32; the hit is then computed again in
//! the scalar of the caller, from the shape's own parameters ([`Shape::interaction`]). A ray whose
//! origin or direction carries tangents therefore gets an interaction that moves with it.
//!
//! What stays with the material when a shape moves are the [`SurfaceCoordinates`] of a point ([`Shape::coordinates`]);
//! where they are for given parameters says [`Shape::point_at`], and how the surface bends there [`Shape::partials`].
//!
//! # Parameters
//! A shape holds its geometry in single precision, for the values that the scene was given last: it is what rays are
//! traced against ([`Shape::update`]). Of `theta`, functions over a scalar with tangents take the tangents.
//!
//! To add a shape: one file here, one line in `shapes!` below.
//!
//! What a pixel sees, and how that point moves as the ray turns:
//!
//! ```
//! use ad_core::{Dual, Real, Vec3};
//! use render::math::Ray;
//! use render::params::Theta;
//!
//! let room = render::scene::room(64, 64)?;
//! let ray = room.camera.ray(32.5f64, 40.5);
//! let seen = room.intersect(&ray).expect("the room is closed");
//! assert_eq!(seen.si.frame.n.dot(seen.si.n_geo).signum(), 1.0);
//!
//! // The same hit over dual numbers: how the point moves as the ray turns.
//! type R = Dual<f64, 1>;
//! let sideways = Vec3::new(R::var(0.0, 0), R::zero(), R::zero());
//! let turning = Ray::new(Vec3::lift(ray.o), (Vec3::lift(ray.d) + sideways).normalize());
//! let moving = room.intersect_moving(&Theta::<R>::still(), &turning).expect("the same");
//! let velocity = moving.si.p.map(|x| x.eps[0]);
//! assert!(velocity.dot(seen.si.n_geo).abs() < 1e-12 * velocity.length()); // it stays on the surface
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod chart;
mod cube;
mod curve;
mod cylinder;
mod disk;
mod displacement;
mod instance;
mod mesh;
mod mesh_data;
mod mesh_motion;
mod mesh_plugins;
mod partials;
mod patch;
mod ply;
mod serialized;
mod sphere;
mod vertices;
mod welding;

pub(crate) use chart::charted;
pub use cube::Cube;
pub use curve::{CurveKind, Curves};
pub use cylinder::Cylinder;
pub use disk::Disk;
pub use displacement::HEIGHTS;
pub use instance::Instance;
pub use mesh::{Mesh, ObjOptions};
pub(crate) use mesh::{SurfaceInLine, Triangle, plain_obj};
pub use mesh_data::{MeshData, smooth_normals};
pub use partials::Partials;
pub use patch::{Patch, Rectangle};
pub use sphere::Sphere;
pub(crate) use sphere::{SphereNumbers, sample_cone, turn};
pub use welding::Welding;

use ad_core::{Const, Dual, Float, Real, Vec2, Vec3};

use crate::accel::{Hit, MAX_COORDINATE, Primitive, bounds};
use crate::error::SceneError;
use crate::math::{Frame, NOWHERE, Ray, Segment, Transform, each};
use crate::motion::{Drift, Wrench};
use crate::params::{GradSink, ParamRef, Params, Theta};
use crate::plugin::{FromNode, Node, Registry};

/// Part of the distance to a point that is not tested for occluders: its rounding.
const SHADOW_EPSILON: f64 = 1e-6;

/// How rays leave a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exit {
    /// How far they start off it.
    pub offset: f32,
    /// The flat surface that they cannot meet again, see [`Ray::from`].
    pub surface: u32,
}

impl Default for Exit {
    /// Of a ray that leaves no surface.
    fn default() -> Self {
        Self {
            offset: 0.0,
            surface: NOWHERE,
        }
    }
}

/// What a primitive of a scene belongs to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prim {
    pub shape: u32,
    /// Index within the shape.
    pub local: u32,
    /// Index among the parallelograms; none if beyond.
    pub patch: u32,
    /// The surface it lies on, as [`crate::accel::surfaces`] numbers them.
    pub surface: u32,
    /// How rays leave it.
    pub exit: Exit,
}

/// Where a point is on a primitive of a shape, in two numbers that do not change when the shape moves: the material
/// stays.
///
/// * Triangles: barycentric coordinates of the second and third vertex.
/// * Parallelograms: in units of their edges.
/// * Disks: in units of their half axes, so that the rim is the unit circle.
/// * Spheres: the octahedral map of the outward normal in the sphere's own axes, in `[-1, 1]^2` [Cigolle et al. 2014].
///   Unlike angles, it has no poles.
/// * Cylinders: the angle in turns, as `u`, and the height over the length.
/// * Curves: the angle in turns, and where along the segment, see [`Curves`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceCoordinates<R>(pub Vec2<R>);

impl<R: Real> SurfaceCoordinates<R> {
    /// Constant coordinates: zero tangents.
    #[inline]
    pub fn lift(at: SurfaceCoordinates<R::Primal>) -> Self {
        Self(Vec2::lift(at.0))
    }
}

/// A point on a surface, seen along a ray.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceInteraction<R> {
    /// Position, world space.
    pub p: Vec3<R>,
    /// Distance along the ray.
    pub t: R,
    /// Unit geometric normal, world space, on the side that the shape calls outside.
    pub n_geo: Vec3<R>,
    /// Shading frame; `frame.n` on the same side as `n_geo`.
    pub frame: Frame<R>,
    /// Texture coordinates; may be zero where nothing looks them up ([`Shape::skip_uv`]).
    pub uv: Vec2<R>,
}

impl<R: Real> SurfaceInteraction<R> {
    /// The ray that leaves in the unit direction `d`.
    #[inline(always)]
    pub fn spawn_ray(&self, d: Vec3<R>, exit: Exit) -> Ray<R> {
        let offset = R::Primal::from_f32(exit.offset);
        let behind = self.n_geo.primal().dot(d.primal()) < R::Primal::zero();
        let offset = R::Primal::select(behind, -offset, offset);
        Ray::new(self.p + self.n_geo * Const(offset), d).leaving(exit.surface)
    }

    /// What must be free for the point at `distance` in the unit direction `d` to be visible, which lies on the
    /// surface `to`. The ray is aimed anew at that point: kept parallel, it would pass a ball near its outline.
    #[inline(always)]
    pub fn shadow_ray(&self, d: Vec3<R>, distance: R, exit: Exit, to: u32) -> Segment<R> {
        let Ray { o, d, from } = self.spawn_ray(d, exit);
        let way = self.p + d * distance - o;
        let length = way.length_squared().sqrt();
        let towards = way * length.recip();
        // Without a branch: waves of paths do this in vectors.
        let finite = distance.primal() <= R::Primal::MAX;
        let d = Vec3::select(finite, towards, d);
        let length = length * R::c(1.0 - SHADOW_EPSILON);
        Segment {
            ray: Ray { o, d, from },
            length: R::select(finite, length, distance),
            to,
        }
    }

    /// The geometric normal in the shading frame: exactly its axis where the two normals are one.
    #[inline]
    pub fn local_geometric_normal(&self) -> Vec3<R>
    where
        R: Float,
    {
        if self.n_geo == self.frame.n {
            Vec3::new(R::zero(), R::zero(), R::one())
        } else {
            self.frame.to_local(self.n_geo)
        }
    }

    /// The same point over a scalar with tangents, all of them zero.
    #[inline]
    pub fn lift<Q: Real<Primal = R>>(&self) -> SurfaceInteraction<Q>
    where
        R: Float,
    {
        SurfaceInteraction {
            p: Vec3::lift(self.p),
            t: Q::lift(self.t),
            n_geo: Vec3::lift(self.n_geo),
            frame: Frame {
                s: Vec3::lift(self.frame.s),
                t: Vec3::lift(self.frame.t),
                n: Vec3::lift(self.frame.n),
            },
            uv: Vec2::lift(self.uv),
        }
    }

    /// The same point on a surface that moves so; `with_frame` is [`Shape::carries_frame`].
    #[inline]
    pub(crate) fn carried(&self, drift: &Drift<R>, with_frame: bool) -> Self {
        let frame = if with_frame {
            drift.frame(&self.frame)
        } else {
            Frame::from_normal(drift.direction(self.frame.n))
        };
        Self {
            p: drift.point(self.p),
            t: self.t,
            n_geo: drift.direction(self.n_geo),
            frame,
            uv: self.uv,
        }
    }

    /// The same point without tangents.
    #[inline]
    pub fn primal(&self) -> SurfaceInteraction<R::Primal> {
        SurfaceInteraction {
            p: self.p.primal(),
            t: self.t.primal(),
            n_geo: self.n_geo.primal(),
            frame: self.frame.primal(),
            uv: self.uv.primal(),
        }
    }
}

/// The adjoints of what an interaction says of a surface.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceAdjoint<P> {
    /// Of the position.
    pub p: Vec3<P>,
    /// Of the geometric normal.
    pub n_geo: Vec3<P>,
    /// Of the axes of the shading frame, each by itself.
    pub frame: Frame<P>,
    /// Of the texture coordinates.
    pub uv: Vec2<P>,
}

impl<P: Float> SurfaceAdjoint<P> {
    /// Without any change.
    pub fn zero() -> Self {
        Self {
            p: Vec3::zero(),
            n_geo: Vec3::zero(),
            frame: Frame {
                s: Vec3::zero(),
                t: Vec3::zero(),
                n: Vec3::zero(),
            },
            uv: Vec2::zero(),
        }
    }

    /// Adds those of another use of the same interaction.
    pub fn add(&mut self, other: &Self) {
        self.p += other.p;
        self.n_geo += other.n_geo;
        self.frame.s += other.frame.s;
        self.frame.t += other.frame.t;
        self.frame.n += other.frame.n;
        self.uv += other.uv;
    }

    /// What it adds to that of a motion of the surface as a whole: the transpose of [`SurfaceInteraction::carried`].
    pub(crate) fn act(&self, si: &SurfaceInteraction<P>, with_frame: bool, wrench: &mut Wrench<P>) {
        wrench.point(si.p, self.p);
        wrench.direction(si.n_geo, self.n_geo);
        wrench.direction(si.frame.n, self.frame.n);
        if with_frame {
            wrench.direction(si.frame.s, self.frame.s);
            wrench.direction(si.frame.t, self.frame.t);
        } else {
            let n = si.frame.n;
            let n = Vec3::new(
                Dual::<P, 3>::var(n.x, 0),
                Dual::var(n.y, 1),
                Dual::var(n.z, 2),
            );
            let axes = Self {
                frame: Frame {
                    n: Vec3::zero(),
                    ..self.frame
                },
                ..Self::zero()
            };
            let around = SurfaceInteraction {
                frame: Frame::from_normal(n),
                ..si.lift()
            };
            wrench.direction(si.frame.n, axes.of(&around).eps.into());
        }
    }

    /// The sum of the interaction's components, each times its adjoint.
    pub fn of<R: Real<Primal = P>>(&self, si: &SurfaceInteraction<R>) -> R {
        let along = |v: Vec3<R>, d: Vec3<P>| v.x * Const(d.x) + v.y * Const(d.y) + v.z * Const(d.z);
        along(si.p, self.p)
            + along(si.n_geo, self.n_geo)
            + along(si.frame.s, self.frame.s)
            + along(si.frame.t, self.frame.t)
            + along(si.frame.n, self.frame.n)
            + si.uv.x * Const(self.uv.x)
            + si.uv.y * Const(self.uv.y)
    }
}

/// A point sampled on a shape.
#[derive(Clone, Copy, Debug)]
pub struct ShapeSample<R: Real> {
    /// Position, world space.
    pub p: Vec3<R>,
    /// Unit normal there, world space.
    pub n: Vec3<R>,
    /// Texture coordinates.
    pub uv: Vec2<R>,
    /// Density per area: a constant.
    pub pdf: R::Primal,
    /// The primitive of the shape that it lies on.
    pub prim: u32,
    /// Where on that primitive.
    pub coordinates: SurfaceCoordinates<R::Primal>,
}

/// A direction sampled towards a shape.
#[derive(Clone, Copy, Debug)]
pub struct DirectionSample<P> {
    /// Unit direction, world space.
    pub d: Vec3<P>,
    /// Distance to the point on the shape.
    pub distance: P,
    /// Unit shading normal at that point, world space.
    pub n: Vec3<P>,
    /// Unit geometric normal there.
    pub n_geo: Vec3<P>,
    /// Texture coordinates there.
    pub uv: Vec2<P>,
    /// Density per solid angle.
    pub pdf: P,
    /// The primitive of the shape that the point lies on.
    pub prim: u32,
}

impl<P: Float> ShapeSample<P> {
    /// The sample as a direction from `from`, when the geometric normal is `n_geo`. `None` if edge-on
    /// or at zero distance.
    #[inline(always)]
    pub fn seen_from(&self, from: Vec3<P>, n_geo: Vec3<P>) -> Option<DirectionSample<P>> {
        let (seen, is_seen) = self.seen_in_line(from, n_geo);
        is_seen.then_some(seen)
    }

    /// [`ShapeSample::seen_from`], and whether anything is seen: without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn seen_in_line(&self, from: Vec3<P>, n_geo: Vec3<P>) -> (DirectionSample<P>, bool) {
        let v = self.p - from;
        let d2 = v.length_squared();
        let distance = d2.sqrt();
        let d = v * distance.recip();
        let pdf = self.pdf * d2 / n_geo.dot(d).abs();
        // False for zero over zero as well.
        let is_seen = (pdf > P::zero()) & (pdf <= P::MAX);
        let seen = DirectionSample {
            d,
            distance,
            n: self.n,
            n_geo,
            uv: self.uv,
            pdf,
            prim: self.prim,
        };
        (seen, is_seen)
    }
}

/// A surface.
pub trait Shape: Send + Sync {
    /// What the acceleration structure intersects; their order defines `prim` below.
    fn primitives(&self) -> Vec<Primitive>;

    /// The control points that [`Primitive::Span`]s are of.
    fn control_points(&self) -> &[[f32; 4]] {
        &[]
    }

    /// The interaction at `hit`, which lies on primitive `prim` of this shape.
    ///
    /// # Derivatives
    /// In the ray, and in `theta` while the ray stays. The primitive that was hit is a primal decision.
    fn interaction<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R>;

    /// Where the point `si` of primitive `prim` is on the material. The inverse of [`Shape::point_at`] up to the
    /// rounding of the position. Interactions do not carry it, as few callers need it.
    fn coordinates<P: Float>(&self, prim: u32, si: &SurfaceInteraction<P>)
    -> SurfaceCoordinates<P>;

    /// Surface coordinates of the point of primitive `prim` next to `p`.
    fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P>;

    /// The point of primitive `prim` with the surface coordinates `at`, seen along no ray: `t` is zero.
    ///
    /// # Derivatives
    /// In `theta` and in `at`.
    fn point_at<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R>;

    /// How the surface changes with the texture coordinates at the same point, also where [`Shape::skip_uv`] leaves
    /// them out. `None` where texture coordinates are none: on triangles whose own ones, or which themselves, are
    /// degenerate.
    ///
    /// At the poles of a sphere and in the middle of a disk, where a coordinate is no coordinate, these are the limits
    /// along the meridian `u = 0`, or the ray `v = 0`: finite, with a zero derivative of the position in that
    /// coordinate.
    fn partials<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>>;

    /// Area of primitive `prim` per constant measure of its [`SurfaceCoordinates`]: per their own area, on spheres per
    /// solid angle. How it changes is how integrals over the material do.
    ///
    /// # Derivatives
    /// In `theta`.
    fn area_element<R: Real>(&self, theta: &Theta<R>, prim: u32) -> R;

    /// Adds the adjoints of the shape's own parameters, given those of [`Shape::point_at`].
    fn scatter_point<P: Float>(
        &self,
        _prim: u32,
        _at: SurfaceCoordinates<P>,
        _d: &SurfaceAdjoint<P>,
        _grad: &mut impl GradSink<P>,
    ) {
    }

    /// The same, given those of [`Shape::interaction`] of a ray that stays.
    fn scatter_interaction<P: Float>(
        &self,
        _prim: u32,
        _ray: &Ray<P>,
        _hit: &Hit,
        _d: &SurfaceAdjoint<P>,
        _grad: &mut impl GradSink<P>,
    ) {
    }

    /// The same, given that of [`Shape::area_element`].
    fn scatter_area<P: Float>(&self, _prim: u32, _d: P, _grad: &mut impl GradSink<P>) {}

    /// Calls `f` with every parameter of its own.
    fn visit_params(&self, _f: &mut dyn FnMut(ParamRef)) {}

    /// Reads these parameters: the geometry is theirs from now on.
    ///
    /// # Errors
    /// What was expected, and what was found.
    fn update(&mut self, _params: &Params) -> Result<(), String> {
        Ok(())
    }

    /// Whether the axes of the shading frame turn with the shape: not on triangles without texture coordinates, where
    /// they are some axes around the normal.
    fn carries_frame(&self, _prim: u32) -> bool {
        true
    }

    /// The centroid of the surface, world space.
    fn centroid(&self) -> [f64; 3];

    /// The same shape moved by a rotation, a positive scale and a translation. Points keep their surface coordinates.
    ///
    /// # Errors
    /// What was expected, and what was found: nothing is left, or it is out of reach.
    fn placed(&self, by: &Transform) -> Result<Self, String>
    where
        Self: Sized;

    /// The parallelogram that primitive `prim` is, if it is one.
    fn patch(&self, _prim: u32) -> Option<&Patch> {
        None
    }

    /// Brings what [`Shape::interaction`] looks up near: who needs that of many primitives need not wait for each.
    #[inline]
    fn fetch(&self, _prim: u32) {}

    /// Area, world space.
    fn area(&self) -> f64;

    /// A point distributed uniformly over the area; density per area.
    ///
    /// # Derivatives
    /// In `theta`, of position, normal and texture coordinates: the material stays, and so does the density.
    fn sample_area<R: Real>(&self, theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R>;

    /// [`Shape::sample_area`], and the unit geometric normal there.
    #[inline]
    fn sample_surface<R: Real>(
        &self,
        theta: &Theta<R>,
        u: [R::Primal; 2],
    ) -> (ShapeSample<R>, Vec3<R>) {
        let s = self.sample_area(theta, u);
        (s, s.n)
    }

    /// A direction from `from` towards the shape. `None` where nothing is seen: the primitive of the sample does not
    /// hide the side of it that faces `from`.
    #[inline]
    fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
        let s = self.sample_area(&Theta::still(), u);
        s.seen_from(from, s.n)
    }

    /// Density of [`Shape::sample`] at an interaction, per solid angle.
    #[inline]
    fn pdf<R: Real>(&self, from: Vec3<R>, si: &SurfaceInteraction<R>) -> R {
        let pdf_area = R::of(1.0 / self.area());
        area_to_solid_angle(pdf_area, from, si.p, si.n_geo).unwrap_or(R::zero())
    }

    /// How far `ray` passes from the outline of primitive `prim` as seen from its origin: zero on
    /// the outline, positive on both sides, about an angle in radians close to it; [`FAR`] or more
    /// where the outline is nowhere near. Whether something hides it is not asked.
    ///
    /// # Derivatives
    /// In the ray.
    fn border<R: Real>(&self, prim: u32, ray: &Ray<R>) -> R;

    /// Says that nothing looks up a texture on this shape: where `uv` is costly, it may be left at zero.
    fn skip_uv(&mut self) {}

    /// Largest absolute coordinate: the scale of rounding errors on the surface.
    fn extent(&self) -> f32;

    /// Corners of a box around it, rounded outwards.
    fn bounds(&self) -> [[f32; 3]; 2] {
        let nothing = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        (self.primitives().iter()).fold(nothing, |[low, high], primitive| {
            let [a, b] = bounds(primitive);
            let all = |k: usize| (low[k].min(a[k]), high[k].max(b[k]));
            let [x, y, z] = [all(0), all(1), all(2)];
            [[x.0, y.0, z.0], [x.1, y.1, z.1]]
        })
    }
}

/// A distance from outlines that counts as no outline at all, radians.
pub const FAR: f64 = 1e3;

/// [`Shape::border`] of a flat primitive whose plane is met at distance `t`, from the signed distances to
/// its edges there, positive outside.
#[inline]
fn flat_border<R: Real>(t: R, outside: impl IntoIterator<Item = R>) -> R {
    if !(t.primal() > R::Primal::zero() && t.primal() <= R::Primal::MAX) {
        return R::of(FAR);
    }
    let farthest = outside.into_iter().reduce(R::max);
    farthest.map_or(R::of(FAR), |x| (x / t).abs())
}

/// Converts a density per area at `p` (normal `n`) to one per solid angle at `from`. `None` if
/// edge-on or at zero distance.
#[inline]
pub fn area_to_solid_angle<R: Real>(
    pdf_area: R,
    from: Vec3<R>,
    p: Vec3<R>,
    n: Vec3<R>,
) -> Option<R> {
    let d = p - from;
    let d2 = d.length_squared();
    let cos_d = n.dot(d).abs();
    let zero = R::Primal::zero();
    if cos_d.primal() > zero && d2.primal() > zero {
        let pdf = pdf_area * d2 * d2.sqrt() / cos_d;
        pdf.is_finite().then_some(pdf)
    } else {
        None
    }
}

/// Whether the traversal's own `u`, `v` and `t` are as good as a recomputation.
#[inline]
pub fn hit_is_exact<R: Real>() -> bool {
    R::IS_PRIMAL && size_of::<R>() == size_of::<f32>()
}

/// Coordinates of the point nearest to `p` on the plane `v0 + x e1 + y e2`; zero if it is none.
fn coordinates_in_plane<P: Float>(
    p: Vec3<P>,
    v0: [f32; 3],
    e1: [f32; 3],
    e2: [f32; 3],
) -> SurfaceCoordinates<P> {
    // In f64, where the products of small edges do not underflow.
    let [v0, e1, e2] = [v0, e1, e2].map(lift3::<f64>);
    let d = p.map(P::to_f64) - v0;
    let n = e1.cross(e2);
    let inverse = n.length_squared().recip();
    let finite = |x: f64| P::of(if x.is_finite() { x } else { 0.0 });
    SurfaceCoordinates(Vec2::new(
        finite(d.cross(e2).dot(n) * inverse),
        finite(e1.cross(d).dot(n) * inverse),
    ))
}

/// What [`Shape::placed`] expects.
fn misplaced() -> String {
    format!(
        "expected a finite, non-zero size and coordinates of magnitude at most {MAX_COORDINATE:e}"
    )
}

/// A point in double precision.
fn double(v: [f32; 3]) -> [f64; 3] {
    each(v, f64::from)
}

/// Lifts an f32 point or vector.
#[inline]
pub fn lift3<R: Real>(v: [f32; 3]) -> Vec3<R> {
    Vec3::lift(Vec3::new(
        R::Primal::from_f32(v[0]),
        R::Primal::from_f32(v[1]),
        R::Primal::from_f32(v[2]),
    ))
}

/// The plugin that stands for the shapes inside, which Mitsuba traces as one.
pub(crate) const MERGED: &str = "merge";

/// The matrix of the shape that a node describes, as Mitsuba has it: from local coordinates to the world. That of a sphere takes
/// the unit sphere to it, that of a cylinder one of radius one along the z axis, from zero to one.
///
/// # Errors
/// A value that is none.
pub(crate) fn to_world(node: &Node) -> Result<Transform, SceneError> {
    let local = match node.plugin.as_str() {
        "sphere" => Sphere::local(node)?,
        "cylinder" => Cylinder::local(node)?,
        _ => Transform::IDENTITY,
    };
    Ok(local.then(&node.transform("to_world")?.unwrap_or_default()))
}

macro_rules! shapes {
    (inline { $($hot:ident),* $(,)? } $($name:ident),* $(,)?) => {
        /// Any shape.
        #[derive(Clone, Debug)]
        pub enum AnyShape {
            $(#[doc = concat!("See [`", stringify!($hot), "`].")] $hot($hot),)*
            $(#[doc = concat!("See [`", stringify!($name), "`].")] $name($name),)*
        }

        $(impl From<$hot> for AnyShape {
            fn from(s: $hot) -> Self {
                Self::$hot(s)
            }
        })*
        $(impl From<$name> for AnyShape {
            fn from(s: $name) -> Self {
                Self::$name(s)
            }
        })*

        impl AnyShape {
            /// Plugin names of all shapes.
            pub const PLUGINS: &'static [&'static [&'static str]] =
                &[$(<$hot as FromNode>::PLUGINS,)* $(<$name as FromNode>::PLUGINS),*];

            /// All names that a shape may have in scene files, in their order: those that stand for other shapes, too.
            pub fn names() -> Vec<&'static str> {
                let mut names = [&Self::PLUGINS.concat()[..], &["instance", MERGED, "shapegroup"]].concat();
                names.sort_unstable();
                names
            }

            /// Builds the shape that the node's plugin names.
            ///
            /// # Errors
            /// Unknown plugin, or anything wrong with its description.
            pub fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
                let plugin = node.plugin.as_str();
                $(if <$hot as FromNode>::PLUGINS.contains(&plugin) {
                    return Ok(Self::$hot(<$hot as FromNode>::from_node(node, registry)?));
                })*
                $(if <$name as FromNode>::PLUGINS.contains(&plugin) {
                    return Ok(Self::$name(<$name as FromNode>::from_node(node, registry)?));
                })*
                Err(node.unknown_plugin(&Self::names()))
            }
        }

        impl Shape for AnyShape {
            fn primitives(&self) -> Vec<Primitive> {
                match self { $(Self::$hot(s) => s.primitives(),)* $(Self::$name(s) => s.primitives(),)* }
            }
            fn control_points(&self) -> &[[f32; 4]] {
                match self { $(Self::$hot(s) => s.control_points(),)* $(Self::$name(s) => s.control_points(),)* }
            }
            #[inline(always)]
            fn interaction<R: Real>(
                &self, theta: &Theta<R>, prim: u32, ray: &Ray<R>, hit: &Hit,
            ) -> SurfaceInteraction<R> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], s => s.interaction(theta, prim, ray, hit))
            }
            fn coordinates<P: Float>(&self, prim: u32, si: &SurfaceInteraction<P>) -> SurfaceCoordinates<P> {
                match self { $(Self::$hot(s) => s.coordinates(prim, si),)* $(Self::$name(s) => s.coordinates(prim, si),)* }
            }
            fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
                match self { $(Self::$hot(s) => s.locate(prim, p),)* $(Self::$name(s) => s.locate(prim, p),)* }
            }
            fn point_at<R: Real>(
                &self, theta: &Theta<R>, prim: u32, at: SurfaceCoordinates<R>,
            ) -> SurfaceInteraction<R> {
                match self { $(Self::$hot(s) => s.point_at(theta, prim, at),)* $(Self::$name(s) => s.point_at(theta, prim, at),)* }
            }
            fn partials<R: Real>(
                &self, theta: &Theta<R>, prim: u32, at: SurfaceCoordinates<R>,
            ) -> Option<Partials<R>> {
                match self { $(Self::$hot(s) => s.partials(theta, prim, at),)* $(Self::$name(s) => s.partials(theta, prim, at),)* }
            }
            fn area_element<R: Real>(&self, theta: &Theta<R>, prim: u32) -> R {
                match self { $(Self::$hot(s) => s.area_element(theta, prim),)* $(Self::$name(s) => s.area_element(theta, prim),)* }
            }
            fn scatter_point<P: Float>(
                &self, prim: u32, at: SurfaceCoordinates<P>, d: &SurfaceAdjoint<P>, grad: &mut impl GradSink<P>,
            ) {
                match self { $(Self::$hot(s) => s.scatter_point(prim, at, d, grad),)* $(Self::$name(s) => s.scatter_point(prim, at, d, grad),)* }
            }
            fn scatter_interaction<P: Float>(
                &self, prim: u32, ray: &Ray<P>, hit: &Hit, d: &SurfaceAdjoint<P>, grad: &mut impl GradSink<P>,
            ) {
                match self {
                    $(Self::$hot(s) => s.scatter_interaction(prim, ray, hit, d, grad),)*
                    $(Self::$name(s) => s.scatter_interaction(prim, ray, hit, d, grad),)*
                }
            }
            fn scatter_area<P: Float>(&self, prim: u32, d: P, grad: &mut impl GradSink<P>) {
                match self { $(Self::$hot(s) => s.scatter_area(prim, d, grad),)* $(Self::$name(s) => s.scatter_area(prim, d, grad),)* }
            }
            fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
                match self { $(Self::$hot(s) => s.visit_params(f),)* $(Self::$name(s) => s.visit_params(f),)* }
            }
            fn update(&mut self, params: &Params) -> Result<(), String> {
                match self { $(Self::$hot(s) => s.update(params),)* $(Self::$name(s) => s.update(params),)* }
            }
            fn carries_frame(&self, prim: u32) -> bool {
                match self { $(Self::$hot(s) => s.carries_frame(prim),)* $(Self::$name(s) => s.carries_frame(prim),)* }
            }
            fn centroid(&self) -> [f64; 3] {
                match self { $(Self::$hot(s) => s.centroid(),)* $(Self::$name(s) => s.centroid(),)* }
            }
            fn placed(&self, by: &Transform) -> Result<Self, String> {
                Ok(match self { $(Self::$hot(s) => s.placed(by)?.into(),)* $(Self::$name(s) => s.placed(by)?.into(),)* })
            }
            fn patch(&self, prim: u32) -> Option<&Patch> {
                match self { $(Self::$hot(s) => s.patch(prim),)* $(Self::$name(s) => s.patch(prim),)* }
            }
            #[inline]
            fn fetch(&self, prim: u32) {
                match self { $(Self::$hot(s) => s.fetch(prim),)* $(Self::$name(s) => s.fetch(prim),)* }
            }
            fn area(&self) -> f64 {
                match self { $(Self::$hot(s) => s.area(),)* $(Self::$name(s) => s.area(),)* }
            }
            fn sample_area<R: Real>(&self, theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
                match self { $(Self::$hot(s) => s.sample_area(theta, u),)* $(Self::$name(s) => s.sample_area(theta, u),)* }
            }
            fn sample_surface<R: Real>(
                &self, theta: &Theta<R>, u: [R::Primal; 2],
            ) -> (ShapeSample<R>, Vec3<R>) {
                match self { $(Self::$hot(s) => s.sample_surface(theta, u),)* $(Self::$name(s) => s.sample_surface(theta, u),)* }
            }
            #[inline(always)]
            fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], s => s.sample(from, u))
            }
            #[inline(always)]
            fn pdf<R: Real>(&self, from: Vec3<R>, si: &SurfaceInteraction<R>) -> R {
                $crate::dispatch::dispatch!(self, [$($hot),*] [$($name),*], s => s.pdf(from, si))
            }
            fn border<R: Real>(&self, prim: u32, ray: &Ray<R>) -> R {
                match self { $(Self::$hot(s) => s.border(prim, ray),)* $(Self::$name(s) => s.border(prim, ray),)* }
            }
            fn skip_uv(&mut self) {
                match self { $(Self::$hot(s) => s.skip_uv(),)* $(Self::$name(s) => s.skip_uv(),)* }
            }
            fn extent(&self) -> f32 {
                match self { $(Self::$hot(s) => s.extent(),)* $(Self::$name(s) => s.extent(),)* }
            }
            fn bounds(&self) -> [[f32; 3]; 2] {
                match self { $(Self::$hot(s) => s.bounds(),)* $(Self::$name(s) => s.bounds(),)* }
            }
        }
    };
}

shapes! {
    inline { Rectangle, Cube }
    Sphere,
    Disk,
    Cylinder,
    Mesh,
    Instance,
    Curves,
}
