//! Scenes from Mitsuba XML files.

use std::path::Path;
use std::sync::Arc;

use super::builder::{Builder, MaterialId, out_of_reach};
use super::clip::Clip;
use super::{Connections, Constraint, Hints, Method, Scene, Settings};
use crate::accel::{Accel, MAX_COORDINATE};
use crate::bsdf::{Diffuse, Material};
use crate::camera::{Camera, FovAxis};
use crate::emitter::AnyEmitter;
use crate::error::{SceneError, quoted};
use crate::film::{Film, Lobed, MOST_LOBES, PixelFilter};
use crate::inputs;
use crate::plugin::Node;
use crate::plugin::xml::{Document, check_limit};
use crate::shape::{AnyShape, Shape};
use crate::texture;

/// How a scene file is loaded.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Values for the file's `$names`, instead of their defaults.
    pub defines: Vec<(String, String)>,
    /// Substitute mid-grey for missing texture files, with a warning, instead of failing.
    pub allow_missing: bool,
}

/// Size of a trial set that a file does not give [Zeltner 2021, figure 3.13].
const DEFAULT_TRIALS: u32 = 16;

/// Sums of so many pixels take three gigabytes.
const MAX_PIXELS: usize = 1 << 27;

/// Integrators that the path tracer is.
const INTEGRATORS: &[&str] = &["path", "direct", "prb"];
/// Those of [Zeltner et al. 2020] that leave out the light that manifold connections would find.
const FILTERED: &[&str] = &["path_filtered_ss", "path_filtered_ms"];
/// Those that find it.
const CONNECTED: &[&str] = &["path_sms_ss", "path_sms_ms"];
/// Other ways to the same image, or to its derivatives: the path tracer takes their place.
const OTHERS: &[&str] = &[
    "bdpt",
    "direct_projective",
    "direct_reparam",
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
    "volpath",
    "volpath_simple",
    "volpathmis",
];
/// Those that add something to the image of the integrator inside.
const WRAPPERS: &[&str] = &["adaptive", "aov", "moment"];
/// Those of light with a state that does not exist here, and what that is.
const REFUSED: &[(&str, &str)] = &[
    ("stokes", "polarisation"),
    ("transientpath", "time"),
    ("transientstokes", "polarisation"),
    ("transient_path", "time"),
];
const FILMS: &[&str] = &["hdrfilm"];
const FILTERS: &[&str] = &[
    "box",
    "gaussian",
    "tent",
    "mitchell",
    "catmullrom",
    "lanczos",
];
/// What does nothing at the root unless something refers to it.
const DECLARED: &[&str] = &["bsdf", "texture", "film", "sampler", "rfilter"];
/// Flags of the scenes of [Zeltner et al. 2020]: [`Hints`].
const RECEIVER: &[&str] = &["caustic_receiver"];
const SINGLE: &[&str] = &["caustic_caster_single", "caustic_emitter_single"];
const MULTI: &[&str] = &[
    "caustic_caster_multi",
    "caustic_bouncer",
    "caustic_emitter_multi",
];

impl Scene {
    /// Loads a scene; the second value lists what was ignored or substituted.
    ///
    /// # Errors
    /// Anything wrong with the file or the files it names, with its place.
    pub fn load(path: &Path, options: &LoadOptions) -> Result<(Self, Vec<String>), SceneError> {
        let (loaded, files) = inputs::during(|| {
            Self::from_document(&Document::load(path, &options.defines)?, options)
        });
        let (mut scene, warnings) = loaded?;
        scene.files = files;
        Ok((scene, warnings))
    }

    /// [`Scene::load`] from the text of a scene file; file names in it are relative to `base`.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn from_xml(
        text: &str,
        base: &Path,
        options: &LoadOptions,
    ) -> Result<(Self, Vec<String>), SceneError> {
        Self::from_document(&Document::from_str(text, base, &options.defines)?, options)
    }

    fn from_document(
        document: &Document,
        options: &LoadOptions,
    ) -> Result<(Self, Vec<String>), SceneError> {
        let root = document.root();
        let mut build = Builder::new();
        build.registry().allow_missing = options.allow_missing;
        let mut settings = Settings::default();
        if let Some(node) = root.child_with_tag("integrator")? {
            integrator(node, &mut settings)?;
        }
        let sensor = root
            .child_with_tag("sensor")?
            .ok_or_else(|| root.missing("sensor", "a perspective sensor"))?;
        let clip = Clip::from_node(sensor)?;
        let (camera, film) = sensor_from_node(sensor, &mut settings)?;
        let mut defaults = [None; 2];
        let shapes = root.children_with_tag("shape");
        for (i, node) in shapes.iter().enumerate() {
            shape(node, i, &mut build, &mut defaults)?;
        }
        warn_of_coordinates(&shapes, &build);
        for node in root.children_with_tag("emitter") {
            // An area light out here is a declaration that shapes refer to.
            if node.plugin == "area" && node.id.is_some() {
                continue;
            }
            let name = node.id.clone().unwrap_or_else(|| "emitter".into());
            let emitter = build
                .registry()
                .within(&name, None, |r| AnyEmitter::from_node(node, r))?;
            let weight = sampling_weight(node)?;
            let hints = hints(node)?;
            node.finish()?;
            build.add_weighted_emitter(emitter, None, weight);
            build.hint_emitter(hints);
        }
        for tag in DECLARED {
            for node in root.children_with_tag(tag) {
                declaration(node)?;
            }
        }
        root.finish()?;
        let mut of_builder = std::mem::take(&mut build.registry().warnings);
        let scene = build.build(camera, film, settings)?;
        clip.check(sensor, &scene)?;
        let mut warnings: Vec<String> = document
            .warnings()
            .iter()
            .map(ToString::to_string)
            .collect();
        warnings.append(&mut of_builder);
        Ok((scene, warnings))
    }
}

/// Checks what may never be built, for want of a reference to it.
fn declaration(node: &Node) -> Result<(), SceneError> {
    if node.id.is_none() {
        return Err(node.missing("id", "a name for others to refer to"));
    }
    known_plugins(node)
}

/// An error for the first plugin in a declaration that does not exist.
fn known_plugins(node: &Node) -> Result<(), SceneError> {
    if node.is_constant() {
        return Ok(());
    }
    let known = match node.tag.as_str() {
        "bsdf" => Material::PLUGINS.concat(),
        "texture" => texture::PLUGINS.to_vec(),
        "film" => FILMS.to_vec(),
        "rfilter" => FILTERS.to_vec(),
        // Any sampler will do.
        _ => return Ok(()),
    };
    if !known.contains(&node.plugin.as_str()) {
        return Err(node.unknown_plugin(&known));
    }
    node.children()
        .try_for_each(|(_, child)| known_plugins(child))
}

fn integrator(mut node: &Node, settings: &mut Settings) -> Result<(), SceneError> {
    while WRAPPERS.contains(&node.plugin.as_str()) {
        let Some(inside) = node.child_with_tag("integrator")? else {
            return Err(node.missing("integrator", "one inside, whose image it is"));
        };
        node.warn("only the image of the integrator inside is made");
        node.ignore_rest();
        node = inside;
    }
    let plugin = node.plugin.as_str();
    if let Some((_, state)) = REFUSED.iter().find(|(name, _)| *name == plugin) {
        return Err(SceneError::Value {
            location: node.location.clone(),
            key: "integrator".to_owned(),
            expected: format!("one of light without {state}, which is not there"),
            found: quoted(plugin),
        });
    }
    let replaced = OTHERS.contains(&plugin);
    let of_manifolds = FILTERED.contains(&plugin) || CONNECTED.contains(&plugin);
    if !(INTEGRATORS.contains(&plugin) || of_manifolds || replaced) {
        let known = [INTEGRATORS, FILTERED, CONNECTED, OTHERS, WRAPPERS].concat();
        return Err(node.unknown_plugin(&known));
    }
    let depth = |key: &str, default: i64| -> Result<u32, SceneError> {
        match node.integer_or(key, default)? {
            -1 => Ok(u32::MAX),
            d @ 0..=0xffff_ffff => Ok(d as u32),
            _ => Err(node.invalid(key, "-1 for no limit, or a non-negative integer")),
        }
    };
    // The defaults of Mitsuba 3.
    let deepest = if plugin.starts_with("direct") {
        2
    } else if plugin.starts_with("prb") {
        6
    } else {
        -1
    };
    settings.max_depth = depth("max_depth", deepest)?;
    settings.rr_depth = depth("rr_depth", 5)?;
    if node.boolean_or("hide_emitters", false)? {
        return Err(node.invalid("hide_emitters", "false: lamps are always seen"));
    }
    if of_manifolds {
        settings.connections = Some(connections(node)?);
    }
    if replaced {
        node.warn("traced like `path` instead: the same image, but for its noise");
        node.ignore_rest();
    }
    node.ignore(&["samples_per_pass", "block_size"], Node::integer)?;
    let samples = ["shading_samples", "emitter_samples", "bsdf_samples"];
    node.ignore(&samples, Node::integer)?;
    node.ignore(&["timeout"], Node::float)?;
    node.finish()
}

/// How manifold connections are made, or left out.
fn connections(node: &Node) -> Result<Connections, SceneError> {
    let plugin = node.plugin.as_str();
    let most = i64::from(Connections::MOST_BOUNCES);
    let bounces = if plugin.ends_with("_ms") {
        node.integer_in("bounces", 2, 1..=most)? as u32
    } else {
        1
    };
    node.boolean("disable_reflected_emitters")?;
    if FILTERED.contains(&plugin) {
        return Ok(Connections {
            bounces,
            ..Connections::new(Method::LeftOut)
        });
    }
    let trials = match node.integer("max_trials")? {
        None | Some(-1) => None,
        Some(n @ 1..=0xffff_ffff) => Some(n as u32),
        Some(_) => return Err(node.invalid("max_trials", "-1 for no limit, or a positive number")),
    };
    let biased = node.boolean_or("biased", false)?;
    // With a fallback to paths or without: here chains are never left to those.
    let alone = node.boolean_or("biased_mnee", false)?;
    let aimed = node.boolean_or("mnee_init", false)? || alone;
    let method = match (biased, aimed) {
        (_, true) => Method::Mnee,
        (true, false) => Method::SmsBiased(trials.unwrap_or(DEFAULT_TRIALS)),
        (false, false) => Method::Sms,
    };
    if node.boolean_or("twostage", false)? {
        node.warn("`twostage`: walks have one stage, which changes their number");
    }
    let constraint = if node.boolean_or("halfvector_constraints", false)? {
        Constraint::HalfVector
    } else {
        Constraint::Angle
    };
    if node.float("uniqueness_threshold")?.is_some() {
        node.warn("`uniqueness_threshold`: solutions are told apart by proof");
    }
    node.ignore(&["max_iterations"], Node::integer)?;
    node.ignore(&["solver_threshold"], Node::float)?;
    Ok(Connections {
        bounces,
        constraint,
        budget: trials.unwrap_or(u32::MAX),
        ..Connections::new(method)
    })
}

fn sensor_from_node(node: &Node, settings: &mut Settings) -> Result<(Camera, Film), SceneError> {
    if node.plugin != "perspective" {
        return Err(node.unknown_plugin(&["perspective"]));
    }
    let film = match node.child_with_tag("film")? {
        Some(film) => film_from_node(film)?,
        None => Film::new(768, 576),
    };
    if let Some(sampler) = node.child_with_tag("sampler")? {
        if sampler.plugin != "independent" {
            sampler.warn("every sampler is replaced by independent samples");
        }
        settings.spp = sampler.integer_in("sample_count", 16, 1..=1 << 30)? as u32;
        sampler.ignore_rest();
    }
    let given = node.choice(
        "fov_axis",
        &[
            ("x", FovAxis::X),
            ("y", FovAxis::Y),
            ("diagonal", FovAxis::Diagonal),
            ("smaller", FovAxis::Smaller),
            ("larger", FovAxis::Larger),
        ],
    )?;
    let length = node.string_or("focal_length", "50mm")?;
    let (fov, axis) = match node.float("fov")? {
        Some(_) if node.has("focal_length") => {
            return Err(node.invalid("focal_length", "none beside `fov`"));
        }
        Some(fov) => (fov, given.unwrap_or_default()),
        None => {
            let number = length.trim().trim_end_matches("mm").trim_end();
            let millimetres = number.parse::<f64>().ok().filter(|l| *l > 0.0);
            let millimetres = millimetres
                .ok_or_else(|| node.invalid("focal_length", "a length such as `50mm`"))?;
            // Of 35 mm film, 36 mm x 24 mm, along its diagonal; 50 mm is the default of Mitsuba.
            let fov = 2.0 * (36.0f64.hypot(24.0) / (2.0 * millimetres)).atan();
            (fov.to_degrees(), FovAxis::Diagonal)
        }
    };
    let to_world = node.transform("to_world")?.unwrap_or_default();
    let camera = Camera::new(to_world, fov, axis, film.size).map_err(|e| match e {
        SceneError::Parameter { key, expected, .. } => node.invalid(&key, &expected),
        other => other,
    })?;
    node.ignore(&["focus_distance"], Node::float)?;
    node.finish()?;
    Ok((camera, film))
}

fn film_from_node(node: &Node) -> Result<Film, SceneError> {
    if !FILMS.contains(&node.plugin.as_str()) {
        return Err(node.unknown_plugin(FILMS));
    }
    let size = |key, default| node.integer_in(key, default, 1..=1 << 16).map(|x| x as u32);
    let (width, height) = (size("width", 768)?, size("height", 576)?);
    let offset = |key, limit: u32| {
        node.integer_in(key, 0, 0..=i64::from(limit) - 1)
            .map(|x| x as u32)
    };
    let (x, y) = (
        offset("crop_offset_x", width)?,
        offset("crop_offset_y", height)?,
    );
    let extent = |key, limit: u32| {
        node.integer_in(key, i64::from(limit), 1..=i64::from(limit))
            .map(|x| x as u32)
    };
    let crop_size = [
        extent("crop_width", width - x)?,
        extent("crop_height", height - y)?,
    ];
    let [w, h] = crop_size.map(|n| n as usize);
    check_limit(w * h, MAX_PIXELS, "pixels", &node.location)?;
    let filter = match node.child_with_tag("rfilter")? {
        None => PixelFilter::Gaussian { stddev: 0.5 },
        Some(filter) => filter_from_node(filter)?,
    };
    // Images hold three colours.
    node.choice("pixel_format", &[("rgb", ()), ("rgba", ())])?;
    node.ignore(&["component_format", "file_format"], Node::string)?;
    let flags = [
        "attach_log",
        "banner",
        "compensate",
        "high_quality_edges",
        "sample_border",
    ];
    node.ignore(&flags, Node::boolean)?;
    node.finish()?;
    Ok(Film {
        size: [width, height],
        crop_offset: [x, y],
        crop_size,
        filter,
    })
}

fn filter_from_node(node: &Node) -> Result<PixelFilter, SceneError> {
    let length = |key: &str, default: f64| match node.float_or(key, default)? {
        x if x > 0.0 && x <= 100.0 => Ok(x),
        _ => Err(node.invalid(key, "a number of pixels in (0, 100]")),
    };
    // The authors' letters, which scene files spell in either case.
    let third = |key: &'static str, capital: &'static str| {
        let key = if node.has(capital) { capital } else { key };
        node.float_in(key, 1.0 / 3.0, 0.0..=1.0)
    };
    let cubic = |b: f64, c: f64| {
        let lobed = Lobed::cubic(b, c).map(PixelFilter::Lobed);
        lobed.ok_or_else(|| node.invalid("b", "a number from 0 to 1"))
    };
    let filter = match node.plugin.as_str() {
        "box" => PixelFilter::Box,
        "gaussian" => PixelFilter::Gaussian {
            stddev: length("stddev", 0.5)?,
        },
        "tent" => PixelFilter::Tent {
            radius: length("radius", 1.0)?,
        },
        "mitchell" => cubic(third("b", "B")?, third("c", "C")?)?,
        "catmullrom" => cubic(0.0, 0.5)?,
        "lanczos" => {
            let lobes = node.integer_in("lobes", 3, 1..=i64::from(MOST_LOBES))?;
            let lobed = Lobed::lanczos(lobes as u32).map(PixelFilter::Lobed);
            lobed.ok_or_else(|| node.invalid("lobes", "a number of zeros"))?
        }
        _ => return Err(node.unknown_plugin(FILTERS)),
    };
    node.finish()?;
    Ok(filter)
}

/// Shapes smaller than so many roundings of their coordinates are not seen as they are: rays that leave a surface
/// start some way off it, and what is near is lit by a few percent too much or too little.
const FEWEST_ROUNDINGS: f64 = 1024.0;
/// Triangles smaller than so many have normals of their own making.
const FEWEST_ROUNDINGS_OF_TRIANGLES: f64 = 16.0;

/// Warns of shapes far from the origin that are too small for single precision there: of the worst one, with the number
/// of the others. `nodes` are those of the builder's shapes.
fn warn_of_coordinates(nodes: &[&Arc<Node>], build: &Builder) {
    let mut worst: Option<(f64, &AnyShape, &Node)> = None;
    let mut count = 0;
    for (shape, &node) in build.shapes().iter().zip(nodes) {
        let rounding = rounding(shape);
        let mut roundings = shape.area().sqrt() / rounding / FEWEST_ROUNDINGS;
        if let Some(size) = size_of_triangles(shape) {
            roundings = roundings.min(size / rounding / FEWEST_ROUNDINGS_OF_TRIANGLES);
        }
        if roundings < 1.0 {
            count += 1;
            if worst.is_none_or(|(least, ..)| roundings < least) {
                worst = Some((roundings, shape, node));
            }
        }
    }
    let Some((_, shape, node)) = worst else {
        return;
    };
    let name = node.id.as_deref().map(|id| format!("{} ", quoted(id)));
    let triangles = size_of_triangles(shape).map(|s| format!(", with triangles of {s:.1e}"));
    let others = match count - 1 {
        0 => String::new(),
        more => format!("; so it is with {more} more shapes"),
    };
    node.warn(format!(
        "{}about {:.1e} large{} is too small for coordinates of {:.1e}, which single precision resolves to {:.1e}: \
         its light will be wrong by percents{others}. Move the scene to the origin",
        name.unwrap_or_default(),
        shape.area().sqrt(),
        triangles.unwrap_or_default(),
        shape.extent(),
        2.0 * rounding(shape),
    ));
}

/// Largest rounding of a shape's coordinates.
fn rounding(shape: &AnyShape) -> f64 {
    f64::from(shape.extent()) * f64::from(f32::EPSILON) / 2.0
}

/// About as long as the sides of the triangles of a mesh.
fn size_of_triangles(shape: &AnyShape) -> Option<f64> {
    let AnyShape::Mesh(mesh) = shape else {
        return None;
    };
    Some((2.0 * mesh.area() / mesh.data().triangles.len() as f64).sqrt())
}

/// What a shape or an emitter is to manifold connections.
fn hints(node: &Node) -> Result<Hints, SceneError> {
    // Glints are not told from other reflections.
    node.ignore(&["glinty"], Node::boolean)?;
    let any = |keys: &[&str]| {
        let mut any = false;
        for key in keys {
            any |= node.boolean_or(key, false)?;
        }
        Ok::<bool, SceneError>(any)
    };
    Ok(Hints {
        receiver: any(RECEIVER)?,
        single: any(SINGLE)?,
        multi: any(MULTI)?,
    })
}

/// How often an emitter is sampled, relative to the others.
fn sampling_weight(node: &Node) -> Result<f64, SceneError> {
    match node.float_or("sampling_weight", 1.0)? {
        weight if weight > 0.0 && weight.is_finite() => Ok(weight),
        _ => Err(node.invalid("sampling_weight", "a positive number")),
    }
}

fn shape(
    node: &Arc<Node>,
    index: usize,
    build: &mut Builder,
    defaults: &mut [Option<MaterialId>; 2],
) -> Result<(), SceneError> {
    let name = node.id.clone().unwrap_or_else(|| format!("shape{index}"));
    let geometry = AnyShape::from_node(node, build.registry())?;
    // The builder would complain too, but knows no line.
    if geometry.extent() > MAX_COORDINATE {
        Accel::build(&geometry.primitives())
            .map_err(|e| out_of_reach(&node.plugin, &e).at(&node.location))?;
    }
    let emitter_node = node.child_with_tag("emitter")?;
    let emits = emitter_node.is_some();
    let material = match node.child_with_tag("bsdf")? {
        Some(bsdf) => {
            let m = build
                .registry()
                .within(&name, None, |r| r.material_from_node(bsdf, "bsdf"))?;
            build.add_shared_material(m)
        }
        None => {
            // As in Mitsuba 3, lamps reflect nothing unless they say so.
            let (kind, name, albedo) = if emits {
                (1, "default_lamp_bsdf.reflectance.value", 0.0)
            } else {
                (0, "default_bsdf.reflectance.value", 0.5)
            };
            match defaults[kind] {
                Some(id) => id,
                None => {
                    let reflectance = build.rgb(name, [albedo; 3], (0.0, 1.0))?;
                    *defaults[kind].insert(build.add_material(Diffuse { reflectance }))
                }
            }
        }
    };
    let emitter = match emitter_node {
        Some(e) => {
            let next = build.shapes().len() as u32;
            let emitter =
                (build.registry()).within(&format!("{name}.emitter"), Some(next), |r| {
                    AnyEmitter::from_node(e, r)
                })?;
            let weight = sampling_weight(e)?;
            let hints = hints(e)?;
            e.finish()?;
            Some((emitter, weight, hints))
        }
        None => None,
    };
    let of_shape = hints(node)?;
    node.finish()?;
    let shape = build.add_shape(&name, geometry, material);
    build.hint_shape(of_shape);
    if let Some((e, weight, hints)) = emitter {
        build.add_weighted_emitter(e, Some(shape), weight);
        build.hint_emitter(hints);
    }
    Ok(())
}
