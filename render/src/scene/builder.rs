//! Scenes made by code, and the common part of scenes made from files.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use ad_core::Vec3;

use super::{PixelShares, Scene, Settings, ShapeInfo, Shares};
use crate::accel::{self, Accel, AccelError, Hit, MAX_COORDINATE, Plane, Primitive};
use crate::bsdf::nesting::{check_textures, flips_normals, is_glossy, visit_deltas};
use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::camera::Camera;
use crate::emitter::{AnyEmitter, Ball, Emitter};
use crate::error::SceneError;
use crate::film::Film;
use crate::math::{NOWHERE, Ray};
use crate::params::{ParamKind, Params};
use crate::plugin::Registry;
use crate::shape::{AnyShape, Exit, Prim, Shape};
use crate::texture::{RgbTexture, ScalarTexture, Texture};

/// Index of a material in the builder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaterialId(u32);

/// Collects materials, shapes, emitters and parameters, and checks them as they come.
///
/// ```
/// use render::bsdf::Diffuse;
/// use render::camera::{Camera, FovAxis};
/// use render::emitter::Constant;
/// use render::math::Transform;
/// use render::scene::Builder;
/// use render::shape::Sphere;
/// use render::{Film, Settings};
///
/// let mut build = Builder::new();
/// let reflectance = build.rgb("clay.reflectance.value", [0.6, 0.4, 0.3], (0.0, 1.0))?;
/// let clay = build.add_material(Diffuse { reflectance });
/// let ball = Sphere::new([0.0, 0.0, 0.0], 1.0, false).expect("a positive radius");
/// build.add_shape("ball", ball, clay);
/// let radiance = build.rgb("sky.radiance.value", [1.0; 3], (0.0, f64::INFINITY))?;
/// build.add_emitter(Constant { radiance }, None);
///
/// let view = Transform::look_at([0.0, 0.0, 4.0], [0.0; 3], [0.0, 1.0, 0.0]).expect("a direction");
/// let camera = Camera::new(view, 40.0, FovAxis::Smaller, [32, 32])?;
/// let scene = build.build(camera, Film::new(32, 32), Settings::default())?;
/// let names: Vec<_> = scene.params().infos().iter().map(|p| p.name.as_str()).collect();
/// assert_eq!(names, ["clay.reflectance.value", "sky.radiance.value"]);
/// # Ok::<(), render::SceneError>(())
/// ```
#[derive(Debug, Default)]
pub struct Builder {
    registry: Registry,
    materials: Vec<Arc<Material>>,
    /// Where each of them stands.
    indices: HashMap<*const Material, u32>,
    shapes: Vec<AnyShape>,
    infos: Vec<ShapeInfo>,
    emitters: Vec<AnyEmitter>,
    /// How often each is sampled, relative to the others.
    weights: Vec<f64>,
}

/// This many lamps, or things that throw caustics, have a ball of their own, at most.
const MOST_BALLS: usize = 16;

/// How far rays start off a curved surface, relative to its largest coordinate: 64 roundings of an f32.
const RELATIVE_OFFSET: f32 = 64.0 * f32::EPSILON / 2.0;

/// How far a light stands out from what else lies on its plane, in roundings of the scene's coordinates: more than
/// distances err by.
const STANDS_OUT: f64 = 16.0;

impl Builder {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// The parameters so far.
    pub fn params(&self) -> &Params {
        self.registry.params()
    }

    /// Where plugins put their parameters.
    pub fn registry(&mut self) -> &mut Registry {
        &mut self.registry
    }

    /// [`Registry::rgb`].
    ///
    /// # Errors
    /// A channel outside `valid`.
    pub fn rgb(
        &mut self,
        name: &str,
        value: [f64; 3],
        valid: (f64, f64),
    ) -> Result<RgbTexture, SceneError> {
        self.registry.rgb(name, value, valid)
    }

    /// [`Registry::scalar`].
    ///
    /// # Errors
    /// A value outside `valid`.
    pub fn scalar(
        &mut self,
        name: &str,
        value: f64,
        valid: (f64, f64),
    ) -> Result<ScalarTexture, SceneError> {
        self.registry.scalar(name, value, valid)
    }

    /// [`Registry::texels`].
    ///
    /// # Errors
    /// A wrong number of texels, or one outside `valid`.
    pub fn texels<const C: usize>(
        &mut self,
        name: &str,
        size: [u32; 2],
        texels: &[f32],
        valid: (f64, f64),
    ) -> Result<Texture<C>, SceneError> {
        self.registry.texels(name, size, texels, valid)
    }

    /// Adds a material.
    pub fn add_material(&mut self, material: impl Into<Material>) -> MaterialId {
        self.add_shared_material(Arc::new(material.into()))
    }

    /// Adds a material that may be part of others as well.
    pub fn add_shared_material(&mut self, material: Arc<Material>) -> MaterialId {
        let next = self.materials.len() as u32;
        // Kept in `materials`, so that no other comes to lie there.
        let known = self.indices.entry(Arc::as_ptr(&material));
        let index = *known.or_insert(next);
        if index == next {
            self.materials.push(material);
        }
        MaterialId(index)
    }

    /// Adds a shape.
    pub fn add_shape(
        &mut self,
        name: &str,
        shape: impl Into<AnyShape>,
        material: MaterialId,
    ) -> u32 {
        let shape = shape.into();
        let index = self.shapes.len() as u32;
        self.infos.push(ShapeInfo {
            name: name.into(),
            material: material.0,
            delta: self.materials[material.0 as usize].is_delta(),
            glossy: is_glossy(&self.materials[material.0 as usize]),
            emitter: None,
        });
        self.shapes.push(shape);
        index
    }

    /// The shapes so far.
    pub(super) fn shapes(&self) -> &[AnyShape] {
        &self.shapes
    }

    /// Adds an emitter that is no surface, or is the last shape added if `shape` says so.
    pub fn add_emitter(&mut self, emitter: impl Into<AnyEmitter>, shape: Option<u32>) {
        self.add_weighted_emitter(emitter.into(), shape, 1.0);
    }

    /// [`Builder::add_emitter`] with its sampling weight, a positive number.
    pub(super) fn add_weighted_emitter(
        &mut self,
        emitter: AnyEmitter,
        shape: Option<u32>,
        weight: f64,
    ) {
        let index = self.emitters.len() as u32;
        self.emitters.push(emitter);
        self.weights.push(weight);
        if let Some(shape) = shape {
            self.infos[shape as usize].emitter = Some(index);
        }
    }

    /// Checks the whole and builds the acceleration structure.
    ///
    /// # Errors
    /// Geometry that is not finite, or a material that reads more textures than there is room for.
    pub fn build(
        mut self,
        camera: Camera,
        film: Film,
        settings: Settings,
    ) -> Result<Scene, SceneError> {
        for (shape, info) in self.shapes.iter_mut().zip(&self.infos) {
            let mut mapped = info.emitter.is_some_and(|e| {
                let radiance = self.emitters[e as usize].radiance();
                !matches!(radiance, Texture::Constant(_))
            });
            self.materials[info.material as usize]
                .visit_textures(&mut |t| mapped |= !t.is_constant());
            if !mapped {
                shape.skip_uv();
            }
        }
        for m in &self.materials {
            check_textures(m, self.registry.params())?;
            let params = self.registry.params_mut();
            m.visit_textures(&mut |t| match t {
                TextureRef::Alpha(t) | TextureRef::Exponent(t) => {
                    t.visit_params(&mut |p| params.mark(p, ParamKind::Roughness));
                }
                TextureRef::Vector(t) | TextureRef::Encoded(t) => {
                    t.visit_params(&mut |p| params.mark(p, ParamKind::Normals));
                }
                TextureRef::Rgb(_) | TextureRef::Scalar(_) => {}
            });
            visit_deltas(m, &mut |p| params.mark(p, ParamKind::Delta));
        }
        for e in &self.emitters {
            let params = self.registry.params_mut();
            (e.radiance()).visit_params(&mut |p| params.mark(p, ParamKind::Emission));
        }
        let (mut prims, mut patches) = (Vec::new(), Vec::new());
        let mut primitives = Vec::new();
        let mut firsts = Vec::with_capacity(self.shapes.len());
        for (i, shape) in self.shapes.iter().enumerate() {
            firsts.push(prims.len() as u32);
            let curved = Exit {
                offset: (shape.extent() * RELATIVE_OFFSET).max(f32::MIN_POSITIVE),
                ..Exit::default()
            };
            for (local, primitive) in shape.primitives().into_iter().enumerate() {
                let patch = shape.patch(local as u32);
                prims.push(Prim {
                    shape: i as u32,
                    local: local as u32,
                    patch: patch.map_or(u32::MAX, |_| patches.len() as u32),
                    surface: NOWHERE,
                    exit: curved,
                });
                patches.extend(patch.copied());
                primitives.push(primitive);
            }
        }
        let emits = |i: usize| self.infos[prims[i].shape as usize].emitter.is_some();
        let surfaces = accel::surfaces(&primitives, emits);
        raise_lights(
            &mut primitives,
            &prims,
            &surfaces,
            &self.shapes,
            &camera,
            emits,
        );
        let accel = Accel::with_surfaces(&primitives, &surfaces).map_err(|e| match e {
            AccelError::Coordinate { primitive, .. } => {
                let shape = prims[primitive].shape as usize;
                out_of_reach(&self.infos[shape].name, &e)
            }
            AccelError::TooMany { .. } => out_of_reach("geometry", &e),
        })?;
        for ((prim, primitive), &surface) in prims.iter_mut().zip(&primitives).zip(&surfaces) {
            prim.surface = surface;
            if let Some(plane) = Plane::of(primitive) {
                prim.exit = Exit {
                    offset: plane.offset(),
                    surface,
                };
            }
        }
        let mut emitters = self.emitters;
        for e in &mut emitters {
            e.update(self.registry.params());
        }
        let infinite: Vec<u32> = (0..emitters.len() as u32)
            .filter(|&i| emitters[i as usize].is_infinite())
            .collect();
        let lamps = if infinite.is_empty() {
            balls(&self.shapes, &self.infos, |i| i.emitter.is_some())
        } else {
            None
        };
        let flips = self.materials.iter().any(|m| flips_normals(m));
        let lit_things = self.infos.iter().any(|i| !i.glossy) && !emitters.is_empty();
        let casters = if lit_things && !flips {
            balls(&self.shapes, &self.infos, |i| i.glossy).unwrap_or_default()
        } else {
            Vec::new()
        };
        Ok(Scene {
            params: self.registry.into_params(),
            materials: self.materials,
            shapes: self.shapes,
            infos: self.infos,
            emitters,
            infinite,
            shares: Shares::new(&self.weights),
            pixels: PixelShares::default(),
            guide: None,
            casters,
            lamps,
            prims,
            firsts,
            patches,
            accel,
            files: Vec::new(),
            camera,
            film,
            settings,
        })
    }
}

/// Lets lights that share their plane with something else stand out from it on the side that emits, for rays: they are
/// met first wherever they come from, whichever stands first in the scene.
fn raise_lights(
    primitives: &mut [Primitive],
    prims: &[Prim],
    surfaces: &[u32],
    shapes: &[AnyShape],
    camera: &Camera,
    emits: impl Fn(usize) -> bool,
) {
    // Surfaces that something dark lies on.
    let dark: HashSet<u32> = (0..prims.len())
        .filter(|&i| !emits(i))
        .map(|i| surfaces[i])
        .collect();
    let shared = |i: &usize| emits(*i) && dark.contains(&surfaces[*i]);
    let raised: Vec<usize> = (0..prims.len()).filter(shared).collect();
    if raised.is_empty() {
        return;
    }
    let mut reach = camera.origin().map(f64::abs);
    for p in &*primitives {
        let [low, high] = accel::bounds(p);
        for k in 0..3 {
            reach[k] = reach[k].max(f64::from(low[k].abs().max(high[k].abs())));
        }
    }
    for i in raised {
        let Some(plane) = Plane::of(&primitives[i]) else {
            continue;
        };
        let Prim { shape, local, .. } = prims[i];
        let anywhere = Hit {
            t: 1.0,
            u: 0.25,
            v: 0.25,
            prim: i as u32,
        };
        let along = Ray::new(Vec3::zero(), Vec3::new(0.0f32, 0.0, 1.0));
        let outside = shapes[shape as usize].interaction(local, &along, &anywhere);
        let normal = plane.normal;
        let same = f64::from(outside.n_geo.x) * normal[0]
            + f64::from(outside.n_geo.y) * normal[1]
            + f64::from(outside.n_geo.z) * normal[2];
        let by = STANDS_OUT * accel::scale(normal, reach) * same.signum();
        let (Primitive::Triangle { v0: at, .. }
        | Primitive::Parallelogram { v0: at, .. }
        | Primitive::Disk { center: at, .. }) = &mut primitives[i]
        else {
            continue;
        };
        for k in 0..3 {
            at[k] = (f64::from(at[k]) + by * normal[k]) as f32;
        }
    }
}

/// Balls around these shapes, or one around all of them if there are many. `None` if one has no extent in the digits
/// of its coordinates.
fn balls(
    shapes: &[AnyShape],
    infos: &[ShapeInfo],
    these: impl Fn(&ShapeInfo) -> bool,
) -> Option<Vec<Ball>> {
    let found = || (shapes.iter().zip(infos)).filter_map(|(s, i)| these(i).then_some(s));
    match found().count() {
        0..=MOST_BALLS => found().map(|s| Ball::around([s])).collect(),
        _ => Ball::around(found()).map(|b| vec![b]),
    }
}

/// Why rays cannot be traced to what is called so.
pub(super) fn out_of_reach(name: &str, e: &AccelError) -> SceneError {
    let (expected, found) = match e {
        AccelError::Coordinate { found, .. } => (
            format!("finite coordinates of magnitude at most {MAX_COORDINATE:e}"),
            format!("{found:e}"),
        ),
        AccelError::TooMany { .. } => ("fewer primitives".to_owned(), e.to_string()),
    };
    SceneError::Parameter {
        key: name.to_owned(),
        expected,
        found,
    }
}
