//! How the materials of many vertices are read: lookups of one image at once, before any of them.

use ad_core::Float;

use super::lanes::Lane;
use super::lookups::{Lookups, image};
use crate::bsdf::{Bsdf, Material, Reader, Shading, TextureRef};
use crate::math::Rgb;
use crate::params::Theta;
use crate::texture::{Bitmap, Footprint, RgbTexture, ScalarTexture, Texture};

/// Fewer places are looked up one by one: to visit the textures would take longer.
const FEWEST: usize = 8;

/// Calls a function with one texture after the other.
type Visit<'a> = dyn Fn(&mut dyn FnMut(TextureRef)) + 'a;

/// The image that is read, if its lookups can be found in vectors, and its channels.
#[inline(always)]
fn image_of(texture: TextureRef<'_>) -> Option<(&Bitmap, usize)> {
    match texture {
        TextureRef::Rgb(t)
        | TextureRef::Mixed(t)
        | TextureRef::Vector(t)
        | TextureRef::Encoded(t) => image(t).map(|image| (image, 3)),
        TextureRef::Scalar(t)
        | TextureRef::Alpha(t)
        | TextureRef::Exponent(t)
        | TextureRef::Height(t) => image(t).map(|image| (image, 1)),
    }
}

/// Whether a material reads images.
pub fn reads_images(material: &Material) -> bool {
    let mut any = false;
    material.visit_textures(&mut |t| any |= image_of(t).is_some());
    any
}

/// Lookups of the images of a material, in the order in which it reads them.
pub struct Readings<P> {
    looked: Vec<Lookups<P>>,
    /// So many are of the material.
    used: usize,
}

impl<P: Float> Readings<P> {
    /// Of no material.
    pub fn new() -> Self {
        Self {
            looked: Vec::new(),
            used: 0,
        }
    }

    /// Looks up all images of a material at the first `n` places. `visit` visits its textures, in the order in which they will
    /// be read.
    #[inline(never)]
    pub fn look(&mut self, theta: &Theta<P>, visit: &Visit, n: usize, [u, v]: [&Lane<P>; 2]) {
        self.used = 0;
        if n < FEWEST {
            return;
        }
        visit(&mut |t| {
            let Some((image, channels)) = image_of(t) else {
                return;
            };
            if self.used == self.looked.len() {
                self.looked.push(Lookups::new());
            }
            let lookups = &mut self.looked[self.used];
            self.used += 1;
            lookups.find(image, n, u, v);
            lookups.expect(theta, image, n, channels);
        });
    }

    /// Of the `k`-th place, which is this.
    #[inline(always)]
    pub fn at<'a>(&'a self, at: Shading<'a, P>, k: usize) -> Reading<'a, P> {
        let looked = &self.looked[..self.used];
        Reading { at, looked, k }
    }
}

/// Reads a material at a point. Images are read in the order of their lookups, if they have been looked up before.
pub struct Reading<'a, P: Float> {
    /// The point.
    pub at: Shading<'a, P>,
    /// Lookups that have not been read.
    looked: &'a [Lookups<P>],
    k: usize,
}

impl<'a, P: Float> Reading<'a, P> {
    /// Where nothing has been looked up.
    #[inline(always)]
    pub fn new(at: Shading<'a, P>) -> Self {
        Self {
            at,
            looked: &[],
            k: 0,
        }
    }

    /// The lookup of a texture, if it has one.
    #[inline(always)]
    fn next<'b, const C: usize>(
        &mut self,
        texture: &'b Texture<C>,
    ) -> Option<(&'a Lookups<P>, &'b Bitmap)> {
        let (first, rest) = self.looked.split_first()?;
        let image = image(texture)?;
        self.looked = rest;
        Some((first, image))
    }

    /// Texels and weights of a texture.
    #[inline(always)]
    pub fn footprint(&mut self, texture: &RgbTexture) -> Footprint<P> {
        match self.next(texture) {
            Some((lookups, image)) => lookups.footprint(image, self.k),
            None => texture.footprint(self.at.uv),
        }
    }

    /// Texels of a texture, and how their weights change.
    #[inline(always)]
    pub fn slopes(&mut self, texture: &ScalarTexture) -> Footprint<[P; 2]> {
        match self.next(texture) {
            Some((lookups, image)) => lookups.slopes(image, self.k),
            None => texture.slopes(self.at.uv),
        }
    }
}

impl<P: Float> Reader<P> for Reading<'_, P> {
    #[inline(always)]
    fn rgb(&mut self, t: &RgbTexture) -> Rgb<P> {
        match self.next(t) {
            Some((lookups, image)) => lookups.value(&self.at.theta, image, self.k),
            None => t.rgb(&self.at.theta, self.at.uv),
        }
    }

    #[inline(always)]
    fn scalar(&mut self, t: &ScalarTexture) -> P {
        match self.next(t) {
            Some((lookups, image)) => {
                let [value] = lookups.footprint(image, self.k).value(&self.at.theta);
                value
            }
            None => t.scalar(&self.at.theta, self.at.uv),
        }
    }
}
