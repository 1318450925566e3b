//! Environment maps.

mod motion;
mod table;

pub use motion::{Moved, MovingDraw, Shift};

use std::f64::consts::FRAC_1_PI;

use ad_core::{Const, Float, Real, Vec2, Vec3};

pub(crate) use self::table::Local;
use self::table::Table;
use super::{Emission, Emitter, EmitterSample, Lights, SCALES, WIDE, scale_given, scale_of};
use crate::error::SceneError;
use crate::film::Image;
use crate::math::{Rgb, Transform, angle, each};
use crate::motion::Placement;
use crate::params::{ParamRef, ParamShape, Params};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{SurfaceInteraction, lift3};
use crate::texture::{self, Bitmap, RgbTexture, Texture, UvTransform, Wrap};

/// What every environment's texels satisfy.
const VALID: (f64, f64) = (0.0, f64::INFINITY);

/// Radiance from infinitely far away, an image over longitude and latitude.
///
/// In the local space of the map, `(u, v)` belongs to the direction `(sin phi sin theta, cos theta,
/// -cos phi sin theta)` with `phi = 2 pi u` and `theta = pi v`. As in Mitsuba 3, columns are centre-aligned
/// and periodic (position `u width - 1/2`), rows are corner-aligned (position `v (height - 1)`): the first
/// and the last row lie at the poles.
///
/// Directions are sampled in proportion to the luminance, interpolated over the cells between
/// texels, plus a uniform part of five percent.
#[derive(Clone, Debug)]
pub struct Envmap {
    radiance: RgbTexture,
    param: ParamRef,
    scale: ParamRef,
    /// Local x, y and z axis, world space, orthonormal.
    axes: [[f32; 3]; 3],
    /// The same before it is turned, and how it is.
    axes_at_rest: [[f32; 3]; 3],
    turned: Placement,
    table: Table,
}

impl Envmap {
    /// From an image whose texels become the parameters `{name}.data`; the radiance is `scale`, the parameter
    /// `{name}.scale`, times that. Of `to_world`, only the axes' directions count.
    ///
    /// # Errors
    /// An image of the wrong length, or negative or not finite; axes that are not orthogonal; a
    /// negative scale.
    pub fn new(
        registry: &mut Registry,
        name: &str,
        image: &Image,
        to_world: &Transform,
        scale: f64,
    ) -> Result<Self, SceneError> {
        let key = format!("{name}.scale");
        let scale = |r: &mut Registry| r.push_param(&key, ParamShape::Scalar, &[scale], SCALES);
        Self::of_image(registry, name, image, to_world, scale)
    }

    /// [`Envmap::new`] whose scale the caller makes a parameter, behind the texels.
    fn of_image(
        registry: &mut Registry,
        name: &str,
        image: &Image,
        to_world: &Transform,
        scale: impl FnOnce(&mut Registry) -> Result<ParamRef, SceneError>,
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
        let param = registry
            .push_texels(&name, shape, &image.data, VALID)
            .ok_or_else(|| error("at most 2^32 parameters", "more".into()))?;
        let axes = orthonormal(to_world)
            .ok_or_else(|| error("a to_world with orthogonal axes", "others".into()))?;
        Ok(Self::over(
            param,
            [width as u32, height as u32],
            axes,
            scale(registry)?,
        ))
    }

    fn over(
        param: ParamRef,
        [width, height]: [u32; 2],
        axes: [[f32; 3]; 3],
        scale: ParamRef,
    ) -> Self {
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
        Self {
            radiance: Texture::Bitmap(bitmap),
            param,
            scale,
            axes,
            axes_at_rest: axes,
            turned: Placement::default(),
            table: Table::new(width as usize, height as usize),
        }
    }

    /// Where a direction meets the map.
    #[inline(always)]
    pub(crate) fn spot<R: Real>(&self, d: Vec3<R>) -> MapPoint<R> {
        let [x, y, z] = each(self.axes, |a| lift3::<R>(a).dot(d));
        let sine_squared = x.square() + z.square();
        let u = angle::atan2(x, -z) * R::c(0.5 * FRAC_1_PI);
        let u = R::select(u.primal() < R::Primal::zero(), u + R::c(1.0), u);
        let v = angle::polar(x, z, y) * R::c(FRAC_1_PI);
        // 1 - cos theta without cancellation near the upper pole; near the lower one nothing cancels.
        let r = (sine_squared + y * y).sqrt();
        let h = R::select(
            y.primal() > R::Primal::zero(),
            sine_squared / (r * (r + y)),
            -(y / r) + R::c(1.0),
        );
        MapPoint {
            uv: Vec2::new(u, v),
            h,
        }
    }

    /// The cell there: its band, its column, and how far along it the spot is.
    #[inline(always)]
    pub(crate) fn cell<R: Real>(&self, spot: &MapPoint<R>) -> ([u32; 2], R) {
        let (width, bands) = (self.table.width as f64, self.table.bands() as f64);
        let column = spot.uv.x * R::c(width) - R::c(0.5);
        let left = column.primal().floor();
        let whole = |x: R::Primal, n: f64| {
            let last = R::Primal::of(n - 1.0);
            let x = R::Primal::select(x < R::Primal::zero(), last, x);
            // Of numbers in this range the fastest conversion is right.
            x.min(last).to_f64() as i32 as u32
        };
        let band = spot.uv.y.primal() * R::Primal::of(bands);
        let cell = [whole(band, bands), whole(left, width)];
        (cell, column - Const(left))
    }

    /// What the density in a cell depends on: 1 - cos theta above and below it, and the density at its corners.
    #[inline(always)]
    pub(crate) fn corners(&self, [band, cell]: [u32; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
        let (table, band) = (&self.table, band as usize);
        let edges = [table.edges[band], table.edges[band + 1]];
        (edges, table.corners(band, cell as usize))
    }

    /// Density per solid angle at a spot that is so far along its cell: bilinear there, so continuous.
    #[inline(always)]
    pub(crate) fn density_in<R: Real>(
        spot: &MapPoint<R>,
        fx: R,
        [above, below]: [f64; 2],
        [[a, b], [c, d]]: [[f64; 2]; 2],
    ) -> R {
        let fy = ((spot.h - R::c(above)) / R::c(below - above)).clamp(R::zero(), R::one());
        let across = |a: f64, b: f64| fx * R::c(b - a) + R::c(a);
        let (upper, lower) = (across(a, b), across(c, d));
        (upper + (lower - upper) * fy) * R::c(0.25 * FRAC_1_PI)
    }

    /// A sample of direction, density and coordinates of the texture.
    #[inline(always)]
    pub(crate) fn sampled<P: Float>(&self, d: Vec3<P>, pdf: P, uv: Vec2<P>) -> EmitterSample<P> {
        EmitterSample::without_surface(d, P::of(f64::INFINITY), pdf, self.emission(uv))
    }

    /// Whether it has been told its texels: until then there is nothing to draw.
    #[inline(always)]
    pub(crate) fn is_known(&self) -> bool {
        !self.table.density.is_empty()
    }

    /// What it emits at a spot.
    #[inline(always)]
    pub(crate) fn emission<R: Real>(&self, uv: Vec2<R>) -> Emission<R> {
        Emission {
            uv,
            falloff: R::one(),
        }
    }

    /// The first and the last band that a random number may fall into.
    #[inline(always)]
    pub(crate) fn bands_left(&self, u: f64) -> [usize; 2] {
        self.table.bands_left(u)
    }

    /// Whether it falls below a band.
    #[inline(always)]
    pub(crate) fn is_above(&self, band: usize, u: f64) -> bool {
        self.table.is_above(band, u)
    }

    /// What there is of its band in the map's numbers, and the fraction of the sphere that it covers.
    #[inline(always)]
    pub(crate) fn draw_band(&self, band: usize) -> (Local<f64>, f64) {
        (self.table.around(band), self.table.cover(band))
    }

    /// How far down in the band it is.
    #[inline(always)]
    pub(crate) fn draw_latitude(&self, cover: f64, u: f64, around: &Local<f64>) -> f64 {
        self.table.latitude_where(cover, u, around)
    }

    /// The first and the last cell of a band that a random number may fall into at a latitude, and the sum that it reaches.
    #[inline(always)]
    pub(crate) fn cells_left(&self, band: usize, u: f64, y: f64) -> ([usize; 2], f64) {
        self.table.cells_left(band, u, y)
    }

    /// Whether a cell of a band ends before that sum.
    #[inline(always)]
    pub(crate) fn is_before(&self, of: [usize; 2], y: f64, target: f64) -> bool {
        self.table.is_before(of, y, target)
    }

    /// What surrounds a cell, and 1 - cos theta above and below.
    #[inline(always)]
    pub(crate) fn draw_cell(&self, [band, cell]: [usize; 2]) -> (Local<f64>, [f64; 2]) {
        let edges = [self.table.edges[band], self.table.edges[band + 1]];
        (self.table.local(band, cell), edges)
    }

    /// The sample that these numbers give: direction, density and coordinates of the texture.
    #[inline(always)]
    pub(crate) fn draw_place<P: Float>(
        &self,
        (cell, edges): (f64, [f64; 2]),
        u: f64,
        y: f64,
        local: &Local<f64>,
    ) -> (Vec3<P>, P, Vec2<P>) {
        let draw = self.table.place(y, u, local);
        let (d, [u, v]) = self.towards(cell, edges, [draw.x, draw.y]);
        let pdf = P::of(draw.density * 0.25 * FRAC_1_PI);
        // It is nearly of unit length already.
        (d.map(P::of).unit().0, pdf, Vec2::new(P::of(u), P::of(v)))
    }

    /// The direction to a place in a cell, whose edges are at these values of 1 - cos theta, world space, and the
    /// coordinates of the texture there.
    #[inline(always)]
    fn towards<R: Real<Primal = f64>>(
        &self,
        cell: f64,
        [above, below]: [f64; 2],
        [x, y]: [R; 2],
    ) -> (Vec3<R>, [R; 2]) {
        let h = y * R::c(below - above) + R::c(above);
        let u = (x + R::c(cell + 0.5)) * R::c(1.0 / self.table.width as f64);
        // Half of the last cell lies beyond the seam.
        let u = R::select(u.primal() >= 1.0, u - R::c(1.0), u);
        let (sin_phi, cos_phi) = angle::sin_cos(u);
        let sin_theta = (h * (R::c(2.0) - h)).max(R::zero()).sqrt();
        let cos_theta = R::c(1.0) - h;
        let local = [sin_phi * sin_theta, cos_theta, -cos_phi * sin_theta];
        let world = |k: usize| {
            let [a, b, c] = each(self.axes, |axis| R::c(f64::from(axis[k])));
            local[0] * a + local[1] * b + local[2] * c
        };
        let v = angle::atan2(sin_theta, cos_theta) * R::c(FRAC_1_PI);
        (Vec3::new(world(0), world(1), world(2)), [u, v])
    }
}

/// Where a direction meets a map.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MapPoint<R> {
    /// Coordinates of the texture.
    pub uv: Vec2<R>,
    /// 1 - cos theta.
    pub h: R,
}

/// What the angle of `(x, y)` is more than it is without tangents: zero, and its change. `atan2` would find the angle,
/// too, which takes most of its time.
#[inline]
fn angle_again<R: Real>(y: R, x: R) -> R {
    let (x0, y0) = (x.primal(), y.primal());
    let squared = x0 * x0 + y0 * y0;
    if squared <= R::Primal::MIN_POSITIVE {
        return R::zero();
    }
    let across = y * Const(x0) - x * Const(y0);
    (across - Const(across.primal())) * Const(squared.recip())
}

/// A transform whose axes differ from one in length by more than this scales.
const STRETCHED: f64 = 1e-3;

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

impl Emitter for Envmap {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline(always)]
    fn scale(&self) -> Option<ParamRef> {
        Some(self.scale)
    }

    #[inline]
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        if si.is_some() {
            return None;
        }
        Some(self.emission(self.spot(d).uv))
    }

    #[inline]
    fn hit_again<R: Real>(
        &self,
        d: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
        at: &Emission<R::Primal>,
    ) -> Option<Emission<R>> {
        if si.is_some() {
            return None;
        }
        let [x, y, z] = each(self.axes, |a| lift3::<R>(a).dot(d));
        let u = angle_again(x, -z) * R::c(0.5 * FRAC_1_PI);
        let sine = (x.square() + z.square()).sqrt();
        let v = angle_again(sine, y) * R::c(FRAC_1_PI);
        Some(Emission {
            uv: Vec2::new(u + Const(at.uv.x), v + Const(at.uv.y)),
            falloff: R::lift(at.falloff),
        })
    }

    fn sample<P: Float>(&self, _: Lights, _: Vec3<P>, u: [P; 2]) -> Option<EmitterSample<P>> {
        if !self.is_known() {
            return None;
        }
        // In f64: a choice among thousands of cells leaves f32 few digits for the place in the cell.
        let [u0, u1] = [u[0].to_f64(), u[1].to_f64()];
        let band = self.table.band(u1);
        let (around, cover) = self.draw_band(band);
        let y = self.draw_latitude(cover, u1, &around);
        let cell = self.table.cell(band, u0, y);
        let (local, edges) = self.draw_cell([band, cell]);
        let (d, pdf, uv) = self.draw_place((cell as f64, edges), u0, y, &local);
        Some(self.sampled(d, pdf, uv))
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
            None if !self.is_known() => R::of(0.25 * FRAC_1_PI),
            None => {
                let spot = self.spot(d);
                let (cell, fx) = self.cell(&spot);
                let (edges, corners) = self.corners(cell);
                Self::density_in(&spot, fx, edges, corners)
            }
        }
    }

    fn is_infinite(&self) -> bool {
        true
    }

    fn is_wide(&self) -> bool {
        self.is_known() && self.table.cover_of_light() >= WIDE
    }

    fn update(&mut self, params: &Params) {
        let len = self.table.width * self.table.height * 3;
        let texels = &params.values()[self.param.offset as usize..][..len];
        let luminance = |t: &[f32]| Rgb::new(t[0], t[1], t[2]).luminance();
        let luminance: Vec<f32> = texels.chunks_exact(3).map(luminance).collect();
        self.table.update(&luminance);
        self.axes = each(self.axes_at_rest, |a| self.turned.turn(params, a));
    }

    fn make_movable(&mut self, p: ParamRef) {
        self.turned.rotation = Some(p);
    }

    fn turned(&self) -> Option<&Placement> {
        Some(&self.turned)
    }
}

impl FromNode for Envmap {
    const PLUGINS: &'static [&'static str] = &["envmap"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let axes = orthonormal(&to_world).ok_or_else(|| {
            node.invalid("to_world", "a transform that keeps the axes orthogonal")
        })?;
        let length =
            |j: usize| Vec3::from([0, 1, 2].map(|i: usize| to_world.linear[i][j])).length();
        if (0..3).any(|j| (length(j) - 1.0).abs() > STRETCHED) {
            node.warn(
                "`to_world` turns the image and does not scale it; Mitsuba 3 distorts it then",
            );
        }
        // What is wrong with it is said before a file is read.
        scale_given(node)?;
        node.ignore(&["mis_compensation"], Node::boolean)?;
        let name = registry.prefix().to_owned();
        let usage = texture::Use {
            name: &name,
            valid: VALID,
            substitute: &[0.5; 3],
        };
        let (layer, encoding) = (node.string("layer")?, texture::encoding(node)?);
        let Some(path) = texture::file(registry, node, &usage)? else {
            let grey = Image {
                width: 1,
                height: 1,
                data: vec![0.5; 3],
            };
            return Self::of_image(registry, &name, &grey, &to_world, |r| scale_of(node, r));
        };
        let (param, size) = texture::texels::<3>(registry, &path, encoding, layer, &usage)?;
        registry.origins.of_image(node, param);
        Ok(Self::over(param, size, axes, scale_of(node, registry)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;

    /// All around, at a pole, and across the seam.
    #[test]
    fn a_known_place_moves_as_one_that_is_found() {
        let param = ParamRef { id: 0, offset: 0 };
        let axes = [[0.0, 0.6, 0.8], [1.0, 0.0, 0.0], [0.0, 0.8, -0.6]];
        let scale = ParamRef { id: 1, offset: 96 };
        let map = Envmap::over(param, [8, 4], axes, scale);
        for k in 0..400 {
            let (theta, phi) = (0.157 * f64::from(k / 20), 0.3142 * f64::from(k % 20));
            let (sin, cos) = theta.sin_cos();
            let d = Vec3::new(cos, sin * phi.cos(), sin * phi.sin());
            let vary = |x: f64, i: usize| Dual::<f64, 3>::var(x, i);
            let moving = Vec3::new(vary(d.x, 0), vary(d.y, 1), vary(d.z, 2));
            let known = map.hit(d, None).unwrap();
            let found = map.hit(moving, None).unwrap();
            let again = map.hit_again(moving, None, &known).unwrap();
            for (a, b) in [(again.uv.x, found.uv.x), (again.uv.y, found.uv.y)] {
                assert_eq!(a.re, b.re);
                for (a, b) in a.eps.iter().zip(b.eps) {
                    assert!((a - b).abs() <= 1e-12 * b.abs().max(1.0), "{d:?}: {a} {b}");
                }
            }
            assert_eq!(again.falloff.re, found.falloff.re);
        }
    }
}
