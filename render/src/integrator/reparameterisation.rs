//! Where samples have to stand still: the factor `B` of reparameterised attached sampling.
//!
//! Attached samples move with the parameters, and must not move across a discontinuity of the
//! incident light. `B` is a smooth function of direction that is one at every discontinuity that can
//! be seen from a point, and falls to zero away from them: samples move with `1 - B` of their velocity
//! [Zeltner 2021, section 4.4.2].
//!
//! The thesis makes `B` from distances to the outline of whatever a ray hits, which are right on
//! one side of an outline only, and spreads them by a harmonic convolution, a ratio of two
//! estimates [Zeltner 2021, Eqs. 4.23, 4.24]. With 16 rays that ratio is far from converged where
//! it matters: on a ball light, three quarters of the derivative were missing (exponent 3 of errata
//! Z-4.24). Here auxiliary rays only find out *which* outlines are near; the distance of the direction
//! itself from each of them is then exact, from both sides, and so is the gradient. No division, and
//! almost no noise.

use ad_core::{Dual, Float, Real, Vec3};

use crate::accel::Hit;
use crate::math::{Frame, Ray, each};
use crate::sampler::Sampler;
use crate::scene::Scene;

/// Directions closer to a discontinuity than this (radians) are slowed down.
pub const OUTLINE_WIDTH: f64 = 0.02;

/// Auxiliary rays lie in a ring between these angles (radians), uniformly in the logarithm. A pair on
/// opposite sides of the direction finds most outlines that are nearer than its angle; to find those at
/// [`OUTLINE_WIDTH`] nearly always, as an unbiased `B` needs, it has to look well beyond.
const RING: [f64; 2] = [OUTLINE_WIDTH / 30.0, OUTLINE_WIDTH * 10.0];

/// Rays that meet a primitive closer to its outline than this (radians) say nothing of it: by rounding, a ray that passes an
/// edge meets a face behind that edge, which is turned away and which no other ray meets.
const ROUNDING: f64 = 1e-5;

/// `B` at a direction, and how it changes with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Freeze<P> {
    /// `B`, in [0, 1].
    pub b: P,
    /// Its gradient with respect to the direction: a tangent vector, local frame, per radian.
    pub gradient: Vec3<P>,
}

/// One at an outline, zero from [`OUTLINE_WIDTH`] on, with a continuous derivative.
#[inline]
fn bump<R: Real>(distance: R) -> R {
    if distance.primal() >= R::Primal::of(OUTLINE_WIDTH) {
        return R::zero();
    }
    let s = distance * R::c(1.0 / OUTLINE_WIDTH);
    (-s.square() + R::c(1.0)).square()
}

/// `B` at the unit direction `w` (local to `frame`) seen from where the ray `start` does: outlines are those of the
/// primitives met by the direction itself and by `rays` auxiliary rays around it (rounded up to pairs),
/// and the horizon of `frame`. Takes one number of the sampler per ray.
///
/// # Does not handle
/// Lines where surfaces intersect each other; outlines that no auxiliary ray finds, such as those of
/// objects much smaller than [`OUTLINE_WIDTH`]: there, some of the bias of naive attached sampling is left. Outlines that are
/// hidden count where a ray meets another part of the primitive: samples stand still there, which they need not.
pub fn freeze<P: Float, X: Sampler>(
    scene: &Scene,
    start: &Ray<P>,
    frame: &Frame<P>,
    w: Vec3<P>,
    rays: usize,
    sampler: &mut X,
) -> Freeze<P> {
    let (origin, from) = (start.o, start.from);
    let tangents = Frame::from_normal(w);
    let mut found: Vec<Hit> = Vec::with_capacity(rays + 2);
    let mut look = |w: Vec3<P>| {
        let ray = Ray::new(origin, frame.to_world(w)).leaving(from);
        if let Some(hit) = scene.nearest(&ray)
            && found.iter().all(|h| h.prim != hit.prim)
            && scene.border(&ray, &hit) > P::of(ROUNDING)
        {
            found.push(hit);
        }
    };
    look(w);
    let [least, most] = RING;
    let log_range = (most / least).ln();
    let pairs = rays.div_ceil(2);
    for pair in 0..pairs {
        let [u, v]: [f64; 2] = sampler.next_2d();
        let angle = least * ((pair as f64 + u) / pairs as f64 * log_range).exp();
        let (sin, cos) = angle.sin_cos();
        let (y, x) = (2.0 * std::f64::consts::PI * v).sin_cos();
        for side in [sin, -sin] {
            let around = each([side * x, side * y, cos], P::of);
            look(tangents.to_world(around.into()));
        }
    }

    // 1 - B is the product over all outlines; over duals that move the direction.
    let moving = Vec3::<Dual<P, 2>>::lift(w)
        + Vec3::lift(tangents.s) * Dual::var(P::zero(), 0)
        + Vec3::lift(tangents.t) * Dual::var(P::zero(), 1);
    let to_world = |v: Vec3<Dual<P, 2>>| {
        let [s, t, n] = each([frame.s, frame.t, frame.n], Vec3::lift);
        s * v.x + t * v.y + n * v.z
    };
    let ray = Ray::new(Vec3::lift(origin), to_world(moving));
    let mut free = -bump(moving.z.abs()) + Dual::lift(P::one());
    for hit in &found {
        free *= -bump(scene.border(&ray, hit)) + Dual::lift(P::one());
    }
    Freeze {
        b: P::one() - free.re,
        gradient: -(tangents.s * free.eps[0] + tangents.t * free.eps[1]),
    }
}
