//! [Zeltner 2021, figure 2.23]: samples of a density by rejection.

use render::sampler::{Independent, Sampler};
use render::statistics::{sidak, z_limit};

use super::integration_1d::{Density, Histogram, Normal, Uniform, positions};
use super::two_bumps::{RANGE, target};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// A proposal: position, height below `c q`, and whether it is below `p` too.
type Proposal = (f64, f64, bool);

/// `zeltner-2-23`.
pub fn figure(fig: &mut Figure) -> Result {
    let (n, seed) = (fig.pick(100_000, 2_000_000), 2);
    fig.note("proposals", n);
    fig.note("seed", seed);
    let p = target();
    let bell = Normal {
        mean: 0.42,
        sd: 0.3,
        range: RANGE,
    };
    let flat = Uniform { range: RANGE };
    let proposals: [(&str, &dyn Density<f64>); 2] = [("normal q", &bell), ("uniform q", &flat)];
    let grid: Vec<f64> = positions(RANGE, 4000).collect();
    let least = sidak(proposals.len(), 1e-3);
    let limit = z_limit(proposals.len(), n, 1e-3);
    let mut shown = None;
    for (k, (name, q)) in proposals.into_iter().enumerate() {
        // A little above the largest ratio between the positions.
        let c = grid
            .iter()
            .map(|&x| p.pdf(x) / q.pdf(x))
            .fold(0.0, f64::max)
            * (1.0 + 1e-4);
        let propose = |i: u64| -> Proposal {
            let [u, v] = Independent::new(seed, k as u64, i).next_2d::<f64>();
            let x = q.sample(u);
            let y = v * c * q.pdf(x);
            (x, y, y < p.pdf(x))
        };
        let all: Vec<Proposal> = (0..n).map(propose).collect();
        let accepted: Vec<f64> = all.iter().filter(|s| s.2).map(|s| s.0).collect();
        let histogram = Histogram::of(&accepted, &p);
        let test = histogram.test;
        fig.check(
            format!("{name}: the histogram of accepted proposals matches p (chi-square)"),
            test.p_value > least,
            format!(
                "p-value {:.3}, at least {least:.4}, deviate {:.2} ({} cells, {} accepted of {n})",
                test.p_value,
                test.deviate,
                Histogram::CELLS,
                accepted.len()
            ),
        );
        let share = accepted.len() as f64 / n as f64;
        let z = (share - 1.0 / c) / ((1.0 - 1.0 / c) / c / n as f64).sqrt();
        fig.check(
            format!("{name}: 1 / c of the proposals are accepted"),
            z.abs() < limit,
            format!(
                "{share:.5}, 1 / c = {:.5} (c = {c:.4}): deviate {z:.2}, limit {limit:.2}",
                1.0 / c
            ),
        );
        let everything: Vec<f64> = all.iter().map(|s| s.0).collect();
        let wrong = Histogram::of(&everything, &p).test.deviate;
        fig.check(
            format!("{name}: the test notices when nothing is rejected"),
            wrong > 10.0,
            format!("deviate {wrong:.0}, at least 10"),
        );
        if shown.is_none() {
            shown = Some((c, all, histogram));
        }
    }
    let Some((c, all, histogram)) = shown else {
        return Ok(());
    };
    let few = &all[..all.len().min(700)];
    let of = |kept: bool| few.iter().filter(move |s| s.2 == kept).map(|s| (s.0, s.1));
    let chart = LineChart::new("Rejection sampling", "x", "density")
        .x_range(0.0, 1.0)
        .y_range(0.0, 3.4)
        .line("p", grid.iter().map(|&x| (x, p.pdf(x))))
        .line("c q", grid.iter().map(|&x| (x, c * bell.pdf(x))))
        .points("accepted", of(true))
        .points("rejected", of(false))
        .dashed("q", grid.iter().map(|&x| (x, bell.pdf(x))));
    fig.chart("proposals", &chart);
    let chart = LineChart::new("Rejection sampling: accepted proposals", "x", "density")
        .x_range(0.0, 1.0)
        .y_range(0.0, 2.6)
        .line("p", grid.iter().map(|&x| (x, p.pdf(x))))
        .points("histogram", histogram.bars.clone());
    fig.chart("histogram", &chart);
    let rows = few.iter().map(|s| [s.0, s.1, f64::from(u8::from(s.2))]);
    let rows: Vec<_> = rows.collect();
    fig.csv("proposals", &["x", "y", "accepted"], rows);
    let bars: Vec<_> = histogram
        .bars
        .iter()
        .map(|&(x, d)| [x, d, p.pdf(x)])
        .collect();
    fig.csv("histogram", &["x", "measured", "pdf"], bars);
    Ok(())
}
