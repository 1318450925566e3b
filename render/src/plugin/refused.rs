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
    ("bsdf", &["irawan"], "scattering by the threads of cloth is"),
    ("bsdf", &["hk"], MEDIA),
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
    ("film", &["specfilm"], "light by wavelength is"),
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
    (
        "integrator",
        &["volprim_rf_basic"],
        "fields of radiance in clouds of primitives are",
    ),
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
    ("shape", &["animatedinstance", "deformable"], SHUTTER),
    (
        "shape",
        &["curve", "hair"],
        "curves of other files than lists of control points are",
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
        &["vertexcolors"],
        "a texture that Mitsuba 3 has no more is",
    ),
    ("texture", &["volume"], "textures of space are"),
];

/// Attributes of others that stand for something which is left out: the element, and what they would need.
const ATTRIBUTES: &[(&str, &[&str], &str)] = &[
    (
        "shape",
        &["max_smooth_angle"],
        "normals that break where faces meet at an angle are",
    ),
    ("texture", &["channel"], "a single channel of an image is"),
    (
        "texture",
        &["wrap_mode_u", "wrap_mode_v"],
        "an image that goes on in another way along u than along v is",
    ),
];

const MEDIA: &str = "participating media are";
const POLARISATION: &str = "polarisation is";
const SHUTTER: &str = "motion while the shutter is open is";

/// What the plugin would need, if it is known to be left out: participating media whatever they are called.
pub(in crate::plugin) fn reason(tag: &str, plugin: &str) -> Option<&'static str> {
    match tag {
        "medium" | "phase" | "volume" => return Some(MEDIA),
        "subsurface" => return Some("scattering below surfaces is"),
        "animation" => return Some(SHUTTER),
        _ => {}
    }
    let found = (REFUSED.iter()).find(|(t, plugins, _)| *t == tag && plugins.contains(&plugin));
    found.map(|(.., what)| *what)
}

/// What an attribute that was not asked for would need, if it is known to be left out.
pub(in crate::plugin) fn attribute(tag: &str, name: &str) -> Option<&'static str> {
    let found = (ATTRIBUTES.iter()).find(|(t, names, _)| *t == tag && names.contains(&name));
    found.map(|(.., what)| *what)
}
