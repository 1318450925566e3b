//! What moves as a whole: shapes, the camera, environments.
//!
//! A [`Placement`] is three ranges of parameters: a translation, a rotation vector about a pivot, a scale. Its values say
//! where the thing is ([`Placement::transform`]); its tangents, how it moves from there ([`Drift`]); and the adjoints of
//! all that moves with it add up to one [`Wrench`], which is pulled back to the parameters once. A drift is the identity
//! but for tangents, so that values are those of the thing where it is.
//!
//! ```
//! use ad_core::{Dual, Vec3};
//! use render::motion::rotation;
//!
//! // A point that turns about the vertical axis begins to move at right angles to it.
//! type R = Dual<f64, 1>;
//! let zero = R::constant(0.0);
//! let turned = rotation(Vec3::new(zero, R::var(0.0, 0), zero)) * Vec3::new(R::constant(1.0), zero, zero);
//! assert_eq!(turned.map(|x| x.eps[0]), Vec3::new(0.0, 0.0, -1.0));
//! ```

use ad_core::{Const, Float, Mat3, Real, Vec3};

use crate::math::{Frame, Ray, Transform, each};
use crate::params::{GradSink, ParamRef, Params, Theta};

/// Parameters of a rigid motion and a scale; what is not there does not move.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Placement {
    /// What does not turn, world space, before the translation.
    pub pivot: [f64; 3],
    /// World space; zero at rest.
    pub translation: Option<ParamRef>,
    /// A rotation vector, world axes: its direction is the axis, its length the angle in radians. Zero at rest.
    pub rotation: Option<ParamRef>,
    /// A positive factor; one at rest.
    pub scale: Option<ParamRef>,
}

/// How something moves from where it is: `x -> about + shift + (1 + growth) (1 + turn) (x - about)`, of which all but
/// `about` are tangents.
#[derive(Clone, Copy, Debug)]
pub struct Drift<R: Real> {
    about: Vec3<R::Primal>,
    shift: Vec3<R>,
    turn: Mat3<R>,
    growth: R,
}

/// The adjoint of a [`Drift`]: what a force, a torque and a pressure are in mechanics.
#[derive(Clone, Copy, Debug)]
pub struct Wrench<P> {
    about: Vec3<P>,
    force: Vec3<P>,
    torque: Vec3<P>,
    stretch: P,
}

/// `sin x / x`, `(1 - cos x) / x^2` and `(x - sin x) / x^3` of the root of `q`.
///
/// # Derivatives
/// In `q`, also where it is zero.
fn coefficients<R: Real>(q: R) -> [R; 3] {
    if q.primal() < R::Primal::of(0.25) {
        // Taylor series; the first term left out is less than a rounding of f64.
        let series = |first: i32| {
            let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
            (0..9).rev().fold(R::zero(), |sum, k| {
                R::of(factorial(2 * k + first).recip()) - sum * q
            })
        };
        return [series(1), series(2), series(3)];
    }
    let x = q.sqrt();
    let (sin, cos) = x.sin_cos();
    let (over_x, over_q) = (x.recip(), q.recip());
    [
        sin * over_x,
        (R::one() - cos) * over_q,
        (R::one() - sin * over_x) * over_q,
    ]
}

/// The matrix that takes the cross product with `w`.
fn cross_matrix<R: Real>(w: Vec3<R>) -> Mat3<R> {
    let zero = R::zero();
    Mat3::from_rows([[zero, -w.z, w.y], [w.z, zero, -w.x], [-w.y, w.x, zero]])
}

/// The rotation about the axis of `w` by its length in radians: the formula of Rodrigues.
///
/// # Derivatives
/// In `w`, also where it is zero.
pub fn rotation<R: Real>(w: Vec3<R>) -> Mat3<R> {
    let [a, b, _] = coefficients(w.length_squared());
    let k = cross_matrix(w);
    Mat3::identity() + k * a + (k * k) * b
}

/// The rotation vector of a rotation, of length pi at most: the inverse of [`rotation`], by way of a quaternion whose largest
/// component is found first [Shepperd 1978].
pub fn rotation_vector(m: [[f64; 3]; 3]) -> [f64; 3] {
    let [xx, yy, zz] = [0, 1, 2].map(|i: usize| m[i][i]);
    let odd = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    // Four times the products of its largest component with all of them.
    let products = [
        [1.0 + xx + yy + zz, odd[0], odd[1], odd[2]],
        [
            odd[0],
            1.0 + xx - yy - zz,
            m[0][1] + m[1][0],
            m[0][2] + m[2][0],
        ],
        [
            odd[1],
            m[0][1] + m[1][0],
            1.0 - xx + yy - zz,
            m[1][2] + m[2][1],
        ],
        [
            odd[2],
            m[0][2] + m[2][0],
            m[1][2] + m[2][1],
            1.0 - xx - yy + zz,
        ],
    ];
    let largest = (1..4).fold(0, |k, i| {
        if products[i][i] > products[k][k] {
            i
        } else {
            k
        }
    });
    let [w, x, y, z] = products[largest];
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    let axis = Vec3::new(x, y, z) * sign;
    let sine = axis.length();
    if sine == 0.0 {
        return [0.0; 3];
    }
    (axis * (2.0 * sine.atan2(w.abs()) / sine)).to_array()
}

/// What `x` is more than it is without tangents.
fn tangent<R: Real>(x: R) -> R {
    x - Const(x.primal())
}

/// Three numbers of a range.
fn vector<R: Real>(theta: &Theta<R>, p: ParamRef) -> Vec3<R> {
    Vec3::new(theta.get(p, 0), theta.get(p, 1), theta.get(p, 2))
}

impl Placement {
    /// About this point, with no parameters yet.
    pub fn about(pivot: [f64; 3]) -> Self {
        Self {
            pivot,
            ..Self::default()
        }
    }

    /// All ranges that are there.
    pub fn params(&self) -> impl Iterator<Item = ParamRef> {
        [self.translation, self.rotation, self.scale]
            .into_iter()
            .flatten()
    }

    /// The transform from where it is at rest, for these values: exactly the identity where they are those of rest.
    pub fn transform(&self, params: &Params) -> Transform {
        let three = |p: Option<ParamRef>| {
            p.map_or([0.0; 3], |p| {
                each([0, 1, 2], |i: usize| {
                    f64::from(params.values()[p.offset as usize + i])
                })
            })
        };
        let scale = (self.scale).map_or(1.0, |p| f64::from(params.values()[p.offset as usize]));
        let linear = (rotation(Vec3::from(three(self.rotation))) * scale).rows;
        let turned = Transform {
            linear,
            translation: three(self.translation),
        };
        let fixed = turned.vector(self.pivot);
        let translation = each([0, 1, 2], |i: usize| {
            turned.translation[i] + (self.pivot[i] - fixed[i])
        });
        Transform {
            linear,
            translation,
        }
    }

    /// A direction as it is turned, for these values.
    pub fn turn(&self, params: &Params, at_rest: [f32; 3]) -> [f32; 3] {
        let turned = self.transform(params).vector(each(at_rest, f64::from));
        each(turned, |x| x as f32)
    }

    /// The centre of turns, where it is now.
    fn centre<P: Float>(&self, theta: &Theta<P>) -> Vec3<P> {
        let moved = (self.translation).map_or(Vec3::zero(), |p| vector(theta, p));
        moved + Vec3::from(each(self.pivot, P::of))
    }

    /// How it moves; `None` if it does not.
    #[inline]
    pub fn drift<R: Real>(&self, theta: &Theta<R>) -> Option<Drift<R>> {
        if R::IS_PRIMAL || !self.params().any(|p| theta.moves(p)) {
            return None;
        }
        let turn = self.rotation.map_or(Mat3::diagonal(Vec3::zero()), |p| {
            let w = vector(theta, p);
            let now = rotation(w.map(|x| R::lift(x.primal())));
            let m = rotation(w) * now.transpose();
            Mat3::from_rows(each(m.rows, |row| each(row, tangent)))
        });
        let growth = self.scale.map_or(R::zero(), |p| {
            let s = theta.get(p, 0);
            tangent(s) * Const(s.primal().recip())
        });
        Some(Drift {
            about: self.centre(&theta.primal()),
            shift: (self.translation).map_or(Vec3::zero(), |p| vector(theta, p).map(tangent)),
            turn,
            growth,
        })
    }

    /// The adjoint of what moves with it, zero as long as nothing is added.
    pub fn wrench<P: Float>(&self, theta: &Theta<P>) -> Wrench<P> {
        Wrench {
            about: self.centre(theta),
            force: Vec3::zero(),
            torque: Vec3::zero(),
            stretch: P::zero(),
        }
    }

    /// Adds the adjoint of the turn of what shines from afar, given that of its light from the unit direction `d` with
    /// respect to `d`: who turns along sees the direction turn back.
    pub fn scatter_turn<P: Float>(
        &self,
        theta: &Theta<P>,
        d: Vec3<P>,
        adjoint: Vec3<P>,
        grad: &mut impl GradSink<P>,
    ) {
        self.scatter_direction(theta, d, -adjoint, grad);
    }

    /// Adds the adjoint of a turn, given that of a unit direction `d` that turns along.
    pub fn scatter_direction<P: Float>(
        &self,
        theta: &Theta<P>,
        d: Vec3<P>,
        adjoint: Vec3<P>,
        grad: &mut impl GradSink<P>,
    ) {
        let mut wrench = self.wrench(theta);
        wrench.direction(d, adjoint);
        self.scatter(theta, &wrench, grad);
    }

    /// Adds the adjoints of its parameters: the transpose of [`Placement::drift`].
    pub fn scatter<P: Float>(&self, theta: &Theta<P>, d: &Wrench<P>, grad: &mut impl GradSink<P>) {
        let active = |p: &ParamRef| grad.active(*p);
        let translation = self.translation.filter(active);
        let rotation = self.rotation.filter(active);
        let scale = self.scale.filter(active);
        if let Some(p) = translation {
            grad.add_all(p, 0, d.force.to_array());
        }
        if let Some(p) = rotation {
            // The left Jacobian of the exponential map, transposed.
            let w = vector(theta, p);
            let [_, b, c] = coefficients(w.length_squared());
            let across = w.cross(d.torque);
            let back = d.torque - across * b + w.cross(across) * c;
            grad.add_all(p, 0, back.to_array());
        }
        if let Some(p) = scale {
            grad.add(p, 0, d.stretch / theta.get(p, 0));
        }
    }
}

impl<R: Real> Drift<R> {
    /// A unit vector that turns with it.
    #[inline]
    pub fn direction(&self, v: Vec3<R>) -> Vec3<R> {
        v + self.turn * v
    }

    /// A vector between two of its points.
    #[inline]
    pub fn vector(&self, v: Vec3<R>) -> Vec3<R> {
        let turned = self.direction(v);
        turned + turned * self.growth
    }

    /// One of its points.
    #[inline]
    pub fn point(&self, p: Vec3<R>) -> Vec3<R> {
        let z = p - Vec3::lift(self.about);
        p + self.shift + (self.vector(z) - z)
    }

    /// How areas grow.
    #[inline]
    pub fn area(&self) -> R {
        (self.growth + R::one()).square()
    }

    /// A frame that turns with it.
    #[inline]
    pub fn frame(&self, f: &Frame<R>) -> Frame<R> {
        Frame {
            s: self.direction(f.s),
            t: self.direction(f.t),
            n: self.direction(f.n),
        }
    }

    /// The unit vector that becomes `v`.
    #[inline]
    pub fn direction_back(&self, v: Vec3<R>) -> Vec3<R> {
        v + self.turn.transpose() * v
    }

    /// A ray as seen from what moves: its direction is no unit vector where scales change, so that distances
    /// along both rays are the same number.
    #[inline]
    pub fn ray_back(&self, ray: &Ray<R>) -> Ray<R> {
        let shrink = (self.growth + R::one()).recip();
        let back = |v| self.direction_back(v) * shrink;
        let z = ray.o - Vec3::lift(self.about);
        Ray {
            o: ray.o + (back(z - self.shift) - z),
            d: back(ray.d),
            from: ray.from,
        }
    }
}

impl<P: Float> Wrench<P> {
    /// Something at `p` that moves along has the adjoint `d`.
    #[inline]
    pub fn point(&mut self, p: Vec3<P>, d: Vec3<P>) {
        self.force += d;
        self.vector(p - self.about, d);
    }

    /// A vector between points that move along has.
    #[inline]
    pub fn vector(&mut self, v: Vec3<P>, d: Vec3<P>) {
        self.direction(v, d);
        self.stretch += v.dot(d);
    }

    /// A unit vector has that turns along.
    #[inline]
    pub fn direction(&mut self, v: Vec3<P>, d: Vec3<P>) {
        self.torque += v.cross(d);
    }

    /// The logarithm of an area has.
    #[inline]
    pub fn area(&mut self, d: P) {
        self.stretch += d + d;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::{ParamShape, Tangent};
    use ad_core::Dual;

    /// A placement of a translation, a rotation and a scale, with these values.
    fn placement(values: [f32; 7]) -> (Params, Placement) {
        let mut params = Params::default();
        let all = (-1e3, 1e3);
        let placement = Placement {
            pivot: [0.25, -1.0, 2.0],
            translation: Some(params.push("t", ParamShape::Vector, &values[..3], all)),
            rotation: Some(params.push("r", ParamShape::Vector, &values[3..6], all)),
            scale: Some(params.push("s", ParamShape::Scalar, &values[6..], all)),
        };
        (params, placement)
    }

    struct Sum(Vec<f64>);

    impl GradSink<f64> for Sum {
        fn active(&self, _p: ParamRef) -> bool {
            true
        }
        fn add(&mut self, p: ParamRef, i: usize, d: f64) {
            self.0[p.offset as usize + i] += d;
        }
    }

    const PLACES: [[f32; 7]; 4] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        [0.5, -0.25, 1.0, 0.125, -0.25, 0.0625, 2.0],
        [0.0, 1.0, 0.0, 2.0, -1.0, 0.5, 0.5],
        [0.0, 1.0, 0.0, 0.0, 0.0, -3.0, 1.0],
    ];

    #[test]
    fn nothing_moves_at_rest() {
        let (params, placement) = placement(PLACES[0]);
        assert_eq!(placement.transform(&params), Transform::IDENTITY);
    }

    /// Rotations are orthogonal, and those that [`Transform::rotate`] has.
    #[test]
    fn a_rotation_vector_is_an_axis_and_an_angle() {
        for angle in [1e-9, 1e-3, 0.4999, 0.5001, 1.0, 3.0, 7.0] {
            let axis = Vec3::new(0.36, 0.48, -0.8);
            let found = rotation(axis * angle).rows;
            let expected = Transform::rotate(axis.to_array(), f64::to_degrees(angle)).unwrap();
            for (a, b) in found.iter().flatten().zip(expected.linear.iter().flatten()) {
                assert!((a - b).abs() < 1e-14, "{angle}: {a} {b}");
            }
        }
    }

    /// There and back again, near no turn, a half turn and where each component of the quaternion is the largest.
    #[test]
    fn rotation_vectors_are_found_again() {
        for axis in [
            [0.36, 0.48, -0.8],
            [1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.6, 0.0, 0.8],
        ] {
            for angle in [0.0, 1e-12, 1e-3, 1.0, 3.0, std::f64::consts::PI - 1e-7] {
                let w = Vec3::from(axis) * angle;
                let found = rotation_vector(rotation(w).rows);
                for (a, b) in found.into_iter().zip(w.to_array()) {
                    assert!((a - b).abs() < 1e-13, "{axis:?} {angle}: {a} {b}");
                }
            }
        }
    }

    /// Of points, directions and rays, against differences of the transform, and against the adjoint.
    #[test]
    fn drifts_are_the_change_of_the_transform() {
        for values in PLACES {
            let (params, placement) = placement(values);
            let now = placement.transform(&params);
            let wide: Vec<f64> = values.map(f64::from).to_vec();
            let rest = [0.5, 0.75, -1.5];
            let (p, d_p) = (now.point(rest), Vec3::new(0.3, -0.7, 1.1));
            let v = Vec3::from(now.vector([0.0, 0.6, 0.8])).normalize();
            let d_v = Vec3::new(-0.2, 0.9, 0.4);
            let mut wrench = placement.wrench(&Theta::constant(&wide));
            wrench.point(p.into(), d_p);
            wrench.direction(v, d_v);
            wrench.area(0.5);
            let mut sum = Sum(vec![0.0; 7]);
            placement.scatter(&Theta::constant(&wide), &wrench, &mut sum);
            for k in 0..7 {
                let mut tangents = vec![vec![Dual::<f64, 1>::new(0.0, [0.0]); 3]; 2];
                tangents.push(vec![Dual::new(0.0, [0.0])]);
                tangents[k / 3][k % 3].eps[0] = 1.0;
                let tangents: Vec<_> = tangents.into_iter().map(Tangent::Dense).collect();
                let theta = Theta::with_tangents(&wide, &tangents);
                let drift = placement.drift(&theta).expect("it moves");
                let point = drift.point(Vec3::lift(p.into()));
                let direction = drift.direction(Vec3::lift(v));
                let area = drift.area();
                assert_eq!(point.primal().to_array(), p);
                assert_eq!(direction.primal(), v);

                let h = 1.0 / 1024.0;
                let at = |h: f32| {
                    let mut values = values;
                    values[k] += h;
                    let (params, placement) = self::placement(values);
                    let t = placement.transform(&params);
                    let v = Vec3::from(t.vector([0.0, 0.6, 0.8]));
                    (
                        Vec3::from(t.point(rest)),
                        v.normalize(),
                        v.length_squared().ln(),
                    )
                };
                let ((p1, v1, a1), (p0, v0, a0)) = (at(h), at(-h));
                let slope = f64::from(0.5 / h);
                let near = |found: f64, expected: f64| {
                    assert!((found - expected).abs() < 2e-5, "{k}: {found} {expected}");
                };
                for i in 0..3 {
                    near(point[i].eps[0], (p1[i] - p0[i]) * slope);
                    near(direction[i].eps[0], (v1[i] - v0[i]) * slope);
                }
                near(area.eps[0], (a1 - a0) * slope);
                let slopes = |v: Vec3<Dual<f64, 1>>| v.map(|x| x.eps[0]);
                let forward =
                    slopes(point).dot(d_p) + slopes(direction).dot(d_v) + 0.5 * area.eps[0];
                assert!(
                    (forward - sum.0[k]).abs() < 1e-13,
                    "{k}: {forward} {}",
                    sum.0[k]
                );

                // There and back again.
                let ray = Ray::new(point, drift.vector(Vec3::lift(v)));
                let back = drift.ray_back(&ray);
                for (x, was) in [(back.o, p.into()), (back.d, v)] {
                    assert_eq!(x.primal(), was);
                    assert!(slopes(x).length() < 1e-14, "{k}: {x:?}");
                }
            }
        }
    }
}
