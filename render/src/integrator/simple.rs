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
use super::vertex::interest::is_straight;
use super::vertex::light::mis_weight;
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
    /// Material, surface coordinates, and the direction that the path came from (local frame).
    surface: Option<(u32, Vec2<P>, Vec3<P>)>,
    /// How the surface was used: a direction (local frame), what it belongs to, and the light that was sampled there; none
    /// for the direction of the edge.
    uses: Vec<(Vec3<P>, Component, Option<Light<P>>)>,
    /// One over the density of the direction of the edge.
    weight: P,
    /// Light that the edge met.
    met: Vec<Light<P>>,
}

/// Emitted light: an emitter, where on it, and what it is multiplied by (its MIS weight; if sampled, over its density).
#[derive(Clone, Copy, Debug)]
pub struct Light<P> {
    emitter: u32,
    emission: Emission<P>,
    weight: P,
}

/// Follows a path of at most `max_depth` edges from a camera ray; the scene says whether the first one meets lights. `theta` decides about directions only.
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
        uses: Vec::new(),
        weight: P::one(),
        met: Vec::new(),
    };
    let share = |emitter: u32| P::of(scene.shares().of(emitter as usize));
    let mut here = vertex(Rgb::splat(P::one()), None);
    let mut path = Vec::new();
    // The point that the edge left, and the density of its direction: zero for the camera and for mirrors.
    let (mut from, mut pdf) = (ray.o, P::zero());
    let mut bent = false;
    for depth in 1..=max_depth {
        // ---- Light that the edge meets ----
        let hit = (scene.seen(&ray, scene.settings.hides(depth)))
            .map(|hit| scene.interaction(&Theta::still(), &ray, &hit));
        let si = hit.as_ref().map(|hit| &hit.si);
        let emitters = match &hit {
            _ if scene.settings.hides(depth) => &[],
            None if scene.settings.hides_sky(bent) => &[],
            Some(hit) => scene.shape_info(hit.shape).emitter.as_slice(),
            None => scene.infinite_emitters(),
        };
        for &emitter in emitters {
            let e = &scene.emitters()[emitter as usize];
            if let Some(emission) = e.hit(ray.d, si) {
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
        // Along the edge that led here.
        let along = here.uses.iter().find(|(.., light)| light.is_none());
        let beta = match (here.surface, along) {
            (Some(surface), Some((wi, component, _))) => {
                here.beta * value(scene, theta, surface, *wi, *component) * here.weight
            }
            _ => here.beta,
        };
        path.push(std::mem::replace(
            &mut here,
            vertex(beta, Some((material, si.uv, wo))),
        ));
        sampler.seek(Purpose::Light.at(depth));
        let (choice, u) = (sampler.next_bits(), sampler.next_2d());
        let emitter = scene.shares().choose(choice, 1).0 as u32;
        if let Some(e) = scene
            .emitters()
            .get(emitter as usize)
            .filter(|_| !bsdf.is_delta())
            && let Some(sample) = e.sample(scene.lights(), si.p, u)
        {
            let wi = si.frame.to_local(sample.d);
            let (pdf, rival) = (
                sample.pdf * share(emitter),
                bsdf.eval_pdf(&at, wo, wi, MODE).1,
            );
            let segment = si.shadow_ray(sample.d, sample.distance, exit, sample.surface);
            if pdf > P::zero() && rival > P::zero() && !scene.occluded(&segment) {
                let weight = mis_weight::<DetachedMis, P>(!e.is_delta(), pdf, rival) / pdf;
                let light = Light {
                    emitter,
                    emission: sample.emission,
                    weight,
                };
                here.uses.push((wi, Component::Continuous, Some(light)));
            }
        }

        // ---- The next edge ----
        sampler.seek(Purpose::Scattering.at(depth));
        let Some(sample) = bsdf.sample(&at, wo, sampler.next_3d(), MODE) else {
            break;
        };
        bent |= !is_straight(sample.component, [P::one(), sample.eta]);
        here.uses.push((sample.wi, sample.component, None));
        here.weight = sample.pdf.recip();
        from = si.p;
        pdf = match sample.component {
            Component::Continuous => sample.pdf,
            Component::Delta { .. } => P::zero(),
        };
        ray = si.spawn_ray(si.frame.to_world(sample.wi), exit);
    }
    path.push(here);
    path
}

/// Value of the BSDF at a surface.
fn value<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    (material, uv, wo): (u32, Vec2<P>, Vec3<P>),
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
        let arrives = v
            .met
            .iter()
            .fold(next, |l, light| l + emitted(scene, theta, light));
        let Some(surface) = v.surface else {
            return arrives;
        };
        v.uses
            .iter()
            .fold(Rgb::black(), |l, (wi, component, light)| {
                let incident = match light {
                    Some(light) => emitted(scene, theta, light),
                    None => arrives.scale(v.weight),
                };
                l + value(scene, theta, surface, *wi, *component) * incident
            })
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
        let along = v.uses.iter().find(|(.., light)| light.is_none());
        let beta = v.beta * along.map_or(Rgb::splat(P::one()), |(wi, c, _)| f(*wi, *c) * v.weight);
        let arrives = v
            .met
            .iter()
            .fold(next, |l, light| l + emit(light, beta, grad));
        next = arrives;
        if let Some((material, uv, wo)) = v.surface {
            next = Rgb::black();
            let mut uses = Vec::new();
            for (wi, component, light) in &v.uses {
                let f = f(*wi, *component);
                let incident = match light {
                    Some(light) => emit(light, v.beta * f, grad),
                    None => arrives * v.weight,
                };
                next += f * incident;
                let (wi, component, d) = (*wi, *component, d * v.beta * incident);
                uses.push(Use {
                    wi,
                    component,
                    part: Part::All,
                    d,
                });
            }
            let at = Shading::new(*theta, uv);
            scene.materials()[material as usize].backward(&at, wo, &uses, MODE, grad);
        }
    }
}
