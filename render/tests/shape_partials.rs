//! How surfaces and their normals change over surface coordinates, with normal maps and without.

use ad_core::{Dual, Float, Vec2, Vec3};
use render::math::Transform;
use render::params::Theta;
use render::sampler::{Independent, Sampler};
use render::scene::Builder;
use render::shape::{
    AnyShape, Disk, Mesh, Partials, Shape, Sphere, SurfaceCoordinates, SurfaceInteraction,
};

use crate::common::shapes::{Tracer, affine, all_shapes, bent_mesh, curves, rays};

/// Position, normal and first axis, as functions of the surface coordinates, and the texture coordinates.
fn bends(at: &SurfaceInteraction<f64>) -> [Vec3<f64>; 3] {
    [at.p, at.frame.n, at.frame.s]
}

/// Both partial derivatives of each of [`bends`].
fn partials_of(p: &Partials<f64>) -> [[Vec3<f64>; 2]; 3] {
    [[p.dp_du, p.dp_dv], [p.dn_du, p.dn_dv], [p.ds_du, p.ds_dv]]
}

/// Central differences in f64 with step 1e-5 in each surface coordinate: `d x = x_u du + x_v dv`, to 1e-6 of the largest
/// term, at random points of every shape.
#[test]
fn partials_are_those_of_differences() {
    const STEP: f64 = 1e-5;
    for (name, shape) in all_shapes().into_iter().chain(curves()) {
        let tracer = Tracer::new(&shape);
        let mut tested = 0;
        for ray in rays(1500, 13) {
            let Some(hit) = tracer.hit(&ray) else {
                continue;
            };
            let si = shape.interaction(&Theta::still(), hit.prim, &ray, &hit);
            let SurfaceCoordinates(at) = shape.coordinates(hit.prim, &si);
            // Neither at a pole nor where an angle jumps, nor at a fold of the octahedron.
            let pole = match name {
                "disk" => si.uv.x < 0.05,
                _ if name.ends_with("sphere") => {
                    let fold = [at.x, at.y, 1.0 - at.x.abs() - at.y.abs()];
                    !(0.05..0.95).contains(&si.uv.y) || fold.iter().any(|x| x.abs() < 1e-3)
                }
                _ => false,
            };
            let wrap = |x: f64| x.min(1.0 - x) < 1e-3;
            if pole || wrap(si.uv.x) || wrap(si.uv.y) {
                continue;
            }
            tested += 1;
            let found = shape.partials(&Theta::still(), hit.prim, SurfaceCoordinates(at));
            if name == "linear curves" && !(0.01..0.99).contains(&at.y) {
                // The balls have one coordinate only.
                let ball = !(-0.01..1.01).contains(&at.y);
                assert!(found.is_none() || !ball);
                continue;
            }
            let found = found.expect("texture coordinates");
            for k in 0..2 {
                let point = |h: f64| {
                    let mut at = at.to_array();
                    at[k] += h;
                    shape.point_at(&Theta::still(), hit.prim, SurfaceCoordinates(at.into()))
                };
                let (above, below) = (point(STEP), point(-STEP));
                let slope = |x: f64, y: f64| (x - y) / (2.0 * STEP);
                let du = slope(above.uv.x, below.uv.x);
                let dv = slope(above.uv.y, below.uv.y);
                let all = bends(&above).into_iter().zip(bends(&below));
                for ((x, y), [x_u, x_v]) in all.zip(partials_of(&found)) {
                    let expected = (x - y) * (0.5 / STEP);
                    let off = (x_u * du + x_v * dv - expected).length();
                    let scale = 1.0 + (x_u * du).length() + (x_v * dv).length();
                    assert!(off < 1e-6 * scale, "{name}: off by {off:e} of {scale}");
                }
            }
        }
        assert!(tested > 80, "{name}: {tested}");
    }
}

/// Also over scalars with tangents: those of the partial derivatives are second derivatives.
#[test]
fn partials_carry_tangents() {
    type D = Dual<f64, 2>;
    let shape: AnyShape = bent_mesh().into();
    let at = [0.3, 0.2];
    let found = |at: [f64; 2]| {
        let at = SurfaceCoordinates(Vec2::from(at));
        shape.partials::<f64>(&Theta::still(), 0, at).unwrap()
    };
    let moving = SurfaceCoordinates(Vec2::new(D::var(at[0], 0), D::var(at[1], 1)));
    let dual = shape.partials::<D>(&Theta::still(), 0, moving).unwrap();
    for k in 0..2 {
        let step = |h: f64| {
            let mut x = at;
            x[k] += h;
            found(x)
        };
        let expected = (step(1e-5).dn_du - step(-1e-5).dn_du) * (0.5 / 1e-5);
        let off = (dual.dn_du.map(|x| x.eps[k]) - expected).length();
        assert!(off < 1e-6, "{off:e}");
    }
}

/// Where a coordinate is none, partial derivatives are limits: finite, and zero along it.
#[test]
fn partials_at_poles_are_finite() {
    fn finite<P: Float>() {
        let ball: AnyShape = Sphere::new([0.1, 0.2, 0.3], 2.0, false).unwrap().into();
        let disk: AnyShape = Disk::new(&affine(), false).unwrap().into();
        let zero = Vec2::new(P::zero(), P::zero());
        let south = Vec2::new(P::one(), P::one());
        for (shape, at) in [(&ball, zero), (&ball, south), (&disk, zero)] {
            let at = SurfaceCoordinates(at);
            let found = shape.partials::<P>(&Theta::still(), 0, at).unwrap();
            assert!(found.is_finite(), "{found:?}");
            let along = if matches!(shape, AnyShape::Disk(_)) {
                found.dp_dv
            } else {
                found.dp_du
            };
            assert!(along.length() < P::of(1e-5), "{found:?}");
            let across = if matches!(shape, AnyShape::Disk(_)) {
                found.dp_du
            } else {
                found.dp_dv
            };
            assert!(across.length() > P::of(0.3), "{found:?}");
        }
    }
    finite::<f32>();
    finite::<f64>();
}

/// Degenerate triangles, and texture coordinates that are none, have no partial derivatives; everything else is finite.
#[test]
fn degenerate_triangles_have_no_partials() {
    let mut data = bent_mesh().data().clone();
    data.triangles.push([0, 1, 1]);
    data.triangles.push([2, 2, 2]);
    data.uvs[3] = data.uvs[2];
    let mesh = Mesh::new(data, false).unwrap();
    let at = SurfaceCoordinates(Vec2::new(0.3f32, 0.3));
    let found = |prim| mesh.partials::<f32>(&Theta::still(), prim, at);
    assert!(found(0).is_some_and(|p| p.is_finite()));
    for prim in 1..4 {
        assert!(found(prim).is_none(), "{prim}");
        let si = mesh.point_at::<f32>(&Theta::still(), prim, at);
        assert!(si.p.is_finite() && si.uv.x.is_finite() && si.uv.y.is_finite());
        let back = mesh.coordinates(prim, &si).0;
        assert!(back.x.is_finite() && back.y.is_finite());
    }
}

/// A random map of slopes that are not small.
fn normal_texels(width: usize, height: usize) -> Vec<f32> {
    let texel = |i| {
        let mut s = Independent::new(14, 0, i as u64);
        let [x, y] = s.next_2d::<f32>();
        [0.3 + 0.4 * x, 0.3 + 0.4 * y, 0.9]
    };
    (0..width * height).flat_map(texel).collect()
}

/// The normal of a normal map, by itself and in other materials, on every shape: how it changes over the surface, against
/// central differences as above.
#[test]
fn partials_of_mapped_normals_are_those_of_differences() {
    use render::bsdf::{Blend, Conductor, Interpolation, Mask, NormalMap, TwoSided};
    use render::camera::{Camera, FovAxis};
    use render::{Film, Settings};
    use std::sync::Arc;

    const STEP: f64 = 1e-5;
    for (name, shape) in all_shapes() {
        for (interpolation, composite) in [
            (Interpolation::Normals, 0),
            (Interpolation::Slopes, 1),
            (Interpolation::Slopes, 2),
            (Interpolation::Normals, 3),
            (Interpolation::Slopes, 4),
        ] {
            let mut build = Builder::new();
            let mut map = |name: &str, size: [u32; 2]| {
                let texels = normal_texels(size[0] as usize, size[1] as usize);
                build.texels(name, size, &texels, (-1.0, 2.0)).unwrap()
            };
            let (first, second) = (map("first", [5, 4]), map("second", [3, 6]));
            let tint = build.rgb("tint", [0.9; 3], (0.0, 1.0)).unwrap();
            let half = build.scalar("half", 0.5, (0.0, 1.0)).unwrap();
            let mirror: Arc<_> = Arc::new(
                Conductor {
                    index: None,
                    specular_reflectance: tint,
                }
                .into(),
            );
            let mapped = |map: &render::texture::RgbTexture,
                          nested: &Arc<render::bsdf::Material>| {
                let map = NormalMap::new(map.clone(), interpolation, nested.clone()).unwrap();
                Arc::new(render::bsdf::Material::from(map))
            };
            let one = mapped(&first, &mirror);
            let other = mapped(&second, &mirror);
            // What is nested how, and the part that is looked at.
            let (material, route, behind) = match composite {
                0 => (one, 0, false),
                1 => (mapped(&second, &one), 0, false),
                2 => (
                    Arc::new(TwoSided::new([one, other]).unwrap().into()),
                    0,
                    true,
                ),
                3 => (
                    Arc::new(Blend::new(half, [one, other]).unwrap().into()),
                    1,
                    false,
                ),
                _ => (Arc::new(Mask::new(half, one).unwrap().into()), 1, false),
            };
            let material = build.add_shared_material(material);
            build.add_shape("it", shape.clone(), material);
            let view = Transform::look_at([0.0, 0.0, 9.0], [0.0; 3], [0.0, 1.0, 0.0]).unwrap();
            let camera = Camera::new(view, 40.0, FovAxis::Smaller, [8, 8]).unwrap();
            let scene = build
                .build(camera, Film::new(8, 8), Settings::default())
                .unwrap();
            let values: Vec<f64> = scene
                .params()
                .values()
                .iter()
                .map(|&x| f64::from(x))
                .collect();
            let theta = Theta::<f64>::constant(&values);
            let mut tested = 0;
            for ray in rays(400, 15) {
                let Some(hit) = scene.intersect(&ray) else {
                    continue;
                };
                let prim = hit.prim;
                let SurfaceCoordinates(at) = scene.coordinates(prim, &hit.si);
                let side = if behind { -1.0 } else { 1.0 };
                let look = |at: Vec2<f64>| {
                    let at = SurfaceCoordinates(at);
                    let si = scene.point_at(&theta, prim, at);
                    let wo = si.frame.n * side;
                    let (frame, partials) = scene.mapped_partials(&theta, prim, at, wo, route)?;
                    Some((si, frame, partials))
                };
                let (si, frame, partials) = look(at).expect("texture coordinates");
                let fold = [at.x, at.y, 1.0 - at.x.abs() - at.y.abs()];
                let round = name.ends_with("sphere");
                // Neither where coordinates jump nor where the interpolation of texels bends.
                let bend = |x: f64, n: [f64; 2]| {
                    n.iter()
                        .any(|n| ((x * n - 0.5) - (x * n - 0.5).round()).abs() < 1e-3)
                };
                let edge = |x: f64| x.min(1.0 - x) < 0.06;
                if (round && fold.iter().any(|x| x.abs() < 1e-3))
                    || edge(si.uv.x)
                    || edge(si.uv.y)
                    || bend(si.uv.x, [5.0, 3.0])
                    || bend(si.uv.y, [4.0, 6.0])
                {
                    continue;
                }
                tested += 1;
                assert!((frame.n.length() - 1.0).abs() < 1e-6, "{name}");
                assert!(frame.n.dot(si.frame.n) > 0.0, "{name}");
                assert!((frame.n - si.frame.n).length() > 1e-3, "{name}: not mapped");
                for k in 0..2 {
                    let point = |h: f64| {
                        let mut at = at.to_array();
                        at[k] += h;
                        look(at.into()).unwrap()
                    };
                    let (above, below) = (point(STEP), point(-STEP));
                    let du = (above.0.uv.x - below.0.uv.x) * (0.5 / STEP);
                    let dv = (above.0.uv.y - below.0.uv.y) * (0.5 / STEP);
                    for (x, y, x_u, x_v) in [
                        (above.1.n, below.1.n, partials.dn_du, partials.dn_dv),
                        (above.1.s, below.1.s, partials.ds_du, partials.ds_dv),
                        (above.0.p, below.0.p, partials.dp_du, partials.dp_dv),
                    ] {
                        let off = (x_u * du + x_v * dv - (x - y) * (0.5 / STEP)).length();
                        let scale = 1.0 + (x_u * du).length() + (x_v * dv).length();
                        assert!(
                            off < 1e-6 * scale,
                            "{name}, {composite}: off by {off:e} of {scale}"
                        );
                    }
                }
            }
            assert!(tested > 15, "{name}, {composite}: {tested}");
        }
    }
}
