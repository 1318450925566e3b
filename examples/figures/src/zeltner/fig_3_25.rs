//! [Zeltner 2021, figure 3.25]: a wall of bumpy metal and a half-buried ball of bumpy glass, by paths, by one walk towards the
//! light, by unbiased estimates and by trial sets.

use render::scene::{Method, Starts};

use super::authors::{Authors, compare_methods};
use super::manifold_comparison::compare;
use super::manifold_methods::{Effort, correlation, measure, single};
use super::manifold_scenes::{Waves, bumpy, glass, half_ball, mapped_ball, metal, mirrored};
use examples::figure::{Figure, Result};

const SEED: u64 = 325;

/// `zeltner-3-25`.
///
/// # Errors
/// None that the built-in scenes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(12, 48);
    // Paths meet wider lamps in less time.
    let lamp = fig.pick(0.75, 0.15);
    let plane = mirrored(lamp, 67.5 / (lamp * lamp), size, |b| {
        let smooth = metal(b)?;
        bumpy(b, smooth, 0.1, SEED)
    })?;
    let sphere = half_ball(size, fig.pick(1.5, 0.2), |b, radius| {
        let smooth = glass(b)?;
        let waves = Waves::new(3.0, 0.07, SEED);
        let material = mapped_ball(b, radius, &waves, 128, smooth)?;
        b.ball("ball", [0.0; 3], radius, &material)?;
        Ok(())
    })?;
    let effort = Effort::of(fig, [2, 16], SEED);
    effort.note(fig, size);
    let wall = compare(fig, "wall", &plane, 1, effort)?;
    let left = wall.share(&wall.mnee);
    fig.check(
        "wall: one walk to the middle of the metal finds less than half of the light",
        left < 0.5,
        format!("{left:.3} of it"),
    );
    // What is missing is the same in independent images, of independent references.
    let (walks, set) = &wall.sets[0];
    let again = |k: u64, method: Method| {
        let connections = single(method, Starts::Uniform);
        measure(&plane, connections, false, effort.other(k))
    };
    let (few, all) = (
        again(30, Method::SmsBiased(*walks))?,
        again(31, Method::Sms)?,
    );
    let alike = correlation([set, &wall.sms], [&few, &all]);
    fig.check(
        format!("wall: what trial sets of {walks} miss is the same for other seeds"),
        alike > 0.5,
        format!("correlation of blocks {alike:.3}"),
    );
    compare(fig, "ball", &sphere, 1, effort)?;
    published(fig)
}

/// The plane and the ball of the authors, where they are.
fn published(fig: &mut Figure) -> Result {
    let Some(authors) = Authors::find() else {
        return Ok(());
    };
    let effort = Effort::of(fig, [1, 4], 2 * SEED);
    let accuracy = fig.pick((1 << 14, 0.4), (1 << 18, 0.1));
    for (name, file) in [
        (
            "authors' plane",
            "Figure_14_15_MainComparison/plane_sms.xml",
        ),
        (
            "authors' ball",
            "Figure_14_15_MainComparison/sphere_sms.xml",
        ),
    ] {
        let of = authors.scene(fig, name, file, fig.pick(16, 48), &[])?;
        let found = compare_methods(fig, &of, 1, effort, accuracy)?;
        if name == "authors' plane" {
            let [share, error] = found.share(0);
            fig.check(
                "authors' plane: one walk to the middle of the metal finds less than half of the light",
                share < 0.5,
                format!("{share:.3} ± {error:.3} of it"),
            );
        }
    }
    Ok(())
}
