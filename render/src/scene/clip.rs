//! Clip distances of scene files. Nothing is clipped here; files that ask for it are accepted where that
//! shows no difference.

use ad_core::{Const, Vec3};

use super::Scene;
use crate::accel;
use crate::error::SceneError;
use crate::math::{Ray, each};
use crate::plugin::Node;
use crate::shape::Shape;

/// Between which depths the camera of a scene file sees surfaces. Depth is measured along the viewing
/// direction.
pub(super) struct Clip {
    near: Option<f64>,
    far: Option<f64>,
}

/// Rays are traced through so many points of the film per axis.
const GRID: u32 = 64;
/// Rounding of depths, relative.
const ROUNDING: f64 = 1e-4;

impl Clip {
    pub(super) fn from_node(node: &Node) -> Result<Self, SceneError> {
        let distance = |key: &str| match node.float(key)? {
            Some(x) if x <= 0.0 => Err(node.invalid(key, "a positive number")),
            other => Ok(other),
        };
        let (near, far) = (distance("near_clip")?, distance("far_clip")?);
        if let (Some(near), Some(far)) = (near, far)
            && near >= far
        {
            let expected = format!("a number above `near_clip`, {near}");
            return Err(node.invalid("far_clip", &expected));
        }
        Ok(Self { near, far })
    }

    /// Warns where surfaces may be clipped.
    ///
    /// # Errors
    /// A surface in sight would be.
    pub(super) fn check(&self, node: &Node, scene: &Scene) -> Result<(), SceneError> {
        if self.near.is_none() && self.far.is_none() {
            return Ok(());
        }
        let view = View::of(scene);
        if let Some(seen) = view.depths_in_sight(scene) {
            if let Some(near) = self.near
                && seen[0] < near * (1.0 - ROUNDING)
            {
                return Err(unclipped(node, "near_clip", "most", seen[0]));
            }
            if let Some(far) = self.far
                && seen[1] > far * (1.0 + ROUNDING)
            {
                return Err(unclipped(node, "far_clip", "least", seen[1]));
            }
        }
        // Rays may have passed between things; boxes around them miss nothing.
        let boxes = || {
            let primitives = scene.shapes().iter().flat_map(Shape::primitives);
            primitives.map(|p| accel::bounds(&p).map(|corner| each(corner, f64::from)))
        };
        if let Some(near) = self.near {
            let [low, high] = view.box_before(scene, near);
            let meets = |b: [[f64; 3]; 2]| (0..3).all(|k| b[0][k] <= high[k] && low[k] <= b[1][k]);
            if boxes().any(meets) {
                node.warn(format!(
                    "`near_clip` is not applied: something may be nearer than {near}, and would be seen"
                ));
            }
        }
        if let Some(far) = self.far {
            let deepest = boxes().map(|b| view.deepest(b)).fold(0.0, f64::max);
            if deepest > far * (1.0 + ROUNDING) {
                node.warn(format!(
                    "`far_clip` is not applied: something may be as far as {deepest:.6}, and would be seen"
                ));
            }
        }
        Ok(())
    }
}

fn unclipped(node: &Node, key: &str, bound: &str, depth: f64) -> SceneError {
    let expected =
        format!("at {bound} {depth:.6}, the depth of a surface in sight (nothing is clipped)");
    node.invalid(key, &expected)
}

/// Where a camera is, and which way depth grows.
struct View {
    origin: Vec3<f64>,
    forward: Vec3<f64>,
}

impl View {
    fn of(scene: &Scene) -> Self {
        let at = |x, y| scene.camera.direction(x, y);
        let corner = at(0.0, 0.0);
        let normal = (at(1.0, 0.0) - corner)
            .cross(at(0.0, 1.0) - corner)
            .normalize();
        let forward = if normal.dot(corner) < 0.0 {
            -normal
        } else {
            normal
        };
        Self {
            origin: scene.camera.origin().into(),
            forward,
        }
    }

    /// Least and largest depth of what a grid of camera rays meets.
    fn depths_in_sight(&self, scene: &Scene) -> Option<[f64; 2]> {
        let points = |axis: usize| {
            let (from, size) = (scene.film.crop_offset[axis], scene.film.crop_size[axis]);
            let n = size.min(GRID);
            (0..n).map(move |i| {
                f64::from(from) + (f64::from(i) + 0.5) * f64::from(size) / f64::from(n)
            })
        };
        let hidden = scene.settings.hides(1);
        let mut found: Option<[f64; 2]> = None;
        for y in points(1) {
            for x in points(0) {
                let ray = scene.camera.ray(x, y);
                if let Some(hit) = scene.seen(&ray, hidden) {
                    let depth = f64::from(hit.t) * ray.d.dot(self.forward);
                    let [low, high] = found.unwrap_or([depth; 2]);
                    found = Some([low.min(depth), high.max(depth)]);
                }
            }
        }
        found
    }

    /// Corners of a box around all that is in sight at less than this depth.
    fn box_before(&self, scene: &Scene, depth: f64) -> [[f64; 3]; 2] {
        let mut corners = [self.origin.to_array(); 2];
        let [xs, ys] = scene.film.reach();
        for (x, y) in [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| (xs[i], ys[j])) {
            let Ray { o, d, .. } = scene.camera.ray::<f64>(x, y);
            for p in [o, o + d * Const(depth / d.dot(self.forward))] {
                let p = p.to_array();
                corners[0] = [0, 1, 2].map(|k: usize| corners[0][k].min(p[k]));
                corners[1] = [0, 1, 2].map(|k: usize| corners[1][k].max(p[k]));
            }
        }
        corners
    }

    /// Depth of the farthest corner of a box.
    fn deepest(&self, [low, high]: [[f64; 3]; 2]) -> f64 {
        let forward = self.forward.to_array();
        let farthest = [0, 1, 2].map(|k: usize| if forward[k] < 0.0 { low[k] } else { high[k] });
        (Vec3::from(farthest) - self.origin).dot(self.forward)
    }
}
