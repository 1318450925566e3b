//! Scenes of which every pixel sees the same, and what their derivatives are: by quadrature in f64, not
//! by sampling.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use ad_core::{Dual, Real, Vec3};
use render::bsdf::microfacet::{Microfacet, Ndf};
use render::bsdf::{Conductor, Material, RoughConductor, Roughness};
use render::emitter::{Emitter, Envmap, Vmf};
use render::math::{Frame, Transform};
use render::params::Theta;
use render::shape::Sphere;
use render::{Image, Scene};

use crate::figure::Result;
use crate::scene_builder::{POSITIVE, SceneBuilder, View};

type D = Dual<f64, 1>;

/// Name of the roughness.
pub const ROUGHNESS: &str = "metal.alpha.value";
/// Name of the emitted radiance, where it is a parameter.
pub const EMISSION: &str = "light.emitter.radiance.value";

/// Pixels per side where all see the same, so that their spread is the error.
pub const SIZE: u32 = 16;
/// Angle of view, degrees: small enough to be one direction.
pub const FOV: f64 = 1e-3;
/// How far viewer and lights are.
pub const DISTANCE: f64 = 4.0;

/// Radiance, or the mean of an image, and its derivative.
#[derive(Clone, Copy, Debug)]
pub struct Truth {
    /// Radiance.
    pub value: f64,
    /// Derivative.
    pub slope: f64,
    /// How far the quadrature may be off.
    pub error: f64,
    /// Standard deviations of one sample of light sampling and of detached BSDF sampling, where the
    /// quadrature gives them.
    pub std: Option<[f64; 2]>,
}

/// Where the spread of an estimate is read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Values {
    /// Pixels, which see the same.
    Pixels,
    /// The means of images with samples of their own.
    Images,
}

/// One point of a sweep.
#[derive(Debug)]
pub struct Setup {
    /// The scene.
    pub scene: Scene,
    /// Its truth.
    pub truth: Truth,
    /// What the derivative is in, each of its components alike.
    pub param: &'static str,
    /// Where its spread is read from.
    pub values: Values,
}

impl Setup {
    fn in_roughness(scene: Scene, truth: Truth) -> Self {
        Self {
            scene,
            truth,
            param: ROUGHNESS,
            values: Values::Pixels,
        }
    }
}

/// What shines on the plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Light {
    /// The same from everywhere.
    Constant,
    /// `1 + 0.9 cos(k x)` over the angle x from the mirror direction.
    Stripes(u32),
    /// A lobe in the mirror direction and a constant: smooth.
    Lobe,
    /// A ball of this angular radius (radians) in the mirror direction.
    Ball(f64),
}

/// A metal plate that reflects all light, seen under the angle `incidence` (radians) from the normal.
#[derive(Clone, Copy, Debug)]
pub struct Plate {
    /// Its distribution of normals; all of them are sampled.
    pub kind: Ndf,
    /// Its roughness.
    pub alpha: f64,
    /// Angle of the viewer.
    pub incidence: f64,
    /// What it reflects.
    pub light: Light,
}

/// Depth of the modulation of [`Light::Stripes`].
pub const DEPTH: f64 = 0.9;

impl Plate {
    /// Direction to the viewer.
    pub fn wo(&self) -> Vec3<f64> {
        let (sin, cos) = self.incidence.sin_cos();
        Vec3::new(sin, 0.0, cos)
    }

    /// Its reflection.
    pub fn mirror(&self) -> Vec3<f64> {
        let (sin, cos) = self.incidence.sin_cos();
        Vec3::new(-sin, 0.0, cos)
    }

    /// Its distribution of normals.
    pub fn surface<R: Real>(&self, alpha: R, visible: bool) -> Microfacet<R> {
        Microfacet {
            kind: self.kind,
            alpha,
            visible,
        }
    }

    /// The plate in front of its light, and the truth.
    ///
    /// # Errors
    /// A roughness or a size out of range.
    pub fn setup(&self) -> Result<Setup> {
        let scene = self.scene(SceneBuilder::default())?;
        let truth = match self.light {
            Light::Lobe => self.by_moving(&scene),
            _ => self.by_directions(&scene),
        };
        Ok(Setup::in_roughness(scene, truth))
    }

    /// The same in a black environment that could shine.
    ///
    /// # Errors
    /// As [`Plate::setup`].
    pub fn in_the_dark(&self) -> Result<Scene> {
        let mut stage = SceneBuilder::default();
        stage.ambient([0.0; 3])?;
        self.scene(stage)
    }

    /// The plate alone; whether visible normals are sampled.
    ///
    /// # Errors
    /// A roughness out of range.
    pub fn place(&self, stage: &mut SceneBuilder, visible: bool) -> Result<()> {
        let roughness = Roughness {
            kind: self.kind,
            alpha: stage.build.scalar(ROUGHNESS, self.alpha, (1e-4, 1.0))?,
            visible,
        };
        let metal = Arc::new(Material::from(RoughConductor {
            roughness,
            conductor: white(stage, 1.0)?,
        }));
        plane(stage, "plate", &metal)
    }

    fn scene(&self, mut stage: SceneBuilder) -> Result<Scene> {
        self.place(&mut stage, false)?;
        match self.light {
            Light::Constant => stage.ambient([1.0; 3])?,
            Light::Stripes(k) => {
                let map = stripes(k);
                let light = Envmap::new(
                    stage.build.registry(),
                    "light",
                    &map,
                    &Transform::IDENTITY,
                    1.0,
                )?;
                stage.build.add_emitter(light, None);
            }
            Light::Lobe => {
                stage.ambient([0.5; 3])?;
                let radiance = stage.build.rgb("lobe.radiance.value", [2.0; 3], POSITIVE)?;
                let lobe = Vmf::new(radiance, self.mirror().to_array(), 20.0);
                stage.build.add_emitter(lobe.ok_or("no direction")?, None);
            }
            Light::Ball(angle) => {
                let black = stage.matt("black", [0.0; 3])?;
                let center = self.mirror() * DISTANCE;
                let ball =
                    stage.ball("light", center.to_array(), DISTANCE * angle.sin(), &black)?;
                stage.lamp("light", ball, [1.0; 3])?;
            }
        }
        let view = View {
            eye: (self.wo() * DISTANCE).to_array(),
            target: [0.0; 3],
            fov: FOV,
            size: [SIZE; 2],
        };
        stage.finish(&view, 2)
    }

    /// Light from a direction.
    fn incident<R: Real<Primal = f64>>(&self, scene: &Scene, values: &[f64], w: Vec3<R>) -> R {
        if let Light::Ball(_) = self.light {
            // Asked for within its cone only.
            return R::one();
        }
        let theta = Theta::constant(values);
        let light = |e: &render::emitter::AnyEmitter| {
            e.hit(w, None)
                .map_or(R::zero(), |hit| e.eval::<R>(&theta, &hit).g)
        };
        scene.emitters().iter().map(light).sum()
    }

    /// Over directions, in rings around the mirror direction that widen from less than the lobe to
    /// the edge of the light.
    fn by_directions(&self, scene: &Scene) -> Truth {
        let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
        let edge = match self.light {
            Light::Ball(angle) => angle,
            _ => FRAC_PI_2,
        };
        let around = Frame::from_normal(self.mirror());
        let surface = self.surface(D::var(self.alpha, 0), false);
        let wo = self.wo();
        let light_pdf = match self.light {
            Light::Ball(angle) => 1.0 / (TAU * 2.0 * (0.5 * angle).sin().powi(2)),
            _ => 0.25 / PI,
        };
        let ring = |n: usize| {
            let [mut value, mut slope, mut by_light, mut by_lobe] = [0.0; 4];
            let mut bounds = vec![0.0, edge.min(1e-2 * self.alpha)];
            while let Some(&last) = bounds.last()
                && last < edge
            {
                let widened = last * 10f64.powf(1.0 / n as f64);
                bounds.push(widened.min(last + 0.2 / n as f64).min(edge));
            }
            for panel in bounds.windows(2) {
                let (a, b) = (panel[0], panel[1]);
                for (x, weight) in GAUSS {
                    let r = a + (b - a) * (0.5 + 0.5 * x);
                    let (sin, cos) = r.sin_cos();
                    let measure = 0.5 * (b - a) * weight * sin * TAU / (64 * n) as f64;
                    for j in 0..64 * n {
                        let (y, x) = (TAU * j as f64 / (64 * n) as f64).sin_cos();
                        let w = around.to_world(Vec3::new(sin * x, sin * y, cos));
                        if w.z <= 0.0 {
                            continue;
                        }
                        let m = (wo + w).normalize();
                        let f = bsdf(&surface, wo, w, m);
                        let l = self.incident(scene, &values, w);
                        let pdf = surface.primal().pdf_reflected(wo, m);
                        value += measure * f.re * l;
                        slope += measure * f.eps[0] * l;
                        let square = (f.eps[0] * l).powi(2) * measure;
                        by_light += square / light_pdf;
                        // Tails beyond the range of f64.
                        by_lobe += if pdf > 0.0 { square / pdf } else { 0.0 };
                    }
                }
            }
            let std = [by_light, by_lobe].map(|s: f64| (s - slope * slope).max(0.0).sqrt());
            (value, slope, std)
        };
        let (coarse, fine) = (ring(2), ring(3));
        Truth {
            value: fine.0,
            slope: fine.1,
            error: (fine.1 - coarse.1).abs(),
            // Sampling an image of light has another density.
            std: (!matches!(self.light, Light::Stripes(_))).then_some(fine.2),
        }
    }

    /// Over random numbers, with samples that move: for smooth light.
    fn by_moving(&self, scene: &Scene) -> Truth {
        let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
        let surface = self.surface(D::var(self.alpha, 0), true);
        let wo = Vec3::lift(self.wo());
        let grid = |n: usize| {
            let mut sum = D::zero();
            for i in 0..n * n {
                let u = [i % n, i / n].map(|k| (k as f64 + 0.5) / n as f64);
                let m: Vec3<D> = surface.sample(wo, u);
                let w = m * (wo.dot(m) * D::c(2.0)) - wo;
                if w.z.re > 0.0 {
                    // `f / p` for visible normals: masking of the sampled direction.
                    sum += self.incident(scene, &values, w) * (w.z / surface.sigma(w));
                }
            }
            let n2 = (n * n) as f64;
            (sum.re / n2, sum.eps[0] / n2)
        };
        let (coarse, fine) = (grid(300), grid(600));
        Truth {
            value: fine.0,
            slope: fine.1,
            error: (fine.1 - coarse.1).abs(),
            std: None,
        }
    }
}

/// A large square around the origin; its front is towards z.
///
/// # Errors
/// None.
pub fn plane(stage: &mut SceneBuilder, name: &str, material: &Arc<Material>) -> Result<()> {
    let half = 10.0;
    let sides = [[2.0 * half, 0.0, 0.0], [0.0, 2.0 * half, 0.0]];
    stage.quad(name, [[-half, -half, 0.0], sides[0], sides[1]], material)?;
    Ok(())
}

/// BSDF times cosine of a plate that reflects all light.
pub fn bsdf<R: Real<Primal = f64>>(
    surface: &Microfacet<R>,
    wo: Vec3<f64>,
    w: Vec3<f64>,
    m: Vec3<f64>,
) -> R {
    let [wo, w, m] = [wo, w, m].map(Vec3::<R>::lift);
    surface.d(m) * w.z / (surface.sigma(wo) * surface.sigma(w) * R::c(4.0))
}

/// Six-point Gauss-Legendre quadrature on [-1, 1].
pub const GAUSS: [(f64, f64); 6] = [
    (-0.932_469_514_203_152, 0.171_324_492_379_170_4),
    (-0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (-0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_4),
];

fn white(stage: &mut SceneBuilder, reflectance: f64) -> Result<Conductor> {
    Ok(Conductor {
        specular_reflectance: stage.colour("metal", "specular_reflectance", [reflectance; 3])?,
        index: None,
    })
}

/// Vertical stripes, periodic in the longitude; `k` of them around.
fn stripes(k: u32) -> Image {
    let width = 4096;
    let mut image = Image::new(width, 8);
    for (i, texel) in image.data.chunks_exact_mut(3).enumerate() {
        let phi = TAU * ((i % width) as f64 + 0.5) / width as f64;
        texel.fill((1.0 + DEPTH * (f64::from(k) * (phi - PI)).cos()) as f32);
    }
    image
}

/// The inside of a ball of rough metal that glows: every point sees the same, forever.
#[derive(Clone, Copy, Debug)]
pub struct Furnace {
    /// Roughness (GGX).
    pub alpha: f64,
    /// Reflectance of a facet.
    pub reflectance: f64,
    /// Angle of the viewer from the normal, radians.
    pub incidence: f64,
    /// Largest number of path edges; `None` for roulette from the second vertex on.
    pub depth: Option<u32>,
}

impl Furnace {
    /// The ball, seen from within.
    ///
    /// # Errors
    /// A parameter out of range.
    pub fn setup(&self) -> Result<Setup> {
        let mut stage = SceneBuilder::default();
        let roughness = Roughness {
            kind: Ndf::Ggx,
            alpha: stage.build.scalar(ROUGHNESS, self.alpha, (1e-4, 1.0))?,
            visible: true,
        };
        let conductor = white(&mut stage, self.reflectance)?;
        let metal = Arc::new(Material::from(RoughConductor {
            roughness,
            conductor,
        }));
        let ball = Sphere::new([0.0; 3], 1.0, true).ok_or("no ball")?;
        let shape = stage.shape("ball", ball, &metal);
        stage.lamp("light", shape, [1.0; 3])?;
        let height = self.incidence.sin();
        let view = View {
            eye: [0.0, height, 0.0],
            target: [1.0, height, 0.0],
            fov: FOV,
            size: [SIZE; 2],
        };
        let mut scene = stage.finish(&view, self.depth.unwrap_or(u32::MAX))?;
        if self.depth.is_none() {
            scene.settings.rr_depth = 2;
        }
        let [coarse, fine] = [48, 64].map(|n| self.radiance(n, self.depth.unwrap_or(400)));
        let truth = Truth {
            value: fine.re,
            slope: fine.eps[0],
            error: (fine.eps[0] - coarse.eps[0]).abs(),
            std: None,
        };
        Ok(Setup::in_roughness(scene, truth))
    }

    /// Radiance of all paths of up to `depth` edges. A chord meets the ball under the same angle at both
    /// ends, so light is a function of the angle alone: `L = 1 + K L`, over `n` angles.
    pub fn radiance(&self, n: usize, depth: u32) -> Dual<f64, 1> {
        let surface = Microfacet {
            kind: Ndf::Ggx,
            alpha: D::var(self.alpha, 0),
            visible: true,
        };
        // Midpoints in the angle: the integrand vanishes at both ends.
        let angle = |i: usize| FRAC_PI_2 * (i as f64 + 0.5) / n as f64;
        let at = |theta: f64, phi: f64| {
            let (sin, cos) = theta.sin_cos();
            Vec3::new(sin * phi.cos(), sin * phi.sin(), cos)
        };
        let row = |theta: f64| -> Vec<D> {
            let wo = at(theta, 0.0);
            let scattered = |j: usize| {
                let measure = FRAC_PI_2 / n as f64 * angle(j).sin() * PI / (2 * n) as f64;
                let sum: D = (0..2 * n)
                    .map(|k| {
                        let phi = PI * (k as f64 + 0.5) / (2 * n) as f64;
                        let w = at(angle(j), phi);
                        bsdf(&surface, wo, w, (wo + w).normalize())
                    })
                    .sum();
                // Half of the azimuths: the other half is the same.
                sum * D::c(2.0 * self.reflectance * measure)
            };
            (0..n).map(scattered).collect()
        };
        let rows: Vec<Vec<D>> = (0..n).map(|i| row(angle(i))).collect();
        let apply = |row: &[D], light: &[D]| -> D {
            row.iter().zip(light).map(|(k, l)| *k * *l).sum::<D>() + D::one()
        };
        let mut light = vec![D::one(); n];
        for _ in 2..depth {
            light = rows.iter().map(|row| apply(row, &light)).collect();
        }
        match depth {
            0 => D::zero(),
            1 => D::one(),
            _ => apply(&row(self.incidence), &light),
        }
    }
}

/// Standard deviations of attached and detached sampling of `1 + 0.9 cos(k x)` by a Gaussian of two
/// dimensions, with respect to the width `s` of the Gaussian, times `s`: functions of `q = k s`
/// (after errata F28). The mean is `1 + 0.9 exp(-q^2 / 2)`.
pub fn stripe_laws(q: f64) -> [f64; 2] {
    let a = DEPTH;
    let q2 = q * q;
    let slope = -a * q2 * (-0.5 * q2).exp();
    // E[sin^2(q x) x^2] with x standard normal.
    let moved = 0.5 * a * a * q2 * (1.0 - (1.0 - 4.0 * q2) * (-2.0 * q2).exp());
    // E[(x^2 + y^2 - 2)^2 (1 + a cos(q x))^2]: the second factor is a sum of cosines with frequencies
    // 0, q and 2 q, and E[(x^2 - 1)^2 cos(f x)] = (2 - 4 f^2 + f^4) exp(-f^2 / 2).
    let moment = |f: f64| {
        let f2 = f * f;
        // The second direction adds E[(y^2 - 1)^2] = 2; mixed terms vanish.
        ((2.0 - 4.0 * f2 + f2 * f2) + 2.0) * (-0.5 * f2).exp()
    };
    let scored =
        (1.0 + 0.5 * a * a) * moment(0.0) + 2.0 * a * moment(q) + 0.5 * a * a * moment(2.0 * q);
    [moved, scored].map(|m| (m - slope * slope).max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Directional albedos of errata section 9 with product masking; and the law of F1.
    #[test]
    fn quadrature_meets_known_numbers() {
        let plate = Plate {
            kind: Ndf::Ggx,
            alpha: 0.5,
            incidence: 0.0,
            light: Light::Constant,
        };
        let truth = plate.setup().unwrap().truth;
        assert!((truth.value - 0.6878).abs() < 1e-4, "{truth:?}");
        for (kind, law) in [(Ndf::Beckmann, 2.0), (Ndf::Ggx, 2.0 / 3f64.sqrt())] {
            let smooth = Plate {
                kind,
                alpha: 1e-3,
                ..plate
            };
            let truth = smooth.setup().unwrap().truth;
            let [_, detached] = truth.std.unwrap();
            assert!((detached * 1e-3 / law - 1.0).abs() < 2e-3, "{truth:?}");
            // In units of 1 / alpha.
            let error = truth.error * smooth.alpha;
            assert!(truth.slope.abs() < 1e-2 && error < 1e-4, "{truth:?}");
        }
    }

    /// dI/d alpha by moving samples equals that over directions.
    #[test]
    fn both_quadratures_agree() {
        let plate = Plate {
            kind: Ndf::Beckmann,
            alpha: 0.3,
            incidence: 0.6,
            light: Light::Lobe,
        };
        let scene = plate.setup().unwrap().scene;
        let (a, b) = (plate.by_moving(&scene), plate.by_directions(&scene));
        assert!((a.value - b.value).abs() < 1e-3, "{a:?} {b:?}");
        assert!((a.slope / b.slope - 1.0).abs() < 5e-3, "{a:?} {b:?}");
    }

    /// Nothing is lost at first, and a factor of the albedo per bounce.
    #[test]
    fn furnace_is_a_geometric_series() {
        let furnace = Furnace {
            alpha: 0.3,
            reflectance: 0.5,
            incidence: 0.7,
            depth: None,
        };
        let up_to = |depth| furnace.radiance(64, depth).re;
        assert_eq!((up_to(0), up_to(1)), (0.0, 1.0));
        let terms: Vec<f64> = (1..6).map(|d| up_to(d + 1) - up_to(d)).collect();
        assert!(terms[0] > 0.4 && terms[0] < 0.5, "{terms:?}");
        assert!(
            terms
                .windows(2)
                .all(|t| t[1] < 0.5 * t[0] && t[1] > 0.4 * t[0]),
            "{terms:?}"
        );
    }

    /// The rows of errata F28, whose Gaussian has one dimension, bracket the crossover at about 3.
    #[test]
    fn stripes_favour_moving_samples_while_they_are_wide() {
        let better = |q: f64| {
            let [attached, detached] = stripe_laws(q);
            attached < detached
        };
        assert!(better(0.1) && better(2.0) && !better(5.0) && !better(10.0));
    }
}
