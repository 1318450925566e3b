//! Where light comes from.

use crate::estimator::DetachedMis;
use crate::guide::Guide;
use crate::integrator::guide_training;
use crate::integrator::render::Progress;
use crate::sampler::{Family, Points, Spread};
use crate::scene::{Scene, Settings};

/// Paths of the last round, as far as one per pixel is not more.
const SAMPLES: usize = 1 << 18;
/// Rounds; each follows twice as many paths as the one before.
const ROUNDS: u32 = 3;

/// Learns where light comes from at diffuse surfaces, and sets it ([`Scene::set_guide`]): paths report what they met,
/// and those of each round are guided by what the round before has learned. Worth its time where light arrives
/// through water or by mirrors; not where all is lit by lamps in sight. It takes at least a sample per
/// pixel, and half a million paths. False, and the scene has what was known before, if a round met nothing or was
/// stopped.
pub fn guide(scene: &mut Scene, settings: &Settings, seed: u64, progress: &dyn Progress) -> bool {
    let settings = Settings {
        points: Points::Independent,
        ..*settings
    };
    let last = SAMPLES.div_ceil(scene.film.pixels().max(1)) as u64;
    let mut done = 0;
    for round in 1..=ROUNDS {
        let samples = done..done + last.div_ceil(1 << (ROUNDS - round));
        done = samples.end;
        let mut arrivals = guide_training::arrivals::<DetachedMis, Spread>(
            scene,
            &settings,
            Family::Pilots.seed(seed),
            samples,
            progress,
        );
        if progress.cancelled() || arrivals.is_empty() {
            return false;
        }
        scene.set_guide(Some(Guide::new(&mut arrivals)));
    }
    true
}
