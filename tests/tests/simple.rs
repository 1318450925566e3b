//! The path tracer to read is the full one: with the same random numbers it has the same radiance and gradient, path by
//! path.

use ad_core::Dual;
use render::Job;
use render::Scene;
use render::estimator::DetachedMis;
use render::integrator::gradient::{Active, backward};
use render::integrator::{path, simple};
use render::math::{Ray, Rgb};
use render::params::{GradSink, ParamRef, Tangent, Theta};
use render::sampler::{Points, Sampler, Spread};
use tests::{cases, scene, smooth_params, values};

const SEED: u64 = 11;
const SPP: u64 = 8;

/// All samples of an image: camera ray and the numbers of the path to come.
fn samples(s: &Scene) -> impl Iterator<Item = (Ray<f64>, Spread)> + '_ {
    let [width, height] = s.film.crop_size;
    let pixels = (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
    pixels.flat_map(move |(x, y)| {
        (0..SPP).map(move |index| {
            let pixel = u64::from(y) * u64::from(width) + u64::from(x);
            let mut sampler = Spread::spread(Points::Independent, SEED, pixel, index);
            let [dx, dy] = s.film.filter.sample(sampler.next_2d::<f64>());
            let ray = s
                .camera
                .ray(f64::from(x) + 0.5 + dx, f64::from(y) + 0.5 + dy);
            (ray, sampler)
        })
    })
}

/// Scenes without roulette, which the simple one does not play.
fn scenes() -> impl Iterator<Item = (&'static str, Scene)> {
    cases::all().into_iter().map(|case| {
        let mut s = scene(&case.body);
        s.settings.rr_depth = u32::MAX;
        (case.name, s)
    })
}

fn assert_close(a: &[f64], b: &[f64], tolerance: f64, what: &str) {
    let scale = a.iter().chain(b).fold(1e-300, |m: f64, x| m.max(x.abs()));
    assert_eq!(a.len(), b.len(), "{what}");
    for (x, y) in a.iter().zip(b) {
        assert!((x - y).abs() <= tolerance * scale, "{what}: {x} and {y}");
    }
}

/// Radiance, and its derivative along a direction over all parameters, over dual numbers.
#[test]
fn radiance_is_that_of_the_full_path_tracer() {
    type R = Dual<f64, 1>;
    let mut lit = 0;
    for (name, s) in scenes() {
        let theta = values::<f64>(&s);
        let mut tangents = vec![Tangent::None; s.params().infos().len()];
        for p in smooth_params(&s) {
            let id = s.params().handle(&p).id as usize;
            tangents[id] = Tangent::Uniform(Dual::new(0.0, [1.0]));
        }
        let moving = Theta::<R>::with_tangents(&theta, &tangents);
        for (ray, sampler) in samples(&s) {
            let still = Theta::constant(&theta);
            let depth = s.settings.max_depth;
            let found = simple::trace(&s, &still, depth, ray, &mut { sampler });
            let l: Rgb<R> = simple::radiance(&s, &moving, &found);
            let full = path::trace::<R, DetachedMis, Spread, ()>(
                &s,
                &moving,
                &s.settings,
                ray,
                sampler,
                &mut (),
            );
            let numbers = |l: Rgb<R>| {
                l.to_array()
                    .iter()
                    .flat_map(|c| [c.re, c.eps[0]])
                    .collect::<Vec<_>>()
            };
            assert_close(&numbers(l), &numbers(full), 1e-10, name);
            lit += usize::from(numbers(l).iter().any(|x| *x != 0.0));
        }
    }
    assert!(lit > 5000, "only {lit} paths carry light");
}

/// Adjoints of all values.
struct All(Vec<f64>);

impl GradSink<f64> for All {
    fn active(&self, _p: ParamRef) -> bool {
        true
    }
    fn add(&mut self, p: ParamRef, i: usize, d: f64) {
        self.0[p.offset as usize + i] += d;
    }
}

/// The gradient of the mean over samples of all pixels' sums.
#[test]
fn gradients_are_those_of_the_full_path_tracer() {
    for (name, s) in scenes() {
        let theta = values::<f64>(&s);
        let still = Theta::constant(&theta);
        let mut sums = All(vec![0.0; theta.len()]);
        for (ray, mut sampler) in samples(&s) {
            let found = simple::trace(&s, &still, s.settings.max_depth, ray, &mut sampler);
            let d = Rgb::splat(1.0 / SPP as f64);
            simple::backward(&s, &still, &found, d, &mut sums);
        }
        let params = smooth_params(&s);
        let names: Vec<_> = params.iter().map(|p| &p.name).collect();
        let active = Active::new(&s, &names).expect("smooth parameters");
        let ones = vec![1.0; s.film.pixels() * 3];
        let full = backward::<f64, DetachedMis, Spread>(
            &Job::new(&s, &s.settings, SEED, 0..SPP, &()),
            &still,
            &active,
            &ones,
        )
        .expect("an image of the right size");
        let own: Vec<f64> = params
            .iter()
            .flat_map(|p| sums.0[p.range()].to_vec())
            .collect();
        assert_close(&own, &full.values.concat(), 1e-9, name);
    }
}
