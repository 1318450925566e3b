//! How much light passes the coat of plastic, smooth or rough.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};

use ad_core::{Const, Float, Real, Vec3, array};

use super::dielectric::INDEX_RANGE;
use super::fresnel;
use super::microfacet::{ALPHA_RANGE, Microfacet, Ndf};
use super::rough_conductor::reflect;

/// Reflectance of a smooth coat for diffuse light from below, `eta` being its index over that above it.
///
/// Between nodes that are equidistant in the square root of the logarithm of the index: a Catmull-Rom spline through
/// [`fresnel::dielectric_diffuse`], to 5e-6.
///
/// # Derivatives
/// Those of the spline; at an index of exactly one, where the slope jumps, that from above.
pub fn diffuse_below<R: Real>(eta: R) -> R {
    const NODES: usize = 100;
    const STEP: f64 = 1.0 / 64.0;
    static ABOVE: LazyLock<[f64; NODES]> = LazyLock::new(|| {
        std::array::from_fn(|i| {
            let x = STEP * i as f64;
            fresnel::dielectric_diffuse((x * x).exp())
        })
    });
    let dense = eta.primal() >= R::Primal::one();
    let ratio = R::select(dense, eta, eta.recip());
    let (nodes, weights) = even_spline(root(ratio) * R::c(STEP.recip()), NODES);
    let mut above = R::zero();
    for (i, w) in nodes.into_iter().zip(weights) {
        above += w * R::c(ABOVE[i]);
    }
    // What enters the denser side of what is diffuse, leaves it as well, from a cone that is the narrower the denser.
    R::select(dense, R::one() - (R::one() - above) / eta.square(), above)
}

/// The square root of the logarithm of an index, which is at least one. Where that has no slope, and below, it stands a
/// millionth above: even functions have a slope in the index there.
fn root<R: Real>(eta: R) -> R {
    let least = R::Primal::of(1.0 + 1e-6);
    let lacking = (least - eta.primal()).max(R::Primal::zero());
    (eta + Const(lacking)).ln().sqrt()
}

/// How much light passes a rough coat, as a function of roughness, angle and index.
///
/// Nodes are equidistant in the square roots of roughness and cosine: what happens at small values
/// of either needs them. Between nodes: Catmull-Rom splines. What belongs to a node of roughness is computed when it is
/// first asked for: most materials need four of them, and those that are not seen none.
///
/// The coat has an index that it begins with, where nothing else is asked for. Other indices lie between coats whose
/// indices are equidistant in the square root of the logarithm, which that one is among.
#[derive(Debug)]
pub struct Coat {
    kind: Ndf,
    eta: f64,
    rows: [OnceLock<Row>; ALPHAS],
    /// In the order of their indices.
    others: Box<[OnceLock<&'static Coat>]>,
    /// The place of this coat among them.
    place: usize,
    /// From the square root of the logarithm of each index to that of the next.
    step: f64,
}

/// A node of roughness.
#[derive(Debug)]
pub struct Row {
    /// Light from above that is not reflected, `[cosine]`.
    transmit: [f64; COSINES],
    /// Reflectance for diffuse light from below.
    inside: f64,
}

const ALPHAS: usize = 24;
const COSINES: usize = 32;
/// Largest [`Coat::step`].
const ETA_STEP: f64 = 0.05;

impl Coat {
    /// The table for a kind of facets and a relative index, of which there is one per program: it depends on
    /// nothing that can be differentiated or changed.
    pub fn get(kind: Ndf, eta: f64) -> &'static Self {
        static TABLES: LazyLock<Mutex<HashMap<(Ndf, u64), &'static Coat>>> =
            LazyLock::new(Mutex::default);
        let mut tables = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
        tables
            .entry((kind, eta.to_bits()))
            .or_insert_with(|| Box::leak(Box::new(Self::new(kind, eta))))
    }

    fn new(kind: Ndf, eta: f64) -> Self {
        // From where there is no coat, if that is not closer than it is worth a node.
        let own = eta.ln().max(0.0).sqrt();
        let place = (own / ETA_STEP - 0.25).ceil().max(0.0);
        let step = if place > 0.0 { own / place } else { ETA_STEP };
        let beyond = ((INDEX_RANGE.1.ln().sqrt() - own) / step).ceil().max(1.0);
        let others = (0..=(place + beyond) as usize).map(|_| OnceLock::new());
        Self {
            kind,
            eta,
            rows: std::array::from_fn(|_| OnceLock::new()),
            others: others.collect(),
            place: place as usize,
            step,
        }
    }

    /// A node of roughness. On this thread alone: one that shared the work could come to wait for itself.
    #[inline]
    fn node(&self, i: usize) -> &Row {
        self.rows[i].get_or_init(|| self.compute(i))
    }

    #[cold]
    fn compute(&self, i: usize) -> Row {
        let last = |n: usize, i: usize| i as f64 / (n - 1) as f64;
        let (lo, hi) = (ALPHA_RANGE.0.sqrt(), ALPHA_RANGE.1.sqrt());
        let facets = Facets::new(self.kind, (lo + (hi - lo) * last(ALPHAS, i)).powi(2));
        // At exactly grazing incidence reflection is a limit.
        let cosine = |j| last(COSINES, j).powi(2).max(1e-6);
        Row {
            transmit: std::array::from_fn(|j| 1.0 - facets.albedo(cosine(j), self.eta)),
            inside: facets.diffuse_albedo(1.0 / self.eta),
        }
    }

    /// The coat of index `k` among the [`Coat::others`].
    fn other(&self, k: usize) -> &Self {
        if k == self.place {
            return self;
        }
        self.others[k].get_or_init(|| {
            let steps = k as f64 - self.place as f64;
            let root = self.eta.ln().max(0.0).sqrt() + steps * self.step;
            Self::get(self.kind, root.powi(2).exp())
        })
    }

    /// What passes a coat of one roughness and index.
    #[inline]
    pub fn passes<R: Real>(&self, alpha: R, eta: R) -> Passes<'_, R> {
        let first = eta.primal() == R::Primal::of(self.eta);
        if first && (R::IS_PRIMAL || !eta.has_tangent()) {
            Passes::One(self.rough(alpha))
        } else {
            Passes::Between(self.between(alpha, eta))
        }
    }

    #[inline]
    fn rough<R: Real>(&self, alpha: R) -> Rough<'_, R> {
        let (lo, hi) = (ALPHA_RANGE.0.sqrt(), ALPHA_RANGE.1.sqrt());
        let x = (alpha.sqrt() - R::c(lo)) * R::c((ALPHAS - 1) as f64 / (hi - lo));
        let (i, weights) = spline(x, ALPHAS);
        let [a, b, c, d] = i;
        let rows = [self.node(a), self.node(b), self.node(c), self.node(d)];
        Rough { rows, weights }
    }

    /// The coats whose indices lie around `eta`, and their weights.
    #[inline(never)]
    fn between<R: Real>(&self, alpha: R, eta: R) -> Box<[(Rough<'_, R>, R); 4]> {
        // Exactly at the place of this coat where the index is its own.
        let own = R::Primal::of(self.eta).ln().sqrt();
        let steps = (root(eta) - Const(own)) * R::c(self.step.recip());
        let x = steps + R::c(self.place as f64);
        let (nodes, weights) = even_spline(x, self.others.len());
        Box::new(std::array::from_fn(|k| {
            (self.other(nodes[k]).rough(alpha), weights[k])
        }))
    }
}

/// A [`Coat`] of one roughness: nodes, and their weights.
#[derive(Clone, Copy, Debug)]
pub struct Rough<'a, R> {
    rows: [&'a Row; 4],
    weights: [R; 4],
}

/// A [`Coat`] of one roughness and one index.
#[derive(Clone, Debug)]
pub enum Passes<'a, R> {
    /// Of the index that the coat begins with.
    One(Rough<'a, R>),
    /// Of another index, or one that moves: coats around it, with their weights.
    Between(Box<[(Rough<'a, R>, R); 4]>),
}

impl<R: Real> Passes<'_, R> {
    /// Fraction of light from above, under the angle whose cosine is `cos`, that the coat does not reflect.
    #[inline]
    pub fn transmit(&self, cos: R) -> R {
        let (cell, weights) = place(cos);
        weighed(self.nodes(cell), weights)
    }

    /// What passes at the nodes around a [`place`].
    #[inline]
    pub(crate) fn nodes(&self, cell: u32) -> [R; 4] {
        let around = neighbours(cell as usize, COSINES);
        array(|k| self.node(around[k]))
    }

    #[inline(always)]
    fn node(&self, j: usize) -> R {
        self.sum(|row, w| w * R::c(row.transmit[j]))
    }

    /// Fraction of diffuse light from below that the coat reflects.
    #[inline]
    pub fn inside(&self) -> R {
        self.sum(|row, w| w * R::c(row.inside))
    }

    /// The sum over nodes of what they have with their weights.
    #[inline(always)]
    fn sum(&self, weighted: impl Fn(&Row, R) -> R) -> R {
        let of = |rough: &Rough<R>| {
            let mut sum = R::zero();
            for (row, &w) in rough.rows.iter().zip(&rough.weights) {
                sum += weighted(row, w);
            }
            sum
        };
        match self {
            Self::One(rough) => of(rough),
            Self::Between(coats) => {
                let mut sum = R::zero();
                for (rough, w) in coats.iter() {
                    sum += of(rough) * *w;
                }
                sum
            }
        }
    }
}

/// What passes a coat of one roughness and index at all nodes of cosines: to be kept for as long as these stay the same.
#[derive(Clone, Debug)]
pub struct Curve<P> {
    /// The first and the last one twice.
    nodes: [P; COSINES + 2],
    /// See [`Passes::inside`].
    pub inside: P,
}

impl<P: Float> Curve<P> {
    /// Of a coat.
    pub fn of(passes: &Passes<P>) -> Self {
        Self {
            nodes: array(|j| passes.node(j.saturating_sub(1).min(COSINES - 1))),
            inside: passes.inside(),
        }
    }

    /// [`Passes::nodes`].
    #[inline(always)]
    pub fn nodes(&self, cell: u32) -> [P; 4] {
        let first = (cell as usize).min(COSINES - 2);
        array(|k| self.nodes[first + k])
    }
}

/// The cell of nodes in which a cosine lies, and the weights of those [around](Passes::nodes) it: without a branch, for loops
/// over many.
#[inline(always)]
pub fn place<R: Real>(cos: R) -> (u32, [R; 4]) {
    let x = cos.sqrt() * R::c((COSINES - 1) as f64);
    let (cell, weights) = through(x, COSINES);
    (cell, continued(cell, before_first(cell, weights), COSINES))
}

/// The sum of what nodes have with their weights.
#[inline(always)]
pub fn weighed<R: Real>(nodes: [R; 4], weights: [R; 4]) -> R {
    let [a, b, c, d] = nodes;
    let [u, v, w, x] = weights;
    a * u + b * v + c * w + d * x
}

/// Nodes and weights of a Catmull-Rom spline through `n` equidistant values at `x` in `[0, n - 1]`.
/// Beyond the ends the values continue linearly.
#[inline]
fn spline<R: Real>(x: R, n: usize) -> ([usize; 4], [R; 4]) {
    let (cell, weights) = through(x, n);
    let weights = continued(cell, before_first(cell, weights), n);
    (neighbours(cell as usize, n), weights)
}

/// The same of an even function.
#[inline]
fn even_spline<R: Real>(x: R, n: usize) -> ([usize; 4], [R; 4]) {
    let (cell, weights) = through(x, n);
    let mut nodes = neighbours(cell as usize, n);
    if cell == 0 {
        nodes[0] = 1;
    }
    (nodes, continued(cell, weights, n))
}

/// The nodes around a cell. Where there is none, the nearest.
#[inline(always)]
fn neighbours(cell: usize, n: usize) -> [usize; 4] {
    [
        cell.saturating_sub(1),
        cell,
        cell + 1,
        (cell + 2).min(n - 1),
    ]
}

/// The cell of `x`, and the weights of four neighbours.
#[inline(always)]
fn through<R: Real>(x: R, n: usize) -> (u32, [R; 4]) {
    let last = R::Primal::of((n - 2) as f64);
    let cell = x.primal().floor().max(R::Primal::zero()).min(last);
    let t = x - Const(cell);
    let (t2, s) = (t.square(), R::one() - t);
    let s2 = s.square();
    // Hermite basis with slopes from central differences.
    let h0 = s2 * (t * R::c(2.0) + R::c(1.0));
    let h1 = t2 * (s * R::c(2.0) + R::c(1.0));
    let (d0, d1) = (s2 * t * R::c(0.5), -(t2 * s) * R::c(0.5));
    // Of numbers in this range the fastest conversion is right.
    let cell = cell.to_f64() as i32 as u32;
    (cell, [-d0, h0 - d1, h1 + d0, d1])
}

/// Linearly before the first node.
#[inline(always)]
fn before_first<R: Real>(cell: u32, w: [R; 4]) -> [R; 4] {
    let first = cell == 0;
    [
        R::select(first, R::zero(), w[0]),
        R::select(first, w[1] + w[0] * R::c(2.0), w[1]),
        R::select(first, w[2] - w[0], w[2]),
        w[3],
    ]
}

/// Linearly beyond the last one.
#[inline(always)]
fn continued<R: Real>(cell: u32, w: [R; 4], n: usize) -> [R; 4] {
    let last = cell as usize == n - 2;
    [
        w[0],
        R::select(last, w[1] - w[3], w[1]),
        R::select(last, w[2] + w[3] * R::c(2.0), w[2]),
        R::select(last, R::zero(), w[3]),
    ]
}

/// Normals of one roughness with quadrature weights: a midpoint rule in the random numbers, over
/// half of the azimuths.
struct Facets {
    microfacet: Microfacet<f64>,
    nodes: Vec<(Vec3<f64>, f64)>,
}

impl Facets {
    fn new(kind: Ndf, alpha: f64) -> Self {
        const ZENITH: u32 = 48;
        const AZIMUTH: u32 = 32;
        let microfacet = Microfacet {
            kind,
            alpha,
            visible: false,
        };
        let middle = |i: u32, n: u32| (f64::from(i) + 0.5) / f64::from(n);
        let mut nodes = Vec::new();
        for i in 0..ZENITH {
            // Finer where the slopes are steep.
            let v = middle(i, ZENITH);
            for j in 0..AZIMUTH {
                let m = microfacet.sample_all([1.0 - v * v, 0.5 * middle(j, AZIMUTH)]);
                nodes.push((m, 2.0 * v / f64::from(ZENITH * AZIMUTH) / m.z));
            }
        }
        Self { microfacet, nodes }
    }

    /// Reflected fraction of light under one angle: the mean of `F G cos(m) / (cos_o m.z)` over
    /// normals `m`.
    fn albedo(&self, cos: f64, eta: f64) -> f64 {
        let wo = Vec3::new((1.0 - cos * cos).sqrt(), 0.0, cos);
        let sigma_o = self.microfacet.sigma(wo);
        let reflected = |&(m, weight): &(Vec3<f64>, f64)| {
            let facing = wo.dot(m);
            let wi = reflect(wo, m);
            if facing <= 0.0 || wi.z <= 0.0 {
                return 0.0;
            }
            let f = fresnel::dielectric(facing, eta).reflect;
            weight * f * facing * wi.z / (sigma_o * self.microfacet.sigma(wi))
        };
        self.nodes.iter().map(reflected).sum()
    }

    /// Reflected fraction of diffuse light; `eta < 1`.
    fn diffuse_albedo(&self, eta: f64) -> f64 {
        const N: u32 = 24;
        // As in `fresnel::dielectric_diffuse`, on either side of total internal reflection.
        let critical = (1.0 - eta * eta).max(0.0).sqrt();
        let middle = |i| (f64::from(i) + 0.5) / f64::from(N);
        let total: f64 = (0..N)
            .map(|i| critical * middle(i))
            .map(|mu| 2.0 * mu * critical * self.albedo(mu, eta))
            .sum();
        let partial: f64 = (0..N)
            .map(|i| {
                let t = middle(i);
                let mu = critical + (1.0 - critical) * t * t;
                4.0 * mu * t * (1.0 - critical) * self.albedo(mu, eta)
            })
            .sum();
        (total + partial) / f64::from(N)
    }
}

#[cfg(test)]
mod tests {
    use ad_core::Dual;

    use super::*;

    type D = Dual<f64, 1>;

    /// What is kept of a coat is what passes it, bit by bit, at all cosines and beyond the ends of their range.
    #[test]
    fn what_is_kept_of_coats_is_what_passes() {
        let coat = Coat::get(Ndf::Ggx, 1.5);
        for (alpha, eta) in [(0.013, 1.5), (0.4, 1.5), (1.0, 1.5), (0.2, 1.7)] {
            let passes = coat.passes(alpha, eta);
            let curve = Curve::of(&passes);
            assert_eq!(curve.inside, passes.inside());
            for i in 0..=1000 {
                let cos = (f64::from(i) / 1000.0).powi(2) * 1.0001;
                let (cell, weights) = place(cos);
                assert_eq!(weighed(curve.nodes(cell), weights), passes.transmit(cos));
                let sum: f64 = weights.iter().sum();
                assert!((sum - 1.0).abs() < 1e-14, "{cos}: {weights:?}");
            }
        }
    }

    /// A spline goes through its nodes, and is linear, with the ends, where these are.
    #[test]
    fn splines_pass_nodes_and_are_linear_where_these_are() {
        let at = |values: [f64; 5], x: f64| {
            let (nodes, weights) = spline(x, values.len());
            let terms = nodes.into_iter().zip(weights);
            terms.map(|(i, w)| values[i] * w).sum::<f64>()
        };
        let values = [0.3, -1.0, 2.0, 0.5, 0.7];
        for (i, value) in values.into_iter().enumerate() {
            assert!((at(values, i as f64) - value).abs() < 1e-14, "{i}");
        }
        for k in 0..=400 {
            let x = f64::from(k) / 100.0;
            let line = [0.0, 1.0, 2.0, 3.0, 4.0].map(|x| 0.3 - 0.7 * x);
            assert!((at(line, x) - (0.3 - 0.7 * x)).abs() < 1e-14, "{x}");
        }
        assert_eq!(through(f64::NAN, 5).0, 0);
        assert_eq!(through(-3.0, 5).0, 0);
        assert_eq!(through(1e9f32, 5).0, 3);
    }

    /// Smooth coats between nodes, and their slopes by central differences.
    #[test]
    fn smooth_coats_are_those_of_fresnel() {
        let exact = |eta: f64| fresnel::dielectric_diffuse(1.0 / eta);
        for i in 0..200 {
            let eta = 0.1 * 100f64.powf((f64::from(i) + 0.37) / 200.0);
            let found = diffuse_below(D::var(eta, 0));
            assert!(
                (found.re - exact(eta)).abs() < 5e-6,
                "{eta}: {found:?} {}",
                exact(eta)
            );
            let h = 1e-3 * (eta - 1.0).abs();
            let slope = (exact(eta + h) - exact(eta - h)) / (2.0 * h);
            assert!(
                (found.eps[0] - slope).abs() < 1e-3 * (1.0 + slope.abs()),
                "{eta}: {found:?} {slope}"
            );
        }
        // From above where there is no coat.
        let [none, thin] = [1.0, 1.001].map(|eta| diffuse_below(D::var(eta, 0)));
        assert!(none.re.abs() < 1e-5, "{none:?}");
        assert!(
            (none.eps[0] - thin.eps[0]).abs() < 0.05 * thin.eps[0],
            "{none:?} {thin:?}"
        );
    }

    /// Coats of other indices than the first are those that begin with these, and so are their slopes; at the first one
    /// the number is the same, bit for bit, whether its index moves or not.
    #[test]
    fn coats_of_other_indices_lie_between() {
        for (kind, first) in [(Ndf::Ggx, 1.49), (Ndf::Beckmann, 1.01), (Ndf::Ggx, 1.0)] {
            let coat = Coat::get(kind, first);
            for eta in [1.05, 1.2, 1.37, 1.62, 2.4] {
                let exact = |eta: f64| Coat::get(kind, eta).passes(0.3, eta);
                let found = coat.passes(D::of(0.3), D::var(eta, 0));
                let h = 1e-4;
                let [low, known, high] = [eta - h, eta, eta + h].map(exact);
                let check = |found: D, of: fn(&Passes<f64>) -> f64| {
                    assert!(
                        (found.re - of(&known)).abs() < 2e-4,
                        "{first} {eta}: {found:?}"
                    );
                    let slope = (of(&high) - of(&low)) / (2.0 * h);
                    assert!(
                        (found.eps[0] - slope).abs() < 0.01 * (1.0 + slope.abs()),
                        "{first} {eta}: {found:?} {slope}"
                    );
                };
                check(found.inside(), |p| p.inside());
                check(found.transmit(D::of(0.9)), |p| p.transmit(0.9));
                check(found.transmit(D::of(0.2)), |p| p.transmit(0.2));
            }
            let none = coat.passes(D::of(0.3), D::var(1.0, 0)).inside();
            assert!(
                none.re.abs() < 1e-5 && none.eps[0].abs() < 0.5,
                "{first}: {none:?}"
            );
            if first == 1.0 {
                continue;
            }
            let still = coat.passes(0.3f32, first as f32);
            let moves = coat.passes(
                Dual::<f32, 1>::of(0.3),
                Dual::<f32, 1>::var(first as f32, 0),
            );
            assert_eq!(
                still.transmit(0.4),
                moves.transmit(Dual::<f32, 1>::of(0.4)).re
            );
            assert_eq!(still.inside(), moves.inside().re);
        }
    }
}
