//! A path tracer to read: all of detached differentiable light transport on one page.
//!
//! It samples BSDFs and emitters, weighs them with the power heuristic, and stops at a depth; everything is detached, so a
//! path is a list of plain numbers that does not depend on what is differentiated. [`trace`] makes the list, [`radiance`]
//! evaluates it over any scalar, and [`backward`] is the adjoint of that. What [`super::path`] and [`super::wave`] have
//! besides is the other strategies, roulette, guides, the choice of lights by what they would bring, caustics that are left to
//! particles, many paths at a time, and that what no derivative needs is not computed. With the same random numbers the
//! two agree to rounding (`tests/tests/simple.rs`).

use ad_core::{Float, Real, Vec2, Vec3};

use super::vertex::light::mis_weight;
use crate::bsdf::{Bsdf, Component, Part, Shading, TransportMode, Use};
use crate::emitter::{Emission, Emitter};
use crate::estimator::{DetachedMis, Strategy};
use crate::math::{Ray, Rgb};
use crate::params::{GradSink, Theta};
use crate::sampler::{Purpose, Sampler};
use crate::scene::Scene;

const MODE: TransportMode = TransportMode::Radiance;

/// Emitted light: an emitter, where on it, and what it is multiplied by.
#[derive(Clone, Copy, Debug)]
pub struct Light<P> {
    emitter: u32,
    emission: Emission<P>,
    /// MIS weight; of sampled light, over its density.
    weight: P,
}

/// A point where a path is reflected.
#[derive(Clone, Copy, Debug)]
pub struct Vertex<P> {
    /// Index of the material.
    material: u32,
    uv: Vec2<P>,
    /// Direction that the path came from, local frame.
    wo: Vec3<P>,
    /// A light that was sampled and is visible, and its direction, local frame.
    sampled: Option<(Vec3<P>, Light<P>)>,
    /// The direction that the path goes on in, local frame, what it belongs to, and one over its density.
    scattered: Option<(Vec3<P>, Component, P)>,
}

/// A path: its vertices, and the light that each edge met, of which there is one more.
#[derive(Clone, Debug, Default)]
pub struct Path<P> {
    vertices: Vec<Vertex<P>>,
    met: Vec<Vec<Light<P>>>,
}

/// Follows a path of at most `max_depth` edges from a camera ray. `theta` decides about directions only.
///
/// # Reference
/// [Zeltner 2021, section 2.5.1].
pub fn trace<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    max_depth: u32,
    mut ray: Ray<P>,
    sampler: &mut impl Sampler,
) -> Path<P> {
    let mut path = Path::default();
    let share = |emitter: u32| P::of(scene.shares().of(emitter as usize));
    // The point that the last edge left, and the density of its direction: zero for the camera and for mirrors.
    let (mut from, mut pdf) = (ray.o, P::zero());
    for depth in 1..=max_depth {
        // ---- Light that the edge met ----
        let hit = scene.intersect(&ray);
        let emitters = match &hit {
            Some(hit) => scene.shape_info(hit.shape).emitter.as_slice(),
            None => scene.infinite_emitters(),
        };
        let si = hit.as_ref().map(|hit| &hit.si);
        let mut met = Vec::new();
        for &emitter in emitters {
            let e = &scene.emitters()[emitter as usize];
            let Some(emission) = e.hit(ray.d, si) else {
                continue;
            };
            let weight = if pdf > P::zero() {
                DetachedMis::weight_hit(
                    pdf,
                    e.pdf(scene.lights(), from, ray.d, si) * share(emitter),
                )
            } else {
                P::one()
            };
            met.push(Light {
                emitter,
                emission,
                weight,
            });
        }
        path.met.push(met);
        let Some(hit) = hit.filter(|_| depth < max_depth) else {
            break;
        };

        // ---- A sampled light ----
        let (si, exit) = (&hit.si, scene.exit(hit.prim));
        let material = scene.shape_info(hit.shape).material;
        let bsdf = &scene.materials()[material as usize];
        let at = Shading {
            theta: *theta,
            uv: si.uv,
        };
        let wo = si.frame.to_local(-ray.d);
        sampler.seek(Purpose::Light.at(depth));
        let (choice, u) = (sampler.next_bits(), sampler.next_2d());
        let emitter = scene.shares().choose(choice, 1).0 as u32;
        let sample = (scene.emitters().get(emitter as usize))
            .filter(|_| !bsdf.is_delta())
            .and_then(|e| Some((e, e.sample(scene.lights(), si.p, u)?)));
        let sampled = sample.and_then(|(e, sample)| {
            let wi = si.frame.to_local(sample.d);
            let pdf_light = sample.pdf * share(emitter);
            let (_, pdf_bsdf) = bsdf.eval_pdf(&at, wo, wi, MODE);
            let weight =
                mis_weight::<DetachedMis, P>(!e.is_delta(), pdf_light, pdf_bsdf) / pdf_light;
            let segment = si.shadow_ray(sample.d, sample.distance, exit, sample.surface);
            let visible =
                pdf_light > P::zero() && pdf_bsdf > P::zero() && !scene.occluded(&segment);
            let emission = sample.emission;
            visible.then_some((
                wi,
                Light {
                    emitter,
                    emission,
                    weight,
                },
            ))
        });

        // ---- The next edge ----
        sampler.seek(Purpose::Scattering.at(depth));
        let sample = bsdf.sample(&at, wo, sampler.next_3d(), MODE);
        path.vertices.push(Vertex {
            material,
            uv: si.uv,
            wo,
            sampled,
            scattered: sample.map(|s| (s.wi, s.component, s.pdf.recip())),
        });
        let Some(sample) = sample else {
            break;
        };
        from = si.p;
        pdf = match sample.component {
            Component::Continuous => sample.pdf,
            Component::Delta { .. } => P::zero(),
        };
        ray = si.spawn_ray(si.frame.to_world(sample.wi), exit);
    }
    path
}

/// Radiance of a path: `L_k = sampled_k + f_k / p_k (met_k + L_(k+1))`.
///
/// # Derivatives
/// In `theta`.
pub fn radiance<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    path: &Path<P>,
) -> Rgb<R> {
    let emitted = |light: &Light<P>| {
        let e = &scene.emitters()[light.emitter as usize];
        e.eval(theta, &light.emission.lift()).scale(light.weight)
    };
    let mut next = Rgb::black();
    for k in (0..path.met.len()).rev() {
        // What arrives at the start of edge k, and what leaves the vertex there.
        let arrives = path.met[k].iter().fold(next, |l, light| l + emitted(light));
        let Some(v) = k.checked_sub(1).map(|k| &path.vertices[k]) else {
            return arrives;
        };
        next = leaving(scene, theta, v, emitted, arrives);
    }
    next
}

/// What leaves a vertex, given what arrives along the path.
fn leaving<P: Float, R: Real<Primal = P>>(
    scene: &Scene,
    theta: &Theta<R>,
    v: &Vertex<P>,
    emitted: impl Fn(&Light<P>) -> Rgb<R>,
    arrives: Rgb<R>,
) -> Rgb<R> {
    let bsdf = &scene.materials()[v.material as usize];
    let at = Shading {
        theta: *theta,
        uv: Vec2::lift(v.uv),
    };
    let f =
        |wi, component| bsdf.eval_component(&at, Vec3::lift(v.wo), Vec3::lift(wi), component, MODE);
    let mut l = Rgb::black();
    if let Some((wi, light)) = &v.sampled {
        l += f(*wi, Component::Continuous) * emitted(light);
    }
    if let Some((wi, component, weight)) = v.scattered {
        l += f(wi, component) * arrives.scale(weight);
    }
    l
}

/// Adds the derivative of `d . radiance` to `grad`: throughput times adjoint on the way there, radiance on the way back.
pub fn backward<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    path: &Path<P>,
    d: Rgb<P>,
    grad: &mut impl GradSink<P>,
) {
    let eval = |light: &Light<P>| {
        let e = &scene.emitters()[light.emitter as usize];
        e.eval(theta, &light.emission) * light.weight
    };
    // The adjoint of what arrives along each edge.
    let mut adjoints = vec![d];
    for v in &path.vertices {
        let before = adjoints[adjoints.len() - 1];
        let at = Shading {
            theta: *theta,
            uv: v.uv,
        };
        let bsdf = &scene.materials()[v.material as usize];
        let through = v.scattered.map_or(Rgb::black(), |(wi, component, weight)| {
            bsdf.eval_component(&at, v.wo, wi, component, MODE) * weight
        });
        adjoints.push(before * through);
    }
    let mut next = Rgb::black();
    for (k, met) in path.met.iter().enumerate().rev() {
        let mut arrives = next;
        for light in met {
            let e = &scene.emitters()[light.emitter as usize];
            e.backward(&light.emission, adjoints[k] * light.weight, grad);
            arrives += eval(light);
        }
        let Some(v) = k.checked_sub(1).map(|k| &path.vertices[k]) else {
            return;
        };
        let (d, at) = (
            adjoints[k - 1],
            Shading {
                theta: *theta,
                uv: v.uv,
            },
        );
        let bsdf = &scene.materials()[v.material as usize];
        let of = |wi, component, d| Use {
            wi,
            component,
            part: Part::All,
            d,
        };
        let mut uses = Vec::new();
        if let Some((wi, light)) = &v.sampled {
            let f = bsdf.eval(&at, v.wo, *wi, MODE);
            let e = &scene.emitters()[light.emitter as usize];
            e.backward(&light.emission, d * f * light.weight, grad);
            uses.push(of(*wi, Component::Continuous, d * eval(light)));
        }
        if let Some((wi, component, weight)) = v.scattered {
            uses.push(of(wi, component, d * arrives * weight));
        }
        bsdf.backward(&at, v.wo, &uses, MODE, grad);
        next = leaving(scene, theta, v, eval, arrives);
    }
}
