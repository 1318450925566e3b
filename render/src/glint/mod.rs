//! Glints: lights that the camera sees in smooth metal whose normals a fine map turns.
//!
//! A pixel sees many texels of such a map. Where the normal is the half vector between the view and a point on a light, there is
//! a glint; sampling finds it seldom. Here the solutions of that constraint are sought in texture space, inside the footprint of
//! the pixel's filter, by Newton's method on slopes ([`SlopeMap`]), with the estimators of [`crate::manifold`]: trial sets, or
//! trials for the reciprocal of a probability [Zeltner 2021, section 3.3.3].
//!
//! ```
//! use render::instances::{Estimator, render_f32};
//! use render::params::Theta;
//! use render::scene::{GlintMethod, Glints};
//! use render::{Image, Job, Scene, Settings, image_io::write_exr};
//!
//! // A plate of metal whose normals differ from texel to texel, under a small lamp.
//! let folder = tempfile::tempdir()?;
//! let mut normals = Image::new(32, 32);
//! for (i, n) in normals.data.chunks_exact_mut(3).enumerate() {
//!     let turn = 2.4 * i as f32;
//!     n.copy_from_slice(&[0.5 + 0.05 * turn.sin(), 0.5 + 0.05 * turn.cos(), 1.0]);
//! }
//! write_exr(&folder.path().join("normals.exr"), &normals)?;
//! let text = r#"<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="2"/></integrator>
//!     <sensor type="perspective"><float name="fov" value="40"/>
//!     <transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
//!     <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
//!     <shape type="rectangle"><bsdf type="normalmap"><texture type="bitmap" name="normalmap">
//!     <string name="filename" value="normals.exr"/><boolean name="raw" value="true"/></texture>
//!     <bsdf type="conductor"/></bsdf></shape>
//!     <shape type="sphere"><point name="center" value="0, 0, 5"/><float name="radius" value="0.3"/>
//!     <emitter type="area"><rgb name="radiance" value="9"/></emitter></shape></scene>"#;
//! let (scene, _warnings) = Scene::from_xml(text, folder.path(), &Default::default())?;
//! let glints = Some(Glints::new(GlintMethod::Unbiased));
//! let settings = Settings { glints, ..scene.settings };
//! let theta = Theta::constant(scene.params().values());
//! let found = render_f32(&Job::new(&scene, &settings, 0, 0..16, &()), &theta, Estimator::Mis);
//! assert!(found.glints.walks > 0 && found.image(0).data.iter().all(|v| v.is_finite()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The constraint
//! Slopes of half vector and normal agree, `h(t) = n(t)` over texel coordinates `t`. The published method takes `h` for a
//! constant. Here it is affine: ray differentials [Igehy 1999] say how view, light and the surface's own frame turn across the
//! footprint, so that a flat map on a curved surface is no singular case. What is left out is of second order in the size of
//! the footprint: where a surface curves much within a pixel, that is searched in parts ([`Part`]).
//!
//! A solution at `t*` brings `h(x*) F L / (p q s)`, with the pixel's filter `h`, the reflectance `F`, the radiance `L` of a point
//! on a light with density `p` per solid angle, the probability `q` that this part of the pixel and this cell are searched, and
//! the solid angle `s` that a square pixel's reflections cover there: `|det d(h - n)/dx|` over the slopes of half vectors per
//! solid angle.
//!
//! # Where walks start
//! In one cell between texels, whose slopes are bilinear. It is drawn down a pyramid of the moments of slopes, those of a MIP map
//! [Olano and Baker 2010], by how well they fit the half vector, so that a footprint may cover any part of the map, or copies of
//! it: far off, moments decide where to look, and nothing is filtered. Or anywhere in the footprint, as published.
//!
//! # Who finds what
//! Paths leave out light that they meet behind a first vertex on a glinty shape ([`crate::manifold::Split`]). It is found here
//! by two techniques, walks and scattered directions, which are weighed: by the densities with which either finds the same
//! path, `q p s` and that of the filter, or by the published ones of directions, from moments. Whatever weights, they are
//! functions of the path alone and add up to one, so that all light is counted once.
//!
//! # Memory
//! The map, and moments of every level but the finest: [`SlopeMap::bytes`].
//!
//! # Does not handle
//! Glints behind other vertices than the first, rough metal, maps that are no images, and light over several reflections: all of
//! it is ordinary paths'. Derivatives in what moves glints: they are refused by name.

mod find;
mod footprint;
mod map;
mod parts;
mod search;
mod walk;

pub use find::{Drawn, Finder, Glint};
pub use footprint::{Footprint, Part};
pub use map::{Moments, SlopeMap};
pub use parts::Pixel;

use crate::bsdf::nesting::{Microfacets, Specular, facets};
use crate::bsdf::{Material, NormalMap};
use crate::manifold::chosen;
use crate::scene::Scene;
use crate::shape::AnyShape;

#[cfg(test)]
mod tests;

fn is_smooth_metal(material: &Material) -> bool {
    let mirror = |f: Microfacets| matches!(f.specular, Specular::Mirror) && f.roughness.is_none();
    facets(material).is_some_and(mirror)
}

/// The normal map of smooth metal, as it is seen from the front or from behind. `None` for what is none.
pub fn mapped_metal(material: &Material, behind: bool) -> Option<&NormalMap> {
    match material {
        Material::NormalMap(m) => {
            let fits = is_smooth_metal(m.nested())
                && !matches!(&**m.nested(), Material::NormalMap(_))
                && SlopeMap::fits(m);
            fits.then_some(m)
        }
        Material::TwoSided(m) => match &*m.sides()[usize::from(behind)] {
            inside @ Material::NormalMap(_) => mapped_metal(inside, false),
            _ => None,
        },
        _ => None,
    }
}

/// Which shapes glints are looked for on, by index: those of smooth metal under a normal map, or, where the scene file flags any
/// of them as `glinty`, these alone. Not on curves, whose glints are found by paths. `None` if there is none.
pub fn glinty_shapes(scene: &Scene) -> Option<Vec<bool>> {
    let shapes = 0..scene.shapes().len() as u32;
    let able = |shape: u32| {
        let material = scene.material(shape);
        let is_curve = matches!(scene.shapes()[shape as usize], AnyShape::Curves(_));
        mapped_metal(material, false).is_some() && is_smooth_metal(material) && !is_curve
    };
    let flagged = |i: usize| scene.shape_info(i as u32).hints.glinty;
    let chosen = chosen(shapes.map(able).collect(), flagged);
    chosen.contains(&true).then_some(chosen)
}
