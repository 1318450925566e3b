//! Counter-based random numbers: a sample is a pure function of (seed, pixel, sample index,
//! dimension), so results do not depend on threads or tile order, and paired passes (common random
//! numbers, antithetic lobes) are a matter of asking for the same counter again.
//!
//! ```
//! use render::sampler::{Independent, Points, Sampler, Spread};
//!
//! let sampler = Independent::new(7, 3, 0); // seed, pixel, sample
//! let first: [f64; 2] = { sampler }.next_2d();
//! assert_eq!(first, { sampler }.next_2d::<f64>()); // a copy starts again
//!
//! // Sixteen Sobol points of one pixel: one in each sixteenth.
//! let mut cells = [0; 16];
//! for index in 0..16 {
//!     let u: f64 = Spread::spread(Points::Sobol, 7, 3, index).next_1d();
//!     cells[(16.0 * u) as usize] += 1;
//! }
//! assert_eq!(cells, [1; 16]);
//! ```

use std::sync::LazyLock;

use ad_core::Float;
use sobol_burley::NUM_DIMENSION_SETS_4D;
use sobol_burley::parts::{owen_scramble_rev, sobol_int4_rev};

use crate::math::each;

/// What numbers are drawn for: every decision of a path or a particle has dimensions of its own.
///
/// The dimensions of paths and of particles are those of different streams. No two purposes of one stream share any up to
/// a depth of 131 000 edges, beyond which numbers repeat and estimates stay unbiased one by one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Where in its pixel a path starts, 2; the depth is 1.
    Pixel,
    /// The same where there is a lens, and where on that, 4 instead.
    Lens,
    /// Which light is sampled, and where on it, 2.
    Light,
    /// A scattered direction, 3, and roulette.
    Scattering,
    /// A direction that a viewing ray goes on in, 3, which samples no lights: they have those of [`Purpose::Light`].
    Viewing,
    /// The pair of samples of the derivative of the distribution of normals, 3.
    NormalsPair,
    /// So many auxiliary rays around an edge, 2 each.
    AuxiliaryRays(u32),
    /// Edges that hide light from a vertex, so many candidates of 2 each, and which of them is taken.
    Edges(u32),
    /// Lines along which surfaces cross, so many candidates of 2 each, which of them is taken, and which of the surfaces.
    Crossings(u32),
    /// The vertex of a path that looks for edges, 1; the depth is 1.
    Vertex,
    /// Where on the horizon of a vertex light is lost, 1.
    Horizon,
    /// The start of a particle: its emitter if there is a choice, position 2, direction 2; the depth is 1.
    Emission,
    /// A direction that a particle is scattered in, 3, and roulette.
    ParticleScattering,
    /// The pair of samples of the derivative of the distribution of normals where particles scatter, 3.
    ParticleNormalsPair,
}

impl Purpose {
    /// The first dimension, at the vertex (or along the edge) number `depth`, counted from one.
    #[inline(always)]
    pub const fn at(self, depth: u32) -> u32 {
        const AUXILIARY: u32 = 1 << 20;
        const EDGES: u32 = 1 << 22;
        const HORIZON: u32 = 1 << 23;
        const CROSSINGS: u32 = 3 << 22;
        const LENS: u32 = 7 << 21;
        const RAYS: u32 = 1 << 24;
        match self {
            Self::Pixel | Self::Emission => 0,
            Self::Lens => LENS,
            Self::Light | Self::Viewing => 2 + (depth - 1) * 8,
            Self::Scattering => 5 + (depth - 1) * 8,
            Self::NormalsPair => AUXILIARY + depth * 8,
            Self::AuxiliaryRays(rays) => RAYS + depth * 2 * rays,
            Self::Edges(candidates) => EDGES + depth * (2 * candidates + 1),
            Self::Crossings(candidates) => CROSSINGS + depth * (2 * candidates + 2),
            Self::Vertex => HORIZON,
            Self::Horizon => HORIZON + depth,
            Self::ParticleScattering => 5 + (depth - 1) * 4,
            Self::ParticleNormalsPair => AUXILIARY + depth * 4,
        }
    }

    /// How many it takes.
    pub const fn count(self) -> u32 {
        match self {
            Self::Vertex | Self::Horizon => 1,
            Self::Pixel => 2,
            Self::Light | Self::Viewing | Self::NormalsPair | Self::ParticleNormalsPair => 3,
            Self::Scattering | Self::ParticleScattering | Self::Lens => 4,
            Self::AuxiliaryRays(rays) => 2 * rays,
            Self::Edges(candidates) => 2 * candidates + 1,
            Self::Crossings(candidates) => 2 * candidates + 2,
            Self::Emission => 5,
        }
    }
}

/// What else draws random numbers beside the paths of a pass, at the same seed. Each has numbers of its own, so that estimates
/// that are added, compared or decided by are independent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Family {
    /// Particles from the lights.
    Particles,
    /// Manifold connections, and the paths that they end.
    Connections,
    /// Particles by which the walks of connections start.
    Landings,
    /// Glints.
    Glints,
    /// Edges that hide light from a vertex.
    EdgesAtVertices,
    /// Edges on the film.
    EdgesOnFilm,
    /// Edges before lights.
    EdgesBeforeLights,
    /// Where the normals of lights turn away.
    TurnsOfLights,
    /// Auxiliary rays around scattered directions, and around rays of the camera.
    FieldsOfScattering,
    /// Auxiliary rays around directions to sampled lights.
    FieldsOfLights,
    /// Paths and auxiliary rays at the borders of pixels.
    PixelBorders,
    /// Short passes that decide on the ones that follow, whose seed may be the same.
    Pilots,
    /// Along what parameters move in these.
    Directions,
    /// Pixels in which work is counted.
    Places,
    /// Differences that gradients are checked against.
    Differences,
    /// Short differences that decide on the steps of these.
    DifferencePilots,
    /// Second looks at what the first one of a check found wrong.
    SecondLooks,
    /// Differences of third looks.
    ThirdLooks,
}

impl Family {
    /// All of them.
    #[cfg(test)]
    const ALL: [Self; 18] = [
        Self::Particles,
        Self::Connections,
        Self::Landings,
        Self::Glints,
        Self::EdgesAtVertices,
        Self::EdgesOnFilm,
        Self::EdgesBeforeLights,
        Self::TurnsOfLights,
        Self::FieldsOfScattering,
        Self::FieldsOfLights,
        Self::PixelBorders,
        Self::Pilots,
        Self::Directions,
        Self::Places,
        Self::Differences,
        Self::DifferencePilots,
        Self::SecondLooks,
        Self::ThirdLooks,
    ];

    /// Its seed in a pass with this one.
    pub const fn seed(self, pass: u64) -> u64 {
        pass ^ match self {
            Self::Particles => 0x6c69_6768_7421_0001,
            Self::Connections => 0x6d61_6e69_666f_6c64,
            Self::Landings => 0x6c61_6e64_696e_6773,
            Self::Glints => 0x676c_696e_7473_2121,
            Self::EdgesAtVertices => 0x6a09_e667_f3bc_c908,
            Self::EdgesOnFilm => 0xbb67_ae85_84ca_a73b,
            Self::EdgesBeforeLights => 0x3c6e_f372_fe94_f82b,
            Self::TurnsOfLights => 0x1f83_d9ab_fb41_bd6b,
            Self::FieldsOfScattering => 0xa54f_f53a_5f1d_36f1,
            Self::FieldsOfLights => 0x510e_527f_ade6_82d1,
            Self::PixelBorders => 0x9b05_688c_2b3e_6c1f,
            Self::Pilots => 0x7069_6c6f_7473,
            Self::Directions => 0x6469_7265_6374_696f,
            Self::Places => 0x706c_6163_6573_2121,
            Self::Differences => 0x6469_6666,
            Self::DifferencePilots => 0x7069_6c6f,
            Self::SecondLooks => 0x7365_636f,
            Self::ThirdLooks => 0x7468_6972,
        }
    }
}

/// How the samples of a pixel are spread.
///
/// The default is that of the library, [`Points::Independent`]: the variance of an estimator is defined by independent
/// samples, and what compares estimators wants them. The tools and Python choose [`Points::Sobol`], which have the least error
/// for the same work, unless they are told otherwise. `scene.settings.points = Points::Sobol` does so in code; see the example
/// of [`Settings`](crate::Settings).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Points {
    /// Each on its own.
    #[default]
    Independent,
    /// Owen-scrambled Sobol points [Burley 2020]: any power of two of them is stratified. Each pixel, and
    /// each decision of a path, has a scrambling of its own.
    Sobol,
    /// In pairs: the numbers of an odd sample are one minus those of the sample before it.
    Antithetic,
}

impl Points {
    /// All of them, by name.
    pub const NAMES: [(&'static str, Self); 3] = [
        ("independent", Self::Independent),
        ("sobol", Self::Sobol),
        ("antithetic", Self::Antithetic),
    ];
}

/// What the numbers of a sample are made of: many samples' numbers can be made in a loop.
#[derive(Clone, Copy, Debug)]
pub struct Stream {
    /// How.
    pub points: Points,
    /// What tells it from others.
    pub key: u64,
    /// Number of the sample among those with the same key.
    pub index: u32,
}

/// A stream of numbers in [0, 1) for one sample of one pixel.
pub trait Sampler: Copy {
    /// Starts the stream of sample `index` of pixel `pixel`.
    fn new(seed: u64, pixel: u64, index: u64) -> Self;

    /// The same for a sampler that knows more than one kind of points.
    fn spread(_points: Points, seed: u64, pixel: u64, index: u64) -> Self
    where
        Self: Sized,
    {
        Self::new(seed, pixel, index)
    }

    /// What its numbers are made of.
    fn stream(&self) -> Stream;

    /// Moves to a dimension: the next number drawn is that of dimension `dim`. What is drawn between
    /// two calls belongs together.
    fn seek(&mut self, dim: u32);

    /// The next dimension's 64 random bits.
    fn next_bits(&mut self) -> u64;

    /// One number in [0, 1).
    #[inline]
    fn next_1d<P: Float>(&mut self) -> P {
        P::from_bits_unit(self.next_bits())
    }

    /// Two numbers in [0, 1).
    #[inline]
    fn next_2d<P: Float>(&mut self) -> [P; 2] {
        [self.next_1d(), self.next_1d()]
    }

    /// Three numbers in [0, 1).
    #[inline]
    fn next_3d<P: Float>(&mut self) -> [P; 3] {
        [self.next_1d(), self.next_1d(), self.next_1d()]
    }
}

/// 64 random bits as an index below `n`, at most 2^32.
#[inline]
pub(crate) fn index_below(bits: u64, n: usize) -> usize {
    (((bits >> 32) * n as u64) >> 32) as usize
}

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

/// The finaliser of SplitMix64 [Steele et al. 2014]: a bijection whose output bits all depend on all
/// input bits.
#[inline]
pub fn mix64(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// The bits of dimension `dim`, counted from one, of a stream of independent numbers.
#[inline(always)]
pub(crate) fn independent_bits(key: u64, dim: u32) -> u64 {
    mix64(key.wrapping_add(u64::from(dim).wrapping_mul(GOLDEN)))
}

/// Independent uniform numbers.
#[derive(Clone, Copy, Debug)]
pub struct Independent {
    key: u64,
    dim: u32,
}

impl Sampler for Independent {
    #[inline]
    fn new(seed: u64, pixel: u64, index: u64) -> Self {
        let key =
            mix64(mix64(mix64(seed ^ GOLDEN).wrapping_add(pixel)) ^ index.wrapping_mul(GOLDEN));
        Self { key, dim: 0 }
    }

    #[inline]
    fn stream(&self) -> Stream {
        Stream {
            points: Points::Independent,
            key: self.key,
            index: 0,
        }
    }

    #[inline]
    fn seek(&mut self, dim: u32) {
        self.dim = dim;
    }

    #[inline]
    fn next_bits(&mut self) -> u64 {
        self.dim += 1;
        independent_bits(self.key, self.dim)
    }
}

/// Whichever [`Points`] are asked for.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    key: u64,
    dim: u32,
    /// The dimension that was sought last.
    first: u32,
    /// Sample index, of Sobol points.
    index: u32,
    points: Points,
    /// The four Sobol dimensions that the next number is one of, once the first of them is drawn.
    drawn: [u32; 4],
}

/// Points of the first four dimensions of the Sobol sequence, bits reversed, for the upper and for the lower
/// eight bits of a reversed index. The sequence is linear over bits: the point is the exclusive or of the two.
pub(crate) type FirstFour = [[[u32; 4]; 256]; 2];

/// The table itself.
pub(crate) fn first_four() -> &'static FirstFour {
    static TABLE: LazyLock<FirstFour> = LazyLock::new(|| {
        [24, 16].map(|shift| std::array::from_fn(|i| sobol_int4_rev((i as u32) << shift, 0).into()))
    });
    &TABLE
}

#[inline(always)]
fn after(x: u64, n: u32) -> u64 {
    mix64(x.wrapping_add(u64::from(n.wrapping_add(1)).wrapping_mul(GOLDEN)))
}

/// The Owen-scrambled points of the `k`-th four dimensions, given those of the sequence at the shuffled index.
#[inline(always)]
pub(crate) fn scrambled(set: u64, k: u32, points: [u32; 4]) -> [u32; 4] {
    let [a, b] = [after(set, 2 * k), after(set, 2 * k + 1)];
    let [x, y, z, w] = points;
    let point = |x: u32, scramble: u64| owen_scramble_rev(x, scramble as u32).reverse_bits();
    [
        point(x, a),
        point(y, a >> 32),
        point(z, b),
        point(w, b >> 32),
    ]
}

/// What the Sobol points from dimension `dim` on are scrambled by, and their shuffled index, bits reversed.
#[inline(always)]
pub(crate) fn sobol_set(key: u64, index: u32, dim: u32) -> (u64, u32) {
    let set = after(key, dim);
    (set, owen_scramble_rev(index.reverse_bits(), set as u32))
}

/// The first four dimensions of the sequence at a reversed index.
#[inline(always)]
pub(crate) fn sobol_points([upper, lower]: &FirstFour, reversed: u32) -> [u32; 4] {
    let a = upper[(reversed >> 24) as usize];
    let b = lower[(reversed >> 16 & 0xff) as usize];
    [a[0] ^ b[0], a[1] ^ b[1], a[2] ^ b[2], a[3] ^ b[3]]
}

/// The bits of a Sobol point, and noise below its 32, so that doubles have all of theirs.
#[inline(always)]
pub(crate) fn sobol_bits(x: u32) -> u64 {
    u64::from(x) << 32 | u64::from(x.wrapping_mul(GOLDEN as u32))
}

impl Spread {
    /// Numbers of an Owen-scrambled Sobol sequence that is padded: the dimensions drawn since the last
    /// [`Sampler::seek`] are those of one sequence, whose order is shuffled by the same scrambling. Made four at a
    /// time.
    #[inline(never)]
    fn sobol<const N: usize>(&mut self) -> [u64; N] {
        std::array::from_fn(|_| {
            let k = self.dim - self.first;
            self.dim += 1;
            if k.is_multiple_of(4) {
                self.drawn = self.four(k / 4);
            }
            sobol_bits(self.drawn[k as usize % 4])
        })
    }

    /// The `k`-th four dimensions since the last [`Sampler::seek`].
    #[inline]
    fn four(&self, k: u32) -> [u32; 4] {
        let (set, shuffled) = sobol_set(self.key, self.index, self.first);
        let points = match k {
            0 => sobol_points(first_four(), shuffled),
            _ => sobol_int4_rev(shuffled, k % NUM_DIMENSION_SETS_4D).into(),
        };
        scrambled(set, k, points)
    }
}

impl Sampler for Spread {
    #[inline]
    fn new(seed: u64, pixel: u64, index: u64) -> Self {
        Self::spread(Points::Independent, seed, pixel, index)
    }

    #[inline]
    fn spread(points: Points, seed: u64, pixel: u64, index: u64) -> Self {
        // Samples with the same key are points of the same sequence, or of the same pair.
        let shared = match points {
            Points::Independent => index,
            Points::Sobol => index >> 16,
            Points::Antithetic => index >> 1,
        };
        Self {
            key: Independent::new(seed, pixel, shared).key,
            dim: 0,
            first: 0,
            index: index as u32 & 0xffff,
            points,
            drawn: [0; 4],
        }
    }

    #[inline]
    fn stream(&self) -> Stream {
        Stream {
            points: self.points,
            key: self.key,
            index: self.index,
        }
    }

    #[inline]
    fn seek(&mut self, dim: u32) {
        self.dim = dim;
        self.first = dim;
    }

    #[inline(always)]
    fn next_bits(&mut self) -> u64 {
        if self.points == Points::Sobol {
            return self.sobol::<1>()[0];
        }
        self.dim += 1;
        let bits = independent_bits(self.key, self.dim);
        if self.points == Points::Antithetic && self.index & 1 == 1 {
            !bits
        } else {
            bits
        }
    }

    #[inline(always)]
    fn next_2d<P: Float>(&mut self) -> [P; 2] {
        match self.points {
            Points::Sobol => {
                let [x, y] = self.sobol();
                [P::from_bits_unit(x), P::from_bits_unit(y)]
            }
            _ => [self.next_1d(), self.next_1d()],
        }
    }

    #[inline(always)]
    fn next_3d<P: Float>(&mut self) -> [P; 3] {
        match self.points {
            Points::Sobol => each(self.sobol(), P::from_bits_unit),
            _ => [self.next_1d(), self.next_1d(), self.next_1d()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::z_limit;

    /// No two decisions of a path, or of a particle, share a dimension.
    #[test]
    fn purposes_do_not_overlap() {
        let path = [
            Purpose::Light,
            Purpose::Scattering,
            Purpose::NormalsPair,
            Purpose::AuxiliaryRays(16),
            Purpose::Edges(4),
            Purpose::Crossings(4),
            Purpose::Horizon,
        ];
        let particle = [Purpose::ParticleScattering, Purpose::ParticleNormalsPair];
        for (start, purposes) in [
            (Purpose::Pixel, &path[..]),
            (Purpose::Lens, &path[..]),
            (Purpose::Emission, &particle),
        ] {
            let mut taken = [start, Purpose::Vertex]
                .map(|p| (p.at(1), p.count()))
                .to_vec();
            for depth in (1..2000).chain(130_000..131_000) {
                taken.extend(purposes.iter().map(|p| (p.at(depth), p.count())));
            }
            taken.sort_unstable();
            assert!(taken.windows(2).all(|w| w[0].0 + w[0].1 <= w[1].0));
        }
    }

    /// No two families share a seed, nor do those of a pass and of a pilot for it.
    #[test]
    fn families_have_seeds_of_their_own() {
        let of = |pass: u64| Family::ALL.map(|f| f.seed(pass)).into_iter().chain([pass]);
        let mut seeds: Vec<u64> = of(7).chain(of(Family::Pilots.seed(7))).collect();
        let all = seeds.len();
        seeds.sort_unstable();
        seeds.dedup();
        // A pilot of a pilot is the pass, and the pilot stands in both lists.
        assert_eq!(seeds.len(), all - 2);
    }

    /// The table holds the sequence: the exclusive or of its halves is what the crate says.
    #[test]
    fn first_four_dimensions_are_the_sequence() {
        for i in 0..2000u32 {
            let index = (mix64(u64::from(i)) as u32) & 0xffff_0000;
            let [upper, lower] = first_four();
            let [a, b, ..] = index.to_be_bytes().map(usize::from);
            let expected: [u32; 4] = sobol_int4_rev(index, 0).into();
            let found: [u32; 4] = std::array::from_fn(|k| upper[a][k] ^ lower[b][k]);
            assert_eq!(found, expected);
        }
    }

    /// In the first 256 samples, every elementary interval of area 1/256 has exactly one point: of the
    /// first two dimensions after each `seek`, in each pixel.
    #[test]
    fn sobol_points_are_stratified_in_every_pair() {
        for (pixel, dim) in [(0, 0), (0, 2), (5, 5), (9, 13)] {
            let points: Vec<[f64; 2]> = (0..256)
                .map(|i| {
                    let mut s = Spread::spread(Points::Sobol, 3, pixel, i);
                    s.seek(dim);
                    s.next_2d()
                })
                .collect();
            for log in 0..=8 {
                let (nx, ny) = (1 << log, 256 >> log);
                let mut count = vec![0; 256];
                for [x, y] in &points {
                    count[(x * nx as f64) as usize * ny + (y * ny as f64) as usize] += 1;
                }
                assert!(count.iter().all(|&c| c == 1), "{pixel} {dim} {nx} x {ny}");
            }
        }
    }

    /// Uniform over seeds, and uncorrelated between pixels, seeks and seeds: seven tests, significance 1 in 1000 together.
    #[test]
    fn sobol_points_are_uniform_and_unrelated_elsewhere() {
        let n = 100_000u64;
        let draw = |seed: u64, pixel: u64, index: u64, dim: u32| -> f64 {
            let mut s = Spread::spread(Points::Sobol, seed, pixel, index);
            s.seek(dim);
            s.next_1d::<f64>() - 0.5
        };
        let z = |sum: f64, sd: f64| (sum / n as f64 / (sd / (n as f64).sqrt())).abs();
        let sd = (1.0f64 / 12.0).sqrt();
        let limit = z_limit(7, n, 1e-3);
        for index in [0, 1, 77, 1 << 20] {
            let sum: f64 = (0..n).map(|i| draw(i, 1, index, 2)).sum();
            assert!(z(sum, sd) < limit, "{index}");
        }
        for (seed, pixel, dim) in [(1, 0, 0), (0, 1, 0), (0, 0, 3)] {
            let pairs = (0..n).map(|i| draw(i, i, 5, 2) * draw(i + seed, i + pixel, 5, 2 + dim));
            assert!(z(pairs.sum(), 1.0 / 12.0) < limit, "{seed} {pixel} {dim}");
        }
    }

    #[test]
    fn antithetic_samples_mirror_each_other() {
        let draw =
            |index| -> [f64; 3] { Spread::spread(Points::Antithetic, 1, 2, index).next_3d() };
        for (a, b) in draw(6).iter().zip(draw(7)) {
            assert!((a + b - 1.0).abs() < 1e-15);
        }
        assert_ne!(draw(6), draw(8));
    }

    #[test]
    fn a_sample_is_a_function_of_its_counter() {
        let mut a = Independent::new(7, 11, 13);
        let first: Vec<f64> = (0..10).map(|_| a.next_1d()).collect();
        let mut b = Independent::new(7, 11, 13);
        b.seek(6);
        assert_eq!(b.next_1d::<f64>(), first[6]);
        assert!((b.next_1d::<f32>() as f64 - first[7]).abs() < 1e-7);
        assert_ne!(
            Independent::new(8, 11, 13).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
        assert_ne!(
            Independent::new(7, 12, 13).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
        assert_ne!(
            Independent::new(7, 11, 14).next_bits(),
            Independent::new(7, 11, 13).next_bits()
        );
    }

    /// Mean, variance and correlation between neighbouring pixels, samples and dimensions: eight tests, significance 1 in
    /// 1000 together.
    #[test]
    fn streams_are_uniform_and_uncorrelated() {
        let n = 200_000u64;
        let draw = |pixel: u64, index: u64, dim: u32| -> f64 {
            let mut s = Independent::new(1, pixel, index);
            s.seek(dim);
            s.next_1d::<f64>() - 0.5
        };
        let z = |values: &mut dyn Iterator<Item = f64>, mean: f64, sd: f64| {
            let sum: f64 = values.sum();
            (sum / n as f64 - mean) / (sd / (n as f64).sqrt())
        };
        let limit = z_limit(8, n, 1e-3);
        let sd = (1.0f64 / 12.0).sqrt();
        assert!(z(&mut (0..n).map(|i| draw(i, 0, 0)), 0.0, sd).abs() < limit);
        assert!(z(&mut (0..n).map(|i| draw(0, i, 0)), 0.0, sd).abs() < limit);
        assert!(z(&mut (0..n).map(|i| draw(0, 0, i as u32)), 0.0, sd).abs() < limit);
        let square_sd = (1.0f64 / 180.0).sqrt();
        assert!(
            z(
                &mut (0..n).map(|i| draw(i, 3, 5).powi(2)),
                sd * sd,
                square_sd
            )
            .abs()
                < limit
        );
        let product_sd = 1.0 / 12.0;
        for (dp, di, dd) in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0)] {
            let pairs = &mut (0..n).map(|i| draw(i, i, 2) * draw(i + dp, i + di, 2 + dd));
            assert!(
                z(pairs, 0.0, product_sd).abs() < limit,
                "offset {dp} {di} {dd}"
            );
        }
    }
}
