//! Environment maps.

use std::f64::consts::{FRAC_1_PI, PI};

use ad_core::{Float, Real, Vec2, Vec3};

use super::{Emission, Emitter, EmitterSample, Lights};
use crate::bsdf::FromNode;
use crate::error::SceneError;
use crate::film::Image;
use crate::image_io::Encoding;
use crate::math::{Rgb, Transform};
use crate::params::{Differentiability, ParamRef, ParamShape, Params};
use crate::scene::{Builder, Node};
use crate::shape::{SurfaceInteraction, lift3, turn};
use crate::texture::{self, Bitmap, RgbTexture, Texture, UvTransform, Wrap};

/// Fraction of the samples that are uniform over the sphere, so that dark texels can be switched on
/// (F7).
const UNIFORM_FRACTION: f64 = 0.05;

/// What every environment's texels satisfy.
const VALID: (f64, f64) = (0.0, f64::INFINITY);

/// Radiance from infinitely far away, an image over longitude and latitude.
///
/// In the local space of the map, `(u, v)` belongs to the direction `(sin phi sin theta, cos theta,
/// -cos phi sin theta)` with `phi = 2 pi u` and `theta = pi v`. As in the peer, columns are centre-aligned
/// and periodic (position `u width - 1/2`), rows are corner-aligned (position `v (height - 1)`): the first
/// and the last row lie at the poles.
///
/// Directions are sampled in proportion to the luminance, interpolated over the cells between
/// texels, plus a uniform part of five percent.
#[derive(Clone, Debug)]
pub struct Envmap {
    radiance: RgbTexture,
    param: ParamRef,
    width: usize,
    height: usize,
    scale: f64,
    /// Local x, y and z axis, world space, orthonormal.
    axes: [[f32; 3]; 3],
    /// 1 - cos theta between the bands of cells, from pole to pole.
    edges: Vec<f64>,
    table: Table,
}

/// Cells between neighbouring texels: `width` of them around each of `rows` bands. Within a cell the
/// density per solid angle is bilinear in longitude and in the cosine of the angle from the pole.
#[derive(Clone, Debug, Default)]
struct Table {
    /// 4 pi times the density per solid angle, at the texels.
    density: Vec<f32>,
    /// Per band: probability of this band and all before it.
    bands: Vec<f64>,
    /// Per band and cell: probability of this cell and all before it in the band.
    cells: Vec<f32>,
}

impl Envmap {
    /// From an image whose texels become the parameters `{name}.data`; the radiance is `scale` times
    /// that. Of `to_world`, only the axes' directions count.
    ///
    /// # Errors
    /// An image of the wrong length, or negative or not finite; axes that are not orthogonal; a
    /// negative scale.
    pub fn new(
        build: &mut Builder,
        name: &str,
        image: &Image,
        to_world: &Transform,
        scale: f64,
    ) -> Result<Self, SceneError> {
        let error = |expected: &str, found: String| SceneError::Parameter {
            key: format!("{name}.data"),
            expected: expected.into(),
            found,
        };
        let (width, height) = (image.width, image.height);
        let len = width.checked_mul(height).and_then(|n| n.checked_mul(3));
        if image.data.is_empty() || len != Some(image.data.len()) {
            return Err(error(
                "an RGB image",
                format!("{} values for {width} x {height} texels", image.data.len()),
            ));
        }
        if let Some(x) = image.data.iter().find(|x| !(x.is_finite() && **x >= 0.0)) {
            return Err(error("finite texels of at least 0", x.to_string()));
        }
        let shape = ParamShape::Texture {
            height,
            width,
            channels: 3,
        };
        let name = format!("{name}.data");
        let smooth = Differentiability::Smooth;
        let param = build
            .push_texels(&name, shape, &image.data, VALID, smooth)
            .ok_or_else(|| error("at most 2^32 parameters", "more".into()))?;
        let axes = orthonormal(to_world)
            .ok_or_else(|| error("a to_world with orthogonal axes", "others".into()))?;
        if !(scale.is_finite() && scale >= 0.0) {
            return Err(error("a scale of at least 0", scale.to_string()));
        }
        Ok(Self::over(
            param,
            [width as u32, height as u32],
            axes,
            scale,
        ))
    }

    fn over(param: ParamRef, [width, height]: [u32; 2], axes: [[f32; 3]; 3], scale: f64) -> Self {
        // Rows v (height - 1), expressed for a texture whose rows are centre-aligned. A hair's breadth
        // less, so that rounding at a pole cannot reach across to the other one.
        let n = f64::from(height);
        let slope = (n - 1.0) / n * (1.0 - 3.0 * f64::from(f32::EPSILON));
        let start = 0.5 / n * (1.0 + 3.0 * f64::from(f32::EPSILON));
        let bitmap = Bitmap {
            param,
            width,
            height,
            wrap: Wrap::Repeat,
            nearest: false,
            to_uv: UvTransform {
                rows: [[1.0, 0.0, 0.0], [0.0, slope as f32, start as f32]],
            },
        };
        // One band where there is one row only.
        let bands = (height as usize - 1).max(1);
        let one_minus_cos =
            |band: usize| 2.0 * (0.5 * PI * band as f64 / bands as f64).sin().powi(2);
        Self {
            radiance: Texture::Bitmap(bitmap),
            param,
            width: width as usize,
            height: height as usize,
            scale,
            axes,
            edges: (0..=bands).map(one_minus_cos).collect(),
            table: Table::default(),
        }
    }

    #[inline]
    fn local<R: Real>(&self, d: Vec3<R>) -> [R; 3] {
        self.axes.map(|a| lift3::<R>(a).dot(d))
    }

    /// Number of bands of cells.
    #[inline]
    fn bands(&self) -> usize {
        self.edges.len() - 1
    }

    /// The densities at the corners of a cell: of the upper row, then of the lower one.
    #[inline]
    fn corners(&self, band: usize, cell: usize) -> [[f64; 2]; 2] {
        let next = if cell + 1 == self.width { 0 } else { cell + 1 };
        [band, (band + 1).min(self.height - 1)]
            .map(|row| [cell, next].map(|x| f64::from(self.table.density[row * self.width + x])))
    }

    #[inline]
    fn corner_sum(&self, band: usize, cell: usize) -> f64 {
        self.corners(band, cell).as_flattened().iter().sum()
    }

    /// Density per solid angle at a local direction: bilinear in its cell, so continuous.
    fn density<R: Real>(&self, local: [R; 3]) -> R {
        let uniform = R::c(0.25 * FRAC_1_PI);
        if self.table.density.is_empty() {
            return R::lift(uniform.0);
        }
        let [x, y, z] = local;
        let column = turn(x, -z) * R::c(self.width as f64) - R::c(0.5);
        let left = column.primal().to_f64().floor();
        let cell = (left as i64).rem_euclid(self.width as i64) as usize;
        let fx = column - R::c(left);
        let sine_squared = x * x + z * z;
        let theta = sine_squared.primal().sqrt().atan2(y.primal()).to_f64();
        let band = (theta * FRAC_1_PI * self.bands() as f64) as usize;
        let band = band.min(self.bands() - 1);
        // 1 - cos theta without cancellation near the upper pole; near the lower one nothing cancels.
        let r = (sine_squared + y * y).sqrt();
        let h = if y.primal() > R::Primal::zero() {
            sine_squared / (r * (r + y))
        } else {
            -(y / r) + R::c(1.0)
        };
        let (above, below) = (self.edges[band], self.edges[band + 1]);
        let fy = ((h - R::c(above)) / R::c(below - above)).clamp(R::zero(), R::one());
        let [[a, b], [c, d]] = self.corners(band, cell);
        let across = |a: f64, b: f64| fx * R::c(b - a) + R::c(a);
        let (upper, lower) = (across(a, b), across(c, d));
        (upper + (lower - upper) * fy) * uniform
    }
}

/// Directions of the images of the axes, exactly orthonormal; `None` unless they nearly are.
fn orthonormal(to_world: &Transform) -> Option<[[f32; 3]; 3]> {
    let column = |j: usize| Vec3::from([0, 1, 2].map(|i: usize| to_world.linear[i][j])).normalize();
    let (x, y, z) = (column(0), column(1), column(2));
    let skew = [x.dot(y), y.dot(z), z.dot(x)];
    let unit = [x, y, z].iter().all(|a| a.length() > 0.5);
    if !unit || !skew.iter().all(|s| s.abs() < 1e-4) {
        return None;
    }
    let x = (x - y * x.dot(y)).normalize();
    let right = x.cross(y);
    let z = if right.dot(z) < 0.0 { -right } else { right };
    Some([x, y, z].map(|a| a.to_array().map(|x| x as f32)))
}

/// Fraction at which a density linear from `a` to `b` (positive) has accumulated the share `u`.
#[inline]
fn sample_linear(u: f64, a: f64, b: f64) -> f64 {
    let x = u * (a + b) / (a + (a * a + u * (b * b - a * a)).sqrt());
    x.clamp(0.0, 1.0)
}

impl Emitter for Envmap {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline]
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        if si.is_some() {
            return None;
        }
        let [x, y, z] = self.local(d);
        let v = x.hypot(z).atan2(y) * R::c(FRAC_1_PI);
        Some(Emission {
            uv: Vec2::new(turn(x, -z), v),
            falloff: R::of(self.scale),
        })
    }

    fn sample<P: Float>(&self, _: Lights, _: Vec3<P>, u: [P; 2]) -> Option<EmitterSample<P>> {
        let t = &self.table;
        if t.density.is_empty() {
            return None;
        }
        // In f64: a choice among thousands of cells leaves f32 few digits for the place in the cell.
        let [ux, uy] = u.map(|u| u.to_f64());
        let band = t.bands.partition_point(|&p| p <= uy).min(self.bands() - 1);
        let before = if band == 0 { 0.0 } else { t.bands[band - 1] };
        let uy = ((uy - before) / (t.bands[band] - before)).clamp(0.0, 1.0);
        let cells = &t.cells[band * self.width..][..self.width];
        let cell = cells
            .partition_point(|&p| f64::from(p) <= ux)
            .min(self.width - 1);
        let before = if cell == 0 {
            0.0
        } else {
            f64::from(cells[cell - 1])
        };
        let ux = ((ux - before) / (f64::from(cells[cell]) - before)).clamp(0.0, 1.0);

        let [[a, b], [c, d]] = self.corners(band, cell);
        let fy = sample_linear(uy, a + b, c + d);
        let (left, right) = (a + (c - a) * fy, b + (d - b) * fy);
        let fx = sample_linear(ux, left, right);
        let (above, below) = (self.edges[band], self.edges[band + 1]);
        let h = above + (below - above) * fy;
        let u = ((cell as f64 + 0.5 + fx) / self.width as f64).rem_euclid(1.0);
        let (sin_phi, cos_phi) = (2.0 * PI * u).sin_cos();
        let (sin_theta, cos_theta) = ((h * (2.0 - h)).max(0.0).sqrt(), 1.0 - h);
        let local = [sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta];
        let world = self.axes.iter().zip(local);
        let d = world.fold(Vec3::<f64>::zero(), |sum, (&a, x)| {
            sum + lift3::<f64>(a) * x
        });
        let pdf = (left + (right - left) * fx) * 0.25 * FRAC_1_PI;
        Some(EmitterSample {
            d: d.map(P::of).normalize(),
            distance: P::of(f64::INFINITY),
            normals: [Vec3::zero(); 2],
            pdf: P::of(pdf),
            emission: Emission {
                uv: Vec2::new(P::of(u), P::of(sin_theta.atan2(cos_theta) * FRAC_1_PI)),
                falloff: P::of(self.scale),
            },
        })
    }

    #[inline]
    fn pdf<R: Real>(
        &self,
        _: Lights,
        _: Vec3<R>,
        d: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
    ) -> R {
        match si {
            Some(_) => R::zero(),
            None => self.density(self.local(d)),
        }
    }

    fn is_infinite(&self) -> bool {
        true
    }

    fn update(&mut self, params: &Params) {
        let (width, bands) = (self.width, self.bands());
        let texels = &params.values()[self.param.offset as usize..][..width * self.height * 3];
        let luminance = |t: &[f32]| Rgb::new(t[0], t[1], t[2]).luminance();
        self.table.density = texels.chunks_exact(3).map(luminance).collect();

        // Fraction of the sphere that one cell of a band covers, and the mass of luminance there.
        let cover: Vec<f64> = (self.edges.windows(2))
            .map(|e| 0.5 * (e[1] - e[0]) / width as f64)
            .collect();
        let mass = |band: usize| -> f64 {
            let corners: f64 = (0..width).map(|cell| self.corner_sum(band, cell)).sum();
            0.25 * corners * cover[band]
        };
        let total: f64 = (0..bands).map(mass).sum();
        // A black map is sampled uniformly.
        let (factor, floor) = if total > 0.0 && (1.0 / total).is_finite() {
            ((1.0 - UNIFORM_FRACTION) / total, UNIFORM_FRACTION)
        } else {
            (0.0, 1.0)
        };
        for x in &mut self.table.density {
            *x = (f64::from(*x) * factor + floor) as f32;
        }

        let mut cells = Vec::with_capacity(width * bands);
        let mut sums = Vec::with_capacity(bands);
        let mut sum = 0.0;
        for (band, cover) in cover.iter().enumerate() {
            let corners: f64 = (0..width).map(|cell| self.corner_sum(band, cell)).sum();
            let mut share = 0.0;
            for cell in 0..width {
                share += self.corner_sum(band, cell);
                cells.push((share / corners) as f32);
            }
            sum += corners * cover;
            sums.push(sum);
        }
        sums.iter_mut().for_each(|s| *s /= sum);
        self.table.cells = cells;
        self.table.bands = sums;
    }
}

impl FromNode for Envmap {
    const PLUGINS: &'static [&'static str] = &["envmap"];

    fn from_node(node: &Node, build: &mut Builder) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let axes = orthonormal(&to_world).ok_or_else(|| {
            node.invalid("to_world", "a transform that keeps the axes orthogonal")
        })?;
        let scale = node.float_or("scale", 1.0)?;
        if scale < 0.0 {
            return Err(node.invalid("scale", "a number of at least 0"));
        }
        node.ignore(&["mis_compensation"]);
        let name = build.prefix().to_owned();
        let usage = texture::Use {
            name: &name,
            valid: VALID,
            differentiability: Differentiability::Smooth,
            substitute: &[0.5; 3],
        };
        let Some(path) = texture::file(build, node, &usage)? else {
            let grey = Image {
                width: 1,
                height: 1,
                data: vec![0.5; 3],
            };
            return Self::new(build, &name, &grey, &to_world, scale);
        };
        let (param, size) = texture::texels::<3>(build, &path, Encoding::Srgb, &usage)?;
        Ok(Self::over(param, size, axes, scale))
    }
}
