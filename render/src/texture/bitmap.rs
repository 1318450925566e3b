//! Image textures.

use ad_core::{Float, Real, Vec2};

use super::Footprint;
use crate::params::ParamRef;

/// What happens outside the unit square.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Periodic.
    #[default]
    Repeat,
    /// The border is continued.
    Clamp,
    /// Periodic with every second copy reflected.
    Mirror,
}

/// An affine map of surface coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UvTransform {
    /// Rows `[a, b, c]`: `u' = a u + b v + c`.
    pub rows: [[f32; 3]; 2],
}

impl UvTransform {
    /// No change.
    pub const IDENTITY: Self = Self {
        rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    };

    /// Maps `uv`.
    #[inline(always)]
    pub fn apply<R: Real>(&self, uv: Vec2<R>) -> Vec2<R> {
        let k = |x: f32| ad_core::Const(R::Primal::from_f32(x));
        let row = |[a, b, c]: [f32; 3]| uv.x * k(a) + uv.y * k(b) + k(c);
        Vec2::new(row(self.rows[0]), row(self.rows[1]))
    }
}

/// The four texels around a place of an image, x first, and how far it is from the first to the last along both axes.
pub(crate) type Corners<R> = ([u32; 4], [R; 2]);

/// A bilinearly interpolated image. Row 0 lies at v = 0, column 0 at u = 0, and the centre of texel
/// (i, j) at `((i + 1/2) / width, (j + 1/2) / height)`, as in Mitsuba 3.
#[derive(Clone, Debug)]
pub struct Bitmap {
    /// The texels, `[height][width][channels]`.
    pub param: ParamRef,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Behaviour outside the unit square.
    pub wrap: Wrap,
    /// No interpolation if set.
    pub nearest: bool,
    /// Applied to `uv` first.
    pub to_uv: UvTransform,
}

impl Bitmap {
    /// The texels and weights of a lookup at `uv`.
    ///
    /// # Derivatives
    /// The weights follow `uv`; which texels they belong to is a primal decision. At texel centres
    /// the derivative is that of the cell towards larger coordinates.
    #[inline(always)]
    pub fn footprint<R: Real>(&self, uv: Vec2<R>) -> Footprint<R> {
        let uv = self.to_uv.apply(uv);
        if self.nearest {
            let x = texel_index(uv.x.primal(), self.width, self.wrap);
            let y = texel_index(uv.y.primal(), self.height, self.wrap);
            let texel = [y * self.width + x; 4];
            let mut weight = [R::zero(); 4];
            weight[0] = R::one();
            return Footprint {
                param: self.param,
                texel,
                weight,
            };
        }
        self.between(self.corners(uv))
    }

    /// Whether [`Bitmap::corners_in_line`] is ever right.
    #[inline(always)]
    pub(crate) fn is_found_in_line(&self) -> bool {
        !self.nearest && self.wrap == Wrap::Repeat
    }

    /// What a lookup at `uv` of an interpolated image that repeats is made of, without a branch, and whether that is right:
    /// if the place lies within the image.
    #[inline(always)]
    pub(crate) fn corners_in_line<P: Float>(&self, uv: Vec2<P>) -> (Corners<P>, bool) {
        let at = self.to_uv.apply(uv);
        let right = within(at.x) & within(at.y);
        let inside = |x: P| P::select(right, x, P::zero());
        let cell = |x: P, n: u32| reduced_cell(inside(x), n, Wrap::Repeat);
        let corners = self.corners_of(cell(at.x, self.width), cell(at.y, self.height));
        (corners, right)
    }

    /// The same of any interpolated image, at any place.
    #[inline(always)]
    pub(crate) fn corners_at<R: Real>(&self, uv: Vec2<R>) -> Corners<R> {
        self.corners(self.to_uv.apply(uv))
    }

    /// The interpolation of four texels.
    #[inline(always)]
    pub(crate) fn between<R: Real>(&self, (texel, [fx, fy]): Corners<R>) -> Footprint<R> {
        let (gx, gy) = (R::one() - fx, R::one() - fy);
        Footprint {
            param: self.param,
            texel,
            weight: [gx * gy, fx * gy, gx * fy, fx * fy],
        }
    }

    /// The texels around a place of the image, x first, and how far it is from the first to the last.
    #[inline(always)]
    fn corners<R: Real>(&self, at: Vec2<R>) -> Corners<R> {
        let x = cell(at.x, self.width, self.wrap);
        self.corners_of(x, cell(at.y, self.height, self.wrap))
    }

    #[inline(always)]
    fn corners_of<R: Real>(
        &self,
        (x0, x1, fx): (u32, u32, R),
        (y0, y1, fy): (u32, u32, R),
    ) -> Corners<R> {
        let texel = [
            y0 * self.width + x0,
            y0 * self.width + x1,
            y1 * self.width + x0,
            y1 * self.width + x1,
        ];
        (texel, [fx, fy])
    }

    /// The texels of an interpolated lookup, and how their weights change with `uv`, along u and v: constant across a
    /// cell each, and linear in the other.
    #[inline(always)]
    pub(super) fn slopes<R: Real>(&self, uv: Vec2<R>) -> Footprint<[R; 2]> {
        self.slopes_between(self.corners_at(uv))
    }

    /// [`Texture::slopes`](super::Texture::slopes) between four texels.
    #[inline(always)]
    pub(crate) fn slopes_between<R: Real>(
        &self,
        (texel, [fx, fy]): Corners<R>,
    ) -> Footprint<[R; 2]> {
        let single = |x: f32| R::lift(R::Primal::from_f32(x));
        let [[a, b, _], [c, d, _]] = self.to_uv.rows;
        let [[a, b], [c, d]] = [[single(a), single(b)], [single(c), single(d)]];
        let (width, height) = (R::of(f64::from(self.width)), R::of(f64::from(self.height)));
        let (gx, gy) = (R::one() - fx, R::one() - fy);
        let along = |x: R, y: R| {
            let (x, y) = (x * width, y * height);
            [x * a + y * c, x * b + y * d]
        };
        Footprint {
            param: self.param,
            texel,
            weight: [
                along(-gy, -gx),
                along(gy, -fx),
                along(-fy, gx),
                along(fy, fx),
            ],
        }
    }
}

/// Whether a coordinate lies in the first period.
#[inline(always)]
fn within<P: Float>(x: P) -> bool {
    (x >= P::zero()) & (x < P::one())
}

/// Reduces a coordinate to about one period, so that its integer part fits an `i32` whatever the input.
#[inline]
fn reduce<P: Float>(x: P, wrap: Wrap) -> P {
    // Nearly always; a division with remainder costs more than the rest of the lookup.
    if within(x) {
        return x;
    }
    let x = if x.is_finite() { x } else { P::zero() };
    match wrap {
        Wrap::Repeat => x.rem_euclid(P::c(1.0)),
        Wrap::Mirror => x.rem_euclid(P::c(2.0)),
        Wrap::Clamp => x.max(P::zero()).min(P::one()),
    }
}

/// A texel of `n` for an index that is at most one beyond a period: of [`reduce`]d coordinates. Without divisions and,
/// on small images, without branches that are hard to predict.
#[inline]
fn wrap_index(i: i32, n: u32, wrap: Wrap) -> u32 {
    // As unsigned numbers, negative ones are the largest.
    let once = |i: i32, period: u32| {
        let i = i as u32;
        (if i == period { 0 } else { i }).min(period - 1)
    };
    match wrap {
        Wrap::Repeat => once(i, n),
        Wrap::Clamp => i.clamp(0, n as i32 - 1) as u32,
        Wrap::Mirror => {
            let j = once(i, 2 * n);
            j.min(2 * n - 1 - j)
        }
    }
}

/// A whole number below 2^31 as an integer: `as` would also look after all others.
#[inline]
fn whole(x: f64) -> i32 {
    // Its lowest digits become those of the sum's bits.
    const SHIFT: f64 = (3u64 << 51) as f64;
    (x + SHIFT).to_bits() as i32
}

#[inline]
fn texel_index<P: Float>(x: P, n: u32, wrap: Wrap) -> u32 {
    wrap_index(
        (reduce(x, wrap).to_f32() * n as f32).floor() as i32,
        n,
        wrap,
    )
}

/// The two neighbouring texels along one axis and the weight of the second.
///
/// In line: written one by one and read as a whole, the texels would wait for each other.
#[inline(always)]
fn cell<R: Real>(x: R, n: u32, wrap: Wrap) -> (u32, u32, R) {
    // Adding the primal difference keeps the tangent of x while the value is reduced exactly.
    let p = x.primal();
    let reduced = reduce(p, wrap);
    let x = if reduced == p {
        x
    } else {
        x + ad_core::Const(reduced - p)
    };
    reduced_cell(x, n, wrap)
}

/// The same for a coordinate that is [`reduce`]d.
#[inline(always)]
fn reduced_cell<R: Real>(x: R, n: u32, wrap: Wrap) -> (u32, u32, R) {
    let pos = x * R::c(f64::from(n)) - R::c(0.5);
    let floor = pos.primal().to_f64().floor();
    let i = whole(floor);
    (
        wrap_index(i, n, wrap),
        wrap_index(i + 1, n, wrap),
        pos - R::c(floor),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bitmap(wrap: Wrap) -> Bitmap {
        Bitmap {
            param: ParamRef { id: 0, offset: 0 },
            width: 4,
            height: 2,
            wrap,
            nearest: false,
            to_uv: UvTransform::IDENTITY,
        }
    }

    #[test]
    fn texel_centres_are_exact_and_weights_sum_to_one() {
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            let b = bitmap(wrap);
            for i in 0..4 {
                let f = b.footprint(Vec2::new((i as f64 + 0.5) / 4.0, 0.25));
                let hit: f64 = (0..4)
                    .filter(|&k| f.texel[k] == i)
                    .map(|k| f.weight[k])
                    .sum();
                assert!((hit - 1.0).abs() < 1e-12);
            }
            for k in -40..40 {
                let uv = Vec2::new(0.173 * f64::from(k), -0.31 * f64::from(k));
                let f = b.footprint(uv);
                assert!((f.weight.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                assert!(f.texel.iter().all(|&t| t < 8));
            }
        }
    }

    /// Beyond the image, the texels of a lookup are those that whole numbers say.
    #[test]
    fn texels_repeat_end_or_turn_back_beyond_the_image() {
        let texel = |wrap, i: i64, n: i64| match wrap {
            Wrap::Repeat => i.rem_euclid(n),
            Wrap::Clamp => i.clamp(0, n - 1),
            Wrap::Mirror => {
                let j = i.rem_euclid(2 * n);
                j.min(2 * n - 1 - j)
            }
        };
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for k in -40..40 {
                let uv = Vec2::new(0.173 * f64::from(k), -0.313 * f64::from(k));
                let f = bitmap(wrap).footprint(uv);
                let first = [uv.x * 4.0, uv.y * 2.0].map(|x| (x - 0.5).floor() as i64);
                for (corner, [dx, dy]) in [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().enumerate() {
                    let [x, y] = [(first[0] + dx, 4), (first[1] + dy, 2)];
                    let expected = texel(wrap, y.0, y.1) * 4 + texel(wrap, x.0, x.1);
                    assert_eq!(i64::from(f.texel[corner]), expected, "{wrap:?} {k}");
                }
            }
        }
    }

    #[test]
    fn extreme_coordinates_stay_in_range() {
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for nearest in [false, true] {
                let b = Bitmap {
                    nearest,
                    ..bitmap(wrap)
                };
                for x in [
                    f32::NAN,
                    f32::INFINITY,
                    -f32::INFINITY,
                    1e30,
                    -1e30,
                    1.0,
                    0.0,
                    -0.0,
                ] {
                    let f = b.footprint(Vec2::new(x, x));
                    assert!(f.texel.iter().all(|&t| t < 8), "{wrap:?} {x}");
                }
            }
        }
    }
}
