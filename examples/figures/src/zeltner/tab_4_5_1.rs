//! Which combinations of sampling and weights estimate a derivative: what the compiler says, and what
//! measurement says [Zeltner 2021, tables of section 4.5.1].

use std::marker::PhantomData;

use rayon::prelude::*;
use render::Job;
use render::bsdf::microfacet::Ndf;
use render::estimator::{
    Attached, AttachedChoice, AttachedDirect, AttachedRoulette, AttachedWeights, BsdfOnly,
    Detached, DetachedWeights, Differential, EmitterOnly, FrozenWeights, Mis, MixedWeights,
    Reparameterised, Unbiased,
};
use render::instances::{Direction, Estimator};
use render::statistics::{Estimate, z_limit};
use render::{Image, Scene};

use crate::differences::central;
use crate::statistics::{blocks, grey, per_pixel};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View};

const SEED: u64 = 451;
/// Chance of a false alarm, over all cells of one scene.
const LEVEL: f64 = 1e-3;
const NAME: &str = "plate.alpha.value";
const VIEW: [u32; 2] = [36, 24];
const BLOCK: usize = 6;

/// What the type system says about a combination: the constant of [`Refused`] where the one that asks
/// for [`Unbiased`] does not exist.
struct Verdict<S>(PhantomData<S>);

trait Refused {
    const ADMITTED: bool = false;
}

impl<S> Refused for Verdict<S> {}

impl<S: Unbiased> Verdict<S> {
    const ADMITTED: bool = true;
}

macro_rules! admitted {
    ($($combination:ty),* $(,)?) => {
        [$(Verdict::<$combination>::ADMITTED),*]
    };
}

/// Columns: how directions are drawn.
const COLUMNS: [&str; 4] = [
    "detached",
    "differential",
    "naive attached",
    "reparameterised",
];
/// Rows: what is done about light sampling and weights.
const ROWS: [&str; 5] = [
    "BSDF sampling alone",
    "MIS: estimators and weights detached",
    "MIS: estimators and weights attached",
    "MIS: attached estimators, detached weights",
    "MIS: detached estimators, attached weights",
];

/// A cell of the tables.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Cell {
    /// Unbiased in every scene.
    Valid(Estimator),
    /// Unbiased only in scenes without discontinuities; the second estimator is the one that other scenes admit.
    Naive(Estimator, Estimator),
    /// Biased in every scene.
    Biased(Estimator),
    /// Column and row contradict each other: there is no such type.
    None,
}

use Cell::{Biased, Naive, None as No, Valid};

/// [Zeltner 2021, section 4.5.1].
const TABLE: [[Cell; 4]; 5] = [
    [
        Valid(Estimator::Detached),
        Valid(Estimator::Differential),
        Naive(Estimator::AttachedNaive, Estimator::Attached),
        Valid(Estimator::Reparameterised),
    ],
    [
        Valid(Estimator::Mis),
        Valid(Estimator::DifferentialMis),
        No,
        No,
    ],
    [
        No,
        No,
        Naive(Estimator::AttachedMisNaive, Estimator::AttachedMis),
        Valid(Estimator::ReparameterisedMis),
    ],
    [
        No,
        No,
        Biased(Estimator::BiasedAttachedWeights),
        Biased(Estimator::BiasedWeights),
    ],
    [
        Valid(Estimator::MisAttachedWeights),
        Valid(Estimator::DifferentialMisAttachedWeights),
        No,
        No,
    ],
];

/// A plate of rough metal seen from the front, and its lights.
fn scene(lamps: bool) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let mut roughness = builder.ggx("plate", 0.06)?;
    (roughness.kind, roughness.visible) = (Ndf::Beckmann, false);
    let metal = builder.metal_of("plate", [0.9, 0.7, 0.5], roughness)?;
    let sides = [[2.0, 0.0, 0.0], [0.0, 0.0, -2.0]];
    builder.quad("plate", [[-1.0, 0.0, 1.0], sides[0], sides[1]], &metal)?;
    if lamps {
        let black = builder.matt("black", [0.0; 3])?;
        let lamp = builder.ball("lamp", [0.0, 2.0, -3.2], 0.5, &black)?;
        builder.lamp("lamp", lamp, [4.0, 3.0, 2.0])?;
        let dark = builder.matt("ball", [0.1; 3])?;
        builder.ball("ball", [0.4, 1.0, -1.6], 0.3, &dark)?;
    } else {
        builder.lobe("lobe", [3.0, 2.0, 1.0], [0.1, 0.55, -0.8], 12.0)?;
    }
    let view = View {
        eye: [0.0, 2.2, 3.6],
        target: [0.0; 3],
        fov: 26.0,
        size: VIEW,
    };
    builder.finish(&view, 2)
}

/// Numbers of runs and samples.
#[derive(Clone, Copy, Debug)]
struct Effort {
    runs: u64,
    spp: u64,
}

/// Derivative images of independent runs.
fn derivatives(e: Estimator, scene: &Scene, effort: Effort) -> Result<Vec<Vec<f64>>> {
    let along = [Direction::uniform(scene.params(), NAME)?];
    let values = scene.params().values();
    let stream = 1 + Estimator::ALL.iter().position(|x| *x == e).unwrap_or(0) as u64;
    let image = |run: u64| {
        let seed = SEED + stream * 10_000 + run;
        let spp = effort.spp;
        let r = e.forward_f32(
            &Job::new(scene, &scene.settings, seed, 0..spp, &()),
            values,
            &along,
        )?;
        Ok(grey(&r.sums[1], 1.0 / spp as f64))
    };
    let images: std::result::Result<Vec<_>, render::RenderError> =
        (0..effort.runs).into_par_iter().map(image).collect();
    Ok(images?)
}

/// Central differences in double precision. Samples of lights do not move with roughness: with common
/// random numbers, one bounce is smooth.
fn differences(scene: &Scene, effort: Effort) -> Result<Vec<Vec<f64>>> {
    let at = scene.params().find(NAME)?.offset;
    let h = 1e-4 * f64::from(scene.params().values()[at]);
    let spp = effort.spp;
    let image = |run: u64| {
        let job = Job::new(scene, &scene.settings, SEED + run, 0..spp, &());
        let difference = central(&job, Estimator::Emitter, &[(at, h)]);
        grey(&difference, 1.0 / (2.0 * h * spp as f64))
    };
    Ok((0..effort.runs).into_par_iter().map(image).collect())
}

/// Independent runs in blocks of [`BLOCK`] pixels, and their mean image.
struct Found {
    blocks: Vec<Estimate>,
    image: Vec<f64>,
}

impl Found {
    fn of(images: &[Vec<f64>]) -> Self {
        let width = VIEW[0] as usize;
        let averaged: Vec<_> = images.iter().map(|i| blocks(i, width, BLOCK)).collect();
        let image = per_pixel(images).into_iter().map(|e| e.mean);
        Self {
            blocks: per_pixel(&averaged),
            image: image.collect(),
        }
    }

    /// The blocks that count: elsewhere a rough lobe hits the lamp so rarely that standard errors say
    /// nothing.
    fn strong(&self) -> Vec<bool> {
        let magnitudes = self.blocks.iter().map(|b| b.mean.abs());
        let largest = magnitudes.fold(0.0, f64::max);
        let strong = |b: &Estimate| b.mean.abs() > 0.05 * largest;
        self.blocks.iter().map(strong).collect()
    }

    /// Largest difference of a block that counts, in standard errors.
    fn z(&self, reference: &Self) -> f64 {
        let pairs = self.blocks.iter().zip(&reference.blocks);
        let zs = pairs.zip(reference.strong()).filter(|(_, strong)| *strong);
        zs.map(|((a, b), _)| a.z(b).abs()).fold(0.0, f64::max)
    }
}

/// Results of all estimators in one scene.
struct Trial {
    name: &'static str,
    reference: Found,
    found: Vec<(Estimator, Found)>,
    /// Number of blocks that count.
    strong: usize,
    /// |z| that an unbiased estimator stays below.
    limit: f64,
}

impl Trial {
    fn new(
        name: &'static str,
        scene: &Scene,
        estimators: &[Estimator],
        effort: Effort,
    ) -> Result<Self> {
        let reference = Found::of(&differences(scene, effort)?);
        let mut found = Vec::new();
        for &e in estimators {
            found.push((e, Found::of(&derivatives(e, scene, effort)?)));
        }
        let strong = reference.strong().iter().filter(|s| **s).count();
        let tests = estimators.len() * strong;
        Ok(Self {
            name,
            reference,
            found,
            strong,
            limit: z_limit(tests, effort.runs, LEVEL),
        })
    }

    /// Largest |z| of a block.
    fn z(&self, e: Estimator) -> f64 {
        let found = self.found.iter().find(|(x, _)| *x == e);
        found.map_or(f64::NAN, |(_, found)| found.z(&self.reference))
    }

    /// Checks that all are close to the reference, or that none is.
    fn judge(&self, fig: &mut Figure, statement: &str, estimators: &[Estimator], right: bool) {
        let zs: Vec<f64> = estimators.iter().map(|e| self.z(*e)).collect();
        let holds = zs.iter().all(|z| (*z < self.limit) == right);
        let list: Vec<String> = estimators
            .iter()
            .zip(&zs)
            .map(|(e, z)| format!("{} {z:.1}", e.name()))
            .collect();
        fig.check(
            format!("{}: {statement}", self.name),
            holds && zs.iter().all(|z| z.is_finite()),
            format!(
                "largest |z| of {} blocks, limit {:.2}: {}",
                self.strong,
                self.limit,
                list.join(", ")
            ),
        );
    }
}

fn cells(pick: impl Fn(Cell) -> Option<Estimator>) -> Vec<Estimator> {
    TABLE.into_iter().flatten().filter_map(pick).collect()
}

/// `zeltner-tab-4-5-1`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    types(fig);
    let effort = Effort {
        runs: 32,
        spp: fig.pick(32, 512),
    };
    fig.note("runs", effort.runs);
    fig.note("samples per pixel and run", effort.spp);
    fig.note("seed", SEED);

    let valid = cells(|c| match c {
        Valid(e) => Some(e),
        _ => None,
    });
    let naive = cells(|c| match c {
        Naive(e, _) => Some(e),
        _ => None,
    });
    let allowed = cells(|c| match c {
        Naive(_, e) => Some(e),
        _ => None,
    });
    let mut biased = cells(|c| match c {
        Biased(e) => Some(e),
        _ => None,
    });
    biased.push(Estimator::BiasedMixed);
    let others = [Estimator::Emitter];

    let hidden = scene(true)?;
    let estimators = [&valid[..], &naive, &biased, &others].concat();
    let trial = Trial::new("lamp behind a ball", &hidden, &estimators, effort)?;
    let all_valid = [&valid[..], &others].concat();
    trial.judge(
        fig,
        "all valid cells, and light sampling, equal finite differences",
        &all_valid,
        true,
    );
    trial.judge(fig, "naive attached cells are noticed", &naive, false);
    trial.judge(
        fig,
        "cells with the wrong weights are noticed",
        &biased,
        false,
    );
    let refused = allowed.iter().all(|e| e.check(&hidden).is_err());
    fig.check(
        "naive attached sampling is refused when it meets this scene",
        refused,
        match allowed[0].check(&hidden) {
            Ok(()) => "accepted".into(),
            Err(e) => e.to_string(),
        },
    );

    let open = scene(false)?;
    let mut right = [&all_valid[..], &allowed].concat();
    right.push(Estimator::AttachedMisFrozen);
    let estimators = [&right[..], &biased].concat();
    let smooth = Trial::new("nothing hidden", &open, &estimators, effort)?;
    smooth.judge(
        fig,
        "valid cells, and attached ones too, equal finite differences",
        &right,
        true,
    );
    smooth.judge(
        fig,
        "wrong weights are noticed all the same",
        &biased,
        false,
    );

    report(fig, &[&trial, &smooth], &valid, &biased);
    picture(fig, &trial);
    Ok(())
}

/// What the compiler admits.
fn types(fig: &mut Figure) {
    type M<B, W> = Mis<B, Detached, W>;
    let single = admitted![
        EmitterOnly<Detached>,
        BsdfOnly<Detached>,
        BsdfOnly<Differential>,
        BsdfOnly<AttachedDirect>,
        BsdfOnly<Attached>,
        BsdfOnly<Reparameterised>,
    ];
    let detached = admitted![
        M<Detached, DetachedWeights>,
        M<Detached, AttachedWeights>,
        M<Differential, DetachedWeights>,
        M<Differential, AttachedWeights>,
    ];
    let attached = admitted![
        M<Reparameterised, AttachedWeights>,
        M<AttachedDirect, AttachedWeights>,
        M<Attached, AttachedWeights>,
        EmitterOnly<Detached, Attached>,
        Mis<AttachedDirect, Attached, AttachedWeights>,
    ];
    let frozen = admitted![
        M<Detached, FrozenWeights>,
        M<Differential, FrozenWeights>,
        M<Reparameterised, FrozenWeights>,
        M<AttachedDirect, FrozenWeights>,
    ];
    let wrong = admitted![
        M<Reparameterised, DetachedWeights>,
        M<AttachedDirect, DetachedWeights>,
        M<Attached, DetachedWeights>,
        M<Detached, MixedWeights>,
        M<Differential, MixedWeights>,
        M<Reparameterised, MixedWeights>,
        M<AttachedDirect, MixedWeights>,
        Mis<Detached, Attached, DetachedWeights>,
        Mis<Differential, Attached, AttachedWeights>,
        EmitterOnly<Attached, Attached>,
        Mis<Reparameterised, Reparameterised, AttachedWeights>,
        Mis<Differential, Differential, DetachedWeights>,
        AttachedRoulette<M<Detached, DetachedWeights>>,
        AttachedRoulette<BsdfOnly<Detached>>,
        AttachedChoice<M<Detached, DetachedWeights>>,
        AttachedChoice<BsdfOnly<Detached>>,
    ];
    let count = |all: &[bool]| all.iter().filter(|a| **a).count();
    let mis = count(&detached) + count(&attached[..1]);
    fig.check(
        "the compiler admits the single techniques and exactly five combinations for scenes with \
         discontinuities",
        count(&single) == single.len() && mis == 5 && count(&wrong) == 0,
        format!(
            "{} of {} single techniques, {mis} of 5 combinations; {} of {} wrong or contradictory ones",
            count(&single),
            single.len(),
            count(&wrong),
            wrong.len()
        ),
    );
    fig.check(
        "it also admits attached estimators that the scene decides about, and frozen weights",
        count(&attached) == attached.len() && count(&frozen) == frozen.len(),
        format!(
            "{} of {} and {} of {}",
            count(&attached),
            attached.len(),
            count(&frozen),
            frozen.len()
        ),
    );
}

fn report(fig: &mut Figure, trials: &[&Trial], valid: &[Estimator], biased: &[Estimator]) {
    let rows = trials.iter().flat_map(|t| {
        t.found.iter().flat_map(move |(e, found)| {
            let kind = match (valid.contains(e), biased.contains(e)) {
                (true, _) => "valid",
                (_, true) => "biased",
                _ => "depends on the scene",
            };
            let pairs = found.blocks.iter().zip(&t.reference.blocks).enumerate();
            pairs.map(move |(i, (f, r))| {
                let numbers = [f.mean, f.se, r.mean, r.se, f.z(r)];
                let [mean, error, reference, its, z] = numbers.map(|x| x.to_string());
                let [scene, e, kind] = [t.name, e.name(), kind].map(str::to_owned);
                [
                    scene,
                    e,
                    kind,
                    i.to_string(),
                    mean,
                    error,
                    reference,
                    its,
                    z,
                ]
            })
        })
    });
    let header = [
        "scene",
        "estimator",
        "kind",
        "block",
        "mean",
        "error",
        "reference",
        "its error",
        "z",
    ];
    let rows: Vec<_> = rows.collect();
    fig.csv_text("cells", &header, rows);

    let rows = ROWS.iter().zip(TABLE).flat_map(|(row, cells)| {
        COLUMNS.iter().zip(cells).map(move |(column, cell)| {
            let (verdict, name) = match cell {
                Valid(e) => ("valid", e.name()),
                Naive(e, _) => ("biased at discontinuities", e.name()),
                Biased(e) => ("biased", e.name()),
                No => ("no such type", ""),
            };
            let z = |t: &Trial| match cell {
                Valid(e) | Biased(e) | Naive(e, _) => t.z(e).to_string(),
                No => String::new(),
            };
            let [row, column] = [row, column].map(|s| (*s).to_owned());
            [row, column, verdict.into(), name.into(), z(trials[0])]
        })
    });
    let rows: Vec<_> = rows.collect();
    let header = [
        "combination",
        "BSDF sampling",
        "verdict",
        "estimator",
        "largest z",
    ];
    fig.csv_text("table", &header, rows);
}

/// The table in pictures: the derivative image of every cell, beside the hidden lamp.
fn picture(fig: &mut Figure, trial: &Trial) {
    let width = VIEW[0] as usize;
    let all = trial.reference.image.iter();
    let scale = 0.75 * all.fold(0.0f64, |m, x| m.max(x.abs()));
    let panel =
        |label: &str, values: &[f64]| Panel::signed(label, width, values, Some(scale)).enlarged(8);
    let blank = |label: &str| {
        let mut grey = Image::new(width, VIEW[1] as usize);
        grey.data.fill(0.6);
        Panel::tonemapped(label, &grey, 1.0).enlarged(8)
    };
    let mut panels = vec![panel("finite differences", &trial.reference.image)];
    panels.extend((1..COLUMNS.len()).map(|_| blank("")));
    for row in TABLE {
        for cell in row {
            let image = |e: Estimator| {
                let found = trial.found.iter().find(|(x, _)| *x == e);
                found.map_or(&[][..], |(_, found)| &found.image)
            };
            panels.push(match cell {
                Valid(e) => panel(e.name(), image(e)),
                Naive(e, _) | Biased(e) => panel(&format!("BIASED {}", e.name()), image(e)),
                No => blank("no such type"),
            });
        }
    }
    fig.images("table", COLUMNS.len(), &panels);
}
