//! The adjoint of a path whose vertices move, vertex by vertex.

use ad_core::{Dual, Float, Vec2, Vec3};

use super::slopes::{across, slope, slopes, varied};
use super::trail::{Stop, Trail, sampled_point};
use crate::bsdf::Component;
use crate::camera::CameraSample;
use crate::emitter::{Emitter, EmitterSample, Rays};
use crate::estimator::Strategy;
use crate::integrator::active::Active;
use crate::integrator::record::{Place, SampledLight};
use crate::math::{Ray, RayAdjoint, Rgb};
use crate::params::{GradSink, Theta};
use crate::scene::Scene;
use crate::shape::{SurfaceAdjoint, SurfaceInteraction};

/// A point that may move, and its adjoint.
#[derive(Clone, Copy, Debug)]
struct Point<P> {
    prim: u32,
    si: SurfaceInteraction<P>,
    /// The point that its ray comes from; none for the camera's.
    from: Option<usize>,
    moves: bool,
    d: SurfaceAdjoint<P>,
    /// Of the logarithm of the area around it.
    d_log_area: P,
}

/// What light comes from.
#[derive(Clone, Copy)]
enum Source<P> {
    /// A point, by its number.
    Point(usize),
    /// Far away: a direction that is a constant, world space.
    Afar,
    /// A point that is a light.
    Light(Vec3<P>),
    /// The direction of parallel light, which may turn.
    Parallel,
}

/// A value of a material, and its adjoint.
#[derive(Clone, Copy)]
struct ScatteredValue<P> {
    /// Direction that light comes from, local frame.
    wi: Vec3<P>,
    component: Component,
    f: Rgb<P>,
    a: Rgb<P>,
}

impl<P: Float> ScatteredValue<P> {
    /// For a light that was sampled.
    fn of_light(s: &SampledLight<P>, a: Rgb<P>) -> Self {
        Self {
            wi: s.wi,
            component: Component::Continuous,
            f: s.f,
            a,
        }
    }
}

/// Adds the adjoint of a path's radiance to the parameters that move its vertices.
///
/// Its first vertex is where a ray through a point of the film meets the surface that moves; all others stay on their
/// material, and so do their densities, weights and roulette. Then every factor of the path's value depends on three
/// vertices at most, and each vertex takes one adjoint, of its position, normals and texture coordinates, from the factors
/// that it appears in. Nothing is handed on along the path.
///
/// With `rays_at_rest`, for study, all others are where a ray that is a constant meets the surface that moves: that its
/// vertex moves, too, is left out (F44).
///
/// # Does not handle
/// What becomes visible or hidden (F10), horizons of mapped normals among it (F9), and Dirac deltas.
pub(super) struct PullBack<'a, P: Float> {
    scene: &'a Scene,
    theta: &'a Theta<'a, P>,
    active: &'a Active,
    rays_at_rest: bool,
    points: Vec<Point<P>>,
    /// Direction of the camera's ray, and its adjoint.
    camera: Vec3<P>,
    d_camera: Vec3<P>,
}

impl<'a, P: Float> PullBack<'a, P> {
    pub fn new<S: Strategy>(scene: &'a Scene, theta: &'a Theta<'a, P>, active: &'a Active) -> Self {
        Self {
            scene,
            theta,
            active,
            rays_at_rest: S::RAYS_AT_REST,
            points: Vec::new(),
            camera: Vec3::zero(),
            d_camera: Vec3::zero(),
        }
    }

    /// Adds the derivative of `d_l . L`, where `L` is the radiance of the path that the camera sees `at` a point of the image.
    pub fn add(
        &mut self,
        trail: &Trail<P>,
        at: &CameraSample<P>,
        d_l: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) {
        self.d_camera = Vec3::zero();
        self.points.clear();
        for (k, stop) in trail.stops.iter().enumerate() {
            self.push(k.checked_sub(1), stop.place.prim, stop.place.si);
        }
        // An end that is no vertex.
        let last = trail.stops.last().map_or(&trail.first, |stop| &stop.edge);
        if let Some((prim, si)) = last.end {
            self.push(trail.stops.len().checked_sub(1), prim, si);
        }
        let ray: Ray<P> = self.scene.camera.ray_of(at);
        self.camera = ray.d;
        let mut next = Rgb::black();
        for (k, stop) in trail.stops.iter().enumerate().rev() {
            next = self.stop(k, stop, next, d_l, grad);
        }
        for met in &trail.first.met {
            let end = trail.first.end.map(|_| 0);
            self.emission(None, end, met.emitter, ray.d, d_l * met.weight, grad);
        }
        self.scatter(&ray, at, grad);
    }

    fn push(&mut self, from: Option<usize>, prim: u32, si: SurfaceInteraction<P>) -> usize {
        let shape = self.scene.shape_of(prim);
        let first = self.points.is_empty();
        self.points.push(Point {
            prim,
            si,
            from,
            moves: self.active.moves_shape(shape) || (first && self.active.moves_camera()),
            d: SurfaceAdjoint::zero(),
            d_log_area: P::zero(),
        });
        self.points.len() - 1
    }

    /// The radiance that leaves a vertex where `next` leaves the one behind it.
    fn stop(
        &mut self,
        k: usize,
        stop: &Stop<P>,
        next: Rgb<P>,
        d_l: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) -> Rgb<P> {
        let radiance = stop.radiance(self.scene, self.theta, next);
        if let Some(b) = &stop.bounce {
            let a = d_l * stop.beta * radiance.arriving;
            let end = stop.edge.end.map(|_| k + 1);
            let source = end.map_or(Source::Afar, Source::Point);
            let value = ScatteredValue {
                wi: b.wi,
                component: b.component,
                f: b.f,
                a,
            };
            self.scattered(k, &stop.place, value, source);
            let d = match end {
                Some(j) => self.direction(k, self.points[j].si.p),
                None => stop.place.si.frame.to_world(b.wi),
            };
            for met in &stop.edge.met {
                let a = d_l * stop.beta * b.f.scale(b.weight) * met.weight;
                self.emission(Some(k), end, met.emitter, d, a, grad);
            }
        }
        if let Some(light @ (s, sample)) = &stop.sampled {
            let e = &self.scene.emitters()[s.emitter as usize];
            let a = d_l * stop.beta * s.le.scale(s.weight);
            let a_le = d_l * stop.beta * s.f.scale(s.weight);
            if e.is_delta() {
                self.delta_light(k, &stop.place, light, [a, a_le], grad);
            } else {
                let end = sampled_point(self.scene, e, &stop.place, sample)
                    .map(|(prim, si)| self.push(Some(k), prim, si));
                let source = end.map_or(Source::Afar, Source::Point);
                self.scattered(k, &stop.place, ScatteredValue::of_light(s, a), source);
                let d = match end {
                    Some(j) => self.direction(k, self.points[j].si.p),
                    None => sample.d,
                };
                self.emission(Some(k), end, s.emitter, d, a_le, grad);
            }
        }
        radiance.leaving
    }

    /// The unit vector from point `k` to `to`. Rays start off their surface and are not quite parallel to it: only with
    /// this one everywhere what moves as a whole changes nothing to the last digits.
    fn direction(&self, k: usize, to: Vec3<P>) -> Vec3<P> {
        (to - self.points[k].si.p).normalize()
    }

    /// Whether point `k` slides over its surface, along a ray that does not move with it.
    fn slides(&self, k: usize) -> bool {
        k == 0 || self.rays_at_rest
    }

    /// The adjoint `d` of the unit vector from point `k` to `to`, as that of `to`; point `k` has the opposite.
    fn towards(&mut self, k: usize, to: Vec3<P>, d: Vec3<P>) -> Vec3<P> {
        let v = to - self.points[k].si.p;
        let inverse = v.length().recip();
        let n = v * inverse;
        let d = (d - n * n.dot(d)) * inverse;
        self.points[k].d.p -= d;
        d
    }

    /// The adjoint `local` of the unit vector `world` in the frame of point `k`, as that of the vector in the world.
    fn in_world(&mut self, k: usize, world: Vec3<P>, local: Vec3<P>) -> Vec3<P> {
        let point = &mut self.points[k];
        point.d.frame.s += world * local.x;
        point.d.frame.t += world * local.y;
        point.d.frame.n += world * local.z;
        point.si.frame.to_world(local)
    }

    /// A value of the material of point `k`, for light from `source`. The adjoint of the place of a source that is a light, of the
    /// direction to parallel light.
    fn scattered(
        &mut self,
        k: usize,
        place: &Place<P>,
        ScatteredValue {
            wi,
            component,
            f,
            a,
        }: ScatteredValue<P>,
        source: Source<P>,
    ) -> Vec3<P> {
        let before = match k {
            0 => self.active.moves_camera(),
            _ => self.points[k - 1].moves,
        };
        let behind = match source {
            Source::Point(j) => self.points[j].moves,
            Source::Afar => false,
            Source::Light(_) | Source::Parallel => true,
        };
        if a.is_black() || !(before || self.points[k].moves || behind) {
            return Vec3::zero();
        }
        let material = self.scene.material(place.shape);
        let s = if self.slides(k) {
            slopes::<P, 6>(material, self.theta, place, wi, component, a)
        } else {
            slopes::<P, 4>(material, self.theta, place, wi, component, a)
        };
        self.points[k].d.uv += s.uv;
        if k == 0 {
            let d_o = self.in_world(k, -self.camera, s.wo);
            self.d_camera -= d_o;
        } else {
            let from = self.points[k - 1].si.p;
            let d_o = self.in_world(k, self.direction(k, from), s.wo);
            if !self.rays_at_rest {
                let d = self.towards(k, from, d_o);
                self.points[k - 1].d.p += d;
            }
        }
        match source {
            Source::Afar => {
                self.in_world(k, place.si.frame.to_world(wi), s.wi);
                Vec3::zero()
            }
            Source::Parallel => self.in_world(k, place.si.frame.to_world(wi), s.wi),
            Source::Light(at) => {
                let d_i = self.in_world(k, self.direction(k, at), s.wi);
                self.towards(k, at, d_i)
            }
            Source::Point(j) => {
                let to = self.points[j].si;
                let d_i = self.in_world(k, self.direction(k, to.p), s.wi);
                if self.rays_at_rest {
                    return Vec3::zero();
                }
                let d = self.towards(k, to.p, d_i);
                // The solid angle of the area around it: its logarithm has this adjoint.
                let b = (a * f).sum();
                let v = to.p - self.points[k].si.p;
                let across = to.n_geo.dot(v);
                // Points of one plane stay on it: they see nothing of each other, however it moves.
                let foreshortened = if across == P::zero() {
                    P::zero()
                } else {
                    b / across
                };
                let d_v = to.n_geo * foreshortened - v * (P::of(3.0) * b / v.length_squared());
                self.points[k].d.p -= d_v;
                let end = &mut self.points[j];
                end.d.p += d + d_v;
                end.d.n_geo += v * foreshortened;
                end.d_log_area += b;
                Vec3::zero()
            }
        }
    }

    /// Light from a point that is a light, or along one direction: `a` and `a_le` are the adjoints of the material's value and of what arrives.
    fn delta_light(
        &mut self,
        k: usize,
        place: &Place<P>,
        (s, sample): &(SampledLight<P>, EmitterSample<P>),
        [a, a_le]: [Rgb<P>; 2],
        grad: &mut impl GradSink<P>,
    ) {
        let e = &self.scene.emitters()[s.emitter as usize];
        let moves = self.active.moves_emitter(s.emitter);
        let before = k == 0 && self.active.moves_camera() || k > 0 && self.points[k - 1].moves;
        if !(moves || before || self.points[k].moves) {
            return;
        }
        let source = match e.rays(self.scene.lights()) {
            Some(Rays::From(_)) => Source::Light(place.si.p + sample.d * sample.distance),
            Some(Rays::Along(_)) | None => Source::Parallel,
        };
        let mut d = self.scattered(k, place, ScatteredValue::of_light(s, a), source);
        let from = place.si.p;
        let var = |x: P, i: usize| Dual::<P, 3>::var(x, i);
        let from = Vec3::new(var(from.x, 0), var(from.y, 1), var(from.z, 2));
        let connection = e.connect(sample, from);
        let le = e.eval(&self.theta.lift(), &connection.emission);
        let d_from = Vec3::new(
            slope(&le, a_le, 0),
            slope(&le, a_le, 1),
            slope(&le, a_le, 2),
        );
        self.points[k].d.p += d_from;
        d -= d_from;
        if moves {
            if let Some(turned) = e.turned() {
                turned.scatter_direction(self.theta, sample.d, d, grad);
            } else if let Some(p) = e.moved_by() {
                grad.add_all(p, 0, d.to_array());
            }
        }
    }

    /// Light that arrives with the adjoint `a` in direction `d` from an emitter at point `end`, or from afar, at point
    /// `from`, or at the camera.
    fn emission(
        &mut self,
        from: Option<usize>,
        end: Option<usize>,
        emitter: u32,
        d: Vec3<P>,
        a: Rgb<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let e = &self.scene.emitters()[emitter as usize];
        let moves = match from {
            None => self.active.moves_camera(),
            Some(k) => end.is_some() && self.points[k].moves,
        };
        let moves = moves || end.is_some_and(|j| self.points[j].moves);
        if a.is_black() || !(moves || self.active.moves_emitter(emitter)) {
            return;
        }
        type D<P> = Dual<P, 7>;
        let theta = self.theta.lift::<D<P>>();
        let direction = varied::<P, 7>(d, 0);
        let seen = end.map(|j| {
            let mut si = self.points[j].si.lift::<D<P>>();
            let n = &mut si.frame.n;
            let var = |k| D::<P>::var(P::zero(), k);
            *n = Vec3::new(n.x + var(2), n.y + var(3), n.z + var(4));
            (si.uv.x, si.uv.y) = (si.uv.x + var(5), si.uv.y + var(6));
            si
        });
        let Some(found) = e.hit(direction, seen.as_ref()) else {
            return;
        };
        let le = e.eval(&theta, &found);
        let slope = |k: usize| slope(&le, a, k);
        let [s, t] = across(d);
        let d_d = s * slope(0) + t * slope(1);
        match (from, end) {
            (None, _) => self.d_camera += d_d,
            (Some(_), Some(_)) if self.rays_at_rest => {}
            (Some(k), Some(j)) => {
                let to = self.points[j].si.p;
                let d = self.towards(k, to, d_d);
                self.points[j].d.p += d;
            }
            (Some(_), None) => {}
        }
        if let Some(j) = end {
            let slides = self.slides(j);
            let end = &mut self.points[j].d;
            end.frame.n += Vec3::new(slope(2), slope(3), slope(4));
            if slides {
                end.uv += Vec2::new(slope(5), slope(6));
            }
        } else if self.active.moves_emitter(emitter)
            && let Some(turned) = e.turned()
        {
            turned.scatter_turn(self.theta, d, d_d, grad);
        }
    }

    /// Adds the adjoints of all points.
    fn scatter(&mut self, ray: &Ray<P>, at: &CameraSample<P>, grad: &mut impl GradSink<P>) {
        let (scene, theta) = (self.scene, self.theta);
        let mut back = RayAdjoint {
            o: Vec3::zero(),
            d: self.d_camera,
        };
        for (i, point) in self.points.iter().enumerate().filter(|(_, p)| p.moves) {
            let Point {
                prim,
                si,
                from,
                d,
                d_log_area,
                ..
            } = point;
            if i == 0 {
                let own = scene.scatter_interaction(theta, *prim, ray, si, d, grad);
                back.o += own.o;
                back.d += own.d;
            } else if self.rays_at_rest {
                let o = from.map_or(ray.o, |k| self.points[k].si.p);
                let ray = Ray::new(o, (si.p - o).normalize());
                scene.scatter_interaction(theta, *prim, &ray, si, d, grad);
            } else {
                scene.scatter_point(theta, *prim, si, d, *d_log_area, grad);
            }
        }
        if self.active.moves_camera() {
            scene.camera.scatter_ray(theta, at, &back, grad);
        }
    }
}
