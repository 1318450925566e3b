//! Plugins of others that stand for something which is left out.

/// The element, the names of its plugins, and what they would need, with its verb.
const REFUSED: &[(&str, &[&str], &str)] = &[
    (
        "bsdf",
        &[
            "circular",
            "measured_polarized",
            "polarizer",
            "pplastic",
            "retarder",
        ],
        POLARISATION,
    ),
    (
        "bsdf",
        &["coating", "roughcoating"],
        "layers over other materials are",
    ),
    ("bsdf", &["difftrans"], "diffuse transmission is"),
    ("bsdf", &["hair", "irawan"], "scattering by fibres is"),
    ("bsdf", &["hk"], MEDIA),
    (
        "bsdf",
        &["principledthin"],
        "the model of Disney for thin surfaces is",
    ),
    ("bsdf", &["measured", "bsdf_merl"], "measured materials are"),
    (
        "bsdf",
        &["mixturebsdf"],
        "a sum of materials other than `blendbsdf` is",
    ),
    (
        "bsdf",
        &["roughconductor_heitz", "roughdielectric_heitz"],
        "scattering between the facets of a rough surface is",
    ),
    (
        "bsdf",
        &["phong", "roughdiffuse", "ward"],
        "a model of roughness that Mitsuba 3 has no more is",
    ),
    ("emitter", &["collimated"], "light of a single ray is"),
    ("emitter", &["volumelight"], MEDIA),
    (
        "emitter",
        &["sky", "sun", "sunsky", "timed_sunsky"],
        "models of the sky are",
    ),
    (
        "film",
        &["ldrfilm", "mfilm"],
        "an image of another kind than OpenEXR is",
    ),
    ("film", &["specfilm"], "light by wavelength is"),
    ("film", &["streakhdrfilm", "transient_hdr_film"], TIME),
    (
        "integrator",
        &["ao", "depth", "field", "motion"],
        "a picture of something else than light is",
    ),
    (
        "integrator",
        &["multichannel"],
        "several pictures in one image are",
    ),
    ("integrator", &["stokes"], POLARISATION),
    ("integrator", &["transient_path", "transientpath"], TIME),
    ("integrator", &["transientstokes"], POLARISATION),
    ("sensor", &["batch"], "several views in one image are"),
    (
        "sensor",
        &[
            "distant",
            "fluencemeter",
            "irradiancemeter",
            "mdistant",
            "radiancemeter",
        ],
        "sensors without a lens are",
    ),
    (
        "sensor",
        &["perspective_rdist", "spherical", "telecentric"],
        "projections by other lenses than thin ones are",
    ),
    (
        "shape",
        &["bsplinecurve", "curve", "hair", "linearcurve"],
        "curves are",
    ),
    (
        "shape",
        &["ellipsoids", "ellipsoidsmesh"],
        "clouds of Gaussians are",
    ),
    ("shape", &["heightfield"], "height fields are"),
    ("shape", &["sdfgrid"], "signed distance fields are"),
    (
        "texture",
        &["curvature", "gridtexture", "wireframe"],
        "textures that are computed, other than `checkerboard`, are",
    ),
    (
        "texture",
        &["scale", "vertexcolors"],
        "a texture that Mitsuba 3 has no more is",
    ),
    ("texture", &["volume"], "textures of space are"),
];

const MEDIA: &str = "participating media are";
const POLARISATION: &str = "polarisation is";
const TIME: &str = "the time that light takes is";

/// What the plugin would need, if it is known to be left out: participating media whatever they are called.
pub(in crate::plugin) fn reason(tag: &str, plugin: &str) -> Option<&'static str> {
    if matches!(tag, "medium" | "phase" | "volume") {
        return Some(MEDIA);
    }
    let found = (REFUSED.iter()).find(|(t, plugins, _)| *t == tag && plugins.contains(&plugin));
    found.map(|(.., what)| *what)
}
