//! Which normals scatter at the vertices of chains: those of surfaces, of facets, or of surfaces without their normal maps.

use ad_core::{Real, Vec3};

use super::space::Space;
use crate::bsdf::nesting::facets;
use crate::bsdf::{Bsdf, Material, Shading, TransportMode};
use crate::math::{Frame, warp};

/// The normal that scatters at a vertex. The unit vectors are the same wherever a walk takes the vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Normal {
    /// That of the surface, normal maps included.
    Own,
    /// That of a facet of a rough surface: a unit vector in the frame of the surface's own normal.
    Facet(Vec3<f64>),
    /// A unit vector in the shading frame, without normal maps: for the first of two stages.
    Smoothed(Vec3<f64>),
}

impl Normal {
    /// The vector itself, local to the shading frame; `mapped` is the frame with normal maps.
    pub(super) fn vector<R: Real<Primal = f64>>(
        self,
        mapped: impl FnOnce() -> Frame<R>,
    ) -> Vec3<R> {
        match self {
            Self::Own => mapped().n,
            Self::Facet(m) => mapped().to_world(m.map(R::of)),
            Self::Smoothed(m) => Vec3::lift(m),
        }
    }
}

/// The Gaussian of the slopes of a normal map: of tangent over normal component, in the shading frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slopes {
    /// Their mean.
    pub mean: [f64; 2],
    /// Lower triangle of a matrix whose square is their covariance: entries 00, 10, 11.
    pub root: [f64; 3],
}

/// Slopes are looked up at so many points in each direction of the surface coordinates.
const LOOK_UPS: usize = 128;

/// Whether a normal map is read.
pub(super) fn is_mapped(material: &Material) -> bool {
    match material {
        Material::NormalMap(_) => true,
        Material::TwoSided(m) => m.sides().iter().any(|side| is_mapped(side)),
        _ => false,
    }
}

impl Slopes {
    /// Of what a caster's material reads over surface coordinates in [0, 1], seen from the front. `None` without a map, or of
    /// what is no caster.
    pub fn of(space: &Space, shape: u32) -> Option<Self> {
        let material = space.scene.material(shape);
        if facets(material).is_none() || !is_mapped(material) {
            return None;
        }
        let at = |k: usize| (k as f64 + 0.5) / LOOK_UPS as f64;
        let (mut n, mut sums) = (0.0, [0.0; 5]);
        for i in 0..LOOK_UPS * LOOK_UPS {
            let uv = ad_core::Vec2::new(at(i % LOOK_UPS), at(i / LOOK_UPS));
            let theta = space.theta;
            let up = Vec3::new(0.0, 0.0, 1.0);
            let mode = TransportMode::Radiance;
            let normal = (material.shading_frame(&Shading::new(theta, uv), up, 0, mode)).n;
            let (x, y) = (normal.x / normal.z, normal.y / normal.z);
            if normal.z > 0.0 && x.is_finite() && y.is_finite() {
                n += 1.0;
                let terms = [x, y, x * x, x * y, y * y];
                sums.iter_mut().zip(terms).for_each(|(s, t)| *s += t);
            }
        }
        if n == 0.0 {
            return None;
        }
        let [x, y, xx, xy, yy] = sums.map(|s| s / n);
        // Rounding may leave less than nothing.
        let a = (xx - x * x).max(0.0).sqrt();
        let b = if a > 0.0 { (xy - x * y) / a } else { 0.0 };
        let c = (yy - y * y - b * b).max(0.0).sqrt();
        Some(Self {
            mean: [x, y],
            root: [a, b, c],
        })
    }

    /// A normal, by two numbers in [0, 1).
    pub fn draw(&self, [u, v]: [f64; 2]) -> Normal {
        let r = (-2.0 * (-u).ln_1p()).sqrt();
        let (sin, cos) = warp::sin_cos_of_turns(v);
        let ([x, y], [a, b, c]) = (self.mean, self.root);
        let (p, q) = (r * cos, r * sin);
        let slope = Vec3::new(x + a * p, y + b * p + c * q, 1.0);
        Normal::Smoothed(slope.normalize())
    }
}

/// The facet of a shape that two numbers draw; its own normal where it is smooth.
pub(super) fn facet(space: &Space, shape: u32, u: [f64; 2]) -> Normal {
    let roughness = facets(space.scene.material(shape)).and_then(|f| f.roughness);
    roughness.map_or(Normal::Own, |r| {
        Normal::Facet(r.everywhere(&space.theta).sample_all(u))
    })
}
