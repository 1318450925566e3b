//! Finds the lines along which surfaces cross.
//!
//! Which side of a plane a corner is on is decided once for every corner and plane, so that the lines of neighbours meet: a
//! corner nearer than rounding may be off is on the plane. A side of a face that lies on a plane is a line if the faces that
//! it belongs to are on different sides of that; if they are on one side, one surface only stands on the other. Two sides in
//! one place are no line, whatever is around them.

use std::collections::HashMap;

use ad_core::Vec3;
use smallvec::{SmallVec, smallvec};

use super::boxes::{self, Box3};
use super::contact::{self, Doubt, Touch};
use super::flat::{Chord, Flat, FlatKind, LEAST_SINE};
use super::round::Round;
use super::{Line, LineSide, Path, normal};
use crate::camera::Pupil;
use crate::edges::topology::{place, tube};
use crate::shape::{AnyShape, Mesh, Patch, Shape, lift3};

/// How near surfaces touch without crossing: relative to the largest coordinate of the smaller shape, and of the larger
/// one.
const TOUCHING: [f64; 2] = [4e-6, 4e-7];

/// All surfaces, one by one.
struct Sheets<'a> {
    shapes: &'a [AnyShape],
    /// Meshes of instances, in the world.
    copies: HashMap<u32, Mesh>,
    /// Shape, and its primitive.
    all: Vec<(u32, u32)>,
}

/// What a surface is.
enum Sheet {
    Flat(Flat),
    Round(Round),
    /// Nothing that rays meet.
    Nothing,
}

/// A side of a face that lies on a plane.
struct Half {
    line: Line,
    end_points: [Vec3<f64>; 2],
    /// A point of the face beside it.
    inner: Vec3<f64>,
}

/// What is found of a pair.
enum Found {
    Line(Line),
    Half(Half),
    Touch(Touch),
    Doubt(Doubt, [LineSide; 2]),
}

/// What is found of all.
pub(super) struct All {
    pub lines: Vec<Line>,
    pub touches: Vec<Touch>,
    /// Pairs of shapes, sorted.
    pub doubts: Vec<(Doubt, [u32; 2])>,
}

impl<'a> Sheets<'a> {
    fn of(shapes: &'a [AnyShape]) -> (Self, Vec<Box3>) {
        let mut sheets = Self {
            shapes,
            copies: HashMap::new(),
            all: Vec::new(),
        };
        let mut boxes = Vec::new();
        for (shape, i) in shapes.iter().zip(0..) {
            let copy = match shape {
                AnyShape::Instance(instance) => Some(instance.copied()),
                _ => None,
            };
            let primitives = match &copy {
                Some(mesh) => mesh.primitives(),
                None => shape.primitives(),
            };
            for (primitive, local) in primitives.iter().zip(0..) {
                sheets.all.push((i, local));
                boxes.push(crate::accel::bounds(primitive));
            }
            if let Some(mesh) = copy {
                sheets.copies.insert(i, mesh);
            }
        }
        (sheets, boxes)
    }

    /// The corners of a triangle of a mesh.
    fn triangle(&self, shape: u32, local: u32) -> Option<[[f32; 3]; 3]> {
        let mesh = match &self.shapes[shape as usize] {
            AnyShape::Mesh(mesh) => mesh,
            AnyShape::Instance(_) => self.copies.get(&shape)?,
            _ => return None,
        };
        let data = mesh.data();
        Some(data.triangles[local as usize].map(|v| data.positions[v as usize]))
    }

    fn sheet(&self, (shape, local): (u32, u32)) -> Sheet {
        if let Some(corners) = self.triangle(shape, local) {
            return polygon(SmallVec::from_slice(&corners.map(lift3::<f64>)));
        }
        let of = &self.shapes[shape as usize];
        match of {
            AnyShape::Rectangle(_) | AnyShape::Cube(_) => {
                of.patch(local)
                    .map_or(Sheet::Nothing, |Patch { corner, e1, e2, .. }| {
                        let [p, e1, e2] = [*corner, *e1, *e2].map(lift3::<f64>);
                        polygon(smallvec![p, p + e1, p + e1 + e2, p + e2])
                    })
            }
            AnyShape::Sphere(s) => Sheet::Round(Round {
                origin: lift3(s.center()),
                axis: None,
                radius: f64::from(s.radius()),
            }),
            AnyShape::Cylinder(_) => {
                let [origin, axis, across] = tube(of);
                Sheet::Round(Round {
                    origin,
                    axis: Some(axis),
                    radius: across.length(),
                })
            }
            AnyShape::Disk(_) => {
                let at = |u, v| place(of, u, v);
                let centre = at(0.0, 0.0);
                let [a, b] = [at(1.0, 0.0) - centre, at(0.0, 1.0) - centre];
                Sheet::Flat(Flat {
                    normal: a.cross(b).normalize(),
                    kind: FlatKind::Oval([centre, a, b]),
                })
            }
            AnyShape::Mesh(_) | AnyShape::Instance(_) | AnyShape::Curves(_) => Sheet::Nothing,
        }
    }

    /// Whether two surfaces of one shape have nothing in common but a side, or are parts of what is convex.
    fn beside(&self, a: (u32, u32), b: (u32, u32)) -> bool {
        let [Some(p), Some(q)] = [a, b].map(|(shape, local)| self.triangle(shape, local)) else {
            return true;
        };
        p.iter().filter(|corner| q.contains(corner)).count() > 1
    }

    fn touching(&self, a: u32, b: u32) -> f64 {
        let [a, b] = [a, b].map(|i| f64::from(self.shapes[i as usize].extent()));
        TOUCHING[0] * a.min(b) + TOUCHING[1] * a.max(b)
    }

    /// Lines along which two surfaces cross.
    fn cross(&self, a: (u32, u32), b: (u32, u32), found: &mut Vec<Found>) {
        if a.0 == b.0 && self.beside(a, b) {
            return;
        }
        let near = self.touching(a.0, b.0);
        let parts = [a, b].map(|(shape, local)| LineSide {
            shape,
            locals: [local; 2],
        });
        let round = |paths: SmallVec<[Path; 2]>| {
            paths
                .into_iter()
                .map(|path| Found::Line(Line { sides: parts, path }))
        };
        match [a, b].map(|i| self.sheet(i)) {
            [Sheet::Flat(x), Sheet::Flat(y)] => flats([&x, &y], parts, near, found),
            [Sheet::Flat(flat), Sheet::Round(of)] | [Sheet::Round(of), Sheet::Flat(flat)] => {
                found.extend(round(of.cut(&flat, near)));
            }
            [Sheet::Round(x), Sheet::Round(y)] => found.extend(round(x.meets(&y, near))),
            [Sheet::Nothing, _] | [_, Sheet::Nothing] => {}
        }
    }
}

/// The first shape, of those for which `wanted` holds, that crosses the surface on which rays of a camera begin.
pub(crate) fn cut_by(
    pupil: Pupil,
    shapes: &[AnyShape],
    wanted: impl Fn(u32) -> bool,
) -> Option<u32> {
    let (corners, sheet): (SmallVec<[Vec3<f64>; 4]>, _) = match pupil {
        Pupil::Rectangle(corners) => (corners.into(), polygon(corners.into())),
        Pupil::Disk([middle, a, b]) => (
            smallvec![
                middle - a - b,
                middle + a - b,
                middle + a + b,
                middle - a + b
            ],
            Sheet::Flat(Flat {
                normal: a.cross(b).normalize(),
                kind: FlatKind::Oval([middle, a, b]),
            }),
        ),
    };
    let Sheet::Flat(window) = sheet else {
        return None;
    };
    let apart = |[low, high]: Box3| {
        (0..3).any(|k| {
            let all = || corners.iter().map(|p| p.to_array()[k]);
            all().all(|x| x < f64::from(low[k])) || all().all(|x| x > f64::from(high[k]))
        })
    };
    let (sheets, boxes) = Sheets::of(shapes);
    let cut = |&(&(shape, local), _): &(&(u32, u32), Box3)| {
        let near = sheets.touching(shape, shape);
        match sheets.sheet((shape, local)) {
            Sheet::Flat(flat) => {
                let parts = [shape, u32::MAX].map(|shape| LineSide {
                    shape,
                    locals: [local; 2],
                });
                let mut found = Vec::new();
                flats([&flat, &window], parts, near, &mut found);
                (found.iter()).any(|found| matches!(found, Found::Line(_) | Found::Half(_)))
            }
            Sheet::Round(round) => !round.cut(&window, near).is_empty(),
            Sheet::Nothing => false,
        }
    };
    let all = sheets.all.iter().zip(boxes);
    let mut near = all.filter(|((shape, _), b)| wanted(*shape) && !apart(*b));
    near.find(cut).map(|(&(shape, _), _)| shape)
}

fn polygon(corners: SmallVec<[Vec3<f64>; 4]>) -> Sheet {
    let normal = (corners[1] - corners[0]).cross(corners[corners.len() - 1] - corners[0]);
    if normal.length_squared() == 0.0 {
        // Never hit.
        return Sheet::Nothing;
    }
    Sheet::Flat(Flat {
        normal: normal.normalize(),
        kind: FlatKind::Polygon(corners),
    })
}

/// Lines along which flat surfaces cross.
fn flats(of: [&Flat; 2], parts: [LineSide; 2], near: f64, found: &mut Vec<Found>) {
    let apart = parts[0].shape != parts[1].shape;
    let along = of[0].normal.cross(of[1].normal);
    if along.length() < LEAST_SINE {
        let doubt = if apart {
            contact::doubt(of, near)
        } else {
            contact::lie_on_each_other(of, near).then_some(Doubt::Twice)
        };
        if let Some(doubt) = doubt {
            found.push(Found::Doubt(doubt, parts));
        }
        return;
    }
    let along = along.normalize();
    let Some(a) = of[0].chord(of[1], near) else {
        return;
    };
    let Some(b) = of[1].chord(of[0], near) else {
        return;
    };
    let Some(common) = contact::common(along, &a, &b, near) else {
        return;
    };
    let [start, along] = common;
    let line = Line {
        sides: parts,
        path: Path::Straight { start, along },
    };
    let through = [&a, &b].map(|chord| chord.sides == [true; 2]);
    match through {
        [true, true] => found.push(Found::Line(line)),
        [false, true] => found.push(Found::Half(Half::of(line, of[0], &a))),
        [true, false] => {
            let [first, second] = line.sides;
            let sides = [second, first];
            found.push(Found::Half(Half::of(Line { sides, ..line }, of[1], &b)));
        }
        [false, false] if apart => found.push(Found::Touch(Touch {
            parts,
            sides: [a.end_points, b.end_points],
            into: of.map(|face| {
                let to = face.middle() - start;
                (to - along * (along.dot(to) / along.length_squared())).normalize()
            }),
            common,
            near,
        })),
        [false, false] => {}
    }
}

impl Half {
    /// Of a line whose first surface is the face.
    fn of(line: Line, face: &Flat, chord: &Chord) -> Self {
        Self {
            line,
            end_points: chord.end_points,
            inner: face.middle(),
        }
    }

    /// Whether the face is in front of the other surface, as the normal of that says.
    fn above(&self, shapes: &[AnyShape]) -> bool {
        let LineSide { shape, locals } = self.line.sides[1];
        let normal = normal(&shapes[shape as usize], locals[0], self.end_points[0]);
        normal.dot(self.inner - self.end_points[0]) > 0.0
    }

    /// What both faces at a side have in common: the surface that it lies on, and the side.
    fn key(&self) -> ([u32; 3], [[u64; 3]; 2]) {
        let bits = |p: Vec3<f64>| p.to_array().map(f64::to_bits);
        let [a, b] = self.end_points.map(bits);
        let [own, other] = self.line.sides;
        (
            [own.shape, other.shape, other.locals[0]],
            [a.min(b), a.max(b)],
        )
    }
}

/// All lines along which surfaces of these shapes cross, and what they do besides.
pub(super) fn all(shapes: &[AnyShape]) -> All {
    let (sheets, boxes) = Sheets::of(shapes);
    let found = boxes::pairs(&boxes, |i, j, found| {
        sheets.cross(sheets.all[i], sheets.all[j], found);
    });
    let (mut lines, mut touches, mut doubts) = (Vec::new(), Vec::new(), Vec::new());
    let mut halves = Vec::new();
    for found in found {
        match found {
            Found::Line(line) => lines.push(line),
            Found::Half(half) => halves.push(half),
            Found::Touch(touch) => touches.push(touch),
            Found::Doubt(doubt, parts) => {
                let [a, b] = parts.map(|LineSide { shape, locals }| {
                    normal(&shapes[shape as usize], locals[0], Vec3::zero())
                });
                // The bottom of what stands on something looks the other way.
                if doubt != Doubt::Twice || a.dot(b) > 0.0 {
                    doubts.push((doubt, parts.map(|part| part.shape)));
                }
            }
        }
    }
    halves.sort_by_key(Half::key);
    for group in halves.chunk_by(|a, b| a.key() == b.key()) {
        let of = |above: bool| group.iter().find(|half| half.above(shapes) == above);
        if let [Some(below), Some(above)] = [of(false), of(true)] {
            let mut line = below.line;
            line.sides[0].locals[1] = above.line.sides[0].locals[1];
            lines.push(line);
        }
    }
    let crossing = contact::four_sides(&mut touches).into_iter();
    doubts.extend(crossing.map(|pair| (Doubt::FourSides, pair)));
    doubts.sort_unstable();
    doubts.dedup();
    All {
        lines,
        touches,
        doubts,
    }
}
