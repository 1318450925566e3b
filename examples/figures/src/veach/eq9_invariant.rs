//! Basic radiance gives the same image of a pool [Veach 1996, section 3.1.4, Eq. 9].

use render::bsdf::kernel::Rules;
use render::integrator::density::Convention;
use render::integrator::render::Rendering;

use super::pool::{gather, pool};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// `veach-eq9-invariant`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width = fig.pick(64, 192);
    let spp = fig.pick(16, 64);
    fig.note("particles and viewing rays per pixel", spp);
    let (scene, _) = pool(width, 1.0)?;
    let radiance = gather(&scene, Rules::default(), Convention::Radiance, spp)?;
    let basic = gather(&scene, Rules::default(), Convention::Basic, spp)?;
    let scale = radiance.sums[0].iter().fold(0.0f64, |m, x| m.max(x.abs()));
    let largest = (radiance.sums[0].iter().zip(&basic.sums[0]))
        .map(|(a, b)| (a - b).abs() / (a.abs() + 1e-3 * scale))
        .fold(0.0, f64::max);
    fig.check(
        "L / eta^2 along viewing rays and the same rules as for importance: the image of plate 2 (a), to rounding (1e-5)",
        largest < 1e-5 && scale > 0.0,
        format!("largest relative difference {largest:.1e}"),
    );
    let counts = radiance.non_finite.count + basic.non_finite.count;
    fig.check(
        "no sample is lost",
        counts == 0,
        format!("{counts} not finite"),
    );
    fig.csv("difference", &["largest relative difference"], [[largest]]);
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, r: &Rendering| Panel::tonemapped(label, &r.image(0), 1.0).enlarged(enlarge);
    fig.images(
        "conventions",
        2,
        &[
            panel("radiance", &radiance),
            panel("basic radiance", &basic),
        ],
    );
    Ok(())
}
