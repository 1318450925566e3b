//! What a sample of a pixel finds of the light in a glinty surface.

use ad_core::{Float, Mat2, Vec2, Vec3};

use super::footprint::{Footprint, HalfVectors};
use super::map::{Moments, SlopeMap, cell_of};
use super::mapped_metal;
use super::parts::Pixel;
use super::search::Pick;
use super::walk::{Root, over_footprint};
use crate::bsdf::{Bsdf, Shading, TransportMode};
use crate::emitter::{Emission, Emitter, EmitterSample};
use crate::manifold::{Asking, Statistics, Target, cast, distinct, trials};
use crate::params::Theta;
use crate::sampler::{Independent, Sampler};
use crate::scene::{
    GlintMethod, GlintRegion, GlintTechniques, GlintWeights, Glints, LightChoice, Scene,
};
use crate::shape::SurfaceInteraction;

/// How far half vector and normal may be apart, in slopes, where a scattered direction is a solution: single precision.
const SAME_SLOPE: f64 = 1e-3;
/// How many lights tell which parts of a pixel are worth searching.
const LIGHTS: usize = 4;

/// Light by one reflection.
#[derive(Clone, Copy, Debug)]
pub struct Glint {
    /// The shape.
    pub shape: u32,
    /// The primitive.
    pub prim: u32,
    /// The point, with the texture coordinates of the reflection.
    pub si: SurfaceInteraction<f64>,
    /// To the viewer and to the light, local frame.
    pub wo: Vec3<f64>,
    /// See `wo`.
    pub wi: Vec3<f64>,
    /// Index of the emitter.
    pub emitter: u32,
    /// What of it arrives.
    pub emission: Emission<f64>,
    /// What reflectance times radiance is multiplied by.
    pub weight: f64,
    /// Whether a walk found it.
    pub by_walk: bool,
}

/// Finds glints in a scene.
pub struct Finder<'a, P: Float> {
    scene: &'a Scene,
    theta: Theta<'a, P>,
    options: Glints,
    /// Slopes by shape, of the front and of the back.
    maps: Vec<[Option<SlopeMap>; 2]>,
    glinty: &'a [bool],
}

/// What a sample of a pixel is drawn by.
#[derive(Clone, Copy, Debug)]
pub struct Drawn {
    /// The point of the full film, drawn by the pixel's filter.
    pub film: [f64; 2],
    /// On the lens, uniform in the unit square.
    pub lens: [f64; 2],
    /// Uniform numbers for a part of the pixel, and for a point of it, from which that is searched. They have no effect on what
    /// is searched as a whole: from the point of the sample.
    pub part: [f64; 3],
}

/// A point, the directions to the viewer and to the light, local frame, and a weight.
type Worth = (SurfaceInteraction<f64>, Vec3<f64>, Vec3<f64>, f64);

/// A light that was drawn for a footprint.
struct Light {
    emitter: u32,
    sample: EmitterSample<f64>,
    /// Density of its direction, and of this emitter's choice.
    pdf: f64,
    target: Target,
}

/// A light for a footprint: where, how densely it is sampled, and the half vectors to it.
struct Lit<'a> {
    foot: &'a Footprint,
    map: &'a SlopeMap,
    halves: HalfVectors,
    /// Density of the direction, per solid angle; `None` for what cannot be hit.
    pdf: Option<f64>,
    behind: bool,
}

impl<'a, P: Float> Finder<'a, P> {
    /// For the shapes of `glinty`, see [`super::glinty_shapes`].
    pub fn new(scene: &'a Scene, theta: Theta<'a, P>, glinty: &'a [bool], options: Glints) -> Self {
        let of = |shape: usize| {
            [false, true].map(|behind| {
                let map = mapped_metal(scene.material(shape as u32), behind);
                map.filter(|_| glinty[shape])
                    .and_then(|m| SlopeMap::new(m, &theta))
            })
        };
        Self {
            scene,
            theta,
            options,
            maps: (0..glinty.len()).map(of).collect(),
            glinty,
        }
    }

    /// The pixel whose filter has its middle there on the full film, in as many parts as it takes for footprints to be affine;
    /// published walks go over all of it, however it curves, and without walks there is nothing to search. `hidden`: whether
    /// the camera looks through lamps.
    pub fn pixel(&self, middle: [f64; 2], hidden: bool) -> Pixel {
        let walks = self.options.techniques != GlintTechniques::Scattering;
        if !walks || self.options.region == GlintRegion::Footprint {
            return Pixel::whole(&self.scene.film.filter, middle, hidden);
        }
        Pixel::new(self.scene, self.glinty, middle, hidden, |foot| {
            self.fits(foot)
        })
    }

    /// How well the slopes in a footprint fit lights: the mean of a few, which are the same for all footprints.
    fn fits(&self, foot: &Footprint) -> f64 {
        let Some((map, behind)) = self.slopes(foot) else {
            return 0.0;
        };
        let mut rng = Independent::new(0, 0, 0);
        let fit = |_| {
            let light = self.light(foot, &mut rng)?;
            let halves = foot.half_vectors(map, &light.target, behind)?;
            let middle = halves.bounds().0;
            let spread = self.spread(map, &halves, middle, foot.part.half);
            Some(spread.tailed(halves.half(middle)))
        };
        (0..LIGHTS).filter_map(fit).sum()
    }

    /// The slopes of a footprint, and whether they are seen from behind.
    fn slopes(&self, foot: &Footprint) -> Option<(&SlopeMap, bool)> {
        let behind = foot.behind();
        let map = self.maps[foot.shape as usize][usize::from(behind)].as_ref()?;
        Some((map, behind && self.turns(foot.shape)))
    }

    /// Whether directions are turned to the front of a shape: those with two sides.
    fn turns(&self, shape: u32) -> bool {
        matches!(
            self.scene.material(shape),
            crate::bsdf::Material::TwoSided(_)
        )
    }

    /// Adds what a sample of a pixel finds: estimates whose mean over samples is the pixel's light from glinty shapes over one
    /// reflection.
    /// What walks came to is added to `came_to`. Once `cancelled` says so, which is asked now and then, nothing of it counts.
    pub fn find(
        &self,
        pixel: &Pixel,
        view: &Drawn,
        rng: &mut Independent,
        cancelled: &dyn Fn() -> bool,
        came_to: &mut Statistics,
        out: &mut Vec<Glint>,
    ) {
        let offset = [0, 1].map(|k: usize| view.film[k] - pixel.middle[k]);
        let own = (pixel.seen(self.scene, self.glinty, view.film, view.lens))
            .map(|foot| foot.within(pixel.around(offset)));
        if let Some(foot) = &own
            && self.options.techniques != GlintTechniques::Walks
        {
            self.scatter(foot, self.scene.film.filter.weight(offset), out);
        }
        if self.options.techniques == GlintTechniques::Scattering {
            return;
        }
        let searched = if pixel.is_whole() {
            own
        } else {
            let [which, x, y] = view.part;
            let part = pixel.draw(which);
            let at =
                |k: usize, u: f64| pixel.middle[k] + part.middle[k] + part.half * (2.0 * u - 1.0);
            (pixel.seen(self.scene, self.glinty, [at(0, x), at(1, y)], view.lens))
                .map(|foot| foot.within(part))
        };
        if let Some(foot) = searched {
            self.walk(&foot, rng, (&Asking::new(cancelled), came_to), out);
        }
    }

    /// The weight of walks for a path, of which `q` is the probability that its part of the pixel (by the filter alone) and its
    /// cell are searched, `covers` the solid angle per pixel, `drawn` the density of its point in the image, and `t` the place
    /// of its normal.
    fn weight(&self, lit: &Lit, t: Vec2<f64>, [q, covers, drawn]: [f64; 3], angle: f64) -> f64 {
        let Some(pdf) = lit
            .pdf
            .filter(|_| self.options.techniques == GlintTechniques::Both)
        else {
            return f64::from(
                lit.pdf.is_none() || self.options.techniques == GlintTechniques::Walks,
            );
        };
        let (walks, scattering) = match self.options.weights {
            GlintWeights::Densities => (q * pdf * covers, drawn),
            GlintWeights::Lobe => (pdf, self.lobe(lit, t) * angle),
        };
        let all = walks + scattering;
        if all > 0.0 && all.is_finite() {
            walks / all
        } else {
            0.0
        }
    }

    /// Density of the footprint's slopes at the half vector, from moments, if the footprint is about `t`, and as wide as a square
    /// pixel.
    fn lobe(&self, lit: &Lit, t: Vec2<f64>) -> f64 {
        self.spread(lit.map, &lit.halves, t, 0.5)
            .density(lit.halves.half(t))
    }

    /// Moments of slopes less half vectors about `t`, of a square of the image with this half side, in pixels.
    fn spread(&self, map: &SlopeMap, halves: &HalfVectors, t: Vec2<f64>, half: f64) -> Moments {
        let texels_per_pixel = halves.texels_per_pixel;
        let texels = texels_per_pixel
            .rows
            .map(|[a, b]| half * (a.abs() + b.abs()));
        let per_pixel = halves.half_per_texel * texels_per_pixel;
        (map.moments(&self.theta, t, texels)).spread(&per_pixel, [half * half / 3.0; 2])
    }

    /// Scatters a direction and looks for light there.
    fn scatter(&self, foot: &Footprint, sample: f64, out: &mut Vec<Glint>) {
        let scene = self.scene;
        let si: SurfaceInteraction<P> = cast(&foot.si.primal());
        let at = Shading::new(self.theta, si.uv);
        let wo = foot.wo();
        let scattered = scene.material(foot.shape).sample(
            &at,
            wo.map(P::from_f64),
            [P::of(0.5); 3],
            TransportMode::Radiance,
        );
        let Some(scattered) = scattered else {
            return;
        };
        let d = si.frame.to_world(scattered.wi);
        let ray = si.spawn_ray(d, scene.exit(foot.prim));
        let met = scene.intersect(&ray);
        let own = met.and_then(|met| scene.shape_info(met.shape).emitter);
        let emitters = match &met {
            Some(_) => own.as_slice(),
            None => scene.infinite_emitters(),
        };
        let met = met.map(|met| met.si);
        for &emitter in emitters {
            let e = &scene.emitters()[emitter as usize];
            let Some(emission) = e.hit(d, met.as_ref()) else {
                continue;
            };
            let share: P = LightChoice::One.share(scene, emitter);
            let pdf = e.pdf(scene.lights(), si.p, d, met.as_ref()) * share;
            let target = match &met {
                Some(met) => Target::Point(met.p.map(P::to_f64)),
                None => Target::Direction(d.map(P::to_f64)),
            };
            let rival = self.rival(foot, &target, pdf.to_f64());
            let weight = match self.options.techniques {
                GlintTechniques::Both => 1.0 - rival,
                _ => 1.0,
            };
            out.push(Glint {
                shape: foot.shape,
                prim: foot.prim,
                si: foot.si.primal(),
                wo,
                wi: scattered.wi.map(P::to_f64),
                emitter,
                emission: Emission {
                    uv: emission.uv.map(P::to_f64),
                    falloff: emission.falloff.to_f64(),
                },
                weight: sample * weight,
                by_walk: false,
            });
        }
    }

    /// The weight of walks for the path that was scattered to a target; zero if none could find it.
    fn rival(&self, foot: &Footprint, target: &Target, pdf: f64) -> f64 {
        let found = || {
            let (map, behind) = self.slopes(foot)?;
            let halves = foot.half_vectors(map, target, behind)?;
            let (slope, derivative) = map.slope(&self.theta, halves.t0)?;
            let off = halves.half(halves.t0) - slope;
            // A normal that was turned to the viewer, and the like.
            let same = off.length() <= SAME_SLOPE * (1.0 + slope.length_squared());
            if !same {
                return None;
            }
            let reflection = foot.reflection(Vec2::zero(), slope, behind)?;
            let lit = Lit {
                foot,
                map,
                halves,
                pdf: Some(pdf),
                behind,
            };
            let q = match self.options.region {
                GlintRegion::Texels => {
                    map.choose(&self.theta, &lit.halves, Pick::Of(cell_of(halves.t0)))?
                        .1
                }
                GlintRegion::Footprint => 1.0,
            } * foot.part.by_filter;
            let det = (halves.half_per_texel - derivative).determinant().abs();
            let angle = reflection.slopes_per_angle;
            let covers = covered(&halves.texels_per_pixel, det, angle);
            let drawn = foot.drawn(Vec2::zero());
            Some(self.weight(&lit, halves.t0, [q, covers, drawn], angle))
        };
        found().unwrap_or(0.0)
    }

    /// A random light.
    fn light(&self, foot: &Footprint, rng: &mut Independent) -> Option<Light> {
        let scene = self.scene;
        if scene.emitters().is_empty() {
            return None;
        }
        let emitter = scene.shares().choose(rng.next_bits(), 1).0 as u32;
        let e = &scene.emitters()[emitter as usize];
        let p = foot.si.p.map(|x| x.re);
        let sample = e.sample(scene.lights(), p, rng.next_2d::<f64>())?;
        let pdf = sample.pdf * LightChoice::One.share::<f64>(scene, emitter);
        let target = if sample.distance.is_finite() && sample.distance < f64::from(f32::MAX) {
            Target::Point(p + sample.d * sample.distance)
        } else {
            Target::Direction(sample.d)
        };
        (pdf > 0.0).then_some(Light {
            emitter,
            sample,
            pdf,
            target,
        })
    }

    /// Samples a light and walks to the normals that reflect it.
    fn walk(
        &self,
        foot: &Footprint,
        rng: &mut Independent,
        (stops, came_to): (&Asking, &mut Statistics),
        out: &mut Vec<Glint>,
    ) {
        let Some((map, behind)) = self.slopes(foot) else {
            return;
        };
        let Some(Light {
            emitter,
            sample: light,
            pdf,
            target,
        }) = self.light(foot, rng)
        else {
            return;
        };
        let Some(halves) = foot.half_vectors(map, &target, behind) else {
            return;
        };
        let lit = Lit {
            foot,
            map,
            halves,
            pdf: (!self.scene.emitters()[emitter as usize].is_delta()).then_some(pdf),
            behind,
        };
        came_to.attempts += 1;
        let before = out.len();
        self.solve(&lit, pdf, rng, (stops, came_to), |si, wo, wi, weight| {
            out.push(Glint {
                shape: foot.shape,
                prim: foot.prim,
                si,
                wo,
                wi,
                emitter,
                emission: light.emission,
                weight,
                by_walk: true,
            });
        });
        // Seen from the footprint's point: lights are far, compared with its size.
        if out.len() > before && self.hidden(foot, &light) {
            out.truncate(before);
        }
        came_to.found += u64::from(out.len() > before);
    }

    fn hidden(&self, foot: &Footprint, light: &EmitterSample<f64>) -> bool {
        let exit = self.scene.exit(foot.prim);
        let shadow = (foot.si.primal()).shadow_ray(light.d, light.distance, exit, light.surface);
        self.scene.occluded(&shadow)
    }

    /// Calls `put` with every reflection that walks find, and its weight.
    fn solve(
        &self,
        lit: &Lit,
        pdf: f64,
        rng: &mut Independent,
        (stops, s): (&Asking, &mut Statistics),
        mut put: impl FnMut(SurfaceInteraction<f64>, Vec3<f64>, Vec3<f64>, f64),
    ) {
        let Glints {
            method,
            region,
            threshold,
            steps: most,
            budget,
            ..
        } = self.options;
        let &Lit { map, halves, .. } = lit;
        // A threshold is in texture coordinates.
        let threshold = threshold.map(|x| x * map.texels_per_uv().determinant().abs().sqrt());
        let (cell, q) = match region {
            GlintRegion::Footprint => (None, 1.0),
            GlintRegion::Texels => match map.choose(&self.theta, &halves, Pick::Random(rng)) {
                Some((cell, q)) => {
                    let patch = map.patch(&self.theta, cell);
                    (Some((cell, patch)), q * lit.foot.part.share)
                }
                None => return,
            },
        };
        let mut walk = |s: &mut Statistics| {
            if stops.now() {
                return None;
            }
            let u = rng.next_2d::<f64>();
            let (root, n) = match &cell {
                Some((cell, patch)) => patch.walk(&halves, *cell, u, most),
                None => over_footprint(map, &self.theta, &halves, halves.at(u), most),
            };
            s.walks += 1;
            s.steps += u64::from(n);
            s.converged += u64::from(root.is_some());
            root
        };
        match method {
            GlintMethod::Unbiased => {
                let first = walk(s);
                let worth = first.and_then(|root| Some((self.worth(lit, pdf, q, &root)?, root)));
                if let Some(((si, wo, wi, weight), root)) = worth {
                    let again = || {
                        let found = walk(s);
                        stops.stopped() || found.is_some_and(|found| root.is(&found, threshold))
                    };
                    let (n, exhausted) = trials(again, budget);
                    s.solutions += 1;
                    s.trials += u64::from(n);
                    s.exhausted += u64::from(exhausted);
                    put(si, wo, wi, weight * f64::from(n));
                }
            }
            GlintMethod::Biased(walks) => {
                let found = distinct(walks, || walk(s), |a, b| a.is(b, threshold));
                for root in &found {
                    if let Some((si, wo, wi, weight)) = self.worth(lit, pdf, q, root) {
                        put(si, wo, wi, weight);
                    }
                }
            }
        }
    }

    /// A solution as materials see it, and its weight; `None` where it brings nothing.
    fn worth(&self, lit: &Lit, pdf: f64, q: f64, root: &Root) -> Option<Worth> {
        let Lit {
            foot,
            halves,
            behind,
            ..
        } = lit;
        // A cell may reach into other parts.
        if !halves.contains(root.t) {
            return None;
        }
        let off = halves.pixels(root.t);
        let filter = foot.filter.density(foot.offset(off));
        let reflection = foot.reflection(off, halves.half(root.t), *behind)?;
        if filter == 0.0 {
            return None;
        }
        let angle = reflection.slopes_per_angle;
        let covers = covered(&halves.texels_per_pixel, root.det, angle);
        let by_filter = q * (foot.part.by_filter / foot.part.share);
        let share = self.weight(lit, root.t, [by_filter, covers, foot.drawn(off)], angle);
        let weight = share * filter / (q * pdf * covers);
        let uv = foot.si.uv;
        let mut si = foot.si.primal();
        si.uv = Vec2::new(uv.x, uv.y).map(|x| x.re + x.eps[0] * off.x + x.eps[1] * off.y);
        (weight.is_finite() && weight != 0.0).then_some((si, reflection.wo, reflection.wi, weight))
    }
}

/// Solid angle that the reflections of a square pixel cover, if its normals go on as at a point.
fn covered(texels_per_pixel: &Mat2<f64>, det: f64, slopes_per_angle: f64) -> f64 {
    texels_per_pixel.determinant().abs() * det / slopes_per_angle
}

impl Footprint {
    /// Where the filter of its pixel is asked for a point `off` pixels away.
    fn offset(&self, off: Vec2<f64>) -> [f64; 2] {
        [off.x - self.centre[0], off.y - self.centre[1]]
    }

    /// Density of the point in the image that samples of the pixel see, `off` pixels away.
    fn drawn(&self, off: Vec2<f64>) -> f64 {
        let offset = self.offset(off);
        let weight = self.filter.weight(offset);
        if weight == 0.0 {
            return 0.0;
        }
        self.filter.density(offset) / weight
    }
}
