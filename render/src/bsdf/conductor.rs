//! Smooth conductors: mirrors, coloured by their complex index of refraction.

use ad_core::{Float, Real, Vec3};

use super::dielectric::index;
use super::metals::{self, METALS};
use super::{BsdfSample, Component, DeltaKind, Leaf, Lobe, Reader, TransportMode, fresnel};
use crate::error::SceneError;
use crate::math::Rgb;
use crate::plugin::{FromNode, Node, Registry};
use crate::texture::RgbTexture;

/// The reflectance of a conducting surface as a function of angle.
#[derive(Clone, Debug)]
pub struct Conductor {
    /// Factor on the reflectance, in [0, 1]; 1 is physical.
    pub specular_reflectance: RgbTexture,
    /// Complex index of refraction; without one, everything is reflected.
    pub index: Option<ConductorIndex>,
}

/// Complex index of refraction `eta + i k`, relative to the outside.
#[derive(Clone, Debug)]
pub struct ConductorIndex {
    /// Real part, not negative.
    pub eta: RgbTexture,
    /// Imaginary part, not negative.
    pub k: RgbTexture,
}

impl ConductorIndex {
    /// Makes an index that is one against vacuum one against something else: the same everywhere, as others may read the
    /// texels of an image.
    fn divide(&self, outside: f64, registry: &mut Registry) -> Result<(), &'static str> {
        for texture in [&self.eta, &self.k] {
            let RgbTexture::Constant(p) = texture else {
                return Err("none beside textures of `eta` or `k`");
            };
            let params = registry.params_mut();
            let range = params.infos()[p.id as usize].range();
            for value in &mut params.values_mut()[range] {
                *value = (f64::from(*value) / outside) as f32;
            }
        }
        Ok(())
    }
}

/// A mirror; also the reflectance of a microfacet of a rough conductor.
#[derive(Clone, Copy, Debug)]
pub struct ConductorLobe<R> {
    /// Factor on the reflectance.
    pub specular_reflectance: Rgb<R>,
    /// Real and imaginary part of the index.
    pub index: Option<[Rgb<R>; 2]>,
}

impl<R: Real> ConductorLobe<R> {
    /// The same values without tangents.
    #[inline]
    pub fn primal(&self) -> ConductorLobe<R::Primal> {
        ConductorLobe {
            specular_reflectance: self.specular_reflectance.primal(),
            index: self.index.map(|[eta, k]| [eta.primal(), k.primal()]),
        }
    }

    /// Reflectance under the angle whose cosine is `cos`.
    #[inline]
    pub fn reflectance(&self, cos: R) -> Rgb<R> {
        match self.index {
            None => self.specular_reflectance,
            Some([eta, k]) => {
                let f = |eta, k| fresnel::conductor(cos, eta, k);
                self.specular_reflectance * Rgb::new(f(eta.r, k.r), f(eta.g, k.g), f(eta.b, k.b))
            }
        }
    }
}

impl<P: Float> ConductorLobe<P> {
    /// [`ConductorLobe::reflectance`] of those that have an index or do not, without a branch.
    #[inline(always)]
    pub(super) fn reflectance_in_line(&self, has_index: bool, cos: P) -> Rgb<P> {
        let [eta, k] = self.index.unwrap_or([Rgb::black(); 2]);
        let f = |eta, k| {
            let [r_s, r_p] = fresnel::conductor_in_line(cos, eta, k);
            (r_s + r_p) * P::of(0.5)
        };
        let fresnel = Rgb::new(f(eta.r, k.r), f(eta.g, k.g), f(eta.b, k.b));
        let all = self.specular_reflectance;
        let some = all * fresnel;
        Rgb::new(
            P::select(has_index, some.r, all.r),
            P::select(has_index, some.g, all.g),
            P::select(has_index, some.b, all.b),
        )
    }
}

impl Leaf for Conductor {
    type Lobe<R: Real> = ConductorLobe<R>;
    const DELTA: bool = true;

    #[inline]
    fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> ConductorLobe<R> {
        ConductorLobe {
            specular_reflectance: read.rgb(&self.specular_reflectance),
            index: self
                .index
                .as_ref()
                .map(|i| [read.rgb(&i.eta), read.rgb(&i.k)]),
        }
    }
}

impl<R: Real> Lobe<R> for ConductorLobe<R> {
    #[inline]
    fn eval(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> Rgb<R> {
        Rgb::black()
    }

    #[inline]
    fn pdf(&self, _wo: Vec3<R>, _wi: Vec3<R>, _mode: TransportMode) -> R {
        R::zero()
    }

    #[inline]
    fn sample(
        &self,
        wo: Vec3<R>,
        _u: [R::Primal; 3],
        _mode: TransportMode,
    ) -> Option<BsdfSample<R>> {
        (wo.z.primal() > R::Primal::zero()).then(|| BsdfSample {
            wi: Vec3::new(-wo.x, -wo.y, wo.z),
            pdf: R::one(),
            component: Component::Delta {
                kind: DeltaKind::Reflection,
                route: 0,
            },
            eta: R::Primal::one(),
        })
    }

    #[inline]
    fn eval_delta(&self, wo: Vec3<R>, kind: DeltaKind, _mode: TransportMode) -> Rgb<R> {
        if kind == DeltaKind::Reflection && wo.z.primal() > R::Primal::zero() {
            self.reflectance(wo.z)
        } else {
            Rgb::black()
        }
    }
}

impl FromNode for Conductor {
    const PLUGINS: &'static [&'static str] = &["conductor"];

    /// `specular_reflectance` (1), and either `material` (a metal's name, or `none`: the default)
    /// or `eta` (0) and `k` (1), all relative to the index outside, `ext_eta` (1).
    fn from_node(node: &Node, registry: &mut Registry) -> Result<Self, SceneError> {
        let specular_reflectance =
            registry.rgb_texture(node, "specular_reflectance", [1.0; 3], (0.0, 1.0))?;
        let named = match node.string("material")?.and_then(metals::named) {
            Some(metal) => Some(metal),
            None => node.choice("material", METALS)?,
        };
        let explicit = node.has("eta") || node.has("k");
        if explicit && node.has("material") {
            return Err(node.invalid("material", "either `material`, or `eta` and `k`"));
        }
        let given = node.has("ext_eta");
        let outside = given.then(|| index(node, "ext_eta", "air")).transpose()?;
        let default = match named.flatten() {
            None if !explicit => {
                return Ok(Self {
                    specular_reflectance,
                    index: None,
                });
            }
            None => [[0.0; 3], [1.0; 3]],
            Some(index) => index,
        };
        let valid = (0.0, f64::INFINITY);
        let of = ConductorIndex {
            eta: registry.rgb_texture(node, "eta", default[0], valid)?,
            k: registry.rgb_texture(node, "k", default[1], valid)?,
        };
        if let Some(outside) = outside {
            of.divide(outside, registry)
                .map_err(|expected| node.invalid("ext_eta", expected))?;
        }
        Ok(Self {
            specular_reflectance,
            index: Some(of),
        })
    }
}
