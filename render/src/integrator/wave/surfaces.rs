//! What lies where paths have hit something: shapes of one kind at once.

use ad_core::Float;

use super::balls::Balls;
use super::faces::Faces;
use super::lanes::{Field, Lane, WAVE_SIZE};
use super::state::{Paths, Vertices};
use crate::accel::Hit;
use crate::scene::{HitSurface, Scene};
use crate::shape::hit_is_exact;

/// Surfaces that paths have met, path by path.
pub struct Surfaces<P> {
    faces: Faces<P>,
    balls: Balls<P>,
    /// Whether the place of the path has been found.
    right: Lane<u32>,
}

impl<P: Float> Surfaces<P> {
    /// Of no path.
    pub fn new() -> Self {
        Self {
            faces: Faces::new(),
            balls: Balls::new(),
            right: Lane::zero(),
        }
    }

    /// Whether the place of path `i` has been found.
    #[inline(always)]
    pub fn have(&self, i: usize) -> bool {
        self.right[i] != 0
    }

    /// Finds the places of all paths that have hit a triangle of a mesh or a sphere.
    #[inline(always)]
    pub fn find(
        &mut self,
        scene: &Scene,
        paths: &Paths<P>,
        hits: &[Option<Hit>],
        at: &mut Vertices<P>,
    ) {
        self.right = Lane::zero();
        // Where hits are not exact, the point is found anew, from the ray.
        if hit_is_exact::<P>() && !scene.has_patches_only() {
            self.look(scene, paths, hits, at);
        }
    }

    #[inline(never)]
    fn look(
        &mut self,
        scene: &Scene,
        paths: &Paths<P>,
        hits: &[Option<Hit>],
        at: &mut Vertices<P>,
    ) {
        for (i, hit) in hits.iter().enumerate().take(WAVE_SIZE) {
            let Some(hit) = hit else {
                continue;
            };
            match scene.surface(hit) {
                HitSurface::Mesh(mesh, local) => self.faces.put(i, &mesh.triangle(local), hit),
                HitSurface::Sphere(sphere) => self.balls.put(i, sphere, hit),
                HitSurface::Other => continue,
            }
            self.right[i] = 1;
        }
        self.faces.find(hits.len(), &mut self.right, at);
        (self.balls).find(hits.len(), paths, &mut self.right, at);
    }
}
