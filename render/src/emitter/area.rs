//! Surfaces that emit.

use std::f64::consts::PI;

use ad_core::{Const, Float, Real, Vec2, Vec3};

use super::{Ball, Connection, Emission, EmittedRay, Emitter, EmitterSample, Lights};
use crate::error::SceneError;
use crate::math::{Frame, Ray, warp};
use crate::params::Theta;
use crate::plugin::{FromNode, Node, Registry};
use crate::shape::{DirectionSample, Shape, SurfaceInteraction};
use crate::texture::RgbTexture;

/// One-sided emission `radiance(uv) cos^exponent(theta)` from the outside of a shape. Exponent 0 is
/// Mitsuba's area light; larger ones are the directional lights of [Christensen et al. 1993].
#[derive(Clone, Debug)]
pub struct Area {
    /// Emitted radiance along the normal, W m^-2 sr^-1.
    pub radiance: RgbTexture,
    /// Sharpness of the lobe; 0 for a diffuse light.
    pub exponent: f32,
    /// Index of the shape.
    pub shape: u32,
}

/// `cos^exponent`, on the side that emits.
#[inline(always)]
fn lobe<R: Real>(exponent: f32, cos_theta: R) -> Option<R> {
    if cos_theta.primal() <= R::Primal::zero() {
        None
    } else if exponent == 0.0 {
        Some(R::one())
    } else {
        Some(cos_theta.powf(R::of(f64::from(exponent))))
    }
}

impl Area {
    #[inline(always)]
    fn lobe<R: Real>(&self, cos_theta: R) -> Option<R> {
        lobe(self.exponent, cos_theta)
    }

    /// What a light with a lobe of sharpness `exponent` sends along a direction that was sampled on its shape, and
    /// there on `surface`.
    #[inline(always)]
    pub(crate) fn facing<P: Float>(
        exponent: f32,
        surface: u32,
        s: DirectionSample<P>,
    ) -> Option<EmitterSample<P>> {
        let falloff = lobe(exponent, -s.n.dot(s.d))?;
        let emission = Emission { uv: s.uv, falloff };
        Some(EmitterSample {
            d: s.d,
            distance: s.distance,
            normals: [s.n, s.n_geo],
            surface,
            prim: s.prim,
            pdf: s.pdf,
            emission,
        })
    }

    /// [`Area::facing`] for a diffuse light, with density zero where nothing is seen: without branches, for loops over many.
    #[inline(always)]
    pub(crate) fn facing_in_line<P: Float>(
        surface: u32,
        (s, is_seen): (DirectionSample<P>, bool),
    ) -> EmitterSample<P> {
        let lit = is_seen & (-s.n.dot(s.d) > P::zero());
        EmitterSample {
            // At the light itself there is no direction.
            d: Vec3::select(lit, s.d, Vec3::zero()),
            distance: s.distance,
            normals: [s.n, s.n_geo],
            surface,
            prim: s.prim,
            pdf: P::select(lit, s.pdf, P::zero()),
            emission: Emission {
                uv: s.uv,
                falloff: P::one(),
            },
        }
    }

    /// Of the cosine in the density of directions, plus one.
    #[inline(always)]
    fn power<P: Float>(&self) -> P {
        P::of(f64::from(self.exponent) + 2.0)
    }

    /// Density of directions of particles: in proportion to the lobe times the cosine.
    #[inline(always)]
    fn pdf_direction<P: Float>(&self, cos: P) -> P {
        if self.exponent == 0.0 {
            return warp::cosine_hemisphere_pdf(cos);
        }
        let power = self.power::<P>();
        power * P::of(0.5 / PI) * cos.powf(power - P::one())
    }
}

impl Emitter for Area {
    #[inline(always)]
    fn radiance(&self) -> &RgbTexture {
        &self.radiance
    }

    #[inline(always)]
    fn hit<R: Real>(&self, d: Vec3<R>, si: Option<&SurfaceInteraction<R>>) -> Option<Emission<R>> {
        let si = si?;
        let falloff = self.lobe(-si.frame.n.dot(d))?;
        Some(Emission { uv: si.uv, falloff })
    }

    #[inline(always)]
    fn sample<P: Float>(
        &self,
        lights: Lights,
        from: Vec3<P>,
        u: [P; 2],
    ) -> Option<EmitterSample<P>> {
        let s = lights.shapes[self.shape as usize].sample(from, u)?;
        Self::facing(self.exponent, lights.surface(self.shape, s.prim), s)
    }

    /// Uniform over the area; directions in proportion to the lobe times the cosine, both to the
    /// shading normal.
    #[inline(always)]
    fn sample_ray<P: Float>(
        &self,
        theta: &Theta<P>,
        lights: Lights,
        _ball: Option<Ball>,
        [u0, u1, u2, u3]: [P; 4],
    ) -> Option<EmittedRay<P>> {
        let (s, n_geo) = lights.shapes[self.shape as usize].sample_surface(theta, [u0, u1]);
        let frame = Frame::from_normal(s.n);
        let local = if self.exponent == 0.0 {
            warp::square_to_cosine_hemisphere([u2, u3])
        } else {
            // 1 - u in (0, 1]: the cosine is never zero for lack of digits.
            let z = (P::one() - u2).powf(self.power::<P>().recip());
            let r = (P::one() - z * z).max(P::zero()).sqrt();
            let (sin, cos) = warp::sin_cos_of_turns(u3);
            Vec3::new(r * cos, r * sin, z)
        };
        let pdf_direction = self.pdf_direction(local.z);
        let d = frame.to_world(local);
        let falloff = self.lobe(local.z)?;
        if pdf_direction <= P::zero() {
            return None;
        }
        let si = SurfaceInteraction {
            p: s.p,
            t: P::zero(),
            n_geo,
            frame,
            uv: s.uv,
        };
        Some(EmittedRay {
            ray: Ray::new(s.p, d),
            surface: Some((self.shape, si)),
            exit: lights.prim(self.shape, s.prim).exit,
            pdf_position: s.pdf,
            pdf_direction,
            emission: Emission { uv: s.uv, falloff },
        })
    }

    fn leaves<P: Float>(
        &self,
        d: Vec3<P>,
        si: Option<&SurfaceInteraction<P>>,
    ) -> Option<(Emission<P>, P)> {
        let si = si?;
        let cos = si.frame.n.dot(d);
        let falloff = self.lobe(cos)?;
        Some((Emission { uv: si.uv, falloff }, self.pdf_direction(cos)))
    }

    #[inline(always)]
    fn pdf<R: Real>(
        &self,
        lights: Lights,
        from: Vec3<R>,
        _d: Vec3<R>,
        si: Option<&SurfaceInteraction<R>>,
    ) -> R {
        si.map_or(R::zero(), |si| {
            lights.shapes[self.shape as usize].pdf(from, si)
        })
    }

    fn connect<R: Real>(&self, sample: &EmitterSample<R::Primal>, from: Vec3<R>) -> Connection<R> {
        let at = from.primal() + sample.d * sample.distance;
        let to = Vec3::lift(at) - from;
        let d = to.normalize();
        let [n, n_geo] = sample.normals;
        let (n, n_geo) = (Vec3::<R>::lift(n), Vec3::lift(n_geo));
        // Constant density per area.
        let per_angle = to.length_squared() / n_geo.dot(d);
        Connection {
            d,
            pdf: per_angle * Const(sample.pdf / per_angle.primal()),
            emission: Emission {
                uv: Vec2::lift(sample.emission.uv),
                falloff: self.lobe(-n.dot(d)).unwrap_or(R::zero()),
            },
        }
    }
}

impl FromNode for Area {
    const PLUGINS: &'static [&'static str] = &["area"];

    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let shape = registry.current_shape(node)?;
        let exponent = node.float_or("exponent", 0.0)?;
        if !(0.0..=1e4).contains(&exponent) {
            return Err(node.invalid("exponent", "a number in [0, 10000]"));
        }
        let radiance = registry.rgb_texture(node, "radiance", [1.0; 3], (0.0, f64::INFINITY))?;
        Ok(Self {
            radiance,
            exponent: exponent as f32,
            shape,
        })
    }
}
