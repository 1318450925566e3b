//! A sample of a boundary: a colour times a linear form in velocities.

use std::ops::Range;

use ad_core::{Const, Float, Real, Vec3, array};
use smallvec::SmallVec;

use crate::accel::Hit;
use crate::camera::CameraSample;
use crate::emitter::Emitter;
use crate::integrator::sink::Sink;
use crate::math::{RayAdjoint, Rgb};
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;
use crate::shape::{SurfaceAdjoint, SurfaceInteraction};

/// What moves: shapes, lights without area, the camera.
pub(super) struct Moving {
    pub camera: bool,
    pub shapes: Vec<bool>,
    /// Positions of lights that are points, turns of parallel light.
    pub lights: Vec<ParamRef>,
    /// Running sums of how many of the shapes do.
    counts: Vec<u32>,
}

impl Moving {
    pub fn of(scene: &Scene, moves: impl Fn(ParamRef) -> bool) -> Self {
        let mut shapes = vec![false; scene.shapes().len()];
        for &(shape, p) in scene.movers() {
            shapes[shape as usize] |= moves(p);
        }
        let mut count = 0;
        let counts = std::iter::once(0)
            .chain(shapes.iter().map(|&m| {
                count += u32::from(m);
                count
            }))
            .collect();
        Self {
            camera: scene.camera.depends_on(&moves),
            lights: (scene.emitters().iter())
                .filter(|e| e.is_delta())
                .filter_map(|e| e.moved_by().filter(|&p| moves(p)))
                .collect(),
            shapes,
            counts,
        }
    }

    pub fn any(&self, shapes: Range<u32>) -> bool {
        self.counts[shapes.start as usize] < self.counts[shapes.end as usize]
    }

    /// Whether any of two does.
    pub fn parts(&self, pair: [u32; 2]) -> bool {
        pair.iter().any(|&shape| self.shapes[shape as usize])
    }

    pub fn anything(&self) -> bool {
        self.camera || !self.lights.is_empty() || self.counts.last().is_some_and(|&n| n > 0)
    }
}

/// Something that moves.
#[derive(Clone, Copy)]
pub(super) enum Mover<P> {
    /// A point that stays on the material.
    Material(u32, SurfaceInteraction<P>),
    /// What the ray through a point of the film and a place of the lens meets, which stay.
    Seen(u32, CameraSample<P>, SurfaceInteraction<P>),
    /// That ray.
    Camera(CameraSample<P>),
    /// A light that is a point, whose position is this parameter.
    Light(ParamRef),
    /// The unit direction of parallel light, of the emitter with this index.
    Parallel(u32, Vec3<P>),
}

/// A multiple of a velocity: of a point along `o`; along `d` besides, of the direction of a ray, or of the shading normal at
/// that point.
#[derive(Clone, Copy)]
pub(super) struct Term<P> {
    pub mover: Mover<P>,
    pub along: RayAdjoint<P>,
}

/// A sum of multiples of velocities.
pub(super) type Form<P> = SmallVec<[Term<P>; 3]>;

/// A sample: a colour times a speed.
pub(super) struct Contribution<P> {
    pub value: Rgb<P>,
    pub form: Form<P>,
}

impl<P: Float> Contribution<P> {
    pub fn is_finite(&self) -> bool {
        let finite = |t: &Term<P>| t.along.o.is_finite() && t.along.d.is_finite();
        self.value.is_finite() && self.form.iter().all(finite)
    }
}

impl<P: Float> Term<P> {
    pub fn point(mover: Mover<P>, along: Vec3<f64>) -> Self {
        let along = RayAdjoint {
            o: along.map(P::of),
            d: Vec3::zero(),
        };
        Self { mover, along }
    }

    /// The tangent of the term, over a number whose primal part is zero.
    pub fn evaluate<R: Real<Primal = P>>(&self, scene: &Scene, theta: &Theta<R>) -> R {
        let form = |v: Vec3<R>, d: Vec3<P>| v.x * Const(d.x) + v.y * Const(d.y) + v.z * Const(d.z);
        let sum = match self.mover {
            Mover::Material(prim, si) => {
                let at = scene.coordinates(prim, &si);
                let at = crate::shape::SurfaceCoordinates::<R>::lift(at);
                let here = scene.point_at(theta, prim, at);
                form(here.p, self.along.o) + form(here.frame.n, self.along.d)
            }
            Mover::Seen(prim, at, si) => {
                let ray = scene.camera.ray_moving(theta, &at);
                let seen = scene.interaction(theta, &ray, &hit_at(prim, si.t));
                form(seen.si.p, self.along.o) + form(seen.si.frame.n, self.along.d)
            }
            Mover::Camera(at) => {
                let ray = scene.camera.ray_moving(theta, &at);
                form(ray.o, self.along.o) + form(ray.d, self.along.d)
            }
            Mover::Light(p) => form(array(|k| theta.get(p, k)).into(), self.along.o),
            Mover::Parallel(light, d) => {
                let turned = scene.emitters()[light as usize].turned();
                let drift = turned.and_then(|turned| turned.drift(theta));
                let d = Vec3::lift(d);
                form(drift.map_or(d, |drift| drift.direction(d)), self.along.o)
            }
        };
        sum - Const(sum.primal())
    }

    /// Adds its transpose, for an adjoint of its value.
    pub fn scatter(&self, scene: &Scene, theta: &Theta<P>, adjoint: P, sink: &mut Sink) {
        let RayAdjoint { o, d } = self.along;
        let mut surface = SurfaceAdjoint {
            p: o * adjoint,
            ..SurfaceAdjoint::zero()
        };
        surface.frame.n = d * adjoint;
        match self.mover {
            Mover::Material(prim, si) => {
                scene.scatter_point(theta, prim, &si, &surface, P::zero(), sink);
            }
            Mover::Seen(prim, at, si) => {
                let ray = scene.camera.ray_of(&at);
                let back = scene.scatter_interaction(theta, prim, &ray, &si, &surface, sink);
                scene.camera.scatter_ray(theta, &at, &back, sink);
            }
            Mover::Camera(at) => {
                let back = RayAdjoint {
                    o: o * adjoint,
                    d: d * adjoint,
                };
                scene.camera.scatter_ray(theta, &at, &back, sink);
            }
            Mover::Parallel(light, at) => {
                if let Some(turned) = scene.emitters()[light as usize].turned() {
                    turned.scatter_direction(theta, at, o * adjoint, sink);
                }
            }
            Mover::Light(p) => {
                for (k, d) in o.to_array().into_iter().enumerate() {
                    sink.add(p, k, d * adjoint);
                }
            }
        }
    }
}

/// Where along a ray it met a primitive.
pub(super) fn hit_at<P: Float>(prim: u32, t: P) -> Hit {
    Hit {
        t: t.to_f32(),
        u: 0.0,
        v: 0.0,
        prim,
    }
}
