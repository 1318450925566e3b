//! A sphere displaced by the height behind its normal map.

use std::f64::consts::{PI, TAU};

use ad_core::Vec3;
use faer::Side;
use faer::linalg::solvers::Solve;
use faer::sparse::{SparseColMat, Triplet};
use rayon::prelude::*;
use render::bsdf::DeltaKind;
use render::manifold::{Event, Normal};
use render::scene::Constraint;

use super::specular_scenes::Laboratory;
use examples::figure::Result;

/// The sphere among the shapes of the authors' files.
const SPHERE: u32 = 2;
/// By how much their displaced spheres are enlarged where they stand.
const SCALE: f64 = 6.5;

/// What the logarithm of a radius gains per angle, along circles of latitude and along meridians, in cells of latitude and longitude.
struct Slopes {
    rows: usize,
    cells: Vec<[f64; 2]>,
    radius: f64,
}

impl Slopes {
    /// Those that the normals of the sphere at the origin say, seen from its centre, a point of the floor.
    fn of(lab: &Laboratory, rows: usize) -> Result<Self> {
        let space = lab.space(Constraint::Angle);
        let centre = lab.floor(0.0, 0.0).ok_or("no floor in the sphere")?;
        let event = Event {
            shape: SPHERE,
            kind: DeltaKind::Transmission,
            normal: Normal::Own,
        };
        let seen = |k: usize| {
            let ((sin, cos), (sin_phi, cos_phi)) = angles(rows, k);
            let out = Vec3::new(sin * cos_phi, sin * sin_phi, cos);
            let chain = space.trace(&centre, out, &[event])?;
            let vertex = &chain[0];
            // The normal of a radius is along the direction less the gradient of its logarithm.
            let n = vertex.normal();
            let along = n.dot(out);
            let slope = (out * along - n) / along;
            let parallel = Vec3::new(-sin_phi, cos_phi, 0.0);
            let meridian = Vec3::new(cos * cos_phi, cos * sin_phi, -sin);
            Some((
                [slope.dot(parallel), slope.dot(meridian)],
                vertex.si.p.length(),
            ))
        };
        let cells: Option<Vec<_>> = (0..2 * rows * rows).into_par_iter().map(seen).collect();
        let cells = cells.ok_or("no sphere around the floor")?;
        let radius = cells.iter().map(|c| c.1).sum::<f64>() / cells.len() as f64;
        Ok(Self {
            rows,
            cells: cells.into_iter().map(|c| c.0).collect(),
            radius,
        })
    }

    /// Pairs of neighbours, how much they count, and by how much the second one is higher.
    fn edges(&self) -> Vec<([usize; 2], f64, f64)> {
        let (rows, columns) = (self.rows, 2 * self.rows);
        let step = PI / rows as f64;
        let mut edges = Vec::new();
        for k in 0..rows * columns {
            let ((sin, _), _) = angles(rows, k);
            let (row, column) = (k / columns, k % columns);
            let half =
                |a: usize, b: usize, axis: usize| 0.5 * (self.cells[a][axis] + self.cells[b][axis]);
            let right = row * columns + (column + 1) % columns;
            edges.push(([k, right], 1.0 / sin, half(k, right, 0) * sin * step));
            if row + 1 < rows {
                let below = k + columns;
                let between = ((row + 1) as f64 * step).sin();
                edges.push(([k, below], between, half(k, below, 1) * step));
            }
        }
        edges
    }

    /// The logarithm of the radius in each cell, with a mean of zero: the least squares fit.
    fn integrate(&self) -> Result<Vec<f64>> {
        let n = self.cells.len();
        // The constant that is free is fixed in the first cell.
        let mut matrix = vec![Triplet::new(0, 0, 1.0)];
        let mut height = faer::Col::zeros(n);
        for ([a, b], weight, gain) in self.edges() {
            height[a] -= weight * gain;
            height[b] += weight * gain;
            matrix.extend([(a, a), (b, b)].map(|(i, j)| Triplet::new(i, j, weight)));
            matrix.push(Triplet::new(a.max(b), a.min(b), -weight));
        }
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &matrix)
            .map_err(|e| format!("normal equations: {e:?}"))?;
        let factor = matrix
            .sp_cholesky(Side::Lower)
            .map_err(|e| format!("normal equations: {e:?}"))?;
        factor.solve_in_place(&mut height);
        let mean = height.iter().sum::<f64>() / n as f64;
        Ok(height.iter().map(|h| h - mean).collect())
    }
}

/// Sine and cosine of the polar angle and of the azimuth in the middle of cell `k`.
fn angles(rows: usize, k: usize) -> ((f64, f64), (f64, f64)) {
    let columns = 2 * rows;
    let polar = PI * ((k / columns) as f64 + 0.5) / rows as f64;
    let azimuth = TAU * (k % columns) as f64 / columns as f64;
    (polar.sin_cos(), azimuth.sin_cos())
}

/// The displaced sphere behind the normal map of the sphere in a scene of the authors, with so many rows of vertices, as a file of
/// theirs: its normals are those of the mesh.
///
/// # Errors
/// A scene without that sphere, or equations that have no factor.
pub fn displaced_sphere(lab: &Laboratory, rows: usize) -> Result<String> {
    use std::fmt::Write;
    let slopes = Slopes::of(lab, rows)?;
    let height = slopes.integrate()?;
    let columns = 2 * rows;
    let mut mesh = String::new();
    let length = |h: f64| slopes.radius / SCALE * h.exp();
    for (k, h) in height.iter().enumerate() {
        let ((sin, cos), (sin_phi, cos_phi)) = angles(rows, k);
        let r = length(*h);
        writeln!(
            mesh,
            "v {} {} {}",
            r * sin * cos_phi,
            r * sin * sin_phi,
            r * cos
        )?;
    }
    for (row, side) in [(0, 1.0), (rows - 1, -1.0)] {
        let around = &height[row * columns..][..columns];
        let z = side * length(around.iter().sum::<f64>() / columns as f64);
        writeln!(mesh, "v 0 0 {z}")?;
    }
    let poles = [1, 2].map(|i| rows * columns + i);
    for i in 0..columns {
        let at = |row: usize, i: usize| row * columns + i % columns + 1;
        writeln!(mesh, "f {} {} {}", poles[0], at(0, i), at(0, i + 1))?;
        for row in 0..rows - 1 {
            let [a, b] = [at(row, i), at(row + 1, i)];
            let [c, d] = [at(row + 1, i + 1), at(row, i + 1)];
            writeln!(mesh, "f {a} {b} {c}\nf {a} {c} {d}")?;
        }
        writeln!(
            mesh,
            "f {} {} {}",
            at(rows - 1, i),
            poles[1],
            at(rows - 1, i + 1)
        )?;
    }
    Ok(mesh)
}
