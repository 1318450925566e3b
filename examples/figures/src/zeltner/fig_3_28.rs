//! [Zeltner 2021, figure 3.28]: light over a wall of rough metal, by manifold connections with offset normals and by paths.

use std::sync::Arc;

use render::Scene;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{Conductor, Material, RoughConductor, Roughness};
use render::scene::{Connections, Method, Starts};
use render::statistics::z_limit;

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::mirrored;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

const SEED: u64 = 328;
/// Beckmann roughness, from left to right.
const ALPHA: [f64; 6] = [0.005, 0.02, 0.05, 0.1, 0.2, 0.5];

/// The wall of this roughness.
fn rough(size: u32, alpha: f64) -> Result<Scene> {
    mirrored(0.4, 500.0, size, |b| {
        let specular_reflectance = b.colour("wall", "specular_reflectance", [0.9; 3])?;
        let roughness = Roughness {
            kind: Ndf::Beckmann,
            alpha: b.build.scalar("wall.alpha.value", alpha, (1e-4, 1.0))?,
            visible: true,
        };
        let conductor = Conductor {
            specular_reflectance,
            index: None,
        };
        Ok(Arc::new(Material::from(RoughConductor {
            roughness,
            conductor,
        })))
    })
}

/// Chains over surfaces of any roughness.
fn chains() -> Connections {
    Connections {
        roughness: 1.0,
        ..single(Method::Sms, Starts::Particles)
    }
}

/// Both estimators at a roughness.
struct Row {
    alpha: f64,
    chains: Measured,
    paths: Measured,
}

impl Row {
    /// How much less variance connections have than paths in the same time, and at equal samples.
    fn gains(&self) -> [f64; 2] {
        let seconds = self.chains.seconds;
        [
            self.paths.variance_after(seconds) / self.chains.variance(),
            self.paths.variance_of_one() / self.chains.variance_of_one(),
        ]
    }
}

/// `zeltner-3-28`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort {
        runs: 16,
        spp: fig.pick(8, 64),
        seed: SEED,
    };
    effort.note(fig, size);
    // Paths seldom meet the light over smooth metal.
    let more: [u64; 6] = fig.pick([256, 64, 16, 4, 4, 4], [128, 32, 8, 4, 4, 4]);
    let mut rows = Vec::new();
    for ((i, alpha), more) in (0..).zip(ALPHA).zip(more) {
        let scene = rough(size, alpha)?;
        let effort = effort.other(i);
        let many = Effort {
            seed: effort.seed + 500,
            spp: more * effort.spp,
            ..effort
        };
        rows.push(Row {
            alpha,
            chains: measure(&scene, chains(), false, effort)?,
            paths: measure(&scene, chains(), true, many)?,
        });
    }
    let noise = |r: &Row| [&r.chains, &r.paths].map(Measured::variance_of_one);
    let shown = |r: &Row| {
        let [chains, paths] = noise(r);
        format!(
            "{chains:.2e} of connections and {paths:.2e} of paths at {}",
            r.alpha
        )
    };
    let (first, last) = (&rows[0], &rows[ALPHA.len() - 1]);
    fig.check(
        "paths have less noise on rougher metal, connections more",
        rows.windows(2).all(|w| noise(&w[1])[1] < noise(&w[0])[1])
            && noise(last)[0] > noise(first)[0],
        rows.iter().map(shown).collect::<Vec<_>>().join(", "),
    );
    let gains: Vec<[f64; 2]> = rows.iter().map(Row::gains).collect();
    let [in_time, of_one] = [0, 1].map(|k| gains.iter().map(|g| g[k]).collect::<Vec<f64>>());
    let falls = |gains: &[f64]| gains.windows(2).all(|w| w[1] < w[0]);
    fig.check(
        "what connections gain falls with the roughness, in the same time and at equal samples",
        falls(&in_time) && falls(&of_one),
        format!(
            "{in_time:.2?} times less variance in the same time, {of_one:.1?} at equal samples"
        ),
    );
    fig.check(
        "in the same time they are better on the smoothest metal, and paths are on the roughest",
        in_time[0] > 100.0 && in_time[ALPHA.len() - 1] < 1.0,
        format!(
            "{:.0} and {:.3} times less variance",
            in_time[0],
            in_time[ALPHA.len() - 1]
        ),
    );
    same_light(fig, &rows, size, effort.runs);
    let chart = |title: &str, y: &str| LineChart::new(title, "alpha", y).log_x().log_y();
    let line = |k: usize| rows.iter().map(move |r| (r.alpha, noise(r)[k]));
    let samples = chart("noise of either at equal samples", "variance");
    let samples = samples.line("connections", line(0)).line("paths", line(1));
    fig.chart("variance", &samples);
    let spent = |r: &Row| [&r.chains, &r.paths].map(|m| m.variance_after(1.0));
    let line = |k: usize| rows.iter().map(move |r| (r.alpha, spent(r)[k]));
    let time = chart("noise of either in the same time", "variance times seconds");
    let time = time.line("connections", line(0)).line("paths", line(1));
    fig.chart("time", &time);
    let columns = [
        "alpha",
        "chains",
        "paths",
        "chains_in_time",
        "paths_in_time",
        "mean_chains",
        "mean_paths",
    ];
    let each = rows.iter().map(|r| {
        let ([a, b], [c, d]) = (noise(r), spent(r));
        [r.alpha, a, b, c, d, r.chains.mean(), r.paths.mean()]
    });
    fig.csv("variance", &columns, each.collect::<Vec<_>>());
    let panels = rows.iter().flat_map(|r| {
        let both = [("chains", &r.chains), ("paths", &r.paths)];
        let alpha = r.alpha;
        let factor = (128 / size as usize).max(1);
        both.map(|(label, m)| m.panel(&format!("{label}, {alpha}"), &r.chains, factor))
    });
    fig.images("metal", 2, &panels.collect::<Vec<_>>());
    published(fig)
}

/// Whether both bring the same light: all in all at every roughness, block by block where means of paths are nearly normal.
fn same_light(fig: &mut Figure, rows: &[Row], size: u32, runs: u64) {
    const NEARLY: f64 = 0.05;
    let means = |r: &Row| [&r.chains, &r.paths].map(|m| m.series.whole);
    let z = rows.iter().map(|r| {
        let [a, b] = means(r);
        a.z(&b)
    });
    let z: Vec<f64> = z.collect();
    let errors = rows.iter().map(|r| means(r)[1].se / means(r)[0].mean);
    let errors: Vec<f64> = errors.collect();
    let most = fig.pick(0.25, 0.1);
    let bound = z_limit(rows.len(), runs, 1e-3);
    fig.check(
        "both bring the same light at every roughness",
        z.iter().all(|z| z.abs() < bound) && errors.iter().all(|e| *e < most),
        format!("deviates {z:.2?}, limit {bound:.2}, relative errors of paths {errors:.3?}"),
    );
    let blocks = (size as usize / 4).pow(2);
    let compared: Vec<&Row> = rows.iter().filter(|r| r.alpha >= NEARLY).collect();
    let bound = z_limit(blocks * compared.len(), runs, 1e-3);
    let worst = compared.iter().map(|r| {
        let blocks = r.chains.series.blocks.iter().zip(&r.paths.series.blocks);
        blocks.map(|(a, b)| a.z(b).abs()).fold(0.0, f64::max)
    });
    let worst: Vec<f64> = worst.collect();
    fig.check(
        "and in every block from a roughness of 0.05 on",
        worst.iter().all(|z| *z < bound),
        format!("largest |z| {worst:.2?}, limit {bound:.2}"),
    );
}

/// The plane of the authors, where it is, at the least and the largest roughness.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let effort = Effort::of(fig, [2, 8], 2 * SEED);
    let mut gains = Vec::new();
    for (name, alpha) in [
        ("authors' plane, 0.005", "0.005"),
        ("authors' plane, 0.2", "0.2"),
    ] {
        let file = "Figure_17_Roughness/plane_sms.xml";
        let columns = fig.pick(12, 32);
        let of = authors.scene(fig, name, file, columns, &[("$alpha", alpha)])?;
        let accuracy = fig.pick((1 << 14, 0.4), (1 << 18, 0.1));
        let found = compare(fig, &of, &[("offset normals", chains())], effort, accuracy)?;
        gains.push(found.gain(0));
    }
    // In few samples paths do not meet its lamp over smooth metal at all.
    if fig.pick(false, true) {
        fig.check(
            "authors' plane: what connections gain in the same time falls with the roughness",
            gains[1] < gains[0],
            format!("{gains:.2?} times less variance"),
        );
    }
    Ok(())
}
