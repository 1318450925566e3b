//! Points drawn on meshes that emit.

use ad_core::{Float, Vec3};

use super::faces::Corners;
use super::lanes::{Field, Lane, WAVE_SIZE, whole};
use crate::math::warp;
use crate::scene::Scene;
use crate::shape::{Mesh, Shape, ShapeSample, SurfaceCoordinates};

/// Triangles that were chosen, and points on them.
pub struct FacesOfLamps<P> {
    /// Made when there are any.
    corners: Option<Box<Corners<P>>>,
    surface: Lane<u32>,
    right: Lane<u32>,
    /// Where in its part of all areas the number is that chose the triangle.
    reused: Lane<P>,
    /// Density per area.
    pdf: P,
}

impl<P: Float> FacesOfLamps<P> {
    /// None.
    pub fn new() -> Self {
        Self {
            corners: None,
            surface: Lane::zero(),
            right: Lane::zero(),
            reused: Lane::zero(),
            pdf: P::zero(),
        }
    }

    /// The surface that the `k`-th point lies on.
    #[inline(always)]
    pub fn surface(&self, k: usize) -> u32 {
        self.surface[k]
    }

    /// Points on a mesh, made of two random numbers each: triangles are chosen and looked up one by one.
    #[inline(never)]
    pub fn draw(
        &mut self,
        scene: &Scene,
        (mesh, shape): (&Mesh, u32),
        n: usize,
        [a, b]: [&Lane<P>; 2],
    ) {
        self.right = [1; WAVE_SIZE];
        self.pdf = P::of(1.0 / mesh.area());
        let corners = &mut **(self.corners).get_or_insert_with(|| Box::new(Corners::zero()));
        let mut chosen = [0; WAVE_SIZE];
        for k in 0..n.min(WAVE_SIZE) {
            (chosen[k], self.reused[k]) = mesh.draw_triangle(a[k]);
            mesh.fetch(chosen[k]);
        }
        for k in 0..n.min(WAVE_SIZE) {
            corners.put(k, &mesh.triangle(chosen[k]));
            corners.met[k] = 1;
            self.surface[k] = scene.lights().surface(shape, chosen[k]);
        }
        for k in 0..whole(n) {
            corners.put_place(k, warp::square_to_triangle([self.reused[k], b[k]]));
        }
        corners.find_normals(n, &mut self.right);
    }

    /// The `k`-th point, the normal of its triangle, and whether they are right.
    #[inline(always)]
    pub fn sample(&self, corners: &Corners<P>, k: usize) -> (ShapeSample<P>, Vec3<P>, bool) {
        let (p, [n, _], uv, right) = corners.point(k);
        let sample = ShapeSample {
            p,
            n,
            uv,
            pdf: self.pdf,
            prim: 0,
            coordinates: SurfaceCoordinates(uv),
        };
        (sample, corners.flat_normal(k), right & (self.right[k] != 0))
    }

    /// What the points are on, once there have been any.
    #[inline(always)]
    pub fn corners(&self) -> Option<&Corners<P>> {
        self.corners.as_deref()
    }
}
