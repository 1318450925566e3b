//! Rays that know how they change across the image.

use ad_core::{Dual, Vec3};

use super::Camera;
use super::lens::Lens;
use crate::math::Ray;

/// A number with its derivatives in x and y of the image, per pixel.
pub type PerPixel = Dual<f64, 2>;

fn vector(v: [f64; 3]) -> Vec3<PerPixel> {
    Vec3::from(v.map(PerPixel::constant))
}

impl Camera {
    /// [`Camera::ray_through`] with its derivatives in the point of the image [Igehy 1999]; the place on the lens stays.
    pub fn ray_differential(&self, [x, y]: [f64; 2], u: [f64; 2]) -> Ray<PerPixel> {
        let (x, y) = (PerPixel::var(x, 0), PerPixel::var(y, 1));
        let origin = vector(self.origin);
        let d = vector(self.dx) * x + vector(self.dy) * y + vector(self.corner);
        match &self.lens {
            None => Ray::new(origin, d.normalize()),
            Some(Lens::Parallel { direction }) => Ray::new(
                origin + d - vector(self.forward),
                vector(*direction).normalize(),
            ),
            Some(Lens::Thin(lens)) => {
                let off = vector(lens.off(u).to_array());
                let depth = d.dot(vector(lens.forward));
                let to = d * (PerPixel::constant(lens.focus) / depth) - off;
                Ray::new(origin + off, to.normalize())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::FovAxis;
    use crate::math::Transform;

    /// Values are those of rays without derivatives, and derivatives central differences, for every kind of camera.
    #[test]
    fn derivatives_are_differences() {
        let to_world = Transform::look_at([1.0, 2.0, 3.0], [0.3, -0.2, 0.1], [0.1, 1.0, 0.0]);
        let to_world = to_world.unwrap();
        let pinhole = Camera::new(to_world, 50.0, FovAxis::X, [40, 30]).unwrap();
        let lens = pinhole.clone().with_lens(&to_world, 0.3, 2.5).unwrap();
        let parallel = Camera::orthographic(to_world, [40, 30]).unwrap();
        for camera in [pinhole, lens, parallel] {
            let (at, u, h) = ([13.2, 7.9], [0.3, 0.8], 1e-4);
            let found = camera.ray_differential(at, u);
            let value = camera.ray_through::<f64>(at[0], at[1], u);
            assert!((found.o.map(|x| x.re) - value.o).length() < 1e-12);
            assert!((found.d.map(|x| x.re) - value.d).length() < 1e-12);
            for k in 0..2 {
                let moved = |h: f64| {
                    let mut at = at;
                    at[k] += h;
                    camera.ray_through::<f64>(at[0], at[1], u)
                };
                let (a, b) = (moved(h), moved(-h));
                let scale = 0.5 / h;
                let o = (a.o - b.o) * scale - found.o.map(|x| x.eps[k]);
                let d = (a.d - b.d) * scale - found.d.map(|x| x.eps[k]);
                assert!(o.length() < 1e-8 && d.length() < 1e-8, "{o:?} {d:?}");
            }
        }
    }
}
