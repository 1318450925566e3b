//! What derivatives cost: gradient time over primal time, beside two peers.
//!
//! `cargo bench -p ad-core` runs criterion and then prints a table of ratios. The ratios come from
//! alternating passes, primal and contenders in turn, and are medians over rounds: other load on
//! the machine hits all of them alike.

mod kernels;
mod peers;

use std::hint::black_box;
use std::time::{Duration, Instant};

use ad_core::{Chain, DiffFn, Dual, Vec3, gradient};
use criterion::Criterion;
use kernels::{Ggx, GgxOfAlpha, Relax};

const STEPS: usize = 100;
const X0: f32 = 0.1;

/// One way to compute something, as a pass over all inputs.
struct Contender<'a> {
    name: &'static str,
    /// Largest allowed ratio to the first contender's time.
    bar: Option<f64>,
    pass: Box<dyn FnMut() + 'a>,
}

/// A contender that writes `f(x)` for every input `x`.
fn contender<'a, T: Copy + Default + 'a>(
    name: &'static str,
    bar: Option<f64>,
    inputs: &'a [[f32; 8]],
    mut f: impl FnMut(&[f32; 8]) -> T + 'a,
) -> Contender<'a> {
    let mut out = vec![T::default(); inputs.len()];
    let pass = move || {
        for (x, y) in inputs.iter().zip(&mut out) {
            // Opaque inputs one by one: no vectorisation across evaluations.
            *y = f(black_box(x));
        }
        black_box(&mut out);
    };
    Contender {
        name,
        bar,
        pass: Box::new(pass),
    }
}

/// GGX arguments over the upper hemisphere and roughness from 0.05 to 0.8.
fn ggx_inputs() -> Vec<[f32; 8]> {
    (0..256)
        .map(|i| {
            let i = i as f32;
            let (a, b) = ((0.37 * i).sin_cos(), (0.91 * i).sin_cos());
            [
                0.05 + 0.003 * i,
                0.5,
                0.6 * a.0,
                0.6 * a.1,
                0.8,
                0.28 * b.0,
                0.28 * b.1,
                0.96,
            ]
        })
        .collect()
}

fn ggx(inputs: &[[f32; 8]]) -> Vec<Contender<'_>> {
    let tape = reverse::Tape::new();
    let passive = |x: &[f32; 8]| GgxOfAlpha {
        f0: x[1],
        wi: Vec3::new(x[2], x[3], x[4]),
        wo: Vec3::new(x[5], x[6], x[7]),
    };
    vec![
        contender("primal f32", None, inputs, |x| Ggx.eval(*x)),
        contender("gradient, 8 derivatives", Some(4.0), inputs, |x| {
            gradient(&Ggx, *x)
        }),
        contender("alpha alone active", Some(1.8), inputs, move |x| {
            let y = passive(x).eval(Dual::<f32, 1>::var(x[0], 0));
            (y.re, y.eps)
        }),
        contender("num-dual, 8 derivatives", None, inputs, peers::ggx_num_dual),
        contender("reverse (tape), 8 derivatives", None, inputs, move |x| {
            peers::ggx_tape(&tape, x)
        }),
    ]
}

fn chain(inputs: &[[f32; 8]]) -> Vec<Contender<'_>> {
    let tape = reverse::Tape::new();
    let mut chain = Chain::<f32, 2, 1>::with_capacity(STEPS);
    vec![
        contender("primal f32", None, inputs, |p| {
            (0..STEPS).fold([X0], |[x], k| Relax.eval([x, p[k % 8]]))
        }),
        contender("chain, 9 derivatives", Some(1.7), inputs, move |p| {
            chain.start([X0]);
            chain.advance_all(&Relax, (0..STEPS).map(|k| [p[k % 8]]));
            let mut g = [0.0; 9];
            let [d_x0] = chain.pull_back([1.0], |k, [d]: [f32; 1]| g[k % 8] += d);
            g[8] = d_x0;
            g
        }),
        contender("forward duals, 9 derivatives", None, inputs, |p| {
            let p: [_; 8] = std::array::from_fn(|i| Dual::<f32, 9>::var(p[i], i));
            let x0 = [Dual::var(X0, 8)];
            let [x] = (0..STEPS).fold(x0, |[x], k| Relax.eval([x, p[k % 8]]));
            x.eps
        }),
        contender("num-dual, 9 derivatives", None, inputs, |p| {
            peers::chain_num_dual(p, X0, STEPS)
        }),
        contender("reverse (tape), 9 derivatives", None, inputs, move |p| {
            peers::chain_tape(&tape, p, X0, STEPS)
        }),
    ]
}

fn median(mut v: Vec<f64>) -> f64 {
    v.sort_by(f64::total_cmp);
    v[v.len() / 2]
}

/// Median time per evaluation and median ratio to the first contender over alternating rounds.
fn print_ratios(title: &str, inputs: usize, contenders: &mut [Contender<'_>]) {
    const ROUNDS: usize = 200;
    let mut times = vec![Vec::with_capacity(ROUNDS); contenders.len()];
    for _ in 0..ROUNDS {
        for (c, t) in contenders.iter_mut().zip(&mut times) {
            // The first pass warms caches and branch prediction up after the previous contender.
            (c.pass)();
            let start = Instant::now();
            (c.pass)();
            (c.pass)();
            t.push(start.elapsed().as_secs_f64() * 1e9 / (2 * inputs) as f64);
        }
    }
    println!("\n{title:<34} {:>9} {:>8} {:>6}", "ns", "ratio", "bar");
    for (c, t) in contenders.iter().zip(&times) {
        let ratio = median(t.iter().zip(&times[0]).map(|(t, p)| t / p).collect());
        let bar = c.bar.map_or(String::new(), |b| {
            format!("{b:>6.2} {}", if ratio <= b { "pass" } else { "FAIL" })
        });
        println!(
            "{:<34} {:>9.2} {ratio:>8.2} {bar}",
            c.name,
            median(t.clone())
        );
    }
}

/// All contenders must compute the same numbers before their times mean anything.
fn assert_agreement(inputs: &[[f32; 8]]) {
    let tape = reverse::Tape::new();
    for x in inputs {
        let (y, g) = gradient(&Ggx, *x);
        for (peer, p) in [peers::ggx_num_dual(x), peers::ggx_tape(&tape, x)] {
            assert!((peer - y).abs() <= 1e-4 * y.abs());
            assert!(
                g.iter()
                    .zip(p)
                    .all(|(a, b)| (a - b).abs() <= 1e-2 * (1.0 + a.abs()))
            );
        }
        let c = peers::chain_num_dual(x, X0, STEPS);
        let t = peers::chain_tape(&tape, x, X0, STEPS);
        assert!(
            c.iter()
                .zip(t)
                .all(|(a, b)| (a - b).abs() <= 1e-3 * (1.0 + a.abs()))
        );
    }
}

fn main() {
    let inputs = ggx_inputs();
    let chains = &inputs[..16];
    assert_agreement(&inputs);
    let mut criterion = Criterion::default()
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args();
    for (name, contenders) in [("ggx x 256", ggx(&inputs)), ("chain x 16", chain(chains))] {
        let mut group = criterion.benchmark_group(name);
        for mut c in contenders {
            group.bench_function(c.name, |b| b.iter(&mut c.pass));
        }
        group.finish();
    }
    criterion.final_summary();
    // `cargo test --benches` only checks that everything runs.
    if !std::env::args().any(|a| a == "--test") {
        print_ratios("GGX x cosine, 8 inputs", inputs.len(), &mut ggx(&inputs));
        print_ratios("chain of 100 steps", chains.len(), &mut chain(chains));
    }
}
