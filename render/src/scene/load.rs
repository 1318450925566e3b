//! Scenes from Mitsuba XML files.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use super::builder::{Builder, MaterialId, out_of_reach};
use super::clip::Clip;
use super::precision;
use super::published::{self, CONNECTED, FILTERED, GLINTY};
use super::save::{Place, Places, Source};
use super::sensor::sensor_called;
use super::stand_ins::{OTHERS, WRAPPERS};
use super::{Hints, Scene, Sensor, Settings};
use crate::accel::{Accel, MAX_COORDINATE};
use crate::bsdf::{Diffuse, Material};
use crate::camera::Camera;
use crate::emitter::{AnyEmitter, DirectionalArea};
use crate::error::SceneError;
use crate::film::{Film, Lobed, MOST_LOBES, PIXELS, PixelFilter};
use crate::inputs;
use crate::math::Transform;
use crate::plugin::xml::{Document, SPECTRA, check_limit};
use crate::plugin::{Attributes, FromNode, Node, Origins, address};
use crate::shape::{AnyShape, Cube, Curves, Instance, MERGED, Mesh, Shape, Sphere};
use crate::texture;

/// How a scene file is loaded.
///
/// ```
/// use render::{Scene, scene::LoadOptions};
///
/// let text = r#"<scene version="3.0.0">
///     <default name="res" value="256"/>
///     <sensor type="perspective" id="front">
///         <float name="fov" value="40"/>
///         <film type="hdrfilm"><integer name="width" value="$res"/><integer name="height" value="$res"/></film>
///     </sensor>
///     <sensor type="perspective" id="side"><float name="fov" value="20"/></sensor>
///     <shape type="sphere"><bsdf type="diffuse" id="wood">
///         <texture type="bitmap" name="reflectance"><string name="filename" value="wood.png"/></texture>
///     </bsdf></shape>
/// </scene>"#;
/// let options = LoadOptions {
///     defines: vec![("res".into(), "16".into())], // as `-D res=16` of the tools
///     allow_missing: true,                        // grey in place of `wood.png`
///     sensor: Some("front".into()),
///     ..Default::default()
/// };
/// let (scene, warnings) = Scene::from_xml(text, "".as_ref(), &options)?;
/// assert_eq!(scene.film.size, [16, 16]);
/// assert!(warnings.iter().any(|w| w.contains("wood.png")), "{warnings:?}");
/// assert!(Scene::from_xml(text, "".as_ref(), &LoadOptions::default()).is_err()); // `wood.png` is missing
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// Values for the file's `$names`, instead of their defaults.
    pub defines: Vec<(String, String)>,
    /// Substitute mid-grey for missing texture files, with a warning, instead of failing.
    pub allow_missing: bool,
    /// The sensor to look through, by its id or its number, instead of the first.
    pub sensor: Option<String>,
    /// Whether others will be looked through as well: without it, a warning says that it is only the first.
    pub several_sensors: bool,
}

/// Sums of so many pixels take three gigabytes.
pub(super) const MAX_PIXELS: usize = 1 << 27;

/// Integrators that the path tracer is.
const INTEGRATORS: &[&str] = &["path", "direct", "prb"];
/// Numbers of samples of the integrator `direct`, and what only these find.
const TECHNIQUES: [(&str, &str); 2] = [
    ("emitter_samples", "light of emitters without size"),
    ("bsdf_samples", "light over mirrors and smooth glass"),
];
/// Films that tell apart when light arrives.
const OVER_TIME: &[&str] = &["streakhdrfilm", "transient_hdr_film"];
/// Of all of them only the number of samples is read, and of those of other names, too.
const SAMPLERS: &[&str] = &[
    "halton",
    "hammersley",
    "independent",
    "ldsampler",
    "multijitter",
    "orthogonal",
    "sobol",
    "stratified",
];
const SENSORS: &[&str] = &["perspective", "thinlens", "orthographic"];
const FILMS: &[&str] = &[
    "exrfilm",
    "hdrfilm",
    "ldrfilm",
    "mfilm",
    "pngfilm",
    "streakhdrfilm",
    "tiledhdrfilm",
    "transient_hdr_film",
];
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
const GLINTY_SHAPE: &[&str] = &["glinty"];
const RECEIVER: &[&str] = &["caustic_receiver"];
const SINGLE: &[&str] = &["caustic_caster_single", "caustic_emitter_single"];
const MULTI: &[&str] = &["caustic_caster_multi", "caustic_emitter_multi"];
const BOUNCER: &[&str] = &["caustic_bouncer"];

/// Classes of Mitsuba, by plugin.
const SHAPE_NAMES: &[(&str, &str)] = &[
    ("bsplinecurve", "BSplineCurve"),
    ("cube", "Cube"),
    ("cylinder", "Cylinder"),
    ("disk", "Disk"),
    ("linearcurve", "LinearCurve"),
    ("obj", "OBJMesh"),
    ("ply", "PLYMesh"),
    ("rectangle", "Rectangle"),
    ("serialized", "SerializedMesh"),
    ("sphere", "Sphere"),
];
const EMITTER_NAMES: &[(&str, &str)] = &[
    ("constant", "ConstantBackgroundEmitter"),
    ("directional", "DirectionalEmitter"),
    ("envmap", "EnvironmentMapEmitter"),
    ("point", "PointLight"),
    ("projector", "Projector"),
    ("spot", "SpotLight"),
];

/// All plugins that there are, by the element that names them.
pub(super) fn plugins() -> Vec<(&'static str, Vec<&'static str>)> {
    let mut all = vec![
        ("bsdf", Material::PLUGINS.concat()),
        ("emitter", AnyEmitter::PLUGINS.concat()),
        ("film", FILMS.to_vec()),
        (
            "integrator",
            [INTEGRATORS, FILTERED, CONNECTED, GLINTY, OTHERS, WRAPPERS].concat(),
        ),
        ("rfilter", FILTERS.to_vec()),
        ("sampler", SAMPLERS.to_vec()),
        ("sensor", SENSORS.to_vec()),
        ("shape", AnyShape::names()),
        ("texture", [texture::PLUGINS, SPECTRA].concat()),
    ];
    for (_, plugins) in &mut all {
        plugins.sort_unstable();
        plugins.dedup();
    }
    all
}

impl Scene {
    /// Loads a scene; the second value lists what was ignored or substituted.
    ///
    /// ```
    /// use render::{Scene, scene::LoadOptions};
    ///
    /// let small = LoadOptions { defines: vec![("res".into(), "16".into())], ..Default::default() };
    /// let (scene, warnings) = Scene::load("../examples/scenes/cornell.xml".as_ref(), &small)?;
    /// assert!(warnings.is_empty()); // nothing was ignored
    /// assert_eq!((scene.film.size, scene.settings.spp), ([16, 16], 64));
    /// assert_eq!(scene.params().get("red.reflectance.value")?, [0.65, 0.05, 0.05]);
    /// assert_eq!(scene.files().len(), 1); // textures and meshes would follow
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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
    /// See the example of [`Scene`]. What a file has wrong is said with its line:
    ///
    /// ```
    /// use render::Scene;
    ///
    /// let text = r#"<scene version="3.0.0">
    ///     <sensor type="perspective"><float name="fov" value="40"/></sensor>
    ///     <shape type="sphere"><float name="radios" value="2"/></shape>
    /// </scene>"#;
    /// let error = Scene::from_xml(text, "".as_ref(), &Default::default()).unwrap_err().to_string();
    /// assert!(error.starts_with("<text>:3: ") && error.contains("`radios`"), "{error}");
    /// ```
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
        let mut reading = Reading::new(options, None);
        let scene = reading.scene(document.root(), options)?;
        let mut scene = scene.ok_or_else(|| document.root().missing("sensor", "a sensor"))?;
        let origins = std::mem::take(&mut reading.origins);
        let places = std::mem::take(&mut reading.places);
        let root = document.shared_root();
        scene.source = Some(Source::new(root, origins, places, &scene.params));
        let warnings = document.warnings().into_iter().map(|w| w.to_string());
        Ok((scene, warnings.chain(reading.warnings).collect()))
    }
}

/// A scene that is being read.
pub(super) struct Reading {
    build: Builder,
    settings: Settings,
    /// What is wrong, if reading goes on after that.
    pub faults: Option<Vec<SceneError>>,
    /// Of files besides the scene's.
    pub warnings: Vec<String>,
    /// Which parts of the file hold which parameters.
    origins: Origins,
    /// Which parts hold what may move.
    places: Places,
    /// The materials of shapes without one, and of such lamps.
    defaults: [Option<MaterialId>; 2],
    /// Of shapes whose textures ask for attributes of their mesh.
    serial: u64,
    /// How many things without id of each class there were.
    classes: HashMap<String, u32>,
    /// Meshes of groups, by the node that describes them.
    members: HashMap<usize, Member>,
}

/// A mesh that instances place.
struct Member {
    mesh: Mesh,
    material: MaterialId,
    /// What the file calls it.
    material_id: Option<String>,
    hints: Hints,
}

/// Bump maps and displacements are in units of the scene.
const COPIED: &str =
    "a mesh with a bump map or a displacement is copied: every instance takes the memory of it";

impl Reading {
    pub fn new(options: &LoadOptions, faults: Option<Vec<SceneError>>) -> Self {
        let mut build = Builder::new();
        build.registry().allow_missing = options.allow_missing;
        Self {
            build,
            settings: Settings::default(),
            faults,
            warnings: Vec::new(),
            origins: Origins::default(),
            places: Places::default(),
            defaults: [None; 2],
            serial: 0,
            classes: HashMap::new(),
            members: HashMap::new(),
        }
    }

    /// Passes an error on, or notes it and goes on without the result.
    fn note<T>(&mut self, result: Result<T, SceneError>) -> Result<Option<T>, SceneError> {
        match (result, &mut self.faults) {
            (Ok(x), _) => Ok(Some(x)),
            (Err(e), Some(faults)) => {
                faults.push(e);
                Ok(None)
            }
            (Err(e), None) => Err(e),
        }
    }

    /// All that the file describes; `None` where something was wrong.
    pub fn scene(
        &mut self,
        root: &Node,
        options: &LoadOptions,
    ) -> Result<Option<Scene>, SceneError> {
        let integrators = root.child_with_tag("integrator");
        if let Some(Some(node)) = self.note(integrators)? {
            let read = integrator(node, &mut self.settings);
            self.note(read)?;
        }
        let (nodes, mut sensors) = (root.children_with_tag("sensor"), Vec::new());
        if nodes.is_empty() {
            self.note::<()>(Err(root.missing("sensor", "a perspective sensor")))?;
        }
        let mut clips = Vec::new();
        for (i, node) in nodes.iter().enumerate() {
            let read =
                Clip::from_node(node).and_then(|clip| Ok((clip, sensor_from_node(node, i)?)));
            if let Some((clip, sensor)) = self.note(read)? {
                clips.push(clip);
                sensors.push(sensor);
                self.places.sensors.push(address(node));
            }
        }
        let shapes = self.apart(root.children_with_tag("shape"))?;
        let (mut drawn, mut groups) = (Vec::new(), Vec::new());
        for (i, &node) in shapes.iter().enumerate() {
            let before = self.build.shapes().len();
            match node.plugin.as_str() {
                "shapegroup" => groups.push(node),
                "instance" => {
                    let read = self.instance(node, i);
                    self.note(read)?;
                }
                _ => self.shape(node, i)?,
            }
            drawn.resize(drawn.len() + self.build.shapes().len() - before, node);
            let place = (node.plugin != "instance").then(|| Place {
                node: address(node),
                has_attributes: attributes_of(node).is_ok_and(|names| !names.is_empty()),
            });
            self.places.shapes.resize(drawn.len(), place);
            let instance = (node.plugin == "instance").then(|| address(node));
            self.places.instances.resize(drawn.len(), instance);
        }
        for group in groups {
            self.apart(group.children_with_tag("shape"))?;
            self.note(group.finish())?;
        }
        if self.faults.as_ref().is_none_or(Vec::is_empty) {
            precision::warn_of_coordinates(&drawn, &self.build);
            precision::warn_of_layers(&drawn, &self.build);
        }
        for node in root.children_with_tag("emitter") {
            // An area light out here is a declaration that shapes refer to.
            if node.plugin == "area" && node.id.is_some() {
                continue;
            }
            let name = node.id.clone().unwrap_or_else(|| "emitter".into());
            if node.id.is_none() {
                self.call_as_mitsuba(EMITTER_NAMES, node, &name);
            }
            let emitter = self.emitter(node, &name, None);
            if let Some((emitter, weight, hints)) = self.note(emitter)? {
                let number = self.build.emitters() as u32;
                self.places.emitters.push((number, address(node)));
                self.build.add_weighted_emitter(emitter, None, weight);
                self.build.hint_emitter(hints);
            }
        }
        for tag in DECLARED {
            for node in root.children_with_tag(tag) {
                self.note(declaration(node))?;
            }
        }
        self.note(root.finish())?;
        self.warnings = std::mem::take(&mut self.build.registry().warnings);
        self.origins = std::mem::take(&mut self.build.registry().origins);
        if self.faults.as_ref().is_some_and(|f| !f.is_empty()) {
            return Ok(None);
        }
        let chosen = match &options.sensor {
            Some(name) => self.note(sensor_called(&sensors, name))?,
            None => Some(0),
        };
        let Some(chosen) = chosen else {
            return Ok(None);
        };
        let is_only_first = options.sensor.is_none() && !options.several_sensors;
        if is_only_first && sensors.len() > 1 {
            let count = sensors.len();
            nodes[0].warn(format!("the first of {count} sensors is looked through"));
        }
        let build = std::mem::take(&mut self.build);
        let scene = build.build_with(sensors, chosen, self.settings);
        let Some(scene) = self.note(scene)? else {
            return Ok(None);
        };
        let clipped = clips[chosen].check(nodes[chosen], &scene);
        Ok(self.note(clipped)?.map(|()| scene))
    }

    /// An emitter and how often it is sampled; `shape` is the shape that it belongs to.
    fn emitter(
        &mut self,
        node: &Node,
        name: &str,
        shape: Option<u32>,
    ) -> Result<(AnyEmitter, f64, Hints), SceneError> {
        let registry = self.build.registry();
        let emitter = registry.within(name, shape, |r| AnyEmitter::from_node(node, r))?;
        let weight = sampling_weight(node)?;
        let hints = hints(node)?;
        node.finish()?;
        Ok((emitter, weight, hints))
    }

    fn shape(&mut self, node: &Arc<Node>, index: usize) -> Result<(), SceneError> {
        let name = node.id.clone().unwrap_or_else(|| format!("shape{index}"));
        if node.id.is_none() {
            self.call_as_mitsuba(SHAPE_NAMES, node, &name);
        }
        let wanted = attributes_of(node)?;
        if !wanted.is_empty() {
            self.serial += 1;
            let asked = Attributes {
                serial: self.serial,
                shape: name.clone(),
                wanted,
                ..Attributes::default()
            };
            self.build.registry().attributes = Some(asked);
        }
        let registry = self.build.registry();
        let geometry = registry.within(&name, None, |r| AnyShape::from_node(node, r));
        // What belongs to a shape that is missing is read all the same.
        let stand_in = || Cube::new(&Transform::IDENTITY, false).map(AnyShape::from);
        let geometry = self.note(geometry)?;
        let whole = geometry.is_some();
        if let Some(asked) = &mut self.build.registry().attributes {
            asked.absent = !whole;
        }
        let Some(geometry) = geometry.or_else(stand_in) else {
            return Ok(());
        };
        // The builder would complain too, but knows no line.
        if geometry.extent() > MAX_COORDINATE {
            let tested = Accel::build(&geometry.primitives());
            let tested = tested.map_err(|e| out_of_reach(&node.plugin, &e).at(&node.location));
            self.note(tested)?;
        }
        let emitter_node = self.note(node.child_with_tag("emitter"))?.flatten();
        let material = match self.note(node.child_with_tag("bsdf"))?.flatten() {
            Some(bsdf) => {
                let registry = self.build.registry();
                let read = registry.within(&name, None, |r| r.material_from_node(bsdf, "bsdf"));
                match self.note(read)? {
                    Some(material) => self.build.add_shared_material(material),
                    None => self.default_material(false)?,
                }
            }
            None => self.default_material(emitter_node.is_some())?,
        };
        let emitter = match emitter_node {
            Some(e) => {
                if let Some(id) = &e.id {
                    let params = self.build.registry().params_mut();
                    params.answer_of_one(id, &format!("{name}.emitter"));
                }
                let next = self.build.shapes().len() as u32;
                let read = self.emitter(e, &format!("{name}.emitter"), Some(next));
                let read = read.and_then(|read| {
                    if whole && read.0.is_beam() && !DirectionalArea::admits(&geometry) {
                        return Err(e.refused(
                            "parallel light from other surfaces than rectangles and disks is",
                        ));
                    }
                    if whole && matches!(geometry, AnyShape::Curves(_)) {
                        return Err(e.refused("curves that emit are"));
                    }
                    Ok(read)
                });
                self.note(read)?
            }
            None => None,
        };
        let hinted = self.note(hints(node))?.unwrap_or_default();
        if whole {
            self.note(node.finish())?;
        }
        self.build.registry().attributes = None;
        let shape = self.build.add_shape(&name, geometry, material);
        self.build.hint_shape(hinted);
        if let Some((e, weight, hints)) = emitter {
            self.build.add_weighted_emitter(e, Some(shape), weight);
            self.build.hint_emitter(hints);
        }
        Ok(())
    }

    /// Parameters of what has no id answer to the name of its class in Mitsuba, numbered from the second on.
    fn call_as_mitsuba(&mut self, names: &[(&str, &str)], node: &Node, own: &str) {
        let found = names.iter().find(|(plugin, _)| *plugin == node.plugin);
        let Some((_, class)) = found else {
            return;
        };
        let count = self.classes.entry(class.to_string()).or_default();
        let name = match *count {
            0 => class.to_string(),
            n => format!("{class}_{n}"),
        };
        *count += 1;
        self.build.registry().params_mut().alias(name, own);
    }

    /// The shapes themselves where some stand for those inside.
    fn apart<'n>(&mut self, nodes: Vec<&'n Arc<Node>>) -> Result<Vec<&'n Arc<Node>>, SceneError> {
        let mut shapes = Vec::new();
        for node in nodes {
            if node.plugin != MERGED {
                shapes.push(node);
                continue;
            }
            shapes.extend(self.apart(node.children_with_tag("shape"))?);
            self.note(node.finish())?;
        }
        Ok(shapes)
    }

    /// All shapes of a group, where the instance is: meshes whose points stay are there once, others are copied.
    fn instance(&mut self, node: &Arc<Node>, index: usize) -> Result<(), SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let group = node.child_with_tag("shape")?;
        let group = group.filter(|g| g.plugin == "shapegroup");
        let group = group.ok_or_else(|| node.missing("shapegroup", "a reference to a group"))?;
        node.finish()?;
        let name = node.id.clone().unwrap_or_else(|| format!("shape{index}"));
        let parts = self.apart(group.children_with_tag("shape"))?;
        let mut unnamed = (0..).map(|n| match n {
            0 => "shape".to_owned(),
            n => format!("shape_{n}"),
        });
        for (i, part) in parts.into_iter().enumerate() {
            if matches!(part.plugin.as_str(), "instance" | "shapegroup") {
                return Err(part.refused("groups of groups and of instances are"));
            }
            if Curves::PLUGINS.contains(&part.plugin.as_str()) {
                return Err(part.refused("curves in groups are"));
            }
            if let Some(emitter) = part.child_with_tag("emitter")? {
                return Err(emitter.refused("shapes of a group that emit, in its instances, are"));
            }
            let id = part.id.clone().unwrap_or_else(|| format!("shape{i}"));
            // In Mitsuba the material is that of the group.
            let theirs = part.id.clone().or_else(|| unnamed.next());
            if let (Some(group), Some(theirs)) = (&group.id, theirs) {
                let params = self.build.registry().params_mut();
                params.answer(
                    format!("{group}.{theirs}.bsdf"),
                    &format!("{name}.{id}.bsdf"),
                );
            }
            self.part(node, part, format!("{name}.{id}"), &to_world, index)?;
        }
        Ok(())
    }

    /// A shape of a group, where an instance is.
    fn part(
        &mut self,
        node: &Arc<Node>,
        part: &Arc<Node>,
        name: String,
        to_world: &Transform,
        index: usize,
    ) -> Result<(), SceneError> {
        let place = |mesh: &Mesh| {
            let placed = Instance::new(mesh.clone(), *to_world);
            placed.map_err(|expected| {
                let expected = expected.trim_start_matches("expected ");
                node.invalid("to_world", expected)
            })
        };
        if let Some(member) = self.members.get(&address(part)) {
            let placed = place(&member.mesh)?;
            let (material, hints) = (member.material, member.hints);
            if let Some(id) = &member.material_id {
                let own = format!("{name}.bsdf");
                self.build.registry().params_mut().alias(own, id);
            }
            if self.build.is_bumped(material) {
                part.warn(COPIED);
            }
            self.build.add_shape(&name, placed, material);
            self.build.hint_shape(hints);
            return Ok(());
        }
        let is_mesh = Mesh::PLUGINS.contains(&part.plugin.as_str());
        let is_displaced = is_mesh && part.child("displacement").is_some();
        if is_displaced {
            part.warn(COPIED);
        }
        if !is_mesh || is_displaced {
            let mut copy = part.moved(name, to_world)?;
            // A ball is turned inside out by mirrors of its own, and carried by those of instances.
            if Sphere::PLUGINS.contains(&part.plugin.as_str()) && to_world.determinant() < 0.0 {
                copy.turn_over("flip_normals")?;
            }
            return self.shape(&Arc::new(copy), index);
        }
        let before = self.build.shapes().len();
        let own = part.moved(name, &Transform::IDENTITY)?;
        self.shape(&Arc::new(own), index)?;
        // Nothing has been added, or something in its stead, where the mesh is missing.
        if let Some(AnyShape::Mesh(mesh)) = self.build.shapes().get(before) {
            let mesh = mesh.clone();
            let placed = place(&mesh)?;
            let (material, hints) = self.build.replace_last(placed);
            if self.build.is_bumped(material) {
                part.warn(COPIED);
            }
            let bsdf = part.child_with_tag("bsdf")?;
            let member = Member {
                mesh,
                material,
                material_id: bsdf.and_then(|bsdf| bsdf.id.clone()),
                hints,
            };
            self.members.insert(address(part), member);
        }
        Ok(())
    }

    /// As in Mitsuba 3, lamps without a material reflect nothing, and other shapes half of the light.
    fn default_material(&mut self, emits: bool) -> Result<MaterialId, SceneError> {
        let (kind, name, albedo) = if emits {
            (1, "default_lamp_bsdf.reflectance.value", 0.0)
        } else {
            (0, "default_bsdf.reflectance.value", 0.5)
        };
        if let Some(id) = self.defaults[kind] {
            return Ok(id);
        }
        let reflectance = self.build.rgb(name, [albedo; 3], (0.0, 1.0))?;
        Ok(*self.defaults[kind].insert(self.build.add_material(Diffuse { reflectance })))
    }
}

/// Names of the attributes of its mesh that textures of a shape ask for.
///
/// # Errors
/// Textures by surface coordinates beside them, which then say something else.
fn attributes_of(shape: &Node) -> Result<Vec<String>, SceneError> {
    fn visit<'a>(node: &'a Node, names: &mut Vec<String>, other: &mut Option<&'a Node>) {
        for part in node.parts() {
            if part.tag == "texture" {
                match part.plugin.as_str() {
                    "mesh_attribute" => {
                        names.extend(part.string("name").ok().flatten().map(str::to_owned))
                    }
                    _ if part.is_constant() => {}
                    // What it has inside is another.
                    "scale" => {}
                    _ => *other = Some(part),
                }
            }
            visit(part, names, other);
        }
    }
    let (mut names, mut other) = (Vec::new(), None);
    visit(shape, &mut names, &mut other);
    match other {
        Some(texture) if !names.is_empty() => Err(SceneError::Refused {
            location: texture.location.clone(),
            tag: texture.tag.clone(),
            plugin: texture.plugin.clone(),
            what: "a texture by surface coordinates beside attributes of the mesh is",
        }),
        _ => Ok(names),
    }
}

/// Checks what may never be built, for want of a reference to it.
fn declaration(node: &Node) -> Result<(), SceneError> {
    if node.id.is_none() && !matches!(node.tag.as_str(), "bsdf" | "texture") {
        return Err(node.missing("id", "a name for others to refer to"));
    }
    if node.id.is_none() {
        // What it is made of may have one all the same.
        node.warn_of_no_effect("it has no `id` for others to refer to");
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
        let inside = node.child_with_tag("integrator")?;
        node.warn("only the image of the integrator inside is made");
        node.ignore(&["aovs"], Node::string)?;
        node.ignore_rest();
        let expected = "one inside, whose image it is";
        node = inside.ok_or_else(|| node.missing("integrator", expected))?;
    }
    let plugin = node.plugin.as_str();
    let replaced = OTHERS.contains(&plugin);
    let of_manifolds = FILTERED.contains(&plugin) || CONNECTED.contains(&plugin);
    let glinty = GLINTY.contains(&plugin);
    if !(INTEGRATORS.contains(&plugin) || of_manifolds || glinty || replaced) {
        let known = [INTEGRATORS, FILTERED, CONNECTED, GLINTY, OTHERS, WRAPPERS].concat();
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
    } else if plugin.starts_with("emission") {
        1
    } else if plugin.starts_with("prb") {
        6
    } else {
        -1
    };
    settings.max_depth = depth("max_depth", deepest)?;
    if settings.max_depth == 0 {
        return Err(node.invalid(
            "max_depth",
            "-1 for no limit, or at least 1, which is emission",
        ));
    }
    settings.rr_depth = depth("rr_depth", 5)?;
    settings.hide_emitters = node.boolean_or("hide_emitters", false)?;
    if of_manifolds {
        settings.connections = Some(published::connections(node)?);
    }
    if glinty {
        settings.glints = Some(published::glints(node)?);
    }
    if replaced {
        node.warn("traced like `path` instead: the same image, but for its noise");
        node.ignore_rest();
    }
    node.ignore(&["samples_per_pass", "block_size"], Node::integer)?;
    for (key, lost) in TECHNIQUES {
        if node.integer(key)? == Some(0) {
            node.warn(format!(
                "`{key}`: both techniques are used; {lost} is in the image, which is left out in Mitsuba where this is 0"
            ));
        } else {
            node.ignore(&[key], Node::integer)?;
        }
    }
    node.ignore(&["shading_samples"], Node::integer)?;
    node.ignore(&["timeout"], Node::float)?;
    node.finish()
}

/// The sensor number `index`.
fn sensor_from_node(node: &Node, index: usize) -> Result<Sensor, SceneError> {
    if !SENSORS.contains(&node.plugin.as_str()) {
        return Err(node.unknown_plugin(SENSORS));
    }
    let film = match node.child_with_tag("film")? {
        Some(film) => film_from_node(film)?,
        None => Film::new(768, 576),
    };
    let mut spp = Settings::default().spp;
    if let Some(sampler) = node.child_with_tag("sampler")? {
        if sampler.plugin != "independent" {
            sampler.warn("of a sampler, only the number of samples is read");
        }
        spp = sampler.integer_in("sample_count", 16, 1..=1 << 30)? as u32;
        sampler.ignore_rest();
    }
    let camera = camera_from_node(node, film.size).map_err(|e| match e {
        SceneError::Parameter { key, expected, .. } => node.invalid(&key, &expected),
        other => other,
    })?;
    node.finish()?;
    Ok(Sensor {
        name: node.id.clone().unwrap_or_else(|| format!("sensor{index}")),
        camera,
        film,
        spp,
    })
}

fn camera_from_node(node: &Node, size: [u32; 2]) -> Result<Camera, SceneError> {
    let to_world = node.transform("to_world")?.unwrap_or_default();
    node.ignore(&["shutter_open", "shutter_close"], Node::float)?;
    if node.plugin == "orthographic" {
        return Camera::orthographic(to_world, size);
    }
    let (fov, axis) = node.field_of_view()?;
    let camera = Camera::new(to_world, fov, axis, size)?;
    let offset = |key| node.float_or(key, 0.0);
    let principal = [
        offset("principal_point_offset_x")?,
        offset("principal_point_offset_y")?,
    ];
    let camera = if principal == [0.0; 2] {
        camera
    } else {
        camera.with_principal_point(principal)
    };
    if node.plugin == "perspective" {
        node.ignore(&["focus_distance"], Node::float)?;
        return Ok(camera);
    }
    let radius = node.float("aperture_radius")?;
    let radius = radius.ok_or_else(|| node.missing("aperture_radius", "a positive number"))?;
    let focus = node.float("focus_distance")?;
    let focus = focus.ok_or_else(|| node.missing("focus_distance", "a positive number"))?;
    camera.with_lens(&to_world, radius, focus)
}

fn film_from_node(node: &Node) -> Result<Film, SceneError> {
    if !FILMS.contains(&node.plugin.as_str()) {
        return Err(node.unknown_plugin(FILMS));
    }
    match node.plugin.as_str() {
        "hdrfilm" => {}
        "tiledhdrfilm" => node.warn("written as one image, without tiles"),
        film if OVER_TIME.contains(&film) => {
            node.warn("light is summed over the times when it arrives, in one image");
        }
        _ => node
            .warn("written as OpenEXR, linear, and as a PNG beside it; tone mapping has no effect"),
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
    let filter = if OVER_TIME.contains(&node.plugin.as_str()) {
        // That over time is another one.
        let in_space = |(name, child): &(Option<&str>, &Arc<Node>)| {
            child.tag == "rfilter" && *name != Some("tfilter")
        };
        node.children().find(in_space).map(|(_, child)| child)
    } else {
        node.child_with_tag("rfilter")?
    };
    let filter = match filter {
        None => PixelFilter::Gaussian { stddev: 0.5 },
        Some(filter) => filter_from_node(filter)?,
    };
    let (alpha, as_asked) = node
        .choice("pixel_format", PIXELS)?
        .unwrap_or((false, true));
    if !as_asked {
        node.warn("`pixel_format`: written in red, green and blue instead");
    }
    node.ignore(&["component_format", "file_format"], Node::string)?;
    let flags = [
        "attach_log",
        "banner",
        "compensate",
        "high_quality_edges",
        "sample_border",
    ];
    node.ignore(&flags, Node::boolean)?;
    if node.plugin != "hdrfilm" {
        node.ignore_rest();
    }
    node.finish()?;
    Ok(Film {
        size: [width, height],
        crop_offset: [x, y],
        crop_size,
        filter,
        alpha,
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

/// What a shape or an emitter is to manifold connections.
fn hints(node: &Node) -> Result<Hints, SceneError> {
    let any = |keys: &[&str]| {
        let mut any = false;
        for key in keys {
            any |= node.boolean_or(key, false)?;
        }
        Ok::<bool, SceneError>(any)
    };
    let (begins, bounces) = (any(MULTI)?, any(BOUNCER)?);
    Ok(Hints {
        receiver: any(RECEIVER)?,
        single: any(SINGLE)?,
        multi: begins || bounces,
        bouncer: bounces && !begins,
        glinty: any(GLINTY_SHAPE)?,
    })
}

/// How often an emitter is sampled, relative to the others.
fn sampling_weight(node: &Node) -> Result<f64, SceneError> {
    match node.float_or("sampling_weight", 1.0)? {
        weight if weight > 0.0 && weight.is_finite() => Ok(weight),
        _ => Err(node.invalid("sampling_weight", "a positive number")),
    }
}
