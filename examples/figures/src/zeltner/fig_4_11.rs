//! [Zeltner 2021, figure 4.11]: attached sampling of integrals over one dimension.

use std::f64::consts::TAU;

use ad_core::Real;
use render::sampler::Sampler;

use super::exact_moments::{agrees, describe, exact};
use super::integration_1d::{integrate, positions};
use super::taxonomy::{Bell, D, Integrand, Sampling, Technique, estimate};
use crate::statistics::Moments;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// `exp(-x^2 / (2 pi^2)) / (sqrt(2 pi) pi)`: a normal distribution that is not normalised to its
/// interval.
#[derive(Clone, Copy, Debug)]
struct Gauss;

impl Integrand for Gauss {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        ((x / pi).square() * R::c(-0.5)).exp() * R::c(1.0 / TAU.sqrt()) / pi
    }
}

/// Scaled Gaussians: `exp(-x^2 / (2 pi^2))`, times one of fixed width.
#[derive(Clone, Copy, Debug)]
struct Gaussians {
    fixed: f64,
}

impl Integrand for Gaussians {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        let square = (x / pi).square() + (x * R::c(1.0 / self.fixed)).square();
        (square * R::c(-0.5)).exp()
    }
}

/// [`Gauss`] times light that varies: `1 + 0.9 cos(k x)`.
#[derive(Clone, Copy, Debug)]
struct Lit {
    frequency: f64,
}

impl Integrand for Lit {
    fn eval<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        Gauss.eval(x, pi) * ((x * R::c(self.frequency)).cos() * R::c(0.9) + R::c(1.0))
    }
}

/// A [`Bell`] a little too wide: of standard deviation `sqrt(pi^2 + 0.1^2)`.
#[derive(Clone, Copy, Debug)]
struct Wider(Bell);

fn wider<R: Real<Primal = f64>>(pi: R) -> R {
    (pi.square() + R::c(0.01)).sqrt()
}

impl Technique for Wider {
    fn pdf<R: Real<Primal = f64>>(&self, x: R, pi: R) -> R {
        self.0.pdf(x, wider(pi))
    }
    fn sample<R: Real<Primal = f64>>(&self, u: f64, pi: R) -> R {
        self.0.sample(u, wider(pi))
    }
}

/// Estimates that are compared with quadrature: of three integrals, detached and attached.
const ESTIMATES: usize = 6;

/// Moments of one estimator.
struct Study {
    derivative: [Moments; 2],
    exact: [(f64, f64); 2],
    primal: f64,
}

/// Detached and attached estimates with one technique, measured and by quadrature; checks that both
/// are unbiased.
fn study(
    fig: &mut Figure,
    n: u64,
    name: &str,
    f: &impl Integrand,
    t: &impl Technique,
    range: [f64; 2],
    pi: f64,
) -> Study {
    let truth = integrate(range, 4000, |x| f.eval(D::lift(x), D::var(pi, 0)).eps[0]);
    let one = |sampling, u| estimate(f, t, sampling, pi, u);
    let exact = Sampling::ALL.map(|s| exact(|u| one(s, u).eps[0]));
    let seed = 411;
    let derivative = Sampling::ALL.map(|s| Moments::of(n, seed, |r| one(s, r.next_1d()).eps[0]));
    for k in 0..2 {
        let (m, e) = (&derivative[k], exact[k]);
        fig.check(
            format!("{name}, {:?}: unbiased", Sampling::ALL[k]),
            // Without variance there are no standard errors.
            (e.0 - truth).abs() < 1e-6
                && (agrees(m, e, ESTIMATES) || (m.mean - truth).abs() < 1e-9),
            format!("{}; true derivative {truth:.4}", describe(m, e)),
        );
    }
    let primal = super::exact_moments::exact(|u| one(Sampling::Detached, u).re).1;
    let weights: Vec<_> = positions([0.001, 0.999], 600)
        .map(|u| {
            let [d, a] = Sampling::ALL.map(|s| one(s, u));
            [u, d.re, d.eps[0], a.eps[0]]
        })
        .collect();
    let column = |k: usize| weights.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let file = name.replace(' ', "-");
    let chart = LineChart::new(&format!("Sample weights, {name}"), "u", "weight")
        .line("primal", column(1))
        .line("detached derivative", column(2))
        .line("attached derivative", column(3));
    fig.chart(&file, &chart);
    let header = ["u", "primal", "detached", "attached"];
    fig.csv(&file, &header, weights);
    Study {
        derivative,
        exact,
        primal,
    }
}

/// Standard deviations of detached and attached sampling of [`Lit`] at `k sigma`, for sigma 0.3, in two
/// digits [errata F28].
const LIT: [(f64, [f64; 2]); 4] = [
    (0.1, [8.9, 0.042]),
    (1.0, [4.1, 1.7]),
    (3.0, [6.4, 6.4]),
    (6.0, [5.6, 12.7]),
];

/// `zeltner-4-11`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(20_000, 400_000);
    let sd = 0.3;
    fig.note("samples", n);
    fig.note("sigma", sd);
    let range = [-1.0, 1.0];
    let bell = Bell { range };
    let top = study(fig, n, "a single factor", &Gauss, &bell, range, sd);
    let [detached, attached] = top.exact.map(|e| e.1);
    fig.check(
        "a single factor, p proportional to it: attached std below 0.01 of detached",
        attached < 0.01 * detached && top.derivative[1].variance().sqrt() < 0.01 * detached,
        format!("{attached:.1e} against {detached:.3}"),
    );
    let near = study(
        fig,
        n,
        "a density near the factor",
        &Gauss,
        &Wider(bell),
        range,
        sd,
    );
    let [detached, attached] = near.exact.map(|e| e.1);
    fig.check(
        "p only near it: attached still varies less than detached, by more than half",
        attached < 0.5 * detached,
        format!("{attached:.3} against {detached:.3}"),
    );
    let whole = [-3.0, 3.0];
    let product = Gaussians { fixed: sd };
    let bell = Bell { range: whole };
    let bottom = study(fig, n, "a product", &product, &bell, whole, sd);
    let attached = bottom.exact[1].1;
    fig.check(
        "a product sampled by one factor: attached std above 3 times the primal std",
        attached > 3.0 * bottom.primal,
        format!(
            "{attached:.3} against {:.3}: {:.2} times (detached {:.3})",
            bottom.primal,
            attached / bottom.primal,
            bottom.exact[0].1
        ),
    );

    let stds = |ks: f64| {
        let f = Lit { frequency: ks / sd };
        Sampling::ALL.map(|s| exact(|u| estimate(&f, &bell, s, sd, u).eps[0]).1)
    };
    for (ks, expected) in LIT {
        let found = stds(ks);
        // Half a unit of the last digit.
        let rounding = |x: f64| if x < 1.0 { 5e-4 } else { 0.05 };
        let ok = (0..2).all(|k| (found[k] - expected[k]).abs() < rounding(expected[k]));
        fig.check(
            format!(
                "under light of k sigma = {ks}: std {} detached, {} attached",
                expected[0], expected[1]
            ),
            ok,
            format!("{:.4}, {:.4}", found[0], found[1]),
        );
    }
    let rows: Vec<_> = positions([0.0, 40.0], fig.pick(20, 80))
        .map(|i| {
            let ks = 0.1 * 100f64.powf(i / 40.0);
            let [d, a] = stds(ks);
            [ks, d, a]
        })
        .collect();
    let above: Vec<f64> = (rows.iter().filter(|r| r[2] > r[1]).map(|r| r[0])).collect();
    let first = above.first().copied().unwrap_or(f64::NAN);
    fig.check(
        "attached varies more than detached for k sigma above about 3, and only there",
        (2.5..3.5).contains(&first) && above.len() == rows.iter().filter(|r| r[0] >= first).count(),
        format!(
            "from {first:.2} on, at {} of {} values",
            above.len(),
            rows.len()
        ),
    );
    let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let title = "A normal distribution (sigma 0.3) times 1 + 0.9 cos(k x)";
    let chart = LineChart::new(title, "k sigma", "standard deviation of one sample")
        .log_x()
        .log_y()
        .line("detached", column(1))
        .line("attached", column(2));
    fig.chart("light", &chart);
    fig.csv("light", &["k_sigma", "detached", "attached"], rows);
    Ok(())
}
