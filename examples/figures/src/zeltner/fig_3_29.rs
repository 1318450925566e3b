//! [Zeltner 2021, figure 3.29]: light through a slab of glass with waves on both faces, by paths, by one walk towards the light,
//! by unbiased estimates and by trial sets.
//!
//! Chains of the figure are refracted twice. The renderer looks for all chains of up to two vertices; others than those are
//! blocked by the frame of the slab, or end where there is no lamp.

use ad_core::Vec3;
use render::scene::{Method, Starts};

use super::authors::{Authors, attribute, compare_methods};
use super::manifold_comparison::compare;
use super::manifold_methods::{Effort, measure, single};
use super::manifold_scenes::{Waves, slab};
use examples::figure::{Figure, Result};

const SEED: u64 = 329;
/// Wavelength and slopes of the waves.
const WAVES: [f64; 2] = [1.0, 0.16];

/// `zeltner-3-29`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(8, 48);
    let effort = Effort::of(fig, [2, 16], SEED);
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
        let connections = single(method, Starts::Particles);
        measure(&once, connections, false, effort.other(k))
    };
    let (walks, set) = &found.sets[0];
    let (all, part) = (of(50, Method::Sms)?, of(51, Method::SmsBiased(*walks))?);
    let (both, one) = (found.share(set), part.mean() / all.mean());
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
    published(fig)
}

/// The missing face of the authors' slab, from the text of the other one: its mirror image, displaced by waves, as the edge of the
/// frame around it is.
fn wavy(other: &str, waves: &Waves) -> Result<String> {
    /// Where it lies, so that the middle is between both edges of the frame.
    const PLACE: f64 = 0.01;
    let mut mesh = String::new();
    for line in other.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => {
                let at = words
                    .map(str::parse)
                    .collect::<std::result::Result<Vec<f64>, _>>()?;
                let [x, y, _] = at[..] else {
                    return Err(format!("expected a point, found `{line}`").into());
                };
                let z = PLACE + waves.height(Vec3::new(x, y, 0.0));
                mesh += &format!("v {x} {y} {z}\n");
            }
            Some("f") => {
                let corners = words.filter_map(|w| w.split('/').next());
                let turned: Vec<&str> = corners.collect::<Vec<_>>().into_iter().rev().collect();
                mesh += &format!("f {}\n", turned.join(" "));
            }
            _ => {}
        }
    }
    Ok(mesh)
}

/// The slab of the authors, where it is.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let folder = "Figure_18_DoubleRefraction";
    let other = authors.read(&format!("{folder}/meshes/plane_2.obj"))?;
    let [length, slope] = [0.7, 0.16];
    let mesh = wavy(&other, &Waves::new(length, slope, SEED))?;
    fig.write("plane_1.obj", mesh.as_bytes());
    let path = attribute(&std::path::absolute(fig.path("plane_1.obj"))?);
    let file = format!("{folder}/slab_sms.xml");
    let changes = [("meshes/plane_1.obj", path.as_str())];
    let of = authors.scene(fig, "authors' slab", &file, fig.pick(16, 48), &changes)?;
    fig.note(
        "authors' slab: plane_1.obj",
        "plane_2.obj, mirrored and displaced by waves",
    );
    let effort = Effort::of(fig, [1, 4], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.4), (1 << 18, 0.1));
    compare_methods(fig, &of, 2, effort, accuracy)?;
    Ok(())
}
