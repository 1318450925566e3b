//! Where paths start.

use ad_core::{Float, Vec3};

use super::Wave;
use super::lanes::{Field, Lane, WAVE_SIZE, whole};
use super::numbers::draw_units;
use crate::camera::{Camera, ThinLens};
use crate::math::{NOWHERE, Rgb};
use crate::sampler::{Purpose, Sampler, Stream};
use crate::scene::Scene;

impl<P: Float, X: Sampler> Wave<P, X> {
    /// Camera rays through these pixels, by the numbers of [`Purpose::Pixel`] or [`Purpose::Lens`], as single paths start.
    #[inline(never)]
    pub(super) fn look_from(&mut self, scene: &Scene, pixels: &[[u32; 2]; WAVE_SIZE]) {
        let camera = &scene.camera;
        let [mut x, mut y, mut u, mut v] = [Lane::<P>::zero(); 4];
        let n = whole(self.n);
        let first = match camera.thin_lens() {
            Some(_) => Purpose::Lens.at(1),
            None => Purpose::Pixel.at(1),
        };
        draw_units(
            self.points,
            n,
            &self.paths,
            first,
            [&mut x, &mut y, &mut u, &mut v],
        );
        for i in 0..self.n {
            [x[i], y[i]] = scene.film.point_in(pixels[i], [x[i], y[i]]);
        }
        if let Some(lens) = camera.thin_lens() {
            self.look_through(camera, lens, [&x, &y, &u, &v]);
            return;
        }
        self.look(camera, &x, &y);
        if !camera.is_pinhole() {
            for i in 0..self.n {
                let ray = camera.ray(x[i], y[i]);
                self.paths.o.put_vec(i, ray.o);
                self.paths.d.put_vec(i, ray.d);
            }
        }
    }

    /// Camera rays through these points of the image and these places of the lens.
    #[inline(never)]
    fn look_through(&mut self, camera: &Camera, lens: &ThinLens, [x, y, u, v]: [&Lane<P>; 4]) {
        self.put_rays(
            |i| camera.through(lens, x[i], y[i], [u[i], v[i]]),
            |i| camera.ray_through(x[i], y[i], [u[i], v[i]]).d,
        );
    }

    /// Camera rays through these points of the image.
    #[inline(never)]
    fn look(&mut self, camera: &Camera, x: &Lane<P>, y: &Lane<P>) {
        let origin = camera.origin().map(P::of).into();
        self.put_rays(
            |i| (origin, camera.direction(x[i], y[i])),
            |i| camera.ray(x[i], y[i]).d,
        );
    }

    /// Paths from a point in a direction of any length; in the other one, of unit length, where that cannot be normalised
    /// without a branch.
    #[inline(always)]
    fn put_rays(
        &mut self,
        from: impl Fn(usize) -> (Vec3<P>, Vec3<P>),
        otherwise: impl Fn(usize) -> Vec3<P>,
    ) {
        let paths = &mut self.paths;
        let mut right = Lane::<u32>::zero();
        for i in 0..whole(self.n) {
            let (o, to) = from(i);
            let (d, is_right) = to.unit();
            paths.o.put_vec(i, o);
            paths.d.put_vec(i, d);
            paths.surface[i] = NOWHERE;
            right[i] = u32::from(is_right);
        }
        for i in 0..self.n {
            if right[i] == 0 {
                paths.d.put_vec(i, otherwise(i));
            }
        }
    }

    /// Path number `id` starts somewhere, as the `i`-th.
    #[inline(always)]
    pub(super) fn start(&mut self, i: usize, id: usize, sampler: &X) {
        let paths = &mut self.paths;
        (paths.id[i], paths.slot[i]) = (id as u32, i as u32);
        let Stream { points, key, index } = sampler.stream();
        self.points = points;
        (paths.key[i], paths.index[i]) = (key, index);
        paths.beta.put_rgb(i, Rgb::splat(P::one()));
        paths.l.put_rgb(i, Rgb::black());
        (paths.eta[i], paths.roulette_weight[i]) = (P::one(), P::one());
        paths.pdf[i] = P::zero();
        (
            paths.active[i],
            paths.caustics_excluded[i],
            paths.caustic[i],
        ) = (0, 0, 0);
    }
}
