//! Where Dirac deltas go, as a function of where light comes from and of the surface.

use ad_core::{Real, Vec3};

use super::vertex::MODE;
use crate::bsdf::nesting::delta_leaf;
use crate::bsdf::{Bsdf, DeltaKind, Material, Shading};
use crate::manifold::constraint::{reflect, refract};
use crate::math::Rgb;

/// A Dirac delta of a material; the number says which part of nested materials it belongs to, as the `route` of a
/// [`Component`](crate::bsdf::Component).
pub(super) type Delta = (DeltaKind, u8);

/// The direction that a delta scatters `wo` into, and its weight ([`Bsdf::eval_delta`]), both directions in the frame of the
/// surface. `None` where the material has no such delta, or where it reflects nothing or totally.
///
/// # Derivatives
/// In `wo`, in theta and in the texture coordinates. Over plain numbers the direction is that of [`Bsdf::sample`], to rounding.
pub(super) fn scatter<R: Real>(
    material: &Material,
    at: &Shading<R>,
    wo: Vec3<R>,
    (kind, route): Delta,
) -> Option<(Vec3<R>, Rgb<R>)> {
    let normal = || material.shading_frame(at, wo.primal(), route, MODE).n;
    let behind = wo.z.primal() < R::Primal::zero();
    let wi = match kind {
        DeltaKind::Passthrough => -wo,
        DeltaKind::Reflection => reflect(wo, normal()),
        DeltaKind::Transmission => match delta_leaf(material, behind, route) {
            Material::ThinDielectric(_) => -wo,
            Material::Dielectric(glass) => {
                refract(wo, normal(), glass.eta.scalar(&at.theta, at.uv))?
            }
            _ => return None,
        },
    };
    let weight = material.eval_delta(at, wo, wi, kind, route, MODE);
    (!weight.is_black()).then_some((wi, weight))
}

#[cfg(test)]
mod tests {
    use ad_core::Vec2;

    use super::*;
    use crate::bsdf::Component;
    use crate::params::Theta;
    use crate::sampler::{Independent, Sampler};
    use crate::scene::Scene;

    /// Of materials with deltas, from both sides, in 300 directions each: the directions that are sampled, and their values.
    #[test]
    fn directions_are_those_that_are_sampled() {
        let mirror = r#"<bsdf type="conductor"/>"#;
        let glass = r#"<bsdf type="dielectric"/>"#;
        let tilted = |nested: &str| {
            format!(
                r#"<bsdf type="normalmap"><texture type="checkerboard" name="normalmap">
                <rgb name="color0" value="0.6, 0.45, 0.9"/><rgb name="color1" value="0.4, 0.55, 0.95"/></texture>{nested}</bsdf>"#
            )
        };
        let materials = [
            mirror.to_owned(),
            glass.to_owned(),
            r#"<bsdf type="thindielectric"/>"#.into(),
            r#"<bsdf type="plastic"/>"#.into(),
            r#"<bsdf type="null"/>"#.into(),
            tilted(mirror),
            tilted(glass),
            format!(r#"<bsdf type="twosided">{}</bsdf>"#, tilted(mirror)),
            format!(r#"<bsdf type="mask"><float name="opacity" value="0.4"/>{mirror}</bsdf>"#),
            format!(
                r#"<bsdf type="blendbsdf"><float name="weight" value="0.4"/>{glass}{mirror}</bsdf>"#
            ),
        ];
        for text in materials {
            let text = format!(
                r#"<scene version="3.0.0"><sensor type="perspective"/><shape type="sphere">{text}</shape></scene>"#
            );
            let scene = Scene::from_xml(&text, "".as_ref(), &Default::default());
            let scene = scene.unwrap_or_else(|e| panic!("{e}\n{text}")).0;
            let values: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
            let material = scene.material(0);
            let mut sampler = Independent::new(3, 0, 0);
            let mut met = 0;
            for _ in 0..300 {
                let mut next = || sampler.next_1d::<f64>();
                let at = Shading::new(Theta::constant(&values), Vec2::new(next(), next()));
                let wo = Vec3::new(next() - 0.5, next() - 0.5, next() - 0.5).normalize();
                let u = [next(), next(), next()];
                let Some((sample, f)) = material.sample_eval(&at, wo, u, MODE) else {
                    continue;
                };
                let Component::Delta { kind, route } = sample.component else {
                    continue;
                };
                let scattered = scatter(material, &at, wo, (kind, route));
                if f.is_black() {
                    assert!(scattered.is_none(), "{text}");
                    continue;
                }
                let (wi, weight) = scattered.unwrap_or_else(|| panic!("{kind:?}\n{text}"));
                assert!((wi - sample.wi).length() < 1e-9, "{kind:?}\n{text}");
                assert!((weight.g - f.g).abs() < 1e-9, "{kind:?}\n{text}");
                met += 1;
            }
            assert!(met > 20, "only {met}\n{text}");
        }
    }
}
