//! Importance-driven radiance transport with hierarchical finite elements [Christensen et al. 1993].
//!
//! Surfaces are quadtrees of [`element`]s, each with a distribution of outgoing radiance and one of
//! outgoing importance over a directional [`basis`] (a single number where the surface is diffuse: the
//! method is then hierarchical radiosity). [`link`]s carry radiance from element to element at the
//! level at which that is accurate enough; importance, sent out by the camera, takes the same links
//! backwards through the same code, because outgoing importance and radiance obey the same equation. A
//! link is refined while
//!
//! `radiance sent along it x importance of its receiver towards it x variation of its kernel`
//!
//! is above a tolerance: directions that do not matter and parts of the scene that send nothing to
//! the camera stay coarse. Without importance every surface counts as what it reflects.
//!
//! With `G` the links, `R` reflection and `P` the sum over levels, `S = P R` is symmetric and
//! `L = P E + S G L`, `Gamma = Gamma_0 + S G^T Gamma` are solved; `<Gamma_0, G L> = <Gamma, G P E>` holds to
//! rounding, and one importance solution gives the derivative of the cost in *all* parameters
//! ([`FiniteElements::gradient`], [Stam, Eq. 12-14]). Pictures ([`FiniteElements::flat`],
//! [`FiniteElements::interpolated`]) take the last reflection, to the eye, by the BRDF itself instead of through
//! the basis; the cost and its derivatives do not.
//!
//! A lamp over a floor: the mean of what the camera sees, and its derivatives from one solution for importance.
//!
//! ```
//! use render::Scene;
//! use render::finite_element::{FiniteElements, Options};
//! use render::scene::LoadOptions;
//!
//! let file = r#"<scene version="3.0.0">
//!     <sensor type="perspective">
//!         <transform name="to_world"><lookat origin="0, 2, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
//!         <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
//!     </sensor>
//!     <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="-90"/></transform>
//!         <bsdf type="diffuse" id="floor"/></shape>
//!     <shape type="rectangle" id="lamp">
//!         <transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="1"/></transform>
//!         <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
//!         <emitter type="area"><rgb name="radiance" value="3"/></emitter></shape>
//! </scene>"#;
//! let (scene, _warnings) = Scene::from_xml(file, ".".as_ref(), &LoadOptions::default())?;
//! let mut elements = FiniteElements::new(&scene, Options::default())?;
//! for tolerance in [4e-3, 2e-3, 1e-3] {
//!     elements.solve()?;
//!     elements.refine(tolerance);
//! }
//! elements.solve()?;
//! let gradient = elements.gradient(&["lamp.emitter.radiance.value"])?;
//! // Light is linear in emission.
//! let by_emission: f64 = gradient[0].values.iter().map(|d| 3.0 * d).sum();
//! assert!((by_emission / elements.cost() - 1.0).abs() < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Does not handle
//! Shapes other than rectangles and cubes, lights other than area lights, textures, and materials
//! other than diffuse and rough conductor: errors that name them. A shape is first seen by 16 pairs of
//! points: an occluder much smaller than an element can be overlooked while that is coarse.

mod adjoint;
pub mod basis;
pub mod discrete;
pub mod element;
pub mod link;
pub mod solve;

pub use adjoint::ParameterGradient;
pub use basis::{Directions, Spread, Stencil};

use std::collections::HashMap;

use ad_core::{Real, Vec2, Vec3};
use rayon::prelude::*;
use thiserror::Error;

use crate::bsdf::{Bsdf, Shading, TransportMode};
use crate::emitter::Emitter;
use crate::film::Image;
use crate::math::Rgb;
use crate::params::Theta;
use crate::scene::Scene;
use element::{Kind, Mesh, Side};
use link::{Connection, Link, SAMPLES};
use solve::{Colour, Field, Flow, Operator, Order, Table};

/// Why a scene cannot be solved.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FiniteElementError {
    /// A shape or its material.
    #[error("shape `{name}` cannot be divided into elements: {reason}")]
    Shape {
        /// Its name.
        name: String,
        /// What is supported.
        reason: &'static str,
    },
    /// A light.
    #[error("emitter {index} cannot be divided into elements: {reason}")]
    Emitter {
        /// Its index.
        index: usize,
        /// What is supported.
        reason: &'static str,
    },
    /// A lobe between the nodes of the directional basis.
    #[error(
        "shape `{name}`: its lobe is too sharp for {side} x {side} directions, the discrete albedo \
         is {albedo:.3}"
    )]
    TooSharp {
        /// Name of a shape with the material.
        name: String,
        /// Directions along one side of the grid.
        side: usize,
        /// What the basis makes of the largest albedo.
        albedo: f64,
    },
    /// The iteration did not come to rest.
    #[error("transport does not converge: relative change {change:e} per bounce")]
    Diverges {
        /// Of the last iteration.
        change: f64,
    },
    /// A vector of parameters, or an option.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// What it is.
        what: &'static str,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
    },
}

/// How finely a scene may be modelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Directions along one side of the basis of glossy surfaces, 2 to 64.
    pub directions: usize,
    /// Refine by importance as well as by radiance.
    pub importance: bool,
    /// Elements are at least this fraction of the largest surface.
    pub finest: f64,
    /// Links are made between elements of at most this fraction of the largest surface where nothing
    /// seems to get through.
    pub coarsest: f64,
    /// No refinement starts with more links than this.
    pub max_links: usize,
    /// Accuracy of the iteration, relative.
    pub tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            directions: 16,
            importance: true,
            finest: 1.0 / 16384.0,
            coarsest: 1.0 / 16.0,
            max_links: 4_000_000,
            tolerance: 1e-5,
        }
    }
}

/// What a pixel sees.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    root: u32,
    uv: [f64; 2],
    /// Emitter and cosine lobe of a lamp that is seen.
    lamp: Option<(u32, f64)>,
}

/// How large a solution is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Statistics {
    /// Elements of all levels.
    pub elements: usize,
    /// Links that carry radiance.
    pub radiance_links: usize,
    /// Links that carry importance: the same again, or none.
    pub importance_links: usize,
    /// Numbers in the fields, over elements, directions and channels.
    pub values: usize,
    /// Bytes of elements, links, tables and fields.
    pub bytes: usize,
}

impl Statistics {
    /// Links of both kinds.
    pub fn links(&self) -> usize {
        self.radiance_links + self.importance_links
    }
}

/// A scene as a hierarchy of elements and links, with its solution.
#[derive(Debug)]
pub struct FiniteElements<'a> {
    scene: &'a Scene,
    options: Options,
    theta: Vec<f64>,
    mesh: Mesh,
    sides: Vec<Side>,
    tables: Vec<Table>,
    links: Vec<Link>,
    order: Order,
    pixels: Vec<Option<Pixel>>,
    radiance: Field,
    importance: Field,
}

/// Luminance-free size of a colour.
fn mean(c: Colour) -> f64 {
    (c[0] + c[1] + c[2]) / 3.0
}

/// Where materials are evaluated: they are constant over a surface.
fn middle<'a, R: Real<Primal = f64>>(theta: &Theta<'a, R>) -> Shading<'a, R> {
    Shading::new(*theta, Vec2::lift(Vec2::new(0.5, 0.5)))
}

impl<'a> FiniteElements<'a> {
    /// The coarsest model of a scene: whole surfaces, all linked. Parameters are those of the scene.
    ///
    /// # Errors
    /// Anything that is not supported, with its name.
    pub fn new(scene: &'a Scene, options: Options) -> Result<Self, FiniteElementError> {
        if !scene.camera.is_pinhole() {
            return Err(FiniteElementError::Value {
                what: "camera",
                expected: "a pinhole".into(),
                found: "a lens, or parallel rays".into(),
            });
        }
        if !(2..=64).contains(&options.directions) {
            return Err(FiniteElementError::Value {
                what: "directions",
                expected: "2 to 64".into(),
                found: options.directions.to_string(),
            });
        }
        let (mesh, sides) = element::mesh(scene, options.directions)?;
        let theta: Vec<f64> = scene.params().values().iter().map(|&v| v.into()).collect();
        let mut fem = Self {
            scene,
            options,
            theta: Vec::new(),
            mesh,
            sides,
            tables: Vec::new(),
            links: Vec::new(),
            order: Order::default(),
            pixels: Vec::new(),
            radiance: Vec::new(),
            importance: Vec::new(),
        };
        fem.set_params(&theta)?;
        fem.pixels = fem.look();
        let roots = fem.mesh.roots.len() as u32;
        let receivers =
            (0..roots).filter(|&r| matches!(fem.mesh.roots[r as usize].kind, Kind::Surface(_)));
        let pairs: Vec<(u32, u32)> = receivers
            .flat_map(|e| (0..roots).filter(move |&s| s != e).map(move |s| (e, s)))
            .collect();
        fem.links = fem.connect(pairs);
        fem.arrange();
        Ok(fem)
    }

    /// Changes parameters; elements and links stay. The solution is that of the old values until
    /// [`FiniteElements::solve`].
    ///
    /// # Errors
    /// Wrong length; a lobe that is too sharp for the basis.
    pub fn set_params(&mut self, theta: &[f64]) -> Result<(), FiniteElementError> {
        let expected = self.scene.params().values().len();
        if theta.len() != expected || theta.iter().any(|v| !v.is_finite()) {
            return Err(FiniteElementError::Value {
                what: "parameters",
                expected: format!("{expected} finite values"),
                found: format!("{} values", theta.len()),
            });
        }
        let view = Theta::constant(theta);
        let tables: Vec<Table> = (self.sides.iter())
            .map(|side| self.table(&self.reflection::<f64>(&view, side)))
            .collect();
        for (table, side) in tables.iter().zip(&self.sides) {
            let albedo = table.albedo.iter().fold(0.0, |m: f64, a| m.max(*a));
            if albedo > 1.1 {
                return Err(FiniteElementError::TooSharp {
                    name: self.scene.shape_info(side.shape).name.clone(),
                    side: self.options.directions,
                    albedo,
                });
            }
        }
        self.tables = tables;
        self.theta = theta.to_vec();
        Ok(())
    }

    fn basis(&self, side: &Side) -> Directions {
        Directions {
            side: if side.diffuse {
                1
            } else {
                self.options.directions
            },
        }
    }

    /// The BRDF between all nodes of a side, the lower triangle row by row.
    fn reflection<R: Real<Primal = f64>>(&self, theta: &Theta<R>, side: &Side) -> Vec<Rgb<R>> {
        let basis = self.basis(side);
        let material = &self.scene.materials()[side.material as usize];
        let at = middle(theta);
        let up = if side.behind { -1.0 } else { 1.0 };
        let node = |i| {
            let w = basis.node(i);
            Vec3::new(w.x, w.y, up * w.z)
        };
        let mut values = Vec::with_capacity(basis.len() * (basis.len() + 1) / 2);
        for i in 0..basis.len() {
            for j in 0..=i {
                let (wo, wi) = (node(i), node(j));
                let f = material.eval(&at, Vec3::lift(wo), Vec3::lift(wi), TransportMode::Radiance);
                values.push(f.scale(1.0 / wi.z.abs()));
            }
        }
        values
    }

    fn table(&self, triangle: &[Rgb<f64>]) -> Table {
        // n (n + 1) / 2 values.
        let nodes = ((8.0 * triangle.len() as f64 + 1.0).sqrt() * 0.5 - 0.5).round() as usize;
        let at = |i: usize, j: usize| i.max(j) * (i.max(j) + 1) / 2 + i.min(j);
        let mut values = vec![[0.0; 3]; nodes * nodes];
        for i in 0..nodes {
            for j in 0..nodes {
                values[i * nodes + j] = triangle[at(i, j)].to_array();
            }
        }
        basis::fit(nodes, &mut values);
        let basis = Directions {
            side: nodes.isqrt(),
        };
        let cells: Vec<f64> = (0..nodes).map(|i| basis.cell(i)).collect();
        let mut albedo = [0.0f64; 3];
        for row in values.chunks_exact(nodes.max(1)) {
            for c in 0..3 {
                let reflected = row.iter().zip(&cells).map(|(f, cell)| f[c] * cell);
                albedo[c] = albedo[c].max(reflected.sum());
            }
        }
        let row = |i: usize| &values[i * nodes..(i + 1) * nodes];
        let distance = (0..nodes * nodes).into_par_iter().map(|k| {
            let pairs = row(k / nodes).iter().zip(row(k % nodes)).zip(&cells);
            let moved = pairs.map(|((a, b), cell)| cell * (mean(*a) - mean(*b)).abs());
            moved.sum::<f64>() as f32
        });
        Table {
            nodes,
            distance: distance.collect(),
            albedo,
            values,
        }
    }

    /// What the centres of all pixels see.
    fn look(&self) -> Vec<Option<Pixel>> {
        let film = &self.scene.film;
        let [w, h] = film.crop_size;
        let hidden = self.scene.settings.hides(1);
        let pixel = |i: u32| {
            let at = |k: usize, p: u32| f64::from(film.crop_offset[k] + p) + 0.5;
            let ray = self.scene.camera.ray(at(0, i % w), at(1, i / w));
            let hit = self.scene.seen(&ray, hidden)?;
            let hit = self.scene.interaction(&Theta::still(), &ray, &hit);
            let (shape, p) = (hit.shape, hit.si.p);
            let seen = |r: &element::Root| {
                let height = r.normal.dot(p - r.corner).abs();
                r.shape == shape && r.normal.dot(ray.d) < 0.0 && height <= 1e-4 * r.area.sqrt()
            };
            let surface = (self.mesh.roots.iter())
                .position(|r| matches!(r.kind, Kind::Surface(_)) && seen(r))?;
            let lamp = self.mesh.roots.iter().find_map(|r| match r.kind {
                Kind::Lamp(e) if seen(r) => Some((e, (-r.normal.dot(ray.d)).powf(r.exponent))),
                _ => None,
            });
            let uv = self.mesh.roots[surface].coordinates(p);
            Some(Pixel {
                root: surface as u32,
                uv: [uv.x, uv.y],
                lamp,
            })
        };
        (0..w * h).into_par_iter().map(pixel).collect()
    }

    /// Links between these pairs; pairs that seem to be hidden are looked at in parts.
    fn connect(&mut self, mut pairs: Vec<(u32, u32)>) -> Vec<Link> {
        let largest = self.mesh.roots.iter().fold(0.0, |m: f64, r| m.max(r.area));
        let mut links = Vec::new();
        while !pairs.is_empty() {
            let (scene, mesh) = (self.scene, &self.mesh);
            let found: Vec<Connection> = pairs
                .par_iter()
                .map(|&(e, s)| link::connect(scene, mesh, e, s))
                .collect();
            let mut parts = Vec::new();
            for (&(e, s), c) in pairs.iter().zip(found) {
                match c {
                    Connection::Link(l) => links.push(l),
                    Connection::None => {}
                    Connection::Blocked => {
                        let (a, b) = (self.area(e), self.area(s));
                        if a.max(b) > self.options.coarsest * largest {
                            self.divide(e, s, &mut parts);
                        }
                    }
                }
            }
            pairs = parts;
        }
        links
    }

    fn area(&self, e: u32) -> f64 {
        self.mesh.elements[e as usize].area
    }

    /// The pairs that replace a pair: the larger element is quartered.
    fn divide(&mut self, e: u32, s: u32, pairs: &mut Vec<(u32, u32)>) {
        if self.area(e) >= self.area(s) {
            let first = self.mesh.subdivide(e);
            pairs.extend((first..first + 4).map(|e| (e, s)));
        } else {
            let first = self.mesh.subdivide(s);
            pairs.extend((first..first + 4).map(|s| (e, s)));
        }
    }

    /// Orders the links and gives new elements the values of those they are part of.
    fn arrange(&mut self) {
        self.links.sort_by_key(|l| (l.receiver, l.source));
        self.order = Order::new(&self.links, self.mesh.elements.len());
        for field in [&mut self.radiance, &mut self.importance] {
            let old = field.len();
            field.resize(self.mesh.values(), [0.0; 3]);
            for (e, el) in self.mesh.elements.iter().enumerate() {
                if let Some(parent) = el.parent
                    && self.mesh.start[e] >= old
                {
                    let from =
                        self.mesh.start[parent as usize]..self.mesh.start[parent as usize + 1];
                    field.copy_within(from, self.mesh.start[e]);
                }
            }
        }
    }

    fn operator(&self) -> Operator<'_> {
        Operator {
            mesh: &self.mesh,
            links: &self.links,
            order: &self.order,
            tables: &self.tables,
        }
    }

    /// The radiance of a lamp along its normal.
    fn emission(&self, emitter: u32) -> Colour {
        let texture = self.scene.emitters()[emitter as usize].radiance();
        let theta = Theta::<f64>::constant(&self.theta);
        texture.rgb(&theta, Vec2::new(0.5, 0.5)).to_array()
    }

    /// What lamps emit, before levels are combined.
    fn emitted(&self) -> Field {
        let mut own = vec![[0.0; 3]; self.mesh.values()];
        for (e, root) in self.mesh.roots.iter().enumerate() {
            if let Kind::Lamp(emitter) = root.kind {
                own[self.mesh.start[e]] = self.emission(emitter);
            }
        }
        own
    }

    /// The direction from the middle of an element to the camera.
    fn eye(&self, e: u32) -> Stencil {
        let root = self.mesh.root(e);
        let d = Vec3::from(self.scene.camera.origin()) - self.mesh.point(e, 0.5, 0.5);
        root.directions.stencil(root.frame.to_local(d.normalize()))
    }

    fn leaf(&self, p: &Pixel) -> u32 {
        self.mesh.leaf(p.root, p.uv[0], p.uv[1])
    }

    /// The importance that arrives from the camera, for the mean over pixels and channels.
    fn measured(&self) -> Field {
        let mut field = vec![[0.0; 3]; self.mesh.values()];
        let weight = 1.0 / (3.0 * self.pixels.len().max(1) as f64);
        for p in self.pixels.iter().flatten() {
            let e = self.leaf(p);
            let start = self.mesh.start[e as usize];
            let end = self.mesh.start[e as usize + 1];
            self.eye(e).add(&mut field[start..end], [weight; 3]);
        }
        field
    }

    /// Solves for radiance, and for importance if wanted, from the last solution, for the elements and links
    /// there are.
    ///
    /// # Errors
    /// Transport that does not converge.
    pub fn solve(&mut self) -> Result<(), FiniteElementError> {
        self.solve_to(self.options.tolerance, self.options.importance)
    }

    /// [`FiniteElements::solve`] with another accuracy, and importance in any case or not.
    ///
    /// # Errors
    /// As there.
    pub fn solve_to(&mut self, tolerance: f64, importance: bool) -> Result<(), FiniteElementError> {
        let t = self.operator();
        let radiance = t.solve(&self.emitted(), Flow::Radiance, &self.radiance, tolerance)?;
        let solved = if importance {
            let source = t.reflect(&self.measured());
            Some(t.solve(&source, Flow::Importance, &self.importance, tolerance)?)
        } else {
            None
        };
        self.radiance = radiance;
        if let Some(importance) = solved {
            self.importance = importance;
        }
        Ok(())
    }

    /// What a link may contribute wrongly, and what it contributes: in units of the mean pixel with
    /// importance, of reflected power without.
    fn error(&self, l: &Link) -> [f64; 2] {
        let mesh = &self.mesh;
        let (re, rs) = (mesh.root(l.receiver), mesh.root(l.source));
        let values = |e: u32| mesh.start[e as usize]..mesh.start[e as usize + 1];
        let leaving = &self.radiance[values(l.source)];
        let importance = &self.importance[values(l.receiver)];
        let Kind::Surface(table) = re.kind else {
            return [0.0; 2];
        };
        let table = &self.tables[table];
        let nearest = |s: &Stencil| {
            let best = (0..4).fold(0, |b, k| if s.weight[k] > s.weight[b] { k } else { b });
            usize::from(s.index[best])
        };
        let centre = l.receive.nearest();
        let single = re.directions.side == 1 && rs.directions.side == 1;
        let (mut low, mut high, mut sum): (f64, f64, f64) = (f64::INFINITY, 0.0, 0.0);
        let mut turned: f64 = 0.0;
        for k in 0..SAMPLES {
            let mut stencils = [Stencil::SINGLE; 2];
            if !single {
                let [a, b] = link::sample(k);
                let x = mesh.point(l.receiver, a[0], a[1]);
                let d = (mesh.point(l.source, b[0], b[1]) - x).normalize();
                stencils = [
                    re.directions.stencil(re.frame.to_local(d)),
                    rs.directions.stencil(rs.frame.to_local(-d)),
                ];
            }
            let kernel = f64::from(l.kernel[k]);
            let radiance = stencils[1].read(leaving);
            let weight = if self.options.importance {
                stencils[0].read(importance)
            } else {
                let moved = f64::from(table.distance[nearest(&stencils[0]) * table.nodes + centre]);
                turned = turned.max(kernel * mean(radiance) * moved);
                table.albedo
            };
            let p = kernel * (0..3).map(|c| radiance[c] * weight[c]).sum::<f64>();
            low = low.min(p);
            high = high.max(p);
            sum += p;
        }
        if l.peak > 0.0 {
            let radiance = l.send.read(leaving);
            let weight = if self.options.importance {
                l.receive.read(importance)
            } else {
                table.albedo
            };
            let p = (0..3).map(|c| radiance[c] * weight[c]).sum::<f64>();
            high = high.max(f64::from(l.peak) * p);
        }
        [high - low + 3.0 * turned, sum / SAMPLES as f64]
    }

    /// Refines every link whose error is above `tolerance` times all that links transport, and the links that
    /// replace it, up to four levels at once. Returns how many were refined: 0 means that the tolerance is met as far as
    /// the finest elements allow.
    pub fn refine(&mut self, tolerance: f64) -> usize {
        const LEVELS: usize = 4;
        let largest = self.mesh.roots.iter().fold(0.0, |m: f64, r| m.max(r.area));
        let errors: Vec<[f64; 2]> = self.links.par_iter().map(|l| self.error(l)).collect();
        let limit = tolerance * errors.iter().map(|e| e[1]).sum::<f64>();
        let mut refined = 0;
        for _ in 0..LEVELS {
            if self.links.len() > self.options.max_links {
                break;
            }
            let errors: Vec<[f64; 2]> = self.links.par_iter().map(|l| self.error(l)).collect();
            let mut pairs = Vec::new();
            let mut kept = Vec::with_capacity(self.links.len());
            for (l, error) in std::mem::take(&mut self.links).into_iter().zip(errors) {
                let size = self.area(l.receiver).max(self.area(l.source));
                if error[0] > limit && 0.25 * size >= self.options.finest * largest {
                    self.divide(l.receiver, l.source, &mut pairs);
                    refined += 1;
                } else {
                    kept.push(l);
                }
            }
            let done = pairs.is_empty();
            let new = self.connect(pairs);
            self.links = kept;
            self.links.extend(new);
            self.arrange();
            if done {
                break;
            }
        }
        refined
    }

    /// The mean over pixels and channels of the image, as measured from radiance through the directional basis.
    pub fn cost(&self) -> f64 {
        solve::dot(&self.measured(), &self.radiance) + self.seen_directly()
    }

    /// The same number from the importance that arrives at lamps.
    pub fn cost_by_importance(&self) -> f64 {
        let t = self.operator();
        let emitted = t.push_pull(&self.emitted());
        let arriving = t.incident(&self.importance, Flow::Importance);
        solve::dot(&arriving, &emitted) + self.seen_directly()
    }

    /// The part of the cost that is lamps in the picture.
    fn seen_directly(&self) -> f64 {
        let lamps = self.pixels.iter().flatten().filter_map(|p| p.lamp);
        let sum: f64 = lamps.map(|(e, lobe)| mean(self.emission(e)) * lobe).sum();
        sum / self.pixels.len().max(1) as f64
    }

    /// How large the model is.
    pub fn statistics(&self) -> Statistics {
        let tables: usize = self
            .tables
            .iter()
            .map(|t| size_of_val(&t.values[..]) + size_of_val(&t.distance[..]))
            .sum();
        let spread = |l: &Link| l.receive.bytes() + l.send.bytes();
        let spreads: usize = self.links.iter().map(spread).sum();
        let fields = if self.options.importance { 2 } else { 1 };
        Statistics {
            elements: self.mesh.elements.len(),
            radiance_links: self.links.len(),
            importance_links: if self.options.importance {
                self.links.len()
            } else {
                0
            },
            values: 3 * self.mesh.values() * fields,
            bytes: tables
                + size_of_val(&self.mesh.elements[..])
                + size_of_val(&self.links[..])
                + spreads
                + self.mesh.values() * fields * size_of::<Colour>(),
        }
    }

    /// The radiance of an element towards the eye. The last reflection is by the BRDF itself, in the
    /// directions that links come from, so that lobes which the eye sees keep their shape however coarse the
    /// basis is.
    fn seen(&self, e: u32) -> Colour {
        let mesh = &self.mesh;
        let root = mesh.root(e);
        let Kind::Surface(table) = root.kind else {
            return [0.0; 3];
        };
        let radiance = |e: u32| &self.radiance[mesh.start[e as usize]..mesh.start[e as usize + 1]];
        if root.directions.side == 1 {
            return radiance(e)[0];
        }
        let d = Vec3::from(self.scene.camera.origin()) - mesh.point(e, 0.5, 0.5);
        if root.normal.dot(d) <= 0.0 {
            return [0.0; 3];
        }
        let wo = root.frame.to_local(d.normalize());
        let theta = Theta::constant(&self.theta);
        let at = middle(&theta);
        let material = &self.scene.materials()[self.sides[table].material as usize];
        let mut sum = [0.0; 3];
        // Links end at the element or at one that it is a part of.
        for a in std::iter::successors(Some(e), |&a| mesh.elements[a as usize].parent) {
            let scale = 1.0 / (SAMPLES as f64 * mesh.elements[a as usize].area);
            for l in &self.links[self.order.received(a)] {
                let arriving = l.send.read(radiance(l.source));
                if arriving == [0.0; 3] {
                    continue;
                }
                let mut reflected = [0.0; 3];
                for (k, kernel) in l.kernel.iter().enumerate().filter(|(_, g)| **g > 0.0) {
                    let [x, y] = link::sample(k);
                    let d = mesh.point(l.source, y[0], y[1]) - mesh.point(a, x[0], x[1]);
                    let wi = root.frame.to_local(d.normalize());
                    let f = material
                        .eval(&at, wo, wi, TransportMode::Radiance)
                        .to_array();
                    let weight = scale * f64::from(*kernel) / wi.z.abs();
                    (0..3).for_each(|c| reflected[c] += weight * f[c]);
                }
                (0..3).for_each(|c| sum[c] += reflected[c] * arriving[c]);
            }
        }
        sum
    }

    /// [`FiniteElements::seen`] of all elements that are not divided, black for the others.
    fn leaves(&self) -> Vec<Colour> {
        let elements = self.mesh.elements.par_iter().enumerate();
        let leaf = |(e, el): (usize, &element::Element)| match el.children {
            None => self.seen(e as u32),
            Some(_) => [0.0; 3],
        };
        elements.map(leaf).collect()
    }

    fn image(&self, value: impl Fn(&Pixel) -> Colour) -> Image {
        let [w, h] = self.scene.film.crop_size;
        let mut image = Image::new(w as usize, h as usize);
        for (p, out) in self.pixels.iter().zip(image.data.chunks_exact_mut(3)) {
            let Some(p) = p else { continue };
            let mut colour = value(p);
            if let Some((e, lobe)) = p.lamp {
                let emission = self.emission(e);
                for c in 0..3 {
                    colour[c] += emission[c] * lobe;
                }
            }
            for c in 0..3 {
                out[c] = colour[c] as f32;
            }
        }
        image
    }

    /// The picture with one radiance per element.
    pub fn flat(&self) -> Image {
        let leaves = self.leaves();
        self.image(|p| leaves[self.leaf(p) as usize])
    }

    /// The picture with radiance interpolated between the corners of elements.
    pub fn interpolated(&self) -> Image {
        // Exact in units of the smallest element.
        const UNIT: f64 = (1u64 << 32) as f64;
        let key = |root: u32, u: f64, v: f64| (root, (u * UNIT) as u64, (v * UNIT) as u64);
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
        let mut sums: HashMap<(u32, u64, u64), (Colour, f64)> = HashMap::new();
        for (el, l) in self.mesh.elements.iter().zip(self.leaves()) {
            if el.children.is_some() {
                continue;
            }
            for [i, j] in corners {
                let k = key(el.root, el.at[0] + i * el.size, el.at[1] + j * el.size);
                let sum = sums.entry(k).or_default();
                (0..3).for_each(|c| sum.0[c] += l[c]);
                sum.1 += 1.0;
            }
        }
        self.image(|p| {
            let el = &self.mesh.elements[self.leaf(p) as usize];
            let (a, b) = (
                (p.uv[0] - el.at[0]) / el.size,
                (p.uv[1] - el.at[1]) / el.size,
            );
            let mut colour = [0.0; 3];
            for [i, j] in corners {
                let k = key(el.root, el.at[0] + i * el.size, el.at[1] + j * el.size);
                let weight = (1.0 - a - i + 2.0 * a * i) * (1.0 - b - j + 2.0 * b * j);
                if let Some((sum, n)) = sums.get(&k) {
                    (0..3).for_each(|c| colour[c] += weight * sum[c] / n);
                }
            }
            colour
        })
    }

    /// The surface that pixels see: tree and surface coordinates. `None` where that is nothing or a lamp, or
    /// where the pixel or a neighbour may see something else as well.
    pub fn surfaces(&self) -> Vec<Option<(u32, [f64; 2])>> {
        let [w, h] = self.scene.film.crop_size.map(i64::from);
        let tree = |x: i64, y: i64| {
            let inside = (0..w).contains(&x) && (0..h).contains(&y);
            let p = inside.then(|| self.pixels[(y * w + x) as usize]).flatten();
            p.filter(|p| p.lamp.is_none()).map(|p| p.root)
        };
        let pixel = |i: i64| {
            let (x, y) = (i % w, i / w);
            let p = self.pixels[i as usize]?;
            let around = (0..9).map(|k| tree(x + k % 3 - 1, y + k / 3 - 1));
            let alone = around.into_iter().all(|t| t == Some(p.root));
            alone.then_some((p.root, p.uv))
        };
        (0..w * h).map(pixel).collect()
    }

    /// All links.
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// All elements.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }
}
