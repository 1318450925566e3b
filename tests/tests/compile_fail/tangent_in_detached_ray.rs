//! A detached path has no place for the tangent of a ray.

use ad_core::Dual;
use render::estimator::{DetachedMis, Geometry};
use render::math::{Ray, Vec3};

fn main() {
    let moving = Vec3::<Dual<f32, 1>>::zero();
    let _: Ray<Geometry<DetachedMis, Dual<f32, 1>>> = Ray::new(moving, moving);
}
