//! Vertices of one kind of material, at once.

use ad_core::{Float, Vec3};

use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use crate::bsdf::microfacet::Ndf;
use crate::bsdf::{
    Component, Conductor, DeltaKind, Diffuse, Facets, Material, Metal, RoughConductor, Shading,
};
use crate::math::Rgb;

/// What a vertex scatters like.
#[derive(Clone, Copy, Debug)]
pub enum Kind<'a> {
    /// Diffuse.
    Plain(&'a Diffuse),
    /// Rough and metallic.
    Rough(&'a RoughConductor),
    /// A metallic mirror.
    Mirror(&'a Conductor),
    /// Anything.
    Other,
}

/// What a material scatters like, and whether that is so from both sides.
#[inline(always)]
pub fn kind(material: &Material) -> (Kind<'_>, bool) {
    let (leaf, both) = match material {
        Material::TwoSided(m) => (m.same().unwrap_or(material), true),
        _ => (material, false),
    };
    match leaf {
        Material::Diffuse(m) => (Kind::Plain(m), both),
        Material::RoughConductor(m) => (Kind::Rough(m), both),
        Material::Conductor(m) => (Kind::Mirror(m), both),
        _ => (Kind::Other, false),
    }
}

/// A direction in the local frame of the side that is seen: `side` is one, or minus one from behind.
#[inline(always)]
pub fn seen_from<P: Float>(side: P, w: Vec3<P>) -> Vec3<P> {
    Vec3::new(w.x, w.y, w.z * side)
}

/// Which normals a metal has.
const GGX: u32 = 0;
const BECKMANN: u32 = 1;
const MIRROR: u32 = 2;

lanes! {
    /// Metals, and where they scatter.
    MetalLanes {
        /// [`GGX`], [`BECKMANN`] or [`MIRROR`].
        normals: Lane<u32>,
        alpha: Lane<P>,
        specular_reflectance: Lanes<P>,
        eta: Lanes<P>,
        k: Lanes<P>,
        has_index: Lane<u32>,
        /// Direction that the path came from, local frame of the side that is seen.
        wo: Lanes<P>,
        /// Direction to the light, or scattered one.
        wi: Lanes<P>,
        /// [`Facets`] in between.
        m: Lanes<P>,
        d: Lane<P>,
        sigma_o: Lane<P>,
        sigma_i: Lane<P>,
        /// Value there.
        f: Lanes<P>,
        /// Density.
        pdf: Lane<P>,
        /// Whether the direction is right.
        sampled: Lane<u32>,
        /// Whether all is right.
        right: Lane<u32>,
    }
}

/// The vertices of a wave that are metals.
pub struct Metals<P> {
    /// Which paths stand there.
    pub paths: Vec<usize>,
    /// Those that have Beckmann's normals, by their places among these: their functions are called one by one.
    beckmann: Vec<usize>,
    lanes: Box<MetalLanes<P>>,
}

/// What a metal scatters: direction, value, density or probability, and what it belongs to.
pub type Reflected<P> = (Vec3<P>, Rgb<P>, P, Component);

impl<P: Float> Metals<P> {
    /// None.
    pub fn new() -> Self {
        Self {
            paths: Vec::with_capacity(WAVE_SIZE),
            beckmann: Vec::with_capacity(WAVE_SIZE),
            lanes: Box::new(MetalLanes::zero()),
        }
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.paths.clear();
        self.beckmann.clear();
    }

    /// Takes path `i` in, if the material is one of these there.
    #[inline(always)]
    pub fn take(&mut self, i: usize, kind: Kind, at: &Shading<P>) -> bool {
        let (normals, metal) = match kind {
            Kind::Rough(m) => match Metal::rough(m, at) {
                Some((Ndf::Ggx, metal)) => (GGX, metal),
                Some((Ndf::Beckmann, metal)) => (BECKMANN, metal),
                None => return false,
            },
            Kind::Mirror(m) => (MIRROR, Metal::mirror(m, at)),
            _ => return false,
        };
        let (to, k) = (&mut *self.lanes, self.paths.len() % WAVE_SIZE);
        self.paths.push(i);
        if normals == BECKMANN {
            self.beckmann.push(k);
        }
        to.normals[k] = normals;
        to.alpha[k] = metal.alpha;
        to.specular_reflectance
            .put_rgb(k, metal.specular_reflectance);
        to.eta.put_rgb(k, metal.index[0]);
        to.k.put_rgb(k, metal.index[1]);
        to.has_index[k] = u32::from(metal.has_index);
        true
    }

    /// Values and densities of directions to lights: calls `put` with each path, and with them where they are right.
    #[inline(always)]
    pub fn eval_pdf(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        wi: &Lanes<P>,
        mut put: impl FnMut(usize, Option<(Rgb<P>, P)>),
    ) {
        let (paths, at) = (&self.paths, &mut *self.lanes);
        if paths.is_empty() {
            return;
        }
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            at.wo.put_vec(k, seen_from(side[i], wo.vec(i)));
            at.wi.put_vec(k, seen_from(side[i], wi.vec(i)));
        }
        at.eval_pdf(paths.len(), &self.beckmann);
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            // Nothing comes from a light to a mirror.
            let found = match at.normals[k] {
                MIRROR => Some((Rgb::black(), P::zero())),
                _ => (at.right[k] != 0).then(|| (at.f.rgb(k), at.pdf[k])),
            };
            put(i, found);
        }
    }

    /// Scattered directions, made of three lanes of random numbers: calls `put` with each path, and with what it finds
    /// where that is right.
    #[inline(always)]
    pub fn sample(
        &mut self,
        wo: &Lanes<P>,
        side: &Lane<P>,
        [b, c]: [&Lane<P>; 2],
        mut put: impl FnMut(usize, Option<Reflected<P>>),
    ) {
        let (paths, at) = (&self.paths, &mut *self.lanes);
        if paths.is_empty() {
            return;
        }
        let mut u = [Lane::zero(); 2];
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            at.wo.put_vec(k, seen_from(side[i], wo.vec(i)));
            (u[0][k], u[1][k]) = (b[i], c[i]);
        }
        at.sample(paths.len(), &self.beckmann, &u);
        at.eval_pdf(paths.len(), &self.beckmann);
        at.reflect(paths.len());
        let mirrored = Component::Delta {
            kind: DeltaKind::Reflection,
            route: 0,
        };
        for (k, &i) in paths.iter().enumerate() {
            let k = k % WAVE_SIZE;
            let component = match at.normals[k] {
                MIRROR => mirrored,
                _ => Component::Continuous,
            };
            let right = at.right[k] & at.sampled[k] != 0;
            let wi = seen_from(side[i], at.wi.vec(k));
            let all = || (wi, at.f.rgb(k), at.pdf[k], component);
            put(i, right.then(all));
        }
    }
}

impl<P: Float> MetalLanes<P> {
    #[inline(always)]
    fn metal(&self, k: usize) -> Metal<P> {
        Metal {
            alpha: self.alpha[k],
            specular_reflectance: self.specular_reflectance.rgb(k),
            index: [self.eta.rgb(k), self.k.rgb(k)],
            has_index: self.has_index[k] != 0,
        }
    }

    #[inline(always)]
    fn facets(&self, k: usize) -> Facets<P> {
        Facets {
            m: self.m.vec(k),
            d: self.d[k],
            sigma: [self.sigma_o[k], self.sigma_i[k]],
        }
    }

    #[inline(always)]
    fn put_facets(&mut self, k: usize, facets: &Facets<P>) {
        self.m.put_vec(k, facets.m);
        self.d[k] = facets.d;
        [self.sigma_o[k], self.sigma_i[k]] = facets.sigma;
    }

    /// As if all were GGX, then those that are not, then what all have in common.
    #[inline(never)]
    fn eval_pdf(&mut self, n: usize, beckmann: &[usize]) {
        for k in 0..whole(n) {
            let (wo, wi) = (self.wo.vec(k), self.wi.vec(k));
            let (facets, right) = self.metal(k).ggx(wo, wi);
            self.put_facets(k, &facets);
            // Below the horizon there is no normal.
            let below = (wo.z <= P::zero()) | (wi.z <= P::zero());
            self.right[k] = u32::from(right | below);
        }
        for &k in beckmann {
            let (wo, wi, m) = (self.wo.vec(k), self.wi.vec(k), self.m.vec(k));
            let facets = self.metal(k).beckmann(wo, wi, m);
            self.put_facets(k, &facets);
        }
        for k in 0..whole(n) {
            let (wo, wi, facets) = (self.wo.vec(k), self.wi.vec(k), self.facets(k));
            let (f, pdf) = self.metal(k).eval_pdf(wo, wi, &facets);
            self.f.put_rgb(k, f);
            self.pdf[k] = pdf;
        }
    }

    #[inline(never)]
    fn sample(&mut self, n: usize, beckmann: &[usize], u: &[Lane<P>; 2]) {
        for k in 0..whole(n) {
            let wo = self.wo.vec(k);
            let (wi, right) = self.metal(k).sample_ggx(wo, [u[0][k], u[1][k]]);
            self.wi.put_vec(k, wi);
            self.sampled[k] = u32::from(right | (wo.z <= P::zero()));
        }
        for &k in beckmann {
            let wo = self.wo.vec(k);
            if wo.z > P::zero() {
                let wi = self.metal(k).sample_beckmann(wo, [u[0][k], u[1][k]]);
                self.wi.put_vec(k, wi);
                self.sampled[k] = 1;
            }
        }
    }

    /// Mirrors, whose directions are not drawn.
    #[inline(never)]
    fn reflect(&mut self, n: usize) {
        for k in 0..whole(n) {
            let wo = self.wo.vec(k);
            let mirror = self.normals[k] == MIRROR;
            let f = self.metal(k).reflectance(wo.z);
            let f = f.map(|f| P::select(wo.z > P::zero(), f, P::zero()));
            let pdf = P::select(wo.z > P::zero(), P::one(), P::zero());
            let wi = Vec3::new(-wo.x, -wo.y, wo.z);
            let select = |a: P, b: P| P::select(mirror, a, b);
            let (w, v) = (self.wi.vec(k), self.f.rgb(k));
            let wi = Vec3::new(select(wi.x, w.x), select(wi.y, w.y), select(wi.z, w.z));
            let f = Rgb::new(select(f.r, v.r), select(f.g, v.g), select(f.b, v.b));
            self.wi.put_vec(k, wi);
            self.f.put_rgb(k, f);
            self.pdf[k] = select(pdf, self.pdf[k]);
            let ready = u32::from(mirror);
            self.sampled[k] |= ready;
            self.right[k] |= ready;
        }
    }
}
