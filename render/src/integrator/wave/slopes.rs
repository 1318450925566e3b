//! Derivatives of what rough metals scatter, many vertices at once.
//!
//! They are those of [`crate::bsdf::Bsdf::backward`] up to rounding, by the change of the logarithm of what facets reflect, and
//! are added in the order of the vertices.

use std::marker::PhantomData;

use ad_core::{Float, Vec2, Vec3};
use smallvec::SmallVec;

use super::kinds::{Beckmann, Ggx, Shape, Surfaces, seen_from, side};
use super::lanes::{Field, Lane, Lanes, WAVE_SIZE, lanes, whole};
use crate::bsdf::microfacet::{Microfacet, Ndf};
use crate::bsdf::{
    Bsdf, Component, Facets, Leaf, Material, Metal, Part, RoughConductor, Shading, Use,
};
use crate::integrator::vertex::MODE;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;

/// A number of a rough metal that derivatives are wanted by, as a bit of [`Wanted`].
const ROUGHNESS: u32 = 1;
/// Likewise: the factor on its reflectance.
const REFLECTANCE: u32 = 2;

/// By which numbers of the front and the back of a material derivatives are wanted; none of what is no rough metal, or where
/// there are others.
type Wanted = [u32; 2];

lanes! {
    /// Vertices on rough metals, and how light was scattered there.
    Vertices {
        alpha: Lane<P>,
        reflectance: Lanes<P>,
        eta: Lanes<P>,
        k: Lanes<P>,
        has_index: Lane<u32>,
        /// By which numbers derivatives are wanted.
        wanted: Lane<u32>,
        wo: Lanes<P>,
        /// Two directions at most, and the adjoints of the values there: black where there is none.
        first: Lanes<P>,
        first_d: Lanes<P>,
        second: Lanes<P>,
        second_d: Lanes<P>,
        /// Whether normals are right; otherwise, the functions of the material have to be called.
        right: Lane<u32>,
        /// Adjoints of these numbers.
        by_roughness: Lanes<P>,
        by_reflectance: Lanes<P>,
        u: Lane<P>,
        v: Lane<P>,
    }
}

/// Vertices of metals whose normals are of one shape.
struct Batch<'a, P, N> {
    lanes: Box<Vertices<P>>,
    metals: Vec<&'a RoughConductor>,
    shape: PhantomData<N>,
}

/// Vertices on rough metals that wait for others.
pub struct MetalSlopes<'a, P> {
    scene: &'a Scene,
    /// Of each material.
    wanted: Vec<Wanted>,
    ggx: Batch<'a, P, Ggx>,
    beckmann: Batch<'a, P, Beckmann>,
}

/// By which numbers of a material derivatives are wanted, of the ranges for which `active` holds.
fn wanted(material: &Material, active: impl Fn(ParamRef) -> bool) -> u32 {
    let Material::RoughConductor(metal) = material else {
        return 0;
    };
    let conductor = &metal.conductor;
    let index = conductor.index.as_ref();
    if index.is_some_and(|i| i.eta.any_param(&active) || i.k.any_param(&active)) {
        return 0;
    }
    let bit = |bit, wants| if wants { bit } else { 0 };
    bit(ROUGHNESS, metal.roughness.alpha.any_param(&active))
        | bit(
            REFLECTANCE,
            conductor.specular_reflectance.any_param(&active),
        )
}

impl<'a, P: Float> MetalSlopes<'a, P> {
    /// Without vertices.
    pub fn of(scene: &'a Scene, grad: &impl GradSink<P>) -> Self {
        let of = |material, behind| wanted(side(material, behind).0, |p| grad.active(p));
        let materials = scene.materials().iter();
        Self {
            scene,
            wanted: materials.map(|m| [of(m, false), of(m, true)]).collect(),
            ggx: Batch::new(),
            beckmann: Batch::new(),
        }
    }

    /// Takes a vertex of the material `index` in, if it is a rough metal there: its derivatives are added to `grad` then, or
    /// later.
    #[inline(always)]
    pub fn take(
        &mut self,
        index: u32,
        (uv, wo): (Vec2<P>, Vec3<P>),
        uses: &[Use<P>],
        theta: &Theta<P>,
        grad: &mut impl GradSink<P>,
    ) -> bool {
        let behind = wo.z < P::zero();
        let wanted = self.wanted[index as usize][usize::from(behind)];
        let plain = |u: &Use<P>| u.component == Component::Continuous && u.part == Part::All;
        if wanted == 0 || uses.len() > 2 || !uses.iter().all(plain) {
            return false;
        }
        let (material, both) = side(&self.scene.materials()[index as usize], behind);
        let Material::RoughConductor(metal) = material else {
            return false;
        };
        let turn = P::select(both & behind, -P::one(), P::one());
        let vertex = (wanted, uv, seen_from(turn, wo));
        let uses = [0, 1].map(|i| {
            let none = (Vec3::zero(), Rgb::black());
            uses.get(i).map_or(none, |u| (seen_from(turn, u.wi), u.d))
        });
        match metal.roughness.kind {
            Ndf::Ggx => self.ggx.put(metal, vertex, uses, theta, grad),
            Ndf::Beckmann => self.beckmann.put(metal, vertex, uses, theta, grad),
        }
        true
    }

    /// Adds the derivatives of all that wait.
    pub fn finish(&mut self, theta: &Theta<P>, grad: &mut impl GradSink<P>) {
        self.ggx.add(theta, grad);
        self.beckmann.add(theta, grad);
    }
}

impl<'a, P: Float, N: Shape> Batch<'a, P, N> {
    fn new() -> Self {
        Self {
            lanes: Box::new(Vertices::zero()),
            metals: Vec::with_capacity(WAVE_SIZE),
            shape: PhantomData,
        }
    }

    fn put(
        &mut self,
        metal: &'a RoughConductor,
        (wanted, uv, wo): (u32, Vec2<P>, Vec3<P>),
        [first, second]: [(Vec3<P>, Rgb<P>); 2],
        theta: &Theta<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let (lanes, k) = (&mut *self.lanes, self.metals.len());
        let lobe = metal.lobe(&mut &Shading::new(*theta, uv));
        let facet = Metal::of(&lobe.facet);
        lanes.alpha[k] = lobe.microfacet.alpha;
        lanes.reflectance.put_rgb(k, facet.specular_reflectance);
        lanes.eta.put_rgb(k, facet.index[0]);
        lanes.k.put_rgb(k, facet.index[1]);
        lanes.has_index[k] = u32::from(facet.has_index);
        lanes.wanted[k] = wanted;
        lanes.wo.put_vec(k, wo);
        lanes.first.put_vec(k, first.0);
        lanes.first_d.put_rgb(k, first.1);
        lanes.second.put_vec(k, second.0);
        lanes.second_d.put_rgb(k, second.1);
        (lanes.u[k], lanes.v[k]) = (uv.x, uv.y);
        self.metals.push(metal);
        if self.metals.len() == WAVE_SIZE {
            self.add(theta, grad);
        }
    }

    /// Adds the derivatives of all, and forgets them.
    fn add(&mut self, theta: &Theta<P>, grad: &mut impl GradSink<P>) {
        let n = self.metals.len();
        if n == 0 {
            return;
        }
        let lanes = &mut *self.lanes;
        lanes.right = Lane::zero();
        lanes.right[..n].fill(1);
        lanes.by_roughness = Lanes::zero();
        lanes.by_reflectance = Lanes::zero();
        lanes.find::<N, false>(n);
        lanes.find::<N, true>(n);
        for (k, metal) in self.metals.iter().enumerate() {
            if lanes.right[k] == 0 {
                continue;
            }
            let uv = Vec2::new(lanes.u[k], lanes.v[k]);
            if lanes.wanted[k] & ROUGHNESS != 0 {
                (metal.roughness.alpha).scatter(uv, lanes.by_roughness.rgb(k), grad);
            }
            if lanes.wanted[k] & REFLECTANCE != 0 {
                let d = lanes.by_reflectance.rgb(k);
                metal.conductor.specular_reflectance.scatter(uv, d, grad);
            }
        }
        for (k, metal) in self.metals.iter().enumerate() {
            if self.lanes.right[k] == 0 {
                self.lanes.call(k, metal, theta, grad);
            }
        }
        self.metals.clear();
    }
}

impl<P: Float> Vertices<P> {
    /// Adds the adjoints by the first, or the `second` direction of each of the first `n`.
    #[inline(never)]
    fn find<N: Shape, const SECOND: bool>(&mut self, n: usize) {
        for k in 0..whole(n) {
            let wo = self.wo.vec(k);
            let (wi, d) = if SECOND {
                (self.second.vec(k), self.second_d.rgb(k))
            } else {
                (self.first.vec(k), self.first_d.rgb(k))
            };
            let (m, right) = Surfaces::<P, P, N>::between(wo, wi);
            let surface = Microfacet {
                kind: N::NDF,
                alpha: self.alpha[k],
                visible: true,
            };
            let metal = Metal {
                specular_reflectance: Rgb::splat(P::one()),
                index: [self.eta.rgb(k), self.k.rgb(k)],
                has_index: self.has_index[k] != 0,
            };
            let facets = Facets::of(&surface, m, [wo, wi]);
            let (f, _) = metal.eval_pdf(wo, wi, &facets);
            let by_reflectance = f * d;
            let slope = surface.log_slope_in_line(m, [wo, wi]);
            // Where nothing is reflected there may be no slope.
            let lit = (wo.z > P::zero()) & (wi.z > P::zero()) & (facets.d > P::zero());
            let slope = P::select(lit, slope, P::zero());
            let by_roughness = by_reflectance * self.reflectance.rgb(k) * slope;
            self.by_reflectance.add_rgb(k, by_reflectance);
            self.by_roughness.add_rgb(k, by_roughness);
            self.right[k] &= u32::from(right);
        }
    }

    /// Adds all derivatives of vertex `k` by the functions of the material.
    #[cold]
    fn call(
        &self,
        k: usize,
        metal: &RoughConductor,
        theta: &Theta<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let both = [
            (self.first.vec(k), self.first_d.rgb(k)),
            (self.second.vec(k), self.second_d.rgb(k)),
        ];
        let uses: SmallVec<[_; 2]> = (both.into_iter())
            .filter(|(_, d)| !d.is_black())
            .map(|(wi, d)| Use {
                wi,
                component: Component::Continuous,
                part: Part::All,
                d,
            })
            .collect();
        let at = Shading::new(*theta, Vec2::new(self.u[k], self.v[k]));
        metal.backward(&at, self.wo.vec(k), &uses, MODE, grad);
    }
}
