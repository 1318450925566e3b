//! Scenes made by code, and the common part of scenes made from files.

use std::collections::HashMap;
use std::sync::Arc;

use super::geometry::{Geometry, Wanted};
use super::sensor::{Sensor, farthest};
use super::{Hints, PixelShares, Scene, Settings, ShapeInfo, Shares};
use crate::accel::{AccelError, MAX_COORDINATE};
use crate::bsdf::nesting::{check_textures, flips_normals, is_bumped, is_glossy, visit_deltas};
use crate::bsdf::{Bsdf, Charted, Material, TextureRef};
use crate::camera::Camera;
use crate::emitter::{AnyEmitter, DirectionalArea, Emitter};
use crate::error::SceneError;
use crate::film::Film;
use crate::params::{ParamKind, Params};
use crate::plugin::Registry;
use crate::shape::{AnyShape, Shape, charted};
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
    /// What is said of each.
    emitter_hints: Vec<Hints>,
}

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
            hints: Hints::default(),
        });
        self.shapes.push(shape);
        index
    }

    /// Puts something in place of the shape added last. What belongs to it.
    pub(super) fn replace_last(&mut self, shape: impl Into<AnyShape>) -> (MaterialId, Hints) {
        self.shapes.pop();
        self.shapes.push(shape.into());
        let info = self.infos.last();
        info.map_or((MaterialId(0), Hints::default()), |info| {
            (MaterialId(info.material), info.hints)
        })
    }

    /// Whether a material has a bump map.
    pub(super) fn is_bumped(&self, material: MaterialId) -> bool {
        is_bumped(&self.materials[material.0 as usize])
    }

    /// The shapes so far.
    pub(super) fn shapes(&self) -> &[AnyShape] {
        &self.shapes
    }

    /// The material of one of them.
    pub(super) fn material_of(&self, shape: usize) -> &Material {
        &self.materials[self.infos[shape].material as usize]
    }

    /// The emitter of one of them, if it emits.
    pub(super) fn emitter_of(&self, shape: usize) -> Option<u32> {
        self.infos[shape].emitter
    }

    /// How many emitters there are so far.
    pub(super) fn emitters(&self) -> usize {
        self.emitters.len()
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
        self.emitter_hints.push(Hints::default());
        if let Some(shape) = shape {
            self.infos[shape as usize].emitter = Some(index);
        }
    }

    /// What is said of the shape added last.
    pub fn hint_shape(&mut self, hints: Hints) {
        if let Some(info) = self.infos.last_mut() {
            info.hints = hints;
        }
    }

    /// What is said of the emitter added last.
    pub fn hint_emitter(&mut self, hints: Hints) {
        if let Some(last) = self.emitter_hints.last_mut() {
            *last = hints;
        }
    }

    /// Checks the whole and builds the acceleration structure.
    ///
    /// # Errors
    /// Geometry that is not finite, a material that reads more textures than there is room for, or a bump map on a mesh
    /// whose points are parameters, or whose light is an image.
    pub fn build(
        self,
        camera: Camera,
        film: Film,
        settings: Settings,
    ) -> Result<Scene, SceneError> {
        let sensor = Sensor {
            name: "sensor0".into(),
            camera,
            film,
            spp: settings.spp,
        };
        self.build_with(vec![sensor], 0, settings)
    }

    /// Light along normals is a beam from flat surfaces only.
    fn check_beams(&self) -> Result<(), SceneError> {
        for (shape, info) in self.shapes.iter().zip(&self.infos) {
            let beam = |e: u32| self.emitters[e as usize].is_beam();
            if info.emitter.is_some_and(beam) && !DirectionalArea::admits(shape) {
                return Err(SceneError::Parameter {
                    key: info.name.clone(),
                    expected: "a rectangle or a disk, whose normals are one".into(),
                    found: "another shape".into(),
                });
            }
            if info.emitter.is_some() && matches!(shape, AnyShape::Curves(_)) {
                return Err(SceneError::Parameter {
                    key: info.name.clone(),
                    expected: "a surface that is sampled by its area".into(),
                    found: "curves, which do not emit".into(),
                });
            }
        }
        Ok(())
    }

    /// Gives materials with bump maps the charts of the surfaces that they are on: a material of its own to each.
    fn chart_bumps(&mut self) -> Result<(), SceneError> {
        for (shape, info) in self.shapes.iter_mut().zip(&mut self.infos) {
            let material = &self.materials[info.material as usize];
            if !is_bumped(material) {
                continue;
            }
            let refuse = |expected: &str, found: &str| SceneError::Parameter {
                key: info.name.clone(),
                expected: format!("under a bump map, {expected}"),
                found: found.to_owned(),
            };
            let glows =
                |e: u32| !matches!(self.emitters[e as usize].radiance(), Texture::Constant(_));
            let (own, chart) = charted(shape).map_err(|expected| refuse(expected, "another"))?;
            if info.emitter.is_some_and(glows) {
                return Err(refuse("light that is the same everywhere", "an image"));
            }
            *shape = own;
            let charted = Charted::new(chart, material.clone());
            info.material = self.materials.len() as u32;
            self.materials.push(Arc::new(charted.into()));
        }
        Ok(())
    }

    /// [`Builder::build`] of a scene with several sensors, of which one is looked through: its samples per pixel count.
    ///
    /// # Errors
    /// The same, or no sensor of this number.
    pub fn build_with(
        mut self,
        sensors: Vec<Sensor>,
        chosen: usize,
        mut settings: Settings,
    ) -> Result<Scene, SceneError> {
        let Some(Sensor {
            camera, film, spp, ..
        }) = sensors.get(chosen).cloned()
        else {
            return Err(SceneError::Parameter {
                key: "sensor".into(),
                expected: format!("a number below {}", sensors.len()),
                found: chosen.to_string(),
            });
        };
        settings.spp = spp;
        self.check_beams()?;
        self.chart_bumps()?;
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
            m.visit_textures(&mut |t| {
                let kind = match t {
                    TextureRef::Alpha(_) | TextureRef::Exponent(_) => ParamKind::Roughness,
                    TextureRef::Vector(_) | TextureRef::Encoded(_) | TextureRef::Height(_) => {
                        ParamKind::Normals
                    }
                    TextureRef::Rgb(_) | TextureRef::Mixed(_) | TextureRef::Scalar(_) => return,
                };
                t.visit_params(&mut |p| params.mark(p, kind));
            });
            visit_deltas(m, &mut |p| params.mark(p, ParamKind::Delta));
        }
        for shape in &self.shapes {
            let params = self.registry.params_mut();
            shape.visit_params(&mut |p| params.mark(p, ParamKind::Position));
        }
        for e in &self.emitters {
            let params = self.registry.params_mut();
            e.visit_params(&mut |p| params.mark(p, ParamKind::Emission));
        }
        let mut emitters = self.emitters;
        for e in &mut emitters {
            e.update(self.registry.params());
        }
        let infinite: Vec<u32> = (0..emitters.len() as u32)
            .filter(|&i| emitters[i as usize].is_infinite())
            .collect();
        let flips = self.materials.iter().any(|m| flips_normals(m));
        let lit_things = self.infos.iter().any(ShapeInfo::shows_caustics) && !emitters.is_empty();
        let wanted = Wanted {
            lamps: infinite.iter().all(|&i| emitters[i as usize].is_delta()),
            casters: lit_things && !flips,
        };
        let reach = farthest(&sensors, &camera);
        let geometry = Geometry::new(self.shapes, &self.infos, reach, wanted).map_err(|e| {
            let name = e.shape.map(|shape| &self.infos[shape as usize].name[..]);
            out_of_reach(name.unwrap_or("geometry"), &e.error)
        })?;
        Ok(Scene {
            params: self.registry.into_params(),
            materials: self.materials,
            geometry,
            infos: self.infos,
            emitters,
            infinite,
            emitter_hints: self.emitter_hints,
            shares: Shares::new(&self.weights),
            pixels: PixelShares::default(),
            guide: None,
            files: Vec::new(),
            source: None,
            sensors,
            through: chosen,
            camera,
            film,
            settings,
        })
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
