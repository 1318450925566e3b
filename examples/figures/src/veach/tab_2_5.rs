//! The scattering kernel and its adjoint, and the four ways to transport [Veach 1996, table in section 2.5 and
//! EVAL-KERNEL].

use std::f64::consts::{PI, TAU};

use ad_core::{Vec2, Vec3};
use render::Job;
use render::bsdf::kernel::{Rules, eval_kernel};
use render::bsdf::{BlinnPhong, BlinnPhongSampling, Component, Material, Shading, TransportMode};
use render::instances::backward_particles_f32;
use render::integrator::gradient::Active;
use render::params::Theta;
use render::scene::Builder;
use render::statistics::{Estimate, z_limit};

use super::{IGNORED, particles, paths};
use crate::common_scenes::{Walls, cornell};
use examples::figure::{Figure, Result};

type V = Vec3<f64>;

const CONTINUOUS: Component = Component::Continuous;

fn unit(theta: f64, phi: f64) -> V {
    let ((st, ct), (sp, cp)) = (theta.sin_cos(), phi.sin_cos());
    Vec3::new(st * cp, st * sp, ct)
}

/// Directions of a product rule over the sphere and their solid angles: midpoints in the cosine and the azimuth.
fn sphere(n: usize) -> Vec<(V, f64)> {
    let weight = 2.0 * TAU / (2 * n * n) as f64;
    let azimuth = |j: usize| TAU * (j as f64 + 0.5) / (2 * n) as f64;
    let height = |i: usize| 1.0 - 2.0 * (i as f64 + 0.5) / n as f64;
    (0..n)
        .flat_map(|i| (0..2 * n).map(move |j| (unit(height(i).acos(), azimuth(j)), weight)))
        .collect()
}

/// A material that is diffuse and glossy; its parameters are added to `build`.
fn surface(build: &mut Builder) -> Result<Material> {
    let unit = (0.0, 1.0);
    Ok(Material::from(BlinnPhong {
        diffuse: build.rgb("diffuse", [0.5, 0.4, 0.3], unit)?,
        specular: build.rgb("specular", [0.3, 0.4, 0.5], unit)?,
        exponent: build.scalar("exponent", 10.0, (0.0, 1e6))?,
        sampling: BlinnPhongSampling::Importance,
    }))
}

/// A point whose shading normal z is not its geometric normal.
struct Point<'a> {
    material: &'a Material,
    theta: &'a [f64],
    n_geo: V,
}

impl Point<'_> {
    /// `k(wi -> wo)` or its adjoint, EVAL-KERNEL of the paper: the red channel.
    fn kernel(&self, from: V, to: V, adjoint: bool, rules: Rules) -> f64 {
        let theta = Theta::constant(self.theta);
        let at = Shading::new(theta, Vec2::new(0.5, 0.5));
        // Radiance comes from `from`, to the viewer at `to`; importance the other way round.
        let (directions, mode) = if adjoint {
            ([from, to], TransportMode::Importance)
        } else {
            ([to, from], TransportMode::Radiance)
        };
        eval_kernel(
            self.material,
            &at,
            self.n_geo,
            directions,
            CONTINUOUS,
            mode,
            rules,
        )
        .r
    }
}

/// A smooth function of directions, to be integrated against the kernel.
fn lobe(towards: V, d: V) -> f64 {
    (2.0 * (towards.normalize().dot(d) - 1.0)).exp() + 0.1
}

/// <W, K L> and <K* W, L> by the same quadrature.
fn products(point: &Point, n: usize, rules: [Rules; 2]) -> [f64; 2] {
    let nodes = sphere(n);
    let w = |d| lobe(Vec3::new(0.3, -0.8, 0.7), d);
    let l = |d| lobe(Vec3::new(-0.5, 0.2, 1.0), d);
    // Projected solid angle goes by the geometric normal.
    let projected = |(d, weight): (V, f64)| d.dot(point.n_geo).abs() * weight;
    let mut forward = 0.0;
    let mut adjoint = 0.0;
    for &a in &nodes {
        // a: towards the light in the outer sum of K* W, towards the viewer in that of K L.
        let (mut kl, mut kw) = (0.0, 0.0);
        for &b in &nodes {
            kl += point.kernel(b.0, a.0, false, rules[0]) * l(b.0) * b.1;
            kw += point.kernel(a.0, b.0, true, rules[1]) * w(b.0) * b.1;
        }
        forward += w(a.0) * kl * projected(a);
        adjoint += l(a.0) * kw * projected(a);
    }
    [forward, adjoint]
}

/// A ray between two of the patches of [`finite`].
struct FiniteScene {
    /// Rays `(a, b)` from patch a to patch b, and the throughput measure of each.
    rays: Vec<(usize, usize, f64)>,
    /// Kernels with respect to that measure: `[to ray][from ray]`, both leave the same patch.
    k: Vec<Vec<f64>>,
    adjoint: Vec<Vec<f64>>,
}

/// A room of six patches that see each other at one direction each; shading normals are tilted.
fn finite(material: &Material, theta: &[f64], rules: Rules) -> FiniteScene {
    // Centre, normal; unit areas, scaled such that light survives a few bounces.
    let axis = |k: usize, s: f64| Vec3::from(std::array::from_fn(|i| if i == k { s } else { 0.0 }));
    let jitter = |i: usize, k: usize| 0.2 * ((7 * i + 3 * k) as f64).sin();
    let patches: Vec<(V, V, V)> = (0..6)
        .map(|i| {
            let out = axis(i / 2, if i % 2 == 0 { 1.0 } else { -1.0 });
            let moved = Vec3::from(std::array::from_fn(|k| jitter(i, k)));
            let tilt = Vec3::from(std::array::from_fn(|k| 0.4 * ((5 * i + k) as f64).cos()));
            (out + moved, -out, (tilt - out).normalize())
        })
        .collect();
    let mut rays = Vec::new();
    for a in 0..6 {
        for b in 0..6 {
            let d = patches[b].0 - patches[a].0;
            let r2 = d.length_squared();
            let cosines = d.dot(patches[a].1) * -d.dot(patches[b].1) / r2;
            if a != b && cosines > 0.0 {
                rays.push((a, b, 0.5 * cosines / r2));
            }
        }
    }
    let direction = |a: usize, b: usize| (patches[b].0 - patches[a].0).normalize();
    let n = rays.len();
    let (mut k, mut adjoint) = (vec![vec![0.0; n]; n], vec![vec![0.0; n]; n]);
    for (i, &(a, b, _)) in rays.iter().enumerate() {
        for (j, &(c, d, _)) in rays.iter().enumerate() {
            if a != c {
                continue;
            }
            let frame = render::math::Frame::from_normal(patches[a].2);
            let point = Point {
                material,
                theta,
                n_geo: frame.to_local(patches[a].1),
            };
            let (out, other) = (direction(a, b), direction(c, d));
            let (to, from) = (frame.to_local(out), frame.to_local(other));
            // The cosine of the measure belongs to the ray.
            let cos = from.dot(point.n_geo).abs();
            k[i][j] = point.kernel(from, to, false, rules) / cos;
            // Importance arrives from `other`: particles go there.
            adjoint[i][j] = point.kernel(to, from, true, rules) / cos;
        }
    }
    FiniteScene { rays, k, adjoint }
}

impl FiniteScene {
    /// The same ray, seen from its other end.
    fn g(&self, l: &[f64]) -> Vec<f64> {
        let back = |&(a, b, _): &(usize, usize, f64)| {
            let there = self.rays.iter().position(|&(c, d, _)| (c, d) == (b, a));
            there.map_or(0.0, |j| l[j])
        };
        self.rays.iter().map(back).collect()
    }

    fn scatter(&self, k: &[Vec<f64>], l: &[f64]) -> Vec<f64> {
        let row = |row: &Vec<f64>| (0..l.len()).map(|j| row[j] * l[j] * self.rays[j].2).sum();
        k.iter().map(row).collect()
    }

    fn product(&self, a: &[f64], b: &[f64]) -> f64 {
        (0..a.len()).map(|i| a[i] * b[i] * self.rays[i].2).sum()
    }

    /// The four measurements of the table.
    fn measure(&self) -> [f64; 4] {
        let n = self.rays.len();
        let le: Vec<f64> = (0..n)
            .map(|i| if self.rays[i].0 == 2 { 3.0 } else { 0.0 })
            .collect();
        let we: Vec<f64> = (0..n)
            .map(|i| {
                if self.rays[i].0 == 5 {
                    1.0 + i as f64
                } else {
                    0.0
                }
            })
            .collect();
        let solve = |source: &[f64], step: &dyn Fn(&[f64]) -> Vec<f64>| {
            let mut x = source.to_vec();
            for _ in 0..400 {
                x = step(&x).iter().zip(source).map(|(a, b)| a + b).collect();
            }
            x
        };
        let lo = solve(&le, &|l| self.scatter(&self.k, &self.g(l)));
        let li = solve(&self.g(&le), &|l| self.g(&self.scatter(&self.k, l)));
        let wo = solve(&we, &|w| self.scatter(&self.adjoint, &self.g(w)));
        let wi = solve(&self.g(&we), &|w| self.g(&self.scatter(&self.adjoint, w)));
        [
            self.product(&we, &self.g(&lo)),
            self.product(&we, &li),
            self.product(&self.g(&wo), &le),
            self.product(&wi, &le),
        ]
    }
}

/// Largest relative difference of the values from the first of them.
fn spread(values: &[f64]) -> f64 {
    let d = values.iter().map(|v| (v / values[0] - 1.0).abs());
    d.fold(0.0, f64::max)
}

/// `veach-tab-2-5`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let mut build = Builder::new();
    let material = surface(&mut build)?;
    let theta: Vec<f64> = [0.5, 0.4, 0.3, 0.3, 0.4, 0.5, 10.0].into();
    let tilt = 0.5;
    let point = Point {
        material: &material,
        theta: &theta,
        n_geo: unit(tilt, 0.7),
    };
    let n = fig.pick(16, 32);
    let tested = Rules {
        side_tests: true,
        ..Rules::default()
    };
    let [a, b] = products(&point, n, [tested, tested]);
    fig.check(
        "<W, K L> = <K* W, L> to 1e-10: tilted shading normal, diffuse and glossy",
        (a / b - 1.0).abs() < 1e-10,
        format!("{a:.12} and {b:.12}"),
    );
    let wrong = Rules {
        side_tests: true,
        ..IGNORED
    };
    let [_, c] = products(&point, n, [tested, wrong]);
    fig.check(
        "without the adjoint flag they differ by more than 1 %",
        (c / a - 1.0).abs() > 0.01,
        format!("{c:.6} instead of {a:.6}: {:.2} %", (c / a - 1.0) * 100.0),
    );
    let four = finite(&material, &theta, tested).measure();
    fig.check(
        "all four measurements of the table agree to 1e-12 in a room of 6 patches",
        spread(&four) < 1e-12 && four[0] > 0.0,
        format!("<We, G L>, <We, Li>, <G W, Le>, <Wi, Le> = {four:.9?}"),
    );
    let confused = finite(&material, &theta, wrong).measure();
    fig.check(
        "with the flag ignored radiance and importance disagree by more than 0.5 %",
        spread(&confused[..2]) < 1e-12 && spread(&confused) > 0.005,
        format!("{confused:.6?}"),
    );

    // The renderer: paths, particles where they are seen, particles where they start.
    let scene = cornell(fig.pick(24, 48), Walls::Matt, 5)?;
    let settings = scene.settings;
    let spp = fig.pick(64, 256);
    let pixels = (scene.film.pixels() * 3) as f32;
    let adjoint = vec![1.0 / pixels; scene.film.pixels() * 3];
    let mean = |m: [f64; 3]| m.iter().sum::<f64>() / 3.0;
    let active = Active::new(&scene, &["left.reflectance.value"])?;
    let params = Theta::constant(scene.params().values());
    let runs = 16u64;
    let mut found = [Vec::new(), Vec::new(), Vec::new()];
    for seed in 0..runs {
        found[0].push(mean(paths(&scene, &settings, 100 + seed, spp).mean(0)));
        found[1].push(mean(
            particles(&scene, &settings, Rules::default(), seed, spp)?.mean(0),
        ));
        let m = backward_particles_f32(
            &Job::new(&scene, &settings, 200 + seed, 0..spp, &()),
            &params,
            &active,
            &adjoint,
        )?;
        found[2].push(m.value);
    }
    let [p, q, r] = found.map(|values| Estimate::of(&values));
    let worst = [p.z(&q), p.z(&r), q.z(&r)].map(f64::abs);
    let worst = worst.into_iter().fold(0.0, f64::max);
    let limit = z_limit(3, runs, 1e-2);
    fig.check(
        "the Cornell box measured by paths, at the film by particles and at the light by importance, and all agree",
        worst < limit,
        format!(
            "{:.5} +- {:.5}, {:.5} +- {:.5}, {:.5} +- {:.5}; largest |z| {worst:.2}, limit {limit:.2}",
            p.mean, p.se, q.mean, q.se, r.mean, r.se
        ),
    );
    let rows = [
        ("<W, K L>", a),
        ("<K* W, L>", b),
        ("<K W, L>, flag ignored", c),
    ];
    let names = ["<We, G L>", "<We, Li>", "<G W, Le>", "<Wi, Le>"];
    let rows = rows.into_iter().chain(names.into_iter().zip(four));
    let rows = rows.chain([
        ("paths", p.mean),
        ("particles", q.mean),
        ("importance", r.mean),
    ]);
    fig.csv_text(
        "products",
        &["what", "value"],
        rows.map(|(n, v)| [n.to_owned(), v.to_string()]),
    );
    Ok(())
}

/// Fraction of the received power that a white diffuse surface reflects, when the shading normal is tilted by
/// `tilt` towards light that arrives `incidence` from the geometric normal; side tests included. Quadrature.
pub fn albedo(incidence: f64, tilt: f64, n: usize) -> Result<f64> {
    let mut build = Builder::new();
    let white = build.rgb("white", [1.0; 3], (0.0, 1.0))?;
    let material = Material::from(render::bsdf::Diffuse { reflectance: white });
    // In the shading frame: the geometric normal leans away from the light.
    let point = Point {
        material: &material,
        theta: &[1.0; 3],
        n_geo: unit(tilt, PI),
    };
    let light = unit(incidence - tilt, 0.0);
    let rules = Rules {
        side_tests: true,
        ..Rules::default()
    };
    let reflected: f64 = (sphere(n).into_iter())
        .map(|(d, weight)| point.kernel(light, d, false, rules) * d.dot(point.n_geo).abs() * weight)
        .sum();
    Ok(reflected / light.dot(point.n_geo).abs())
}
