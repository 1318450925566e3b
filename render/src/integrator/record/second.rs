//! Second derivatives of a recorded path: its radiance as a function of the parameters.

use ad_core::{Float, Real, Vec2, Vec3};

use super::sweep::{Visitor, sweep};
use super::{Contribution, PathRecord, Place};
use crate::bsdf::{Bsdf, Component, Shading, TextureRef};
use crate::emitter::{Emission, Emitter};
use crate::integrator::active::Active;
use crate::integrator::local::{LocalFn, Texels, pull_back_second};
use crate::integrator::vertex::MODE;
use crate::math::Rgb;
use crate::params::{GradSink, ParamRef, Theta};
use crate::scene::Scene;
use crate::texture::ScalarTexture;

/// The radiance of a recorded path: its samples, densities and weights are constants.
struct Radiance<'a, P: Float> {
    scene: &'a Scene,
    active: &'a Active,
    path: &'a PathRecord<P>,
}

/// The values of the path over another scalar.
struct Again<'a, R: Real> {
    scene: &'a Scene,
    active: &'a Active,
    theta: &'a Theta<'a, R>,
}

impl<P: Float, R: Real<Primal = P>> Visitor<P> for Again<'_, R> {
    type Scalar = R;

    fn emitted(&mut self, emitter: u32, emission: &Emission<P>, _beta: Rgb<P>) -> Rgb<R> {
        self.scene.emitters()[emitter as usize].eval(self.theta, &emission.lift())
    }

    fn value(&mut self, place: &Place<P>, wi: Vec3<P>, component: Component, f: Rgb<P>) -> Rgb<R> {
        let index = self.scene.shape_info(place.shape).material;
        if !self.active.differentiates(index) {
            return Rgb::lift(f);
        }
        let at = Shading::new(*self.theta, Vec2::lift(place.si.uv));
        let (wo, wi) = (Vec3::lift(place.wo), Vec3::lift(wi));
        self.scene.materials()[index as usize].eval_component(&at, wo, wi, component, MODE)
    }
}

impl<P: Float> LocalFn<P> for Radiance<'_, P> {
    fn eval<R: Real<Primal = P>>(&self, theta: &Theta<R>) -> Rgb<R> {
        let &Self {
            scene,
            active,
            path,
        } = self;
        sweep(
            path,
            &mut Again {
                scene,
                active,
                theta,
            },
        )
    }
}

/// Adds the change of the gradient of `d_l . L` when the parameters move along `direction` and `d_l` changes by `change`:
/// nested duals over the recorded vertices, which stay where they are.
///
/// # Does not handle
/// Anything but detached samples with detached weights.
pub(super) fn pull_back_path<P: Float>(
    scene: &Scene,
    theta: &Theta<P>,
    active: &Active,
    path: &PathRecord<P>,
    direction: impl Fn(ParamRef, u32) -> P,
    [d_l, change]: [Rgb<P>; 2],
    grad: &mut impl GradSink<P>,
) {
    let mut texels = Texels::default();
    for place in path.vertices().iter().filter_map(|v| v.place.as_ref()) {
        let material = scene.shape_info(place.shape).material;
        texels.add_all(active.textures(material), place.si.uv, |p| {
            active.contains(p)
        });
    }
    for contribution in path.all_contributions() {
        let (emitter, uv) = match contribution {
            Contribution::Met(l) => (l.emitter, l.emission.uv),
            Contribution::Sampled(l) => (l.emitter, l.emission.uv),
            _ => continue,
        };
        let e = &scene.emitters()[emitter as usize];
        texels.add(TextureRef::Rgb(e.radiance()), uv, |p| active.contains(p));
        if let Some(scale) = e.scale().map(ScalarTexture::Constant) {
            texels.add(TextureRef::Scalar(&scale), uv, |p| active.contains(p));
        }
    }
    let radiance = Radiance {
        scene,
        active,
        path,
    };
    pull_back_second(&texels, theta, direction, &radiance, [d_l, change], grad);
}
