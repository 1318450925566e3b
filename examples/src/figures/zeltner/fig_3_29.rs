//! [Zeltner 2021, figure 3.29]: light through a slab of glass with waves on both faces, by paths, by one walk towards the light,
//! by unbiased estimates and by trial sets.
//!
//! Chains of the figure are refracted twice. The renderer looks for all chains of up to two vertices; others than those are
//! blocked by the frame of the slab, or end where there is no lamp.

use render::scene::{Connections, Method};

use super::manifold_comparison::compare;
use super::manifold_methods::{Effort, measure};
use super::manifold_scenes::{Waves, slab};
use crate::figure::{Figure, Result};

const SEED: u64 = 329;
/// Wavelength and slopes of the waves.
const WAVES: [f64; 2] = [1.0, 0.16];

/// `zeltner-3-29`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(8, 48);
    let effort = Effort {
        runs: fig.pick(8, 16),
        spp: fig.pick(2, 16),
        seed: SEED,
    };
    effort.note(fig, size);
    let [length, slope] = WAVES;
    let waves = Waves::new(length, slope, SEED);
    // Paths meet wider lamps in less time.
    let lamp = fig.pick(0.3, 0.05);
    let twice = slab(size, lamp, &waves, false)?;
    let found = compare(fig, "slab", &twice, 2, effort)?;

    // ---- One face ----
    let once = slab(size, lamp, &waves, true)?;
    let of = |k: u64, method: Method| {
        let connections = Connections {
            bounces: 1,
            ..Connections::new(method)
        };
        measure(&once, connections, false, effort.other(k))
    };
    let (walks, set) = &found.sets[0];
    let (all, single) = (of(50, Method::Sms)?, of(51, Method::SmsBiased(*walks))?);
    let (both, one) = (found.share(set), single.mean() / all.mean());
    fig.check(
        format!("trial sets of {walks} lose more over two faces than over one"),
        both < one,
        format!("{both:.3} of the light is found, {one:.3} over one face"),
    );
    fig.check(
        "estimates take more trials over two faces than over one",
        found.sms.trials() > all.trials(),
        format!("{:.1} and {:.1}", found.sms.trials(), all.trials()),
    );
    fig.check(
        "no estimate ran out of trials, which would bias it",
        found.sms.found.exhausted == 0 && all.found.exhausted == 0,
        format!(
            "of {} and {}",
            found.sms.found.solutions, all.found.solutions
        ),
    );
    Ok(())
}
