//! Particles seen by density estimation: what a pinhole sees in mirrors and through water.
//!
//! Neither paths from the camera (with small or no lights) nor connections of particles to a pinhole find
//! caustics that are seen through a smooth interface. Here particles are kept where they land, and viewing rays
//! follow deltas to the first surface that is none, where they collect the particles within a radius. The
//! estimate is biased: it is the light convolved with a kernel, and the bias shrinks with the square
//! of the radius while the variance grows with one over it.
//!
//! ```
//! use render::Job;
//! use render::bsdf::kernel::Rules;
//! use render::instances::{density_f32, particle_map_f32};
//! use render::integrator::density::Convention;
//! use render::params::Theta;
//!
//! let room = render::scene::room(16, 16)?;
//! let theta = Theta::constant(room.params().values());
//! let job = Job::new(&room, &room.settings, 1, 0..16, &());
//! let image = density_f32(&job, &theta, Rules::default(), Convention::default(), 0.2)?.image(0);
//! assert!(image.data.iter().all(|v| v.is_finite()));
//!
//! // The particles themselves, gathered on the floor.
//! let map = particle_map_f32(&job, &theta, 0.2)?;
//! let floor = map.irradiance([0.0, -1.0, 0.0].into(), [0.0, 1.0, 0.0].into());
//! assert!(floor.count > 0 && floor.value.mean() > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::f64::consts::PI;
use std::ops::Range;

use ad_core::{Float, Vec2, Vec3};

use super::particle::{Context, ParticleObserver, trace_particles};
use super::progress::Progress;
use super::record::{Interest, Observer, Place};
use super::rendering::{Components, NonFinite, Rendering};
use super::tile::tiles;
use super::vertex::interest::PathInterest;
use super::vertex::light::emitters_at;
use super::vertex::roulette::{play, probability};
use crate::bsdf::kernel::{Symmetry, eval_kernel};
use crate::bsdf::{Bsdf, Component, DeltaKind, Shading, TransportMode};
use crate::emitter::Emitter;
use crate::error::RenderError;
use crate::manifold::Statistics;
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Purpose, Sampler};
use crate::scene::Intersection;

/// What viewing rays carry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Convention {
    /// Radiance, scaled by `(eta_i / eta_t)^2` where it is refracted.
    #[default]
    Radiance,
    /// Basic radiance `L / eta^2`, which scatters like importance, without any factor: it is divided by
    /// `eta^2` where light and importance meet, and multiplied by that of the sensor's medium
    /// [Veach 1996, section 3.1.4].
    Basic,
}

/// A particle that landed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Landed<P: Float> {
    pub p: Vec3<P>,
    /// Where it came from, unit, world space.
    pub wi: Vec3<P>,
    pub n_geo: Vec3<P>,
    pub power: Rgb<P>,
    /// Number of edges so far.
    pub depth: u32,
    pub shape: u32,
}

impl<P: Float> Landed<P> {
    /// With so much power, after so many edges.
    pub fn at(place: &Place<P>, power: Rgb<P>, depth: u32) -> Self {
        let si = &place.si;
        Self {
            p: si.p,
            wi: si.frame.to_world(place.wo),
            n_geo: si.n_geo,
            power,
            depth,
            shape: place.shape,
        }
    }
}

/// Keeps where a particle lands, as far as that is of interest.
pub(super) trait Keeps<P: Float>: ParticleObserver<P> + Clone + Sync {
    /// What it has kept since it was last emptied.
    fn kept(&mut self) -> &mut Vec<Landed<P>>;
}

/// Keeps where a particle landed.
#[derive(Clone, Debug)]
struct Keeper<P: Float> {
    landed: Vec<Landed<P>>,
}

impl<P: Float> Interest for Keeper<P> {}

impl<P: Float> Observer<P> for Keeper<P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        let depth = self.landed.len() as u32 + 1;
        self.landed.push(Landed::at(place, beta, depth));
    }
}

impl<P: Float> ParticleObserver<P> for Keeper<P> {
    const CONNECTS: bool = false;
}

impl<P: Float> Keeps<P> for Keeper<P> {
    fn kept(&mut self) -> &mut Vec<Landed<P>> {
        &mut self.landed
    }
}

/// Where the particles of these numbers land on surfaces that are no deltas, as far as `keeper` keeps them, in their order;
/// and those whose power was not finite, which are left out.
pub(super) fn land<P: Float, X: Sampler, K: Keeps<P>>(
    context: &Context<P>,
    keeper: &K,
    seed: u64,
    particles: Range<u64>,
) -> (Vec<Landed<P>>, NonFinite) {
    const CHUNK: u64 = 4096;
    let (scene, progress, n) = (context.scene, context.progress, context.per_sample);
    let jobs = (particles.end - particles.start).div_ceil(CHUNK) as usize;
    let parts = parallel::map(jobs, |job| {
        let start = particles.start + job as u64 * CHUNK;
        let mut landed = Vec::<Landed<P>>::new();
        let mut non_finite = NonFinite::default();
        if progress.cancelled() {
            return (landed, non_finite);
        }
        trace_particles::<P, X, K>(
            context,
            keeper,
            seed,
            start..(start + CHUNK).min(particles.end),
            |_, _, _| {},
            |i, keeper| {
                for l in keeper.kept().drain(..) {
                    if !l.power.is_finite() {
                        non_finite.add(i % n, i / n);
                    } else if !l.power.is_black() && !scene.shape_info(l.shape).delta {
                        landed.push(l);
                    }
                }
            },
        );
        (landed, non_finite)
    });
    let mut non_finite = NonFinite::default();
    for (_, bad) in &parts {
        non_finite.merge(bad);
    }
    let landed = parts.iter().flat_map(|(l, _)| l).copied().collect();
    (landed, non_finite)
}

/// Particles in a hashed grid whose cells are as large as the radius of the kernel.
#[derive(Clone, Debug)]
pub struct Map<P: Float> {
    pub(super) radius: P,
    landed: Vec<Landed<P>>,
    /// Per bucket of cells: where its particles start; one more at the end.
    starts: Vec<u32>,
    /// Particles that were sent.
    sent: u64,
    /// Particles whose power was not finite: left out.
    pub non_finite: NonFinite,
}

/// Light gathered at a point.
#[derive(Clone, Copy, Debug)]
pub struct Density<P: Float> {
    /// Power per area, weighted by the kernel and what `gather` was asked for.
    pub value: Rgb<P>,
    /// Particles within the radius.
    pub count: u32,
}

impl<P: Float> Map<P> {
    /// Sends the particles of the samples `samples` (one per pixel of the full film and sample, as
    /// [`super::particle::render`]), and keeps those on surfaces that are no deltas.
    /// Memory: 64 bytes or so per particle that lands. The same for any number of threads.
    ///
    /// # Errors
    /// A `radius` that is not positive, or so large or small that its square is not; more than 2^32 particles
    /// that land.
    pub fn new<X: Sampler>(
        context: &Context<P>,
        radius: f64,
        seed: u64,
        samples: Range<u64>,
        progress: &dyn Progress,
    ) -> Result<Self, RenderError> {
        let context = &Context {
            progress,
            ..*context
        };
        let n = context.per_sample;
        let particles = samples.start * n..samples.end.max(samples.start) * n;
        let sent = particles.end - particles.start;
        Self::check(radius)?;
        let keeper = Keeper { landed: Vec::new() };
        let (landed, non_finite) = land::<P, X, _>(context, &keeper, seed, particles);
        Self::of(&landed, radius, sent, non_finite)
    }

    /// That a radius is one.
    fn check(radius: f64) -> Result<P, RenderError> {
        let radius_p = P::of(radius);
        let area = radius_p * radius_p;
        if radius_p > P::zero() && area.is_finite() && area.recip().is_finite() {
            Ok(radius_p)
        } else {
            Err(RenderError::Radius { found: radius })
        }
    }

    /// Those that landed of so many that were sent.
    ///
    /// # Errors
    /// As those of [`Map::new`].
    pub(super) fn of(
        landed: &[Landed<P>],
        radius: f64,
        sent: u64,
        non_finite: NonFinite,
    ) -> Result<Self, RenderError> {
        let radius = Self::check(radius)?;
        let total = landed.len();
        if u32::try_from(total).is_err() {
            return Err(RenderError::Count {
                what: "particles that land",
                expected: "at most 2^32",
                found: total as u64,
            });
        }
        let mut map = Self {
            radius,
            landed: Vec::new(),
            starts: vec![0; total.next_power_of_two().max(2) + 1],
            sent,
            non_finite,
        };
        // Counting sort by bucket; within a bucket particles keep their order.
        let buckets: Vec<u32> = (landed.iter()).map(|l| map.bucket(map.cell(l.p))).collect();
        for &b in &buckets {
            map.starts[b as usize + 1] += 1;
        }
        for i in 1..map.starts.len() {
            map.starts[i] += map.starts[i - 1];
        }
        let mut next = map.starts.clone();
        let mut order = vec![0u32; total];
        for (i, &b) in buckets.iter().enumerate() {
            order[next[b as usize] as usize] = i as u32;
            next[b as usize] += 1;
        }
        map.landed = order.iter().map(|&i| landed[i as usize]).collect();
        Ok(map)
    }

    /// Power that arrives on a shape after `depth` edges.
    pub fn power_on(&self, shape: u32, depth: u32) -> [f64; 3] {
        let there = (self.landed.iter()).filter(|l| l.shape == shape && l.depth == depth);
        let mut sum = [0.0; 3];
        for l in there {
            for (c, sum) in sum.iter_mut().enumerate() {
                *sum += l.power[c].to_f64();
            }
        }
        sum.map(|x| x / self.sent.max(1) as f64)
    }

    /// How many particles were sent.
    pub(super) fn sent(&self) -> u64 {
        self.sent
    }

    /// Number of particles on surfaces.
    pub fn len(&self) -> usize {
        self.landed.len()
    }

    /// Whether no particle landed.
    pub fn is_empty(&self) -> bool {
        self.landed.is_empty()
    }

    fn cell(&self, p: Vec3<P>) -> [i64; 3] {
        // Saturates far away, where cells are one.
        p.to_array()
            .map(|x| (x / self.radius).to_f64().floor() as i64)
    }

    fn bucket(&self, cell: [i64; 3]) -> u32 {
        let mixed = cell
            .iter()
            .fold(0u64, |h, &c| crate::sampler::mix64(h ^ c as u64));
        (mixed & (self.starts.len() as u64 - 2)) as u32
    }

    /// Calls `f` with the particles within the radius of `p` on surfaces that face the same way as `n_geo`,
    /// and their kernel: `2 / (pi r^2) (1 - d^2 / r^2)`, per area.
    pub(super) fn near(&self, p: Vec3<P>, n_geo: Vec3<P>, mut f: impl FnMut(&Landed<P>, P)) {
        let r2 = self.radius * self.radius;
        let norm = P::of(2.0 / PI) / r2;
        let centre = self.cell(p);
        let mut visited = [u32::MAX; 27];
        let mut n = 0;
        for k in 0..27 {
            let cell =
                [0, 1, 2].map(|a| centre[a].saturating_add([k % 3, k / 3 % 3, k / 9][a] - 1));
            let bucket = self.bucket(cell);
            // Two cells may share a bucket.
            if visited[..n].contains(&bucket) {
                continue;
            }
            visited[n] = bucket;
            n += 1;
            let range =
                self.starts[bucket as usize] as usize..self.starts[bucket as usize + 1] as usize;
            for l in &self.landed[range] {
                let d2 = (l.p - p).length_squared();
                if d2 < r2 && l.n_geo.dot(n_geo) > P::of(0.5) {
                    f(l, norm * (P::one() - d2 / r2));
                }
            }
        }
    }

    /// Irradiance at a point of a surface: power per area of the particles that arrive from the side of
    /// `n_geo`.
    pub fn irradiance(&self, p: Vec3<P>, n_geo: Vec3<P>) -> Density<P> {
        let mut out = Density {
            value: Rgb::black(),
            count: 0,
        };
        self.near(p, n_geo, |l, kernel| {
            if l.wi.dot(n_geo) > P::zero() {
                out.value += l.power * kernel;
                out.count += 1;
            }
        });
        out.value = out.value * P::of(1.0 / self.sent.max(1) as f64);
        out
    }

    /// The image: viewing rays follow deltas, add the emission on their way, and gather at the first
    /// surface that is none. `context` must be that of the map; its rules apply to the viewing rays as well: with
    /// [`Symmetry::Ignored`] radiance is not scaled at refraction, and `convention` makes no difference.
    pub fn render<X: Sampler>(
        &self,
        context: &Context<P>,
        convention: Convention,
        seed: u64,
        samples: Range<u64>,
        progress: &dyn Progress,
    ) -> Rendering
    where
        P: Components,
    {
        let context = &Context {
            progress,
            ..*context
        };
        let film = &context.scene.film;
        let [width, height] = film.crop_size;
        let spp = samples.end.saturating_sub(samples.start);
        let tiles = tiles(width, height);
        let parts = parallel::map(tiles.len(), |i| {
            let tile = &tiles[i];
            let mut sums = vec![[0.0f64; 3]; tile.pixels()];
            let mut non_finite = NonFinite::default();
            if progress.cancelled() {
                return (sums, non_finite);
            }
            for (at, sum) in sums.iter_mut().enumerate() {
                let [x, y] = tile.pixel(at);
                for index in samples.clone() {
                    if progress.cancelled() {
                        return (sums, non_finite);
                    }
                    let (at, pixel) = film.full_pixel([x, y]);
                    let l = self.radiance(
                        context,
                        convention,
                        at,
                        X::spread(context.settings.points, seed, pixel, index),
                    );
                    if l.is_finite() {
                        for c in 0..3 {
                            sum[c] += l[c].to_f64();
                        }
                    } else {
                        non_finite.add(u64::from(y * width + x), index);
                    }
                }
            }
            progress.advance(tile.pixels() as u64);
            (sums, non_finite)
        });
        let mut out = Rendering {
            width: width as usize,
            height: height as usize,
            samples: spp,
            sums: vec![vec![0.0; film.pixels() * 3]],
            non_finite: self.non_finite,
            connections: Statistics::default(),
            light_of_connections: 0.0,
            connections_by_pixel: Vec::new(),
            glints: Statistics::default(),
            cancelled: progress.cancelled(),
        };
        for (tile, (sums, bad)) in tiles.iter().zip(&parts) {
            out.non_finite.merge(bad);
            for (at, sum) in sums.iter().enumerate() {
                let [x, y] = tile.pixel(at);
                let i = (y as usize * width as usize + x as usize) * 3;
                out.sums[0][i..i + 3].copy_from_slice(sum);
            }
        }
        out
    }

    /// What arrives along a viewing ray through a pixel.
    fn radiance<X: Sampler>(
        &self,
        context: &Context<P>,
        convention: Convention,
        [px, py]: [u32; 2],
        mut sampler: X,
    ) -> Rgb<P> {
        let Context {
            scene,
            theta,
            settings,
            rules,
            ..
        } = *context;
        let filter = &scene.film.filter;
        let offset @ [dx, dy] = filter.sample(sampler.next_2d::<P>());
        let centre = |p: u32| P::of(f64::from(p) + 0.5);
        let mut ray = scene.camera.ray(centre(px) + dx, centre(py) + dy);
        let scaled = convention == Convention::Radiance && rules.symmetry == Symmetry::Respected;
        let basic = convention == Convention::Basic && rules.symmetry == Symmetry::Respected;
        let mut l = Rgb::black();
        let mut beta = Rgb::splat(P::of(filter.weight(offset)));
        // Index of the medium around the ray over that around the camera.
        let mut eta = P::one();
        let mut interest = PathInterest::default();
        for depth in 1..=settings.max_depth {
            if depth % 64 == 0 && context.progress.cancelled() {
                break;
            }
            // Where light and importance meet, L / eta^2 is what is carried; the sensor's own eta is 1.
            let meet = if basic { (eta * eta).recip() } else { P::one() };
            let hit = (scene.seen(&ray, settings.hides(depth)))
                .map(|hit| scene.interaction(&Theta::still(), &ray, &hit));
            let si = hit.as_ref().map(|h| &h.si);
            let shape = hit.as_ref().map(|h| h.shape);
            for &e in emitters_at(scene, settings, depth, interest.bent, shape) {
                let e = &scene.emitters()[e as usize];
                if let Some(emission) = e.hit(ray.d, si) {
                    l += beta * e.eval(theta, &emission) * meet;
                }
            }
            let Some(Intersection { shape, prim, si }) = hit else {
                break;
            };
            let material = scene.material(shape);
            let n_geo = si.local_geometric_normal();
            let wo = si.frame.to_local(-ray.d);
            let at = Shading::new(*theta, Vec2::lift(si.uv));
            if !scene.shape_info(shape).delta {
                let mut sum = Rgb::black();
                self.near(si.p, si.n_geo, |p, kernel| {
                    if p.depth + depth > settings.max_depth {
                        return;
                    }
                    let wi = si.frame.to_local(p.wi);
                    let continuous = Component::Continuous;
                    let f = eval_kernel(
                        material,
                        &at,
                        n_geo,
                        [wo, wi],
                        continuous,
                        TransportMode::Radiance,
                        rules,
                    );
                    // The cosine of the particles' measure: their power is already per area.
                    let cos = match rules.symmetry {
                        Symmetry::Respected => wi.dot(n_geo).abs(),
                        Symmetry::Ignored => wi.z.abs(),
                    };
                    if cos > P::zero() {
                        sum += f * p.power * (kernel / cos);
                    }
                });
                return l + beta * sum * (meet / P::of(self.sent.max(1) as f64));
            }
            sampler.seek(Purpose::Viewing.at(depth));
            let mode = TransportMode::Radiance;
            let Some(sample) = material.sample(&at, wo, sampler.next_3d(), mode) else {
                break;
            };
            interest.bend(sample.component, [P::one(), sample.eta]);
            let f = material.eval_component(&at, wo, sample.wi, sample.component, mode);
            beta = beta * f * sample.pdf.recip();
            if matches!(
                sample.component,
                Component::Delta {
                    kind: DeltaKind::Transmission,
                    ..
                }
            ) {
                eta *= sample.eta;
                if !scaled {
                    beta = beta * (sample.eta * sample.eta);
                }
            }
            ray = si.spawn_ray(si.frame.to_world(sample.wi), scene.exit(prim));
            // Total reflection may go on for long; what is left behind is unbiased.
            if depth >= settings.rr_depth {
                let q = probability(beta.max_component(), P::one());
                let (survives, inv_q) = play(true, q, sampler.next_1d());
                if !survives {
                    break;
                }
                beta = beta * inv_q;
            }
        }
        l
    }
}
