//! The work of samples, by counting what they are made of.

use super::active::Active;
use super::job::Job;
use super::lockstep;
use super::path::Context;
use super::record::{Contribution, Interest, Observer, Place};
use super::tile::start;
use crate::emitter::AnyEmitter;
use crate::estimator::{Direct, Mode, Sampling, Strategy, goes_in_waves};
use crate::math::Rgb;
use crate::parallel;
use crate::params::Theta;
use crate::sampler::{Family, Independent, Sampler};
use crate::scene::Scene;

/// Paths are counted in so many shares, whatever the number of threads.
const JOBS: usize = 64;

/// The parts of samples, one line each: what it takes, in edges of a recorded path.
macro_rules! parts {
    ($($(#[doc = $doc:literal])* $part:ident [$price:literal];)*) => {
        #[derive(Clone, Copy, Debug)]
        enum Item {
            $($(#[doc = $doc])* $part,)*
        }

        const PRICES: &[f64] = &[$($price,)*];
    };
}

// Least squares of the logarithms of times in both modes, up to a factor per scene and mode, of all estimators in the
// scenes of `auto-estimator`, in a room with and without metal boxes, on plates, and on a plane under an environment map.
// Over those of `mis` within 15 per cent for five sixths of them.
parts! {
    /// An edge of the path.
    Edge [1.0];
    /// A sampled light.
    Light [0.9];
    /// An environment map in sight among them.
    Map [2.1];
    /// Any light in sight, where weights are differentiated.
    WeighedLight [0.2];
    /// A vertex where a derivative is taken.
    Vertex [0.8];
    /// A sample of the derivative of normals that has lights for rivals.
    Rival [1.0];
    /// An edge of its path, or of that of one without rivals.
    Walked [1.1];
    /// An edge to light that is differentiated by itself, with weights.
    WeighedEdge [2.7];
    /// One without.
    MovedEdge [0.7];
    /// An auxiliary ray around one.
    Ray [0.4];
    /// An edge of a path that moves as a whole, in reverse mode.
    Moving [4.1];
}

/// How often the parts occur in some paths.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkCount {
    paths: u64,
    parts: [u64; PRICES.len()],
}

impl WorkCount {
    fn add(&mut self, part: Item, n: u64) {
        self.parts[part as usize] += n;
    }

    fn merge(mut self, other: Self) -> Self {
        self.paths += other.paths;
        self.parts
            .iter_mut()
            .zip(other.parts)
            .for_each(|(a, b)| *a += b);
        self
    }

    /// Work of a sample, in edges of a recorded path, whatever the mode.
    pub fn work(&self) -> f64 {
        let parts = self.parts.iter().zip(PRICES);
        parts.map(|(&n, p)| n as f64 * p).sum::<f64>() / self.paths.max(1) as f64
    }
}

/// Watches paths that are differentiated.
struct Counter<'a> {
    scene: &'a Scene,
    active: &'a Active,
    /// Whether light is looked for that no derivative needs: images have it.
    image: bool,
    /// Whether vertices are differentiated where nothing is active.
    everywhere: bool,
    /// Whether lights are sampled.
    rivals: bool,
    /// Whether weights are differentiated.
    weighs: bool,
    /// Auxiliary rays around an edge.
    rays: u64,
    count: WorkCount,
}

impl<'a> Counter<'a> {
    fn of<S: Strategy>(scene: &'a Scene, active: &'a Active, mode: Mode) -> Self {
        Self {
            scene,
            active,
            image: mode == Mode::Forward,
            everywhere: mode == Mode::Forward && !goes_in_waves::<S>(),
            rivals: S::SAMPLES_EMITTERS,
            weighs: S::DIFFERENTIATED_WEIGHTS || S::FROZEN_WEIGHTS,
            rays: match S::Bsdf::DIRECT {
                Direct::Reparameterised { rays } => rays as u64,
                Direct::AsPath | Direct::Attached => 0,
            },
            count: WorkCount::default(),
        }
    }
}

impl Interest for Counter<'_> {
    fn differentiates(&self, material: u32) -> bool {
        self.everywhere || self.active.differentiates(material)
    }

    fn differentiates_roughness(&self, material: u32) -> bool {
        self.active.differentiates_roughness(material)
    }

    fn differentiates_emission(&self) -> bool {
        self.image || self.active.differentiates_emission()
    }
}

impl Observer<f32> for Counter<'_> {
    fn vertex(&mut self, _beta: Rgb<f32>, place: &Place<f32>) {
        let followed = self.differentiates(self.scene.shape_info(place.shape).material);
        self.count.add(Item::Vertex, followed.into());
    }

    fn contribution(&mut self, contribution: Contribution<f32>) {
        match contribution {
            Contribution::Sampled(light) => {
                let emitter = &self.scene.emitters()[light.emitter as usize];
                let map = matches!(emitter, AnyEmitter::Envmap(_));
                self.count.add(Item::Map, map.into());
                self.count.add(Item::WeighedLight, self.weighs.into());
            }
            Contribution::Edge(..) => {
                let part = if self.weighs {
                    Item::WeighedEdge
                } else {
                    Item::MovedEdge
                };
                self.count.add(part, 1);
                self.count.add(Item::Ray, self.rays);
            }
            _ => {}
        }
    }

    fn branch(&mut self, edges: u32) {
        self.count.add(Item::Rival, self.rivals.into());
        self.count.add(Item::Walked, edges.into());
    }
}

/// Counts what samples of the derivatives in `active` are made of: as many paths as the job has samples of a pixel, spread
/// over the image. Particles are not counted. Incomplete if cancelled.
pub fn count_work<S: Strategy, X: Sampler>(job: &Job, active: &Active, mode: Mode) -> WorkCount {
    let &Job {
        scene,
        settings,
        seed,
        progress,
        ..
    } = job;
    let paths = job.count();
    let theta = Theta::constant(scene.params().values());
    let caustics = settings.caustics_of::<S>(scene);
    let context = Context::new(scene, &theta, settings, caustics, progress);
    let [width, height] = scene.film.crop_size.map(|n| u64::from(n).max(1));
    let pixels = width * height;
    let part = |first| {
        let mut counter = Counter::of::<S>(scene, active, mode);
        for k in (first as u64..paths).step_by(JOBS) {
            if progress.cancelled() {
                break;
            }
            let path = job.samples.start + k;
            // One pixel from each of as many equal parts of the image.
            let mut random = Independent::new(Family::Places.seed(seed), path, 0);
            let u = k as f64 + random.next_1d::<f64>();
            let pixel = ((u / paths as f64 * pixels as f64) as u64).min(pixels - 1);
            let pixel = [pixel % width, pixel / width].map(|p| p as u32);
            let mut walk = start::<f32, S, X>(scene, settings.points, seed, pixel, path);
            lockstep::trace_alone(
                scene,
                &S::Bsdf::geometry(context.theta),
                settings.hides(1),
                progress,
                &mut walk,
                |walk, hit, visible| {
                    let count = &mut counter.count;
                    let edge = u64::from(walk.ray.is_some());
                    count.add(Item::Edge, edge);
                    count.add(Item::Light, walk.shadow.is_some().into());
                    if mode == Mode::Reverse && !S::Bsdf::DETACHED_PATH {
                        count.add(Item::Moving, edge);
                    }
                    walk.step(&context, hit, visible, &mut counter);
                },
            );
            counter.count.paths += 1;
        }
        counter.count
    };
    let parts = parallel::map(JOBS, part);
    parts
        .into_iter()
        .fold(WorkCount::default(), WorkCount::merge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::{BsdfOnly, Detached, DetachedMis, DetachedWeights, Differential, Mis};
    use crate::sampler::Spread;

    const PATHS: u64 = 100;

    /// A rough plate, and nothing else in sight, with one light of this kind.
    fn plate(emitter: &str) -> Scene {
        let xml = format!(
            r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/>
            <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
            <integrator type="path"><integer name="max_depth" value="2"/></integrator>
            <shape type="rectangle"><transform name="to_world"><scale value="9"/></transform>
            <bsdf type="roughconductor" id="metal"><float name="alpha" value="0.1"/></bsdf></shape>
            {emitter}</scene>"#
        );
        Scene::from_xml(&xml, "".as_ref(), &Default::default())
            .expect("a scene")
            .0
    }

    fn counted<S: Strategy>(scene: &Scene, name: &str, mode: Mode) -> [u64; PRICES.len()] {
        let active = Active::new(scene, &[name]).expect("a parameter");
        let job = Job::new(scene, &scene.settings, 1, 0..PATHS, &());
        let found = count_work::<S, Spread>(&job, &active, mode);
        assert_eq!(found.paths, PATHS);
        found.parts
    }

    fn parts(of: &[(Item, u64)]) -> [u64; PRICES.len()] {
        let mut count = WorkCount::default();
        of.iter().for_each(|&(part, n)| count.add(part, n * PATHS));
        count.parts
    }

    /// Every path is the same one.
    #[test]
    fn paths_by_hand() {
        use Item::{Edge, Light, Rival, Vertex, Walked};
        let point =
            plate(r#"<emitter type="point"><point name="position" value="0, 0, 3"/></emitter>"#);
        let (alpha, power) = ("metal.alpha.value", "emitter.intensity.value");
        type Pair = Mis<Differential, Detached, DetachedWeights>;
        for mode in [Mode::Forward, Mode::Reverse] {
            let direct = parts(&[(Edge, 1), (Light, 1), (Vertex, 1)]);
            assert_eq!(counted::<DetachedMis>(&point, alpha, mode), direct);
            // A point is not met.
            let alone = parts(&[(Edge, 1), (Vertex, 1)]);
            assert_eq!(counted::<BsdfOnly<Detached>>(&point, alpha, mode), alone);
        }
        // Emission alone: the plate is a constant, and has no samples of normals.
        for mode in [Mode::Forward, Mode::Reverse] {
            let direct = parts(&[(Edge, 1), (Light, 1)]);
            assert_eq!(counted::<Pair>(&point, power, mode), direct);
        }
        // A pair of one edge each, as far as they do not leave below the horizon.
        let sky = plate(r#"<emitter type="constant"/>"#);
        for mode in [Mode::Forward, Mode::Reverse] {
            let both = counted::<Pair>(&sky, alpha, mode);
            let walked = both[Walked as usize];
            assert!(walked > 19 * PATHS / 10 && walked <= 2 * PATHS, "{walked}");
            assert_eq!(both[Rival as usize], walked);
            let alone = counted::<BsdfOnly<Differential>>(&sky, alpha, mode);
            let none = [Rival, Light].map(|part| alone[part as usize]);
            assert_eq!((alone[Walked as usize], none), (walked, [0, 0]));
        }
    }
}
