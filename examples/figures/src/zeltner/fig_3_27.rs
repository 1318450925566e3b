//! [Zeltner 2021, figure 3.27]: balls of glass with growing bumps, once as a normal map and once displaced.
//!
//! Both are made from the same waves. Walks start anywhere: two stages are off.

use render::scene::{Method, Starts};

use super::authors::{Authors, Found, attribute, compare};
use super::integrated_normals::displaced_sphere;
use super::manifold_methods::{Effort, measure, single};
use super::manifold_scenes::{Waves, displaced_ball, glass, half_ball, mapped_ball};
use super::specular_scenes::Laboratory;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 327;
/// Standard deviations of the slopes.
const SLOPES: [f64; 3] = [0.03, 0.07, 0.15];
/// Wavelength, of a ball of radius 5.
const WAVELENGTH: f64 = 3.0;

/// `zeltner-3-27`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort {
        runs: fig.pick(4, 16),
        spp: fig.pick(4, 16),
        seed: SEED,
    };
    effort.note(fig, size);
    // Texels and vertices of half a turn.
    let rows = fig.pick(96, 256);
    fig.note("rows", rows);
    let mut table = Vec::new();
    let mut panels = Vec::new();
    for displaced in [false, true] {
        for (k, slope) in (0..).zip(SLOPES) {
            let waves = Waves::new(WAVELENGTH, slope, SEED);
            let scene = half_ball(size, 0.4, |b, radius| {
                let smooth = glass(b)?;
                if displaced {
                    b.shape("ball", displaced_ball(radius, &waves, rows)?, &smooth);
                } else {
                    let material = mapped_ball(b, radius, &waves, rows as usize, smooth)?;
                    b.ball("ball", [0.0; 3], radius, &material)?;
                }
                Ok(())
            })?;
            let connections = single(Method::Sms, Starts::Uniform);
            let seed = effort.seed + 1000 * k + 500 * u64::from(displaced);
            let m = measure(&scene, connections, false, Effort { seed, ..effort })?;
            let label = if displaced { "displaced" } else { "normal map" };
            panels.push(m.panel(&format!("{label}, {slope}"), &m, fig.pick(10, 4)));
            table.push([
                f64::from(u8::from(displaced)),
                slope,
                m.lit(),
                m.success(),
                m.trials(),
                m.mean(),
                m.seconds,
            ]);
        }
    }
    let (mapped, displaced) = table.split_at(SLOPES.len());
    let rates = |rows: &[[f64; 7]]| rows.iter().map(|r| r[2]).collect::<Vec<f64>>();
    let (mapped, displaced) = (rates(mapped), rates(displaced));
    let falls = |r: &[f64]| r.windows(2).all(|w| w[1] < w[0]);
    let found = format!("{mapped:.3?} with normal maps, {displaced:.3?} displaced");
    fig.check(
        "fewer walks find light the larger the bumps, on either",
        falls(&mapped) && falls(&displaced),
        &found,
    );
    let worst = mapped
        .iter()
        .zip(&displaced)
        .map(|(a, b)| (b / a - 1.0).abs());
    let worst = worst.fold(0.0, f64::max);
    fig.check(
        "displaced or mapped, success rates are within 30 %",
        worst < 0.3,
        format!("{:.1} % apart at most: {found}", 100.0 * worst),
    );
    let trials = |k: usize| table[k][4];
    fig.check(
        "and trials per solution grow",
        trials(2) > trials(0) && trials(5) > trials(3),
        format!("{:.2?}", (0..6).map(trials).collect::<Vec<_>>()),
    );
    fig.images("bumps", 3, &panels);
    let chart = LineChart::new("walks that find light", "slope", "success rate")
        .log_x()
        .measured("normal map", SLOPES.into_iter().zip(mapped))
        .measured("displaced", SLOPES.into_iter().zip(displaced));
    fig.chart("rates", &chart);
    let columns = [
        "displaced",
        "slope",
        "with_light",
        "success_rate",
        "trials",
        "mean",
        "seconds",
    ];
    fig.csv("rates", &columns, table);
    published(fig)
}

/// The balls of the authors, where they are; those that are displaced are not there, and come from what the normal maps say.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let effort = Effort {
        runs: fig.pick(8, 16),
        spp: 4,
        seed: 2 * SEED,
    };
    let accuracy = fig.pick((1 << 14, 0.8), (1 << 17, 0.1));
    let (columns, rows) = (fig.pick(16, 32), fig.pick(192, 512));
    let ways = [
        ("unbiased", single(Method::Sms, Starts::Uniform)),
        ("from particles", single(Method::Sms, Starts::Particles)),
    ];
    let mut rates = [Vec::new(), Vec::new()];
    for (k, [mapped, displaced]) in [
        ["authors' map 1", "authors' shape 1"],
        ["authors' map 2", "authors' shape 2"],
        ["authors' map 3", "authors' shape 3"],
    ]
    .into_iter()
    .enumerate()
    {
        let n = k + 1;
        let file = |kind: &str| format!("Figure_16_Displacement/sphere_{n}_{kind}.xml");
        let lit = |found: &Found| found.ways[0].lit();
        let of = authors.scene(fig, mapped, &file("nrm"), columns, &[])?;
        rates[0].push(lit(&compare(
            fig,
            &of,
            &ways,
            effort.other(n as u64),
            accuracy,
        )?));
        let missing = format!("sphere_d_{n}.obj");
        let mesh = displaced_sphere(&Laboratory::new(of.scene), rows)?;
        fig.write(&missing, mesh.as_bytes());
        let path = attribute(&std::path::absolute(fig.path(&missing))?);
        let changes = [(&*format!("meshes/{missing}"), path.as_str())];
        let of = authors.scene(fig, displaced, &file("disp"), columns, &changes)?;
        rates[1].push(lit(&compare(
            fig,
            &of,
            &ways,
            effort.other(10 + n as u64),
            accuracy,
        )?));
    }
    let [mapped, displaced] = &rates;
    let found = format!("{mapped:.3?} with normal maps, {displaced:.3?} displaced");
    let falls = |r: &[f64]| r.windows(2).all(|w| w[1] < w[0]);
    fig.check(
        "authors' balls: fewer walks find light the larger the bumps, on either",
        falls(mapped) && falls(displaced),
        &found,
    );
    let apart = mapped.iter().zip(displaced);
    let apart = apart.map(|(a, b)| (b / a - 1.0).abs()).fold(0.0, f64::max);
    fig.check(
        "authors' balls: displaced or mapped, success rates are within 30 %",
        apart < 0.3,
        format!("{:.1} % apart at most: {found}", 100.0 * apart),
    );
    Ok(())
}
