//! Surfaces that tell materials how long their texture coordinates are.

use ad_core::Vec2;

use super::{AnyShape, Cube, Disk, Mesh, MeshData, Patch, Shape, SurfaceCoordinates};
use crate::bsdf::chart::{Chart, Corners};
use crate::params::Theta;

/// The surface with its chart. Cubes and instances become meshes, and triangles of meshes with texture coordinates share no vertices any
/// more: their interactions have coordinates that tell triangles apart ([`Chart::of_triangles`]).
///
/// # Errors
/// What there is no chart of.
pub(crate) fn charted(shape: &AnyShape) -> Result<(AnyShape, Chart), &'static str> {
    match shape {
        AnyShape::Rectangle(_) | AnyShape::Cylinder(_) => {
            let lengths = lengths_at(shape, [0.5, 0.5]).ok_or(DEGENERATE)?;
            Ok((shape.clone(), Chart::even(lengths)))
        }
        AnyShape::Sphere(_) => {
            let at = [0.3, 0.2];
            let [a, _, c] = lengths_at(shape, at).ok_or(DEGENERATE)?;
            let coordinates = SurfaceCoordinates(Vec2::from(at));
            let v = shape.point_at::<f64>(&Theta::still(), 0, coordinates).uv.y;
            let equator = a / (std::f64::consts::PI * v).sin();
            Ok((shape.clone(), Chart::ball(equator, c)))
        }
        AnyShape::Disk(disk) => Ok((shape.clone(), disk.chart())),
        AnyShape::Cube(cube) => charted_mesh(&of_cube(cube).ok_or(DEGENERATE)?),
        AnyShape::Mesh(mesh) => charted_mesh(mesh),
        AnyShape::Instance(instance) => charted_mesh(&instance.copied()),
        AnyShape::Curves(_) => Err("a surface that is no curve"),
    }
}

const DEGENERATE: &str = "a surface with an area";

/// What a [`crate::bsdf::chart::Stretch`] is made of, at a point.
fn lengths_at(shape: &AnyShape, at: [f64; 2]) -> Option<[f64; 3]> {
    let at = SurfaceCoordinates(Vec2::from(at));
    let frame = shape.point_at::<f64>(&Theta::still(), 0, at).frame;
    let partials = shape.partials::<f64>(&Theta::still(), 0, at)?;
    let [du, dv] = [partials.dp_du, partials.dp_dv];
    Some([frame.s.dot(du), frame.s.dot(dv), frame.t.dot(dv)])
}

impl Disk {
    fn chart(&self) -> Chart {
        let [e1, e2] = self.half_axes();
        let n = self
            .point_at::<f64>(&Theta::still(), 0, SurfaceCoordinates(Vec2::zero()))
            .n_geo;
        Chart::disk(e1, e2, e1.cross(e2).dot(n) < 0.0)
    }
}

fn charted_mesh(mesh: &Mesh) -> Result<(AnyShape, Chart), &'static str> {
    if mesh.has_moving_points() {
        return Err("points that stay, as how long texture coordinates are is not a parameter");
    }
    if mesh.data().uvs.is_empty() {
        return Ok((mesh.clone().into(), Chart::even([1.0, 0.0, 1.0])));
    }
    let corners: Vec<_> = (0..mesh.data().triangles.len())
        .map(|i| mesh.corners(i))
        .collect();
    let (chart, uvs) = Chart::of_triangles(&corners).ok_or("fewer triangles")?;
    let data = mesh.data();
    let picked = |all: &[[f32; 3]]| -> Vec<[f32; 3]> {
        let indices = data.triangles.as_flattened().iter();
        indices
            .filter_map(|&i| all.get(i as usize).copied())
            .collect()
    };
    let count = data.triangles.len() as u32;
    let apart = MeshData {
        positions: picked(&data.positions),
        normals: picked(&data.normals),
        uvs,
        triangles: (0..count).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
    };
    let apart = Mesh::new(apart, mesh.is_flipped()).map_err(|_| DEGENERATE)?;
    Ok((apart.into(), chart))
}

/// Two triangles for each face, with the same coordinates.
fn of_cube(cube: &Cube) -> Option<Mesh> {
    let mut data = MeshData::default();
    for k in 0..6 {
        let Patch { corner, e1, e2, .. } = cube.patch(k)?;
        let first = data.positions.len() as u32;
        for [u, v] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0f32]] {
            data.positions
                .push([0, 1, 2].map(|i| corner[i] + u * e1[i] + v * e2[i]));
            data.uvs.push([u, v]);
        }
        let lengths = lengths_of_face(cube, k);
        let triangles = if lengths > 0.0 {
            [[0, 1, 3], [0, 3, 2]]
        } else {
            [[0, 3, 1], [0, 2, 3]]
        };
        data.triangles
            .extend(triangles.map(|t| t.map(|i| first + i)));
    }
    Mesh::new(data, false).ok()
}

/// Positive where the coordinates of a face run counter-clockwise.
fn lengths_of_face(cube: &Cube, face: u32) -> f64 {
    let at = SurfaceCoordinates(Vec2::new(0.5, 0.5));
    let frame = cube.point_at::<f64>(&Theta::still(), face, at).frame;
    let partials = cube.partials::<f64>(&Theta::still(), face, at);
    partials.map_or(0.0, |p| frame.t.dot(p.dp_dv))
}

impl Mesh {
    /// A triangle as its chart is made of it.
    fn corners(&self, triangle: usize) -> Corners {
        let data = self.data();
        let t = data.triangles[triangle].map(|i| i as usize);
        let at = SurfaceCoordinates(Vec2::new(1.0 / 3.0, 1.0 / 3.0));
        let si = self.point_at::<f64>(&Theta::still(), triangle as u32, at);
        let side = if self.is_flipped() { -1.0 } else { 1.0 };
        Corners {
            positions: t.map(|i| data.positions[i]),
            normals: t.map(|i| {
                let n = data.normals.get(i).copied().unwrap_or_default();
                n.map(|x| x * side)
            }),
            flat: si.n_geo.to_array(),
            uvs: t.map(|i| data.uvs[i]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Transform;
    use crate::shape::{Cylinder, Rectangle, Sphere};

    /// Charts say what partial derivatives do, in the surface's own coordinates, and frames stay.
    fn check(name: &str, shape: &AnyShape, exact: f64) {
        let (apart, chart) = charted(shape).expect("a chart");
        let theta = Theta::still();
        let count = shape.primitives().len() as u32;
        for at in [[0.2, 0.3], [0.55, 0.1], [0.1, 0.75], [-0.3, 0.4]] {
            for prim in 0..count {
                let at = SurfaceCoordinates(Vec2::from(at));
                let si = shape.point_at::<f64>(&theta, prim, at);
                // A cube's faces are two triangles each.
                let (other, own) = if apart.primitives().len() as u32 == count {
                    (prim, at)
                } else {
                    (2 * prim, apart.locate(2 * prim, si.p))
                };
                let seen = apart.point_at::<f64>(&theta, other, own);
                let (uv, triangle) = chart.own(seen.uv);
                let near = |a: f64, b: f64| (a - b).abs() <= exact * (1.0 + b.abs());
                assert!(
                    near(uv.x, si.uv.x) && near(uv.y, si.uv.y),
                    "{name}: {uv:?} for {:?}",
                    si.uv
                );
                assert!(si.frame.s.dot(seen.frame.s) > 1.0 - 10.0 * exact, "{name}");
                assert!(si.frame.n.dot(seen.frame.n) > 1.0 - 10.0 * exact, "{name}");
                let p = shape
                    .partials::<f64>(&theta, prim, at)
                    .expect("coordinates");
                let found = chart.stretch(uv, triangle);
                let right = [
                    si.frame.s.dot(p.dp_du),
                    si.frame.s.dot(p.dp_dv),
                    si.frame.t.dot(p.dp_dv),
                ];
                let found = [found.a, found.b, found.c];
                let size = right.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
                assert!(
                    found
                        .iter()
                        .zip(right)
                        .all(|(f, r)| (f - r).abs() <= exact * size),
                    "{name} {prim} {at:?}: {found:?} for {right:?}"
                );
            }
        }
    }

    #[test]
    fn charts_are_partial_derivatives() {
        let sheared = Transform {
            linear: [[2.0, 0.4, 0.1], [0.0, 1.5, -0.3], [0.2, 0.1, 0.7]],
            translation: [1.0, -2.0, 0.5],
        };
        for flip in [false, true] {
            let patch = Patch::new(
                sheared.point([-1.0, -1.0, 0.0]),
                sheared.vector([2.0, 0.0, 0.0]),
                sheared.vector([0.0, 2.0, 0.0]),
                flip,
            );
            let rectangle = Rectangle(patch.expect("an area"));
            check("rectangle", &rectangle.into(), 1e-6);
            check(
                "disk",
                &Disk::new(&sheared, flip).expect("an area").into(),
                1e-6,
            );
            check(
                "cube",
                &Cube::new(&sheared, flip).expect("faces").into(),
                1e-5,
            );
            let ball = Sphere::new([0.5, 1.0, -1.0], 0.7, flip).expect("a radius");
            check("sphere", &ball.into(), 1e-6);
            let tube = Cylinder::new([0.0, 1.0, 0.0], [0.5, 1.5, 2.0], 0.4, flip);
            check("cylinder", &tube.expect("a radius").into(), 1e-6);
            for normals in [false, true] {
                let data = MeshData {
                    positions: vec![
                        [0.0, 0.0, 0.0],
                        [1.0, 0.1, 0.2],
                        [0.1, 1.3, 0.0],
                        [1.2, 1.1, -0.4],
                    ],
                    normals: if normals {
                        vec![
                            [0.1, 0.0, 1.0],
                            [0.3, -0.2, 1.0],
                            [0.0, 0.3, 0.9],
                            [0.2, 0.2, 2.0],
                        ]
                    } else {
                        Vec::new()
                    },
                    // The second triangle's run clockwise, and outside of the unit square.
                    uvs: vec![[0.1, 0.2], [0.7, 0.25], [-3.5, 8.0], [0.9, 0.1]],
                    triangles: vec![[0, 1, 2], [1, 3, 2]],
                };
                let mesh = Mesh::new(data, flip).expect("triangles");
                check("mesh", &mesh.into(), 2e-5);
            }
        }
    }

    #[test]
    fn degenerate_coordinates_are_harmless() {
        let huge = f32::MAX;
        for uvs in [
            vec![[0.5; 2]; 3],
            vec![[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]],
            vec![[0.0, 0.0], [1e-40, 0.0], [0.0, 1e-40]],
            vec![[-huge, -huge], [huge, 0.0], [0.0, huge]],
        ] {
            let data = MeshData {
                positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                uvs,
                triangles: vec![[0, 1, 2]],
                ..MeshData::default()
            };
            let mesh = AnyShape::from(Mesh::new(data, false).expect("a triangle"));
            let (apart, chart) = charted(&mesh).expect("a chart");
            let at = SurfaceCoordinates(Vec2::new(0.2f32, 0.3));
            let si = apart.point_at::<f32>(&Theta::still(), 0, at);
            let (uv, triangle) = chart.own(si.uv);
            let s = chart.stretch(uv, triangle);
            assert!(uv.x.is_finite() && uv.y.is_finite());
            assert!([s.a, s.b, s.c].iter().all(|x| x.is_finite()), "{s:?}");
        }
        for uv in [
            [f32::NAN, 0.0],
            [f32::INFINITY, -f32::INFINITY],
            [1e30, -1e30],
        ] {
            let cube = AnyShape::from(Cube::new(&Transform::IDENTITY, false).expect("faces"));
            let (_, chart) = charted(&cube).expect("a chart");
            assert!(chart.own(Vec2::from(uv)).1 < 12);
        }
    }
}
