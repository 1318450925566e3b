//! What figures share that set two ways to the same image and its derivatives against each other.

use render::RenderError;
use render::integrator::render::Rendering;

use crate::statistics::{Series, grey};
use examples::chart::{LineChart, Panel};
use examples::ranks::percentile;

/// Independent images of `width` columns, each above its derivative, from so many samples per pixel: `image(0..runs)`.
///
/// # Errors
/// Those of `image`.
pub(super) fn series(
    width: u32,
    runs: u64,
    spp: u64,
    image: impl Fn(u64) -> Result<Rendering, RenderError> + Sync + Send,
) -> Result<Series, RenderError> {
    Series::of(runs, [width as usize, 8], |run| {
        let r = image(run)?;
        Ok([0, 1].map(|k| grey(&r.sums[k], 1.0 / spp as f64)).concat())
    })
}

/// Images and their derivatives side by side, with the labels of both, from so many samples per pixel. The colours of all
/// derivatives have the scale of the first.
pub(super) fn panels(found: &[([String; 2], Rendering)], spp: u64) -> Vec<Panel> {
    let mut panels = Vec::new();
    let mut scale = None;
    for ([label, label_of_change], r) in found {
        let change = grey(&r.sums[1], 1.0 / spp as f64);
        let most = *scale.get_or_insert_with(|| percentile(&change, 0.98));
        let image = Panel::tonemapped(label, &r.image(0), 1.0);
        let change = Panel::signed(label_of_change, r.width, &change, Some(most));
        let enlarge = (384 / r.width).max(1);
        panels.extend([image, change].map(|p| p.enlarged(enlarge)));
    }
    panels
}

/// A chart of the noise of a derivative against time.
pub(super) fn noise_over_time(what: &str, time: &str) -> LineChart {
    let title = format!("derivative in {what}");
    LineChart::new(&title, time, "standard deviation of a run")
        .log_x()
        .log_y()
}
