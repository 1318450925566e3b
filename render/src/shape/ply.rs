//! Polygon files (PLY): meshes in text, or in binary of either order of bytes.

use std::collections::BTreeMap;
use std::io::{BufRead, Cursor};
use std::path::Path;

use ad_core::Vec3;
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Header, Property, PropertyAccess, PropertyAccessResult, PropertyDef,
    PropertyType,
};
use smallvec::SmallVec;

use super::mesh::{Mesh, ObjOptions};
use super::mesh_data::MeshData;
use crate::error::{SceneError, quoted};
use crate::files;
use crate::image_io::srgb_to_linear;
use crate::math::each;
use crate::plugin::{Attribute, Node, Registry};
use crate::texture;

mod text;

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
const WHOLE_INDICES: &str = "indices of vertices that are whole numbers";

/// A vertex, a face, or anything else that is read to get past it.
struct Element {
    numbers: [f64; 8],
    indices: Vec<i64>,
    /// Numbers of any other name, in the order of the header.
    others: SmallVec<[f64; 8]>,
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self {
            numbers: [0.0; 8],
            indices: Vec::new(),
            others: SmallVec::new(),
        }
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let list = FACE.contains(&name);
        match property {
            Property::Char(x) => self.number(name, x.into(), i8::MAX.into()),
            Property::UChar(x) => self.number(name, x.into(), u8::MAX.into()),
            Property::Short(x) => self.number(name, x.into(), i16::MAX.into()),
            Property::UShort(x) => self.number(name, x.into(), u16::MAX.into()),
            Property::Int(x) => self.number(name, x.into(), i32::MAX.into()),
            Property::UInt(x) => self.number(name, x.into(), u32::MAX.into()),
            Property::Float(x) => self.number(name, x.into(), 0.0),
            Property::Double(x) => self.number(name, x, 0.0),
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
    /// Attributes that are integers are colours in sRGB, of at most `most`.
    fn number(&mut self, name: &str, value: f64, most: f64) -> PropertyAccessResult {
        match VERTEX.iter().find(|(known, _)| *known == name) {
            Some(&(_, i)) => {
                self.numbers[i] = value;
                PropertyAccessResult::Set
            }
            None => {
                let integer = most > 0.0;
                self.others.push(if integer {
                    srgb_to_linear(value / most)
                } else {
                    value
                });
                PropertyAccessResult::Set
            }
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
        let cursor = self.reader.get_mut();
        let read = match self.encoding {
            Encoding::Ascii => return self.line_of(def, i),
            Encoding::BinaryBigEndian => self.parser.read_big_endian_element(cursor, def),
            Encoding::BinaryLittleEndian => self.parser.read_little_endian_element(cursor, def),
        };
        read.map_err(|e| {
            // The first line of messages that quote the whole input.
            let message = e.to_string();
            let message = message.lines().last().unwrap_or_default().trim();
            let found = format!("an error: {}", quoted(message).trim_matches('`'));
            wrong(called(def, i), found)
        })
    }

    /// The same from a file that is text: on the next line that is not empty.
    fn line_of(&mut self, def: &ElementDef, i: usize) -> Result<Element, Wrong> {
        let of = called(def, i);
        let mut line = String::new();
        while line.trim().is_empty() {
            line.clear();
            self.line += 1;
            match self.reader.get_mut().read_line(&mut line) {
                Ok(0) => return Err(wrong(of, "the end of the file")),
                Ok(_) => {}
                Err(_) => {
                    let found = "a line that is not in UTF-8".to_owned();
                    return Err((Some(self.line), of, found));
                }
            }
        }
        text::element(&line, def, &of)
            .map_err(|(expected, found)| (Some(self.line), expected, found))
    }
}

/// What element number `i` of those that `def` describes is called in messages.
fn called(def: &ElementDef, i: usize) -> String {
    format!("{} {} of {}", quoted(&def.name), i + 1, def.count)
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
        let (data, ignored, _) = read(bytes, options, false).map_err(asset)?;
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

/// What a file holds: a mesh, names of what of it has no effect, and attributes.
type Content = (MeshData, Vec<String>, BTreeMap<String, Attribute>);

/// `attributes`: whether those of vertices and faces are kept.
fn read(bytes: &[u8], options: &ObjOptions, attributes: bool) -> Result<Content, Wrong> {
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
        let line = e.line().and_then(|n| u32::try_from(n).ok());
        let text = String::from_utf8_lossy(&bytes[..end]);
        let said = line.and_then(|n| text.lines().nth(n.checked_sub(1)? as usize));
        let found = said.map_or_else(|| "another".to_owned(), |said| quoted(said.trim()));
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
    let mut others = if attributes {
        Others::of(&header)
    } else {
        Others::default()
    };
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
                    others.add("vertex", &element.others, 1);
                }
                "face" => {
                    let here = (file.encoding == Encoding::Ascii).then_some(file.line);
                    let before = faces.len();
                    let at = face(&mut faces, &element, i);
                    others.add("face", &element.others, faces.len() - before);
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
    Ok((mesh, ignored(&header), others.found))
}

/// Numbers of vertices and faces besides their places, as attributes that textures may ask for.
#[derive(Default)]
struct Others {
    /// Names as Mitsuba gives them, which element has them, and which of its other numbers they are.
    groups: Vec<(String, &'static str, Vec<usize>)>,
    found: BTreeMap<String, Attribute>,
}

/// What the last part of the name of a number may be, if it is one of several.
const PARTS: [&[&str]; 4] = [
    &["r", "g", "b"],
    &["x", "y", "z"],
    &["0", "1", "2"],
    &["1", "2", "3"],
];

impl Others {
    fn of(header: &Header) -> Self {
        let mut groups: Vec<(String, &'static str, Vec<usize>)> = Vec::new();
        for element in ["vertex", "face"] {
            let Some(def) = header.elements.get(element) else {
                continue;
            };
            let scalar = |p: &&PropertyDef| matches!(p.data_type, PropertyType::Scalar(_));
            let known = |name: &str| VERTEX.iter().any(|(known, _)| *known == name);
            let names = def
                .properties
                .values()
                .filter(scalar)
                .map(|p| p.name.as_str());
            for (i, name) in names.filter(|name| !known(name)).enumerate() {
                let name = match name {
                    "red" | "r" => "color_r",
                    "green" | "g" => "color_g",
                    "blue" | "b" => "color_b",
                    name => name,
                };
                let cut = name
                    .rfind(['_', '.'])
                    .filter(|&cut| PARTS.iter().any(|parts| parts.contains(&&name[cut + 1..])));
                let name = format!("{element}_{}", &name[..cut.unwrap_or(name.len())]);
                match groups.last_mut() {
                    Some((last, of, columns)) if *last == name && *of == element => columns.push(i),
                    _ => groups.push((name, element, vec![i])),
                }
            }
        }
        groups.retain(|(.., columns)| [1, 3].contains(&columns.len()));
        Self {
            groups,
            found: BTreeMap::new(),
        }
    }

    /// The other numbers of an element, for so many vertices or triangles.
    fn add(&mut self, element: &str, numbers: &[f64], times: usize) {
        for (name, of, columns) in self.groups.iter().filter(|(_, of, _)| *of == element) {
            let attribute = self.found.entry(name.clone()).or_insert_with(|| Attribute {
                of_faces: *of == "face",
                channels: columns.len(),
                values: Vec::new(),
            });
            for _ in 0..times {
                let values = columns
                    .iter()
                    .map(|&c| numbers.get(c).map_or(0.0, |&x| x as f32));
                attribute.values.extend(values);
            }
        }
    }
}

/// A mesh whose triangles share no vertices: its surface coordinates say which triangle a point is on.
fn told_apart(mesh: &MeshData) -> Option<MeshData> {
    let columns = texture::columns(mesh.triangles.len())?;
    let corners = || mesh.triangles.as_flattened().iter().map(|&i| i as usize);
    let pick = |all: &[[f32; 3]]| -> Vec<[f32; 3]> {
        corners().filter_map(|i| all.get(i).copied()).collect()
    };
    let count = mesh.triangles.len() as u32;
    Some(MeshData {
        positions: pick(&mesh.positions),
        normals: pick(&mesh.normals),
        uvs: (0..count)
            .flat_map(|t| texture::place(t, columns))
            .collect(),
        triangles: (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    })
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
        let others = || {
            let names: Vec<_> = header.elements.keys().map(|name| quoted(name)).collect();
            if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            }
        };
        let def = def.ok_or_else(|| wrong(format!("the element `{element}`"), others()))?;
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

impl Mesh {
    /// The mesh as the content of a PLY file, binary, in little-endian order: positions in world space, texture coordinates
    /// and normals where it has them. Normals that follow the positions are left out: readers make the same ones.
    pub fn to_ply(&self) -> Vec<u8> {
        let mesh = self.data();
        let normals: &[_] = if self.has_given_normals() {
            &mesh.normals
        } else {
            &[]
        };
        let mut text = "ply\nformat binary_little_endian 1.0\n".to_owned();
        text += &format!("element vertex {}\n", mesh.positions.len());
        let names = [
            (true, &["x", "y", "z"][..]),
            (!normals.is_empty(), &["nx", "ny", "nz"]),
            (!mesh.uvs.is_empty(), &["u", "v"]),
        ];
        for name in names
            .iter()
            .filter(|(has, _)| *has)
            .flat_map(|(_, names)| *names)
        {
            text += &format!("property float {name}\n");
        }
        text += &format!("element face {}\n", mesh.triangles.len());
        text += "property list uchar int vertex_indices\nend_header\n";
        let mut bytes = text.into_bytes();
        for (i, position) in mesh.positions.iter().enumerate() {
            let normal = normals.get(i).map_or(&[][..], |n| n);
            let uv = mesh.uvs.get(i).map_or(&[][..], |uv| uv);
            let numbers = position.iter().chain(normal).chain(uv);
            bytes.extend(numbers.flat_map(|x| x.to_le_bytes()));
        }
        for triangle in &mesh.triangles {
            bytes.push(3);
            bytes.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
        }
        bytes
    }
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
    let options = ObjOptions {
        to_world: node.transform("to_world")?.unwrap_or_default(),
        face_normals: node.boolean_or("face_normals", false)?,
        flip_normals: node.boolean_or("flip_normals", false)?,
        flip_v: node.boolean_or("flip_tex_coords", false)?,
    };
    let path = node
        .path("filename")?
        .ok_or_else(|| node.missing("filename", "a PLY file"))?;
    let (mut mesh, mut ignored) = Mesh::from_ply(&path, &options)?;
    if let Some(asked) = registry
        .attributes
        .as_mut()
        .filter(|a| !a.wanted.is_empty())
    {
        let bytes = files::read(&path, MAX_BYTES)?;
        // It was read before.
        let attributes = read(&bytes, &options, true).map(|(.., attributes)| attributes);
        let too_many = || node.invalid("filename", "fewer triangles, for a mesh with attributes");
        asked.triangles = mesh.data().triangles.clone().into();
        asked.found = attributes.ok();
        let apart = told_apart(mesh.data()).ok_or_else(too_many)?;
        mesh = Mesh::new(apart, options.flip_normals)?;
        ignored.clear();
    }
    if !ignored.is_empty() {
        let list = quoted(&ignored.join(", "));
        registry
            .warnings
            .push(format!("{}: {list} have no effect", path.display()));
    }
    Ok(mesh)
}
