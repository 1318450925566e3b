//! A path tracer to read: all of detached differentiable light transport on a few pages.
//!
//! It samples BSDFs and emitters, weighs them with the power heuristic, and stops at a depth. Everything is detached, so that
//! a path is a list of plain numbers which does not depend on what is differentiated: [`trace`] makes it, [`radiance`]
//! evaluates it over any scalar, and [`backward`] is the adjoint of that. What [`super::path`] and `super::wave` have
//! besides is the other strategies, roulette, guides, the choice of lights by what they would bring, caustics that are left
//! to particles, many paths at a time, and that what no derivative needs is not computed. With the same random numbers
//! the two agree to rounding (`tests/tests/simple.rs`).
//!
//! ```
//! use render::integrator::simple;
//! use render::params::Theta;
//! use render::sampler::{Independent, Sampler};
//!
//! let room = render::scene::room(16, 16)?;
//! let values: Vec<f64> = room.params().values().iter().map(|&v| v.into()).collect();
//! let theta = Theta::constant(&values);
//! let mut sampler = Independent::new(1, 0, 0);
//! let path = simple::trace(&room, &theta, 6, room.camera.ray(8.5, 12.5), &mut sampler);
//! let radiance = simple::radiance(&room, &theta, &path);
//! assert!(radiance.is_finite());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use ad_core::{Float, Real, Vec2, Vec3};

use super::vertex::MODE;
use super::vertex::interest::PathInterest;
use super::vertex::light::{density, emitters_at, mis_weight};
use crate::bsdf::{Bsdf, Component, Part, Shading, Use};
use crate::emitter::{Emission, Emitter};
use crate::estimator::{DetachedMis, Strategy};
use crate::math::{Ray, Rgb};
use crate::params::{GradSink, Theta};
use crate::sampler::{Purpose, Sampler};
use crate::scene::Scene;

/// A vertex of a path, and the edge from there. The first one is the camera.
#[derive(Clone, Debug)]
pub struct Vertex<P> {
    /// Throughput from the camera.
    beta: Rgb<P>,
    /// None at the camera.
    surface: Option<Surface<P>>,
    /// The light that was sampled, and the direction to it (local frame).
    sampled: Option<(Vec3<P>, Light<P>)>,
    /// Direction of the edge (local frame), what it belongs to, and one over its density; none at the camera, and where the
    /// path ends.
    edge: Option<(Vec3<P>, Component, P)>,
    /// Light that the edge met.
    met: Vec<Light<P>>,
}

/// Material, surface coordinates, and the direction that the path came from (local frame).
type Surface<P> = (u32, Vec2<P>, Vec3<P>);

/// Emitted light: an emitter, where on it, and what it is multiplied by (its MIS weight; if sampled, over its density).
#[derive(Clone, Copy, Debug)]
pub struct Light<P> {
    emitter: u32,
    emission: Emission<P>,
    weight: P,
}

/// Follows a path of at most `max_depth` edges from a camera ray; whether the first of them meets lights is a setting of the
/// scene. `theta` decides about directions only.
///
/// # Reference
/// [Zeltner 2021, section 2.5.1].
pub fn trace<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    max_depth: u32,
    mut ray: Ray<P>,
    sampler: &mut impl Sampler,
) -> Vec<Vertex<P>> {
    let vertex = |beta, surface| Vertex {
        beta,
        surface,
        sampled: None,
        edge: None,
        met: Vec::new(),
    };
    let share = |emitter: u32| P::of(scene.shares().of(emitter as usize));
    let mut path = Vec::new();
    // The vertex that the edge leaves, and what it multiplies the throughput by: value over density.
    let (mut here, mut step) = (vertex(Rgb::splat(P::one()), None), Rgb::splat(P::one()));
    // The point there, and the density of the direction: zero for the camera and for mirrors.
    let (mut from, mut pdf) = (ray.o, P::zero());
    let mut interest = PathInterest::default();
    for depth in 1..=max_depth {
        // ---- Light that the edge meets ----
        let hit = scene.seen(&ray, scene.settings.hides(depth));
        let hit = hit.map(|hit| scene.interaction(&Theta::still(), &ray, &hit));
        let si = hit.as_ref().map(|hit| &hit.si);
        let shape = hit.as_ref().map(|hit| hit.shape);
        for &emitter in emitters_at(scene, &scene.settings, depth, interest.bent, shape) {
            let e = &scene.emitters()[emitter as usize];
            if let Some(emission) = e.hit(ray.d, si) {
                // In full, to be read: `find_light` has the same for all strategies.
                let weight = if pdf > P::zero() {
                    let rival = e.pdf(scene.lights(), from, ray.d, si) * share(emitter);
                    DetachedMis::weight_hit(pdf, rival)
                } else {
                    P::one()
                };
                here.met.push(Light {
                    emitter,
                    emission,
                    weight,
                });
            }
        }
        let Some(hit) = hit.filter(|_| depth < max_depth) else {
            break;
        };

        // ---- A sampled light ----
        let (si, exit) = (&hit.si, scene.exit(hit.prim));
        let material = scene.shape_info(hit.shape).material;
        let bsdf = &scene.materials()[material as usize];
        let at = Shading::new(*theta, si.uv);
        let wo = si.frame.to_local(-ray.d);
        let next = vertex(here.beta * step, Some((material, si.uv, wo)));
        path.push(std::mem::replace(&mut here, next));
        sampler.seek(Purpose::Light.at(depth));
        let (choice, u) = (sampler.next_bits(), sampler.next_2d());
        let emitter = scene.shares().choose(choice, 1).0 as u32;
        let e = scene.emitters().get(emitter as usize);
        if let Some(e) = e.filter(|_| !bsdf.is_delta())
            && let Some(sample) = e.sample(scene.lights(), si.p, u)
        {
            let wi = si.frame.to_local(sample.d);
            let pdf = sample.pdf * share(emitter);
            let (_, rival) = bsdf.eval_pdf(&at, wo, wi, MODE);
            let segment = si.shadow_ray(sample.d, sample.distance, exit, sample.surface);
            if pdf > P::zero() && rival > P::zero() && !scene.occluded(&segment) {
                let light = Light {
                    emitter,
                    emission: sample.emission,
                    weight: mis_weight::<DetachedMis, P>(!e.is_delta(), pdf, rival) / pdf,
                };
                here.sampled = Some((wi, light));
            }
        }

        // ---- The next edge ----
        sampler.seek(Purpose::Scattering.at(depth));
        let Some((sample, f)) = bsdf.sample_eval(&at, wo, sampler.next_3d(), MODE) else {
            break;
        };
        let weight = sample.pdf.recip();
        here.edge = Some((sample.wi, sample.component, weight));
        step = f * weight;
        interest.bend(sample.component, [P::one(), sample.eta]);
        (from, pdf) = (si.p, density(sample.component, || sample.pdf));
        ray = si.spawn_ray(si.frame.to_world(sample.wi), exit);
    }
    path.push(here);
    path
}

/// Value of the BSDF at a surface.
fn value<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    (material, uv, wo): Surface<P>,
    wi: Vec3<P>,
    component: Component,
) -> Rgb<R> {
    let at = Shading::new(*theta, Vec2::lift(uv));
    let bsdf = &scene.materials()[material as usize];
    bsdf.eval_component(&at, Vec3::lift(wo), Vec3::lift(wi), component, MODE)
}

/// Emitted radiance, weighed.
fn emitted<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    light: &Light<P>,
) -> Rgb<R> {
    let e = &scene.emitters()[light.emitter as usize];
    e.eval(theta, &light.emission.lift()).scale(light.weight)
}

/// Radiance of a path, from its end to its start: `L_k = f le / p + f / p (met_k + L_(k+1))`.
///
/// # Derivatives
/// In `theta`.
pub fn radiance<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    path: &[Vertex<P>],
) -> Rgb<R> {
    path.iter().rev().fold(Rgb::black(), |next, v| {
        let met = v.met.iter().map(|light| emitted(scene, theta, light));
        let arrives = met.fold(next, |l, le| l + le);
        let Some(surface) = v.surface else {
            return arrives;
        };
        let mut leaves = Rgb::black();
        if let Some((wi, light)) = &v.sampled {
            let f = value(scene, theta, surface, *wi, Component::Continuous);
            leaves += f * emitted(scene, theta, light);
        }
        if let Some((wi, component, weight)) = v.edge {
            leaves += value(scene, theta, surface, wi, component) * arrives.scale(weight);
        }
        leaves
    })
}

/// Adds the derivative of `d . radiance` to `grad`: each value's adjoint is the throughput up to it times what arrives
/// behind it.
pub fn backward<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    path: &[Vertex<P>],
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let emit = |light: &Light<P>, beta: Rgb<P>, grad: &mut _| {
        let e = &scene.emitters()[light.emitter as usize];
        e.backward(theta, &light.emission, d * beta * light.weight, grad);
        emitted(scene, theta, light)
    };
    let mut next = Rgb::black();
    for v in path.iter().rev() {
        let f = |wi, component| match v.surface {
            Some(surface) => value(scene, theta, surface, wi, component),
            None => Rgb::splat(P::one()),
        };
        let along = (v.edge).map_or(Rgb::splat(P::one()), |(wi, c, weight)| f(wi, c) * weight);
        let met = v.met.iter().map(|light| emit(light, v.beta * along, grad));
        let arrives = met.fold(next, |l, le| l + le);
        let Some((material, uv, wo)) = v.surface else {
            continue;
        };
        // Directions that the material was asked for, and what arrives from there.
        let mut uses = Vec::new();
        if let Some((wi, light)) = &v.sampled {
            let f = f(*wi, Component::Continuous);
            uses.push((*wi, Component::Continuous, emit(light, v.beta * f, grad)));
        }
        uses.extend((v.edge).map(|(wi, component, weight)| (wi, component, arrives * weight)));
        let leaves = uses.iter().map(|&(wi, component, l)| f(wi, component) * l);
        next = leaves.fold(Rgb::black(), |l, leaves| l + leaves);
        let uses: Vec<_> = (uses.into_iter())
            .map(|(wi, component, l)| Use {
                wi,
                component,
                part: Part::All,
                d: d * v.beta * l,
            })
            .collect();
        let at = Shading::new(*theta, uv);
        scene.materials()[material as usize].backward(&at, wo, &uses, MODE, grad);
    }
}
