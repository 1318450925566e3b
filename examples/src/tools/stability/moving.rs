//! Scenes in which something moves, and their derivatives: in closed form, or by an integral along an outline in f64.

use std::f64::consts::{PI, TAU};

use ad_core::{Dual, Real, Vec3};
use render::bsdf::microfacet::Ndf;
use render::emitter::Point;
use render::math::Frame;
use render::shape::{Mesh, MeshData, Sphere};

use super::setup::{DISTANCE, FOV, GAUSS, Light, Plate, SIZE, Setup, Truth, Values, bsdf, plane};
use crate::figure::Result;
use crate::scene_builder::{POSITIVE, SceneBuilder, View};

type D = Dual<f64, 1>;

/// Pixels per side where they are not alike.
const SIDE: u32 = 4;
/// Half the width of their film at the distance 1.
const HALF: f64 = 0.1;
/// Radius of the ball over the floor.
pub const OCCLUDER: f64 = 0.2;
/// Angular radius of the ball above the plate, and the angle of the viewer from the normal, radians: the mirror direction lies
/// on the outline.
const ANGLE: f64 = 0.3;
const INCIDENCE: f64 = 0.5;
/// Reflectance of the white ball.
pub const WHITE: f64 = 0.8;
/// How far from its centre the bulb hangs, away from the viewer, over its radius.
const BULB: f64 = 0.5;

fn closed(value: f64, slope: f64) -> Truth {
    Truth {
        value,
        slope,
        error: 0.0,
        std: None,
    }
}

/// The camera of images whose pixels differ: it looks at the origin from the distance [`DISTANCE`].
fn view() -> View {
    View {
        eye: [0.0, 0.0, DISTANCE],
        target: [0.0; 3],
        fov: 2.0 * HALF.atan().to_degrees(),
        size: [SIDE; 2],
    }
}

fn ready(
    stage: SceneBuilder,
    view: &View,
    depth: u32,
    param: &'static str,
    truth: Truth,
) -> Result<Setup> {
    let mut scene = stage.finish(view, depth)?;
    scene.film.filter = render::film::PixelFilter::Box;
    scene.make_movable(&[param])?;
    let values = if view.size == [SIZE; 2] {
        Values::Pixels
    } else {
        Values::Images
    };
    Ok(Setup {
        scene,
        truth,
        param,
        values,
    })
}

/// A ball of radiance 1 before black that grows; its radius on the film is that of so many pixels.
///
/// # Errors
/// No radius.
pub fn silhouette(pixels: f64) -> Result<Setup> {
    let mut stage = SceneBuilder::default();
    let black = stage.matt("black", [0.0; 3])?;
    let tan = pixels * 2.0 * HALF / f64::from(SIDE);
    // A ball on the axis is a disk on the film, of the tangent of its angular radius, whose sine goes with the radius.
    let sin2 = tan * tan / (1.0 + tan * tan);
    let ball = stage.ball("ball", [0.0; 3], DISTANCE * sin2.sqrt(), &black)?;
    stage.lamp("ball", ball, [1.0; 3])?;
    let film = 4.0 * HALF * HALF;
    let value = PI * tan * tan / film;
    let slope = 2.0 * PI * sin2 / (1.0 - sin2).powi(2) / film;
    ready(stage, &view(), 2, "ball.scale", closed(value, slope))
}

/// A black ball over a white floor below an even sky that rises; its centre is at this height over its radius.
///
/// # Errors
/// No radius.
pub fn contact(height: f64) -> Result<Setup> {
    let mut stage = SceneBuilder::default();
    let floor = stage.matt("floor", [1.0; 3])?;
    let black = stage.matt("black", [0.0; 3])?;
    plane(&mut stage, "plane", &floor)?;
    let center = [0.0, 0.0, height * OCCLUDER];
    stage.ball("ball", center, OCCLUDER, &black)?;
    stage.ambient([1.0; 3])?;
    let (sin, cos) = 80f64.to_radians().sin_cos();
    let view = View {
        eye: [DISTANCE * sin, 0.0, DISTANCE * cos],
        target: [0.0; 3],
        fov: FOV,
        size: [SIZE; 2],
    };
    // Straight above, a ball hides the square of the sine of its angular radius. Along the floor, it changes nothing.
    let truth = closed(1.0 - height.powi(-2), 2.0 * height.powi(-3) / OCCLUDER);
    ready(stage, &view, 2, "ball.translation", truth)
}

/// A metal plate of this roughness (GGX) below an even sky, part of which a black ball hides that moves along the sum of the
/// axes; the viewer sees its outline in the plate.
///
/// # Errors
/// A roughness out of range.
pub fn reflection(alpha: f64) -> Result<Setup> {
    let mut stage = SceneBuilder::default();
    let plate = Plate {
        kind: Ndf::Ggx,
        alpha,
        incidence: INCIDENCE,
        light: Light::Constant,
    };
    plate.place(&mut stage, true)?;
    let black = stage.matt("black", [0.0; 3])?;
    let tilt = INCIDENCE - ANGLE;
    let axis = Vec3::new(-tilt.sin(), 0.0, tilt.cos());
    let center = (axis * DISTANCE).to_array();
    stage.ball("ball", center, DISTANCE * ANGLE.sin(), &black)?;
    stage.ambient([1.0; 3])?;
    let wo = plate.wo();
    let view = View {
        eye: (wo * DISTANCE).to_array(),
        target: [0.0; 3],
        fov: FOV,
        size: [SIZE; 2],
    };
    let surface = plate.surface(alpha, true);
    let f = |w: Vec3<f64>| bsdf(&surface, wo, w, (wo + w).normalize());
    let value = plate.setup()?.truth.value - hidden(&f);
    let truth = closed(value, -along_outline(axis, &f));
    ready(stage, &view, 2, "ball.translation", truth)
}

/// The integral of `f` over what the ball hides, in rings around the mirror direction that widen from less than a lobe.
fn hidden(f: &dyn Fn(Vec3<f64>) -> f64) -> f64 {
    let mirror = Vec3::new(-INCIDENCE.sin(), 0.0, INCIDENCE.cos());
    let around = Frame::from_normal(mirror);
    let tilt = INCIDENCE - ANGLE;
    let axis = around.to_local(Vec3::new(-tilt.sin(), 0.0, tilt.cos()));
    let first = axis.y.atan2(axis.x);
    let (mut sum, mut inner) = (0.0, 0.0);
    while inner < 2.0 * ANGLE {
        let outer: f64 = (1.05 * inner + 1e-5f64).min(2.0 * ANGLE);
        for (x, weight) in GAUSS {
            let r = inner + (outer - inner) * (0.5 + 0.5 * x);
            let (sin, cos) = r.sin_cos();
            // The part of the ring that is nearer to the axis than the outline.
            let open = (ANGLE.cos() * (1.0 - cos) / (sin * ANGLE.sin())).clamp(-1.0, 1.0);
            let widest = open.acos();
            for (y, share) in GAUSS {
                let (sin_phi, cos_phi) = (first + widest * y).sin_cos();
                let w = around.to_world(Vec3::new(sin * cos_phi, sin * sin_phi, cos));
                sum += 0.5 * (outer - inner) * weight * sin * widest * share * f(w);
            }
        }
        inner = outer;
    }
    sum
}

/// The integral of `f` along the outline of the ball, times the speed of the outline out of the ball as it moves along
/// the sum of the axes: periodic, so that even points converge fast.
fn along_outline(axis: Vec3<f64>, f: &dyn Fn(Vec3<f64>) -> f64) -> f64 {
    let velocity = Vec3::new(1.0, 1.0, 1.0);
    let around = Frame::from_normal(axis);
    let (sin, cos) = ANGLE.sin_cos();
    let receding = velocity.dot(axis);
    let turn = (velocity - axis * receding) * (1.0 / DISTANCE);
    let shrink = -sin * receding / (DISTANCE * cos);
    let count = 1 << 17;
    let at = |i: u32| {
        let (y, x) = (TAU * f64::from(i) / f64::from(count)).sin_cos();
        let out = around.to_world(Vec3::new(x, y, 0.0));
        f(axis * cos + out * sin) * (turn.dot(out) + shrink)
    };
    (0..count).map(at).sum::<f64>() * sin * TAU / f64::from(count)
}

/// The inside of a white ball that moves along the sum of the axes around a bulb that does not hang in its centre, up to so
/// many edges.
///
/// # Errors
/// None.
pub fn bounces(depth: u32) -> Result<Setup> {
    let mut stage = SceneBuilder::default();
    let white = stage.matt("white", [WHITE; 3])?;
    let ball = Sphere::new([0.0; 3], 1.0, true).ok_or("no ball")?;
    stage.shape("ball", ball, &white);
    let intensity = stage
        .build
        .rgb("bulb.intensity.value", [1.0; 3], POSITIVE)?;
    let bulb = Point::new(intensity, [-BULB as f32, 0.0, 0.0]);
    stage.build.add_emitter(bulb, None);
    let view = View {
        eye: [0.0; 3],
        target: [1.0, 0.0, 0.0],
        ..view()
    };
    // All of the ball's inside sees all of it alike, so that light is even from the second bounce on, wherever the bulb hangs.
    let even: f64 = (1..depth.saturating_sub(1))
        .map(|k| WHITE.powi(k as i32))
        .sum();
    // The middle of the film to second order, and its corners to fourth: Simpson's rule.
    let mut direct = D::zero();
    let rule = [(-1.0, 1.0 / 6.0), (0.0, 4.0 / 6.0), (1.0, 1.0 / 6.0)];
    for (x, a) in rule {
        for (y, b) in rule {
            let toward = Vec3::new(1.0, HALF * x, HALF * y);
            direct += below_the_bulb(toward.normalize()) * D::c(a * b);
        }
    }
    let truth = Truth {
        error: 1e-5 * direct.eps[0].abs(),
        ..closed(WHITE / PI * (direct.re + even), WHITE / PI * direct.eps[0])
    };
    ready(stage, &view, depth, "ball.translation", truth)
}

/// The irradiance of the bulb where a ray from the origin meets the white ball, as that moves along the sum of the axes.
fn below_the_bulb(w: Vec3<f64>) -> D {
    let w = Vec3::<D>::lift(w);
    let centre = Vec3::new(D::var(0.0, 0), D::var(0.0, 0), D::var(0.0, 0));
    let along = w.dot(centre);
    let p = w * (along + (D::one() - centre.dot(centre) + along * along).sqrt());
    let to = Vec3::<D>::lift(Vec3::new(-BULB, 0.0, 0.0)) - p;
    (centre - p).dot(to) / (to.dot(to) * to.dot(to).sqrt())
}

/// A convex solid of radiance 1 and so many flat faces (8, 32, 128 ..) before black, as large as 1.5 pixels, that grows.
///
/// # Errors
/// None.
pub fn facets(faces: usize) -> Result<Setup> {
    let mut stage = SceneBuilder::default();
    let black = stage.matt("black", [0.0; 3])?;
    let radius = DISTANCE * 1.5 * 2.0 * HALF / f64::from(SIDE);
    let solid = solid(faces, radius);
    let truth = projected(&solid);
    let shape = stage.shape("solid", Mesh::new(solid, false)?, &black);
    stage.lamp("solid", shape, [1.0; 3])?;
    ready(stage, &view(), 2, "solid.scale", truth)
}

/// An octahedron whose triangles are cut into four until there are so many, with all corners on a sphere.
fn solid(faces: usize, radius: f64) -> MeshData {
    let corners = [0, 1, 2].map(|axis| {
        [1.0, -1.0].map(|sign| {
            let mut p = [0.0; 3];
            p[axis] = sign;
            Vec3::from(p)
        })
    });
    let mut triangles: Vec<[Vec3<f64>; 3]> = Vec::new();
    for i in 0..8usize {
        let [a, b, c] = [0, 1, 2].map(|axis: usize| corners[axis][i >> axis & 1]);
        let mirrored = i.count_ones() % 2 == 1;
        triangles.push(if mirrored { [a, c, b] } else { [a, b, c] });
    }
    while triangles.len() < faces {
        let cut = |[a, b, c]: [Vec3<f64>; 3]| {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| (p + q).normalize());
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        triangles = triangles.into_iter().flat_map(cut).collect();
    }
    // Turned, so that no edge is seen along its faces.
    let turn = Frame::from_normal(Vec3::new(0.36, 0.48, 0.8));
    let mut mesh = MeshData::default();
    for triangle in triangles {
        let first = mesh.positions.len() as u32;
        let place = |p: Vec3<f64>| (turn.to_world(p) * radius).to_array().map(|x| x as f32);
        mesh.positions.extend(triangle.map(place));
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    mesh
}

/// Part of the film that a convex solid around the origin covers, and its derivative as it grows: half of what its faces
/// cover.
fn projected(solid: &MeshData) -> Truth {
    let scale = D::var(1.0, 0);
    let film = |i: u32| {
        let p = solid.positions[i as usize].map(f64::from);
        let depth = D::c(DISTANCE) - scale * D::c(p[2]);
        [p[0], p[1]].map(|x| scale * D::c(x) / depth)
    };
    let mut sum = D::zero();
    for t in &solid.triangles {
        let [a, b, c] = t.map(film);
        let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        if area.re > 0.0 {
            sum += area;
        }
    }
    let covered = sum * D::c(0.5 / (4.0 * HALF * HALF));
    closed(covered.re, covered.eps[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Many faces cover what the ball around them does, and grow as it does.
    #[test]
    fn many_faces_are_a_ball() {
        let solid = solid(1 << 17, 0.3);
        let (truth, area) = (projected(&solid), 4.0 * HALF * HALF);
        let sin2 = (0.3 / DISTANCE).powi(2);
        let covered = PI * sin2 / (1.0 - sin2) / area;
        let slope = 2.0 * PI * sin2 / (1.0 - sin2).powi(2) / area;
        assert!((truth.value / covered - 1.0).abs() < 1e-3, "{truth:?}");
        assert!((truth.slope / slope - 1.0).abs() < 1e-3, "{truth:?}");
    }

    /// The solid angle of the ball, and how it changes: only its distance matters, as everything scatters alike.
    #[test]
    fn outlines_of_balls() {
        let even = |_| 1.0;
        assert!((hidden(&even) / (TAU * (1.0 - ANGLE.cos())) - 1.0).abs() < 1e-4);
        let tilt = INCIDENCE - ANGLE;
        let axis = Vec3::new(-tilt.sin(), 0.0, tilt.cos());
        let receding = Vec3::new(1.0, 1.0, 1.0).dot(axis);
        let slope = -TAU * ANGLE.sin() * ANGLE.tan() / DISTANCE * receding;
        assert!((along_outline(axis, &even) / slope - 1.0).abs() < 1e-9);
    }

    /// Straight on, at one and a half of the radius from the bulb.
    #[test]
    fn light_of_a_bulb() {
        let found = below_the_bulb(Vec3::new(1.0, 0.0, 0.0));
        let far = 1.0 + BULB;
        assert!((found.re * far * far - 1.0).abs() < 1e-12);
        assert!((found.eps[0] * far.powi(3) + 2.0).abs() < 1e-12);
    }

    /// The ball's shadow is its cosine-weighted solid angle over pi.
    #[test]
    fn a_ball_at_the_floor_hides_nearly_all() {
        let truth = contact(1.01).unwrap().truth;
        assert!(truth.value > 0.0 && truth.value < 0.02, "{truth:?}");
    }
}
