//! Where derivatives of what waves keep go: to the parameters, or to the radiance of the paths.

use ad_core::{Const, Float, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::lanes::{Lane, Lanes, Sums, WIDTH};
use super::record::Layer;
use crate::bsdf::{Bsdf, Material, Shading, Use};
use crate::emitter::{AnyEmitter, Emission, Emitter};
use crate::integrator::gradient::Active;
use crate::integrator::local::{ActiveTexture, LocalFn, pull_back};
use crate::integrator::path::MODE;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;
use crate::texture::{RgbTexture, Texture};

/// Takes the values that parameters have a part in, each with the adjoint `d` of the radiance of path `id` with respect
/// to it.
pub trait Ends<P: Float> {
    /// Light of an emitter.
    fn emission(&mut self, id: usize, emitter: &AnyEmitter, emission: &Emission<P>, d: Rgb<P>);
    /// Values of a material.
    fn vertex(&mut self, id: usize, material: &Material, uv: Vec2<P>, wo: Vec3<P>, uses: &[Use<P>]);
    /// Albedos of the plain vertices of a layer, where `wanted` is not zero.
    fn albedos(&mut self, scene: &Scene, layer: &Layer<P>, wanted: &Lane<u32>, d: &Lanes<P>);
    /// Light that is a function of the `textures` of a material.
    fn light(
        &mut self,
        id: usize,
        textures: &[ActiveTexture],
        uv: Vec2<P>,
        light: &impl LocalFn<P>,
        d: Rgb<P>,
    );
    /// Nothing follows.
    fn finish(&mut self) {}
}

/// The albedo of a plain vertex.
#[inline(always)]
fn albedo(scene: &Scene, material: u32) -> Option<&RgbTexture> {
    match &*scene.materials()[material as usize] {
        Material::Diffuse(m) => Some(&m.reflectance),
        _ => None,
    }
}

/// Beyond so many, vertices are faster one by one than materials.
const MOST_CONSTANTS: usize = 8;

/// Reverse mode: adjoints of the parameters.
pub struct Adjoints<'a, P: Float, G> {
    theta: &'a Theta<'a, P>,
    grad: &'a mut G,
    /// Plain materials that are differentiated and the same everywhere, and their albedos: sums over whole layers.
    constants: SmallVec<[(u32, ParamRef); MOST_CONSTANTS]>,
    /// In the same order.
    sums: [Sums<P>; MOST_CONSTANTS],
    /// Whether there are no other plain materials that are differentiated.
    only_constants: bool,
}

impl<'a, P: Float, G: GradSink<P>> Adjoints<'a, P, G> {
    /// Those of the parameters in `active`, added to `grad`.
    pub fn of(scene: &Scene, active: &Active, theta: &'a Theta<'a, P>, grad: &'a mut G) -> Self {
        let mut constants = SmallVec::new();
        let mut only_constants = true;
        for (index, _) in (0..).zip(scene.materials()) {
            match albedo(scene, index) {
                Some(reflectance) if active.material_active(index) => match reflectance {
                    Texture::Constant(albedo) if constants.len() < MOST_CONSTANTS => {
                        constants.push((index, *albedo));
                    }
                    _ => only_constants = false,
                },
                _ => {}
            }
        }
        Self {
            theta,
            grad,
            constants,
            sums: [Sums::zero(); MOST_CONSTANTS],
            only_constants,
        }
    }
}

impl<P: Float, G: GradSink<P>> Ends<P> for Adjoints<'_, P, G> {
    fn emission(&mut self, _id: usize, emitter: &AnyEmitter, emission: &Emission<P>, d: Rgb<P>) {
        emitter.backward(emission, d, self.grad);
    }

    fn vertex(
        &mut self,
        _id: usize,
        material: &Material,
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
    ) {
        let theta = *self.theta;
        material.backward(&Shading { theta, uv }, wo, uses, MODE, self.grad);
    }

    fn albedos(&mut self, scene: &Scene, layer: &Layer<P>, wanted: &Lane<u32>, d: &Lanes<P>) {
        for ((material, _), sums) in self.constants.iter().zip(&mut self.sums) {
            let of_this = |i: usize| (layer.material[i] == *material) & (wanted[i] != 0);
            sums.add_where(d, layer.n, of_this);
        }
        if self.only_constants {
            return;
        }
        let textured = |i: &usize| {
            let material = layer.material[*i];
            wanted[*i] != 0 && self.constants.iter().all(|(m, _)| *m != material)
        };
        let textured = || {
            (0..layer.n)
                .filter(textured)
                .filter_map(|i| Some((i, albedo(scene, layer.material[i])?)))
        };
        for (i, albedo) in textured() {
            albedo.expect_scatter(layer.uv(i), self.grad);
        }
        for (i, albedo) in textured() {
            albedo.scatter(layer.uv(i), d.rgb(i), self.grad);
        }
    }

    fn light(
        &mut self,
        _id: usize,
        textures: &[ActiveTexture],
        uv: Vec2<P>,
        light: &impl LocalFn<P>,
        d: Rgb<P>,
    ) {
        pull_back(textures, self.theta, uv, light, d, self.grad);
    }

    fn finish(&mut self) {
        for (&(_, albedo), sums) in self.constants.iter().zip(&mut self.sums) {
            self.grad.add_all(albedo, 0, sums.total());
            *sums = Sums::zero();
        }
    }
}

/// Forward mode: tangents of the radiance of each path, where each has the adjoint one.
pub struct Tangents<'a, R: Real> {
    /// The parameters as they move.
    pub theta: &'a Theta<'a, R>,
    /// Radiance of the paths.
    pub l: &'a mut [Rgb<R>],
}

impl<R: Real> Tangents<'_, R> {
    /// The adjoint is part of `values`.
    #[inline(always)]
    fn add(&mut self, id: usize, values: Rgb<R>) {
        if let Some(l) = self.l.get_mut(id) {
            *l += values.map(|x| x - Const(x.primal()));
        }
    }
}

impl<R: Real> Ends<R::Primal> for Tangents<'_, R> {
    fn emission(
        &mut self,
        id: usize,
        emitter: &AnyEmitter,
        emission: &Emission<R::Primal>,
        d: Rgb<R::Primal>,
    ) {
        self.add(
            id,
            emitter.eval(self.theta, &emission.lift()) * Rgb::lift(d),
        );
    }

    fn vertex(
        &mut self,
        id: usize,
        material: &Material,
        uv: Vec2<R::Primal>,
        wo: Vec3<R::Primal>,
        uses: &[Use<R::Primal>],
    ) {
        let at = Shading {
            theta: *self.theta,
            uv: Vec2::lift(uv),
        };
        self.add(id, material.forward(&at, wo, uses, MODE));
    }

    fn albedos(
        &mut self,
        scene: &Scene,
        layer: &Layer<R::Primal>,
        wanted: &Lane<u32>,
        d: &Lanes<R::Primal>,
    ) {
        for i in (0..layer.n).filter(|i| wanted[*i] != 0) {
            if let Some(albedo) = albedo(scene, layer.material[i]) {
                let albedo = albedo.rgb(self.theta, Vec2::lift(layer.uv(i)));
                self.add(layer.id[i] as usize % WIDTH, albedo * Rgb::lift(d.rgb(i)));
            }
        }
    }

    fn light(
        &mut self,
        id: usize,
        _textures: &[ActiveTexture],
        _uv: Vec2<R::Primal>,
        light: &impl LocalFn<R::Primal>,
        d: Rgb<R::Primal>,
    ) {
        self.add(id, light.eval(self.theta) * Rgb::lift(d));
    }
}
