//! Recorded paths and their adjoint.
//!
//! The forward pass keeps what happened at each vertex. The backward pass knows the radiance at every
//! vertex from the recursion `L_k = light_k + sampled_k + f_k w_k L_(k+1)` and gives each local value
//! its adjoint: no tape of operations, no second ray tracing, and no subtraction or division of
//! radiances, so nothing cancels and a zero albedo is no special case.

use ad_core::{Float, Vec2, Vec3};

use super::path::{Bounce, HitLight, Observer, SampledLight};
use crate::bsdf::{Bsdf, Component, Shading, TransportMode, Use};
use crate::emitter::Emitter;
use crate::math::Rgb;
use crate::params::{GradSink, Theta};
use crate::scene::Scene;

/// One vertex of a path, and the light found on the edge that leads to it.
#[derive(Clone, Copy, Debug)]
struct Vertex<P> {
    /// Throughput from the camera.
    beta: Rgb<P>,
    /// Index of the shape; none at an end without surface or beyond the last scattering.
    surface: Option<Surface<P>>,
    sampled: Option<SampledLight<P>>,
    bounce: Option<Bounce<P>>,
    /// Light found here, as a range of `Recorder::lights`.
    lights: (u32, u32),
}

#[derive(Clone, Copy, Debug)]
struct Surface<P> {
    shape: u32,
    uv: Vec2<P>,
    wo: Vec3<P>,
}

/// Keeps the vertices of one path at a time. Reused from path to path, it stops allocating soon.
#[derive(Clone, Debug, Default)]
pub struct Recorder<P> {
    vertices: Vec<Vertex<P>>,
    lights: Vec<HitLight<P>>,
    /// Number of entries of `lights` that belong to a vertex already.
    claimed: u32,
}

impl<P: Float> Recorder<P> {
    /// Forgets the path.
    pub fn clear(&mut self) {
        self.vertices.clear();
        self.lights.clear();
        self.claimed = 0;
    }

    fn push(&mut self, beta: Rgb<P>, surface: Option<Surface<P>>) {
        let lights = (self.claimed, self.lights.len() as u32);
        self.claimed = lights.1;
        self.vertices.push(Vertex {
            beta,
            surface,
            sampled: None,
            bounce: None,
            lights,
        });
    }

    /// Adds the derivative of `d_l . L`, where `L` is the radiance of the recorded path and `d_l` its
    /// adjoint, to the active parameters.
    pub fn backward(
        &mut self,
        scene: &Scene,
        theta: &Theta<P>,
        d_l: Rgb<P>,
        grad: &mut (impl GradSink<P> + Activity),
    ) {
        if (self.claimed as usize) < self.lights.len() {
            // The light at the open end of the path, beyond the last vertex.
            let beta = match self.vertices.last() {
                Some(Vertex {
                    beta,
                    bounce: Some(b),
                    ..
                }) => *beta * b.f * b.weight,
                _ => Rgb::splat(P::one()),
            };
            self.push(beta, None);
        }
        let mut l = Rgb::<P>::black(); // radiance leaving the next vertex
        for v in self.vertices.iter().rev() {
            let d = d_l * v.beta;
            let mut here = Rgb::black();
            for hit in &self.lights[v.lights.0 as usize..v.lights.1 as usize] {
                let e = &scene.emitters()[hit.emitter as usize];
                here += e.eval(theta, &hit.emission) * hit.weight;
                if grad.emitter_active(hit.emitter) {
                    e.backward(&hit.emission, d * hit.weight, grad);
                }
            }
            let mut uses = [Use {
                wi: Vec3::zero(),
                component: Component::Continuous,
                d: Rgb::black(),
            }; 2];
            let mut n = 0;
            if let Some(s) = &v.sampled {
                here += s.f * s.le * s.weight;
                if grad.emitter_active(s.emitter) {
                    let e = &scene.emitters()[s.emitter as usize];
                    e.backward(&s.emission, d * s.f * s.weight, grad);
                }
                uses[n] = Use {
                    wi: s.wi,
                    component: Component::Continuous,
                    d: d * s.le * s.weight,
                };
                n += 1;
            }
            if let Some(b) = &v.bounce {
                here += b.f * l * b.weight;
                if !l.is_black() {
                    uses[n] = Use {
                        wi: b.wi,
                        component: b.component,
                        d: d * l * b.weight,
                    };
                    n += 1;
                }
            }
            if let (Some(s), true) = (&v.surface, n > 0) {
                let material = scene.shape_info(s.shape).material;
                if grad.material_active(material) {
                    let at = Shading {
                        theta: *theta,
                        uv: s.uv,
                    };
                    let material = &scene.materials()[material as usize];
                    material.backward(&at, s.wo, &uses[..n], TransportMode::Radiance, grad);
                }
            }
            l = here;
        }
    }
}

/// What takes part in a derivative, by index: a vertex of an inactive material does primal work only.
pub trait Activity {
    /// Whether a material reads an active parameter.
    fn material_active(&self, material: u32) -> bool;
    /// Whether an emitter does.
    fn emitter_active(&self, emitter: u32) -> bool;
}

impl<P: Float> Observer<P> for Recorder<P> {
    #[inline]
    fn light(&mut self, _depth: u32, _beta: Rgb<P>, light: HitLight<P>) {
        self.lights.push(light);
    }

    #[inline]
    fn vertex(
        &mut self,
        _depth: u32,
        beta: Rgb<P>,
        shape: u32,
        uv: Vec2<P>,
        wo: Vec3<P>,
        _p: Vec3<P>,
    ) {
        self.push(beta, Some(Surface { shape, uv, wo }));
    }

    #[inline]
    fn sampled(&mut self, _depth: u32, light: SampledLight<P>) {
        if let Some(v) = self.vertices.last_mut() {
            v.sampled = Some(light);
        }
    }

    #[inline]
    fn bounce(&mut self, bounce: Bounce<P>) {
        if let Some(v) = self.vertices.last_mut() {
            v.bounce = Some(bounce);
        }
    }
}
