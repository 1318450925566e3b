//! Figure 2: piecewise-constant solutions without importance, and the path tracer.

use render::finite_element::FiniteElements;

use super::boxes::{
    self, Step, Which, average, difference, mask, noiseless_patch_difference, patch_difference,
    refine, traced,
};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

const SEED: u64 = 2;
/// Patches along one side of a surface.
const CELLS: f64 = 8.0;
/// Refinement stops when patches change by less than this.
const LIMIT: f64 = 0.01;

/// `christensen-02`.
///
/// # Errors
/// None that the boxes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(64, 128);
    let spp = 256;
    fig.note("spp", spp);
    fig.note("seed", SEED);
    let mut rows = Vec::new();
    let mut panels = Vec::new();
    for which in [Which::B, Which::D] {
        let scene = boxes::scene(which, size, 0)?;
        let letter = which.letter();
        // Two quiet steps in a row: coarse models may agree by chance.
        let mut moved = [f64::INFINITY; 2];
        let most = fig.pick(9, 14);
        let options = boxes::options(false);
        let coarse = FiniteElements::new(&scene, options)?;
        let inside = mask(&coarse);
        let (model, steps) = refine(&scene, options, 0.02, |steps: &[Step]| {
            if let [.., a, b] = steps {
                moved = [moved[1], patch_difference(&coarse, &b.flat, &a.flat, CELLS)];
            }
            moved.iter().all(|m| *m < LIMIT) || steps.len() >= most
        })?;
        let Some(end) = steps.last() else { continue };
        for pair in steps.windows(2) {
            let [a, b] = [&pair[0].flat, &pair[1].flat];
            rows.push([
                f64::from(u8::from(which == Which::D)),
                pair[1].size.links() as f64,
                patch_difference(&coarse, b, a, CELLS),
                difference(b, a, &inside),
                pair[1].seconds,
            ]);
        }
        fig.check(
            format!("({letter}) refinement stops: successive pictures differ by less than 1 %"),
            moved.iter().all(|m| *m < fig.pick(3.0, 1.0) * LIMIT),
            format!(
                "{:.2} % and {:.2} % over patches after {} steps, {} links, {} elements, {:.1} MB, {:.1} s",
                100.0 * moved[0],
                100.0 * moved[1],
                steps.len() - 1,
                end.size.links(),
                end.size.elements,
                end.size.bytes as f64 * 1e-6,
                end.seconds
            ),
        );
        let reference = traced(&scene, SEED, spp);
        let [r, s] = &reference;
        let compare = |picture| noiseless_patch_difference(&model, picture, [r, s], CELLS);
        // Elements larger than a patch: read between their corners.
        let ((flat, _), (off, patches)) = (compare(&end.flat), compare(&end.interpolated));
        fig.check(
            format!("({letter}) patches agree with the path tracer within 3 % RMS"),
            off.most < fig.pick(0.04, 0.03),
            format!(
                "{off} over {patches} patches, {flat} without interpolation; noise of the path tracer taken out"
            ),
        );
        let exposure = if which == Which::D { 6.0 } else { 1.0 };
        let enlarge = 320usize.div_ceil(size as usize);
        let panel =
            |label: String, image| Panel::tonemapped(&label, image, exposure).enlarged(enlarge);
        panels.push(panel(format!("({letter}) finite elements"), &end.flat));
        panels.push(panel(
            format!("({letter}) path tracer"),
            &average(&reference),
        ));
    }
    fig.csv(
        "steps",
        &[
            "d",
            "links",
            "change of patches",
            "change of pixels",
            "seconds",
        ],
        rows,
    );
    fig.images("flat", 2, &panels);
    Ok(())
}
