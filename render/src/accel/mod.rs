//! Ray traversal: the nearest primitive along a ray, and whether there is any.
//!
//! Everything here is primal and f32: the renderer takes the primitive that was hit and computes
//! the point again in its own scalar, so nothing in this module is ever differentiated.
//!
//! Small scenes are tested linearly, eight flat primitives at a time (`triangle_block`); large scenes go
//! through an eight-wide hierarchy (`bvh`). Both run the same arithmetic on the same
//! numbers and break ties towards the lowest primitive, so they return the same bits. Sets of primitives that are placed
//! many times are there once (`instances`), and found after the others.
//!
//! ```
//! use render::accel::{Accel, Primitive};
//!
//! let triangle = Primitive::Triangle { v0: [0.0; 3], e1: [1.0, 0.0, 0.0], e2: [0.0, 1.0, 0.0] };
//! let accel = Accel::build(&[triangle])?;
//! let hit = accel.intersect([0.2, 0.2, 1.0], [0.0, 0.0, -1.0], f32::INFINITY, u32::MAX).expect("above it");
//! assert_eq!((hit.prim, hit.t), (0, 1.0));
//! assert!(!accel.occluded([0.2, 0.2, 1.0], [0.0, 0.0, -1.0], 0.5, [u32::MAX; 2])); // not within half a unit
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bvh;
mod cluster;
mod curved;
mod instances;
mod interleaved;
mod node;
mod plane;
mod ray_packet;
mod triangle_block;
mod tube;
mod widen;

pub(crate) use triangle_block::SEAM;
pub(crate) use tube::{Along, Cubic, range, rounded};

#[cfg(test)]
mod tests;

use crate::math::{NOWHERE, both, each};
use crate::parallel;
use bvh::Tree;
use curved::{Curved, Line};
pub use instances::Instance;
use instances::Instances;
pub use plane::surfaces;
pub(crate) use plane::{Flats, Plane, layers, scale, sheets};
use ray_packet::Few;
pub use ray_packet::{PACKET_SIZE, RayPacket};
use thiserror::Error;
use triangle_block::{Flat, TriangleBlocks};
use tube::{Cone, Span};

/// Largest coordinate magnitude: squares and cubes of it, divided by [`MIN_THICKNESS`], stay finite.
pub const MAX_COORDINATE: f32 = 1e12;

/// Primitives thinner than this in some direction count as degenerate.
pub const MIN_THICKNESS: f32 = 1e-18;

/// Up to this cost (in blocks of eight flat primitives) a linear scan is faster than the hierarchy (decision 0032).
const MAX_LINEAR_COST: usize = 12;

/// Cost of one curved primitive.
const CURVED_COST: usize = 1;

/// One primitive in world space, as the ray sees it.
///
/// Degenerate primitives (no area, negative radius, no length) are accepted and never hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Primitive {
    /// Points `v0 + u e1 + v e2` with `u, v >= 0` and `u + v <= 1`.
    Triangle {
        /// First vertex.
        v0: [f32; 3],
        /// Second vertex minus the first.
        e1: [f32; 3],
        /// Third vertex minus the first.
        e2: [f32; 3],
    },
    /// Points `v0 + u e1 + v e2` with `0 <= u, v <= 1`: a rectangle or a face of a cube.
    Parallelogram {
        /// Corner.
        v0: [f32; 3],
        /// First side.
        e1: [f32; 3],
        /// Second side.
        e2: [f32; 3],
    },
    /// The surface of a ball; hits leave `u = v = 0`.
    Sphere {
        /// Centre.
        center: [f32; 3],
        /// Radius.
        radius: f32,
    },
    /// Points `center + u e1 + v e2` with `u^2 + v^2 <= 1`.
    Disk {
        /// Centre.
        center: [f32; 3],
        /// First half axis.
        e1: [f32; 3],
        /// Second half axis, orthogonal to the first.
        e2: [f32; 3],
    },
    /// An open tube around the segment from `p0` to `p0 + axis`; hits leave `u = v = 0`.
    Cylinder {
        /// Start of the axis.
        p0: [f32; 3],
        /// End of the axis minus its start.
        axis: [f32; 3],
        /// Radius.
        radius: f32,
    },
    /// The surface of all balls around points `p0 + s axis` with `0 <= s <= 1`, whose radius is linear in `s`, from outside
    /// alone: what starts within passes. Hits leave `u = s` of the ball that they lie on.
    Cone {
        /// Centre of the first ball.
        p0: [f32; 3],
        /// Centre of the last one minus that.
        axis: [f32; 3],
        /// The radii of both.
        radii: [f32; 2],
    },
    /// A part of a tube around a uniform cubic B-spline, from outside alone: circles across the curve, whose radius is
    /// that spline, too; there is nothing over its ends. Hits leave the parameter between the four control points as `u`,
    /// in [0, 1] whatever the part.
    Span {
        /// Ends of the axis of a capsule around it.
        end_points: [[f32; 3]; 2],
        /// Radius of that.
        radius: f32,
        /// The first of four control points, among those that the structure is given, see [`Accel::with_curves`].
        first: u32,
        /// Which of how many equal parts of the parameter.
        part: [u8; 2],
    },
}

/// Where a ray meets a primitive.
///
/// `u` and `v` may leave their range by the rounding of the hit point: neighbours overlap that much
/// so that no ray slips between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the direction's length, `> 0`.
    pub t: f32,
    /// First surface coordinate, see [`Primitive`].
    pub u: f32,
    /// Second surface coordinate, see [`Primitive`].
    pub v: f32,
    /// Index of the primitive in the order given to [`Accel::build`].
    pub prim: u32,
}

/// Why a set of primitives was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AccelError {
    /// A coordinate is NaN, infinite or beyond [`MAX_COORDINATE`].
    #[error(
        "primitive {primitive}: expected finite coordinates of magnitude at most {max:e}, found {found}",
        max = MAX_COORDINATE
    )]
    Coordinate {
        /// Index of the primitive.
        primitive: usize,
        /// The offending number.
        found: f32,
    },
    /// More primitives than indices.
    #[error("expected at most {max} primitives, found {found}", max = MAX_PRIMITIVES)]
    TooMany {
        /// Number of primitives given.
        found: usize,
    },
}

/// What [`Accel::refit`] did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refit {
    /// The hierarchy is the same, with other boxes.
    Kept {
        /// How many times as many boxes a ray through it visits as when it was built, by their surface areas.
        looseness: f64,
    },
    /// All is built anew.
    Rebuilt,
}

/// A hierarchy whose rays visit so many times as many boxes is built anew.
const MAX_LOOSENESS: f64 = 1.5;

/// Indices are 30 bits wide, see [`Tag`], those of instances, too, and the largest one marks empty slots.
pub(crate) const MAX_PRIMITIVES: usize = (u32::MAX >> 2) as usize - 1;

/// A set of primitives, ready for ray queries.
///
/// Queries are pure functions of their arguments and never panic. A ray misses everything if its
/// direction is zero, NaN or infinite, or shorter or longer than `1e-18` or `1e18`, or if its origin
/// is not finite or is farther out than a few [`MAX_COORDINATE`].
#[derive(Clone, Debug)]
pub struct Accel {
    layout: Layout,
    /// Primitives of other spaces.
    instances: Option<Box<Instances>>,
}

#[derive(Clone, Debug)]
enum Layout {
    Linear(TriangleBlocks, Vec<(Curved, Tag)>, Few),
    Tree(Box<Tree>),
}

impl Accel {
    /// Prepares `prims` for queries. An empty set is valid and never hit.
    ///
    /// # Errors
    /// Coordinates out of reach, or too many primitives.
    pub fn build(prims: &[Primitive]) -> Result<Accel, AccelError> {
        Self::with_surfaces(prims, &surfaces(prims, |_| false))
    }

    /// The same, where it is known which surface each primitive lies on, see [`surfaces`].
    ///
    /// # Errors
    /// As [`Accel::build`].
    pub fn with_surfaces(prims: &[Primitive], surfaces: &[u32]) -> Result<Accel, AccelError> {
        Self::with_curves(prims, surfaces, &[])
    }

    /// The same with curves: `points` are control points, three coordinates and a radius. A [`Primitive::Span`] whose
    /// points are not there is never hit.
    ///
    /// # Errors
    /// As [`Accel::build`].
    pub fn with_curves(
        prims: &[Primitive],
        surfaces: &[u32],
        points: &[[f32; 4]],
    ) -> Result<Accel, AccelError> {
        let items = prepare(prims, surfaces, points)?;
        let curved = items.iter().filter(|i| i.is_curved()).count();
        let flat = items.len() - curved;
        let cost = flat.div_ceil(triangle_block::LANES) + CURVED_COST * curved;
        Ok(if cost <= MAX_LINEAR_COST {
            Self::linear(&items, points)
        } else {
            Self::tree(&items, points).unwrap_or_else(|| Self::linear(&items, points))
        })
    }

    /// Adds these primitives of other spaces, whose indices are behind those of all others, in place of those that there
    /// were.
    pub fn set_instances(&mut self, all: Vec<Instance>) {
        self.instances = Instances::new(all).map(Box::new);
    }

    /// Follows primitives that have moved: as many as before, in the same order. Hits are those of a structure built
    /// anew, bit by bit. It is built anew where the hierarchy would be too loose, where there is none, and where
    /// primitives are no longer degenerate, or are by now.
    ///
    /// # Errors
    /// As [`Accel::build`]; nothing has changed then.
    pub fn refit(
        &mut self,
        prims: &[Primitive],
        surfaces: &[u32],
        points: &[[f32; 4]],
    ) -> Result<Refit, AccelError> {
        if let Layout::Tree(tree) = &mut self.layout {
            let items = prepare(prims, surfaces, points)?;
            if let Some(looseness) = tree.refit(&items, points)
                && looseness <= MAX_LOOSENESS
            {
                return Ok(Refit::Kept { looseness });
            }
        }
        *self = Self::with_curves(prims, surfaces, points)?;
        Ok(Refit::Rebuilt)
    }

    fn linear(items: &[Item], points: &[[f32; 4]]) -> Accel {
        let mut flat = Vec::new();
        let mut curved = Vec::new();
        let shapes = || (items.iter()).filter_map(|i| Some((i.shape(points)?, i.tag)));
        for (shape, tag) in shapes() {
            match shape {
                Shape::Flat(f) => flat.push((f, tag)),
                Shape::Curved(c) => curved.push((c, tag)),
            }
        }
        Accel {
            layout: Layout::Linear(TriangleBlocks::new(&flat), curved, Few::new(shapes())),
            instances: None,
        }
    }

    /// `None` if there are too many leaves.
    fn tree(items: &[Item], points: &[[f32; 4]]) -> Option<Accel> {
        Tree::new(items, points).map(|t| Accel {
            layout: Layout::Tree(Box::new(t)),
            instances: None,
        })
    }

    /// Nearest hit of the ray `o + t d` with `0 < t < t_max`; the lowest primitive among equals. What lies on the
    /// surface `from` is not hit.
    ///
    /// `d` need not be normalised. The caller offsets origins that lie on another surface.
    #[inline(always)]
    pub fn intersect(&self, o: [f32; 3], d: [f32; 3], t_max: f32, from: u32) -> Option<Hit> {
        let [x, y, z] = OnAxis::axes(o, d);
        self.intersect_numbers(x, y, z, t_max, from)
    }

    /// Whether anything is hit with `0 < t < t_max` that lies on neither of the surfaces in `skip`.
    #[inline(always)]
    pub fn occluded(&self, o: [f32; 3], d: [f32; 3], t_max: f32, skip: [u32; 2]) -> bool {
        let [x, y, z] = OnAxis::axes(o, d);
        self.occluded_numbers(x, y, z, t_max, skip)
    }

    /// [`Accel::intersect`] for every ray of a packet, with the same results.
    pub fn intersect_packet(&self, packet: &RayPacket) -> [Option<Hit>; PACKET_SIZE] {
        let mut hits = [None; PACKET_SIZE];
        let done = match &self.layout {
            Layout::Linear(_, _, few) => few.intersect(packet, &mut hits),
            Layout::Tree(tree) => tree.intersect_packet(packet, &mut hits),
        };
        if done.is_some() {
            if let Some(instances) = &self.instances {
                instances.intersect_packet(packet, &mut hits);
            }
            return hits;
        }
        for (i, hit) in hits.iter_mut().enumerate().take(packet.len()) {
            let (o, d, t_max, [from, _]) = packet.ray(i);
            *hit = self.intersect(o, d, t_max, from);
        }
        hits
    }

    /// [`Accel::occluded`] for every ray of a packet: one bit each.
    pub fn occluded_packet(&self, packet: &RayPacket) -> u32 {
        let done = match &self.layout {
            Layout::Linear(_, _, few) => few.occluded(packet),
            Layout::Tree(tree) => tree.occluded_packet(packet),
        };
        if let (Some(blocked), Some(instances)) = (done, &self.instances) {
            return instances.occluded_packet(packet, blocked);
        }
        done.unwrap_or_else(|| {
            (0..packet.len()).fold(0, |bits, i| {
                let (o, d, t_max, skip) = packet.ray(i);
                bits | u32::from(self.occluded(o, d, t_max, skip)) << i
            })
        })
    }

    #[inline(never)]
    fn intersect_numbers(
        &self,
        x: OnAxis,
        y: OnAxis,
        z: OnAxis,
        t_max: f32,
        from: u32,
    ) -> Option<Hit> {
        let ([o, d], skip) = (OnAxis::vectors(x, y, z), [from, NOWHERE]);
        match Ray::new(o, d, skip) {
            Some(ray) => self.nearest(&ray, t_max).hit(),
            None => self.intersect_odd(o, d, t_max, skip),
        }
    }

    #[inline(never)]
    fn occluded_numbers(
        &self,
        x: OnAxis,
        y: OnAxis,
        z: OnAxis,
        t_max: f32,
        skip: [u32; 2],
    ) -> bool {
        let [o, d] = OnAxis::vectors(x, y, z);
        match Ray::new(o, d, skip) {
            Some(ray) => self.blocked(&ray, t_max),
            None => self.occluded_odd(o, d, t_max, skip),
        }
    }

    #[cold]
    #[inline(never)]
    fn intersect_odd(&self, o: [f32; 3], d: [f32; 3], t_max: f32, skip: [u32; 2]) -> Option<Hit> {
        let (ray, scale) = Ray::rescaled(o, d, skip)?;
        let hit = self.nearest(&ray, t_max * scale).hit()?;
        Some(Hit {
            t: hit.t / scale,
            ..hit
        })
    }

    #[cold]
    #[inline(never)]
    fn occluded_odd(&self, o: [f32; 3], d: [f32; 3], t_max: f32, skip: [u32; 2]) -> bool {
        Ray::rescaled(o, d, skip).is_some_and(|(ray, scale)| self.blocked(&ray, t_max * scale))
    }

    #[inline(always)]
    fn nearest(&self, ray: &Ray, t_max: f32) -> Best {
        let mut best = Best::new(capped(t_max));
        self.search(ray, &mut best);
        if let Some(instances) = &self.instances {
            instances.intersect(ray, &mut best);
        }
        best
    }

    /// The nearest hit without instances, if it is nearer than `best`, which has nothing but its distance.
    #[inline(always)]
    fn search(&self, ray: &Ray, best: &mut Best) {
        match &self.layout {
            Layout::Linear(blocks, curved, _) => {
                blocks.intersect(ray, best);
                if !curved.is_empty() {
                    let line = Line::of(ray);
                    for (c, tag) in curved {
                        if let Some((t, u, v)) = c.intersect(&line, best.t) {
                            best.offer(t, u, v, *tag, ray.skip[0]);
                        }
                    }
                }
            }
            Layout::Tree(tree) => tree.intersect(ray, best),
        }
    }

    #[inline(always)]
    fn blocked(&self, ray: &Ray, t_max: f32) -> bool {
        let t_max = capped(t_max);
        self.blocks(ray, t_max) || (self.instances.as_ref()).is_some_and(|i| i.occluded(ray, t_max))
    }

    /// Whether anything but an instance is.
    #[inline(always)]
    fn blocks(&self, ray: &Ray, t_max: f32) -> bool {
        match &self.layout {
            Layout::Linear(blocks, curved, _) => {
                blocks.occluded(ray, t_max)
                    || (!curved.is_empty() && {
                        let line = Line::of(ray);
                        (curved.iter())
                            .any(|(c, tag)| !ray.skips(tag.surface) && c.occluded(&line, t_max))
                    })
            }
            Layout::Tree(tree) => tree.occluded(ray, t_max),
        }
    }

    /// Whether it is a hierarchy, not a list.
    #[inline]
    pub fn has_hierarchy(&self) -> bool {
        matches!(self.layout, Layout::Tree(_)) || self.instances.is_some()
    }

    /// Heap and inline memory held, in bytes.
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>()
            + self.instances.as_ref().map_or(0, |i| i.memory_bytes())
            + match &self.layout {
                Layout::Linear(blocks, curved, few) => {
                    blocks.memory_bytes()
                        + curved.capacity() * size_of::<(Curved, Tag)>()
                        + few.memory_bytes()
                }
                Layout::Tree(tree) => tree.memory_bytes(),
            }
    }
}

/// A primitive in the form its intersection test wants.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Flat(Flat<f32>),
    Curved(Curved),
}

/// Which primitive it is, and on which surface.
#[derive(Clone, Copy, Debug)]
struct Tag {
    /// Four times the index of the primitive, and which of its corners is the first one of the triangle that is tested,
    /// see [`turned`].
    id: u32,
    surface: u32,
}

impl Tag {
    const EMPTY: Tag = Tag {
        id: u32::MAX,
        surface: u32::MAX,
    };

    fn prim(self) -> usize {
        (self.id >> 2) as usize
    }
}

/// The hit of a primitive by its [`Tag::id`], with coordinates on the triangle as it was given.
#[inline(always)]
fn hit_of(id: u32, t: f32, u: f32, v: f32) -> Hit {
    let w = 1.0 - u - v;
    let [u, v] = match id & 3 {
        0 => [u, v],
        1 => [w, u],
        _ => [v, w],
    };
    Hit {
        t,
        u,
        v,
        prim: id >> 2,
    }
}

/// A triangle from the corner that faces its longest side, and which corner that is.
///
/// Barycentric coordinates are known up to roundings that go with one over the height above a side. Across the side that
/// both share these add up: if it is the longest one, neighbours overlap there by at most twice as much as elsewhere,
/// however thin they are.
fn turned(p: &Primitive) -> (Primitive, u32) {
    let Primitive::Triangle { v0, e1, e2 } = *p else {
        return (*p, 0);
    };
    let [a, b] = both([e1, e2], |e| each(e, f64::from));
    let c = each([0, 1, 2], |k: usize| b[k] - a[k]);
    let squared = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
    let [ab, ac, bc] = each([a, b, c], squared);
    let back = |e: [f32; 3]| each(e, |x| -x);
    let from = |e: [f32; 3]| each([0, 1, 2], |k: usize| v0[k] + e[k]);
    let c = each(c, |x| x as f32);
    if bc >= ab.max(ac) {
        (*p, 0)
    } else if ac >= ab {
        let (v0, e1, e2) = (from(e1), c, back(e1));
        (Primitive::Triangle { v0, e1, e2 }, 1)
    } else {
        let (v0, e1, e2) = (from(e2), back(e2), back(c));
        (Primitive::Triangle { v0, e1, e2 }, 2)
    }
}

/// A primitive that can be hit.
#[derive(Clone, Copy, Debug)]
struct Item {
    primitive: Primitive,
    tag: Tag,
    /// Corners of a box around it.
    bounds: [[f32; 3]; 2],
}

impl Item {
    /// What its intersection test wants: computed where it is needed, because it takes more memory than all else. There
    /// is always one.
    fn shape(&self, points: &[[f32; 4]]) -> Option<Shape> {
        shape(&self.primitive, points)
    }

    fn is_curved(&self) -> bool {
        !matches!(
            self.primitive,
            Primitive::Triangle { .. } | Primitive::Parallelogram { .. }
        )
    }
}

/// `None` if it can never be hit.
#[inline(always)]
fn shape(p: &Primitive, points: &[[f32; 4]]) -> Option<Shape> {
    match *p {
        Primitive::Triangle { v0, e1, e2 } => Flat::new(v0, e1, e2, true).map(Shape::Flat),
        Primitive::Parallelogram { v0, e1, e2 } => Flat::new(v0, e1, e2, false).map(Shape::Flat),
        Primitive::Sphere { center, radius } => Curved::sphere(center, radius).map(Shape::Curved),
        Primitive::Disk { center, e1, e2 } => Curved::disk(center, e1, e2).map(Shape::Curved),
        Primitive::Cylinder { p0, axis, radius } => {
            Curved::cylinder(p0, axis, radius).map(Shape::Curved)
        }
        Primitive::Cone { p0, axis, radii } => {
            Cone::new(p0, axis, radii).map(|cone| Shape::Curved(Curved::Cone(cone)))
        }
        Primitive::Span { first, part, .. } => {
            let four = points.get(first as usize..)?.first_chunk::<4>()?;
            Span::new(*four, part).map(|span| Shape::Curved(Curved::Span(span)))
        }
    }
}

/// So many primitives are prepared by one thread.
const PREPARED_TOGETHER: usize = 1 << 14;

/// Checks the input, and drops what can never be hit.
fn prepare(
    prims: &[Primitive],
    surfaces: &[u32],
    points: &[[f32; 4]],
) -> Result<Vec<Item>, AccelError> {
    if prims.len() > MAX_PRIMITIVES {
        return Err(AccelError::TooMany { found: prims.len() });
    }
    let parts = parallel::ranges(prims.len(), PREPARED_TOGETHER, |range| {
        let mut items = Vec::with_capacity(range.len());
        for i in range {
            let p = prims[i];
            let (vectors, radius) = match p {
                Primitive::Triangle { v0, e1, e2 } | Primitive::Parallelogram { v0, e1, e2 } => {
                    ([v0, e1, e2], 0.0)
                }
                Primitive::Disk { center, e1, e2 } => ([center, e1, e2], 0.0),
                Primitive::Sphere { center, radius } => ([center, [0.0; 3], [0.0; 3]], radius),
                Primitive::Cylinder { p0, axis, radius } => ([p0, axis, [0.0; 3]], radius),
                Primitive::Cone { p0, axis, radii } => {
                    ([p0, axis, [0.0; 3]], radii[0].max(radii[1]))
                }
                Primitive::Span {
                    end_points: [a, b],
                    radius,
                    ..
                } => ([a, b, [0.0; 3]], radius),
            };
            let numbers = vectors.iter().flatten().chain([&radius]);
            if let Some(&found) = numbers
                .into_iter()
                .find(|x| !x.is_finite() || x.abs() > MAX_COORDINATE)
            {
                return Err(AccelError::Coordinate {
                    primitive: i,
                    found,
                });
            }
            let (primitive, turn) = turned(&p);
            if shape(&primitive, points).is_some() {
                items.push(Item {
                    primitive,
                    tag: Tag {
                        id: (i as u32) << 2 | turn,
                        surface: surfaces[i],
                    },
                    bounds: bounds(&p),
                });
            }
        }
        Ok(items)
    });
    let mut items = Vec::with_capacity(prims.len());
    for part in parts {
        items.extend(part?);
    }
    Ok(items)
}

/// Corners of a box around a primitive, rounded outwards.
pub(crate) fn bounds(p: &Primitive) -> [[f32; 3]; 2] {
    let axis = |k: usize| -> (f64, f64) {
        let at = |x: [f32; 3]| f64::from(x[k]);
        match *p {
            Primitive::Triangle { v0, e1, e2 } => (
                at(v0) + at(e1).min(at(e2)).min(0.0),
                at(v0) + at(e1).max(at(e2)).max(0.0),
            ),
            Primitive::Parallelogram { v0, e1, e2 } => (
                at(v0) + at(e1).min(0.0) + at(e2).min(0.0),
                at(v0) + at(e1).max(0.0) + at(e2).max(0.0),
            ),
            Primitive::Sphere { center, radius } => (
                at(center) - f64::from(radius),
                at(center) + f64::from(radius),
            ),
            Primitive::Disk { center, e1, e2 } => {
                let half = at(e1).hypot(at(e2));
                (at(center) - half, at(center) + half)
            }
            Primitive::Cylinder { p0, axis, radius } => {
                let squared: f64 = axis.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
                let sine = (1.0 - at(axis) * at(axis) / squared).max(0.0).sqrt();
                let half = f64::from(radius) * sine;
                (
                    at(p0) + at(axis).min(0.0) - half,
                    at(p0) + at(axis).max(0.0) + half,
                )
            }
            Primitive::Cone { p0, axis, radii } => {
                let [a, b] = radii.map(f64::from);
                let (p, q) = (at(p0), at(p0) + at(axis));
                ((p - a).min(q - b), (p + a).max(q + b))
            }
            Primitive::Span {
                end_points: [a, b],
                radius,
                ..
            } => {
                let radius = f64::from(radius);
                (at(a).min(at(b)) - radius, at(a).max(at(b)) + radius)
            }
        }
    };
    let sides = [axis(0), axis(1), axis(2)];
    [
        each(sides, |s| (s.0 as f32).next_down()),
        each(sides, |s| (s.1 as f32).next_up()),
    ]
}

/// Origin and direction of a ray along one axis. A call passes two numbers in registers, where vectors would go through
/// memory and stall.
#[derive(Clone, Copy)]
struct OnAxis {
    o: f32,
    d: f32,
}

impl OnAxis {
    #[inline(always)]
    fn axes(o: [f32; 3], d: [f32; 3]) -> [Self; 3] {
        [0, 1, 2].map(|k| Self { o: o[k], d: d[k] })
    }

    /// Origin and direction.
    #[inline(always)]
    fn vectors(x: Self, y: Self, z: Self) -> [[f32; 3]; 2] {
        [[x.o, y.o, z.o], [x.d, y.d, z.d]]
    }
}

/// A ray with finite numbers of sane size.
#[derive(Clone, Copy, Debug)]
struct Ray {
    o: [f32; 3],
    d: [f32; 3],
    /// Sum of the absolute components of `d`: bounds its length.
    size: f32,
    /// Surfaces that it does not meet.
    skip: [u32; 2],
}

impl Ray {
    /// `None` unless the direction is about as long as a unit vector and the origin in reach.
    #[inline(always)]
    fn new(o: [f32; 3], d: [f32; 3], skip: [u32; 2]) -> Option<Ray> {
        // Sums of magnitudes keep NaN and infinity, which max() would not.
        let size = d[0].abs() + d[1].abs() + d[2].abs();
        let reach = o[0].abs() + o[1].abs() + o[2].abs();
        let sane = size > 0.25 && size < 4.0 && reach <= 3.0 * MAX_COORDINATE;
        sane.then_some(Ray { o, d, size, skip })
    }

    #[inline(always)]
    fn skips(&self, surface: u32) -> bool {
        self.skip[0] == surface || self.skip[1] == surface
    }

    /// Brings the direction to unit size by a power of two, which rounds nothing; and the factor
    /// that converts the caller's distances to the ray's. `None` if that is hopeless.
    #[cold]
    fn rescaled(o: [f32; 3], d: [f32; 3], skip: [u32; 2]) -> Option<(Ray, f32)> {
        let largest = d.iter().fold(0.0, |m: f32, x| m.max(x.abs()));
        let sum: f32 = o.iter().chain(&d).map(|x| x.abs()).sum();
        let reach = o.iter().fold(0.0, |m: f32, x| m.max(x.abs()));
        // Directions beyond this range would overflow distances.
        if !sum.is_finite() || reach > 3.0 * MAX_COORDINATE || !(1e-18..1e18).contains(&largest) {
            return None;
        }
        let exponent = (largest.to_bits() >> 23) as i32 - 127;
        let down = f32::from_bits(((127 - exponent) as u32) << 23);
        let up = f32::from_bits(((127 + exponent) as u32) << 23);
        let d = each(d, |x| x * down);
        let size = d[0].abs() + d[1].abs() + d[2].abs();
        Some((Ray { o, d, size, skip }, up))
    }
}

/// Nothing can be farther than the cap, and with it the flat test stays finite. NaN stays NaN,
/// which no distance is below.
#[inline(always)]
fn capped(t_max: f32) -> f32 {
    const CAP: f32 = 1e15;
    if t_max > CAP { CAP } else { t_max }
}

/// Best hit so far.
#[derive(Clone, Copy, Debug)]
struct Best {
    t: f32,
    u: f32,
    v: f32,
    /// See [`Tag::id`].
    id: u32,
    found: bool,
}

impl Best {
    #[inline(always)]
    fn new(t_max: f32) -> Best {
        // Primitive 0 as the start value makes every tie with t_max lose.
        Best {
            t: t_max,
            u: 0.0,
            v: 0.0,
            id: 0,
            found: false,
        }
    }

    #[inline(always)]
    fn offer(&mut self, t: f32, u: f32, v: f32, tag: Tag, from: u32) {
        let Tag { id, surface } = tag;
        if (t < self.t || (t == self.t && id < self.id)) && surface != from {
            *self = Best {
                t,
                u,
                v,
                id,
                found: true,
            };
        }
    }

    #[inline(always)]
    fn hit(self) -> Option<Hit> {
        self.found.then(|| hit_of(self.id, self.t, self.u, self.v))
    }
}
