//! Flat primitives, one at a time or eight at a time with the same arithmetic.

use super::{Best, MIN_THICKNESS, Ray, Tag};
use crate::math::each;
use crate::prefetch::prefetch;
use std::ops::{Add, Div, Mul, Sub};
use wide::{f32x8, f32x16};

/// Primitives per block.
pub(super) const LANES: usize = 8;

/// Relative size of the seam by which neighbours overlap, so that no ray slips between them.
///
/// Covers the rounding of the hit point (a few half ulps of the distance travelled) and of
/// vertices that callers rebuild as `v0 + e1`.
pub(crate) const SEAM: f32 = 4.0 * f32::EPSILON;

/// The operations the flat test needs, rounded alike for one lane and for eight.
pub(super) trait Lane:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    fn splat(x: f32) -> Self;
    /// `self * a + b`, fused exactly where `wide` fuses.
    fn fma(self, a: Self, b: Self) -> Self;
    /// `self * a - b`, likewise.
    fn fms(self, a: Self, b: Self) -> Self;
    /// `b - self * a`, likewise.
    fn fnma(self, a: Self, b: Self) -> Self;
    fn lower(self, o: Self) -> Self;
    fn upper(self, o: Self) -> Self;
}

/// Whether `wide` fuses `mul_add` on this target; scalar code must follow.
const FUSED: bool = cfg!(all(target_feature = "avx", target_feature = "fma"));

impl Lane for f32 {
    #[inline(always)]
    fn splat(x: f32) -> f32 {
        x
    }
    #[inline(always)]
    fn fma(self, a: f32, b: f32) -> f32 {
        if FUSED {
            self.mul_add(a, b)
        } else {
            self * a + b
        }
    }
    #[inline(always)]
    fn fms(self, a: f32, b: f32) -> f32 {
        if FUSED {
            self.mul_add(a, -b)
        } else {
            self * a - b
        }
    }
    #[inline(always)]
    fn fnma(self, a: f32, b: f32) -> f32 {
        if FUSED {
            (-self).mul_add(a, b)
        } else {
            b - self * a
        }
    }
    #[inline(always)]
    fn lower(self, o: f32) -> f32 {
        if self < o { self } else { o }
    }
    #[inline(always)]
    fn upper(self, o: f32) -> f32 {
        if self > o { self } else { o }
    }
}

macro_rules! lanes {
    ($($lanes:ident),*) => {$(
        impl Lane for $lanes {
            #[inline(always)]
            fn splat(x: f32) -> $lanes {
                $lanes::splat(x)
            }
            #[inline(always)]
            fn fma(self, a: $lanes, b: $lanes) -> $lanes {
                if FUSED {
                    self.mul_add(a, b)
                } else {
                    self * a + b
                }
            }
            #[inline(always)]
            fn fms(self, a: $lanes, b: $lanes) -> $lanes {
                if FUSED {
                    self.mul_sub(a, b)
                } else {
                    self * a - b
                }
            }
            #[inline(always)]
            fn fnma(self, a: $lanes, b: $lanes) -> $lanes {
                if FUSED {
                    self.mul_neg_add(a, b)
                } else {
                    b - self * a
                }
            }
            #[inline(always)]
            fn lower(self, o: $lanes) -> $lanes {
                self.fast_min(o)
            }
            #[inline(always)]
            fn upper(self, o: $lanes) -> $lanes {
                self.fast_max(o)
            }
        }
    )*};
}
lanes!(f32x8, f32x16);

/// A triangle or parallelogram as a plane and a dual basis, so that a test needs no cross product.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Flat<N> {
    v0: [N; 3],
    /// Unit normal; zero in empty slots, which no ray can hit.
    n: [N; 3],
    /// `du . e1 = 1`, `du . e2 = 0`, in the plane.
    du: [N; 3],
    /// `dv . e1 = 0`, `dv . e2 = 1`, in the plane.
    dv: [N; 3],
    /// 1 for triangles (`u + v <= 1`), 0 for parallelograms.
    cut: N,
    /// Seam width in `u` and `v` per unit of distance.
    seam_u: N,
    seam_v: N,
    /// Distance that stands for the magnitude of the coordinates themselves.
    reach: N,
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Of numbers whose squares neither overflow nor vanish beside what counts as degenerate.
fn length(a: [f64; 3]) -> f64 {
    (a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sqrt()
}

#[inline(always)]
fn dot<N: Lane>(a: [N; 3], b: [N; 3]) -> N {
    a[2].fma(b[2], a[1].fma(b[1], a[0] * b[0]))
}

impl Flat<[f32; LANES]> {
    /// Replaces primitive `k`.
    pub(super) fn set(&mut self, k: usize, one: &Flat<f32>) {
        for axis in 0..3 {
            self.v0[axis][k] = one.v0[axis];
            self.n[axis][k] = one.n[axis];
            self.du[axis][k] = one.du[axis];
            self.dv[axis][k] = one.dv[axis];
        }
        self.cut[k] = one.cut;
        self.seam_u[k] = one.seam_u;
        self.seam_v[k] = one.seam_v;
        self.reach[k] = one.reach;
    }

    /// Primitive `k` in every lane.
    #[inline(always)]
    pub(super) fn splat<N: Lane>(&self, k: usize) -> Flat<N> {
        let one = |x: &[f32; LANES]| N::splat(x[k]);
        let three = |x: &[[f32; LANES]; 3]| [one(&x[0]), one(&x[1]), one(&x[2])];
        Flat {
            v0: three(&self.v0),
            n: three(&self.n),
            du: three(&self.du),
            dv: three(&self.dv),
            cut: one(&self.cut),
            seam_u: one(&self.seam_u),
            seam_v: one(&self.seam_v),
            reach: one(&self.reach),
        }
    }

    /// Brings all lines of the cache near.
    #[inline(always)]
    pub(super) fn fetch(&self) {
        let Self {
            v0,
            n,
            du,
            dv,
            cut,
            seam_v,
            ..
        } = self;
        for x in [&v0[0], &v0[2], &n[1], &du[0], &du[2], &dv[1], cut, seam_v] {
            prefetch(x);
        }
    }

    /// All of them, a lane each.
    #[inline(always)]
    pub(super) fn load(&self) -> Flat<f32x8> {
        Flat {
            v0: each(self.v0, f32x8::from),
            n: each(self.n, f32x8::from),
            du: each(self.du, f32x8::from),
            dv: each(self.dv, f32x8::from),
            cut: self.cut.into(),
            seam_u: self.seam_u.into(),
            seam_v: self.seam_v.into(),
            reach: self.reach.into(),
        }
    }
}

impl Flat<f32x8> {
    /// Offers the hits of one ray.
    #[inline(always)]
    pub(super) fn offer(
        &self,
        from: u32,
        lanes: &RayLanes<f32x8>,
        tags: &[Tag; LANES],
        best: &mut Best,
    ) {
        // One rounding more, so that equal distances pass; the offer decides.
        let reach = f32x8::splat(best.t * (1.0 + f32::EPSILON));
        let c = self.candidate(lanes);
        let mut hits = c.within(reach).to_bitmask();
        if hits != 0 {
            let (t, u, v) = (c.t.to_array(), c.u.to_array(), c.v.to_array());
            while hits != 0 {
                let k = hits.trailing_zeros() as usize % LANES;
                hits &= hits - 1;
                best.offer(t[k], u[k], v[k], tags[k], from);
            }
        }
    }
}

impl Flat<f32> {
    /// The same primitive in every place.
    pub(super) fn splat_array(&self) -> Flat<[f32; LANES]> {
        let all = |x: f32| [x; LANES];
        Flat {
            v0: each(self.v0, all),
            n: each(self.n, all),
            du: each(self.du, all),
            dv: each(self.dv, all),
            cut: all(self.cut),
            seam_u: all(self.seam_u),
            seam_v: all(self.seam_v),
            reach: all(self.reach),
        }
    }

    /// Cannot be hit; fills blocks up and marks slots of other kinds.
    pub(super) const EMPTY: Flat<f32> = Flat {
        v0: [0.0; 3],
        n: [0.0; 3],
        du: [0.0; 3],
        dv: [0.0; 3],
        cut: 0.0,
        seam_u: 0.0,
        seam_v: 0.0,
        reach: 0.0,
    };

    /// `None` if it has no area.
    pub(super) fn new(v0: [f32; 3], e1: [f32; 3], e2: [f32; 3], triangle: bool) -> Option<Self> {
        let (a, b) = (each(e1, f64::from), each(e2, f64::from));
        let normal = cross(a, b);
        let area = length(normal);
        let (la, lb) = (length(a), length(b));
        let thickness = area / la.max(lb);
        // Sides that are parallel up to the rounding of their components enclose nothing.
        let noise = 2.0 * f64::from(f32::EPSILON) * la * lb;
        if !(thickness >= f64::from(MIN_THICKNESS) && area > noise) {
            return None;
        }
        let n = each(normal, |x| x / area);
        let du = each(cross(b, n), |x| x / area);
        let dv = each(cross(n, a), |x| x / area);
        let extent = v0.iter().fold(0.0, |m: f32, x| m.max(x.abs())) + (la + lb) as f32;
        let narrow = |x: [f64; 3]| each(x, |x| x as f32);
        Some(Flat {
            v0,
            n: narrow(n),
            du: narrow(du),
            dv: narrow(dv),
            cut: if triangle { 1.0 } else { 0.0 },
            seam_u: SEAM * length(du) as f32,
            seam_v: SEAM * length(dv) as f32,
            reach: extent,
        })
    }
}

/// A ray broadcast to every lane.
#[derive(Clone, Copy)]
pub(super) struct RayLanes<N> {
    o: [N; 3],
    d: [N; 3],
    size: N,
}

impl<N: Lane> RayLanes<N> {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> Self {
        RayLanes {
            o: each(ray.o, N::splat),
            d: each(ray.d, N::splat),
            size: N::splat(ray.size),
        }
    }
}

impl RayLanes<f32x16> {
    /// One ray per lane.
    #[inline(always)]
    pub(super) fn of(o: [f32x16; 3], d: [f32x16; 3]) -> Self {
        let size = d[0].abs() + d[1].abs() + d[2].abs();
        RayLanes { o, d, size }
    }
}

/// Candidate: a hit if `0 < t < t_max`, `inner >= 0` and `outer <= 1`. All NaN in empty slots.
pub(super) struct Candidate<N> {
    pub(super) t: N,
    pub(super) u: N,
    pub(super) v: N,
    pub(super) inner: N,
    pub(super) outer: N,
}

impl<N: Lane> Flat<N> {
    #[inline(always)]
    pub(super) fn candidate(&self, ray: &RayLanes<N>) -> Candidate<N> {
        let to = [
            self.v0[0] - ray.o[0],
            self.v0[1] - ray.o[1],
            self.v0[2] - ray.o[2],
        ];
        let t = dot(self.n, to) / dot(self.n, ray.d);
        // The hit relative to v0: small numbers, whatever the distance of the scene from zero.
        let p = [
            ray.d[0].fms(t, to[0]),
            ray.d[1].fms(t, to[1]),
            ray.d[2].fms(t, to[2]),
        ];
        let u = dot(self.du, p);
        let v = dot(self.dv, p);
        let travelled = t.fma(ray.size, self.reach);
        let inner = self
            .seam_u
            .fma(travelled, u)
            .lower(self.seam_v.fma(travelled, v));
        let (u1, v1) = (
            self.seam_u.fnma(travelled, u),
            self.seam_v.fnma(travelled, v),
        );
        let outer = self.cut.fma(v1, u1).upper(self.cut.fma(u1, v1));
        Candidate {
            t,
            u,
            v,
            inner,
            outer,
        }
    }
}

impl Flat<f32> {
    /// The same primitive in every lane.
    #[inline(always)]
    fn splat<N: Lane>(&self) -> Flat<N> {
        Flat {
            v0: each(self.v0, N::splat),
            n: each(self.n, N::splat),
            du: each(self.du, N::splat),
            dv: each(self.dv, N::splat),
            cut: N::splat(self.cut),
            seam_u: N::splat(self.seam_u),
            seam_v: N::splat(self.seam_v),
            reach: N::splat(self.reach),
        }
    }

    /// [`Flat::test`] of the same primitive in every lane.
    #[inline(always)]
    pub(super) fn test_lanes(
        &self,
        rays: &RayLanes<f32x16>,
        t_max: f32x16,
    ) -> (f32x16, f32x16, f32x16, f32x16) {
        self.splat::<f32x16>().test(rays, t_max)
    }
}

impl Flat<f32x16> {
    /// Which rays hit their lane's primitive before `t_max`, and where: distance and coordinates.
    #[inline(always)]
    pub(super) fn test(
        &self,
        rays: &RayLanes<f32x16>,
        t_max: f32x16,
    ) -> (f32x16, f32x16, f32x16, f32x16) {
        let (zero, one) = (f32x16::splat(0.0), f32x16::splat(1.0));
        let c = self.candidate(rays);
        let ahead = c.t.simd_gt(zero) & c.t.simd_lt(t_max);
        let inside = c.inner.simd_ge(zero) & c.outer.simd_le(one);
        (ahead & inside, c.t, c.u, c.v)
    }
}

/// Flat primitives in blocks of eight, tested one block after the other.
#[derive(Clone, Debug)]
pub(super) struct TriangleBlocks {
    blocks: Vec<Flat<f32x8>>,
    /// [`Tag::id`] of every slot, ascending; the bits of integers, so that lanes can be selected.
    ids: Vec<f32x8>,
    /// Surface of every slot, as a [`mark`].
    surfaces: Vec<f32x8>,
}

/// A surface as a number that lanes can be compared with: all of these are normal, and different for the first two
/// billion surfaces and [`crate::math::NOWHERE`].
#[inline(always)]
pub(super) fn mark(surface: u32) -> f32 {
    f32::from_bits(surface.wrapping_add(f32::MIN_POSITIVE.to_bits() + 1))
}

impl TriangleBlocks {
    pub(super) fn new(flat: &[(Flat<f32>, Tag)]) -> TriangleBlocks {
        let mut blocks = Vec::new();
        let (mut ids, mut surfaces) = (Vec::new(), Vec::new());
        for group in flat.chunks(LANES) {
            let slot = |i: usize| group.get(i).map_or(Flat::EMPTY, |g| g.0);
            let lanes = |f: &dyn Fn(&Flat<f32>) -> f32| {
                f32x8::from(std::array::from_fn::<f32, LANES, _>(|i| f(&slot(i))))
            };
            let axes = |f: &dyn Fn(&Flat<f32>) -> [f32; 3]| {
                std::array::from_fn::<f32x8, 3, _>(|k| lanes(&|g| f(g)[k]))
            };
            blocks.push(Flat {
                v0: axes(&|g| g.v0),
                n: axes(&|g| g.n),
                du: axes(&|g| g.du),
                dv: axes(&|g| g.dv),
                cut: lanes(&|g| g.cut),
                seam_u: lanes(&|g| g.seam_u),
                seam_v: lanes(&|g| g.seam_v),
                reach: lanes(&|g| g.reach),
            });
            ids.push(f32x8::from(std::array::from_fn::<f32, LANES, _>(|i| {
                f32::from_bits(group.get(i).map_or(Tag::EMPTY.id, |g| g.1.id))
            })));
            surfaces.push(f32x8::from(std::array::from_fn::<f32, LANES, _>(|i| {
                mark(group.get(i).map_or(u32::MAX, |g| g.1.surface))
            })));
        }
        TriangleBlocks {
            blocks,
            ids,
            surfaces,
        }
    }

    /// `best` must be fresh: only its distance is looked at.
    #[inline(always)]
    pub(super) fn intersect(&self, ray: &Ray, best: &mut Best) {
        let lanes = RayLanes::<f32x8>::new(ray);
        let zero = f32x8::splat(0.0);
        let start = f32x8::splat(best.t);
        let (mut t, mut u, mut v, mut id) = (start, zero, zero, zero);
        let from = f32x8::splat(mark(ray.skip[0]));
        let tags = self.ids.iter().zip(&self.surfaces);
        for (block, (&ids, &surfaces)) in self.blocks.iter().zip(tags) {
            let c = block.candidate(&lanes);
            // Strict, and blocks ascend: every lane keeps its lowest primitive among equals.
            let hit = c.within(t) & surfaces.simd_ne(from);
            t = hit.select(c.t, t);
            u = hit.select(c.u, u);
            v = hit.select(c.v, v);
            id = hit.select(ids, id);
        }
        let nearest = least(t);
        if nearest < best.t {
            let mut winners = t.simd_eq(f32x8::splat(nearest)).to_bitmask();
            let ids = id.to_array();
            let id_of = |lane: usize| ids[lane].to_bits();
            let mut lane = winners.trailing_zeros() as usize % LANES;
            winners &= winners - 1;
            while winners != 0 {
                let other = winners.trailing_zeros() as usize % LANES;
                if id_of(other) < id_of(lane) {
                    lane = other;
                }
                winners &= winners - 1;
            }
            *best = Best {
                t: nearest,
                u: u.to_array()[lane],
                v: v.to_array()[lane],
                id: id_of(lane),
                found: true,
            };
        }
    }

    #[inline(always)]
    pub(super) fn occluded(&self, ray: &Ray, t_max: f32) -> bool {
        let lanes = RayLanes::<f32x8>::new(ray);
        let t_max = f32x8::splat(t_max);
        let [from, to] = ray.skip.map(|surface| f32x8::splat(mark(surface)));
        (self.blocks.iter().zip(&self.surfaces)).any(|(block, surfaces)| {
            let counts = surfaces.simd_ne(from) & surfaces.simd_ne(to);
            (block.candidate(&lanes).within(t_max) & counts).any()
        })
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.blocks.capacity() * size_of::<Flat<f32x8>>()
            + (self.ids.capacity() + self.surfaces.capacity()) * size_of::<f32x8>()
    }
}

impl Candidate<f32x8> {
    /// Lanes that are hit before `t_max`.
    #[inline(always)]
    pub(super) fn within(&self, t_max: f32x8) -> f32x8 {
        let (zero, one) = (f32x8::splat(0.0), f32x8::splat(1.0));
        self.t.simd_gt(zero)
            & self.t.simd_lt(t_max)
            & self.inner.simd_ge(zero)
            & self.outer.simd_le(one)
    }
}

/// Smallest lane, pairwise so that the comparisons do not wait for each other.
#[inline(always)]
fn least(x: f32x8) -> f32 {
    let a = x.to_array();
    let pair = |i: usize| a[i].lower(a[i + 4]);
    pair(0).lower(pair(2)).lower(pair(1).lower(pair(3)))
}
