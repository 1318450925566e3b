//! Lines where they are known, and none where surfaces only touch.

use super::*;
use crate::edges::Eye;
use crate::math::Transform;
use crate::shape::{Cube, Cylinder, Disk, Mesh, MeshData, Patch, Rectangle, Sphere};

fn cube(scale: f64, at: [f64; 3]) -> AnyShape {
    let to_world = Transform::scale([scale; 3]).then(&Transform::translate(at));
    Cube::new(&to_world, false).expect("a cube").into()
}

fn floor() -> AnyShape {
    let patch = Patch::new([-5.0, -5.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], false);
    Rectangle(patch.expect("a floor")).into()
}

fn ball(at: [f64; 3], radius: f64) -> AnyShape {
    Sphere::new(at, radius, false).expect("a ball").into()
}

fn mesh(positions: Vec<[f32; 3]>, triangles: Vec<[u32; 3]>) -> AnyShape {
    let data = MeshData {
        positions,
        triangles,
        ..Default::default()
    };
    Mesh::new(data, false).expect("a mesh").into()
}

/// Two pyramids over one square in the plane of the floor, of which the height is a coordinate, moved.
fn octahedron([x, y, z]: [f32; 3]) -> AnyShape {
    let points = [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
    ];
    let moved = points.map(|[a, b, c]| [a + x, b + y, c + z]);
    let faces = (0..4u32).flat_map(|k| [[k, (k + 1) % 4, 4], [(k + 1) % 4, k, 5]]);
    mesh(moved.into(), faces.collect())
}

/// The length of all lines, after all of their points were found on both surfaces and their tangents were compared.
fn length(shapes: &[AnyShape]) -> f64 {
    let crossings = Crossings::of(shapes);
    let surfaces = Surfaces {
        shapes,
        firsts: &vec![0; shapes.len()],
    };
    let mut sum = 0.0;
    for line in &crossings.lines {
        let n = 2000;
        for i in 0..n {
            let s = (f64::from(i) + 0.5) / f64::from(n);
            let (p, tangent) = line.path.at(s);
            sum += tangent.length() / f64::from(n);
            let h = 1e-6;
            let change = (line.path.at(s + h).0 - line.path.at(s - h).0) * (0.5 / h);
            assert!(
                (change - tangent).length() < 1e-4 * (1.0 + tangent.length()),
                "{line:?} {s}: {change:?}, not {tangent:?}"
            );
            for part in line.sides {
                for local in part.locals {
                    let (_, at) = surfaces.place::<f64>(part.shape, Spot::Near(local), p);
                    let si: SurfaceInteraction<f64> =
                        shapes[part.shape as usize].point_at(&Theta::still(), local, at);
                    assert!((si.p - p).length() < 1e-5, "{line:?} {s}: {p:?} {:?}", si.p);
                }
            }
        }
    }
    sum
}

fn near(found: f64, expected: f64) {
    assert!(
        (found - expected).abs() < 1e-4 * expected,
        "{found}, not {expected}"
    );
}

/// A cube, a ball, a disk, tubes and a mesh in a floor, and in each other.
#[test]
fn lines_are_as_long_as_they_are_known_to_be() {
    near(length(&[floor(), cube(0.5, [0.3, 0.2, 0.1])]), 4.0);
    near(
        length(&[cube(0.5, [0.0; 3]), cube(0.25, [0.0, 0.1, 0.5])]),
        2.0,
    );
    near(length(&[floor(), ball([1.0, 0.0, 0.6], 1.0)]), TAU * 0.8);
    near(
        length(&[ball([0.0; 3], 1.0), ball([1.2, 0.0, 0.0], 1.0)]),
        TAU * 0.8,
    );
    // Beyond the border of the floor, half of the circle.
    near(length(&[floor(), ball([5.0, 0.0, 0.6], 1.0)]), TAU * 0.4);
    let upright = Transform::rotate([1.0, 0.0, 0.0], 90.0).expect("a turn");
    let disk: AnyShape = Disk::new(&upright, false).expect("a disk").into();
    near(length(&[floor(), disk.clone()]), 2.0);
    near(length(&[disk, ball([0.0, 0.6, 0.0], 1.0)]), TAU * 0.8);
    let tube = |p: [f64; 3], q: [f64; 3], r: f64| -> AnyShape {
        Cylinder::new(p, q, r, false).expect("a tube").into()
    };
    let standing = tube([0.0, 0.0, -1.0], [0.0, 0.0, 1.0], 0.5);
    near(length(&[floor(), standing.clone()]), TAU * 0.5);
    near(
        length(&[standing.clone(), ball([0.0, 0.0, 0.0], 0.8)]),
        2.0 * TAU * 0.5,
    );
    let lying = tube([-1.0, 0.0, 0.3], [1.0, 0.0, 0.3], 0.5);
    near(length(&[floor(), lying]), 2.0 * 2.0);
    let beside = tube([0.8, 0.0, 3.0], [0.8, 0.0, 0.0], 0.5);
    near(length(&[standing.clone(), beside]), 2.0);
    // Thin beside wide: about two circles.
    let thin = tube([-2.0, 0.0, 0.0], [2.0, 0.0, 0.0], 0.01);
    let found = length(&[standing, thin]);
    assert!((found - 2.0 * TAU * 0.01).abs() < 1e-4, "{found}");
    // A mesh that crosses itself and a floor.
    near(
        length(&[floor(), octahedron([0.0, 0.0, 0.5])]),
        4.0 * 0.5 * 2f64.sqrt(),
    );
}

/// A side of faces that lies on a surface is a line if they are on both sides of it, one by one or in a crowd.
#[test]
fn sides_that_lie_on_a_surface_are_lines() {
    let all = [floor(), octahedron([0.0; 3])];
    near(length(&all), 4.0 * 2f64.sqrt());
    let crossings = Crossings::of(&all);
    assert_eq!(crossings.lines.len(), 4);
    assert_eq!(crossings.bent.len(), 4);
    let (mut point, _) = crossings.lines[0]
        .rim(0.5)
        .seen(&Eye::point(Vec3::splat(3.0)), 1)
        .expect("seen");
    for (p, held) in [([0.5, 0.5, 0.0], true), ([2.0, -1.0, 0.0], false)] {
        point.p = p.into();
        assert_eq!(crossings.hold([0, 1], &point), held);
    }
}

/// What stands on something, lies on it, shares sides or corners with it, or is away, crosses nothing.
#[test]
fn what_touches_crosses_nothing() {
    let none = |what: &str, shapes: &[AnyShape]| {
        let found = Crossings::of(shapes).lines;
        assert!(found.is_empty(), "{what}: {found:?}");
    };
    none("a cube on a floor", &[floor(), cube(0.5, [0.0, 0.0, 0.5])]);
    none(
        "a cube below a floor",
        &[floor(), cube(0.5, [0.0, 0.0, -0.5])],
    );
    none("a ball on a floor", &[floor(), ball([0.0, 0.0, 1.0], 1.0)]);
    none(
        "cubes side by side",
        &[cube(0.5, [0.0; 3]), cube(0.5, [1.0, 0.3, 0.0])],
    );
    none(
        "a cube in a cube",
        &[cube(0.5, [0.0; 3]), cube(0.7, [0.0; 3])],
    );
    none(
        "one cube twice",
        &[cube(0.5, [0.0; 3]), cube(0.5, [0.0; 3])],
    );
    none(
        "corners on a floor",
        &[floor(), octahedron([0.0, 0.0, 1.0])],
    );
    none("one floor twice", &[floor(), floor()]);
    none("a mesh alone", &[octahedron([0.0; 3])]);
    let folded = mesh(
        vec![
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            [2.0, 0.0, 0.0],
        ],
        vec![[0, 1, 2], [0, 1, 4], [0, 0, 1], [2, 3, 1]],
    );
    none("slivers and folds", &[folded.clone(), folded, floor()]);
}

/// Whether pairs of shapes meet in a way that is not told apart, and in which one.
#[test]
fn what_is_not_told_apart_is_named() {
    let doubts = |shapes: &[AnyShape]| Crossings::of(shapes).doubts;
    let tilted = |angle: f64, shift: f64| -> AnyShape {
        let (sin, cos) = angle.sin_cos();
        let corner = [-1.0, -cos, shift - sin];
        let patch = Patch::new(corner, [2.0, 0.0, 0.0], [0.0, 2.0 * cos, 2.0 * sin], false);
        Rectangle(patch.expect("a rectangle")).into()
    };
    let pair = |doubt| vec![(doubt, [0, 1])];
    assert_eq!(doubts(&[floor(), tilted(5e-4, 0.0)]), pair(Doubt::Grazing));
    assert_eq!(doubts(&[floor(), tilted(2e-3, 0.0)]), []);
    assert_eq!(doubts(&[floor(), tilted(5e-4, 0.1)]), []);
    assert_eq!(doubts(&[floor(), floor()]), pair(Doubt::Twice));
    assert_eq!(doubts(&[floor(), cube(0.5, [0.0, 0.0, 0.5])]), []);
    // Roofs whose ridges are one line: side by side, and one through the other.
    let roof = |a: [f32; 2], b: [f32; 2]| {
        let at = |x: f32, [y, z]: [f32; 2]| [x, y, z];
        let corners = vec![
            [0.0; 3],
            [1.0, 0.0, 0.0],
            at(1.0, a),
            at(0.0, a),
            at(1.0, b),
            at(0.0, b),
        ];
        mesh(corners, vec![[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 5, 4]])
    };
    let upright = || roof([1.0, 0.5], [-1.0, 0.5]);
    assert_eq!(doubts(&[upright(), roof([1.0, -0.5], [-1.0, -0.5])]), []);
    let across = roof([0.5, 1.0], [0.5, -1.0]);
    assert_eq!(doubts(&[upright(), across]), pair(Doubt::FourSides));
}
