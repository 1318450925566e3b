//! Particles aimed at what throws caustics: few would meet it by chance.

use std::f64::consts::PI;

use ad_core::{Float, Vec3};

use crate::emitter::{AnyEmitter, Ball, EmittedRay, Emitter};
use crate::math::{Frame, Ray, each, warp};

/// The cone that a ball fills: its axis, and one minus the cosine of its half angle. `None` from within.
fn cone<P: Float>(ball: &Ball, from: Vec3<P>) -> Option<(Vec3<P>, P)> {
    let to = Vec3::from(each(ball.centre, P::of)) - from;
    let (d2, r) = (to.length_squared(), P::of(ball.radius));
    let sin2 = r * r / d2;
    (sin2 < P::one()).then(|| {
        let axis = to * d2.sqrt().recip();
        (axis, sin2 / (P::one() + (P::one() - sin2).sqrt()))
    })
}

/// Of a mixture in which every ball has the same share.
fn mean<P: Float>(balls: &[Ball], density: impl Fn(usize, &Ball) -> P) -> P {
    let each = balls.iter().enumerate().map(|(i, ball)| density(i, ball));
    each.fold(P::zero(), |a, b| a + b) * P::of((balls.len() as f64).recip())
}

/// Turns a particle towards the ball number `which`: `start` is as the emitter would send it, `u` are fresh numbers.
/// Its density is that of a mixture over all balls, and positive wherever a particle could meet one first.
/// `None` where nothing is emitted.
///
/// Light from points and surfaces gets another direction, towards the ball, unless it starts within; light from
/// environments keeps its direction and gets another origin, beyond the ball `around` the scene. Beams stay as they are.
///
/// # Reference
/// Projection maps [Jensen 1996], with balls in place of a grid.
pub(super) fn turn_to_casters<P: Float>(
    emitter: &AnyEmitter,
    around: Option<Ball>,
    balls: &[Ball],
    which: usize,
    start: EmittedRay<P>,
    u: [P; 2],
) -> Option<EmittedRay<P>> {
    if emitter.is_infinite() {
        let d = start.ray.d;
        let centre = |ball: &Ball| Vec3::from(each(ball.centre, P::of));
        let disc = warp::square_to_disk(u) * P::of(balls[which].radius);
        let frame = Frame::from_normal(d);
        let p = centre(&balls[which]) + frame.to_world(Vec3::new(disc.x, disc.y, P::zero()));
        let density = |i: usize, ball: &Ball| {
            let (across, r2) = (
                frame.to_local(centre(ball) - p),
                P::of(ball.radius * ball.radius),
            );
            let meets = across.x * across.x + across.y * across.y <= r2;
            if meets || i == which {
                (P::of(PI) * r2).recip()
            } else {
                P::zero()
            }
        };
        return Some(EmittedRay {
            ray: Ray::new(p - d * P::of(3.0 * around?.radius), d),
            pdf_position: mean(balls, density),
            ..start
        });
    }
    // There is nowhere to turn, and no ball has a share of its own.
    if emitter.is_beam() {
        return Some(start);
    }
    let from = start.ray.o;
    let d = match cone(&balls[which], from) {
        Some((axis, opening)) => {
            Frame::from_normal(axis).to_world(warp::square_to_cone(u, opening))
        }
        None => start.ray.d,
    };
    let (emission, own) = emitter.leaves(d, start.surface.as_ref().map(|(_, si)| si))?;
    let density = |i: usize, ball: &Ball| match cone(ball, from) {
        None => own,
        // One minus the cosine, without cancellation.
        Some((axis, opening)) => {
            let within = (d - axis).length_squared() * P::of(0.5) <= opening;
            if within || i == which {
                (P::of(2.0 * PI) * opening).recip()
            } else {
                P::zero()
            }
        }
    };
    Some(EmittedRay {
        ray: Ray::new(from, d),
        pdf_direction: mean(balls, density),
        emission,
        ..start
    })
}
