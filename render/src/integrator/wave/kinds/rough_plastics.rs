//! Rough plastic, of which visible normals are sampled.

use ad_core::Float;

use super::super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use super::super::readings::Reading;
use super::facets::{Shape, Surfaces};
use super::plastics::Coatings;
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::coat::{Coat, Curve, Passes, place, weighed};
use crate::bsdf::{Leaf, Material};
use crate::texture::{ScalarTexture, Texture};

/// Coats of so many materials are kept.
const MOST_KEPT: usize = 32;

lanes! {
    /// Rough plastic, but for its normals and tables.
    RoughCoatings {
        coated: Coatings<P>,
        /// What passes of light along `wo`.
        t_o: Lane<P>,
        /// The same of light along `wi`.
        t_i: Lane<P>,
        /// What does not of diffuse light from below.
        inside: Lane<P>,
    }
}

lanes! {
    /// What passes at the nodes around cosines.
    Nodes {
        cell: Lane<u32>,
        a: Lane<P>,
        b: Lane<P>,
        c: Lane<P>,
        d: Lane<P>,
    }
}

/// A coat of one roughness and index.
struct Kept<P> {
    coat: &'static Coat,
    alpha: P,
    eta: P,
    curve: Curve<P>,
}

/// Rough plastic whose normals are of one shape.
pub struct RoughPlastics<P, N> {
    lanes: RoughCoatings<P>,
    nodes: Nodes<P>,
    facets: Surfaces<P, P, N>,
    /// Of materials that are the same everywhere.
    kept: Vec<Kept<P>>,
    /// Where each is among these, or, counted from [`MOST_KEPT`], among others.
    place: Lane<u32>,
    /// Coats of the others.
    others: Vec<Passes<'static, P>>,
    /// Whether it is known what passes along `wo`.
    seen: bool,
}

impl<P: Float> Nodes<P> {
    /// What passes of the first `n` along directions: nodes are looked up one by one, between what is done in vectors.
    #[inline(never)]
    fn look(
        &mut self,
        n: usize,
        coats: (&[Kept<P>], &[Passes<P>], &Lane<u32>),
        directions: &Lanes<P>,
        out: &mut Lane<P>,
    ) {
        let (kept, others, places) = coats;
        for k in 0..whole(n) {
            (self.cell[k], _) = place(directions.vec(k).z);
        }
        for k in 0..n.min(WAVE_SIZE) {
            let place = places[k] as usize;
            let [a, b, c, d] = match kept.get(place) {
                Some(kept) => kept.curve.nodes(self.cell[k]),
                None => others[place - MOST_KEPT].nodes(self.cell[k]),
            };
            (self.a[k], self.b[k], self.c[k], self.d[k]) = (a, b, c, d);
        }
        for k in 0..whole(n) {
            let (_, weights) = place(directions.vec(k).z);
            out[k] = weighed([self.a[k], self.b[k], self.c[k], self.d[k]], weights);
        }
    }
}

impl<P: Float, N: Shape> RoughPlastics<P, N> {
    /// Takes in a coat as the `k`-th. What passes a coat that is the `same` everywhere is kept.
    #[inline(always)]
    fn know(&mut self, k: usize, (coat, alpha, eta): (&'static Coat, P, P), same: bool) {
        let is_it = |kept: &Kept<P>| {
            std::ptr::eq(kept.coat, coat) & (kept.alpha == alpha) & (kept.eta == eta)
        };
        let mut place = self.kept.iter().position(is_it);
        if k == 0 {
            self.others.clear();
        }
        if place.is_none() {
            let passes = coat.passes(alpha, eta);
            if same && self.kept.len() < MOST_KEPT {
                place = Some(self.kept.len());
                let curve = Curve::of(&passes);
                self.kept.push(Kept {
                    coat,
                    alpha,
                    eta,
                    curve,
                });
            } else {
                self.lanes.inside[k] = passes.inside();
                self.place[k] = (MOST_KEPT + self.others.len()) as u32;
                self.others.push(passes);
            }
        }
        if let Some(place) = place {
            self.lanes.inside[k] = self.kept[place].curve.inside;
            self.place[k] = place as u32;
        }
        self.seen = false;
    }

    /// What passes along `wo`: once, for all that is asked.
    #[inline(always)]
    fn look_out(&mut self, n: usize, of: &Scattering<P>) {
        if !self.seen {
            let coats = (&*self.kept, &*self.others, &self.place);
            self.nodes.look(n, coats, &of.wo, &mut self.lanes.t_o);
            self.seen = true;
        }
    }

    #[inline(always)]
    fn look_in(&mut self, n: usize, of: &Scattering<P>) {
        let coats = (&*self.kept, &*self.others, &self.place);
        self.nodes.look(n, coats, &of.wi, &mut self.lanes.t_i);
    }

    #[inline(never)]
    fn value(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let directions = [of.wo.vec(k), of.wi.vec(k)];
            let passes = [self.lanes.t_o[k], self.lanes.t_i[k], self.lanes.inside[k]];
            let coated = self.lanes.coated.at(k);
            let (f, pdf) = coated.rough_eval_pdf(&self.facets.facets(k), directions, passes);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    #[inline(never)]
    fn turn(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k).to_array());
            let coated = self.lanes.coated.at(k);
            let wi = coated.rough_sample(wo, self.facets.normal(k), u, self.lanes.t_o[k]);
            of.wi.put_vec(k, wi);
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float, N: Shape> Members<P> for RoughPlastics<P, N> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: RoughCoatings::zero(),
            nodes: Nodes::zero(),
            facets: Surfaces::new(),
            kept: Vec::new(),
            place: Lane::zero(),
            others: Vec::new(),
            seen: false,
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        let Material::RoughPlastic(m) = material else {
            return false;
        };
        let lobe = m.lobe(read);
        let alpha = lobe.microfacet.alpha;
        self.facets.put(k, alpha);
        self.lanes.coated.put(k, &lobe.coated);
        let same = |texture: &ScalarTexture| matches!(texture, Texture::Constant(_));
        let same = same(&m.roughness.alpha) & same(&m.coated.eta);
        self.know(k, (lobe.table, alpha, lobe.coated.eta), same);
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.lanes.relocate(k, earlier);
        self.facets.repeat(k, earlier);
        self.place[k] = self.place[earlier];
        self.seen = false;
    }

    #[inline(always)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look_out(n, of);
        self.look_in(n, of);
        self.facets.reflecting(n, of);
        self.value(n, of);
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.look_out(n, of);
        self.facets.sample(n, of, false);
        self.turn(n, of);
        self.eval_pdf(n, of);
    }
}
