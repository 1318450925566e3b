//! Where interpolated normals of a lamp turn away, within faces: it sends light on one side of its shading normal only.
//!
//! With the shading normal `n` at a point `y` of the lamp, and the unit direction `omega` from there to a receiver `x`, that
//! is where `n . omega = 0`. As things move, light appears that the receiver did not see, by
//!
//! `dI = integral over the lamp and over directions at right angles to n of f L |cos_y| (n . omega)'`,
//!
//! with `(n . omega)' = n . (x' - y') / |x - y| + n' . omega`, for the material of the lamp stays, and so does the film. A
//! point of the lamp and a direction in that plane are a sample; the ray goes on to the receiver, and that is connected to
//! the camera, as with outlines of [`shadows`](super::shadows).
//!
//! # Does not handle
//! Receivers that the camera sees in others.

use std::f64::consts::TAU;

use ad_core::Float;

use super::super::tile::on_lens;
use super::form::{Contribution, Form, Mover, Term};
use super::{Boundary, Source, wide};
use crate::emitter::{Emission, Emitter};
use crate::math::RayAdjoint;
use crate::params::Theta;
use crate::sampler::{Family, Points, Sampler, Spread};

impl<P: Float> Boundary<'_, P> {
    /// Sample `index` of where lamps turn away: where on the film, and of what.
    pub(super) fn at_turn(&self, index: u64) -> Option<([f64; 2], Contribution<P>)> {
        let scene = self.context.scene;
        let count = self.per_sample(Source::Turns) as f64;
        let mut sampler = Spread::spread(
            Points::Sobol,
            Family::TurnsOfLights.seed(self.seed),
            0,
            index,
        );
        let on_light: [P; 2] = sampler.next_2d();
        let turn: f64 = sampler.next_1d();
        let (light, weight) = self.turning.choose(sampler.next_1d())?;
        let lens = on_lens(scene, sampler);
        let emitter = &scene.emitters()[light as usize];
        let start = self.start(emitter, on_light)?;
        let (prim, shape, si) = start.surface?;
        if si.frame.n == si.n_geo {
            return None;
        }
        let (sin, cos) = (TAU * turn).sin_cos();
        let plane = [si.frame.s, si.frame.t].map(wide);
        let direction = plane[0] * cos + plane[1] * sin;
        let d = direction.map(P::of).normalize();
        // As from just before the normal.
        let facing: Option<(Emission<P>, P)> = emitter.leaves(si.frame.n, Some(&si));
        let le = emitter.eval(self.context.theta, &facing?.0);
        if le.is_black() {
            return None;
        }

        // ---- What it lights, as the camera sees that ----
        let ray = si.spawn_ray(d, scene.exit(prim));
        let hit = scene.seen(&ray, self.context.settings.hides(2))?;
        let hit = scene.interaction(&Theta::still(), &ray, &hit);
        let far = (wide(hit.si.p) - wide(si.p)).length().recip();
        let receiver = self.receiver(&ray, hit, lens)?;
        let cos_light = wide(si.n_geo).dot(direction).abs();
        let weight = weight * start.weight * TAU * cos_light * receiver.area / count;

        // ---- How fast its normal turns ----
        let n = wide(si.frame.n);
        let mut form: Form<P> = (self.of_receiver(&receiver, n * far)).into_iter().collect();
        if self.moving.shapes[shape as usize] {
            form.push(Term {
                mover: Mover::Material(prim, si),
                along: RayAdjoint {
                    o: (n * -far).map(P::of),
                    d,
                },
            });
        }
        let value = (receiver.f * le).scale(P::of(weight));
        (!form.is_empty()).then_some((receiver.at(), Contribution { value, form }))
    }
}
