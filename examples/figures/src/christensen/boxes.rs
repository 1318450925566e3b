//! The four boxes of figure 1, and a model of them that is refined step by step.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

use render::bsdf::Material;
use render::emitter::Area;
use render::finite_element::{FiniteElements, Options, Statistics};
use render::statistics::Estimate;
use render::{Image, Scene};

use examples::figure::Result;
use examples::scene_builder::{POSITIVE, SceneBuilder, View, picture};

/// The images of figure 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// A diffuse lamp in the ceiling, diffuse walls.
    A,
    /// Diffuse lamps close to the walls, diffuse walls.
    B,
    /// Directional lamps that send little light to the eye, diffuse walls.
    C,
    /// Directional lamps, one of which sends light to the eye; glossy walls.
    D,
}

impl Which {
    /// All four.
    pub const ALL: [Self; 4] = [Self::A, Self::B, Self::C, Self::D];

    /// The letter of the image.
    pub fn letter(self) -> &'static str {
        match self {
            Self::A => "a",
            Self::B => "b",
            Self::C => "c",
            Self::D => "d",
        }
    }
}

/// Sharpness of the directional lamps: `cos^30`.
pub const EXPONENT: f32 = 30.0;
/// GGX roughness of glossy walls.
pub const ALPHA: f64 = 0.15;

/// Distance of the eye from the middle of the box, but in (b).
pub const EYE: f64 = 3.9;

struct Lamp {
    center: [f64; 3],
    normal: [f64; 3],
    side: f64,
    radiance: f64,
    exponent: f32,
}

/// One of the boxes: [-1, 1]^3, open to the camera, seen in `size * size` pixels. `dark` more lamps
/// shine at the side walls and the ceiling, away from the camera.
///
/// # Errors
/// None for a size above zero.
pub fn scene(which: Which, size: u32, dark: usize) -> Result<Scene> {
    let mut builder = SceneBuilder::default();
    let mut wall = |name: &str, rgb: [f64; 3]| -> Result<Arc<Material>> {
        if which == Which::D {
            // One-sided like the diffuse walls: the camera is never behind them.
            builder.front_metal(name, rgb, ALPHA)
        } else {
            builder.matt(name, rgb)
        }
    };
    let white = wall("white", [0.7; 3])?;
    let left = wall("left", [0.65, 0.15, 0.1])?;
    let right = wall("right", [0.15, 0.25, 0.65])?;
    let black = builder.matt("black", [0.0; 3])?;
    let (x, y, z) = ([2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]);
    let minus = |v: [f64; 3]| v.map(|c: f64| -c);
    builder.quad("floor", [[-1.0, -1.0, 1.0], x, minus(z)], &white)?;
    builder.quad("ceiling", [[-1.0, 1.0, -1.0], x, z], &white)?;
    builder.quad("back", [[-1.0, -1.0, -1.0], x, y], &white)?;
    builder.quad("left", [[-1.0, -1.0, 1.0], minus(z), y], &left)?;
    builder.quad("right", [[1.0, -1.0, -1.0], z, y], &right)?;
    for (i, l) in lamps(which, dark).iter().enumerate() {
        let name = format!("lamp {i}");
        let shape = builder.quad(&name, square(l), &black)?;
        let radiance = format!("{name}.emitter.radiance.value");
        let radiance = builder.build.rgb(&radiance, [l.radiance; 3], POSITIVE)?;
        let light = Area {
            radiance,
            exponent: l.exponent,
            shape,
        };
        builder.build.add_emitter(light, Some(shape));
    }
    // (b) is seen from farther away: oblique walls are where the paper expects importance to pay there.
    let (distance, fov) = if which == Which::B {
        (8.0, 19.5)
    } else {
        (EYE, 38.0)
    };
    let view = View {
        eye: [0.0, 0.0, distance],
        target: [0.0; 3],
        fov,
        size: [size; 2],
    };
    let mut scene = builder.finish(&view, 40)?;
    scene.settings.rr_depth = 8;
    Ok(scene)
}

fn lamps(which: Which, dark: usize) -> Vec<Lamp> {
    let lamp = |center, normal, side, radiance, exponent| Lamp {
        center,
        normal,
        side,
        radiance,
        exponent,
    };
    let (left, right, up) = ([-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let mut lamps = match which {
        Which::A => vec![lamp([0.0, 0.98, 0.0], [0.0, -1.0, 0.0], 0.6, 8.0, 0.0)],
        Which::B => vec![
            lamp([-0.7, 0.2, 0.1], left, 0.3, 6.0, 0.0),
            lamp([0.7, -0.2, -0.2], right, 0.3, 6.0, 0.0),
            lamp([0.1, 0.3, -0.7], [0.0, 0.0, -1.0], 0.3, 6.0, 0.0),
            lamp([0.0, -0.7, 0.3], [0.0, -1.0, 0.0], 0.3, 6.0, 0.0),
        ],
        Which::C | Which::D => {
            // In (c) the fourth lamp shines at the back wall; in (d) between the eye and the point of
            // the floor that mirrors it to the eye.
            let fourth = if which == Which::C {
                lamp([0.0, -0.3, -0.3], [0.0, 0.0, -1.0], 0.25, 30.0, EXPONENT)
            } else {
                lamp([0.0, -0.7, -0.7], [0.0, -0.09, 1.0], 0.25, 30.0, EXPONENT)
            };
            vec![
                lamp([-0.4, 0.2, -0.2], left, 0.25, 30.0, EXPONENT),
                lamp([0.4, 0.1, -0.1], right, 0.25, 30.0, EXPONENT),
                lamp([0.0, 0.5, -0.3], up, 0.25, 30.0, EXPONENT),
                fourth,
            ]
        }
    };
    let walls = [left, right, up];
    for i in 0..dark {
        let normal = walls[i % 3];
        // Spread over the wall, half way to it.
        let (a, b) = (
            1.5 * ((i as f64 + 0.5) * 0.618_034).fract() - 0.75,
            1.5 * ((i as f64 + 0.5) / dark as f64) - 0.75,
        );
        let center = match i % 3 {
            0 => [-0.7, a, b],
            1 => [0.7, a, b],
            _ => [a, 0.7, b],
        };
        lamps.push(lamp(center, normal, 0.12, 60.0, EXPONENT));
    }
    lamps
}

/// The square of a lamp, front towards its normal.
fn square(l: &Lamp) -> [[f64; 3]; 3] {
    let frame = render::math::Frame::from_normal(ad_core::Vec3::from(l.normal).normalize());
    let (s, t) = (frame.s * l.side, frame.t * l.side);
    let corner = ad_core::Vec3::from(l.center) - (s + t) * 0.5;
    [corner.to_array(), s.to_array(), t.to_array()]
}

/// One state of a model that is being refined.
#[derive(Clone, Debug)]
pub struct Step {
    /// Tolerance that it meets.
    pub tolerance: f64,
    /// Numbers of elements and links.
    pub size: Statistics,
    /// Seconds so far.
    pub seconds: f64,
    /// The picture, one radiance per element.
    pub flat: Image,
    /// The picture, interpolated.
    pub interpolated: Image,
}

/// Options that all figures share.
pub fn options(importance: bool) -> Options {
    Options {
        importance,
        finest: 1.0 / 16384.0,
        ..Options::default()
    }
}

/// Refines a model until `enough` says so, halving the tolerance from step to step.
///
/// # Errors
/// A scene that is not supported.
pub fn refine<'a>(
    scene: &'a Scene,
    options: Options,
    first: f64,
    mut enough: impl FnMut(&[Step]) -> bool,
) -> Result<(FiniteElements<'a>, Vec<Step>)> {
    let start = Instant::now();
    let mut idle = 0.0;
    let mut model = FiniteElements::new(scene, options)?;
    let mut steps: Vec<Step> = Vec::new();
    let mut tolerance = first;
    loop {
        model.solve()?;
        let seconds = start.elapsed().as_secs_f64() - idle;
        steps.push(Step {
            tolerance,
            size: model.statistics(),
            seconds,
            flat: model.flat(),
            interpolated: model.interpolated(),
        });
        if enough(&steps) {
            return Ok((model, steps));
        }
        idle = start.elapsed().as_secs_f64() - seconds;
        tolerance *= 0.5;
        model.refine(tolerance);
    }
}

/// Root mean square of the difference over that of the reference, over pixels in the mask.
pub fn difference(a: &Image, reference: &Image, mask: &[bool]) -> f64 {
    let (mut sum, mut square) = (0.0, 0.0);
    let pixels = a.data.chunks_exact(3).zip(reference.data.chunks_exact(3));
    for ((a, b), _) in pixels.zip(mask).filter(|(_, m)| **m) {
        for (a, b) in a.iter().zip(b) {
            sum += f64::from(a - b).powi(2);
            square += f64::from(*b).powi(2);
        }
    }
    (sum / square).sqrt()
}

/// Pixels that see one surface and no lamp.
pub fn mask(model: &FiniteElements) -> Vec<bool> {
    model.surfaces().iter().map(Option::is_some).collect()
}

/// Means of pictures over `cells * cells` patches of every surface: pixels that see one surface and no lamp.
/// Slivers at the edge of the mask are no patches.
pub fn patches<const N: usize>(
    model: &FiniteElements,
    pictures: [&Image; N],
    cells: f64,
) -> [Image; N] {
    let mut found = BTreeMap::<(u32, u64, u64), Vec<usize>>::new();
    for (i, seen) in model.surfaces().iter().enumerate() {
        if let Some((root, [u, v])) = seen {
            let key = (*root, (u * cells) as u64, (v * cells) as u64);
            found.entry(key).or_default().push(i);
        }
    }
    found.retain(|_, pixels| pixels.len() >= 8);
    let means = |picture: &Image| {
        let mut means = Image::new(found.len(), 1);
        for (pixels, mean) in found.values().zip(means.data.chunks_exact_mut(3)) {
            for (c, mean) in mean.iter_mut().enumerate() {
                let values = pixels.iter().map(|i| f64::from(picture.data[3 * i + c]));
                *mean = (values.sum::<f64>() / pixels.len() as f64) as f32;
            }
        }
        means
    };
    pictures.map(means)
}

/// Patches of a picture, and [`difference`] of their means from those of a reference.
pub fn patch_difference(model: &FiniteElements, a: &Image, reference: &Image, cells: f64) -> f64 {
    let [a, reference] = patches(model, [a, reference], cells);
    difference(&a, &reference, &vec![true; a.width])
}

/// How far a picture is off, relative to the reference, root mean square.
#[derive(Clone, Copy, Debug)]
pub struct Off {
    /// The estimate; zero if noise hides it.
    pub rms: f64,
    /// Two standard errors above, from the spread over pixels.
    pub most: f64,
}

impl fmt::Display for Off {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [rms, most] = [self.rms, self.most].map(|x| 100.0 * x);
        write!(f, "{rms:.2} % (at most {most:.2} %)")
    }
}

/// [`difference`] from what two independent noisy references have in common: their noise drops out,
/// `E[(a - r_1)(a - r_2)] = (a - r)^2`.
pub fn noiseless_difference(a: &Image, references: [&Image; 2], mask: &[bool]) -> Off {
    let [r, s] = references.map(|image| image.data.chunks_exact(3));
    let mut square = 0.0;
    let mut pixels = Vec::new();
    for (((a, r), s), _) in (a.data.chunks_exact(3).zip(r).zip(s).zip(mask)).filter(|(_, m)| **m) {
        let mut product = 0.0;
        for c in 0..3 {
            let [a, r, s] = [a, r, s].map(|v| f64::from(v[c]));
            product += (a - r) * (a - s);
            square += r * s;
        }
        pixels.push(product);
    }
    let n = pixels.len() as f64;
    let found = Estimate::of(&pixels);
    let relative = |mean: f64| (mean.max(0.0) * n / square).sqrt();
    Off {
        rms: relative(found.mean),
        most: relative(found.mean + 2.0 * found.se),
    }
}

/// [`noiseless_difference`] over patches, and their number.
pub fn noiseless_patch_difference(
    model: &FiniteElements,
    a: &Image,
    references: [&Image; 2],
    cells: f64,
) -> (Off, usize) {
    let [r, s] = references;
    let [a, r, s] = patches(model, [a, r, s], cells);
    let all = vec![true; a.width];
    (noiseless_difference(&a, [&r, &s], &all), a.width)
}

/// Two independent path-traced pictures.
pub fn traced(scene: &Scene, seed: u64, spp: u64) -> [Image; 2] {
    [seed, seed + 1000].map(|seed| picture(scene, seed, spp).image(0))
}

/// The mean of two pictures.
pub fn average([a, b]: &[Image; 2]) -> Image {
    let mut mean = a.clone();
    for (m, b) in mean.data.iter_mut().zip(&b.data) {
        *m = 0.5 * (*m + b);
    }
    mean
}
