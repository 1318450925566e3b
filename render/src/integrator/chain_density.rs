//! Light over specular chains by particles: what manifold connections are checked against.
//!
//! Particles go from lights over casters and are kept where they land on receivers. Paths from the camera are those that
//! connections start from; at every receiver they collect particles instead of being connected. So both sides see the same
//! light, that of chains alone, at any depth and through any glass, from lights of any size. They share neither walks nor
//! geometric terms nor trials: here chains are scattered, and counted where they end.

use std::f64::consts::PI;

use ad_core::{Float, Vec2, Vec3};

use super::Job;
use super::connections::{Scattering, still};
use super::density::{Keeps, Landed, Map, land};
use super::particle::{Context, ParticleObserver};
use super::pass::Pass;
use super::paths::{TileSums, assemble, deposit};
use super::record::{Contribution, Interest, Observer, Place};
use super::rendering::{Components, NonFinite, Rendering};
use super::tile::{place, start};
use super::vertex::MODE;
use crate::bsdf::{Bsdf, Shading};
use crate::error::RenderError;
use crate::manifold::Split;
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::Sampler;
use crate::scene::{ChainKind, Scene, Settings};

/// Within the radius there are this many particles around half of all particles.
const NEIGHBOURS: usize = 8;
/// So many particles are asked for their neighbours.
const ASKED: usize = 64;

/// Light over chains, as particles have it.
#[derive(Clone, Debug)]
pub struct ChainLight {
    /// Its image.
    pub image: Rendering,
    /// Radius of the kernel that it is blurred by on receivers, world space; none if no particle landed.
    pub radius: Option<f64>,
}

/// Follows a particle over casters to a receiver.
#[derive(Clone, Debug)]
struct ChainKeeper<'a, P: Float> {
    scene: &'a Scene,
    split: &'a Split,
    /// What happened at casters so far, seen from its end, as long as it is on a chain; and whether it is at one.
    events: Option<ChainKind>,
    at_caster: bool,
    /// The last of them: its index, its material, and the side that the particle came from.
    last: (u32, u32, P),
    landed: Vec<Landed<P>>,
}

impl<P: Float> Interest for ChainKeeper<'_, P> {}

impl<P: Float> Observer<P> for ChainKeeper<'_, P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        let Some(events) = self.events else {
            return;
        };
        let casters = events.vertices();
        self.at_caster = self.split.takes_particle(casters, place.shape);
        if casters > 0 && self.split.lands(events, self.last.0, place.shape) {
            self.landed.push(Landed::at(place, beta, casters + 1));
        }
        if !self.at_caster {
            self.events = None;
        }
        let material = self.scene.shape_info(place.shape).material;
        self.last = (place.shape, material, place.wo.z);
    }

    fn contribution(&mut self, contribution: Contribution<P>) {
        if let Contribution::Emitted(light) = contribution {
            let connected = self.split.is_connected(light.emitter);
            (self.events, self.at_caster) = (connected.then_some(ChainKind::NONE), false);
        }
        if let (Contribution::Scattered(bounce), true) = (&contribution, self.at_caster) {
            let (_, material, wo_z) = self.last;
            let reflects = wo_z * bounce.wi.z > P::zero();
            let kept = (self.events).filter(|_| self.split.keeps_particle(material, reflects));
            self.events = kept.map(|events| events.after(!reflects));
        }
    }
}

impl<P: Float> ParticleObserver<P> for ChainKeeper<'_, P> {
    const CONNECTS: bool = false;
}

impl<P: Float> Keeps<P> for ChainKeeper<'_, P> {
    fn kept(&mut self) -> &mut Vec<Landed<P>> {
        &mut self.landed
    }
}

/// Collects particles at the receivers of a path that looks for no light.
struct Collecting<'a, P: Float> {
    scene: &'a Scene,
    theta: &'a Theta<'a, P>,
    split: &'a Split,
    map: &'a Map<P>,
    max_depth: u32,
    /// Edges so far.
    depth: u32,
    l: Rgb<P>,
}

impl<P: Float> Interest for Collecting<'_, P> {
    const LIGHT: bool = false;
}

impl<P: Float> Observer<P> for Collecting<'_, P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.depth += 1;
        if !self.split.is_receiver(place.shape) {
            return;
        }
        let si = &place.si;
        let material = self.scene.material(place.shape);
        let at = Shading::new(*self.theta, Vec2::new(si.uv.x, si.uv.y));
        let mut sum = Rgb::black();
        self.map.near(si.p, si.n_geo, |l, kernel| {
            if l.shape != place.shape || l.depth + self.depth > self.max_depth {
                return;
            }
            // Their power is per area already.
            let cos = l.wi.dot(si.n_geo).abs();
            if cos > P::zero() {
                let wi: Vec3<P> = si.frame.to_local(l.wi);
                let weight = extrapolated(kernel, self.map.radius) / cos;
                sum += material.eval(&at, place.wo, wi, MODE) * l.power * weight;
            }
        });
        let sent = P::of(self.map.sent().max(1) as f64);
        self.l += beta * sum * sent.recip();
    }
}

/// Twice the kernel of half the radius less that of the radius: where light and what is seen end sharply at the same place, a
/// kernel loses light in proportion to its radius, and this one does not.
fn extrapolated<P: Float>(kernel: P, radius: P) -> P {
    // One minus the squared distance over that of the radius, and over that of its half.
    let whole = kernel * radius * radius * P::of(0.5 * PI);
    let half = (P::of(4.0) * whole - P::of(3.0)).max(P::zero());
    P::of(2.0 / PI) / (radius * radius) * (P::of(8.0) * half - whole)
}

/// A radius that holds a few particles around most of them: so that it shrinks as there are more, and is small where
/// light is. `None` where there are too few to say.
fn radius<P: Float>(landed: &[Landed<P>]) -> Option<f64> {
    let step = (landed.len() / ASKED).max(1);
    let asked: Vec<_> = landed.iter().step_by(step).take(ASKED).collect();
    let mut distances = parallel::map(asked.len(), |i| {
        let mut nearest = [f64::INFINITY; NEIGHBOURS + 1];
        for l in landed.iter().filter(|l| l.shape == asked[i].shape) {
            let d2 = (l.p - asked[i].p).length_squared().to_f64();
            // Itself is the nearest of them.
            let rank = nearest.partition_point(|&n| n <= d2);
            if rank <= NEIGHBOURS {
                nearest[rank..].rotate_right(1);
                nearest[rank] = d2;
            }
        }
        nearest[NEIGHBOURS].sqrt()
    });
    distances.sort_by(f64::total_cmp);
    let median = *distances.get(distances.len() / 2)?;
    (median > 0.0 && median.is_finite()).then_some(median)
}

/// The light of manifold connections as `settings` has them, whatever their method, by so many particles instead.
///
/// It is convolved with a kernel on receivers, whose radius follows from how densely particles land. Means over parts of the
/// image that are much larger are right but for what goes over their borders; what a plain kernel would lose along edges and
/// shadows is extrapolated away, so that single values may be negative. The same for any number of threads; 64 bytes or so
/// per particle.
///
/// # Errors
/// Normals that are flipped to the viewer, whom particles do not know; more particles than there are numbers for.
pub fn image<P: Float + Components, X: Sampler>(
    job: &Job,
    theta: &Theta<P>,
    particles: u64,
) -> Result<ChainLight, RenderError> {
    let pass = Pass::of::<Scattering>(job, theta);
    let &Pass {
        scene,
        seed,
        progress,
        ..
    } = &pass;
    if scene.flips_normals() {
        return Err(RenderError::FlippedNormals);
    }
    let black = || Rendering::black(scene.film.crop_size, &pass.samples, P::COUNT);
    let nothing = || ChainLight {
        image: black(),
        radius: None,
    };
    let Some(split) = pass.split.as_deref().filter(|s| s.connects()) else {
        return Ok(nothing());
    };
    // ---- Particles ----
    let shallow = Settings {
        max_depth: pass.settings.max_depth.min(split.bounces() + 2),
        ..*pass.settings
    };
    let context = Context {
        progress,
        ..Context::caustics(scene, theta, &shallow)
    };
    let keeper = ChainKeeper {
        scene,
        split,
        events: None,
        at_caster: false,
        last: (0, 0, P::zero()),
        landed: Vec::new(),
    };
    let (landed, non_finite) = land::<P, X, _>(&context, &keeper, seed, 0..particles);
    let Some(radius) = radius(&landed) else {
        return Ok(nothing());
    };
    let map = Map::of(&landed, radius, particles, non_finite)?;
    // ---- Paths ----
    let (points, context) = (pass.settings.points, still(&pass));
    let spp = job.count() as f64;
    let tiles = pass.tiles();
    let sums: Vec<TileSums> = parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let mut sums = vec![0.0f64; P::COUNT * tile.pixels() * 3];
        let mut non_finite = NonFinite::default();
        let mut collecting = Collecting {
            scene,
            theta,
            split,
            map: &map,
            max_depth: pass.settings.max_depth,
            depth: 0,
            l: Rgb::black(),
        };
        for (at, sample) in tile.samples::<P, X>(scene, points, seed, &pass.samples) {
            if progress.cancelled() {
                return (Vec::new(), NonFinite::default());
            }
            (collecting.depth, collecting.l) = (0, Rgb::black());
            start::<P, Scattering, X>(scene, points, seed, sample.pixel, sample.index)
                .finish(&context, &mut collecting);
            if collecting.l.is_finite() {
                deposit(&mut sums, at, collecting.l, spp * sample.scale());
            } else {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
            }
        }
        progress.advance(tile.pixels() as u64);
        (sums, non_finite)
    });
    let mut image = assemble(&pass, P::COUNT, &sums);
    image.non_finite.merge(&map.non_finite);
    Ok(ChainLight {
        image,
        radius: Some(radius),
    })
}
