//! The cube.

use ad_core::{Float, Real, Vec3};

use super::{
    Partials, Patch, Shape, ShapeSample, SurfaceCoordinates, SurfaceInteraction, misplaced,
};
use crate::accel::{Hit, Primitive};
use crate::error::SceneError;
use crate::math::{Ray, Transform};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};

/// `uv = (0, 0)`, `(1, 0)` and `(0, 1)` of the six faces, as Mitsuba 3 numbers them.
const FACES: [[[f64; 3]; 3]; 6] = [
    [[-1.0, -1.0, -1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, -1.0]],
    [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, -1.0]],
    [[1.0, -1.0, 1.0], [1.0, 1.0, 1.0], [1.0, -1.0, -1.0]],
    [[-1.0, -1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, -1.0, 1.0]],
    [[-1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]],
    [[-1.0, 1.0, -1.0], [-1.0, -1.0, -1.0], [1.0, 1.0, -1.0]],
];

/// The cube [-1, 1]^3 under an affine transform. Every face has `uv` in [0, 1]^2 and its own flat
/// normal, outward unless flipped.
#[derive(Clone, Debug)]
pub struct Cube {
    faces: Box<[Patch; 6]>,
    area: f64,
}

impl Cube {
    /// From the transform of [-1, 1]^3. `None` if a face has no area, or one that is not finite.
    pub fn new(to_world: &Transform, flip_normals: bool) -> Option<Self> {
        let mirrored = to_world.determinant() < 0.0;
        let face = |[corner, along_u, along_v]: [[f64; 3]; 3]| {
            let edge = |to: [f64; 3]| to_world.vector([0, 1, 2].map(|i| to[i] - corner[i]));
            // The table lists u and v such that their cross product points inward.
            let flip = !(flip_normals ^ mirrored);
            Patch::new(to_world.point(corner), edge(along_u), edge(along_v), flip)
        };
        Self::of(FACES.map(face))
    }

    fn of([a, b, c, d, e, f]: [Option<Patch>; 6]) -> Option<Self> {
        let faces = Box::new([a?, b?, c?, d?, e?, f?]);
        let area: f64 = faces.iter().map(Patch::area).sum();
        area.is_finite().then_some(Self { faces, area })
    }

    /// Its six faces.
    pub(crate) fn faces(&self) -> &[Patch; 6] {
        &self.faces
    }
}

impl Shape for Cube {
    fn primitives(&self) -> Vec<Primitive> {
        self.faces.iter().map(Patch::primitive).collect()
    }

    #[inline(always)]
    fn interaction<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        ray: &Ray<R>,
        hit: &Hit,
    ) -> SurfaceInteraction<R> {
        self.faces[prim as usize].interaction(ray, hit)
    }

    fn coordinates<P: Float>(
        &self,
        prim: u32,
        si: &SurfaceInteraction<P>,
    ) -> SurfaceCoordinates<P> {
        self.faces[prim as usize].coordinates(si)
    }

    fn locate<P: Float>(&self, prim: u32, p: Vec3<P>) -> SurfaceCoordinates<P> {
        self.faces[prim as usize].locate(p)
    }

    fn point_at<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> SurfaceInteraction<R> {
        self.faces[prim as usize].point_at(at)
    }

    fn partials<R: Real>(
        &self,
        _theta: &Theta<R>,
        prim: u32,
        at: SurfaceCoordinates<R>,
    ) -> Option<Partials<R>> {
        Some(self.faces[prim as usize].partials(at))
    }

    fn area_element<R: Real>(&self, _theta: &Theta<R>, prim: u32) -> R {
        self.faces[prim as usize].area_element()
    }

    fn patch(&self, prim: u32) -> Option<&Patch> {
        self.faces.get(prim as usize)
    }

    fn centroid(&self) -> [f64; 3] {
        let [a, b, ..] = &*self.faces;
        // The first two are opposite.
        let [a, b] = [a, b].map(|f| Vec3::from(f.centroid()));
        ((a + b) * 0.5).to_array()
    }

    fn placed(&self, by: &Transform) -> Result<Self, String> {
        let faces = [0, 1, 2, 3, 4, 5].map(|i| self.faces[i].placed(by));
        Self::of(faces).ok_or_else(misplaced)
    }

    fn area(&self) -> f64 {
        self.area
    }

    fn sample_area<R: Real>(&self, _theta: &Theta<R>, u: [R::Primal; 2]) -> ShapeSample<R> {
        let mut rest = u[0].to_f64() * self.area;
        let (mut face, mut prim) = (&self.faces[0], 0);
        for (f, k) in self.faces.iter().zip(0..) {
            (face, prim) = (f, k);
            if rest < f.area() {
                break;
            }
            rest -= f.area();
        }
        let reused = R::Primal::of((rest / face.area()).clamp(0.0, 1.0));
        ShapeSample {
            pdf: R::Primal::of(1.0 / self.area),
            prim,
            ..face.sample_area([reused, u[1]])
        }
    }

    fn border<R: Real>(&self, prim: u32, ray: &Ray<R>) -> R {
        self.faces[prim as usize].border(ray)
    }

    fn extent(&self) -> f32 {
        self.faces.iter().fold(0.0, |m, f| m.max(f.extent()))
    }
}

impl FromNode for Cube {
    const PLUGINS: &'static [&'static str] = &["cube"];

    fn from_node(node: &Node, _registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let flip = node.boolean_or("flip_normals", false)?;
        Self::new(&to_world, flip).ok_or_else(|| {
            node.invalid(
                "to_world",
                "a transform that leaves finite faces of non-zero area",
            )
        })
    }
}
