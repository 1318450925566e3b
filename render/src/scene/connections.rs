//! What a scene says about manifold connections: who throws caustics, who receives them, how they are found.

use std::fmt;
use std::str::FromStr;

use ad_core::Vec3;

/// How manifold connections are made: paths from a vertex that is not specular over a chain of specular ones to a sampled
/// point of a light. See [`crate::manifold`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Connections {
    /// The estimator.
    pub method: Method,
    /// Most specular vertices of a chain, from 1 to [`Connections::MOST_BOUNCES`].
    pub bounces: u32,
    /// The chains that are looked for, by what happens at their vertices, instead of all of at most `bounces`. Others are left to
    /// paths.
    pub kinds: Option<ChainKinds>,
    /// The function whose roots are sought.
    pub constraint: Constraint,
    /// When two walks have ended in the same solution.
    pub uniqueness: Uniqueness,
    /// Of so many walks that are taken to have ended in a known solution, by [`Uniqueness::ErrorBounds`], one is proved to have, if it
    /// can be ([`crate::manifold::Space::sameness`]); of 1 all are, of 0 none. It changes no image: [`crate::manifold::Statistics`]
    /// counts.
    pub proofs: u32,
    /// Where walks start.
    pub starts: Starts,
    /// Surfaces of metal and glass that are no rougher than this throw light over chains, too; others are left to paths,
    /// unless the scene file names them.
    pub roughness: f64,
    /// Whether images say what connections came to in each pixel, too.
    pub by_pixel: bool,
    /// Most Bernoulli trials of one estimate. Where it bites, and that is counted, the estimate is biased (F13).
    pub budget: u32,
    /// Which of the light over casters there is.
    pub light: CasterLight,
    /// How walks step, and where they end.
    pub steps: Steps,
}

/// What happened at the vertices of a chain, from the receiver on: a one, and a digit for each vertex, zero for a reflection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChainKind(pub(crate) u32);

impl ChainKind {
    /// Of no vertex.
    pub const NONE: Self = Self(1);
    /// They are less than this.
    const ALL: usize = 2 << Connections::MOST_BOUNCES;

    /// How many vertices.
    #[inline]
    pub fn vertices(self) -> u32 {
        self.0.ilog2()
    }

    /// The same, and one vertex more, towards the light.
    #[must_use]
    #[inline]
    pub fn then(self, refracts: bool) -> Self {
        Self(self.0 << 1 | u32::from(refracts))
    }

    /// The same, and one vertex before all others.
    #[must_use]
    pub fn after(self, refracts: bool) -> Self {
        Self(self.0 + ((1 + u32::from(refracts)) << self.vertices()))
    }

    /// The same where the last vertex refracts.
    #[must_use]
    #[inline]
    pub(crate) fn refracted(self) -> Self {
        Self(self.0 | 1)
    }
}

/// A set of [`ChainKind`]s.
///
/// ```
/// use render::scene::{ChainKinds, ChainKind};
/// let kinds: ChainKinds = "R,TT".parse()?;
/// assert_eq!((kinds.to_string().as_str(), kinds.longest()), ("R,TT", 2));
/// assert!(kinds.contains(ChainKind::NONE.then(true).then(true)));
/// assert!("R,,T".parse::<ChainKinds>().is_err());
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChainKinds {
    /// A bit for each, and for what they begin with.
    set: [u64; ChainKind::ALL / 64],
    beginnings: [u64; ChainKind::ALL / 64],
}

fn bit(kind: ChainKind) -> (usize, u64) {
    (kind.0 as usize / 64, 1 << (kind.0 % 64))
}

impl ChainKinds {
    /// Whether it has this one.
    #[inline]
    pub fn contains(&self, kind: ChainKind) -> bool {
        let (word, bit) = bit(kind);
        self.set[word] & bit != 0
    }

    /// Whether it has one that begins like this, or is it.
    #[inline]
    pub fn begins(&self, kind: ChainKind) -> bool {
        let (word, bit) = bit(kind);
        self.beginnings.get(word).is_some_and(|all| all & bit != 0)
    }

    fn insert(&mut self, kind: ChainKind) {
        let (word, own) = bit(kind);
        self.set[word] |= own;
        for k in 0..=kind.vertices() {
            let (word, beginning) = bit(ChainKind(kind.0 >> k));
            self.beginnings[word] |= beginning;
        }
    }

    fn all(&self) -> impl Iterator<Item = ChainKind> + '_ {
        let all = (2..ChainKind::ALL as u32).map(ChainKind);
        all.filter(|kind| self.contains(*kind))
    }

    /// The number of vertices of the shortest chain; zero if there are none.
    pub fn shortest(&self) -> u32 {
        self.all().map(ChainKind::vertices).min().unwrap_or(0)
    }

    /// The number of vertices of the longest chain; zero if there are none.
    pub fn longest(&self) -> u32 {
        self.all().map(ChainKind::vertices).max().unwrap_or(0)
    }
}

impl FromStr for ChainKinds {
    type Err = String;

    /// Words of `R` and `T`, separated by commas, from the receiver to the light.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut kinds = Self::default();
        for word in text.split(',') {
            let most = Connections::MOST_BOUNCES as usize;
            let letters = word.chars().all(|c| c == 'R' || c == 'T');
            if !letters || !(1..=most).contains(&word.len()) {
                return Err(format!(
                    "expected words of 1 to {most} letters R (reflection) and T (refraction), from the receiver to the light, \
                     such as R,TT; found `{word}`"
                ));
            }
            kinds.insert(word.chars().fold(ChainKind::NONE, |f, c| f.then(c == 'T')));
        }
        Ok(kinds)
    }
}

impl fmt::Display for ChainKinds {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for (i, kind) in self.all().enumerate() {
            f.write_str(if i > 0 { "," } else { "" })?;
            for k in (0..kind.vertices()).rev() {
                f.write_str(if kind.0 >> k & 1 == 1 { "T" } else { "R" })?;
            }
        }
        Ok(())
    }
}

/// How walks step, and where they end: Newton's method, whose step is halved while it leaves a larger constraint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steps {
    /// Most steps of a walk.
    pub most: u32,
    /// The part of Newton's step that is tried first.
    pub scale: f64,
    /// A walk has ended when no component of the last constraint exceeds this. What it found is brought to rounding from there.
    pub tolerance: f64,
}

impl Default for Steps {
    fn default() -> Self {
        Self {
            most: 20,
            scale: 1.0,
            tolerance: 1e-9,
        }
    }
}

/// Which estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// A random start, and the reciprocal of its solution's probability from trials: unbiased
    /// [Zeltner 2021, algorithm 3.2 with errata Z-Alg-3.1].
    Sms,
    /// So many random starts, and each distinct solution once: it loses what they miss
    /// [Zeltner 2021, algorithm 3.3 with errata Z-Alg-3.1].
    SmsBiased(u32),
    /// One start on the way to the light, for reflection at the middle of each caster: it loses what that misses
    /// [Zeltner 2021, algorithm 3.1; Hanika et al. 2015].
    Mnee,
    /// The same start, and paths for what it misses: those that scatter over a chain onto a light count where the walk between
    /// the same two ends does not find that chain. Unbiased where lights have a size that paths can meet
    /// ([`crate::manifold::Split::admits`]) [Hanika et al. 2015].
    MneeUnbiased,
    /// Every solution, by proof: those of one vertex, over smooth surfaces without normal maps. No random number but that of the
    /// light; where a search runs out of boxes, that is counted ([`crate::manifold::Space::every`]).
    Complete,
    /// None: the light that connections would find is left out.
    LeftOut,
    /// None: paths find that light, too.
    Paths,
}

impl Method {
    /// Whether no start of a walk is random.
    pub fn is_deterministic(self) -> bool {
        matches!(self, Self::Mnee | Self::MneeUnbiased | Self::Complete)
    }

    /// Whether there are walks.
    pub fn walks(self) -> bool {
        !matches!(self, Self::LeftOut | Self::Paths)
    }
}

/// Which of the light over casters an image has, by whatever integral.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CasterLight {
    /// All of it: what connections cannot represent is left to paths.
    #[default]
    All,
    /// What the programs of [Zeltner et al. 2020] keep, to compare their methods without noise of other light: that over chains of
    /// exactly [`Connections::bounces`] vertices, reflected by metal and refracted by glass, and lights that the camera sees in
    /// casters. Of other paths, those are left out whose last edge leaves a caster and ends at a light.
    Published(Seen),
}

/// The lights that the camera sees in casters, where other light over these is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// None.
    Nothing,
    /// In the first vertex of a path.
    Directly,
    /// Behind any number of vertices, along Dirac deltas alone.
    AlongDeltas,
}

/// A function of a specular vertex that vanishes where the laws of reflection and refraction hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Constraint {
    /// Polar and azimuthal angle between the direction onward and the scattered one [Zeltner 2021, Eq. 3.19].
    #[default]
    Angle,
    /// The half vector, projected onto the tangents of the surface [Zeltner 2021, Eqs. 3.1 and 3.2].
    HalfVector,
}

/// Where walks start. All of them reach every solution, so that the estimate is unbiased with any; they differ in how many
/// trials it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Starts {
    /// At random points of casters, as light would go on from there.
    Uniform,
    /// There, after a walk over the surfaces without their normal maps, turned by a normal from the Gaussian of the map's
    /// slopes [Zeltner 2021, section 3.3.2].
    TwoStage,
    /// Where particles from the lights passed that landed nearby, and in two stages every other time. Of unbiased sampling,
    /// the solutions that these particles lead to count as they are, and others by random walks.
    #[default]
    Particles,
}

/// When two walks have ended in the same solution.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Uniqueness {
    /// If the balls overlap in which the roots lie, as the last steps of Newton's method and rounding bound them: an estimate
    /// of errors with nothing to tune, of which [`Connections::proofs`] are made.
    #[default]
    ErrorBounds,
    /// If one minus the cosine between their directions is less than this, as it was published: it merges what is distinct.
    Threshold(f64),
}

impl Connections {
    /// Longest chains.
    pub const MOST_BOUNCES: u32 = 8;
    /// Up to this roughness chains have less noise than paths, by default.
    pub const SMOOTH: f64 = 0.02;
    /// Most trials of an estimate, by default: of solutions that one walk in 10 000 finds, it loses 0.2 %, and what no walk finds
    /// again costs about a second.
    pub const BUDGET: u32 = 1 << 16;
    /// Largest trial set.
    pub const MOST_WALKS: u32 = 1 << 20;
    /// A proof takes several times as long as a walk, and succeeds nearly always.
    pub const PROOFS: u32 = 256;
    /// Size of a trial set by default [Zeltner 2021, figure 3.13].
    pub const TRIALS: u32 = 16;

    /// Most specular vertices of a chain: of these kinds, if any are named.
    pub fn longest(&self) -> u32 {
        let longest = self.kinds.map_or(self.bounces, |kinds| kinds.longest());
        longest.clamp(1, Self::MOST_BOUNCES)
    }

    /// Fewest specular vertices of a chain: one, or those of the shortest kind that is named; where other light is left out, as many as
    /// there may be.
    pub(crate) fn shortest(&self) -> u32 {
        match self.light {
            CasterLight::All => self.kinds.map_or(1, |kinds| kinds.shortest()),
            CasterLight::Published(_) => self.longest(),
        }
    }

    /// Whether a proof is made for a walk that ended in this direction: a function of its last digits.
    pub(crate) fn proves(&self, d: Vec3<f64>) -> bool {
        let digits = d.x.to_bits() ^ d.y.to_bits().rotate_left(21) ^ d.z.to_bits().rotate_left(42);
        let mixed = digits.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        self.proofs > 0 && mixed.is_multiple_of(u64::from(self.proofs))
    }

    /// Unbiased, with chains of at most two vertices.
    pub fn new(method: Method) -> Self {
        Self {
            method,
            bounces: 2,
            kinds: None,
            constraint: Constraint::default(),
            uniqueness: Uniqueness::default(),
            proofs: Self::PROOFS,
            starts: Starts::default(),
            roughness: Self::SMOOTH,
            by_pixel: false,
            budget: Self::BUDGET,
            light: CasterLight::default(),
            steps: Steps::default(),
        }
    }
}

/// What a scene file says of a shape or an emitter: the flags of the scenes of [Zeltner et al. 2020].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hints {
    /// `caustic_receiver`: caustics are looked for on it.
    pub receiver: bool,
    /// `caustic_caster_single` or `caustic_emitter_single`: part of chains of one specular vertex.
    pub single: bool,
    /// `caustic_caster_multi`, `caustic_bouncer` or `caustic_emitter_multi`: of longer ones.
    pub multi: bool,
    /// `caustic_bouncer` alone: not their first vertex, of [`CasterLight::Published`].
    pub bouncer: bool,
    /// `glinty`: glints are looked for on it ([`crate::glint`]).
    pub glinty: bool,
}
