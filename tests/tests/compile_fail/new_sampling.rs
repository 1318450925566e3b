//! A new way of sampling is not unbiased until somebody says so.

use ad_core::{Dual, Real, Vec3};
use render::bsdf::{Bsdf, Material, Scattered, Shading, TransportMode};
use render::estimator::memory::Forget;
use render::estimator::{BsdfOnly, Sampling};
use render::integrator::render::render;
use render::params::Theta;
use render::sampler::Independent;

struct Mine;

impl Sampling for Mine {
    type Geometry<R: Real> = R::Primal;
    const DETACHED_PATH: bool = true;
    type Edge = Forget;

    fn geometry<'a, R: Real>(theta: &Theta<'a, R>) -> Theta<'a, R::Primal> {
        theta.primal()
    }

    fn embed<R: Real>(g: R::Primal) -> R {
        R::lift(g)
    }

    fn scatter<R: Real>(
        material: &Material,
        at: &Shading<R>,
        wo: Vec3<R::Primal>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R::Primal, R>> {
        material.scatter(at, wo, u, mode)
    }
}

fn main() {
    let _ = render::<Dual<f32, 1>, BsdfOnly<Mine>, Independent>;
}
