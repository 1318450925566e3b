//! How long texture coordinates are on a surface, as functions of these coordinates.

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec2, Vec3, array};

use crate::math::angle;
use crate::texture;

/// How dp/du and dp/dv lie in the plane of a shading frame, whose first axis is the projection of dp/du: `(a, 0)` and
/// `(b, c)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch<R> {
    /// Length of the projection of dp/du.
    pub a: R,
    /// First component of dp/dv.
    pub b: R,
    /// Second component of dp/dv; negative where the coordinates run clockwise.
    pub c: R,
}

impl<R: Real> Stretch<R> {
    /// Both of length one and at right angles.
    #[inline]
    pub fn unit() -> Self {
        Self {
            a: R::one(),
            b: R::zero(),
            c: R::one(),
        }
    }
}

/// What a surface is in its texture coordinates: for materials that know a point by those alone.
///
/// Triangles have coordinates of their own, which may overlap, and their interactions carry others, which say which
/// triangle a point is on.
#[derive(Clone, Debug)]
pub struct Chart(Kind);

#[derive(Clone, Debug)]
enum Kind {
    /// The same everywhere.
    Even([f64; 3]),
    /// A sphere: `a` at its equator, and `c`.
    Ball([f64; 2]),
    /// A disk: squares and product of its half axes, and `n . (e1 x e2)`.
    Disk {
        squares: [f64; 3],
        area: f64,
    },
    Triangles(Triangles),
}

#[derive(Clone, Debug)]
struct Triangles {
    columns: u32,
    list: Vec<Triangle>,
}

/// A triangle; coordinates of its own are relative to `low`.
#[derive(Clone, Copy, Debug)]
struct Triangle {
    /// Least of its own coordinates, and how long a cell is in these.
    low: [f32; 2],
    size: [f32; 2],
    dp_du: [f32; 3],
    dp_dv: [f32; 3],
    /// From its own coordinates to barycentric ones of the second and the third vertex: factors, and a constant.
    barycentric: [[f32; 3]; 2],
    /// At the vertices, on the side of the shading normal.
    normals: [[f32; 3]; 3],
    /// Whether its coordinates have lengths.
    is_whole: bool,
}

/// A triangle as charts are made of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Corners {
    /// World space.
    pub positions: [[f32; 3]; 3],
    /// At the vertices, on the side of the shading normal, of any length; zero for that of the triangle.
    pub normals: [[f32; 3]; 3],
    /// Its normal on that side.
    pub flat: [f64; 3],
    /// Texture coordinates.
    pub uvs: [[f32; 2]; 3],
}

impl Chart {
    /// The same lengths everywhere.
    pub(crate) fn even([a, b, c]: [f64; 3]) -> Self {
        Self(Kind::Even([a, b, c]))
    }

    /// Of a sphere: `a` at the equator, and `c`.
    pub(crate) fn ball(equator: f64, meridian: f64) -> Self {
        Self(Kind::Ball([equator, meridian]))
    }

    /// Of a disk with these half axes, whose normal is on the side of `e1 x e2`, or on the other.
    pub(crate) fn disk(e1: Vec3<f64>, e2: Vec3<f64>, flip: bool) -> Self {
        let area = e1.cross(e2).length();
        Self(Kind::Disk {
            squares: [e1.dot(e1), e1.dot(e2), e2.dot(e2)],
            area: if flip { -area } else { area },
        })
    }

    /// Of triangles, and the coordinates that tell them apart, three for each: triangle `i` has the cell of column
    /// `i % n` and row `i / n` among `n` columns. In its cell it has the shape that it has in its own coordinates but for
    /// a factor for each, so that dp/du is the same direction in both. `None` if they are too many.
    pub(crate) fn of_triangles(triangles: &[Corners]) -> Option<(Self, Vec<[f32; 2]>)> {
        let columns = texture::columns(triangles.len())?;
        let mut places = Vec::with_capacity(3 * triangles.len());
        let list = (triangles.iter().zip(0..))
            .map(|(t, i)| {
                let (low, size) = range(t.uvs);
                let cell = [i % columns, i / columns].map(f64::from);
                places.extend(t.uvs.map(|uv| {
                    array(|k: usize| {
                        let own = f64::from(uv[k]) - f64::from(low[k]);
                        (cell[k] + texture::CELL_BEGIN + own / f64::from(size[k])) as f32
                    })
                }));
                Triangle::new(t, low, size)
            })
            .collect();
        Some((Self(Kind::Triangles(Triangles { columns, list })), places))
    }

    /// The surface's own coordinates of a point, and its triangle.
    #[inline]
    pub(crate) fn own<R: Real>(&self, uv: Vec2<R>) -> (Vec2<R>, u32) {
        let Kind::Triangles(Triangles { columns, list }) = &self.0 else {
            return (uv, 0);
        };
        // Anything finite leads to a triangle, also beyond all cells.
        let last = f64::from(*columns) - 1.0;
        let cell = |x: R| x.primal().to_f64().floor().clamp(0.0, last);
        let (column, row) = (cell(uv.x), cell(uv.y));
        let triangle = (row as u32 * columns + column as u32).min(list.len() as u32 - 1);
        let t = &list[triangle as usize];
        let own = |x: R, cell: f64, k: usize| {
            let size = R::of(f64::from(t.size[k]));
            (x - R::c(cell + texture::CELL_BEGIN)) * size + R::of(f64::from(t.low[k]))
        };
        (Vec2::new(own(uv.x, column, 0), own(uv.y, row, 1)), triangle)
    }

    /// How long the surface's own coordinates are at a point of this triangle.
    ///
    /// # Derivatives
    /// In `uv`.
    #[inline]
    pub(crate) fn stretch<R: Real>(&self, uv: Vec2<R>, triangle: u32) -> Stretch<R> {
        match &self.0 {
            Kind::Even(all) => {
                let [a, b, c] = all.map(R::of);
                Stretch { a, b, c }
            }
            Kind::Ball([equator, meridian]) => Stretch {
                a: angle::sin_cos(uv.y * R::c(0.5)).0.max(R::zero()) * R::of(*equator),
                b: R::zero(),
                c: R::of(*meridian),
            },
            Kind::Disk { squares, area } => {
                let [uu, uv_, vv] = squares.map(R::of);
                let (sin, cos) = angle::sin_cos(uv.y);
                let a =
                    (uu * cos.square() + uv_ * cos * sin * R::c(2.0) + vv * sin.square()).sqrt();
                let along = uv_ * (cos.square() - sin.square()) + (vv - uu) * cos * sin;
                let round = uv.x * R::c(2.0 * PI) / a;
                Stretch {
                    a,
                    b: along * round,
                    c: R::of(*area) * round,
                }
            }
            Kind::Triangles(all) => all.list[triangle as usize].stretch(uv),
        }
    }
}

/// The least of coordinates, and how long a cell is that they fill the part of that triangles fill.
fn range(uvs: [[f32; 2]; 3]) -> ([f32; 2], [f32; 2]) {
    let least = |k: usize| uvs.iter().fold(f32::INFINITY, |m, uv| m.min(uv[k]));
    let most = |k: usize| uvs.iter().fold(f32::NEG_INFINITY, |m, uv| m.max(uv[k]));
    let low = array(least);
    let size = array(|k: usize| {
        let size = (f64::from(most(k)) - f64::from(low[k])) / texture::CELL_FILLED;
        let single = size as f32;
        if single < f32::MIN_POSITIVE {
            1.0
        } else {
            single.min(f32::MAX)
        }
    });
    (low, size)
}

impl Triangle {
    fn new(t: &Corners, low: [f32; 2], size: [f32; 2]) -> Self {
        let double = |v: [f32; 3]| Vec3::from(v.map(f64::from));
        let single = |v: Vec3<f64>| v.to_array().map(|x| x as f32);
        let [p0, p1, p2] = t.positions.map(double);
        let (e1, e2) = (p1 - p0, p2 - p0);
        let minus = |x: f32, y: f32| f64::from(x) - f64::from(y);
        let [a, b, c] = t.uvs;
        let (du1, dv1) = (minus(b[0], a[0]), minus(b[1], a[1]));
        let (du2, dv2) = (minus(c[0], a[0]), minus(c[1], a[1]));
        let inverse = (du1 * dv2 - dv1 * du2).recip();
        let dp_du = (e1 * dv2 - e2 * dv1) * ad_core::Const(inverse);
        let dp_dv = (e2 * du1 - e1 * du2) * ad_core::Const(inverse);
        // Relative to `low`, where digits are not lost.
        let (u0, v0) = (minus(a[0], low[0]), minus(a[1], low[1]));
        let row = |u: f64, v: f64| [u, v, -(u * u0 + v * v0)].map(|x| (x * inverse) as f32);
        let barycentric = [row(dv2, -du2), row(-dv1, du1)];
        let all = |rows: &[[f32; 3]]| rows.iter().flatten().all(|x| x.is_finite());
        let (dp_du, dp_dv) = (single(dp_du), single(dp_dv));
        let smooth = |n: [f32; 3]| n != [0.0; 3];
        let normals = if t.normals.into_iter().any(smooth) {
            t.normals
        } else {
            [t.flat.map(|x| x as f32); 3]
        };
        Self {
            low,
            size,
            dp_du,
            dp_dv,
            barycentric,
            normals,
            is_whole: all(&[dp_du, dp_dv]) && all(&barycentric),
        }
    }

    #[inline]
    fn stretch<R: Real>(&self, uv: Vec2<R>) -> Stretch<R> {
        if !self.is_whole {
            return Stretch::unit();
        }
        let number = |x: f32| R::of(f64::from(x));
        let vector = |v: [f32; 3]| Vec3::new(number(v[0]), number(v[1]), number(v[2]));
        let (u, v) = (uv.x - number(self.low[0]), uv.y - number(self.low[1]));
        let [p, q] = self
            .barycentric
            .map(|[x, y, z]| u * number(x) + v * number(y) + number(z));
        let [n0, n1, n2] = self.normals.map(vector);
        let n = (n0 * (-(p + q) + R::one()) + n1 * p + n2 * q).normalize();
        let (du, dv) = (vector(self.dp_du), vector(self.dp_dv));
        let (along_u, along_v) = (n.dot(du), n.dot(dv));
        let square = du.dot(du);
        let a2 = square - along_u.square();
        if a2.primal() <= square.primal() * R::Primal::of(1e-12) {
            return Stretch::unit();
        }
        let a = a2.sqrt();
        Stretch {
            a,
            b: (du.dot(dv) - along_u * along_v) / a,
            c: n.dot(du.cross(dv)) / a,
        }
    }
}
