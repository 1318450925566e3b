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
use crate::math::gauss::{faded, fading, ln};
use crate::math::{Rgb, angle, warp};
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

/// Parameters of [`Hair`] at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fibre<R> {
    /// Per radius.
    pub sigma_a: Rgb<R>,
    /// Along the fibre and around it.
    pub roughness: [R; 2],
    /// In degrees.
    pub scale_tilt: R,
    pub eta: R,
}

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
    pub(crate) sigma_a: Rgb<R>,
    pub(crate) eta: R,
    pub(crate) along: [Along<R>; LOBES],
    pub(crate) around: Around<R>,
    /// Sine and cosine of the angle by which scales turn the lobes.
    pub(crate) tilts: [[R; 2]; LOBES],
}

/// A density of angles along the fibre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Along<R> {
    pub variance: R,
    pub norm: R,
}

/// A logistic density, trimmed to one turn around the fibre.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Around<R> {
    pub scale: R,
    pub norm: R,
}

/// The side of the viewer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen<R> {
    /// Sine and cosine of the angle to the plane across the fibre.
    pub theta: [R; 2],
    /// Angle to the normal, in that plane.
    pub gamma: R,
    /// The same inside.
    pub inside: R,
    /// How much light each order has.
    pub attenuation: [Rgb<R>; ORDERS],
}

/// How an order scatters.
#[derive(Clone, Copy)]
struct Order<R: Real> {
    /// Zero for R, and so on.
    number: R::Primal,
    along: Along<R>,
    tilt: [R; 2],
}

/// Sine and cosine of the angle to the plane across the fibre.
#[inline(always)]
fn theta<R: Real>(w: Vec3<R>) -> [R; 2] {
    [w.y, (w.x.square() + w.z.square()).sqrt()]
}

/// Angle to the normal in the plane across the fibre.
#[inline(always)]
fn gamma<R: Real>(w: Vec3<R>) -> R {
    angle::atan2(-w.x, w.z)
}

impl<R: Real> Along<R> {
    #[inline(always)]
    fn new(variance: R) -> Self {
        let whole = faded(variance.div_into(R::c(2.0)));
        Self {
            variance,
            norm: (variance * whole).recip(),
        }
    }

    /// [d'Eon et al. 2011], per solid angle and turn. Nothing overflows or cancels in this form: the exponents of
    /// `exp(-b/v) I_0(a/v)` are a distance between both directions, and what the function of Bessel is scaled by.
    #[inline(always)]
    fn density(&self, seen: [R; 2], wi: [R; 2]) -> R {
        let off = (seen[1] - wi[1]).square() + (seen[0] + wi[0]).square();
        let narrow = fading(off * R::c(0.5) / self.variance);
        i0_scaled(seen[1] * wi[1] / self.variance) * narrow * self.norm
    }

    /// Sine and cosine of an angle with that density [d'Eon et al. 2013].
    #[inline(always)]
    fn sample(&self, [sin, cos]: [R; 2], u: [R::Primal; 2]) -> [R; 2] {
        let least = R::Primal::EPSILON * R::Primal::of(0.5);
        let (u0, one) = (u[0].max(least), R::Primal::one());
        let far = fading(self.variance.div_into(R::c(2.0)));
        // One minus the cosine to the direction that a smooth fibre has.
        let down = -ln(far * Const(one - u0) + Const(u0)) * self.variance;
        let up = -down + R::c(1.0);
        let out = (down * (-down + R::c(2.0))).max(R::zero()).sqrt();
        let (sin_phi, cos_phi) = warp::sin_cos_of_turns(u[1]);
        let (side, across) = (out * Const(sin_phi), out * Const(cos_phi));
        let plane = (up * cos + across * sin).square() + side.square();
        [across * cos - up * sin, plane.sqrt()]
    }
}

impl<R: Real> Around<R> {
    #[inline(always)]
    fn new(scale: R) -> Self {
        let end = scale.div_into(R::c(PI));
        Self {
            scale,
            norm: (fading(end) + R::c(1.0)) / (faded(end) * scale),
        }
    }

    /// Per angle, of one between minus and plus pi.
    #[inline(always)]
    fn density(&self, x: R) -> R {
        let tail = fading(x.abs() / self.scale);
        tail * self.norm / (tail + R::c(1.0)).square()
    }

    #[inline(always)]
    fn sample(&self, u: R::Primal) -> R {
        let (one, least) = (R::Primal::one(), R::Primal::EPSILON * R::Primal::of(0.5));
        let u = u.max(least).min(one - least);
        let end = fading(self.scale.div_into(R::c(PI)));
        let below = end * Const(one - u) + Const(u);
        let above = end * Const(u) + Const(one - u);
        (ln(below) - ln(above)) * self.scale
    }
}

/// `x^20`.
#[inline(always)]
fn twentieth<R: Real>(x: R) -> R {
    let x4 = x.square().square();
    x4.square().square() * x4
}

impl<R: Real> HairLobe<R> {
    /// From evaluated parameters.
    fn new(fibre: &Fibre<R>) -> Self {
        Self::new_in_line(fibre)
    }

    /// [`HairLobe::new`] where loops over many go through it: without a branch, as all that is in line here.
    #[inline(always)]
    pub(crate) fn new_in_line(fibre: &Fibre<R>) -> Self {
        // The fits of [Chiang et al. 2016].
        let [b, c] = fibre.roughness;
        let deviation = b * R::c(0.726) + b.square() * R::c(0.812) + twentieth(b) * R::c(3.7);
        let variance = deviation.square();
        let (c2, c22) = (c.square(), twentieth(c) * c.square());
        let scale = c * R::c(0.265) + c2 * R::c(1.194) + c22 * R::c(5.372);
        let alpha = fibre.scale_tilt * R::c(PI / 180.0);
        // Functions, because closures that several places call are calls.
        Self {
            sigma_a: fibre.sigma_a,
            eta: fibre.eta,
            along: [
                Along::new(variance),
                Along::new(variance * R::c(0.25)),
                Along::new(variance * R::c(4.0)),
            ],
            around: Around::new(scale * R::c((PI / 8.0).sqrt())),
            tilts: [
                sine_and_cosine(alpha * R::c(-2.0)),
                sine_and_cosine(alpha),
                sine_and_cosine(alpha * R::c(4.0)),
            ],
        }
    }

    /// What there is to know of the direction of a viewer.
    fn seen(&self, wo: Vec3<R>) -> Seen<R> {
        self.seen_in_line(wo)
    }

    #[inline(always)]
    pub(crate) fn seen_in_line(&self, wo: Vec3<R>) -> Seen<R> {
        // Index times cosine of what is refracted, in the plane along the fibre and the normal of that plane.
        let flat = (self.eta - R::c(1.0)) * (self.eta + R::c(1.0));
        let [sin, cos] = theta(wo);
        let square = flat + cos.square();
        let down = (flat + wo.z.square()).sqrt();
        // The way through the cylinder, in its radius.
        let length = self.eta * down * R::c(2.0) / square;
        let fresnel = fresnel::dielectric(wo.z.abs(), self.eta);
        let (reflect, transmit) = (fresnel.reflect, fresnel.transmit);
        // Behind some depth nothing is left, and what is infinite has no derivative.
        let depth = self.sigma_a.map(|a| (a * length).min(R::of(BLACK)));
        let passes = Rgb::new(fading(depth.r), fading(depth.g), fading(depth.b));
        let stays = Rgb::new(faded(depth.r), faded(depth.g), faded(depth.b));
        let mut attenuation = [Rgb::splat(reflect); ORDERS];
        attenuation[1] = passes * transmit.square();
        attenuation[2] = attenuation[1] * passes * reflect;
        // What is left of light that goes around once more: `1 - passes reflect`, without cancellation.
        let left = stays * reflect + Rgb::splat(transmit);
        let rest = attenuation[2] * passes * reflect;
        attenuation[LOBES] = Rgb::new(
            over(rest.r, left.r),
            over(rest.g, left.g),
            over(rest.b, left.b),
        );
        Seen {
            theta: [sin, cos],
            gamma: gamma(wo),
            inside: angle::atan2(-wo.x, down),
            attenuation,
        }
    }

    #[inline(always)]
    fn order(&self, number: usize) -> Order<R> {
        let tilt = match self.tilts.get(number) {
            Some(&tilt) => tilt,
            None => [R::zero(), R::one()],
        };
        Order {
            number: R::Primal::of(number as f64),
            along: self.along[number.min(LOBES - 1)],
            tilt,
        }
    }

    /// Density of a direction in an order: `toward` is its [`theta`], `turned` the angle to the normal of both directions.
    #[inline(always)]
    fn density(&self, order: &Order<R>, seen: &Seen<R>, toward: [R; 2], turned: R) -> R {
        let along = order.along.density(order.tilted(seen.theta), toward);
        let off = angle::in_one_turn(turned - seen.smooth(order));
        let around = R::select(
            order.is_rest(),
            R::of(TAU.recip()),
            self.around.density(off),
        );
        along * around
    }

    /// Densities of a direction in each order.
    fn densities(&self, seen: &Seen<R>, wi: Vec3<R>) -> [R; ORDERS] {
        self.densities_in_line(seen, wi)
    }

    #[inline(always)]
    fn densities_in_line(&self, seen: &Seen<R>, wi: Vec3<R>) -> [R; ORDERS] {
        let (toward, turned) = (theta(wi), gamma(wi) + seen.gamma);
        // A loop would not be unrolled within another one.
        [
            self.density(&self.order(0), seen, toward, turned),
            self.density(&self.order(1), seen, toward, turned),
            self.density(&self.order(2), seen, toward, turned),
            self.density(&self.order(3), seen, toward, turned),
        ]
    }

    /// Value and density of a direction, for viewers.
    #[inline(always)]
    pub(crate) fn eval_pdf_in_line(&self, seen: &Seen<R>, wi: Vec3<R>) -> (Rgb<R>, R) {
        let densities = self.densities_in_line(seen, wi);
        (seen.radiance(&densities), seen.sampled(&densities))
    }

    /// The order that `u` chooses, and `u` stretched over [0, 1) again. Numbers are selected, so that there is no branch.
    #[inline(always)]
    fn choose(&self, u: R::Primal, shares: &[R; ORDERS]) -> (Order<R>, R::Primal) {
        let below_one = R::Primal::one() - R::Primal::EPSILON;
        let (mut order, mut share) = (self.order(0), shares[0].primal());
        let (mut rest, mut beyond) = (u, true);
        let mut number = 1;
        while number < ORDERS {
            beyond &= rest >= share;
            rest = R::Primal::select(beyond, rest - share, rest);
            share = R::Primal::select(beyond, shares[number].primal(), share);
            order = Order::select(beyond, &self.order(number), &order);
            number += 1;
        }
        (order, (rest / share).min(below_one))
    }

    /// A direction of that order; `u` and `u_along` are used up.
    #[inline(always)]
    fn direction(
        &self,
        seen: &Seen<R>,
        order: &Order<R>,
        u: R::Primal,
        u_along: [R::Primal; 2],
    ) -> Vec3<R> {
        let [sin, cos] = order.along.sample(order.tilted(seen.theta), u_along);
        let anywhere = R::lift(u * R::Primal::of(TAU));
        let around = self.around.sample(u) + seen.smooth(order);
        let turned = R::select(order.is_rest(), anywhere, around);
        let (sin_gamma, cos_gamma) = angle::sin_cos_of(turned - seen.gamma);
        Vec3::new(-cos * sin_gamma, sin, cos * cos_gamma)
    }

    /// A direction of any order, chosen by the (primal) luminance of its attenuation.
    fn scatter(&self, seen: &Seen<R>, u: [R::Primal; 3]) -> Vec3<R> {
        self.scatter_in_line(seen, u)
    }

    #[inline(always)]
    pub(crate) fn scatter_in_line(&self, seen: &Seen<R>, u: [R::Primal; 3]) -> Vec3<R> {
        let (order, stretched) = self.choose(u[0], &seen.shares());
        self.direction(seen, &order, u[2], [u[1], stretched])
    }

    /// Value and density of a direction that is lit, or where particles go.
    fn eval_pdf_where(
        &self,
        seen: &Seen<R>,
        [wo, wi]: [Vec3<R>; 2],
        mode: TransportMode,
    ) -> (Rgb<R>, R) {
        let densities = self.densities(seen, wi);
        let value = match mode {
            TransportMode::Radiance => seen.radiance(&densities),
            TransportMode::Importance => self.importance(wo, wi),
        };
        (value, mixture(seen.sampled(&densities), wi, mode))
    }

    /// What particles that come from `wo` have along `wi`: what viewers have, exchanged.
    fn importance(&self, wo: Vec3<R>, wi: Vec3<R>) -> Rgb<R> {
        // No particle comes along the surface.
        if wo.z.primal().abs() <= R::Primal::EPSILON {
            return Rgb::black();
        }
        let seen = self.seen(wi);
        let value = seen.radiance(&self.densities(&seen, wo));
        value * (wi.z / wo.z).abs()
    }
}

/// Of an angle in radians.
#[inline(always)]
fn sine_and_cosine<R: Real>(angle: R) -> [R; 2] {
    let (sin, cos) = angle::sin_cos_of(angle);
    [sin, cos]
}

/// A quotient, zero where there is none.
#[inline(always)]
fn over<R: Real>(rest: R, left: R) -> R {
    let some = left.primal() > R::Primal::zero();
    R::select(some, rest / left, R::zero())
}

impl<R: Real> Order<R> {
    /// Whether it is all those that have no lobe of their own.
    #[inline(always)]
    fn is_rest(&self) -> bool {
        self.number >= R::Primal::of(LOBES as f64)
    }

    /// A direction as scales that are tilted see it.
    #[inline(always)]
    fn tilted(&self, [sin, cos]: [R; 2]) -> [R; 2] {
        let [s, c] = self.tilt;
        [sin * c + cos * s, (cos * c - sin * s).abs()]
    }

    /// `a` if `cond` holds, else `b`: no branch.
    #[inline(always)]
    fn select(cond: bool, a: &Self, b: &Self) -> Self {
        Self {
            number: R::Primal::select(cond, a.number, b.number),
            along: Along {
                variance: R::select(cond, a.along.variance, b.along.variance),
                norm: R::select(cond, a.along.norm, b.along.norm),
            },
            tilt: [
                R::select(cond, a.tilt[0], b.tilt[0]),
                R::select(cond, a.tilt[1], b.tilt[1]),
            ],
        }
    }
}

impl<R: Real> Seen<R> {
    /// Sum of the angles to the normal of both directions, where the fibre is smooth around.
    #[inline(always)]
    fn smooth(&self, order: &Order<R>) -> R {
        let p = order.number;
        self.inside * Const(p + p) + Const(p * R::Primal::of(PI))
    }

    /// Probability of sampling each order.
    #[inline(always)]
    fn shares(&self) -> [R; ORDERS] {
        let sizes: [R; ORDERS] = ad_core::array(|p| self.attenuation[p].luminance());
        let whole = sizes[0] + sizes[1] + sizes[2] + sizes[3];
        let unit = (whole * R::c(1.0 + LEAST_SHARE * ORDERS as f64)).recip();
        ad_core::array(|p| (sizes[p] + whole * R::c(LEAST_SHARE)) * unit)
    }

    /// What a viewer sees of light from where the orders have these densities, cosine included.
    #[inline(always)]
    fn radiance(&self, densities: &[R; ORDERS]) -> Rgb<R> {
        let parts = self.attenuation;
        parts[0] * densities[0]
            + parts[1] * densities[1]
            + parts[2] * densities[2]
            + parts[3] * densities[3]
    }

    /// The density there of samples of the orders, chosen by primal shares.
    #[inline(always)]
    fn sampled(&self, densities: &[R; ORDERS]) -> R {
        let shares = self.shares();
        let part = ad_core::array::<R, ORDERS>(|p| densities[p] * Const(shares[p].primal()));
        part[0] + part[1] + part[2] + part[3]
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

impl<R: Real> Lobe<R> for HairLobe<R> {
    fn eval(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> Rgb<R> {
        match mode {
            TransportMode::Radiance => {
                let seen = self.seen(wo);
                seen.radiance(&self.densities(&seen, wi))
            }
            TransportMode::Importance => self.importance(wo, wi),
        }
    }

    fn pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> R {
        let seen = self.seen(wo);
        let sampled = seen.sampled(&self.densities(&seen, wi));
        mixture(sampled, wi, mode)
    }

    fn eval_pdf(&self, wo: Vec3<R>, wi: Vec3<R>, mode: TransportMode) -> (Rgb<R>, R) {
        self.eval_pdf_where(&self.seen(wo), [wo, wi], mode)
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
        let (evenly, u0) = match mode {
            TransportMode::Radiance => (false, u[0]),
            TransportMode::Importance => choose(u[0], R::Primal::of(EVENLY)),
        };
        let seen = self.seen(wo);
        let wi = if evenly {
            let w = warp::square_to_cosine_hemisphere([u[1], u[2]]);
            let below = u0 < R::Primal::of(0.5);
            Vec3::lift(Vec3::new(w.x, w.y, R::Primal::select(below, -w.z, w.z)))
        } else {
            self.scatter(&seen, [u0, u[1], u[2]])
        };
        let (f, pdf) = self.eval_pdf_where(&seen, [wo, wi], mode);
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

impl Leaf for Hair {
    type Lobe<R: Real> = HairLobe<R>;
    const MANY: bool = true;

    fn transmits(&self) -> bool {
        true
    }

    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> HairLobe<R> {
        HairLobe::new(&self.fibre(read))
    }
}

impl Hair {
    /// Its parameters at a point.
    #[inline]
    pub(crate) fn fibre<R: Real>(&self, read: &mut impl Reader<R>) -> Fibre<R> {
        let sigma_a = match &self.absorption {
            Absorption::Pigments(pigments) => {
                let each = pigments.iter().zip(MELANINS);
                each.fold(Rgb::black(), |sum, (amount, unit)| {
                    sum + Rgb::from(unit.map(R::of)) * read.scalar(amount)
                })
            }
            Absorption::Coefficient { sigma_a, scale } => read.rgb(sigma_a) * read.scalar(scale),
        };
        Fibre {
            sigma_a,
            roughness: [
                read.scalar(&self.longitudinal_roughness),
                read.scalar(&self.azimuthal_roughness),
            ],
            scale_tilt: read.scalar(&self.scale_tilt),
            eta: read.scalar(&self.eta),
        }
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
        let fibre = Fibre {
            sigma_a: Rgb::new(x[0], x[1], x[2]),
            roughness: [x[3], x[4]],
            scale_tilt: x[5],
            eta: x[6],
        };
        (HairLobe::new(&fibre), Vec3::new(x[7], x[8], x[9]))
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
                    let w = lobe.direction(&lobe.seen(wo), &lobe.order(order), u[2], [u[0], u[1]]);
                    w.to_array()[axis]
                };
                let (lobe, wo) = of(&seeded::<INPUTS>(&x, 0));
                let w = lobe.direction(&lobe.seen(wo), &lobe.order(order), u[2], [u[0], u[1]]);
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
                    let wi = lobe.direction(&seen, &lobe.order(order), b, [a, turn]);
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
