//! Triangle meshes, and Wavefront OBJ files.

use std::borrow::Cow;
use std::io::{self, BufRead, Read};
use std::path::Path;
use std::sync::{Arc, OnceLock};

use ad_core::{Const, Dual, Float, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::mesh_data::{MeshData, smooth_normals};
use super::partials::variables;
use super::patch::intersect_plane;
use super::vertices::{MovingNormals, MovingTriangle, MovingVertices};
use super::welding::Welding;
use super::{
    DirectionSample, Partials, Shape, ShapeSample, SurfaceAdjoint, SurfaceCoordinates,
    SurfaceInteraction, coordinates_in_plane, hit_is_exact, lift3,
};
use crate::accel::{Hit, MAX_COORDINATE, Primitive};
use crate::error::{SceneError, quoted};
use crate::files;
use crate::math::{Frame, Ray, Transform, each, warp};
use crate::params::{GradSink, ParamRef, Params, Theta};
use crate::prefetch::prefetch;

/// Largest OBJ file in bytes.
const MAX_BYTES: u64 = 1 << 33;

/// Triangles with interpolated normals and texture coordinates. Cheap to clone.
///
/// Degenerate triangles are kept but never hit or sampled.
#[derive(Clone, Debug)]
pub struct Mesh {
    pub(super) data: Arc<Data>,
    /// If they are parameters.
    pub(super) vertices: Option<MovingVertices>,
    /// Likewise.
    pub(super) normals: Option<MovingNormals>,
}

#[derive(Debug)]
pub(super) struct Data {
    pub mesh: MeshData,
    pub flip: bool,
    /// Whether the normals are [`smooth_normals`], and follow the positions.
    pub smooth: bool,
    area: f64,
    extent: f32,
    /// Running sums of the triangles' areas: only meshes that emit need them.
    cdf: OnceLock<Vec<f64>>,
    /// See [`Mesh::welding`]; made by the first call.
    pub welding: OnceLock<Arc<Welding>>,
}

impl Mesh {
    /// The triangle that a number in [0, 1) chooses, by its part of the area, and where in that part the number is, from 0 to 1.
    #[inline]
    pub(crate) fn draw_triangle<P: Float>(&self, u: P) -> (u32, P) {
        let (i, _, reused) = pick(self.data.running_areas(), u.to_f64());
        (i as u32, P::of(reused))
    }

    /// From arrays.
    ///
    /// # Errors
    /// [`SceneError::Parameter`]: no triangles, no area, a vertex that is not finite (or out of reach
    /// of [`crate::accel`]), an index without a vertex, arrays of different lengths.
    pub fn new(mesh: MeshData, flip_normals: bool) -> Result<Self, SceneError> {
        Self::with_normals(mesh, flip_normals, false)
    }

    /// Whether the axes of the shading frame jump within a face, as normals do there that cross the plane of x and y where no
    /// texture coordinates say how axes lie around them ([`Frame::from_normal`](crate::math::Frame::from_normal)).
    pub(crate) fn axes_jump(&self) -> bool {
        let mesh = &self.data.mesh;
        let crosses = |t: &[u32; 3]| {
            let below = t.map(|i| mesh.normals[i as usize][2].is_sign_negative());
            below[1] != below[0] || below[2] != below[0]
        };
        let mut faces = mesh.triangles.iter().enumerate();
        !mesh.normals.is_empty()
            && faces.any(|(i, t)| crosses(t) && self.data.triangle(i).slopes() == [0.0; 2])
    }

    /// The same of a mesh without normals, with those of [`smooth_normals`]: they follow the positions.
    ///
    /// # Errors
    /// As [`Mesh::new`].
    pub fn smoothed(mesh: MeshData, flip_normals: bool) -> Result<Self, SceneError> {
        Self::with_normals(mesh, flip_normals, true)
    }

    pub(super) fn with_normals(
        mut mesh: MeshData,
        flip_normals: bool,
        smooth: bool,
    ) -> Result<Self, SceneError> {
        let error = |expected: &str, found: String| SceneError::Parameter {
            key: "mesh".into(),
            expected: expected.into(),
            found,
        };
        let vertices = mesh.positions.len();
        if mesh.triangles.is_empty() {
            return Err(error("at least one triangle", "none".into()));
        }
        for (what, n) in [("normals", mesh.normals.len()), ("uvs", mesh.uvs.len())] {
            if n != 0 && n != vertices {
                return Err(error(
                    &format!("no {what}, or one for each of {vertices} vertices"),
                    n.to_string(),
                ));
            }
        }
        let bad = |x: &f32| x.is_nan() || x.abs() > MAX_COORDINATE;
        if let Some(i) = mesh.positions.iter().position(|p| p.iter().any(bad)) {
            return Err(error(
                &format!("finite vertices of magnitude at most {MAX_COORDINATE:e}"),
                format!("{:?} for vertex {i}", mesh.positions[i]),
            ));
        }
        let infinite = |x: &f32| !x.is_finite();
        if let Some(i) = mesh.normals.iter().position(|n| n.iter().any(infinite)) {
            return Err(error("finite normals", format!("{:?}", mesh.normals[i])));
        }
        if let Some(i) = mesh.uvs.iter().position(|t| t.iter().any(infinite)) {
            return Err(error("finite uvs", format!("{:?}", mesh.uvs[i])));
        }
        let outside = |t: &&[u32; 3]| t.iter().any(|&i| i as usize >= vertices);
        if let Some(t) = mesh.triangles.iter().find(outside) {
            return Err(error(
                &format!("vertex indices below {vertices}"),
                format!("{t:?}"),
            ));
        }
        if smooth {
            mesh.normals = smooth_normals(&mesh.positions, &mesh.triangles);
        }
        let extent = mesh
            .positions
            .as_flattened()
            .iter()
            .fold(0.0, |m: f32, x| m.max(x.abs()));
        let mut data = Data {
            mesh,
            flip: flip_normals,
            smooth,
            area: 0.0,
            extent,
            cdf: OnceLock::new(),
            welding: OnceLock::new(),
        };
        data.area = (0..data.mesh.triangles.len())
            .map(|i| data.triangle(i).double_area() * 0.5)
            .sum();
        if data.area.is_nan() || data.area <= 0.0 {
            return Err(error(
                "at least one triangle with an area",
                "only degenerate ones".into(),
            ));
        }
        Ok(Self {
            data: Arc::new(data),
            vertices: None,
            normals: None,
        })
    }

    /// Reads a Wavefront OBJ file: positions, normals, texture coordinates and faces; polygons become
    /// fans of triangles. Groups and materials are ignored. As in Mitsuba 3, a file
    /// without any normals gets smooth ones ([`smooth_normals`]), and `flip_v` turns v into 1 - v. The second value says what
    /// is no face and has no effect, such as lines and points, with the first line of each kind.
    ///
    /// # Errors
    /// Whatever is wrong, with the line where there is one.
    pub fn from_obj(path: &Path, options: &ObjOptions) -> Result<(Self, Vec<String>), SceneError> {
        let text = files::read(path, MAX_BYTES)?;
        Self::from_obj_text(&text, path, options)
    }

    /// [`Mesh::from_obj`] on a file's content; `path` is for messages.
    ///
    /// # Errors
    /// See there.
    pub fn from_obj_text(
        text: &[u8],
        path: &Path,
        options: &ObjOptions,
    ) -> Result<(Self, Vec<String>), SceneError> {
        let asset = |line: Option<u32>, expected: &str, found: &str| SceneError::Asset {
            path: path.into(),
            line,
            expected: expected.into(),
            found: found.into(),
        };
        if text.starts_with(&[0xff, 0xfe]) || text.starts_with(&[0xfe, 0xff]) {
            return Err(asset(Some(1), "text in UTF-8", "UTF-16"));
        }
        let mut reader = ObjLines::new(text);
        // Points and lines have no surface; `ObjLines` does not let them through.
        let load = tobj::LoadOptions {
            single_index: true,
            triangulate: true,
            ..Default::default()
        };
        let no_materials = |_: &Path| Err(tobj::LoadError::OpenFileFailed);
        let models = match tobj::load_obj_buf(&mut reader, &load, no_materials) {
            Ok((models, _)) => models,
            Err(e) => {
                return Err(match reader.complaint {
                    Some((expected, found)) => asset(Some(reader.line), expected, &found),
                    None => asset(Some(reader.line), "a well-formed line", &e.to_string()),
                });
            }
        };
        let mut mesh = MeshData::default();
        for model in models {
            append(&mut mesh, &model.mesh, options)
                .map_err(|found| asset(None, "matching arrays in the file", found))?;
        }
        let skipped: Vec<String> = (reader.skipped.iter())
            .map(|(word, line)| {
                format!("{}:{line}: {} has no effect", path.display(), quoted(word))
            })
            .collect();
        if mesh.triangles.is_empty() {
            let found = match reader.skipped.first() {
                Some((word, line)) => format!("none, but {} in line {line}", quoted(word)),
                None => "none".to_owned(),
            };
            return Err(asset(None, "at least one face", &found));
        }
        if options.face_normals {
            mesh.normals = Vec::new();
        }
        let smooth = !options.face_normals && reader.counts[2] == 0;
        let mesh = Self::with_normals(mesh, options.flip_normals, smooth).map_err(|e| match e {
            SceneError::Parameter {
                expected, found, ..
            } => asset(None, &expected, &found),
            other => other,
        })?;
        Ok((mesh, skipped))
    }

    /// The mesh as the text of an OBJ file, in world space: positions, texture coordinates and normals where it has them, and
    /// faces. Normals that follow the positions are left out: readers make the same ones. Numbers have as many digits
    /// as tell them from their neighbours. `flip_v` is that of the [`ObjOptions`] to read it with: v is written as 1 - v, which
    /// brings all that was read so back to the last bit.
    pub fn to_obj(&self, flip_v: bool) -> String {
        let mesh = self.data();
        let normals: &[_] = if self.has_given_normals() {
            &mesh.normals
        } else {
            &[]
        };
        let mut text = String::new();
        for [x, y, z] in &mesh.positions {
            text += &format!("v {x} {y} {z}\n");
        }
        for &[u, v] in &mesh.uvs {
            let v = if flip_v { 1.0 - v } else { v };
            text += &format!("vt {u} {v}\n");
        }
        for [x, y, z] in normals {
            text += &format!("vn {x} {y} {z}\n");
        }
        let has_normal = |&i: &u32| normals.get(i as usize).is_some_and(|n| *n != [0.0; 3]);
        for triangle in &mesh.triangles {
            // Those whose normals are zero are flat.
            let smooth = triangle.iter().any(has_normal);
            text.push('f');
            for i in each(*triangle, |i| u64::from(i) + 1) {
                text += &format!(" {i}");
                if !mesh.uvs.is_empty() {
                    text += &format!("/{i}");
                } else if smooth {
                    text.push('/');
                }
                if smooth {
                    text += &format!("/{i}");
                }
            }
            text.push('\n');
        }
        text
    }

    /// The arrays.
    pub fn data(&self) -> &MeshData {
        &self.data.mesh
    }

    /// Whether its normals were given, and stay where positions change.
    pub fn has_given_normals(&self) -> bool {
        !self.data.smooth && !self.data.mesh.normals.is_empty()
    }

    /// What one of its triangles is made of.
    #[inline(always)]
    pub(crate) fn triangle(&self, prim: u32) -> Triangle {
        self.data.triangle(prim as usize)
    }

    /// All of them.
    pub(crate) fn all_triangles(&self) -> impl Iterator<Item = Triangle> + '_ {
        (0..self.data.mesh.triangles.len()).map(|i| self.data.triangle(i))
    }

    /// Where its arrays are in memory.
    pub(crate) fn address(&self) -> usize {
        Arc::as_ptr(&self.data).addr()
    }

    /// Whether its normals are [`smooth_normals`].
    pub(super) fn has_smooth_normals(&self) -> bool {
        self.data.smooth
    }

    /// Whether the surface was turned around.
    pub(super) fn is_flipped(&self) -> bool {
        self.data.flip
    }

    /// Bytes held by the arrays.
    pub fn memory_bytes(&self) -> usize {
        let m = &self.data.mesh;
        size_of_val(&m.positions[..])
            + size_of_val(&m.normals[..])
            + size_of_val(&m.uvs[..])
            + size_of_val(&m.triangles[..])
            + self.data.cdf.get().map_or(0, |c| size_of_val(&c[..]))
            + (self.data.welding.get()).map_or(0, |w| 4 * (w.points.len() + w.firsts.len()))
    }
}

/// Which of running sums of areas a number chooses, how large that area is, and where in it the number is, from 0 to 1.
pub(super) fn pick(cdf: &[f64], u: f64) -> (usize, f64, f64) {
    let total = cdf[cdf.len() - 1];
    let x = (u * total).min(total.next_down());
    // The first whose sum exceeds x: never one without an area.
    let i = cdf.partition_point(|&c| c <= x).min(cdf.len() - 1);
    let before = if i == 0 { 0.0 } else { cdf[i - 1] };
    let share = cdf[i] - before;
    (i, share, ((x - before) / share).clamp(0.0, 1.0))
}

/// A triangle that is drawn from running sums of areas, and barycentric coordinates of its second and third vertex.
pub(super) fn choose<P: Float>(cdf: &[f64], u: [P; 2]) -> (usize, Vec2<P>) {
    let (i, _, reused) = pick(cdf, u[0].to_f64());
    (i, warp::square_to_triangle([P::of(reused), u[1]]))
}

/// Running sums of the areas of triangles.
pub(super) fn running_areas(triangles: impl Iterator<Item = Triangle>) -> Vec<f64> {
    let mut sum = 0.0;
    let areas = triangles.map(|t| {
        sum += 0.5 * t.double_area();
        sum
    });
    areas.collect()
}

impl Data {
    /// Running sums of the areas of its triangles.
    #[inline]
    fn running_areas(&self) -> &[f64] {
        self.cdf.get_or_init(|| {
            let count = self.mesh.triangles.len();
            running_areas((0..count).map(|i| self.triangle(i)))
        })
    }

    /// What a triangle is made of.
    #[inline(always)]
    pub(super) fn triangle(&self, triangle: usize) -> Triangle {
        let m = &self.mesh;
        let t = m.triangles[triangle];
        Triangle {
            normals: (!m.normals.is_empty()).then(|| corners(&m.normals, t)),
            uvs: (!m.uvs.is_empty()).then(|| corners(&m.uvs, t)),
            ..Triangle::new(corners(&m.positions, t), self.flip)
        }
    }
}

/// What a triangle has of an array over vertices.
#[inline(always)]
pub(super) fn corners<T: Copy>(all: &[T], [a, b, c]: [u32; 3]) -> [T; 3] {
    [all[a as usize], all[b as usize], all[c as usize]]
}

/// [`Triangle::slopes`] of texture coordinates.
#[inline(always)]
fn slopes_in_line([a, b, c]: [[f32; 2]; 3]) -> [f64; 2] {
    let minus = |x: f32, y: f32| f64::from(x) - f64::from(y);
    let (dv1, dv2) = (minus(b[1], a[1]), minus(c[1], a[1]));
    let det = minus(b[0], a[0]) * dv2 - dv1 * minus(c[0], a[0]);
    let sign = f64::select(det == 0.0, 0.0, 1.0_f64.copysign(det));
    [dv2 * sign, -(dv1 * sign)]
}

/// What a triangle of a mesh is made of, world space: all that is known of its surface follows from it. What rays ask is
/// inlined, so that it stays in registers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle {
    pub v0: [f32; 3],
    /// From there, rounded as the ray sees them.
    pub edges: [[f32; 3]; 2],
    pub normals: Option<[[f32; 3]; 3]>,
    pub uvs: Option<[[f32; 2]; 3]>,
    /// Whether it is turned around.
    pub flip: bool,
}

/// The surface of a triangle at barycentric `(u, v)`, as [`Triangle::surface`] has it, number by number, in steps
/// without a branch: for loops over many, in which what is looked up in memory is gathered before. Each tells whether it is
/// right; otherwise [`Shape::interaction`] has to be asked.
pub(crate) struct SurfaceInLine;

impl SurfaceInLine {
    /// [`Triangle::flat_normal`].
    #[inline(always)]
    pub fn flat_normal(e1: Vec3<f64>, e2: Vec3<f64>) -> (Vec3<f64>, bool) {
        e1.cross(e2).unit()
    }

    /// [`Triangle::dp_du`], zero if the triangle is not `mapped`.
    #[inline(always)]
    pub fn dp_du([e1, e2]: [Vec3<f64>; 2], uvs: [[f32; 2]; 3], mapped: bool) -> (Vec3<f64>, bool) {
        let [a, b] = slopes_in_line(uvs);
        let there = mapped & ((a != 0.0) | (b != 0.0));
        let (along, right) = (e1 * a + e2 * b).unit();
        let along = Vec3::select(there, along, Vec3::zero());
        (along, right | !there)
    }

    /// The unit normal that scattering goes by, and the geometric one on its side: of a triangle with the `flat` normal,
    /// interpolated between `normals` if it is `smooth`.
    #[inline(always)]
    pub fn normals<P: Float>(
        [w, u, v]: [P; 3],
        flat: Vec3<P>,
        [a, b, c]: [Vec3<P>; 3],
        (smooth, flip): (bool, bool),
    ) -> ([Vec3<P>; 2], bool) {
        let (between, right) = (a * w + b * u + c * v).unit();
        let n = Vec3::select(smooth, between, flat);
        let behind = smooth & (between.dot(flat) < P::zero());
        let n_geo = Vec3::select(behind, -flat, flat);
        let turned = |x: Vec3<P>| Vec3::select(flip, -x, x);
        ([turned(n), turned(n_geo)], right | !smooth)
    }
}

impl Triangle {
    /// Without normals and texture coordinates.
    #[inline(always)]
    pub fn new([a, b, c]: [[f32; 3]; 3], flip: bool) -> Self {
        let minus = |x: [f32; 3]| [x[0] - a[0], x[1] - a[1], x[2] - a[2]];
        Self {
            v0: a,
            edges: [minus(b), minus(c)],
            normals: None,
            uvs: None,
            flip,
        }
    }

    #[inline(always)]
    fn wide_edges(&self) -> [Vec3<f64>; 2] {
        let [e1, e2] = self.edges;
        [lift3(e1), lift3(e2)]
    }

    #[inline]
    pub fn double_area(&self) -> f64 {
        let [e1, e2] = self.wide_edges();
        e1.cross(e2).length()
    }

    /// Along `e1 x e2`, of unit length. In f64, where the product of small edges does not underflow.
    #[inline(always)]
    pub fn flat_normal<R: Real>(&self) -> Vec3<R> {
        let [e1, e2] = self.wide_edges();
        let flat = e1.cross(e2).normalize();
        Vec3::new(R::of(flat.x), R::of(flat.y), R::of(flat.z))
    }

    /// How much of each edge is in the direction of increasing u, up to a common factor; zero where the texture
    /// coordinates are degenerate, or where there are none.
    #[inline(always)]
    pub fn slopes(&self) -> [f64; 2] {
        self.uvs.map_or([0.0; 2], slopes_in_line)
    }

    /// The direction of increasing u, zero where the texture coordinates are degenerate. Its length
    /// means nothing.
    #[inline(always)]
    fn dp_du(&self) -> Vec3<f64> {
        let [e1, e2] = self.wide_edges();
        let [a, b] = self.slopes();
        (e1 * a + e2 * b).normalize()
    }

    /// Shading frame, geometric normal on its side, and texture coordinates at barycentric `(u, v)`.
    #[inline(always)]
    fn surface<R: Real>(
        &self,
        u: R,
        v: R,
        moving: Option<&MovingTriangle<R>>,
    ) -> (Frame<R>, Vec3<R>, Vec2<R>) {
        let mut flat = self.flat_normal::<R>();
        if let Some(moving) = moving {
            flat += moving.flat_normal(self.edges);
        }
        let w = R::one() - u - v;
        let smooth = match self.normals {
            None => Vec3::zero(),
            Some([a, b, c]) => {
                let [mut a, mut b, mut c] = [lift3::<R>(a), lift3::<R>(b), lift3::<R>(c)];
                if let Some(moving) = moving {
                    a += moving.normals[0];
                    b += moving.normals[1];
                    c += moving.normals[2];
                }
                (a * w + b * u + c * v).normalize()
            }
        };
        let (mut n, mut n_geo) = (smooth, flat);
        let side = smooth.primal().dot(flat.primal());
        if smooth.primal().length_squared() == R::Primal::zero() {
            n = flat;
        } else if side < R::Primal::zero() {
            // Emission and scattering go by the shading normal.
            n_geo = -flat;
        }
        if self.flip {
            (n, n_geo) = (-n, -n_geo);
        }
        let Some([a, b, c]) = self.uvs else {
            return (Frame::from_normal(n), n_geo, Vec2::new(u, v));
        };
        let lift2 = |x: [f32; 2]| -> Vec2<R> {
            Vec2::new(
                R::lift(R::Primal::from_f32(x[0])),
                R::lift(R::Primal::from_f32(x[1])),
            )
        };
        let [a, b, c] = [lift2(a), lift2(b), lift2(c)];
        let uv = Vec2::new(a.x * w + b.x * u + c.x * v, a.y * w + b.y * u + c.y * v);
        let dp_du = self.dp_du();
        let mut dp_du = Vec3::new(R::of(dp_du.x), R::of(dp_du.y), R::of(dp_du.z));
        if let Some(moving) = moving {
            dp_du += moving.dp_du(self.edges, self.slopes());
        }
        (Frame::from_normal_and_tangent(n, dp_du), n_geo, uv)
    }

    /// A corner and the two edges from there.
    #[inline(always)]
    fn corner_and_edges<R: Real>(&self, moving: Option<&MovingTriangle<R>>) -> [Vec3<R>; 3] {
        let [e1, e2] = self.edges;
        let still = [lift3::<R>(self.v0), lift3::<R>(e1), lift3::<R>(e2)];
        moving.map_or(still, |m| m.corner_and_edges(still))
    }

    /// The point at barycentric `(u, v)`.
    #[inline(always)]
    pub(super) fn point<R: Real>(
        &self,
        u: R,
        v: R,
        moving: Option<&MovingTriangle<R>>,
    ) -> SurfaceInteraction<R> {
        let [v0, e1, e2] = self.corner_and_edges(moving);
        let (frame, n_geo, uv) = self.surface(u, v, moving);
        SurfaceInteraction {
            p: v0 + e1 * u + e2 * v,
            t: R::zero(),
            n_geo,
            frame,
            uv,
        }
    }

    /// See [`Shape::interaction`].
    #[inline(always)]
    pub(super) fn seen<R: Real>(
        &self,
        ray: &Ray<R>,
        hit: &Hit,
        moving: Option<&MovingTriangle<R>>,
    ) -> SurfaceInteraction<R> {
        let (t, u, v) = if hit_is_exact::<R>() {
            let exact = |x: f32| R::lift(R::Primal::from_f32(x));
            (exact(hit.t), exact(hit.u), exact(hit.v))
        } else {
            let [v0, e1, e2] = self.corner_and_edges(moving);
            intersect_plane(ray, v0, e1, e2)
        };
        SurfaceInteraction {
            t,
            ..self.point(u, v, moving)
        }
    }

    /// The point there, if triangles are chosen by their part of an area.
    pub(super) fn sampled<R: Real>(
        &self,
        prim: u32,
        at: Vec2<R::Primal>,
        area: f64,
        moving: Option<&MovingTriangle<R>>,
    ) -> ShapeSample<R> {
        let si = self.point::<R>(R::lift(at.x), R::lift(at.y), moving);
        ShapeSample {
            p: si.p,
            n: si.frame.n,
            uv: si.uv,
            pdf: R::Primal::of(1.0 / area),
            prim,
            coordinates: SurfaceCoordinates(at),
        }
    }

    /// See [`Shape::locate`].
    pub fn locate<P: Float>(&self, p: Vec3<P>) -> SurfaceCoordinates<P> {
        let [e1, e2] = self.edges;
        coordinates_in_plane(p, self.v0, e1, e2)
    }

    /// See [`Shape::partials`].
    pub(super) fn partials<R: Real>(
        &self,
        at: SurfaceCoordinates<R>,
        moving: Option<MovingTriangle<R>>,
    ) -> Option<Partials<R>> {
        if self.double_area() == 0.0 {
            return None;
        }
        let [u, v] = variables(at.0.x, at.0.y);
        let constant = moving.map(|m| m.map(Dual::<R, 2>::constant));
        let si = self.point::<Dual<R, 2>>(u, v, constant.as_ref());
        Partials::of(si.p, &si.frame).with_respect_to(si.uv)
    }

    /// See [`Shape::border`].
    pub fn border<R: Real>(&self, ray: &Ray<R>) -> R {
        let [v0, e1, e2] = self.corner_and_edges::<R>(None);
        let (t, u, v) = intersect_plane(ray, v0, e1, e2);
        // Barycentric coordinate times height over the opposite edge.
        let twice_area = e1.cross(e2).length();
        let outside = |b: R, edge: Vec3<R>| -(b * twice_area / edge.length());
        let w = -(u + v) + R::c(1.0);
        let distances = [outside(u, e2), outside(v, e1), outside(w, e2 - e1)];
        super::flat_border(t, distances)
    }
}

impl Shape for Mesh {
    fn primitives(&self) -> Vec<Primitive> {
        (0..self.data.mesh.triangles.len())
            .map(|i| {
                let Triangle {
                    v0,
                    edges: [e1, e2],
                    ..
                } = self.data.triangle(i);
                Primitive::Triangle { v0, e1, e2 }
            })
            .collect()
    }

    #[inline]
    fn interaction<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        let moving = self.moving(theta, prim as usize);
        (self.data.triangle(prim as usize)).seen(ray, hit, moving.as_ref())
    }

    fn coordinates<P: Float>(
        &self,
        prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        if self.data.mesh.uvs.is_empty() {
            return SurfaceCoordinates(si.uv);
        }
        self.locate(prim, si.p)
    }

    fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        self.data.triangle(prim as usize).locate(p)
    }

    fn point_at<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        let moving = self.moving(theta, prim as usize);
        (self.data.triangle(prim as usize)).point(at.0.x, at.0.y, moving.as_ref())
    }

    fn partials<R: Real>(
        &self,
        theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        let moving = self.moving(theta, prim as usize);
        self.data.triangle(prim as usize).partials(at, moving)
    }

    fn area_element<R: Real>(&self, theta: &Theta<R>, prim: u32) -> R {
        let triangle = self.data.triangle(prim as usize);
        let area = R::of(triangle.double_area());
        match self.moving(theta, prim as usize) {
            Some(moving) => area + moving.double_area(triangle.edges),
            None => area,
        }
    }

    fn scatter_point<P: Float>(
        &self,
        prim: u32,
        at: SurfaceCoordinates<P>,
        d: &SurfaceAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let triangle = self.data.triangle(prim as usize);
        self.scatter(prim as usize, grad, |moving| {
            let at = SurfaceCoordinates::lift(at).0;
            d.of(&triangle.point(at.x, at.y, Some(moving)))
        });
    }

    fn scatter_interaction<P: Float>(
        &self,
        prim: u32,
        ray: &Ray<P>,
        hit: &Hit,
        d: &SurfaceAdjoint<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let triangle = self.data.triangle(prim as usize);
        self.scatter(prim as usize, grad, |moving| {
            d.of(&triangle.seen(&Ray::lift(*ray), hit, Some(moving)))
        });
    }

    fn scatter_area<P: Float>(&self, prim: u32, d: P, grad: &mut impl GradSink<P>) {
        let edges = self.data.triangle(prim as usize).edges;
        self.scatter(prim as usize, grad, |moving| {
            moving.double_area(edges) * Const(d)
        });
    }

    fn visit_params(&self, f: &mut dyn FnMut(ParamRef)) {
        self.vertices.iter().for_each(|v| f(v.param));
        self.normals.iter().for_each(|n| f(n.param));
    }

    /// # Errors
    /// As [`Mesh::new`].
    fn update(&mut self, params: &Params) -> Result<(), String> {
        self.update_vertices(params)
    }

    fn carries_frame(&self, prim: u32) -> bool {
        self.data.triangle(prim as usize).slopes() != [0.0; 2]
    }

    fn centroid(&self) -> [f64; 3] {
        let data = &*self.data;
        let mut sum = Vec3::<f64>::zero();
        for (i, t) in data.mesh.triangles.iter().enumerate() {
            let [a, b, c] = each(*t, |i| lift3::<f64>(data.mesh.positions[i as usize]));
            sum += (a + b + c) * (data.triangle(i).double_area() / 6.0);
        }
        (sum * data.area.recip()).to_array()
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let double = |v: &[f32; 3]| each(*v, f64::from);
        let mut mesh = self.data.mesh.clone();
        for p in &mut mesh.positions {
            *p = each(by.point(double(p)), |x| x as f32);
        }
        for n in mesh.normals.iter_mut().filter(|n| **n != [0.0; 3]) {
            // Lengths stay: they weigh the normals where they are interpolated.
            let length = lift3::<f64>(*n).length();
            let turned = Vec3::from(by.vector(double(n))).normalize() * length;
            *n = each(turned.to_array(), |x| x as f32);
        }
        let mut placed = self.clone();
        placed.replace(mesh)?;
        if let Some(vertices) = &mut placed.vertices {
            vertices.linear = by.linear;
        }
        if let Some(normals) = &mut placed.normals {
            let size = by.determinant().cbrt();
            normals.turn = each(by.linear, |row| row.map(|x| x / size));
        }
        Ok(placed)
    }

    #[inline]
    fn fetch(&self, prim: u32) {
        let mesh = &self.data.mesh;
        for i in mesh.triangles[prim as usize] {
            prefetch(&mesh.positions[i as usize]);
            mesh.normals.get(i as usize).into_iter().for_each(prefetch);
            mesh.uvs.get(i as usize).into_iter().for_each(prefetch);
        }
    }

    fn border<R: Real>(&self, prim: u32, ray: &Ray<R>) -> R {
        self.data.triangle(prim as usize).border(ray)
    }

    fn area(&self) -> f64 {
        self.data.area
    }

    /// The normal returned is the shading normal, which emission goes by.
    fn sample_area<R: Real>(&self, theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let data = &*self.data;
        let (i, b) = choose(data.running_areas(), u);
        let moving = self.moving(theta, i);
        (data.triangle(i)).sampled(i as u32, b, data.area, moving.as_ref())
    }

    fn sample_surface<R: Real>(
        &self,
        theta: &Theta<R>,
        u: [R::Primal; 2],
    ) -> (ShapeSample<R>, Vec3<R>) {
        let s = self.sample_area(theta, u);
        let triangle = self.data.triangle(s.prim as usize);
        let mut n = triangle.flat_normal();
        if let Some(moving) = self.moving(theta, s.prim as usize) {
            n += moving.flat_normal(triangle.edges);
        }
        (s, n)
    }

    fn sample<P: Float>(&self, from: Vec3<P>, u: [P; 2]) -> Option<DirectionSample<P>> {
        let (s, n_geo) = self.sample_surface(&Theta::still(), u);
        s.seen_from(from, n_geo)
    }

    fn extent(&self) -> f32 {
        self.data.extent
    }
}

/// How a file with meshes is read.
#[derive(Clone, Copy, Debug)]
pub struct ObjOptions {
    /// From the file's space to the world.
    pub to_world: Transform,
    /// Ignore normals, and make none.
    pub face_normals: bool,
    /// Turn the surface around.
    pub flip_normals: bool,
    /// Use 1 - v for v.
    pub flip_v: bool,
}

impl Default for ObjOptions {
    fn default() -> Self {
        Self {
            to_world: Transform::IDENTITY,
            face_normals: false,
            flip_normals: false,
            flip_v: true,
        }
    }
}

/// Adds one group of faces to a mesh, in world space.
fn append(
    mesh: &mut MeshData,
    group: &tobj::Mesh,
    options: &ObjOptions,
) -> Result<(), &'static str> {
    let start = mesh.positions.len();
    let count = group.positions.len() / 3;
    let first = u32::try_from(start).map_err(|_| "more than 2^32 vertices")?;
    if start + count > u32::MAX as usize {
        return Err("more than 2^32 vertices");
    }
    let single = |v: [f64; 3]| each(v, |x| x as f32);
    let double = |v: &[f32; 3]| each(*v, f64::from);
    let positions = group.positions.as_chunks::<3>().0.iter();
    mesh.positions
        .extend(positions.map(|p| single(options.to_world.point(double(p)))));
    if !group.normals.is_empty() {
        if group.normals.len() != group.positions.len() {
            return Err("another number of normals than of vertices");
        }
        // Cofactors: like the inverse transpose, but reflections keep the side of the winding; undo
        // that, so that mirrored meshes keep their outside.
        let sign = options.to_world.determinant().signum();
        mesh.normals.resize(start, [0.0; 3]);
        let normals = group.normals.as_chunks::<3>().0.iter();
        mesh.normals.extend(normals.map(|n| {
            let n = Vec3::from(options.to_world.normal(double(n))).normalize();
            single((n * sign).to_array())
        }));
    }
    if !group.texcoords.is_empty() {
        if group.texcoords.len() / 2 != count {
            return Err("another number of texture coordinates than of vertices");
        }
        mesh.uvs.resize(start, [0.0; 2]);
        let uvs = group.texcoords.as_chunks::<2>().0.iter();
        mesh.uvs
            .extend(uvs.map(|&[u, v]| [u, if options.flip_v { 1.0 - v } else { v }]));
    }
    if !mesh.normals.is_empty() {
        mesh.normals.resize(start + count, [0.0; 3]);
    }
    if !mesh.uvs.is_empty() {
        mesh.uvs.resize(start + count, [0.0; 2]);
    }
    let triangles = group.indices.as_chunks::<3>().0.iter();
    mesh.triangles
        .extend(triangles.map(|t| each(*t, |i| first + i)));
    Ok(())
}

/// The lines of an OBJ file that make up its geometry, counted, checked and in the form that `tobj` reads.
///
/// Groups and materials are left out, so that normals are smooth across them. Where faces change
/// between having texture coordinates or normals and not having them, a new group begins: `tobj`
/// cannot mix them in one. Comments and colours of vertices are left out, continued lines joined.
struct ObjLines<'a> {
    rest: &'a [u8],
    /// What the parser reads next, and how much of it is read.
    current: Vec<u8>,
    given: usize,
    /// Number of the current line, from one; of several that are joined, the first.
    line: u32,
    /// Number of the line that `rest` starts with.
    next_line: u32,
    /// `v`, `vt` and `vn` lines so far.
    counts: [usize; 3],
    /// Whether faces have texture coordinates and normals.
    layout: Option<[bool; 2]>,
    /// Why the current line was refused: expected, found.
    complaint: Option<(&'static str, String)>,
    /// What lines begin with that make no geometry, of each kind the first.
    skipped: Vec<(String, u32)>,
}

/// What says how faces belong together and are drawn.
const OF_GROUPS: &[&str] = &[
    "bevel", "c_interp", "d_interp", "g", "lod", "mg", "mtllib", "o", "s", "usemtl",
];
/// So many kinds of lines without effect are named at most.
const MOST_SKIPPED: usize = 16;

impl<'a> ObjLines<'a> {
    fn new(text: &'a [u8]) -> Self {
        const BYTE_ORDER_MARK: &[u8] = "\u{feff}".as_bytes();
        Self {
            rest: text.strip_prefix(BYTE_ORDER_MARK).unwrap_or(text),
            current: Vec::new(),
            given: 0,
            line: 0,
            next_line: 1,
            counts: [0; 3],
            layout: None,
            complaint: None,
            skipped: Vec::new(),
        }
    }

    fn refuse(&mut self, expected: &'static str, found: &[u8]) -> io::Error {
        // Characters of four bytes at most, and one more, so that what is cut is marked as cut.
        let found = String::from_utf8_lossy(&found[..found.len().min(512)]);
        self.complaint = Some((expected, quoted(&found)));
        io::Error::from(io::ErrorKind::InvalidData)
    }

    /// The next line without its end.
    fn physical_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
        let (line, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        let ends: [&[u8]; 3] = [b"\r\n", b"\n", b"\r"];
        let after = ends.iter().find_map(|e| rest.strip_prefix(*e));
        self.rest = after.unwrap_or_default();
        self.next_line = self.next_line.saturating_add(1);
        Some(line)
    }

    /// The next line without its comment, joined with those behind it that continue it.
    fn logical_line(&mut self) -> Option<Cow<'a, [u8]>> {
        self.line = self.next_line;
        let mut joined: Option<Vec<u8>> = None;
        loop {
            let Some(line) = self.physical_line() else {
                return joined.map(Cow::Owned);
            };
            let comment = line.iter().position(|&b| b == b'#');
            let content = &line[..comment.unwrap_or(line.len())];
            let continued = match comment {
                None => content.trim_ascii_end().strip_suffix(b"\\"),
                Some(_) => None,
            };
            match (&mut joined, continued) {
                (None, None) => return Some(Cow::Borrowed(content)),
                (Some(all), None) => {
                    all.extend(content);
                    return joined.map(Cow::Owned);
                }
                (_, Some(part)) => {
                    let all = joined.get_or_insert_default();
                    all.extend(part);
                    all.push(b' ');
                }
            }
        }
    }

    /// Moves to the next line worth parsing.
    fn advance(&mut self) -> io::Result<()> {
        self.current.clear();
        self.given = 0;
        while let Some(line) = self.logical_line() {
            let mut words = words(&line);
            let (kind, expected, kept) = match words.next().unwrap_or_default() {
                b"" => continue,
                b"f" => {
                    let layout = self.check_face(words)?;
                    if self.layout.replace(layout).is_some_and(|old| old != layout) {
                        self.current.extend(b"g\n");
                    }
                    self.current.extend(&*line);
                    self.current.push(b'\n');
                    return Ok(());
                }
                b"v" => (
                    0,
                    "`v` with three numbers, alone or with a weight or a colour behind them",
                    3,
                ),
                b"vt" => (1, "`vt` with two or three numbers", 2),
                b"vn" => (2, "`vn` with three numbers", 3),
                other => {
                    self.skip(other);
                    continue;
                }
            };
            let name = ["v", "vt", "vn"][kind];
            self.current.extend(name.as_bytes());
            let numbers = SmallVec::<[&[u8]; 6]>::from_iter(words);
            let (count, weighted) = (numbers.len(), kind == 0 && numbers.len() == 4);
            for (i, word) in numbers.into_iter().enumerate() {
                // "nan" and "inf" are numbers to the parser.
                let number = std::str::from_utf8(word).ok();
                let number = number.and_then(|s| s.parse::<f32>().ok());
                let Some(number) = number.filter(|x| x.is_finite()) else {
                    return Err(self.refuse("a finite number", word));
                };
                if weighted && i == 3 && number == 0.0 {
                    return Err(self.refuse("a weight other than zero", word));
                }
                if weighted || i < kept {
                    self.current.push(b' ');
                    self.current.extend(word);
                }
            }
            let fits = match kind {
                0 => matches!(count, 3 | 4 | 6),
                1 => matches!(count, 2 | 3),
                _ => count == 3,
            };
            if !fits {
                return Err(self.refuse(expected, &line));
            }
            self.current.push(b'\n');
            self.counts[kind] += 1;
            return Ok(());
        }
        Ok(())
    }

    /// Notes a line that makes no geometry.
    fn skip(&mut self, word: &[u8]) {
        let word = String::from_utf8_lossy(&word[..word.len().min(64)]);
        let known = OF_GROUPS.contains(&&*word) || self.skipped.iter().any(|(w, _)| *w == word);
        if !known && self.skipped.len() < MOST_SKIPPED {
            self.skipped.push((word.into_owned(), self.line));
        }
    }

    /// Whether the face has texture coordinates and normals. All its indices are in range.
    fn check_face<'w>(&mut self, words: impl Iterator<Item = &'w [u8]>) -> io::Result<[bool; 2]> {
        const FORM: &str = "at least three vertices `v`, `v/vt`, `v//vn` or `v/vt/vn`";
        let mut layout = None;
        let mut corners = 0;
        for word in words {
            let mut present = [false; 3];
            for (k, index) in word.split(|&b| b == b'/').enumerate() {
                if k > 2 {
                    return Err(self.refuse(FORM, word));
                }
                if index.is_empty() {
                    continue;
                }
                let number = std::str::from_utf8(index).ok();
                let Some(i) = number.and_then(|s| s.parse::<i64>().ok()) else {
                    return Err(self.refuse(FORM, word));
                };
                if i == 0 || i.unsigned_abs() > self.counts[k] as u64 {
                    return Err(self.refuse("the index of an earlier line", word));
                }
                present[k] = true;
            }
            let own = [present[1], present[2]];
            if !present[0] || layout.is_some_and(|l| l != own) {
                return Err(self.refuse("vertices of one form", word));
            }
            layout = Some(own);
            corners += 1;
        }
        match layout {
            Some(layout) if corners >= 3 => Ok(layout),
            _ => Err(self.refuse(FORM, format!("{corners} vertices").as_bytes())),
        }
    }
}

/// An OBJ file in the form that other readers know, if it is in another one: with lines that go on behind a `\`, with
/// indices that count from the end, or with line ends of old Macintoshes. Only its geometry is left then.
pub(crate) fn plain_obj(text: &[u8]) -> Option<Vec<u8>> {
    let ends = |pair: &[u8]| pair[0] == b'\r' && pair[1] != b'\n';
    let mut odd = text.windows(2).any(ends) || text.ends_with(b"\r");
    for line in text.split(|b| matches!(b, b'\n' | b'\r')) {
        let mut words = words(line);
        odd |= line.trim_ascii_end().ends_with(b"\\");
        odd |= words.next() == Some(b"f") && words.any(|w| w.contains(&b'-'));
    }
    if !odd {
        return None;
    }
    let mut lines = ObjLines::new(text);
    let mut out = Vec::with_capacity(text.len());
    loop {
        // What is wrong was refused when the scene was read.
        let line = lines.fill_buf().ok()?;
        let n = line.len();
        if n == 0 {
            return Some(out);
        }
        let line = line.to_vec();
        lines.consume(n);
        if !line.starts_with(b"f") && !line.starts_with(b"g\nf") {
            out.extend(line);
            continue;
        }
        out.push(b'f');
        for corner in words(&line).filter(|word| !matches!(*word, b"f" | b"g")) {
            let indices = corner.split(|&b| b == b'/').enumerate().map(|(k, index)| {
                let number = std::str::from_utf8(index).ok();
                match number.and_then(|s| s.parse::<i64>().ok()) {
                    Some(i) if i < 0 => (lines.counts[k] as i64 + i + 1).to_string(),
                    Some(i) => i.to_string(),
                    None => String::new(),
                }
            });
            out.push(b' ');
            out.extend(indices.collect::<Vec<_>>().join("/").bytes());
        }
        out.push(b'\n');
    }
}

fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace)
        .filter(|w| !w.is_empty())
}

impl Read for ObjLines<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let available = self.fill_buf()?;
        let n = available.len().min(buf.len());
        buf[..n].copy_from_slice(&available[..n]);
        self.consume(n);
        Ok(n)
    }
}

impl BufRead for ObjLines<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if self.given == self.current.len() {
            self.advance()?;
        }
        Ok(&self.current[self.given..])
    }

    fn consume(&mut self, n: usize) {
        self.given = (self.given + n).min(self.current.len());
    }
}
