//! All chains of one vertex between two ends, by proof.
//!
//! The surface of a caster is cut into smooth [`Piece`]s over two numbers each. Interval arithmetic leaves out those, and the boxes of
//! numbers, in which no half vector can lie along the normal; of a box where that is not enough, Krawczyk's operator proves
//! that it holds one root alone, or none, or it is cut into four. A tree over pieces, with bounds of positions and normals,
//! leaves out many at once.

use ad_core::krawczyk::{Bounded, isolated, rootless};
use ad_core::{Dual, Interval, Mat2, Real, Vec2, Vec3};
use smallvec::SmallVec;

use super::chain::Event;
use super::normal::{Normal, is_mapped};
use super::space::{Space, Start, Target};
use super::walk::Solution;
use crate::bsdf::DeltaKind;
use crate::bsdf::nesting::{Specular, facets};
use crate::math::Frame;
use crate::scene::{Scene, Uniqueness};
use crate::shape::{AnyShape, Mesh, Patch, Sphere, lift3};
use crate::texture::Texture;

/// Boxes are so much wider than the parts of a piece that they stand for, so that no root lies on the edge of all.
const OVERLAP: f64 = 1.125;
/// Half the size of boxes that are not cut any more, in parts of a piece.
const LEAST: f64 = 1e-7;
/// Most boxes on the pieces of a surface in one search: where whole curves are roots, it would never end.
const MOST_BOXES: u64 = 1 << 16;
/// How far beyond its edges a piece is searched: roots on edges of two pieces are found twice, and not lost.
const MARGIN: f64 = 1e-9;
/// Triangles thinner than this part of their length are left out: rays in single precision do not meet them, and across them
/// nothing changes that a search could go by.
const SLIVER: f64 = 1e-12;
/// Steps of Newton's method from the middle of a box with one root.
const NEWTON: u32 = 8;
/// The last of them is shorter than this part of the box.
const CONVERGED: f64 = 1e-3;
/// A chain has met what a root stands for up to this part of its first edge. It decides what hides a root, not where it is.
const MET: f64 = 1e-6;

/// What is not covered of shapes that are of no smooth pieces here.
const OTHER: &str = "its shape (expected a mesh, a sphere, a rectangle or a cube)";

/// A bound of a number that changes with two others.
type Bound = Dual<Interval, 2>;

/// A smooth part of a surface, over two numbers from zero to one.
#[derive(Clone, Copy, Debug)]
enum Piece {
    /// Positions and normals in the first corner, and what both numbers add to them.
    Linear {
        p: [Vec3<f64>; 3],
        n: [Vec3<f64>; 3],
        /// Whether the sum of both is one at most.
        triangle: bool,
    },
    /// An eighth of a sphere: outward between three axes, whose shares are the numbers and what is left to one. `side` is minus
    /// one where the normal points inward.
    Octant {
        center: Vec3<f64>,
        radius: f64,
        axes: [Vec3<f64>; 3],
        side: f64,
    },
}

impl Piece {
    /// A position, and a vector of some length along the normal there.
    #[inline]
    fn at<R: Real<Primal = f64>>(&self, [a, b]: [R; 2]) -> (Vec3<R>, Vec3<R>) {
        let lift = Vec3::<R>::lift;
        match self {
            Self::Linear { p, n, .. } => {
                let of = |x: &[Vec3<f64>; 3]| lift(x[0]) + lift(x[1]) * a + lift(x[2]) * b;
                (of(p), of(n))
            }
            Self::Octant {
                center,
                radius,
                axes: [x, y, z],
                side,
            } => {
                let outward = lift(*x) * a + lift(*y) * b + lift(*z) * (R::one() - a - b);
                let scale = length(outward).recip() * R::of(*radius);
                (lift(*center) + outward * scale, outward * R::of(*side))
            }
        }
    }

    /// How much more than one the sum of both numbers may be.
    fn excess(&self) -> f64 {
        match self {
            Self::Linear {
                triangle: false, ..
            } => 1.0,
            _ => 0.0,
        }
    }

    /// Whether it has such a place.
    fn has(&self, [a, b]: [f64; 2]) -> bool {
        let within = |x: f64, most: f64| (-MARGIN..=most + MARGIN).contains(&x);
        within(a, 1.0) && within(b, 1.0) && within(a + b, 1.0 + self.excess())
    }

    /// Bounds of positions and normals.
    fn bounds(&self) -> [Vec3<Interval>; 2] {
        match self {
            Self::Linear { triangle, .. } => {
                let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
                let corners = &corners[..if *triangle { 3 } else { 4 }];
                let mut all = corners.iter().map(|c| self.at(c.map(Interval::lift)));
                let first = all.next().map(|(p, n)| [p, n]).unwrap_or_default();
                all.fold(first, |[p, n], (q, m)| [hull(p, q), hull(n, m)])
            }
            Self::Octant { .. } => {
                let (p, n) = self.at([Interval::new(0.0, 1.0); 2]);
                [p, n]
            }
        }
    }
}

fn hull(a: Vec3<Interval>, b: Vec3<Interval>) -> Vec3<Interval> {
    Vec3::new(a.x.hull(b.x), a.y.hull(b.y), a.z.hull(b.z))
}

/// Without the squares that [`Vec3::length`] bounds as products of any two numbers.
#[inline]
fn length<R: Real>(v: Vec3<R>) -> R {
    (v.x.square() + v.y.square() + v.z.square()).sqrt()
}

/// What part of a tree over pieces holds.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// The piece of this index.
    Piece(u32),
    /// The node after this one, and that of this index.
    Both(u32),
}

#[derive(Clone, Copy, Debug)]
struct Node {
    p: Vec3<Interval>,
    n: Vec3<Interval>,
    part: Part,
}

/// The surface of a caster in smooth pieces, in a tree.
#[derive(Clone, Debug)]
pub struct Pieces {
    pieces: Vec<Piece>,
    nodes: Vec<Node>,
}

impl Pieces {
    /// Of a shape.
    ///
    /// # Errors
    /// Says what is not covered.
    pub fn of(scene: &Scene, shape: u32) -> Result<Self, &'static str> {
        Self::covers(scene, shape)?;
        let mut pieces = match &scene.shapes()[shape as usize] {
            AnyShape::Mesh(mesh) => of_mesh(mesh),
            AnyShape::Sphere(sphere) => of_sphere(sphere),
            AnyShape::Rectangle(rectangle) => vec![of_patch(&rectangle.0)],
            AnyShape::Cube(cube) => cube.faces().iter().map(of_patch).collect(),
            _ => return Err(OTHER),
        };
        let mut nodes = Vec::with_capacity(2 * pieces.len());
        if !pieces.is_empty() {
            let bounds = |piece: Piece| (piece, piece.bounds());
            let mut all: Vec<_> = pieces.into_iter().map(bounds).collect();
            build(&mut all, 0, &mut nodes);
            pieces = all.into_iter().map(|(piece, _)| piece).collect();
        }
        Ok(Self { pieces, nodes })
    }

    /// Whether a shape can be cut into pieces.
    ///
    /// # Errors
    /// Says what is not covered.
    pub fn covers(scene: &Scene, shape: u32) -> Result<(), &'static str> {
        let material = scene.material(shape);
        if is_mapped(material) {
            return Err("a normal map");
        }
        match facets(material) {
            Some(f) if f.roughness.is_some() => return Err("a rough surface"),
            Some(f) => match f.specular {
                Specular::Mirror | Specular::Interface(Texture::Constant(_)) => {}
                Specular::Interface(_) => return Err("an index that is a texture"),
            },
            None => return Err("its material"),
        }
        match &scene.shapes()[shape as usize] {
            AnyShape::Mesh(_)
            | AnyShape::Sphere(_)
            | AnyShape::Rectangle(_)
            | AnyShape::Cube(_) => Ok(()),
            _ => Err(OTHER),
        }
    }
}

/// Adds the tree over pieces, which it brings into an order, the first of which has this index.
fn build(all: &mut [(Piece, [Vec3<Interval>; 2])], first: u32, nodes: &mut Vec<Node>) {
    let [p, n] = all[1..]
        .iter()
        .fold(all[0].1, |[p, n], (_, [q, m])| [hull(p, *q), hull(n, *m)]);
    let at = nodes.len();
    nodes.push(Node {
        p,
        n,
        part: Part::Piece(first),
    });
    if all.len() == 1 {
        return;
    }
    let axis = (0..3).max_by(|&i, &j| p[i].width().total_cmp(&p[j].width()));
    let middle = |(_, [p, _]): &(Piece, [Vec3<Interval>; 2])| p[axis.unwrap_or(0)].middle();
    let half = all.len() / 2;
    all.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
    let (before, after) = all.split_at_mut(half);
    build(before, first, nodes);
    nodes[at].part = Part::Both(nodes.len() as u32);
    build(after, first + half as u32, nodes);
}

fn of_mesh(mesh: &Mesh) -> Vec<Piece> {
    let of = mesh.all_triangles().filter_map(|t| {
        let [v0, e1, e2] = [t.v0, t.edges[0], t.edges[1]].map(lift3::<f64>);
        let (zero, flat) = (Vec3::zero(), e1.cross(e2));
        let longest = e1.length_squared().max(e2.length_squared());
        if flat.length() <= SLIVER * longest {
            return None;
        }
        let flat = [flat, zero, zero];
        let n = match t.normals {
            Some([a, b, c]) if [a, b, c] != [[0.0; 3]; 3] => {
                let [a, b, c] = [a, b, c].map(lift3::<f64>);
                [a, b - a, c - a]
            }
            _ => flat,
        };
        Some(Piece::Linear {
            p: [v0, e1, e2],
            n: n.map(|n| if t.flip { -n } else { n }),
            triangle: true,
        })
    });
    of.collect()
}

fn of_patch(patch: &Patch) -> Piece {
    let zero = Vec3::zero();
    Piece::Linear {
        p: [patch.corner, patch.e1, patch.e2].map(lift3),
        n: [patch.normal(), zero, zero],
        triangle: false,
    }
}

fn of_sphere(sphere: &Sphere) -> Vec<Piece> {
    let ball = sphere.ball::<f64>();
    let octant = |i: u32| Piece::Octant {
        center: ball.center,
        radius: ball.radius,
        axes: [0, 1, 2].map(|k: usize| {
            let mut axis = [0.0; 3];
            axis[k] = if i >> k & 1 == 1 { -1.0 } else { 1.0 };
            Vec3::from(axis)
        }),
        side: if ball.flip { -1.0 } else { 1.0 },
    };
    (0..8).map(octant).collect()
}

/// On which sides of a normal the two neighbours of a vertex lie.
#[derive(Clone, Copy, Debug)]
enum Sides {
    /// On the same.
    Same,
    /// The one before in front of it, the other one behind.
    Through,
    /// The other way around.
    Out,
}

/// What is asked of all pieces: whether the half vector between two ends is along the normal.
struct Question<'q> {
    start: Vec3<f64>,
    target: &'q Target,
    sides: Sides,
    /// On the side of the start, and on that of the target.
    index: [f64; 2],
}

impl Question<'_> {
    /// The half vector, of some length, across the normal, and on what sides of that both ends are.
    #[inline]
    fn value<R: Real<Primal = f64>>(&self, p: Vec3<R>, n: Vec3<R>) -> (Vec3<R>, [R; 2]) {
        let w = Vec3::<R>::lift(self.start) - p;
        let [here, there] = self.index.map(R::of);
        let (h, next) = match *self.target {
            Target::Point(at) => {
                let next = Vec3::<R>::lift(at) - p;
                (w * (length(next) * here) + next * (length(w) * there), next)
            }
            Target::Direction(d) => {
                let next = Vec3::<R>::lift(d);
                (w * here + next * (length(w) * there), next)
            }
        };
        (h.cross(n), [n.dot(w), n.dot(next)])
    }

    /// Whether none of these positions with any of these normals is a root.
    fn excludes(&self, p: Vec3<Interval>, n: Vec3<Interval>) -> bool {
        let (across, [w, next]) = self.value(p, n);
        let apart = |x: Interval| x.lo() > 0.0 || x.hi() < 0.0;
        let [x, y, z] = across.to_array();
        apart(x)
            || apart(y)
            || apart(z)
            || match self.sides {
                Sides::Same => {
                    (w.lo() > 0.0 && next.hi() < 0.0) || (w.hi() < 0.0 && next.lo() > 0.0)
                }
                Sides::Through => w.hi() <= 0.0 || next.lo() >= 0.0,
                Sides::Out => w.lo() >= 0.0 || next.hi() <= 0.0,
            }
    }
}

/// All chains of one vertex between two ends.
#[derive(Clone, Debug, Default)]
pub struct Every {
    /// Distinct solutions, which nothing hides from their start.
    pub solutions: Vec<Solution>,
    /// Roots that were found: some on edges of two pieces, and hidden ones.
    pub roots: u64,
    /// Boxes that were looked at.
    pub boxes: u64,
    /// Boxes of which it is not known whether they hold a root: where there is none, no chain is missing.
    pub undecided: u64,
}

/// Where the search of one piece is, and what of it is left.
struct Search<'q> {
    question: &'q Question<'q>,
    piece: &'q Piece,
    /// Axes that differences are measured along; across the normal in the middle of the box.
    axes: [Vec3<f64>; 2],
}

impl Search<'_> {
    fn value<R: Real<Primal = f64>>(&self, at: [R; 2]) -> [R; 2] {
        let (p, n) = self.piece.at(at);
        let (across, _) = self.question.value(p, n);
        self.axes.map(|axis| across.dot_const(axis))
    }

    /// Bounds of values and derivatives over a box. Nothing in it is decided by numbers.
    fn bounds(&self, middle: [f64; 2], radius: f64) -> Bounded<2> {
        let number = |i: usize| Bound::var(Interval::around(middle[i], radius), i);
        self.value([number(0), number(1)])
    }

    /// The root of a box that has one, to rounding. `None` where Newton's method does not go there from the middle.
    fn root(&self, middle: [f64; 2], radius: f64) -> Option<[f64; 2]> {
        let (mut at, mut last) = (middle, f64::INFINITY);
        for _ in 0..NEWTON {
            let [a, b] = self.value([Dual::<f64, 2>::var(at[0], 0), Dual::var(at[1], 1)]);
            let inverse = Mat2::from_rows([a.eps, b.eps]).inverse()?;
            let step = inverse * Vec2::new(a.re, b.re);
            at = [at[0] - step.x, at[1] - step.y];
            last = f64::max(step.x.abs(), step.y.abs());
        }
        let within = (0..2).all(|i| (at[i] - middle[i]).abs() <= radius);
        (within && last <= CONVERGED * radius).then_some(at)
    }
}

impl Question<'_> {
    /// Where the roots on a piece are, box by box, with so many boxes `left`.
    fn search(
        &self,
        piece: &Piece,
        left: &mut u64,
        found: &mut Every,
        mut root: impl FnMut([f64; 2]),
    ) {
        let mut known = SmallVec::<[[f64; 2]; 4]>::new();
        let mut boxes = SmallVec::<[([f64; 2], f64); 32]>::new();
        boxes.push(([0.5; 2], 0.5));
        while let Some((middle, half)) = boxes.pop() {
            if *left == 0 {
                found.undecided += 1 + boxes.len() as u64;
                return;
            }
            let radius = half * OVERLAP;
            let [a, b] = middle.map(|x| Interval::around(x, radius));
            if (a + b).lo() > 1.0 + piece.excess() {
                continue;
            }
            found.boxes += 1;
            *left -= 1;
            let (p, normals) = piece.at([a, b]);
            if self.excludes(p, normals) {
                continue;
            }
            let (_, n) = piece.at(middle);
            let Frame { s, t, .. } = Frame::from_normal(n.normalize());
            let search = Search {
                question: self,
                piece,
                axes: [s, t],
            };
            let (at, over) = (search.bounds(middle, 0.0), search.bounds(middle, radius));
            if rootless(&at, &over, radius) {
                continue;
            }
            // The normal in the middle has to be one that all others of the box are within a right angle of.
            let ahead = normals.dot(Vec3::lift(n));
            let is_alone = ahead.lo() > 0.0 && isolated(&at, &over, radius).is_some();
            let within = |x: &&[f64; 2]| (0..2).all(|i| (x[i] - middle[i]).abs() <= radius);
            let known_root = known.iter().find(within).copied();
            let search_root = || known_root.or_else(|| search.root(middle, radius));
            if is_alone && let Some(at) = search_root() {
                if known_root.is_none() {
                    known.push(at);
                    if piece.has(at) {
                        root(at);
                    }
                }
            } else if half < LEAST {
                found.undecided += 1;
            } else {
                let quarter = 0.5 * half;
                for i in 0..4 {
                    let off = |up: bool| if up { quarter } else { -quarter };
                    let [x, y] = middle;
                    boxes.push(([x + off(i & 1 == 1), y + off(i & 2 == 2)], quarter));
                }
            }
        }
    }
}

impl Space<'_> {
    /// Adds all chains of one vertex between two ends, where this event happens on the shape that these pieces are of.
    ///
    /// Every place of the surface is either left out by proof, or within a box that has one root alone, or is one of those
    /// that are not decided, which are counted. What hides a root from the start leaves it out; what hides it from the
    /// target does not.
    pub fn every(
        &self,
        pieces: &Pieces,
        (start, target): (&Start, &Target),
        (shape, kind): (u32, DeltaKind),
        found: &mut Every,
    ) {
        let eta = match facets(self.scene.material(shape)).map(|f| f.specular) {
            Some(Specular::Interface(eta)) => eta.scalar(&self.theta, Vec2::zero()),
            _ => 1.0,
        };
        let sides: &[(Sides, [f64; 2])] = match kind {
            DeltaKind::Reflection => &[(Sides::Same, [1.0; 2])],
            DeltaKind::Transmission => &[(Sides::Through, [1.0, eta]), (Sides::Out, [eta, 1.0])],
            DeltaKind::Passthrough => &[],
        };
        let event = Event {
            shape,
            kind,
            normal: Normal::Own,
        };
        for &(sides, index) in sides {
            let mut left = MOST_BOXES;
            let question = Question {
                start: start.si.p,
                target,
                sides,
                index,
            };
            let mut nodes = SmallVec::<[u32; 64]>::new();
            nodes.extend((!pieces.nodes.is_empty()).then_some(0));
            while let Some(at) = nodes.pop() {
                let node = &pieces.nodes[at as usize];
                found.boxes += 1;
                if question.excludes(node.p, node.n) {
                    continue;
                }
                match node.part {
                    Part::Both(second) => nodes.extend([second, at + 1]),
                    Part::Piece(i) => {
                        let piece = &pieces.pieces[i as usize];
                        let mut roots = SmallVec::<[[f64; 2]; 2]>::new();
                        question.search(piece, &mut left, found, |at| roots.push(at));
                        found.roots += roots.len() as u64;
                        for at in roots {
                            let (p, _) = piece.at(at);
                            found.add(self.seen(start, target, p, event));
                        }
                    }
                }
            }
        }
    }

    /// The chain over a root on a surface, if nothing hides it from its start.
    fn seen(&self, start: &Start, target: &Target, p: Vec3<f64>, event: Event) -> Option<Solution> {
        let edge = p - start.si.p;
        let chain = self.trace(start, edge.normalize(), &[event])?;
        let off = (chain[0].si.p - p).length();
        if off > MET * edge.length() {
            return None;
        }
        self.walk(start, chain, target).solution
    }
}

impl Every {
    /// Adds a solution, unless it is known: on edges of two pieces.
    fn add(&mut self, solution: Option<Solution>) {
        let is_known = |s: &Solution| {
            (self.solutions.iter()).any(|known| known.is(s, Uniqueness::ErrorBounds))
        };
        self.solutions.extend(solution.filter(|s| !is_known(s)));
    }
}
