//! [Zeltner 2021, figure 3.28]: light over a wall of rough metal, by manifold connections with offset normals and by paths.
//!
//! In the thesis paths win on the roughest metal in the same time. At equal samples, of which one of a connection is several
//! walks, the curves come closer here, and do not cross.

use std::sync::Arc;

use render::bsdf::microfacet::Ndf;
use render::bsdf::{Conductor, Material, RoughConductor, Roughness};
use render::scene::{Connections, Method};

use super::manifold_methods::{Effort, measure};
use super::manifold_scenes::mirrored;
use crate::chart::LineChart;
use crate::figure::{Figure, Result};
use crate::figures::statistics::limit;

const SEED: u64 = 328;
/// Beckmann roughness, from left to right.
const ALPHA: [f64; 5] = [0.005, 0.02, 0.05, 0.1, 0.2];

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
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    for (i, alpha) in ALPHA.into_iter().enumerate() {
        let scene = mirrored(0.4, 500.0, size, |b| {
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
        })?;
        let connections = Connections {
            bounces: 1,
            roughness: 1.0,
            ..Connections::new(Method::Sms)
        };
        let effort = effort.other(i as u64);
        let chains = measure(&scene, connections, false, effort)?;
        let paths = Effort {
            seed: effort.seed + 500,
            spp: 4 * effort.spp,
            ..effort
        };
        let paths = measure(&scene, connections, true, paths)?;
        let blocks = chains.series.blocks.iter().zip(&paths.series.blocks);
        let worst = blocks.map(|(a, b)| a.z(b).abs()).fold(0.0, f64::max);
        // Of one sample per pixel.
        let variances = [chains.variance(), 4.0 * paths.variance()];
        rows.push([
            alpha,
            variances[0],
            variances[1],
            chains.mean(),
            paths.mean(),
            worst,
        ]);
        for (label, m) in [("chains", &chains), ("paths", &paths)] {
            let label = format!("{label}, {alpha}");
            panels.push(m.panel(&label, &chains, fig.pick(8, 3)));
        }
    }
    let (first, last) = (rows[0], rows[ALPHA.len() - 1]);
    fig.check(
        "paths have less noise on rougher metal, connections more",
        last[2] < first[2] && last[1] > first[1],
        format!(
            "paths {:.2e} to {:.2e}, connections {:.2e} to {:.2e}",
            first[2], last[2], first[1], last[1]
        ),
    );
    let gains = [first, last].map(|r| r[2] / r[1]);
    fig.check(
        "what connections gain at equal samples falls with the roughness, by a factor of ten at least",
        gains[0] > 10.0 * gains[1] && gains[0] > 1.0,
        format!("{:.0} times less variance at 0.005, {:.0} at 0.2", gains[0], gains[1]),
    );
    // Paths meet the light seldom on smoother metal, and their means are far from normal.
    let blocks = (size as usize / 4).pow(2);
    let compared = &rows[2..];
    let z = limit(blocks * compared.len(), effort.runs, 1e-3);
    fig.check(
        "both bring the same light, from a roughness of 0.05 on",
        compared.iter().all(|r| r[5] < z),
        format!(
            "largest |z| {:.2?}, limit {z:.2}",
            compared.iter().map(|r| r[5]).collect::<Vec<_>>()
        ),
    );
    let chart = LineChart::new("noise of either at equal samples", "alpha", "variance")
        .log_x()
        .log_y()
        .line("connections", rows.iter().map(|r| (r[0], r[1])))
        .line("paths", rows.iter().map(|r| (r[0], r[2])));
    fig.chart("variance", &chart);
    let columns = [
        "alpha",
        "chains",
        "paths",
        "mean_chains",
        "mean_paths",
        "worst_z",
    ];
    fig.csv("variance", &columns, rows);
    fig.images("metal", 2, &panels);
    Ok(())
}
