//! Scenes as files again.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Scene;
use crate::error::SceneError;
use crate::files;
use crate::film::Image;
use crate::image_io;
use crate::params::{ParamInfo, ParamShape, Params};
use crate::plugin::Node;
use crate::plugin::Origins;
use crate::plugin::xml::{Number, Rewrite, written};

/// What a scene was read from.
#[derive(Debug)]
pub(super) struct Source {
    pub root: Arc<Node>,
    pub origins: Origins,
    /// The values of parameters that no part of the file holds, which therefore cannot change.
    pub fixed: Vec<(u32, Vec<f32>)>,
}

impl Source {
    pub fn new(root: Arc<Node>, origins: Origins, params: &Params) -> Self {
        let written: HashSet<u32> = origins.params().collect();
        let rest = (0u32..)
            .zip(params.infos())
            .filter(|(id, _)| !written.contains(id));
        let fixed = rest.map(|(id, info)| (id, params.values()[info.range()].to_vec()));
        Self {
            fixed: fixed.collect(),
            root,
            origins,
        }
    }
}

impl Scene {
    /// Writes the scene, with the parameters that it has now, as a file that this renderer and Mitsuba 3 read: images of
    /// texels as OpenEXR in the folder `textures` beside it, meshes copied into `meshes`. What has no effect here is
    /// written as it was read. Returns all files, the scene last.
    ///
    /// # Errors
    /// A scene that was not read from a file; a folder in which one of its own files would be replaced; a parameter that
    /// has changed and that no attribute or image of the file holds, such as the colours of meshes, the images in spot
    /// lights, and what moves; the operating system's.
    pub fn save(&self, path: &Path) -> Result<Vec<PathBuf>, SceneError> {
        let bad = |key: &str, expected: &str, found: &str| SceneError::Parameter {
            key: key.to_owned(),
            expected: expected.to_owned(),
            found: found.to_owned(),
        };
        let source = self.source.as_ref();
        let source =
            source.ok_or_else(|| bad("scene", "one that was read from a file", "another"))?;
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
            files: HashMap::new(),
            names: HashSet::new(),
            images: Vec::new(),
            copies: Vec::new(),
        };
        let text = written(&source.root, &mut writing);
        let Writing { images, copies, .. } = writing;
        let same = |a: &Path, b: &Path| match (a.canonicalize(), b.canonicalize()) {
            (Ok(a), Ok(b)) => a == b,
            _ => false,
        };
        let copies: Vec<(PathBuf, PathBuf)> = (copies.into_iter())
            .map(|(from, to)| (from, folder.join(to)))
            .filter(|(from, to)| !same(from, to))
            .collect();
        let written = images.iter().map(|(to, _)| folder.join(to));
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
        for (from, to) in copies {
            make(&to)?;
            let bytes = files::read(&from, u64::MAX)?;
            image_io::write_atomically(&to, &bytes)?;
            all.push(to);
        }
        make(path)?;
        image_io::write_atomically(path, text.as_bytes())?;
        all.push(path.to_owned());
        Ok(all)
    }
}

/// What becomes of values and files while a scene is written.
struct Writing<'a> {
    params: &'a Params,
    origins: &'a Origins,
    /// The new names of files that were named before.
    files: HashMap<PathBuf, String>,
    names: HashSet<String>,
    images: Vec<(String, Image)>,
    copies: Vec<(PathBuf, String)>,
}

impl Writing<'_> {
    fn info(&self, id: u32) -> &ParamInfo {
        &self.params.infos()[id as usize]
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

impl Rewrite for Writing<'_> {
    fn values(&mut self, node: &Node) -> Vec<(String, Number)> {
        let Some(origin) = self.origins.of(node) else {
            return Vec::new();
        };
        let mut out = Vec::new();
        for (key, &id) in &origin.values {
            let info = self.info(id);
            let number = match self.params.values()[info.range()] {
                [x] => Number::Scalar(x),
                [r, g, b] => Number::Colour([r, g, b]),
                _ => continue,
            };
            out.push((key.clone(), number));
        }
        if let Some(id) = origin.index {
            let eta = self.params.values()[self.info(id).offset];
            out.push(("int_ior".to_owned(), Number::Scalar(eta)));
            out.push(("ext_ior".to_owned(), Number::Scalar(1.0)));
        }
        out
    }

    fn is_gone(&self, node: &Node, name: &str) -> bool {
        self.origins.of(node).is_some_and(|origin| match name {
            "layer" => origin.image.is_some(),
            // Its indices are written themselves.
            "material" => origin.values.contains_key("eta"),
            _ => false,
        })
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
