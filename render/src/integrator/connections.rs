//! The integral over paths that end in a manifold connection: its image and its gradient.
//!
//! Paths from the camera scatter as they do for BSDF sampling, look for no light, and are connected at every receiver that
//! they reach ([`crate::manifold`]). A connection is a path like any other: over a scalar with tangents its value has the
//! derivatives of its factors, and reverse mode goes back through the record of its vertices.
//!
//! Where one walk is all that is tried ([`crate::scene::Method::MneeUnbiased`]), the same paths look for light that they meet
//! behind chains, and count what the walk misses.

use ad_core::{Float, Real, Vec2, Vec3};

use super::active::Active;
use super::chain_trail::ChainTrail;
use super::exact::ExactBuffer;
use super::pass::Pass;
use super::path::Context;
use super::paths::{JOBS, TileSums, assemble, deposit};
use super::progress::Progress;
use super::record::{
    Bounce, Contribution, Interest, MetLight, Observer, PathRecord, Place, Recorder,
};
use super::rendering::{Components, NonFinite, PixelConnections, Rendering};
use super::sink::{GradientSums, Sink};
use super::solved::Solved;
use super::tile::{Sample, place, start};
use super::vertex::MODE;
use crate::bsdf::{Bsdf, Component, Part, Shading};
use crate::emitter::{Emission, Emitter};
use crate::error::RenderError;
use crate::estimator::{BsdfOnly, Detached};
use crate::manifold::{Connection, Connector, Link, Space, Split, Start, Statistics, cast};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Family, Independent, Sampler};
use crate::scene::{Connections, Scene, Starts};
use crate::shape::SurfaceInteraction;

/// Light over specular chains.
pub(super) const CHAINS: Solved = Solved {
    these: "chains",
    option: "--manifold off",
    error: |what| RenderError::Connections { what },
    is_sought: |settings| settings.connections.is_some(),
    admits: |scene, settings| {
        let connections = settings.connections.as_ref();
        let split = connections.and_then(|c| Some((Split::of(scene, c)?, c.method)));
        split.map_or(Ok(()), |(split, method)| split.admits(scene, method))
    },
};

/// How paths scatter on their way to where they are connected, whatever the estimator of the others.
pub(super) type Scattering = BsdfOnly<Detached>;

/// A number in another precision.
fn number<R: Real>(x: f64) -> R {
    R::of(x)
}

pub(super) fn vector<R: Real>(v: Vec3<f64>) -> Vec3<R> {
    v.map(number)
}

fn surface<R: Real>(si: &SurfaceInteraction<f64>) -> SurfaceInteraction<R> {
    cast::<f64, R::Primal>(si).lift()
}

pub(super) fn emission<R: Real>(e: &Emission<f64>) -> Emission<R> {
    Emission {
        uv: Vec2::new(number(e.uv.x), number(e.uv.y)),
        falloff: number(e.falloff),
    }
}

/// Follows a path and connects its vertices.
struct Connecting<'a> {
    scene: &'a Scene,
    connector: &'a Connector<'a>,
    split: &'a Split,
    progress: &'a dyn Progress,
    max_depth: u32,
    /// Edges of the path so far.
    depth: u32,
    rng: Independent,
    found: Vec<Connection>,
    /// What they came to, since the path was started.
    came_to: Statistics,
    /// The chain that the path is on, where light counts that it meets there.
    trail: Option<ChainTrail>,
}

impl<'a> Connecting<'a> {
    fn new<R: Real>(pass: &Pass<'a, R>, connector: &'a Connector<'a>, split: &'a Split) -> Self {
        Self {
            scene: pass.scene,
            connector,
            split,
            progress: pass.progress,
            max_depth: pass.settings.max_depth,
            depth: 0,
            rng: Independent::new(0, 0, 0),
            found: Vec::new(),
            came_to: Statistics::default(),
            trail: connector.counts_missed().then(ChainTrail::default),
        }
    }

    /// Starts the path of a sample.
    fn restart(&mut self, seed: u64, at: &Sample) {
        let (_, pixel) = self.scene.film.full_pixel(at.pixel);
        self.rng = Independent::new(Family::Connections.seed(seed), pixel, at.index);
        self.depth = 0;
        self.came_to = Statistics::default();
        if let Some(trail) = &mut self.trail {
            trail.restart();
        }
    }

    /// The connections of the vertex that the path reaches now.
    fn arrive<R: Real>(&mut self, place: &Place<R>) -> &[Connection] {
        self.depth += 1;
        self.found.clear();
        // The edges of a chain are one more than its vertices.
        let most = self.max_depth.saturating_sub(self.depth).saturating_sub(1);
        let start = || Start {
            si: cast(&place.si.primal()),
            exit: self.scene.exit(place.prim),
        };
        if let Some(trail) = &mut self.trail {
            let material = self.scene.shape_info(place.shape).material;
            trail.vertex(self.split, (place, material), start(), most);
        }
        if most > 0 && self.split.is_receiver(place.shape) {
            let start = start();
            let found = &mut self.found;
            let (progress, rng) = (self.progress, &mut self.rng);
            let cancelled = || progress.cancelled();
            let came_to = (self.connector).connect(&start, most, rng, &cancelled, found);
            self.came_to.merge(&came_to);
        }
        &self.found
    }

    /// Whether the path looks for light.
    fn looks(&self) -> bool {
        self.trail.is_some()
    }

    /// The path goes on from its last vertex.
    fn leaves<R: Real>(&mut self, bounce: &Bounce<R>) {
        if let Some(trail) = &mut self.trail {
            trail.leaves(self.split, bounce);
        }
    }

    /// Its edge ends at a surface.
    fn arrives<R: Real>(&mut self, prim: u32, si: &SurfaceInteraction<R>) {
        if let Some(trail) = &mut self.trail {
            trail.arrives(prim, si);
        }
    }

    /// Whether light that it meets counts: behind a chain that walks miss.
    fn counts(&mut self, emitter: u32) -> bool {
        let met = (self.trail.as_ref()).and_then(|trail| trail.met(self.split, emitter));
        let Some(met) = met else {
            return false;
        };
        let missed = !self.connector.finds(&met);
        self.came_to.met += 1;
        self.came_to.missed += u64::from(missed);
        missed
    }
}

/// A connection as it is seen from its start: the direction that it leaves in, local frame, and the values of the start's
/// material and of that at each link.
struct Valued<R: Real> {
    wi: Vec3<R>,
    f: Rgb<R>,
    links: Vec<Rgb<R>>,
}

/// What the value of a link's material is multiplied with.
fn weight<R: Real>(link: &Link) -> R {
    number(link.density.map_or(1.0, f64::recip))
}

impl<R: Real> Valued<R> {
    fn of(scene: &Scene, theta: &Theta<R>, place: &Place<R>, connection: &Connection) -> Self {
        let at = |uv: Vec2<R>| Shading::new(*theta, uv);
        let wi = place.si.frame.to_local(vector(connection.direction));
        let material = scene.material(place.shape);
        let links = connection.links.iter().map(|link| {
            let uv = Vec2::new(number(link.si.uv.x), number(link.si.uv.y));
            let (wo, wi) = (vector(link.wo), vector(link.wi));
            let material = scene.material(link.shape);
            match link.density {
                None => material.eval_delta(&at(uv), wo, wi, link.kind, 0, MODE),
                Some(_) => material.eval(&at(uv), wo, wi, MODE),
            }
        });
        Self {
            wi,
            f: material.eval(&at(place.si.uv), place.wo, wi, MODE),
            links: links.collect(),
        }
    }
}

/// Adds up what connections bring.
struct Value<'a, R: Real> {
    connecting: Connecting<'a>,
    theta: &'a Theta<'a, R>,
    l: Rgb<R>,
}

/// Its path looks for no light, but where some of it counts that is met.
impl<R: Real> Interest for Value<'_, R> {
    const LIGHT: bool = false;
    fn differentiates_emission(&self) -> bool {
        self.connecting.looks()
    }
}

impl<R: Real> Observer<R> for Value<'_, R> {
    fn vertex(&mut self, beta: Rgb<R>, place: &Place<R>) {
        let (scene, theta) = (self.connecting.scene, self.theta);
        for connection in self.connecting.arrive(place) {
            let Valued { f, links, .. } = Valued::of(scene, theta, place, connection);
            let e = &scene.emitters()[connection.emitter as usize];
            let le = e.eval(theta, &emission(&connection.emission));
            let along = (links.into_iter().zip(&connection.links))
                .fold(beta * f, |b, (f, link)| b * f * weight::<R>(link));
            self.l += along * le * number::<R>(connection.weight);
        }
    }

    fn arrives(&mut self, prim: u32, si: &SurfaceInteraction<R>) {
        self.connecting.arrives(prim, si);
    }

    fn contribution(&mut self, contribution: Contribution<R>) {
        match contribution {
            Contribution::Scattered(bounce) => self.connecting.leaves(&bounce),
            Contribution::Met(light) if self.connecting.counts(light.emitter) => {
                let e = &self.connecting.scene.emitters()[light.emitter as usize];
                self.l += light.beta * e.eval(self.theta, &light.emission) * light.weight;
            }
            _ => {}
        }
    }
}

/// The parameters in double precision.
fn double<R: Real>(theta: &Theta<R>) -> Vec<f64> {
    theta.values().iter().map(|x| x.to_f64()).collect()
}

/// Where connections of a pass are sought.
fn space<'a, R: Real>(pass: &Pass<'a, R>, values: &'a [f64]) -> Option<Space<'a>> {
    let Connections {
        constraint, steps, ..
    } = pass.settings.connections?;
    Some(Space {
        scene: pass.scene,
        theta: Theta::constant(values),
        constraint,
        steps,
    })
}

/// Fewest and most particles that show where walks may start.
const PARTICLES: [usize; 2] = [1 << 12, 1 << 16];
/// So many of them for each pixel of the film.
const PARTICLES_PER_PIXEL: usize = 4;

/// Makes the connections of a pass, and learns for it where they may start.
fn connector<'a, R: Real>(
    pass: &Pass<'a, R>,
    space: Space<'a>,
    split: &'a Split,
    options: Connections,
) -> Connector<'a> {
    let mut connector = Connector::new(space, split, options);
    if options.starts == Starts::Particles && !options.method.is_deterministic() {
        let [width, height] = pass.scene.film.size.map(|n| n as usize);
        let [least, most] = PARTICLES;
        let particles = width
            .saturating_mul(height)
            .saturating_mul(PARTICLES_PER_PIXEL);
        connector.learn(pass.seed, particles.clamp(least, most));
    }
    connector
}

/// What the connections of a tile came to.
struct CameTo {
    all: Statistics,
    light: f64,
    /// Of each pixel, if that is asked for.
    pixels: Vec<PixelConnections>,
}

impl CameTo {
    fn new(by_pixel: bool, pixels: usize) -> Self {
        let n = if by_pixel { pixels } else { 0 };
        Self {
            all: Statistics::default(),
            light: 0.0,
            pixels: vec![PixelConnections::default(); n],
        }
    }
}

/// The image by connections.
pub(super) fn image<R: Components, X: Sampler>(pass: &Pass<R>) -> Rendering {
    let values = double(pass.theta);
    let parts = (pass.split.as_deref())
        .zip(space(pass, &values))
        .zip(pass.settings.connections);
    let Some(((split, space), options)) = parts else {
        return Rendering::black(pass.scene.film.crop_size, &pass.samples, R::COUNT);
    };
    let connector = connector(pass, space, split, options);
    let (scene, progress, seed) = (pass.scene, pass.progress, pass.seed);
    let (points, context) = (pass.settings.points, still(pass));
    let spp = pass.samples.end.saturating_sub(pass.samples.start) as f64;
    let tiles = pass.tiles();
    let found: Vec<(TileSums, CameTo)> = parallel::map(tiles.len(), |i| {
        let tile = &tiles[i];
        let pixels = tile.pixels();
        let mut sums = vec![0.0f64; R::COUNT * pixels * 3];
        let mut non_finite = NonFinite::default();
        let mut came_to = CameTo::new(options.by_pixel, pixels);
        let mut value = Value {
            connecting: Connecting::new(pass, &connector, split),
            theta: pass.theta,
            l: Rgb::black(),
        };
        for (at, sample) in tile.samples::<R::Primal, X>(scene, points, seed, &pass.samples) {
            if progress.cancelled() {
                return ((Vec::new(), NonFinite::default()), came_to);
            }
            value.connecting.restart(seed, &sample);
            value.l = Rgb::black();
            start::<R, Scattering, X>(scene, points, seed, sample.pixel, sample.index)
                .finish(&context, &mut value);
            came_to.all.merge(&value.connecting.came_to);
            if !value.l.is_finite() {
                non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                continue;
            }
            let weight = spp * sample.scale();
            deposit(&mut sums, at, value.l, weight);
            let channels = (0..3).map(|c| value.l[c].component(0));
            let light = weight * channels.sum::<f64>() / 3.0;
            came_to.light += light;
            if let Some(pixel) = came_to.pixels.get_mut(at) {
                pixel.statistics.merge(&value.connecting.came_to);
                pixel.light += light;
            }
        }
        progress.advance(pixels as u64);
        ((sums, non_finite), came_to)
    });
    let (sums, came_to): (Vec<TileSums>, Vec<CameTo>) = found.into_iter().unzip();
    let mut out = assemble(pass, R::COUNT, &sums);
    if options.by_pixel {
        let n = out.width * out.height;
        out.connections_by_pixel = vec![PixelConnections::default(); n];
    }
    for (tile, CameTo { all, light, pixels }) in tiles.iter().zip(&came_to) {
        out.connections.merge(all);
        out.light_of_connections += light;
        let columns = (tile.x.end - tile.x.start) as usize;
        for (row, pixels) in (tile.y.start..).zip(pixels.chunks(columns)) {
            let first = place(scene, [tile.x.start, row]);
            out.connections_by_pixel[first..first + columns].copy_from_slice(pixels);
        }
    }
    out
}

/// What paths have in common that look for no light.
pub(super) fn still<'a, R: Real>(pass: &'a Pass<'a, R>) -> Context<'a, R> {
    Context {
        split: None,
        ..pass.context()
    }
}

/// Records what connections bring.
struct Recording<'a, P: Float> {
    connecting: Connecting<'a>,
    theta: &'a Theta<'a, P>,
    /// The path so far.
    path: PathRecord<P>,
    /// With each connection, and with each light that it met and that counts.
    connected: Vec<PathRecord<P>>,
}

/// As [`Value`].
impl<P: Float> Interest for Recording<'_, P> {
    const LIGHT: bool = false;
    fn differentiates_emission(&self) -> bool {
        self.connecting.looks()
    }
}

impl<P: Float> Observer<P> for Recording<'_, P> {
    fn vertex(&mut self, beta: Rgb<P>, place: &Place<P>) {
        self.path.vertex(beta, place);
        let scene = self.connecting.scene;
        for connection in self.connecting.arrive(place) {
            let valued = Valued::of(scene, self.theta, place, connection);
            let mut path = self.path.clone();
            let mut bounce = Bounce {
                wi: valued.wi,
                component: Component::Continuous,
                mode: MODE,
                weight: number(connection.weight),
                f: valued.f,
                part: Part::All,
                deciding: None,
            };
            let mut beta = beta;
            for (link, f) in connection.links.iter().zip(valued.links) {
                path.contribution(Contribution::Scattered(bounce));
                beta = beta * bounce.f * bounce.weight;
                let at = Place {
                    shape: link.shape,
                    prim: link.prim,
                    si: surface(&link.si),
                    wo: vector(link.wo),
                };
                path.vertex(beta, &at);
                let delta = Component::Delta {
                    kind: link.kind,
                    route: 0,
                };
                bounce = Bounce {
                    wi: vector(link.wi),
                    component: link.density.map_or(delta, |_| Component::Continuous),
                    weight: weight(link),
                    f,
                    ..bounce
                };
            }
            path.contribution(Contribution::Scattered(bounce));
            path.contribution(Contribution::Met(MetLight {
                emitter: connection.emitter,
                emission: emission(&connection.emission),
                weight: P::one(),
                beta: beta * bounce.f * bounce.weight,
                share: P::one(),
            }));
            self.connected.push(path);
        }
    }

    fn arrives(&mut self, prim: u32, si: &SurfaceInteraction<P>) {
        self.connecting.arrives(prim, si);
    }

    fn contribution(&mut self, contribution: Contribution<P>) {
        match contribution {
            Contribution::Met(light) => {
                if self.connecting.counts(light.emitter) {
                    let mut path = self.path.clone();
                    path.contribution(contribution);
                    self.connected.push(path);
                }
            }
            _ => {
                if let Contribution::Scattered(bounce) = &contribution {
                    self.connecting.leaves(bounce);
                }
                self.path.contribution(contribution);
            }
        }
    }
}

/// The derivative of `<adjoint, image>` by connections. The large ranges are added to `large`.
pub(super) fn gradient<P: Float, X: Sampler>(
    pass: &Pass<P>,
    active: &Active,
    adjoint: &[f32],
    large: &ExactBuffer,
) -> GradientSums {
    let values = double(pass.theta);
    let parts = (pass.split.as_deref())
        .zip(space(pass, &values))
        .zip(pass.settings.connections);
    let sums = GradientSums::zero(active);
    let Some(((split, space), options)) = parts else {
        return sums;
    };
    let connector = connector(pass, space, split, options);
    let (scene, theta, seed) = (pass.scene, pass.theta, pass.seed);
    let (points, context) = (pass.settings.points, still(pass));
    let tiles = pass.tiles();
    let jobs = JOBS.min(tiles.len());
    let parts = parallel::map(jobs, |job| {
        let mut sink = Sink::new(active, large);
        let mut non_finite = NonFinite::default();
        let mut recording = Recording {
            connecting: Connecting::new(pass, &connector, split),
            theta,
            path: PathRecord::default(),
            connected: Vec::new(),
        };
        let mut came_to = Statistics::default();
        for tile in tiles.iter().skip(job).step_by(jobs) {
            for (_, sample) in tile.samples::<P, X>(scene, points, seed, &pass.samples) {
                if pass.progress.cancelled() {
                    break;
                }
                recording.connecting.restart(seed, &sample);
                recording.path.clear();
                recording.connected.clear();
                start::<P, Scattering, X>(scene, points, seed, sample.pixel, sample.index)
                    .finish(&context, &mut recording);
                came_to.merge(&recording.connecting.came_to);
                let d = sample.of_image::<P>(adjoint, scene) * P::of(sample.scale());
                let mut l = Rgb::black();
                for path in recording.connected.drain(..) {
                    let recorder = Recorder { active, path };
                    l += recorder.backward::<Scattering>(scene, theta, d, &mut sink);
                }
                if !l.is_finite() {
                    non_finite.add(place(scene, sample.pixel) as u64, sample.index);
                }
            }
            pass.progress.advance(tile.pixels() as u64);
        }
        ((sink.into_small(), non_finite), came_to)
    });
    let (parts, came_to): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    let mut sums = sums.with_parts(parts);
    came_to.iter().for_each(|s| sums.connections.merge(s));
    sums
}
