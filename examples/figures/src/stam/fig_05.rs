//! [Stam 2020, figure 5]: the path visualiser. Left, one random path in the box; right, the image with
//! a subset of its paths.

use ad_core::Vec3;
use render::bsdf::BlinnPhongSampling;
use render::params::Theta;

use super::cornell::{self, Cornell, EYE, FOV, LIGHT_HALF, LIGHT_Y, RADIUS};
use super::fixed_path::FixedPath;
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::scene_builder::picture;

type Point = Vec3<f64>;

/// Number of paths drawn over the image; more are checked.
const DRAWN: usize = 12;

/// A camera of the visualiser, independent of the renderer's.
struct View {
    eye: Point,
    right: Point,
    up: Point,
    forward: Point,
    /// Pixels per unit of tangent.
    scale: f64,
    centre: f64,
}

impl View {
    fn new(eye: Point, target: Point, fov: f64, size: f64) -> Self {
        let forward = (target - eye).normalize();
        let right = forward.cross(Vec3::new(0.0, 1.0, 0.0)).normalize();
        Self {
            eye,
            right,
            up: right.cross(forward),
            forward,
            scale: size / 2.0 / (fov.to_radians() / 2.0).tan(),
            centre: size / 2.0,
        }
    }

    /// Pixel coordinates of a point in front of the camera.
    fn pixel(&self, p: Point) -> [f64; 2] {
        let d = p - self.eye;
        let z = d.dot(self.forward);
        [
            self.centre + d.dot(self.right) / z * self.scale,
            self.centre - d.dot(self.up) / z * self.scale,
        ]
    }

    /// Draws a segment, cut at a plane just in front of the camera.
    fn draw(&self, panel: &mut Panel, a: Point, b: Point, colour: [u8; 3]) {
        const NEAR: f64 = 0.02;
        let depth = |p: Point| (p - self.eye).dot(self.forward) - NEAR;
        let (da, db) = (depth(a), depth(b));
        if da <= 0.0 && db <= 0.0 {
            return;
        }
        let cut = || a + (b - a) * (da / (da - db));
        let a_seen = if da < 0.0 { cut() } else { a };
        let b_seen = if db < 0.0 { cut() } else { b };
        panel.line(self.pixel(a_seen), self.pixel(b_seen), colour);
    }

    fn polyline(&self, panel: &mut Panel, points: &[Point], colour: [u8; 3]) {
        for w in points.windows(2) {
            self.draw(panel, w[0], w[1], colour);
        }
    }
}

/// The edges of the box and the light, and three great circles of the sphere.
fn wireframe(view: &View, panel: &mut Panel) {
    let grey = [150, 150, 150];
    for axis in 0..3 {
        for k in 0..4 {
            let side = |bit: usize| if k >> bit & 1 == 0 { -1.0 } else { 1.0 };
            let end = |s: f64| {
                let mut p = [side(0), side(1), side(1)];
                p[axis] = s;
                p[(axis + 1) % 3] = side(0);
                p[(axis + 2) % 3] = side(1);
                Point::from(p)
            };
            view.draw(panel, end(-1.0), end(1.0), grey);
        }
    }
    let h = LIGHT_HALF;
    let corners = [(-h, -h), (h, -h), (h, h), (-h, h), (-h, -h)];
    let light = corners.map(|(x, z)| Vec3::new(x, LIGHT_Y, z));
    view.polyline(panel, &light, [230, 160, 0]);
    for axis in 0..3 {
        let circle: Vec<Point> = (0..=96)
            .map(|i| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / 96.0).sin_cos();
                let mut p = [0.0; 3];
                p[(axis + 1) % 3] = RADIUS * cos;
                p[(axis + 2) % 3] = RADIUS * sin;
                Point::from(p)
            })
            .collect();
        view.polyline(panel, &circle, [90, 140, 190]);
    }
}

/// The points of a path, from the eye on.
fn points(path: &FixedPath<f64>) -> Vec<Point> {
    let mut all = vec![Point::from(EYE)];
    all.extend(&path.positions);
    all
}

/// A path, seen from outside.
fn one_path(path: Option<&FixedPath<f64>>) -> Panel {
    let view = View::new(
        Vec3::new(2.2, 1.5, 4.2),
        Vec3::new(0.0, -0.05, 0.0),
        41.0,
        512.0,
    );
    let blank = render::Image {
        width: 512,
        height: 512,
        data: vec![1.0; 512 * 512 * 3],
    };
    let mut left = Panel::tonemapped("one path", &blank, 1.0);
    wireframe(&view, &mut left);
    if let Some(path) = path {
        let all = points(path);
        for offset in [0.0, 0.004] {
            let shifted: Vec<Point> = all.iter().map(|p| *p + Vec3::splat(offset)).collect();
            view.polyline(&mut left, &shifted, [200, 30, 30]);
        }
        for (i, p) in all.iter().enumerate() {
            let colour = match i {
                0 => [0, 0, 0],
                _ if i + 1 == all.len() => [230, 160, 0],
                _ => [200, 30, 30],
            };
            left.dot(view.pixel(*p), 4.5, colour);
        }
    }
    left
}

/// `stam-05`.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(96, 256);
    let enlarge = 512 / size as usize;
    let (spp, seed, shown) = (fig.pick(32, 256), 5, 40);
    fig.note("size", size);
    fig.note("spp", spp);
    fig.note("seed", seed);
    let theta = [12.0, 0.0, 0.15, 0.45, 40.0, 0.0, 0.7];
    let sampling = BlinnPhongSampling::Importance;
    let scene = Cornell {
        theta,
        sampling,
        size,
        max_depth: 6,
    }
    .build()?;
    let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();

    // ---- Paths that reach the light, spread over the image ----
    let theta64 = Theta::<f64>::constant(&values);
    let mut paths = Vec::new();
    let mut tried = 0u64;
    let (mut end_error, mut radiance_error) = (0.0f64, 0.0f64);
    'search: for index in 0..4000u64 {
        // A lattice that visits the whole image before it comes back to a place.
        let pixel = [
            (index * 37 % u64::from(size)) as u32,
            (index * 61 % u64::from(size)) as u32,
        ];
        for sample in 0..16 {
            tried += 1;
            let (path, l) = FixedPath::record(&scene, &theta64, seed, pixel, sample);
            if !path.is_complete() || path.vertices.len() < 2 {
                continue;
            }
            let again = path.radiance(&scene, &theta64);
            radiance_error = radiance_error.max((again.r - l.r).abs() / l.r);
            paths.push(path);
            if paths.len() == shown {
                break 'search;
            }
            break;
        }
    }
    let single = paths
        .iter()
        .position(|p| p.vertices.len() == 4 && p.hits(|s| s == cornell::SPHERE) > 0);
    let single = single
        .or_else(|| paths.iter().position(|p| p.vertices.len() >= 3))
        .unwrap_or(0);
    let mut segment_error = 0.0f64;
    let mut segments = 0;
    for path in &paths {
        for p in &path.positions {
            segment_error = segment_error.max(cornell::distance_to_geometry(p.to_array()));
            segments += 1;
        }
        if let Some(p) = path.positions.last() {
            end_error = end_error.max(cornell::distance_to_light(p.to_array()));
        }
    }
    fig.check(
        "contributing paths are found all over the image",
        paths.len() == shown,
        format!("{} of {shown} after {tried} tries", paths.len()),
    );
    fig.check(
        "every drawn segment starts (pinhole aside) and ends on scene geometry",
        segments > 0 && segment_error < 1e-4,
        format!("largest distance {segment_error:.1e} over {segments} segments, at most 1e-4"),
    );
    fig.check(
        "the last vertex of every contributing path is on the light",
        !paths.is_empty() && end_error < 1e-4,
        format!("largest distance {end_error:.1e}, at most 1e-4"),
    );
    fig.check(
        "a recorded path evaluated again carries the radiance that was traced",
        radiance_error < 1e-12,
        format!("largest relative difference {radiance_error:.1e}"),
    );

    // ---- Left: one path, seen from outside ----
    let left = one_path(paths.get(single));

    // ---- Right: the image and a subset of its paths ----
    let image = picture(&scene, seed, spp);
    fig.check(
        "no sample of the image is NaN or infinite",
        image.non_finite.count == 0,
        format!(
            "{} of {}",
            image.non_finite.count,
            u64::from(size * size) * spp
        ),
    );
    let mut right =
        Panel::tonemapped("image and some of its paths", &image.image(0), 1.3).enlarged(enlarge);
    let view = View::new(
        Point::from(EYE),
        Vec3::zero(),
        FOV,
        f64::from(size) * enlarge as f64,
    );
    let colours = [
        [230, 159, 0],
        [86, 180, 233],
        [0, 158, 115],
        [240, 228, 66],
        [213, 94, 0],
        [204, 121, 167],
    ];
    for (i, path) in paths.iter().take(DRAWN).enumerate() {
        view.polyline(&mut right, &path.positions, colours[i % colours.len()]);
    }
    let rows = paths.iter().enumerate().flat_map(|(i, path)| {
        points(path)
            .into_iter()
            .enumerate()
            .map(move |(k, p)| [i as f64, k as f64, p.x, p.y, p.z])
    });
    fig.csv(
        "paths",
        &["path", "vertex", "x", "y", "z"],
        rows.collect::<Vec<_>>(),
    );
    fig.images("figure", 2, &[left, right]);
    Ok(())
}
