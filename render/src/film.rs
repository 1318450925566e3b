//! Images, pixel filters and the part of the film that is rendered.

use std::f64::consts::TAU;
use std::ops::Range;

use ad_core::Float;

use crate::math::warp;

mod lobed;

pub use lobed::{Lobed, MOST_LOBES};

/// What pixels of films are made of in scene files: whether there is a fourth channel, and whether it is what is written.
pub(crate) const PIXELS: &[(&str, (bool, bool))] = &[
    ("rgb", (false, true)),
    ("rgba", (true, true)),
    ("luminance", (false, false)),
    ("luminance_alpha", (true, false)),
    ("luminanceAlpha", (true, false)),
    ("xyz", (false, false)),
    ("xyza", (true, false)),
];

/// A linear RGB image, row-major, row 0 at the top.
///
/// ```
/// let mut image = render::Image::new(2, 1);
/// image.data.copy_from_slice(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.5]); // [height][width][3]
/// assert_eq!(image.pixel(1, 0), [0.0, 0.0, 0.5]);
/// assert_eq!(image.mean(), [0.5, 0.0, 0.25]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// `[height][width][3]`.
    pub data: Vec<f32>,
}

impl Image {
    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            data: vec![0.0; width * height * 3],
        }
    }

    /// The colour of a pixel.
    pub fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        let i = (y * self.width + x) * 3;
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// Mean of all pixels, per channel.
    pub fn mean(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for p in self.data.chunks_exact(3) {
            for c in 0..3 {
                sum[c] += f64::from(p[c]);
            }
        }
        sum.map(|s| s / (self.width * self.height).max(1) as f64)
    }
}

/// A reconstruction filter. Samples are drawn *from* the filter and weigh one, so that a sample belongs
/// to one pixel: the expectation is that of the normalised splat, tiles need no borders, and the adjoint of a
/// pixel is looked up, never filtered twice (errata Z-4.15). Of filters with negative lobes the magnitude is sampled, and
/// samples have a [weight](PixelFilter::weight).
// There is one per scene, and it is `Copy`.
#[allow(clippy::large_enum_variant)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum PixelFilter {
    /// Uniform over the pixel.
    #[default]
    Box,
    /// A Gaussian with this standard deviation in pixels, cut at four standard deviations.
    Gaussian {
        /// Standard deviation, in pixels.
        stddev: f64,
    },
    /// A pyramid: the product of a triangle along either axis.
    Tent {
        /// Where it ends, in pixels.
        radius: f64,
    },
    /// The product of a filter with negative lobes along either axis.
    Lobed(Lobed),
}

impl PixelFilter {
    /// An offset from the pixel's centre, in pixels.
    #[inline]
    pub fn sample<P: Float>(&self, u: [P; 2]) -> [P; 2] {
        match *self {
            Self::Box => [u[0] - P::of(0.5), u[1] - P::of(0.5)],
            Self::Gaussian { stddev } => {
                // Box-Muller with the radius cut at 4 sigma: u is scaled into the inside of the disc.
                let inside = 1.0 - (-8.0f64).exp();
                let r = P::of(stddev) * (-P::of(2.0) * (-(u[0] * P::of(inside))).ln_1p()).sqrt();
                let (sin, cos) = warp::sin_cos_of_turns(u[1]);
                [r * cos, r * sin]
            }
            Self::Tent { radius } => u.map(|u| {
                // Both halves by their distance from the end, so that nothing cancels.
                let (near, far) = (P::of(2.0) * u, P::of(2.0) * (P::one() - u));
                let end = near.min(far).max(P::zero()).sqrt();
                let x = P::of(radius) * (P::one() - end);
                P::select(near < P::one(), -x, x)
            }),
            Self::Lobed(lobed) => u.map(|u| lobed.sample(u)),
        }
    }

    /// What a [`PixelFilter::sample`] at this offset counts: the filter over the density of the sample. One, unless the
    /// filter is negative in places.
    #[inline(always)]
    pub fn weight<P: Float>(&self, offset: [P; 2]) -> f64 {
        match self {
            Self::Lobed(lobed) => offset.iter().map(|x| lobed.weight(x.to_f64())).product(),
            _ => 1.0,
        }
    }

    /// Whether samples have [weights](PixelFilter::weight) other than one.
    #[inline(always)]
    pub fn is_weighted(&self) -> bool {
        matches!(self, Self::Lobed(_))
    }
}

impl PixelFilter {
    /// The filter at an offset from the pixel's centre, per square pixel; its integral is one. The weight of a splat, and
    /// the density of [`PixelFilter::sample`] times what such a sample [weighs](PixelFilter::weight).
    #[inline]
    pub fn density(&self, [x, y]: [f64; 2]) -> f64 {
        match *self {
            Self::Box => f64::from((-0.5..0.5).contains(&x) && (-0.5..0.5).contains(&y)),
            Self::Gaussian { stddev } => {
                let r2 = (x * x + y * y) / (stddev * stddev);
                if r2 < 16.0 {
                    (-0.5 * r2).exp() / (TAU * stddev * stddev * (1.0 - (-8.0f64).exp()))
                } else {
                    0.0
                }
            }
            Self::Tent { radius } => {
                let side = |x: f64| (1.0 - x.abs() / radius).max(0.0) / radius;
                side(x) * side(y)
            }
            Self::Lobed(ref lobed) => lobed.density(x) * lobed.density(y),
        }
    }

    /// Largest offset along either axis where the filter is not zero.
    pub fn radius(&self) -> f64 {
        match *self {
            Self::Box => 0.5,
            Self::Gaussian { stddev } => 4.0 * stddev,
            Self::Tent { radius } => radius,
            Self::Lobed(ref lobed) => lobed.radius(),
        }
    }
}

/// Size of the image and the part of it that is rendered.
///
/// Random numbers are those of pixels of the whole film, so that what is rendered of it is a part of the whole picture:
///
/// ```
/// use render::instances::{Estimator, render_f32};
/// use render::params::Theta;
/// use render::{Film, Job, Scene};
///
/// let mut room = render::scene::room(16, 8)?;
/// let image = |room: &Scene| {
///     let job = Job::new(room, &room.settings, 1, 0..4, &());
///     render_f32(&job, &Theta::constant(room.params().values()), Estimator::Mis).image(0)
/// };
/// let whole = image(&room);
/// room.film = Film { crop_offset: [5, 2], crop_size: [4, 3], ..Film::new(16, 8) };
/// let part = image(&room);
/// assert_eq!((part.width, part.height, room.film.pixels()), (4, 3, 12)); // `data` is [3][4][3]
/// assert_eq!(part.pixel(1, 2), whole.pixel(5 + 1, 2 + 2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Full resolution, `[width, height]`.
    pub size: [u32; 2],
    /// Top left corner of the rendered part.
    pub crop_offset: [u32; 2],
    /// Size of the rendered part: the size of the image that comes out.
    pub crop_size: [u32; 2],
    /// Reconstruction filter.
    pub filter: PixelFilter,
    /// Whether the scene file asks for a fourth channel: how much of a pixel is covered.
    pub alpha: bool,
}

impl Film {
    /// A whole film with a box filter.
    pub fn new(width: u32, height: u32) -> Self {
        Self {
            size: [width, height],
            crop_offset: [0, 0],
            crop_size: [width, height],
            filter: PixelFilter::Box,
            alpha: false,
        }
    }

    /// A pixel of the crop window on the full film, and its number there. Random numbers go by that, so that a crop shows the
    /// same samples.
    #[inline(always)]
    pub(crate) fn full_pixel(&self, [x, y]: [u32; 2]) -> ([u32; 2], u64) {
        let at @ [x, y] = [x + self.crop_offset[0], y + self.crop_offset[1]];
        (at, u64::from(y) * u64::from(self.size[0]) + u64::from(x))
    }

    /// The point of the image that two uniform numbers stand for in a pixel of the full film, by the filter.
    #[inline(always)]
    pub fn point_in<P: Float>(&self, [px, py]: [u32; 2], u: [P; 2]) -> [P; 2] {
        let [dx, dy] = self.filter.sample(u);
        let centre = |p: u32| P::of(f64::from(p) + 0.5);
        [centre(px) + dx, centre(py) + dy]
    }

    /// Least and largest x, then y, of the full film where a splat reaches the rendered part.
    pub fn reach(&self) -> [[f64; 2]; 2] {
        let margin = self.filter.radius() - 0.5;
        std::array::from_fn(|axis| {
            let low = f64::from(self.crop_offset[axis]);
            let high = low + f64::from(self.crop_size[axis]);
            [low - margin, high + margin]
        })
    }

    /// Rows of the crop window that a splat at height `y` of the full film may touch.
    #[inline]
    pub fn rows(&self, y: f64) -> Range<u32> {
        self.touched(y, 1)
    }

    /// Pixels of the crop window, along an axis, that a splat at `x` of the full film may touch.
    #[inline]
    fn touched(&self, x: f64, axis: usize) -> Range<u32> {
        let x = x - f64::from(self.crop_offset[axis]);
        if self.filter == PixelFilter::Box {
            let within = (0.0..f64::from(self.crop_size[axis])).contains(&x);
            let pixel = x as u32;
            return if within { pixel..pixel + 1 } else { 0..0 };
        }
        let (x, r) = (x - 0.5, self.filter.radius());
        // A cast saturates: what is not finite touches nothing, or weighs nothing.
        let last = (x + r).floor();
        let end = if last < 0.0 {
            0
        } else {
            (last as u32).saturating_add(1).min(self.crop_size[axis])
        };
        ((x - r).ceil().max(0.0) as u32).min(end)..end
    }

    /// Calls `f` with the index and the weight of every rendered pixel that a splat at `(x, y)` of
    /// the full film touches, if its row in the crop window is in `rows`.
    #[inline]
    pub fn splat(&self, [x, y]: [f64; 2], rows: Range<u32>, mut f: impl FnMut(usize, f64)) {
        let (mut columns, mut touched) = (self.touched(x, 0), self.touched(y, 1));
        let width = self.crop_size[0] as usize;
        // Without the loops, which would take longer than all the rest.
        if self.filter == PixelFilter::Box {
            if let (Some(column), Some(row)) = (columns.next(), touched.next())
                && rows.contains(&row)
            {
                f(row as usize * width + column as usize, 1.0);
            }
            return;
        }
        let (x, y) = (
            x - f64::from(self.crop_offset[0]),
            y - f64::from(self.crop_offset[1]),
        );
        for row in touched.start.max(rows.start)..touched.end.min(rows.end) {
            for column in columns.clone() {
                let offset = [x - f64::from(column) - 0.5, y - f64::from(row) - 0.5];
                let weight = self.filter.density(offset);
                if weight != 0.0 {
                    f(row as usize * width + column as usize, weight);
                }
            }
        }
    }

    /// Number of rendered pixels.
    pub fn pixels(&self) -> usize {
        self.crop_size[0] as usize * self.crop_size[1] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The splat of a point integrates to one over its position (midpoint rule), is what samples of the
    /// filter look like, and nothing beyond its reach touches the film.
    #[test]
    fn splats_are_the_density_of_the_filter() {
        for filter in [
            PixelFilter::Box,
            PixelFilter::Gaussian { stddev: 0.5 },
            PixelFilter::Gaussian { stddev: 0.9 },
            PixelFilter::Tent { radius: 1.5 },
            PixelFilter::Lobed(Lobed::cubic(1.0 / 3.0, 1.0 / 3.0).unwrap()),
            PixelFilter::Lobed(Lobed::lanczos(2).unwrap()),
        ] {
            let film = Film {
                crop_offset: [3, 2],
                crop_size: [2, 3],
                filter,
                ..Film::new(9, 8)
            };
            // Thirty points across a pixel: none falls on the box filter's edges.
            let n = 420;
            let mut sums = [0.0; 6];
            for i in 0..n {
                for j in 0..n {
                    let at = [i, j].map(|i| (f64::from(i) + 0.5) / f64::from(n) * 14.0 - 3.0);
                    let mut touched = false;
                    film.splat(at, 0..3, |k, w| {
                        sums[k] += w;
                        touched = true;
                    });
                    let reaches =
                        (0..2).all(|k| film.reach()[k][0] <= at[k] && at[k] <= film.reach()[k][1]);
                    assert!(reaches || !touched, "{at:?}");
                }
            }
            for s in sums {
                let integral = s * (14.0 / f64::from(n)).powi(2);
                assert!((integral - 1.0).abs() < 3e-3, "{filter:?}: {integral}");
            }
            // The rows one by one are the same splat.
            let at = [4.1, 3.9];
            let (mut whole, mut parts) = (Vec::new(), Vec::new());
            film.splat(at, 0..3, |k, w| whole.push((k, w)));
            for row in 0..3 {
                film.splat(at, row..row + 1, |k, w| parts.push((k, w)));
            }
            assert_eq!(whole, parts);
            film.splat([f64::NAN, 1.0], 0..3, |_, _| panic!("touched"));
            film.splat([f64::INFINITY, 1.0], 0..3, |_, _| panic!("touched"));
        }
    }

    fn all() -> Vec<PixelFilter> {
        let cubic = |b, c| PixelFilter::Lobed(Lobed::cubic(b, c).unwrap());
        let lanczos = |n| PixelFilter::Lobed(Lobed::lanczos(n).unwrap());
        vec![
            PixelFilter::Box,
            PixelFilter::Gaussian { stddev: 0.5 },
            PixelFilter::Tent { radius: 1.0 },
            PixelFilter::Tent { radius: 2.3 },
            cubic(1.0 / 3.0, 1.0 / 3.0),
            cubic(0.0, 0.5),
            cubic(1.0, 0.0),
            cubic(0.0, 1.0),
            lanczos(1),
            lanczos(2),
            lanczos(3),
            lanczos(MOST_LOBES),
        ]
    }

    /// Along an axis through the centre, where filters that are products are their own cut times a constant.
    fn cut(filter: &PixelFilter, moment: i32) -> f64 {
        // Thousands of cells of the midpoint rule, whose ends are those of all pieces but the Gaussian's.
        let n = 40_000;
        let r = filter.radius();
        let h = 2.0 * r / f64::from(n);
        let at = |i: i32| -r + (f64::from(i) + 0.5) * h;
        (0..n)
            .map(|i| filter.density([at(i), 0.0]) * at(i).powi(moment) * h)
            .sum()
    }

    /// The samples of a regular grid, weighed, have the integral and the moments of the filter, which quadrature gives,
    /// and each sample weighs what it must.
    #[test]
    fn weighed_samples_are_the_filter() {
        for filter in all() {
            let n = 200_000;
            let mut moments = [0.0; 5];
            let mut heaviest: f64 = 0.0;
            for i in 0..n {
                let u = (f64::from(i) + 0.5) / f64::from(n);
                // The radius of a Gaussian comes from the first number.
                let [x, y] = match filter {
                    PixelFilter::Gaussian { .. } => {
                        filter.sample([u, (f64::from(i) * 0.618_033_988_75).fract()])
                    }
                    _ => filter.sample([u, 0.5]),
                };
                let weight = match &filter {
                    PixelFilter::Lobed(lobed) => lobed.weight(x),
                    _ => filter.weight([x, y]),
                };
                assert!(
                    x.abs() <= filter.radius() && weight.is_finite(),
                    "{filter:?} {x}"
                );
                heaviest = heaviest.max(weight.abs());
                for (k, m) in moments.iter_mut().enumerate() {
                    *m += weight * x.powi(k as i32) / f64::from(n);
                }
            }
            let whole = cut(&filter, 0);
            let scale = filter.radius();
            for (k, m) in moments.into_iter().enumerate() {
                let expected = cut(&filter, k as i32) / whole;
                let off = (m - expected).abs() / scale.powi(k as i32);
                assert!(off < 2e-4, "{filter:?}: moment {k} is {m}, not {expected}");
            }
            assert!((1.0..3.5).contains(&heaviest), "{filter:?}: {heaviest}");
            assert_eq!(filter.is_weighted(), heaviest != 1.0, "{filter:?}");
        }
    }

    /// Known values of the filters themselves.
    #[test]
    fn filters_are_those_of_the_books() {
        let one = |filter: &PixelFilter, x: f64| match filter {
            PixelFilter::Lobed(lobed) => lobed.density(x),
            _ => filter.density([x, 0.0]) / filter.density([0.0, 0.0]),
        };
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        let mitchell = PixelFilter::Lobed(Lobed::cubic(1.0 / 3.0, 1.0 / 3.0).unwrap());
        for (x, value) in [
            (0.0, 8.0 / 9.0),
            (1.0, 1.0 / 18.0),
            (1.5, -5.0 / 144.0),
            (2.0, 0.0),
        ] {
            close(one(&mitchell, x), value);
            close(one(&mitchell, -x), value);
        }
        let catmull_rom = PixelFilter::Lobed(Lobed::cubic(0.0, 0.5).unwrap());
        for (x, value) in [(0.0, 1.0), (0.5, 0.5625), (1.0, 0.0), (1.5, -0.0625)] {
            close(one(&catmull_rom, x), value);
        }
        let lanczos = PixelFilter::Lobed(Lobed::lanczos(3).unwrap());
        close(one(&lanczos, 1.0), 0.0);
        close(
            one(&lanczos, 1.5) / one(&lanczos, 0.0),
            -4.0 / (3.0 * std::f64::consts::PI.powi(2)),
        );
        close(one(&PixelFilter::Tent { radius: 2.0 }, 0.5), 0.75);
        for bad in [(-0.1, 0.5), (0.5, 1.1), (f64::NAN, 0.5)] {
            assert!(Lobed::cubic(bad.0, bad.1).is_none());
        }
        assert!(Lobed::lanczos(0).is_none() && Lobed::lanczos(MOST_LOBES + 1).is_none());
    }
}
