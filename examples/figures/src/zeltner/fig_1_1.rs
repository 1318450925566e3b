//! A scene rendered forward and recovered backward [Zeltner 2021, figure 1.1].

use optim::Adam;
use render::Image;

use super::recovery::{
    START, STEPS, TARGET_SEED, bounded, descend, error, note, picture, report, setup,
};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// `zeltner-1-1`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let mut setup = setup(fig)?;
    note(fig, &setup);
    setup.problem.set(&START)?;
    let spp = fig.pick(128, 512);
    let before = picture(&setup.problem.scene, spp, TARGET_SEED + 1);
    let mut adam = bounded(Adam::new(3, 0.05)?)?;
    let (path, bad) = descend(&mut setup.problem, &mut adam, STEPS, 0.1)?;
    let (found, _) = path.last().ok_or("no steps")?;
    let e = error(found, &setup.truth);
    let most = fig.pick(0.03, 0.01);
    fig.check(
        format!(
            "the round trip recovers the albedo to {:.0} % in fewer than 100 Adam steps",
            100.0 * most
        ),
        e < most && STEPS < 100 && bad == 0,
        format!(
            "{STEPS} steps: {found:.4?}, truth {:.4?}, largest relative error {:.2} %",
            setup.truth,
            100.0 * e
        ),
    );
    let after = picture(&setup.problem.scene, spp, TARGET_SEED + 1);
    let panel = |label: &str, image: &Image| Panel::tonemapped(label, image, 1.0).enlarged(4);
    let panels = [
        panel("start", &before),
        panel("recovered", &after),
        panel("target", &setup.problem.targets[0].image),
    ];
    fig.images("forward-inverse", 3, &panels);
    report(fig, "steps", &path, &setup.truth);
    Ok(())
}
