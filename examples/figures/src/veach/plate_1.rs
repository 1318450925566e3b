//! A bump-mapped pot and a faceted sphere with smooth shading normals, by particles [Veach 1996, plate 1].

use std::collections::{BTreeMap, HashMap};

use ad_core::Vec3;
use render::Scene;
use render::bsdf::kernel::Rules;
use render::integrator::render::Rendering;
use render::shape::{Mesh, MeshData, Shape};

use super::{IGNORED, particles, paths};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::{SceneBuilder, View, lathe};

/// A sphere of triangles: an icosahedron whose triangles are split into four, `level` times. The normals are
/// those of the sphere.
fn icosphere(centre: [f64; 3], radius: f64, level: u32) -> MeshData {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut points: Vec<Vec3<f64>> = Vec::new();
    for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
        points.push(Vec3::new(a, b, 0.0).normalize());
    }
    for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
        points.push(Vec3::new(0.0, a, b).normalize());
    }
    for (a, b) in [(-1.0, g), (1.0, g), (-1.0, -g), (1.0, -g)] {
        points.push(Vec3::new(b, 0.0, a).normalize());
    }
    // The twenty triples of neighbours.
    let near = |a: usize, b: usize| points[a].dot(points[b]) > 0.4;
    let mut triangles: Vec<[usize; 3]> = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let out = (points[b] - points[a]).cross(points[c] - points[a]);
                    let front = out.dot(points[a]) > 0.0;
                    triangles.push(if front { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..level {
        let mut middles = HashMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in triangles {
            let mut middle = |i: usize, j: usize| {
                *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| {
                    points.push((points[i] + points[j]).normalize());
                    points.len() - 1
                })
            };
            let (d, e, f) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, d, f], [d, b, e], [f, e, c], [d, e, f]]);
        }
        triangles = finer;
    }
    let single = |v: Vec3<f64>| v.to_array().map(|x| x as f32);
    MeshData {
        positions: points
            .iter()
            .map(|&p| single(Vec3::from(centre) + p * radius))
            .collect(),
        normals: points.iter().map(|&p| single(p)).collect(),
        uvs: Vec::new(),
        triangles: (triangles.iter()).map(|t| t.map(|i| i as u32)).collect(),
    }
}

/// A pot whose shading normals have bumps that its surface has not.
fn pot(at: [f64; 3]) -> MeshData {
    let profile: Vec<[f64; 2]> = (0..=60)
        .map(|i| {
            let t = f64::from(i) / 60.0;
            [
                0.25 + 0.45 * (std::f64::consts::PI * t).sin().max(0.0).sqrt() * (1.0 - 0.35 * t),
                1.2 * t,
            ]
        })
        .collect();
    let mut mesh = lathe(&profile, 160, at);
    let bump = |p: [f32; 3]| {
        let [x, y, z] = p.map(|c| 22.0 * f64::from(c));
        Vec3::new(x.cos() * y.sin(), y.cos() * z.sin(), z.cos() * x.sin()) * 0.35
    };
    for (n, p) in mesh.normals.iter_mut().zip(&mesh.positions) {
        let normal = Vec3::from(n.map(f64::from)).normalize();
        let b = bump(*p);
        let tilted = (normal + b - normal * normal.dot(b)).normalize();
        *n = tilted.to_array().map(|x| x as f32);
    }
    mesh
}

/// The scene and the index of the sphere.
fn still_life(width: u32) -> Result<(Scene, u32, MeshData)> {
    let mut builder = SceneBuilder::default();
    let ground = builder.matt("ground", [0.5, 0.48, 0.45])?;
    let clay = builder.matt("clay", [0.7, 0.4, 0.25])?;
    let chalk = builder.matt("chalk", [0.6, 0.65, 0.75])?;
    let black = builder.matt("black", [0.0; 3])?;
    builder.quad(
        "floor",
        [[-4.0, 0.0, 4.0], [8.0, 0.0, 0.0], [0.0, 0.0, -8.0]],
        &ground,
    )?;
    builder.shape("pot", Mesh::new(pot([-0.8, 0.0, 0.0]), false)?, &clay);
    let ball = icosphere([0.85, 0.75, 0.1], 0.75, 2);
    let sphere = builder.shape("sphere", Mesh::new(ball.clone(), false)?, &chalk);
    let lamp = builder.quad(
        "lamp",
        [[-3.2, 3.0, 0.6], [1.2, 0.0, 0.0], [0.0, 0.6, 1.2]],
        &black,
    )?;
    builder.lamp("lamp", lamp, [16.0, 15.0, 13.0])?;
    let view = View {
        eye: [0.3, 1.6, 4.6],
        target: [0.0, 0.65, 0.0],
        fov: 30.0,
        size: [width, width * 3 / 4],
    };
    Ok((builder.finish(&view, 4)?, sphere, ball))
}

/// Light on every facet of the sphere, all pixels and channels together.
fn on_facets(scene: &Scene, sphere: u32, facets: usize, image: &Rendering) -> Vec<f64> {
    let [width, height] = scene.film.size;
    let before = &scene.shapes()[..sphere as usize];
    let first: usize = before.iter().map(|s| s.primitives().len()).sum();
    let mut sums = vec![0.0; facets];
    for y in 0..height {
        for x in 0..width {
            let ray = scene.camera.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
            if let Some(hit) = scene.intersect(&ray).filter(|h| h.shape == sphere) {
                let i = (y * width + x) as usize * 3;
                sums[hit.prim as usize - first] += image.sums[0][i..i + 3].iter().sum::<f64>();
            }
        }
    }
    sums
}

/// Pairs of triangles that share an edge.
fn neighbours(mesh: &MeshData) -> Vec<[usize; 2]> {
    let mut edges: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
    for (i, t) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            edges.entry([a.min(b), a.max(b)]).or_default().push(i);
        }
    }
    let pairs = edges.into_values();
    pairs.filter_map(|f| f.try_into().ok()).collect()
}

/// `veach-plate-1`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let width = fig.pick(64, 192);
    let spp = fig.pick(4000, 6000);
    fig.note("particles per pixel", spp);
    let (scene, sphere, ball) = still_life(width)?;
    let settings = scene.settings;
    // Everything twice: the noise of two runs is independent, and cancels in the products of their jumps.
    let half = |rules, seed| particles(&scene, &settings, rules, seed, spp / 2);
    let twice = |rules| -> Result<_> { Ok([half(rules, 1)?, half(rules, 2)?]) };
    let (a, b) = (twice(Rules::default())?, twice(IGNORED)?);
    let reference = [3, 4].map(|seed| paths(&scene, &settings, seed, spp / 2));
    let facets =
        |r: &[Rendering; 2]| [0, 1].map(|k| on_facets(&scene, sphere, ball.triangles.len(), &r[k]));
    let lit = facets(&reference);
    let both = |i: usize| lit[0][i] + lit[1][i];
    // Mean square of the jump from facet to facet, relative to the path tracer; the fainter of the two facets
    // says how well it is known.
    let mut edges: Vec<_> = (neighbours(&ball).into_iter())
        .map(|[i, j]| ([i, j], both(i).min(both(j)).powi(2)))
        .collect();
    edges.retain(|([i, j], _)| [i, j].iter().all(|&&i| lit.iter().all(|l| l[i] > 0.0)));
    let total: f64 = edges.iter().map(|(_, weight)| weight).sum();
    let jump = |r: &[Rendering; 2]| {
        let facets = facets(r);
        let squares = edges.iter().map(|&([i, j], weight)| -> f64 {
            let jump = |k: usize| facets[k][i] / lit[k][i] - facets[k][j] / lit[k][j];
            weight * jump(0) * jump(1)
        });
        squares.sum::<f64>() / total
    };
    let (ja, jb) = (jump(&a), jump(&b));
    let sum = |[mut x, y]: [Rendering; 2]| {
        x.sums[0]
            .iter_mut()
            .zip(&y.sums[0])
            .for_each(|(x, y)| *x += y);
        x.samples += y.samples;
        x
    };
    let (a, b, reference) = (sum(a), sum(b), sum(reference));
    let mean = |r: &Rendering| r.mean(0).iter().sum::<f64>();
    let (ma, mb, mr) = (mean(&a), mean(&b), mean(&reference));
    fig.check(
        "(a) adjoint BSDFs: as bright as the path tracer, to 1 %",
        (ma / mr - 1.0).abs() < 0.01,
        format!("mean {:+.3} %", (ma / mr - 1.0) * 100.0),
    );
    fig.check(
        "(b) scattered like viewing rays: jumps across the sphere's edges more than 3 times those of (a)",
        jb > 9.0 * ja.abs(),
        format!(
            "mean square, noise cancelled, {jb:+.2e} against {ja:+.2e}"
        ),
    );
    let difference = |r: &Rendering| -> f64 {
        let pairs = r.sums[0].iter().zip(&reference.sums[0]);
        pairs.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    let (da, db) = (difference(&a), difference(&b));
    fig.check(
        "(b) differs from the path tracer by more than noise",
        db > 1.5 * da,
        format!(
            "{:.2} times the root mean square difference of (a); mean {:+.2} %",
            db / da,
            (mb / mr - 1.0) * 100.0
        ),
    );
    fig.csv(
        "differences",
        &[
            "mean (a)",
            "mean (b)",
            "mean paths",
            "squared jump (a)",
            "squared jump (b)",
        ],
        [[ma, mb, mr, ja, jb]],
    );
    let enlarge = fig.pick(4, 2);
    let panel =
        |label: &str, r: &Rendering| Panel::tonemapped(label, &r.image(0), 1.0).enlarged(enlarge);
    let ratio: Vec<f64> = (b.sums[0]
        .chunks_exact(3)
        .zip(reference.sums[0].chunks_exact(3)))
    .map(|(b, r)| {
        let (b, r) = (b.iter().sum::<f64>(), r.iter().sum::<f64>());
        if r > 0.0 { b / r - 1.0 } else { 0.0 }
    })
    .collect();
    let ratio = Panel::signed("(b) over paths, minus 1", width as usize, &ratio, Some(0.5));
    fig.images(
        "plate",
        2,
        &[
            panel("(a) adjoint BSDFs", &a),
            panel("(b) like viewing rays", &b),
            panel("path tracer", &reference),
            ratio.enlarged(enlarge),
        ],
    );
    Ok(())
}
