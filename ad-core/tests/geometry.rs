//! The hardest later users in miniature: attached sampling through a ray, a moving triangle, a
//! Newton walk on a specular manifold, a Hessian of it all.

use ad_core::{
    Const, DiffFn, Dual, Mat3, NewtonOptions, Real, Vec3, check, diff_fn, gradient, hessian,
    jacobian, newton, solve_dense,
};

/// Distance and barycentrics of the hit of a ray with a triangle, all of them differentiable.
fn intersect<R: Real>(origin: Vec3<R>, dir: Vec3<R>, [a, b, c]: [Vec3<R>; 3]) -> Option<Vec3<R>> {
    // origin + t dir = a + u (b - a) + v (c - a)
    Mat3::from_cols([-dir, b - a, c - a]).solve(origin - a)
}

diff_fn! {
    /// Hit point on a triangle that turns by an angle and moves, of a ray with a moving origin:
    /// inputs angle, shift, ray origin x, y; outputs t, u, v and the world-space hit point.
    fn moving_triangle<R>([angle, shift, ox, oy]: [R; 4]) -> [R; 6] {
        let (s, c) = angle.sin_cos();
        let turn = |v: [f64; 3]| {
            let [x, y, z] = v.map(R::of);
            Vec3::new(c * x - s * z, y + shift, s * x + c * z)
        };
        let tri = [turn([-1.0, -1.0, 4.0]), turn([1.5, -0.8, 4.5]), turn([0.0, 1.3, 3.6])];
        let origin = Vec3::new(ox, oy, R::zero());
        let dir = Vec3::<R>::lift(Vec3::new(0.1, 0.05, 1.0).map(<R::Primal as Real>::of));
        let hit = intersect(origin, dir, tri).expect("the ray meets the triangle's plane");
        let p = origin + dir * hit.x;
        [hit.x, hit.y, hit.z, p.x, p.y, p.z]
    }
}

#[test]
fn moving_triangle_hit_equals_differences() {
    for x in [
        [0.0, 0.0, 0.0, 0.0],
        [0.4, -0.1, 0.2, -0.1],
        [-0.7, 0.3, 0.1, 0.2],
    ] {
        let report = check::jacobian_by_differences(&moving_triangle, x, 1e-9);
        assert!(report.passed() && report.compared == 24, "{report}");
        // Moving the origin along the ray's plane leaves the hit in the triangle's plane.
        let single = jacobian(&moving_triangle, x.map(|x| x as f32)).1;
        for (a, b) in single
            .iter()
            .flatten()
            .zip(jacobian(&moving_triangle, x).1.iter().flatten())
        {
            assert!((f64::from(*a) - b).abs() < 1e-4 * (1.0 + b.abs()));
        }
    }
}

/// A direction sampled with roughness alpha hits a sphere light's plane; the contribution is an
/// emission profile times the cosine. The sample point is fixed: attached sampling.
struct AttachedSample {
    u: [f64; 2],
}

impl DiffFn<2, 1> for AttachedSample {
    fn eval<R: Real>(&self, [alpha, height]: [R; 2]) -> [R; 1] {
        // GGX normal: tan^2 = alpha^2 u / (1 - u).
        let tan2 = alpha.square() * R::c(self.u[0] / (1.0 - self.u[0]));
        let cos = (tan2 + R::c(1.0)).sqrt().recip();
        let sin = cos * tan2.sqrt();
        let phi = 2.0 * std::f64::consts::PI * self.u[1];
        let m = Vec3::new(sin * R::c(phi.cos()), sin * R::c(phi.sin()), cos);
        let wo = Vec3::<R>::lift(Vec3::new(0.6, 0.0, 0.8).map(<R::Primal as Real>::of));
        let wi = m * (wo.dot(m) * R::c(2.0)) - wo;
        let t = height / wi.z;
        let (x, y) = (wi.x * t, wi.y * t);
        [(-(x.square() + y.square()) * R::c(0.5)).exp() * wi.z]
    }
}

#[test]
fn attached_sampling_through_a_ray() {
    for u in [[0.1, 0.2], [0.5, 0.9], [0.8, 0.55]] {
        let f = AttachedSample { u };
        let report = check::jacobian_by_differences(&f, [0.3, 1.4], 1e-9);
        assert!(report.passed(), "{report}");
        // At alpha = 0 the sample is the mirror direction; its derivative stays finite.
        let (y, g) = gradient(&f, [0.0, 1.4]);
        assert!(y > 0.0 && g.iter().all(|g| g.is_finite()), "{y} {g:?}");
    }
}

/// Reflection at a height field `z = a (x^2 + y^2 / 2)` between two fixed points: the constraint is
/// that the projected half vector vanishes in the tangent plane.
struct Mirror<P> {
    curvature: P,
    light: Vec3<f64>,
    eye: Vec3<f64>,
}

impl<P: Copy> Mirror<P> {
    fn constraint<R: Real>(&self, x: R, y: R, curvature: R) -> [R; 2] {
        let half = R::c(0.5);
        let p = Vec3::new(x, y, curvature * (x.square() + y.square() * half));
        let (tx, ty) = (curvature * x * R::c(2.0), curvature * y);
        let to = |v: Vec3<f64>| (Vec3::<R>::lift(v.map(<R::Primal as Real>::of)) - p).normalize();
        let h = to(self.light) + to(self.eye);
        [h.x + h.z * tx, h.y + h.z * ty]
    }
}

impl DiffFn<2, 2> for Mirror<f64> {
    fn eval<R: Real>(&self, [x, y]: [R; 2]) -> [R; 2] {
        self.constraint(x, y, R::of(self.curvature))
    }
}

fn mirror(curvature: f64) -> Mirror<f64> {
    Mirror {
        curvature,
        light: Vec3::new(1.0, 0.3, 2.0),
        eye: Vec3::new(-0.8, -0.5, 1.5),
    }
}

fn specular_point(curvature: f64) -> [f64; 2] {
    let options = NewtonOptions {
        max_iterations: 20,
        tolerance: 1e-14,
    };
    let found = newton(&mirror(curvature), [0.0, 0.0], &options);
    assert!(found.converged() && found.iterations <= 8, "{found:?}");
    found.x
}

#[test]
fn manifold_walk_and_its_derivative() {
    // Flat mirror: the unfolded straight line meets z = 0 in the ratio of the heights.
    let [x, y] = specular_point(0.0);
    assert!((x - (1.0 * 1.5 - 0.8 * 2.0) / 3.5).abs() < 1e-12);
    assert!((y - (0.3 * 1.5 - 0.5 * 2.0) / 3.5).abs() < 1e-12);

    // Implicit function theorem: dx/dp = -(dC/dx)^-1 dC/dp.
    let curvature = 0.1;
    let [x, y] = specular_point(curvature);
    let m = mirror(curvature);
    let (_, by_x) = jacobian(&m, [x, y]);
    let by_p = m
        .constraint::<Dual<f64, 1>>(Dual::lift(x), Dual::lift(y), Dual::var(curvature, 0))
        .map(|c| -c.eps[0]);
    let dx = solve_dense(by_x, by_p).expect("regular");
    for (k, got) in dx.into_iter().enumerate() {
        let d = check::central_difference(|p| specular_point(p)[k], curvature, 0.02);
        assert!((got - d.value).abs() < 1e-8 + 4.0 * d.error, "{got} {d:?}");
    }
}

diff_fn! {
    /// Squared distance of the hit from a target: a loss on geometry.
    fn pose_loss<R>(x: [R; 4]) -> [R; 1] {
        let y = moving_triangle.eval(x);
        let target = Vec3::new(0.3, 0.1, 4.2).map(<R::Primal as Real>::of);
        [(Vec3::new(y[3], y[4], y[5]) - Vec3::lift(target)).length_squared()]
    }
}

#[test]
fn hessian_through_geometry() {
    diff_fn! { fn slope<R>(x: [R; 4]) -> [R; 4] { gradient(&pose_loss, x).1 } }
    let x = [0.4, -0.1, 0.2, -0.1];
    let report = check::jacobian_by_differences(&slope, x, 1e-8);
    assert!(report.passed(), "{report}");
    let (_, _, h) = hessian(&pose_loss, x);
    assert_eq!(h, jacobian(&slope, x).1);
}

#[test]
fn vector_singularities() {
    type D = Dual<f32, 3>;
    let at = |v: [f32; 3]| Vec3::from(std::array::from_fn::<_, 3, _>(|i| D::var(v[i], i)));
    let zero = at([0.0; 3]);
    assert_eq!((zero.length().re, zero.length().eps), (0.0, [0.0; 3]));
    assert_eq!(zero.normalize(), Vec3::zero());
    for v in [
        [0.0; 3],
        [1e-42, 0.0, 0.0],
        [1e-30, 2e-30, 0.0],
        [3e38, 1e38, 2e38],
        [0.6, 0.0, 0.8],
    ] {
        let (n, l) = (at(v).normalize(), at(v).length());
        assert!(n.is_finite(), "{v:?}: {n:?}");
        assert!(l.eps.iter().all(|e| e.is_finite()), "{v:?}: {l:?}");
        // Zero tangent in, zero tangent out.
        let c = Vec3::<D>::lift(Vec3::from(v));
        let n = c.normalize();
        assert!(![n.x, n.y, n.z, c.length()].into_iter().any(D::has_tangent));
    }
    for s in [1e-36f32, 1e-25, 1.0, 1e19, 1e25, 2e38] {
        let l = at([0.6 * s, 0.0, 0.8 * s]).length();
        assert!((l.re / s - 1.0).abs() < 1e-6);
        assert!(
            (l.eps[0] - 0.6).abs() < 1e-6 && (l.eps[2] - 0.8).abs() < 1e-6,
            "{s:e}: {l:?}"
        );
    }
    let endless = at([f32::INFINITY, 1.0, 0.0]);
    assert_eq!(
        (endless.length().re, endless.normalize()),
        (f32::INFINITY, Vec3::zero())
    );
    // Derivative of normalisation across the direction: (I - n n^T) / |v|, also for tiny vectors.
    for s in [1e-30f32, 1e-12, 1.0, 1e12, 1e30] {
        let n = at([0.6 * s, 0.0, 0.8 * s]).normalize();
        for (got, want) in n.x.eps.into_iter().zip([0.64, 0.0, -0.48]) {
            assert!((got * s - want).abs() < 1e-5, "{s:e}: {:?}", n.x);
        }
        assert!((n.y.eps[1] * s - 1.0).abs() < 1e-5);
    }
    assert_eq!(Vec3::splat(1.0f32) * Const(2.0), Vec3::splat(2.0));
}
