//! Paths that are recorded to be differentiated, one at a time.

use ad_core::{Dual, Float, Real, Vec2, Vec3, array};

use super::derivatives::{Adjoints, DerivativeSink, SumSink};
use super::second::pull_back_path;
use super::sweep::{Arriving, Uses, Visitor, sweep};
use super::{
    Bounce, Contribution, Interest, NormalsLight, Observer, PathRecord, Place, SampledLight,
    SeenVertex, Vertex,
};
use crate::bsdf::{Bsdf, Component, Material, Part, Shading, TransportMode};
use crate::emitter::{Emission, Emitter};
use crate::estimator::memory::Memory;
use crate::estimator::{Strategy, differentiates_edges};
use crate::integrator::active::Active;
use crate::integrator::direct::{
    Connected, EmitterDraw, Found, SeparateLight, Weighing, moving_emitter_light,
};
use crate::integrator::local::{LocalFn, pull_back_texels};
use crate::integrator::vertex::MODE;
use crate::math::{Rgb, each};
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;

/// Keeps one path at a time, as far as some parameters have a part in it.
#[derive(Clone, Debug)]
pub struct Recorder<'a, P: Float> {
    /// What is differentiated.
    pub(in crate::integrator) active: &'a Active,
    pub(in crate::integrator) path: PathRecord<P>,
}

impl<'a, P: Float> Recorder<'a, P> {
    /// A recorder for derivatives in some parameters: light that they do not change is left out.
    pub fn of(active: &'a Active) -> Self {
        Self {
            active,
            path: PathRecord::default(),
        }
    }

    /// Forgets the path.
    pub fn clear(&mut self) {
        self.path.clear();
    }

    /// What the path cost, in edges.
    pub(in crate::integrator) fn work(&self) -> u32 {
        self.path.work()
    }

    /// Adds the derivative of `d_l . L`, where `L` is the radiance of the recorded path and `d_l` its
    /// adjoint, to the active parameters. Returns that radiance, or the part of it that they change; of a particle, its part of
    /// the measurement.
    pub fn backward<S: Strategy>(
        &self,
        scene: &Scene,
        theta: &Theta<P>,
        d_l: Rgb<P>,
        grad: &mut (impl GradSink<P> + SumSink),
    ) -> Rgb<P> {
        let mut sink = Adjoints { theta, grad };
        let mut visitor = Backward::<P, S, _>::new(scene, theta, self.active, d_l, &mut sink);
        sweep(&self.path, &mut visitor)
    }

    /// [`Recorder::backward`] for a path that moves with the parameters, whose radiance is `path`: emitters
    /// as recorded, materials through the whole path.
    pub(in crate::integrator) fn backward_moving(
        &self,
        scene: &Scene,
        theta: &Theta<P>,
        path: &impl LocalFn<P>,
        d_l: Rgb<P>,
        grad: &mut (impl GradSink<P> + SumSink),
    ) {
        let vertices = self.path.vertices();
        for (k, vertex) in vertices.iter().enumerate() {
            for contribution in self.path.contributions(k) {
                let (emitter, emission, beta) = match contribution {
                    Contribution::Met(met) => (met.emitter, met.emission, met.beta * met.weight),
                    Contribution::Sampled(s) => {
                        (s.emitter, s.emission, vertex.beta * s.f * s.weight)
                    }
                    _ => continue,
                };
                if self.active.emitter_active(emitter) {
                    let e = &scene.emitters()[emitter as usize];
                    e.backward(theta, &emission, d_l * beta, grad);
                }
            }
        }
        let places = vertices.iter().filter_map(|v| v.place.as_ref());
        let read = places.map(|p| {
            let material = scene.shape_info(p.shape).material;
            (self.active.textures(material), p.si.uv)
        });
        pull_back_texels(read, theta, path, d_l, grad);
    }

    /// Adds the change of what [`Recorder::backward`] adds, when the parameters move along `direction` and
    /// `d_l` changes: both are in `d_l`.
    pub(in crate::integrator) fn backward_second(
        &self,
        scene: &Scene,
        theta: &Theta<P>,
        direction: impl Fn(ParamRef, u32) -> P,
        d_l: [Rgb<P>; 2],
        grad: &mut impl GradSink<P>,
    ) {
        pull_back_path(scene, theta, self.active, &self.path, direction, d_l, grad);
    }
}

/// The adjoint of a path, value by value.
struct Backward<'a, P: Float, S, E> {
    scene: &'a Scene,
    theta: &'a Theta<'a, P>,
    active: &'a Active,
    /// Adjoint of the radiance.
    d_l: Rgb<P>,
    sink: &'a mut E,
    /// Of the vertex that the sweep is at, in one mode.
    uses: Uses<P>,
    mode: TransportMode,
    /// The sampled light there, if its weight is differentiated.
    connected: Option<Connected<P>>,
    /// Adjoints of the logarithms of survival weights beyond, together, and of throughputs that decided on them.
    decided: P,
    deciding: [P; 3],
    strategy: std::marker::PhantomData<S>,
}

impl<'a, P: Float, S: Strategy, E: DerivativeSink<P>> Backward<'a, P, S, E> {
    /// For a path whose radiance has the adjoint `d_l`.
    fn new(
        scene: &'a Scene,
        theta: &'a Theta<'a, P>,
        active: &'a Active,
        d_l: Rgb<P>,
        sink: &'a mut E,
    ) -> Self {
        Self {
            scene,
            theta,
            active,
            d_l,
            sink,
            uses: Uses::default(),
            mode: MODE,
            connected: None,
            decided: P::zero(),
            deciding: [P::zero(); 3],
            strategy: std::marker::PhantomData,
        }
    }

    /// The material of a place, if it is differentiated.
    #[inline(always)]
    fn material(&self, place: &Place<P>) -> Option<(u32, &'a Material)> {
        let index = self.scene.shape_info(place.shape).material;
        let active = self.active.differentiates(index);
        active.then(|| (index, &*self.scene.materials()[index as usize]))
    }

    /// Hands over the values used so far.
    fn flush(&mut self, place: &Place<P>) {
        if !self.uses.0.is_empty()
            && let Some((_, material)) = self.material(place)
        {
            let (uv, uses) = (place.si.uv, &self.uses.0);
            self.sink.vertex(0, material, uv, place.wo, uses, self.mode);
        }
        self.uses.0.clear();
    }

    /// What is used next is used in this mode.
    fn enter(&mut self, mode: TransportMode, place: &Place<P>) {
        if mode != self.mode {
            self.flush(place);
            self.mode = mode;
        }
    }

    /// The adjoint of `f` through the survival probabilities that it decided on, and that of the logarithm of the density
    /// of `bounce`, which is what it brings.
    fn decisions(&mut self, bounce: &Bounce<P>, brings: Rgb<P>) -> (Rgb<P>, Rgb<P>) {
        let mut chosen = brings;
        if !S::ATTACHED_ROULETTE {
            return (Rgb::black(), chosen);
        }
        if let Some(channel) = bounce.deciding {
            let own = chosen.sum() - self.decided;
            self.decided += own;
            self.deciding[channel] -= own;
        }
        chosen += self.deciding.into();
        let through = array(|c| {
            if bounce.f[c] == P::zero() {
                P::zero()
            } else {
                self.deciding[c] / bounce.f[c]
            }
        });
        (through.into(), chosen)
    }
}

impl<P: Float, S: Strategy, E: DerivativeSink<P>> Visitor<P> for Backward<'_, P, S, E> {
    type Scalar = P;

    #[inline(always)]
    fn emitted(&mut self, emitter: u32, emission: &Emission<P>, beta: Rgb<P>) -> Rgb<P> {
        let e = &self.scene.emitters()[emitter as usize];
        if self.active.emitter_active(emitter) {
            self.sink.emission(0, e, emission, self.d_l * beta);
        }
        e.eval(self.theta, emission)
    }

    #[inline(always)]
    fn value(
        &mut self,
        _place: &Place<P>,
        _wi: Vec3<P>,
        _component: Component,
        f: Rgb<P>,
    ) -> Rgb<P> {
        f
    }

    #[inline(always)]
    fn sampled(&mut self, vertex: &Vertex<P>, place: &Place<P>, s: &SampledLight<P>) {
        let d = self.d_l * vertex.beta;
        if S::EmitterMotion::KEEPS
            && self.active.emitter_active(s.emitter)
            && let Some(draw) = &s.draw
        {
            pull_back_motion::<P, S>(self.scene, self.theta, place, draw, d, self.sink);
        }
        if S::DIFFERENTIATED_WEIGHTS && s.mis_pdf > P::zero() {
            self.connected = Some(Connected {
                wi: s.wi,
                le: s.le,
                mis_pdf: s.mis_pdf,
                kept: s.kept,
                splits: s.normals_weight.is_some(),
            });
        }
        self.enter(MODE, place);
        let normals = s.normals_weight.map(|w| s.le * w);
        let weighed = self.connected.is_some();
        self.uses
            .sampled(s.wi, s.le * s.weight, normals, weighed, d);
    }

    #[inline(always)]
    fn normals(&mut self, place: &Place<P>, n: &NormalsLight<P>) {
        self.enter(n.mode, place);
        self.uses
            .push(n.wi, Component::Continuous, Part::Normals, self.d_l * n.li);
    }

    #[inline(always)]
    fn scattered(
        &mut self,
        vertex: &Vertex<P>,
        place: &Place<P>,
        b: &Bounce<P>,
        arriving: &Arriving<P>,
    ) {
        self.enter(b.mode, place);
        let d = self.d_l * vertex.beta * b.weight;
        let (through, chosen) = self.decisions(b, d * b.f * arriving.all());
        self.uses
            .push(b.wi, b.component, b.part, d * arriving.along() + through);
        if const { S::ATTACHED_CHOICE }
            && let Some((index, material)) = self.material(place)
        {
            let f = Chosen {
                material,
                place,
                bounce: b,
            };
            let textures = self.active.textures(index);
            self.sink.light(0, textures, place.si.uv, &f, chosen);
        }
    }

    #[inline(always)]
    fn seen(&mut self, vertex: &Vertex<P>, place: &Place<P>, s: &SeenVertex<P>) {
        self.enter(s.mode, place);
        let d = self.d_l * vertex.beta * s.importance;
        self.uses.push(s.wi, Component::Continuous, Part::All, d);
    }

    #[inline(always)]
    fn leave(&mut self, vertex: &Vertex<P>, place: &Place<P>, found: Option<Found<P>>) {
        self.flush(place);
        // A constant: nothing of this is compiled where it never happens.
        if const { differentiates_edges::<S>() } {
            let connected = self.connected.take();
            if (connected.is_some() || found.is_some())
                && let Some((index, _)) = self.material(place)
            {
                let at = (index, place.si.uv, place.wo);
                let light = SeparateLight::<P, S>::at(self.scene, at, connected, found);
                let textures = self.active.textures(index);
                let d = self.d_l * vertex.beta;
                self.sink.light(0, textures, place.si.uv, &light, d);
            }
        }
    }
}

/// Adds the derivative of `d . f w L_e / p` of a sampled emitter through the motion of its direction, and
/// the change of its density.
fn pull_back_motion<P: Float, S: Strategy>(
    scene: &Scene,
    theta: &Theta<P>,
    place: &Place<P>,
    draw: &EmitterDraw<P>,
    d: Rgb<P>,
    sink: &mut impl DerivativeSink<P>,
) {
    let Some(map) = scene.emitters()[draw.emitter as usize].moving() else {
        return;
    };
    let Some(drawn) = map.moving_draw(draw.u) else {
        return;
    };
    let at = Shading::new(theta.lift(), Vec2::lift(place.si.uv));
    let light: Rgb<Dual<P, 3>> = moving_emitter_light(
        scene,
        scene.material(place.shape),
        &at,
        Vec3::lift(place.wo),
        draw,
        &map.vary(&drawn),
        &Weighing::of::<S>(),
    );
    let adjoint = each([0, 1, 2], |k: usize| {
        (Rgb::new(light.r.eps[k], light.g.eps[k], light.b.eps[k]) * d).sum()
    });
    sink.moved(draw.emitter, map, &drawn, adjoint);
}

/// Logarithm of one over [`Bsdf::choice_pdf`] of a bounce.
struct Chosen<'a, P: Real> {
    material: &'a Material,
    place: &'a Place<P>,
    bounce: &'a Bounce<P>,
}

impl<P: Float> LocalFn<P> for Chosen<'_, P> {
    const MIXES: bool = true;

    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let at = Shading::new(*theta, Vec2::lift(self.place.si.uv));
        let (wo, wi) = (Vec3::lift(self.place.wo), Vec3::lift(self.bounce.wi));
        let component = self.bounce.component;
        Rgb::splat(-self.material.choice_pdf(&at, wo, wi, component, MODE).ln())
    }
}

impl<P: Float> Interest for Recorder<'_, P> {
    #[inline]
    fn differentiates(&self, material: u32) -> bool {
        self.active.differentiates(material)
    }

    #[inline]
    fn differentiates_roughness(&self, material: u32) -> bool {
        self.active.differentiates_roughness(material)
    }

    #[inline]
    fn differentiates_emission(&self) -> bool {
        self.active.differentiates_emission()
    }
}

impl<P: Float> Observer<P> for Recorder<'_, P> {
    #[inline]
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.path.vertex(beta, place);
    }

    #[inline]
    fn contribution(&mut self, contribution: Contribution<P>) {
        self.path.contribution(contribution);
    }

    #[inline]
    fn branch(&mut self, edges: u32) {
        self.path.branch(edges);
    }
}
