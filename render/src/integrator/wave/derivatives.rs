//! Where derivatives of what waves keep go: [`crate::integrator::record::derivatives`], and what many plain vertices have together.

use ad_core::{Float, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::kinds::{has_two_sides, side};
use super::lanes::{Lane, LaneSums, Lanes, WAVE_SIZE};
use super::record::{Layer, LayerSink};
use super::slopes::MetalSlopes;
use crate::bsdf::{Material, TransportMode, Use};
use crate::emitter::{AnyEmitter, Emission};
use crate::integrator::active::Active;
use crate::integrator::local::{ActiveTexture, LocalFn};
use crate::integrator::record::SumSink;
use crate::integrator::record::derivatives::{Adjoints, DerivativeSink, Tangents};
use crate::integrator::vertex::MODE;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;
use crate::texture::{RgbTexture, Texture};

/// The albedo of a plain vertex; `back`: whether it is that of the back of a material that is another one there.
#[inline(always)]
pub(super) fn albedo(scene: &Scene, material: u32, back: bool) -> Option<&RgbTexture> {
    match side(&scene.materials()[material as usize], back) {
        (Material::Diffuse(m), _) => Some(&m.reflectance),
        _ => None,
    }
}

/// Beyond so many, vertices are faster one by one than materials.
const MOST_CONSTANTS: usize = 8;

/// Reverse mode: [`Adjoints`], and sums over whole layers.
pub struct LayerAdjoints<'a, P: Float, G> {
    adjoints: Adjoints<'a, P, G>,
    /// Plain materials that are differentiated and the same everywhere, whether only their backs are, and their albedos:
    /// sums over whole layers.
    constants: SmallVec<[(u32, bool, ParamRef); MOST_CONSTANTS]>,
    /// In the same order.
    sums: [LaneSums<P>; MOST_CONSTANTS],
    /// Whether there are no other plain materials that are differentiated.
    only_constants: bool,
    metals: MetalSlopes<'a, P>,
}

impl<'a, P: Float, G: GradSink<P> + SumSink> LayerAdjoints<'a, P, G> {
    /// Those of the parameters in `active`, added to `grad`.
    pub fn of(scene: &'a Scene, active: &Active, theta: &'a Theta<'a, P>, grad: &'a mut G) -> Self {
        let mut constants = SmallVec::new();
        let mut only_constants = true;
        for (index, material) in (0..).zip(scene.materials()) {
            for back in [false, true]
                .into_iter()
                .take(1 + usize::from(has_two_sides(material)))
            {
                match albedo(scene, index, back) {
                    Some(reflectance) if active.differentiates(index) => match reflectance {
                        Texture::Constant(albedo) if constants.len() < MOST_CONSTANTS => {
                            constants.push((index, back, *albedo));
                        }
                        _ => only_constants = false,
                    },
                    _ => {}
                }
            }
        }
        Self {
            metals: MetalSlopes::of(scene, grad),
            adjoints: Adjoints { theta, grad },
            constants,
            sums: [LaneSums::zero(); MOST_CONSTANTS],
            only_constants,
        }
    }

    /// Adds what still waits: called after the last wave.
    pub fn complete(mut self) {
        let Adjoints { theta, grad } = &mut self.adjoints;
        self.metals.finish(theta, *grad);
    }
}

impl<P: Float, G: GradSink<P> + SumSink> DerivativeSink<P> for LayerAdjoints<'_, P, G> {
    fn emission(&mut self, id: usize, emitter: &AnyEmitter, emission: &Emission<P>, d: Rgb<P>) {
        self.adjoints.emission(id, emitter, emission, d);
    }

    fn vertex(
        &mut self,
        id: usize,
        material: &Material,
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
    ) {
        self.adjoints.vertex(id, material, uv, wo, uses, mode);
    }

    fn light(
        &mut self,
        id: usize,
        textures: &[ActiveTexture],
        uv: Vec2<P>,
        light: &impl LocalFn<P>,
        d: Rgb<P>,
    ) {
        self.adjoints.light(id, textures, uv, light, d);
    }
}

impl<P: Float, G: GradSink<P> + SumSink> LayerSink<P> for LayerAdjoints<'_, P, G> {
    fn other(
        &mut self,
        (id, index, material): (usize, u32, &Material),
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
    ) {
        let Adjoints { theta, grad } = &mut self.adjoints;
        if !(self.metals).take(index, (uv, wo), uses, theta, *grad) {
            self.vertex(id, material, uv, wo, uses, MODE);
        }
    }

    fn albedos(&mut self, scene: &Scene, layer: &Layer<P>, wanted: &Lane<u32>, d: &Lanes<P>) {
        for (&(material, back, _), sums) in self.constants.iter().zip(&mut self.sums) {
            let of_this = |i: usize| {
                let same = (layer.material[i] == material) & (layer.back[i] == u32::from(back));
                same & (wanted[i] != 0)
            };
            sums.add_where(d, layer.n, of_this);
        }
        if self.only_constants {
            return;
        }
        let textured = |i: &usize| {
            let of = (layer.material[*i], layer.back[*i] != 0);
            wanted[*i] != 0 && self.constants.iter().all(|&(m, back, _)| (m, back) != of)
        };
        let textured = || {
            (0..layer.n)
                .filter(textured)
                .filter_map(|i| Some((i, albedo(scene, layer.material[i], layer.back[i] != 0)?)))
        };
        let grad = &mut *self.adjoints.grad;
        for (i, albedo) in textured() {
            albedo.expect_scatter(layer.uv(i), grad);
        }
        for (i, albedo) in textured() {
            albedo.scatter(layer.uv(i), d.rgb(i), grad);
        }
    }

    fn finish(&mut self) {
        for (&(_, _, albedo), sums) in self.constants.iter().zip(&mut self.sums) {
            self.adjoints.grad.add_all(albedo, 0, sums.total());
            *sums = LaneSums::zero();
        }
    }
}

impl<R: Real> LayerSink<R::Primal> for Tangents<'_, R> {
    fn albedos(
        &mut self,
        scene: &Scene,
        layer: &Layer<R::Primal>,
        wanted: &Lane<u32>,
        d: &Lanes<R::Primal>,
    ) {
        for i in (0..layer.n).filter(|i| wanted[*i] != 0) {
            if let Some(albedo) = albedo(scene, layer.material[i], layer.back[i] != 0) {
                let albedo = albedo.rgb(self.theta, Vec2::lift(layer.uv(i)));
                self.add(
                    layer.id[i] as usize % WAVE_SIZE,
                    albedo * Rgb::lift(d.rgb(i)),
                );
            }
        }
    }
}
