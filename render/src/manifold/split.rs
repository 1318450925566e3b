//! Which paths belong to manifold connections.

use super::enumeration::Pieces;
use crate::bsdf::nesting::{Specular, facets};
use crate::bsdf::{DeltaKind, Material};
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::params::Theta;
use crate::scene::{CasterLight, ChainKind, ChainKinds, Connections, Hints, Method, Scene, Seen};
use crate::shape::AnyShape;

/// Where a path is on its way over a chain: how many of its last vertices are casters, since it left a receiver. The default
/// is its start at the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Run(u32);

impl Run {
    /// At the camera.
    const CAMERA: Self = Self(0);
    /// On no chain: from here on everything is ordinary until the next receiver.
    const NONE: Self = Self(1);
    /// At a first vertex whose glints others find ([`crate::glint`]).
    const GLINT: Self = Self(2);
    /// Where the camera sees lights in casters that others are left out of.
    const SEEN: Self = Self(3);
    /// At a caster whose light is left out, whatever lies behind.
    const DARK: Self = Self(4);
    /// At no caster, along deltas alone since the camera, where such paths see lights in casters.
    const ALONG: Self = Self(5);

    /// At a receiver, or behind casters, where this happened. The last event is known once the path has left its vertex, if
    /// it is told ([`Split::leaves`]).
    fn chain(events: ChainKind) -> Self {
        Self(events.0 + 5)
    }

    /// What happened since it left a receiver. `None` on no chain.
    fn events(self) -> Option<ChainKind> {
        self.0.checked_sub(6).map(|n| ChainKind(n + 1))
    }

    /// Behind how many casters, since it left a receiver. `None` on no chain.
    #[inline]
    pub fn behind(self) -> Option<u32> {
        self.events().map(ChainKind::vertices)
    }

    /// At a caster more, on a chain.
    #[inline]
    fn further(self) -> Self {
        self.events()
            .map_or(Self::NONE, |events| Self::chain(events.then(false)))
    }

    /// As a number, for arrays of them.
    #[inline(always)]
    pub fn bits(self) -> u32 {
        self.0
    }

    /// The inverse of [`Run::bits`].
    #[inline(always)]
    pub fn from_bits(bits: u32) -> Self {
        Self(bits)
    }
}

/// The roles of shapes and emitters in manifold connections.
///
/// *Casters* are shapes of metal or glass that are smooth or no rougher than [`Connections::roughness`], *receivers* all others
/// that scatter along more than deltas; the *emitters* are all but those so wide that scattered directions find them better
/// ([`Emitter::is_wide`]). Where the flags of a scene file name any of a kind, only these are ([`Hints`]), and casters may
/// then be as rough, and emitters as wide, as they like. Curves and what is bump-mapped are no casters: the light that they throw is found by paths.
/// Roughness is that of the scene as it is now, whatever derivatives are taken in.
#[derive(Clone, Debug)]
pub struct Split {
    casters: Vec<bool>,
    receivers: Vec<bool>,
    emitters: Vec<bool>,
    /// Emitters whose light over chains there is: those, and wide ones, which paths find.
    shining: Vec<bool>,
    /// Casters that chains begin with, where others are left out.
    begin: Vec<bool>,
    /// Materials that light is refracted by, and not reflected, where others are left out.
    glass: Vec<bool>,
    light: CasterLight,
    /// Chains that are looked for, where not all are.
    kinds: Option<ChainKinds>,
    /// Whether chains are found by paths.
    by_paths: bool,
    /// Whose glints others find.
    glinty: Vec<bool>,
    /// The casters, by index.
    pub(super) caster_list: Vec<u32>,
    /// The emitters.
    pub(super) emitter_list: Vec<u32>,
    /// Whether any caster is rough.
    pub(super) rough: bool,
    bounces: u32,
    fewest: u32,
}

/// Those of `able` that are flagged, or all if none is.
pub(crate) fn chosen(able: Vec<bool>, flagged: impl Fn(usize) -> bool) -> Vec<bool> {
    let any = (0..able.len()).any(|i| able[i] && flagged(i));
    let each = able.iter().enumerate();
    each.map(|(i, &able)| able && (!any || flagged(i)))
        .collect()
}

/// Whether hints name what takes part in connections like these.
fn takes_part(connections: &Connections) -> impl Fn(Hints) -> bool + Copy + use<> {
    let single = connections.longest() == 1;
    move |hints| hints.single || (hints.multi && !single)
}

/// The roughness of each shape that can be a caster.
fn alphas(scene: &Scene) -> Vec<Option<f32>> {
    let theta = Theta::<f32>::constant(scene.params().values());
    let alpha = |(i, shape): (u32, &AnyShape)| {
        if matches!(shape, AnyShape::Curves(_)) {
            return None;
        }
        let roughness = facets(scene.material(i))?.roughness;
        Some(roughness.map_or(0.0, |r| r.everywhere(&theta).alpha))
    };
    (0..).zip(scene.shapes()).map(alpha).collect()
}

fn list(these: &[bool]) -> Vec<u32> {
    let all = these.iter().zip(0..);
    all.filter_map(|(&yes, i)| yes.then_some(i)).collect()
}

impl Split {
    /// The roles in a scene. `None` if there is nothing to connect: no caster, no receiver or no emitter.
    pub fn of(scene: &Scene, connections: &Connections) -> Option<Self> {
        let takes_part = takes_part(connections);
        let shapes = 0..scene.shapes().len() as u32;
        let info = |shape: u32| scene.shape_info(shape);
        let alpha = alphas(scene);
        let flagged = |i: u32| takes_part(info(i).hints);
        // In the precision of parameters, so that equal is no more than.
        let most = connections.roughness as f32;
        let casts = shapes
            .clone()
            .map(|i| alpha[i as usize].is_some_and(|alpha| alpha <= most || flagged(i)));
        let casters = chosen(casts.collect(), |i| flagged(i as u32));
        let rough = (shapes.clone().zip(&casters))
            .any(|(i, casts)| *casts && alpha[i as usize].is_some_and(|alpha| alpha > 0.0));
        let scatters = (shapes.zip(&casters)).map(|(i, casts)| !casts && !info(i).delta);
        let receivers = chosen(scatters.collect(), |i| info(i as u32).hints.receiver);
        let named = |i: usize| takes_part(scene.emitter_hints()[i]);
        let connected = |(i, e): (usize, &AnyEmitter)| !e.is_beam() && (named(i) || !e.is_wide());
        let able = (scene.emitters().iter().enumerate()).map(connected);
        let emitters = chosen(able.collect(), named);
        let shining = chosen(vec![true; emitters.len()], named);
        let (caster_list, emitter_list) = (list(&casters), list(&emitters));
        let chains = !emitter_list.is_empty() && receivers.contains(&true);
        let any = chains || connections.light != CasterLight::All;
        let begins = (casters.iter().zip(0..)).map(|(&casts, i)| casts && !info(i).hints.bouncer);
        (any && !caster_list.is_empty()).then_some(Self {
            begin: begins.collect(),
            casters,
            receivers,
            emitters,
            shining,
            glass: scene.materials().iter().map(|m| refracts(m)).collect(),
            light: connections.light,
            kinds: connections.kinds,
            by_paths: connections.method == Method::Paths,
            glinty: Vec::new(),
            caster_list,
            emitter_list,
            rough,
            bounces: connections.longest(),
            fewest: connections.shortest(),
        })
    }

    /// The shapes that are flagged as casters and can be none, by index: their light is found by paths.
    pub fn unheeded(scene: &Scene, connections: &Connections) -> Vec<u32> {
        let takes_part = takes_part(connections);
        let each = (0..).zip(alphas(scene));
        let unheeded = |(i, alpha): (u32, Option<f32>)| {
            (alpha.is_none() && takes_part(scene.shape_info(i).hints)).then_some(i)
        };
        each.filter_map(unheeded).collect()
    }

    /// The same, or one without casters, where glints on these shapes are found by others, too. `None` if there is neither.
    pub fn with_glints(split: Option<Self>, glinty: Option<Vec<bool>>) -> Option<Self> {
        let Some(glinty) = glinty else {
            return split;
        };
        let none = || Self {
            casters: vec![false; glinty.len()],
            receivers: vec![false; glinty.len()],
            emitters: Vec::new(),
            shining: Vec::new(),
            begin: Vec::new(),
            glass: Vec::new(),
            light: CasterLight::All,
            kinds: None,
            by_paths: false,
            glinty: Vec::new(),
            caster_list: Vec::new(),
            emitter_list: Vec::new(),
            rough: false,
            bounces: 1,
            fewest: 1,
        };
        let split = split.unwrap_or_else(none);
        Some(Self { glinty, ..split })
    }

    /// Whether there is anything to connect.
    pub fn connects(&self) -> bool {
        !self.emitter_list.is_empty()
    }

    /// The shapes whose glints others find, by index; empty if there are none.
    pub fn glinty(&self) -> &[bool] {
        &self.glinty
    }

    /// Whether chains may have vertices on this shape.
    #[inline]
    pub fn is_caster(&self, shape: u32) -> bool {
        self.casters[shape as usize]
    }

    /// Whether chains start on this shape.
    #[inline]
    pub fn is_receiver(&self, shape: u32) -> bool {
        self.receivers[shape as usize]
    }

    /// Longest chain.
    pub fn bounces(&self) -> u32 {
        self.bounces
    }

    /// A path arrives at a shape; `along_delta`: the edge that it came by left its vertex along a Dirac delta.
    ///
    /// A chain starts at a receiver that is left otherwise than along a delta, and has one to [`Split::bounces`] casters.
    #[inline]
    pub fn next(&self, run: Run, shape: u32, along_delta: bool) -> Run {
        if run == Run::CAMERA && self.glinty.get(shape as usize) == Some(&true) {
            return Run::GLINT;
        }
        if self.is_caster(shape) {
            match run.behind() {
                Some(0) if along_delta || !self.begins(shape) => self.off(run, along_delta),
                Some(n) if n < self.bounces => run.further(),
                _ => self.off(run, along_delta),
            }
        } else if self.is_receiver(shape) {
            Run::chain(ChainKind::NONE)
        } else if self.sees(run, along_delta) {
            Run::ALONG
        } else {
            Run::NONE
        }
    }

    /// At a caster, off all chains.
    fn off(&self, run: Run, along_delta: bool) -> Run {
        match self.light {
            CasterLight::All => Run::NONE,
            CasterLight::Published(Seen::Directly) if run == Run::CAMERA => Run::SEEN,
            CasterLight::Published(_) if self.sees(run, along_delta) => Run::SEEN,
            CasterLight::Published(_) => Run::DARK,
        }
    }

    /// Whether a path comes from the camera along deltas alone, where that matters.
    fn sees(&self, run: Run, along_delta: bool) -> bool {
        self.light == CasterLight::Published(Seen::AlongDeltas)
            && along_delta
            && [Run::CAMERA, Run::SEEN, Run::ALONG].contains(&run)
    }

    /// Whether [`Split::leaves`] has anything to say.
    #[inline(always)]
    pub fn selects(&self) -> bool {
        self.kinds.is_some() || self.is_published()
    }

    /// Whether some light over casters is left out.
    #[inline(always)]
    pub(super) fn is_published(&self) -> bool {
        self.light != CasterLight::All
    }

    /// Whether a vertex may reflect, and refract, after these of a chain that is looked for.
    pub(super) fn goes_on(&self, events: ChainKind) -> [bool; 2] {
        let begins = |refracts: bool| {
            let further = |kinds: &ChainKinds| kinds.begins(events.then(refracts));
            (refracts || !self.is_published()) && self.kinds.as_ref().is_none_or(further)
        };
        [begins(false), begins(true)]
    }

    /// Whether chains are looked for on which this happens.
    #[inline]
    fn asks_for(&self, events: ChainKind) -> bool {
        self.kinds
            .as_ref()
            .is_none_or(|kinds| kinds.contains(events))
    }

    /// A path leaves a vertex of a material, by reflection or not: light behind it may be left out for that.
    #[inline]
    pub fn leaves(&self, run: Run, material: u32, along_delta: bool, reflects: bool) -> Run {
        let run = match run.events() {
            Some(events) if self.kinds.is_some() && !reflects && events != ChainKind::NONE => {
                Run::chain(events.refracted())
            }
            _ => run,
        };
        let CasterLight::Published(seen) = self.light else {
            return run;
        };
        let dark = match run.behind() {
            Some(0) => false,
            Some(_) => reflects == self.glass[material as usize],
            None => run == Run::SEEN && seen == Seen::AlongDeltas && !along_delta,
        };
        if dark { Run::DARK } else { run }
    }

    /// Whether a chain may begin with this caster.
    #[inline]
    fn begins(&self, shape: u32) -> bool {
        !self.is_published() || self.begin[shape as usize]
    }

    /// Fewest vertices of a chain.
    pub fn fewest(&self) -> u32 {
        self.fewest
    }

    /// Whether connections look for chains of these vertices, shapes and materials with what happens there, from the receiver on.
    pub(super) fn takes(
        &self,
        like: impl ExactSizeIterator<Item = (u32, u32, DeltaKind)> + Clone,
    ) -> bool {
        if let Some(kinds) = &self.kinds {
            let refracts = |kind: DeltaKind| kind == DeltaKind::Transmission;
            let then = |e: ChainKind, (_, _, kind)| e.then(refracts(kind));
            if !kinds.contains(like.clone().fold(ChainKind::NONE, then)) {
                return false;
            }
        }
        if !self.is_published() {
            return true;
        }
        let whole = like.len() as u32 == self.bounces;
        let right = |(i, (shape, material, kind)): (usize, (u32, u32, DeltaKind))| {
            let reflects = kind == DeltaKind::Reflection;
            (i > 0 || self.begins(shape)) && reflects != self.glass[material as usize]
        };
        whole && like.enumerate().all(right)
    }

    /// Whether a particle from an emitter stays on a chain at a shape behind so many casters: [`Split::next`] from the other end.
    pub fn takes_particle(&self, casters: u32, shape: u32) -> bool {
        self.is_caster(shape) && casters < self.bounces
    }

    /// [`Split::leaves`] for a particle: whether it stays on a chain.
    pub fn keeps_particle(&self, material: u32, reflects: bool) -> bool {
        !self.is_published() || reflects != self.glass[material as usize]
    }

    /// Whether a particle ends a chain that lands on a receiver after these events, seen from there, the first of which was at the caster
    /// `last`.
    pub fn lands(&self, events: ChainKind, last: u32, shape: u32) -> bool {
        let whole = events.vertices() >= self.fewest() && self.asks_for(events);
        whole && self.begins(last) && self.is_receiver(shape)
    }

    /// Whether light of this emitter is found over chains.
    pub fn is_connected(&self, emitter: u32) -> bool {
        self.emitters[emitter as usize]
    }

    /// Whether the method finds all light that it takes from others: for [`Method::MneeUnbiased`] paths have to meet lights, and for
    /// [`Method::Complete`] chains have one vertex, on surfaces that [`Pieces`] covers.
    ///
    /// # Errors
    /// Names the parameter of the first emitter without a size, or the first shape that is not covered.
    pub fn admits(&self, scene: &Scene, method: Method) -> Result<(), RenderError> {
        match method {
            Method::Complete => self.is_covered(scene),
            Method::MneeUnbiased => self.meets_lights(scene),
            _ => Ok(()),
        }
    }

    fn is_covered(&self, scene: &Scene) -> Result<(), RenderError> {
        let refused = |what: String| Err(RenderError::Connections { what });
        if self.bounces > 1 {
            return refused(format!(
                "`complete`: finds chains of one vertex, expected `--bounces 1`; found {}",
                self.bounces
            ));
        }
        let uncovered = |&shape: &u32| Some((shape, Pieces::covers(scene, shape).err()?));
        match self.caster_list.iter().find_map(uncovered) {
            None => Ok(()),
            Some((shape, what)) => refused(format!(
                "`complete`: shape `{}`: does not cover {what}; expected `sms`",
                scene.shape_info(shape).name
            )),
        }
    }

    fn meets_lights(&self, scene: &Scene) -> Result<(), RenderError> {
        let mut emitters = (self.emitter_list.iter()).map(|&e| &scene.emitters()[e as usize]);
        let Some(unmet) = emitters.find(|e| e.is_delta()) else {
            return Ok(());
        };
        let mut name = "";
        unmet.visit_params(&mut |p| name = &scene.params().infos()[p.id as usize].name);
        Err(RenderError::Connections {
            what: format!(
                "`mnee-unbiased`: paths never meet the light of `{name}`, which has no size; expected `sms`, or `mnee`"
            ),
        })
    }

    /// Whether paths may sample a light that belongs to connections: at casters that are rough.
    #[inline(always)]
    pub fn is_rough(&self) -> bool {
        self.rough
    }

    /// Whether light that a path meets there, or samples from there, is that of a whole chain, which connections find.
    #[inline]
    pub fn finds(&self, run: Run, emitter: u32) -> bool {
        let asked = |events: ChainKind| events.vertices() >= self.fewest() && self.asks_for(events);
        let whole = run.events().is_some_and(asked);
        whole && self.emitters[emitter as usize] && !self.by_paths
    }

    /// Whether paths leave such light out: other integrals find that of chains and glints, and some is left out on purpose.
    #[inline]
    pub fn excludes(&self, run: Run, emitter: u32) -> bool {
        match run.behind() {
            Some(0) => false,
            Some(_) if !self.is_published() => self.finds(run, emitter),
            Some(n) => {
                n < self.bounces || !self.shining[emitter as usize] || self.finds(run, emitter)
            }
            None => run == Run::GLINT || run == Run::DARK,
        }
    }
}

/// Whether a material is glass.
pub(super) fn refracts(material: &Material) -> bool {
    matches!(
        facets(material).map(|f| f.specular),
        Some(Specular::Interface(_))
    )
}
