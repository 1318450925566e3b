//! Rough plastic: a diffuse base under a rough dielectric coat.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex, OnceLock, PoisonError};

use ad_core::{Const, Float, Real, Vec3};

use super::dielectric::wrong_index;
use super::microfacet::{ALPHA_RANGE, Microfacet, Ndf};
use super::plastic::{Coated, CoatedLobe};
use super::rough_conductor::{
    Facets as Known, Roughness, half_vector, pdf_reflected_differential, reflect, reflection,
    reflection_of_normals, sample_reflected_differential,
};
use super::{BsdfSample, Component, Leaf, Lobe, Reader, TransportMode, constant, fresnel};
use crate::error::SceneError;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};

/// A diffuse surface under a rough coat.
#[derive(Clone, Debug)]
pub struct RoughPlastic {
    /// The coat's microsurface.
    pub roughness: Roughness,
    /// Colours and index.
    pub coated: Coated,
    table: &'static Coat,
}

/// Reflection by the coat's facets, and what comes back from below it: the model of Mitsuba's
/// `roughplastic`.
///
/// What passes the coat is all that its facets do not reflect at once. Mitsuba lets through what rough glass of the same
/// roughness transmits, which is less: what facets hide from each other is lost there. Ours is brighter by some percent,
/// the more the rougher; neither returns all light where nothing absorbs any.
///
/// How much light passes the coat has no closed form and is interpolated in a [`Coat`]. The
/// interpolant *is* the model: it is continuously differentiable in roughness and angle, and
/// derivatives are exactly those of the values.
#[derive(Clone, Copy, Debug)]
pub struct RoughPlasticLobe<R: Real> {
    /// The coat's facets.
    pub microfacet: Microfacet<R>,
    /// Colours and index.
    pub coated: CoatedLobe<R>,
    /// What passes the coat.
    pub table: &'static Coat,
}

impl RoughPlastic {
    /// From its parts.
    pub fn new(roughness: Roughness, coated: Coated) -> Self {
        let table = Coat::get(roughness.kind, coated.eta);
        Self {
            roughness,
            coated,
            table,
        }
    }
}

impl Leaf for RoughPlastic {
    type Lobe<R: Real> = RoughPlasticLobe<R>;
    const DIFFERENTIAL: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> RoughPlasticLobe<R> {
        RoughPlasticLobe {
            microfacet: self.roughness.read(read),
            coated: CoatedLobe::read(&self.coated, read),
            table: self.table,
        }
    }
}

impl<R: Real> RoughPlasticLobe<R> {
    #[inline]
    fn choose_coat(&self, wo: Vec3<R>) -> R::Primal {
        let alpha = self.microfacet.alpha.primal();
        let passes = self.table.transmit(wo.z.primal(), alpha);
        self.coated.choose_coat(R::Primal::one() - passes)
    }
}

impl<P: Float> CoatedLobe<P> {
    /// [`Lobe::eval_pdf`] of a rough coat where the facets and the [`Passes`] of `wo` and of `wi` are known, and visible
    /// normals are sampled: without a branch, for loops over many.
    #[inline(always)]
    pub(crate) fn rough_eval_pdf(
        &self,
        facets: &Known<P>,
        [wo, wi]: [Vec3<P>; 2],
        [t_o, t_i, inside]: [P; 3],
    ) -> (Rgb<P>, P) {
        let (zero, one) = (P::zero(), P::one());
        let f = fresnel::dielectric(wo.dot(facets.m), self.eta).reflect;
        let coat = f * facets.reflection(wi);
        let value = self.specular_reflectance * coat + self.diffuse(wi.z, t_i, t_o, inside);
        let coat = self.choose_coat(one - t_o);
        let base = warp::cosine_hemisphere_pdf(wi.z) * (one - coat);
        let pdf = facets.pdf_reflected() * coat + base;
        let lit = (wo.z > zero) & (wi.z > zero);
        let value = Rgb::select(lit, value, Rgb::black());
        (value, P::select(lit, pdf, zero))
    }

    /// The direction that [`Lobe::sample`] of a rough coat finds by a normal of its facets: likewise.
    #[inline(always)]
    pub(crate) fn rough_sample(&self, wo: Vec3<P>, m: Vec3<P>, u: [P; 3], t_o: P) -> Vec3<P> {
        let reflects = u[0] < self.choose_coat(P::one() - t_o);
        let base = warp::square_to_cosine_hemisphere([u[1], u[2]]);
        Vec3::select(reflects, reflect(wo, m), base)
    }
}

impl<R: Real> Lobe<R> for RoughPlasticLobe<R> {
    #[inline]
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        let f = fresnel::dielectric(wo.dot(m), R::lift(self.coated.eta)).reflect;
        let coat = f * reflection(&self.microfacet, wo, wi, m);
        let alpha = self.microfacet.alpha;
        let (t_i, t_o) = (
            self.table.transmit(wi.z, alpha),
            self.table.transmit(wo.z, alpha),
        );
        self.coated.specular_reflectance * coat
            + self
                .coated
                .diffuse(wi.z, t_i, t_o, self.table.inside(alpha))
    }

    #[inline]
    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, _mode: TransportMode) -> R {
        let Some(m) = half_vector(wo, wi) else {
            return R::zero();
        };
        let coat = self.choose_coat(wo);
        self.microfacet.pdf_reflected(wo, m) * Const(coat)
            + warp::cosine_hemisphere_pdf(wi.z) * Const(R::Primal::one() - coat)
    }

    /// Chooses coat or base by the (primal) light they send on.
    #[inline]
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        if wo.z.primal() <= R::Primal::zero() {
            return None;
        }
        let wi = if u[0] < self.choose_coat(wo) {
            reflect(wo, self.microfacet.sample(wo, [u[1], u[2]]))
        } else {
            Vec3::lift(warp::square_to_cosine_hemisphere([u[1], u[2]]))
        };
        let pdf = self.pdf(wo, wi, mode);
        BsdfSample::reflected(wi, pdf)
    }

    #[inline]
    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        _mode: TransportMode,
    ) -> R {
        let Some(m) = half_vector(wo, wi) else {
            return R::zero();
        };
        let passes = self.table.transmit(wo.z, self.microfacet.alpha);
        let coat = self.coated.attached_choice(R::one() - passes);
        constant(self.microfacet.pdf_reflected(wo, m)) * coat
            + constant(warp::cosine_hemisphere_pdf(wi.z)) * (R::one() - coat)
    }

    /// Of the coat only: the base changes little with roughness.
    #[inline]
    fn eval_normals(
        &self,
        wo: Vec3<R::Primal>,
        wi: Vec3<R::Primal>,
        _mode: TransportMode,
    ) -> Rgb<R> {
        let Some(m) = half_vector(wo, wi) else {
            return Rgb::black();
        };
        let f = fresnel::dielectric(wo.dot(m), self.coated.eta).reflect;
        let coat = self.coated.specular_reflectance.primal() * f;
        Rgb::lift(coat) * reflection_of_normals(&self.microfacet, wo, wi, m)
    }

    #[inline]
    fn sample_differential(
        &self,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> [Option<BsdfSample<R::Primal>>; 2] {
        sample_reflected_differential(&self.microfacet.primal(), wo, [u[1], u[2]])
    }

    #[inline]
    fn pdf_differential(&self, wo: Vec3<R::Primal>, wi: Vec3<R::Primal>) -> R::Primal {
        pdf_reflected_differential(&self.microfacet.primal(), wo, wi)
    }
}

impl FromNode for RoughPlastic {
    const PLUGINS: &'static [&'static str] = &["roughplastic"];

    /// As [`Roughness::from_node`] and [`Coated::from_node`], and with a coat denser than what is above it: where total
    /// reflection begins, a [`Coat`] is not exact.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let roughness = Roughness::from_node(node, registry)?;
        let coated = Coated::from_node(node, registry)?;
        if coated.eta < 1.0 {
            let expected = "a rough coat denser than what is above it (a smooth one, `plastic`, may be either)";
            return Err(wrong_index(node, expected));
        }
        Ok(Self::new(roughness, coated))
    }
}

/// How much light passes a rough coat, as a function of roughness and angle.
///
/// Nodes are equidistant in the square roots of roughness and cosine: what happens at small values
/// of either needs them. Between nodes: Catmull-Rom splines. What belongs to a node of roughness is computed when it is
/// first asked for: most materials need four of them, and those that are not seen none.
#[derive(Debug)]
pub struct Coat {
    kind: Ndf,
    eta: f64,
    rows: [OnceLock<Row>; ALPHAS],
}

/// A node of roughness.
#[derive(Debug)]
struct Row {
    /// Light from above that is not reflected, `[cosine]`.
    transmit: [f64; COSINES],
    /// Reflectance for diffuse light from below.
    inside: f64,
}

const ALPHAS: usize = 24;
const COSINES: usize = 32;

impl Coat {
    /// The table for a kind of facets and a relative index, of which there is one per program: it depends on
    /// nothing that can be differentiated or changed.
    pub fn get(kind: Ndf, eta: f64) -> &'static Self {
        static TABLES: LazyLock<Mutex<HashMap<(Ndf, u64), &'static Coat>>> =
            LazyLock::new(Mutex::default);
        let mut tables = TABLES.lock().unwrap_or_else(PoisonError::into_inner);
        tables.entry((kind, eta.to_bits())).or_insert_with(|| {
            let rows = std::array::from_fn(|_| OnceLock::new());
            Box::leak(Box::new(Self { kind, eta, rows }))
        })
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

    /// Fraction of light from above, under the angle whose cosine is `cos`, that the coat does not
    /// reflect.
    #[inline]
    pub fn transmit<R: Real>(&self, cos: R, alpha: R) -> R {
        self.passes(alpha).transmit(cos)
    }

    /// Fraction of diffuse light from below that the coat reflects.
    #[inline]
    pub fn inside<R: Real>(&self, alpha: R) -> R {
        self.passes(alpha).inside()
    }

    /// What passes a coat of one roughness.
    #[inline]
    pub(crate) fn passes<R: Real>(&self, alpha: R) -> Passes<'_, R> {
        let (lo, hi) = (ALPHA_RANGE.0.sqrt(), ALPHA_RANGE.1.sqrt());
        let x = (alpha.sqrt() - R::c(lo)) * R::c((ALPHAS - 1) as f64 / (hi - lo));
        let (i, weights) = spline(x, ALPHAS);
        let [a, b, c, d] = i;
        let rows = [self.node(a), self.node(b), self.node(c), self.node(d)];
        Passes { rows, weights }
    }
}

/// A [`Coat`] of one roughness: nodes, and their weights.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Passes<'a, R> {
    rows: [&'a Row; 4],
    weights: [R; 4],
}

impl<R: Real> Passes<'_, R> {
    /// See [`Coat::transmit`].
    #[inline]
    pub fn transmit(&self, cos: R) -> R {
        let (j, wj) = spline(cos.sqrt() * R::c((COSINES - 1) as f64), COSINES);
        let mut sum = R::zero();
        for (row, &w) in self.rows.iter().zip(&self.weights) {
            let mut value = R::zero();
            for (b, wj) in wj.into_iter().enumerate() {
                value += wj * R::c(row.transmit[j[b]]);
            }
            sum += value * w;
        }
        sum
    }

    /// See [`Coat::inside`].
    #[inline]
    pub fn inside(&self) -> R {
        let mut sum = R::zero();
        for (row, &w) in self.rows.iter().zip(&self.weights) {
            sum += w * R::c(row.inside);
        }
        sum
    }
}

/// Nodes and weights of a Catmull-Rom spline through `n` equidistant values at `x` in `[0, n - 1]`.
/// Beyond the ends the values continue linearly.
#[inline]
fn spline<R: Real>(x: R, n: usize) -> ([usize; 4], [R; 4]) {
    let cell = (x.primal().floor().to_f64().max(0.0) as usize).min(n - 2);
    let t = x - R::c(cell as f64);
    let (t2, s) = (t.square(), R::one() - t);
    let s2 = s.square();
    // Hermite basis with slopes from central differences.
    let h0 = s2 * (t * R::c(2.0) + R::c(1.0));
    let h1 = t2 * (s * R::c(2.0) + R::c(1.0));
    let (d0, d1) = (s2 * t * R::c(0.5), -(t2 * s) * R::c(0.5));
    let mut w = [-d0, h0 - d1, h1 + d0, d1];
    let mut i = [
        cell.saturating_sub(1),
        cell,
        cell + 1,
        (cell + 2).min(n - 1),
    ];
    if cell == 0 {
        w = [R::zero(), w[1] + w[0] * R::c(2.0), w[2] - w[0], w[3]];
        i[0] = 0;
    }
    if cell == n - 2 {
        w = [w[0], w[1] - w[3], w[2] + w[3] * R::c(2.0), R::zero()];
    }
    (i, w)
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
