//! Vertices as parameters, and how triangles move with them.

use std::sync::{Arc, OnceLock};

use ad_core::{Const, Float, Real, Vec3};

use super::displacement::Displacement;
use super::lift3;
use super::mesh_data::MeshData;
use super::welding::Welding;
use crate::math::each;
use crate::params::{GradSink, ParamRef, Params, Theta};

/// Corners around each vertex of a mesh: the triangle, and which of its corners.
#[derive(Debug)]
pub(super) struct Rings {
    starts: Vec<u32>,
    corners: Vec<(u32, u8)>,
}

impl Rings {
    pub fn new(mesh: &MeshData) -> Self {
        let mut starts = vec![0; mesh.positions.len() + 1];
        for &i in mesh.triangles.as_flattened() {
            starts[i as usize + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut corners = vec![(0, 0); 3 * mesh.triangles.len()];
        for (t, triangle) in (0..).zip(&mesh.triangles) {
            for (k, &i) in (0..).zip(triangle) {
                corners[next[i as usize] as usize] = (t, k);
                next[i as usize] += 1;
            }
        }
        Self { starts, corners }
    }

    pub fn around(&self, vertex: u32) -> &[(u32, u8)] {
        let [from, to] = [0, 1].map(|k| self.starts[vertex as usize + k] as usize);
        &self.corners[from..to]
    }
}

/// How the unit normal at a vertex changes with a value of a range of parameters: its number there, and the slope.
pub(super) type NormalSlope = (u32, [f64; 3]);

/// Those of each vertex, made when they are asked for, and kept as long as positions stay.
pub(super) type NormalSlopes = Arc<OnceLock<Box<[OnceLock<Box<[NormalSlope]>>]>>>;

/// Vertices whose positions are parameters.
#[derive(Clone, Debug)]
pub(super) struct MovingVertices {
    /// The points of `welding`, before the mesh moves as a whole, or the texels that displace them.
    pub param: ParamRef,
    /// If they are texels.
    pub displacement: Option<Arc<Displacement>>,
    pub welding: Arc<Welding>,
    /// Where normals follow the positions.
    pub rings: Option<Arc<Rings>>,
    /// How displacements turn and grow as the mesh moves as a whole.
    pub linear: [[f64; 3]; 3],
    /// Of the normals that follow.
    pub slopes: NormalSlopes,
}

impl MovingVertices {
    /// How a vertex moves.
    pub fn offset<R: Real>(&self, theta: &Theta<R>, vertex: u32) -> Vec3<R> {
        let point = self.welding.points[vertex as usize];
        match &self.displacement {
            Some(displacement) => {
                let moved = displacement.offset(theta, point);
                changed(self.linear, |k| moved[k])
            }
            None => changed(self.linear, |k| {
                let x = theta.get(self.param, 3 * point as usize + k);
                x - Const(x.primal())
            }),
        }
    }

    /// Its transpose.
    pub fn add<P: Float>(&self, vertex: u32, d: Vec3<P>, grad: &mut impl GradSink<P>) {
        let point = self.welding.points[vertex as usize];
        let back = changed_back(self.linear, d);
        match &self.displacement {
            Some(displacement) => displacement.add(point, back, grad),
            None => grad.add_all(self.param, 3 * point as usize, back),
        }
    }

    /// Where a vertex is, before the mesh moves as a whole.
    pub fn position(&self, params: &Params, vertex: u32) -> [f32; 3] {
        let point = self.welding.points[vertex as usize];
        if let Some(displacement) = &self.displacement {
            return displacement.position(params, point);
        }
        let values = &params.values()[self.param.offset as usize + 3 * point as usize..];
        [values[0], values[1], values[2]]
    }
}

/// Normals that a mesh was given, as parameters: their directions count.
#[derive(Clone, Debug)]
pub(super) struct MovingNormals {
    /// Of all vertices, before the mesh moves as a whole.
    pub param: ParamRef,
    /// How they turn as it does.
    pub turn: [[f64; 3]; 3],
    /// Of the parameters, by vertex.
    pub lengths: Arc<[f32]>,
}

impl MovingNormals {
    /// The part of a vector across the normal at a vertex, times the length of that over the length of the parameters.
    pub fn across<R: Real>(&self, vertex: u32, v: Vec3<R>, n: [f32; 3]) -> Vec3<R> {
        let n = lift3::<f64>(n);
        let length = n.length();
        let unit = (n * length.recip()).map(R::of);
        (v - unit * unit.dot(v)) * R::c(length / f64::from(self.lengths[vertex as usize]))
    }

    /// How the normal `n` at a vertex moves.
    pub fn offset<R: Real>(&self, theta: &Theta<R>, vertex: u32, n: [f32; 3]) -> Vec3<R> {
        let moved = changed(self.turn, |k| {
            let x = theta.get(self.param, 3 * vertex as usize + k);
            x - Const(x.primal())
        });
        self.across(vertex, moved, n)
    }

    /// Its transpose.
    pub fn add<P: Float>(&self, vertex: u32, d: Vec3<P>, n: [f32; 3], grad: &mut impl GradSink<P>) {
        let back = changed_back(self.turn, self.across(vertex, d, n));
        grad.add_all(self.param, 3 * vertex as usize, back);
    }
}

/// A vector that moves, after a linear map.
fn changed<R: Real>(rows: [[f64; 3]; 3], moved: impl Fn(usize) -> R) -> Vec3<R> {
    let moved = each([0, 1, 2], moved);
    each(rows, |row| {
        moved[0] * R::c(row[0]) + moved[1] * R::c(row[1]) + moved[2] * R::c(row[2])
    })
    .into()
}

/// Its transpose.
fn changed_back<P: Float>(rows: [[f64; 3]; 3], d: Vec3<P>) -> [P; 3] {
    each([0, 1, 2], |k: usize| {
        d.x * P::of(rows[0][k]) + d.y * P::of(rows[1][k]) + d.z * P::of(rows[2][k])
    })
}

/// How the corners of a triangle and the normals there move: tangents.
#[derive(Clone, Copy, Debug)]
pub(super) struct MovingTriangle<R> {
    pub corners: [Vec3<R>; 3],
    pub normals: [Vec3<R>; 3],
}

pub(super) fn tangent<R: Real>(v: Vec3<R>) -> Vec3<R> {
    v - Vec3::lift(v.primal())
}

impl<R: Real> MovingTriangle<R> {
    /// The same over another scalar.
    pub fn map<Q: Real>(self, f: impl Fn(R) -> Q) -> MovingTriangle<Q> {
        MovingTriangle {
            corners: each(self.corners, |v| v.map(&f)),
            normals: each(self.normals, |v| v.map(&f)),
        }
    }

    /// A corner and the two edges from there, which are these where nothing moves.
    pub fn corner_and_edges(&self, [v0, e1, e2]: [Vec3<R>; 3]) -> [Vec3<R>; 3] {
        let [a, b, c] = self.corners;
        [v0 + a, e1 + (b - a), e2 + (c - a)]
    }

    /// The edges over their lengths, and these.
    fn scaled(&self, edges: [[f32; 3]; 2]) -> ([Vec3<R>; 2], [f64; 2]) {
        let lengths = edges.map(|e| lift3::<f64>(e).length());
        let [_, e1, e2] =
            self.corner_and_edges([Vec3::zero(), lift3::<R>(edges[0]), lift3::<R>(edges[1])]);
        let unit = |e: Vec3<R>, length: f64| e * R::c(length.recip());
        ([unit(e1, lengths[0]), unit(e2, lengths[1])], lengths)
    }

    /// How the unit normal moves.
    pub fn flat_normal(&self, edges: [[f32; 3]; 2]) -> Vec3<R> {
        let ([e1, e2], _) = self.scaled(edges);
        tangent(e1.cross(e2).normalize())
    }

    /// How the unit vector along a sum of the edges does.
    pub fn dp_du(&self, edges: [[f32; 3]; 2], [a, b]: [f64; 2]) -> Vec3<R> {
        let [_, e1, e2] =
            self.corner_and_edges([Vec3::zero(), lift3::<R>(edges[0]), lift3::<R>(edges[1])]);
        tangent((e1 * R::c(a) + e2 * R::c(b)).normalize())
    }

    /// How twice the area does.
    pub fn double_area(&self, edges: [[f32; 3]; 2]) -> R {
        let ([e1, e2], [a, b]) = self.scaled(edges);
        let sine = e1.cross(e2).length();
        (sine - Const(sine.primal())) * R::c(a * b)
    }
}
