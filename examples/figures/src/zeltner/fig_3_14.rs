//! [Zeltner 2021, figure 3.14]: how many reflections in a ring light a point of the floor, and from where walks find which.

use ad_core::Vec3;
use rayon::prelude::*;
use render::bsdf::DeltaKind;
use render::manifold::{Connector, Solution, Target, distinct, trials};
use render::sampler::{Independent, Sampler};
use render::scene::{Constraint, Method, Starts, Uniqueness};
use render::shape::Shape;
use render::statistics::{Estimate, z_limit};

use super::authors::{Authors, compare};
use super::manifold_methods::{Effort, Measured, measure, single};
use super::specular_scenes::{Laboratory, RING, View, load};
use examples::chart::{LineChart, Panel};
use examples::figure::{Figure, Result};
use examples::ranks::median;

/// The point of the floor that the figure shows, x and z, and that of the light.
const FLOOR: [f64; 2] = [4.218, -3.074];
const LIGHT: [f64; 3] = [-11.982, 10.0, 8.05];
/// The three reflections (errata section 9).
const LISTED: [[f64; 3]; 3] = [
    [9.476, 2.711, 3.194],
    [0.731, 2.595, -9.973],
    [7.808, 1.641, -6.248],
];
/// The ring among the shapes.
const SHAPE: u32 = 1;
const SEED: u64 = 14;

fn same(a: &Solution, b: &Solution) -> bool {
    a.is(b, Uniqueness::ErrorBounds)
}

/// `zeltner-3-14`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let view = View {
        lookat: [[0.0, 40.0, 40.0], [0.0; 3]],
        fov: 28.0,
        size: 16,
    };
    let ring = Laboratory::new(load(RING, &view, 4)?);
    fig.note("seed", SEED);
    shown(fig, ["", "basins", "counts", "light"], &ring)?;
    seen(fig)?;
    published(fig)
}

/// The ring of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_4_5_RingSolutions/ring.xml";
    let of = authors.scene(fig, "authors' ring", file, fig.pick(24, 96), &[])?;
    let ways = [("unbiased", single(Method::Sms, Starts::Particles))];
    let effort = Effort::of(fig, [8, 32], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.1), (1 << 18, 0.02));
    let found = compare(fig, &of, &ways, effort, accuracy)?;
    if fig.pick(false, true) {
        let gain = found.gain(0);
        fig.check(
            "authors' ring: in the same time unbiased estimates have hundreds of times less variance than paths",
            gain > 300.0,
            format!("{gain:.0} times"),
        );
    }
    let ring = Laboratory::new(of.scene);
    let names = ["basins", "counts", "light"].map(|name| format!("authors-{name}"));
    let [basins, of_counts, of_light] = &names;
    let names = ["authors' ring: ", basins, of_counts, of_light];
    shown(fig, names, &ring)
}

/// The shown point, and the whole floor of a ring. `scene` is said before each statement; pictures have the other names.
fn shown(
    fig: &mut Figure,
    [scene, basins, of_counts, of_light]: [&str; 4],
    ring: &Laboratory,
) -> Result {
    let connections = single(Method::Sms, Starts::Particles);
    let split = ring.split(&connections)?;
    let connector = Connector::new(ring.space(Constraint::Angle), &split, connections);
    let target = Target::Point(Vec3::from(LIGHT));

    // ---- The shown point ----
    let start = ring.floor(FLOOR[0], FLOOR[1]).ok_or("no floor")?;
    let mut rng = Independent::new(SEED, 0, 0);
    let walk = || connector.explore(&start, &target, 1, &mut rng);
    let mut found = distinct(2000, walk, same);
    let nearest = |at: [f64; 3]| {
        let distances = found.iter().enumerate().map(|(i, s)| {
            let d = (s.chain[0].si.p - Vec3::from(at)).length();
            (d, i)
        });
        distances
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, 0))
    };
    let distances = LISTED.map(|at| nearest(at).0);
    fig.check(
        format!("{scene}2000 walks end in exactly three reflections, those listed"),
        found.len() == 3 && distances.iter().all(|d| *d < 3e-3),
        format!(
            "{} solutions, {distances:.4?} from the listed points",
            found.len()
        ),
    );
    let order = LISTED.map(|at| nearest(at).1);
    if found.len() == 3 {
        found = order.map(|i| found[i].clone()).to_vec();
    }

    // ---- Basins ----
    let size = fig.pick(96, 384);
    fig.note("basins", size);
    let shape = &ring.scene.shapes()[SHAPE as usize];
    let space = ring.space(Constraint::Angle);
    let like = [(SHAPE, DeltaKind::Reflection)];
    let end = |u: [f64; 2]| {
        let d = shape.sample(start.si.p, u)?.d;
        let chain = space.trace_own(&start, d, &like)?;
        let solution = space.walk(&start, chain, &target).solution?;
        found.iter().position(|s| same(s, &solution))
    };
    let ends: Vec<Option<usize>> = (0..size * size)
        .into_par_iter()
        .map(|i| {
            let at = |k: usize| (k as f64 + 0.5) / size as f64;
            end([at(i % size), 1.0 - at(i / size)])
        })
        .collect();
    let areas: [f64; 3] = std::array::from_fn(|k| {
        ends.iter().filter(|e| **e == Some(k)).count() as f64 / ends.len() as f64
    });
    fig.check(
        format!("{scene}each of the three solutions has a basin, and they do not cover all"),
        areas.iter().all(|a| *a > 0.01) && areas.iter().sum::<f64>() < 1.0,
        format!("{areas:.3?} of the square"),
    );
    let colours: Vec<f64> = ends
        .iter()
        .map(|e| e.map_or(0.0, |k| 1.0 + k as f64))
        .collect();
    fig.image(
        basins,
        &Panel::false_colour("basins of the three solutions", size, &colours, 0.0, 3.0)
            .enlarged(fig.pick(4, 2)),
    );

    // ---- The estimate at the shown point ----
    let worth: f64 = found.iter().map(Solution::angle_per_target).sum();
    let n = fig.pick(4_000, 40_000);
    fig.note("estimates", n);
    let each: Vec<(f64, u32)> = (0..n)
        .into_par_iter()
        .map(|i| {
            let mut rng = Independent::new(SEED, 1, i);
            let mut walk = || connector.explore(&start, &target, 1, &mut rng);
            let Some(first) = walk() else {
                return (0.0, 0);
            };
            let (n, _) = trials(|| walk().is_some_and(|s| same(&first, &s)), 1 << 20);
            (first.angle_per_target() * f64::from(n), n)
        })
        .collect();
    let sum = Estimate::of(&each.iter().map(|e| e.0).collect::<Vec<_>>());
    let z = sum.z(&Estimate::exact(worth));
    // The sum, and the number of trials.
    let limit = z_limit(2, n, 1e-3);
    fig.check(
        format!("{scene}the sum over the solutions is the mean of unbiased estimates"),
        z.abs() < limit && sum.se < 0.05 * worth,
        format!(
            "{:.4e} ± {:.1e} of {worth:.4e}, deviate {z:.2}, limit {limit:.2}",
            sum.mean, sum.se
        ),
    );
    let made: Vec<f64> = each
        .iter()
        .filter(|e| e.1 > 0)
        .map(|e| f64::from(e.1))
        .collect();
    let mean = Estimate::of(&made);
    // One over the basin of the one that was found first, on average over those found: three over all of them.
    let expected = 3.0 / areas.iter().sum::<f64>();
    fig.check(
        format!("{scene}trials are the reciprocals of basins, on average"),
        (mean.mean / expected - 1.0).abs() < 0.1 + limit * mean.se / expected,
        format!(
            "{:.2} ± {:.2}, {expected:.2} by the picture",
            mean.mean, mean.se
        ),
    );
    counts(fig, [scene, of_counts, of_light], ring, &connector, &target);
    Ok(())
}

/// Half a side of the square of the floor that is looked at.
const HALF: f64 = 9.8;

/// A reflection that lights a point of the floor.
struct Reflection {
    p: Vec3<f64>,
    /// What it adds to the light there, for a lamp of unit size and radiance that faces it.
    light: f64,
}

/// The floor of a ring under a point of its lamp.
struct Floor<'a> {
    ring: &'a Laboratory,
    connector: &'a Connector<'a>,
    target: &'a Target,
    /// Walks for each point.
    walks: u32,
}

impl Floor<'_> {
    /// What lights a point on the inner wall, by random numbers of stream and index; `None` for points that are not within the ring.
    fn reflections(&self, [x, z]: [f64; 2], stream: u64, index: u64) -> Option<Vec<Reflection>> {
        if x.hypot(z) > HALF {
            return None;
        }
        let start = self.ring.floor(x, z)?;
        let mut rng = Independent::new(SEED, stream, index);
        let walk = || self.connector.explore(&start, self.target, 1, &mut rng);
        let found = distinct(self.walks, walk, same);
        let reflection = |s: &Solution| Reflection {
            p: s.chain[0].si.p,
            light: s.angle_per_target() * s.direction().y,
        };
        Some(found.iter().map(reflection).collect())
    }
}

/// What two reflections that are nearest to each other add, and how far apart they are.
fn nearest_pair(points: &[Reflection]) -> Option<(f64, f64)> {
    let pairs = (0..points.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
    let pairs = pairs.map(|(i, j)| {
        let [a, b] = [i, j].map(|k: usize| &points[k]);
        (a.light + b.light, (a.p - b.p).length())
    });
    pairs.min_by(|a, b| a.1.total_cmp(&b.1))
}

/// What lights the points of a grid over the floor.
struct Grid {
    /// Points of a row.
    size: usize,
    points: Vec<Option<Vec<Reflection>>>,
}

impl Grid {
    /// Where point `i` is.
    fn at(size: usize, i: usize) -> [f64; 2] {
        [i % size, i / size].map(|k| HALF * (2.0 * (k as f64 + 0.5) / size as f64 - 1.0))
    }

    fn step(&self) -> f64 {
        2.0 * HALF / self.size as f64
    }

    /// Pairs of points next to each other that are both within the ring, those with fewer reflections first, and by how many.
    fn neighbours(&self) -> impl Iterator<Item = ([usize; 2], usize)> + '_ {
        let count = |i: usize| Some(self.points.get(i)?.as_ref()?.len());
        let pairs = (0..self.points.len()).flat_map(move |i| {
            let last = (i + 1).is_multiple_of(self.size);
            let right = (!last).then_some([i, i + 1]);
            right.into_iter().chain([[i, i + self.size]])
        });
        pairs.filter_map(move |[i, k]| {
            let (a, b) = (count(i)?, count(k)?);
            let pair = if a > b { [k, i] } else { [i, k] };
            Some((pair, a.abs_diff(b)))
        })
    }

    fn of(&self, i: usize) -> &[Reflection] {
        self.points[i].as_deref().unwrap_or_default()
    }

    /// The light of all reflections, and zero outside.
    fn light(&self) -> Vec<f64> {
        let sum = |i: usize| self.of(i).iter().map(|r| r.light).sum();
        (0..self.points.len()).map(sum).collect()
    }
}

/// The number of solutions over the floor, and its light.
fn counts(
    fig: &mut Figure,
    [scene, name, of_light]: [&str; 3],
    ring: &Laboratory,
    connector: &Connector,
    target: &Target,
) {
    let (size, walks) = (fig.pick(40, 160), fig.pick(300, 600));
    fig.note("counts", size);
    fig.note("walks per point", walks);
    let floor = Floor {
        ring,
        connector,
        target,
        walks,
    };
    let solve = |i: usize| floor.reflections(Grid::at(size, i), 2, i as u64);
    let points = (0..size * size).into_par_iter().map(solve).collect();
    let grid = Grid { size, points };
    let counted = || grid.points.iter().flatten().map(Vec::len);
    let with = |n: usize| counted().filter(|c| *c == n).count();
    let histogram: [usize; 5] = std::array::from_fn(with);
    let inside = counted().count();
    fig.check(
        format!("{scene}points within the ring have no solution, one, or three, but for those near the edges of the light"),
        histogram[0] + histogram[1] + histogram[3] > inside * 8 / 10 && histogram[1] > 0 && histogram[3] > 0,
        format!("{histogram:?} points with 0 to 4 solutions, of {inside}"),
    );
    vanishing(fig, scene, &grid);
    jumps(fig, scene, &floor, &grid);
    let colours: Vec<f64> = (grid.points.iter())
        .map(|p| p.as_ref().map_or(f64::NAN, |p| p.len() as f64))
        .collect();
    let factor = fig.pick(4, 2);
    fig.image(
        name,
        &Panel::false_colour("number of solutions", size, &colours, 0.0, 4.0).enlarged(factor),
    );
    let light = grid.light();
    let lit: Vec<f64> = light.iter().copied().filter(|l| *l > 0.0).collect();
    let high = 3.0 * median(&lit).unwrap_or(1.0);
    fig.image(
        of_light,
        &Panel::false_colour("light of all solutions", size, &light, 0.0, high).enlarged(factor),
    );
    across(fig, of_light, &floor);
}

/// How solutions vanish from one point of the floor to the next: two together, or one over an edge of the ring.
fn vanishing(fig: &mut Figure, scene: &str, grid: &Grid) {
    const HEIGHT: f64 = 4.0;
    let at_edge = |r: &Reflection| r.p.y.min(HEIGHT - r.p.y) < 1.5 * grid.step();
    let nearest = |points: &[Reflection]| nearest_pair(points).map(|(_, apart)| apart);
    let mut jumps = [0usize; 5];
    let (mut over_edges, mut closest) = (0, Vec::new());
    for ([_, more], by) in grid.neighbours() {
        let more = grid.of(more);
        match by {
            1 if more.iter().any(at_edge) => over_edges += 1,
            2 => closest.extend(nearest(more)),
            _ => {}
        }
        jumps[by.min(4)] += 1;
    }
    let all = grid.points.iter().flatten();
    let everywhere: Vec<f64> = all.filter_map(|points| nearest(points)).collect();
    let [pairs, all] = [&closest, &everywhere].map(|x| median(x).unwrap_or(f64::NAN));
    fig.check(
        format!("{scene}where two solutions vanish from one point of the floor to the next, two are next to each other"),
        jumps[2] > 10 && pairs < 0.5 * all,
        format!("{} times, {pairs:.2} apart, {all:.2} over all points; medians", jumps[2]),
    );
    fig.check(
        format!("{scene}where a single one vanishes, one is at an edge of the ring"),
        over_edges as f64 >= 0.9 * jumps[1] as f64,
        format!(
            "{over_edges} of {} times; counts differ by 0 to 4 in {jumps:?}",
            jumps[1]
        ),
    );
}

/// How the light jumps where two solutions appear: at a distance `d` behind the caustic curve they bring `2 c / sqrt(d)`, and before it
/// nothing.
fn jumps(fig: &mut Figure, scene: &str, floor: &Floor, grid: &Grid) {
    /// Halvings of the distance between two points of the grid.
    const HALVINGS: u64 = 16;
    /// Two distances behind the curve, in that distance: the law is that of small ones.
    const BEHIND: [f64; 2] = [4e-3, 1e-3];
    let appear: Vec<[usize; 2]> = (grid.neighbours())
        .filter(|(_, by)| *by == 2)
        .map(|(pair, _)| pair)
        .collect();
    let every = (appear.len() / fig.pick(24, 96)).max(1);
    // At each place: the exponent, and the light before over that behind.
    let at = |(place, &[less, more]): (usize, &[usize; 2])| {
        let [a, b] = [less, more].map(|i| Grid::at(grid.size, i));
        let between = |t: f64| [0, 1].map(|k| a[k] + t * (b[k] - a[k]));
        let look = |t: f64, n: u64| floor.reflections(between(t), 3, 64 * place as u64 + n);
        let fewer = grid.of(less).len();
        let (mut before, mut behind) = (0.0, 1.0);
        for n in 0..HALVINGS {
            let middle = 0.5 * (before + behind);
            if look(middle, n)?.len() > fewer {
                behind = middle;
            } else {
                before = middle;
            }
        }
        let curve = 0.5 * (before + behind);
        let [far, near] = [0, 1].map(|k| {
            let lit = look(curve + BEHIND[k], HALVINGS + k as u64)?;
            (lit.len() == fewer + 2).then_some(lit)
        });
        let (far, near) = (far?, near?);
        let dark = look(curve - BEHIND[1], HALVINGS + 2)?;
        let sum = |lit: &[Reflection]| lit.iter().map(|r| r.light).sum::<f64>();
        let pair = |lit: &[Reflection]| nearest_pair(lit).map(|(light, _)| light);
        let exponent = (pair(&near)? / pair(&far)?).ln() / (BEHIND[1] / BEHIND[0]).ln();
        Some([exponent, sum(&dark) / sum(&near)])
    };
    let places: Vec<_> = appear.iter().step_by(every).enumerate().collect();
    let found: Vec<[f64; 2]> = places.into_par_iter().filter_map(at).collect();
    let of = |k: usize| found.iter().map(|f| f[k]).collect::<Vec<f64>>();
    let [exponent, part] = [0, 1].map(|k| median(&of(k)).unwrap_or(f64::NAN));
    // The next term of the sum of both is smaller by the distance itself.
    fig.check(
        format!("{scene}where two solutions appear, their light falls as one over the square root of the distance from there"),
        found.len() > 10 && (exponent + 0.5).abs() < 0.05,
        format!("exponent {exponent:.3}, median of {} places", found.len()),
    );
    let near = BEHIND[1] * grid.step();
    fig.check(
        format!("{scene}and the light jumps there"),
        part < 0.5,
        format!(
            "{:.0} % of what there is {near:.1e} behind is not there {near:.1e} before, median",
            100.0 * (1.0 - part)
        ),
    );
}

/// Solutions and light on a line across the floor through the shown point.
fn across(fig: &mut Figure, name: &str, floor: &Floor) {
    let n = fig.pick(400, 2000);
    let at = |i: usize| HALF * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
    let lit = |i: usize| floor.reflections([at(i), FLOOR[1]], 4, i as u64);
    let lit: Vec<_> = (0..n).into_par_iter().map(lit).collect();
    let rows = (lit.iter().enumerate()).filter_map(|(i, lit)| {
        let lit = lit.as_ref()?;
        let light: f64 = lit.iter().map(|r| r.light).sum();
        Some([at(i), lit.len() as f64, light])
    });
    let rows: Vec<[f64; 3]> = rows.collect();
    let typical = median(&rows.iter().map(|r| r[2]).collect::<Vec<_>>()).unwrap_or(1.0);
    let title = format!("the floor at z = {}", FLOOR[1]);
    let chart = LineChart::new(&title, "x", "solutions, and light over its median")
        .log_y()
        .y_range(0.1, 50.0)
        .line("solutions", rows.iter().map(|r| (r[0], r[1])))
        .line("light", rows.iter().map(|r| (r[0], r[2] / typical)));
    fig.chart(&format!("{name}-across"), &chart);
    fig.csv(
        &format!("{name}-across"),
        &["x", "solutions", "light"],
        rows,
    );
}

/// An image of the ring from above, beside the number of solutions at what the middle of each pixel sees.
fn seen(fig: &mut Figure) -> Result {
    // So far above that rays are nearly parallel, and not quite in the middle, where no direction would be up.
    const HIGH: f64 = 1000.0;
    let size = fig.pick(40, 120);
    let view = View {
        lookat: [[0.0, HIGH, 1.0], [0.0; 3]],
        fov: 2.0 * (HALF / HIGH).atan().to_degrees(),
        size,
    };
    let ring = Laboratory::new(load(RING, &view, 4)?);
    let connections = single(Method::Sms, Starts::Particles);
    let effort = Effort::of(fig, [4, 16], SEED);
    effort.note(fig, size);
    let image = measure(&ring.scene, connections, false, effort)?;
    let split = ring.split(&connections)?;
    let connector = Connector::new(ring.space(Constraint::Angle), &split, connections);
    let floor = Floor {
        ring: &ring,
        connector: &connector,
        target: &Target::Point(Vec3::from(LIGHT)),
        walks: 300,
    };
    let size = size as usize;
    let solve = |i: usize| floor.reflections(Grid::at(size, i), 5, i as u64);
    let points = (0..size * size).into_par_iter().map(solve).collect();
    let grid = Grid { size, points };
    // Steps over the curve, and from there to the next pixel behind it.
    let mut steps = [Vec::new(), Vec::new()];
    for ([less, more], by) in grid.neighbours() {
        let next = (2 * more).checked_sub(less);
        let behind = next.filter(|&next| {
            let column = |i: usize| i % size;
            let in_line = column(next).abs_diff(column(more)) <= 1;
            in_line && next < size * size && grid.of(next).len() == grid.of(more).len()
        });
        if let (2, Some(next)) = (by, behind) {
            steps[0].push([less, more]);
            steps[1].push([more, next]);
        }
    }
    let [onto, behind] = steps.map(|pairs| {
        let mut weights = vec![0.0; size * size];
        for [from, to] in &pairs {
            weights[*from] -= 1.0 / pairs.len() as f64;
            weights[*to] += 1.0 / pairs.len() as f64;
        }
        let each = weights.iter().zip(&image.series.pixels);
        let (mean, square) = each.fold((0.0, 0.0), |(mean, square), (w, e)| {
            (mean + w * e.mean, square + (w * e.se).powi(2))
        });
        let se = square.sqrt();
        (pairs.len(), Estimate { mean, se })
    });
    let limit = z_limit(2, Measured::repeats(&[&image]), 1e-3);
    let z = [onto.1, behind.1].map(|e| e.z(&Estimate::exact(0.0)));
    fig.check(
        "the image becomes brighter from one pixel to the next where two solutions appear, and darker behind",
        onto.0 > 50 && z[0] > limit && z[1] < -limit,
        format!(
            "by {:.3} ± {:.3} and {:.3} ± {:.3} at {} places, of {:.3} on average; deviates {z:.1?}, limit {limit:.2}",
            onto.1.mean, onto.1.se, behind.1.mean, behind.1.se, onto.0, image.mean()
        ),
    );
    let counts = grid.points.iter();
    let counts = counts.map(|p| p.as_ref().map_or(f64::NAN, |p| p.len() as f64));
    let counts: Vec<f64> = counts.collect();
    let light = grid.light();
    // Without what the outside of the ring throws.
    let pixels = grid.points.iter().zip(image.series.means());
    let within = pixels.map(|(p, x)| p.as_ref().map_or(0.0, |_| x));
    let within: Vec<f64> = within.collect();
    let factor = fig.pick(6, 3);
    let bright = |label: &str, values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        Panel::false_colour(label, size, values, 0.0, 4.0 * mean).enlarged(factor)
    };
    let panels = [
        Panel::false_colour("number of solutions", size, &counts, 0.0, 4.0).enlarged(factor),
        bright("light of all solutions", &light),
        bright("image", &within),
    ];
    fig.images("image", 3, &panels);
    Ok(())
}
