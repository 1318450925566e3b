//! Slopes of a normal map: the bilinear cells between its texels, and their filtered moments.

use std::f64::consts::TAU;

use ad_core::{Float, Mat2, Vec2, Vec3};

use crate::bsdf::{Interpolation, NormalMap};
use crate::params::{ParamRef, Theta};
use crate::texture::{Bitmap, RgbTexture, Wrap};

/// Smallest z of an interpolated normal that has a slope.
const LEAST_Z: f64 = 1e-6;

/// A distribution of slopes: its first two moments [Olano and Baker 2010].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Mean.
    pub mean: Vec2<f64>,
    /// Covariance: xx, xy, yy.
    pub covariance: [f64; 3],
}

impl Moments {
    /// The covariance of slopes that also move by `by` times something with the variances `of` along its axes.
    #[must_use]
    pub fn spread(self, by: &Mat2<f64>, of: [f64; 2]) -> Self {
        let [[a, b], [c, d]] = by.rows;
        let [xx, xy, yy] = self.covariance;
        let [u, v] = of;
        Self {
            covariance: [
                xx + a * a * u + b * b * v,
                xy + a * c * u + b * d * v,
                yy + c * c * u + d * d * v,
            ],
            ..self
        }
    }

    /// Determinant of the covariance, and the squared distance of a slope from the mean in its metric. A little is added
    /// to the covariance, so that there is always a density.
    fn metric(&self, slope: Vec2<f64>) -> (f64, f64) {
        let [xx, xy, yy] = self.covariance;
        let least = 1e-6 * (xx + yy) + 1e-12;
        let (xx, yy) = (xx + least, yy + least);
        let det = (xx * yy - xy * xy).max(least * least);
        let d = slope - self.mean;
        let m2 = (yy * d.x * d.x - 2.0 * xy * d.x * d.y + xx * d.y * d.y) / det;
        (det, m2.max(0.0))
    }

    /// Density of the normal distribution with these moments, per area of slopes.
    pub fn density(&self, slope: Vec2<f64>) -> f64 {
        let (det, m2) = self.metric(slope);
        (-0.5 * m2).exp() / (TAU * det.sqrt())
    }

    /// The same with a tail, up to a factor that all have in common: few maps are normally distributed.
    pub(super) fn tailed(&self, slope: Vec2<f64>) -> f64 {
        let (det, m2) = self.metric(slope);
        (1.0 + 0.5 * m2).powi(-2) / det.sqrt()
    }
}

/// Sums of slopes, and of their products.
#[derive(Clone, Copy, Debug, Default)]
struct SlopeSums {
    n: f64,
    first: [f64; 2],
    second: [f64; 3],
}

impl SlopeSums {
    fn add(&mut self, m: &Moments, weight: f64) {
        let (x, y) = (m.mean.x, m.mean.y);
        let [xx, xy, yy] = m.covariance;
        self.n += weight;
        for (sum, v) in self.first.iter_mut().zip([x, y]) {
            *sum += weight * v;
        }
        for (sum, v) in self
            .second
            .iter_mut()
            .zip([xx + x * x, xy + x * y, yy + y * y])
        {
            *sum += weight * v;
        }
    }

    fn moments(&self) -> Moments {
        let n = if self.n > 0.0 { self.n } else { 1.0 };
        let [x, y] = self.first.map(|v| v / n);
        let [xx, xy, yy] = self.second.map(|v| v / n);
        Moments {
            mean: Vec2::new(x, y),
            covariance: [(xx - x * x).max(0.0), xy - x * y, (yy - y * y).max(0.0)],
        }
    }
}

/// What lies between four texels: the vectors at its corners, which are interpolated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// At (0, 0), (1, 0), (0, 1) and (1, 1).
    corners: [Vec3<f64>; 4],
    /// Whether these are slopes with z one.
    pub slopes: bool,
}

impl Patch {
    /// The slope of the normal and its derivatives in both coordinates, as columns. `None` if it points down.
    pub fn slope(&self, [a, b]: [f64; 2]) -> Option<(Vec2<f64>, Mat2<f64>)> {
        let [p, q, r, s] = self.corners;
        let v =
            p * ((1.0 - a) * (1.0 - b)) + q * (a * (1.0 - b)) + r * ((1.0 - a) * b) + s * (a * b);
        let v_a = (q - p) * (1.0 - b) + (s - r) * b;
        let v_b = (r - p) * (1.0 - a) + (s - q) * a;
        let upright = v.z > LEAST_Z;
        if !upright {
            return None;
        }
        let slope = Vec2::new(-v.x / v.z, -v.y / v.z);
        // With -v_xy = slope v_z.
        let turn = |d: Vec3<f64>| Vec2::new(-d.x - slope.x * d.z, -d.y - slope.y * d.z) / v.z;
        Some((slope, Mat2::from_cols([turn(v_a), turn(v_b)])))
    }

    /// The slopes at the corners; those of normals that point down are cut.
    pub fn corners(&self) -> [Vec2<f64>; 4] {
        self.corners.map(|v| {
            let z = v.z.max(0.01);
            Vec2::new(-v.x / z, -v.y / z)
        })
    }

    /// Those of its slopes, exact where slopes are interpolated.
    fn moments(&self) -> Moments {
        /// Integrals of products of the four weights, times 36.
        const PRODUCTS: [[f64; 4]; 4] = [
            [4.0, 2.0, 2.0, 1.0],
            [2.0, 4.0, 1.0, 2.0],
            [2.0, 1.0, 4.0, 2.0],
            [1.0, 2.0, 2.0, 4.0],
        ];
        let s = self.corners();
        let mean = (s[0] + s[1] + s[2] + s[3]) * 0.25;
        let d = s.map(|s| s - mean);
        let mut covariance = [0.0; 3];
        for (row, i) in PRODUCTS.iter().zip(d) {
            for (w, j) in row.iter().zip(d) {
                covariance[0] += w * i.x * j.x;
                covariance[1] += w * i.x * j.y;
                covariance[2] += w * i.y * j.y;
            }
        }
        let covariance = covariance.map(|c| c / 36.0);
        Moments { mean, covariance }
    }
}

/// A node of the pyramid, as small as it can be kept.
#[derive(Clone, Copy, Debug, Default)]
struct Node([f32; 5]);

impl Node {
    fn of(m: &Moments) -> Self {
        let [xx, xy, yy] = m.covariance;
        Self([m.mean.x, m.mean.y, xx, xy, yy].map(|x| x as f32))
    }

    fn moments(self) -> Moments {
        let [x, y, xx, xy, yy] = self.0.map(f64::from);
        Moments {
            mean: Vec2::new(x, y),
            covariance: [xx, xy, yy],
        }
    }
}

#[derive(Clone, Debug)]
struct Level {
    size: [usize; 2],
    nodes: Vec<Node>,
}

/// A normal map as a field of slopes, and a pyramid of their moments: every level but the finest, which is the map itself.
///
/// Texel coordinates `t` are those in which the cell `[i, i + 1) x [j, j + 1)` lies between four texels; beyond the map
/// cells go on as its texture does. Texels are read where they are, in the parameters.
#[derive(Clone, Debug)]
pub struct SlopeMap {
    param: ParamRef,
    size: [usize; 2],
    wrap: Wrap,
    nearest: bool,
    interpolation: Interpolation,
    to_uv: [[f64; 3]; 2],
    /// Nodes of 2, 4, .. cells a side, to the whole.
    levels: Vec<Level>,
}

/// Where in a map of `n` something lies that does not end.
fn wrapped(i: i64, n: usize, wrap: Wrap) -> usize {
    let n = n as i64;
    let i = match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Clamp => i.clamp(0, n - 1),
        Wrap::Mirror => {
            let j = i.rem_euclid(2 * n);
            j.min(2 * n - 1 - j)
        }
    };
    i as usize
}

impl SlopeMap {
    /// Whether the texture of a normal map is one that glints are found in: an image, or the same everywhere.
    pub(super) fn fits(map: &NormalMap) -> bool {
        matches!(map.map(), RgbTexture::Bitmap(_) | RgbTexture::Constant(_))
    }

    /// Of a normal map at these parameters. `None` for textures that are no images.
    pub fn new<P: Float>(map: &NormalMap, theta: &Theta<P>) -> Option<Self> {
        let mut field = match *map.map() {
            RgbTexture::Bitmap(Bitmap {
                param,
                width,
                height,
                wrap,
                nearest,
                to_uv,
            }) => Self {
                param,
                size: [width as usize, height as usize],
                wrap,
                nearest,
                interpolation: map.interpolation(),
                to_uv: to_uv.rows.map(|row| row.map(f64::from)),
                levels: Vec::new(),
            },
            RgbTexture::Constant(param) => Self {
                param,
                size: [1, 1],
                wrap: Wrap::Repeat,
                nearest: true,
                interpolation: map.interpolation(),
                to_uv: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                levels: Vec::new(),
            },
            _ => return None,
        };
        field.build(theta);
        Some(field)
    }

    fn build<P: Float>(&mut self, theta: &Theta<P>) {
        let mut below = self.size;
        while below != [1, 1] {
            let size = below.map(|n| n.div_ceil(2));
            let mut nodes = Vec::with_capacity(size[0] * size[1]);
            for j in 0..size[1] {
                for i in 0..size[0] {
                    let mut sums = SlopeSums::default();
                    for [x, y] in [[0, 0], [1, 0], [0, 1], [1, 1]] {
                        let at = [2 * i + x, 2 * j + y];
                        if at[0] < below[0] && at[1] < below[1] {
                            let (moments, cells) = match self.levels.last() {
                                Some(level) => {
                                    let k = self.levels.len();
                                    let cells = |axis: usize| {
                                        let from = at[axis] << k;
                                        ((from + (1 << k)).min(self.size[axis]) - from) as f64
                                    };
                                    let node = level.nodes[at[1] * below[0] + at[0]];
                                    (node.moments(), cells(0) * cells(1))
                                }
                                None => {
                                    let cell = at.map(|i| i as i64);
                                    (self.patch(theta, cell).moments(), 1.0)
                                }
                            };
                            sums.add(&moments, cells);
                        }
                    }
                    nodes.push(Node::of(&sums.moments()));
                }
            }
            self.levels.push(Level { size, nodes });
            below = size;
        }
    }

    /// Bytes of the moments: what is kept besides the map itself.
    pub fn bytes(&self) -> usize {
        let nodes = |l: &Level| size_of_val(l.nodes.as_slice());
        self.levels.iter().map(nodes).sum()
    }

    /// Columns and rows.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Texel coordinates of surface coordinates.
    pub fn texels(&self, uv: Vec2<f64>) -> Vec2<f64> {
        let [x, y] = self.to_uv.map(|[a, b, c]| a * uv.x + b * uv.y + c);
        let half = if self.nearest { 0.0 } else { 0.5 };
        let [w, h] = self.size.map(|n| n as f64);
        Vec2::new(x * w - half, y * h - half)
    }

    /// Their derivatives in surface coordinates.
    pub(super) fn texels_per_uv(&self) -> Mat2<f64> {
        let [[a, b, _], [c, d, _]] = self.to_uv;
        let [w, h] = self.size.map(|n| n as f64);
        Mat2::from_rows([[a * w, b * w], [c * h, d * h]])
    }

    /// The slope of the normal there, and its derivatives in texel coordinates, as columns. `None` where it points down.
    pub fn slope<P: Float>(
        &self,
        theta: &Theta<P>,
        t: Vec2<f64>,
    ) -> Option<(Vec2<f64>, Mat2<f64>)> {
        let cell = cell_of(t);
        let [a, b] = [t.x - cell[0] as f64, t.y - cell[1] as f64];
        self.patch(theta, cell).slope([a, b])
    }

    /// A cell.
    pub(super) fn patch<P: Float>(&self, theta: &Theta<P>, [i, j]: [i64; 2]) -> Patch {
        let [w, h] = self.size;
        let corner = |x: i64, y: i64| {
            let texel = wrapped(y, h, self.wrap) * w + wrapped(x, w, self.wrap);
            let encoded: [P; 3] = theta.texel(self.param, texel);
            (self.interpolation).decode(encoded.map(|c| c.to_f64()))
        };
        let corners = if self.nearest {
            [corner(i, j); 4]
        } else {
            [
                corner(i, j),
                corner(i + 1, j),
                corner(i, j + 1),
                corner(i + 1, j + 1),
            ]
        };
        Patch {
            corners,
            slopes: self.interpolation == Interpolation::Slopes || self.nearest,
        }
    }

    /// How the map goes on.
    pub(super) fn wrap(&self) -> Wrap {
        self.wrap
    }

    /// Levels above the cells.
    pub(super) fn height(&self) -> usize {
        self.levels.len()
    }

    /// Size of level `k`, in nodes of `2^k` cells a side.
    pub(super) fn nodes(&self, k: usize) -> [usize; 2] {
        match k {
            0 => self.size,
            _ => self.levels[k - 1].size,
        }
    }

    /// Moments of a node, counted without an end.
    pub(super) fn node<P: Float>(&self, theta: &Theta<P>, k: usize, at: [i64; 2]) -> Moments {
        match k {
            0 => self.patch(theta, at).moments(),
            _ => {
                let level = &self.levels[k - 1];
                let [i, j] =
                    [0, 1].map(|axis: usize| wrapped(at[axis], level.size[axis], self.wrap));
                level.nodes[j * level.size[0] + i].moments()
            }
        }
    }

    /// Moments of the slopes in the rectangle of half extents `half`, in texels, about `t`, from few nodes of the pyramid:
    /// what is far off looks like this. Rectangles larger than the map see all of it.
    pub fn moments<P: Float>(&self, theta: &Theta<P>, t: Vec2<f64>, half: [f64; 2]) -> Moments {
        let size = self.size.map(|n| n as f64);
        let longest = half[0].max(half[1]);
        let whole =
            !(longest.is_finite() && t.is_finite()) || (0..2).all(|k| 2.0 * half[k] >= size[k]);
        if whole {
            return self.node(theta, self.height(), [0, 0]);
        }
        // At most eight nodes along the longer side.
        let k = (longest / 4.0).log2().ceil().max(0.0) as usize;
        let k = k.min(self.height());
        let step = (1u64 << k) as f64;
        let range = |x: f64, half: f64| {
            let half = half.max(0.5).min(longest.max(0.5));
            let (from, to) = ((x - half) / step, (x + half) / step);
            (from, to)
        };
        let (x, y) = (range(t.x, half[0]), range(t.y, half[1]));
        let overlap = |i: i64, (from, to): (f64, f64)| {
            ((i as f64 + 1.0).min(to) - (i as f64).max(from)).max(0.0)
        };
        let mut sums = SlopeSums::default();
        for j in y.0.floor() as i64..=y.1.floor() as i64 {
            for i in x.0.floor() as i64..=x.1.floor() as i64 {
                let weight = overlap(i, x) * overlap(j, y);
                if weight > 0.0 {
                    sums.add(&self.node(theta, k, [i, j]), weight);
                }
            }
        }
        sums.moments()
    }
}

/// The cell of a point in texel coordinates.
pub(super) fn cell_of(t: Vec2<f64>) -> [i64; 2] {
    [t.x, t.y].map(|x| x.floor() as i64)
}
