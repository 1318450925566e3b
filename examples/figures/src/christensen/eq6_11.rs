//! Equations 6 to 11 between patches without geometry.

use render::finite_element::discrete::Patches;
use render::sampler::{Independent, Sampler};

use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 611;
/// Number of patches.
const N: usize = 12;

struct Numbers(Independent);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0.next_1d::<f64>()
    }
    fn field(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.next()).collect()
    }
}

/// Random symmetric geometry; a BRDF that is reciprocal but for the fraction `skew`.
fn patches(random: &mut Numbers, skew: f64) -> Patches {
    let mut geometry = vec![0.0; N * N];
    for x in 0..N {
        for y in 0..x {
            let g = random.next();
            geometry[x * N + y] = g;
            geometry[y * N + x] = g;
        }
    }
    // Reflects about half of what arrives.
    let raw = random.field(N * N * N);
    let at = |x: usize, y: usize, z: usize| (x * N + y) * N + z;
    let brdf = (0..N * N * N).map(|k| {
        let (x, y, z) = (k / N / N, k / N % N, k % N);
        let symmetric = raw[at(x.min(z), y, x.max(z))];
        2.0 / N as f64 * (symmetric + skew * (raw[at(x, y, z)] - symmetric))
    });
    Patches {
        patches: N,
        brdf: brdf.collect(),
        geometry,
    }
}

/// How far equations 6 to 11 are violated by a BRDF.
struct Outcome {
    adjoint: f64,
    cost: f64,
    residual: f64,
}

fn outcome(skew: f64) -> Result<Outcome> {
    let mut random = Numbers(Independent::new(SEED, 0, 0));
    let p = patches(&mut random, skew);
    let (light, outgoing) = (random.field(N * N), random.field(N * N));
    let (a, b) = (random.field(N * N), random.field(N * N));
    let still = || "transport that grows";
    let eye = p.arriving(&outgoing);
    let l = Patches::solve(&light, |x| p.transport(x)).ok_or_else(still)?;
    let gamma = Patches::solve(&eye, |x| p.adjoint(x)).ok_or_else(still)?;
    let relative = |a: f64, b: f64| (a - b).abs() / a.abs().max(b.abs());
    // Outgoing importance put into the equation of radiance, then compared as it arrives.
    let solved = Patches::solve(&outgoing, |x| p.transport(x)).ok_or_else(still)?;
    let largest = gamma.iter().fold(0.0, |m: f64, v| m.max(*v));
    let arrives = p.arriving(&solved);
    let off = arrives.iter().zip(&gamma).map(|(a, b)| (a - b).abs());
    Ok(Outcome {
        adjoint: relative(
            Patches::inner(&p.transport(&a), &b),
            Patches::inner(&a, &p.adjoint(&b)),
        ),
        cost: relative(Patches::inner(&eye, &l), Patches::inner(&gamma, &light)),
        residual: off.fold(0.0, f64::max) / largest,
    })
}

/// `christensen-eq6-11`.
///
/// # Errors
/// None that the patches can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("seed", SEED);
    fig.note("patches", N);
    let reciprocal = outcome(0.0)?;
    let skewed = outcome(0.5)?;
    for (name, o) in [("reciprocal", &reciprocal), ("not reciprocal", &skewed)] {
        fig.check(
            format!("{name}: <T L, Gamma> = <L, T* Gamma> to 1e-12"),
            o.adjoint < 1e-12,
            format!("relative difference {:.1e}", o.adjoint),
        );
        fig.check(
            format!("{name}: <Gamma_0, L> = <Gamma, L_0> to 1e-12"),
            o.cost < 1e-12,
            format!("relative difference {:.1e}", o.cost),
        );
    }
    fig.check(
        "reciprocal: outgoing importance obeys the equation of radiance to 1e-12",
        reciprocal.residual < 1e-12,
        format!("residual {:.1e}", reciprocal.residual),
    );
    fig.check(
        "not reciprocal: it does not, by about 1e-2",
        (2e-3..0.3).contains(&skewed.residual),
        format!("residual {:.3}", skewed.residual),
    );
    let mut rows = Vec::new();
    for k in 0..=10 {
        let skew = f64::from(k) * 0.1;
        let o = outcome(skew)?;
        rows.push([skew, o.adjoint, o.cost, o.residual]);
    }
    fig.csv(
        "duality",
        &["skew", "adjoint", "cost", "residual"],
        rows.clone(),
    );
    let floor = |v: f64| v.max(1e-17);
    let line = |i: usize| {
        rows.iter()
            .map(move |r| (r[0], floor(r[i])))
            .collect::<Vec<_>>()
    };
    let title = "Duality and reciprocity";
    let chart = LineChart::new(title, "part of the BRDF that is not reciprocal", "residual")
        .log_y()
        .measured("<T L, Gamma> = <L, T* Gamma>", line(1))
        .measured("<Gamma_0, L> = <Gamma, L_0>", line(2))
        .measured("importance as radiance", line(3));
    fig.chart("duality", &chart);
    Ok(())
}
