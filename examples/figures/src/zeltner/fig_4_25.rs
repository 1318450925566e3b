//! Shape and texture of an object, found together from five pictures [Zeltner 2021, figure 4.25].

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use optim::{
    Adam, AdamOptions, AnyOptimizer, Coarse, Constrained, Groups, Loss, LossKind, Parameterisation,
    Rates, Schedule,
};
use render::bsdf::{Diffuse, Material};
use render::camera::{Camera, FovAxis};
use render::instances::Estimator;
use render::math::Transform;
use render::sampler::{Points, mix64};
use render::scene::{LightChoice, Sensor};
use render::shape::{HEIGHTS, Mesh, MeshData};
use render::{Film, Image, Scene, Settings};

use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::optimise::{Algorithm, Problem, Target};
use examples::scene_builder::{self, SceneBuilder, UNIT};

const SEED: u64 = 425;
const SHAPE: &str = "object.displacement.data";
const COLOUR: &str = "object.reflectance.data";
/// Half axes of the undisplaced object.
const AXES: [f64; 3] = [1.0, 0.8, 0.9];
/// Texels along a side of the displacement.
const HEIGHT_SIDE: usize = 64;
/// Where the cameras are: turn and height in degrees; the last one is held out.
const VIEWS: [[f64; 2]; 6] = [
    [10.0, 25.0],
    [85.0, -15.0],
    [150.0, 40.0],
    [225.0, 10.0],
    [295.0, 45.0],
    [0.0, 85.0],
];
const TRAINED: usize = 5;
/// Texels along a side of heights and of colours at first.
const COARSEST: [usize; 2] = [8, 64];
/// What a step of Adam is at first, for heights and for colours.
const RATES: [f64; 2] = [0.01, 0.06];
/// What is left of that at the end: where the loss is the sign of a difference, values go on to jump by a whole step.
const LAST_RATE: f64 = 0.02;
/// Ten steps of memory: a texel of a finer image has a quarter of the gradient that a coarse one had, and would hardly
/// move as long as that is remembered. Its direction is forgotten before, so that a texel that is met once comes to rest.
const BETAS: [f64; 2] = [0.8, 0.9];

/// An ellipsoid of latitudes and longitudes, u around and v up the y axis.
fn ellipsoid(around: u32, up: u32) -> MeshData {
    let mut mesh = MeshData::default();
    for j in 0..=up {
        for i in 0..=around {
            let [u, v] = [
                f64::from(i) / f64::from(around),
                f64::from(j) / f64::from(up),
            ];
            // The same digits on both sides of the seam, and one point at each pole.
            let turn = TAU * f64::from(i % around) / f64::from(around);
            let ring = if j == 0 || j == up {
                0.0
            } else {
                (PI * v).sin()
            };
            let p = [ring * turn.cos(), -(PI * v).cos(), -ring * turn.sin()];
            mesh.positions
                .push([0, 1, 2].map(|k: usize| (p[k] * AXES[k]) as f32));
            mesh.uvs.push([u as f32, v as f32]);
        }
    }
    let row = around + 1;
    for j in 0..up {
        for i in 0..around {
            let a = j * row + i;
            if j > 0 {
                mesh.triangles.push([a, a + 1, a + row + 1]);
            }
            if j + 1 < up {
                mesh.triangles.push([a, a + row + 1, a + row]);
            }
        }
    }
    mesh
}

/// A direction from the middle, for the texel (i, j).
fn towards(i: usize, j: usize, side: usize) -> [f64; 3] {
    let [u, v] = [i, j].map(|k| (k as f64 + 0.5) / side as f64);
    let (turn, ring) = (TAU * u, (PI * v).sin());
    [ring * turn.cos(), -(PI * v).cos(), -ring * turn.sin()]
}

/// Bumps, ridges and a dent.
fn heights() -> Vec<f32> {
    let height = |i: usize| {
        let [x, y, z] = towards(i % HEIGHT_SIDE, i / HEIGHT_SIDE, HEIGHT_SIDE);
        let bump = |c: [f64; 3], width: f64, h: f64| {
            let d = (x - c[0]).powi(2) + (y - c[1]).powi(2) + (z - c[2]).powi(2);
            h * (-d / (width * width)).exp()
        };
        let ridges = 0.05 * (7.0 * x + 3.0 * y).sin() * (5.0 * z - 2.0 * y).cos();
        let bumps = bump([0.8, 0.5, 0.3], 0.35, 0.3) + bump([-0.5, 0.6, 0.6], 0.4, 0.25);
        let others = bump([0.1, 0.2, -1.0], 0.4, 0.3) + bump([-0.9, -0.2, -0.2], 0.5, -0.2);
        (ridges + bumps + others) as f32
    };
    (0..HEIGHT_SIDE * HEIGHT_SIDE).map(height).collect()
}

/// Patches of colour with fine lines.
fn colours(side: usize) -> Vec<f32> {
    let colour = |i: usize| {
        let [x, y, z] = towards(i % side, i / side, side);
        let patches = (4.0 * x + 1.0).sin() + (5.0 * y - 2.0 * z).sin() + (4.0 * z + x).cos();
        let base = if patches > 0.6 {
            [0.75, 0.3, 0.15]
        } else if patches > -0.5 {
            [0.7, 0.65, 0.5]
        } else {
            [0.2, 0.4, 0.5]
        };
        let lines = 1.0 - 0.5 * f64::from((14.0 * (y + 0.3 * x)).sin() > 0.9);
        base.map(|c| (c * lines) as f32)
    };
    (0..side * side).flat_map(colour).collect()
}

#[derive(Clone, Copy)]
struct Effort {
    /// Along a side of a view.
    pixels: u32,
    /// Squares of the mesh around its axis; half as many along it.
    around: u32,
    /// Texels along a side of the albedo.
    colour_side: usize,
    /// Samples per pixel of derivatives.
    spp: u32,
    /// Those of the images that a step compares: the loss takes the sign of a difference, which noise makes a toss of a
    /// coin, and images cost less than derivatives.
    image_spp: u32,
    steps: u64,
    /// Samples per pixel of images that are shown and judged.
    many: u64,
}

fn scene(effort: &Effort) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let size = [HEIGHT_SIDE as u32; 2];
    let build = &mut builder.build;
    let texture = build.texels::<1>("object.displacement", size, &heights(), HEIGHTS)?;
    let mesh = Mesh::smoothed(ellipsoid(effort.around, effort.around / 2), false)?;
    let mesh = mesh.displaced(&texture, build.params())?;
    let side = effort.colour_side;
    let texels = colours(side);
    let reflectance = build.texels::<3>("object.reflectance", [side as u32; 2], &texels, UNIT)?;
    let matt = std::sync::Arc::new(Material::from(Diffuse { reflectance }));
    builder.shape("object", mesh, &matt);
    builder.ambient([0.25, 0.27, 0.32])?;
    builder.lobe("sun", [4.0, 3.7, 3.2], [0.6, 0.7, 0.4], 12.0)?;
    builder.lobe("fill", [0.8, 1.0, 1.3], [-0.7, 0.1, -0.5], 4.0)?;
    let mut sensors = Vec::new();
    for (i, view) in VIEWS.into_iter().enumerate() {
        let [turn, height] = view.map(f64::to_radians);
        let flat = height.cos();
        let eye = [flat * turn.cos(), height.sin(), flat * turn.sin()].map(|x| 5.0 * x);
        let to_world = Transform::look_at(eye, [0.0; 3], [0.0, 1.0, 0.0]);
        let to_world = to_world.ok_or("a camera that looks nowhere")?;
        sensors.push(Sensor {
            name: format!("view{i}"),
            camera: Camera::new(to_world, 34.0, FovAxis::Smaller, [effort.pixels; 2])?,
            film: Film::new(effort.pixels, effort.pixels),
            spp: effort.spp,
        });
    }
    let settings = Settings {
        max_depth: 2,
        rr_depth: u32::MAX,
        spp: effort.spp,
        points: Points::Sobol,
        lights: LightChoice::All,
        ..Settings::default()
    };
    Ok(builder.build.build_with(sensors, 0, settings)?)
}

struct Setup {
    problem: Problem,
    held_out: Image,
    effort: Effort,
    start: Vec<f32>,
    truth: Vec<f32>,
}

/// Losses with little noise at some steps, of the views that are seen and of the one that is held out, and the values there.
struct Descent {
    losses: Vec<(u64, f64, f64)>,
    stages: Vec<(u64, Vec<f32>)>,
    folded: usize,
    bad: u64,
}

impl Descent {
    fn last(&self) -> (f64, f64) {
        self.losses
            .last()
            .map_or((f64::NAN, f64::NAN), |l| (l.1, l.2))
    }
}

impl Setup {
    fn new(effort: Effort) -> Result<Self> {
        let mut scene = scene(&effort)?;
        let mut images = Vec::new();
        for view in 0..VIEWS.len() {
            scene.look_through(view)?;
            images.push(scene_builder::picture(&scene, SEED, 4 * effort.many).image(0));
        }
        let held_out = images.pop().ok_or("no view")?;
        let active = Estimator::Edges.active(&scene, &[SHAPE, COLOUR])?;
        let settings = scene.settings;
        let targets = images.into_iter().enumerate().map(|(i, image)| Target {
            sensor: Some(i),
            image,
        });
        let problem = Problem {
            settings,
            active,
            estimator: Estimator::Edges,
            image_spp: Some(effort.image_spp),
            loss: "relative-l1".parse::<LossKind>()?,
            targets: targets.collect(),
            scene,
        };
        let truth = problem.values();
        let mut start = Vec::new();
        for info in problem.active.ranges() {
            let value = if info.name == SHAPE { 0.0 } else { 0.5 };
            start.resize(start.len() + info.shape.len(), value);
        }
        Ok(Self {
            problem,
            held_out,
            effort,
            start,
            truth,
        })
    }

    fn range(&self, name: &str) -> Range<usize> {
        let mut at = 0;
        for info in self.problem.active.ranges() {
            let range = at..at + info.shape.len();
            if info.name == name {
                return range;
            }
            at = range.end;
        }
        0..0
    }

    fn picture(&mut self, view: usize) -> Result<Image> {
        self.problem.scene.look_through(view)?;
        let spp = self.effort.many;
        Ok(scene_builder::picture(&self.problem.scene, SEED + 1, spp).image(0))
    }

    /// Mean loss of the views that are seen, and that of the one that is held out.
    fn losses(&mut self, values: &[f32]) -> Result<(f64, f64)> {
        self.problem.set(values)?;
        let mut sum = 0.0;
        for view in 0..TRAINED {
            let image = self.picture(view)?;
            let target = &self.problem.targets[view].image;
            sum += self.problem.loss.value(&image.data, &target.data)?;
        }
        let image = self.picture(TRAINED)?;
        let held_out = self.problem.loss.value(&image.data, &self.held_out.data)?;
        Ok((sum / TRAINED as f64, held_out))
    }

    /// By Adam, from coarse to fine or at full resolution from the beginning.
    fn descend(&mut self, coarse_to_fine: bool) -> Result<Descent> {
        let steps = self.effort.steps;
        let n = self.start.len();
        let (shape, colour) = (self.range(SHAPE), self.range(COLOUR));
        let mut groups = Groups::new(n);
        groups.add(SHAPE, shape.clone(), Parameterisation::bounded(-1.0, 1.0)?)?;
        groups.add(COLOUR, colour.clone(), Parameterisation::bounded(0.0, 1.0)?)?;
        if coarse_to_fine {
            // Both are at their own resolution for the last two fifths.
            let coarse = |side: usize, channels: usize, start: usize| {
                let doublings = u64::from((side / start).ilog2());
                Coarse::new(
                    [side; 2],
                    channels,
                    start,
                    (3 * steps).div_ceil(5 * doublings),
                )
            };
            groups.coarsen(SHAPE, coarse(HEIGHT_SIDE, 1, COARSEST[0])?)?;
            groups.coarsen(COLOUR, coarse(self.effort.colour_side, 3, COARSEST[1])?)?;
        }
        let floor = LAST_RATE;
        let cosine = Schedule::Cosine { steps, floor };
        let mut rates = Rates::new(n, RATES[1])?.with_schedule(cosine)?;
        rates.set_rate(shape, RATES[0])?;
        let options = AdamOptions {
            beta1: BETAS[0],
            beta2: BETAS[1],
            ..Default::default()
        };
        let adam = AnyOptimizer::Adam(Adam::with_options(rates, options)?);
        let mut algorithm = Algorithm::FirstOrder(Constrained::new(adam, groups)?);
        let mut values = self.start.clone();
        let mut out = Descent {
            losses: Vec::new(),
            stages: Vec::new(),
            folded: 0,
            bad: 0,
        };
        for i in 0..=steps {
            if i % (steps / 8).max(1) == 0 {
                let (seen, held_out) = self.losses(&values)?;
                out.losses.push((i, seen, held_out));
            }
            if i % (steps / 4).max(1) == 0 {
                out.stages.push((i, values.clone()));
            }
            if i == steps {
                break;
            }
            let seeds = [2 * i, 2 * i + 1].map(|s| mix64(SEED + 10 + s));
            let report = self
                .problem
                .advance(&mut values, &mut algorithm, seeds, &())?;
            let report = report.ok_or("stopped")?;
            out.bad += report.non_finite.iter().map(|n| n.count).sum::<u64>();
        }
        self.problem.set(&values)?;
        out.folded = self.problem.scene.folded().iter().map(|(_, n, _)| n).sum();
        Ok(out)
    }

    /// Mean distance of heights from the truth, over that of the start.
    fn shape_error(&self, values: &[f32]) -> f64 {
        let range = self.range(SHAPE);
        let far = |values: &[f32]| {
            let pairs = values[range.clone()].iter().zip(&self.truth[range.clone()]);
            pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>()
        };
        far(values) / far(&self.start)
    }
}

/// `zeltner-4-25`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let effort = Effort {
        pixels: fig.pick(24, 80),
        around: fig.pick(48, 128),
        colour_side: fig.pick(128, 1024),
        spp: fig.pick(2, 4),
        image_spp: fig.pick(32, 64),
        steps: fig.pick(40, 72),
        many: fig.pick(32, 128),
    };
    let mut setup = Setup::new(effort)?;
    fig.note("unknown values", setup.start.len());
    fig.note("pixels of a view", effort.pixels * effort.pixels);
    fig.note("samples per pixel of derivatives", effort.spp);
    fig.note("samples per pixel of images", effort.image_spp);
    fig.note("steps", effort.steps);
    fig.note("seed", SEED);
    let fine = setup.descend(true)?;
    let single = setup.descend(false)?;
    judge(fig, &setup, &fine, &single);
    show(fig, &mut setup, &fine, &single)
}

fn judge(fig: &mut Figure, setup: &Setup, fine: &Descent, single: &Descent) {
    let count = setup.start.len();
    let least = fig.pick(50_000, 1_000_000);
    fig.check(
        format!("(a) more than {least} values are found at once, all derivatives of them finite"),
        count > least && fine.bad == 0,
        format!("{count} values, {} samples left out", fine.bad),
    );
    let (first, first_held_out) = (fine.losses[0].1, fine.losses[0].2);
    let (seen, held_out) = fine.last();
    let goal = fig.pick(0.25, 0.1);
    fig.check(
        format!(
            "(b) the loss of five views falls below {} % of the initial one",
            100.0 * goal
        ),
        seen < goal * first,
        format!(
            "from {first:.3} to {seen:.4}, {:.1} %",
            100.0 * seen / first
        ),
    );
    fig.check(
        "(c) the loss of the view that is held out falls, too, and stays within 3 times that of the others",
        held_out < 0.5 * first_held_out && held_out < 3.0 * seen,
        format!("from {first_held_out:.3} to {held_out:.4}, {:.2} times the others", held_out / seen),
    );
    let (by_single, single_held_out) = single.last();
    fig.check(
        "(d) at full resolution from the beginning, the losses end higher",
        by_single > seen && single_held_out > held_out,
        format!(
            "{by_single:.4} and {single_held_out:.4} held out; {} triangles are turned over, {} from coarse to fine",
            single.folded, fine.folded
        ),
    );
    let [a, b] = [fine, single].map(|d| {
        d.stages
            .last()
            .map_or(f64::NAN, |(_, values)| setup.shape_error(values))
    });
    fig.check(
        "(e) heights come closer to the truth",
        a < fig.pick(0.9, 0.7) && a < b,
        format!(
            "{:.1} % of the distance at the start are left; {:.1} % at full resolution",
            100.0 * a,
            100.0 * b
        ),
    );
}

fn show(fig: &mut Figure, setup: &mut Setup, fine: &Descent, single: &Descent) -> Result {
    let mut chart = LineChart::new("Shape and texture", "step", "relative L1").log_y();
    let mut rows = Vec::new();
    for (k, (label, run)) in [("coarse to fine", fine), ("one resolution", single)]
        .into_iter()
        .enumerate()
    {
        let points = |held_out: bool| {
            let points = run.losses.iter();
            points.map(move |l| (l.0 as f64, if held_out { l.2 } else { l.1 }))
        };
        chart = chart.measured(&format!("{label}, five views"), points(false));
        chart = chart.measured(&format!("{label}, held out"), points(true));
        rows.extend(run.losses.iter().map(|l| [k as f64, l.0 as f64, l.1, l.2]));
    }
    fig.chart("losses", &chart);
    fig.csv(
        "losses",
        &["one resolution", "step", "five views", "held out"],
        rows,
    );
    let enlarge = fig.pick(6, 2);
    let mut panels = Vec::new();
    for view in [0, 2, 3, TRAINED] {
        for (step, values) in &fine.stages {
            setup.problem.set(values)?;
            let image = setup.picture(view)?;
            let kind = if view == TRAINED { "held out" } else { "view" };
            let label = format!("{kind} {view}, step {step}");
            panels.push(Panel::tonemapped(&label, &image, 1.0).enlarged(enlarge));
        }
        let target = setup
            .problem
            .targets
            .get(view)
            .map_or(&setup.held_out, |t| &t.image);
        panels.push(Panel::tonemapped("target", target, 1.0).enlarged(enlarge));
    }
    fig.images("views", fine.stages.len() + 1, &panels);
    let range = setup.range(SHAPE);
    let mut heights = Vec::new();
    let stages = fine
        .stages
        .iter()
        .map(|(step, v)| (format!("step {step}"), v));
    let last = single
        .stages
        .last()
        .map(|(_, v)| ("one resolution".to_owned(), v));
    let all = stages
        .chain(last)
        .chain([("target".to_owned(), &setup.truth)]);
    for (label, values) in all {
        let values: Vec<f64> = values[range.clone()].iter().map(|&v| v.into()).collect();
        heights.push(Panel::false_colour(&label, HEIGHT_SIDE, &values, -0.25, 0.35).enlarged(3));
    }
    fig.images("heights", 4, &heights);
    Ok(())
}
