//! Materials made of one or two others: masks, blends, and what is tilted by a map of normals or heights. Their parts are
//! sorted by kind themselves, and mixed afterwards.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use super::super::readings::Reading;
use super::{Found, Leaves, Scattered, Valued, seen_from, sort};
use crate::bsdf::nesting::{choice, choose};
use crate::bsdf::{
    Bsdf, Component, DeltaKind, Material, Reader, TextureRef, shadowing, tilted, tilts,
};
use crate::math::{Frame, Rgb};

/// What a vertex is made of: all are blends of two parts. The first part of a mask is its hole; what is only tilted has
/// none.
struct Mixture<'a, P> {
    parts: [Option<&'a Material>; 2],
    /// Weight of the second part.
    weight: P,
    /// Probability of choosing it.
    second: P,
    hole: bool,
    tilt: Option<Tilt<P>>,
}

/// A vector along the normal of a tilted surface, and whether its horizon casts shadows.
struct Tilt<P>(Vec3<P>, bool);

impl<'a, P: Float> Mixture<'a, P> {
    fn of(material: &'a Material, read: &mut Reading<P>, wo: Vec3<P>) -> Option<Self> {
        let tilted = |nested: &'a Material, tilt| Self {
            parts: [None, Some(nested)],
            weight: P::one(),
            second: P::one(),
            hole: false,
            tilt: Some(tilt),
        };
        Some(match material {
            Material::Mask(m) => {
                let weight = read.scalar(m.texture());
                Self {
                    parts: [None, Some(m.nested())],
                    weight,
                    second: choice(weight),
                    hole: true,
                    tilt: None,
                }
            }
            Material::Blend(m) => {
                let weight = read.scalar(m.texture());
                let [a, b] = m.parts() else {
                    return None;
                };
                Self {
                    parts: [Some(a), Some(b)],
                    weight,
                    second: choice(weight),
                    hole: false,
                    tilt: None,
                }
            }
            Material::NormalMap(m) => {
                let normals = read.footprint(m.map());
                let vector = m.vector_between(&read.at, &normals, wo);
                let tilt = Tilt(vector, m.corrections().shadowing);
                tilted(m.nested(), tilt)
            }
            Material::BumpMap(m) => {
                let heights = read.slopes(m.height());
                let scale = read.scalar(m.scale());
                let vector = m.vector_between(&read.at, &heights, scale, wo);
                let tilt = Tilt(vector, m.corrections().shadowing);
                tilted(m.nested(), tilt)
            }
            _ => return None,
        })
    }
}

/// What a part is made of, and whether it is that from both sides; `None` if that is of no kind.
fn leaf(part: &Material) -> Option<(&Material, bool)> {
    let (leaf, both) = match part {
        Material::TwoSided(m) => (m.same()?, true),
        _ => (part, false),
    };
    sort(leaf).map(|_| (leaf, both))
}

/// Calls `f` with every texture of a material, in the order in which [`super::Kinds::take`] reads them; with none where that
/// depends on the side that is seen.
pub fn visit_textures(material: &Material, f: &mut dyn FnMut(TextureRef)) {
    let of_leaf = |part: &Material, f: &mut dyn FnMut(TextureRef)| {
        if let Some((leaf, _)) = leaf(part) {
            leaf.visit_textures(f);
        }
    };
    match material {
        Material::Charted(m) => visit_textures(m.nested(), f),
        Material::TwoSided(m) => {
            if let Some(both) = m.same() {
                visit_textures(both, f);
            }
        }
        Material::Mask(m) => {
            f(TextureRef::Scalar(m.texture()));
            of_leaf(m.nested(), f);
        }
        Material::Blend(m) => {
            f(TextureRef::Scalar(m.texture()));
            for part in m.parts() {
                of_leaf(part, f);
            }
        }
        Material::NormalMap(m) => {
            m.visit_tilt(f);
            of_leaf(m.nested(), f);
        }
        Material::BumpMap(m) => {
            m.visit_tilt(f);
            of_leaf(m.nested(), f);
        }
        _ => material.visit_textures(f),
    }
}

lanes! {
    /// Mixtures, and what they are asked and answer.
    Mixtures {
        /// Minus one where a side within is seen from behind, otherwise one.
        turn: Lane<P>,
        weight: Lane<P>,
        second: Lane<P>,
        hole: Lane<u32>,
        /// Whether the parts are the same from both sides.
        both_a: Lane<u32>,
        both_b: Lane<u32>,
        tilted: Lane<u32>,
        shadowed: Lane<u32>,
        /// Along the normals of what is tilted, and the frames of that.
        along: Lanes<P>,
        s: Lanes<P>,
        t: Lanes<P>,
        n: Lanes<P>,
        /// Directions as the surface has them.
        wo: Lanes<P>,
        wi: Lanes<P>,
        /// The same as the parts have them.
        o: Lanes<P>,
        i: Lanes<P>,
        /// Sides of the parts that are seen.
        side_a: Lane<P>,
        side_b: Lane<P>,
        /// Whether the surface scatters at all between these directions, and the share that its horizon lets through.
        scatters: Lane<u32>,
        shadow: Lane<P>,
        f_a: Lanes<P>,
        f_b: Lanes<P>,
        pdf_a: Lane<P>,
        pdf_b: Lane<P>,
        right: Lane<u32>,
        f: Lanes<P>,
        pdf: Lane<P>,
        /// Random numbers, the first of them for the chosen part.
        first: Lane<P>,
        b: Lane<P>,
        c: Lane<P>,
        chosen: Lane<u32>,
    }
}

impl<P: Float> Mixtures<P> {
    #[inline(always)]
    fn frame(&self, k: usize) -> Frame<P> {
        Frame {
            s: self.s.vec(k),
            t: self.t.vec(k),
            n: self.n.vec(k),
        }
    }

    #[inline(always)]
    fn put_frame(&mut self, k: usize, frame: &Frame<P>) {
        self.s.put_vec(k, frame.s);
        self.t.put_vec(k, frame.t);
        self.n.put_vec(k, frame.n);
    }

    /// Frames of what is tilted.
    #[inline(never)]
    fn tilt(&mut self, n: usize) {
        let x = Vec3::new(P::one(), P::zero(), P::zero());
        let z = Vec3::new(P::zero(), P::zero(), P::one());
        for k in 0..whole(n) {
            let along = self.along.vec(k);
            let (unit, long) = along.unit();
            let (frame, right) = Frame::in_line(Vec3::select(tilts(along), unit, z), x);
            self.put_frame(k, &frame);
            self.right[k] = u32::from(right & (long | !tilts(along)));
        }
        for k in 0..n.min(WAVE_SIZE) {
            if (self.right[k] == 0) & (self.tilted[k] != 0) {
                self.put_frame(k, &tilted(self.along.vec(k)));
            }
        }
    }

    /// Directions as the parts see them.
    #[inline(never)]
    fn face(&mut self, n: usize) {
        let (zero, one) = (P::zero(), P::one());
        for k in 0..whole(n) {
            let (frame, tilted) = (self.frame(k), self.tilted[k] != 0);
            let (wo, wi) = (self.wo.vec(k), self.wi.vec(k));
            let inside = |w: Vec3<P>| Vec3::select(tilted, frame.to_local(w), w);
            let (o, i) = (inside(wo), inside(wi));
            self.o.put_vec(k, o);
            self.i.put_vec(k, i);
            let same = (wo.z * o.z > zero) & (wi.z * i.z > zero);
            self.scatters[k] = u32::from(same | !tilted);
            let shadow = shadowing(frame.n, wi);
            self.shadow[k] = P::select(self.shadowed[k] != 0, shadow, one);
            let side = |both: u32| P::select((both != 0) & (o.z < zero), -one, one);
            (self.side_a[k], self.side_b[k]) = (side(self.both_a[k]), side(self.both_b[k]));
            self.f_a.put_rgb(k, Rgb::black());
            self.f_b.put_rgb(k, Rgb::black());
            (self.pdf_a[k], self.pdf_b[k], self.right[k]) = (zero, zero, 1);
        }
    }

    /// Puts together what the parts answered.
    #[inline(never)]
    fn mix(&mut self, n: usize) {
        for k in 0..whole(n) {
            let (weight, second) = (self.weight[k], self.second[k]);
            let f = self.f_a.rgb(k) * (P::one() - weight) + self.f_b.rgb(k) * weight;
            let pdf = self.pdf_a[k] * (P::one() - second) + self.pdf_b[k] * second;
            let scatters = self.scatters[k] != 0;
            let f = Rgb::select(scatters, f * self.shadow[k], Rgb::black());
            self.f.put_rgb(k, f);
            self.pdf[k] = P::select(scatters, pdf, P::zero());
        }
    }

    /// Which part is sampled.
    #[inline(never)]
    fn choose(&mut self, n: usize) {
        for k in 0..whole(n) {
            let (is_second, first) = choose(self.first[k], self.second[k]);
            self.chosen[k] = u32::from(is_second);
            self.first[k] = first;
        }
    }
}

/// The vertices of a wave whose materials are made of others.
pub struct Composites<P> {
    paths: Vec<usize>,
    /// Whether frames are known.
    framed: bool,
    lanes: Box<Mixtures<P>>,
    parts: [Leaves<P>; 2],
    /// What the chosen parts scatter, as they see it.
    drawn: Vec<Option<Found<P>>>,
}

/// Whether a material may be one of these.
#[inline(always)]
pub fn may_be_one(material: &Material) -> bool {
    matches!(
        material,
        Material::Mask(_)
            | Material::Blend(_)
            | Material::NormalMap(_)
            | Material::BumpMap(_)
            | Material::Charted(_)
    )
}

impl<P: Float> Default for Box<Composites<P>> {
    fn default() -> Self {
        Self::new(Composites {
            paths: Vec::with_capacity(WAVE_SIZE),
            framed: false,
            lanes: Box::new(Mixtures::zero()),
            parts: [Leaves::new(), Leaves::new()],
            drawn: Vec::with_capacity(WAVE_SIZE),
        })
    }
}

impl<P: Float> Composites<P> {
    /// Forgets all.
    pub fn clear(&mut self) {
        self.paths.clear();
        for part in &mut self.parts {
            part.clear();
        }
    }

    /// Takes path `i` in, if its material is made of leaves of which there are kinds.
    #[inline(never)]
    pub fn take<'a>(
        &mut self,
        i: usize,
        material: &'a Material,
        read: &mut Reading<'a, P>,
        wo: Vec3<P>,
    ) -> bool {
        let material = match material {
            Material::Charted(m) => {
                read.at = m.inside(&read.at);
                &**m.nested()
            }
            _ => material,
        };
        let (material, turn) = match material {
            Material::TwoSided(m) => {
                let behind = wo.z < P::zero();
                let turn = P::select(behind, -P::one(), P::one());
                (&*m.sides()[usize::from(behind)], turn)
            }
            _ => (material, P::one()),
        };
        let Some(mixture) = Mixture::of(material, read, seen_from(turn, wo)) else {
            return false;
        };
        let k = self.paths.len() % WAVE_SIZE;
        let known = |part: &Option<&Material>| part.is_none_or(|part| leaf(part).is_some());
        if !mixture.parts.iter().all(known) {
            return false;
        }
        let mut both = [0; 2];
        for side in 0..2 {
            if let Some((leaf, same)) = mixture.parts[side].and_then(leaf) {
                self.parts[side].take(k, leaf, read);
                both[side] = u32::from(same);
            }
        }
        let lanes = &mut *self.lanes;
        lanes.turn[k] = turn;
        (lanes.weight[k], lanes.second[k]) = (mixture.weight, mixture.second);
        lanes.hole[k] = u32::from(mixture.hole);
        [lanes.both_a[k], lanes.both_b[k]] = both;
        lanes.tilted[k] = u32::from(mixture.tilt.is_some());
        lanes.shadowed[k] = 0;
        if let Some(Tilt(along, shadowed)) = mixture.tilt {
            lanes.shadowed[k] = u32::from(shadowed);
            lanes.along.put_vec(k, along);
        }
        self.framed = false;
        self.paths.push(i);
        true
    }

    /// Finds the frames of what is tilted, if that has not been done.
    #[inline(always)]
    fn frame(&mut self) {
        if !self.framed {
            self.lanes.tilt(self.paths.len());
            self.framed = true;
        }
    }

    /// Values and densities of `wi` as the surface has it.
    fn find(&mut self) {
        let n = self.paths.len();
        self.lanes.face(n);
        let Mixtures {
            o,
            i,
            side_a,
            side_b,
            f_a,
            f_b,
            pdf_a,
            pdf_b,
            right,
            ..
        } = &mut *self.lanes;
        let answers = [(side_a, f_a, pdf_a), (side_b, f_b, pdf_b)];
        for (part, (side, f, pdf)) in self.parts.iter_mut().zip(answers) {
            for &mut (k, found) in part.eval_pdf(o, side, i) {
                match found {
                    Some((value, density)) => {
                        f.put_rgb(k, value);
                        pdf[k] = density;
                    }
                    None => right[k] = 0,
                }
            }
        }
        self.lanes.mix(n);
    }

    /// See [`super::Kinds::eval_pdf`].
    #[inline(never)]
    pub fn eval_pdf(
        &mut self,
        (wo, side, wi): (&Lanes<P>, &Lane<P>, &Lanes<P>),
        out: &mut Vec<Valued<P>>,
    ) {
        if self.paths.is_empty() {
            return;
        }
        self.frame();
        for (k, &i) in self.paths.iter().enumerate() {
            let side = side[i] * self.lanes.turn[k];
            self.lanes.wo.put_vec(k, seen_from(side, wo.vec(i)));
            self.lanes.wi.put_vec(k, seen_from(side, wi.vec(i)));
        }
        self.find();
        let lanes = &*self.lanes;
        out.extend(self.paths.iter().enumerate().map(|(k, &i)| {
            let both = (lanes.f.rgb(k), lanes.pdf[k]);
            (i, (lanes.right[k] != 0).then_some(both))
        }));
    }

    /// See [`super::Kinds::sample`].
    #[inline(never)]
    pub fn sample(
        &mut self,
        (wo, side, [a, b, c]): (&Lanes<P>, &Lane<P>, [&Lane<P>; 3]),
        out: &mut Vec<Scattered<P>>,
    ) {
        let n = self.paths.len();
        if n == 0 {
            return;
        }
        self.frame();
        let lanes = &mut *self.lanes;
        for (k, &i) in self.paths.iter().enumerate() {
            let side = side[i] * lanes.turn[k];
            lanes.wo.put_vec(k, seen_from(side, wo.vec(i)));
            (lanes.first[k], lanes.b[k], lanes.c[k]) = (a[i], b[i], c[i]);
        }
        lanes.choose(n);
        lanes.face(n);
        self.draw();
        self.find();
        let lanes = &*self.lanes;
        out.extend(self.paths.iter().enumerate().map(|(k, &i)| {
            let found = self.drawn[k].and_then(|drawn| lanes.mixed(k, drawn));
            let side = side[i] * lanes.turn[k];
            let turned =
                |(wi, f, pdf, component, eta)| (seen_from(side, wi), f, pdf, component, eta);
            (i, found.map(turned))
        }));
    }

    /// What the chosen parts scatter, and where that is on the surface.
    fn draw(&mut self) {
        let lanes = &mut *self.lanes;
        self.drawn.clear();
        self.drawn.resize(self.paths.len(), None);
        for (number, (part, side)) in
            (0..).zip(self.parts.iter_mut().zip([&lanes.side_a, &lanes.side_b]))
        {
            let numbers = [&lanes.first, &lanes.b, &lanes.c];
            let chosen = |k: usize| lanes.chosen[k] == number;
            for &mut (k, found) in part.sample(&lanes.o, side, numbers) {
                if chosen(k) {
                    self.drawn[k] = found;
                }
            }
        }
        for (k, drawn) in self.drawn.iter_mut().enumerate() {
            if (lanes.hole[k] != 0) & (lanes.chosen[k] == 0) {
                let component = Component::Delta {
                    kind: DeltaKind::Passthrough,
                    route: 0,
                };
                let through = Rgb::splat(P::one());
                *drawn = Some((-lanes.wo.vec(k), through, P::one(), component, P::one()));
            }
            let Some((wi, _, pdf, ..)) = drawn else {
                continue;
            };
            if lanes.tilted[k] != 0 {
                let (i, wo, o) = (*wi, lanes.wo.vec(k), lanes.o.vec(k));
                *wi = lanes.frame(k).to_world(i);
                let same = (wo.z * o.z > P::zero()) & (wi.z * i.z > P::zero());
                *pdf = P::select(same, *pdf, P::zero());
            }
            lanes.wi.put_vec(k, *wi);
        }
    }
}

impl<P: Float> Mixtures<P> {
    /// What the mixture makes of what one part scatters.
    fn mixed(&self, k: usize, (wi, f, pdf, component, eta): Found<P>) -> Option<Found<P>> {
        let second = self.chosen[k] != 0;
        Some(match component {
            Component::Continuous => {
                if self.right[k] == 0 {
                    return None;
                }
                let pdf = P::select(pdf > P::zero(), self.pdf[k], P::zero());
                (wi, self.f.rgb(k), pdf, component, eta)
            }
            Component::Delta { kind, route } => {
                let (p, weight) = (self.second[k], self.weight[k]);
                let p = P::select(second, p, P::one() - p);
                let share = P::select(second, weight, P::one() - weight);
                let route = match self.tilted[k] {
                    0 => route << 1 | u8::from(second),
                    _ => route,
                };
                let component = Component::Delta { kind, route };
                (wi, f * share * self.shadow[k], pdf * p, component, eta)
            }
        })
    }
}
