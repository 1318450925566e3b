//! In how many parts a pixel is searched: as many as it takes for footprints to be affine.

use ad_core::{Mat2, Vec3};

use super::footprint::{Footprint, Part};
use crate::film::PixelFilter;
use crate::scene::Scene;

/// By how much normals may turn (radians) and texels per pixel change (relative) across a part.
const MOST_CHANGE: f64 = 0.12;
/// Parts along a side are 1, 2, 4, .. up to two to this power.
const FINEST: usize = 3;
/// Where rays find out how a pixel curves, in half sides of its filter's support from the middle.
const PROBES: [[f64; 2]; 5] = {
    const FAR: f64 = 2.0 / 3.0;
    [
        [0.0, 0.0],
        [-FAR, -FAR],
        [FAR, -FAR],
        [-FAR, FAR],
        [FAR, FAR],
    ]
};
/// Where on the lens these rays start.
const MIDDLE: [f64; 2] = [0.5; 2];
/// The part of a choice by the filter that goes by area alone: it may vanish in the middle of a part.
const BY_AREA: f64 = 0.05;
/// The part of a choice by what parts show that goes by the filter alone: a part may show more than its middle.
const BY_FILTER: f64 = 0.2;

/// A pixel, and the parts that it is searched in: its filter's support, cut into equal squares.
#[derive(Clone, Debug)]
pub struct Pixel {
    /// The middle of its filter, on the full film.
    pub middle: [f64; 2],
    /// Whether the camera looks through lamps.
    pub hidden: bool,
    /// Parts along a side.
    side: usize,
    /// Half the side of a part, in pixels.
    half: f64,
    /// Probabilities of the parts, row by row.
    shares: Vec<f64>,
    /// Those by the filter alone.
    by_filter: Vec<f64>,
}

impl Pixel {
    /// One that is searched as a whole.
    pub(super) fn whole(filter: &PixelFilter, middle: [f64; 2], hidden: bool) -> Self {
        Self {
            middle,
            hidden,
            side: 1,
            half: filter.radius(),
            shares: vec![1.0],
            by_filter: vec![1.0],
        }
    }

    /// In as many parts as it takes for what is seen of `glinty` shapes, by index, to be affine in each. They are drawn by the
    /// filter and by what `fits` says of a footprint. All of it depends on the pixel alone, so that a part has the same
    /// probability for all samples.
    pub(super) fn new(
        scene: &Scene,
        glinty: &[bool],
        middle: [f64; 2],
        hidden: bool,
        fits: impl Fn(&Footprint) -> f64,
    ) -> Self {
        let filter = &scene.film.filter;
        let mut pixel = Self::whole(filter, middle, hidden);
        let probes = PROBES.map(|at| {
            let film = pixel.film(at.map(|x| x * pixel.half));
            let foot = pixel.seen(scene, glinty, film, MIDDLE);
            foot.map(|foot| Probe::new(&foot, at))
        });
        let across = change(&probes);
        let level = (0..FINEST).find(|&k| across <= MOST_CHANGE * (1 << k) as f64);
        pixel.side = 1 << level.unwrap_or(FINEST);
        if pixel.side == 1 {
            return pixel;
        }
        pixel.half /= pixel.side as f64;
        let all = pixel.side * pixel.side;
        let by_area = vec![(all as f64).recip(); all];
        let place = |i: usize| place(i, pixel.side, pixel.half);
        let by_filter: Vec<f64> = (0..all).map(|i| filter.density(place(i)).abs()).collect();
        pixel.by_filter = mixed(by_filter, &by_area, BY_AREA);
        let worth = |i: usize| {
            let foot = pixel.seen(scene, glinty, pixel.film(place(i)), MIDDLE);
            let part = Part {
                middle: place(i),
                half: pixel.half,
                share: 1.0,
                by_filter: pixel.by_filter[i],
            };
            foot.map_or(0.0, |foot| fits(&foot.within(part)) * part.by_filter)
        };
        let worth = (0..all).map(worth).collect();
        pixel.shares = mixed(worth, &pixel.by_filter, BY_FILTER);
        pixel
    }

    /// What is seen of glinty shapes, by index, at a point of the full film, `lens` on the lens.
    pub(super) fn seen(
        &self,
        scene: &Scene,
        glinty: &[bool],
        film: [f64; 2],
        lens: [f64; 2],
    ) -> Option<Footprint> {
        let foot = Footprint::new(scene, film, lens, self.middle, self.hidden)?;
        glinty[foot.shape as usize].then_some(foot)
    }

    /// The point of the full film that is so many pixels from the middle.
    fn film(&self, off: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|k: usize| self.middle[k] + off[k])
    }

    /// Whether it is searched as a whole.
    pub fn is_whole(&self) -> bool {
        self.side == 1
    }

    fn part(&self, i: usize) -> Part {
        Part {
            middle: place(i, self.side, self.half),
            half: self.half,
            share: self.shares[i],
            by_filter: self.by_filter[i],
        }
    }

    /// A part for a uniform number.
    pub(super) fn draw(&self, mut u: f64) -> Part {
        let drawn = self.shares.iter().position(|share| {
            u -= share;
            u < 0.0
        });
        self.part(drawn.unwrap_or(self.shares.len() - 1))
    }

    /// The part that a point belongs to, in pixels from the middle.
    pub(super) fn around(&self, offset: [f64; 2]) -> Part {
        let [x, y] = offset.map(|x| {
            let k = (0.5 * (x / self.half + self.side as f64)).floor();
            k.clamp(0.0, (self.side - 1) as f64) as usize
        });
        self.part(y * self.side + x)
    }
}

/// The middle of a part, in pixels from that of the filter.
fn place(i: usize, side: usize, half: f64) -> [f64; 2] {
    let along = |k: usize| (2 * k + 1) as f64 - side as f64;
    [i % side, i / side].map(|k| along(k) * half)
}

/// Probabilities in proportion to `sizes`, but for `some`, which goes by others; all of it, where there are no sizes.
fn mixed(sizes: Vec<f64>, others: &[f64], some: f64) -> Vec<f64> {
    let finite = |x: f64| if x.is_finite() { x } else { 0.0 };
    let sum: f64 = sizes.iter().map(|&x| finite(x)).sum();
    let possible = sum > 0.0 && sum.is_finite();
    let mix = |(&size, &other): (&f64, &f64)| {
        if possible {
            some * other + (1.0 - some) * (finite(size) / sum)
        } else {
            other
        }
    };
    sizes.iter().zip(others).map(mix).collect()
}

/// What a ray through a pixel sees of how its surface curves.
struct Probe {
    /// Where, see [`PROBES`].
    at: [f64; 2],
    shape: u32,
    normal: Vec3<f64>,
    /// Texture coordinates per pixel, as columns.
    uv: Mat2<f64>,
}

impl Probe {
    fn new(foot: &Footprint, at: [f64; 2]) -> Self {
        Self {
            at,
            shape: foot.shape,
            normal: foot.si.frame.n.map(|x| x.re),
            uv: Mat2::from_rows([foot.si.uv.x.eps, foot.si.uv.y.eps]),
        }
    }

    /// By how much what is seen changes from here to another.
    fn change(&self, other: &Self) -> f64 {
        let turn = (self.normal - other.normal).length();
        let stretch = self.uv.inverse().map_or(f64::INFINITY, |inverse| {
            let [[a, b], [c, d]] = (inverse * other.uv).rows;
            let squares = [a - 1.0, b, c, d - 1.0].map(|x| x * x);
            squares.iter().sum::<f64>().sqrt()
        });
        // What is not a number is no small change.
        if turn.is_nan() || stretch.is_nan() {
            f64::INFINITY
        } else {
            turn.max(stretch)
        }
    }
}

/// The largest change between two probes on one shape, as it would be across the pixel; infinite where a probe has no other on
/// its shape, at outlines and on what is smaller than a pixel.
fn change(probes: &[Option<Probe>; PROBES.len()]) -> f64 {
    let mut most = 0.0f64;
    for (i, probe) in probes.iter().enumerate() {
        let Some(probe) = probe else { continue };
        let others = probes.iter().enumerate().filter(|(k, _)| *k != i);
        let rates = others.filter_map(|(_, other)| {
            let other = other.as_ref().filter(|other| other.shape == probe.shape)?;
            let [x, y] = [0, 1].map(|k: usize| other.at[k] - probe.at[k]);
            Some(probe.change(other) * 2.0 / x.hypot(y))
        });
        // Infinite where there is none.
        most = most.max(rates.reduce(f64::max).unwrap_or(f64::INFINITY));
    }
    most
}
