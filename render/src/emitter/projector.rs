//! Lights at a point that throw an image: projectors, and spot lights with a slide.

use std::f64::consts::PI;

use ad_core::{Float, Real, Vec2, Vec3};

use super::point::{moving, towards};
use super::{
    Ball, Border, Cone, Connection, Emission, EmittedRay, Emitter, EmitterSample, INSIDE_BORDER,
    Lights, Rays, Spot, around, scale_of,
};
use crate::error::SceneError;
use crate::math::{Ray, Transform};
use crate::params::{ParamRef, Theta};
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{Exit, SurfaceInteraction, lift3};
use crate::texture::{self, RgbTexture};

/// Where a direction from a point meets the image plane in front of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plane {
    /// Right, up and forward, world space, orthonormal.
    axes: [[f32; 3]; 3],
    /// Half width and height of the image at unit distance; negative where the image is turned over.
    half: [f64; 2],
}

impl Plane {
    /// `None` if the axes are not orthonormal.
    fn new(to_world: &Transform, half: [f64; 2]) -> Option<Self> {
        let column = |j: usize| Vec3::from([0, 1, 2].map(|i: usize| to_world.linear[i][j]));
        let axes = [0, 1, 2].map(column);
        let close = |x: f64, to: f64| (x - to).abs() < 1e-3;
        let orthonormal = (0..3)
            .all(|i| close(axes[i].length(), 1.0) && close(axes[i].dot(axes[(i + 1) % 3]), 0.0));
        orthonormal.then(|| Self {
            axes: axes.map(|a| a.normalize().to_array().map(|x| x as f32)),
            half,
        })
    }

    /// Texture coordinates where a unit direction away from the point meets the plane, and its cosine to the axis.
    /// `None` behind the point.
    #[inline]
    fn meet<R: Real>(&self, d: Vec3<R>) -> Option<(Vec2<R>, R)> {
        let (uv, cos, ahead) = self.meet_in_line(d);
        ahead.then_some((uv, cos))
    }

    /// [`Plane::meet`], and whether the plane is met at all: without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn meet_in_line<R: Real>(&self, d: Vec3<R>) -> (Vec2<R>, R, bool) {
        let [right, up, forward] = &self.axes;
        let (x, y) = (lift3::<R>(*right).dot(d), lift3::<R>(*up).dot(d));
        let z = lift3::<R>(*forward).dot(d);
        let place = |x: R, half: f64| x / z * R::c(0.5 / half) + R::c(0.5);
        let uv = Vec2::new(place(x, self.half[0]), place(y, self.half[1]));
        (uv, z, z.primal() > R::Primal::of(1e-6))
    }

    /// [`Projector::profile`] in this plane, and whether the image is met: without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn profile_in_line<R: Real>(&self, d: Vec3<R>) -> (Emission<R>, bool) {
        let (uv, cos, ahead) = self.meet_in_line(d);
        let falloff = (cos * cos * cos).recip() * R::c(PI);
        (Emission { uv, falloff }, ahead & inside(uv))
    }

    /// The unit direction to a place of the image, and its cosine to the axis.
    #[inline]
    fn towards<P: Float>(&self, u: [P; 2]) -> (Vec3<P>, P) {
        let at = |u: P, half: f64| (u + u - P::one()) * P::of(half);
        let [right, up, forward] = self.axes.map(lift3::<P>);
        let d = right * at(u[0], self.half[0]) + up * at(u[1], self.half[1]) + forward;
        let length = d.length();
        (d * length.recip(), length.recip())
    }

    /// The middle of the image at unit distance and its corners, from the point.
    fn corners(&self) -> (Vec3<f64>, [Vec3<f64>; 4]) {
        let [right, up, forward] = self.axes.map(lift3::<f64>);
        let [x, y] = [right * self.half[0], up * self.half[1]];
        let corners = [x + y, y - x, -(x + y), x - y];
        (forward, corners.map(|corner| forward + corner))
    }

    /// Area of the image at unit distance.
    fn area(&self) -> f64 {
        4.0 * (self.half[0] * self.half[1]).abs()
    }
}

/// Whether a place is on the image.
#[inline(always)]
fn inside<R: Real>(uv: Vec2<R>) -> bool {
    let (x, y) = (uv.x.primal(), uv.y.primal());
    let (zero, one) = (R::Primal::zero(), R::Primal::one());
    (x >= zero) & (x <= one) & (y >= zero) & (y <= one)
}

/// The reverse of a pinhole camera: light from a point that makes a constant image a constant irradiance on planes
/// across its axis, of `pi scale` times the texture at unit distance, as in Mitsuba 3.
#[derive(Clone, Debug)]
pub struct Projector {
    /// The image, W m^-2.
    pub irradiance: RgbTexture,
    /// World space.
    position: [f32; 3],
    plane: Plane,
    scale: ParamRef,
}

impl Projector {
    /// Where light leaves in the unit direction `d`, and its intensity over that of the texture. `None` beside the image.
    #[inline]
    fn profile<R: Real>(&self, d: Vec3<R>) -> Option<Emission<R>> {
        let (emission, is_met) = self.plane.profile_in_line(d);
        is_met.then_some(emission)
    }

    /// Where it is, world space, and its image.
    pub(crate) fn lens(&self) -> ([f32; 3], Plane) {
        (self.position, self.plane)
    }

    /// Density of a direction whose cosine to the axis is `cos`: uniform over the image.
    #[inline]
    fn pdf_direction<P: Float>(&self, cos: P) -> P {
        (cos * cos * cos * P::of(self.plane.area())).recip()
    }
}

impl Emitter for Projector {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.irradiance
    }

    #[inline]
    fn scale(&self) -> Option<ParamRef> {
        Some(self.scale)
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, _: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        None
    }

    #[inline]
    fn sample<P: Float>(&self, _: Lights, from: Vec3<P>, _: [P; 2]) -> Option<EmitterSample<P>> {
        let (d, distance, inverse_square) = towards(self.position, from)?;
        let Emission { uv, falloff } = self.profile(-d)?;
        let falloff = falloff * inverse_square;
        (falloff > P::zero() && falloff <= P::MAX).then_some(EmitterSample::without_surface(
            d,
            distance,
            P::one(),
            Emission { uv, falloff },
        ))
    }

    /// Uniform over the image.
    fn sample_ray<P: Float>(
        &self,
        _theta: &Theta<P>,
        _: Lights,
        _: Option<Ball>,
        [_, _, u2, u3]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let (d, cos) = self.plane.towards([u2, u3]);
        let (emission, pdf_direction) = self.leaves(d, None)?;
        (cos > P::zero()).then_some(EmittedRay {
            ray: Ray::new(lift3(self.position), d),
            surface: None,
            exit: Exit::default(),
            pdf_position: P::one(),
            pdf_direction,
            emission,
        })
    }

    fn leaves<P: Float>(
        &self,
        d: Vec3<P>,
        _: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        let (_, cos) = self.plane.meet(d)?;
        Some((self.profile(d)?, self.pdf_direction(cos)))
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        let seen = moving(self.position, sample, from, |d| {
            self.profile(d).map_or(R::zero(), |e| e.falloff)
        });
        along(&self.plane, seen)
    }

    fn rays(&self, _: Lights) -> Option<Rays> {
        Some(Rays::From(self.position))
    }

    fn border<P: Float>(&self, _: Lights, u: f64) -> Option<Border<P>> {
        let (middle, corners) = self.plane.corners();
        let [p, tangent] = around(corners, u);
        let plane = p.cross(tangent);
        let inside = plane * plane.dot(middle).signum();
        let d = p + (middle - p) * INSIDE_BORDER;
        let ray = Ray::new(lift3(self.position), d.map(P::of).normalize());
        Some(Border {
            ray,
            inside: inside.normalize(),
            length: plane.length() / p.length_squared(),
            emission: self.profile(ray.d)?,
        })
    }

    fn is_delta(&self) -> bool {
        true
    }
}

/// The same connection where the image is met: texture coordinates follow the direction.
#[inline]
fn along<R: Real>(plane: &Plane, mut seen: Connection<R>) -> Connection<R> {
    if let Some((uv, _)) = plane.meet(-seen.d) {
        seen.emission.uv = uv;
    }
    seen
}

impl FromNode for Projector {
    const PLUGINS: &'static [&'static str] = &["projector"];

    /// `irradiance` (1), `scale` (1), `fov` or `focal_length`, `fov_axis`, `to_world`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let irradiance =
            registry.rgb_texture(node, "irradiance", [1.0; 3], (0.0, f64::INFINITY))?;
        let scale = scale_of(node, registry)?;
        let [w, h] = match &irradiance {
            RgbTexture::Bitmap(b) => [b.width, b.height].map(f64::from),
            _ => [1.0; 2],
        };
        let (fov, axis) = node.field_of_view()?;
        let half_x = (axis.half_width(fov, [w, h]))
            .ok_or_else(|| node.invalid("fov", "an angle in (0, 180) degrees"))?;
        let to_world = node.transform("to_world")?.unwrap_or_default();
        // As of a camera, x points left in the image, and its first row is at the top.
        let plane = Plane::new(&to_world, [-half_x, -half_x * h / w]).ok_or_else(|| {
            node.invalid(
                "to_world",
                "a transform that turns and moves, but does not scale",
            )
        })?;
        Ok(Self {
            irradiance,
            position: to_world.translation.map(|x| x as f32),
            plane,
            scale,
        })
    }
}

/// A spot light with an image in its cone, which meets the square around it: the intensity times the texture.
#[derive(Clone, Debug)]
pub struct Slide {
    spot: Spot,
    plane: Plane,
}

impl Slide {
    /// Where it is, world space, where it shines, and its image.
    pub(crate) fn lens(&self) -> ([f32; 3], Cone, Plane) {
        let (position, cone) = self.spot.cone();
        (position, cone, self.plane)
    }

    /// The same where the image is met.
    #[inline]
    fn at<P: Float>(&self, d: Vec3<P>, mut emission: Emission<P>) -> Option<Emission<P>> {
        (emission.uv, _) = self.plane.meet(d)?;
        Some(emission)
    }
}

impl Emitter for Slide {
    #[inline]
    fn radiance(&self) -> &RgbTexture {
        &self.spot.intensity
    }

    #[inline]
    fn hit<R: Real>(&self, _: Vec3<R>, _: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        None
    }

    #[inline]
    fn sample<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        u: [P; 2],
    ) -> Option<EmitterSample<P>> {
        let sample = self.spot.sample(lights, from, u)?;
        let emission = self.at(-sample.d, sample.emission)?;
        Some(EmitterSample { emission, ..sample })
    }

    fn sample_ray<P: Float>(
        &self,
        theta: &Theta<P>,
        lights: Lights,
        ball: Option<Ball>,
        u: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let start = self.spot.sample_ray(theta, lights, ball, u)?;
        let emission = self.at(start.ray.d, start.emission)?;
        Some(EmittedRay { emission, ..start })
    }

    fn leaves<P: Float>(
        &self,
        d: Vec3<P>,
        si: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        let (emission, pdf) = self.spot.leaves(d, si)?;
        Some((self.at(d, emission)?, pdf))
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        along(&self.plane, self.spot.connect(sample, from))
    }

    fn rays(&self, lights: Lights) -> Option<Rays> {
        self.spot.rays(lights)
    }

    fn is_delta(&self) -> bool {
        true
    }
}

impl FromNode for Slide {
    const PLUGINS: &'static [&'static str] = &["spot"];

    fn takes(node: &Node) -> bool {
        node.plugin == "spot" && node.child("texture").is_some()
    }

    /// As a spot light. Its parameter is the product of `intensity` and `texture`.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let to_world = node.transform("to_world")?.unwrap_or_default();
        let cutoff = node.float_or("cutoff_angle", 20.0)?;
        if !(cutoff > 0.0 && cutoff < 90.0) {
            let expected = "a number of degrees in (0, 90), beside a texture";
            return Err(node.invalid("cutoff_angle", expected));
        }
        let beam = node.float_or("beam_width", 0.75 * cutoff)?;
        if !(0.0..=cutoff).contains(&beam) {
            return Err(node.invalid("beam_width", "a number of degrees in [0, cutoff_angle]"));
        }
        let turned = || {
            let expected = "a transform that turns and moves, but does not scale";
            node.invalid("to_world", expected)
        };
        let half = cutoff.to_radians().tan();
        let plane = Plane::new(&to_world, [half; 2]).ok_or_else(turned)?;
        let colour = node.rgb_or("intensity", [1.0; 3])?;
        if colour.iter().any(|&x| x < 0.0) {
            return Err(node.invalid("intensity", "a colour without negative channels"));
        }
        let name = format!("{}.intensity", registry.prefix());
        let usage = texture::Use {
            name: &name,
            valid: (0.0, f64::INFINITY),
            substitute: &[0.5; 3],
        };
        let slide = node.child("texture");
        let slide = slide.ok_or_else(|| node.missing("texture", "an image"))?;
        let intensity = texture::times(registry, slide, &usage, colour)?;
        let axis = to_world.vector([0.0, 0.0, 1.0]);
        let spot = Spot::new(intensity, to_world.translation, axis, beam, cutoff);
        Ok(Self {
            spot: spot.ok_or_else(turned)?,
            plane,
        })
    }
}
