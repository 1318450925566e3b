//! What auxiliary rays find of outlines.

use std::path::Path;

use ad_core::{Float, Vec3};
use render::Scene;
use render::integrator::reparameterisation::freeze;
use render::math::{Frame, Ray};
use render::sampler::{Independent, Sampler, Stream};
use render::scene::LoadOptions;

/// One pair of auxiliary rays, 0.0115 radian from the direction, turned about it by so many turns.
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
    for k in 0..20 {
        let height = -0.95 + 0.025 * f64::from(k);
        let towards = Vec3::new(edge.x, height, edge.z) - origin;
        let d = (towards.normalize() + off * 0.005).normalize();
        let b = |turns: f64| {
            let (ray, w) = (Ray::new(origin, d), frame.to_local(d));
            freeze(&scene, &ray, &frame, w, 2, &mut Turned(turns)).b
        };
        // One of both rays meets the box, or none.
        let all = (0..64).map(|i| (f64::from(i) / 128.0, b(f64::from(i) / 128.0)));
        let (mut met, seen) = all.clone().find(|(_, b)| *b > 0.0).expect("met");
        let (mut missed, _) = all.clone().find(|(_, b)| *b == 0.0).expect("missed");
        while (met - missed).abs() > 1e-12 {
            let middle = 0.5 * (met + missed);
            if b(middle) > 0.0 {
                met = middle;
            } else {
                missed = middle;
            }
        }
        // Single precision tells turns apart by about 1e-6.
        for i in -2000..2000 {
            let found = b(met + 2e-9 * f64::from(i));
            assert!(
                found == 0.0 || found == seen,
                "{height}: {found} instead of {seen} or 0"
            );
        }
    }
}
