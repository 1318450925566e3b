//! Slopes, moments, cells and roots, by themselves.

use std::sync::Arc;

use ad_core::{Mat2, Vec2, Vec3};

use super::footprint::HalfVectors;
use super::map::{SlopeMap, cell_of};
use super::search::Pick;
use super::walk::over_footprint;
use crate::bsdf::{Bsdf, Conductor, Interpolation, NormalMap, Shading, TransportMode};
use crate::params::{ParamShape, Params, Theta};
use crate::sampler::{Independent, Sampler};
use crate::texture::{Bitmap, RgbTexture, UvTransform, Wrap};

/// A map of noise, `w` by `h`.
fn noisy(size: [u32; 2], interpolation: Interpolation, wrap: Wrap) -> (Params, NormalMap) {
    let [width, height] = size;
    let mut s = Independent::new(11, u64::from(width), u64::from(height));
    let texels: Vec<f32> = (0..width * height)
        .flat_map(|_| {
            let [x, y] = s.next_2d::<f32>().map(|u| 0.4 * (u - 0.5));
            let z = (1.0 + x * x + y * y).sqrt().recip();
            [x * z, y * z, z].map(|c| 0.5 * c + 0.5)
        })
        .collect();
    let mut params = Params::default();
    let shape = ParamShape::Texture {
        width: width as usize,
        height: height as usize,
        channels: 3,
    };
    let param = params.push("normals.data", shape, &texels, (-1.0, 2.0));
    let one = params.push("metal.value", ParamShape::Rgb, &[1.0; 3], (0.0, 1.0));
    let metal = Conductor {
        specular_reflectance: RgbTexture::Constant(one),
        index: None,
    };
    let map = RgbTexture::Bitmap(Bitmap {
        param,
        width,
        height,
        wrap,
        nearest: false,
        to_uv: UvTransform {
            rows: [[2.0, 0.1, 0.3], [-0.2, 1.0, 0.0]],
        },
    });
    let mapped = NormalMap::new(map, interpolation, Arc::new(metal.into()));
    (params, mapped.unwrap())
}

fn double(params: &Params) -> Vec<f64> {
    params.values().iter().map(|&x| f64::from(x)).collect()
}

/// A footprint about a point, so many texels wide, slanted.
fn half_vectors(t0: Vec2<f64>, width: f64, half: Vec2<f64>, turn: f64) -> HalfVectors {
    let texels = Mat2::from_rows([[width, 0.3 * width], [-0.2 * width, 0.7 * width]]);
    let turns = Mat2::from_rows([[turn, 0.1 * turn], [-0.3 * turn, 0.8 * turn]]);
    HalfVectors::of(t0, half, turns, texels, Vec2::new(0.1, -0.2), 0.5).unwrap()
}

/// Slopes are those of the material's shading frame, and their derivatives central differences.
#[test]
fn slopes_are_those_of_the_material() {
    for interpolation in [Interpolation::Slopes, Interpolation::Normals] {
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            let (params, map) = noisy([7, 5], interpolation, wrap);
            let values = double(&params);
            let theta = Theta::<f64>::constant(&values);
            let field = SlopeMap::new(&map, &theta).unwrap();
            let mut s = Independent::new(1, 2, 3);
            for _ in 0..200 {
                let uv = s.next_2d::<f64>().map(|u| 4.0 * u - 2.0);
                let uv = Vec2::from(uv);
                let t = field.texels(uv);
                let (slope, derivative) = field.slope(&theta, t).unwrap();
                let at = Shading::new(theta, uv);
                let up = Vec3::new(0.0, 0.0, 1.0);
                let n = map.shading_frame(&at, up, 0, TransportMode::Radiance).n;
                let expected = Vec2::new(-n.x / n.z, -n.y / n.z);
                assert!((slope - expected).length() < 1e-6, "{slope:?} {expected:?}");
                let h = 1e-6;
                for k in 0..2 {
                    let mut step = Vec2::zero();
                    if k == 0 {
                        step.x = h
                    } else {
                        step.y = h
                    }
                    let moved = |t: Vec2<f64>| field.slope(&theta, t).unwrap().0;
                    if cell_of(t + step) != cell_of(t - step) {
                        continue;
                    }
                    let difference = (moved(t + step) - moved(t - step)) * (0.5 / h);
                    assert!((difference - derivative.col(k)).length() < 1e-7);
                }
            }
        }
    }
}

/// Moments of rectangles are those of many points in them, as far as nodes are as fine.
#[test]
fn moments_are_those_of_points() {
    let (params, map) = noisy([48, 20], Interpolation::Slopes, Wrap::Repeat);
    let values = double(&params);
    let theta = Theta::<f64>::constant(&values);
    let field = SlopeMap::new(&map, &theta).unwrap();
    for half in [[1.5, 2.0], [12.0, 3.0], [24.0, 10.0]] {
        let t = Vec2::new(13.2, 41.7);
        let found = field.moments(&theta, t, half);
        let n = 300;
        let (mut first, mut second) = (Vec2::zero(), [0.0; 3]);
        for k in 0..n * n {
            let of = |i: usize, half: f64| half * ((i as f64 + 0.5) * 2.0 / n as f64 - 1.0);
            let at = t + Vec2::new(of(k % n, half[0]), of(k / n, half[1]));
            let (s, _) = field.slope(&theta, at).unwrap();
            first += s * ((n * n) as f64).recip();
            for (sum, x) in second.iter_mut().zip([s.x * s.x, s.x * s.y, s.y * s.y]) {
                *sum += x / (n * n) as f64;
            }
        }
        let m = first;
        let expected = [
            second[0] - m.x * m.x,
            second[1] - m.x * m.y,
            second[2] - m.y * m.y,
        ];
        // A cell counts as a whole: the rectangle's edges are as sharp as that.
        assert!(
            (found.mean - m).length() < 0.02,
            "{half:?}: {found:?} {m:?}"
        );
        for (a, b) in found.covariance.into_iter().zip(expected) {
            assert!((a - b).abs() < 3e-3, "{half:?}: {found:?} {expected:?}");
        }
    }
    // The map without its finest level, five numbers for three.
    let bytes = field.bytes();
    assert!(bytes < 48 * 20 * 3 * size_of::<f32>(), "{bytes}");
}

/// The probability of each cell is the one that it is said to be drawn with, and they add up to one: inside a cell, over the
/// seams, over copies of the map; 40 000 draws of each, five standard errors.
#[test]
fn cells_are_drawn_as_they_say() {
    for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
        let (params, map) = noisy([7, 5], Interpolation::Normals, wrap);
        let values = double(&params);
        let theta = Theta::<f64>::constant(&values);
        let field = SlopeMap::new(&map, &theta).unwrap();
        for (i, width) in [0.3, 3.0, 25.0].into_iter().enumerate() {
            let halves = half_vectors(Vec2::new(5.8, -0.4), width, Vec2::new(0.05, 0.02), 0.01);
            let (middle, half) = halves.bounds();
            let mut sum = 0.0;
            let mut all = std::collections::HashMap::new();
            let range = |m: f64, h: f64| (m - h).floor() as i64 - 1..=(m + h).floor() as i64 + 1;
            for y in range(middle.y, half[1]) {
                for x in range(middle.x, half[0]) {
                    if let Some((cell, p)) = field.choose(&theta, &halves, Pick::Of([x, y])) {
                        assert_eq!(cell, [x, y]);
                        sum += p;
                        all.insert(cell, (p, 0u32));
                    }
                }
            }
            let mut s = Independent::new(7, 0, i as u64);
            let n = 40_000;
            let mut lost = 0;
            for _ in 0..n {
                match field.choose(&theta, &halves, Pick::Random(&mut s)) {
                    Some((cell, p)) => {
                        let (expected, count) = all.get_mut(&cell).expect("a cell");
                        assert!((p - *expected).abs() < 1e-12);
                        *count += 1;
                    }
                    None => lost += 1,
                }
            }
            let drawn = 1.0 - f64::from(lost) / f64::from(n);
            assert!(
                sum <= 1.0 + 1e-9 && (sum - drawn).abs() < 0.02,
                "{width}: {sum} {drawn}"
            );
            for (cell, (p, count)) in all {
                let expected = p * f64::from(n);
                let off = f64::from(count) - expected;
                assert!(
                    off.abs() < 5.0 * expected.sqrt() + 5.0,
                    "{cell:?}: {count} {expected}"
                );
            }
        }
    }
}

/// The roots of two bilinear functions in the unit square, from the quadratic equation that is left when one coordinate is
/// eliminated. `c` has the values at (0, 0), (1, 0), (0, 1), (1, 1).
fn closed_form(c: [Vec2<f64>; 4]) -> Vec<Vec2<f64>> {
    let [p, q, r, s] = [c[0], c[1] - c[0], c[2] - c[0], c[3] - c[1] - c[2] + c[0]];
    // (p + a q) + b (r + a s) = 0: parallel vectors.
    let quadratic = [q.perp_dot(s), p.perp_dot(s) + q.perp_dot(r), p.perp_dot(r)];
    let [x, y, z] = quadratic;
    let d = y * y - 4.0 * x * z;
    if d < 0.0 {
        return Vec::new();
    }
    let w = -0.5 * (y + d.sqrt().copysign(y));
    [w / x, z / w]
        .into_iter()
        .filter_map(|a| {
            let (u, v) = (p + q * a, r + s * a);
            let b = -u.dot(v) / v.length_squared();
            let inside = (0.0..1.0).contains(&a) && (0.0..1.0).contains(&b);
            inside.then_some(Vec2::new(a, b))
        })
        .collect()
}

/// Walks in a cell find the roots of the quadratic equation and no others, each from many a start, and cells that are excluded
/// have none; walks over the footprint find roots of its cells.
#[test]
fn walks_end_in_the_roots_of_cells() {
    let (params, map) = noisy([16, 16], Interpolation::Slopes, Wrap::Repeat);
    let values = double(&params);
    let theta = Theta::<f64>::constant(&values);
    let field = SlopeMap::new(&map, &theta).unwrap();
    let halves = half_vectors(Vec2::new(8.0, 8.0), 20.0, Vec2::new(0.04, -0.03), 0.02);
    let mut s = Independent::new(3, 1, 4);
    let (mut some, mut rarest, mut excluded) = (0, 1.0f64, 0);
    let mut roots = Vec::new();
    for k in 0..256i64 {
        let cell = [k % 16, k / 16];
        let patch = field.patch(&theta, cell);
        let slopes = patch.corners();
        let at = |i: i64, j: i64| Vec2::new((cell[0] + i) as f64, (cell[1] + j) as f64);
        let corners = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
        let c = [0, 1, 2, 3].map(|i: usize| halves.half(corners[i]) - slopes[i]);
        let expected = closed_form(c);
        if patch.excludes(&halves, cell) {
            excluded += 1;
            assert!(expected.is_empty());
        }
        let mut counts = vec![0; expected.len()];
        let n = 200;
        for _ in 0..n {
            let (found, steps) = patch.walk(&halves, cell, s.next_2d::<f64>(), 30);
            assert!(steps <= 30);
            let Some(root) = found else { continue };
            let local = root.t - at(0, 0);
            let which = expected.iter().position(|e| (*e - local).length() < 1e-8);
            counts[which.unwrap_or_else(|| panic!("{local:?} {expected:?}"))] += 1;
        }
        for count in counts {
            rarest = rarest.min(f64::from(count) / f64::from(n));
        }
        some += expected.len();
        roots.extend(expected.iter().map(|e| at(0, 0) + *e));
    }
    println!("{some} roots, found at least {rarest} of the time; {excluded} cells excluded");
    assert!(some > 10 && rarest > 0.1 && excluded > 50);
    let mut found = 0;
    for _ in 0..2000 {
        let start = halves.at(s.next_2d::<f64>());
        if let (Some(root), _) = over_footprint(&field, &theta, &halves, start, 20) {
            let wrapped = Vec2::new(root.t.x.rem_euclid(16.0), root.t.y.rem_euclid(16.0));
            // Half vectors are those of where it is: only in the middle copy they are the same.
            if (wrapped - root.t).length() < 1e-9 {
                found += 1;
                assert!(
                    roots.iter().any(|r| (*r - root.t).length() < 1e-7),
                    "{root:?}"
                );
            }
        }
    }
    assert!(found > 100, "{found}");
}
