//! Meshes whose vertices move, and the adjoint of that.

use std::sync::{Arc, OnceLock};

use ad_core::{Const, Dual, Float, Real, Vec3, array};

use super::displacement::Displacement;
use super::lift3;
use super::mesh::Mesh;
use super::mesh_data::{MeshData, smooth_normals};
use super::vertices::{
    MovingNormals, MovingTriangle, MovingVertices, NormalSlope, NormalSlopes, Rings, tangent,
};
use super::welding::Welding;
use crate::error::SceneError;
use crate::math::{Transform, each};
use crate::params::{GradSink, ParamRef, Params, Theta};
use crate::texture::ScalarTexture;

/// Adjoints of single values of one range, each once.
struct Collected<'a> {
    slopes: &'a mut Vec<NormalSlope>,
    /// Which of three adjoints they are.
    of: usize,
}

impl GradSink<f64> for Collected<'_> {
    fn active(&self, _p: ParamRef) -> bool {
        true
    }

    fn add(&mut self, _p: ParamRef, i: usize, d: f64) {
        let i = i as u32;
        let at = self.slopes.iter().position(|(known, _)| *known == i);
        let at = at.unwrap_or_else(|| {
            self.slopes.push((i, [0.0; 3]));
            self.slopes.len() - 1
        });
        self.slopes[at].1[self.of] += d;
    }
}

impl Mesh {
    /// Which of its vertices are one point; once vertices are parameters, those that were when that was said.
    pub fn welding(&self) -> Arc<Welding> {
        match &self.vertices {
            Some(vertices) => vertices.welding.clone(),
            None => {
                let new = || Arc::new(Welding::new(&self.data.mesh.positions));
                self.data.welding.get_or_init(new).clone()
            }
        }
    }

    /// The same mesh, whose vertices are one point where those of another one are, with as many.
    pub(super) fn welded_like(self, other: &Mesh) -> Self {
        // A new mesh has none yet, so that this one is taken.
        let _ = self.data.welding.set(other.welding());
        self
    }

    /// How many points its vertices are.
    pub fn points(&self) -> usize {
        self.welding().firsts.len()
    }

    /// Their positions, `[points][3]`.
    pub(crate) fn point_positions(&self) -> Vec<f32> {
        let firsts = &self.welding().firsts;
        let each = |&i: &u32| self.data.mesh.positions[i as usize];
        firsts.iter().flat_map(each).collect()
    }

    /// The same mesh whose points ([`Mesh::welding`]) are the parameters `param` of shape `[points][3]`.
    pub(crate) fn with_vertices(&self, param: ParamRef) -> Self {
        self.moved_by(param, self.welding(), None)
    }

    fn moved_by(
        &self,
        param: ParamRef,
        welding: Arc<Welding>,
        displacement: Option<Arc<Displacement>>,
    ) -> Self {
        let data = &*self.data;
        let rings = (data.smooth).then(|| Arc::new(Rings::new(&data.mesh)));
        Self {
            data: self.data.clone(),
            vertices: Some(MovingVertices {
                param,
                displacement,
                welding,
                rings,
                linear: Transform::IDENTITY.linear,
                slopes: NormalSlopes::default(),
            }),
            normals: self.normals.clone(),
        }
    }

    /// The same mesh, the directions of whose given normals are the parameters `param` of shape `[vertices][3]`.
    pub(crate) fn with_vertex_normals(&self, param: ParamRef) -> Self {
        let of = |n: &[f32; 3]| lift3::<f64>(*n).length() as f32;
        Self {
            normals: Some(MovingNormals {
                param,
                turn: Transform::IDENTITY.linear,
                lengths: self.data.mesh.normals.iter().map(of).collect(),
            }),
            ..self.clone()
        }
    }

    /// The same mesh with its points displaced along its normals by a texture over its texture coordinates: `x + d n`, `n`
    /// of unit length. Its texels are parameters ([`super::HEIGHTS`] is a range for them); a point at which several
    /// vertices meet, along a seam, is displaced by the mean of what the texture has for them. Between points the surface
    /// is what the triangles make of it: a texture finer than they are is not seen. Normals follow the positions, also
    /// where they were given; where there are none, triangles stay flat. Displacement is of this renderer, and none of
    /// Mitsuba's.
    ///
    /// # Errors
    /// [`SceneError::Parameter`]: a mesh without texture coordinates, or whose points are parameters already; a texture
    /// that is no image; heights with which [`Mesh::new`] would fail.
    pub fn displaced(&self, texture: &ScalarTexture, params: &Params) -> Result<Self, SceneError> {
        let error = |expected: &str, found: &str| SceneError::Parameter {
            key: "displacement".into(),
            expected: expected.into(),
            found: found.into(),
        };
        let data = &*self.data;
        if data.mesh.uvs.is_empty() {
            return Err(error("a mesh with texture coordinates", "one without"));
        }
        if self.vertices.is_some() {
            return Err(error("a mesh that stands still", "one whose points move"));
        }
        if !matches!(
            texture,
            ScalarTexture::Constant(_) | ScalarTexture::Bitmap(_)
        ) {
            return Err(error("a number or an image", "another texture"));
        }
        let smooth = !data.mesh.normals.is_empty();
        let still = Self::with_normals(data.mesh.clone(), data.flip, smooth)?;
        let welding = still.welding();
        let displacement = Displacement::new(&data.mesh, data.flip, &welding, texture);
        let displacement = displacement.ok_or_else(|| error("a texture", "none"))?;
        let param = displacement.param;
        let mut moved = still.moved_by(param, welding, Some(Arc::new(displacement)));
        moved
            .update_vertices(params)
            .map_err(|found| error("a mesh that can be displaced", &found))?;
        Ok(moved)
    }

    /// Whether a texture displaces its points.
    pub fn is_displaced(&self) -> bool {
        (self.vertices.as_ref()).is_some_and(|v| v.displacement.is_some())
    }

    /// Whether its points are parameters, or displaced by some.
    pub fn has_moving_points(&self) -> bool {
        self.vertices.is_some()
    }

    /// Brings vertices that move to where these parameters have them, and their normals.
    pub(super) fn update_vertices(&mut self, params: &Params) -> Result<(), String> {
        if self.vertices.is_none() && self.normals.is_none() {
            return Ok(());
        }
        let mut mesh = self.data.mesh.clone();
        if let Some(vertices) = &self.vertices {
            for (position, i) in mesh.positions.iter_mut().zip(0..) {
                *position = vertices.position(params, i);
            }
        }
        if let Some(normals) = &mut self.normals {
            let first = normals.param.offset as usize;
            let values = params.values()[first..][..3 * mesh.normals.len()].as_chunks::<3>();
            if let Some(i) = values.0.iter().position(|n| *n == [0.0; 3]) {
                return Err(format!(
                    "expected normals of some length, found none at vertex {i}"
                ));
            }
            let wide = || values.0.iter().map(|n| lift3::<f64>(*n));
            normals.lengths = wide().map(|n| n.length() as f32).collect();
            for (to, n) in mesh.normals.iter_mut().zip(wide()) {
                *to = each(n.normalize().to_array(), |x| x as f32);
            }
        }
        self.replace(mesh)
    }

    /// Triangles that are turned over: those that face away from the mean normal of their corners, which is that of all
    /// triangles around. Where a mesh folds over itself there are some.
    pub fn folded(&self) -> Vec<u32> {
        let welding = self.welding();
        let points: Vec<[f32; 3]> = self.point_positions().as_chunks::<3>().0.to_vec();
        let triangles = welding.triangles(&self.data.mesh);
        let normals = smooth_normals(&points, &triangles);
        let faces_away = |t: &[u32; 3]| {
            let [a, b, c] = each(*t, |i| lift3::<f64>(points[i as usize]));
            let around = t.iter().fold(Vec3::<f64>::zero(), |sum, &i| {
                sum + lift3::<f64>(normals[i as usize])
            });
            (b - a).cross(c - a).dot(around) < 0.0
        };
        let found = (0..).zip(&triangles).filter(|(_, t)| faces_away(t));
        found.map(|(i, _)| i).collect()
    }

    /// The same arrays at other positions.
    pub(super) fn replace(&mut self, mesh: MeshData) -> Result<(), String> {
        let data = &*self.data;
        let replaced = Self::with_normals(mesh, data.flip, data.smooth).map_err(|e| match e {
            SceneError::Parameter {
                expected, found, ..
            } => format!("expected {expected}, found {found}"),
            other => other.to_string(),
        })?;
        self.data = replaced.data;
        if let Some(vertices) = &mut self.vertices {
            vertices.slopes = NormalSlopes::default();
        }
        Ok(())
    }

    /// How a triangle moves; `None` if it does not.
    #[inline]
    pub(super) fn moving<R: Real>(
        &self,
        theta: &Theta<R>,
        triangle: usize,
    ) -> Option<MovingTriangle<R>> {
        if R::IS_PRIMAL {
            return None;
        }
        let vertices = (self.vertices.as_ref()).filter(|v| theta.moves(v.param));
        let normals = (self.normals.as_ref()).filter(|n| theta.moves(n.param));
        if vertices.is_none() && normals.is_none() {
            return None;
        }
        let corners = self.data.mesh.triangles[triangle];
        let still = || [Vec3::zero(); 3];
        Some(MovingTriangle {
            corners: vertices.map_or_else(still, |v| each(corners, |i| v.offset(theta, i))),
            normals: match (normals, vertices) {
                (Some(n), _) => each(corners, |i| n.offset(theta, i, self.normal(i))),
                (None, Some(v)) => each(corners, |i| self.normal_offset(v, theta, i)),
                (None, None) => still(),
            },
        })
    }

    /// The normal at a vertex.
    fn normal(&self, vertex: u32) -> [f32; 3] {
        self.data.mesh.normals[vertex as usize]
    }

    /// The edges of a triangle from one of its corners.
    fn edges_at<R: Real>(&self, triangle: u32, corner: u8, offsets: [Vec3<R>; 3]) -> [Vec3<R>; 2] {
        let corners = self.data.mesh.triangles[triangle as usize];
        let from = usize::from(corner);
        let edge = |to: usize| {
            let [a, b] = [from, to].map(|k| self.data.mesh.positions[corners[k] as usize]);
            lift3::<R>(each([0, 1, 2], |k: usize| b[k] - a[k])) + (offsets[to] - offsets[from])
        };
        [edge((from + 1) % 3), edge((from + 2) % 3)]
    }

    /// How the normal at a vertex moves, if it follows the positions.
    fn normal_offset<R: Real>(
        &self,
        vertices: &MovingVertices,
        theta: &Theta<R>,
        vertex: u32,
    ) -> Vec3<R> {
        let Some(rings) = &vertices.rings else {
            return Vec3::zero();
        };
        let mut sum = Vec3::<R>::zero();
        for &(triangle, corner) in rings.around(vertex) {
            let corners = self.data.mesh.triangles[triangle as usize];
            let offsets = each(corners, |i| vertices.offset(theta, i));
            let [a, b] = self.edges_at(triangle, corner, offsets);
            sum += weighted_normal(a, b);
        }
        tangent(sum.normalize())
    }

    /// Adds the adjoint of `f` of a triangle that moves.
    pub(super) fn scatter<P: Float>(
        &self,
        triangle: usize,
        grad: &mut impl GradSink<P>,
        f: impl Fn(&MovingTriangle<Dual<P, 9>>) -> Dual<P, 9>,
    ) {
        let corners = self.data.mesh.triangles[triangle];
        let still = [Vec3::zero(); 3];
        let by_normals = || {
            let d = f(&MovingTriangle {
                corners: still,
                normals: seeds(),
            });
            corners.into_iter().zip(thirds(d))
        };
        if let Some(normals) = (self.normals.as_ref()).filter(|n| grad.active(n.param)) {
            for (i, d) in by_normals() {
                normals.add(i, d, self.normal(i), grad);
            }
        }
        let Some(vertices) = (self.vertices.as_ref()).filter(|v| grad.active(v.param)) else {
            return;
        };
        let d = f(&MovingTriangle {
            corners: seeds(),
            normals: still,
        });
        for (i, d) in corners.into_iter().zip(thirds(d)) {
            vertices.add(i, d, grad);
        }
        let Some(rings) = &vertices.rings else {
            return;
        };
        for (i, d) in by_normals() {
            if d.to_array() == [P::zero(); 3] {
                continue;
            }
            let d = d.map(P::to_f64);
            for &(value, slope) in self.normal_slopes(vertices, rings, i) {
                grad.add(vertices.param, value as usize, P::of(d.dot(slope.into())));
            }
        }
    }

    /// The transpose of [`Mesh::normal_offset`], kept: many samples see a vertex before it moves.
    fn normal_slopes<'a>(
        &self,
        vertices: &'a MovingVertices,
        rings: &Rings,
        vertex: u32,
    ) -> &'a [NormalSlope] {
        let count = self.data.mesh.positions.len();
        let all = vertices
            .slopes
            .get_or_init(|| (0..count).map(|_| OnceLock::new()).collect());
        all[vertex as usize].get_or_init(|| self.find_normal_slopes(vertices, rings, vertex))
    }

    fn find_normal_slopes(
        &self,
        vertices: &MovingVertices,
        rings: &Rings,
        vertex: u32,
    ) -> Box<[NormalSlope]> {
        let moved: Vec<_> = (rings.around(vertex).iter())
            .map(|&(triangle, corner)| {
                let [a, b] = self.edges_at(triangle, corner, seeds());
                (triangle, weighted_normal::<Dual<f64, 9>>(a, b))
            })
            .collect();
        let sum = (moved.iter()).fold(Vec3::<f64>::zero(), |sum, (_, n)| sum + n.primal());
        let n = sum.normalize();
        let inverse = sum.length().recip();
        let mut slopes = Vec::new();
        if !inverse.is_finite() {
            return slopes.into();
        }
        for of in 0..3 {
            let unit = Vec3::from(array(|k| f64::from(u8::from(k == of))));
            let d = (unit - n * n.dot(unit)) * inverse;
            let mut collected = Collected {
                slopes: &mut slopes,
                of,
            };
            for (triangle, moved) in &moved {
                let along = moved.x * Const(d.x) + moved.y * Const(d.y) + moved.z * Const(d.z);
                let corners = self.data.mesh.triangles[*triangle as usize];
                for (i, d) in corners.into_iter().zip(thirds(along)) {
                    vertices.add(i, d, &mut collected);
                }
            }
        }
        slopes.into()
    }
}

/// Nine independent tangents.
fn seeds<P: Float>() -> [Vec3<Dual<P, 9>>; 3] {
    let var = |k| Dual::var(P::zero(), k);
    each([0, 3, 6], |k: usize| {
        Vec3::new(var(k), var(k + 1), var(k + 2))
    })
}

/// Their derivatives.
fn thirds<P: Float>(d: Dual<P, 9>) -> [Vec3<P>; 3] {
    each([0, 3, 6], |k: usize| Vec3::from(array(|i| d.eps[k + i])))
}

/// The normal of a triangle, as long as its angle at the first corner; edges from there.
fn weighted_normal<R: Real>(a: Vec3<R>, b: Vec3<R>) -> Vec3<R> {
    // Of length one, so that products of small ones do not underflow.
    let unit = |v: Vec3<R>| v * Const(v.primal().length().recip());
    let (a, b) = (unit(a), unit(b));
    let across = a.cross(b);
    across.normalize() * across.length().atan2(a.dot(b))
}
