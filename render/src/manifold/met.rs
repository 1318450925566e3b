//! Chains that paths went by themselves, and whether one walk finds them, too.

use ad_core::Vec3;

use super::chain::{Event, Events};
use super::connector::{Connector, Facets, Light, Link, Statistics};
use super::normal::Normal;
use super::space::{Start, Target};
use super::walk::Seed;
use crate::bsdf::nesting::{Specular, facets};
use crate::bsdf::{Bsdf, DeltaKind, Shading, TransportMode};
use crate::emitter::Emission;
use crate::math::NOWHERE;
use crate::scene::Method;
use crate::shape::SurfaceInteraction;

/// A chain that a path went from a receiver to a light.
#[derive(Clone, Copy, Debug)]
pub struct Met<'p> {
    /// The receiver.
    pub start: &'p Start,
    /// The chain, from there on; densities are not looked at.
    pub links: &'p [Link],
    /// Most vertices that a chain may have here.
    pub most: u32,
    /// Index of the emitter that the last edge met.
    pub emitter: u32,
    /// Where: the primitive and the point. `None` infinitely far away.
    pub end: Option<(u32, SurfaceInteraction<f64>)>,
}

impl Connector<'_> {
    /// Whether light counts that paths meet over chains which walks miss.
    pub fn counts_missed(&self) -> bool {
        self.options.method == Method::MneeUnbiased
    }

    /// Whether connections by [`Method::Mnee`] from the start of a chain to the point of the light that it ends
    /// at are this very chain. On rough surfaces facets are those that the path was scattered by. False, too, where the
    /// path is no solution in double precision.
    ///
    /// The answer is a function of the path alone. So the light of paths for which it says no, and that of connections, add up to
    /// all light: every chain is counted by one of them [Hanika et al. 2015].
    pub fn finds(&self, met: &Met) -> bool {
        let Some(last) = met.links.last() else {
            return false;
        };
        let events: Option<Events> = met.links.iter().map(|link| self.event_of(link)).collect();
        let Some(events) = events else {
            return false;
        };
        let onward = last.si.frame.to_world(last.wi);
        let target = match &met.end {
            Some((_, si)) => Target::Point(si.p),
            None => Target::Direction(onward),
        };
        let light = Light {
            emitter: met.emitter,
            target,
            surface: met.end.map(|(_, si)| si),
            number: (met.end).map_or(NOWHERE, |(prim, _)| self.space.scene.exit(prim).surface),
            pdf: 1.0,
            emission: Emission::whole(),
        };
        let facets = Facets::Of(&events);
        let estimate = self.estimate_over(met.start, &light.target, met.most, facets);
        let mut ignored = Statistics::default();
        let same = |v: &Event, e: &Event| v.shape == e.shape && v.kind == e.kind;
        let mut own = None;
        self.deterministic_starts(&estimate)
            .into_iter()
            .any(|seed| {
                let alike = seed.like.len() == events.len()
                    && seed.like.iter().zip(&events).all(|(v, e)| same(v, e));
                if !alike {
                    return false;
                }
                let Some(found) = self.walk(&estimate, seed, &mut ignored) else {
                    return false;
                };
                // The path is a root but for rounding; a walk from there takes that away.
                let own = own.get_or_insert_with(|| {
                    let d = (met.links[0].si.p - met.start.si.p).normalize();
                    let like = events.clone();
                    self.walk(&estimate, Seed { d, like }, &mut Statistics::default())
                });
                own.as_ref()
                    .is_some_and(|own| found.is(own, self.options.uniqueness))
                    && self.worth(&found, &light).is_some()
            })
    }

    /// What happened at a vertex of a path. `None` where no facet scatters like that.
    fn event_of(&self, link: &Link) -> Option<Event> {
        let (scene, theta) = (self.space.scene, self.space.theta);
        let material = scene.material(link.shape);
        let surface = facets(material)?;
        let event = |normal| Event {
            shape: link.shape,
            kind: link.kind,
            normal,
        };
        if surface.roughness.is_none() {
            return Some(event(Normal::Own));
        }
        let at = Shading::new(theta, link.si.uv);
        let frame = material.shading_frame(&at, link.wo, 0, TransportMode::Radiance);
        let [wo, wi] = [link.wo, link.wi].map(|w| frame.to_local(w));
        let half: Vec3<f64> = match (surface.specular, link.kind) {
            (Specular::Interface(eta), DeltaKind::Transmission) => {
                // The index on the side of `wi` over that on the other.
                let eta = eta.scalar(&theta, link.si.uv);
                let across = if wo.z < 0.0 { eta.recip() } else { eta };
                wo + wi * across
            }
            _ => wo + wi,
        };
        let m = half.normalize();
        let m = if m.z < 0.0 { -m } else { m };
        m.is_finite().then(|| event(Normal::Facet(m)))
    }
}
