//! What may move, and becomes a parameter when it is asked for.

use super::{Scene, ShapeInfo, sensor};
use crate::accel::MAX_COORDINATE;
use crate::bsdf::nesting::{flips_normals, reads_axes, scatters_deltas};
use crate::bsdf::{Bsdf, Material, TextureRef};
use crate::camera::{FovAxis, Optic};
use crate::edges::crossing::cut_by;
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::estimator::{Follows, Strategy};
use crate::film::PixelFilter;
use crate::motion::Placement;
use crate::params::{ParamInfo, ParamKind, ParamRef, ParamShape, fits};
use crate::shape::{AnyShape, Mesh, Shape};

/// Displacements: from one end of what is in reach to the other.
const WAYS: (f64, f64) = (
    -2.0 * (MAX_COORDINATE as f64),
    2.0 * (MAX_COORDINATE as f64),
);
/// Coordinates.
const ANYWHERE: (f64, f64) = (-(MAX_COORDINATE as f64), MAX_COORDINATE as f64);
/// Rotation vectors: hundreds of turns, where single precision still tells degrees apart.
const TURNS: (f64, f64) = (-1e4, 1e4);
/// Scales. Neither zero nor negative ones are there: a shape without size has no points, and one that is turned inside
/// out has another side.
const SCALES: (f64, f64) = (1e-6, 1e6);
/// Components of normals, whose directions count.
const NORMALS: (f64, f64) = (-1e6, 1e6);
/// Angles of view in degrees.
const ANGLES: (f64, f64) = (1e-3, 179.0);
/// Radii of lenses, and distances of focus.
const LENGTHS: (f64, f64) = (1e-6, MAX_COORDINATE as f64);

/// Something that may move: a parameter to be ([`Scene::make_movable`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Movable {
    /// Its name.
    pub name: String,
    /// Arrangement.
    pub shape: ParamShape,
    /// Smallest and largest valid value.
    pub valid: (f64, f64),
    /// What it does to light.
    pub kind: ParamKind,
    pub(super) what: What,
}

/// What a parameter moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum What {
    Shape(u32, Freedom),
    Vertices(u32),
    Normals(u32),
    Camera(Freedom),
    Optic(Optic),
    Emitter(u32),
}

/// How something moves as a whole.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Freedom {
    Translation,
    Rotation,
    Scale,
}

impl Freedom {
    pub const ALL: [Self; 3] = [Self::Translation, Self::Rotation, Self::Scale];

    /// What follows the name of what moves.
    pub fn key(self) -> &'static str {
        match self {
            Self::Translation => "translation",
            Self::Rotation => "rotation",
            Self::Scale => "scale",
        }
    }

    fn shape(self) -> ParamShape {
        match self {
            Self::Scale => ParamShape::Scalar,
            _ => ParamShape::Vector,
        }
    }

    fn valid(self) -> (f64, f64) {
        match self {
            Self::Translation => WAYS,
            Self::Rotation => TURNS,
            Self::Scale => SCALES,
        }
    }

    /// Its values at rest.
    pub fn rest(self) -> &'static [f32] {
        match self {
            Self::Scale => &[1.0],
            _ => &[0.0; 3],
        }
    }

    fn of(self, placement: &mut Placement) -> &mut Option<ParamRef> {
        match self {
            Self::Translation => &mut placement.translation,
            Self::Rotation => &mut placement.rotation,
            Self::Scale => &mut placement.scale,
        }
    }
}

/// What a light is called, from the name of its radiance: what stands before its key, and the number that makes it unique.
fn name_of_light(radiance: &str) -> (&str, &str) {
    let number = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
    let (name, suffix) = match radiance.rsplit_once('_') {
        Some((name, digits)) if number(digits) => (name, &radiance[name.len()..]),
        _ => (radiance, ""),
    };
    let keys = [
        ".intensity.value",
        ".radiance.value",
        ".irradiance.value",
        ".data",
    ];
    let stem = keys.iter().find_map(|key| name.strip_suffix(key));
    stem.map_or((radiance, ""), |stem| (stem, suffix))
}

/// A box around a shape.
struct Extent([[f64; 3]; 2]);

impl Extent {
    fn of(shape: &AnyShape) -> Self {
        Self(shape.bounds().map(|corner| corner.map(f64::from)))
    }

    /// Half its longest side.
    fn size(&self) -> f64 {
        let [low, high] = self.0;
        (0..3).fold(0.0, |most: f64, k| most.max(0.5 * (high[k] - low[k])))
    }

    /// How far a point is from it.
    fn distance(&self, to: [f64; 3]) -> f64 {
        let [low, high] = self.0;
        let off = |k: usize| (low[k] - to[k]).max(to[k] - high[k]).max(0.0);
        off(0).hypot(off(1)).hypot(off(2))
    }
}

impl Scene {
    /// Everything that may move, whether or not it is a parameter by now. Names are those of shapes and lights in the
    /// scene file:
    ///
    /// * `NAME.translation`, `NAME.rotation`, `NAME.scale` of a shape: a displacement and a factor, in the world's axes and
    ///   units, and a rotation vector (its length is the angle in radians) about the centroid of the surface as it was
    ///   loaded. Zero, zero and one in a loaded scene; the scale comes first, then the rotation.
    /// * `NAME.vertex_positions` of a mesh: its points, before it moves as a whole. Vertices at one position are one point,
    ///   in the order of their first ones, so that nothing tears along seams of texture coordinates. Normals follow
    ///   where the file gives none. Those of meshes that a texture displaces are not there: its texels are parameters.
    ///   Neither they nor the scale are there under a bump map, whose heights are in units of the scene.
    /// * `NAME.vertex_normals` of a mesh whose file gives normals: their directions at all vertices, before it moves as a
    ///   whole. They may have any length but zero. Under a bump map they are not there.
    /// * `sensor.translation`, `sensor.rotation` (about its origin: the pinhole, the middle of the lens or of the film), and
    ///   `sensor.fov` in degrees, unless rays are parallel; `sensor.aperture_radius` and `sensor.focus_distance` of a thin lens.
    /// * `NAME.position` of point and spot lights, world space; `NAME.rotation` of environment maps, lobes and directional
    ///   lights.
    ///
    /// Mitsuba's keys stand for these where they mean the same: `positions`, and `x_fov`, of the
    /// sensor or its class, where that is the angle. Matrices are set and read ([`Scene::to_world`]).
    ///
    /// ```
    /// use render::params::ParamKind;
    ///
    /// let mut room = render::scene::room(8, 8)?;
    /// let all = room.movables();
    /// let lens = all.iter().find(|m| m.name == "sensor.fov").expect("a pinhole has an angle");
    /// assert_eq!((lens.kind, lens.shape.len()), (ParamKind::Camera, 1));
    /// assert!(all.iter().any(|m| m.name == "sphere.translation" && m.kind == ParamKind::Position));
    ///
    /// // One of them becomes a parameter, behind all others.
    /// let before = room.params().values().len();
    /// room.make_movable(&["sensor.fov"])?;
    /// assert_eq!(room.params().get("sensor.fov")?, [38.0]); // degrees
    /// assert_eq!(room.params().values().len(), before + 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn movables(&self) -> Vec<Movable> {
        let mut all = Vec::new();
        let part = |name: &str, part: Freedom, kind, what| Movable {
            name: format!("{name}.{}", part.key()),
            shape: part.shape(),
            valid: part.valid(),
            kind,
            what,
        };
        for ((i, info), shape) in (0..).zip(&self.infos).zip(&self.geometry.shapes) {
            let bumped = matches!(
                *self.materials[info.material as usize],
                Material::Charted(_)
            );
            let is_curve = matches!(shape, AnyShape::Curves(_));
            let fits = |p: &Freedom| match p {
                Freedom::Translation => true,
                Freedom::Rotation => !is_curve,
                Freedom::Scale => !(bumped || is_curve),
            };
            for p in Freedom::ALL.into_iter().filter(fits) {
                let what = What::Shape(i, p);
                all.push(part(&info.name, p, ParamKind::Position, what));
            }
            let mesh = match shape {
                AnyShape::Mesh(mesh) if !mesh.is_displaced() => Some(mesh),
                AnyShape::Instance(instance) => Some(instance.mesh()),
                _ => None,
            };
            let Some(mesh) = mesh.filter(|_| !bumped) else {
                continue;
            };
            all.push(Movable {
                name: format!("{}.vertex_positions", info.name),
                shape: ParamShape::Points {
                    count: mesh.points(),
                },
                valid: ANYWHERE,
                kind: ParamKind::Position,
                what: What::Vertices(i),
            });
            if mesh.has_given_normals() {
                all.push(Movable {
                    name: format!("{}.vertex_normals", info.name),
                    shape: ParamShape::Points {
                        count: mesh.data().normals.len(),
                    },
                    valid: NORMALS,
                    kind: ParamKind::VertexNormals,
                    what: What::Normals(i),
                });
            }
        }
        for p in [Freedom::Translation, Freedom::Rotation] {
            all.push(part("sensor", p, ParamKind::Camera, What::Camera(p)));
        }
        let optics = [
            (Optic::Fov, ANGLES),
            (Optic::Aperture, LENGTHS),
            (Optic::Focus, LENGTHS),
        ];
        let there = |(optic, _): &(Optic, _)| self.camera.value_of(*optic).is_some();
        for (optic, valid) in optics.into_iter().filter(there) {
            all.push(Movable {
                name: format!("sensor.{}", optic.key()),
                shape: ParamShape::Scalar,
                valid,
                kind: ParamKind::Camera,
                what: What::Optic(optic),
            });
        }
        for (i, e) in (0..).zip(&self.emitters) {
            all.extend(self.movable_light(i, e));
        }
        // Where names are taken, as parameters make them unique.
        let mut taken = std::collections::HashMap::<String, u32>::new();
        for m in &mut all {
            let times = taken.entry(m.name.clone()).or_default();
            if *times > 0 {
                m.name = format!("{}_{times}", m.name);
            }
            *times += 1;
        }
        all
    }

    /// The first parameter that its emission is linear in.
    fn name_of_radiance(&self, emitter: &AnyEmitter) -> Option<&str> {
        let mut name = None;
        (emitter.radiance()).visit_params(&mut |p| {
            name.get_or_insert(&self.params.infos()[p.id as usize].name[..]);
        });
        name
    }

    fn movable_light(&self, index: u32, emitter: &AnyEmitter) -> Option<Movable> {
        let (key, _) = emitter.mobility()?;
        let radiance = self.name_of_radiance(emitter);
        let (name, suffix) = radiance.map_or(("emitter", ""), name_of_light);
        Some(Movable {
            name: format!("{name}.{key}{suffix}"),
            shape: ParamShape::Vector,
            valid: if key == "rotation" { TURNS } else { ANYWHERE },
            kind: ParamKind::LightPosition,
            what: What::Emitter(index),
        })
    }

    /// How far a range of lengths may go before the scene is another one: as far as what it moves is large, or as near as
    /// other things are. `None` if it holds no lengths.
    pub(crate) fn reach_of(&self, info: &ParamInfo) -> Option<f64> {
        if !info.kind.is_motion() {
            return None;
        }
        let movable = self.movables().into_iter().find(|m| m.name == info.name)?;
        let reach = match movable.what {
            What::Shape(i, Freedom::Translation) | What::Vertices(i) => {
                let own = Extent::of(&self.geometry.shapes[i as usize]).size();
                own.min(self.room_around(self.camera.origin()))
            }
            What::Camera(Freedom::Translation) => self.room_around(self.camera.origin()),
            What::Emitter(i) => match self.emitters[i as usize].mobility()? {
                ("position", at) => self.room_around(at.map(f64::from)),
                _ => return None,
            },
            _ => return None,
        };
        (reach > 0.0 && reach.is_finite()).then_some(reach)
    }

    /// How near the nearest shape is, or how large, if the point is in its box.
    fn room_around(&self, to: [f64; 3]) -> f64 {
        let all = self.geometry.shapes.iter().map(|shape| {
            let extent = Extent::of(shape);
            let distance = extent.distance(to);
            if distance > 0.0 {
                distance
            } else {
                extent.size()
            }
        });
        all.fold(f64::INFINITY, f64::min)
    }

    /// Makes what is called so a parameter, behind all others, with the value that it has. Names of parameters stay what
    /// they are: a list may hold those of any. Until then, what may move takes no room and no time.
    ///
    /// # Errors
    /// A name that nothing has, a matrix, or an angle of view that no parameter may have. The names before it are parameters
    /// then.
    ///
    /// ```
    /// use render::Scene;
    ///
    /// let text = r#"<scene version="3.0.0">
    ///     <sensor type="perspective"><float name="fov" value="40"/></sensor>
    ///     <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="5"/></shape>
    /// </scene>"#;
    /// let (mut scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
    /// scene.make_movable(&["ball.translation"])?;
    /// let mut values = scene.params().values().to_vec();
    /// let up = scene.params().find("ball.translation")?.offset + 1;
    /// values[up] = 0.5;
    /// scene.set_params(&values)?;
    /// let render::shape::AnyShape::Sphere(ball) = &scene.shapes()[0] else { unreachable!() };
    /// assert_eq!(ball.center(), [0.0, 0.5, 5.0]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn make_movable<N: AsRef<str>>(&mut self, names: &[N]) -> Result<(), RenderError> {
        let mut movables = None;
        for name in names {
            let given = name.as_ref();
            if self.params.matching(given).is_ok() {
                continue;
            }
            self.refuse_matrix(given)?;
            let name = self.canonical(given);
            let all = movables.get_or_insert_with(|| self.movables());
            let found: Vec<_> = all
                .iter()
                .filter(|m| fits(&name, &m.name))
                .cloned()
                .collect();
            if found.is_empty() {
                let known = self.params.infos().iter().map(|i| &i.name);
                // Of another axis, `sensor.fov` is that angle.
                let close = |m: &&Movable| !self.is_x_fov(&name) || m.name == "sensor.fov";
                let known = known.filter(|_| !self.is_x_fov(&name)).collect();
                let movable = all.iter().filter(close).map(|m| &m.name).collect();
                return Err(RenderError::unknown_key(&name, [known, movable]));
            }
            for found in found {
                let p = match self.params.find(&found.name) {
                    Ok(info) => self.params.handle(info),
                    Err(_) => self.materialise(&found)?,
                };
                if given != found.name && name == found.name {
                    self.params.also_call(p, given.to_owned());
                }
            }
        }
        Ok(())
    }

    /// The mesh whose points this range is.
    pub fn mesh_of(&self, info: &ParamInfo) -> Option<&Mesh> {
        let p = self.params.handle(info);
        let of_points =
            matches!(info.shape, ParamShape::Points { .. }) && info.kind == ParamKind::Position;
        let (shape, _) = (self.movers().iter()).find(|(_, reads)| of_points && *reads == p)?;
        match &self.shapes()[*shape as usize] {
            AnyShape::Mesh(mesh) => Some(mesh),
            _ => None,
        }
    }

    /// Meshes whose points are parameters, or displaced by them, and of which triangles are turned over ([`Mesh::folded`]):
    /// name, number of those, number of all. There is light on a surface that folds over itself, and derivatives of it are
    /// right; but no optimiser should have made it.
    pub fn folded(&self) -> Vec<(String, usize, usize)> {
        let mut out = Vec::new();
        for (info, shape) in self.infos.iter().zip(self.shapes()) {
            if let AnyShape::Mesh(mesh) = shape
                && mesh.has_moving_points()
            {
                let folded = mesh.folded().len();
                if folded > 0 {
                    out.push((info.name.clone(), folded, mesh.data().triangles.len()));
                }
            }
        }
        out
    }

    /// The name that a parameter has here, where Mitsuba calls it otherwise.
    fn canonical(&self, name: &str) -> String {
        if let Some(shape) = name.strip_suffix(".positions") {
            return format!("{shape}.vertex_positions");
        }
        if self.is_x_fov(name) && self.camera.fov().1 == FovAxis::X {
            return "sensor.fov".into();
        }
        name.into()
    }

    /// Whether this is Mitsuba's name of the angle of view along x: of a sensor with its id, or its class.
    fn is_x_fov(&self, name: &str) -> bool {
        (name.strip_suffix(".x_fov")).is_some_and(|of| self.is_sensor(of))
    }

    /// Whether this is the sensor that is looked through: so called, by its id, or by Mitsuba's name of its class.
    pub(super) fn is_sensor(&self, name: &str) -> bool {
        let own = self.sensors.get(self.through).map(|s| s.name.as_str());
        let classes = ["PerspectiveCamera", "ThinLensCamera", "OrthographicCamera"];
        name == "sensor" || classes.contains(&name) || Some(name) == own
    }

    fn materialise(&mut self, movable: &Movable) -> Result<ParamRef, RenderError> {
        let values = match movable.what {
            What::Shape(_, part) | What::Camera(part) => part.rest().to_vec(),
            What::Optic(optic) => {
                (self.camera.value_of(optic)).map_or(Vec::new(), |value| vec![value as f32])
            }
            What::Vertices(shape) => match self.geometry.at_rest(shape) {
                AnyShape::Mesh(mesh) => mesh.point_positions(),
                AnyShape::Instance(instance) if instance.has_foreign_normals() => {
                    return Err(RenderError::Motion {
                        name: movable.name.clone(),
                        culprit: "normals of an instance that is not scaled evenly do not follow its points (a file \
                                  with normals, or a copy instead of an instance, would do)"
                            .into(),
                    });
                }
                AnyShape::Instance(instance) => instance.copied().point_positions(),
                _ => Vec::new(),
            },
            What::Normals(shape) => {
                let normals = match self.geometry.at_rest(shape) {
                    AnyShape::Mesh(mesh) => mesh.data().normals.clone(),
                    AnyShape::Instance(instance) => instance.copied().data().normals.clone(),
                    _ => Vec::new(),
                };
                let refuse = |culprit| {
                    Err(RenderError::Motion {
                        name: movable.name.clone(),
                        culprit,
                    })
                };
                if let Some(i) = normals.iter().position(|n| *n == [0.0; 3]) {
                    return refuse(format!("vertex {i} has no normal of its own"));
                }
                let length = |n: &[f32; 3]| n.iter().map(|x| x * x).sum::<f32>().sqrt();
                let alike = |n: &[f32; 3]| (length(n) / length(&normals[0]) - 1.0).abs() < 1e-3;
                if let Some(i) = normals.iter().position(|n| !alike(n)) {
                    return refuse(format!(
                        "the normal of vertex {i} weighs more or less by its length"
                    ));
                }
                normals.concat()
            }
            What::Emitter(e) => (self.emitters[e as usize].mobility())
                .map_or(Vec::new(), |(_, value)| value.to_vec()),
        };
        let (lo, hi) = movable.valid;
        let outside = |v: &f32| !(lo..=hi).contains(&f64::from(*v));
        if let Some(index) = values.iter().position(outside) {
            return Err(RenderError::ParameterOutOfRange {
                name: movable.name.clone(),
                index,
                valid: movable.valid,
                found: values[index].into(),
            });
        }
        if u32::try_from(self.params.values().len() + values.len()).is_err() {
            return Err(RenderError::Count {
                what: "parameters",
                expected: "at most 2^32",
                found: (self.params.values().len() + values.len()) as u64,
            });
        }
        if let What::Vertices(shape) | What::Normals(shape) = movable.what {
            let camera = sensor::farthest(&self.sensors, &self.camera);
            (self.geometry.copy(shape, &self.infos, camera)).map_err(|e| {
                RenderError::OutOfReach {
                    shape: Some(self.infos[shape as usize].name.clone()),
                    reason: e.error.to_string(),
                }
            })?;
        }
        let p = (self.params).push(&movable.name, movable.shape, &values, movable.valid);
        if let Some(source) = &mut self.source {
            source.moves(p, movable.what, values);
        }
        self.params.mark(p, movable.kind);
        match movable.what {
            What::Shape(shape, part) => self.geometry.place(shape, p, |own| part.of(own)),
            What::Vertices(shape) => self.geometry.free_vertices(shape, p),
            What::Normals(shape) => self.geometry.free_normals(shape, p),
            What::Camera(part) => *part.of(self.camera.placement()) = Some(p),
            What::Optic(optic) => self.camera.set_optic(optic, p),
            What::Emitter(e) => self.emitters[e as usize].make_movable(p),
        }
        Ok(p)
    }

    /// Whether any material flips normals to the viewer.
    pub(crate) fn flips_normals(&self) -> bool {
        self.materials.iter().any(|m| flips_normals(m))
    }

    /// Whether something scatters along Dirac deltas: mirrors, smooth glass, holes.
    pub(crate) fn scatters_deltas(&self) -> bool {
        self.delta_scatterer().is_some()
    }

    fn delta_scatterer(&self) -> Option<&ShapeInfo> {
        let smooth = |i: &&ShapeInfo| scatters_deltas(&self.materials[i.material as usize]);
        self.infos.iter().find(smooth)
    }

    /// Whether paths whose vertices move with this parameter have a derivative in it: textures may not jump where they slide,
    /// and nothing may scatter along Dirac deltas but where directions follow outlines that auxiliary rays find.
    ///
    /// # Errors
    /// Names the parameter, and the shape. None for parameters that move nothing.
    pub fn admits_motion<S: Strategy>(&self, info: &ParamInfo) -> Result<(), RenderError> {
        if !info.kind.is_motion() {
            return Ok(());
        }
        let refuse = |shape: &ShapeInfo, why: &str| RenderError::Motion {
            name: info.name.clone(),
            culprit: format!("`{}` {why}", shape.name),
        };
        if let Some(shape) = self.curves() {
            let why =
                "is made of curves, whose outlines are not known: nothing moves in their sight";
            return Err(refuse(shape, why));
        }
        if S::FOLLOWS.rays() == 0
            && let Some(shape) = self.delta_scatterer()
        {
            let why = "scatters along a Dirac delta, between vertices of which one moves";
            return Err(refuse(shape, why));
        }
        let mut all = self.infos.iter().zip(self.shapes());
        let axes_jump = |(own, shape): &(&ShapeInfo, &AnyShape)| {
            reads_axes(&self.materials[own.material as usize])
                && match shape {
                    AnyShape::Mesh(mesh) => mesh.axes_jump(),
                    AnyShape::Instance(instance) => instance.copied().axes_jump(),
                    _ => false,
                }
        };
        if let Some((shape, _)) = all.find(axes_jump) {
            let why = "has a brushed material or mapped normals, and smooth normals that cross the plane of x and y where no \
                       texture coordinates say how axes lie around them";
            return Err(refuse(shape, why));
        }
        let p = self.params.handle(info);
        for ((i, own), shape) in (0..).zip(&self.infos).zip(self.shapes()) {
            let moves = self.movers().contains(&(i, p)) && info.kind == ParamKind::Position;
            let slides = info.kind == ParamKind::Camera || moves;
            let beam = own
                .emitter
                .is_some_and(|e| self.emitters[e as usize].is_beam());
            if beam && self.movers().contains(&(i, p)) {
                return Err(refuse(own, "sends a beam, whose edge would move along"));
            }
            if slides && self.jumps(own, shape) {
                return Err(refuse(own, "has a texture that jumps where it slides"));
            }
        }
        Ok(())
    }

    /// Whether the estimator has terms for all outlines that move with this parameter, where paths have up to `max_depth`
    /// edges, if it has any. Where directions follow outlines, they slide over everything: no texture may jump then. Shadows of
    /// lights that no scattered light meets are drawn from the light, for samples of edges alone.
    /// Where the camera does not see what they fall on, particles go on from there, which know neither lenses nor normals that
    /// are flipped to the viewer. Directions that follow points of the film need a pixel filter whose derivative has
    /// samples, a box or a Gaussian, and rays that leave one point of the camera's lens.
    ///
    /// # Errors
    /// Names the parameter, and what is in the way. None for parameters that move nothing.
    pub fn admits_outlines<S: Strategy>(
        &self,
        info: &ParamInfo,
        max_depth: u32,
    ) -> Result<(), RenderError> {
        let follows = S::FOLLOWS.any();
        if !info.kind.is_motion() || !(S::OUTLINES || follows) {
            return Ok(());
        }
        let refuse = |culprit: &str| {
            Err(RenderError::Motion {
                name: info.name.clone(),
                culprit: culprit.into(),
            })
        };
        let filter = &self.film.filter;
        if follows && info.kind == ParamKind::VertexNormals {
            return refuse("directions do not follow curves where normals turn away");
        }
        if follows && self.camera.parallel_direction().is_some() {
            return refuse("directions do not follow curves where the camera's rays are parallel");
        }
        let mut all = self.infos.iter().zip(self.shapes());
        if follows && let Some((own, _)) = all.find(|(own, shape)| self.jumps(own, shape)) {
            return refuse(&format!(
                "`{}` has a texture that jumps where directions that follow outlines slide over it",
                own.name
            ));
        }
        let turns = |info: &&ShapeInfo| {
            let emitter = info.emitter.map(|e| &self.emitters[e as usize]);
            emitter.is_some_and(|e| self.turns_away(e))
        };
        if follows && let Some(lamp) = self.infos.iter().find(turns) {
            return refuse(&format!(
                "directions do not follow curves where the interpolated normals of `{}` turn away, which it is dark beyond",
                lamp.name
            ));
        }
        if follows && !matches!(filter, PixelFilter::Box | PixelFilter::Gaussian { .. }) {
            return refuse(
                "directions that follow outlines need a box or a Gaussian as the pixel filter",
            );
        }
        if let Some(own) = self.cut_by_camera(info) {
            return refuse(&format!(
                "`{}` reaches through the surface that rays of the camera begin on, which cuts it: where it does so moves, and is \
                 no outline",
                own.name
            ));
        }
        if matches!(S::FOLLOWS, Follows::Closed)
            && let Some(culprit) = self.without_closed_outlines(info)
        {
            return refuse(&culprit);
        }
        if max_depth < 2 || self.outline(false).is_none() {
            return Ok(());
        }
        if let Some(light) = self.emitters.iter().find(|e| e.throws_jumps()) {
            let texture = self.name_of_radiance(light).unwrap_or("a light");
            return refuse(&format!(
                "`{texture}` colours an image that jumps where things slide through its light",
            ));
        }
        if let Some([beam, other]) = self.crossed_beam() {
            return refuse(&format!(
                "`{}` goes through `{}`, which sends a beam: the line along which they cross ends that, and has no samples",
                other.name, beam.name
            ));
        }
        let deltas = || self.emitters.iter().filter(|e| e.is_delta());
        if follows && deltas().next().is_some() {
            refuse("shadows of lights without area have outlines without samples")
        } else if max_depth > 2
            && deltas().next().is_some()
            && (!self.camera.is_pinhole() || self.flips_normals())
        {
            refuse(
                "shadows of lights without area have outlines without samples of edges where paths have more than two edges and \
                 the camera is no pinhole, or normals are flipped to the viewer",
            )
        } else {
            Ok(())
        }
    }

    /// A shape that sends a beam, and one that goes through it.
    fn crossed_beam(&self) -> Option<[&ShapeInfo; 2]> {
        if !self.emitters.iter().any(AnyEmitter::is_beam) {
            return None;
        }
        let pairs = self.crossings().shapes();
        let mut pairs = pairs.map(|pair| pair.map(|shape| &self.infos[shape as usize]));
        let sends = |info: &ShapeInfo| {
            info.emitter
                .is_some_and(|e| self.emitters[e as usize].is_beam())
        };
        pairs.find_map(|[a, b]| {
            if sends(a) {
                Some([a, b])
            } else {
                sends(b).then_some([b, a])
            }
        })
    }

    /// A shape that the camera sees cut, if that moves with this parameter.
    fn cut_by_camera(&self, info: &ParamInfo) -> Option<&ShapeInfo> {
        let p = self.params.handle(info);
        let pupil = self.camera.pupil()?;
        let all = self.camera.depends_on(|q| q == p);
        let wanted = |shape: u32| all || self.movers().contains(&(shape, p));
        cut_by(pupil, self.shapes(), wanted).map(|shape| &self.infos[shape as usize])
    }

    /// What has outlines that are not known in closed form where this parameter moves, if anything has.
    fn without_closed_outlines(&self, info: &ParamInfo) -> Option<String> {
        let p = self.params.handle(info);
        match self.camera.optic_of(p) {
            None => {}
            Some(Optic::Fov) => {
                return Some(
                    "the angle of view spreads directions, which has no closed form".into(),
                );
            }
            Some(Optic::Aperture | Optic::Focus) => {
                return Some("lenses bend directions, which has no closed form".into());
            }
        }
        let round = |shape: &AnyShape| match shape {
            AnyShape::Rectangle(_) | AnyShape::Cube(_) | AnyShape::Sphere(_) => false,
            AnyShape::Mesh(mesh) => !mesh.data().normals.is_empty(),
            AnyShape::Disk(_)
            | AnyShape::Cylinder(_)
            | AnyShape::Instance(_)
            | AnyShape::Curves(_) => true,
        };
        for ((i, own), shape) in (0..).zip(&self.infos).zip(self.shapes()) {
            if round(shape) {
                return Some(format!(
                    "`{}` is no sphere and has no flat faces, whose outlines are known in closed form",
                    own.name
                ));
            }
            let moves = self.movers().contains(&(i, p));
            let whole = (self.geometry.placement(i)).is_some_and(|a| a.params().any(|q| q == p));
            if moves && !whole {
                return Some(format!("`{}` does not move as a whole", own.name));
            }
        }
        let mut pairs = self.crossings().shapes();
        let [a, b] = (pairs.find(|[a, b]| a != b)?).map(|i| &self.infos[i as usize].name);
        Some(format!(
            "`{a}` and `{b}` cross each other along a line that directions do not follow"
        ))
    }

    /// Whether what an emitter sends jumps where its normals turn away, and they do so within faces: they are interpolated.
    pub(crate) fn turns_away(&self, emitter: &AnyEmitter) -> bool {
        let AnyEmitter::Area(area) = emitter else {
            return false;
        };
        match &self.shapes()[area.shape as usize] {
            AnyShape::Mesh(mesh) => area.exponent == 0.0 && !mesh.data().normals.is_empty(),
            _ => false,
        }
    }

    /// Whether a texture of a shape does: between texels, or where its coordinates begin again.
    fn jumps(&self, info: &ShapeInfo, shape: &AnyShape) -> bool {
        let around = match shape {
            AnyShape::Sphere(_) | AnyShape::Cylinder(_) | AnyShape::Curves(_) => Some(0),
            AnyShape::Disk(_) => Some(1),
            _ => None,
        };
        let opens = |t: &TextureRef| around.is_some_and(|k| !t.closes(k));
        let jumps = |t: TextureRef| t.jumps() || opens(&t);
        let mut any = false;
        self.materials[info.material as usize].visit_textures(&mut |t| any |= jumps(t));
        let emitted = info.emitter.map(|e| self.emitters[e as usize].radiance());
        any || emitted.is_some_and(|t| jumps(TextureRef::Rgb(t)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_called_as_their_radiance() {
        for (radiance, found) in [
            ("lamp.intensity.value", ("lamp", "")),
            ("emitter.intensity.value_2", ("emitter", "_2")),
            ("sky_1.data", ("sky_1", "")),
            ("lobe.radiance.value", ("lobe", "")),
            ("sun.irradiance.value", ("sun", "")),
            ("anything_3", ("anything_3", "")),
        ] {
            assert_eq!(name_of_light(radiance), found);
        }
    }
}
