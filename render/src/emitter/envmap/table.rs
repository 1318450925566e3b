//! Directions in proportion to the luminance of a map, by inverse-transform sampling.
//!
//! A cell lies between neighbouring texels: `width` of them around each band between two rows. The latitude
//! is drawn first, from the means of the rows, then the longitude around the circle of that latitude. So
//! the direction is a continuous function of both random numbers, and stays one when the texels change:
//! attached samples must not jump [Zeltner 2021, section 4.2.2]. (A cell drawn first, with a latitude of its
//! own, jumps at its sides.)

use std::f64::consts::PI;

use ad_core::Real;

use crate::math::both;
use crate::math::search::first_not;

/// Fraction of the samples that are uniform over the sphere, so that dark texels can be switched on
/// (F7).
pub(super) const UNIFORM_FRACTION: f64 = 0.05;

/// Luminance and its sums.
#[derive(Clone, Debug)]
pub(super) struct Table {
    pub width: usize,
    pub height: usize,
    /// 1 - cos theta between the bands, from pole to pole.
    pub edges: Vec<f64>,
    /// 4 pi times the density per solid angle, at the texels; empty until it is known.
    pub density: Vec<f32>,
    /// [`Table::sums_of`] the density.
    pub sums: Vec<f64>,
    /// Where to look for the band of a random number.
    band_guide: Guide,
    /// Where to look for the cell in each row.
    cell_guides: Guide,
    /// How many parts these have: a search among a few numbers is left.
    parts: [usize; 2],
    /// Change of the density with the luminance; zero for a black map, which is sampled uniformly.
    pub slope: f64,
}

/// What a sample is made of: a cell, and what surrounds it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Local<R> {
    /// Probability of all bands before.
    pub before: R,
    /// Sums of the upper and the lower row.
    pub rows: [R; 2],
    /// Sums of all cells before, in both rows.
    pub lines: [R; 2],
    /// The densities at the corners of the cell: of the upper row, then of the lower one.
    pub corners: [[R; 2]; 2],
}

/// A place in a cell, in longitude and in the cosine of the angle from the pole.
#[derive(Clone, Copy, Debug)]
pub(super) struct Draw<R> {
    pub x: R,
    pub y: R,
    /// 4 pi times the density per solid angle there.
    pub density: R,
}

/// Bounds for searches among numbers that ascend from nothing to a whole: how many are at most so many parts of it, for
/// all parts from none to all.
///
/// The parts are powers of two, so that a random number lies in its part whatever the rounding.
#[derive(Clone, Debug, Default)]
struct Guide(Vec<u32>);

impl Guide {
    /// Appends that of some numbers, in so many parts.
    fn add(&mut self, numbers: &[f64], whole: f64, parts: usize) {
        let mut passed = 0;
        for k in 0..=parts {
            let bound = whole * (k as f64 / parts as f64);
            while passed < numbers.len() && numbers[passed] <= bound {
                passed += 1;
            }
            self.0.push(passed as u32);
        }
    }
}

/// The part of so many that a number in [0, 1) lies in.
#[inline(always)]
fn part(u: f64, parts: usize) -> usize {
    // Larger numbers than that are none.
    ((u * parts as f64) as usize).min(parts - 1)
}

impl Table {
    pub fn new(width: usize, height: usize) -> Self {
        // One band where there is one row only.
        let bands = (height - 1).max(1);
        let one_minus_cos =
            |band: usize| 2.0 * (0.5 * PI * band as f64 / bands as f64).sin().powi(2);
        Self {
            width,
            height,
            edges: (0..=bands).map(one_minus_cos).collect(),
            density: Vec::new(),
            sums: Vec::new(),
            band_guide: Guide::default(),
            cell_guides: Guide::default(),
            parts: both([bands, width], usize::next_power_of_two),
            slope: 0.0,
        }
    }

    /// Number of bands of cells.
    #[inline]
    pub fn bands(&self) -> usize {
        self.edges.len() - 1
    }

    /// The rows above and below a band.
    #[inline]
    pub fn rows(&self, band: usize) -> [usize; 2] {
        [band, (band + 1).min(self.height - 1)]
    }

    /// The texels at the sides of a cell.
    #[inline]
    pub fn columns(&self, cell: usize) -> [usize; 2] {
        [cell, if cell + 1 == self.width { 0 } else { cell + 1 }]
    }

    /// Fraction of the sphere that a band covers.
    #[inline]
    pub fn cover(&self, band: usize) -> f64 {
        0.5 * (self.edges[band + 1] - self.edges[band])
    }

    /// Length of [`Table::sums_of`].
    pub fn len(&self) -> usize {
        self.width * self.height + self.bands()
    }

    /// Per row and cell, the sum of the means of its two texels over this cell and all before in the
    /// row; then per band, the integral of what is interpolated over this band and all before, over 4 pi.
    /// Linear in the `texels`.
    ///
    /// # Derivatives
    /// In the texels. Rounding does not add up (Kahan), as tangents may be in single precision.
    pub fn sums_of<R: Real>(&self, texel: impl Fn(usize) -> R) -> Vec<R> {
        let half = R::c(0.5);
        let mut out = Vec::with_capacity(self.len());
        for row in 0..self.height {
            let mut line = Sum::default();
            for cell in 0..self.width {
                let [a, b] = self.columns(cell);
                let texel = |x: usize| texel(row * self.width + x);
                out.push(line.add((texel(a) + texel(b)) * half));
            }
        }
        let mut total = Sum::default();
        for band in 0..self.bands() {
            let [a, b] = self.rows(band);
            let share = R::c(0.5 * self.cover(band) / self.width as f64);
            out.push(total.add((out[self.row(a)] + out[self.row(b)]) * share));
        }
        out
    }

    /// The adjoint of [`Table::sums_of`]: that of the texels.
    pub fn fold(&self, sums: &[f64]) -> Vec<f64> {
        let mut lines = sums[..self.width * self.height].to_vec();
        let mut rest = 0.0;
        for band in (0..self.bands()).rev() {
            rest += sums[self.width * self.height + band];
            let share = 0.5 * self.cover(band) / self.width as f64;
            for row in self.rows(band) {
                lines[(row + 1) * self.width - 1] += rest * share;
            }
        }
        let mut texels = vec![0.0; lines.len()];
        for row in 0..self.height {
            let mut rest = 0.0;
            for cell in (0..self.width).rev() {
                rest += lines[row * self.width + cell];
                for x in self.columns(cell) {
                    texels[row * self.width + x] += 0.5 * rest;
                }
            }
        }
        texels
    }

    /// Takes new luminances.
    pub fn update(&mut self, luminance: &[f32]) {
        let mut sums = self.sums_of(|i| f64::from(luminance[i]));
        let total = sums[sums.len() - 1];
        let known = total > 0.0 && (1.0 / total).is_finite();
        let (slope, floor) = if known {
            ((1.0 - UNIFORM_FRACTION) / total, UNIFORM_FRACTION)
        } else {
            (0.0, 1.0)
        };
        for (i, s) in sums.iter_mut().enumerate() {
            *s = *s * slope + floor * self.uniform_sum(i);
        }
        let density = |l: &f32| (f64::from(*l) * slope + floor) as f32;
        self.density = luminance.iter().map(density).collect();
        (self.sums, self.slope) = (sums, slope);
        let (lines, bands) = self.sums.split_at(self.width * self.height);
        let [band_parts, cell_parts] = self.parts;
        let (mut band_guide, mut cell_guides) = (Guide::default(), Guide::default());
        band_guide.add(bands, 1.0, band_parts);
        for line in lines.chunks_exact(self.width) {
            cell_guides.add(line, line[self.width - 1], cell_parts);
        }
        (self.band_guide, self.cell_guides) = (band_guide, cell_guides);
    }

    /// Fraction of the sphere that as much light would cover if it were the same everywhere: its squared mean over the mean
    /// of its square. One for a black map.
    pub fn cover_of_light(&self) -> f64 {
        let mut squares = Sum::default();
        for band in 0..self.bands() {
            let share = self.cover(band) / self.width as f64;
            for cell in 0..self.width {
                squares.add(share * mean_square(self.corners(band, cell)));
            }
        }
        // Without the uniform part, which is no light.
        let uniform = if self.slope > 0.0 {
            UNIFORM_FRACTION
        } else {
            0.0
        };
        (1.0 - uniform).powi(2) / (squares.value - uniform * (2.0 - uniform))
    }

    /// Element `i` of [`Table::sums_of`] ones.
    #[inline]
    pub fn uniform_sum(&self, i: usize) -> f64 {
        match i.checked_sub(self.width * self.height) {
            None => (i % self.width + 1) as f64,
            Some(band) => 0.5 * self.edges[band + 1],
        }
    }

    /// Where the sums of all bands before this one are, if there are any.
    #[inline]
    pub fn before(&self, band: usize) -> Option<usize> {
        (band > 0).then(|| self.width * self.height + band - 1)
    }

    /// Where the sum of all cells before this one in a row is, if there are any.
    #[inline]
    pub fn line(&self, row: usize, cell: usize) -> Option<usize> {
        (cell > 0).then(|| row * self.width + cell - 1)
    }

    /// Where the sum of a row is.
    #[inline]
    pub fn row(&self, row: usize) -> usize {
        (row + 1) * self.width - 1
    }

    #[inline]
    pub fn corners(&self, band: usize, cell: usize) -> [[f64; 2]; 2] {
        let [left, right] = self.columns(cell);
        let [a, b] = self.rows(band);
        let density = |row: usize, x: usize| f64::from(self.density[row * self.width + x]);
        [
            [density(a, left), density(a, right)],
            [density(b, left), density(b, right)],
        ]
    }

    #[inline]
    pub fn local(&self, band: usize, cell: usize) -> Local<f64> {
        let sum = |at: Option<usize>| at.map_or(0.0, |i| self.sums[i]);
        let [a, b] = self.rows(band);
        Local {
            before: sum(self.before(band)),
            rows: [self.sums[self.row(a)], self.sums[self.row(b)]],
            lines: [sum(self.line(a, cell)), sum(self.line(b, cell))],
            corners: self.corners(band, cell),
        }
    }

    /// The band and the cell that random numbers fall into, and where.
    pub fn draw(&self, u: [f64; 2]) -> (usize, usize, Draw<f64>) {
        let band = self.band(u[1]);
        let y = self.latitude(band, u[1], &self.around(band));
        let cell = self.cell(band, u[0], y);
        (band, cell, self.place(y, u[0], &self.local(band, cell)))
    }

    /// The band that a random number falls into.
    #[inline(always)]
    pub fn band(&self, u: f64) -> usize {
        first_not(self.bands_left(u), |band| self.is_above(band, u))
    }

    /// The first and the last band that it may be.
    #[inline(always)]
    pub fn bands_left(&self, u: f64) -> [usize; 2] {
        let k = part(u, self.parts[0]);
        let guide = &self.band_guide.0;
        // The last sum may be less than one by rounding.
        let last = (guide[k + 1] as usize).min(self.bands() - 1);
        [(guide[k] as usize).min(last), last]
    }

    /// Whether a random number falls below a band.
    #[inline(always)]
    pub fn is_above(&self, band: usize, u: f64) -> bool {
        self.sums[self.width * self.height + band] <= u
    }

    /// The cell that a random number falls into, at a latitude in a band.
    #[inline(always)]
    pub fn cell(&self, band: usize, u: f64, y: f64) -> usize {
        let (range, target) = self.cells_left(band, u, y);
        first_not(range, |cell| self.is_before([band, cell], y, target))
    }

    /// The first and the last cell that it may be, and the sum that it reaches. What is searched is a mean of two rows, which
    /// passes a part of its sum no earlier than both of them do, and no later.
    #[inline(always)]
    pub fn cells_left(&self, band: usize, u: f64, y: f64) -> ([usize; 2], f64) {
        let parts = self.parts[1];
        let [a, b] = self.rows(band);
        let k = part(u, parts);
        let guide = |row: usize, k: usize| self.cell_guides.0[row * (parts + 1) + k] as usize;
        let first = guide(a, k).min(guide(b, k));
        let last = guide(a, k + 1).max(guide(b, k + 1)).min(self.width - 1);
        let target = u * mix([self.sums[self.row(a)], self.sums[self.row(b)]], y);
        ([first.min(last), last], target)
    }

    /// Whether a cell ends before that sum.
    #[inline(always)]
    pub fn is_before(&self, [band, cell]: [usize; 2], y: f64, target: f64) -> bool {
        let sums = both(self.rows(band), |row| self.sums[row * self.width + cell]);
        mix(sums, y) <= target
    }

    /// What the latitude in a band depends on; there is no cell yet.
    #[inline(always)]
    pub fn around(&self, band: usize) -> Local<f64> {
        let [a, b] = self.rows(band);
        Local {
            before: self.before(band).map_or(0.0, |i| self.sums[i]),
            rows: [self.sums[self.row(a)], self.sums[self.row(b)]],
            lines: [0.0; 2],
            corners: [[0.0; 2]; 2],
        }
    }

    /// The same, for the band and the cell that are known.
    ///
    /// # Derivatives
    /// In what surrounds the cell.
    pub fn draw_from<R: Real<Primal = f64>>(
        &self,
        band: usize,
        u: [f64; 2],
        local: &Local<R>,
    ) -> Draw<R> {
        self.place(self.latitude(band, u[1], local), u[0], local)
    }

    /// How far down in a band a random number falls.
    #[inline(always)]
    pub fn latitude<R: Real<Primal = f64>>(&self, band: usize, u: f64, local: &Local<R>) -> R {
        self.latitude_where(self.cover(band), u, local)
    }

    /// The same where it is known which fraction of the sphere the band covers.
    #[inline(always)]
    pub fn latitude_where<R: Real<Primal = f64>>(&self, cover: f64, u: f64, local: &Local<R>) -> R {
        let [a, b] = local.rows;
        let mass = (a + b) * R::c(0.5 * cover / self.width as f64);
        sample_linear((R::of(u) - local.before) / mass, a, b)
    }

    /// Where in its cell a random number falls.
    #[inline(always)]
    pub fn place<R: Real<Primal = f64>>(&self, y: R, u: f64, local: &Local<R>) -> Draw<R> {
        let [[a, b], [c, d]] = local.corners;
        let (left, right) = (mix([a, c], y), mix([b, d], y));
        let target = mix(local.rows, y) * R::c(u) - mix(local.lines, y);
        let x = sample_linear(target / ((left + right) * R::c(0.5)), left, right);
        Draw {
            x,
            y,
            density: mix([left, right], x),
        }
    }
}

/// From the first value to the second.
#[inline(always)]
pub(super) fn mix<R: Real>([a, b]: [R; 2], x: R) -> R {
    a + (b - a) * x
}

/// Mean of the square of what is bilinear in a cell.
fn mean_square([[a, b], [c, d]]: [[f64; 2]; 2]) -> f64 {
    let upper = a * a + a * b + b * b;
    let lower = c * c + c * d + d * d;
    let across = a * c + b * d + 0.5 * (a * d + b * c);
    (upper + lower + across) / 9.0
}

/// Fraction at which a density linear from `a` to `b` (positive) has accumulated the share `u`.
#[inline(always)]
fn sample_linear<R: Real>(u: R, a: R, b: R) -> R {
    let u = u.clamp(R::zero(), R::one());
    let x = u * (a + b) / (a + (a * a + u * (b * b - a * a)).sqrt());
    x.clamp(R::zero(), R::one())
}

/// A sum that keeps what rounding takes [Kahan 1965].
#[derive(Default)]
struct Sum<R> {
    value: R,
    excess: R,
}

impl<R: Real> Sum<R> {
    #[inline]
    fn add(&mut self, x: R) -> R {
        let x = x - self.excess;
        let value = self.value + x;
        self.excess = (value - self.value) - x;
        self.value = value;
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light that is the same everywhere covers everything, and so does none; what rises from the poles to the equator with
    /// the height covers 3/4, and one bright texel less than its cells.
    #[test]
    fn light_covers_what_it_should() {
        let cover = |luminance: &[f32], size: [usize; 2]| {
            let mut table = Table::new(size[0], size[1]);
            table.update(luminance);
            table.cover_of_light()
        };
        for grey in [0.0, 1e-3, 7.0] {
            assert!((cover(&[grey; 40], [8, 5]) - 1.0).abs() < 1e-5, "{grey}");
        }
        let [dark, bright] = [[0.0; 4], [2.0; 4]];
        let rises = cover(&[dark, bright, dark].concat(), [4, 3]);
        assert!((rises - 0.75).abs() < 1e-5, "{rises}");
        let mut spot = vec![0.0; 64 * 33];
        spot[16 * 64 + 20] = 1e6;
        let found = cover(&spot, [64, 33]);
        // A bilinear hat: its squared integral over that of its square is 9/4 of a cell.
        let cell = (std::f64::consts::PI / 32.0).sin() / 2.0 / 64.0;
        assert!((found / (2.25 * cell) - 1.0).abs() < 1e-2, "{found} {cell}");
    }

    /// Searches that start from tables find what searches through everything do, on the borders of parts and of cells as
    /// well; for maps of many sizes, with rows and columns that are black.
    #[test]
    fn tables_do_not_change_what_is_found() {
        for (width, height) in [(1, 1), (1, 5), (7, 1), (8, 4), (37, 19), (64, 33)] {
            for dark in 1..4 {
                let luminance: Vec<f32> = (0..width * height)
                    .map(|i| {
                        let wave = (0.73 * (i * dark) as f32).sin().powi(8);
                        let black = i / width % 4 == dark || i % width < width / dark / 2;
                        if black { 0.0 } else { 1e3 * wave }
                    })
                    .collect();
                let mut table = Table::new(width, height);
                table.update(&luminance);
                let (lines, bands) = table.sums.split_at(width * height);
                let numbers = (0..=512).flat_map(|k| {
                    let u = f64::from(k) / 512.0;
                    [u.next_down(), u, u.next_up()]
                });
                let numbers: Vec<f64> = (numbers.chain(bands.iter().copied()))
                    .filter(|u| (0.0..1.0).contains(u))
                    .collect();
                for &u in &numbers {
                    let all = bands.partition_point(|&p| p <= u).min(bands.len() - 1);
                    assert_eq!(table.band(u), all, "{width} {height} {u}");
                }
                for band in 0..bands.len() {
                    let [a, b] = both(table.rows(band), |row| &lines[row * width..][..width]);
                    for &u in &numbers {
                        for y in [0.0, 0.3, 1.0] {
                            let at = |i: usize| mix([a[i], b[i]], y);
                            let target = u * at(width - 1);
                            let all = (0..width - 1).find(|&i| at(i) > target);
                            let all = all.unwrap_or(width - 1);
                            let found = table.cell(band, u, y);
                            // Numbers on the border of a cell may be rounded to either side.
                            let near = |i: usize| (at(i) - target).abs() <= 1e-14 * at(width - 1);
                            let border = near(all.min(found));
                            assert!(found == all || border, "{width} {height} {u} {found} {all}");
                        }
                    }
                }
            }
        }
    }
}
