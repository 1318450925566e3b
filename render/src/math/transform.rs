//! Affine transforms in f64, as scene files state them. Geometry converts them to its own precision
//! once, at load.

use super::each;

/// How far axes may be from those of a similar transform, over their length: what single precision leaves of products.
const SIMILAR: f64 = 1e-5;

/// An affine map of space, x -> L x + t, acting on column vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transform {
    /// The rows of L.
    pub linear: [[f64; 3]; 3],
    /// t.
    pub translation: [f64; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Transform {
    /// x -> x.
    pub const IDENTITY: Self = Self {
        linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        translation: [0.0; 3],
    };

    /// x -> x + `by`.
    pub fn translate(by: [f64; 3]) -> Self {
        Self {
            translation: by,
            ..Self::IDENTITY
        }
    }

    /// Scales each axis by its own factor.
    pub fn scale(by: [f64; 3]) -> Self {
        let [x, y, z] = by;
        Self {
            linear: [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]],
            translation: [0.0; 3],
        }
    }

    /// Right-handed rotation by `degrees` about `axis` (any length), or `None` for a zero axis.
    pub fn rotate(axis: [f64; 3], degrees: f64) -> Option<Self> {
        let a = normalize(axis)?;
        let (s, c) = sin_cos_degrees(degrees);
        // Rodrigues: R = c I + s [a]x + (1 - c) a a^T.
        let cross = [[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]];
        let linear = from_fn(|i, j| {
            let identity = if i == j { c } else { 0.0 };
            identity + s * cross[i][j] + (1.0 - c) * a[i] * a[j]
        });
        Some(Self {
            linear,
            translation: [0.0; 3],
        })
    }

    /// A frame at `origin` whose +z axis points to `target` and whose +y axis lies in the plane of
    /// `up`; +x = `up` x z. `None` if `origin` and `target` coincide or `up` is parallel to the
    /// line between them.
    pub fn look_at(origin: [f64; 3], target: [f64; 3], up: [f64; 3]) -> Option<Self> {
        let z = normalize(sub(target, origin))?;
        let up = normalize(up)?;
        let x = cross(up, z);
        // Below this sine, rounding of the input decides where x points.
        if dot(x, x) < 1e-20 {
            return None;
        }
        let x = normalize(x)?;
        let y = cross(z, x);
        Some(Self {
            linear: from_fn(|i, j| [x, y, z][j][i]),
            translation: origin,
        })
    }

    /// From the 16 numbers of a row-major 4x4 matrix, or `None` if its last row is not 0 0 0 1.
    pub fn from_matrix(m: &[f64; 16]) -> Option<Self> {
        (m[12..] == [0.0, 0.0, 0.0, 1.0]).then(|| Self {
            linear: from_fn(|i, j| m[4 * i + j]),
            translation: [m[3], m[7], m[11]],
        })
    }

    /// From the nine numbers of a row-major 3x3 matrix, without translation.
    pub fn from_linear(m: &[f64; 9]) -> Self {
        Self {
            linear: from_fn(|i, j| m[3 * i + j]),
            translation: [0.0; 3],
        }
    }

    /// The operations of a list, first listed applied first.
    pub fn sequence(operations: impl IntoIterator<Item = Self>) -> Self {
        operations
            .into_iter()
            .fold(Self::IDENTITY, |first, next| first.then(&next))
    }

    /// `self` applied first, `next` to its result: the matrix product `next` * `self`.
    pub fn then(&self, next: &Self) -> Self {
        Self {
            linear: from_fn(|i, j| (0..3).map(|k| next.linear[i][k] * self.linear[k][j]).sum()),
            translation: next.point(self.translation),
        }
    }

    /// Determinant of L: the signed volume of the image of a unit cube, negative if orientation
    /// flips.
    pub fn determinant(&self) -> f64 {
        let [a, b, c] = self.linear;
        dot(a, cross(b, c))
    }

    /// The inverse, or `None` if L is singular to working precision or an entry is not finite.
    pub fn inverse(&self) -> Option<Self> {
        let [a, b, c] = self.linear;
        let det = self.determinant();
        // The bound of Hadamard makes the test independent of the unit of length. Two ordinary axes
        // may well differ by a factor of a million, so the rows are compared each with its own
        // length.
        let bound = length(a) * length(b) * length(c);
        if !(det.abs() > 1e-13 * bound && det.is_finite()) {
            return None;
        }
        let columns = [cross(b, c), cross(c, a), cross(a, b)];
        let linear = from_fn(|i, j| columns[j][i] / det);
        let inverse = Self {
            linear,
            translation: [0.0; 3],
        };
        let t = inverse.vector(self.translation);
        let inverse = Self {
            translation: [-t[0], -t[1], -t[2]],
            ..inverse
        };
        inverse.is_finite().then_some(inverse)
    }

    /// The rotation and the factor by which this map would have to be followed so that its axes become those of `other`, by
    /// least squares over the directions of its axes: an orthogonal Procrustes problem [Schonemann 1966], whose rotation
    /// is a polar factor [Higham 1986].
    ///
    /// # Errors
    /// What else `other` is, in words: axes that end elsewhere by more than a hundred-thousandth of their length.
    pub fn similarity(&self, other: &Self) -> Result<(Self, f64), &'static str> {
        // Axes of very different lengths count alike.
        let lengths = [0, 1, 2].map(|j| length([0, 1, 2].map(|i: usize| self.linear[i][j])));
        let [from, to] = [self, other].map(|t| from_fn(|i, j| t.linear[i][j] / lengths[j]));
        let product = Self {
            linear: from_fn(|i, j| dot(to[i], from[j])),
            translation: [0.0; 3],
        };
        let mut turn = product;
        for _ in 0..60 {
            let inverse = turn.inverse().ok_or("one that is singular")?;
            let norm = |t: &Self| length(t.linear.map(length));
            let balance = (norm(&inverse) / norm(&turn)).sqrt();
            let next = from_fn(|i, j| {
                0.5 * (balance * turn.linear[i][j] + inverse.linear[j][i] / balance)
            });
            let change = length([0, 1, 2].map(|i| length(sub(next[i], turn.linear[i]))));
            turn.linear = next;
            if change < 1e-15 {
                break;
            }
        }
        if turn.determinant() < 0.0 {
            return Err("one that mirrors");
        }
        let trace =
            |a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]| (0..3).map(|i| dot(a[i], b[i])).sum::<f64>();
        let scale = trace(&turn.linear, &product.linear) / trace(&from, &from);
        let turned = from_fn(|i, j| (0..3).map(|k| turn.linear[i][k] * from[k][j]).sum::<f64>());
        let is_near =
            |i: usize| (0..3).all(|j| (scale * turned[i][j] - to[i][j]).abs() <= SIMILAR * scale);
        if !(0..3).all(is_near) {
            return Err("one that scales axes unequally, or shears");
        }
        Ok((turn, scale))
    }

    /// L p + t.
    pub fn point(&self, p: [f64; 3]) -> [f64; 3] {
        let v = self.vector(p);
        each([0, 1, 2], |i: usize| v[i] + self.translation[i])
    }

    /// L v: a displacement, so the translation does not act.
    pub fn vector(&self, v: [f64; 3]) -> [f64; 3] {
        each(self.linear, |row| dot(row, v))
    }

    /// A surface normal: the cofactor matrix of L times `n`, not normalised. It equals det(L) L^-T
    /// n, which stays finite for every finite L; under a reflection it also turns so as to keep the
    /// side of the winding.
    pub fn normal(&self, n: [f64; 3]) -> [f64; 3] {
        let [a, b, c] = self.linear;
        let cofactors = [cross(b, c), cross(c, a), cross(a, b)];
        each(cofactors, |row| dot(row, n))
    }

    /// Whether all entries are finite.
    pub fn is_finite(&self) -> bool {
        self.linear
            .iter()
            .flatten()
            .chain(&self.translation)
            .all(|x| x.is_finite())
    }

    /// The row-major 4x4 matrix.
    pub fn matrix(&self) -> [[f64; 4]; 4] {
        let row = |i: usize| {
            let [x, y, z] = self.linear[i];
            [x, y, z, self.translation[i]]
        };
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// The row-major 4x4 matrix, rounded to single precision.
    pub fn to_f32(&self) -> [[f32; 4]; 4] {
        self.matrix().map(|row| row.map(|x| x as f32))
    }
}

/// Exact at multiples of 90 degrees, so that axis-aligned scenes stay axis-aligned.
fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        reduced => reduced.to_radians().sin_cos(),
    }
}

fn from_fn(f: impl Fn(usize, usize) -> f64) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| f(i, j)))
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}

fn length(v: [f64; 3]) -> f64 {
    v[0].hypot(v[1]).hypot(v[2])
}

/// Safe against overflow and underflow of the squares; `None` for zero or non-finite input.
fn normalize(v: [f64; 3]) -> Option<[f64; 3]> {
    let largest = v.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    if !(largest > 0.0 && v.iter().all(|x| x.is_finite())) {
        return None;
    }
    let v = v.map(|x| x / largest);
    let length = length(v);
    Some(v.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn assert_same(a: [f64; 3], b: [f64; 3]) {
        for i in 0..3 {
            assert_relative_eq!(a[i], b[i], epsilon = 1e-12, max_relative = 1e-12);
        }
    }

    fn sample() -> Transform {
        Transform::sequence([
            Transform::scale([2.0, 0.5, 3.0]),
            Transform::rotate([1.0, 2.0, -1.0], 37.0).unwrap(),
            Transform::translate([4.0, -5.0, 6.0]),
        ])
    }

    #[test]
    fn first_listed_is_applied_first() {
        let t = Transform::sequence([
            Transform::translate([1.0, 0.0, 0.0]),
            Transform::scale([2.0; 3]),
        ]);
        assert_eq!(t.point([0.0; 3]), [2.0, 0.0, 0.0]);
        assert_eq!(t.vector([1.0, 0.0, 0.0]), [2.0, 0.0, 0.0]);
    }

    #[test]
    fn rotation_is_right_handed_and_exact_at_right_angles() {
        let t = Transform::rotate([0.0, 0.0, 7.0], 90.0).unwrap();
        assert_eq!(t.point([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]);
        let t = Transform::rotate([0.0, 1.0, 0.0], -90.0).unwrap();
        assert_eq!(t.point([1.0, 0.0, 0.0]), [0.0, 0.0, 1.0]);
        let t = Transform::rotate([1.0, 0.0, 0.0], 30.0).unwrap();
        assert_same(t.point([0.0, 1.0, 0.0]), [0.0, 0.75f64.sqrt(), 0.5]);
        assert!(Transform::rotate([0.0; 3], 10.0).is_none());
    }

    #[test]
    fn look_at_maps_z_to_the_target() {
        let t = Transform::look_at([1.0, 2.0, 3.0], [1.0, 2.0, -7.0], [0.0, 1.0, 0.0]).unwrap();
        assert_same(t.point([0.0; 3]), [1.0, 2.0, 3.0]);
        assert_same(t.vector([0.0, 0.0, 1.0]), [0.0, 0.0, -1.0]);
        assert_same(t.vector([0.0, 1.0, 0.0]), [0.0, 1.0, 0.0]);
        assert_relative_eq!(t.determinant(), 1.0, epsilon = 1e-12);
        let same = [1.0; 3];
        assert!(Transform::look_at(same, same, [0.0, 1.0, 0.0]).is_none());
        assert!(Transform::look_at([0.0; 3], [0.0, 3.0, 0.0], [0.0, 1.0, 0.0]).is_none());
    }

    #[test]
    fn inverse_undoes() {
        let t = sample();
        let inverse = t.inverse().unwrap();
        let p = [0.3, -0.7, 2.0];
        assert_same(inverse.point(t.point(p)), p);
        assert_same(t.point(inverse.point(p)), p);
    }

    #[test]
    fn singular_or_overflowing_has_no_inverse() {
        assert!(Transform::scale([1.0, 0.0, 1.0]).inverse().is_none());
        assert!(Transform::scale([1e200; 3]).inverse().is_none());
        let rank_two = Transform::from_linear(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 5.0, 7.0, 9.0]);
        assert!(rank_two.inverse().is_none());
        assert!(Transform::scale([f64::NAN; 3]).inverse().is_none());
        // Small, and of very different axes, is not singular.
        assert!(Transform::scale([1e-6, 1e6, 1e-6]).inverse().is_some());
    }

    #[test]
    fn normals_stay_perpendicular() {
        let t = sample();
        let (u, v) = ([1.0, 0.5, 0.0], [0.2, -1.0, 0.7]);
        let n = t.normal(cross(u, v));
        assert_relative_eq!(dot(n, t.vector(u)), 0.0, epsilon = 1e-12);
        assert_relative_eq!(dot(n, t.vector(v)), 0.0, epsilon = 1e-12);
        // Cofactors carry cross products along exactly, reflections included.
        let mirrored = t.then(&Transform::scale([-1.0, 1.0, 1.0]));
        let n = mirrored.normal(cross(u, v));
        assert_same(n, cross(mirrored.vector(u), mirrored.vector(v)));
    }

    #[test]
    fn matrix_round_trips() {
        let t = sample();
        let m = t.matrix();
        let mut flat = [0.0; 16];
        flat.copy_from_slice(m.as_flattened());
        assert_eq!(Transform::from_matrix(&flat), Some(t));
        flat[12] = 0.1;
        assert_eq!(Transform::from_matrix(&flat), None);
        assert_eq!(t.to_f32()[0][3], 4.0);
    }
}
