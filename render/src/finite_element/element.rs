//! Elements: quadtrees over the flat parallelograms of a scene.

use ad_core::{Vec2, Vec3};

use super::FiniteElementError;
use super::basis::Directions;
use crate::accel::{Hit, Primitive};
use crate::bsdf::Material;
use crate::emitter::{AnyEmitter, Emitter};
use crate::math::{Frame, Ray};
use crate::params::Theta;
use crate::scene::Scene;
use crate::shape::{AnyShape, Shape};
use crate::texture::Texture;

/// What a tree of elements does with light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// It reflects, with the table of this index.
    Surface(usize),
    /// It emits, as the emitter of this index says, and takes no light.
    Lamp(u32),
}

/// One side of a parallelogram. A lamp is a tree of its own in front of the surface it lies on, so that
/// emission keeps its exact lobe and does not go through the directional basis.
#[derive(Clone, Debug)]
pub struct Root {
    /// Index of the shape.
    pub shape: u32,
    /// Corner at surface coordinates (0, 0), world space.
    pub corner: Vec3<f64>,
    /// Edges along u and v.
    pub edges: [Vec3<f64>; 2],
    /// Unit normal of this side.
    pub normal: Vec3<f64>,
    /// Shading frame of the front side.
    pub frame: Frame<f64>,
    /// Area, world space.
    pub area: f64,
    /// Index of the primitive in the scene.
    pub prim: u32,
    /// What it does with light.
    pub kind: Kind,
    /// Directional basis.
    pub directions: Directions,
    /// Exponent of the cosine lobe of a lamp.
    pub exponent: f64,
}

impl Root {
    /// The point at surface coordinates.
    pub fn point(&self, u: f64, v: f64) -> Vec3<f64> {
        self.corner + self.edges[0] * u + self.edges[1] * v
    }

    /// Surface coordinates of a point in the plane.
    pub fn coordinates(&self, p: Vec3<f64>) -> Vec2<f64> {
        let [a, b] = self.edges;
        let d = p - self.corner;
        let (aa, ab, bb) = (a.dot(a), a.dot(b), b.dot(b));
        let (da, db) = (d.dot(a), d.dot(b));
        let det = aa * bb - ab * ab;
        Vec2::new((da * bb - db * ab) / det, (db * aa - da * ab) / det)
    }
}

/// A node of a quadtree.
#[derive(Clone, Copy, Debug)]
pub struct Element {
    /// Its tree.
    pub root: u32,
    /// The element it is a quarter of.
    pub parent: Option<u32>,
    /// The first of its four quarters, which follow each other.
    pub children: Option<u32>,
    /// Smallest surface coordinates.
    pub at: [f64; 2],
    /// Side in surface coordinates.
    pub size: f64,
    /// Area, world space.
    pub area: f64,
}

/// All elements; parents come before their children.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// Trees.
    pub roots: Vec<Root>,
    /// Elements; the first ones are the whole trees, in the same order.
    pub elements: Vec<Element>,
    /// Where the directional values of an element begin; one more entry than elements.
    pub start: Vec<usize>,
}

impl Mesh {
    fn push(&mut self, e: Element) {
        let nodes = self.roots[e.root as usize].directions.len();
        self.elements.push(e);
        self.start.push(self.values() + nodes);
    }

    /// Number of values of a field over all elements and directions.
    pub fn values(&self) -> usize {
        self.start.last().copied().unwrap_or(0)
    }

    /// The tree of an element.
    pub fn root(&self, e: u32) -> &Root {
        &self.roots[self.elements[e as usize].root as usize]
    }

    /// The point of an element at local coordinates in [0, 1].
    pub fn point(&self, e: u32, u: f64, v: f64) -> Vec3<f64> {
        let el = &self.elements[e as usize];
        self.root(e)
            .point(el.at[0] + u * el.size, el.at[1] + v * el.size)
    }

    /// Quarters an element, unless that has happened; the first of the four.
    pub fn subdivide(&mut self, e: u32) -> u32 {
        let el = self.elements[e as usize];
        if let Some(first) = el.children {
            return first;
        }
        let first = self.elements.len() as u32;
        let half = 0.5 * el.size;
        for k in 0..4u32 {
            let offset = [f64::from(k & 1) * half, f64::from(k >> 1) * half];
            self.push(Element {
                root: el.root,
                parent: Some(e),
                children: None,
                at: [el.at[0] + offset[0], el.at[1] + offset[1]],
                size: half,
                area: 0.25 * el.area,
            });
        }
        self.elements[e as usize].children = Some(first);
        first
    }

    /// The smallest element at surface coordinates of a tree.
    pub fn leaf(&self, root: u32, u: f64, v: f64) -> u32 {
        let mut e = root;
        while let Some(first) = self.elements[e as usize].children {
            let el = &self.elements[e as usize];
            let half = 0.5 * el.size;
            let right = u32::from(u >= el.at[0] + half);
            let up = u32::from(v >= el.at[1] + half);
            e = first + right + 2 * up;
        }
        e
    }
}

/// The reflecting side of a shape: material, whether it is seen from behind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// Index of a shape with this material.
    pub shape: u32,
    /// Index of the material.
    pub material: u32,
    /// Whether it is the back.
    pub behind: bool,
    /// Whether it reflects the same radiance in all directions.
    pub diffuse: bool,
}

/// The trees of a scene and the different sides they reflect with.
pub(super) fn mesh(scene: &Scene, side: usize) -> Result<(Mesh, Vec<Side>), FiniteElementError> {
    let mut roots = Vec::new();
    let mut sides: Vec<Side> = Vec::new();
    for (index, emitter) in scene.emitters().iter().enumerate() {
        let AnyEmitter::Area(_) = emitter else {
            return Err(FiniteElementError::Emitter {
                index,
                reason: "only area lights emit from elements",
            });
        };
        constant(emitter.radiance()).ok_or(FiniteElementError::Emitter {
            index,
            reason: "its radiance must be constant",
        })?;
    }
    for (shape, geometry) in scene.shapes().iter().enumerate() {
        let info = scene.shape_info(shape as u32);
        let unsupported = |reason| FiniteElementError::Shape {
            name: info.name.clone(),
            reason,
        };
        let mut faces = vec![(false, side_is_diffuse(scene.material(shape as u32)))];
        if let Material::TwoSided(m) = scene.material(shape as u32) {
            let sides = m.sides().iter().zip([false, true]);
            faces = sides
                .map(|(m, behind)| (behind, side_is_diffuse(m)))
                .collect();
        }
        for (prim, primitive) in geometry.primitives().into_iter().enumerate() {
            let Primitive::Parallelogram { v0, e1, e2 } = primitive else {
                return Err(unsupported("elements are flat parallelograms"));
            };
            let wide = |v: [f32; 3]| Vec3::from(v.map(f64::from));
            let (corner, edges) = (wide(v0), [wide(e1), wide(e2)]);
            let area = edges[0].cross(edges[1]).length();
            if !(area > 0.0 && area.is_finite()) {
                return Err(unsupported("an element needs an area"));
            }
            let frame = shading_frame(geometry, prim as u32, corner + (edges[0] + edges[1]) * 0.5);
            let mut root = Root {
                shape: shape as u32,
                corner,
                edges,
                normal: frame.n,
                frame,
                area,
                prim: scene.primitive(shape as u32, prim as u32),
                kind: Kind::Surface(0),
                directions: Directions { side: 1 },
                exponent: 0.0,
            };
            for &(behind, diffuse) in &faces {
                let diffuse = diffuse.map_err(unsupported)?;
                let found = sides
                    .iter()
                    .position(|s| (s.material, s.behind) == (info.material, behind));
                let table = found.unwrap_or_else(|| {
                    sides.push(Side {
                        shape: shape as u32,
                        material: info.material,
                        behind,
                        diffuse,
                    });
                    sides.len() - 1
                });
                root.normal = if behind { -frame.n } else { frame.n };
                root.kind = Kind::Surface(table);
                root.directions = Directions {
                    side: if diffuse { 1 } else { side },
                };
                roots.push(root.clone());
            }
            if let Some(e) = info.emitter {
                root.normal = frame.n;
                root.kind = Kind::Lamp(e);
                root.directions = Directions { side: 1 };
                if let AnyEmitter::Area(a) = &scene.emitters()[e as usize] {
                    root.exponent = f64::from(a.exponent);
                }
                roots.push(root);
            }
        }
    }
    let mut mesh = Mesh {
        roots: Vec::new(),
        elements: Vec::new(),
        start: vec![0],
    };
    for (i, root) in roots.iter().enumerate() {
        mesh.roots.push(root.clone());
        mesh.push(Element {
            root: i as u32,
            parent: None,
            children: None,
            at: [0.0; 2],
            size: 1.0,
            area: root.area,
        });
    }
    Ok((mesh, sides))
}

fn shading_frame(shape: &AnyShape, prim: u32, centre: Vec3<f64>) -> Frame<f64> {
    let hit = Hit {
        t: 1.0,
        u: 0.5,
        v: 0.5,
        prim,
    };
    // The frame of a flat face does not depend on the ray, even if that is parallel to it.
    let ray = |d: Vec3<f64>| Ray::new(centre - d, d);
    shape
        .interaction(&Theta::still(), prim, &ray(Vec3::new(1.0, 0.0, 0.0)), &hit)
        .frame
}

/// Whether one side of a material is diffuse; or why it is not supported.
fn side_is_diffuse(m: &Material) -> Result<bool, &'static str> {
    let textured = "its parameters must be constant over the surface";
    match m {
        Material::Diffuse(d) => constant(&d.reflectance).map(|()| true).ok_or(textured),
        Material::RoughConductor(c) => constant(&c.roughness.alpha)
            .and(constant(&c.conductor.specular_reflectance))
            .map(|()| false)
            .ok_or(textured),
        // The sides are looked at one by one.
        Material::TwoSided(_) => Err("two-sided materials cannot be nested"),
        Material::BlinnPhong(_) => Err("Blinn-Phong as normals are sampled is not reciprocal"),
        _ => Err("only diffuse and rough conductor, and both two-sided, are supported"),
    }
}

fn constant<const C: usize>(t: &Texture<C>) -> Option<()> {
    matches!(t, Texture::Constant(_)).then_some(())
}
