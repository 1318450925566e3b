//! What auxiliary rays see over mirrors and glass, and how the direction in which they see it moves.
//!
//! A path that leaves a vertex, or the camera, may go on along Dirac deltas. What jumps there is seen in the direction of the
//! first edge, which has to follow it. An auxiliary ray goes on along the same deltas as the path, as far as it meets
//! materials that have them, and each surface that it meets has a boundary test and a velocity.
//!
//! A direction `w` sees a point `y(w)` of a surface that moves. It follows the material if `y_w w'` takes away what the point
//! slides over the surface for a constant direction: `w' = -y_w^-1 (y' - y'_material)`, by 2 x 2 numbers in the tangent planes
//! of both. The last surface that a ray meets carries the field where nothing jumps, those before it only near their outlines.
//! Close to caustics `y_w` is singular, and directions move as fast as images do there; then the first surface carries it,
//! whose material is followed without any turn.

use ad_core::{Dual, Float, Vec3};
use smallvec::SmallVec;

use super::field::{KAPPA, LARGEST};
use super::outlines::Outlines;
use crate::accel::Hit;
use crate::bsdf::{Component, Shading};
use crate::integrator::active::Active;
use crate::integrator::delta::{Delta, scatter};
use crate::integrator::motion::slopes::{across, varied};
use crate::integrator::motion::trail::Stop;
use crate::integrator::record::Place;
use crate::math::{Frame, Ray};
use crate::params::Theta;
use crate::scene::Scene;
use crate::shape::SurfaceInteraction;

/// What surfaces count for away from their outlines that others are seen over, as a boundary test.
const ASIDE: f64 = 100.0 * LARGEST;

/// A ray, the delta that it meets, and where.
#[derive(Clone, Copy)]
pub(super) struct Leg<P> {
    /// From the vertex before itself, where rays that look for surfaces start off it.
    pub ray: Ray<P>,
    pub place: Place<P>,
    pub delta: Delta,
}

/// A point that is seen over deltas.
pub(super) struct Sight<P> {
    pub legs: SmallVec<[Leg<P>; 2]>,
    /// The last ray, and the point that it ends at.
    pub ray: Ray<P>,
    pub end: (u32, SurfaceInteraction<P>),
    /// Whether anything on the way moves, or the point.
    pub moves: bool,
    /// Vectors at right angles to the direction, and tangents of the surface at the end: see [`Sight::slides`].
    pairs: [(Vec3<f64>, Vec3<f64>); 2],
}

impl<P> Sight<P> {
    fn is_finite(&self) -> bool {
        self.pairs.iter().all(|(across, _)| across.is_finite())
    }

    /// The adjoint of how the point slides over the surface there, given that of the direction.
    pub fn slides(&self, d: Vec3<f64>) -> Vec3<f64> {
        let [a, b] = &self.pairs;
        a.1 * a.0.dot(d) + b.1 * b.0.dot(d)
    }
}

/// Surfaces that are seen over others, with their boundary tests.
pub(super) type Sights<P> = SmallVec<[(f64, Sight<P>); 1]>;

/// The deltas that a path goes along from the first of these vertices on.
pub(super) fn ahead<P: Float>(stops: &[Stop<P>]) -> SmallVec<[Delta; 2]> {
    let delta = |stop: &Stop<P>| match stop.bounce.as_ref()?.component {
        Component::Delta { kind, route } => Some((kind, route)),
        Component::Continuous => None,
    };
    stops.iter().map_while(delta).collect()
}

/// The boundary test of a surface that others are seen over.
pub(super) fn aside(test: f64) -> f64 {
    if test < LARGEST {
        (test / (1.0 - test / LARGEST)).min(ASIDE)
    } else {
        ASIDE
    }
}

/// What a ray sees over deltas from its first hit on, with boundary tests in angles of the first direction. `None` if it does
/// not get beyond that hit.
pub(super) fn look<P: Float>(
    (scene, theta, active): (&Scene, &Theta<P>, &Active),
    outlines: &Outlines,
    (first, mut hit): (Ray<P>, Hit),
    deltas: &[Delta],
) -> Option<Sights<P>> {
    type D<P> = Dual<P, 2>;
    let still = Theta::<D<P>>::still();
    let theta = theta.lift::<D<P>>();
    let axes = across(first.d).map(|v| v.map(P::to_f64));
    let mut ray = Ray {
        o: Vec3::lift(first.o),
        d: varied(first.d, 0),
        from: first.from,
    };
    let mut legs = SmallVec::<[Leg<P>; 2]>::new();
    // With how thin the image is; each is seen over one leg more than the one before it.
    let mut seen = SmallVec::<[(f64, f64, Sight<P>); 1]>::new();
    let mut moves = false;
    let mut length = 0.0;
    let mut met = scene.interaction(&still, &ray, &hit);
    for &delta in deltas {
        // ---- On over the surface ----
        let shape = met.shape;
        moves |= active.moves_shape(shape);
        length += met.si.t.re.to_f64();
        let wo = met.si.frame.to_local(-ray.d);
        let at = Shading::new(theta, met.si.uv);
        let Some((wi, _)) = scatter(scene.material(shape), &at, wo, delta) else {
            break;
        };
        let si = met.si.primal();
        legs.push(Leg {
            ray: ray.primal(),
            place: Place {
                shape,
                prim: met.prim,
                si,
                wo: wo.primal(),
            },
            delta,
        });
        let d = met.si.frame.to_world(wi).normalize();
        let onward = si.spawn_ray(d.primal(), scene.exit(met.prim));
        let Some(next) = scene.nearest(&onward) else {
            break;
        };
        hit = next;
        ray = Ray {
            o: met.si.p,
            d,
            from: onward.from,
        };

        // ---- What is there ----
        met = scene.interaction(&still, &ray, &hit);
        let si = met.si.primal();
        let slides = [0, 1].map(|k| met.si.p.map(|x| x.eps[k].to_f64()));
        // The image across the ray: how much faster than the first direction it moves.
        let [[a, b], [c, e]] =
            across(ray.d.primal().map(P::to_f64)).map(|axis| slides.map(|y| axis.dot(y)));
        let size = a * a + b * b + c * c + e * e;
        let distance = si.t.to_f64();
        let kappa = KAPPA * 2.0 * distance * distance / size;
        let test = outlines.test(kappa, &onward, &hit, true);
        let thin = (a * e - b * c).abs() / ((0.5 * size).sqrt() * (length + distance));
        let sight = Sight {
            legs: SmallVec::new(),
            ray: ray.primal(),
            end: (met.prim, si),
            moves: moves || active.moves_shape(met.shape),
            pairs: pairs(axes, slides, si.n_geo.map(P::to_f64)),
        };
        seen.push((test, thin.min(1.0), sight));
    }
    let last = seen.len().checked_sub(1)?;
    let of = |(k, (test, thin, sight)): (usize, (f64, f64, Sight<P>))| {
        let test = if k == last {
            // Near outlines the test is what it is, whatever the image.
            test / (1.0 - test / LARGEST * (1.0 - thin.powi(4)))
        } else if test < LARGEST {
            aside(test)
        } else {
            return None;
        };
        let legs = SmallVec::from_slice(&legs[..=k]);
        (test.is_finite() && sight.is_finite()).then_some((test, Sight { legs, ..sight }))
    };
    Some(seen.into_iter().enumerate().filter_map(of).collect())
}

/// [`Sight::pairs`] of a point that slides over a surface with this normal as the direction turns along two axes.
fn pairs(
    axes: [Vec3<f64>; 2],
    slides: [Vec3<f64>; 2],
    normal: Vec3<f64>,
) -> [(Vec3<f64>, Vec3<f64>); 2] {
    let Frame { s, t, .. } = Frame::from_normal(normal);
    let [[a, b], [c, e]] = [s, t].map(|axis| slides.map(|y| axis.dot(y)));
    // The transpose of the inverse, negative.
    let over = -(a * e - b * c).recip();
    [
        ((axes[0] * e - axes[1] * c) * over, s),
        ((axes[1] * a - axes[0] * b) * over, t),
    ]
}
