//! What auxiliary rays find of outlines.

use std::f64::consts::TAU;
use std::path::Path;

use ad_core::{Float, Vec3};
use render::Scene;
use render::integrator::reparameterisation::{OUTLINE_WIDTH, freeze};
use render::math::{Frame, Ray};
use render::sampler::{Independent, Sampler, Stream};
use render::scene::LoadOptions;

/// One pair of auxiliary rays in the middle of their ring, turned about the direction by so many turns.
#[derive(Clone, Copy)]
struct Turned(f64);

impl Sampler for Turned {
    fn new(_seed: u64, _pixel: u64, _index: u64) -> Self {
        Self(0.0)
    }
    fn stream(&self) -> Stream {
        Independent::new(0, 0, 0).stream()
    }
    fn seek(&mut self, _dim: u32) {}
    fn next_bits(&mut self) -> u64 {
        0
    }
    fn next_2d<P: Float>(&mut self) -> [P; 2] {
        [P::of(0.5), P::of(self.0)]
    }
}

/// How far these rays are from the direction, radians.
fn angle() -> f64 {
    OUTLINE_WIDTH / 30.0 * 300f64.sqrt()
}

/// An upright edge of a box is an outline of two faces, of which one is turned away. Rays that pass it by less than rounding
/// meet the other one, which no ray meets else: `B` is that of the face that is seen, and that of nothing beyond it.
#[test]
fn faces_that_only_rounding_meets_count_nothing() {
    let text = "<scene version=\"3.0.0\"><sensor type=\"perspective\"/>
        <shape type=\"cube\"><transform name=\"to_world\"><scale x=\"0.28\" y=\"0.3\" z=\"0.28\"/>
        <rotate y=\"1\" angle=\"-17\"/><translate x=\"0.38\" y=\"-0.7\" z=\"0.3\"/></transform></shape></scene>";
    let (scene, _) = Scene::from_xml(text, Path::new("."), &LoadOptions::default()).unwrap();
    let origin = Vec3::new(-0.3, -1.0 + 1e-4, 0.5);
    let frame = Frame::from_normal(Vec3::new(0.0, 1.0, 0.0));
    // The edge of the faces towards -x and -z, and the way off the box at right angles to it.
    let edge = Vec3::new(0.1941, 0.0, -0.0497);
    let off = Vec3::new(-0.5497, 0.0, -0.4941).normalize();
    // The face towards -z is the last of six.
    const AWAY: u32 = 5;
    let mut by_rounding = 0;
    for k in 0..20 {
        let height = -0.95 + 0.025 * f64::from(k);
        let towards = Vec3::new(edge.x, height, edge.z) - origin;
        let d = (towards.normalize() + off * 0.005).normalize();
        let b = |turns: f64| {
            let (ray, w) = (Ray::new(origin, d), frame.to_local(d));
            freeze(&scene, &ray, &frame, w, 2, &mut Turned(turns)).b
        };
        let met = |turns: f64| {
            let ((sin, cos), (y, x)) = (angle().sin_cos(), (TAU * turns).sin_cos());
            let around = Frame::from_normal(frame.to_local(d));
            [sin, -sin].into_iter().find_map(|sin| {
                let w = around.to_world(Vec3::new(sin * x, sin * y, cos));
                let hit = scene.nearest(&Ray::new(origin, frame.to_world(w)));
                hit.map(|hit| hit.prim)
            })
        };
        // One of both rays meets the box, or none.
        let all = (0..64).map(|i| f64::from(i) / 128.0);
        let mut on = all.clone().find(|turns| b(*turns) > 0.0).expect("met");
        let mut beside = all
            .clone()
            .find(|turns| met(*turns).is_none())
            .expect("missed");
        let seen = b(on);
        while (on - beside).abs() > 1e-12 {
            let middle = 0.5 * (on + beside);
            if met(middle).is_some() {
                on = middle;
            } else {
                beside = middle;
            }
        }
        // Single precision tells turns apart by about 1e-6.
        for i in -2000..2000 {
            let turns = on + 2e-9 * f64::from(i);
            let found = b(turns);
            by_rounding += u32::from(met(turns) == Some(AWAY));
            assert!(
                found == 0.0 || found == seen,
                "{height}: {found} instead of {seen} or 0"
            );
        }
    }
    assert!(by_rounding > 0, "no ray met the face that is turned away");
}
