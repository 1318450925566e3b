//! Which edges shapes have, and what meets there.
//!
//! Faces are neighbours where their corners are at the same place, whatever their normals and texture coordinates are: a
//! seam of those is no border.

use std::collections::HashMap;

use ad_core::Vec3;
use smallvec::SmallVec;

use super::turn::Turn;
use super::{BEYOND_SEAM, Curve, CurveKind, Edge, Face, INSIDE, MIDDLE, single};
use crate::accel::SEAM;
use crate::params::Theta;
use crate::shape::{AnyShape, Mesh, Patch, Shape, SurfaceCoordinates, SurfaceInteraction, lift3};

/// Two faces whose directions into them differ by less than this from opposite ones are one plane; half the square of an
/// angle.
const FLAT: f64 = 1e-9;
/// Faces are as good as lines whose width, over their largest coordinate, is at most this: several roundings of an f32.
const NEEDLE: f64 = 8.0 * f32::EPSILON as f64;
/// Normals, and texture coordinates, that differ by less are the same.
const SAME: f32 = 1e-4;

/// A face before its neighbours are known.
struct Polygon {
    local: u32,
    corners: SmallVec<[Corner; 4]>,
}

#[derive(Clone, Copy)]
struct Corner {
    at: [f32; 3],
    /// Corners at the same place have the same number.
    welded: u32,
    /// Index among the vertices of a mesh.
    vertex: u32,
}

/// The edges of all shapes.
#[derive(Debug, Default)]
pub(super) struct Topology {
    pub straight: Vec<Edge>,
    /// Directions into the third and further faces of an edge.
    pub more: HashMap<u32, Vec<[f32; 3]>>,
    pub curves: Vec<Curve>,
    /// Faces whose normals are not theirs.
    pub turns: Vec<Turn>,
}

/// Unit vectors of texture space that say where the corners of a face are.
pub(super) fn corner(sides: usize, k: usize) -> [f64; 2] {
    const TRIANGLE: [[f64; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    const PATCH: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    if sides == 3 {
        TRIANGLE[k % 3]
    } else {
        PATCH[k % 4]
    }
}

impl Topology {
    pub fn of(shapes: &[AnyShape]) -> Self {
        let mut all = Self::default();
        for (shape, i) in shapes.iter().zip(0..) {
            match shape {
                AnyShape::Mesh(mesh) => all.mesh(i, mesh),
                // Edges are asked for where they are.
                AnyShape::Instance(instance) => all.mesh(i, &instance.copied()),
                AnyShape::Rectangle(_) | AnyShape::Cube(_) => all.patches(i, shape),
                AnyShape::Sphere(sphere) => {
                    let radius = f64::from(sphere.radius());
                    all.curves.push(Curve {
                        shape: i,
                        kind: CurveKind::Ball,
                        origin: lift3(sphere.center()),
                        axes: [Vec3::zero(); 2],
                        into: Vec3::zero(),
                        radius,
                    });
                }
                AnyShape::Disk(_) => {
                    let origin = place(shape, 0.0, 0.0);
                    let axes = [
                        place(shape, 1.0, 0.0) - origin,
                        place(shape, 0.0, 1.0) - origin,
                    ];
                    let radius = axes[0].length().max(axes[1].length());
                    let kind = CurveKind::Disk;
                    all.curves.push(Curve {
                        shape: i,
                        kind,
                        origin,
                        axes,
                        into: Vec3::zero(),
                        radius,
                    });
                }
                AnyShape::Cylinder(_) => all.cylinder(i, shape),
                // Who asks for edges is refused where there are curves.
                AnyShape::Curves(_) => {}
            }
        }
        all
    }

    fn cylinder(&mut self, index: u32, shape: &AnyShape) {
        let [origin, axis, first] = tube(shape);
        let across = [first, place(shape, 0.25, 0.0) - origin];
        let radius = across[0].length();
        let tube = |kind| Curve {
            shape: index,
            kind,
            origin,
            axes: [axis, Vec3::zero()],
            into: Vec3::zero(),
            radius,
        };
        self.curves
            .extend([0, 1].map(|side| tube(CurveKind::Tube(side))));
        for top in [false, true] {
            self.curves.push(Curve {
                shape: index,
                kind: CurveKind::End(top),
                origin: if top { origin + axis } else { origin },
                axes: across,
                into: if top { -axis } else { axis },
                radius,
            });
        }
    }

    fn mesh(&mut self, index: u32, mesh: &Mesh) {
        let data = mesh.data();
        let welding = mesh.welding();
        let polygon = |(t, local): (&[u32; 3], u32)| Polygon {
            local,
            corners: (t.iter())
                .map(|&vertex| Corner {
                    at: data.positions[vertex as usize],
                    welded: welding.points[vertex as usize],
                    vertex,
                })
                .collect(),
        };
        let polygons: Vec<Polygon> = data.triangles.iter().zip(0..).map(polygon).collect();
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > SAME);
        let unit = |v: u32| {
            let n = lift3::<f32>(data.normals[v as usize]);
            n.normalize().to_array()
        };
        let flat = |v: u32| data.normals.is_empty() || data.normals[v as usize] == [0.0; 3];
        let jumps = |bent: bool, a: u32, b: u32| {
            let facets = flat(a) || flat(b);
            let normals = if facets {
                bent
            } else {
                a != b && apart(&unit(a), &unit(b))
            };
            let seam = a != b
                && !data.uvs.is_empty()
                && apart(&data.uvs[a as usize], &data.uvs[b as usize]);
            normals || seam
        };
        self.join(index, &polygons, jumps);
        if data.normals.is_empty() {
            return;
        }
        for (t, local) in data.triangles.iter().zip(0..) {
            let corners = t.map(|v| data.positions[v as usize]);
            let normals = t.map(|v| data.normals[v as usize]);
            let [a, b, c] = corners.map(lift3::<f64>);
            let across = (b - a).cross(c - a);
            let tilted = |n: &[f32; 3]| {
                let n = lift3::<f64>(*n);
                n.cross(across).length_squared()
                    > f64::from(SAME * SAME) * n.length_squared() * across.length_squared()
            };
            if across.length_squared() > 0.0 && normals.iter().any(tilted) {
                self.turns.push(Turn {
                    shape: index,
                    local,
                    corners,
                    normals,
                });
            }
        }
    }

    fn patches(&mut self, index: u32, shape: &AnyShape) {
        let mut polygons: Vec<Polygon> = Vec::new();
        let mut known: Vec<[f32; 3]> = Vec::new();
        let near = shape.extent() * 1e-5;
        for local in 0..shape.primitives().len() as u32 {
            let Some(Patch { corner, e1, e2, .. }) = shape.patch(local) else {
                continue;
            };
            let at = |u: f32, v: f32| [0, 1, 2].map(|k: usize| corner[k] + u * e1[k] + v * e2[k]);
            let corners = [at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
            let corners = corners.map(|at| {
                // Corners of several faces are the same but for rounding.
                let same = |p: &[f32; 3]| (0..3).all(|k| (p[k] - at[k]).abs() <= near);
                let welded = known.iter().position(same).unwrap_or_else(|| {
                    known.push(at);
                    known.len() - 1
                }) as u32;
                Corner {
                    at,
                    welded,
                    vertex: welded,
                }
            });
            polygons.push(Polygon {
                local,
                corners: corners.into(),
            });
        }
        self.join(index, &polygons, |bent, _, _| bent);
    }

    /// Finds neighbours. `jumps`: whether what is seen jumps at a vertex of two faces, given whether there is an angle
    /// between them.
    fn join(&mut self, shape: u32, polygons: &[Polygon], jumps: impl Fn(bool, u32, u32) -> bool) {
        let mut sides: Vec<([u32; 2], u32, u8)> = Vec::new();
        for (polygon, i) in polygons.iter().zip(0..) {
            let n = polygon.corners.len();
            if is_needle(&polygon.corners) {
                continue;
            }
            for k in 0..n {
                let [a, b] = [k, (k + 1) % n].map(|k| polygon.corners[k].welded);
                if a != b {
                    sides.push(([a.min(b), a.max(b)], i, k as u8));
                }
            }
        }
        sides.sort_unstable();
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            let end_points = |(_, polygon, side): ([u32; 2], u32, u8)| {
                let corners = &polygons[polygon as usize].corners;
                let [a, b] = [side as usize, (side as usize + 1) % corners.len()];
                [corners[a], corners[b]]
            };
            let [a, b] = end_points(group[0]);
            let (start, along) = (lift3::<f64>(a.at), lift3::<f64>(b.at) - lift3::<f64>(a.at));
            if along.length_squared() == 0.0 {
                continue;
            }
            let along = along.normalize();
            // At right angles to the edge, up to the middle.
            let across = |polygon: u32| {
                let corners = &polygons[polygon as usize].corners;
                let sum = corners
                    .iter()
                    .fold(Vec3::zero(), |s, c| s + lift3::<f64>(c.at));
                let to = sum * (corners.len() as f64).recip() - start;
                to - along * along.dot(to)
            };
            let into = |polygon: u32| across(polygon).normalize();
            let inside = |polygon: u32| {
                let corners = polygons[polygon as usize].corners.iter();
                let size = corners.map(|c| lift3::<f64>(c.at)).map(|p| {
                    let largest = p
                        .to_array()
                        .into_iter()
                        .fold(0.0, |m: f64, x| m.max(x.abs()));
                    largest.max((p - start).length())
                });
                let beyond = BEYOND_SEAM * size.fold(0.0, f64::max);
                (beyond / across(polygon).length()).clamp(INSIDE, MIDDLE) as f32
            };
            let face = |&(_, polygon, side): &([u32; 2], u32, u8)| Face {
                local: polygons[polygon as usize].local,
                side,
                sides: polygons[polygon as usize].corners.len() as u8,
                reversed: end_points((group[0].0, polygon, side))[0].welded != a.welded,
                inside: inside(polygon),
            };
            let seam = |&(_, polygon, side): &([u32; 2], u32, u8)| {
                seam(&polygons[polygon as usize].corners, side)
            };
            let m = into(group[0].1);
            let mut edge = Edge {
                shape,
                end_points: [a.at, b.at],
                into: [single(m), [0.0; 3]],
                faces: [face(&group[0]); 2],
                border: group.len() == 1,
                jump: 0.0,
                seam: group.iter().map(seam).fold(0.0, f64::max) as f32,
            };
            if let [_, other, ..] = group {
                let m2 = into(other.1);
                edge.into[1] = single(m2);
                edge.faces[1] = face(other);
                let bent = group.len() > 2 || m.dot(m2) + 1.0 > FLAT;
                let [mut c, mut d] = end_points(*other);
                if edge.faces[1].reversed {
                    (c, d) = (d, c);
                }
                let jumps = jumps(bent, a.vertex, c.vertex) || jumps(bent, b.vertex, d.vertex);
                if jumps || group.len() > 2 {
                    edge.jump = 1.0;
                } else if bent {
                    edge.jump = (2.0 * (m.dot(m2) + 1.0)).sqrt().min(1.0) as f32;
                }
                if !bent && !jumps {
                    continue;
                }
            }
            if group.len() > 2 {
                let rest = group[2..].iter().map(|side| single(into(side.1))).collect();
                self.more.insert(self.straight.len() as u32, rest);
            }
            self.straight.push(edge);
        }
    }
}

/// How far beyond one of its sides a face is met by rays that come from nearby, with some more for rounding. Triangles are
/// met in coordinates along two of their sides, whose seams add up beyond the third one.
fn seam(corners: &[Corner], side: u8) -> f64 {
    let n = corners.len();
    let [a, b, c] = [0, 1, n - 1].map(|k| lift3::<f64>(corners[k].at));
    let both = (b - a).length() + (c - a).length();
    let third = if n == 3 && side == 1 {
        both / (c - b).length()
    } else {
        1.0
    };
    1.5 * f64::from(SEAM) * (a.max_abs() + both) * third
}

/// Whether a face is no wider than its corners are rounded: rays hardly meet it, and its plane is chance.
fn is_needle(corners: &[Corner]) -> bool {
    let [a, b, c] = [0, 1, 2].map(|k| lift3::<f64>(corners[k].at));
    let largest = |of: [f64; 3]| of.into_iter().fold(0.0, f64::max);
    let rounding = NEEDLE * largest([a, b, c].map(|p| p.max_abs()));
    let longest = largest([b - a, c - b, a - c].map(|side| side.length()));
    (b - a).cross(c - a).length() <= rounding * longest
}

/// Foot and axis of a tube, and from the foot to its rim.
pub(super) fn tube(shape: &AnyShape) -> [Vec3<f64>; 3] {
    let [a, b] = [0.0, 0.5].map(|turn| place(shape, turn, 0.0));
    let origin = (a + b) * 0.5;
    [origin, place(shape, 0.0, 1.0) - a, a - origin]
}

/// A point of a shape with one primitive.
pub(super) fn place(shape: &AnyShape, u: f64, v: f64) -> Vec3<f64> {
    let at = SurfaceCoordinates(ad_core::Vec2::new(u, v));
    let si: SurfaceInteraction<f64> = shape.point_at(&Theta::still(), 0, at);
    si.p
}
