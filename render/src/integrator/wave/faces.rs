//! Where paths meet triangles of meshes, at once.

use ad_core::{Float, Vec2, Vec3};

use super::lanes::{Field, Lane, Lanes, lanes, whole};
use super::state::Vertices;
use crate::accel::Hit;
use crate::math::Frame;
use crate::shape::{SurfaceInLine, SurfaceInteraction, Triangle};

lanes! {
    /// What triangles are made of, and where a point on them is.
    Corners {
        v0: Lanes<P>,
        e1: Lanes<P>,
        e2: Lanes<P>,
        /// Normals at the corners.
        n0: Lanes<P>,
        n1: Lanes<P>,
        n2: Lanes<P>,
        /// Texture coordinates there, one axis after the other.
        u0: Lane<f32>,
        u1: Lane<f32>,
        u2: Lane<f32>,
        v0_uv: Lane<f32>,
        v1_uv: Lane<f32>,
        v2_uv: Lane<f32>,
        /// Whether there are such normals.
        smooth: Lane<u32>,
        /// Whether there are such coordinates.
        mapped: Lane<u32>,
        /// Whether the surface is turned around.
        flip: Lane<u32>,
        /// Whether the path has met one.
        met: Lane<u32>,
        /// Barycentric coordinates.
        u: Lane<P>,
        v: Lane<P>,
        /// Normal of the face.
        flat: Lanes<P>,
        /// Direction of increasing u.
        dp_du: Lanes<P>,
    }
}

/// Triangles that paths have met, path by path.
pub struct Faces<P> {
    corners: Box<Corners<P>>,
    any: bool,
}

impl<P: Float> Faces<P> {
    /// Of no path.
    pub fn new() -> Self {
        Self {
            corners: Box::new(Corners::zero()),
            any: false,
        }
    }

    /// Path `i` has met a triangle.
    #[inline(always)]
    pub fn put(&mut self, i: usize, triangle: &Triangle, hit: &Hit) {
        self.corners.put(i, triangle);
        self.corners.met[i] = 1;
        let place = Vec2::new(P::from_f32(hit.u), P::from_f32(hit.v));
        self.corners.put_place(i, place);
        self.any = true;
    }

    /// Finds the places of those of the first `n` paths that have met triangles. `right` stays where they are right.
    pub fn find(&mut self, n: usize, right: &mut Lane<u32>, at: &mut Vertices<P>) {
        if std::mem::take(&mut self.any) {
            self.corners.find_normals(n, right);
            self.corners.find_tangents(n, right);
            self.corners.find_frames(n, right, at);
            self.corners.met = Lane::zero();
        }
    }
}

impl<P: Float> Corners<P> {
    /// The `i`-th is this triangle.
    #[inline(always)]
    pub fn put(&mut self, i: usize, triangle: &Triangle) {
        let vec = |x: [f32; 3]| Vec3::new(P::from_f32(x[0]), P::from_f32(x[1]), P::from_f32(x[2]));
        let [e1, e2] = triangle.edges;
        self.v0.put_vec(i, vec(triangle.v0));
        self.e1.put_vec(i, vec(e1));
        self.e2.put_vec(i, vec(e2));
        self.smooth[i] = u32::from(triangle.normals.is_some());
        if let Some([a, b, c]) = triangle.normals {
            self.n0.put_vec(i, vec(a));
            self.n1.put_vec(i, vec(b));
            self.n2.put_vec(i, vec(c));
        }
        self.mapped[i] = u32::from(triangle.uvs.is_some());
        if let Some([a, b, c]) = triangle.uvs {
            (self.u0[i], self.u1[i], self.u2[i]) = (a[0], b[0], c[0]);
            (self.v0_uv[i], self.v1_uv[i], self.v2_uv[i]) = (a[1], b[1], c[1]);
        }
        self.flip[i] = u32::from(triangle.flip);
    }

    /// The coordinates of the point on the `i`-th.
    #[inline(always)]
    pub fn put_place(&mut self, i: usize, at: Vec2<P>) {
        (self.u[i], self.v[i]) = (at.x, at.y);
    }

    /// The normal of the `i`-th, without regard to sides.
    #[inline(always)]
    pub fn flat_normal(&self, i: usize) -> Vec3<P> {
        self.flat.vec(i)
    }

    /// The point on the `i`-th: where it is, both normals and texture coordinates, and whether these are right.
    #[inline(always)]
    pub fn point(&self, i: usize) -> (Vec3<P>, [Vec3<P>; 2], Vec2<P>, bool) {
        let (u, v) = (self.u[i], self.v[i]);
        let bary = [P::one() - u - v, u, v];
        let corners = [self.n0.vec(i), self.n1.vec(i), self.n2.vec(i)];
        let (smooth, flip) = (self.smooth[i] != 0, self.flip[i] != 0);
        let (normals, right) =
            SurfaceInLine::normals(bary, self.flat.vec(i), corners, (smooth, flip));
        let [a, b, c] = [self.u0[i], self.u1[i], self.u2[i]];
        let [a, b, c] = [P::from_f32(a), P::from_f32(b), P::from_f32(c)];
        let x = a * bary[0] + b * u + c * v;
        let [a, b, c] = [self.v0_uv[i], self.v1_uv[i], self.v2_uv[i]];
        let [a, b, c] = [P::from_f32(a), P::from_f32(b), P::from_f32(c)];
        let y = a * bary[0] + b * u + c * v;
        let mapped = self.mapped[i] != 0;
        let uv = Vec2::new(P::select(mapped, x, u), P::select(mapped, y, v));
        let p = self.v0.vec(i) + self.e1.vec(i) * u + self.e2.vec(i) * v;
        (p, normals, uv, right)
    }

    #[inline(always)]
    fn edges(&self, i: usize) -> [Vec3<f64>; 2] {
        [self.e1.vec(i).map(P::to_f64), self.e2.vec(i).map(P::to_f64)]
    }

    #[inline(always)]
    fn uvs(&self, i: usize) -> [[f32; 2]; 3] {
        [
            [self.u0[i], self.v0_uv[i]],
            [self.u1[i], self.v1_uv[i]],
            [self.u2[i], self.v2_uv[i]],
        ]
    }

    /// The normals of the first `n`, and where these are `right`.
    #[inline(never)]
    pub fn find_normals(&mut self, n: usize, right: &mut Lane<u32>) {
        for i in 0..whole(n) {
            let [e1, e2] = self.edges(i);
            let (flat, is_right) = SurfaceInLine::flat_normal(e1, e2);
            self.flat.put_vec(i, flat.map(P::of));
            right[i] &= u32::from(is_right | (self.met[i] == 0));
        }
    }

    #[inline(never)]
    fn find_tangents(&mut self, n: usize, right: &mut Lane<u32>) {
        for i in 0..whole(n) {
            let mapped = self.mapped[i] != 0;
            let (dp_du, is_right) = SurfaceInLine::dp_du(self.edges(i), self.uvs(i), mapped);
            self.dp_du.put_vec(i, dp_du.map(P::of));
            right[i] &= u32::from(is_right | (self.met[i] == 0));
        }
    }

    #[inline(never)]
    fn find_frames(&self, n: usize, right: &mut Lane<u32>, at: &mut Vertices<P>) {
        for i in 0..whole(n) {
            let (p, [n, n_geo], uv, normal_is_right) = self.point(i);
            let (frame, frame_is_right) = Frame::in_line(n, self.dp_du.vec(i));
            let si = SurfaceInteraction {
                p,
                t: P::zero(),
                n_geo,
                frame,
                uv,
            };
            let met = self.met[i] != 0;
            at.put_if(met, i, &si);
            right[i] &= u32::from((normal_is_right & frame_is_right) | !met);
        }
    }
}
