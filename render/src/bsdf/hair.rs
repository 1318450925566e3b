//! Hair and fur: fibres whose inside is not rendered.

use std::f64::consts::{PI, TAU};

use ad_core::{Const, Float, Real, Vec3};

use super::dielectric::{relative_index, wrong_index};
use super::nesting::choose;
use super::{
    BsdfSample, Component, Leaf, Lobe, Reader, Scattered, TransportMode, constant, fresnel,
};
use crate::error::SceneError;
use crate::math::bessel::i0_scaled;
use crate::math::{Rgb, warp};
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::{RgbTexture, ScalarTexture};

/// The surface of a fibre, a cylinder of glass with scales outside and pigments inside, as one event: light that is reflected
/// (R), that crosses the fibre (TT), that is reflected inside once (TRT), and all the rest, leaves where it came in. It is
/// meant for curves; the fibre runs along the y axis of the shading frame, that is dp/dv of what is orthogonal.
#[derive(Clone, Debug)]
pub struct Hair {
    /// How much light the inside takes.
    pub absorption: Absorption,
    /// Roughness along the fibre, in [0.01, 1].
    pub longitudinal_roughness: ScalarTexture,
    /// Roughness around the fibre, in [0.01, 1].
    pub azimuthal_roughness: ScalarTexture,
    /// Angle by which scales stand off the surface, towards the tip, in degrees from -90 to 90.
    pub scale_tilt: ScalarTexture,
    /// Index of refraction inside over that outside, from 1.001.
    pub eta: ScalarTexture,
}

/// What takes light inside of a fibre.
#[derive(Clone, Debug)]
pub enum Absorption {
    /// Concentrations of eumelanin, brown and black, and of pheomelanin, yellow and red: not negative.
    Pigments([ScalarTexture; 2]),
    /// A coefficient, and a factor on it, neither negative.
    Coefficient {
        /// Per radius of the fibre.
        sigma_a: RgbTexture,
        /// A factor.
        scale: ScalarTexture,
    },
}

/// What the unit of each pigment absorbs, per radius of the fibre [d'Eon et al. 2011].
const MELANINS: [[f64; 3]; 2] = [[0.419, 0.697, 1.37], [0.187, 0.4, 1.05]];

/// Orders that have lobes of their own: R, TT and TRT. The rest is one more.
const LOBES: usize = 3;
/// All orders.
const ORDERS: usize = LOBES + 1;

/// Each order is sampled about this often: its share may have a derivative where it has no size (errata F7).
const LEAST_SHARE: f64 = 0.01;

/// Light that has gone so many times the mean way is gone, in any precision.
const BLACK: f64 = 1e3;

/// Valid roughness: below, a lobe is narrower than directions in single precision resolve.
const ROUGHNESS: (f64, f64) = (0.01, 1.0);
/// Valid relative indices.
const DENSER: (f64, f64) = (1.001, 10.0);

/// [`Hair`] at a point [Chiang et al. 2016]: for each order the attenuation of a smooth cylinder, which depends on the direction
/// of the viewer, times densities of the angle along [d'Eon et al. 2011] and around the fibre of the direction to the light.
/// Both are normalised, so that a viewer receives as much light as is not absorbed, however rough the fibre is: cosine
/// included, the integral over the sphere is the sum of the attenuations, one without absorption.
///
/// The offset from the axis, `h` of the papers, is that of the point where `wo` meets the surface. Seen from inside, where no
/// ray is that has met a curve, it is what these formulas give, as in Mitsuba 3.
///
/// # Does not handle
/// Reciprocity: the model has none. Particles have the same kernel with both directions exchanged, as they have to, whose
/// weight is not bounded where they graze the surface.
///
/// # Derivatives
/// In all parameters and both directions. The density around the fibre is continuous, and has a kink opposite to its peak.
#[derive(Clone, Copy, Debug)]
pub struct HairLobe<R> {
    /// Per radius.
    sigma_a: Rgb<R>,
    eta: R,
    along: [Along<R>; LOBES],
    around: Around<R>,
    /// Sine and cosine of the angle by which scales turn the lobes.
    tilts: [[R; 2]; LOBES],
}

/// A density of angles along the fibre.
#[derive(Clone, Copy, Debug)]
struct Along<R> {
    variance: R,
    norm: R,
}

/// A logistic density, trimmed to one turn around the fibre.
#[derive(Clone, Copy, Debug)]
struct Around<R> {
    scale: R,
    norm: R,
}

/// The side of the viewer.
#[derive(Clone, Copy, Debug)]
struct Seen<R> {
    /// Sine and cosine of the angle to the plane across the fibre.
    theta: [R; 2],
    /// Angle to the normal, in that plane.
    gamma: R,
    /// The same inside.
    inside: R,
    /// How much light each order has.
    attenuation: [Rgb<R>; ORDERS],
}

/// Sine and cosine of the angle to the plane across the fibre.
#[inline]
fn theta<R: Real>(w: Vec3<R>) -> [R; 2] {
    [w.y, (w.x.square() + w.z.square()).sqrt()]
}

/// Angle to the normal in the plane across the fibre.
#[inline]
fn gamma<R: Real>(w: Vec3<R>) -> R {
    (-w.x).atan2(w.z)
}

impl<R: Real> Along<R> {
    #[inline]
    fn new(variance: R) -> Self {
        let whole = -(variance.div_into(R::c(-2.0))).exp_m1();
        Self {
            variance,
            norm: (variance * whole).recip(),
        }
    }

    /// [d'Eon et al. 2011], per solid angle and turn. Nothing overflows or cancels in this form: the exponents of
    /// `exp(-b/v) I_0(a/v)` are a distance between both directions, and what the function of Bessel is scaled by.
    #[inline]
    fn density(&self, seen: [R; 2], wi: [R; 2]) -> R {
        let off = (seen[1] - wi[1]).square() + (seen[0] + wi[0]).square();
        let narrow = (off * R::c(-0.5) / self.variance).exp();
        i0_scaled(seen[1] * wi[1] / self.variance) * narrow * self.norm
    }

    /// Sine and cosine of an angle with that density [d'Eon et al. 2013].
    #[inline]
    fn sample(&self, [sin, cos]: [R; 2], u: [R::Primal; 2]) -> [R; 2] {
        let least = R::Primal::EPSILON * R::Primal::of(0.5);
        let (u0, one) = (u[0].max(least), R::Primal::one());
        let far = self.variance.div_into(R::c(-2.0)).exp();
        // One minus the cosine to the direction that a smooth fibre has.
        let down = -(far * Const(one - u0) + Const(u0)).ln() * self.variance;
        let up = -down + R::c(1.0);
        let out = (down * (-down + R::c(2.0))).max(R::zero()).sqrt();
        let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
        let (side, across) = (out * Const(sin_phi), out * Const(cos_phi));
        let plane = (up * cos + across * sin).square() + side.square();
        [across * cos - up * sin, plane.sqrt()]
    }
}

impl<R: Real> Around<R> {
    #[inline]
    fn new(scale: R) -> Self {
        let end = scale.div_into(R::c(-PI));
        Self {
            scale,
            norm: (end.exp() + R::c(1.0)) / (-end.exp_m1() * scale),
        }
    }

    /// Per angle, of one between minus and plus pi.
    #[inline]
    fn density(&self, x: R) -> R {
        let tail = (-x.abs() / self.scale).exp();
        tail * self.norm / (tail + R::c(1.0)).square()
    }

    #[inline]
    fn sample(&self, u: R::Primal) -> R {
        let (one, least) = (R::Primal::one(), R::Primal::EPSILON * R::Primal::of(0.5));
        let u = u.max(least).min(one - least);
        let end = self.scale.div_into(R::c(-PI)).exp();
        let below = end * Const(one - u) + Const(u);
        let above = end * Const(u) + Const(one - u);
        (below.ln() - above.ln()) * self.scale
    }
}

impl<R: Real> HairLobe<R> {
    /// Of evaluated parameters, those of [`Hair`].
    fn new(sigma_a: Rgb<R>, [longitudinal, azimuthal]: [R; 2], scale_tilt: R, eta: R) -> Self {
        // The fits of [Chiang et al. 2016].
        let b = longitudinal;
        let deviation = b * R::c(0.726) + b.square() * R::c(0.812) + b.powi(20) * R::c(3.7);
        let variance = deviation.square();
        let b = azimuthal;
        let scale = b * R::c(0.265) + b.square() * R::c(1.194) + b.powi(22) * R::c(5.372);
        let alpha = scale_tilt * R::c(PI / 180.0);
        let tilt = |turns: f64| {
            let (sin, cos) = (alpha * R::c(turns)).sin_cos();
            [sin, cos]
        };
        Self {
            sigma_a,
            eta,
            along: [
                Along::new(variance),
                Along::new(variance * R::c(0.25)),
                Along::new(variance * R::c(4.0)),
            ],
            around: Around::new(scale * R::c((PI / 8.0).sqrt())),
            tilts: [tilt(-2.0), tilt(1.0), tilt(4.0)],
        }
    }

    /// What there is to know of the direction of a viewer.
    fn seen(&self, wo: Vec3<R>) -> Seen<R> {
        // Index times cosine of what is refracted, in the plane along the fibre and the normal of that plane.
        let flat = (self.eta - R::c(1.0)) * (self.eta + R::c(1.0));
        let [sin, cos] = theta(wo);
        let square = flat + cos.square();
        let inside = -wo.x / square.sqrt();
        let down = (flat + wo.z.square()).sqrt();
        // The way through the cylinder, in its radius.
        let length = self.eta * down * R::c(2.0) / square;
        let fresnel = fresnel::dielectric(wo.z.abs(), self.eta);
        let (reflect, transmit) = (fresnel.reflect, fresnel.transmit);
        let mut attenuation = [Rgb::splat(reflect); ORDERS];
        // Behind some depth nothing is left, and what is infinite has no derivative.
        let depth = self.sigma_a.map(|a| -(a * length).min(R::of(BLACK)));
        let passes = depth.map(|x| x.exp());
        attenuation[1] = passes * transmit.square();
        attenuation[2] = attenuation[1] * passes * reflect;
        // What is left of light that goes around once more: `1 - passes reflect`, without cancellation.
        let left = depth.map(|x| transmit - x.exp_m1() * reflect);
        let rest = attenuation[2] * passes * reflect;
        let over = |rest: R, left: R| {
            let some = left.primal() > R::Primal::zero();
            R::select(some, rest / left, R::zero())
        };
        attenuation[LOBES] = Rgb::new(
            over(rest.r, left.r),
            over(rest.g, left.g),
            over(rest.b, left.b),
        );
        Seen {
            theta: [sin, cos],
            gamma: gamma(wo),
            inside: inside.asin(),
            attenuation,
        }
    }

    /// As seen by an order whose scales are tilted.
    #[inline]
    fn tilted(&self, order: usize, [sin, cos]: [R; 2]) -> [R; 2] {
        match self.tilts.get(order) {
            Some(&[s, c]) => [sin * c + cos * s, (cos * c - sin * s).abs()],
            None => [sin, cos],
        }
    }

    #[inline]
    fn along(&self, order: usize) -> &Along<R> {
        &self.along[order.min(LOBES - 1)]
    }

    /// Densities of a direction in each order.
    fn densities(&self, seen: &Seen<R>, wi: Vec3<R>) -> [R; ORDERS] {
        let (toward, turned) = (theta(wi), gamma(wi) + seen.gamma);
        ad_core::array(|p| {
            let along = (self.along(p)).density(self.tilted(p, seen.theta), toward);
            if p == LOBES {
                return along * R::c(TAU.recip());
            }
            let off = turned - seen.smooth(p) + R::c(PI);
            along * self.around.density(off.rem_euclid(R::c(TAU)) - R::c(PI))
        })
    }

    /// A direction of that order; `u` and `u_along` are used up.
    fn direction(
        &self,
        seen: &Seen<R>,
        order: usize,
        u: R::Primal,
        u_along: [R::Primal; 2],
    ) -> Vec3<R> {
        let [sin, cos] = (self.along(order)).sample(self.tilted(order, seen.theta), u_along);
        let turned = if order == LOBES {
            R::lift(u * R::Primal::of(TAU))
        } else {
            self.around.sample(u) + seen.smooth(order)
        };
        let (sin_gamma, cos_gamma) = (turned - seen.gamma).sin_cos();
        Vec3::new(-cos * sin_gamma, sin, cos * cos_gamma)
    }

    /// What a viewer along `wo` sees of light from `wi`, cosine included.
    fn radiance(&self, seen: &Seen<R>, densities: &[R; ORDERS]) -> Rgb<R> {
        let all = seen.attenuation.iter().zip(densities);
        all.fold(Rgb::black(), |sum, (a, d)| sum + *a * *d)
    }

    /// What particles that come from `wo` have along `wi`: the same, exchanged.
    fn importance(&self, wo: Vec3<R>, wi: Vec3<R>) -> Rgb<R> {
        // No particle comes along the surface.
        if wo.z.primal().abs() <= R::Primal::EPSILON {
            return Rgb::black();
        }
        let seen = self.seen(wi);
        let value = self.radiance(&seen, &self.densities(&seen, wo));
        value * (wi.z / wo.z).abs()
    }
}

impl<R: Real> Seen<R> {
    /// Sum of the angles to the normal of both directions, where the fibre is smooth around.
    #[inline]
    fn smooth(&self, order: usize) -> R {
        let p = order as f64;
        self.inside * R::c(2.0 * p) + R::c(p * PI)
    }

    /// Probability of sampling each order.
    fn shares(&self) -> [R; ORDERS] {
        let sizes = self.attenuation.each_ref().map(|a| a.luminance());
        let whole = sizes.into_iter().fold(R::zero(), |sum, x| sum + x);
        let unit = (whole * R::c(1.0 + LEAST_SHARE * ORDERS as f64)).recip();
        sizes.map(|x| (x + whole * R::c(LEAST_SHARE)) * unit)
    }
}

/// Particles go evenly to both sides that often, as [`warp::square_to_cosine_hemisphere`]: their kernel is that of another
/// direction than the one they come from.
const EVENLY: f64 = 0.5;

/// The density of samples, of which `sampled` is that of the orders.
#[inline]
fn mixture<R: Real>(sampled: R, wi: Vec3<R>, mode: TransportMode) -> R {
    match mode {
        TransportMode::Radiance => sampled,
        TransportMode::Importance => {
            let evenly = warp::cosine_hemisphere_pdf(wi.z.abs());
            sampled * R::c(1.0 - EVENLY) + evenly * R::c(0.5 * EVENLY)
        }
    }
}

/// The order that `u` chooses, and `u` stretched over [0, 1) again.
#[inline]
fn order_of<P: Float>(mut u: P, shares: &[P; ORDERS]) -> (usize, P) {
    let mut order = 0;
    while order < LOBES && u >= shares[order] {
        u -= shares[order];
        order += 1;
    }
    let below_one = P::one() - P::EPSILON;
    (order, (u / shares[order]).min(below_one))
}

impl<R: Real> Lobe<R> for HairLobe<R> {
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        match mode {
            TransportMode::Radiance => {
                let seen = self.seen(wo);
                self.radiance(&seen, &self.densities(&seen, wi))
            }
            TransportMode::Importance => self.importance(wo, wi),
        }
    }

    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> R {
        let seen = self.seen(wo);
        let sampled = sampled(&seen, &self.densities(&seen, wi));
        mixture(sampled, wi, mode)
    }

    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R) {
        let seen = self.seen(wo);
        let densities = self.densities(&seen, wi);
        let value = match mode {
            TransportMode::Radiance => self.radiance(&seen, &densities),
            TransportMode::Importance => self.importance(wo, wi),
        };
        (value, mixture(sampled(&seen, &densities), wi, mode))
    }

    /// Chooses an order by the (primal) luminance of its attenuation; particles also go evenly to both sides.
    fn sample(&self, wo: Vec3<R>, u: [R::Primal; 3], mode: TransportMode) -> Option<BsdfSample<R>> {
        self.sample_eval(wo, u, mode).map(|(sample, _)| sample)
    }

    fn sample_eval(
        &self,
        wo: Vec3<R>,
        u: [R::Primal; 3],
        mode: TransportMode,
    ) -> Option<Scattered<R, R>> {
        let share = match mode {
            TransportMode::Radiance => 0.0,
            TransportMode::Importance => EVENLY,
        };
        let (evenly, u0) = choose(u[0], R::Primal::of(share));
        let wi = if evenly {
            let w = warp::square_to_cosine_hemisphere([u[1], u[2]]);
            let below = u0 < R::Primal::of(0.5);
            Vec3::lift(Vec3::new(w.x, w.y, R::Primal::select(below, -w.z, w.z)))
        } else {
            let seen = self.seen(wo);
            let (order, u0) = order_of(u0, &seen.shares().map(Real::primal));
            self.direction(&seen, order, u[2], [u[1], u0])
        };
        let (f, pdf) = self.eval_pdf(wo, wi, mode);
        Some((BsdfSample::reflected(wi, pdf)?, f))
    }

    fn choice_pdf(
        &self,
        wo: Vec3<R>,
        wi: Vec3<R>,
        _component: Component,
        mode: TransportMode,
    ) -> R {
        let seen = self.seen(wo);
        let densities = self.densities(&seen, wi);
        let parts = seen.shares().into_iter().zip(densities);
        let sampled = parts.fold(R::zero(), |sum, (share, d)| sum + constant(d) * share);
        mixture(sampled, Vec3::lift(wi.primal()), mode)
    }
}

/// The density of samples of the orders, chosen by primal shares.
#[inline]
fn sampled<R: Real>(seen: &Seen<R>, densities: &[R; ORDERS]) -> R {
    let parts = seen.shares().into_iter().zip(densities);
    parts.fold(R::zero(), |sum, (share, d)| {
        sum + *d * Const(share.primal())
    })
}

impl Leaf for Hair {
    type Lobe<R: Real> = HairLobe<R>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> HairLobe<R> {
        let sigma_a = match &self.absorption {
            Absorption::Pigments(pigments) => {
                let each = pigments.iter().zip(MELANINS);
                each.fold(Rgb::black(), |sum, (amount, unit)| {
                    sum + Rgb::from(unit.map(R::of)) * read.scalar(amount)
                })
            }
            Absorption::Coefficient { sigma_a, scale } => read.rgb(sigma_a) * read.scalar(scale),
        };
        let roughness = [
            read.scalar(&self.longitudinal_roughness),
            read.scalar(&self.azimuthal_roughness),
        ];
        HairLobe::new(
            sigma_a,
            roughness,
            read.scalar(&self.scale_tilt),
            read.scalar(&self.eta),
        )
    }
}

impl FromNode for Hair {
    const PLUGINS: &'static [&'static str] = &["hair"];

    /// `eumelanin` (1.3) and `pheomelanin` (0.2), or `sigma_a` with `scale` (1); `longitudinal_roughness` and
    /// `azimuthal_roughness` (0.3), `scale_tilt` (2 degrees), `int_ior` (`amber`) and `ext_ior` (`air`), the latter less.
    ///
    /// Mitsuba 3 has textures in `sigma_a` only; here pigments and roughness may be textures as well.
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let eta = relative_index(node, "amber")?;
        if !(DENSER.0..=DENSER.1).contains(&eta) {
            let expected = "a fibre denser than what is around it, by at least 0.1 %";
            return Err(wrong_index(node, expected));
        }
        let name = format!("{}.eta.value", registry.prefix());
        let eta = registry.scalar(&name, eta, DENSER)?;
        eta.visit_params(&mut |p| registry.origins.of_index(node, p));
        let some = (0.0, f64::INFINITY);
        let absorption = if node.has("sigma_a") {
            for key in ["eumelanin", "pheomelanin"] {
                if node.has(key) {
                    return Err(node.invalid(key, "none beside `sigma_a`"));
                }
            }
            Absorption::Coefficient {
                sigma_a: registry.rgb_texture(node, "sigma_a", [0.0; 3], some)?,
                scale: registry.scalar_texture(node, "scale", 1.0, some)?,
            }
        } else {
            node.ignore(&["scale"], Node::float)?;
            Absorption::Pigments([
                registry.scalar_texture(node, "eumelanin", 1.3, some)?,
                registry.scalar_texture(node, "pheomelanin", 0.2, some)?,
            ])
        };
        let mut number = |key, default, valid| registry.scalar_texture(node, key, default, valid);
        Ok(Self {
            absorption,
            longitudinal_roughness: number("longitudinal_roughness", 0.3, ROUGHNESS)?,
            azimuthal_roughness: number("azimuthal_roughness", 0.3, ROUGHNESS)?,
            scale_tilt: number("scale_tilt", 2.0, (-90.0, 90.0))?,
            eta,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ad_core::Dual;
    use ad_core::check::central_difference;

    use crate::sampler::{Independent, Sampler};

    /// Absorption, scale, roughness along and around, tilt and index, and a direction.
    const INPUTS: usize = 10;
    const OF_DIRECTION: usize = 7;

    fn of<R: Real>(x: &[R; INPUTS]) -> (HairLobe<R>, Vec3<R>) {
        let lobe = HairLobe::new(Rgb::new(x[0], x[1], x[2]), [x[3], x[4]], x[5], x[6]);
        (lobe, Vec3::new(x[7], x[8], x[9]))
    }

    fn inputs(roughness: [f64; 2], wo: Vec3<f64>) -> [f64; INPUTS] {
        let [along, around] = roughness;
        [0.1, 0.3, 0.9, along, around, 3.0, 1.55, wo.x, wo.y, wo.z]
    }

    fn seeded<const N: usize>(x: &[f64; INPUTS], first: usize) -> [Dual<f64, N>; INPUTS] {
        let mut all = x.map(Dual::lift);
        for k in 0..N {
            all[first + k] = Dual::var(x[first + k], k);
        }
        all
    }

    /// By their own derivatives against central differences, at a fixed order (f64, 1e-6).
    #[test]
    fn samples_move_with_parameters_and_viewers() {
        for i in 0..40 {
            let mut random = Independent::new(3, 0, i);
            let [a, b]: [f64; 2] = random.next_2d();
            let u: [f64; 3] = random.next_3d();
            let wo = warp::square_to_sphere([0.05 + 0.9 * a, b]);
            let x = inputs([0.1 + 0.8 * u[0], 0.1 + 0.8 * u[1]], wo);
            for order in 0..ORDERS {
                let draw = |x: &[f64; INPUTS], axis: usize| {
                    let (lobe, wo) = of(x);
                    let w = lobe.direction(&lobe.seen(wo), order, u[2], [u[0], u[1]]);
                    w.to_array()[axis]
                };
                let (lobe, wo) = of(&seeded::<INPUTS>(&x, 0));
                let w = lobe.direction(&lobe.seen(wo), order, u[2], [u[0], u[1]]);
                assert!((w.primal().length() - 1.0).abs() < 1e-12);
                for (axis, found) in w.to_array().into_iter().enumerate() {
                    for k in 0..INPUTS {
                        let shifted = |value: f64| {
                            let mut x = x;
                            x[k] = value;
                            draw(&x, axis)
                        };
                        let fd = central_difference(shifted, x[k], 1e-3 * x[k].abs().max(0.02));
                        let off = (found.eps[k] - fd.value).abs();
                        let allowed = 1e-6 * fd.value.abs() + 10.0 * fd.error + 1e-9;
                        assert!(off < allowed, "{x:?} {order} {k}: {found:?} {fd:?}");
                    }
                }
            }
        }
    }

    /// What a viewer sees of smooth light, and its derivatives by attached samples of all orders, by a midpoint rule over their
    /// three numbers: against the integral over the sphere (5e-3, or 1.5e-3 where it is small).
    #[test]
    #[cfg_attr(debug_assertions, ignore = "many samples: runs with --release")]
    fn attached_samples_have_the_derivative_of_the_integral() {
        const N: i32 = 40;
        type D = Dual<f64, OF_DIRECTION>;
        let light =
            |w: Vec3<D>| w.z.square() * D::c(0.5) + w.x * D::c(0.3) + w.y * D::c(0.4) + D::c(1.0);
        let middle = |k: i32, n: i32| (f64::from(k) + 0.5) / f64::from(n);
        // Substituted, against the logarithmic ends.
        let ended = |k: i32| {
            let v = middle(k, N);
            (v * v * (3.0 - 2.0 * v), 6.0 * v * (1.0 - v))
        };
        for wo in [Vec3::new(0.36, 0.48, 0.8), Vec3::new(0.8, -0.36, 0.48)] {
            let (lobe, seen_from) = of(&seeded::<OF_DIRECTION>(&inputs([0.35, 0.4], wo), 0));
            let seen = lobe.seen(seen_from);
            let seen_from_there = |wi: Vec3<D>| {
                let (f, pdf) = lobe.eval_pdf(seen_from, wi, TransportMode::Radiance);
                (f.g * light(wi), pdf)
            };
            let mut expected = D::zero();
            let (rows, columns) = (300, 600);
            for k in 0..rows * columns {
                let [u, v] = [middle(k / columns, rows), middle(k % columns, columns)];
                // The pole is along the fibre, where the value is not one.
                let w = warp::square_to_sphere([u, v]);
                expected += seen_from_there(Vec3::lift(Vec3::new(w.x, w.z, w.y))).0;
            }
            expected = expected * D::c(4.0 * PI / f64::from(rows * columns));
            let mut found = D::zero();
            for (order, share) in seen.shares().into_iter().enumerate() {
                for k in 0..N * N * N {
                    let ((a, da), (b, db)) = (ended(k / N % N), ended(k % N));
                    let turn = middle(k / N / N, N);
                    let wi = lobe.direction(&seen, order, b, [a, turn]);
                    let (f, pdf) = seen_from_there(wi);
                    found += f / pdf * D::lift(share.re * da * db);
                }
            }
            found = found * D::c(f64::from(N).powi(-3));
            let close = |a: f64, b: f64| (a - b).abs() < 5e-3 * b.abs().max(0.3);
            assert!(close(found.re, expected.re), "{found:?} {expected:?}");
            for (a, b) in found.eps.into_iter().zip(expected.eps) {
                assert!(close(a, b), "{found:?} {expected:?}");
            }
        }
    }

    /// Values, densities and samples, with all derivatives, in single precision: along the fibre, across it, at grazing
    /// angles, without absorption and with any, for the least and the most roughness.
    #[test]
    fn everything_is_finite() {
        type D = Dual<f32, INPUTS>;
        let s = 0.5f64.sqrt();
        let special = [
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [s, s, 0.0],
            [0.0, s, s],
            [-s, 0.0, 1e-20],
            [1e-20, 1.0, -1e-20],
        ];
        let mut some = 0;
        for roughness in [0.01, 0.3, 1.0] {
            for (sigma, eta) in [
                (0.0, 1.001),
                (0.0, 1.55),
                (1e-20, 10.0),
                (1e3, 1.55),
                (3e38, 1.3),
            ] {
                for wo in special {
                    let mut x = inputs([roughness; 2], Vec3::from(wo));
                    x[0] = sigma;
                    x[5] = 90.0;
                    x[6] = eta;
                    let mut k = 0;
                    let x = x.map(|x| {
                        k += 1;
                        D::var(x as f32, k - 1)
                    });
                    let (lobe, wo) = of(&x);
                    for mode in [TransportMode::Radiance, TransportMode::Importance] {
                        for wi in special {
                            let wi = Vec3::from(wi.map(D::of));
                            let (f, pdf) = lobe.eval_pdf(wo, wi, mode);
                            assert!(f.is_finite() && pdf.is_finite(), "{lobe:?} {wo:?} {wi:?}");
                            assert!(f.to_array().iter().all(|c| c.re >= 0.0) && pdf.re >= 0.0);
                        }
                        for i in 0..40 {
                            let mut u: [f32; 3] = Independent::new(5, 0, i).next_3d();
                            if i < 8 {
                                u = [i & 1, i >> 1 & 1, i >> 2]
                                    .map(|k| k as f32 * (1.0 - f32::EPSILON));
                            }
                            let Some((s, f)) = lobe.sample_eval(wo, u, mode) else {
                                continue;
                            };
                            let whole = s.wi.to_array().into_iter().all(Real::is_finite);
                            assert!(
                                whole && s.pdf.is_finite() && f.is_finite(),
                                "{lobe:?} {wo:?} {u:?}"
                            );
                            some += 1;
                        }
                    }
                }
            }
        }
        assert!(some > 8000, "{some}");
    }

    /// All that is not absorbed leaves, in some order.
    #[test]
    fn orders_add_up() {
        for z in [1.0, 0.5, 0.1, 1e-3, 1e-6, 0.0] {
            let wo = Vec3::new((1.0f64 - z * z).sqrt() * 0.8, (1.0 - z * z).sqrt() * 0.6, z);
            let mut x = inputs([0.3; 2], wo);
            x[..3].fill(0.0);
            let (lobe, wo) = of(&x);
            let sum = (lobe.seen(wo).attenuation.iter()).fold(0.0, |sum, a| sum + a.g);
            assert!((sum - 1.0).abs() < 1e-12, "{z}: {sum}");
        }
    }
}
