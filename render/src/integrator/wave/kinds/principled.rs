//! Principled materials.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::facets::{Ggx, Surfaces};
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::microfacet::Alpha;
use crate::bsdf::{Choices, ClearCoat, Facet, Leaf, Material, PrincipledLobe, Tints, upwards};

lanes! {
    /// Principled materials, but for their normals. What there is none of is zero, or changes nothing.
    PrincipledLanes {
        base_color: Lanes<P>,
        roughness: Lane<P>,
        metallic: Lane<P>,
        eta: Lane<P>,
        flatness: Lane<P>,
        sheen: Lane<P>,
        /// Of the clear coat.
        strength: Lane<P>,
        coat_alpha: Lane<P>,
        coat_ln: Lane<P>,
        transmission: Lane<P>,
        hue: Lanes<P>,
        dielectric_tint: Lane<P>,
        sheen_tint: Lane<P>,
        /// [`Choices`].
        main: Lane<P>,
        base: Lane<P>,
        coat: Lane<P>,
        glass: Lane<P>,
    }
}

/// Principled materials. A loop does what any of those that are there has; of all, few have most.
pub struct PrincipledSurfaces<P, A> {
    lanes: PrincipledLanes<P>,
    facets: Surfaces<P, A, Ggx>,
    /// Whether any has more than a base and its reflection.
    more: bool,
    /// Whether any has glass.
    glass: bool,
}

impl<P: Float, A: Alpha<Scalar = P>> PrincipledSurfaces<P, A> {
    #[inline(always)]
    fn at<const MORE: bool, const GLASS: bool>(&self, k: usize) -> PrincipledLobe<P, A> {
        let lanes = &self.lanes;
        let more = |lane: &Lane<P>| if MORE { Some(lane[k]) } else { None };
        PrincipledLobe {
            base_color: lanes.base_color.rgb(k),
            roughness: lanes.roughness[k],
            microfacet: self.facets.surface(k),
            metallic: lanes.metallic[k],
            eta: lanes.eta[k],
            flatness: more(&lanes.flatness),
            sheen: more(&lanes.sheen),
            clearcoat: MORE.then_some(ClearCoat {
                strength: lanes.strength[k],
                alpha: lanes.coat_alpha[k],
                ln: lanes.coat_ln[k],
            }),
            transmission: GLASS.then_some(lanes.transmission[k]),
            tints: MORE.then_some(Tints {
                hue: lanes.hue.rgb(k),
                dielectric: lanes.dielectric_tint[k],
                sheen: lanes.sheen_tint[k],
            }),
        }
    }

    #[inline(always)]
    fn choices(&self, k: usize) -> Choices<P> {
        Choices {
            main: self.lanes.main[k],
            base: self.lanes.base[k],
            coat: self.lanes.coat[k],
            glass: self.lanes.glass[k],
        }
    }

    #[inline(always)]
    fn put<B: Alpha<Scalar = P>>(&mut self, k: usize, lobe: &PrincipledLobe<P, B>) {
        self.facets.put(k, lobe.microfacet.alpha);
        let (zero, one) = (P::zero(), P::one());
        let coat = lobe.clearcoat.unwrap_or(ClearCoat {
            strength: zero,
            alpha: P::of(0.5),
            ln: -one,
        });
        let tints = lobe.tints.unwrap_or(Tints::none());
        if k == 0 {
            (self.more, self.glass) = (false, false);
        }
        self.more |= lobe.flatness.is_some()
            | lobe.sheen.is_some()
            | lobe.clearcoat.is_some()
            | lobe.tints.is_some();
        self.glass |= lobe.transmission.is_some();
        let lanes = &mut self.lanes;
        lanes.base_color.put_rgb(k, lobe.base_color);
        lanes.roughness[k] = lobe.roughness;
        lanes.metallic[k] = lobe.metallic;
        lanes.eta[k] = lobe.eta;
        lanes.flatness[k] = lobe.flatness.unwrap_or(zero);
        lanes.sheen[k] = lobe.sheen.unwrap_or(zero);
        lanes.strength[k] = coat.strength;
        (lanes.coat_alpha[k], lanes.coat_ln[k]) = (coat.alpha, coat.ln);
        lanes.transmission[k] = lobe.transmission.unwrap_or(zero);
        lanes.hue.put_rgb(k, tints.hue);
        lanes.dielectric_tint[k] = tints.dielectric;
        lanes.sheen_tint[k] = tints.sheen;
        let choices = lobe.primal_choices();
        (lanes.main[k], lanes.base[k]) = (choices.main, choices.base);
        (lanes.coat[k], lanes.glass[k]) = (choices.coat, choices.glass);
    }

    /// The facets that connect both directions.
    #[inline(never)]
    fn connect(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Facet::along(wo, wi, self.lanes.eta[k]).unit();
            self.facets.keep(k, upwards(m), [wo, wi]);
            let zero = P::zero();
            let above = (wo.z > zero) & (wi.z > zero);
            let through = (self.lanes.glass[k] > zero) & (wo.z != zero) & (wi.z != zero);
            of.right[k] = u32::from(right | !(above | through));
        }
    }

    #[inline(never)]
    fn value<const MORE: bool, const GLASS: bool>(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let directions = [of.wo.vec(k), of.wi.vec(k)];
            let (choices, facets) = (self.choices(k), self.facets.facets(k));
            let lobe = self.at::<MORE, GLASS>(k);
            let (f, pdf) = lobe.eval_pdf_where(&choices, &facets, directions);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    /// Where the sampled normals and numbers lead.
    #[inline(never)]
    fn turn<const MORE: bool, const GLASS: bool>(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, m, u) = (of.wo.vec(k), self.facets.normal(k), of.u.vec(k));
            let lobe = self.at::<MORE, GLASS>(k);
            let (wi, eta, goes) = lobe.scatter(&self.choices(k), wo, m, u.to_array());
            // Where nothing goes, nothing is found.
            of.wi.put_vec(k, Vec3::select(goes, wi, Vec3::zero()));
            of.eta[k] = eta;
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float, A: Alpha<Scalar = P>> Members<P> for PrincipledSurfaces<P, A> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: PrincipledLanes::zero(),
            facets: Surfaces::new(),
            more: false,
            glass: false,
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        match material {
            Material::Principled(m) => self.put(k, &m.lobe(read)),
            Material::AnisotropicPrincipled(m) => self.put(k, &m.lobe(read)),
            _ => return false,
        }
        true
    }

    #[inline(always)]
    fn repeat(&mut self, k: usize, earlier: usize) {
        self.lanes.relocate(k, earlier);
        self.facets.repeat(k, earlier);
    }

    #[inline(always)]
    fn eval_pdf(&mut self, n: usize, of: &mut Scattering<P>) {
        if self.glass {
            self.connect(n, of);
            self.value::<true, true>(n, of);
        } else {
            self.facets.reflecting(n, of);
            if self.more {
                self.value::<true, false>(n, of);
            } else {
                self.value::<false, false>(n, of);
            }
        }
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        self.facets.sample(n, of, self.glass);
        if self.glass {
            self.turn::<true, true>(n, of);
        } else if self.more {
            self.turn::<true, false>(n, of);
        } else {
            self.turn::<false, false>(n, of);
        }
        self.eval_pdf(n, of);
    }
}
