//! Where paths meet spheres, at once.

use ad_core::{Float, Vec2};

use super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::state::{Paths, Vertices};
use crate::accel::Hit;
use crate::math::Ray;
use crate::shape::{Sphere, SphereNumbers};

lanes! {
    /// What the spheres are made of, and where they are hit.
    Numbers {
        center: Lanes<P>,
        radius: Lane<P>,
        /// Their own axes.
        x: Lanes<P>,
        y: Lanes<P>,
        z: Lanes<P>,
        /// Whether normals point inward.
        flip: Lane<u32>,
        /// Whether texture coordinates are asked for.
        mapped: Lane<u32>,
        /// Whether the path has met one.
        met: Lane<u32>,
        /// How far away.
        distance: Lane<P>,
    }
}

/// Spheres that paths have met, path by path.
pub struct Balls<P> {
    numbers: Box<Numbers<P>>,
    any: bool,
    any_mapped: bool,
}

impl<P: Float> Balls<P> {
    /// Of no path.
    pub fn new() -> Self {
        Self {
            numbers: Box::new(Numbers::zero()),
            any: false,
            any_mapped: false,
        }
    }

    /// Path `i` has met a sphere.
    #[inline(always)]
    pub fn put(&mut self, i: usize, sphere: &Sphere, hit: &Hit) {
        let numbers = &mut *self.numbers;
        let SphereNumbers {
            center,
            radius,
            axes: [x, y, z],
            flip,
        } = sphere.ball();
        numbers.center.put_vec(i, center);
        numbers.radius[i] = radius;
        numbers.x.put_vec(i, x);
        numbers.y.put_vec(i, y);
        numbers.z.put_vec(i, z);
        numbers.flip[i] = u32::from(flip);
        numbers.mapped[i] = u32::from(sphere.is_mapped());
        numbers.met[i] = 1;
        numbers.distance[i] = P::from_f32(hit.t);
        self.any = true;
        self.any_mapped |= sphere.is_mapped();
    }

    /// Finds the places of those of the first `n` paths that have met spheres. `right` stays where they are right.
    pub fn find(
        &mut self,
        n: usize,
        paths: &Paths<P>,
        right: &mut Lane<u32>,
        at: &mut Vertices<P>,
    ) {
        if std::mem::take(&mut self.any) {
            self.numbers.find_places(n, paths, right, at);
            if std::mem::take(&mut self.any_mapped) {
                self.numbers.find_coordinates(n, at);
            }
            self.numbers.met = Lane::zero();
        }
    }
}

impl<P: Float> Numbers<P> {
    #[inline(always)]
    fn ball(&self, i: usize) -> SphereNumbers<P> {
        SphereNumbers {
            center: self.center.vec(i),
            radius: self.radius[i],
            axes: [self.x.vec(i), self.y.vec(i), self.z.vec(i)],
            flip: self.flip[i] != 0,
        }
    }

    #[inline(never)]
    fn find_places(&self, n: usize, paths: &Paths<P>, right: &mut Lane<u32>, at: &mut Vertices<P>) {
        for i in 0..whole(n) {
            let met = self.met[i] != 0;
            let ray = Ray::new(paths.o.vec(i), paths.d.vec(i));
            let (si, is_right) = self.ball(i).interaction_in_line(&ray, self.distance[i]);
            at.put_if(met, i, &si);
            right[i] &= u32::from(is_right | !met);
        }
    }

    #[inline(never)]
    fn find_coordinates(&self, n: usize, at: &mut Vertices<P>) {
        for i in 0..whole(n) {
            let mapped = (self.met[i] != 0) & (self.mapped[i] != 0);
            let ball = self.ball(i);
            let Vec2 { x, y } = ball.uv(ball.side(at.n.vec(i)));
            at.u[i] = P::select(mapped, x, at.u[i]);
            at.v[i] = P::select(mapped, y, at.v[i]);
        }
    }
}
