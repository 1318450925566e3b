//! Where derivatives of recorded values go: to the parameters, or to the radiance of the paths.

use ad_core::{Const, Float, Real, Vec2, Vec3};

use crate::bsdf::{Bsdf, Material, Shading, TransportMode, Use};
use crate::emitter::{AnyEmitter, Emission, Emitter, Envmap, MovingDraw};
use crate::integrator::local::{ActiveTexture, LocalFn, pull_back};
use crate::math::Rgb;
use crate::params::{GradSink, Theta};

/// Takes the values that parameters have a part in, each with the adjoint `d` of the radiance of path `id` with respect
/// to it.
pub trait DerivativeSink<P: Float> {
    /// Light of an emitter.
    fn emission(&mut self, id: usize, emitter: &AnyEmitter, emission: &Emission<P>, d: Rgb<P>);
    /// Values of a material.
    fn vertex(
        &mut self,
        id: usize,
        material: &Material,
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
    );
    /// Light that is a function of the `textures` of a material.
    fn light(
        &mut self,
        id: usize,
        textures: &[ActiveTexture],
        uv: Vec2<P>,
        light: &impl LocalFn<P>,
        d: Rgb<P>,
    );
    /// A sample of an environment map that moves with its texels; `d` is the adjoint of its three varying numbers
    /// ([`Envmap::vary`]). Strategies without such samples never call it.
    fn moved(&mut self, _emitter: u32, _map: &Envmap, _aim: &MovingDraw, _d: [P; 3]) {}
}

/// Where the adjoints of sums go that moving samples of an emitter are made of
/// ([`crate::emitter::Envmap::fold`]).
pub trait SumSink {
    /// Adds `d`. It is not called for strategies whose samples of emitters stand still.
    fn add_sum(&mut self, _emitter: u32, _sum: usize, _d: f64) {}
}

/// Reverse mode: adjoints of the parameters.
pub struct Adjoints<'a, P: Float, G> {
    /// The parameters.
    pub theta: &'a Theta<'a, P>,
    /// Where their adjoints are added up.
    pub grad: &'a mut G,
}

impl<P: Float, G: GradSink<P> + SumSink> DerivativeSink<P> for Adjoints<'_, P, G> {
    #[inline(always)]
    fn emission(&mut self, _id: usize, emitter: &AnyEmitter, emission: &Emission<P>, d: Rgb<P>) {
        emitter.backward(self.theta, emission, d, self.grad);
    }

    #[inline(always)]
    fn vertex(
        &mut self,
        _id: usize,
        material: &Material,
        uv: Vec2<P>,
        wo: Vec3<P>,
        uses: &[Use<P>],
        mode: TransportMode,
    ) {
        let theta = *self.theta;
        material.backward(&Shading::new(theta, uv), wo, uses, mode, self.grad);
    }

    #[inline(always)]
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

    fn moved(&mut self, emitter: u32, map: &Envmap, drawn: &MovingDraw, d: [P; 3]) {
        map.pull_back(drawn, d, self.grad, |grad, sum, d| {
            grad.add_sum(emitter, sum, d)
        });
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
    pub fn add(&mut self, id: usize, values: Rgb<R>) {
        if let Some(l) = self.l.get_mut(id) {
            *l += values.map(|x| x - Const(x.primal()));
        }
    }
}

impl<R: Real> DerivativeSink<R::Primal> for Tangents<'_, R> {
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
        mode: TransportMode,
    ) {
        let at = Shading::new(*self.theta, Vec2::lift(uv));
        self.add(id, material.forward(&at, wo, uses, mode));
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
