//! How glints are found: reflections of lights in metal whose normals a fine map turns.

/// How glints are found that the camera sees directly: the light of paths over one vertex, on smooth metal under a normal map.
/// See [`crate::glint`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Glints {
    /// The estimator.
    pub method: GlintMethod,
    /// Where walks start, and how far they may go.
    pub region: GlintRegion,
    /// How walks and scattered directions share the light.
    pub weights: GlintWeights,
    /// Which of the two find it.
    pub techniques: GlintTechniques,
    /// Two walks have ended in the same solution if their ends are nearer than this in texture coordinates, as it was
    /// published; by bounds of their errors without it.
    pub threshold: Option<f64>,
    /// Most steps of a walk.
    pub steps: u32,
    /// Most Bernoulli trials of one estimate. Where it bites, and that is counted, the estimate is biased (F13).
    pub budget: u32,
}

/// Which estimator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GlintMethod {
    /// A random start, and the reciprocal of its solution's probability from trials
    /// [Zeltner 2021, algorithm 3.2 with errata Z-Alg-3.1].
    Unbiased,
    /// So many random starts, and each distinct solution once: it loses what they miss
    /// [Zeltner 2021, algorithm 3.3 with errata Z-Alg-3.1].
    Biased(u32),
}

/// Where walks start, and how far they may go.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GlintRegion {
    /// One cell between texels, drawn by how well its slopes fit the half vector: footprints may be of any size.
    #[default]
    Texels,
    /// The whole footprint, uniformly, as it was published: the larger it is, the more trials it takes, or the more a trial
    /// set misses.
    Footprint,
}

/// How walks and scattered directions share the light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GlintWeights {
    /// By the densities with which either of them finds the very path: no contribution exceeds the light itself.
    #[default]
    Densities,
    /// By the densities of its direction, that of the footprint's scattered light from the filtered moments of slopes
    /// [Zeltner 2021, section 3.3.3].
    Lobe,
}

/// Who finds glints.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GlintTechniques {
    /// Walks and scattered directions, weighed.
    #[default]
    Both,
    /// Walks alone.
    Walks,
    /// Scattered directions alone.
    Scattering,
}

impl Glints {
    /// Size of a trial set by default [Zeltner 2021, figure 3.13].
    pub const TRIALS: u32 = super::Connections::TRIALS;

    /// In cells, weighed by densities.
    pub fn new(method: GlintMethod) -> Self {
        Self {
            method,
            region: GlintRegion::default(),
            weights: GlintWeights::default(),
            techniques: GlintTechniques::default(),
            threshold: None,
            steps: 30,
            budget: 1 << 20,
        }
    }

    /// As published: starts in the whole footprint, weights by the lobe.
    pub fn published(method: GlintMethod) -> Self {
        Self {
            region: GlintRegion::Footprint,
            weights: GlintWeights::Lobe,
            steps: 20,
            ..Self::new(method)
        }
    }
}
