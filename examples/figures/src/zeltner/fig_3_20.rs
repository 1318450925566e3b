//! [Zeltner 2021, figure 3.20]: on a wall of bumpy metal solutions have their basins in a small part of it, and that is where a
//! first stage over the smooth wall ends.

use ad_core::Vec3;
use rayon::prelude::*;
use render::Scene;
use render::bsdf::DeltaKind;
use render::manifold::{Event, Normal, Slopes, Solution, Start, Target};
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Uniqueness};

use super::authors::Authors;
use super::manifold_scenes::{WALL, Waves, mapped_quad, metal, mirrored};
use super::specular_scenes::Laboratory;
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 320;
/// Standard deviation of the slopes.
const SLOPE: f64 = 0.08;
/// Their wavelength, on a wall of 10 by 8.
const WAVELENGTH: f64 = 0.8;
/// The wall among the shapes.
const SHAPE: u32 = 1;

/// What is looked at.
struct Place {
    /// Corner and sides of the wall.
    wall: [[f64; 3]; 3],
    /// A point of the floor, x and z.
    floor: [f64; 2],
    /// The middle of the lamp.
    lamp: [f64; 3],
}

const OURS: Place = Place {
    wall: WALL,
    floor: [0.5, 1.0],
    lamp: [0.0, 9.0, 10.0],
};

/// In the plane of the authors, which is turned by 30 degrees about the vertical axis, as its lamp is by 40 after a fall by 60.
fn published() -> Place {
    let (sin, cos) = (30f64).to_radians().sin_cos();
    let (away, up) = (
        50.0 * (60f64).to_radians().sin(),
        50.0 * (60f64).to_radians().cos(),
    );
    let (across, towards) = (40f64).to_radians().sin_cos();
    Place {
        wall: [
            [-8.0 * cos, 0.0, -8.0 * sin],
            [16.0 * cos, 0.0, 16.0 * sin],
            [0.0, 16.0, 0.0],
        ],
        floor: [-2.0, 5.5],
        lamp: [-away * across, up, away * towards],
    }
}

/// `zeltner-3-20`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    fig.note("seed", SEED);
    let waves = Waves::new(WAVELENGTH, SLOPE, SEED);
    let scene = mirrored(0.15, 3000.0, 16, |b| {
        let smooth = metal(b)?;
        mapped_quad(b, WALL, &waves, 128, smooth)
    })?;
    basins(fig, ["", ""], scene, &OURS)?;
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_10_TwostageSolutions/plane_notebook.xml";
    let of = authors.scene(fig, "authors' plane", file, 16, &[])?;
    let names = ["authors' plane: ", "authors-"];
    basins(fig, names, of.scene, &published())
}

/// Where walks on a wall end, and where their first stages do. `name` is said before each statement, `files` before names of files.
fn basins(fig: &mut Figure, [name, files]: [&str; 2], scene: Scene, place: &Place) -> Result {
    let lab = Laboratory::new(scene);
    let space = lab.space(Constraint::Angle);
    let start = lab
        .floor(place.floor[0], place.floor[1])
        .ok_or("no floor")?;
    let target = Target::Point(Vec3::from(place.lamp));
    let [corner, e1, e2] = place.wall.map(Vec3::from);
    let towards = |[u, v]: [f64; 2]| (corner + e1 * u + e2 * v - start.si.p).normalize();
    let second = |u: [f64; 2]| {
        let event = Event {
            shape: SHAPE,
            kind: DeltaKind::Reflection,
            normal: Normal::Own,
        };
        let chain = space.trace(&start, towards(u), &[event])?;
        let solution = space.walk(&start, chain, &target).solution?;
        in_front(&solution, &start, &target).then_some(solution)
    };

    // ---- Basins ----
    let size = fig.pick(96usize, 384);
    fig.note("basins", size);
    let centre = |i: usize| {
        let at = |k: usize| (k as f64 + 0.5) / size as f64;
        [at(i % size), 1.0 - at(i / size)]
    };
    let ends: Vec<Option<Solution>> = (0..size * size)
        .into_par_iter()
        .map(|i| second(centre(i)))
        .collect();
    let mut solutions: Vec<Solution> = Vec::new();
    let which = |solutions: &[Solution], end: &Solution| {
        (solutions.iter()).position(|s| s.is(end, Uniqueness::ErrorBounds))
    };
    for end in ends.iter().flatten() {
        if which(&solutions, end).is_none() {
            solutions.push(end.clone());
        }
    }
    let basin: Vec<Option<usize>> = (ends.iter())
        .map(|e| e.as_ref().and_then(|e| which(&solutions, e)))
        .collect();
    let uniform = basin.iter().flatten().count() as f64 / basin.len() as f64;
    let mut area = vec![0usize; solutions.len()];
    for k in basin.iter().flatten() {
        area[*k] += 1;
    }
    fig.check(
        format!(
            "{name}basins cover less than 30 % of the wall, each of many solutions a small part"
        ),
        uniform < 0.3 && solutions.len() >= 3,
        format!(
            "{:.1} % for {} solutions, the largest {:.1} %",
            100.0 * uniform,
            solutions.len(),
            100.0 * area.iter().max().copied().unwrap_or(0) as f64 / basin.len() as f64
        ),
    );
    // The box around the basins, but for a twentieth of them on each side: some points far away walk there, too.
    let sides: [[f64; 2]; 2] = std::array::from_fn(|k| {
        let found = basin.iter().enumerate().filter(|(_, b)| b.is_some());
        let mut all: Vec<f64> = found.map(|(i, _)| centre(i)[k]).collect();
        all.sort_unstable_by(f64::total_cmp);
        let at = |share: f64| {
            let last = all.len().saturating_sub(1) as f64;
            all.get((share * last) as usize).copied().unwrap_or(0.0)
        };
        [at(0.05), at(0.95)]
    });
    let inside = |u: [f64; 2]| (0..2).all(|k| (sides[k][0]..=sides[k][1]).contains(&u[k]));
    let boxed = (sides[0][1] - sides[0][0]) * (sides[1][1] - sides[1][0]);

    // ---- First stages ----
    let slopes = Slopes::of(&space, SHAPE).ok_or("a wall without a map")?;
    let n = fig.pick(2000u64, 20_000);
    fig.note("walks", n);
    let first: Vec<Option<[f64; 2]>> = (0..n)
        .into_par_iter()
        .map(|i| {
            let mut rng = Independent::new(SEED, 1, i);
            let event = Event {
                shape: SHAPE,
                kind: DeltaKind::Reflection,
                normal: slopes.draw(rng.next_2d()),
            };
            let chain = space.trace(&start, towards(rng.next_2d()), &[event])?;
            let solution = space.walk(&start, chain, &target).solution?;
            let uv = solution.chain[0].si.uv;
            Some([uv.x, uv.y])
        })
        .collect();
    let ended: Vec<[f64; 2]> = first.iter().flatten().copied().collect();
    let within = ended.iter().filter(|u| inside(**u)).count() as f64 / ended.len().max(1) as f64;
    fig.check(
        format!("{name}nearly all first stages converge, and more than 80 % of their ends are in the box around the basins"),
        ended.len() as f64 > 0.9 * n as f64 && within > 0.8,
        format!(
            "{} of {n} converge, {:.1} % into the box, which has {:.1} % of the wall",
            ended.len(),
            100.0 * within,
            100.0 * boxed
        ),
    );
    let staged = ended.par_iter().filter(|u| second(**u).is_some()).count() as f64 / n as f64;
    fig.check(
        format!("{name}a walk from there finds a solution twice as often as one from anywhere"),
        staged > 2.0 * uniform,
        format!("{:.1} % and {:.1} %", 100.0 * staged, 100.0 * uniform),
    );

    let colours: Vec<f64> = (basin.iter())
        .map(|e| e.map_or(0.0, |k| 2.0 + (k % 9) as f64))
        .collect();
    let factor = fig.pick(4, 2);
    let picture =
        |label: &str| Panel::false_colour(label, size, &colours, 0.0, 10.0).enlarged(factor);
    let mut dotted = picture("and ends of first stages");
    let scale = (size * factor) as f64;
    for u in ended.iter().take(fig.pick(300, 1500)) {
        dotted.dot([u[0] * scale, (1.0 - u[1]) * scale], 1.5, [220, 40, 40]);
    }
    fig.images(
        &format!("{files}basins"),
        2,
        &[picture("basins of solutions"), dotted],
    );
    let rows = solutions.iter().zip(&area).map(|(s, area)| {
        let uv = s.chain[0].si.uv;
        let part = *area as f64 / basin.len() as f64;
        [uv.x, uv.y, part, s.angle_per_target()]
    });
    fig.csv(
        &format!("{files}solutions"),
        &["u", "v", "basin", "angle_per_area"],
        rows,
    );
    Ok(())
}

/// Whether light is reflected in front of the wall.
fn in_front(solution: &Solution, start: &Start, target: &Target) -> bool {
    let vertex = &solution.chain[0];
    let Target::Point(lamp) = target else {
        return false;
    };
    [*lamp, start.si.p]
        .iter()
        .all(|p| (*p - vertex.si.p).dot(vertex.normal()) > 0.0)
}
