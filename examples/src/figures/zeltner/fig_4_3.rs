//! Images of two derivatives: of a roughness, which no outline moves with, and of a position [Zeltner 2021, figure 4.3].

use render::instances::{Direction, Estimator, render_f32};
use render::params::Theta;
use render::{Job, Scene};

use super::propagation::grey;
use crate::chart::Panel;
use crate::figure::{Figure, Result};
use crate::figures::common_scenes::chess;
use crate::figures::statistics::{blocks, limit, per_pixel};
use crate::scene_builder::picture;

const SEED: u64 = 43;
const ROUGHNESS: &str = "table.alpha.value";
const PLACE: &str = "rook.translation";
/// Chance of a false alarm in one check.
const LEVEL: f64 = 1e-3;
/// Pixels along the side of a block.
const BLOCK: usize = 8;

/// Independent images of one derivative, grey.
type Images = Vec<Vec<f64>>;

struct Board {
    scene: Scene,
    runs: u64,
    spp: u64,
}

impl Board {
    /// Derivative images along a direction.
    fn by(&self, e: Estimator, direction: &Direction, stream: u64) -> Result<Images> {
        let each = |run: u64| -> Result<Vec<f64>> {
            let seed = SEED + 1000 * stream + run;
            let job = Job::new(&self.scene, &self.scene.settings, seed, 0..self.spp, &());
            let values = self.scene.params().values();
            let found = e.forward_f32(&job, values, std::slice::from_ref(direction))?;
            Ok(grey(found.image(1).data.iter().map(|&x| f64::from(x))))
        };
        (0..self.runs).map(each).collect()
    }

    /// Central differences with common random numbers, `more` times as many samples.
    fn differences(&mut self, name: &str, along: &[f32], h: f32, more: u64) -> Result<Images> {
        let start = self.scene.params().values().to_vec();
        let range = self.scene.params().find(name)?.range();
        let mut sides: [Images; 2] = Default::default();
        for (sign, images) in [1.0, -1.0].into_iter().zip(&mut sides) {
            let mut values = start.clone();
            let moved = values[range.clone()].iter_mut().zip(along);
            moved.for_each(|(v, d)| *v += sign * h * d);
            self.scene.set_params(&values)?;
            for run in 0..self.runs {
                let (scene, settings) = (&self.scene, &self.scene.settings);
                let job = Job::new(scene, settings, SEED + 500 + run, 0..more * self.spp, &());
                let shot = render_f32(&job, &Theta::constant(&values), Estimator::Mis);
                images.push(grey(shot.image(0).data.iter().map(|&x| f64::from(x))));
            }
        }
        self.scene.set_params(&start)?;
        let [plus, minus] = sides;
        let difference = |(p, m): (Vec<f64>, Vec<f64>)| {
            let pairs = p.iter().zip(&m);
            pairs.map(|(p, m)| (p - m) / (2.0 * f64::from(h))).collect()
        };
        Ok(plus.into_iter().zip(minus).map(difference).collect())
    }

    /// Per pixel, whether the outline of the rook passes through it.
    fn outline(&self) -> Vec<bool> {
        let [width, height] = self.scene.film.crop_size;
        let rook = |x: u32, y: u32| {
            let hit = self
                .scene
                .intersect(&self.scene.camera.ray(x as f32, y as f32));
            hit.is_some_and(|h| self.scene.shape_info(h.shape).name == "rook")
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let passes = pixels.map(|(x, y)| {
            let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| rook(x + i, y + j));
            corners.iter().any(|c| *c != corners[0])
        });
        passes.collect()
    }
}

fn mean(images: &[Vec<f64>]) -> Vec<f64> {
    per_pixel(images).iter().map(|e| e.mean).collect()
}

/// How much of the differences an image has, over some pixels: their scalar product, over that of two halves of the
/// differences, whose noise has nothing in common.
fn share(found: &[f64], differences: &Images, inside: &[bool]) -> f64 {
    let (a, b) = differences.split_at(differences.len() / 2);
    let (a, b) = (mean(a), mean(b));
    let over =
        |f: &dyn Fn(usize) -> f64| -> f64 { (0..inside.len()).filter(|i| inside[*i]).map(f).sum() };
    over(&|i| found[i] * 0.5 * (a[i] + b[i])) / over(&|i| a[i] * b[i])
}

/// The largest difference between blocks of two series, in standard errors, and its limit.
fn worst(a: &Images, b: &Images, width: usize) -> (f64, f64) {
    let of = |images: &Images| {
        let blocks: Images = images.iter().map(|i| blocks(i, width, BLOCK)).collect();
        per_pixel(&blocks)
    };
    let (a, b) = (of(a), of(b));
    let z = a.iter().zip(&b).map(|(a, b)| a.z(b).abs());
    (z.fold(0.0, f64::max), limit(a.len(), 8, LEVEL))
}

/// `zeltner-4-3`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick([64, 48], [192, 144]);
    let mut scene = chess(size, 3)?;
    scene.make_movable(&[PLACE])?;
    let mut board = Board {
        scene,
        runs: 8,
        spp: fig.pick(8, 64),
    };
    fig.note("runs", board.runs);
    fig.note("samples per pixel and run", board.spp);
    fig.note("seed", SEED);
    let width = size[0] as usize;

    // ---- The roughness of the table ----
    let rough = Direction::uniform(board.scene.params(), ROUGHNESS)?;
    let derivative = board.by(Estimator::DifferentialMis, &rough, 1)?;
    let differences = board.differences(ROUGHNESS, &[1.0], 0.02, 2)?;
    let (z, most) = worst(&derivative, &differences, width);
    fig.check(
        "roughness: blocks of the image equal differences",
        z < most,
        format!("largest |z| {z:.2}, limit {most:.2}"),
    );
    let shape = |x: u32, y: u32| {
        let ray = board.scene.camera.ray(x as f32 + 0.5, y as f32 + 0.5);
        let hit = board.scene.intersect(&ray);
        hit.map(|h| board.scene.shape_info(h.shape).name.clone())
    };
    let pixels = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
    let table: Vec<bool> = pixels
        .map(|(x, y)| shape(x, y).as_deref() == Some("table"))
        .collect();
    let roughness = mean(&derivative);
    let sum = |inside: bool| -> f64 {
        let chosen = roughness.iter().zip(&table).filter(|(_, t)| **t == inside);
        chosen.map(|(d, _)| d.abs()).sum()
    };
    fig.check(
        "the roughness of the table changes what does not show the table",
        sum(false) > 0.02 * sum(true),
        format!(
            "{:.1} % of the change",
            100.0 * sum(false) / (sum(true) + sum(false))
        ),
    );

    // ---- The rook, to the left ----
    let left = [-1.0, 0.0, 0.0];
    let handle = board
        .scene
        .params()
        .handle(board.scene.params().find(PLACE)?);
    let direction = Direction::Dense(handle, left.to_vec());
    let follows = board.by(Estimator::ReparameterisedMis, &direction, 2)?;
    let edges = board.by(Estimator::Edges, &direction, 3)?;
    let interior = board.by(Estimator::Interior, &direction, 4)?;
    let differences = board.differences(PLACE, &left, 0.01, 4)?;
    let inside = board.outline();
    let means = [&follows, &edges, &interior].map(|images| mean(images));
    let everywhere = vec![true; inside.len()];
    for (name, found, whole) in [
        ("reparameterised", &means[0], true),
        ("edges", &means[1], true),
    ] {
        let [outline, all] = [&inside, &everywhere].map(|i| share(found, &differences, i));
        fig.check(
            format!("{name}: the outline of the rook, its shadow and its reflection are there"),
            whole && (outline - 1.0).abs() < 0.1 && (all - 1.0).abs() < 0.1,
            format!("{outline:.3} of the differences along the outline, {all:.3} everywhere"),
        );
    }
    let missing = share(&means[2], &differences, &inside);
    fig.check(
        "without outlines, the lines are missing",
        missing.abs() < 0.3,
        format!("{missing:.3} of the differences along the outline"),
    );
    let signs = [true, false].map(|positive| {
        let pairs = means[0].iter().zip(&inside).filter(|(_, i)| **i);
        pairs.filter(|(d, _)| (**d > 0.0) == positive).count()
    });
    fig.check(
        "lines have both signs",
        signs.iter().all(|n| *n * 10 > signs[0] + signs[1]),
        format!("{} and {} pixels", signs[0], signs[1]),
    );

    let enlarge = fig.pick(4, 2);
    let image = picture(&board.scene, SEED, 64).image(0);
    let panel = |label: &str, values: &[f64], scale: f64| {
        Panel::signed(label, width, values, Some(scale)).enlarged(enlarge)
    };
    let large = |values: &[f64]| {
        let mut sorted: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() * 99 / 100].max(1e-6)
    };
    let [rough, moved] = [large(&roughness), large(&means[1])];
    let panels = [
        Panel::tonemapped("image", &image, 1.0).enlarged(enlarge),
        panel("roughness of the table", &roughness, rough),
        panel("rook to the left: reparameterised", &means[0], moved),
        panel("rook to the left: edges", &means[1], moved),
        panel("rook to the left: differences", &mean(&differences), moved),
        panel("rook to the left: without outlines", &means[2], moved),
    ];
    fig.images("derivatives", 2, &panels);
    Ok(())
}
