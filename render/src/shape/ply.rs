//! Polygon files (PLY): meshes in text, or in binary of either order of bytes.

use std::io::{BufRead, Cursor};
use std::path::Path;

use ad_core::Vec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult,
};

use super::mesh::{Mesh, MeshData, ObjOptions};
use crate::error::{SceneError, quoted};
use crate::files;
use crate::math::each;
use crate::plugin::{Node, Registry};

/// Largest file in bytes.
const MAX_BYTES: u64 = 1 << 32;
/// Longest header in bytes.
const MAX_HEADER: usize = 1 << 16;

/// What a vertex may have, by the names that programs write; those of equal number are the same.
const VERTEX: [(&str, usize); 14] = [
    ("x", 0),
    ("y", 1),
    ("z", 2),
    ("nx", 3),
    ("ny", 4),
    ("nz", 5),
    ("u", 6),
    ("v", 7),
    ("s", 6),
    ("t", 7),
    ("texture_u", 6),
    ("texture_v", 7),
    ("texture_s", 6),
    ("texture_t", 7),
];
const FACE: [&str; 2] = ["vertex_index", "vertex_indices"];

/// A vertex, a face, or anything else that is read to get past it.
struct Element {
    numbers: [f64; 8],
    indices: Vec<i64>,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self {
            numbers: [0.0; 8],
            indices: Vec::new(),
        }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let list = FACE.contains(&name);
        match property {
            Property::Char(x) => self.number(name, x.into()),
            Property::UChar(x) => self.number(name, x.into()),
            Property::Short(x) => self.number(name, x.into()),
            Property::UShort(x) => self.number(name, x.into()),
            Property::Int(x) => self.number(name, x.into()),
            Property::UInt(x) => self.number(name, x.into()),
            Property::Float(x) => self.number(name, x.into()),
            Property::Double(x) => self.number(name, x),
            Property::ListChar(x) if list => self.indices(x),
            Property::ListUChar(x) if list => self.indices(x),
            Property::ListShort(x) if list => self.indices(x),
            Property::ListUShort(x) if list => self.indices(x),
            Property::ListInt(x) if list => self.indices(x),
            Property::ListUInt(x) if list => self.indices(x),
            _ if list => PropertyAccessResult::UnsupportedType,
            _ => PropertyAccessResult::Ignored,
        }
    }
}

impl Element {
    fn number(&mut self, name: &str, value: f64) -> PropertyAccessResult {
        match VERTEX.iter().find(|(known, _)| *known == name) {
            Some(&(_, i)) => {
                self.numbers[i] = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::Ignored,
        }
    }

    fn indices(&mut self, list: Vec<impl Into<i64>>) -> PropertyAccessResult {
        self.indices = list.into_iter().map(Into::into).collect();
        PropertyAccessResult::Set
    }
}

/// What is wrong: the line if there is one, what was expected, what was found.
type Wrong = (Option<u32>, String, String);

fn wrong(expected: impl Into<String>, found: impl Into<String>) -> Wrong {
    (None, expected.into(), found.into())
}

/// The file that is being read.
struct File<'a> {
    reader: Reader<Cursor<&'a [u8]>>,
    parser: Parser<Element>,
    encoding: Encoding,
    /// Of the text, from one.
    line: u32,
}

impl File<'_> {
    fn left(&self) -> usize {
        let cursor = self.reader.get_ref();
        let at = usize::try_from(cursor.position()).unwrap_or(usize::MAX);
        cursor.get_ref().len().saturating_sub(at)
    }

    /// The next element, which is number `i` of those that `def` describes.
    fn element(&mut self, def: &ElementDef, i: usize) -> Result<Element, Wrong> {
        let expected = || format!("{} of {} `{}`", i + 1, def.count, def.name);
        let cursor = self.reader.get_mut();
        let read = match self.encoding {
            Encoding::Ascii => {
                let mut text = String::new();
                self.line += 1;
                match cursor.read_line(&mut text) {
                    Ok(0) => return Err(wrong(expected(), "the end of the file")),
                    Ok(_) => self.parser.read_ascii_element(text.trim(), def),
                    Err(_) => {
                        let found = "a line that is not in UTF-8".to_owned();
                        return Err((Some(self.line), expected(), found));
                    }
                }
            }
            Encoding::BinaryBigEndian => self.parser.read_big_endian_element(cursor, def),
            Encoding::BinaryLittleEndian => self.parser.read_little_endian_element(cursor, def),
        };
        let text = self.encoding == Encoding::Ascii;
        read.map_err(|e| {
            // The first line of messages that quote the whole input.
            let message = e.to_string();
            let message = message.lines().last().unwrap_or_default().trim();
            let found = format!("an error: {}", quoted(message).trim_matches('`'));
            (text.then_some(self.line), expected(), found)
        })
    }
}

impl Mesh {
    /// Reads a PLY file: vertices with positions, normals and surface coordinates (`u`, `v` or `s`, `t`), and faces;
    /// polygons become fans of triangles. Anything else, such as colours, is left out and listed in the second value. As in
    /// Mitsuba 3, a file without normals gets smooth ones ([`super::smooth_normals`]).
    ///
    /// # Errors
    /// Whatever is wrong, with the line where the file is text.
    pub fn from_ply(path: &Path, options: &ObjOptions) -> Result<(Self, Vec<String>), SceneError> {
        let bytes = files::read(path, MAX_BYTES)?;
        Self::from_ply_bytes(&bytes, path, options)
    }

    /// [`Mesh::from_ply`] on a file's content; `path` is for messages.
    ///
    /// # Errors
    /// See there.
    pub fn from_ply_bytes(
        bytes: &[u8],
        path: &Path,
        options: &ObjOptions,
    ) -> Result<(Self, Vec<String>), SceneError> {
        let asset = |(line, expected, found): Wrong| SceneError::Asset {
            path: path.into(),
            line,
            expected,
            found,
        };
        let (data, ignored) = read(bytes, options).map_err(asset)?;
        let smooth = !options.face_normals && data.normals.is_empty();
        let mesh = Self::with_normals(data, options.flip_normals, smooth).map_err(|e| match e {
            SceneError::Parameter {
                expected, found, ..
            } => asset(wrong(expected, found)),
            other => other,
        })?;
        Ok((mesh, ignored))
    }
}

fn read(bytes: &[u8], options: &ObjOptions) -> Result<(MeshData, Vec<String>), Wrong> {
    if !bytes.starts_with(b"ply") {
        return Err(wrong(
            "a PLY file, which starts with `ply`",
            "another start",
        ));
    }
    let head = &bytes[..bytes.len().min(MAX_HEADER)];
    let end = b"end_header";
    let Some(end) = head.windows(end.len()).position(|w| w == end) else {
        let expected = format!("`end_header` within {MAX_HEADER} bytes");
        return Err(wrong(expected, "none"));
    };
    let parser = Parser::new();
    let mut reader = Reader::new(Cursor::new(bytes));
    let header = parser.read_header(&mut reader).map_err(|e| {
        let message = e.to_string();
        let message = message.lines().last().unwrap_or_default().trim();
        let found = format!("an error: {}", quoted(message).trim_matches('`'));
        let line = e.line().and_then(|n| u32::try_from(n).ok());
        (line, "a well-formed header".to_owned(), found)
    })?;
    let lines = bytes[..end].iter().filter(|b| **b == b'\n').count();
    let mut file = File {
        reader,
        parser,
        encoding: header.encoding,
        line: u32::try_from(lines + 1).unwrap_or(u32::MAX),
    };
    let mut mesh = MeshData::default();
    let has = check_header(&header)?;
    let mut faces = Vec::new();
    let mut seen = false;
    for (name, def) in &header.elements {
        // Each has a byte at least: the header alone promises nothing.
        if def.count > file.left() || def.properties.is_empty() && def.count > 0 {
            let found = format!("{} bytes", file.left());
            return Err(wrong(format!("{} of `{name}`", def.count), found));
        }
        for i in 0..def.count {
            let element = file.element(def, i)?;
            match name.as_str() {
                "vertex" => {
                    let [x, y, z, nx, ny, nz, u, v] = element.numbers;
                    let normal = has.normals.then_some([nx, ny, nz]);
                    let uv = has.uvs.then_some([u, v]);
                    add_vertex(&mut mesh, [x, y, z], normal, uv, options);
                }
                "face" => {
                    let here = (file.encoding == Encoding::Ascii).then_some(file.line);
                    let at = face(&mut faces, &element, i);
                    at.map_err(|(_, expected, found)| (here, expected, found))?;
                    seen = true;
                }
                _ => {}
            }
        }
    }
    if !seen {
        return Err(wrong("at least one face", "none"));
    }
    mesh.triangles = faces;
    // Beyond the vertices, where they may come after the faces.
    let vertices = mesh.positions.len();
    if let Some(t) = (mesh.triangles.iter()).find(|t| t.iter().any(|&i| i as usize >= vertices)) {
        let expected = format!("indices of vertices below {vertices}");
        return Err(wrong(expected, format!("{t:?}")));
    }
    if options.face_normals {
        mesh.normals = Vec::new();
    }
    Ok((mesh, ignored(&header)))
}

/// What vertices have besides their positions.
#[derive(Clone, Copy)]
struct Has {
    normals: bool,
    uvs: bool,
}

fn check_header(header: &Header) -> Result<Has, Wrong> {
    let names = |element: &str| -> Result<Vec<&str>, Wrong> {
        let def = header.elements.get(element);
        let def = def.ok_or_else(|| wrong(format!("the element `{element}`"), "none"))?;
        Ok(def.properties.keys().map(String::as_str).collect())
    };
    let vertex = names("vertex")?;
    let has = |i: usize| {
        let mut known = VERTEX.iter().filter(|(_, k)| *k == i);
        known.any(|(name, _)| vertex.contains(name))
    };
    if !(0..3).all(has) {
        let expected = "vertices with `x`, `y` and `z`";
        return Err(wrong(expected, quoted(&vertex.join(", "))));
    }
    let face = names("face")?;
    if !FACE.iter().any(|name| face.contains(name)) {
        let expected = "faces with `vertex_index` or `vertex_indices`";
        return Err(wrong(expected, quoted(&face.join(", "))));
    }
    Ok(Has {
        normals: (3..6).all(has),
        uvs: (6..8).all(has),
    })
}

/// What is not used, such as `vertex.red`.
fn ignored(header: &Header) -> Vec<String> {
    let mut out = Vec::new();
    for (name, def) in &header.elements {
        let known = |property: &str| match name.as_str() {
            "vertex" => VERTEX.iter().any(|(known, _)| *known == property),
            "face" => FACE.contains(&property),
            _ => false,
        };
        let unknown = def.properties.keys().filter(|p| !known(p));
        out.extend(unknown.map(|p| format!("{name}.{p}")));
    }
    out
}

/// Adds a vertex, in world space.
pub(super) fn add_vertex(
    mesh: &mut MeshData,
    position: [f64; 3],
    normal: Option<[f64; 3]>,
    uv: Option<[f64; 2]>,
    options: &ObjOptions,
) {
    let single = |v: [f64; 3]| each(v, |x| x as f32);
    let to_world = &options.to_world;
    mesh.positions.push(single(to_world.point(position)));
    mesh.normals.extend(normal.map(|n| {
        // As those of OBJ files: a reflection keeps the outside.
        let sign = to_world.determinant().signum();
        let n = Vec3::from(to_world.normal(n)).normalize();
        single(each(n.to_array(), |x| x * sign))
    }));
    mesh.uvs.extend(uv.map(|[u, v]| {
        let v = if options.flip_v { 1.0 - v } else { v };
        [u as f32, v as f32]
    }));
}

/// Adds a face as a fan.
fn face(faces: &mut Vec<[u32; 3]>, element: &Element, i: usize) -> Result<(), Wrong> {
    let indices = &element.indices;
    let bad = |index: &&i64| u32::try_from(**index).is_err();
    if let Some(index) = indices.iter().find(bad) {
        return Err(wrong("indices of vertices", index.to_string()));
    }
    if indices.len() < 3 {
        let expected = format!("at least three vertices of face {i}");
        return Err(wrong(expected, indices.len().to_string()));
    }
    let at = |k: usize| indices[k] as u32;
    faces.extend((1..indices.len() - 1).map(|k| [at(0), at(k), at(k + 1)]));
    Ok(())
}

/// The shape `ply` of a scene file.
pub(super) fn from_node(node: &Node, registry: &mut Registry) -> Result<Mesh, SceneError> {
    let path = node
        .path("filename")?
        .ok_or_else(|| node.missing("filename", "a PLY file"))?;
    let options = ObjOptions {
        to_world: node.transform("to_world")?.unwrap_or_default(),
        face_normals: node.boolean_or("face_normals", false)?,
        flip_normals: node.boolean_or("flip_normals", false)?,
        flip_v: node.boolean_or("flip_tex_coords", false)?,
    };
    let (mesh, ignored) = Mesh::from_ply(&path, &options)?;
    if !ignored.is_empty() {
        let list = quoted(&ignored.join(", "));
        registry
            .warnings
            .push(format!("{}: {list} have no effect", path.display()));
    }
    Ok(mesh)
}
