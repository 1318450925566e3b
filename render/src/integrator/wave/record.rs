//! What a wave of paths keeps, and its derivatives: [`super::super::record`], field by field.

use ad_core::{Float, Vec2, Vec3};

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, whole};
use super::state::Paths;
use super::{Log, Wave};
use crate::bsdf::{Component, Part};
use crate::emitter::Emission;
use crate::estimator::{Edges, Strategy, differentiates_edges};
use crate::integrator::active::Active;
use crate::integrator::direct::{
    Connected, Departure, Found, FoundEdge, FoundLight, SeparateLight,
};
use crate::integrator::record::derivatives::DerivativeSink;
use crate::integrator::record::sweep::Uses;
use crate::integrator::vertex::MODE;
use crate::integrator::vertex::interest::Interest;
use crate::integrator::vertex::light::{Met, weighs};
use crate::integrator::vertex::part_of;
use crate::math::Rgb;
use crate::scene::Scene;

/// [`DerivativeSink`]s that take the albedos of many plain vertices at once.
pub trait LayerSink<P: Float>: DerivativeSink<P> {
    /// Albedos of the plain vertices of a layer, where `wanted` is not zero.
    fn albedos(&mut self, scene: &Scene, layer: &Layer<P>, wanted: &Lane<u32>, d: &Lanes<P>);
    /// Called after the last layer.
    fn finish(&mut self) {}
}

/// The vertices of all paths that have so many edges. At a plain one, the radiance that leaves is its albedo times
/// what arrives: `albedo (direct + bounce L)`.
#[derive(Clone, Debug)]
pub struct Layer<P> {
    pub n: usize,
    /// Number of each path.
    pub id: Lane<u32>,
    /// Its place in the layer before.
    parent: Lane<u32>,
    pub material: Lane<u32>,
    /// Whether it is the back of a material that is another one there.
    pub back: Lane<u32>,
    /// Whether that is differentiated.
    differentiated: Lane<u32>,
    /// Whether there is a vertex that is not in `others`.
    plain: Lane<u32>,
    u: Lane<P>,
    v: Lane<P>,
    /// Throughput from the camera times the adjoint of the path's radiance.
    d: Lanes<P>,
    albedo: Lanes<P>,
    /// Of sampled light.
    direct: Lanes<P>,
    /// One over the density of the scattered direction times the value of a white surface; zero where a path ends.
    bounce: Lane<P>,
    /// Vertices that are not plain, by their places.
    others: Vec<(usize, Other<P>)>,
    /// Light that was hit at the end of the edges from here, by the places that they left.
    hits: Vec<(u32, Rgb<P>)>,
    /// Vertices whose light is differentiated by itself, in the order of their places.
    separate: Vec<SeparateVertex<P>>,
    /// One more than their index there; zero where there is none. All zero where no light is.
    entry: Lane<u32>,
    /// Edges from those that found light, by the places.
    found: Vec<FoundFrom<P>>,
    /// That light, as in `hits`.
    found_light: Vec<(u32, Rgb<P>)>,
    /// Where it comes from, in the same order.
    lights: Vec<FoundLight<P>>,
}

/// A vertex whose light is differentiated by itself: see [`super::super::direct`].
#[derive(Clone, Copy, Debug)]
struct SeparateVertex<P> {
    place: u32,
    wo: Vec3<P>,
    /// That of the scattered direction, if it is one to follow.
    departure: Option<Departure<P>>,
    /// The sampled light, if its weight is differentiated.
    connected: Option<Connected<P>>,
}

/// An edge that found light.
#[derive(Clone, Copy, Debug)]
struct FoundFrom<P> {
    /// The place that it left.
    place: u32,
    edge: FoundEdge<P>,
    /// How many lights all edges up to this one found.
    lights: u32,
}

/// A vertex of any material.
#[derive(Clone, Copy, Debug)]
struct Other<P> {
    wo: Vec3<P>,
    /// Direction of sampled light, value of the BSDF, and radiance times weight.
    light: Option<(Vec3<P>, Rgb<P>, Rgb<P>)>,
    /// Scattered direction, value of the BSDF, and one over density and probability of surviving.
    bounce: Option<(Vec3<P>, Component, Rgb<P>, P)>,
    /// Whether the change of normals has samples of its own.
    splits: bool,
    /// Light for that: radiance times weight of the sampled light.
    for_normals: Rgb<P>,
    /// Its samples, as a range of [`Record::normals`].
    normals: (u32, u32),
}

/// Light of an emitter that is differentiated.
#[derive(Clone, Copy, Debug)]
struct Emitted<P> {
    id: u32,
    emitter: u32,
    emission: Emission<P>,
    /// Adjoint of the radiance.
    d: Rgb<P>,
}

/// Keeps a wave of paths, and differentiates their radiance.
pub struct Record<'a, P: Float> {
    scene: &'a Scene,
    active: &'a Active,
    /// Whether light is looked for that no derivative needs.
    image: bool,
    /// What light on edges is differentiated by itself.
    edges: Edges,
    /// Whether the weights of sampled lights are differentiated.
    weighs: bool,
    /// Adjoints of the radiance of the paths.
    d: Lanes<P>,
    /// By number of edges; the first is that of the camera, where nothing happens but hits.
    layers: Vec<Box<Layer<P>>>,
    used: usize,
    emitted: Vec<Emitted<P>>,
    /// Samples of the change of normals: see [`Log::normals`].
    normals: Vec<(Vec3<P>, Rgb<P>)>,
}

impl<P: Float> Layer<P> {
    fn new() -> Box<Self> {
        Box::new(Self {
            n: 0,
            id: Lane::zero(),
            parent: Lane::zero(),
            material: Lane::zero(),
            back: Lane::zero(),
            differentiated: Lane::zero(),
            plain: Lane::zero(),
            u: Lane::zero(),
            v: Lane::zero(),
            d: Lanes::zero(),
            albedo: Lanes::zero(),
            direct: Lanes::zero(),
            bounce: Lane::zero(),
            others: Vec::new(),
            hits: Vec::new(),
            separate: Vec::new(),
            entry: Lane::zero(),
            found: Vec::new(),
            found_light: Vec::new(),
            lights: Vec::new(),
        })
    }
}

impl<'a, P: Float> Record<'a, P> {
    /// For derivatives in some parameters, as strategy `S` estimates them. `image`: whether all radiance is wanted,
    /// and not only what they change.
    pub fn of<S: Strategy>(active: &'a Active, scene: &'a Scene, image: bool) -> Self {
        Self {
            scene,
            active,
            image,
            edges: Edges::of::<S>(),
            weighs: S::DIFFERENTIATED_WEIGHTS && S::COUNTS_HITS,
            d: Lanes::zero(),
            layers: vec![Layer::new()],
            used: 1,
            emitted: Vec::new(),
            normals: Vec::new(),
        }
    }

    /// Forgets all paths. `adjoints` are those of the radiance of the next.
    pub fn start(&mut self, adjoints: impl Iterator<Item = Rgb<P>>) {
        for (i, d) in adjoints.take(WAVE_SIZE).enumerate() {
            self.d.put_rgb(i, d);
        }
        self.used = 1;
        self.layers[0].hits.clear();
        self.emitted.clear();
    }

    /// Hands `sink` the derivatives of the radiances `l` times their adjoints, for the paths whose radiance is finite. The
    /// strategy is that of [`Record::of`].
    pub fn differentiate<S: Strategy>(&mut self, l: &[Rgb<P>], sink: &mut impl LayerSink<P>) {
        let mut counts = Lane::<u32>::zero();
        for (counts, l) in counts.iter_mut().zip(l) {
            *counts = u32::from(l.is_finite());
        }
        self.differentiate_vertices(&counts, sink);
        if const { differentiates_edges::<S>() } {
            self.differentiate_separately::<S>(&counts, sink);
        }
        sink.finish();
    }

    /// [`Record::differentiate`] of light that strategy `S` differentiates by itself, of the paths that count.
    #[inline(never)]
    fn differentiate_separately<S: Strategy>(
        &mut self,
        counts: &Lane<u32>,
        sink: &mut impl LayerSink<P>,
    ) {
        let (scene, active) = (self.scene, self.active);
        for layer in &mut self.layers[1..self.used] {
            let Layer {
                id,
                material,
                u,
                v,
                d,
                separate,
                entry,
                found,
                lights,
                ..
            } = &mut **layer;
            let mut pull = |at: &SeparateVertex<P>, connected, found: Option<Found<P>>| {
                let i = at.place as usize % WAVE_SIZE;
                let id = id[i] as usize % WAVE_SIZE;
                if counts[id] != 0 {
                    let vertex = (material[i], Vec2::new(u[i], v[i]), at.wo);
                    let light = SeparateLight::<P, S>::at(scene, vertex, connected, found);
                    sink.light(id, active.textures(material[i]), vertex.1, &light, d.rgb(i));
                }
            };
            // Light that was sampled with light that was found, so that both read the material once.
            let mut first = 0;
            for found in found.iter() {
                let lights = &lights[first..found.lights as usize];
                first += lights.len();
                if let Some(k) = entry[found.place as usize % WAVE_SIZE].checked_sub(1) {
                    let connected = separate[k as usize].connected.take();
                    let (at, edge) = (&separate[k as usize], &found.edge);
                    let from = at.departure.as_ref();
                    pull(at, connected, from.map(|from| Found { from, edge, lights }));
                }
            }
            for at in separate.iter().filter(|f| f.connected.is_some()) {
                pull(at, at.connected, None);
            }
        }
    }

    /// [`Record::differentiate`] of everything else.
    fn differentiate_vertices(&mut self, counts: &Lane<u32>, sink: &mut impl LayerSink<P>) {
        let scene = self.scene;
        for e in &self.emitted {
            let id = e.id as usize % WAVE_SIZE;
            if counts[id] != 0 {
                let emitter = &scene.emitters()[e.emitter as usize];
                sink.emission(id, emitter, &e.emission, e.d);
            }
        }
        // Radiance that arrives along the edges from a layer, and that leaves it.
        let mut arrives = Lanes::zero();
        let mut leaves = Lanes::zero();
        for layer in self.layers[1..self.used].iter().rev() {
            for (at, light) in &layer.hits {
                arrives.add_rgb(*at as usize % WAVE_SIZE, *light);
            }
            // The adjoint of the albedo.
            let mut d = Lanes::zero();
            for i in 0..whole(layer.n) {
                let all = layer.direct.rgb(i) + arrives.rgb(i) * layer.bounce[i];
                leaves.put_rgb(i, layer.albedo.rgb(i) * all);
                d.put_rgb(i, layer.d.rgb(i) * all);
            }
            let mut by_themselves = Lanes::zero();
            for (at, light) in &layer.found_light {
                by_themselves.add_rgb(*at as usize % WAVE_SIZE, *light);
            }
            let mut separate = layer.separate.iter().peekable();
            for &(i, ref other) in &layer.others {
                let separate = separate.next_if(|f| f.place as usize == i);
                let weighed = separate.is_some_and(|f| f.connected.is_some());
                let index = layer.material[i];
                let d = layer.d.rgb(i);
                let mut l = Rgb::black();
                let mut uses = Uses::default();
                if let Some((wi, f, light)) = other.light {
                    l += f * light;
                    let normals = other.splits.then_some(other.for_normals);
                    uses.sampled(wi, light, normals, weighed, d);
                }
                let (first, end) = other.normals;
                for &(wi, li) in &self.normals[first as usize..end as usize] {
                    let d = self.d.rgb(layer.id[i] as usize % WAVE_SIZE) * li;
                    uses.push(wi, Component::Continuous, Part::Normals, d);
                }
                if let Some((wi, component, f, weight)) = other.bounce {
                    let light = arrives.rgb(i) * weight;
                    l += f * (light + by_themselves.rgb(i) * weight);
                    let part = part_of(component, other.splits);
                    uses.push(wi, component, part, d * light);
                }
                leaves.put_rgb(i, l);
                let id = layer.id[i] as usize % WAVE_SIZE;
                if layer.differentiated[i] != 0 && counts[id] != 0 && !uses.0.is_empty() {
                    let material = &scene.materials()[index as usize];
                    sink.vertex(id, material, layer.uv(i), other.wo, &uses.0, MODE);
                }
            }
            let mut wanted = Lane::<u32>::zero();
            for i in 0..whole(layer.n) {
                wanted[i] = u32::from(i < layer.n)
                    & layer.plain[i]
                    & layer.differentiated[i]
                    & counts[layer.id[i] as usize % WAVE_SIZE];
            }
            sink.albedos(scene, layer, &wanted, &d);
            arrives = Lanes::zero();
            for i in 0..layer.n {
                arrives.add_rgb(layer.parent[i] as usize % WAVE_SIZE, leaves.rgb(i));
            }
        }
    }
}

impl<P: Float> Layer<P> {
    #[inline(always)]
    pub fn uv(&self, i: usize) -> Vec2<P> {
        Vec2::new(self.u[i], self.v[i])
    }
}

impl<P: Float> Interest for Record<'_, P> {
    #[inline(always)]
    fn differentiates(&self, material: u32) -> bool {
        self.active.differentiates(material)
    }

    #[inline(always)]
    fn differentiates_roughness(&self, material: u32) -> bool {
        self.active.differentiates_roughness(material)
    }

    #[inline(always)]
    fn differentiates_emission(&self) -> bool {
        self.image || self.active.differentiates_emission()
    }
}

impl<P: Float> Log<P> for Record<'_, P> {
    fn departure(&self, paths: &Paths<P>, i: usize) -> Option<&Departure<P>> {
        let layer = &self.layers[self.used - 1];
        let entry = layer.entry[paths.slot[i] as usize % WAVE_SIZE] as usize;
        layer.separate[entry.checked_sub(1)?].departure.as_ref()
    }

    fn hit(
        &mut self,
        paths: &Paths<P>,
        i: usize,
        emitter: u32,
        light: &Met<P>,
        le: Rgb<P>,
        apart: Option<P>,
    ) {
        let layer = &mut self.layers[self.used - 1];
        let hit = (paths.slot[i], le * light.weight);
        match apart {
            None => layer.hits.push(hit),
            Some(share) => {
                layer.found_light.push(hit);
                layer.lights.push(FoundLight {
                    emitter,
                    emission: light.emission,
                    share,
                });
            }
        }
        if self.active.emitter_active(emitter) {
            let id = paths.id[i];
            let d = self.d.rgb(id as usize % WAVE_SIZE) * paths.beta.rgb(i) * light.weight;
            self.emitted.push(Emitted {
                id,
                emitter,
                emission: light.emission,
                d,
            });
        }
    }

    fn found(&mut self, paths: &Paths<P>, i: usize, edge: FoundEdge<P>) {
        let layer = &mut self.layers[self.used - 1];
        layer.found.push(FoundFrom {
            place: paths.slot[i],
            edge,
            lights: layer.lights.len() as u32,
        });
    }

    fn normals(&mut self, samples: impl Iterator<Item = (Vec3<P>, Rgb<P>)>) {
        self.normals.clear();
        self.normals.extend(samples);
    }

    #[inline(never)]
    fn layer<X>(&mut self, wave: &mut Wave<P, X>) {
        if self.used == self.layers.len() {
            self.layers.push(Layer::new());
        }
        let layer = &mut *self.layers[self.used];
        self.used += 1;
        let n = wave.n;
        let (paths, at, lights, bounces) = (&mut wave.paths, &wave.at, &wave.lights, &wave.bounces);
        layer.n = n;
        layer.others.clear();
        layer.hits.clear();
        layer.separate.clear();
        if self.edges != Edges::None {
            layer.entry = Lane::zero();
        }
        layer.found.clear();
        layer.found_light.clear();
        layer.lights.clear();
        for i in 0..whole(n) {
            layer.id[i] = paths.id[i];
            layer.parent[i] = paths.slot[i];
            paths.slot[i] = i as u32;
            layer.material[i] = at.material[i];
            layer.back[i] = at.back[i];
            layer.differentiated[i] = at.differentiated[i];
            layer.plain[i] = at.plain[i] & at.there[i];
            layer.u[i] = at.u[i];
            layer.v[i] = at.v[i];
            layer.albedo.put_rgb(i, at.albedo.rgb(i));
            let seen = lights.shadow_t[i] > P::zero();
            let direct = lights.le.rgb(i) * (lights.weight[i] * lights.white[i]);
            let direct = direct.map(|c| P::select(seen, c, P::zero()));
            layer.direct.put_rgb(i, direct);
            let bounce = bounces.white[i] * bounces.weight[i] * bounces.inverse_survival[i];
            layer.bounce[i] = P::select(bounces.continues[i] != 0, bounce, P::zero());
        }
        for i in 0..n {
            let d = self.d.rgb(paths.id[i] as usize % WAVE_SIZE) * paths.beta.rgb(i);
            layer.d.put_rgb(i, d);
        }
        let mut first = wave.before;
        for i in 0..n {
            if at.plain[i] == 0 {
                let light = (lights.shadow_t[i] > P::zero()).then(|| {
                    let light = lights.le.rgb(i) * lights.weight[i];
                    (lights.wi.vec(i), lights.f.rgb(i), light)
                });
                let bounce = (bounces.continues[i] != 0).then(|| {
                    let weight = bounces.weight[i] * bounces.inverse_survival[i];
                    let wi = bounces.wi.vec(i);
                    (wi, wave.components[i], bounces.f.rgb(i), weight)
                });
                let splits = wave.splits && at.splits[i] != 0;
                let branches = if splits { &wave.branches[first..] } else { &[] };
                let end = first + branches.iter().take_while(|b| b.at == i).count();
                let wo = wave.wo.vec(i);
                if self.edges != Edges::None && at.differentiated[i] != 0 {
                    let e = || &self.scene.emitters()[lights.emitter[i] as usize];
                    let weighed = light.is_some() && weighs(self.weighs, e());
                    let connected = weighed.then(|| Connected {
                        wi: lights.wi.vec(i),
                        le: lights.le.rgb(i),
                        mis_pdf: lights.pdf[i],
                        kept: lights.kept[i],
                        splits,
                    });
                    let component = wave.components[i];
                    let goes_on = bounce.is_some() && self.edges.contain(component);
                    let [.., a, b, c, _] = &wave.numbers;
                    let departure = goes_on.then(|| Departure {
                        material: at.material[i],
                        exit: at.exit(i),
                        si: at.interaction(i),
                        wo,
                        u: [a[i], b[i], c[i]],
                        inverse_survival: bounces.inverse_survival[i],
                        part: part_of(component, splits),
                    });
                    if connected.is_some() || departure.is_some() {
                        layer.entry[i] = layer.separate.len() as u32 + 1;
                        layer.separate.push(SeparateVertex {
                            place: i as u32,
                            wo,
                            departure,
                            connected,
                        });
                    }
                }
                let other = Other {
                    wo,
                    light,
                    bounce,
                    splits,
                    for_normals: lights.le.rgb(i) * lights.normals_weight[i],
                    normals: (first as u32, end as u32),
                };
                first = end;
                layer.others.push((i, other));
            }
        }
        if self.active.differentiates_emission() {
            for i in 0..n {
                let emitter = lights.emitter[i];
                if lights.shadow_t[i] > P::zero() && self.active.emitter_active(emitter) {
                    self.emitted.push(Emitted {
                        id: paths.id[i],
                        emitter,
                        emission: lights.emission(i),
                        d: layer.d.rgb(i) * lights.f.rgb(i) * lights.weight[i],
                    });
                }
            }
        }
    }
}
