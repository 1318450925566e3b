//! Reconstruction filters with negative lobes.

use std::f64::consts::PI;

use ad_core::Float;

/// Parts of the positive half of the table.
const CELLS: usize = 64;

/// Largest number of lobes of a windowed sinc.
pub const MOST_LOBES: u32 = 16;

/// One dimension of a filter that is negative in places, even about zero. Its magnitude is sampled from a table, and a sample
/// weighs the filter over the density that it was drawn with: `+Z` or `-Z`, with `Z` the integral of the magnitude, but for what
/// the table smoothes. So every expectation is that of the filter itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobed {
    curve: Curve,
    radius: f64,
    /// One over the integral of the curve.
    scale: f64,
    /// Magnitude of the curve at the ends of the cells.
    magnitude: [f64; CELLS + 1],
    /// Integral of the table up to the ends of the cells, from zero.
    sums: [f64; CELLS + 1],
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Curve {
    /// Two cubic pieces [Mitchell and Netravali 1988].
    Cubic { b: f64, c: f64 },
    /// A sinc under the central lobe of a wider one.
    Lanczos { lobes: u32 },
}

impl Curve {
    /// At a distance from the centre.
    fn at(&self, x: f64) -> f64 {
        match *self {
            Self::Cubic { b, c } => {
                let polynomial = |a: [f64; 4]| ((a[0] * x + a[1]) * x + a[2]) * x + a[3];
                if x < 1.0 {
                    let near = [
                        12.0 - 9.0 * b - 6.0 * c,
                        12.0 * b + 6.0 * c - 18.0,
                        0.0,
                        6.0 - 2.0 * b,
                    ];
                    polynomial(near) / 6.0
                } else if x < 2.0 {
                    let far = [
                        -b - 6.0 * c,
                        6.0 * b + 30.0 * c,
                        -12.0 * b - 48.0 * c,
                        8.0 * b + 24.0 * c,
                    ];
                    polynomial(far) / 6.0
                } else {
                    0.0
                }
            }
            Self::Lanczos { lobes } => {
                let n = f64::from(lobes);
                if x < n { sinc(x) * sinc(x / n) } else { 0.0 }
            }
        }
    }
}

/// `sin(pi x) / (pi x)`.
fn sinc(x: f64) -> f64 {
    let x = PI * x;
    if x < 1e-4 {
        1.0 - x * x / 6.0
    } else {
        x.sin() / x
    }
}

impl Lobed {
    /// The cubic filter with these parameters, from 0 to 1 [Mitchell and Netravali 1988]; `None` for others. A third
    /// for both is the authors' own choice, and 0 with a half is Catmull-Rom.
    pub fn cubic(b: f64, c: f64) -> Option<Self> {
        let unit = 0.0..=1.0;
        (unit.contains(&b) && unit.contains(&c)).then(|| Self::new(Curve::Cubic { b, c }, 2.0))
    }

    /// A windowed sinc that ends after so many zeros on either side, from 1 to [`MOST_LOBES`]; `None` for others.
    pub fn lanczos(lobes: u32) -> Option<Self> {
        let valid = (1..=MOST_LOBES).contains(&lobes);
        valid.then(|| Self::new(Curve::Lanczos { lobes }, f64::from(lobes)))
    }

    fn new(curve: Curve, radius: f64) -> Self {
        let width = radius / CELLS as f64;
        let magnitude = std::array::from_fn(|i| curve.at(i as f64 * width).abs());
        let mut sums = [0.0; CELLS + 1];
        for i in 0..CELLS {
            sums[i + 1] = sums[i] + 0.5 * width * (magnitude[i] + magnitude[i + 1]);
        }
        // Simpson's rule; its error is beyond double precision for cubics, whose pieces end between its intervals, and for
        // smooth curves.
        let steps = 128 * CELLS;
        let h = radius / (2 * steps) as f64;
        let simpson = |i: usize| {
            let at = |k: usize| curve.at((2 * i + k) as f64 * h);
            (at(0) + 4.0 * at(1) + at(2)) * h / 3.0
        };
        let integral: f64 = 2.0 * (0..steps).map(simpson).sum::<f64>();
        Self {
            curve,
            radius,
            scale: integral.recip(),
            magnitude,
            sums,
        }
    }

    /// The largest offset, pixels.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// The filter, whose integral is one.
    pub fn density(&self, x: f64) -> f64 {
        self.scale * self.curve.at(x.abs())
    }

    /// An offset in pixels.
    pub(super) fn sample<P: Float>(&self, u: P) -> P {
        let u = 2.0 * u.to_f64() - 1.0;
        let total = self.sums[CELLS];
        let area = u.abs() * total;
        let cell = (self.sums.partition_point(|&s| s <= area).max(1) - 1).min(CELLS - 1);
        let width = self.radius / CELLS as f64;
        // Where the area under a line from one end of the cell to the other reaches the rest; in a form that
        // cancels nothing.
        let [from, to] = [self.magnitude[cell], self.magnitude[cell + 1]];
        let rest = (area - self.sums[cell]) / width;
        let root = (from * from + 2.0 * (to - from) * rest).max(0.0).sqrt();
        let t = if from + root > 0.0 {
            (2.0 * rest / (from + root)).clamp(0.0, 1.0)
        } else {
            0.0
        };
        P::of(((cell as f64 + t) * width).copysign(u))
    }

    /// What a sample at this offset weighs.
    pub(super) fn weight(&self, x: f64) -> f64 {
        let at = x.abs() / self.radius * CELLS as f64;
        let cell = (at as usize).min(CELLS - 1);
        let t = (at - cell as f64).clamp(0.0, 1.0);
        let [from, to] = [self.magnitude[cell], self.magnitude[cell + 1]];
        let density = (from + (to - from) * t) / (2.0 * self.sums[CELLS]);
        if density > 0.0 {
            self.density(x) / density
        } else {
            0.0
        }
    }
}
