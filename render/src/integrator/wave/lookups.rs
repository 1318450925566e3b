//! Many lookups of one interpolated image, at once.

use ad_core::{Float, Vec2};

use super::lanes::{Field, Lane, WAVE_SIZE, lanes, whole};
use crate::math::Rgb;
use crate::params::Theta;
use crate::texture::{self, Bitmap, Footprint, Texture};

lanes! {
    /// The texels and weights of lookups.
    Corners {
        texel_a: Lane<u32>,
        texel_b: Lane<u32>,
        texel_c: Lane<u32>,
        texel_d: Lane<u32>,
        weight_a: Lane<P>,
        weight_b: Lane<P>,
        weight_c: Lane<P>,
        weight_d: Lane<P>,
        /// How far from the first texel to the last.
        across: Lane<P>,
        down: Lane<P>,
        /// Whether they are right.
        right: Lane<u32>,
    }
}

/// Lookups of an image.
pub struct Lookups<P>(Box<Corners<P>>);

/// The image that a texture is, if lookups of it can be found in vectors.
#[inline(always)]
pub fn image<const C: usize>(texture: &Texture<C>) -> Option<&Bitmap> {
    match texture {
        Texture::Bitmap(bitmap) if bitmap.is_found_in_line() => Some(bitmap),
        _ => None,
    }
}

impl<P: Float> Lookups<P> {
    /// Without lookups.
    pub fn new() -> Self {
        Self(Box::new(Corners::zero()))
    }

    /// Finds the texels of the first `n` lookups.
    #[inline(never)]
    pub fn find(&mut self, bitmap: &Bitmap, n: usize, u: &Lane<P>, v: &Lane<P>) {
        let corners = &mut *self.0;
        for k in 0..whole(n) {
            let (found, right) = bitmap.corners_in_line(Vec2::new(u[k], v[k]));
            corners.put(k, bitmap, found);
            corners.right[k] = u32::from(right);
        }
        for k in 0..n.min(WAVE_SIZE) {
            if corners.right[k] == 0 {
                corners.put(k, bitmap, bitmap.corners_at(Vec2::new(u[k], v[k])));
            }
        }
    }

    #[inline(always)]
    fn texels(&self, k: usize) -> [u32; 4] {
        let c = &*self.0;
        [c.texel_a[k], c.texel_b[k], c.texel_c[k], c.texel_d[k]]
    }

    /// The texels and weights of lookup `k`.
    #[inline(always)]
    pub fn footprint(&self, bitmap: &Bitmap, k: usize) -> Footprint<P> {
        let c = &*self.0;
        Footprint {
            param: bitmap.param,
            texel: self.texels(k),
            weight: [c.weight_a[k], c.weight_b[k], c.weight_c[k], c.weight_d[k]],
        }
    }

    /// Texels of lookup `k`, and how their weights change.
    #[inline(always)]
    pub fn slopes(&self, bitmap: &Bitmap, k: usize) -> Footprint<[P; 2]> {
        let place = [self.0.across[k], self.0.down[k]];
        bitmap.slopes_between((self.texels(k), place))
    }

    /// The colour of lookup `k`.
    #[inline(always)]
    pub fn value(&self, theta: &Theta<P>, bitmap: &Bitmap, k: usize) -> Rgb<P> {
        self.footprint(bitmap, k).value(theta).into()
    }

    /// Says that the values of the first `n`, of so many channels, will soon be asked for: neighbours are mostly in one line
    /// of the cache.
    #[inline(always)]
    pub fn expect(&self, theta: &Theta<P>, bitmap: &Bitmap, n: usize, channels: usize) {
        for k in 0..n.min(WAVE_SIZE) {
            for texel in [self.0.texel_a[k], self.0.texel_c[k]] {
                theta.expect(bitmap.param, texel as usize * channels);
            }
        }
    }
}

impl<P: Float> Corners<P> {
    #[inline(always)]
    fn put(&mut self, k: usize, bitmap: &Bitmap, found: texture::Corners<P>) {
        [self.across[k], self.down[k]] = found.1;
        let footprint = bitmap.between(found);
        let [a, b, c, d] = footprint.texel;
        (self.texel_a[k], self.texel_b[k]) = (a, b);
        (self.texel_c[k], self.texel_d[k]) = (c, d);
        let [a, b, c, d] = footprint.weight;
        (self.weight_a[k], self.weight_b[k]) = (a, b);
        (self.weight_c[k], self.weight_d[k]) = (c, d);
    }
}
