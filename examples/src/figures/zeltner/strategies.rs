//! [Zeltner 2021, figures 4.10, 4.11 and 4.14]: detached, attached and differential sampling of
//! integrals over one dimension.

use std::f64::consts::{PI, TAU};

use ad_core::{Dual, Real};
use render::sampler::Sampler;

use super::mc1::{Density, Histogram, Moments, integrate, positions};
use super::taxonomy::{
    Bell, D, Integrand, Lobe, Sampling, Technique, Wrapped, WrappedNormal, differential, estimate,
    expectation,
};
use crate::chart::LineChart;
use crate::figure::{Figure, Result};

/// Exact mean and standard deviation over the random number.
fn exact(f: impl Fn(f64) -> f64) -> (f64, f64) {
    let mean = expectation(|u| Dual::lift(f(u))).re;
    let variance = expectation(|u| Dual::lift((f(u) - mean).powi(2))).re;
    (mean, variance.sqrt())
}

/// Whether measured moments agree with their exact values: mean and variance within 4 standard errors.
fn agrees(m: &Moments, (mean, std): (f64, f64)) -> bool {
    m.z(mean).abs() < 4.0 && (m.variance() - std * std).abs() < 4.0 * m.variance_error()
}

fn describe(m: &Moments, (mean, std): (f64, f64)) -> String {
    format!(
        "mean {:.4} ± {:.4}, std {:.4}; by quadrature {mean:.4} and {std:.4}",
        m.mean,
        m.error(),
        m.variance().sqrt()
    )
}

/// `zeltner-4-10`.
pub fn detached(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(20_000, 400_000), 410);
    fig.note("samples", n);
    fig.note("seed", seed);
    let mut peaks = Vec::new();
    for sd in [0.2, 1.0] {
        let one = |u| estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u);
        let primal = Moments::of(n, seed, |s| one(s.next_1d()).re);
        let derivative = Moments::of(n, seed, |s| one(s.next_1d()).eps[0]);
        fig.check(
            format!("sigma {sd}: p = f, and the primal estimate does not vary"),
            primal.variance() < 1e-24 && (primal.mean - 1.0).abs() < 1e-12,
            format!("{:.6}, variance {:.0e}", primal.mean, primal.variance()),
        );
        let expected = exact(|u| one(u).eps[0]);
        fig.check(
            format!("sigma {sd}: the detached estimate of the derivative, 0, is unbiased"),
            expected.0.abs() < 1e-9 && agrees(&derivative, expected),
            describe(&derivative, expected),
        );
        // Wrapping only matters where the tails meet.
        let before = 2f64.sqrt() / sd;
        fig.check(
            format!("sigma {sd}: its std is sqrt 2 / sigma = {before:.3} before wrapping"),
            (expected.1 / before - 1.0).abs() < if sd < 0.5 { 1e-6 } else { 0.1 },
            format!("{:.4} with wrapping", expected.1),
        );
        let weight = |x: f64| {
            let moving = Wrapped.eval(D::lift(x), D::var(sd, 0));
            moving.eps[0] / moving.re
        };
        let gap = positions([-2.0 * sd, 2.0 * sd], 200)
            .map(|x| (weight(x) - (x * x / sd.powi(3) - 1.0 / sd)).abs() * sd);
        let gap = gap.fold(0.0, f64::max);
        if sd < 0.5 {
            fig.check(
                "sigma 0.2: the weight is x^2 / sigma^3 - 1 / sigma, up to 2 sigma",
                gap < 1e-9,
                format!("largest relative gap {gap:.1e}"),
            );
        }
        peaks.push(expected.1);

        let rows: Vec<_> = positions([-PI, PI], 600)
            .map(|x| {
                let f = Wrapped.eval(D::lift(x), D::var(sd, 0));
                [x, f.re, f.eps[0]]
            })
            .collect();
        let name = format!("sigma-{sd}");
        let title = format!("Wrapped normal distribution, sigma = {sd}");
        let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let chart = LineChart::new(&title, "x", "f, df / d sigma")
            .line("f = p", column(1))
            .line("df / d sigma", column(2));
        fig.chart(&format!("{name}-function"), &chart);
        fig.csv(&format!("{name}-function"), &["x", "f", "derivative"], rows);
        let weights: Vec<_> = positions([0.001, 0.999], 600)
            .map(|u| [u, one(u).re, one(u).eps[0]])
            .collect();
        let column = |k: usize| weights.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let title = format!("Sample weights over random numbers, sigma = {sd}");
        // The same scale for both.
        let chart = LineChart::new(&title, "u", "weight")
            .y_range(-8.0, 30.0)
            .line("f / p", column(1))
            .line("(df / d sigma) / p, detached", column(2));
        fig.chart(&format!("{name}-weights"), &chart);
        let header = ["u", "primal", "detached"];
        fig.csv(&format!("{name}-weights"), &header, weights);
    }
    fig.check(
        "weights are smaller for the larger sigma",
        peaks[1] < 0.5 * peaks[0],
        format!("std {:.3} against {:.3}", peaks[1], peaks[0]),
    );
    Ok(())
}

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
            (e.0 - truth).abs() < 1e-6 && (agrees(m, e) || (m.mean - truth).abs() < 1e-9),
            format!("{}; true derivative {truth:.4}", describe(m, e)),
        );
    }
    let primal = self::exact(|u| one(Sampling::Detached, u).re).1;
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
pub fn attached(fig: &mut Figure) -> Result {
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

/// `zeltner-4-14`.
pub fn differential_lobes(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(20_000, 400_000), 414);
    let sd = 0.5;
    fig.note("samples", n);
    fig.note("seed", seed);
    fig.note("sigma", sd);
    let lobes = Lobe::pair(sd);
    let names = ["p+", "p-"];
    let slope = |x: f64| Wrapped.eval(D::lift(x), D::var(sd, 0)).eps[0];
    for (lobe, name) in lobes.iter().zip(names) {
        let total = integrate(lobe.range(), 4000, |x| lobe.pdf(x));
        fig.check(
            format!("{name} integrates to 1"),
            (total - 1.0).abs() < 1e-9,
            format!("{total:.12}"),
        );
        let weights: Vec<f64> = positions([0.001, 0.999], 1000)
            .map(|u| {
                let x = lobe.sample(u);
                slope(x) / lobe.pdf(x)
            })
            .collect();
        let spread = weights.iter().map(|w| (w / lobe.mass - 1.0).abs());
        let spread = spread.fold(0.0, f64::max);
        fig.check(
            format!("{name}: weights of constant magnitude"),
            spread < 1e-9,
            format!("{:.6} everywhere, relative spread {spread:.0e}", lobe.mass),
        );
        let samples: Vec<f64> = (0..n)
            .map(|i| lobe.sample(render::sampler::Independent::new(seed, 0, i).next_1d()))
            .collect();
        let histogram = Histogram::of(&samples, lobe);
        fig.check(
            format!("{name}: samples follow the density"),
            histogram.deviate.abs() < 4.0,
            format!(
                "chi-square deviate {:.2}, at most 4 ({n} samples)",
                histogram.deviate
            ),
        );
    }
    let pair = Moments::of(n, seed, |s| differential(&Wrapped, &lobes, sd, s.next_1d()));
    fig.check(
        "one sample from each lobe: std 0, and the total gradient is 0",
        pair.variance().sqrt() < 1e-9 && pair.mean.abs() < 1e-9,
        format!("{:.1e} ± {:.1e}", pair.mean, pair.variance().sqrt()),
    );
    // The pair has two evaluations, so one lobe at random is the estimator of the same cost as one
    // sample of p; both are far behind.
    let random = Moments::of(n, seed, |s| {
        let lobe = &lobes[usize::from(s.next_1d::<f64>() < 0.5)];
        let x = lobe.sample(s.next_1d());
        2.0 * slope(x) / lobe.pdf(x)
    });
    let plain = exact(|u| estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u).eps[0]);
    fig.check(
        "one lobe chosen at random helps little: std twice the mass, against that of p = f",
        (random.variance().sqrt() / (2.0 * lobes[0].mass) - 1.0).abs() < 1e-3
            && random.variance().sqrt() > 0.5 * plain.1,
        format!("{:.4} against {:.4}", random.variance().sqrt(), plain.1),
    );
    let narrow = Lobe::pair(0.2);
    let scaled = narrow.map(|l| l.mass.abs() * 0.2);
    fig.check(
        "mass of each lobe 0.483941 / sigma before wrapping (sigma 0.2)",
        scaled.iter().all(|m| (m - 0.483941).abs() < 1e-6),
        format!("{:.6} and {:.6} / sigma", scaled[0], scaled[1]),
    );
    // Light that varies: the pair no longer cancels, but stays ahead.
    let lit = |x: f64| slope(x) * (1.0 + 0.9 * x.cos());
    let truth = integrate([-PI, PI], 4000, lit);
    let weight = |lobe: &Lobe, u: f64| {
        let x = lobe.sample(u);
        lit(x) / lobe.pdf(x)
    };
    let paired = Moments::of(n, seed + 1, |s| {
        let u = s.next_1d();
        lobes.iter().map(|lobe| weight(lobe, u)).sum()
    });
    let plain = exact(|u| {
        let x = Wrapped.sample(u, sd);
        lit(x) / WrappedNormal { sd }.pdf(x)
    });
    let std = paired.variance().sqrt();
    fig.check(
        "under light 1 + 0.9 cos x: the pair is unbiased and varies less than a fifth of p = f",
        paired.z(truth).abs() < 4.0 && std < 0.2 * plain.1,
        format!(
            "{:.5} ± {:.5}, true {truth:.5}; std {std:.3} against {:.3}",
            paired.mean,
            paired.error(),
            plain.1
        ),
    );

    // The positive lobe ends beyond pi: shown where it comes back.
    let rows: Vec<_> = positions([-PI, PI], 600)
        .map(|x| {
            let at = |l: &Lobe| {
                let [a, b] = l.range();
                let inside = [x, x + TAU].into_iter().find(|x| (a..=b).contains(x));
                inside.map_or(0.0, |x| l.pdf(x))
            };
            let p = WrappedNormal { sd }.pdf(x);
            [x, p, slope(x), at(&lobes[0]), at(&lobes[1])]
        })
        .collect();
    let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let title = "Densities for the derivative of a wrapped normal distribution";
    let chart = LineChart::new(title, "x", "f, df / d sigma, p")
        .line("df / d sigma", column(2))
        .line("p-", column(4))
        .line("p+", column(3))
        .dashed("f", column(1));
    fig.chart("densities", &chart);
    fig.csv(
        "densities",
        &["x", "f", "derivative", "plus", "minus"],
        rows,
    );
    let weights: Vec<_> = positions([0.001, 0.999], 600)
        .map(|u| {
            let one = estimate(&Wrapped, &Wrapped, Sampling::Detached, sd, u).eps[0];
            [u, one, lobes[0].mass, lobes[1].mass]
        })
        .collect();
    let column = |k: usize| weights.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new("Sample weights of the derivative", "u", "weight")
        .line("p = f", column(1))
        .line("p-", column(3))
        .line("p+", column(2));
    fig.chart("weights", &chart);
    fig.csv("weights", &["u", "primal", "plus", "minus"], weights);
    Ok(())
}
