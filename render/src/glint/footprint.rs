//! What a sample of a pixel sees of a surface, to first order.

use ad_core::{Dual, Mat2, Vec2, Vec3};

use super::map::SlopeMap;
use crate::camera::PerPixel;
use crate::film::PixelFilter;
use crate::manifold::Target;
use crate::math::Ray;
use crate::params::Theta;
use crate::scene::{Intersection, Scene};
use crate::shape::SurfaceInteraction;

/// Farthest texel coordinates: beyond, cells are not told apart.
const FARTHEST: f64 = 1e9;

/// A square of a filter's support, which is searched by itself.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Its middle, in pixels from that of the filter.
    pub middle: [f64; 2],
    /// Half its side, in pixels.
    pub half: f64,
    /// Probability that it is searched.
    pub share: f64,
    /// That by the filter alone, which weights go by: an affine footprint may put a glint on the wrong side of a border, so that
    /// they must not jump there.
    pub by_filter: f64,
}

/// A point of a surface as a camera ray sees it, with its derivatives across the image: the footprint of a part of the pixel's
/// filter around it [Igehy 1999].
#[derive(Clone, Copy, Debug)]
pub struct Footprint {
    /// The shape.
    pub shape: u32,
    /// The primitive.
    pub prim: u32,
    /// The point, with derivatives in x and y of the image, per pixel.
    pub si: SurfaceInteraction<PerPixel>,
    /// The middle of the pixel's filter, in pixels from the point.
    pub centre: [f64; 2],
    /// The filter.
    pub filter: PixelFilter,
    /// The part of it that is searched; all of it, unless it is [`within`](Self::within) another.
    pub part: Part,
    /// To the viewer, local frame.
    wo: Vec3<PerPixel>,
}

/// The half vector to a target as a function of texel coordinates: its slope, an affine function, and what the footprint is.
#[derive(Clone, Copy, Debug)]
pub(super) struct HalfVectors {
    /// Texel coordinates of the footprint's point.
    pub t0: Vec2<f64>,
    /// Slope of the half vector there.
    half0: Vec2<f64>,
    /// Its derivatives in texel coordinates.
    pub half_per_texel: Mat2<f64>,
    /// Texels per pixel, as columns.
    pub texels_per_pixel: Mat2<f64>,
    pixels_per_texel: Mat2<f64>,
    centre: Vec2<f64>,
    radius: f64,
}

impl HalfVectors {
    /// From derivatives across the image, as columns: those of the half vector's slope and of texel coordinates. `None` if they
    /// do not say where in the image a texel is, or if that is out of reach.
    pub fn of(
        t0: Vec2<f64>,
        half0: Vec2<f64>,
        half_per_pixel: Mat2<f64>,
        texels_per_pixel: Mat2<f64>,
        centre: Vec2<f64>,
        radius: f64,
    ) -> Option<Self> {
        let pixels_per_texel = texels_per_pixel.inverse()?;
        let halves = Self {
            t0,
            half0,
            half_per_texel: half_per_pixel * pixels_per_texel,
            texels_per_pixel,
            pixels_per_texel,
            centre,
            radius,
        };
        let (middle, half) = halves.bounds();
        let near = |x: f64| x.abs() <= FARTHEST;
        let all = halves.half_per_texel.is_finite()
            && halves.pixels_per_texel.is_finite()
            && halves.half0.is_finite();
        (all && near(middle.x) && near(middle.y) && half.into_iter().all(near)).then_some(halves)
    }

    /// Slope of the half vector.
    pub fn half(&self, t: Vec2<f64>) -> Vec2<f64> {
        self.half0 + self.half_per_texel * (t - self.t0)
    }

    /// Where in the image, in pixels from the footprint's point.
    pub fn pixels(&self, t: Vec2<f64>) -> Vec2<f64> {
        self.pixels_per_texel * (t - self.t0)
    }

    /// Whether it is in the footprint.
    pub fn contains(&self, t: Vec2<f64>) -> bool {
        let off = self.pixels(t) - self.centre;
        off.x.abs() <= self.radius && off.y.abs() <= self.radius
    }

    /// The point of the footprint at these numbers of the unit square.
    pub fn at(&self, [u, v]: [f64; 2]) -> Vec2<f64> {
        let off = Vec2::new(2.0 * u - 1.0, 2.0 * v - 1.0) * self.radius;
        self.t0 + self.texels_per_pixel * (self.centre + off)
    }

    /// Its bounds in texel coordinates: middle, and half extents.
    pub fn bounds(&self) -> (Vec2<f64>, [f64; 2]) {
        let middle = self.t0 + self.texels_per_pixel * self.centre;
        let half = self
            .texels_per_pixel
            .rows
            .map(|[a, b]| (a.abs() + b.abs()) * self.radius);
        (middle, half)
    }

    /// Whether a rectangle in texel coordinates meets the footprint in the image; with the same for bounds in texel
    /// coordinates, it meets the footprint.
    pub fn meets(&self, middle: Vec2<f64>, half: [f64; 2]) -> bool {
        let off = self.pixels(middle) - self.centre;
        let reach = self
            .pixels_per_texel
            .rows
            .map(|[a, b]| a.abs() * half[0] + b.abs() * half[1]);
        off.x.abs() <= self.radius + reach[0] && off.y.abs() <= self.radius + reach[1]
    }
}

/// The vectors of a reflection at a solution, local frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reflection {
    pub wo: Vec3<f64>,
    pub wi: Vec3<f64>,
    /// Area of slopes of half vectors per solid angle of `wi`.
    pub slopes_per_angle: f64,
}

impl Footprint {
    /// That of the sample at `at` of the image, `u` on the lens, of the pixel whose filter has its middle at `pixel`;
    /// `hidden`: whether the camera looks through lamps. `None` where the ray meets nothing.
    pub fn new(
        scene: &Scene,
        at: [f64; 2],
        u: [f64; 2],
        pixel: [f64; 2],
        hidden: bool,
    ) -> Option<Self> {
        let ray = scene.camera.ray_differential(at, u);
        let primal = Ray::<f64>::new(ray.o.map(|x| x.re), ray.d.map(|x| x.re));
        let hit = scene.seen(&primal, hidden)?;
        let found: Intersection<PerPixel> = scene.interaction(&Theta::still(), &ray, &hit);
        let filter = scene.film.filter;
        Some(Self {
            shape: found.shape,
            prim: found.prim,
            si: found.si,
            centre: [pixel[0] - at[0], pixel[1] - at[1]],
            filter,
            part: Part {
                middle: [0.0; 2],
                half: filter.radius(),
                share: 1.0,
                by_filter: 1.0,
            },
            wo: found.si.frame.to_local(-ray.d),
        })
    }

    /// The same, where a part of the pixel alone is searched.
    #[must_use]
    pub fn within(self, part: Part) -> Self {
        Self { part, ..self }
    }

    /// Slope of the half vector towards a target, from the front; `None` if view and target are on different sides.
    fn half(&self, target: &Target, behind: bool) -> Option<Vec2<PerPixel>> {
        let wi = match *target {
            Target::Point(at) => (at.map(Dual::constant) - self.si.p).normalize(),
            Target::Direction(d) => d.map(Dual::constant),
        };
        let [wo, wi] = [self.wo, self.si.frame.to_local(wi)].map(|w| turned(w, behind));
        if !(wo.z.re > 0.0 && wi.z.re > 0.0) {
            return None;
        }
        let h = wo + wi;
        Some(Vec2::new(-(h.x / h.z), -(h.y / h.z)))
    }

    /// Whether the surface is seen from behind.
    pub(super) fn behind(&self) -> bool {
        self.wo.z.re < 0.0
    }

    /// To the viewer, local frame.
    pub fn wo(&self) -> Vec3<f64> {
        self.wo.map(|x| x.re)
    }

    /// Texels per pixel, as columns.
    pub fn texels_per_pixel(&self, map: &SlopeMap) -> Mat2<f64> {
        let uv = [self.si.uv.x, self.si.uv.y].map(|x| x.eps);
        map.texels_per_uv() * Mat2::from_rows(uv)
    }

    /// The half vector to a target. `None` on different sides, and where texture coordinates are none: at poles.
    /// `behind`: seen from the back of something with two sides.
    pub(super) fn half_vectors(
        &self,
        map: &SlopeMap,
        target: &Target,
        behind: bool,
    ) -> Option<HalfVectors> {
        let half = self.half(target, behind)?;
        let t0 = map.texels(self.si.uv.map(|x| x.re));
        let texels_per_pixel = self.texels_per_pixel(map);
        let half_per_pixel = Mat2::from_rows([half.x.eps, half.y.eps]);
        HalfVectors::of(
            t0,
            half.map(|x| x.re),
            half_per_pixel,
            texels_per_pixel,
            Vec2::from(self.centre) + Vec2::from(self.part.middle),
            self.part.half,
        )
    }

    /// The reflection at the point that is `off` pixels away, where the normal has this slope. `None` if that turns from the
    /// viewer, or light into the surface.
    pub(super) fn reflection(
        &self,
        off: Vec2<f64>,
        slope: Vec2<f64>,
        behind: bool,
    ) -> Option<Reflection> {
        let wo = (self.wo.map(|w| w.re + w.eps[0] * off.x + w.eps[1] * off.y)).normalize();
        let wo = turned(wo, behind);
        let n = Vec3::new(-slope.x, -slope.y, 1.0).normalize();
        let cos = wo.dot(n);
        let wi = n * (2.0 * cos) - wo;
        let slopes_per_angle = (4.0 * cos * n.z.powi(3)).recip();
        let valid = cos > 0.0 && wo.z > 0.0 && wi.z > 0.0 && slopes_per_angle.is_finite();
        valid.then(|| Reflection {
            wo: turned(wo, behind),
            wi: turned(wi, behind),
            slopes_per_angle,
        })
    }
}

/// Mirrored at the surface, if it is seen from behind.
fn turned<R: ad_core::Real>(w: Vec3<R>, behind: bool) -> Vec3<R> {
    if behind { Vec3::new(w.x, w.y, -w.z) } else { w }
}
