//! [Zeltner 2021, figure 2.10]: how much smooth glass reflects.

use render::bsdf::fresnel::dielectric;

use super::fresnel_angles::{cos, lowest};
use super::integration_1d::positions;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Where `f` changes its sign between `a` and `b`, degrees.
fn root([mut a, mut b]: [f64; 2], f: impl Fn(f64) -> f64) -> f64 {
    let sign = f(a) > 0.0;
    for _ in 0..60 {
        let m = 0.5 * (a + b);
        if (f(m) > 0.0) == sign { a = m } else { b = m }
    }
    0.5 * (a + b)
}

/// `zeltner-2-10`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(900, 9000);
    fig.note("angles", n);
    let angles: Vec<f64> = positions([0.0, 90.0], n).collect();
    let sides = [
        ("air to glass", "air-to-glass", 1.5, 56.31),
        ("glass to air", "glass-to-air", 1.0 / 1.5, 33.69),
    ];
    for (name, file, eta, brewster) in sides {
        let at = |degrees: f64| dielectric(cos(degrees), eta);
        let [s, p] = at(0.0).polarised;
        fig.check(
            format!("{name}: both polarisations meet at 0.04 at normal incidence"),
            (s - 0.04).abs() < 1e-12 && (p - 0.04).abs() < 1e-12,
            format!("perpendicular {s:.12}, parallel {p:.12}"),
        );
        let least = lowest([0.0, if eta > 1.0 { 90.0 } else { 41.8 }], |a| {
            at(a).polarised[1]
        });
        let there = at(least).polarised[1];
        fig.check(
            format!("{name}: the parallel component is 0 at {brewster} degrees"),
            (least - brewster).abs() < 0.005 && there < 1e-12,
            format!("smallest at {least:.4} degrees, {there:.1e}"),
        );
        let [s, p] = at(90.0).polarised;
        let [s1, p1] = at(90.0 - 1e-6).polarised;
        let near = (1.0 - s1).max(1.0 - p1);
        fig.check(
            format!("{name}: both are 1 at 90 degrees, and tend to it"),
            s == 1.0 && p == 1.0 && near < 1e-6,
            format!("{s}, {p}; 1e-6 degrees before, within {near:.1e} of 1"),
        );
        let (mut mean_gap, mut sum_gap): (f64, f64) = (0.0, 0.0);
        for &a in &angles {
            let f = at(a);
            mean_gap = mean_gap.max((f.reflect - 0.5 * (f.polarised[0] + f.polarised[1])).abs());
            sum_gap = sum_gap.max((f.reflect + f.transmit - 1.0).abs());
        }
        fig.check(
            format!("{name}: F is the mean of the two, the rest is transmitted"),
            mean_gap < 1e-15 && sum_gap < 1e-14,
            format!("largest gap {mean_gap:.1e}, and of F + T from 1 {sum_gap:.1e}"),
        );
        if eta < 1.0 {
            let critical = root([40.0, 45.0], |a| at(a).transmit - 1e-300);
            let beyond = angles.iter().filter(|&&a| a > critical);
            let ones = beyond.clone().all(|&a| at(a).polarised == [1.0, 1.0]);
            fig.check(
                "from inside: 1 beyond 41.81 degrees, and only there",
                ones && (critical - 41.8103).abs() < 1e-4,
                format!(
                    "transmission ends at {critical:.5} degrees, all {} larger angles give 1",
                    beyond.count()
                ),
            );
        }
        let rows = angles.iter().map(|&a| {
            let f = at(a);
            [a, f.polarised[0], f.polarised[1], f.reflect, f.transmit]
        });
        let rows: Vec<_> = rows.collect();
        let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
        let title = format!("Fresnel reflectance, {name} (1.5)");
        let chart = LineChart::new(&title, "angle of incidence, degrees", "reflectance")
            .x_range(0.0, 90.0)
            .y_range(0.0, 1.45)
            .line("perpendicular", curve(1))
            .line("parallel", curve(2))
            .dashed("mean F", curve(3));
        fig.csv(
            file,
            &[
                "degrees",
                "perpendicular",
                "parallel",
                "mean",
                "transmitted",
            ],
            rows,
        );
        fig.chart(file, &chart);
    }
    Ok(())
}
