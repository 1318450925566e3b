//! Building materials, quadrature over directions, and tests of samplers: shared by the tests of
//! materials.

use std::path::Path;
use std::sync::Arc;

use ad_core::{Real, Vec2, Vec3};
use render::bsdf::{Material, Shading};
use render::camera::{Camera, FovAxis};
use render::math::Transform;
use render::params::{Params, Theta};
use render::plugin::xml::Document;
use render::scene::{Builder, Settings};
use render::{Film, SceneError};

/// A material with its own parameter vector.
pub fn build(plugin: &str, content: &str) -> Result<(Arc<Material>, Params), SceneError> {
    let text =
        format!(r#"<scene version="3.0.0"><bsdf type="{plugin}" id="m">{content}</bsdf></scene>"#);
    let document = Document::from_str(&text, Path::new("."), &[])?;
    let node = document.root().children_with_tag("bsdf")[0];
    let mut build = Builder::new();
    let material = build.registry().material_from_node(node, "bsdf")?;
    let camera = Camera::new(Transform::default(), 45.0, FovAxis::X, [1, 1])?;
    let scene = build.build(camera, Film::new(1, 1), Settings::default())?;
    Ok((material, scene.params().clone()))
}

/// An arbitrary point.
pub fn at<R: Real>(theta: Theta<'_, R>) -> Shading<'_, R> {
    Shading::new(theta, Vec2::new(R::of(0.3), R::of(0.6)))
}

/// A direction by its height and azimuth.
pub fn polar(z: f64, phi: f64) -> Vec3<f64> {
    let s = (1.0 - z * z).sqrt();
    Vec3::new(s * phi.cos(), s * phi.sin(), z)
}

/// Nodes and weights of the 8-point Gauss-Legendre rule on [-1, 1], positive half.
const GAUSS: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_3),
];

fn gauss(f: &dyn Fn(f64, f64) -> f64, [x0, x1, y0, y1]: [f64; 4]) -> f64 {
    let (cx, hx, cy, hy) = (
        (x0 + x1) / 2.0,
        (x1 - x0) / 2.0,
        (y0 + y1) / 2.0,
        (y1 - y0) / 2.0,
    );
    let mut sum = 0.0;
    for (x, wx) in GAUSS {
        for (y, wy) in GAUSS {
            for (sx, sy) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                sum += wx * wy * f(cx + sx * x * hx, cy + sy * y * hy);
            }
        }
    }
    sum * hx * hy
}

/// Integral over a rectangle, refined where two orders of refinement differ by more than
/// `tolerance` (absolute).
pub fn integrate(f: &dyn Fn(f64, f64) -> f64, b: [f64; 4], tolerance: f64, depth: u32) -> f64 {
    let [x0, x1, y0, y1] = b;
    let (xm, ym) = ((x0 + x1) / 2.0, (y0 + y1) / 2.0);
    let parts = [
        [x0, xm, y0, ym],
        [xm, x1, y0, ym],
        [x0, xm, ym, y1],
        [xm, x1, ym, y1],
    ];
    let coarse = gauss(f, b);
    let fine: [f64; 4] = parts.map(|p| gauss(f, p));
    let sum: f64 = fine.iter().sum();
    if (sum - coarse).abs() < tolerance || depth == 0 {
        return sum;
    }
    parts
        .iter()
        .map(|&p| integrate(f, p, tolerance / 2.0, depth - 1))
        .sum()
}
