//! What stands in for plugins of others.

use crate::plugin::Node;

/// Other ways to the same image, or to its derivatives: the path tracer takes their place.
pub(super) const OTHERS: &[&str] = &[
    "bdpt",
    "direct_projective",
    "direct_reparam",
    "emission_reparam",
    "erpt",
    "manifold_path_guiding",
    "mlt",
    "photonmapper",
    "ppm",
    "prb_basic",
    "prb_projective",
    "prb_reparam",
    "prbvolpath",
    "pssmlt",
    "ptracer",
    "sppm",
    "transient_path",
    "transientpath",
    "volpath",
    "volpath_simple",
    "volpathmis",
    "vpl",
];
/// Those that add something to the image of the integrator inside.
pub(super) const WRAPPERS: &[&str] = &["adaptive", "aov", "irrcache", "moment"];

/// What an integrator that the path tracer stands in for keeps.
const OF_PATHS: &[&str] = &["max_depth", "rr_depth", "hide_emitters"];
/// What a film keeps.
const OF_FILMS: &[&str] = &[
    "width",
    "height",
    "crop_offset_x",
    "crop_offset_y",
    "crop_width",
    "crop_height",
    "pixel_format",
];

/// Whether a node is written as the plugin that stands in for it, which knows these attributes only.
pub(super) fn stand_in(node: &Node) -> Option<(&'static str, &'static [&'static str])> {
    let plugin = node.plugin.as_str();
    match node.tag.as_str() {
        // `direct` of Mitsuba 3 has no depth.
        "integrator"
            if OTHERS.contains(&plugin)
                || plugin == "prb"
                || plugin == "direct" && node.has("max_depth") =>
        {
            Some(("path", OF_PATHS))
        }
        "sampler" => Some(("independent", &["sample_count"])),
        "film" => Some(("hdrfilm", OF_FILMS)),
        _ => None,
    }
}
