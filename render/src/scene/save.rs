//! Scenes as files again.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Scene;
use super::movable::What;
use super::stand_ins::{WRAPPERS, stand_in};
use crate::bsdf::CORRECTIONS;
use crate::camera::{FovAxis, Optic};
use crate::emitter::Emitter;
use crate::error::SceneError;
use crate::files;
use crate::film::{Image, PIXELS};
use crate::image_io;
use crate::math::{Transform, each};
use crate::params::{ParamInfo, ParamRef, ParamShape, Params};
use crate::plugin::xml::{Content, Rewrite, written};
use crate::plugin::{Node, Origins, address};
use crate::shape::{AnyShape, MERGED, plain_obj};

/// What a scene was read from.
#[derive(Debug)]
pub(super) struct Source {
    pub root: Arc<Node>,
    pub origins: Origins,
    /// The values of parameters that no part of the file holds, which therefore cannot change.
    fixed: Vec<(u32, Vec<f32>)>,
    /// Parameters that move something, with the values at which it is where the file has it.
    moving: Vec<(ParamRef, What, Vec<f32>)>,
    pub places: Places,
}

/// Where in the file things are that may move.
#[derive(Debug, Default)]
pub(super) struct Places {
    /// Per shape; none for parts of instances.
    pub shapes: Vec<Option<Place>>,
    /// Where the node of the instance lies, per shape; none for others than parts.
    pub instances: Vec<Option<usize>>,
    /// Of emitters that are no surfaces, with their numbers.
    pub emitters: Vec<(u32, usize)>,
    /// Per sensor.
    pub sensors: Vec<usize>,
}

/// Of a shape.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Where its node lies.
    pub node: usize,
    /// Whether textures read attributes of its mesh, which stand in its file.
    pub has_attributes: bool,
}

/// What becomes of a node.
#[derive(Debug, Default)]
struct Change {
    /// Behind its own `to_world`.
    placed: Option<Transform>,
    /// Degrees, and what they refer to.
    fov: Option<(f32, FovAxis)>,
    /// What else changes of a sensor's optics.
    optics: Vec<(Optic, f32)>,
    position: Option<[f32; 3]>,
    direction: Option<[f64; 3]>,
    /// The shape whose mesh it names from now on.
    mesh: Option<u32>,
}

impl Change {
    fn place(&mut self, by: Transform) {
        self.placed = Some(self.placed.unwrap_or_default().then(&by));
    }
}

impl Source {
    pub fn new(root: Arc<Node>, origins: Origins, places: Places, params: &Params) -> Self {
        let written: HashSet<u32> = origins.params().collect();
        let rest = (0u32..)
            .zip(params.infos())
            .filter(|(id, _)| !written.contains(id));
        let fixed = rest.map(|(id, info)| (id, params.values()[info.range()].to_vec()));
        Self {
            fixed: fixed.collect(),
            moving: Vec::new(),
            places,
            root,
            origins,
        }
    }

    /// Says what a parameter moves; it has the values of rest.
    pub fn moves(&mut self, p: ParamRef, what: What, rest: Vec<f32>) {
        self.moving.push((p, what, rest));
    }

    /// The only node at this address. One that several things were made of, as they refer to it, cannot be changed.
    pub fn node(&self, at: usize) -> Option<&Node> {
        let mut standing = Vec::new();
        stand(&self.root, &mut standing);
        let mut found = standing.into_iter().filter(|n| address(n) == at);
        found.next().filter(|_| found.next().is_none())
    }
}

/// Everything at the root, or in what only keeps shapes together.
fn stand<'n>(node: &'n Node, out: &mut Vec<&'n Node>) {
    for part in node.parts() {
        out.push(part);
        if part.plugin == MERGED {
            stand(part, out);
        }
    }
}

impl Scene {
    /// Writes the scene, with the parameters that it has now, as a file that this renderer and Mitsuba 3 read: images of
    /// texels as OpenEXR in the folder `textures` beside it, meshes copied into `meshes` (OBJ files that Mitsuba does not read,
    /// with lines that go on, indices from the end or line ends of old, are written anew). What stands in for another
    /// plugin is written itself: `path`, `independent`, `hdrfilm`. What has moved as a whole has another `to_world` (lights at a
    /// point another `position`), and so have instances whose parts have all moved alike; sensors have another `fov` or another
    /// lens. Meshes whose points have moved or are displaced, which Mitsuba does not know, are written anew, as OBJ files if they
    /// were read from such ones and as PLY files otherwise: world space, with the normals and texture coordinates that they have.
    /// What has no effect here is written as it was read. Returns all files, the scene last.
    ///
    /// ```
    /// use render::Scene;
    ///
    /// let folder = std::env::temp_dir().join(format!("save-{}", std::process::id()));
    /// std::fs::create_dir_all(&folder)?;
    /// let (mut scene, _) = Scene::load("../examples/scenes/cornell.xml".as_ref(), &Default::default())?;
    /// scene.set([("red.reflectance.value", &[0.1, 0.2, 0.3][..])])?;
    /// let files = scene.save(&folder.join("blue.xml"))?;
    /// assert_eq!(files, [folder.join("blue.xml")]); // images of texels and meshes would come before it
    ///
    /// let (again, _) = Scene::load(&files[0], &Default::default())?;
    /// assert_eq!(again.params().values(), scene.params().values());
    /// assert!(render::scene::room(8, 8)?.save(&folder.join("room.xml")).is_err()); // it was read from no file
    /// # std::fs::remove_dir_all(&folder)?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// A scene that was not read from a file; a folder in which one of its own files would be replaced; a parameter that
    /// has changed and that no attribute, image or mesh of the file holds, such as the colours of meshes, the images in
    /// spot lights, points of instances and of meshes with attributes, and parts of an instance that move apart; the operating
    /// system's.
    pub fn save(&self, path: &Path) -> Result<Vec<PathBuf>, SceneError> {
        let bad = |key: &str, expected: &str, found: &str| SceneError::Parameter {
            key: key.to_owned(),
            expected: expected.to_owned(),
            found: found.to_owned(),
        };
        let source = self.source.as_ref();
        let source = source
            .ok_or_else(|| bad("scene", "one that was read from a file", "one made by code"))?;
        for (id, values) in &source.fixed {
            let info = &self.params.infos()[*id as usize];
            if self.params.values()[info.range()] != values[..] {
                let expected = "the value that the file has: nothing in it holds this parameter";
                return Err(bad(&info.name, expected, "another"));
            }
        }
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut writing = Writing {
            params: &self.params,
            origins: &source.origins,
            changes: self.changes(source)?,
            scene: self,
            files: HashMap::new(),
            names: HashSet::new(),
            images: Vec::new(),
            meshes: Vec::new(),
            copies: Vec::new(),
        };
        let text = written(&source.root, &mut writing);
        let Writing {
            images,
            meshes,
            copies,
            ..
        } = writing;
        let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => false,
        };
        let copies: Vec<(PathBuf, PathBuf)> = (copies.into_iter())
            .map(|(from, to)| (from, folder.join(to)))
            .filter(|(from, to)| !same(from, to))
            .collect();
        let made = images.iter().map(|(to, _)| to);
        let made = made.chain(meshes.iter().map(|(to, _)| to));
        let written = made.map(|to| folder.join(to));
        let written = written.chain(copies.iter().map(|(_, to)| to.clone()));
        let mut written = written.chain([path.to_owned()]);
        if let Some(own) = written.find(|to| self.files.iter().any(|file| same(file, to))) {
            let expected = "a folder in which no file of the scene would be replaced";
            return Err(bad("save", expected, &own.to_string_lossy()));
        }
        let mut all = Vec::new();
        let make = |to: &Path| {
            let parent = to.parent().unwrap_or(Path::new(""));
            std::fs::create_dir_all(parent).map_err(|source| SceneError::Write {
                path: parent.to_owned(),
                source,
            })
        };
        for (to, image) in images {
            let to = folder.join(to);
            make(&to)?;
            image_io::write_exr(&to, &image)?;
            all.push(to);
        }
        for (to, bytes) in meshes {
            let to = folder.join(to);
            make(&to)?;
            image_io::write_atomically(&to, &bytes)?;
            all.push(to);
        }
        for (from, to) in copies {
            make(&to)?;
            let bytes = files::read(&from, u64::MAX)?;
            let plain = match from.extension() {
                Some(ending) if ending.eq_ignore_ascii_case("obj") => plain_obj(&bytes),
                _ => None,
            };
            image_io::write_atomically(&to, plain.as_deref().unwrap_or(&bytes))?;
            all.push(to);
        }
        make(path)?;
        image_io::write_atomically(path, text.as_bytes())?;
        all.push(path.to_owned());
        Ok(all)
    }

    /// What has moved, by the address of its node.
    fn changes(&self, source: &Source) -> Result<HashMap<usize, Change>, SceneError> {
        let mut changes = HashMap::<usize, Change>::new();
        let has_moved = |(p, _, rest): &&(ParamRef, What, Vec<f32>)| {
            self.params.values()[self.params.infos()[p.id as usize].range()] != rest[..]
        };
        for (p, what, rest) in source.moving.iter().filter(has_moved) {
            let info = &self.params.infos()[p.id as usize];
            let error = |found: &str| SceneError::Parameter {
                key: info.name.clone(),
                expected: "the value that the file has: nothing in it holds this parameter".into(),
                found: found.to_owned(),
            };
            let emitters = &source.places.emitters;
            if let What::Shape(shape, _) = *what
                && let Some(at) = source.places.instances[shape as usize]
            {
                let node = source.node(at).ok_or_else(|| error("another"))?;
                let by = self.parts_by(&source.places, at).map_err(|e| error(&e))?;
                changes.entry(address(node)).or_default().placed = Some(by);
                continue;
            }
            let at = match *what {
                What::Shape(shape, _) | What::Vertices(shape) | What::Normals(shape) => {
                    let place = source.places.shapes[shape as usize];
                    place
                        .filter(|p| !p.has_attributes || matches!(what, What::Shape(..)))
                        .map(|p| p.node)
                }
                What::Camera(_) | What::Optic(_) => {
                    source.places.sensors.get(self.through).copied()
                }
                What::Emitter(e) => emitters.iter().find(|(i, _)| *i == e).map(|(_, at)| *at),
            };
            let node = at.and_then(|at| source.node(at));
            let node = node.ok_or_else(|| error("another"))?;
            let change = changes.entry(address(node)).or_default();
            let values = &self.params.values()[info.range()];
            match *what {
                What::Shape(shape, _) => {
                    let placement = self.geometry.placement(shape);
                    change.placed = placement.map(|p| p.transform(&self.params));
                }
                What::Vertices(shape) | What::Normals(shape) => change.mesh = Some(shape),
                What::Camera(_) => change.placed = Some(self.camera.displacement(&self.params)),
                What::Optic(Optic::Fov) => change.fov = Some((values[0], self.camera.fov().1)),
                What::Optic(optic) => change.optics.push((optic, values[0])),
                What::Emitter(e) => {
                    let emitter = &self.emitters[e as usize];
                    let key = emitter.mobility().map_or("", |(key, _)| key);
                    let now = each([0, 1, 2], |i: usize| values[i]);
                    if key == "position" && node.plugin == "point" {
                        change.position = Some(now);
                    } else if key == "position" {
                        let by = each([0, 1, 2], |i: usize| f64::from(now[i]) - f64::from(rest[i]));
                        change.place(Transform::translate(by));
                    } else {
                        let turn = crate::motion::Placement {
                            rotation: Some(*p),
                            ..Default::default()
                        };
                        let turn = turn.transform(&self.params);
                        match node.vector("direction").ok().flatten() {
                            Some(d) => change.direction = Some(turn.vector(d)),
                            None => change.place(turn),
                        }
                    }
                }
            }
        }
        for (i, shape) in self.shapes().iter().enumerate() {
            if !matches!(shape, AnyShape::Mesh(mesh) if mesh.is_displaced()) {
                continue;
            }
            let node = source.places.shapes[i].and_then(|p| source.node(p.node));
            let node = node.ok_or_else(|| SceneError::Parameter {
                key: format!("{}.displacement", self.infos[i].name),
                expected: "a displaced mesh of its own, whose points can be written".into(),
                found: "a part of an instance, or of several shapes".into(),
            })?;
            changes.entry(address(node)).or_default().mesh = Some(i as u32);
        }
        Ok(changes)
    }
}

/// In which format a mesh is written: OBJ stays OBJ, all others are PLY.
fn mesh_format(node: &Node) -> &'static str {
    match node.plugin.as_str() {
        "obj" => "obj",
        _ => "ply",
    }
}

impl Scene {
    /// How all parts of an instance have moved, whose node lies there.
    ///
    /// # Errors
    /// Two that have not moved alike.
    fn parts_by(&self, places: &Places, at: usize) -> Result<Transform, String> {
        let parts = (0..).zip(&places.instances);
        let parts = parts.filter(|(_, instance)| **instance == Some(at));
        let mut parts = parts.map(|(i, _): (u32, _)| {
            let placement = self.geometry.placement(i);
            (
                i,
                placement.map_or(Transform::IDENTITY, |p| p.transform(&self.params)),
            )
        });
        let (first, by) = parts.next().unwrap_or((0, Transform::IDENTITY));
        match parts.find(|(_, other)| !alike(&by, other)) {
            None => Ok(by),
            Some((other, _)) => Err(format!(
                "one by which `{}` and `{}`, parts of one instance, move apart",
                self.infos[first as usize].name, self.infos[other as usize].name
            )),
        }
    }
}

/// Whether two motions are the same but for roundings of their parameters.
fn alike(a: &Transform, b: &Transform) -> bool {
    let numbers = |t: &Transform| [t.linear.as_flattened(), &t.translation].concat();
    let close = |(a, b): (&f64, &f64)| (a - b).abs() <= ROUNDING * (1.0 + a.abs().max(b.abs()));
    numbers(a).iter().zip(&numbers(b)).all(close)
}

/// That the normals of a map are not corrected, where the file does not say it: in Mitsuba 3.9 they are by default.
fn uncorrected(node: &Node) -> Vec<(String, Content)> {
    let is_map =
        node.tag == "bsdf" && node.plugin == "normalmap" && node.child("normalmap").is_some();
    let missing = CORRECTIONS
        .into_iter()
        .filter(|key| is_map && !node.has(key));
    missing
        .map(|key| (key.to_owned(), Content::Boolean(false)))
        .collect()
}

/// A few roundings of single precision.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// What becomes of values and files while a scene is written.
struct Writing<'a> {
    params: &'a Params,
    origins: &'a Origins,
    changes: HashMap<usize, Change>,
    scene: &'a Scene,
    /// The new names of files that were named before.
    files: HashMap<PathBuf, String>,
    names: HashSet<String>,
    images: Vec<(String, Image)>,
    meshes: Vec<(String, Vec<u8>)>,
    copies: Vec<(PathBuf, String)>,
}

impl Writing<'_> {
    fn info(&self, id: u32) -> &ParamInfo {
        &self.params.infos()[id as usize]
    }

    fn change(&self, node: &Node) -> Option<&Change> {
        self.changes.get(&address(node))
    }

    /// The shape whose mesh a node names from now on.
    fn mesh(&self, node: &Node) -> Option<u32> {
        self.change(node)?.mesh
    }

    /// Attributes of what has moved.
    fn moved(&self, node: &Node) -> Vec<(String, Content)> {
        let mut out: Vec<(&str, Content)> = Vec::new();
        let Some(change) = self.change(node) else {
            return Vec::new();
        };
        if let Some(shape) = change.mesh {
            if let AnyShape::Mesh(mesh) = &self.scene.shapes()[shape as usize]
                && mesh.data().normals.is_empty()
            {
                out.push(("face_normals", Content::Boolean(true)));
            }
        } else if let Some(by) = change.placed {
            let own = node.transform("to_world").ok().flatten();
            let moved = own.unwrap_or_default().then(&by);
            out.push(("to_world", Content::Transform(moved)));
        }
        if let Some((degrees, axis)) = change.fov {
            out.push(("fov", Content::Scalar(degrees)));
            out.push(("fov_axis", Content::Text(axis.name())));
        }
        for (optic, value) in &change.optics {
            out.push((optic.key(), Content::Scalar(*value)));
        }
        if let Some(position) = change.position {
            out.push(("position", Content::Point(position)));
        }
        if let Some(direction) = change.direction {
            out.push(("direction", Content::Vector(direction)));
        }
        out.into_iter()
            .map(|(key, x)| (key.to_owned(), x))
            .collect()
    }

    /// A name in a folder that is free.
    fn free(&mut self, folder: &str, stem: &str, ending: &str) -> String {
        let plain = |c: char| {
            if c.is_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '_'
            }
        };
        let stem: String = stem.chars().map(plain).collect();
        let names = (0..).map(|i| match i {
            0 => format!("{folder}/{stem}.{ending}"),
            i => format!("{folder}/{stem}_{i}.{ending}"),
        });
        let mut free = names.filter(|name| !self.names.contains(name));
        let name = free.next().unwrap_or_default();
        self.names.insert(name.clone());
        name
    }
}

impl Writing<'_> {
    /// Attributes of what stands in for another plugin, where they are not its defaults.
    fn substituted(&self, node: &Node) -> Vec<(&'static str, Content)> {
        let settings = &self.scene.settings;
        match (node.tag.as_str(), stand_in(node)) {
            ("integrator", Some(_)) => {
                let depth = i32::try_from(settings.max_depth).map_or(-1, i64::from);
                vec![("max_depth", Content::Integer(depth))]
            }
            ("film", Some(_)) if node.has("pixel_format") => {
                let asked = node.choice("pixel_format", PIXELS).ok().flatten();
                let alpha = asked.is_some_and(|(alpha, _)| alpha);
                vec![(
                    "pixel_format",
                    Content::Text(if alpha { "rgba" } else { "rgb" }),
                )]
            }
            _ => Vec::new(),
        }
    }
}

impl Rewrite for Writing<'_> {
    fn values(&mut self, node: &Node) -> Vec<(String, Content)> {
        let mut out = self.moved(node);
        out.extend(uncorrected(node));
        let substituted = self.substituted(self.inside(node));
        out.extend(substituted.into_iter().map(|(key, x)| (key.to_owned(), x)));
        let Some(origin) = self.origins.of(node) else {
            return out;
        };
        for (key, &id) in &origin.values {
            let info = self.info(id);
            let number = match self.params.values()[info.range()] {
                [x] => Content::Scalar(x),
                [r, g, b] => Content::Colour([r, g, b]),
                _ => continue,
            };
            out.push((key.clone(), number));
        }
        if let Some(id) = origin.index {
            let eta = self.params.values()[self.info(id).offset];
            out.push(("int_ior".to_owned(), Content::Scalar(eta)));
            out.push(("ext_ior".to_owned(), Content::Scalar(1.0)));
        }
        out
    }

    fn is_gone(&self, node: &Node, name: &str) -> bool {
        let moved = self.change(node).is_some_and(|change| match name {
            "to_world" => change.mesh.is_some() || change.position.is_some(),
            "shape_index" | "displacement" => change.mesh.is_some(),
            "flip_tex_coords" => change.mesh.is_some() && mesh_format(node) == "ply",
            "focal_length" => change.fov.is_some(),
            _ => false,
        });
        let inside = self.inside(node);
        let idle = stand_in(inside)
            .is_some_and(|(_, kept)| !kept.contains(&name) && inside.child(name).is_none());
        moved
            || idle
            // Indices are those against it.
            || name == "ext_eta"
            || self.origins.of(node).is_some_and(|origin| match name {
                "layer" | "gamma" => origin.image.is_some(),
                // Its indices are written themselves.
                "material" => origin.values.contains_key("eta"),
                _ => false,
            })
    }

    fn inside<'n>(&self, mut node: &'n Node) -> &'n Node {
        let tag = node.tag.as_str();
        // Factors on textures are in their texels; only the image of the integrator inside is made.
        let wrapper = |node: &Node| match tag {
            "integrator" => WRAPPERS.contains(&node.plugin.as_str()),
            "texture" => node.plugin == "scale",
            _ => false,
        };
        while wrapper(node) {
            match node.parts().find(|part| part.tag == tag) {
                Some(part) => node = part,
                None => break,
            }
        }
        node
    }

    fn plugin(&self, node: &Node) -> Option<&'static str> {
        let mesh = self.mesh(node).map(|_| mesh_format(node));
        mesh.or(stand_in(node).map(|(plugin, _)| plugin))
    }

    fn file(&mut self, node: &Node, path: Option<PathBuf>, name: &str) -> String {
        if let Some(id) = self.origins.of(node).and_then(|o| o.image) {
            let info = self.info(id).clone();
            if let ParamShape::Texture {
                height,
                width,
                channels,
            } = info.shape
            {
                let texels = &self.params.values()[info.range()];
                let data = match channels {
                    1 => texels.iter().flat_map(|&x| [x; 3]).collect(),
                    _ => texels.to_vec(),
                };
                let to = self.free("textures", info.name.trim_end_matches(".data"), "exr");
                self.images.push((
                    to.clone(),
                    Image {
                        width,
                        height,
                        data,
                    },
                ));
                return to;
            }
        }
        if let Some(shape) = self.mesh(node)
            && let AnyShape::Mesh(mesh) = &self.scene.shapes()[shape as usize]
        {
            let name = self.scene.shape_info(shape).name.clone();
            let format = mesh_format(node);
            let to = self.free("meshes", &name, format);
            let bytes = match format {
                "obj" => {
                    let flip_v = node.boolean_or("flip_tex_coords", true).unwrap_or(true);
                    mesh.to_obj(flip_v).into_bytes()
                }
                _ => mesh.to_ply(),
            };
            self.meshes.push((to.clone(), bytes));
            return to;
        }
        let Some(from) = path else {
            // It is missing, and was allowed to be.
            return name.to_owned();
        };
        if let Some(known) = self.files.get(&from) {
            return known.clone();
        }
        let part = |part: Option<&std::ffi::OsStr>| {
            part.map_or_else(String::new, |p| p.to_string_lossy().into_owned())
        };
        let folder = if node.tag == "shape" {
            "meshes"
        } else {
            "textures"
        };
        let to = self.free(folder, &part(from.file_stem()), &part(from.extension()));
        self.files.insert(from.clone(), to.clone());
        self.copies.push((from, to.clone()));
        to
    }
}
