//! Second derivatives: Hessian-vector products against nested duals in forward mode, differences of
//! gradients and their own transpose; the Gauss-Newton matrix against an explicit Jacobian.

use ad_core::Dual;
use render::Job;
use render::estimator::DetachedMis;
use render::instances::{
    Direction, backward_f32, backward_f64, forward_f32, gauss_newton_f32, hessian_vector_f32,
};
use render::integrator::gradient::Active;
use render::integrator::render::render;
use render::integrator::second_order::hessian_vector;
use render::params::{ParamInfo, ParamKind, Tangent, Theta};
use render::sampler::Independent;
use render::{Scene, Settings};
use tests::stats::{Estimate, z_limit};
use tests::{cases, image, mean_adjoint, on_any_threads, scene, smooth_params, values};

/// A cheap, fixed sequence in [-1, 1).
fn noise(i: usize) -> f64 {
    render::sampler::mix64(i as u64 + 1) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

fn noise_image(scene: &Scene, first: usize) -> Vec<f32> {
    let n = scene.film.pixels() * 3;
    (0..n).map(|i| noise(i + first) as f32).collect()
}

/// A scene, and parameters of it as one vector.
struct Case {
    name: &'static str,
    scene: Scene,
    params: Vec<ParamInfo>,
    active: Active,
    /// Without roulette, whose probabilities depend on the parameters.
    settings: Settings,
}

impl Case {
    fn new(name: &str, wanted: impl Fn(&ParamInfo) -> bool) -> Self {
        let case = cases::all().into_iter().find(|c| c.name == name).unwrap();
        let scene = scene(&case.body);
        let mut params = smooth_params(&scene);
        params.retain(|p| wanted(p));
        let names: Vec<&str> = params.iter().map(|p| p.name.as_str()).collect();
        let active = Active::new(&scene, &names).unwrap();
        let settings = Settings {
            rr_depth: u32::MAX,
            ..scene.settings
        };
        Self {
            name: case.name,
            scene,
            params,
            active,
            settings,
        }
    }

    fn direction(&self, first: usize) -> Vec<f64> {
        (0..self.active.len()).map(|i| noise(i + first)).collect()
    }

    /// All values of the scene, those of the parameters moved by `h v`.
    fn moved(&self, h: f64, v: &[f64]) -> Vec<f64> {
        let mut all = values::<f64>(&self.scene);
        let places = self.params.iter().flat_map(|p| p.range());
        places.zip(v).for_each(|(i, v)| all[i] += h * v);
        all
    }

    fn gradient(&self, values: &[f64], adjoint: &[f32], seed: u64, spp: u64) -> Vec<f64> {
        let theta = Theta::constant(values);
        let g = backward_f64(
            &Job::new(&self.scene, &self.settings, seed, 0..spp, &()),
            &theta,
            &self.active,
            adjoint,
        );
        g.unwrap().values.concat()
    }

    fn product(&self, v: &[f64], adjoints: [&[f32]; 2], seed: u64, spp: u64) -> Vec<f64> {
        let all = values::<f64>(&self.scene);
        let theta = Theta::constant(&all);
        let product = hessian_vector::<f64, Independent>(
            &Job::new(&self.scene, &self.settings, seed, 0..spp, &()),
            &theta,
            &self.active,
            v,
            adjoints,
        );
        let product = product.unwrap();
        assert_eq!(product.non_finite.count, 0);
        product.values.concat()
    }

    /// Image, its derivatives along `u` and `v`, and the second one: `Dual<Dual<f64, 1>, 1>`, the
    /// inner tangent along `v`.
    fn nested(&self, [u, v]: [&[f64]; 2], seed: u64, spp: u64) -> [Vec<f64>; 4] {
        type Twice = Dual<Dual<f64, 1>, 1>;
        let all = values::<f64>(&self.scene);
        let mut tangents = vec![Tangent::None; self.scene.params().infos().len()];
        let mut at = 0;
        for p in &self.params {
            let own = at..at + p.shape.len();
            at = own.end;
            let twice = own.map(|i| {
                let inner = |re, eps| Dual::<f64, 1>::new(re, [eps]);
                Twice::new(inner(0.0, v[i]), [inner(u[i], 0.0)])
            });
            let id = self.scene.params().handle(p).id as usize;
            tangents[id] = Tangent::Dense(twice.collect());
        }
        let theta = Theta::<Twice>::with_tangents(&all, &tangents);
        let r = render::<Twice, DetachedMis, Independent>(
            &Job::new(&self.scene, &self.settings, seed, 0..spp, &()),
            &theta,
        )
        .expect("detached sampling of smooth parameters");
        assert_eq!(r.non_finite.count, 0);
        let mean = |k: usize| r.sums[k].iter().map(|s| s / spp as f64).collect();
        [mean(0), mean(2), mean(1), mean(3)]
    }
}

fn product_of(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn size_of(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum()
}

fn weighted(image: &[f64], weights: &[f32]) -> f64 {
    let pairs = image.iter().zip(weights);
    pairs.map(|(i, w)| i * f64::from(*w)).sum()
}

/// Recorded paths over nested duals give what the path tracer over nested duals gives, for every
/// parameter of every material and emitter at once, roughness included: same seed, to 1e-9.
#[test]
fn products_equal_nested_duals_in_forward_mode() {
    for case in cases::all() {
        let case = Case::new(case.name, |_| true);
        let adjoints = [0, 5000].map(|k| noise_image(&case.scene, k));
        let [u, v] = [300, 600].map(|k| case.direction(k));
        let [_, along_u, _, both] = case.nested([&u, &v], 5, 8);
        let expected = weighted(&both, &adjoints[0]) + weighted(&along_u, &adjoints[1]);
        let product = case.product(&v, [&adjoints[0], &adjoints[1]], 5, 8);
        let (found, size) = (product_of(&u, &product), size_of(&u, &product));
        assert!(size > 0.0, "{}: no derivative at all", case.name);
        assert!(
            (found - expected).abs() < 1e-9 * size,
            "{}: forward {expected} recorded {found} of {size}",
            case.name
        );
    }
}

/// Albedos and emission do not move samples: differences of gradients with common random numbers are exact.
#[test]
fn products_equal_differences_of_gradients_in_albedo_and_emission() {
    for name in ["diffuse", "beckmann", "checkerboard", "area", "point"] {
        let case = Case::new(name, |p| p.kind != ParamKind::Roughness);
        let adjoint = noise_image(&case.scene, 0);
        let zero = vec![0.0; adjoint.len()];
        let v = case.direction(40);
        let h = 1e-4;
        let [more, less] = [h, -h].map(|h| case.gradient(&case.moved(h, &v), &adjoint, 9, 16));
        let product = case.product(&v, [&adjoint, &zero], 9, 16);
        let largest = product.iter().fold(0.0f64, |m, p| m.max(p.abs()));
        assert!(largest > 0.0, "{name}");
        for ((more, less), product) in more.iter().zip(&less).zip(&product) {
            let difference = (more - less) / (2.0 * h);
            assert!(
                (difference - product).abs() < 1e-6 * largest,
                "{name}: difference {difference} product {product} of {largest}"
            );
        }
    }
}

/// The whole Hessian of a squared error, with image and pass of different seeds: the adjoint moves by
/// the derivative image. Its rounding to f32 limits the differences.
#[test]
fn products_of_a_loss_equal_differences_of_its_gradient() {
    const SPP: u64 = 16;
    for name in ["diffuse", "area"] {
        let case = Case::new(name, |p| p.kind != ParamKind::Roughness);
        let target = noise_image(&case.scene, 77);
        let adjoint = |image: &[f64]| -> Vec<f32> {
            let pairs = image.iter().zip(&target);
            pairs
                .map(|(i, t)| (2.0 * (i - f64::from(*t))) as f32)
                .collect()
        };
        let v = case.direction(40);
        let h = 1e-2;
        let [more, less] = [h, -h].map(|h| {
            let moved = case.moved(h, &v);
            let r = image::<f64>(&case.scene, &moved, &case.settings, 1, SPP);
            let image: Vec<f64> = r.sums[0].iter().map(|s| s / SPP as f64).collect();
            case.gradient(&moved, &adjoint(&image), 2, SPP)
        });
        let [image, _, along, _] = case.nested([&v, &v], 1, SPP);
        let change: Vec<f32> = along.iter().map(|t| (2.0 * t) as f32).collect();
        let product = case.product(&v, [&adjoint(&image), &change], 2, SPP);
        let largest = product.iter().fold(0.0f64, |m, p| m.max(p.abs()));
        for ((more, less), product) in more.iter().zip(&less).zip(&product) {
            let difference = (more - less) / (2.0 * h);
            assert!(
                (difference - product).abs() < 1e-3 * largest,
                "{name}: difference {difference} product {product} of {largest}"
            );
        }
    }
}

/// Roughness moves samples, so differences of gradients agree in the mean only: along the roughness and one
/// albedo, 32 repetitions; significance 1e-3 over all comparisons.
#[test]
#[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
fn products_equal_differences_of_gradients_in_roughness() {
    const REPEATS: u64 = 32;
    const SPP: u64 = 128;
    let mut rows = Vec::new();
    for name in ["ggx", "rough plastic"] {
        let case = Case::new(name, |p| {
            p.kind == ParamKind::Roughness || p.name == "floor_bsdf.reflectance.value"
        });
        let adjoint = mean_adjoint(&case.scene);
        let zero = vec![0.0; adjoint.len()];
        let v: Vec<f64> = (0..case.active.len())
            .map(|i| if i == 0 { 1.0 } else { 0.5 })
            .collect();
        let h = 0.02;
        let mut products = Vec::new();
        let mut differences = Vec::new();
        for r in 0..REPEATS {
            products.push(case.product(&v, [&adjoint, &zero], r, SPP));
            let [more, less] =
                [h, -h].map(|h| case.gradient(&case.moved(h, &v), &adjoint, 1000 + r, SPP));
            let pairs = more.iter().zip(&less);
            differences.push(pairs.map(|(a, b)| (a - b) / (2.0 * h)).collect::<Vec<_>>());
        }
        let mut at = 0;
        for p in &case.params {
            let own = at..at + p.shape.len();
            at = own.end;
            let total = |rows: &[Vec<f64>]| {
                let sums: Vec<f64> = rows.iter().map(|r| r[own.clone()].iter().sum()).collect();
                Estimate::of(&sums)
            };
            rows.push((name, p.name.clone(), total(&products), total(&differences)));
        }
    }
    let limit = z_limit(rows.len(), REPEATS, 1e-3);
    let mut seen = 0;
    for (case, name, product, difference) in &rows {
        let z = product.z(difference);
        println!(
            "{case:>16} {name:42} {:+.4e} +- {:.0e}  fd {:+.4e} +- {:.0e}  z {z:+.2}",
            product.mean, product.se, difference.mean, difference.se
        );
        assert!(z.abs() < limit, "{case}/{name}: z = {z}, limit {limit}");
        seen += usize::from(product.mean.abs() > 5.0 * product.se);
    }
    // The test can fail: most of these are far from zero.
    assert!(seen >= rows.len() / 2, "{seen} of {}", rows.len());
}

/// `<u, H v> = <v, H u>` with equal random numbers, the curvature of a loss included.
#[test]
fn products_are_symmetric() {
    for name in ["ggx", "rough plastic", "two-sided blend", "spot"] {
        let case = Case::new(name, |_| true);
        let adjoint = noise_image(&case.scene, 0);
        let [u, v] = [300, 600].map(|k| case.direction(k));
        let [_, along_u, along_v, _] = case.nested([&u, &v], 4, 8);
        let [change_u, change_v] =
            [along_u, along_v].map(|j| j.iter().map(|x| *x as f32).collect::<Vec<_>>());
        let [hu, hv] = [(&u, &change_u), (&v, &change_v)]
            .map(|(d, change)| case.product(d, [&adjoint, change], 4, 8));
        let (a, b, size) = (product_of(&u, &hv), product_of(&v, &hu), size_of(&u, &hv));
        assert!((a - b).abs() < 1e-6 * size, "{name}: {a} {b} of {size}");
        assert!(size > 0.0);
    }
}

/// The Gauss-Newton matrix is the sum over pixels, channels and pairs of *different* samples of the
/// products of their derivatives, and its diagonal with it; the gradient is that of reverse mode.
#[test]
fn the_gauss_newton_matrix_equals_an_explicit_jacobian() {
    const SPP: u64 = 4;
    for name in ["diffuse", "ggx", "rough plastic", "checkerboard"] {
        let case = Case::new(name, |_| true);
        let s = &case.scene;
        let values = s.params().values();
        let n = case.active.len();
        let adjoint = noise_image(s, 0);
        let weights: Vec<f32> = noise_image(s, 900).iter().map(|w| w.abs() + 0.1).collect();
        let theta = Theta::constant(values);
        let found = gauss_newton_f32(
            &Job::new(s, &s.settings, 3, 0..SPP, &()),
            &theta,
            &case.active,
            [&adjoint, &weights],
        )
        .unwrap();
        // One column per value and sample.
        let mut directions = Vec::new();
        for p in &case.params {
            for i in 0..p.shape.len() {
                let mut unit = vec![0.0; p.shape.len()];
                unit[i] = 1.0;
                directions.push(Direction::Dense(s.params().handle(p), unit));
            }
        }
        let samples: Vec<Vec<Vec<f64>>> = (0..SPP)
            .map(|k| {
                let r = forward_f32(
                    &Job::new(s, &s.settings, 3, k..k + 1, &()),
                    values,
                    &directions,
                );
                r.unwrap().sums.into_iter().skip(1).collect()
            })
            .collect();
        let pairs = (SPP * (SPP - 1)) as f64;
        let mut expected = vec![0.0; n * n];
        for (a, of_a) in samples.iter().enumerate() {
            for of_b in samples.iter().skip(a + 1) {
                for (k, e) in expected.iter_mut().enumerate() {
                    let (i, j) = (k / n, k % n);
                    let terms = (0..weights.len()).map(|p| {
                        f64::from(weights[p]) * (of_a[i][p] * of_b[j][p] + of_b[i][p] * of_a[j][p])
                    });
                    *e += terms.sum::<f64>() / pairs;
                }
            }
        }
        let largest = expected.iter().fold(0.0f64, |m, e| m.max(e.abs()));
        for (k, (e, f)) in expected.iter().zip(&found.matrix).enumerate() {
            assert!(
                (e - f).abs() < 1e-4 * largest,
                "{name} [{}, {}]: {e} {f} of {largest}",
                k / n,
                k % n
            );
        }
        for (i, d) in found.diagonal().iter().enumerate() {
            assert_eq!(*d, found.matrix[i * n + i]);
        }
        let g = backward_f32(
            &Job::new(s, &s.settings, 3, 0..SPP, &()),
            &theta,
            &case.active,
            &adjoint,
        );
        let g = g.unwrap().values.concat();
        let largest = g.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        for (a, b) in g.iter().zip(&found.gradient) {
            assert!((a - b).abs() < 1e-4 * largest, "{name}: {a} {b}");
        }
    }
}

#[test]
fn results_do_not_depend_on_the_threads() {
    let case = Case::new("ggx", |_| true);
    let s = &case.scene;
    let images = [0, 900].map(|k| noise_image(s, k));
    on_any_threads(|| {
        let theta = Theta::constant(s.params().values());
        let v: Vec<f32> = case.direction(1).iter().map(|x| *x as f32).collect();
        let images = [&images[0][..], &images[1][..]];
        let h = hessian_vector_f32(
            &Job::new(s, &s.settings, 1, 0..8, &()),
            &theta,
            &case.active,
            &v,
            images,
        );
        let g = gauss_newton_f32(
            &Job::new(s, &s.settings, 1, 0..8, &()),
            &theta,
            &case.active,
            images,
        );
        let g = g.unwrap();
        (h.unwrap().values, g.matrix, g.gradient)
    });
}

#[test]
fn mistakes_are_errors() {
    let case = Case::new("diffuse", |_| true);
    let s = &case.scene;
    let good = mean_adjoint(s);
    let theta = Theta::constant(s.params().values());
    let newton = |images: [&[f32]; 2], spp| {
        let r = gauss_newton_f32(
            &Job::new(s, &s.settings, 0, 0..spp, &()),
            &theta,
            &case.active,
            images,
        );
        r.unwrap_err().to_string()
    };
    assert_eq!(
        newton([&good, &good[1..]], 4),
        "weights: expected 192 values, found 191"
    );
    assert_eq!(
        newton([&good, &good], 1),
        "samples per pixel of a Gauss-Newton matrix: expected at least 2, found 1"
    );
    let v = vec![0.0; case.active.len() + 1];
    let settings = &s.settings;
    let images = [&good[..], &good[..]];
    let r = hessian_vector_f32(
        &Job::new(s, settings, 0, 0..1, &()),
        &theta,
        &case.active,
        &v,
        images,
    );
    let message = r.unwrap_err().to_string();
    assert!(message.starts_with("direction: expected"), "{message}");
}
