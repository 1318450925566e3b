//! What is differentiated, and who reads it.

use std::sync::Arc;

use ad_core::Real;

use super::local::ActiveTexture;
use super::noise::Watch;
use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::estimator::{self, DetachedMis, Strategy};
use crate::params::{ParamInfo, ParamRef, Theta};
use crate::scene::Scene;

/// Ranges of up to this many values are summed in f64 per job; larger ones share one exact buffer.
const SMALL: usize = 256;

/// Parameters to differentiate with respect to, and who reads them.
#[derive(Clone, Debug)]
pub struct Active {
    /// Names and places, in the order asked for.
    pub(super) ranges: Vec<ParamInfo>,
    /// Per range of the layout: where its gradient goes.
    pub(super) slots: Vec<Slot>,
    /// Per range of the layout: its place in the values of all ranges, one after another.
    places: Vec<Option<u32>>,
    /// Per material: what of it reads one.
    textures: Vec<Vec<ActiveTexture>>,
    /// Per material: whether its roughness reads one.
    roughness: Vec<bool>,
    emitters: Vec<bool>,
    /// Whether any emitter does.
    emission: bool,
    /// Per emitter: where the adjoints of the sums go that its samples are made of. Empty unless samples of
    /// emitters move.
    pub(super) sums: Vec<Option<SumSlot>>,
    /// Per range of the layout: its number among those asked for, and its scale. Empty unless the noise is asked for.
    pub(super) scales: Vec<(usize, f64)>,
    pub(super) small_len: usize,
    pub(super) large_len: usize,
    /// Per shape, per emitter: whether one moves it. Empty if none moves anything.
    moving_shapes: Vec<bool>,
    moving_emitters: Vec<bool>,
    moving_camera: bool,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Slot {
    Inactive,
    Small(u32),
    Large(u32),
}

/// Room for the adjoints of the sums of an emitter.
#[derive(Clone, Copy, Debug)]
pub(super) struct SumSlot {
    /// All but the last one, which every sample depends on: that is summed in f64.
    pub slot: Slot,
    pub last: u32,
    pub len: usize,
}

impl Active {
    /// The named parameters of a scene.
    ///
    /// # Errors
    /// An unknown name, or a parameter whose derivative detached sampling cannot see, or what moves in a scene where that
    /// has none ([`Scene::admits_motion`]).
    pub fn new<N: AsRef<str>>(scene: &Scene, names: &[N]) -> Result<Self, RenderError> {
        Self::seen_by::<DetachedMis, N>(scene, names)
    }

    /// The same for another estimator: a path that moves has derivatives in deltas too.
    ///
    /// # Errors
    /// As [`Active::new`], for what this estimator cannot see.
    pub fn seen_by<S: Strategy, N: AsRef<str>>(
        scene: &Scene,
        names: &[N],
    ) -> Result<Self, RenderError> {
        let found = names.iter().map(|name| {
            let info = scene.params().find(name.as_ref())?;
            estimator::check_parameter::<S>(info)?;
            scene.admits_motion::<S>(info)?;
            Ok(info)
        });
        Ok(Self::of(scene, &found.collect::<Result<Vec<_>, _>>()?))
    }

    /// Those that move along the directions of derivative images.
    pub(super) fn moving<R: Real>(scene: &Scene, theta: &Theta<R>) -> Self {
        let params = scene.params();
        let moves = |info: &&ParamInfo| theta.moves(params.handle(info));
        let moving: Vec<_> = params.infos().iter().filter(moves).collect();
        Self::of(scene, &moving)
    }

    /// These parameters, each once.
    pub(crate) fn of(scene: &Scene, infos: &[&ParamInfo]) -> Self {
        let params = scene.params();
        let mut slots = vec![Slot::Inactive; params.infos().len()];
        let mut ranges: Vec<ParamInfo> = Vec::new();
        let mut places = vec![None; slots.len()];
        let (mut small_len, mut large_len) = (0, 0);
        for &info in infos {
            if ranges.iter().any(|r| r.name == info.name) {
                continue;
            }
            let len = info.shape.len();
            let id = params.handle(info).id as usize;
            places[id] = Some((small_len + large_len) as u32);
            slots[id] = if len <= SMALL {
                small_len += len;
                Slot::Small((small_len - len) as u32)
            } else {
                large_len += len;
                Slot::Large((large_len - len) as u32)
            };
            ranges.push(info.clone());
        }
        let on = |p: ParamRef| !matches!(slots[p.id as usize], Slot::Inactive);
        let textures = (scene.materials().iter()).map(|m| ActiveTexture::of(m, on));
        let textures = textures.collect();
        let rough = |m: &Arc<Material>| {
            let mut any = false;
            m.visit_textures(&mut |t| any |= matches!(t, TextureRef::Alpha(t) if t.any_param(on)));
            any
        };
        let roughness = scene.materials().iter().map(rough).collect();
        let emitters: Vec<bool> = scene
            .emitters()
            .iter()
            .map(|e| {
                let mut any = false;
                e.visit_params(&mut |p| any |= on(p));
                any
            })
            .collect();
        let moves = ranges.iter().any(|r| r.kind.is_motion());
        let mut moving_shapes = vec![false; if moves { scene.shapes().len() } else { 0 }];
        let mut moving_emitters = Vec::new();
        if moves {
            for &(shape, p) in scene.movers() {
                moving_shapes[shape as usize] |= on(p);
            }
            let each = scene.emitters().iter();
            moving_emitters.extend(each.map(|e| e.moved_by().is_some_and(on)));
        }
        let moving_camera = moves && scene.camera.depends_on(on);
        Self {
            moving_shapes,
            moving_emitters,
            moving_camera,
            ranges,
            slots,
            places,
            textures,
            roughness,
            emission: emitters.contains(&true),
            emitters,
            sums: Vec::new(),
            scales: Vec::new(),
            small_len,
            large_len,
        }
    }

    /// The same, and gradient passes tell their noise ([`super::gradient::Gradient::noise`]): derivatives in range `i` of
    /// [`Active::ranges`] are multiplied by `scales[i]`, and by one beyond its end.
    #[must_use]
    pub fn with_noise(mut self, scene: &Scene, scales: &[f64]) -> Self {
        self.scales = vec![(0, 0.0); self.slots.len()];
        for (i, r) in self.ranges.iter().enumerate() {
            let id = scene.params().handle(r).id as usize;
            self.scales[id] = (i, scales.get(i).copied().unwrap_or(1.0));
        }
        self
    }

    /// Sums for the noise of derivatives in these, if that is asked for.
    pub(super) fn watch(&self) -> Option<Watch> {
        if self.scales.is_empty() {
            return None;
        }
        let mut range = vec![0; self.small_len];
        for (slot, &(i, _)) in self.slots.iter().zip(&self.scales) {
            if let Slot::Small(at) = *slot {
                let len = self.ranges[i].shape.len();
                range[at as usize..][..len].fill(i as u32);
            }
        }
        Some(Watch::new(self.ranges.len(), range))
    }

    /// The same with room for the sums that moving samples of emitters are made of.
    pub(super) fn with_sums(mut self, scene: &Scene) -> Self {
        let each = |e: &AnyEmitter| {
            let map = e.moving()?;
            let len = map.sums();
            let last = self.small_len as u32;
            self.small_len += 1;
            // Added up as the texels are.
            let slot = match self.slots[map.texels().id as usize] {
                Slot::Inactive => return None,
                Slot::Small(_) => {
                    self.small_len += len - 1;
                    Slot::Small(last + 1)
                }
                Slot::Large(_) => {
                    self.large_len += len - 1;
                    Slot::Large((self.large_len - (len - 1)) as u32)
                }
            };
            Some(SumSlot { slot, last, len })
        };
        self.sums = scene.emitters().iter().map(each).collect();
        self
    }

    /// The ranges, in the order asked for.
    pub fn ranges(&self) -> &[ParamInfo] {
        &self.ranges
    }

    /// What of a material reads one of them: a vertex where nothing does takes primal work only.
    #[inline]
    pub(super) fn textures(&self, material: u32) -> &[ActiveTexture] {
        &self.textures[material as usize]
    }

    /// Whether anything of a material does.
    #[inline]
    pub(super) fn differentiates(&self, material: u32) -> bool {
        !self.textures(material).is_empty()
    }

    /// Whether its roughness does.
    #[inline]
    pub(super) fn differentiates_roughness(&self, material: u32) -> bool {
        self.roughness[material as usize]
    }

    /// Whether an emitter does.
    #[inline]
    pub(super) fn emitter_active(&self, emitter: u32) -> bool {
        self.emitters[emitter as usize]
    }

    /// Whether any emitter does.
    #[inline]
    pub(super) fn differentiates_emission(&self) -> bool {
        self.emission
    }

    /// Whether one of them moves something.
    pub(super) fn moves(&self) -> bool {
        !self.moving_shapes.is_empty() || self.ranges.iter().any(|r| r.kind.is_motion())
    }

    /// Whether one of them does anything else, or there are none.
    pub(super) fn rests(&self) -> bool {
        self.ranges.is_empty() || self.ranges.iter().any(|r| !r.kind.is_motion())
    }

    /// Whether one of them moves a shape.
    #[inline]
    pub(super) fn moves_shape(&self, shape: u32) -> bool {
        self.moving_shapes.get(shape as usize) == Some(&true)
    }

    /// Whether one of them moves an emitter that is no shape.
    #[inline]
    pub(super) fn moves_emitter(&self, emitter: u32) -> bool {
        self.moving_emitters.get(emitter as usize) == Some(&true)
    }

    /// Whether one of them moves the camera.
    #[inline]
    pub(super) fn moves_camera(&self) -> bool {
        self.moving_camera
    }

    /// Whether strategy `S` has terms for all that moves.
    ///
    /// # Errors
    /// Names the parameter that it has none for.
    pub(super) fn check_motion<S: Strategy>(&self) -> Result<(), RenderError> {
        let moving = self.ranges.iter().filter(|r| r.kind.is_motion());
        moving
            .into_iter()
            .try_for_each(estimator::check_parameter::<S>)
    }

    /// Whether the range is one of them.
    #[inline]
    pub(super) fn contains(&self, p: ParamRef) -> bool {
        self.place(p).is_some()
    }

    /// The first element of a range among the values of all ranges in the order asked for.
    #[inline]
    pub(super) fn place(&self, p: ParamRef) -> Option<usize> {
        self.places[p.id as usize].map(|at| at as usize)
    }

    /// Number of values.
    pub fn len(&self) -> usize {
        self.small_len + self.large_len
    }

    /// Whether there is nothing to differentiate.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }
}
