//! Attached samples that ignore discontinuities, and attached samples that stand still there [Zeltner
//! 2021, figure 4.18]: the outline of a reflected ball, and the horizon of a surface with mapped normals.

use std::sync::Arc;

use render::Job;
use render::Scene;
use render::bsdf::microfacet::Ndf;
use render::bsdf::{Interpolation, Material, NormalMap};
use render::instances::{Direction, Estimator};
use render::statistics::{Estimate, z_limit};

use crate::statistics::{Series, blocks, grey};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::ranks::percentile;
use examples::scene_builder::{SceneBuilder, UNIT, View, picture};

const SEED: u64 = 418;
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Texels along a side of the maps.
const SIDE: u32 = 16;
const BALL: ([f64; 3], f64) = ([0.0, 0.75, -0.3], 0.4);
/// The estimators that are compared; the first is the reference.
const ESTIMATORS: [Estimator; 4] = [
    Estimator::Mis,
    Estimator::Detached,
    Estimator::Reparameterised,
    Estimator::AttachedNaive,
];
const REFERENCE: usize = 0;
const REPARAMETERISED: usize = 2;
const NAIVE: usize = 3;

/// The discontinuity that samples move across.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Edge {
    /// (a) The outline of a ball before the sky; the parameter is a texture of roughness.
    Ball,
    /// (b) The horizon of the surface; the parameter is a map of normals.
    Horizon,
}

impl Edge {
    const BOTH: [Self; 2] = [Self::Ball, Self::Horizon];

    fn label(self) -> &'static str {
        match self {
            Self::Ball => "(a)",
            Self::Horizon => "(b)",
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Ball => "plate.alpha.data",
            Self::Horizon => "plate.normalmap.data",
        }
    }

    /// Beckmann lobes are narrow enough that some pixels see no edge.
    pub(crate) fn scene(self, width: u32) -> Result<Scene> {
        let mut builder = SceneBuilder::default();
        let size = [width, width * 3 / 4];
        let view = match self {
            Self::Ball => {
                let metal = rough_texture(&mut builder)?;
                let sides = [[2.4, 0.0, 0.0], [0.0, 0.0, -2.4]];
                builder.quad("plate", [[-1.2, 0.0, 1.2], sides[0], sides[1]], &metal)?;
                let matt = builder.matt("ball", [0.05; 3])?;
                builder.ball("ball", BALL.0, BALL.1, &matt)?;
                View {
                    eye: [0.0, 2.6, 2.6],
                    target: [0.0, 0.1, 0.0],
                    fov: 30.0,
                    size,
                }
            }
            Self::Horizon => {
                let metal = tilted(&mut builder)?;
                let sides = [[12.0, 0.0, 0.0], [0.0, 0.0, -12.0]];
                builder.quad("plate", [[-6.0, 0.0, 6.0], sides[0], sides[1]], &metal)?;
                View {
                    eye: [0.0, 1.2, 3.0],
                    target: [0.0, 0.0, 1.1],
                    fov: 55.0,
                    size,
                }
            }
        };
        builder.ambient([0.5, 0.55, 0.6])?;
        builder.lobe("lobe", [1.2, 1.0, 0.7], [0.2, 0.35, -0.9], 3.0)?;
        builder.finish(&view, 2)
    }

    /// The direction of the derivative: all roughness grows, or all normals tilt towards the far end.
    fn direction(self, scene: &Scene) -> Result<Direction> {
        let params = scene.params();
        let info = params.find(self.name())?;
        Ok(match self {
            Self::Ball => Direction::Uniform(params.handle(info)),
            Self::Horizon => {
                let axis = (0..info.shape.len()).map(|i| f32::from(u8::from(i % 3 == 1)));
                Direction::Dense(params.handle(info), axis.collect())
            }
        })
    }

    /// How far from the edge the mirrored view of a pixel is, in radians; `None` where nothing is seen that
    /// could reflect.
    fn distance(self, scene: &Scene, x: f32, y: f32) -> Option<f64> {
        let ray = scene.camera.ray(x, y);
        let hit = scene.intersect(&ray)?;
        if scene.shape_info(hit.shape).name != "plate" {
            return None;
        }
        let [p, d] = [hit.si.p, ray.d].map(|v| v.to_array().map(f64::from));
        let mirrored = [d[0], -d[1], d[2]];
        Some(match self {
            Self::Ball => {
                let to = [0, 1, 2].map(|i: usize| BALL.0[i] - p[i]);
                let length = to.iter().map(|x| x * x).sum::<f64>().sqrt();
                let cos: f64 = to.iter().zip(mirrored).map(|(a, b)| a * b).sum::<f64>() / length;
                (cos.clamp(-1.0, 1.0).acos() - (BALL.1 / length).asin()).abs()
            }
            Self::Horizon => mirrored[1].asin(),
        })
    }

    /// Two distances from the edge: nearer than the first, most of a lobe is affected by it; farther than the second,
    /// nothing of it is.
    fn bounds(self) -> [f64; 2] {
        match self {
            Self::Ball => [0.15, 0.55],
            Self::Horizon => [0.3, 0.85],
        }
    }
}

fn rough_texture(builder: &mut SceneBuilder) -> Result<Arc<Material>> {
    let texels: Vec<f32> = (0..SIDE * SIDE)
        .map(|i| 0.08 + 0.02 * ((i % SIDE) as f32 * 0.9).sin() * ((i / SIDE) as f32 * 0.7).cos())
        .collect();
    let roughness = builder.rough_texels("plate", Ndf::Beckmann, &texels)?;
    builder.metal_of("plate", [0.9, 0.8, 0.6], roughness)
}

fn tilted(builder: &mut SceneBuilder) -> Result<Arc<Material>> {
    let mut roughness = builder.ggx("plate", 0.12)?;
    (roughness.kind, roughness.visible) = (Ndf::Beckmann, false);
    let metal = builder.metal_of("plate", [0.9, 0.8, 0.6], roughness)?;
    let slope = |i: u32, k: f32| 0.5 + 0.03 * (i as f32 * k).sin();
    let texels = (0..SIDE * SIDE).flat_map(|i| {
        let (x, y) = (i % SIDE, i / SIDE);
        [slope(x, 1.1), slope(y, 0.8), 1.0]
    });
    let texels: Vec<f32> = texels.collect();
    let map = builder
        .build
        .texels("plate.normalmap", [SIDE; 2], &texels, UNIT)?;
    let mapped = NormalMap::new(map, Interpolation::Normals, metal)?;
    Ok(Arc::new(mapped.into()))
}

/// Sizes of images and blocks, numbers of runs and samples.
#[derive(Clone, Copy, Debug)]
struct Effort {
    width: u32,
    block: usize,
    runs: u64,
    spp: u64,
}

/// Derivatives along the direction of a scene, by all estimators.
struct Found {
    /// Derivatives per estimator and block.
    blocks: Vec<Vec<Estimate>>,
    /// Mean derivative image per estimator.
    images: Vec<Vec<f64>>,
}

fn measure(edge: Edge, scene: &Scene, effort: Effort) -> Result<Found> {
    let along = [edge.direction(scene)?];
    let values = scene.params().values();
    let mut found = Found {
        blocks: Vec::new(),
        images: Vec::new(),
    };
    for (k, e) in ESTIMATORS.into_iter().enumerate() {
        let spp = effort.spp * if k == REFERENCE { 2 } else { 1 };
        let image = |run: u64| {
            let seed = SEED + (k as u64 + 1) * 1000 + run;
            let s = &scene.settings;
            let r = e.forward_f32(&Job::new(scene, s, seed, 0..spp, &()), values, &along)?;
            Ok::<_, render::RenderError>(grey(&r.sums[1], 1.0 / spp as f64))
        };
        let series = Series::of(effort.runs, [effort.width as usize, effort.block], image)?;
        found.images.push(series.means());
        found.blocks.push(series.blocks);
    }
    Ok(found)
}

/// Position of a block relative to the edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Near,
    Between,
    Away,
}

fn places(edge: Edge, scene: &Scene, effort: Effort) -> Vec<Place> {
    let [width, height] = scene.film.size;
    let [near, away] = edge.bounds();
    // Over the whole pixel grid: the nearest in a block, and whether all of it is far.
    let pixel = |i: u32| {
        let (x, y) = ((i % width) as f32 + 0.5, (i / width) as f32 + 0.5);
        edge.distance(scene, x, y)
    };
    let distances: Vec<_> = (0..width * height).map(pixel).collect();
    let flag = |f: &dyn Fn(f64) -> bool, none: bool| -> Vec<f64> {
        let flags = distances.iter().map(|d| d.map_or(none, f));
        let flags: Vec<f64> = flags.map(|b| f64::from(u8::from(b))).collect();
        blocks(&flags, width as usize, effort.block)
    };
    let (close, far) = (flag(&|d| d < near, false), flag(&|d| d > away, true));
    close
        .iter()
        .zip(&far)
        .map(|(c, f)| match (*c > 0.5, *f > 0.999) {
            (true, _) => Place::Near,
            (_, true) => Place::Away,
            _ => Place::Between,
        })
        .collect()
}

/// `zeltner-4-18`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let effort = Effort {
        width: fig.pick(72, 144),
        block: fig.pick(6, 8),
        runs: fig.pick(24, 32),
        spp: fig.pick(12, 96),
    };
    fig.note("width", effort.width);
    fig.note("runs", effort.runs);
    fig.note("samples per pixel and run", effort.spp);
    fig.note("seed", SEED);
    let mut rows = Vec::new();
    for edge in Edge::BOTH {
        let scene = edge.scene(effort.width)?;
        let places = places(edge, &scene, effort);
        let found = measure(edge, &scene, effort)?;
        judge(fig, edge, &places, &found, effort);
        show(fig, edge, &scene, &found, effort);
        for (i, place) in places.iter().enumerate() {
            for (k, e) in ESTIMATORS.iter().enumerate() {
                let b = found.blocks[k][i];
                rows.push([
                    edge.label().to_owned(),
                    i.to_string(),
                    format!("{place:?}").to_lowercase(),
                    e.name().to_owned(),
                    b.mean.to_string(),
                    b.se.to_string(),
                    b.z(&found.blocks[REFERENCE][i]).to_string(),
                ]);
            }
        }
    }
    let header = ["part", "block", "place", "estimator", "mean", "error", "z"];
    fig.csv_text("blocks", &header, rows);
    Ok(())
}

fn judge(fig: &mut Figure, edge: Edge, places: &[Place], found: &Found, effort: Effort) {
    let label = edge.label();
    let largest = |a: usize, b: usize, place: Option<Place>| {
        let zs = found.blocks[a].iter().zip(&found.blocks[b]).zip(places);
        zs.filter(|(_, p)| place.is_none_or(|place| **p == place))
            .map(|((a, b), _)| a.z(b))
            .fold((0.0f64, 0usize), |(most, n), z| {
                (if z.abs() > most.abs() { z } else { most }, n + 1)
            })
    };
    let limit = |n: usize| z_limit(n.max(1), effort.runs, LEVEL);
    for k in [1, REPARAMETERISED] {
        let (z, n) = largest(k, REFERENCE, None);
        fig.check(
            format!(
                "{label} {} equals the reference everywhere",
                ESTIMATORS[k].name()
            ),
            z.abs() < limit(n),
            format!("largest |z| of {n} blocks: {z:.2}, limit {:.2}", limit(n)),
        );
    }
    let (z, n) = largest(NAIVE, REFERENCE, Some(Place::Near));
    let noticed = found.blocks[NAIVE]
        .iter()
        .zip(&found.blocks[REFERENCE])
        .zip(places)
        .filter(|((a, b), p)| **p == Place::Near && a.z(b).abs() > 5.0)
        .count();
    let where_to = match edge {
        Edge::Ball => "near the reflected outline",
        Edge::Horizon => "at grazing angles",
    };
    fig.check(
        format!("{label} naive attached sampling is off by more than 5 standard errors {where_to}"),
        // The derivative changes its sign beside the edge, so not all of them are off by much.
        z.abs() > 5.0 && 4 * noticed > n,
        format!("{noticed} of {n} blocks, up to {:.1}", z.abs()),
    );
    let (z, n) = largest(NAIVE, REPARAMETERISED, Some(Place::Away));
    let (z2, _) = largest(NAIVE, REFERENCE, Some(Place::Away));
    fig.check(
        format!("{label} away from it, both attached estimators agree with each other"),
        n > 0 && z.abs() < limit(n) && z2.abs() < limit(n),
        format!(
            "largest |z| of {n} blocks: {z:.2}, of naive to the reference {z2:.2}, limit {:.2}",
            limit(n)
        ),
    );
}

fn show(fig: &mut Figure, edge: Edge, scene: &Scene, found: &Found, effort: Effort) {
    let image = picture(scene, SEED, 256).image(0);
    let width = effort.width as usize;
    let enlarge = (384 / width).max(1);
    let scale = percentile(&found.images[REFERENCE], 0.98);
    let signed = |label: &str, values: &[f64]| {
        Panel::signed(label, width, values, Some(scale)).enlarged(enlarge)
    };
    let mut panels = vec![Panel::tonemapped("image", &image, 1.0).enlarged(enlarge)];
    for k in [REFERENCE, NAIVE, REPARAMETERISED] {
        panels.push(signed(ESTIMATORS[k].name(), &found.images[k]));
    }
    for k in [NAIVE, REPARAMETERISED] {
        let pairs = found.images[k].iter().zip(&found.images[REFERENCE]);
        let difference: Vec<f64> = pairs.map(|(a, b)| a - b).collect();
        let label = format!("{} - mis", ESTIMATORS[k].name());
        panels.push(signed(&label, &difference));
    }
    let name = match edge {
        Edge::Ball => "a-outline",
        Edge::Horizon => "b-horizon",
    };
    fig.images(name, 3, &panels);
}
