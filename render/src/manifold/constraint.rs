//! What vanishes where light is reflected or refracted as the laws say, written once over the scalar.

use ad_core::{Real, Vec3};

use crate::bsdf::DeltaKind;
use crate::math::{Frame, each};
pub use crate::scene::Constraint;

/// The mirror image of the unit vector `w` about the unit normal `n`.
#[inline]
pub fn reflect<R: Real>(w: Vec3<R>, n: Vec3<R>) -> Vec3<R> {
    n * (n.dot(w) * R::c(2.0)) - w
}

/// The unit direction that `w` is refracted into, both leaving the surface; `eta` is the index behind the unit normal `n`
/// over that in front of it, whichever side `w` is on. `None` at total reflection.
///
/// # Source
/// [Zeltner 2021, Eq. 2.23] with errata Z-2.23.
#[inline]
pub fn refract<R: Real>(w: Vec3<R>, n: Vec3<R>, eta: R) -> Option<Vec3<R>> {
    let cos = n.dot(w);
    // The index on the side of `w` over that on the other.
    let (n, cos, ratio) = if cos.primal() < R::Primal::zero() {
        (-n, -cos, eta)
    } else {
        (n, cos, eta.recip())
    };
    let radicand = R::one() - ratio * ratio * (R::one() - cos * cos);
    (radicand.primal() > R::Primal::zero()).then(|| n * (ratio * cos - radicand.sqrt()) - w * ratio)
}

/// The direction that `w` is scattered into. `None` at total reflection, and for what is no event of a chain.
#[inline]
pub fn scatter<R: Real>(kind: DeltaKind, w: Vec3<R>, n: Vec3<R>, eta: R) -> Option<Vec3<R>> {
    match kind {
        DeltaKind::Reflection => Some(reflect(w, n)),
        DeltaKind::Transmission => refract(w, n, eta),
        DeltaKind::Passthrough => None,
    }
}

/// The surface at a specular vertex.
#[derive(Clone, Copy, Debug)]
pub struct Facet<R> {
    /// Unit normal that scatters: shading normal, normal maps included.
    pub n: Vec3<R>,
    /// Index behind the normal over that in front of it; one on mirrors.
    pub eta: R,
}

/// A frame for spherical coordinates that stays the same during a walk towards `d`: its polar axis is perpendicular to
/// that direction, near which the coordinates are regular (errata Z-3.19).
pub fn equator(d: Vec3<f64>) -> Frame<f64> {
    let Frame { s, t, n } = Frame::from_normal(d.normalize());
    Frame { s: n, t, n: s }
}

/// The polar angle and the azimuth of the unit vector `a` less those of `b`; azimuths differ by at most half a turn (errata
/// Z-3.19). As angles of one turn to the other: equal directions differ by zero, without any rounding of large angles.
#[inline]
fn difference<R>(a: Vec3<R>, b: Vec3<R>, frame: &Frame<f64>) -> [R; 2]
where
    R: Real<Primal = f64>,
{
    let local = |v: Vec3<R>| each([frame.s, frame.t, frame.n], |axis| v.dot_const(axis));
    let ([ax, ay, az], [bx, by, bz]) = (local(a), local(b));
    let (a_off, b_off) = ((ax * ax + ay * ay).sqrt(), (bx * bx + by * by).sqrt());
    let theta = (a_off * bz - az * b_off).atan2(az * bz + a_off * b_off);
    let phi = (ay * bx - ax * by).atan2(ax * bx + ay * by);
    [theta, phi]
}

/// The constraint of a vertex whose unit directions to its two neighbours are `w` and `next`. `None` where it has no value:
/// where light can go neither way, or for half vectors of no length.
///
/// Total reflection of `w` makes the angle constraint look the other way, from `next`, which can be refracted if it lies in
/// the thinner medium (errata Z-A.3).
///
/// # Derivatives
/// In all arguments over `R`; the frame of the angles is constant.
///
/// # Source
/// [Zeltner 2021, Eqs. 3.1, 3.2 and 3.19] with errata Z-2.38.
pub fn value<R: Real<Primal = f64>>(
    constraint: Constraint,
    kind: DeltaKind,
    w: Vec3<R>,
    next: Vec3<R>,
    facet: &Facet<R>,
    frame: &Frame<f64>,
) -> Option<[R; 2]> {
    match constraint {
        Constraint::Angle => match scatter(kind, w, facet.n, facet.eta) {
            Some(scattered) => Some(difference(next, scattered, frame)),
            None => {
                let scattered = scatter(kind, next, facet.n, facet.eta)?;
                Some(difference(w, scattered, frame))
            }
        },
        Constraint::HalfVector => {
            let index = |w: Vec3<R>| {
                let behind = w.dot(facet.n).primal() < 0.0;
                let refracts = kind == DeltaKind::Transmission;
                R::select(refracts && behind, facet.eta, R::one())
            };
            let h = w * index(w) + next * index(next);
            if h.primal().length_squared() < 1e-24 {
                return None;
            }
            let h = h.normalize();
            let h = if h.dot(facet.n).primal() < 0.0 { -h } else { h };
            let Frame { s, t, .. } = Frame::from_normal(facet.n);
            Some([s.dot(h), t.dot(h)])
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use ad_core::Dual;

    use super::*;
    use crate::math::warp;
    use crate::sampler::{Independent, Sampler};

    fn unit<R: Real>(v: [R; 3]) -> Vec3<R> {
        Vec3::from(v).normalize()
    }

    /// The constraint as a function of twelve numbers: both neighbours, the vertex, the normal.
    fn at<R: Real<Primal = f64>>(
        which: Constraint,
        kind: DeltaKind,
        x: [R; 12],
        frame: &Frame<f64>,
    ) -> Option<[R; 2]> {
        let v = |i: usize| Vec3::new(x[i], x[i + 1], x[i + 2]);
        let n = unit([x[9], x[10], x[11]]);
        let facet = Facet { n, eta: R::of(1.5) };
        let to = |p: Vec3<R>| (p - v(3)).normalize();
        value(which, kind, to(v(0)), to(v(6)), &facet, frame)
    }

    /// Derivatives of both constraints against central differences, on random configurations of reflection and of refraction
    /// from both sides, moving normals included.
    #[test]
    fn derivatives_are_those_of_differences() {
        use DeltaKind::{Reflection, Transmission};
        let mut seen = 0;
        for i in 0..2000u64 {
            let mut s = Independent::new(1, 0, i);
            let mut x: [f64; 12] = std::array::from_fn(|_| 2.0 * s.next_1d::<f64>() - 1.0);
            // Away from vertices that meet their neighbours.
            x[1] += 3.0;
            x[7] += if i % 3 == 0 { 3.0 } else { -3.0 };
            x[10] += 2.0;
            if i % 2 == 0 {
                (x[9], x[10], x[11]) = (-x[9], -x[10], -x[11]);
            }
            let kind = if i % 3 == 0 { Reflection } else { Transmission };
            let frame = equator(Vec3::new(x[6] - x[0], x[7] - x[1], x[8] - x[2]));
            for which in [Constraint::Angle, Constraint::HalfVector] {
                let y: [Dual<f64, 12>; 12] = std::array::from_fn(|k| Dual::var(x[k], k));
                let Some(c) = at(which, kind, y, &frame) else {
                    continue;
                };
                // Not across the jump of azimuths, nor where total reflection sets in.
                if c.iter()
                    .any(|c| c.re.abs() > 3.0 || c.eps.iter().any(|e| e.abs() > 10.0))
                {
                    continue;
                }
                for k in 0..12 {
                    let shifted = |h: f64| {
                        let mut y = x;
                        y[k] += h;
                        at(which, kind, y, &frame)
                    };
                    let difference = |h: f64| {
                        let (a, b) = (shifted(h)?, shifted(-h)?);
                        Some([0, 1].map(|j| (a[j] - b[j]) / (2.0 * h)))
                    };
                    let (Some(near), Some(far)) = (difference(2e-5), difference(4e-5)) else {
                        continue;
                    };
                    for j in 0..2 {
                        // Richardson: the error of both differences cancels to fourth order.
                        let expected = (4.0 * near[j] - far[j]) / 3.0;
                        let error = (c[j].eps[k] - expected).abs() / (1.0 + expected.abs());
                        assert!(error < 1e-8, "{i} {which:?} {k} {j}: {error}");
                        seen += 1;
                    }
                }
            }
        }
        assert!(seen > 20_000, "{seen}");
    }

    /// Both constraints vanish where a direction is scattered, from either side of glass; refraction ends on the other side,
    /// with the sines that Snell's law gives, and back again.
    #[test]
    fn scattered_directions_are_roots() {
        for i in 0..1000 {
            let mut s = Independent::new(2, 0, i);
            let n = warp::square_to_sphere(s.next_2d::<f64>());
            let w = warp::square_to_sphere(s.next_2d::<f64>());
            let facet = Facet { n, eta: 1.5 };
            let frame = equator(Vec3::new(0.3, -0.2, 0.9));
            for kind in [DeltaKind::Reflection, DeltaKind::Transmission] {
                let Some(next) = scatter(kind, w, n, 1.5) else {
                    assert!(w.dot(n) < 0.0 && kind == DeltaKind::Transmission);
                    continue;
                };
                let crosses = w.dot(n) * next.dot(n) < 0.0;
                assert_eq!(crosses, kind == DeltaKind::Transmission);
                let back = scatter(kind, next, n, 1.5).expect("the way it came");
                assert!((back - w).length() < 1e-10);
                for which in [Constraint::Angle, Constraint::HalfVector] {
                    let c = value(which, kind, w, next, &facet, &frame).expect("a value");
                    assert!(c.iter().all(|c| c.abs() < 1e-9), "{which:?} {kind:?} {c:?}");
                }
            }
        }
    }

    /// Beyond the critical angle the constraint looks from the thinner medium, and is zero at an exact refraction alone
    /// (errata Z-A.3, F17); both ways at once is no configuration.
    #[test]
    fn total_reflection_falls_back() {
        let n = Vec3::new(0.0, 0.0, 1.0);
        let facet = Facet { n, eta: 1.5 };
        let frame = equator(n);
        let inside = |angle: f64| Vec3::new(angle.sin(), 0.0, -angle.cos());
        let outside = Vec3::new(-0.6, 0.0, 0.8);
        let kind = DeltaKind::Transmission;
        assert!(refract(inside(0.8), n, 1.5).is_none());
        let c = value(
            Constraint::Angle,
            kind,
            inside(0.8),
            outside,
            &facet,
            &frame,
        )
        .expect("a value");
        // The direction that it wants is asin(0.4) off the normal.
        let off = c[0].hypot(c[1]);
        assert!((off - (0.8 - 0.4f64.asin())).abs() < 1e-12, "{c:?}");
        let root = inside(0.4f64.asin());
        let c = value(Constraint::Angle, kind, root, outside, &facet, &frame).expect("a value");
        assert!(c[0].abs() < 1e-12 && c[1].abs() < 1e-12);
        let both = value(
            Constraint::Angle,
            kind,
            inside(0.8),
            inside(-0.9),
            &facet,
            &frame,
        );
        assert!(both.is_none());
    }

    /// Azimuths of 3.1 and -3.1 are 0.083 apart, not 6.2 (F18).
    #[test]
    fn azimuths_wrap_around() {
        let n = Vec3::new(0.0, 0.0, 1.0);
        let frame = Frame {
            s: Vec3::new(1.0, 0.0, 0.0),
            t: Vec3::new(0.0, 1.0, 0.0),
            n,
        };
        let at = |phi: f64| Vec3::new(phi.cos(), phi.sin(), 0.0);
        let [_, turn] = difference(at(3.1), at(-3.1), &frame);
        assert!(
            (turn + 2.0 * PI - 6.2).abs() < 1e-12 && turn.abs() < 0.084,
            "{turn}"
        );
        let [_, turn] = difference(at(-3.1), at(3.1), &frame);
        assert!((turn - (2.0 * PI - 6.2)).abs() < 1e-12, "{turn}");
    }

    /// Half vectors do not tell which side of a surface directions are on; angles do (F20).
    #[test]
    fn only_half_vectors_have_roots_behind_the_surface() {
        let n = Vec3::new(0.0, 0.0, 1.0);
        let facet = Facet { n, eta: 1.5 };
        // The half vector of refraction is parallel to the normal, and both directions are on one side.
        let w = Vec3::new(0.6, 0.0, 0.8);
        let next = Vec3::new(-0.6, 0.0, 0.8);
        let kind = DeltaKind::Transmission;
        let frame = equator(Vec3::new(1.0, 0.0, 0.0));
        let half = value(Constraint::HalfVector, kind, w, next, &facet, &frame).expect("a value");
        assert!(half[0].abs() < 1e-12 && half[1].abs() < 1e-12);
        let angle = value(Constraint::Angle, kind, w, next, &facet, &frame).expect("a value");
        assert!(angle[0].hypot(angle[1]) > 0.5, "{angle:?}");
    }
}
