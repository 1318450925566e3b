//! Links: how much of what one element sends another one receives.

use std::f64::consts::{PI, TAU};

use ad_core::Vec3;

use super::basis::{Spread, Stencil};
use super::element::{Mesh, Root};
use crate::math::Ray;
use crate::scene::Scene;

/// Pairs of points at which the kernel of a link is looked at: 2 x 2 on either side.
pub const SAMPLES: usize = 16;

/// The transport of radiance from `source` to `receiver`, and of importance back.
///
/// Its coefficient is the integral of `lobe G` over both elements, where the lobe is 1 for surfaces and
/// the exact emission for lamps: symmetric in its ends, so that the same number serves both ways.
#[derive(Clone, Debug)]
pub struct Link {
    /// Takes radiance.
    pub receiver: u32,
    /// Sends radiance.
    pub source: u32,
    /// The integral of the kernel over both elements, m^2 sr.
    pub coupling: f64,
    /// Directions from the receiver to the source, in the receiver's basis.
    pub receive: Spread,
    /// Directions from the source to the receiver, in the source's basis.
    pub send: Spread,
    /// What the coupling would be if the kernel were everywhere as at one pair of points.
    pub kernel: [f32; SAMPLES],
    /// The same where the axis of a lamp's lobe meets the receiver: narrow beams fall between points.
    pub peak: f32,
}

/// What lies between two elements.
#[derive(Clone, Debug)]
pub enum Connection {
    /// A link.
    Link(Link),
    /// No sample got through, though parts of the two face each other.
    Blocked,
    /// They cannot see each other.
    None,
}

/// Local coordinates of the pair `k`: on the receiver, on the source.
pub fn sample(k: usize) -> [[f64; 2]; 2] {
    let (a, b) = (k / 4, k % 4);
    let quarter = |i: usize, at: f64| 0.5 * (i as f64 + at);
    let receiver = [quarter(a & 1, 0.5), quarter(a >> 1, 0.5)];
    // Every point of the receiver looks at other points of the source.
    let (du, dv) = (
        0.25 + 0.5 * (a & 1) as f64,
        0.25 + 0.5 * ((a >> 1) ^ (a & 1)) as f64,
    );
    [receiver, [quarter(b & 1, du), quarter(b >> 1, dv)]]
}

/// Cosine of the lobe to its power; `cos` is positive.
fn lobe(cos: f64, exponent: f64) -> f64 {
    if exponent == 0.0 {
        1.0
    } else {
        cos.powf(exponent)
    }
}

/// Whether `b`, a point on the surface `to`, is what is seen from `a` in that direction.
fn visible(scene: &Scene, (a, from): (Vec3<f64>, &Root), (b, to): (Vec3<f64>, &Root)) -> bool {
    let exit = scene.exit(from.prim);
    let o = a + from.normal * f64::from(exit.offset);
    let ray = Ray::new(o, (b - o).normalize()).leaving(exit.surface);
    (scene.nearest(&ray)).is_some_and(|hit| hit.prim == to.prim)
}

/// Links two elements.
pub fn connect(scene: &Scene, mesh: &Mesh, receiver: u32, source: u32) -> Connection {
    let (re, rs) = (mesh.root(receiver), mesh.root(source));
    let corners =
        |e: u32| [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[u, v]| mesh.point(e, u, v));
    let (ce, cs) = (corners(receiver), corners(source));
    let scale = re.area.max(rs.area).sqrt() * 1e-9;
    let before =
        |n: Vec3<f64>, at: Vec3<f64>, p: &[Vec3<f64>; 4]| p.iter().any(|p| n.dot(*p - at) > scale);
    if !before(re.normal, ce[0], &cs) || !before(rs.normal, cs[0], &ce) {
        return Connection::None;
    }
    let area = mesh.elements[receiver as usize].area;
    let mut kernel = [0.0f32; SAMPLES];
    let mut coupling = 0.0;
    let mut directions: Vec<(Vec3<f64>, f64)> = Vec::with_capacity(SAMPLES);
    for a in 0..4 {
        let [[u, v], _] = sample(4 * a);
        let x = mesh.point(receiver, u, v);
        if rs.normal.dot(x - cs[0]) <= 0.0 {
            continue;
        }
        let form = form_factor(x, re.normal, &cs);
        let mut g = [0.0; 4];
        let mut y = [Vec3::zero(); 4];
        for b in 0..4 {
            let [_, [u, v]] = sample(4 * a + b);
            y[b] = mesh.point(source, u, v);
            let d = y[b] - x;
            let cos = [re.normal.dot(d), -rs.normal.dot(d)];
            if cos[0] > 0.0 && cos[1] > 0.0 {
                g[b] = cos[0] * cos[1] / d.length_squared().powi(2);
            }
        }
        let sum: f64 = g.iter().sum();
        if !(sum > 0.0 && form > 0.0) {
            continue;
        }
        for b in 0..4 {
            let d = (y[b] - x).normalize();
            if g[b] == 0.0 || !visible(scene, (x, re), (y[b], rs)) {
                continue;
            }
            // The exact integral over the source, spread by the kernel at its points.
            let part = 0.25 * area * PI * form * g[b] / sum * lobe(-rs.normal.dot(d), rs.exponent);
            kernel[4 * a + b] = (part * SAMPLES as f64) as f32;
            coupling += part;
            directions.push((d, part));
        }
    }
    let peak = peak(scene, mesh, receiver, source);
    if coupling == 0.0 && peak == 0.0 {
        return Connection::Blocked;
    }
    if directions.is_empty() {
        let d = mesh.point(source, 0.5, 0.5) - mesh.point(receiver, 0.5, 0.5);
        directions.push((d.normalize(), 1.0));
    }
    // A beam that every sample misses: equal weights.
    if coupling == 0.0 {
        directions.iter_mut().for_each(|d| d.1 = 1.0);
    }
    let spread = |root: &Root, sign: f64| {
        if root.directions.side == 1 {
            return Spread::default();
        }
        let stencil = |d: Vec3<f64>| root.directions.stencil(root.frame.to_local(d * sign));
        let stencils = directions.iter().map(|&(d, w)| (stencil(d), w));
        Spread::mean(&stencils.collect::<Vec<(Stencil, f64)>>())
    };
    Connection::Link(Link {
        receiver,
        source,
        coupling,
        receive: spread(re, 1.0),
        send: spread(rs, -1.0),
        kernel,
        peak,
    })
}

/// The kernel where the axis of the source's lobe meets the receiver; 0 if it does not.
fn peak(scene: &Scene, mesh: &Mesh, receiver: u32, source: u32) -> f32 {
    let (re, rs) = (mesh.root(receiver), mesh.root(source));
    if rs.exponent == 0.0 {
        return 0.0;
    }
    let y = mesh.point(source, 0.5, 0.5);
    let cos = -re.normal.dot(rs.normal);
    let t = re.normal.dot(re.corner - y) / -cos;
    if cos <= 1e-6 || t <= 0.0 {
        return 0.0;
    }
    let x = y + rs.normal * t;
    let q = re.coordinates(x);
    let e = &mesh.elements[receiver as usize];
    let inside = |t: f64, at: f64| (at..=at + e.size).contains(&t);
    if !inside(q.x, e.at[0]) || !inside(q.y, e.at[1]) {
        return 0.0;
    }
    if !visible(scene, (x, re), (y, rs)) {
        return 0.0;
    }
    // Bounded as the form factor is, however near.
    let g = (cos / (t * t)).min(PI / mesh.elements[source as usize].area);
    (g * e.area * mesh.elements[source as usize].area) as f32
}

/// The form factor from a point with normal `n` to the part of a polygon above its horizon, unoccluded
/// [Lambert 1760].
pub fn form_factor(x: Vec3<f64>, n: Vec3<f64>, polygon: &[Vec3<f64>; 4]) -> f64 {
    let mut clipped = [Vec3::zero(); 8];
    let mut count = 0;
    for i in 0..4 {
        let (a, b) = (polygon[i] - x, polygon[(i + 1) % 4] - x);
        let (ha, hb) = (n.dot(a), n.dot(b));
        if ha >= 0.0 {
            clipped[count] = a;
            count += 1;
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            clipped[count] = a + (b - a) * (ha / (ha - hb));
            count += 1;
        }
    }
    if count < 3 {
        return 0.0;
    }
    let mut sum = 0.0;
    for i in 0..count {
        let (a, b) = (clipped[i].normalize(), clipped[(i + 1) % count].normalize());
        let axis = a.cross(b);
        let sin = axis.length();
        if sin > 0.0 {
            sum += sin.atan2(a.dot(b)) * n.dot(axis) / sin;
        }
    }
    (sum / TAU).abs().min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn form_factors_of_squares() {
        let square = |z: f64| {
            [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[x, y]| Vec3::new(x, y, z))
        };
        let up = Vec3::new(0.0, 0.0, 1.0);
        // Above the middle of a square of side 1 at distance 1/2: 4 times the corner formula.
        let c = 1.0 / 2f64.sqrt();
        let corner = 2.0 * c * c.atan() / TAU;
        let found = form_factor(Vec3::zero(), up, &square(0.5));
        assert!((found - 4.0 * corner).abs() < 1e-12, "{found}");
        // A wall through the horizon counts with its upper half.
        let wall: [[f64; 2]; 4] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let full = wall.map(|[y, z]| Vec3::new(1.0, y, z));
        let half = wall.map(|[y, z]| Vec3::new(1.0, y, z.max(0.0)));
        let (a, b) = (
            form_factor(Vec3::zero(), up, &full),
            form_factor(Vec3::zero(), up, &half),
        );
        assert!((a - b).abs() < 1e-14 && a > 0.1);
    }
}
