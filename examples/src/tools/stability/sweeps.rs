//! What is varied, and where.

use render::bsdf::microfacet::Ndf;
use render::instances::Estimator;

use super::moving;
use super::setup::{Furnace, Light, Plate, Setup, Truth, stripe_laws};
use crate::figure::Result;

/// Stripes around the horizon of [`Light::Stripes`].
pub const STRIPES: u32 = 16;
/// Reflectance of a facet of the furnace.
pub const REFLECTANCE: f64 = 0.8;
/// Roughness of the furnace.
pub const FURNACE_ALPHA: f64 = 0.3;
/// Angle of the viewer in the furnace, radians.
const FURNACE_ANGLE: f64 = 0.7;
/// Angle of the viewer of plates under a ball light, radians.
pub const BALL_INCIDENCE: f64 = 0.5;
/// Angular radius of the ball, where it is not swept.
pub const BALL: f64 = 0.3;
/// Roughness under a ball, where it is not swept.
pub const BALL_ALPHA: f64 = 0.1;

/// A law that a curve should follow.
#[derive(Clone, Copy)]
pub struct Law {
    /// What it is called in the chart.
    pub name: &'static str,
    /// Estimator that follows it.
    pub estimator: Estimator,
    /// Standard deviation of one sample over the radiance.
    pub std: fn(f64) -> f64,
    /// Points between these are compared.
    pub range: [f64; 2],
}

/// What a derivative is in, and what it is measured by.
#[derive(Clone, Copy)]
pub enum Of {
    /// A roughness, which is this at a point: differences and spreads are those of `d ln I / d ln alpha`.
    Roughness(fn(f64) -> f64),
    /// A position or a size: differences and spreads are relative to the derivative.
    Motion,
}

impl Of {
    /// What a difference or a spread of derivatives is divided by.
    pub fn unit(self, x: f64, truth: &Truth) -> f64 {
        match self {
            Self::Roughness(alpha) => truth.value / alpha(x),
            Self::Motion => truth.slope.abs(),
        }
    }
}

/// One axis.
pub struct Sweep {
    /// In tables.
    pub name: &'static str,
    /// Above its charts.
    pub title: &'static str,
    /// Below its charts.
    pub axis: &'static str,
    /// What the derivative is in.
    pub of: Of,
    /// Whether the axis is the roughness.
    pub over_roughness: bool,
    /// Whether the axis is logarithmic.
    pub log: bool,
    /// Where it is measured.
    pub points: Vec<f64>,
    /// The scene at a point.
    pub setup: Box<dyn Fn(f64) -> Result<Setup> + Send + Sync>,
    /// Known laws.
    pub laws: Vec<Law>,
}

/// `n` points from `low` to `high`, evenly in the logarithm.
fn logarithmic(low: f64, high: f64, n: usize) -> Vec<f64> {
    let at = |i: usize| low * (high / low).powf(i as f64 / (n - 1) as f64);
    (0..n).map(at).collect()
}

/// Width of the lobe of Beckmann facets in angle, at normal incidence: slopes vary by alpha / sqrt 2 along
/// each axis, and a mirror doubles angles.
pub fn lobe_width(alpha: f64) -> f64 {
    std::f64::consts::SQRT_2 * alpha
}

fn stripes(alpha: f64, which: usize) -> f64 {
    let q = f64::from(STRIPES) * lobe_width(alpha);
    let radiance = 1.0 + super::setup::DEPTH * (-0.5 * q * q).exp();
    stripe_laws(q)[which] / alpha / radiance
}

/// Roughness under one light, for the viewer at `incidence`.
fn roughness(
    name: &'static str,
    title: &'static str,
    points: Vec<f64>,
    plate: Plate,
    laws: Vec<Law>,
) -> Sweep {
    Sweep {
        name,
        title,
        axis: "roughness α",
        of: Of::Roughness(|alpha| alpha),
        over_roughness: true,
        log: true,
        points,
        setup: Box::new(move |alpha| Plate { alpha, ..plate }.setup()),
        laws,
    }
}

/// All sweeps of derivatives in roughness.
pub fn all(quick: bool) -> Vec<Sweep> {
    let alphas = || logarithmic(1e-4, 1.0, if quick { 5 } else { 17 });
    let plate = Plate {
        kind: Ndf::Beckmann,
        alpha: BALL_ALPHA,
        incidence: 0.0,
        light: Light::Constant,
    };
    let ball = Plate {
        incidence: BALL_INCIDENCE,
        light: Light::Ball(BALL),
        ..plate
    };
    let law = |name, estimator, std, range| Law {
        name,
        estimator,
        std,
        range,
    };
    vec![
        roughness(
            "roughness-beckmann",
            "Beckmann, constant light (F1)",
            alphas(),
            plate,
            vec![law("2/α", Estimator::Detached, |a| 2.0 / a, [1e-4, 0.2])],
        ),
        roughness(
            "roughness-ggx",
            "GGX, constant light (F1)",
            alphas(),
            Plate {
                kind: Ndf::Ggx,
                ..plate
            },
            vec![law(
                "2/(√3 α)",
                Estimator::Detached,
                |a| 2.0 / 3f64.sqrt() / a,
                [1e-4, 0.02],
            )],
        ),
        roughness(
            "roughness-stripes",
            "Beckmann, stripes of light (F28)",
            alphas(),
            Plate {
                light: Light::Stripes(STRIPES),
                ..plate
            },
            vec![
                law(
                    "attached",
                    Estimator::Attached,
                    |a| stripes(a, 0),
                    [5e-3, 0.2],
                ),
                law(
                    "detached",
                    Estimator::Detached,
                    |a| stripes(a, 1),
                    [1e-4, 0.2],
                ),
            ],
        ),
        roughness(
            "roughness-ball",
            "Beckmann, ball light (F1, F8)",
            alphas(),
            ball,
            Vec::new(),
        ),
        Sweep {
            name: "light-size",
            title: "Size of a ball light (F8)",
            axis: "angular radius of the light (rad)",
            of: Of::Roughness(|_| BALL_ALPHA),
            over_roughness: false,
            log: true,
            points: logarithmic(1e-3, 1.0, if quick { 4 } else { 13 }),
            setup: Box::new(move |r| {
                Plate {
                    light: Light::Ball(r),
                    ..ball
                }
                .setup()
            }),
            laws: Vec::new(),
        },
        Sweep {
            name: "incidence",
            title: "Angle of the viewer, smooth light (F9, F43)",
            axis: "angle from the normal (degrees)",
            of: Of::Roughness(|_| 0.3),
            over_roughness: false,
            log: false,
            points: if quick {
                vec![0.0, 45.0, 85.0, 89.9]
            } else {
                vec![
                    0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 75.0, 80.0, 84.0, 87.0, 89.0,
                    89.9,
                ]
            },
            setup: Box::new(move |degrees: f64| {
                Plate {
                    kind: Ndf::Ggx,
                    alpha: 0.3,
                    incidence: degrees.to_radians(),
                    light: Light::Lobe,
                }
                .setup()
            }),
            laws: Vec::new(),
        },
        Sweep {
            name: "depth",
            title: "Path length, inside a glowing ball (F37, F40)",
            axis: "edges of the longest path",
            of: Of::Roughness(|_| FURNACE_ALPHA),
            over_roughness: false,
            log: true,
            points: if quick {
                vec![2.0, 8.0]
            } else {
                vec![2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0]
            },
            setup: Box::new(|depth| furnace(Some(depth as u32)).setup()),
            laws: Vec::new(),
        },
    ]
}

/// All sweeps of derivatives in what moves.
pub fn motion(quick: bool) -> Vec<Sweep> {
    let sweep = |name, title, axis, points, setup: fn(f64) -> Result<Setup>| Sweep {
        name,
        title,
        axis,
        of: Of::Motion,
        over_roughness: false,
        log: true,
        points,
        setup: Box::new(setup),
        laws: Vec::new(),
    };
    vec![
        sweep(
            "silhouette",
            "Size of a silhouette, ball that grows (F10)",
            "radius of the ball (pixels)",
            logarithmic(3e-3, 1.5, if quick { 3 } else { 10 }),
            moving::silhouette,
        ),
        sweep(
            "contact",
            "Distance of a shadow's ball that rises (F10)",
            "height of its centre over the floor (radii)",
            if quick {
                vec![1.02, 4.0]
            } else {
                vec![
                    1.01, 1.02, 1.05, 1.1, 1.2, 1.5, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0,
                ]
            },
            moving::contact,
        ),
        sweep(
            "reflection",
            "Roughness below a ball that moves (F10)",
            "roughness α",
            logarithmic(1e-3, 1.0, if quick { 3 } else { 13 }),
            moving::reflection,
        ),
        sweep(
            "bounces",
            "Path length, bulb in a ball that moves (F44)",
            "edges of the longest path",
            if quick {
                vec![2.0, 6.0]
            } else {
                vec![2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0]
            },
            |depth| moving::bounces(depth as u32),
        ),
        sweep(
            "facets",
            "Faces of a solid that grows (F10)",
            "number of faces",
            if quick {
                vec![8.0, 512.0]
            } else {
                (0..6).map(|k| 8.0 * 4f64.powi(k)).collect()
            },
            |faces| moving::facets(faces as usize),
        ),
    ]
}

/// The ball of the sweep over path lengths.
pub fn furnace(depth: Option<u32>) -> Furnace {
    Furnace {
        alpha: FURNACE_ALPHA,
        reflectance: REFLECTANCE,
        incidence: FURNACE_ANGLE,
        depth,
    }
}
