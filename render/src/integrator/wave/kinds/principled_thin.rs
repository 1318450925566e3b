//! Principled materials without an inside.

use ad_core::{Float, Vec3};

use super::super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::super::readings::Reading;
use super::facets::{Ggx, Surfaces};
use super::{CONTINUOUS, Members, Scattering};
use crate::bsdf::microfacet::{Alpha, Microfacet, Ndf};
use crate::bsdf::{
    Leaf, Material, Pane, PrincipledThinLobe, Sides, ThinShares, Tints, above, reflect,
};
use crate::math::warp;

lanes! {
    /// Thin principled materials. What there is none of is zero, or changes nothing.
    ThinLanes {
        base_color: Lanes<P>,
        roughness: Lane<P>,
        /// Of the pane, and the roughness of what it reflects and of what passes, along both axes.
        share: Lane<P>,
        eta: Lane<P>,
        reflecting_along: Lane<P>,
        reflecting_across: Lane<P>,
        passing_along: Lane<P>,
        passing_across: Lane<P>,
        diff_trans: Lane<P>,
        flatness: Lane<P>,
        sheen: Lane<P>,
        hue: Lanes<P>,
        dielectric_tint: Lane<P>,
        sheen_tint: Lane<P>,
        /// [`ThinShares`].
        reflects: Lane<P>,
        passes: Lane<P>,
        base: Lane<P>,
        through: Lane<P>,
    }
}

/// Thin principled materials. A loop does what any of those that are there has; of all, few have most.
pub struct ThinSurfaces<P, A> {
    lanes: ThinLanes<P>,
    /// Those of the panes, on the side that is asked for.
    facets: Surfaces<P, A, Ggx>,
    /// Whether any has more than diffuse reflection and transmission.
    more: bool,
    /// Whether any has a pane.
    panes: bool,
}

impl<P: Float, A: Alpha<Scalar = P>> ThinSurfaces<P, A> {
    /// Roughness of what is reflected or passes.
    #[inline(always)]
    fn alpha(&self, k: usize, passes: bool) -> A {
        let lanes = &self.lanes;
        let along = P::select(passes, lanes.passing_along[k], lanes.reflecting_along[k]);
        let across = P::select(passes, lanes.passing_across[k], lanes.reflecting_across[k]);
        A::along([along, across])
    }

    #[inline(always)]
    fn surface(&self, k: usize, passes: bool) -> Microfacet<A> {
        Microfacet {
            kind: Ndf::Ggx,
            alpha: self.alpha(k, passes),
            visible: true,
        }
    }

    #[inline(always)]
    fn at<const MORE: bool, const PANES: bool>(&self, k: usize) -> PrincipledThinLobe<P, A> {
        let lanes = &self.lanes;
        let more = |lane: &Lane<P>| if MORE { Some(lane[k]) } else { None };
        PrincipledThinLobe {
            base_color: lanes.base_color.rgb(k),
            roughness: lanes.roughness[k],
            pane: PANES.then_some(Pane {
                share: lanes.share[k],
                eta: lanes.eta[k],
                reflecting: self.surface(k, false),
                transmitting: self.surface(k, true),
            }),
            diff_trans: Some(lanes.diff_trans[k]),
            flatness: more(&lanes.flatness),
            sheen: more(&lanes.sheen),
            tints: MORE.then_some(Tints {
                hue: lanes.hue.rgb(k),
                dielectric: lanes.dielectric_tint[k],
                sheen: lanes.sheen_tint[k],
            }),
        }
    }

    #[inline(always)]
    fn shares(&self, k: usize) -> ThinShares<P> {
        let lanes = &self.lanes;
        ThinShares([
            lanes.reflects[k],
            lanes.passes[k],
            lanes.base[k],
            lanes.through[k],
        ])
    }

    #[inline(always)]
    fn put<B: Alpha<Scalar = P>>(&mut self, k: usize, lobe: &PrincipledThinLobe<P, B>) {
        let (zero, one) = (P::zero(), P::one());
        let half = [P::of(0.5); 2];
        let (share, eta, reflecting, passing) = match &lobe.pane {
            Some(pane) => (
                pane.share,
                pane.eta,
                pane.reflecting.alpha.axes(),
                pane.transmitting.alpha.axes(),
            ),
            None => (zero, one, half, half),
        };
        let tints = lobe.tints.unwrap_or(Tints::none());
        if k == 0 {
            (self.more, self.panes) = (false, false);
        }
        self.more |= lobe.flatness.is_some() | lobe.sheen.is_some() | lobe.tints.is_some();
        self.panes |= lobe.pane.is_some();
        let lanes = &mut self.lanes;
        lanes.base_color.put_rgb(k, lobe.base_color);
        lanes.roughness[k] = lobe.roughness;
        (lanes.share[k], lanes.eta[k]) = (share, eta);
        [lanes.reflecting_along[k], lanes.reflecting_across[k]] = reflecting;
        [lanes.passing_along[k], lanes.passing_across[k]] = passing;
        lanes.diff_trans[k] = lobe.diff_trans.unwrap_or(zero);
        lanes.flatness[k] = lobe.flatness.unwrap_or(zero);
        lanes.sheen[k] = lobe.sheen.unwrap_or(zero);
        lanes.hue.put_rgb(k, tints.hue);
        lanes.dielectric_tint[k] = tints.dielectric;
        lanes.sheen_tint[k] = tints.sheen;
        let ThinShares([reflects, passes, base, through]) = lobe.primal_shares();
        (lanes.reflects[k], lanes.passes[k]) = (reflects, passes);
        (lanes.base[k], lanes.through[k]) = (base, through);
    }

    /// The facets between both directions.
    #[inline(never)]
    fn connect<const PANES: bool>(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (m, right) = Sides::along(wo, wi).unit();
            let (sides, scatters) = Sides::with(m, wo, wi);
            if PANES {
                self.facets.put(k, self.alpha(k, sides.passes));
                self.facets.keep(k, m, sides.directions);
            } else {
                self.facets.put_normal(k, m);
            }
            of.right[k] = u32::from(right | !scatters);
        }
    }

    #[inline(never)]
    fn value<const MORE: bool, const PANES: bool>(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, wi) = (of.wo.vec(k), of.wi.vec(k));
            let (sides, scatters) = Sides::with(self.facets.normal(k), wo, wi);
            let facets = self.facets.facets(k);
            let lobe = self.at::<MORE, PANES>(k);
            let facets = if PANES { Some(&facets) } else { None };
            let (f, pdf) = lobe.eval_pdf_where(&self.shares(k), (&sides, scatters), facets);
            of.f.put_rgb(k, f);
            of.pdf[k] = pdf;
        }
    }

    /// Facets of the panes, on the chosen side.
    #[inline(never)]
    fn draw(&mut self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k));
            let part = self.shares(k).choose(u.x);
            let surface = self.surface(k, part.passes);
            let (m, right) = surface.sample_visible_in_line(above(wo), [u.y, u.z]);
            self.facets.put_normal(k, m);
            of.sampled[k] = u32::from(right | !part.of_facets);
        }
    }

    /// Where the sampled normals and numbers lead.
    #[inline(never)]
    fn turn<const PANES: bool>(&self, n: usize, of: &mut Scattering<P>) {
        for k in 0..whole(n) {
            let (wo, u) = (of.wo.vec(k), of.u.vec(k));
            let part = self.shares(k).choose(u.x);
            let mut on_side = warp::square_to_cosine_hemisphere([u.y, u.z]);
            if PANES {
                let reflected = reflect(above(wo), self.facets.normal(k));
                on_side = Vec3::select(part.of_facets, reflected, on_side);
            } else {
                of.sampled[k] = 1;
            }
            let (wi, goes) = part.turned(wo, on_side);
            // Where nothing goes, nothing is found.
            of.wi.put_vec(k, Vec3::select(goes, wi, Vec3::zero()));
            of.eta[k] = P::one();
            of.component[k] = CONTINUOUS;
        }
    }
}

impl<P: Float, A: Alpha<Scalar = P>> Members<P> for ThinSurfaces<P, A> {
    const CONNECTS: bool = true;

    fn new() -> Self {
        Self {
            lanes: ThinLanes::zero(),
            facets: Surfaces::new(),
            more: false,
            panes: false,
        }
    }

    #[inline(always)]
    fn gather(&mut self, k: usize, material: &Material, read: &mut Reading<P>) -> bool {
        match material {
            Material::PrincipledThin(m) => self.put(k, &m.lobe(read)),
            Material::AnisotropicThin(m) => self.put(k, &m.lobe(read)),
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
        if self.panes {
            self.connect::<true>(n, of);
            self.value::<true, true>(n, of);
        } else {
            self.connect::<false>(n, of);
            if self.more {
                self.value::<true, false>(n, of);
            } else {
                self.value::<false, false>(n, of);
            }
        }
    }

    #[inline(always)]
    fn sample(&mut self, n: usize, of: &mut Scattering<P>) {
        if self.panes {
            self.draw(n, of);
            self.turn::<true>(n, of);
        } else {
            self.turn::<false>(n, of);
        }
        self.eval_pdf(n, of);
    }
}
