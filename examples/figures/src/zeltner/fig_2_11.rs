//! [Zeltner 2021, figure 2.11]: how much smooth gold reflects.

use render::bsdf::fresnel::{conductor, conductor_polarised};

use super::fresnel_angles::{cos, lowest};
use super::integration_1d::positions;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Complex index of gold: photon energy in eV, n, k [Johnson and Christy 1972].
const GOLD: [[f64; 3]; 14] = [
    [1.51, 0.16, 5.083],
    [1.64, 0.14, 4.542],
    [1.76, 0.13, 4.103],
    [1.88, 0.14, 3.697],
    [2.01, 0.21, 3.272],
    [2.14, 0.29, 2.863],
    [2.26, 0.43, 2.455],
    [2.38, 0.62, 2.081],
    [2.50, 1.04, 1.833],
    [2.63, 1.31, 1.849],
    [2.75, 1.38, 1.914],
    [2.88, 1.45, 1.948],
    [3.00, 1.46, 1.958],
    [3.12, 1.47, 1.952],
];

/// Wavelength of a photon of 1 eV, nm.
const NM_EV: f64 = 1_239.841_98;

/// Index at a wavelength in nm, linear between the measurements.
fn gold(nm: f64) -> [f64; 2] {
    let at = |i: usize| NM_EV / GOLD[i][0];
    let i = (1..GOLD.len() - 1)
        .find(|&i| at(i) <= nm)
        .unwrap_or(GOLD.len() - 1);
    let t = (nm - at(i - 1)) / (at(i) - at(i - 1));
    [1, 2].map(|k| GOLD[i - 1][k] + t * (GOLD[i][k] - GOLD[i - 1][k]))
}

/// Reflectances from the Fresnel equations as they stand in textbooks, in complex numbers.
fn textbook(cos_i: f64, index: [f64; 2]) -> [f64; 2] {
    type C = [f64; 2];
    let mul = |a: C, b: C| [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
    let norm = |a: C| a[0] * a[0] + a[1] * a[1];
    let div = |a: C, b: C| mul(a, [b[0] / norm(b), -b[1] / norm(b)]);
    let square_root = |a: C| {
        let (r, phi) = (norm(a).sqrt().sqrt(), 0.5 * a[1].atan2(a[0]));
        [r * phi.cos(), r * phi.sin()]
    };
    // cos_t = sqrt(1 - sin_i^2 / eta^2)
    let ratio = div([1.0 - cos_i * cos_i, 0.0], mul(index, index));
    let cos_t = square_root([1.0 - ratio[0], -ratio[1]]);
    let quotient = |a: C, b: C| norm([a[0] - b[0], a[1] - b[1]]) / norm([a[0] + b[0], a[1] + b[1]]);
    [
        quotient([cos_i, 0.0], mul(index, cos_t)),
        quotient(mul(index, [cos_i, 0.0]), cos_t),
    ]
}

/// `zeltner-2-11`.
pub fn figure(fig: &mut Figure) -> Result {
    let count = fig.pick(900, 9000);
    let nm = 633.0;
    let [n, k] = gold(nm);
    fig.note("angles", count);
    fig.note("wavelength_nm", nm);
    fig.note("n", n);
    fig.note("k", k);
    let at = |degrees: f64| conductor_polarised(cos(degrees), n, k);
    fig.check(
        "gold at 633 nm: index about 0.184 + 3.43 i",
        (n - 0.184).abs() < 0.002 && (k - 3.43).abs() < 0.01,
        format!("{n:.4} + {k:.4} i, linear between Johnson and Christy's measurements"),
    );
    let [s, p] = at(0.0);
    fig.check(
        "R(0) about 0.944, for both polarisations",
        (s - 0.944).abs() < 1e-3 && (s - p).abs() < 1e-12,
        format!("perpendicular {s:.6}, parallel {p:.6}"),
    );
    let least = lowest([0.0, 90.0], |a| at(a)[1]);
    let there = at(least)[1];
    fig.check(
        "parallel minimum about 0.892 near 72.7 degrees",
        (there - 0.892).abs() < 2e-3 && (least - 72.7).abs() < 0.2,
        format!("{there:.5} at {least:.3} degrees"),
    );
    let angles: Vec<f64> = positions([0.0, 90.0], count).collect();
    let largest = angles.iter().flat_map(|&a| at(a)).fold(0.0, f64::max);
    let smallest = angles.iter().flat_map(|&a| at(a)).fold(1.0, f64::min);
    fig.check(
        "both components within [0, 1]",
        smallest >= 0.0 && largest <= 1.0,
        format!("{smallest:.5} to {largest}"),
    );
    let ([s, p], [s1, p1]) = (at(90.0), at(90.0 - 1e-6));
    let near = (1.0 - s1).max(1.0 - p1);
    fig.check(
        "both components 1 at grazing incidence, and tend to it",
        s == 1.0 && p == 1.0 && near < 1e-6,
        format!("{s}, {p}; 1e-6 degrees before, within {near:.1e} of 1"),
    );
    let gap = |sign: f64, index: [f64; 2]| {
        let gap = |&a: &f64| {
            let (ours, theirs) = (
                conductor_polarised(cos(a), n, sign * k),
                textbook(cos(a), index),
            );
            (ours[0] - theirs[0]).abs().max((ours[1] - theirs[1]).abs())
        };
        angles.iter().map(gap).fold(0.0, f64::max)
    };
    let gaps = [
        gap(1.0, [n, k]),
        gap(1.0, [n, -k]),
        gap(-1.0, [n, k]),
        gap(-1.0, [n, -k]),
    ];
    fig.check(
        "n + ik and n - ik give identical curves, those of the equations in complex numbers",
        gaps.iter().all(|g| *g < 1e-12),
        format!(
            "library with +k and -k, equations with n + ik and n - ik: largest gap {:.1e}",
            gaps.into_iter().fold(0.0, f64::max)
        ),
    );
    let mean = angles.iter().map(|&a| {
        let [s, p] = at(a);
        (conductor(cos(a), n, k) - 0.5 * (s + p)).abs()
    });
    let mean = mean.fold(0.0, f64::max);
    fig.check(
        "F is the mean of the two",
        mean < 1e-15,
        format!("largest gap {mean:.1e}"),
    );

    let rows: Vec<_> = angles
        .iter()
        .map(|&a| {
            let [s, p] = at(a);
            [a, s, p, conductor(cos(a), n, k)]
        })
        .collect();
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let chart = LineChart::new(
        "Reflectance of gold at 633 nm",
        "angle of incidence, degrees",
        "reflectance",
    )
    .x_range(0.0, 90.0)
    .y_range(0.85, 1.03)
    .line("perpendicular", curve(1))
    .line("parallel", curve(2))
    .dashed("mean F", curve(3));
    fig.csv(
        "reflectance",
        &["degrees", "perpendicular", "parallel", "mean"],
        rows,
    );
    fig.chart("reflectance", &chart);

    let rows: Vec<_> = positions([400.0, 800.0], 400)
        .map(|nm| {
            let [n, k] = gold(nm);
            [nm, n, k, conductor(1.0, n, k)]
        })
        .collect();
    let curve = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let measured = GOLD
        .iter()
        .flat_map(|g| [1, 2].map(|k| (NM_EV / g[0], g[k])));
    let measured = measured.filter(|(nm, _)| (400.0..=800.0).contains(nm));
    let chart = LineChart::new("Complex index of gold", "wavelength, nm", "index")
        .x_range(390.0, 810.0)
        .y_range(0.0, 7.5)
        .line("n", curve(1))
        .line("k", curve(2))
        .dashed("R at normal incidence", curve(3))
        .points("633 nm", [(nm, n), (nm, k)])
        .points("measured [Johnson and Christy 1972]", measured);
    fig.csv("index", &["nm", "n", "k", "reflectance"], rows);
    fig.chart("index", &chart);
    Ok(())
}
