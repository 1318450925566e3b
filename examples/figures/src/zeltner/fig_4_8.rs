//! [Zeltner 2021, figures 4.7 and 4.8]: following rays, and harmonic convolution, in two dimensions and on the sphere.
//!
//! A camera at the origin of a plane sees a red circle, which moves, before a blue one, which does not, and a wall that is
//! infinitely far away. The velocity of what a ray meets jumps at the outline of the red circle; a reparameterisation needs
//! a velocity that is continuous, and that of the outline there.

use std::f64::consts::{FRAC_PI_2, PI};

use ad_core::Real;

use super::taxonomy::D;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// Concentration of the kernels.
const KAPPA: f64 = 1000.0;

/// Power of the harmonic weight that makes it follow outlines [errata Z-4.24].
const POWER: i32 = 3;

/// The camera sees directions up to this angle, radians.
const VIEW: f64 = 0.6;

/// A circle of the plane; angles of directions are taken from the second axis, towards the first one.
#[derive(Clone, Copy)]
struct Circle {
    centre: [f64; 2],
    radius: f64,
    /// Velocity along the first axis.
    speed: f64,
    /// Radiance: a constant, and the amplitude of what varies along the outline.
    radiance: [f64; 2],
}

/// The nearer circle first.
const CIRCLES: [Circle; 2] = [
    Circle {
        centre: [0.25, 3.0],
        radius: 0.8,
        speed: 1.0,
        radiance: [1.0, 0.4],
    },
    Circle {
        centre: [-0.75, 4.2],
        radius: 0.9,
        speed: 0.0,
        radiance: [0.6, 0.2],
    },
];

/// A point of a circle that a ray has met.
struct Met<R> {
    /// Angle of the point about the centre: what stays with the material.
    material: R,
    /// Cosine between ray and normal, positive.
    cos: R,
}

impl Circle {
    /// The centre when the parameter is `pi`.
    fn centre<R: Real<Primal = f64>>(&self, pi: R) -> [R; 2] {
        let [x, y] = self.centre;
        [pi * R::c(self.speed) + R::c(x), R::of(y)]
    }

    /// Where the ray of direction `theta` meets it.
    fn intersect<R: Real<Primal = f64>>(&self, pi: R, theta: R) -> Option<Met<R>> {
        let (sin, cos) = theta.sin_cos();
        let [x, y] = self.centre(pi);
        let along = x * sin + y * cos;
        let off = x * cos - y * sin;
        let half = R::of(self.radius * self.radius) - off.square();
        if half.primal() <= 0.0 || along.primal() <= 0.0 {
            return None;
        }
        let half = half.sqrt();
        let t = along - half;
        Some(Met {
            material: (sin * t - x).atan2(cos * t - y),
            cos: half / R::c(self.radius),
        })
    }

    /// The direction towards the point with this constant angle about the centre (figure 4.7).
    fn follow<R: Real<Primal = f64>>(&self, pi: R, material: f64) -> R {
        let [x, y] = self.centre(pi);
        let (sin, cos) = material.sin_cos();
        (x + R::c(self.radius * sin)).atan2(y + R::c(self.radius * cos))
    }

    /// The directions of its outline.
    fn outline(&self, pi: f64) -> [f64; 2] {
        let [x, y] = self.centre(pi);
        let (middle, half) = (x.atan2(y), (self.radius / x.hypot(y)).asin());
        [middle - half, middle + half]
    }
}

/// What is seen in direction `theta`.
fn nearest<R: Real<Primal = f64>>(pi: R, theta: R) -> Option<(&'static Circle, Met<R>)> {
    CIRCLES
        .iter()
        .find_map(|c| Some((c, c.intersect(pi, theta)?)))
}

/// Radiance from direction `theta`.
fn radiance<R: Real<Primal = f64>>(pi: R, theta: R) -> R {
    match nearest(pi, theta) {
        Some((circle, met)) => {
            let [constant, varying] = circle.radiance;
            (met.material * R::c(5.0)).sin() * R::c(varying) + R::c(constant)
        }
        None => R::of(0.2) + theta * R::c(0.1),
    }
}

/// Velocity of the direction towards the material that is met.
fn followed(theta: f64) -> f64 {
    match nearest(0.0, theta) {
        Some((circle, met)) => circle.follow(D::var(0.0, 0), met.material).eps[0],
        None => 0.0,
    }
}

/// The boundary test: the cosine at what is met, one where nothing is.
fn boundary(theta: f64) -> f64 {
    nearest(0.0, theta).map_or(1.0, |(_, met)| met.cos)
}

/// Directions between which nothing jumps.
fn pieces(pi: f64) -> Vec<[f64; 2]> {
    let [red, blue] = CIRCLES.map(|c| c.outline(pi));
    let mut ends = [-VIEW, blue[0], red[0], red[1], VIEW];
    ends.sort_by(f64::total_cmp);
    ends.windows(2).map(|w| [w[0], w[1]]).collect()
}

/// Integral over an interval at whose ends the integrand may be singular: trapezia after the substitution
/// `x = tanh(pi / 2 sinh t)` [Takahasi and Mori 1974]. The integrand is given the distances to both ends too, which keep
/// their digits next to them.
fn between<R: Real<Primal = f64>>([a, b]: [f64; 2], n: usize, f: impl Fn(f64) -> R) -> R {
    let reach = 3.4;
    let step = 2.0 * reach / n as f64;
    let mut sum = R::zero();
    for i in 0..=n {
        let t = step * i as f64 - reach;
        let (inner, slope) = (FRAC_PI_2 * t.sinh(), FRAC_PI_2 * t.cosh());
        let x = (a + b) / 2.0 + (b - a) / 2.0 * inner.tanh();
        let weight = slope / inner.cosh().powi(2) * step * (b - a) / 2.0;
        if x > a && x < b && weight > 0.0 {
            sum += f(x) * R::c(weight);
        }
    }
    sum
}

/// How the velocities of neighbours are weighed.
#[derive(Clone, Copy)]
enum Kernel {
    /// Without a look at outlines.
    Gaussian,
    /// [Zeltner 2021, Eq. 4.24], to a power.
    Harmonic(i32),
}

impl Kernel {
    /// The weight of a direction with the boundary test `b`, at an angle whose cosine is one less `away`.
    fn weight<R: Real<Primal = f64>>(self, b: f64, away: R) -> R {
        match self {
            Self::Gaussian => (-(away * R::c(KAPPA))).exp(),
            // Beyond, the weight is below 1e-17 at any power.
            Self::Harmonic(_) if away.primal() * KAPPA > 40.0 => R::zero(),
            Self::Harmonic(power) => ((away * R::c(KAPPA)).exp_m1() + R::c(b))
                .powi(power)
                .recip(),
        }
    }
}

/// The velocity at `theta` after convolution [Zeltner 2021, Eq. 4.23].
fn convolved<R: Real<Primal = f64>>(theta: R, kernel: Kernel, n: usize) -> R {
    let at = theta.primal();
    let [mut sum, mut weights] = [R::zero(); 2];
    for [a, b] in pieces(0.0) {
        // The kernel has its peak at `theta`.
        let split = [[a, b.min(at.max(a))], [a.max(at.min(b)), b]];
        for piece in split.into_iter().filter(|[a, b]| a < b) {
            let weight = |x| {
                // 1 - cos, without its cancellation.
                let half = ((theta - R::c(x)) * R::c(0.5)).sin();
                kernel.weight(boundary(x), half.square() * R::c(2.0))
            };
            weights += between(piece, n, weight);
            sum += between(piece, n, |x| weight(x) * R::c(followed(x)));
        }
    }
    sum / weights
}

/// The image: the integral of radiance over the view.
fn image(pi: f64) -> f64 {
    let of = |piece| between(piece, 400, |theta| radiance(pi, theta));
    pieces(pi).into_iter().map(of).sum()
}

/// Its derivative by reparameterised integration: `d f / d pi + d (f V) / d theta`, without its boundaries.
fn reparameterised(n: usize, velocity: impl Fn(D) -> D) -> f64 {
    let integrand = |theta: f64| {
        let moving = radiance(D::var(0.0, 0), D::lift(theta)).eps[0];
        let direction = D::var(theta, 0);
        moving + (radiance(D::lift(0.0), direction) * velocity(direction)).eps[0]
    };
    (pieces(0.0).into_iter())
        .map(|piece| between(piece, n, integrand))
        .sum()
}

/// `zeltner-4-8`.
pub fn figure(fig: &mut Figure) -> Result {
    let n = fig.pick(120, 240);
    fig.note("nodes per integral", n);
    fig.note("kappa", KAPPA);
    fig.note("power", POWER);
    let harmonic = Kernel::Harmonic(POWER);
    let [left, right] = CIRCLES[0].outline(0.0);
    let velocity = |edge: usize| {
        let h = 1e-5;
        (CIRCLES[0].outline(h)[edge] - CIRCLES[0].outline(-h)[edge]) / (2.0 * h)
    };
    let [at_left, at_right] = [velocity(0), velocity(1)];

    follow_check(fig);
    let [inside, outside] = [followed(right - 1e-9), followed(right + 1e-9)];
    fig.check(
        "followed rays jump at the outline: its velocity inside, none outside",
        (inside / at_right - 1.0).abs() < 1e-3 && outside == 0.0,
        format!("{inside:.5} and {outside}, the outline {at_right:.5}"),
    );
    let [b_in, b_out] = [boundary(right - 1e-9), boundary(right + 1e-9)];
    fig.check(
        "the boundary test vanishes at outlines, from the side of what has them",
        b_in < 1e-3 && b_out == 1.0,
        format!("{b_in:.1e} and {b_out}"),
    );
    let blurred = convolved(right, Kernel::Gaussian, n) / at_right;
    fig.check(
        "a Gaussian kernel gives about half of the outline's velocity on it",
        (0.4..0.6).contains(&blurred),
        format!("{blurred:.3}"),
    );
    for (name, edge, velocity, outwards) in [
        ("left", left, at_left, -1.0),
        ("right", right, at_right, 1.0),
    ] {
        let near = [3e-2, 1e-2, 1e-3, 1e-4]
            .map(|distance| convolved(edge + outwards * distance, harmonic, n) / velocity);
        let off = near.map(|ratio| (ratio - 1.0).abs());
        fig.check(
            format!("{name}: the harmonic kernel tends to the outline's velocity"),
            off[1] < 0.05 && off[3] < 1e-3 && off.windows(2).all(|w| w[1] < w[0]),
            format!("{near:.5?} of it at 3e-2, 1e-2, 1e-3 and 1e-4"),
        );
    }
    let still = CIRCLES[1].outline(0.0)[0];
    let at_still = convolved(still, harmonic, n);
    fig.check(
        "at the outline of the blue circle nothing moves",
        at_still.abs() < 1e-6,
        format!("{at_still:.1e}"),
    );

    let h = 1e-5;
    let truth = (image(h) - image(-h)) / (2.0 * h);
    let nodes = 2 * n;
    let none = reparameterised(nodes, |_| D::zero());
    let gaussian = reparameterised(nodes, |theta| convolved(theta, Kernel::Gaussian, n));
    let ours = reparameterised(nodes, |theta| convolved(theta, harmonic, n));
    fig.check(
        "the derivative of the image, the blue outline being none of its discontinuities",
        (ours / truth - 1.0).abs() < 2e-3,
        format!("{ours:.5}, differences {truth:.5}"),
    );
    fig.check(
        "what takes constant directions, or a Gaussian kernel, misses it",
        [none, gaussian]
            .iter()
            .all(|d| (d / truth - 1.0).abs() > 0.1),
        format!("{none:.5} and {gaussian:.5}"),
    );
    on_the_sphere(fig);

    let rows: Vec<_> = (0..=600)
        .map(|i| -VIEW + 2.0 * VIEW * f64::from(i) / 600.0)
        .map(|theta| {
            let by = |kernel| convolved(theta, kernel, n);
            let (gaussian, harmonic) = (by(Kernel::Gaussian), by(harmonic));
            [theta, boundary(theta), followed(theta), gaussian, harmonic]
        })
        .collect();
    let column = |k: usize| rows.iter().map(|r| (r[0], r[k])).collect::<Vec<_>>();
    let title = "Velocities of directions as a circle moves";
    let chart = LineChart::new(title, "angle, radians", "radians per unit of the parameter")
        .dashed("followed", column(2))
        .line("Gaussian", column(3))
        .line("harmonic", column(4));
    fig.chart("velocities", &chart);
    let chart = LineChart::new("The boundary test", "angle, radians", "cosine")
        .line("boundary test", column(1));
    fig.chart("boundary", &chart);
    let names = ["angle", "boundary", "followed", "gaussian", "harmonic"];
    fig.csv("velocities", &names, rows);
    Ok(())
}

/// A followed ray has the velocity of its material; an intersection along a constant ray has none across it.
fn follow_check(fig: &mut Figure) {
    let worst = (0..50)
        .filter_map(|i| {
            let theta = -0.18 + 0.0104 * f64::from(i);
            let (circle, met) = nearest(0.0, theta)?;
            let towards = |pi: f64| circle.follow(pi, met.material);
            let h = 1e-6;
            let difference = (towards(h) - towards(-h)) / (2.0 * h);
            Some(
                (followed(theta) - difference)
                    .abs()
                    .max((towards(0.0) - theta).abs()),
            )
        })
        .fold(0.0, f64::max);
    fig.check(
        "rays that follow start in their own direction and move with what they have met (figure 4.7)",
        worst < 1e-8,
        format!("largest error {worst:.1e}"),
    );
}

/// The same on the sphere of directions: a ball of angular radius `RADIUS` turns about the viewer, so that its directions
/// move along a great circle. The ratio of the convolved velocity to the outline's, on the side that it moves to.
fn on_the_sphere(fig: &mut Figure) {
    const RADIUS: f64 = 0.3;
    // Rotation about the third axis of a ball in the direction of the first one: every direction of the ball moves by the
    // cross product of axis and direction.
    let ratio = |distance: f64, kernel: Kernel, linear: bool| {
        let angle = RADIUS + distance;
        let seen = [angle.cos(), angle.sin(), 0.0];
        let cosine = |polar: f64| {
            // Ball at distance one: cosine at the point that the direction meets.
            (1.0 - (polar.sin() / RADIUS.sin()).powi(2)).max(0.0).sqrt()
        };
        let moments = |polar: f64| {
            let test = match (polar < RADIUS, linear) {
                (true, true) => RADIUS - polar,
                (true, false) => cosine(polar),
                (false, _) => 1.0,
            };
            let moving = |azimuth: f64| {
                let (sin, cos) = polar.sin_cos();
                let at = [cos, sin * azimuth.cos(), sin * azimuth.sin()];
                let away: f64 = (at.iter().zip(seen))
                    .map(|(a, b)| (a - b).powi(2))
                    .sum::<f64>()
                    / 2.0;
                kernel.weight(test, away) * sin
            };
            // Symmetric about the plane of motion.
            let weight = between([0.0, PI], 200, moving);
            // The component along the outline's own velocity at `seen`: (-sin, cos, 0) of the axis.
            let towards = |azimuth: f64| {
                let (sin, cos) = polar.sin_cos();
                let velocity = [-sin * azimuth.cos(), cos];
                let along = -velocity[0] * seen[1] + velocity[1] * seen[0];
                moving(azimuth) * along
            };
            let velocity = if polar < RADIUS {
                between([0.0, PI], 200, towards)
            } else {
                0.0
            };
            [velocity, weight]
        };
        let ends = [0.0, RADIUS, angle, angle + 0.5];
        let mut sums = [0.0; 2];
        for piece in ends.windows(2) {
            for (k, sum) in sums.iter_mut().enumerate() {
                *sum += between([piece[0], piece[1]], 200, |polar| moments(polar)[k]);
            }
        }
        sums[0] / sums[1]
    };
    let distances = [1e-2, 1e-3, 1e-4];
    for (name, linear) in [("cosine", false), ("distance", true)] {
        let first = distances.map(|d| ratio(d, Kernel::Harmonic(1), linear));
        let third = distances.map(|d| ratio(d, Kernel::Harmonic(POWER), linear));
        fig.check(
            format!(
                "on the sphere, boundary test by {name}: power 3 tends to the outline's velocity"
            ),
            (third[2] - 1.0).abs() < 1e-2 && third[2] > third[0],
            format!("{third:.4?} at 1e-2, 1e-3 and 1e-4"),
        );
        fig.check(
            format!("on the sphere, boundary test by {name}: the printed power 1 does not"),
            first[2] < 0.95,
            format!("{first:.4?}"),
        );
    }
}
