//! The geometry of a scene, and all that is derived from it: one owner, so that it changes together.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use ad_core::{Real, Vec3};

use super::ShapeInfo;
use crate::accel::{self, Accel, AccelError, Flats, Hit, MAX_PRIMITIVES, Plane, Primitive};
use crate::camera::Camera;
use crate::edges::Edges;
use crate::edges::crossing::Crossings;
use crate::emitter::Ball;
use crate::math::{NOWHERE, Ray, Transform};
use crate::motion::{Drift, Placement};
use crate::parallel;
use crate::params::{ParamRef, Params, Theta};
use crate::shape::{AnyShape, Exit, Instance, Mesh, Patch, Prim, Shape};

/// This many lamps, or things that throw caustics, have a ball of their own, at most.
const MOST_BALLS: usize = 16;

/// So many primitives are looked at by one thread.
const PLACED_TOGETHER: usize = 1 << 14;

/// How far rays start off a curved surface, relative to its largest coordinate: 64 roundings of an f32.
const RELATIVE_OFFSET: f32 = 64.0 * f32::EPSILON / 2.0;

/// How far a light stands out from what else lies on its plane, in roundings of the scene's coordinates: more than
/// distances err by.
const STANDS_OUT: f64 = 16.0;

/// Which balls a scene wants.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    /// Around what emits.
    pub lamps: bool,
    /// Around what is glossy.
    pub casters: bool,
}

/// Shapes, and what rays and lights know of them.
#[derive(Debug)]
pub(super) struct Geometry {
    pub shapes: Vec<AnyShape>,
    /// Every primitive of `accel` but those of instances, which are behind them.
    pub prims: Vec<Prim>,
    /// Instances, in the order of their primitives.
    spots: Vec<Spot>,
    /// What rays meet of each mesh that is placed somewhere.
    groups: Groups,
    /// The first one of each shape.
    pub firsts: Vec<u32>,
    /// Those that are parallelograms, once more: paths through rooms of boxes need not ask what they hit.
    pub patches: Vec<Patch>,
    pub accel: Accel,
    /// Balls around everything that emits; `None` if that is everywhere.
    pub lamps: Option<Vec<Ball>>,
    /// Balls around what throws caustics; none where there is nothing to throw them on, no light, or something
    /// that particles see otherwise than paths do.
    pub casters: Vec<Ball>,
    wanted: Wanted,
    /// Found by the first call that asks for them.
    edges: OnceLock<Edges>,
    crossings: OnceLock<Crossings>,
    /// `accel` without what emits, built by the first call that asks for it.
    without_lamps: OnceLock<Accel>,
    /// Per shape, how it moves as a whole; empty as long as none does.
    placed: Vec<Option<Box<Placed>>>,
    /// Parameters that shapes read, with the shape.
    reads: Vec<(u32, ParamRef)>,
}

/// The primitives of an instance.
#[derive(Clone, Copy, Debug)]
struct Spot {
    /// Of its primitives.
    first: u32,
    shape: u32,
    /// See [`Exit::offset`].
    offset: f32,
}

/// What rays meet of meshes in their own space, by where the mesh is in memory. It is kept here, so that no other comes to
/// lie there.
#[derive(Clone, Debug, Default)]
struct Groups(HashMap<usize, (Mesh, Arc<Accel>)>);

impl Groups {
    fn of(&mut self, mesh: &Mesh) -> Result<Arc<Accel>, AccelError> {
        if let Some((_, accel)) = self.0.get(&mesh.address()) {
            return Ok(accel.clone());
        }
        let primitives = mesh.primitives();
        let surfaces: Vec<u32> = (0..primitives.len() as u32).collect();
        let accel = Arc::new(Accel::with_surfaces(&primitives, &surfaces)?);
        (self.0).insert(mesh.address(), (mesh.clone(), accel.clone()));
        Ok(accel)
    }

    /// Instances of shapes, whose first primitives are these.
    fn place(
        &mut self,
        shapes: &[AnyShape],
        spots: &[Spot],
    ) -> Result<Vec<accel::Instance>, OutOfReach> {
        let mut all = Vec::with_capacity(spots.len());
        for &Spot { first, shape, .. } in spots {
            let AnyShape::Instance(instance) = &shapes[shape as usize] else {
                continue;
            };
            let out_of_reach = |error| OutOfReach {
                shape: Some(shape),
                error,
            };
            let [mut low, mut high] = instance.bounds();
            // Seams of primitives are as wide as the rounding of their own coordinates.
            let seam = accel::SEAM * 4.0 * instance.extent();
            for k in 0..3 {
                low[k] -= seam;
                high[k] += seam;
            }
            all.push(accel::Instance {
                accel: self.of(instance.mesh()).map_err(out_of_reach)?,
                // There is one: instances have been checked.
                to_local: instance.to_world().inverse().unwrap_or_default(),
                bounds: [low, high],
                first,
                count: instance.mesh().data().triangles.len() as u32,
            });
        }
        Ok(all)
    }
}

/// A shape that moves as a whole.
#[derive(Debug)]
struct Placed {
    /// The shape before it does.
    rest: AnyShape,
    placement: Placement,
}

impl Placed {
    /// The shape at these parameters.
    fn at(&self, params: &Params) -> Result<AnyShape, String> {
        let mut shape = self.rest.clone();
        shape.update(params)?;
        match self.placement.transform(params) {
            Transform::IDENTITY => Ok(shape),
            transform => shape.placed(&transform),
        }
    }
}

/// Why rays cannot be traced.
#[derive(Debug)]
pub(super) struct OutOfReach {
    /// The shape, if it is one.
    pub shape: Option<u32>,
    pub error: AccelError,
}

/// Why shapes cannot be where parameters want them.
#[derive(Debug)]
pub(super) struct Misplaced {
    /// The shape, if it is one.
    pub shape: Option<u32>,
    pub reason: String,
}

impl From<OutOfReach> for Misplaced {
    fn from(e: OutOfReach) -> Self {
        Self {
            shape: e.shape,
            reason: e.error.to_string(),
        }
    }
}

/// What follows from the shapes one by one.
struct Layout {
    prims: Vec<Prim>,
    firsts: Vec<u32>,
    patches: Vec<Patch>,
    primitives: Vec<Primitive>,
    surfaces: Vec<u32>,
    /// What curves are of.
    points: Vec<[f32; 4]>,
    spots: Vec<Spot>,
}

impl Layout {
    fn new(shapes: &[AnyShape], infos: &[ShapeInfo], camera: &Camera) -> Result<Self, OutOfReach> {
        let (mut prims, mut patches) = (Vec::new(), Vec::new());
        let (mut primitives, mut points) = (Vec::new(), Vec::new());
        let mut firsts = Vec::with_capacity(shapes.len());
        let mut placed: Vec<(u32, &Instance)> = Vec::new();
        for (i, shape) in shapes.iter().enumerate() {
            firsts.push(prims.len() as u32);
            if let AnyShape::Instance(instance) = shape {
                placed.push((i as u32, instance));
                continue;
            }
            let curved = Exit {
                offset: (shape.extent() * RELATIVE_OFFSET).max(f32::MIN_POSITIVE),
                ..Exit::default()
            };
            let before = points.len() as u32;
            points.extend_from_slice(shape.control_points());
            for (local, mut primitive) in shape.primitives().into_iter().enumerate() {
                if let Primitive::Span { first, .. } = &mut primitive {
                    *first += before;
                }
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
        let emits = |i: usize| infos[prims[i].shape as usize].emitter.is_some();
        let surfaces = accel::surfaces(&primitives, emits);
        raise_lights(&mut primitives, &prims, &surfaces, shapes, camera, emits);
        parallel::over(prims.chunks_mut(PLACED_TOGETHER), |k, part| {
            for (prim, i) in part.iter_mut().zip(k * PLACED_TOGETHER..) {
                let surface = surfaces[i];
                prim.surface = surface;
                if let Some(plane) = Plane::of(&primitives[i]) {
                    prim.exit = Exit {
                        offset: plane.offset(),
                        surface,
                    };
                }
            }
        });
        let mut next = prims.len();
        let mut spots = Vec::with_capacity(placed.len());
        for (shape, instance) in placed {
            let first = next as u32;
            next += instance.mesh().data().triangles.len();
            if next > MAX_PRIMITIVES {
                return Err(OutOfReach {
                    shape: Some(shape),
                    error: AccelError::TooMany { found: next },
                });
            }
            firsts[shape as usize] = first;
            spots.push(Spot {
                first,
                shape,
                offset: instance.rounding().max(f64::from(f32::MIN_POSITIVE)) as f32,
            });
        }
        Ok(Self {
            prims,
            firsts,
            patches,
            primitives,
            surfaces,
            points,
            spots,
        })
    }

    fn accel(&self) -> Result<Accel, AccelError> {
        Accel::with_curves(&self.primitives, &self.surfaces, &self.points)
    }

    fn out_of_reach(&self, error: AccelError) -> OutOfReach {
        let shape = match error {
            AccelError::Coordinate { primitive, .. } => Some(self.prims[primitive].shape),
            AccelError::TooMany { .. } => None,
        };
        OutOfReach { shape, error }
    }
}

impl Wanted {
    fn balls(self, shapes: &[AnyShape], infos: &[ShapeInfo]) -> (Option<Vec<Ball>>, Vec<Ball>) {
        let lamps = if self.lamps {
            balls(shapes, infos, |i| i.emitter.is_some())
        } else {
            None
        };
        let casters = if self.casters {
            balls(shapes, infos, ShapeInfo::throws_caustics).unwrap_or_default()
        } else {
            Vec::new()
        };
        (lamps, casters)
    }
}

impl Geometry {
    /// Of shapes, and what belongs to them.
    ///
    /// # Errors
    /// Coordinates out of reach, or too many primitives.
    pub fn new(
        mut shapes: Vec<AnyShape>,
        infos: &[ShapeInfo],
        camera: &Camera,
        wanted: Wanted,
    ) -> Result<Self, OutOfReach> {
        copy_beside_lights(&mut shapes, infos);
        let layout = Layout::new(&shapes, infos, camera)?;
        let mut accel = layout.accel().map_err(|e| layout.out_of_reach(e))?;
        let mut groups = Groups::default();
        accel.set_instances(groups.place(&shapes, &layout.spots)?);
        let (lamps, casters) = wanted.balls(&shapes, infos);
        let mut reads = Vec::new();
        for (shape, i) in shapes.iter().zip(0..) {
            shape.visit_params(&mut |p| reads.push((i, p)));
        }
        Ok(Self {
            shapes,
            prims: layout.prims,
            spots: layout.spots,
            groups,
            firsts: layout.firsts,
            patches: layout.patches,
            accel,
            lamps,
            casters,
            wanted,
            edges: OnceLock::new(),
            crossings: OnceLock::new(),
            without_lamps: OnceLock::new(),
            placed: Vec::new(),
            reads,
        })
    }

    /// Says that a parameter moves a shape as a whole, by what `own` chooses. The parameter has the value that it has at
    /// rest.
    pub fn place(
        &mut self,
        shape: u32,
        p: ParamRef,
        own: impl Fn(&mut Placement) -> &mut Option<ParamRef>,
    ) {
        let count = self.shapes.len();
        self.placed.resize_with(count, || None);
        let rest = &self.shapes[shape as usize];
        let placed = self.placed[shape as usize].get_or_insert_with(|| {
            Box::new(Placed {
                rest: rest.clone(),
                placement: Placement::about(rest.centroid()),
            })
        });
        *own(&mut placed.placement) = Some(p);
        self.reads.push((shape, p));
    }

    /// What a primitive belongs to.
    #[inline(always)]
    pub fn prim(&self, i: u32) -> Prim {
        match self.prims.get(i as usize) {
            Some(prim) => *prim,
            None => self.prim_of_instance(i),
        }
    }

    /// The same, of one behind those that are there one by one.
    #[inline(never)]
    fn prim_of_instance(&self, i: u32) -> Prim {
        let behind = self.spots.partition_point(|spot| spot.first <= i);
        let Spot {
            first,
            shape,
            offset,
        } = self.spots[behind - 1];
        Prim {
            shape,
            local: i - first,
            patch: u32::MAX,
            surface: i,
            exit: Exit { offset, surface: i },
        }
    }

    /// Gives a shape arrays of its own, if it is an instance.
    ///
    /// # Errors
    /// As [`Geometry::new`]; nothing has changed then.
    pub fn copy(
        &mut self,
        shape: u32,
        infos: &[ShapeInfo],
        camera: &Camera,
    ) -> Result<(), OutOfReach> {
        if !matches!(self.at_rest(shape), AnyShape::Instance(_)) {
            return Ok(());
        }
        let mut shapes = self.shapes.clone();
        let own = |shape: &mut AnyShape| {
            if let AnyShape::Instance(instance) = shape {
                *shape = instance.copied().into();
            }
        };
        own(&mut shapes[shape as usize]);
        self.derive(shapes, infos, camera)?;
        if let Some(Some(placed)) = self.placed.get_mut(shape as usize) {
            own(&mut placed.rest);
        }
        Ok(())
    }

    /// Says that a parameter is the points of a mesh, before it moves as a whole: it has their values.
    pub fn free_vertices(&mut self, shape: u32, p: ParamRef) {
        self.free(shape, p, |mesh| mesh.with_vertices(p));
    }

    /// Says that a parameter is the normals of a mesh, likewise.
    pub fn free_normals(&mut self, shape: u32, p: ParamRef) {
        self.free(shape, p, |mesh| mesh.with_vertex_normals(p));
    }

    fn free(&mut self, shape: u32, p: ParamRef, freed: impl Fn(&Mesh) -> Mesh) {
        let free = |shape: &mut AnyShape| {
            if let AnyShape::Mesh(mesh) = shape {
                *mesh = freed(mesh);
            }
        };
        free(&mut self.shapes[shape as usize]);
        if let Some(Some(placed)) = self.placed.get_mut(shape as usize) {
            free(&mut placed.rest);
        }
        self.reads.push((shape, p));
    }

    /// The shape before it moves as a whole.
    pub fn at_rest(&self, shape: u32) -> &AnyShape {
        match self.placed.get(shape as usize) {
            Some(Some(placed)) => &placed.rest,
            _ => &self.shapes[shape as usize],
        }
    }

    /// How a shape moves as a whole, if it may.
    #[inline]
    pub fn placement(&self, shape: u32) -> Option<&Placement> {
        Some(&self.placed.get(shape as usize)?.as_ref()?.placement)
    }

    /// How it does; `None` if it does not.
    #[inline(always)]
    pub fn drift<R: Real>(&self, shape: u32, theta: &Theta<R>) -> Option<Drift<R>> {
        if R::IS_PRIMAL {
            return None;
        }
        self.placement(shape)?.drift(theta)
    }

    /// The edges of all shapes.
    pub fn edges(&self) -> &Edges {
        made_once(&self.edges, || Edges::of(&self.shapes))
    }

    /// The lines along which surfaces cross.
    pub fn crossings(&self) -> &Crossings {
        made_once(&self.crossings, || Crossings::of(&self.shapes))
    }

    /// What rays meet where there are no lamps. Primitives, surfaces and hits are those of `accel`.
    pub fn without_lamps(&self, infos: &[ShapeInfo], camera: &Camera) -> &Accel {
        // It is threads at work that ask: the one that makes it takes no other work meanwhile, which could ask for it, too, and wait
        // for itself.
        let make = || parallel::alone(|| self.others(infos, camera));
        // The same primitives have been accepted before.
        (self.without_lamps).get_or_init(|| make().unwrap_or_else(|_| self.accel.clone()))
    }

    fn others(&self, infos: &[ShapeInfo], camera: &Camera) -> Result<Accel, OutOfReach> {
        let mut layout = Layout::new(&self.shapes, infos, camera)?;
        let zero = [0.0; 3];
        // Without extent, so that no ray meets it.
        let nothing = Primitive::Triangle {
            v0: zero,
            e1: zero,
            e2: zero,
        };
        let emits = |shape: u32| infos[shape as usize].emitter.is_some();
        for (primitive, prim) in layout.primitives.iter_mut().zip(&layout.prims) {
            if emits(prim.shape) {
                *primitive = nothing;
            }
        }
        layout.spots.retain(|spot| !emits(spot.shape));
        let mut others = layout.accel().map_err(|e| layout.out_of_reach(e))?;
        let mut groups = self.groups.clone();
        others.set_instances(groups.place(&self.shapes, &layout.spots)?);
        Ok(others)
    }

    /// Parameters that shapes read, with the shape.
    pub fn reads(&self) -> &[(u32, ParamRef)] {
        &self.reads
    }

    /// Whether it depends on a parameter for which `changed` holds.
    pub fn depends_on(&self, changed: impl Fn(ParamRef) -> bool) -> bool {
        self.reads.iter().any(|(_, p)| changed(*p))
    }

    /// Moves to these parameters, of which those for which `changed` holds are new; or the camera has moved.
    ///
    /// # Errors
    /// As [`Geometry::new`], or a shape of which nothing is left; nothing has changed then.
    pub fn update(
        &mut self,
        params: &Params,
        changed: impl Fn(ParamRef) -> bool,
        infos: &[ShapeInfo],
        camera: &Camera,
    ) -> Result<(), Misplaced> {
        let mut moved: Vec<u32> = (self.reads.iter())
            .filter_map(|&(shape, p)| changed(p).then_some(shape))
            .collect();
        moved.sort_unstable();
        moved.dedup();
        // Meshes share their arrays with the scene's until they change them.
        let mut shapes = self.shapes.clone();
        for shape in moved {
            let own = &mut shapes[shape as usize];
            let done = match self.placed.get(shape as usize) {
                Some(Some(placed)) => placed.at(params).map(|now| *own = now),
                _ => own.update(params),
            };
            done.map_err(|reason| Misplaced {
                shape: Some(shape),
                reason,
            })?;
        }
        self.derive(shapes, infos, camera)?;
        Ok(())
    }

    /// Derives everything from these shapes.
    fn derive(
        &mut self,
        mut shapes: Vec<AnyShape>,
        infos: &[ShapeInfo],
        camera: &Camera,
    ) -> Result<(), OutOfReach> {
        copy_beside_lights(&mut shapes, infos);
        let layout = Layout::new(&shapes, infos, camera)?;
        let instances = self.groups.place(&shapes, &layout.spots)?;
        (self
            .accel
            .refit(&layout.primitives, &layout.surfaces, &layout.points))
        .map_err(|e| layout.out_of_reach(e))?;
        self.accel.set_instances(instances);
        (self.lamps, self.casters) = self.wanted.balls(&shapes, infos);
        self.shapes = shapes;
        self.edges = OnceLock::new();
        self.crossings = OnceLock::new();
        self.without_lamps = OnceLock::new();
        self.prims = layout.prims;
        self.spots = layout.spots;
        self.firsts = layout.firsts;
        self.patches = layout.patches;
        Ok(())
    }
}

/// Gives instances arrays of their own that emit, or share a plane with a light: who lies on the same plane is known of
/// primitives one by one.
fn copy_beside_lights(shapes: &mut [AnyShape], infos: &[ShapeInfo]) {
    if !shapes.iter().any(|s| matches!(s, AnyShape::Instance(_))) {
        return;
    }
    let emits = |(shape, info): (&AnyShape, &ShapeInfo)| info.emitter.map(|_| shape.primitives());
    let lights: Vec<_> = shapes
        .iter()
        .zip(infos)
        .filter_map(emits)
        .flatten()
        .collect();
    let lights = Flats::new(lights);
    let shares = |instance: &Instance| {
        (lights.as_ref()).is_some_and(|lights| {
            lights.meet(&instance.bounds()) && instance.primitives().iter().any(|p| lights.hold(p))
        })
    };
    for (shape, info) in shapes.iter_mut().zip(infos) {
        if let AnyShape::Instance(instance) = shape
            && (info.emitter.is_some() || shares(instance))
        {
            *shape = instance.copied().into();
        }
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
    let mut dark = vec![false; prims.len()];
    for i in (0..prims.len()).filter(|&i| !emits(i)) {
        dark[surfaces[i] as usize] = true;
    }
    let shared = |i: &usize| emits(*i) && dark[surfaces[*i] as usize];
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
        let outside = shapes[shape as usize].interaction(&Theta::still(), local, &along, &anywhere);
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

/// What a place holds, made on all threads if it holds nothing. The place is free in between: who makes it may take other
/// work that asks as well, and would wait for itself.
fn made_once<T>(place: &OnceLock<T>, make: impl FnOnce() -> T) -> &T {
    match place.get() {
        Some(made) => made,
        None => {
            let made = make();
            place.get_or_init(|| made)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bsdf::{Conductor, Diffuse};
    use crate::camera::{Camera, FovAxis};
    use crate::emitter::Area;
    use crate::film::Film;
    use crate::math::Transform;
    use crate::scene::{Builder, Scene, Settings};
    use crate::shape::{Cube, Mesh, MeshData};

    /// A lamp and a mirror that stand where a parameter says, cubes both, over a floor of many triangles.
    fn scene(lamp_at: f32, mirror_at: f32) -> Scene {
        let mut build = Builder::new();
        let half = build.rgb("half", [0.5; 3], (0.0, 1.0)).expect("valid");
        let grey = build.add_material(Diffuse {
            reflectance: half.clone(),
        });
        let metal = build.add_material(Conductor {
            specular_reflectance: half.clone(),
            index: None,
        });
        let n = 20u32;
        let positions = (0..=n).flat_map(|i| (0..=n).map(move |j| [i as f32, j as f32, 0.0]));
        let triangles = (0..n).flat_map(|i| {
            (0..n).flat_map(move |j| {
                let [a, b] = [i * (n + 1) + j, (i + 1) * (n + 1) + j];
                [[a, b, b + 1], [a, b + 1, a + 1]]
            })
        });
        let floor = MeshData {
            positions: positions.collect(),
            triangles: triangles.collect(),
            ..Default::default()
        };
        build.add_shape("floor", Mesh::new(floor, false).expect("a mesh"), grey);
        let cubes = [("lamp", 5.0, grey), ("mirror", 12.0, metal)];
        for ((name, y, material), x) in cubes.into_iter().zip([lamp_at, mirror_at]) {
            let to_world = Transform::translate([f64::from(x) + 1.0, y, 3.0]);
            let cube = Cube::new(&to_world, false).expect("a cube");
            build.add_shape(name, cube, material);
            if name == "lamp" {
                let radiance = half.clone();
                let light = Area {
                    radiance,
                    exponent: 0.0,
                    shape: 1,
                };
                build.add_emitter(light, Some(1));
            }
        }
        let view = Transform::look_at([10.0, 10.0, 30.0], [10.0, 10.0, 0.0], [0.0, 1.0, 0.0]);
        let camera = Camera::new(view.expect("a view"), 50.0, FovAxis::Smaller, [8, 8]);
        let camera = camera.expect("a camera");
        let scene = build.build(camera, Film::new(8, 8), Settings::default());
        let mut scene = scene.expect("a scene");
        let names = ["lamp.translation", "mirror.translation"];
        scene.make_movable(&names).expect("they may move");
        scene
    }

    /// Everything that follows from where shapes are.
    fn derived(scene: &Scene) -> String {
        let g = &scene.geometry;
        let hits: Vec<Option<Hit>> = (0..40 * 40)
            .map(|i| {
                let at = Vec3::new(
                    0.5 * (i % 40) as f32 + 0.13,
                    0.5 * (i / 40) as f32 + 0.07,
                    0.0,
                );
                let o = Vec3::new(10.0f32, 9.0, 20.0);
                scene.nearest(&Ray::new(o, (at - o).normalize()))
            })
            .collect();
        format!(
            "{:?} {:?} {:?} {:?} {:?} {:?} {hits:?}",
            &g.shapes[1..],
            g.prims,
            g.firsts,
            g.patches,
            g.lamps,
            g.casters
        )
    }

    /// After parameters that shapes read have changed, a scene is the one that is built with them: shapes, primitives,
    /// patches, surfaces and exits, hierarchy, balls around lamps and casters.
    #[test]
    fn what_is_derived_from_shapes_moves_with_them() {
        let mut moving = scene(3.0, 9.0);
        assert!(moving.has_hierarchy());
        assert!(moving.lamps().is_some_and(|l| !l.is_empty()) && !moving.casters().is_empty());
        let start = derived(&moving);
        assert_eq!(start, derived(&scene(3.0, 9.0)));
        let offset = |scene: &Scene, name| scene.params().find(name).expect("known").offset;
        let mut values = moving.params().values().to_vec();
        for (lamp, mirror) in [(4.0, 9.0), (12.0, 2.0), (3.0, 9.0)] {
            values[offset(&moving, "lamp.translation")] = lamp - 3.0;
            values[offset(&moving, "mirror.translation")] = mirror - 9.0;
            moving.set_params(&values).expect("valid");
            let now = derived(&moving);
            assert_eq!(now, derived(&scene(lamp, mirror)), "{lamp} {mirror}");
            assert_eq!(now == start, (lamp, mirror) == (3.0, 9.0));
        }
    }

    /// Other parameters leave the geometry alone, and what is out of reach changes nothing.
    #[test]
    fn nothing_moves_without_need() {
        let mut still = scene(3.0, 9.0);
        let start = derived(&still);
        let mut values = still.params().values().to_vec();
        values[0] = 0.25;
        let floor = still.shapes()[0].primitives();
        still.set_params(&values).expect("valid");
        assert_eq!(derived(&still), start);
        assert_eq!(still.shapes()[0].primitives(), floor);
        let before = still.params().values().to_vec();
        let lamp = still
            .params()
            .find("lamp.translation")
            .expect("known")
            .offset;
        values[lamp] = 2e12;
        let error = still
            .set_params(&values)
            .expect_err("out of reach")
            .to_string();
        assert!(
            error.starts_with("shape `lamp`: ") && error.contains("at most 1e12"),
            "{error}"
        );
        assert_eq!(derived(&still), start);
        assert_eq!(still.params().values(), before);
    }
}
