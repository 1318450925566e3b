//! What materials made of other materials share.

use std::sync::Arc;

use ad_core::{Float, Real, Vec3};

use super::{Bsdf, Leaf, Material, Roughness, Shading, TextureRef};
use crate::error::SceneError;
use crate::params::{ParamRef, Params};
use crate::plugin::Node;
use crate::texture::{ScalarTexture, Texture};

/// How many levels materials may nest: one bit each in the `route` of a delta.
pub const MAX_LEVELS: u32 = 8;

/// Smallest probability of choosing either of two parts. At a weight of exactly 0 or 1 one part is
/// invisible, but the derivative with respect to the weight still needs it (errata F7).
pub(super) const LEAST_CHOICE: f64 = 0.05;

/// Probability of choosing the second of two parts that are mixed with the weight `w`: primal, as every
/// discrete decision.
#[inline]
pub(crate) fn choice<R: Real>(w: R) -> R::Primal {
    attached_choice(w.primal())
}

/// [`choice`] with the tangents of the weight, for [`Bsdf::choice_pdf`].
#[inline]
pub(super) fn attached_choice<R: Real>(w: R) -> R {
    let w = w.max(R::zero()).min(R::one());
    R::of(LEAST_CHOICE) + w * R::c(1.0 - 2.0 * LEAST_CHOICE)
}

/// Whether `u` chooses the second part, and `u` stretched over [0, 1) again.
#[inline(always)]
pub(crate) fn choose<P: Float>(u: P, second: P) -> (bool, P) {
    let first = P::one() - second;
    let below_one = P::one() - P::EPSILON;
    let below = u < first;
    let part = P::select(below, u, u - first);
    let whole = P::select(below, first, second);
    (!below, (part / whole).min(below_one))
}

/// The materials that `material` is made of.
fn children(material: &Material) -> &[Arc<Material>] {
    match material {
        Material::TwoSided(m) => m.sides(),
        Material::Blend(m) => m.parts(),
        Material::Mask(m) => std::slice::from_ref(m.nested()),
        Material::NormalMap(m) => std::slice::from_ref(m.nested()),
        Material::BumpMap(m) => std::slice::from_ref(m.nested()),
        Material::Charted(m) => std::slice::from_ref(m.nested()),
        _ => &[],
    }
}

/// Levels of nesting; a leaf has none.
pub fn levels(material: &Material) -> u32 {
    if let Material::Charted(m) = material {
        return levels(m.nested());
    }
    let deepest = children(material).iter().map(|m| levels(m)).max();
    deepest.map_or(0, |n| n + 1)
}

/// Whether any part of the material is a delta.
pub fn has_delta(material: &Material) -> bool {
    match children(material) {
        [] => material.is_delta(),
        parts => parts.iter().any(|m| has_delta(m)),
    }
}

/// Whether some directions that it scatters are Dirac deltas: also where others are not, and straight through holes.
pub fn scatters_deltas(material: &Material) -> bool {
    let mixed = matches!(material, Material::Plastic(_) | Material::Mask(_));
    mixed
        || match children(material) {
            [] => material.is_delta(),
            parts => parts.iter().any(|m| scatters_deltas(m)),
        }
}

/// The part of a material that a delta belongs to, seen from behind or not, by the `route` of its
/// [`Component`](super::Component); that of the hole of a mask is what is around it.
pub(crate) fn delta_leaf(material: &Material, behind: bool, route: u8) -> &Material {
    match material {
        Material::TwoSided(m) => delta_leaf(&m.sides()[usize::from(behind)], false, route),
        Material::Blend(m) => delta_leaf(&m.parts()[usize::from(route & 1)], behind, route >> 1),
        Material::Mask(m) => delta_leaf(m.nested(), behind, route >> 1),
        _ => match children(material) {
            [nested] => delta_leaf(nested, behind, route),
            _ => material,
        },
    }
}

/// Checks that the derivatives of all textures of a material have room.
///
/// # Errors
/// A leaf that reads more than it may, with the name of its first parameter.
pub fn check_textures(material: &Material, params: &Params) -> Result<(), SceneError> {
    match children(material) {
        [] => check_leaf(material, params),
        parts => parts.iter().try_for_each(|m| check_textures(m, params)),
    }
}

fn check_leaf(leaf: &impl Bsdf, params: &Params) -> Result<(), SceneError> {
    let most = leaf.most_textures();
    let mut found = 0;
    let mut first = None;
    leaf.visit_textures(&mut |t| {
        found += if matches!(t, TextureRef::Mixed(_)) {
            3
        } else {
            1
        };
        t.visit_params(&mut |p| {
            first.get_or_insert(p.id);
        });
    });
    if found <= most {
        return Ok(());
    }
    let name = first.map(|id| params.infos()[id as usize].name.clone());
    Err(SceneError::Parameter {
        key: name.unwrap_or_else(|| "bsdf".into()),
        expected: format!("a material that reads at most {most} textures"),
        found: found.to_string(),
    })
}

/// Calls `f` with every range that a sampled direction is a Dirac delta in: the index of smooth glass, and normals that
/// tilt anything smooth.
pub fn visit_deltas(material: &Material, f: &mut dyn FnMut(ParamRef)) {
    match material {
        Material::Dielectric(m) => m.eta.visit_params(f),
        Material::NormalMap(m) if has_delta(material) => {
            m.visit_tilt(&mut |t| t.visit_params(f));
        }
        Material::BumpMap(m) if has_delta(material) => {
            m.visit_tilt(&mut |t| t.visit_params(f));
        }
        _ => {}
    }
    for m in children(material) {
        visit_deltas(m, f);
    }
}

/// Whether it reflects or transmits more in some directions than in others: anything but diffuse reflection.
/// Such surfaces throw caustics.
pub fn is_glossy(material: &Material) -> bool {
    match (material, children(material)) {
        (Material::Mask(_), _) => true,
        (_, []) => !matches!(material, Material::Diffuse(_)),
        (_, parts) => parts.iter().any(|m| is_glossy(m)),
    }
}

/// Whether it matters how the axes of a surface lie around its normal: to what is brushed, to fibres, and to normals that
/// are mapped.
pub fn reads_axes(material: &Material) -> bool {
    let itself = matches!(
        material,
        Material::AnisotropicConductor(_)
            | Material::AnisotropicDielectric(_)
            | Material::AnisotropicPrincipled(_)
            | Material::AnisotropicThin(_)
            | Material::Hair(_)
            | Material::NormalMap(_)
            | Material::BumpMap(_)
    );
    itself || children(material).iter().any(|m| reads_axes(m))
}

/// Whether some light goes on behind it.
pub fn lets_light_through(material: &Material) -> bool {
    match (material, children(material)) {
        (Material::Mask(_), _) => true,
        (Material::PrincipledThin(m), _) => m.lets_light_through(),
        (Material::AnisotropicThin(m), _) => m.lets_light_through(),
        (_, []) => !material.is_opaque(),
        (_, parts) => parts.iter().any(|m| lets_light_through(m)),
    }
}

/// The share of a material that is there, seen along `wo` in the local frame: less than one where light passes straight
/// through holes or panes.
pub fn opacity<P: Float>(material: &Material, at: &Shading<P>, wo: Vec3<P>) -> P {
    match material {
        Material::Null(_) => P::zero(),
        Material::ThinDielectric(m) => m.lobe(&mut &*at).opacity(wo),
        Material::Mask(m) => m.opacity(at) * opacity(m.nested(), at, wo),
        Material::Blend(m) => {
            let shares = m.shares(at);
            (m.parts().iter().zip(shares)).fold(P::zero(), |sum, (part, share)| {
                sum + opacity(part, at, wo) * share
            })
        }
        Material::NormalMap(m) => opacity(m.nested(), at, wo),
        Material::BumpMap(m) => opacity(m.nested(), at, wo),
        Material::Charted(m) => opacity(m.nested(), &m.inside(at), wo),
        Material::TwoSided(m) => {
            let behind = wo.z < P::zero();
            opacity(&m.sides()[usize::from(behind)], at, wo)
        }
        _ => P::one(),
    }
}

/// What a facet does to light.
#[derive(Clone, Copy, Debug)]
pub enum Specular<'a> {
    /// It reflects.
    Mirror,
    /// It reflects and refracts; the index below over that above.
    Interface(&'a ScalarTexture),
}

/// A surface of facets that all do the same to light.
#[derive(Clone, Copy, Debug)]
pub struct Microfacets<'a> {
    /// What a facet does.
    pub specular: Specular<'a>,
    /// How their normals are spread, the same everywhere; `None` where the surface is smooth.
    pub roughness: Option<&'a Roughness>,
}

/// Of metal and glass, smooth or of one roughness everywhere, be its normals mapped or both of its sides metal of equal
/// roughness. `None` for everything else: also for what is metal or glass in parts only, blended or masked.
pub fn facets(material: &Material) -> Option<Microfacets<'_>> {
    let smooth = |specular| {
        Some(Microfacets {
            specular,
            roughness: None,
        })
    };
    let rough = |specular, roughness| {
        let even = matches!(
            roughness,
            &Roughness {
                alpha: Texture::Constant(_),
                ..
            }
        );
        even.then_some(Microfacets {
            specular,
            roughness: Some(roughness),
        })
    };
    match material {
        Material::Conductor(_) => smooth(Specular::Mirror),
        Material::Dielectric(m) => smooth(Specular::Interface(&m.eta)),
        Material::RoughConductor(m) => rough(Specular::Mirror, &m.roughness),
        Material::RoughDielectric(m) => rough(Specular::Interface(&m.eta), &m.roughness),
        Material::NormalMap(m) => facets(m.nested()),
        Material::TwoSided(m) => {
            let mut sides = m.sides().iter().map(|side| facets(side));
            let first = sides.next()??;
            let mirror = |f: &Microfacets| matches!(f.specular, Specular::Mirror);
            let alike = |f: Option<Microfacets>| {
                f.is_some_and(|f| mirror(&f) && equally_rough(f.roughness, first.roughness))
            };
            (mirror(&first) && sides.all(alike)).then_some(first)
        }
        _ => None,
    }
}

/// Whether two surfaces have the same distribution of facets, whatever parameters become.
fn equally_rough(a: Option<&Roughness>, b: Option<&Roughness>) -> bool {
    match (a, b) {
        (None, None) => true,
        (Some(a), Some(b)) => {
            let of = |r: &Roughness| match &r.alpha {
                Texture::Constant(p) => Some(p.id),
                _ => None,
            };
            a.kind == b.kind && of(a).is_some() && of(a) == of(b)
        }
        _ => false,
    }
}

/// Whether a part has normals that follow from heights which are not the same everywhere: those of the material need the
/// chart of the surface.
pub(crate) fn is_bumped(material: &Material) -> bool {
    let own =
        matches!(material, Material::BumpMap(m) if !matches!(m.height(), Texture::Constant(_)));
    own || children(material).iter().any(|m| is_bumped(m))
}

/// Whether any part flips normals to the viewer, as [`super::Corrections::flip`] says: light tracers
/// do not, and disagree with path tracers there.
pub fn flips_normals(material: &Material) -> bool {
    let own = match material {
        Material::NormalMap(m) => m.corrections().flip,
        Material::BumpMap(m) => m.corrections().flip,
        _ => false,
    };
    own || children(material).iter().any(|m| flips_normals(m))
}

/// Checks that one more level around `parts` is allowed.
pub(super) fn check_levels(parts: &[Arc<Material>]) -> Result<(), SceneError> {
    let inside = parts.iter().map(|m| levels(m)).max().unwrap_or(0);
    if inside < MAX_LEVELS {
        return Ok(());
    }
    Err(SceneError::Parameter {
        key: "bsdf".into(),
        expected: format!("materials nested at most {MAX_LEVELS} levels deep"),
        found: format!("{} levels", inside + 1),
    })
}

/// The nested materials of `node`, of which there must be from `least` to `most`.
pub(super) fn nested_nodes(
    node: &Node,
    least: usize,
    most: usize,
) -> Result<Vec<&Arc<Node>>, SceneError> {
    let nodes = node.children_with_tag("bsdf");
    let expected = match (least, most) {
        (1, 1) => "one nested <bsdf>",
        (2, 2) => "two nested <bsdf>",
        _ => "one or two nested <bsdf>",
    };
    if nodes.len() < least {
        return Err(node.missing("bsdf", expected));
    }
    match nodes.get(most) {
        None => Ok(nodes),
        Some(extra) => Err(SceneError::Value {
            location: extra.location.clone(),
            key: node.plugin.clone(),
            expected: expected.into(),
            found: format!("{} of them", nodes.len()),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::{DiffuseLobe, Leaf, MAX_SLOTS, Reader};
    use crate::math::Rgb;
    use crate::plugin::Registry;
    use crate::texture::RgbTexture;

    /// The mean of many albedos.
    struct Layers(Vec<RgbTexture>);

    impl Leaf for Layers {
        type Lobe<R: Real> = DiffuseLobe<R>;

        fn lobe<R: Real>(&self, read: &mut impl Reader<R>) -> DiffuseLobe<R> {
            let sum = |sum: Rgb<R>, t| sum + read.rgb(t);
            let sum = self.0.iter().fold(Rgb::black(), sum);
            DiffuseLobe {
                reflectance: sum * R::of(1.0 / self.0.len() as f64),
            }
        }
    }

    #[test]
    fn more_textures_than_there_is_room_for_are_refused_by_name() {
        for n in [MAX_SLOTS, MAX_SLOTS + 1] {
            let mut build = Registry::default();
            let layer = |i| build.rgb(&format!("coat.layer{i}.value"), [0.5; 3], (0.0, 1.0));
            let layers = (0..n).map(layer).collect::<Result<_, _>>().unwrap();
            let found = check_leaf(&Layers(layers), build.params());
            if n == MAX_SLOTS {
                assert!(found.is_ok());
            } else {
                let error = found.unwrap_err().to_string();
                assert!(error.contains("coat.layer0.value"), "{error}");
                assert!(
                    error.contains("at most 4") && error.contains('5'),
                    "{error}"
                );
            }
        }
    }
}
