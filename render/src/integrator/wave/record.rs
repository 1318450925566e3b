//! What a wave of paths keeps, and its derivatives: [`super::super::record`], field by field.

use ad_core::{Float, Vec2, Vec3};

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use super::state::Paths;
use super::{Log, Wave};
use crate::bsdf::{Component, Material, Part, Use};
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
    /// Values of a material at a vertex that is not plain; `index` is that of the material.
    fn other(
        &mut self,
        (id, _index, material): (usize, u32, &Material),
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
    ) {
        self.vertex(id, material, uv, wo, uses, MODE);
    }
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
    /// Vertices that are not plain, once there were any, and whether there are.
    others: Option<Box<Others<P>>>,
    any_other: bool,
    /// What their scattered directions belong to.
    components: [Component; WAVE_SIZE],
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

lanes! {
    /// Vertices of any material, by their places. They are without sampled light, or scattered direction, where that is worth
    /// nothing.
    Others {
        /// Whether there is one.
        there: Lane<u32>,
        wo: Lanes<P>,
        /// Whether light was sampled and seen.
        lit: Lane<u32>,
        /// Direction of sampled light, value of the BSDF, and radiance times weight.
        light_wi: Lanes<P>,
        light_f: Lanes<P>,
        light: Lanes<P>,
        /// Whether the path goes on.
        goes_on: Lane<u32>,
        /// Scattered direction, value of the BSDF, and one over density and probability of surviving.
        bounce_wi: Lanes<P>,
        bounce_f: Lanes<P>,
        bounce: Lane<P>,
        /// Whether the change of normals has samples of its own.
        splits: Lane<u32>,
        /// Light for that: radiance times weight of the sampled light.
        for_normals: Lanes<P>,
        /// Its samples, as a range of [`Record::normals`].
        normals_begin: Lane<u32>,
        normals_end: Lane<u32>,
    }
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
            others: None,
            any_other: false,
            components: [Component::Continuous; WAVE_SIZE],
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
            if let Some(others) = layer.others.as_ref().filter(|_| layer.any_other) {
                others.reflect(layer.n, [&arrives, &by_themselves], &mut leaves);
                let (places, n) = layer.differentiated_others(others, counts);
                for &i in &places[..n] {
                    self.differentiate_other(layer, others, i, arrives.rgb(i), sink);
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

impl<P: Float> Record<'_, P> {
    /// Hands `sink` the derivatives at vertex `i` of a layer, which is not plain; the light `arrives` along the scattered
    /// direction.
    #[inline(always)]
    fn differentiate_other(
        &self,
        layer: &Layer<P>,
        at: &Others<P>,
        i: usize,
        arrives: Rgb<P>,
        sink: &mut impl LayerSink<P>,
    ) {
        let id = layer.id[i] as usize % WAVE_SIZE;
        let d = layer.d.rgb(i);
        let splits = at.splits[i] != 0;
        let mut uses = Uses::default();
        if at.lit[i] != 0 {
            let normals = splits.then(|| at.for_normals.rgb(i));
            let separate = (layer.entry[i].checked_sub(1)).map(|k| &layer.separate[k as usize]);
            let weighed = separate.is_some_and(|f| f.connected.is_some());
            uses.sampled(at.light_wi.vec(i), at.light.rgb(i), normals, weighed, d);
        }
        let normals = at.normals_begin[i] as usize..at.normals_end[i] as usize;
        for &(wi, li) in &self.normals[normals] {
            let d = self.d.rgb(id) * li;
            uses.push(wi, Component::Continuous, Part::Normals, d);
        }
        if at.goes_on[i] != 0 {
            let component = layer.components[i];
            let light = arrives * at.bounce[i];
            let part = part_of(component, splits);
            uses.push(at.bounce_wi.vec(i), component, part, d * light);
        }
        if !uses.0.is_empty() {
            let index = layer.material[i];
            let material = &self.scene.materials()[index as usize];
            let (uv, wo) = (layer.uv(i), at.wo.vec(i));
            sink.other((id, index, material), uv, wo, &uses.0);
        }
    }
}

impl<P: Float> Record<'_, P> {
    /// Keeps what light of the last layer is differentiated by itself.
    #[inline(never)]
    fn keep_separate<X>(&mut self, wave: &Wave<P, X>) {
        let (at, lights, bounces) = (&wave.at, &wave.lights, &wave.bounces);
        let (scene, edges) = (self.scene, self.edges);
        let layer = &mut *self.layers[self.used - 1];
        for i in (0..wave.n).filter(|&i| at.plain[i] == 0 && at.differentiated[i] != 0) {
            let splits = wave.splits && at.splits[i] != 0;
            let wo = wave.wo.vec(i);
            let weighed = lights.shadow_t[i] > P::zero()
                && weighs(self.weighs, &scene.emitters()[lights.emitter[i] as usize]);
            let connected = weighed.then(|| Connected {
                wi: lights.wi.vec(i),
                le: lights.le.rgb(i),
                mis_pdf: lights.pdf[i],
                kept: lights.kept[i],
                splits,
            });
            let component = wave.components[i];
            let goes_on = bounces.continues[i] != 0 && edges.contain(component);
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
    }
}

impl<P: Float> Others<P> {
    /// The radiance that leaves the first `n` places, where there is one of these vertices: made of what arrives along
    /// scattered directions, the second part of which is differentiated by itself.
    #[inline(never)]
    fn reflect(&self, n: usize, [arrives, apart]: [&Lanes<P>; 2], leaves: &mut Lanes<P>) {
        for i in 0..whole(n) {
            let (lit, goes_on) = (self.lit[i] != 0, self.goes_on[i] != 0);
            let weight = self.bounce[i];
            let direct = self.light_f.rgb(i) * self.light.rgb(i);
            let all = arrives.rgb(i) * weight + apart.rgb(i) * weight;
            let bounced = self.bounce_f.rgb(i) * all;
            let l = Rgb::select(lit, direct, Rgb::black())
                + Rgb::select(goes_on, bounced, Rgb::black());
            leaves.put_rgb(i, Rgb::select(self.there[i] != 0, l, leaves.rgb(i)));
        }
    }
}

impl<P: Float> Layer<P> {
    /// Keeps the vertices that are not plain.
    #[inline(never)]
    fn keep_others<X>(&mut self, wave: &Wave<P, X>) {
        let (at, lights, bounces) = (&wave.at, &wave.lights, &wave.bounces);
        let others = &mut **(self.others).get_or_insert_with(|| Box::new(Others::zero()));
        self.any_other = true;
        for i in 0..whole(wave.n) {
            others.there[i] = u32::from(at.plain[i] == 0);
            others.wo.put_vec(i, wave.wo.vec(i));
            others.lit[i] = u32::from(lights.shadow_t[i] > P::zero());
            others.light_wi.put_vec(i, lights.wi.vec(i));
            others.light_f.put_rgb(i, lights.f.rgb(i));
            let light = lights.le.rgb(i) * lights.weight[i];
            others.light.put_rgb(i, light);
            others.goes_on[i] = bounces.continues[i];
            others.bounce_wi.put_vec(i, bounces.wi.vec(i));
            others.bounce_f.put_rgb(i, bounces.f.rgb(i));
            others.bounce[i] = bounces.weight[i] * bounces.inverse_survival[i];
        }
        self.components = wave.components;
        others.splits = Lane::zero();
        (others.normals_begin, others.normals_end) = (Lane::zero(), Lane::zero());
        if wave.splits {
            let mut first = wave.before;
            for i in (0..wave.n).filter(|&i| at.plain[i] == 0) {
                let branches = match at.splits[i] {
                    0 => &[],
                    _ => &wave.branches[first..],
                };
                let end = first + branches.iter().take_while(|b| b.at == i).count();
                others.splits[i] = at.splits[i];
                let light = lights.le.rgb(i) * lights.normals_weight[i];
                others.for_normals.put_rgb(i, light);
                (others.normals_begin[i], others.normals_end[i]) = (first as u32, end as u32);
                first = end;
            }
        }
    }

    /// The places of vertices that are not plain and that are differentiated, of paths that count.
    #[inline(always)]
    fn differentiated_others(
        &self,
        others: &Others<P>,
        counts: &Lane<u32>,
    ) -> ([usize; WAVE_SIZE], usize) {
        let (mut places, mut found) = ([0; WAVE_SIZE], 0);
        for i in 0..self.n.min(WAVE_SIZE) {
            places[found % WAVE_SIZE] = i;
            let id = self.id[i] as usize % WAVE_SIZE;
            found += (others.there[i] & self.differentiated[i] & counts[id]) as usize;
        }
        (places, found)
    }

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
        let mut plain = true;
        for i in 0..n {
            plain &= at.plain[i] != 0;
        }
        if plain {
            layer.any_other = false;
        } else {
            layer.keep_others(wave);
            if self.edges != Edges::None {
                self.keep_separate(wave);
            }
        }
        let layer = &mut *self.layers[self.used - 1];
        let (paths, lights) = (&wave.paths, &wave.lights);
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
