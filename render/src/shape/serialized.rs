//! The compressed meshes of Mitsuba (`.serialized`): several in one file.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use flate2::bufread::ZlibDecoder;

use super::mesh::{Mesh, ObjOptions};
use super::mesh_data::MeshData;
use super::ply::add_vertex;
use crate::error::{SceneError, quoted};
use crate::files;
use crate::plugin::{Node, Registry};

/// Largest file in bytes.
const MAX_BYTES: u64 = 1 << 32;
/// Most bytes of positions and indices of a mesh within it: few compressed bytes may make many.
const MAX_MESH: u64 = 1 << 30;
/// Longest name of a mesh in bytes.
const MAX_NAME: u64 = 1 << 16;
/// The first two bytes of the file, and of each mesh in it.
const MAGIC: u16 = 0x041c;

const NORMALS: u32 = 0x0001;
const UVS: u32 = 0x0002;
const COLOURS: u32 = 0x0008;
const FACE_NORMALS: u32 = 0x0010;
const DOUBLE: u32 = 0x2000;

/// What was expected, and what was found.
type Wrong = (String, String);

fn wrong(expected: impl Into<String>, found: impl ToString) -> Wrong {
    (expected.into(), found.to_string())
}

impl Mesh {
    /// Reads mesh number `index` of a file of Mitsuba's compressed meshes, of version 3 or 4. Colours of vertices are left
    /// out; the second value says whether there are any. As in Mitsuba 3, a mesh without normals gets smooth ones, unless it
    /// says that its faces are flat.
    ///
    /// # Errors
    /// Whatever is wrong.
    pub fn from_serialized(
        path: &Path,
        index: usize,
        options: &ObjOptions,
    ) -> Result<(Self, bool), SceneError> {
        let bytes = files::read(path, MAX_BYTES)?;
        Self::from_serialized_bytes(&bytes, index, path, options)
    }

    /// [`Mesh::from_serialized`] on a file's content; `path` is for messages.
    ///
    /// # Errors
    /// See there.
    pub fn from_serialized_bytes(
        bytes: &[u8],
        index: usize,
        path: &Path,
        options: &ObjOptions,
    ) -> Result<(Self, bool), SceneError> {
        let asset = |(expected, found): Wrong| SceneError::Asset {
            path: path.into(),
            line: None,
            expected,
            found,
        };
        let (data, smooth, colours) = read(bytes, index, options).map_err(asset)?;
        let mesh = Self::with_normals(data, options.flip_normals, smooth).map_err(|e| match e {
            SceneError::Parameter {
                expected, found, ..
            } => asset((expected, found)),
            other => other,
        })?;
        Ok((mesh, colours))
    }
}

/// A little-endian number at a place.
fn number<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk::<N>().copied()
}

/// Where mesh `index` lies: the places of all are at the end of the file, and their number behind them.
fn place(bytes: &[u8], index: usize) -> Result<&[u8], Wrong> {
    let version = version(bytes)?;
    let cut = || wrong("the places of all meshes at the end", "the end cut off");
    let at = bytes.len().checked_sub(4).ok_or_else(cut)?;
    let count = number(bytes, at).map(u32::from_le_bytes).ok_or_else(cut)?;
    let count = count as usize;
    if index >= count {
        return Err(wrong(
            format!("a mesh of number {index}"),
            format!("{count} meshes"),
        ));
    }
    let width = if version == 4 { 8 } else { 4 };
    let table = width * (count - index);
    let entry = at.checked_sub(table).ok_or_else(cut)?;
    let offset = match width {
        8 => number(bytes, entry).map(u64::from_le_bytes),
        _ => number(bytes, entry).map(|b| u64::from(u32::from_le_bytes(b))),
    };
    let offset = offset
        .and_then(|o| usize::try_from(o).ok())
        .ok_or_else(cut)?;
    let mesh = bytes.get(offset..entry).ok_or_else(cut)?;
    if self::version(mesh)? != version {
        return Err(wrong(format!("a mesh of version {version}"), "another"));
    }
    Ok(&mesh[4..])
}

fn version(bytes: &[u8]) -> Result<u16, Wrong> {
    let pair = |at| number(bytes, at).map(u16::from_le_bytes);
    match (pair(0), pair(2)) {
        (Some(MAGIC), Some(version @ 3..=4)) => Ok(version),
        (Some(MAGIC), Some(version)) => Err(wrong("version 3 or 4", version)),
        _ => Err(wrong("a mesh that Mitsuba serialized", "another start")),
    }
}

/// What is decompressed.
struct Stream<'a> {
    reader: BufReader<ZlibDecoder<&'a [u8]>>,
}

impl Stream<'_> {
    /// So many bytes, which are taken only as they come.
    fn take(&mut self, n: u64, what: &str) -> Result<Vec<u8>, Wrong> {
        let mut out = Vec::new();
        let read = self.reader.by_ref().take(n).read_to_end(&mut out);
        match read {
            Ok(_) if out.len() as u64 == n => Ok(out),
            Ok(_) => Err(wrong(format!("{n} bytes of {what}"), out.len())),
            Err(e) => Err(wrong(
                format!("{n} bytes of {what}"),
                format!("an error: {e}"),
            )),
        }
    }

    fn long(&mut self, what: &str) -> Result<u64, Wrong> {
        let bytes = self.take(8, what)?;
        Ok(number(&bytes, 0).map_or(0, u64::from_le_bytes))
    }

    /// Numbers in single or double precision.
    fn floats(&mut self, n: u64, double: bool, what: &str) -> Result<Vec<f64>, Wrong> {
        if double {
            let bytes = self.take(8 * n, what)?;
            let (numbers, _) = bytes.as_chunks::<8>();
            Ok(numbers.iter().map(|b| f64::from_le_bytes(*b)).collect())
        } else {
            let bytes = self.take(4 * n, what)?;
            let (numbers, _) = bytes.as_chunks::<4>();
            Ok(numbers
                .iter()
                .map(|b| f64::from(f32::from_le_bytes(*b)))
                .collect())
        }
    }
}

/// The mesh, whether it has smooth normals of our making, and whether there are colours.
fn read(bytes: &[u8], index: usize, options: &ObjOptions) -> Result<(MeshData, bool, bool), Wrong> {
    let version = version(bytes)?;
    let compressed = place(bytes, index)?;
    let mut stream = Stream {
        reader: BufReader::new(ZlibDecoder::new(compressed)),
    };
    let flags = stream.take(4, "flags")?;
    let flags = number(&flags, 0).map_or(0, u32::from_le_bytes);
    if version == 4 {
        let mut name = Vec::new();
        let read = stream
            .reader
            .by_ref()
            .take(MAX_NAME)
            .read_until(0, &mut name);
        if read.is_err() || name.last() != Some(&0) {
            return Err(wrong(
                format!("a name of less than {MAX_NAME} bytes"),
                "no end of it",
            ));
        }
    }
    let (vertices, triangles) = (
        stream.long("the number of vertices")?,
        stream.long("the number of triangles")?,
    );
    let double = flags & DOUBLE != 0;
    // Positions and indices alone.
    let least = u128::from(vertices) * 12 + u128::from(triangles) * 12;
    if least > u128::from(MAX_MESH) || vertices >= u64::from(u32::MAX) {
        let expected = format!("a mesh of at most {MAX_MESH} bytes");
        return Err(wrong(
            expected,
            format!("{vertices} vertices and {triangles} triangles"),
        ));
    }
    let has = |flag: u32| flags & flag != 0;
    let positions = stream.floats(3 * vertices, double, "positions")?;
    let mut array = |flag: u32, n: u64, what: &str| {
        let n = if has(flag) { n * vertices } else { 0 };
        stream.floats(n, double, what)
    };
    let normals = array(NORMALS, 3, "normals")?;
    let uvs = array(UVS, 2, "texture coordinates")?;
    array(COLOURS, 3, "colours")?;
    let indices = stream.take(12 * triangles, "triangles")?;
    let (indices, _) = indices.as_chunks::<12>();
    let mut mesh = MeshData::default();
    let normals = normals.as_chunks::<3>().0;
    let uvs = uvs.as_chunks::<2>().0;
    for (i, &position) in positions.as_chunks::<3>().0.iter().enumerate() {
        let (normal, uv) = (normals.get(i).copied(), uvs.get(i).copied());
        add_vertex(&mut mesh, position, normal, uv, options);
    }
    let corner = |bytes: &[u8; 12], k: usize| number(bytes, 4 * k).map_or(0, u32::from_le_bytes);
    mesh.triangles = (indices.iter())
        .map(|t| [0, 1, 2].map(|k| corner(t, k)))
        .collect();
    let outside = |t: &&[u32; 3]| t.iter().any(|&i| u64::from(i) >= vertices);
    if let Some(t) = mesh.triangles.iter().find(outside) {
        let expected = format!("indices of vertices below {vertices}");
        return Err(wrong(expected, format!("{t:?}")));
    }
    let flat = options.face_normals || has(FACE_NORMALS);
    if flat {
        mesh.normals = Vec::new();
    }
    Ok((mesh, !flat && !has(NORMALS), has(COLOURS)))
}

/// The shape `serialized` of a scene file.
pub(super) fn from_node(node: &Node, registry: &mut Registry) -> Result<Mesh, SceneError> {
    let index = node.integer_in("shape_index", 0, 0..=i64::from(u32::MAX))? as usize;
    let options = ObjOptions {
        to_world: node.transform("to_world")?.unwrap_or_default(),
        face_normals: node.boolean_or("face_normals", false)?,
        flip_normals: node.boolean_or("flip_normals", false)?,
        flip_v: node.boolean_or("flip_tex_coords", false)?,
    };
    let path = node
        .path("filename")?
        .ok_or_else(|| node.missing("filename", "a file of serialized meshes"))?;
    let (mesh, colours) = Mesh::from_serialized(&path, index, &options)?;
    if colours {
        let what = quoted("colours of vertices");
        let warning = format!("{}: {what} have no effect", path.display());
        registry.warnings.push(warning);
    }
    Ok(mesh)
}
