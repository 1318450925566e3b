//! [Zeltner 2021, figures 3.9 and 3.24]: light through the waves of a pool, by paths, by one walk towards the light, by unbiased
//! estimates and by trial sets.
//!
//! What one walk misses is found by paths, or left out, as where figure 3.9 discards outliers: those are what paths find of it.

use render::scene::{Method, Starts};
use render::statistics::z_limit;

use super::authors::{Authors, compare as compare_ways, compare_methods};
use super::manifold_comparison::compare;
use super::manifold_methods::{Effort, Measured, measure, single};
use super::manifold_scenes::{Waves, pool};
use crate::statistics::check_same;
use examples::figure::{Figure, Result};

const SEED: u64 = 324;
/// Wavelength and slopes of the waves.
const WAVES: [f64; 2] = [0.5, 0.25];

/// `zeltner-3-24`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(16, 48);
    let effort = Effort::of(fig, [2, 16], SEED);
    effort.note(fig, size);
    let [length, slope] = WAVES;
    let waves = Waves::new(length, slope, SEED);
    // Paths meet wider lamps in less time.
    let small = pool(size, fig.pick(0.12, 0.03), &waves)?;
    let found = compare(fig, "pool", &small, 1, effort)?;
    let share = found.share(&found.mnee);
    fig.check(
        "without what one walk misses, more than a tenth of the light is lost",
        share < 0.9,
        format!("{share:.3} of it is found"),
    );

    // ---- Absolute brightness ----
    // Paths meet a wide lamp.
    let wide = pool(size, 0.8, &waves)?;
    let connections = single(Method::Sms, Starts::Particles);
    let effort = Effort {
        runs: 16,
        spp: fig.pick(4, 32),
        seed: 2 * SEED,
    };
    let chains = measure(&wide, connections, false, effort)?;
    let paths = Effort {
        seed: 3 * SEED,
        spp: 64 * effort.spp,
        ..effort
    };
    let paths = measure(&wide, connections, true, paths)?;
    let pair = [&chains.series, &paths.series];
    let statement = "under a wide lamp unbiased estimates and paths agree, whose light is in water";
    check_same(fig, &[statement], pair, effort.runs, 1e-3);
    let limit = z_limit(1, Measured::repeats(&[&chains, &paths]), 1e-3);
    let (a, b) = (chains.whole(), paths.whole());
    let (ratio, error) = (a.mean / b.mean, (a.se / a.mean).hypot(b.se / b.mean));
    fig.check(
        "so the squared index is in it once",
        (ratio - 1.0).abs() < limit * error && error < 0.1,
        format!(
            "{ratio:.4} ± {error:.4}, limit {limit:.2} of these; without it, or with it twice, the ratio would be 1.77 off"
        ),
    );
    published(fig)
}

/// The pool of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let file = "Figure_14_15_MainComparison/pool_sms.xml";
    let of = authors.scene(fig, "authors' pool", file, fig.pick(16, 48), &[])?;
    let effort = Effort::of(fig, [1, 4], 4 * SEED);
    let accuracy = fig.pick((1 << 14, 0.3), (1 << 18, 0.1));
    if fig.pick(false, true) {
        compare_methods(fig, &of, 1, effort, accuracy)?;
        return Ok(());
    }
    // Its textures make every image long, whatever is in it.
    let ways = [Method::Mnee, Method::Sms].map(|m| single(m, Starts::Particles));
    let ways = [("one walk", ways[0]), ("from particles", ways[1])];
    let found = compare_ways(fig, &of, &ways, effort, accuracy)?;
    let [share, error] = found.share(0);
    fig.check(
        "authors' pool: one walk brings no more than there is",
        share < 1.0 + z_limit(1, effort.runs, 1e-2) * error,
        format!("{share:.3} ± {error:.3} of it"),
    );
    Ok(())
}
