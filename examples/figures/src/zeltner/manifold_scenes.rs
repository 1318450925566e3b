//! Scenes in which chains of mirrors and glass are looked for: bumps, a wall of metal, and balls of glass.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use ad_core::Vec3;
use render::Scene;
use render::bsdf::{Conductor, Dielectric, Interpolation, Material, NormalMap};
use render::math::warp;
use render::sampler::{Independent, Sampler};
use render::shape::{Cylinder, Mesh, MeshData};

use examples::figure::Result;
use examples::scene_builder::{SceneBuilder, View};

/// Encoded normals of a periodic height field of random waves, `[n][n][3]`, whose slopes have this standard deviation along
/// either axis: nearly Gaussian.
fn bumps(n: usize, slope: f64, seed: u64) -> Vec<f32> {
    const WAVES: u64 = 24;
    const MOST: f64 = 3.0;
    let waves: Vec<([f64; 2], f64)> = (0..WAVES)
        .map(|i| {
            let mut s = Independent::new(seed, 0, i);
            let [a, b] = s.next_2d::<f64>();
            let number = |u: f64| ((2.0 * u - 1.0) * (MOST + 0.5)).round();
            let k = [number(a), number(b)];
            let still = k == [0.0; 2];
            (if still { [1.0, 0.0] } else { k }, s.next_1d())
        })
        .collect();
    let slopes: Vec<[f64; 2]> = (0..n * n)
        .map(|i| {
            let at = [i % n, i / n].map(|j| (j as f64 + 0.5) / n as f64);
            let mut sum = [0.0; 2];
            for (k, phase) in &waves {
                let turns = k[0] * at[0] + k[1] * at[1] + phase;
                let (sin, _) = warp::sin_cos_of_turns(turns.rem_euclid(1.0));
                let size = (k[0] * k[0] + k[1] * k[1]).sqrt();
                sum[0] += sin * k[0] / size;
                sum[1] += sin * k[1] / size;
            }
            sum
        })
        .collect();
    let squares: f64 = slopes.iter().flatten().map(|s| s * s).sum();
    let scale = slope / (squares / (2 * n * n) as f64).sqrt();
    let scaled = slopes.iter().map(|s| s.map(|x| x * scale));
    scaled.flat_map(encoded).collect()
}

/// The texel of a normal map with these slopes.
fn encoded([x, y]: [f64; 2]) -> [f32; 3] {
    let normal = Vec3::new(-x, -y, 1.0).normalize();
    [normal.x, normal.y, normal.z].map(|c| (0.5 * c + 0.5) as f32)
}

/// A material on bumps of [`bumps`].
///
/// # Errors
/// None that the constants here can cause.
pub fn bumpy(
    b: &mut SceneBuilder,
    nested: Arc<Material>,
    slope: f64,
    seed: u64,
) -> Result<Arc<Material>> {
    const TEXELS: usize = 32;
    mapped(b, [TEXELS; 2], &bumps(TEXELS, slope, seed), nested)
}

/// A material under a normal map of so many columns and rows.
fn mapped(
    b: &mut SceneBuilder,
    size: [usize; 2],
    texels: &[f32],
    nested: Arc<Material>,
) -> Result<Arc<Material>> {
    let size = size.map(|n| n as u32);
    let map = b.build.texels("bumps", size, texels, (-1.0, 2.0))?;
    let mapped = NormalMap::new(map, Interpolation::Slopes, nested)?;
    Ok(Arc::new(Material::from(mapped)))
}

/// A height over space: the sum of random waves, so that it has no seams and no poles over any surface.
pub struct Waves {
    /// Wave vectors, in radians per unit of length, and phases.
    waves: Vec<(Vec3<f64>, f64)>,
    /// Largest slope of one of them.
    size: f64,
}

impl Waves {
    /// Of about this wavelength, with slopes of this deviation along every axis.
    pub fn new(length: f64, slope: f64, seed: u64) -> Self {
        const WAVES: u64 = 24;
        let wave = |i: u64| {
            let mut s = Independent::new(seed, 1, i);
            let direction = warp::square_to_sphere(s.next_2d::<f64>());
            let number = TAU / length * (0.7 + 0.6 * s.next_1d::<f64>());
            (direction * number, TAU * s.next_1d::<f64>())
        };
        // The mean of a squared cosine is a half, a third of it along each axis.
        Self {
            waves: (0..WAVES).map(wave).collect(),
            size: slope * (6.0 / WAVES as f64).sqrt(),
        }
    }

    /// The height at a point.
    pub fn height(&self, p: Vec3<f64>) -> f64 {
        let one = |(k, phase): &(Vec3<f64>, f64)| (k.dot(p) + phase).sin() / k.length();
        self.size * self.waves.iter().map(one).sum::<f64>()
    }

    /// Its gradient.
    pub fn gradient(&self, p: Vec3<f64>) -> Vec3<f64> {
        let mut sum = Vec3::zero();
        for (k, phase) in &self.waves {
            sum += *k * (self.size * (k.dot(p) + phase).cos() / k.length());
        }
        sum
    }
}

/// The image of the unit square, of so many columns and rows: points and normals, on the side of (du, dv, n) as a right hand.
fn mesh_of_square(
    [columns, rows]: [u32; 2],
    at: impl Fn(f64, f64) -> [Vec3<f64>; 2],
) -> Result<Mesh> {
    let mut mesh = MeshData::default();
    for j in 0..=rows {
        for i in 0..=columns {
            let uv = [(i, columns), (j, rows)].map(|(k, n)| f64::from(k) / f64::from(n));
            let [p, n] = at(uv[0], uv[1]).map(|v| v.to_array().map(|x| x as f32));
            mesh.positions.push(p);
            mesh.normals.push(n);
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let low = j * (columns + 1) + i;
            let high = low + columns + 1;
            mesh.triangles.push([low, low + 1, high + 1]);
            mesh.triangles.push([low, high + 1, high]);
        }
    }
    Ok(Mesh::new(mesh, false)?)
}

/// A ball around the origin that waves displace, as a mesh of `rows` by twice as many.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn displaced_ball(radius: f64, waves: &Waves, rows: u32) -> Result<Mesh> {
    mesh_of_square([2 * rows, rows], |u, v| {
        let ((sin_u, cos_u), (sin, cos)) = ((TAU * u).sin_cos(), (PI * (1.0 - v)).sin_cos());
        let out = Vec3::new(sin * cos_u, sin * sin_u, cos);
        let (height, slope) = (waves.height(out * radius), waves.gradient(out * radius));
        let across = slope - out * out.dot(slope);
        let along = radius + height;
        [out * along, (out - across * (radius / along)).normalize()]
    })
}

/// The material of a ball around the origin with the normals that these waves give it, of `rows` texels by twice as many.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn mapped_ball(
    b: &mut SceneBuilder,
    radius: f64,
    waves: &Waves,
    rows: usize,
    nested: Arc<Material>,
) -> Result<Arc<Material>> {
    let texel = |k: usize| {
        let (i, j) = (k % (2 * rows), k / (2 * rows));
        let (u, v) = (
            (i as f64 + 0.5) / (2 * rows) as f64,
            (j as f64 + 0.5) / rows as f64,
        );
        let ((sin_u, cos_u), (sin, cos)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
        let out = Vec3::new(sin * cos_u, sin * sin_u, cos);
        let s = Vec3::new(-sin_u, cos_u, 0.0);
        let slope = waves.gradient(out * radius);
        encoded([slope.dot(s), slope.dot(out.cross(s))])
    };
    let texels: Vec<f32> = (0..2 * rows * rows).flat_map(texel).collect();
    mapped(b, [2 * rows, rows], &texels, nested)
}

/// Smooth glass.
///
/// # Errors
/// None that the constants here can cause.
pub fn glass(b: &mut SceneBuilder) -> Result<Arc<Material>> {
    interface(b, 1.5)
}

/// The surface of what has this index.
fn interface(b: &mut SceneBuilder, eta: f64) -> Result<Arc<Material>> {
    Ok(Arc::new(Material::from(Dielectric {
        eta: b.build.scalar("glass.eta.value", eta, (1.01, 4.0))?,
        specular_reflectance: b.colour("glass", "specular_reflectance", [1.0; 3])?,
        specular_transmittance: b.colour("glass", "specular_transmittance", [1.0; 3])?,
    })))
}

/// The material of a quad of this corner and these sides with the normals that waves give it, of `n` by `n` texels.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn mapped_quad(
    b: &mut SceneBuilder,
    quad: [[f64; 3]; 3],
    waves: &Waves,
    n: usize,
    nested: Arc<Material>,
) -> Result<Arc<Material>> {
    let [corner, e1, e2] = quad.map(Vec3::from);
    let texel = |k: usize| {
        let at = |i: usize| (i as f64 + 0.5) / n as f64;
        let slope = waves.gradient(corner + e1 * at(k % n) + e2 * at(k / n));
        encoded([slope.dot(e1.normalize()), slope.dot(e2.normalize())])
    };
    let texels: Vec<f32> = (0..n * n).flat_map(texel).collect();
    mapped(b, [n; 2], &texels, nested)
}

/// Smooth metal.
///
/// # Errors
/// None that the constants here can cause.
pub fn metal(b: &mut SceneBuilder) -> Result<Arc<Material>> {
    let specular_reflectance = b.colour("wall", "specular_reflectance", [0.9; 3])?;
    Ok(Arc::new(Material::from(Conductor {
        specular_reflectance,
        index: None,
    })))
}

/// Corner and sides of the wall of [`mirrored`].
pub const WALL: [[f64; 3]; 3] = [[-5.0, 0.0, -5.0], [10.0, 0.0, 0.0], [0.0, 8.0, 0.0]];

/// A floor before a wall of metal, to which a lamp of this half side turns its front; `wall` makes the metal.
///
/// # Errors
/// Those of `wall`.
pub fn mirrored(
    lamp: f64,
    radiance: f64,
    size: u32,
    wall: impl FnOnce(&mut SceneBuilder) -> Result<Arc<Material>>,
) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-8.0, 0.0, -5.0], [0.0, 0.0, 14.0], [16.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let metal = wall(&mut b)?;
    b.quad("wall", WALL, &metal)?;
    let black = b.matt("lamp", [0.0; 3])?;
    let side = 2.0 * lamp;
    // Towards the wall, a little down.
    let quad = [
        [lamp, 9.0 - lamp, 10.0],
        [-side, 0.0, 0.0],
        [0.0, side, 0.1 * side],
    ];
    let shape = b.quad("lamp", quad, &black)?;
    b.lamp("lamp", shape, [radiance; 3])?;
    b.finish(
        &View {
            eye: [0.0, 16.0, 9.0],
            target: [0.0, 0.0, 1.0],
            fov: 40.0,
            size: [size; 2],
        },
        3,
    )
}

/// Corner and sides of the lamp of [`half_ball`].
pub fn half_ball_lamp(half: f64) -> [[f64; 3]; 3] {
    let (x, y) = (0.625 * half, 0.75 * half);
    [
        [15.25 - x, 12.3 + y, -half],
        [2.0 * x, -2.0 * y, 0.0],
        [0.0, 0.0, 2.0 * half],
    ]
}

/// Radius of the ball of [`half_ball`].
const BALL: f64 = 5.0;

/// A floor with a ball around its middle, of which the upper half is seen, and a lamp of these half sides, 50 degrees above;
/// `ball` puts it there, of the radius that it is told.
///
/// # Errors
/// Those of `ball`.
pub fn half_ball(
    size: u32,
    lamp: f64,
    ball: impl FnOnce(&mut SceneBuilder, f64) -> Result,
) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-9.0, 0.0, -9.0], [0.0, 0.0, 18.0], [18.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    ball(&mut b, BALL)?;
    let black = b.matt("lamp", [0.0; 3])?;
    let shape = b.quad("lamp", half_ball_lamp(lamp), &black)?;
    // As much light whatever its size.
    b.lamp("lamp", shape, [320.0 / (lamp * lamp); 3])?;
    let view = View {
        eye: [8.0, 10.0, 8.0],
        target: [0.0, 0.5, 0.0],
        fov: 45.0,
        size: [size; 2],
    };
    b.finish(&view, 4)
}

/// The ring among the shapes of [`bumpy_ring`].
pub const RING_SHAPE: u32 = 1;

/// The ring of metal of [`super::specular_scenes::RING`] under a normal map of bumps with slopes of this deviation.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn bumpy_ring(slope: f64, seed: u64) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6; 3])?;
    let floor = [[-20.0, 0.0, -20.0], [0.0, 0.0, 40.0], [40.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let smooth = metal(&mut b)?;
    let material = bumpy(&mut b, smooth, slope, seed)?;
    // Its inside, turned to the floor within.
    let wall = Cylinder::new([0.0; 3], [0.0, 4.0, 0.0], 10.0, true).ok_or("no radius")?;
    b.shape("ring", wall, &material);
    let black = b.matt("lamp", [0.0; 3])?;
    let lamp = [[-12.1, 10.0, 7.9], [0.2, 0.0, 0.0], [0.0, 0.0, 0.2]];
    let shape = b.quad("lamp", lamp, &black)?;
    b.lamp("lamp", shape, [70_000.0; 3])?;
    let view = View {
        eye: [0.0, 40.0, 40.0],
        target: [0.0; 3],
        fov: 28.0,
        size: [16; 2],
    };
    b.finish(&view, 4)
}

/// Index of water.
pub const WATER: f64 = 1.33;

/// A pool with waves on its water, seen from above, under a lamp of this half side.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn pool(size: u32, lamp: f64, waves: &Waves) -> Result<Scene> {
    const DEEP: f64 = 1.5;
    let mut b = SceneBuilder::default();
    let tiles = b.matt("tiles", [0.5, 0.6, 0.7])?;
    let floor = [[-2.0, 0.0, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0]];
    b.quad("floor", floor, &tiles)?;
    let up = [0.0, DEEP, 0.0];
    let walls = [
        [[-2.0, 0.0, -2.0], [4.0, 0.0, 0.0], up],
        [[2.0, 0.0, -2.0], [0.0, 0.0, 4.0], up],
        [[2.0, 0.0, 2.0], [-4.0, 0.0, 0.0], up],
        [[-2.0, 0.0, 2.0], [0.0, 0.0, -4.0], up],
    ];
    for (k, wall) in walls.into_iter().enumerate() {
        b.quad(&format!("wall {k}"), wall, &tiles)?;
    }
    let water = [[-2.0, DEEP, -2.0], [0.0, 0.0, 4.0], [4.0, 0.0, 0.0]];
    let smooth = interface(&mut b, WATER)?;
    let material = mapped_quad(&mut b, water, waves, 128, smooth)?;
    b.quad("water", water, &material)?;
    square_lamp(&mut b, [0.8, 4.5], lamp, 10.0)?;
    let view = View {
        eye: [0.0, 7.0, 4.0],
        target: [0.0, 0.4, 0.0],
        fov: 30.0,
        size: [size; 2],
    };
    b.finish(&view, 4)
}

/// A square lamp at this place and height that shines down, of this half side and radiance times area.
fn square_lamp(b: &mut SceneBuilder, [x, height]: [f64; 2], half: f64, power: f64) -> Result<()> {
    let black = b.matt("lamp", [0.0; 3])?;
    let side = 2.0 * half;
    let above = [
        [x - half, height, -half],
        [side, 0.0, 0.0],
        [0.0, 0.0, side],
    ];
    let shape = b.quad("lamp", above, &black)?;
    b.lamp("lamp", shape, [power / (side * side); 3])
}

/// Height of the lower face of [`slab`], and how thick it is.
const SLAB: [f64; 2] = [1.5, 0.4];

/// A floor under a slab of glass with a frame around it, both faces displaced by the same waves elsewhere, or the lower one plane
/// and the whole space below of glass if only `one` face is there, and a lamp of this half side above.
///
/// # Errors
/// None that the constants of figures can cause.
pub fn slab(size: u32, lamp: f64, waves: &Waves, one: bool) -> Result<Scene> {
    const HALF: f64 = 1.5;
    const CELLS: u32 = 40;
    let [low, thick] = SLAB;
    let high = low + thick;
    let mut b = SceneBuilder::default();
    let matt = b.matt("floor", [0.6, 0.5, 0.4])?;
    let floor = [[-2.5, 0.0, -2.5], [0.0, 0.0, 5.0], [5.0, 0.0, 0.0]];
    b.quad("floor", floor, &matt)?;
    let glass = glass(&mut b)?;
    // Seen from above, or from below.
    let face = |y: f64, up: bool| {
        mesh_of_square([CELLS; 2], |u, v| {
            let (x, z) = (HALF * (2.0 * u - 1.0), HALF * (2.0 * v - 1.0));
            let z = if up { -z } else { z };
            let at = Vec3::new(x, y, z);
            let slope = waves.gradient(at);
            let n = Vec3::new(-slope.x, 1.0, -slope.z).normalize();
            let p = Vec3::new(x, y + waves.height(at), z);
            [p, if up { n } else { -n }]
        })
    };
    b.shape("top", face(high, true)?, &glass);
    if !one {
        b.shape("bottom", face(low, false)?, &glass);
    }
    let frame = b.matt("frame", [0.05; 3])?;
    let (foot, tall) = if one { (0.0, high) } else { (low, thick) };
    let up = [0.0, tall + 0.2, 0.0];
    let bars = [
        [[-HALF, foot - 0.1, -HALF], [2.0 * HALF, 0.0, 0.0], up],
        [[HALF, foot - 0.1, -HALF], [0.0, 0.0, 2.0 * HALF], up],
        [[HALF, foot - 0.1, HALF], [-2.0 * HALF, 0.0, 0.0], up],
        [[-HALF, foot - 0.1, HALF], [0.0, 0.0, -2.0 * HALF], up],
    ];
    for (k, bar) in bars.into_iter().enumerate() {
        b.quad(&format!("bar {k}"), bar, &frame)?;
    }
    square_lamp(&mut b, [0.6, 5.0], lamp, 40.0)?;
    let view = View {
        eye: [0.0, 7.0, 5.0],
        target: [0.0, 0.3, 0.0],
        fov: 30.0,
        size: [size; 2],
    };
    // The floor is seen through the slab, and lit through it.
    b.finish(&view, 6)
}
