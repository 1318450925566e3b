//! Geometry: interactions, their derivatives, surface coordinates, and the messages of bad input.

use std::f64::consts::PI;
use std::path::Path;

use ad_core::{Dual, Float, Real, Vec3};
use render::SceneError;
use render::math::{Ray, Transform};
use render::params::Theta;
use render::plugin::xml::Document;
use render::sampler::{Independent, Sampler};
use render::scene::Builder;
use render::shape::{AnyShape, Cube, Cylinder, Disk, Shape, Sphere, SurfaceInteraction};

use crate::common::shapes::{
    Tracer, all_shapes, assert_near, curves, interact, rays, shapes, vec3,
};

#[test]
fn interactions_lie_on_the_ray_and_on_the_surface() {
    for (name, shape) in shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut hits = 0;
        for ray in rays(2000, 1) {
            let Some(si) = tracer.first(&ray) else {
                continue;
            };
            hits += 1;
            assert!((si.p - ray.at(si.t)).length() < 1e-6, "{name}");
            assert!((si.n_geo.length() - 1.0).abs() < 1e-6, "{name}");
            let f = si.frame;
            let orthonormal = [
                f.s.length() - 1.0,
                f.t.length() - 1.0,
                f.n.length() - 1.0,
                f.s.dot(f.t),
                f.t.dot(f.n),
                f.n.dot(f.s),
                f.s.cross(f.t).dot(f.n) - 1.0,
            ];
            assert!(
                orthonormal.iter().all(|x| x.abs() < 1e-6),
                "{name} {orthonormal:?}"
            );
            assert!(f.n.dot(si.n_geo) > 0.0, "{name}");
            assert!((-1e-6..1.0 + 1e-6).contains(&si.uv.x), "{name} {:?}", si.uv);
            assert!((-1e-6..1.0 + 1e-6).contains(&si.uv.y), "{name} {:?}", si.uv);
            // The same in f32, which trusts the traversal's distance.
            let single = |v: Vec3<f64>| v.map(|x| x as f32);
            let ray32 = Ray::new(single(ray.o), single(ray.d));
            let si32 = tracer.first(&ray32).unwrap();
            let grazing = si.n_geo.dot(ray.d).abs();
            let error = (si32.p.map(f64::from) - si.p).length();
            assert!(
                error * grazing.max(1e-3) < 4e-6,
                "{name}: {error:e} at cosine {grazing}"
            );
        }
        assert!(hits > 200, "{name}: {hits}");
    }
}

/// Numbers of an interaction, and what they are.
fn numbers<R: Real>(si: &SurfaceInteraction<R>) -> [(&'static str, R); 18] {
    let ([px, py, pz], [nx, ny, nz]) = (si.p.to_array(), si.n_geo.to_array());
    let [s, t, n] = [si.frame.s, si.frame.t, si.frame.n].map(|v| v.to_array());
    [
        ("p.x", px),
        ("p.y", py),
        ("p.z", pz),
        ("n_geo.x", nx),
        ("n_geo.y", ny),
        ("n_geo.z", nz),
        ("s.x", s[0]),
        ("s.y", s[1]),
        ("s.z", s[2]),
        ("t.x", t[0]),
        ("t.y", t[1]),
        ("t.z", t[2]),
        ("n.x", n[0]),
        ("n.y", n[1]),
        ("n.z", n[2]),
        ("u", si.uv.x),
        ("v", si.uv.y),
        ("distance", si.t),
    ]
}

/// Against central differences with step 1e-6 in f64; error 1e-5 relative to the largest curvature on
/// these rays, which grazing hits would not bound.
#[test]
fn interactions_move_with_the_ray() {
    type D = Dual<f64, 6>;
    for (name, shape) in shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut tested = 0;
        for ray in rays(400, 2) {
            let Some(hit) = tracer.hit(&ray) else {
                continue;
            };
            let at = |x: [f64; 6]| {
                let ray = Ray::new(vec3([x[0], x[1], x[2]]), vec3([x[3], x[4], x[5]]));
                shape.interaction(&Theta::still(), hit.prim, &ray, &hit)
            };
            let x: [f64; 6] = [ray.o.x, ray.o.y, ray.o.z, ray.d.x, ray.d.y, ray.d.z];
            let si = at(x);
            let wrap = si.uv.x.min(1.0 - si.uv.x);
            if si.n_geo.dot(ray.d).abs() < 0.2 || wrap < 1e-3 {
                continue;
            }
            tested += 1;
            let lift = |k: usize| D::var(x[k], k);
            let moving = Ray::new(
                Vec3::new(lift(0), lift(1), lift(2)),
                Vec3::new(lift(3), lift(4), lift(5)),
            );
            let dual = shape.interaction(&Theta::still(), hit.prim, &moving, &hit);
            for k in 0..6 {
                let step = |h: f64| {
                    let mut y = x;
                    y[k] += h;
                    at(y)
                };
                let (above, below) = (step(1e-6), step(-1e-6));
                let values = numbers(&above).into_iter().zip(numbers(&below));
                for ((what, d), ((_, a), (_, b))) in numbers(&dual).into_iter().zip(values) {
                    let expected = (a - b) / 2e-6;
                    let error = (d.eps[k] - expected).abs() / (1.0 + expected.abs());
                    assert!(
                        error < 1e-5,
                        "{name}: d {what} / d x{k} = {} vs {expected}",
                        d.eps[k]
                    );
                }
            }
        }
        assert!(tested > 40, "{name}: {tested}");
    }
}

/// Largest difference of two points on a surface, but for the distance along a ray: `u` may be off by whole turns.
fn difference<P: Float>(
    a: &SurfaceInteraction<P>,
    b: &SurfaceInteraction<P>,
) -> (f64, &'static str) {
    let pairs = numbers(a).into_iter().zip(numbers(b));
    let off = pairs.filter(|((what, _), _)| *what != "distance");
    off.map(|((what, x), (_, y))| {
        let d = (x - y).to_f64().abs();
        let turned = matches!(what, "u" | "v");
        (if turned { d.min((1.0 - d).abs()) } else { d }, what)
    })
    .max_by(|x, y| x.0.total_cmp(&y.0))
    .expect("numbers")
}

/// The coordinates of a hit are where it was: in f64 to rounding of the recomputed point, in f32 to some of them.
#[test]
fn coordinates_lead_back_to_the_point() {
    fn check<P: Float>(name: &str, shape: &AnyShape, limit: f64) {
        let tracer = Tracer::new(shape);
        let mut tested = 0;
        for ray in rays(2000, 11) {
            let of = |v: Vec3<f64>| v.map(P::of);
            let Some(hit) = tracer.hit(&Ray::new(of(ray.o), of(ray.d))) else {
                continue;
            };
            let ray = Ray::new(of(ray.o), of(ray.d));
            let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
            let at = shape.coordinates(hit.prim, &si);
            let back = shape.point_at(&Theta::still(), hit.prim, at);
            assert!(back.t == P::zero());
            // Around the middle of a disk, and the poles of a ball, directions are less well known than points.
            let middle = match name {
                "disk" => si.uv.x,
                "sphere" | "inside-out sphere" => (si.uv.y * P::of(PI)).sin(),
                "linear curves" => (P::one() + at.0.y).min(P::of(2.0) - at.0.y).min(P::one()),
                _ => P::one(),
            };
            let (off, what) = difference(&si, &back);
            assert!(
                off * middle.to_f64() < limit,
                "{name}: {what} is off by {off:e}"
            );
            tested += 1;
        }
        assert!(tested > 200, "{name}: {tested}");
    }
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        check::<f64>(name, &shape, 1e-12);
        // Across a thin curve directions are known less well than points.
        let thin = if name.ends_with("curves") { 10.0 } else { 1.0 };
        check::<f32>(name, &shape, 3e-6 * thin);
    }
}

/// A sample says where it is on its primitive.
#[test]
fn samples_lie_at_their_coordinates() {
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        for i in 0..500 {
            let u = Independent::new(12, 0, i).next_2d::<f64>();
            let (s, n_geo) = shape.sample_surface::<f64>(&Theta::still(), u);
            let at = shape.point_at(&Theta::still(), s.prim, s.coordinates);
            // The axes of balls and tubes are unit vectors in single precision only.
            assert!((at.p - s.p).length() < 1e-6, "{name}");
            assert!((at.frame.n - s.n).length() < 1e-6, "{name}");
            assert!(at.n_geo.cross(n_geo).length() < 1e-6, "{name}");
            let du = (at.uv.x - s.uv.x).abs();
            assert!(du.min(1.0 - du) < 1e-6, "{name}");
            assert!((at.uv.y - s.uv.y).abs() < 1e-6, "{name}");
        }
    }
}

/// The element of area over all coordinates is the area.
#[test]
fn elements_of_area_add_up() {
    for (name, shape) in all_shapes() {
        let measure = match &shape {
            AnyShape::Sphere(_) => 4.0 * PI,
            AnyShape::Disk(_) => PI,
            AnyShape::Mesh(_) | AnyShape::Instance(_) => 0.5,
            AnyShape::Rectangle(_) | AnyShape::Cube(_) | AnyShape::Cylinder(_) => 1.0,
            AnyShape::Curves(_) => unreachable!("not among them"),
        };
        let prims = shape.primitives().len() as u32;
        let element = |prim| shape.area_element::<f64>(&Theta::still(), prim);
        let sum: f64 = (0..prims).map(|prim| element(prim) * measure).sum();
        assert!((sum / shape.area() - 1.0).abs() < 1e-6, "{name}: {sum}");
    }
}

/// Surface coordinates of Mitsuba 3.9.
#[test]
fn surface_coordinates_are_those_of_mitsuba() {
    let sphere: AnyShape = Sphere::new([0.0; 3], 2.0, false).unwrap().into();
    let si = interact(&sphere, [3.0, 3.0, 0.0], [-1.0, -1.0, 0.0]);
    assert!((si.uv.x - 0.125).abs() < 1e-6 && (si.uv.y - 0.5).abs() < 1e-6);
    let si = interact(&sphere, [0.0, -5.0, 0.0], [0.0, 1.0, 0.0]);
    assert!((si.uv.x - 0.75).abs() < 1e-6);
    assert_near(si.frame.s, [1.0, 0.0, 0.0]);
    let si = interact(&sphere, [0.0, 0.0, 5.0], [0.0, 0.0, -1.0]);
    assert!(si.uv.y.abs() < 1e-6);

    let disk: AnyShape = Disk::new(&Transform::scale([2.0; 3]), false)
        .unwrap()
        .into();
    let si = interact(&disk, [0.0, 1.0, 1.0], [0.0, 0.0, -1.0]);
    assert!((si.uv.x - 0.5).abs() < 1e-6 && (si.uv.y - 0.25).abs() < 1e-6);
    assert_near(si.frame.s, [0.0, 1.0, 0.0]);
    assert_near(si.n_geo, [0.0, 0.0, 1.0]);

    let tube: AnyShape = Cylinder::new([0.0; 3], [0.0, 0.0, 4.0], 1.0, false)
        .unwrap()
        .into();
    let si = interact(&tube, [0.0, 3.0, 1.0], [0.0, -1.0, 0.0]);
    assert!((si.uv.x - 0.25).abs() < 1e-6 && (si.uv.y - 0.25).abs() < 1e-6);
    assert_near(si.n_geo, [0.0, 1.0, 0.0]);
    assert_near(si.frame.s, [-1.0, 0.0, 0.0]);

    let cube: AnyShape = Cube::new(&Transform::IDENTITY, false).unwrap().into();
    // Face by face: a point off the centre, its normal, its surface coordinates.
    let faces = [
        ([0.5, -1.0, 0.2], [0.0, -1.0, 0.0], [0.6, 0.75]),
        ([0.5, 1.0, 0.2], [0.0, 1.0, 0.0], [0.25, 0.4]),
        ([1.0, 0.5, 0.2], [1.0, 0.0, 0.0], [0.75, 0.4]),
        ([0.5, 0.2, 1.0], [0.0, 0.0, 1.0], [0.6, 0.75]),
        ([-1.0, 0.5, 0.2], [-1.0, 0.0, 0.0], [0.75, 0.6]),
        ([0.5, 0.2, -1.0], [0.0, 0.0, -1.0], [0.4, 0.75]),
    ];
    for (p, n, uv) in faces {
        let si = interact(&cube, [0, 1, 2].map(|i| p[i] + n[i]), n.map(|x| -x));
        assert_near(si.p, p);
        assert_near(si.n_geo, n);
        assert!(
            (si.uv.x - uv[0]).abs() < 1e-6 && (si.uv.y - uv[1]).abs() < 1e-6,
            "{p:?} {:?}",
            si.uv
        );
    }
    // Mirrored cubes keep their outside.
    let mirrored: AnyShape = Cube::new(&Transform::scale([1.0, -1.0, 1.0]), false)
        .unwrap()
        .into();
    assert_near(
        interact(&mirrored, [0.1, 5.0, 0.2], [0.0, -1.0, 0.0]).n_geo,
        [0.0, 1.0, 0.0],
    );
    let flipped: AnyShape = Cube::new(&Transform::IDENTITY, true).unwrap().into();
    assert_near(
        interact(&flipped, [0.1, 5.0, 0.2], [0.0, -1.0, 0.0]).n_geo,
        [0.0, -1.0, 0.0],
    );
}

#[test]
fn areas_are_exact() {
    let area = |s: AnyShape| s.area();
    let scale = Transform::scale([1.0, 2.0, 3.0]);
    assert!((area(Cube::new(&scale, false).unwrap().into()) - 88.0).abs() < 1e-9);
    assert!((area(Disk::new(&scale, false).unwrap().into()) - 2.0 * PI).abs() < 1e-6);
    assert!((area(Sphere::new([1.0; 3], 2.0, false).unwrap().into()) - 16.0 * PI).abs() < 1e-9);
    let tube = Cylinder::transformed(
        [0.0; 3],
        [0.0, 0.0, 1.0],
        1.0,
        &Transform::scale([10.0, 10.0, 4.0]),
        false,
    );
    assert!((area(tube.unwrap().into()) - 80.0 * PI).abs() < 1e-4);
}

// ---- Scene files --------------------------------------------------------------------------------

fn from_xml(text: &str) -> Result<AnyShape, SceneError> {
    let text = format!("<scene version=\"3.0.0\">\n{text}\n</scene>");
    let document = Document::from_str(&text, Path::new("."), &[]).unwrap();
    let node = document.root().children_with_tag("shape")[0];
    AnyShape::from_node(node, Builder::new().registry())
}

#[test]
fn descriptions_of_bad_shapes_name_their_line() {
    let scale = |x: f64, y: f64, z: f64| {
        format!("<transform name=\"to_world\"><scale x=\"{x}\" y=\"{y}\" z=\"{z}\"/></transform>")
    };
    let cases = [
        ("sphere", scale(1.0, 1.0, 2.0), "to_world"),
        (
            "sphere",
            "<float name=\"radius\" value=\"-1\"/>".into(),
            "radius",
        ),
        ("sphere", scale(1e-30, 1e-30, 1e-30), "to_world"),
        ("disk", scale(1e-30, 1e-30, 1e-30), "to_world"),
        ("disk", scale(1.0, 1e-20, 1e5), "to_world"),
        ("cube", scale(1e-40, 1e-40, 1e-40), "to_world"),
        ("cylinder", scale(1.0, 2.0, 1.0), "to_world"),
        (
            "cylinder",
            "<float name=\"radius\" value=\"0\"/>".into(),
            "radius",
        ),
        (
            "cylinder",
            "<point name=\"p1\" value=\"0 0 0\"/>".into(),
            "p1",
        ),
        ("obj", String::new(), "filename"),
        (
            "obj",
            "<string name=\"filename\" value=\"nowhere.obj\"/>".into(),
            "nowhere.obj",
        ),
        ("teapot", String::new(), "known"),
    ];
    for (plugin, content, mention) in cases {
        let text = format!("<shape type=\"{plugin}\">\n{content}</shape>");
        let message = match from_xml(&text) {
            Ok(_) => panic!("{text} was accepted"),
            Err(e) => e.to_string(),
        };
        let place = message.contains("<text>:2") || message.contains("<text>:3");
        assert!(place && message.contains(mention), "{text}: {message}");
    }
    let good = "<shape type=\"sphere\"><point name=\"center\" value=\"1 2 3\"/><float name=\"radius\" value=\"2\"/>
        <transform name=\"to_world\"><scale value=\"2\"/><translate x=\"1\"/></transform></shape>";
    let AnyShape::Sphere(s) = from_xml(good).unwrap() else {
        panic!("not a sphere")
    };
    assert_eq!((s.center(), s.radius()), ([3.0, 4.0, 6.0], 4.0));
}
