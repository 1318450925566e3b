//! What an estimator can do, and what it refuses: read from its type, in one place, for all that list or judge
//! estimators.

use std::fmt;

use super::memory::Memory;
use super::{Direct, Sampling, Strategy, goes_in_waves, is_guided};
use crate::params::ParamKind;

/// What a [`Strategy`] can do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capabilities {
    /// How scattered directions follow the parameters.
    pub motion: Motion,
    /// Whether the derivative of rough materials has samples of its own.
    pub differential: bool,
    /// Whether emitters are sampled.
    pub samples_emitters: bool,
    /// Whether emitters that scattered directions hit count.
    pub counts_hits: bool,
    /// Whether samples of environment maps move with the texels.
    pub follows_texels: bool,
    /// Whether vertices of its paths move with shapes, cameras and lights.
    pub moves_vertices: bool,
    /// Whether edges have samples of their own, as they move: [`Outlines`](super::Outlines).
    pub samples_edges: bool,
    /// Whether it is right for what moves in a limit only, that of a narrow kernel: [`Convolved`](super::Convolved).
    pub in_the_limit: bool,
    /// Where it is right.
    pub scenes: Scenes,
    /// Whether a [`Guide`](crate::guide::Guide) leads its paths.
    pub guided: bool,
    /// How its derivatives are carried.
    pub modes: Modes,
    /// Whether it is wrapped in [`AllowBias`](super::AllowBias): there for study, and wrong on purpose. What is there for study
    /// and right, but noisy, as weights by [`TrustLights`](super::TrustLights), is not.
    pub study: bool,
    /// By what it is biased, of what its type says; empty for those that are right.
    pub failures: Failures,
}

/// How scattered directions follow the parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Motion {
    /// They are constants.
    None,
    /// Through one bounce.
    OneBounce,
    /// Through one bounce, but not at outlines.
    Reparameterised,
    /// The whole path moves.
    Path,
}

/// Scenes in which an estimator is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Scenes {
    /// All of them.
    Any,
    /// Those without discontinuities in the direction of one edge: outlines, horizons of mapped normals.
    Continuous,
    /// Those where whole paths meet none, edges and textures that jump among them.
    ContinuousAlongPaths,
}

/// How derivatives are carried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Modes {
    /// Derivative images.
    pub forward: bool,
    /// Gradients.
    pub reverse: bool,
    /// Hessian-vector products and the Gauss-Newton matrix.
    pub second_order: bool,
    /// Derivatives in double precision are compiled: [`crate::instances`].
    pub double: bool,
    /// Paths are followed many at a time.
    pub waves: bool,
}

/// Why a derivative is biased, by the numbers of `docs/errata.md`, section 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Failure {
    /// F3: samples that move, with MIS weights that do not.
    ConstantWeights,
    /// F4: weights that are differentiated for one technique only.
    MixedWeights,
    /// F5: a roulette whose probability is differentiated.
    AttachedRoulette,
    /// F6: probabilities of lobes that are differentiated.
    AttachedChoice,
    /// F8: samples that move across discontinuities.
    Discontinuities,
    /// F10: no term for what becomes visible or hidden.
    Boundaries,
    /// F44: rays that do not move with the vertices that they start from.
    RaysAtRest,
}

impl Failure {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::ConstantWeights,
        Self::MixedWeights,
        Self::AttachedRoulette,
        Self::AttachedChoice,
        Self::Discontinuities,
        Self::Boundaries,
        Self::RaysAtRest,
    ];

    /// Its number in `docs/errata.md`.
    pub const fn number(self) -> &'static str {
        match self {
            Self::ConstantWeights => "F3",
            Self::MixedWeights => "F4",
            Self::AttachedRoulette => "F5",
            Self::AttachedChoice => "F6",
            Self::Discontinuities => "F8",
            Self::Boundaries => "F10",
            Self::RaysAtRest => "F44",
        }
    }

    /// What goes wrong, in words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::ConstantWeights => "attached samples with constant MIS weights",
            Self::MixedWeights => "weights differentiated for one technique only",
            Self::AttachedRoulette => "differentiated probabilities of roulette",
            Self::AttachedChoice => "differentiated probabilities of lobes",
            Self::Discontinuities => "samples that move across discontinuities",
            Self::Boundaries => "no term for what becomes visible or hidden",
            Self::RaysAtRest => "rays that do not move with the vertices that they start from",
        }
    }
}

/// A set of [`Failure`]s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Failures(u8);

impl Failures {
    /// The set of these.
    pub const fn of(failures: &[Failure]) -> Self {
        let mut out = Self(0);
        let mut i = 0;
        while i < failures.len() {
            out = out.with(failures[i], true);
            i += 1;
        }
        out
    }

    const fn with(self, failure: Failure, holds: bool) -> Self {
        Self(self.0 | (holds as u8) << failure as u8)
    }

    /// Whether it is among them.
    pub const fn contains(self, failure: Failure) -> bool {
        self.0 >> failure as u8 & 1 == 1
    }

    /// Whether there are none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Those that are in the set.
    pub fn iter(self) -> impl Iterator<Item = Failure> {
        Failure::ALL.into_iter().filter(move |f| self.contains(*f))
    }
}

/// Something that an estimator refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// What.
    pub what: &'static str,
    /// Why.
    pub why: &'static str,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}: {}", self.what, self.why)
    }
}

impl Capabilities {
    /// Those of `S`, as far as its type says: [`crate::instances::Estimator::capabilities`] knows as well for which
    /// strategies second derivatives and double precision are compiled.
    pub const fn of<S: Strategy>() -> Self {
        let motion = match S::Bsdf::DIRECT {
            _ if !S::Bsdf::DETACHED_PATH => Motion::Path,
            Direct::AsPath => Motion::None,
            Direct::Attached => Motion::OneBounce,
            Direct::Reparameterised { .. } => Motion::Reparameterised,
        };
        let scenes = match motion {
            _ if !S::NEEDS_CONTINUITY => Scenes::Any,
            Motion::Path => Scenes::ContinuousAlongPaths,
            _ => Scenes::Continuous,
        };
        let weighs = S::SAMPLES_EMITTERS && S::COUNTS_HITS;
        let constant = weighs && !S::FROZEN_WEIGHTS && !S::DIFFERENTIATED_WEIGHTS;
        let moves = !matches!(motion, Motion::None) || S::EmitterMotion::KEEPS;
        let crosses = S::Bsdf::NEEDS_CONTINUITY || S::EmitterMotion::KEEPS;
        let failures = Failures(0)
            .with(Failure::ConstantWeights, constant && moves)
            .with(Failure::MixedWeights, S::MIXED_WEIGHTS)
            .with(Failure::AttachedRoulette, S::ATTACHED_ROULETTE)
            .with(Failure::AttachedChoice, S::ATTACHED_CHOICE)
            .with(Failure::Discontinuities, crosses && !S::NEEDS_CONTINUITY)
            .with(Failure::Boundaries, S::INTERIOR && !S::OUTLINES)
            .with(Failure::RaysAtRest, S::INTERIOR && S::RAYS_AT_REST);
        Self {
            motion,
            differential: S::Bsdf::DIFFERENTIAL,
            samples_emitters: S::SAMPLES_EMITTERS,
            counts_hits: S::COUNTS_HITS,
            follows_texels: S::EmitterMotion::KEEPS,
            moves_vertices: S::INTERIOR || S::FOLLOWS.any(),
            samples_edges: S::OUTLINES,
            in_the_limit: S::FOLLOWS.rays() > 0,
            scenes,
            guided: is_guided::<S>(),
            modes: Modes {
                forward: true,
                reverse: true,
                second_order: false,
                double: false,
                waves: goes_in_waves::<S>(),
            },
            study: S::ALLOWS_BIAS,
            failures,
        }
    }

    /// The words that capabilities are displayed in, and their meaning.
    pub const LEGEND: &[(&str, &str)] = &[
        (
            "no discontinuities",
            "scenes with outlines of lights, shapes that may hide others, or horizons of mapped normals are refused",
        ),
        ("lights", "emitters are sampled"),
        ("texels", "samples of environment maps move with the texels"),
        (
            "motion",
            "sees derivatives in positions of shapes, cameras and lights",
        ),
        ("deltas", "sees derivatives in Dirac deltas"),
        ("guide", "a guide leads its paths"),
        ("waves", "paths are followed many at a time"),
        ("second order", "Hessian-vector products and Gauss-Newton"),
        ("double", "derivatives in double precision are compiled"),
        ("biased", "wrong on purpose, by these failure modes"),
    ];

    /// Whether all that it samples are constant directions, once each.
    pub const fn is_constant(&self) -> bool {
        let moves = self.moves_vertices || self.follows_texels;
        matches!(self.motion, Motion::None) && !moves && !self.differential
    }

    /// Whether it is another one where that is refused, and nothing else: the same samples, which move across
    /// discontinuities.
    pub fn is_naive_form_of(&self, other: &Self) -> bool {
        let refused = Self {
            scenes: Scenes::Any,
            study: true,
            failures: Failures::of(&[Failure::Discontinuities]),
            ..*other
        };
        other.scenes != Scenes::Any && *self == refused
    }

    /// Whether it sees the derivative in a kind of parameter.
    pub const fn sees(&self, kind: ParamKind) -> bool {
        self.refusal_of(kind).is_none()
    }

    /// Why it does not.
    pub const fn refusal_of(&self, kind: ParamKind) -> Option<Refusal> {
        let why = match kind {
            ParamKind::Smooth | ParamKind::Emission | ParamKind::Roughness | ParamKind::Normals => {
                return None;
            }
            kind if kind.is_motion() && self.moves_vertices => return None,
            ParamKind::Delta if matches!(self.motion, Motion::Path) => return None,
            ParamKind::Delta => {
                "a direction is a Dirac delta in them, which constant samples give a zero for (F2)"
            }
            ParamKind::Position => "visibility moves with them, and no term is there for it (F10)",
            ParamKind::VertexNormals => {
                "where surfaces turn away moves with them, and no term is there for it (F10)"
            }
            ParamKind::Camera => {
                "what a pixel sees moves with them, and no term is there for it (F10)"
            }
            ParamKind::LightPosition => "shadows move with them, and no term is there for it (F10)",
        };
        Some(Refusal {
            what: kind.name(),
            why,
        })
    }

    /// All that it refuses.
    pub fn refusals(&self) -> Vec<Refusal> {
        let kinds = ParamKind::ALL.into_iter();
        let mut out: Vec<Refusal> = kinds.filter_map(|k| self.refusal_of(k)).collect();
        let mut refuse = |refuses: bool, what, why| {
            if refuses {
                out.push(Refusal { what, why });
            }
        };
        refuse(
            self.scenes != Scenes::Any,
            "outlines of lights, shapes that may hide others, horizons of mapped normals",
            "samples would move across these discontinuities (F8, F9)",
        );
        refuse(
            self.scenes == Scenes::ContinuousAlongPaths,
            "edges and textures that jump",
            "whole paths would slide over them (F8)",
        );
        refuse(
            !self.guided,
            "a guide",
            "samples, weights or probabilities depend on the parameters, and the guide does not",
        );
        refuse(
            !self.modes.second_order,
            "second derivatives",
            "recorded paths are differentiated twice for constant samples with constant weights only",
        );
        refuse(
            !self.modes.double,
            "double precision",
            "it is compiled for the default only; types are rendered over any scalar",
        );
        out
    }
}

/// In few words, as in the tables of estimators: [`Capabilities::LEGEND`] says what they mean.
impl fmt::Display for Capabilities {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let scenes = match self.scenes {
            Scenes::Any => "any scene",
            Scenes::Continuous => "no discontinuities",
            Scenes::ContinuousAlongPaths => "no discontinuities, edges or jumps",
        };
        f.write_str(scenes)?;
        for (holds, what) in [
            (self.samples_emitters, "lights"),
            (self.follows_texels, "texels"),
            (self.moves_vertices, "motion"),
            (self.sees(ParamKind::Delta), "deltas"),
            (self.guided, "guide"),
            (self.modes.waves, "waves"),
            (self.modes.second_order, "second order"),
            (self.modes.double, "double"),
        ] {
            if holds {
                write!(f, "; {what}")?;
            }
        }
        if self.study {
            let numbers: Vec<&str> = self.failures.iter().map(Failure::number).collect();
            write!(f, "; biased: {}", numbers.join(", "))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::{
        AllowBias, Attached, AttachedDirect, AttachedRoulette, BsdfOnly, Detached, DetachedMis,
        DetachedWeights, Mis, check_parameter,
    };
    use super::*;
    use crate::params::{ParamInfo, ParamShape};

    #[test]
    fn a_type_says_what_it_can_do() {
        let mis = Capabilities::of::<DetachedMis>();
        assert_eq!((mis.motion, mis.scenes), (Motion::None, Scenes::Any));
        assert!(mis.guided && mis.modes.waves && mis.samples_emitters && !mis.study);
        let path = Capabilities::of::<BsdfOnly<Attached>>();
        assert_eq!(path.scenes, Scenes::ContinuousAlongPaths);
        assert!(path.sees(ParamKind::Delta) && !path.guided && !path.modes.waves);
        // What is biased twice says both, and only what is wrapped is for study.
        type Wrong = Mis<AttachedDirect, Detached, DetachedWeights>;
        let both = [Failure::ConstantWeights, Failure::Discontinuities];
        let wrapped = Capabilities::of::<AllowBias<Wrong>>();
        assert_eq!(wrapped.failures, Failures::of(&both));
        assert_eq!(wrapped.failures.iter().collect::<Vec<_>>(), both);
        let bare = Capabilities::of::<Wrong>();
        assert_eq!(bare.failures, Failures::of(&both[..1]));
        assert!(wrapped.study && !bare.study && bare.scenes == Scenes::Continuous);
        let naive = Capabilities::of::<AllowBias<BsdfOnly<AttachedDirect>>>();
        let attached = Capabilities::of::<BsdfOnly<AttachedDirect>>();
        assert!(naive.is_naive_form_of(&attached) && !attached.is_naive_form_of(&naive));
        assert!(!wrapped.is_naive_form_of(&bare) && !naive.is_naive_form_of(&bare));
        assert!(mis.is_constant() && !attached.is_constant());
        let roulette = Capabilities::of::<AllowBias<AttachedRoulette<DetachedMis>>>();
        assert_eq!(
            roulette.failures,
            Failures::of(&[Failure::AttachedRoulette])
        );
    }

    /// What moves is refused by name where there is no term for it.
    #[test]
    fn what_moves_is_refused_by_name() {
        let refused = |kind, by: fn(&ParamInfo) -> Result<(), crate::error::RenderError>| {
            let info = ParamInfo {
                name: "ball.center".into(),
                offset: 0,
                shape: ParamShape::Rgb,
                valid: (-1.0, 1.0),
                kind,
            };
            by(&info).err().map(|e| e.to_string())
        };
        for kind in ParamKind::ALL {
            let all = [
                refused(kind, check_parameter::<DetachedMis>),
                refused(kind, check_parameter::<BsdfOnly<Attached>>),
            ];
            if kind > ParamKind::Delta {
                for message in all {
                    let message = message.expect("a refusal");
                    assert!(message.contains("`ball.center`"), "{message}");
                    assert!(message.contains(kind.name()), "{message}");
                }
            } else {
                assert_eq!(all[0].is_some(), kind == ParamKind::Delta);
                assert_eq!(all[1], None);
            }
        }
    }
}
