//! Paths, one walk towards the light with paths for what it misses and without, unbiased estimates and trial sets, compared in one scene.
//! Walks start anywhere, as published: solutions that particles show make unbiased estimates less noisy than trial sets.

use render::Scene;
use render::scene::{Connections, Method, Starts};
use render::statistics::z_limit;

use super::manifold_methods::{Effort, Measured, measure};
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

/// What was found in a scene.
pub struct Compared {
    /// By one walk.
    pub mnee: Measured,
    /// By that walk, and paths for what it misses.
    pub both: Measured,
    /// By unbiased estimates.
    pub sms: Measured,
    /// By trial sets, and their sizes, which grow.
    pub sets: Vec<(u32, Measured)>,
}

impl Compared {
    /// What part of the light is found.
    pub fn share(&self, found: &Measured) -> f64 {
        found.mean() / self.sms.mean()
    }
}

/// All methods in one scene, over chains of at most so many vertices: checks of what they miss and of their noise, pictures,
/// and charts of their errors over time.
///
/// # Errors
/// Those of rendering.
pub fn compare(
    fig: &mut Figure,
    name: &str,
    scene: &Scene,
    bounces: u32,
    effort: Effort,
) -> Result<Compared> {
    let measured = |k: u64, method: Method, by_paths: bool, spp: u64| {
        let connections = Connections {
            bounces,
            starts: Starts::Uniform,
            ..Connections::new(method)
        };
        let effort = Effort {
            spp,
            ..effort.other(k)
        };
        measure(scene, connections, by_paths, effort)
    };
    let of = |k: u64, method: Method| measured(k, method, false, effort.spp);
    // Paths are quick, and seldom meet a light.
    let paths = measured(1, Method::Sms, true, fig.pick(512, 32) * effort.spp)?;
    let mnee = of(2, Method::Mnee)?;
    // Few of the paths that meet the lamp went over chains that one walk misses.
    let both = measured(4, Method::MneeUnbiased, false, fig.pick(32, 8) * effort.spp)?;
    let sms = of(3, Method::Sms)?;
    let sizes: &[u32] = fig.pick(&[2, 8], &[4, 16, 64]);
    let sets: Vec<(u32, Measured)> = (sizes.iter().zip(10..))
        .map(|(walks, k)| Ok((*walks, of(k, Method::SmsBiased(*walks))?)))
        .collect::<Result<_>>()?;
    let found = Compared {
        mnee,
        both,
        sms,
        sets,
    };
    let (mnee, both, sms, sets) = (&found.mnee, &found.both, &found.sms, &found.sets);
    // ---- One walk and paths ----
    let missing = 1.0 - found.share(mnee);
    let (a, b) = (both.whole(), sms.whole());
    // The two, and the larger trial set against all.
    let limit = z_limit(2, Measured::repeats(&[both, sms, &sets[1].1]), 1e-2);
    let z = a.z(&b);
    fig.check(
        format!("{name}: one walk with paths for what it misses finds as much light as unbiased estimates"),
        z.abs() < limit && both.found.missed > 0,
        format!(
            "{:.4} and {:.4}, {z:.1} standard errors apart, limit {limit:.2}; the walk misses {:.1} % of the light, {} of {} paths that met the lamp count",
            a.mean,
            b.mean,
            100.0 * missing,
            both.found.missed,
            both.found.met
        ),
    );
    // Of paths that count, those of nearly all light have nearly all noise.
    let noise = [&paths, both, sms].map(Measured::variance_of_one);
    let most_is_found = missing < 0.5;
    fig.check(
        format!("{name}: at equal samples it has more noise than these, but less than paths where it finds most light"),
        noise[1] > noise[2] && (noise[0] > noise[1] || !most_is_found),
        format!("variance {noise:.2?} of paths, of one walk and paths, and unbiased"),
    );

    // ---- Errors in the same time ----
    let seconds = sms.seconds;
    let errors = [&paths, both, sms].map(|m| m.variance_after(seconds));
    // Wide lamps are no task for walks.
    if fig.pick(false, true) {
        fig.check(
            format!("{name}: in the same time unbiased estimates have least noise of the three"),
            errors[2] < errors[0].min(errors[1]),
            format!("variance {errors:.2?}"),
        );
    }

    // ---- Trial sets ----
    let relative = |m: &Measured| m.whole().se / m.mean();
    let noise = relative(&sets[1].1).hypot(relative(sms));
    let shares: Vec<f64> = sets.iter().map(|(_, m)| found.share(m)).collect();
    fig.check(
        format!("{name}: trial sets lose light, smaller ones more"),
        shares.windows(2).all(|w| w[0] < w[1])
            && shares[0] < 0.95
            && shares[1] < 1.0 + limit * noise,
        format!("{shares:.3?} of it"),
    );
    let noise: Vec<f64> = sets.iter().map(|(_, m)| m.variance()).collect();
    fig.check(
        format!("{name}: the smallest have less noise than unbiased estimates at equal samples"),
        noise[0] < sms.variance(),
        format!("variance {noise:.3?} and {:.3} unbiased", sms.variance()),
    );

    let others = [
        ("paths", &paths),
        ("one walk", mnee),
        ("one walk and paths", both),
        ("unbiased", sms),
    ];
    let labels = sets.iter().map(|(walks, m)| (format!("{walks} walks"), m));
    let all: Vec<(String, &Measured)> = (others.map(|(l, m)| (l.to_owned(), m)).into_iter())
        .chain(labels)
        .collect();
    let factor = fig.pick(10, 4);
    let panels: Vec<_> = (all.iter())
        .map(|(label, m)| m.panel(label, sms, factor))
        .collect();
    fig.images(name, 3, &panels);
    let rows = all.iter().map(|(label, m)| {
        let numbers = [
            m.mean(),
            m.variance(),
            m.squared_bias(sms),
            m.success(),
            m.trials(),
            m.seconds,
        ];
        let [a, b, c, d, e, f] = numbers.map(|x| x.to_string());
        [label.clone(), a, b, c, d, e, f]
    });
    let columns = [
        "method",
        "mean",
        "variance",
        "squared_bias",
        "success_rate",
        "trials",
        "seconds",
    ];
    fig.csv_text(name, &columns, rows.collect::<Vec<_>>());
    // Noise falls with time, what is missing stays.
    let times: Vec<f64> = (-4..=10).map(|k| seconds * 2f64.powi(k)).collect();
    let mut chart = LineChart::new(&format!("{name}: error and time"), "seconds", "error")
        .log_x()
        .log_y();
    for (label, m) in &all {
        let missing = match label.as_str() {
            "paths" | "one walk and paths" | "unbiased" => 0.0,
            _ => m.squared_bias(sms),
        };
        let error = |t: &f64| (*t, (m.variance_after(*t) + missing).sqrt());
        chart = chart.line(label, times.iter().map(error));
    }
    fig.chart(&format!("{name}-errors"), &chart);
    Ok(found)
}
