//! How a material's value changes with both directions and the texture coordinates.

use ad_core::{Dual, Float, Vec2, Vec3};

use crate::bsdf::{Bsdf, Component, Material, Shading};
use crate::integrator::record::Place;
use crate::integrator::vertex::MODE;
use crate::math::{Frame, Rgb};
use crate::params::Theta;

/// The slopes of a sum over the channels of a material's value.
pub(in crate::integrator) struct Slopes<P> {
    pub wo: Vec3<P>,
    pub wi: Vec3<P>,
    pub uv: Vec2<P>,
}

/// Two unit vectors at right angles to a unit vector and each other.
pub(in crate::integrator) fn across<P: Float>(d: Vec3<P>) -> [Vec3<P>; 2] {
    let frame = Frame::from_normal(d);
    [frame.s, frame.t]
}

/// `d` as it varies across itself, by the tangents `first` and the next.
pub(in crate::integrator) fn varied<P: Float, const N: usize>(
    d: Vec3<P>,
    first: usize,
) -> Vec3<Dual<P, N>> {
    let [a, b] = across(d);
    let var = |k| Dual::<P, N>::var(P::zero(), k);
    Vec3::lift(d) + Vec3::lift(a) * var(first) + Vec3::lift(b) * var(first + 1)
}

/// The slope of a sum over channels, along tangent `k`.
pub(in crate::integrator) fn slope<P: Float, const N: usize>(
    value: &Rgb<Dual<P, N>>,
    a: Rgb<P>,
    k: usize,
) -> P {
    value.r.eps[k] * a.r + value.g.eps[k] * a.g + value.b.eps[k] * a.b
}

/// The slopes of `a . f` at a vertex.
pub(in crate::integrator) fn slopes<P: Float, const N: usize>(
    material: &Material,
    theta: &Theta<P>,
    place: &Place<P>,
    wi: Vec3<P>,
    component: Component,
    a: Rgb<P>,
) -> Slopes<P> {
    let mut uv = Vec2::lift(place.si.uv);
    if N > 4 {
        uv.x += Dual::var(P::zero(), 4);
        uv.y += Dual::var(P::zero(), 5);
    }
    let at = Shading::new(theta.lift::<Dual<P, N>>(), uv);
    let (o, i) = (varied(place.wo, 0), varied(wi, 2));
    let f = material.eval_component(&at, o, i, component, MODE);
    let along = |d: Vec3<P>, first: usize| {
        let [s, t] = across(d);
        s * slope(&f, a, first) + t * slope(&f, a, first + 1)
    };
    let texture = |k: usize| {
        if N > 4 { slope(&f, a, k) } else { P::zero() }
    };
    Slopes {
        wo: along(place.wo, 0),
        wi: along(wi, 2),
        uv: Vec2::new(texture(4), texture(5)),
    }
}
