//! [Stam 2020, section 5.2]: the example with two controls, an albedo and an emission, on a path whose
//! directions are cosine-weighted; and the general recursion of section 5.1 as printed and as corrected.

use ad_core::chain::Chain;
use ad_core::check::central_difference;
use ad_core::{DiffFn, Real, diff_fn, gradient};

use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Emission at the end of the path, and the radiance that is wanted.
const EMISSION: f64 = 1.0;
const TARGET: f64 = 0.25;
const THETA: [f64; 2] = [0.6, 2.0];

/// `L_0` by the forward pass.
fn forward<R: Real>([albedo, emission]: [R; 2], vertices: usize) -> R {
    (1..vertices).fold(emission * R::c(EMISSION), |l, _| albedo * l)
}

/// The cost as a function of the controls.
struct Cost {
    vertices: usize,
}

impl DiffFn<2, 1> for Cost {
    fn eval<R: Real>(&self, theta: [R; 2]) -> [R; 1] {
        let miss = forward(theta, self.vertices) - R::of(TARGET);
        [miss * miss * R::c(0.5)]
    }
}

diff_fn! {
    /// One scattering event: the new radiance.
    fn scatter<R>([radiance, albedo]: [R; 2]) -> [R; 1] { [albedo * radiance] }
}

/// Forward and backward pass as in the paper: radiances first, then adjoints.
fn two_passes([albedo, emission]: [f64; 2], vertices: usize) -> (f64, [f64; 2]) {
    let mut l = vec![0.0; vertices];
    l[vertices - 1] = emission * EMISSION;
    for k in (1..vertices).rev() {
        l[k - 1] = albedo * l[k];
    }
    let mut d = [0.0; 2];
    let mut p = l[0] - TARGET;
    for l in &l[1..] {
        d[0] += p * l;
        p *= albedo;
    }
    d[1] = p * EMISSION;
    (l[0], d)
}

/// The same by `ad-core`'s tape-free reverse mode.
fn reverse([albedo, emission]: [f64; 2], vertices: usize) -> [f64; 2] {
    let mut chain = Chain::<f64, 2, 1>::with_capacity(vertices);
    chain.start([emission * EMISSION]);
    for _ in 1..vertices {
        chain.advance(&scatter, [albedo]);
    }
    let [l] = chain.state();
    let mut d_albedo = 0.0;
    let [d_l] = chain.pull_back([l - TARGET], |_, [d]: [f64; 1]| d_albedo += d);
    [d_albedo, d_l * EMISSION]
}

fn relative(a: f64, b: f64) -> f64 {
    (a - b).abs() / b.abs().max(f64::MIN_POSITIVE)
}

/// `stam-alg-5-2`.
pub fn figure(fig: &mut Figure) -> Result {
    let [a, e] = THETA;
    let mut worst = [0.0f64; 4]; // radiance, two passes, dual numbers, reverse mode
    let mut fd_error = 0.0f64;
    let mut rows = Vec::new();
    for n in 2..=8 {
        let closed_l = a.powi(n as i32 - 1) * e * EMISSION;
        let miss = closed_l - TARGET;
        let closed = [
            miss * (n - 1) as f64 * a.powi(n as i32 - 2) * e * EMISSION,
            miss * a.powi(n as i32 - 1) * EMISSION,
        ];
        let (l, passes) = two_passes(THETA, n);
        let (_, dual) = gradient(&Cost { vertices: n }, THETA);
        let chain = reverse(THETA, n);
        worst[0] = worst[0].max(relative(l, closed_l));
        for k in 0..2 {
            for (w, d) in worst[1..].iter_mut().zip([passes, dual, chain]) {
                *w = w.max(relative(d[k], closed[k]));
            }
            let cost = |x: f64| {
                let mut theta = THETA;
                theta[k] = x;
                Cost { vertices: n }.eval(theta)[0]
            };
            let fd = central_difference(cost, THETA[k], 1e-5);
            fd_error = fd_error.max(relative(fd.value, closed[k]));
        }
        rows.push([
            n as f64, l, closed[0], passes[0], dual[0], chain[0], closed[1], passes[1],
        ]);
    }
    let header = [
        "vertices",
        "L0",
        "closed_d1",
        "passes_d1",
        "dual_d1",
        "reverse_d1",
        "closed_d2",
        "passes_d2",
    ];
    fig.note("theta", THETA.to_vec());
    fig.note("emission", EMISSION);
    fig.note("target", TARGET);
    let limit = 1e-12;
    let text = |w: f64| format!("largest relative error {w:.1e}, N = 2..8, at most {limit:.0e}");
    fig.check(
        "L_0 = theta_1^(N-1) theta_2 E_N",
        worst[0] < limit,
        text(worst[0]),
    );
    fig.check(
        "gradients of forward and backward pass equal the closed form",
        worst[1] < limit,
        text(worst[1]),
    );
    fig.check(
        "dual numbers give the same",
        worst[2] < limit,
        text(worst[2]),
    );
    fig.check(
        "reverse mode gives the same",
        worst[3] < limit,
        text(worst[3]),
    );
    fig.check(
        "central differences agree",
        fd_error < 1e-6,
        format!("largest relative error {fd_error:.1e}, at most 1e-6"),
    );

    // Section 5.1 for uniformly sampled hemispheres: cos / p = 2 pi cos depends on the vertex.
    let (rho, cos, emission) = (a / std::f64::consts::PI, [0.8, 0.3], e * EMISSION);
    let step = |k: usize, rho: f64| rho * 2.0 * std::f64::consts::PI * cos[k];
    let radiance = |albedo: f64| {
        let rho = albedo / std::f64::consts::PI;
        step(0, rho) * step(1, rho) * emission
    };
    let true_d = central_difference(radiance, a, 1e-4).value;
    let d_rho = |k: usize| step(k, 1.0) / std::f64::consts::PI;
    let corrected = d_rho(0) * (step(1, rho) * emission) + step(0, rho) * d_rho(1) * emission;
    // Printed: the update lacks cos / p, and the adjoint takes the cosine of the arriving direction.
    let arriving = 0.5;
    let printed_adjoint = rho * 2.0 * std::f64::consts::PI * arriving;
    let per_pi = 1.0 / std::f64::consts::PI;
    let printed = per_pi * (step(1, rho) * emission) + printed_adjoint * per_pi * emission;
    fig.check(
        "section 5.1, uniform sampling: corrected backward pass equals the derivative",
        relative(corrected, true_d) < 1e-8,
        format!("{corrected:.9}, differences {true_d:.9}"),
    );
    fig.check(
        "section 5.1 as printed does not (errata S-5.1)",
        relative(printed, true_d) > 0.1,
        format!("{printed:.6} instead of {true_d:.6}"),
    );
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k].abs())).collect::<Vec<_>>();
    let chart = LineChart::new(
        "Two controls: gradient against path length",
        "vertices N",
        "|dJ/d theta|",
    )
    .log_y()
    .line("albedo, closed form", curve(2))
    .points("albedo, backward pass", curve(3))
    .line("emission, closed form", curve(6))
    .points("emission, backward pass", curve(7));
    fig.csv("gradients", &header, rows);
    fig.chart("gradients", &chart);
    Ok(())
}
