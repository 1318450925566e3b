//! Recorded paths and their adjoint.
//!
//! The forward pass keeps what happened at each vertex. The backward pass knows the radiance at every
//! vertex from the recursion `L_k = light_k + sampled_k + f_k w_k L_(k+1)` and gives each local value
//! its adjoint: no tape of operations, no second ray tracing, and no subtraction or division of
//! radiances, so nothing cancels and a zero albedo is no special case.

use ad_core::{Dual, Float, Real, Vec2, Vec3, array};

use super::direct::{
    Aimed, Connected, Departure, Followed, Found, FoundEdge, FoundLight, Weighing, aimed_light,
    follows_edges,
};
use super::gradient::Active;
use super::local::{LocalFn, Texels, pull_back, pull_back_second, pull_back_texels};
use super::path::{Bounce, Context, HitLight, MODE, NormalsLight, Observer, SampledLight};
use crate::bsdf::{Bsdf, Component, Material, Part, Shading, TextureRef, Use};
use crate::emitter::{Emission, Emitter};
use crate::estimator::Strategy;
use crate::estimator::memory::Memory;
use crate::math::{Rgb, each};
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;

/// One vertex of a path, and the light found on the edge that leads to it.
#[derive(Clone, Copy, Debug)]
struct Vertex<P: Real> {
    /// Throughput from the camera.
    beta: Rgb<P>,
    /// Index of the shape; none at an end without surface or beyond the last scattering.
    surface: Option<Surface<P>>,
    sampled: Option<SampledLight<P>>,
    bounce: Option<Bounce<P>>,
    /// Light found here, as a range of `Recorder::lights`.
    lights: (u32, u32),
    /// What arrives along samples of the derivative of normals, as a range of `Recorder::normals`.
    normals: (u32, u32),
}

#[derive(Clone, Copy, Debug)]
struct Surface<P> {
    shape: u32,
    uv: Vec2<P>,
    wo: Vec3<P>,
}

/// Keeps the vertices of one path at a time. Reused from path to path, it stops allocating soon.
#[derive(Clone, Debug)]
pub struct Recorder<'a, P: Float> {
    /// What is differentiated.
    active: &'a Active,
    vertices: Vec<Vertex<P>>,
    lights: Vec<HitLight<P>>,
    normals: Vec<NormalsLight<P>>,
    /// Of the vertex that is pulled back.
    uses: Vec<Use<P>>,
    /// Edges that are differentiated by themselves where they found light, with the index of the first, in order.
    found: Vec<(u32, Departure<P>, FoundEdge<P>)>,
    /// That light.
    found_lights: Vec<FoundLight<P>>,
    /// Sampled lights that move, with the indices of their vertices, in order.
    aimed: Vec<(u32, Aimed<P>)>,
    /// Channels that a differentiated roulette went by, with the indices of their vertices, in order.
    survived: Vec<(u32, usize)>,
    /// Number of entries of `lights` that belong to a vertex already.
    claimed: u32,
    /// Edges of samples of the derivative of normals.
    walked: u32,
}

impl<'a, P: Float> Recorder<'a, P> {
    /// A recorder for derivatives in some parameters: light that they do not change is left out.
    pub fn of(active: &'a Active) -> Self {
        Self {
            active,
            vertices: Vec::new(),
            lights: Vec::new(),
            normals: Vec::new(),
            uses: Vec::new(),
            found: Vec::new(),
            found_lights: Vec::new(),
            aimed: Vec::new(),
            survived: Vec::new(),
            claimed: 0,
            walked: 0,
        }
    }

    /// Forgets the path.
    pub fn clear(&mut self) {
        self.vertices.clear();
        self.lights.clear();
        self.found.clear();
        self.found_lights.clear();
        self.aimed.clear();
        self.survived.clear();
        self.normals.clear();
        self.claimed = 0;
        self.walked = 0;
    }

    /// What the path cost, in edges.
    pub(super) fn work(&self) -> u32 {
        1 + self.vertices.len() as u32 + self.walked
    }

    #[inline]
    fn push(&mut self, beta: Rgb<P>, surface: Option<Surface<P>>) {
        let lights = (self.claimed, self.lights.len() as u32);
        self.claimed = lights.1;
        let normals = self.normals.len() as u32;
        self.vertices.push(Vertex {
            beta,
            surface,
            sampled: None,
            bounce: None,
            lights,
            normals: (normals, normals),
        });
    }

    /// Gives the light at the open end of the path, beyond the last vertex, a vertex of its own.
    fn close(&mut self) {
        if (self.claimed as usize) < self.lights.len() {
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
    }

    /// [`Recorder::backward`] for a path that moves with the parameters, whose radiance is `path`: emitters
    /// as recorded, materials through the whole path.
    pub(super) fn backward_moving(
        &mut self,
        &Context { scene, theta, .. }: &Context<P>,
        path: &impl LocalFn<P>,
        d_l: Rgb<P>,
        grad: &mut (impl GradSink<P> + SumSink),
    ) {
        self.close();
        for v in &self.vertices {
            let d = d_l * v.beta;
            for hit in &self.lights[v.lights.0 as usize..v.lights.1 as usize] {
                if self.active.emitter_active(hit.emitter) {
                    let e = &scene.emitters()[hit.emitter as usize];
                    e.backward(&hit.emission, d * hit.weight, grad);
                }
            }
            if let Some(s) = &v.sampled
                && self.active.emitter_active(s.emitter)
            {
                let e = &scene.emitters()[s.emitter as usize];
                e.backward(&s.emission, d * s.f * s.weight, grad);
            }
        }
        let surfaces = self.vertices.iter().filter_map(|v| v.surface.as_ref());
        let vertices = surfaces.map(|s| {
            let material = scene.shape_info(s.shape).material;
            (self.active.textures(material), s.uv)
        });
        pull_back_texels(vertices, theta, path, d_l, grad);
    }

    /// Adds the derivative of `d_l . L`, where `L` is the radiance of the recorded path and `d_l` its
    /// adjoint, to the active parameters.
    pub fn backward<S: Strategy>(
        &mut self,
        scene: &Scene,
        theta: &Theta<P>,
        d_l: Rgb<P>,
        grad: &mut (impl GradSink<P> + SumSink),
    ) {
        self.close();
        // Radiance leaving the next vertex, and light found on the way there: by directions that are
        // differentiated as the path is, and by those that are not.
        let mut l = Rgb::<P>::black();
        let (mut plain, mut followed) = (l, l);
        let mut next_found = None;
        let mut found = self.found.iter().rev().peekable();
        let mut found_lights = &self.found_lights[..];
        let mut aimed = self.aimed.iter().rev().peekable();
        let mut survived = self.survived.iter().rev().peekable();
        // Adjoints of the logarithms of survival weights beyond, together, and of throughputs that decided on them.
        let (mut decided, mut deciding) = (P::zero(), [P::zero(); 3]);
        let mut uses = std::mem::take(&mut self.uses);
        for (index, v) in self.vertices.iter().enumerate().rev() {
            let d = d_l * v.beta;
            let mut arrives = Rgb::black();
            for hit in &self.lights[v.lights.0 as usize..v.lights.1 as usize] {
                let e = &scene.emitters()[hit.emitter as usize];
                arrives += e.eval(theta, &hit.emission) * hit.weight;
                if self.active.emitter_active(hit.emitter) {
                    e.backward(&hit.emission, d * hit.weight, grad);
                }
            }
            uses.clear();
            let mut here = Rgb::black();
            let mut connected = None;
            let mut use_light = |wi, component, part, d: Rgb<P>| {
                if !d.is_black() {
                    uses.push(Use {
                        wi,
                        component,
                        part,
                        d,
                    });
                }
            };
            if let Some(s) = &v.sampled {
                here += s.f * s.le * s.weight;
                let moves = aimed.next_if(|(i, _)| *i as usize == index);
                if self.active.emitter_active(s.emitter) {
                    let e = &scene.emitters()[s.emitter as usize];
                    e.backward(&s.emission, d * s.f * s.weight, grad);
                    if S::Aim::KEEPS
                        && let (Some(surface), Some((_, aimed))) = (&v.surface, moves)
                    {
                        pull_back_motion::<P, S>(scene, theta, surface, s.emitter, aimed, d, grad);
                    }
                }
                if S::DIFFERENTIATED_WEIGHTS && s.mis_pdf > P::zero() {
                    connected = Some(Connected {
                        wi: s.wi,
                        le: s.le,
                        mis_pdf: s.mis_pdf,
                        kept: s.kept,
                        splits: s.normals_weight.is_some(),
                    });
                }
                let d = d * s.le;
                let whole = Component::Continuous;
                match s.normals_weight {
                    None if connected.is_none() => {
                        use_light(s.wi, whole, Part::All, d * s.weight);
                    }
                    None => {}
                    Some(w) => {
                        if connected.is_none() {
                            use_light(s.wi, whole, Part::Rest, d * s.weight);
                        }
                        use_light(s.wi, whole, Part::Normals, d * w);
                    }
                }
            }
            for n in &self.normals[v.normals.0 as usize..v.normals.1 as usize] {
                use_light(n.wi, Component::Continuous, Part::Normals, d_l * n.li);
            }
            if let Some(b) = &v.bounce {
                here += b.f * (l + plain + followed) * b.weight;
                let d = d * b.weight;
                let mut d_f = d * (l + plain);
                let mut chosen = d * b.f * (l + plain + followed);
                if S::ATTACHED_ROULETTE {
                    if let Some((_, channel)) = survived.next_if(|(i, _)| *i as usize == index) {
                        let own = chosen.sum() - decided;
                        decided += own;
                        deciding[*channel] -= own;
                    }
                    chosen += deciding.into();
                    d_f += array(|c| match b.f[c] == P::zero() {
                        true => P::zero(),
                        false => deciding[c] / b.f[c],
                    })
                    .into();
                }
                use_light(b.wi, b.component, b.part, d_f);
                if const { S::ATTACHED_CHOICE }
                    && let Some(surface) = &v.surface
                {
                    let index = scene.shape_info(surface.shape).material;
                    if self.active.material_active(index) {
                        let material = &scene.materials()[index as usize];
                        let f = Chosen {
                            material,
                            surface,
                            bounce: b,
                        };
                        let textures = self.active.textures(index);
                        pull_back(textures, theta, surface.uv, &f, chosen, grad);
                    }
                }
            }
            if let (Some(s), false) = (&v.surface, uses.is_empty()) {
                let material = scene.shape_info(s.shape).material;
                if self.active.material_active(material) {
                    let at = Shading {
                        theta: *theta,
                        uv: s.uv,
                    };
                    let material = &scene.materials()[material as usize];
                    material.backward(&at, s.wo, &uses, MODE, grad);
                }
            }
            // A constant: nothing of this is compiled where it never happens.
            if const { follows_edges::<S>() }
                && let Some(s) = &v.surface
                && (connected.is_some() || next_found.is_some())
            {
                let material = scene.shape_info(s.shape).material;
                if self.active.material_active(material) {
                    let vertex = (material, s.uv, s.wo);
                    let light = Followed::<P, S>::at(scene, vertex, connected, next_found);
                    let textures = self.active.textures(material);
                    pull_back(textures, theta, s.uv, &light, d, grad);
                }
            }
            let edge = found.next_if(|(first, ..)| *first >= v.lights.0);
            next_found = edge.map(|(_, from, edge)| {
                // All light at the end of an edge is followed, or none.
                let here = found_lights.len() - (v.lights.1 - v.lights.0) as usize;
                let (rest, lights) = found_lights.split_at(here);
                found_lights = rest;
                Found { from, edge, lights }
            });
            l = here;
            (plain, followed) = match next_found {
                None => (arrives, Rgb::black()),
                Some(_) => (Rgb::black(), arrives),
            };
        }
        self.uses = uses;
    }
}

/// Adds the derivative of `d . f w L_e / p` of a sampled emitter through the motion of its direction, and
/// the change of its density.
fn pull_back_motion<P: Float, S: Strategy>(
    scene: &Scene,
    theta: &Theta<P>,
    surface: &Surface<P>,
    emitter: u32,
    aimed: &Aimed<P>,
    d: Rgb<P>,
    grad: &mut (impl GradSink<P> + SumSink),
) {
    let Some(map) = scene.emitters()[emitter as usize].moving() else {
        return;
    };
    let Some(aim) = map.aim(aimed.u) else {
        return;
    };
    let at = Shading {
        theta: theta.lift(),
        uv: Vec2::lift(surface.uv),
    };
    let light: Rgb<Dual<P, 3>> = aimed_light(
        scene,
        scene.material(surface.shape),
        &at,
        Vec3::lift(surface.wo),
        aimed,
        emitter,
        &map.vary(&aim),
        &Weighing::of::<S>(),
    );
    let adjoint = each([0, 1, 2], |k: usize| {
        (Rgb::new(light.r.eps[k], light.g.eps[k], light.b.eps[k]) * d).sum()
    });
    map.pull_back(&aim, adjoint, grad, |grad, sum, d| {
        grad.add_sum(emitter, sum, d)
    });
}

impl<P: Float> Recorder<'_, P> {
    /// Adds the change of what [`Recorder::backward`] adds, when the parameters move along `direction` and
    /// `d_l` changes by `change`: nested duals over the recorded vertices, which stay where they are.
    ///
    /// # Does not handle
    /// Anything but detached samples with detached weights.
    pub(super) fn backward_second(
        &mut self,
        context: &Context<P>,
        direction: impl Fn(ParamRef, u32) -> P,
        d_l: [Rgb<P>; 2],
        grad: &mut impl GradSink<P>,
    ) {
        self.close();
        let (scene, active) = (context.scene, self.active);
        let mut texels = Texels::default();
        for v in &self.vertices {
            if let Some(s) = &v.surface {
                let material = scene.shape_info(s.shape).material;
                texels.add_all(active.textures(material), s.uv, |p| active.contains(p));
            }
            let lights = &self.lights[v.lights.0 as usize..v.lights.1 as usize];
            let hits = lights.iter().map(|l| (l.emitter, l.emission.uv));
            let sampled = v.sampled.iter().map(|s| (s.emitter, s.emission.uv));
            for (emitter, uv) in hits.chain(sampled) {
                let radiance = scene.emitters()[emitter as usize].radiance();
                texels.add(TextureRef::Rgb(radiance), uv, |p| active.contains(p));
            }
        }
        let radiance = Radiance {
            scene,
            active,
            path: self,
        };
        pull_back_second(&texels, context.theta, direction, &radiance, d_l, grad);
    }
}

/// The radiance of a recorded path as a function of the parameters: its samples, densities and weights are
/// constants.
struct Radiance<'a, P: Float> {
    scene: &'a Scene,
    active: &'a Active,
    path: &'a Recorder<'a, P>,
}

impl<P: Float> LocalFn<P> for Radiance<'_, P> {
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let emitted = |emitter: u32, emission: &Emission<P>| {
            self.scene.emitters()[emitter as usize].eval(theta, &emission.lift())
        };
        let mut l = Rgb::<R>::black();
        for (k, v) in self.path.vertices.iter().enumerate().rev() {
            let ends = k + 1 == self.path.vertices.len();
            let mut here = Rgb::black();
            if let Some(s) = &v.surface {
                let index = self.scene.shape_info(s.shape).material;
                let material = &self.scene.materials()[index as usize];
                let moves = self.active.material_active(index);
                let at = Shading {
                    theta: *theta,
                    uv: Vec2::lift(s.uv),
                };
                let f = |wi, component, f| {
                    let (wo, wi) = (Vec3::lift(s.wo), Vec3::lift(wi));
                    match moves {
                        true => material.eval_component(&at, wo, wi, component, MODE),
                        false => Rgb::lift(f),
                    }
                };
                if let Some(light) = &v.sampled {
                    let le = emitted(light.emitter, &light.emission).scale(light.weight);
                    here += f(light.wi, Component::Continuous, light.f) * le;
                }
                if let (Some(b), false) = (&v.bounce, ends) {
                    here += f(b.wi, b.component, b.f) * l.scale(b.weight);
                }
            }
            for hit in &self.path.lights[v.lights.0 as usize..v.lights.1 as usize] {
                here += emitted(hit.emitter, &hit.emission).scale(hit.weight);
            }
            l = here;
        }
        l
    }
}

/// Logarithm of one over [`Bsdf::choice_pdf`] of a bounce.
struct Chosen<'a, P: Real> {
    material: &'a Material,
    surface: &'a Surface<P>,
    bounce: &'a Bounce<P>,
}

impl<P: Float> LocalFn<P> for Chosen<'_, P> {
    const MIXES: bool = true;

    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let at = Shading {
            theta: *theta,
            uv: Vec2::lift(self.surface.uv),
        };
        let (wo, wi) = (Vec3::lift(self.surface.wo), Vec3::lift(self.bounce.wi));
        let component = self.bounce.component;
        Rgb::splat(-self.material.choice_pdf(&at, wo, wi, component, MODE).ln())
    }
}

/// Where the adjoints of sums go that moving samples of an emitter are made of
/// ([`crate::emitter::Envmap::fold`]).
pub trait SumSink {
    /// Adds `d`. Nobody calls it for strategies whose emitters stand still.
    fn add_sum(&mut self, _emitter: u32, _sum: usize, _d: f64) {}
}

impl<P: Float> Observer<P> for Recorder<'_, P> {
    #[inline]
    fn follows(&self, material: u32) -> bool {
        self.active.material_active(material)
    }

    #[inline]
    fn follows_normals(&self, material: u32) -> bool {
        self.active.roughness_active(material)
    }

    #[inline]
    fn follows_light(&self) -> bool {
        self.active.any_emitter()
    }

    #[inline]
    fn light(&mut self, _depth: u32, _beta: Rgb<P>, light: HitLight<P>) {
        self.lights.push(light);
    }

    #[inline]
    fn followed(&mut self, found: Found<P>) {
        let first = self.lights.len() - found.lights.len();
        self.found.push((first as u32, *found.from, *found.edge));
        self.found_lights.extend_from_slice(found.lights);
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
    fn aimed(&mut self, aimed: Aimed<P>) {
        let vertex = self.vertices.len().saturating_sub(1);
        self.aimed.push((vertex as u32, aimed));
    }

    #[inline]
    fn normals(&mut self, light: NormalsLight<P>) {
        self.normals.push(light);
        if let Some(v) = self.vertices.last_mut() {
            v.normals.1 += 1;
        }
    }

    #[inline]
    fn walked(&mut self, edges: u32) {
        self.walked += edges;
    }

    #[inline]
    fn survives(&mut self, channel: usize) {
        let vertex = self.vertices.len().saturating_sub(1);
        self.survived.push((vertex as u32, channel));
    }

    #[inline]
    fn bounce(&mut self, bounce: Bounce<P>) {
        if let Some(v) = self.vertices.last_mut() {
            v.bounce = Some(bounce);
        }
    }
}
