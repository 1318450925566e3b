//! Many rays against the same primitives: one lane per ray.
//!
//! The rays of different paths have nothing in common but that they are ready at the same time. A lane per
//! ray needs no reduction at the end, no sorting out of ties, and half the instructions of a lane per primitive.

use super::curved::{Curved, LANES_F64, Line};
use super::triangle_block::{Flat, RayLanes, mark};
use super::{Hit, Ray, Tag, capped, hit_of};
use crate::math::{NOWHERE, each};
use wide::{f32x16, f64x8};

/// Rays traced together.
pub const PACKET_SIZE: usize = 16;

/// Up to [`PACKET_SIZE`] rays, each with the distance it looks ahead and the surfaces that it does not meet.
#[derive(Clone, Copy, Debug)]
pub struct RayPacket {
    o: [[f32; PACKET_SIZE]; 3],
    d: [[f32; PACKET_SIZE]; 3],
    t_max: [f32; PACKET_SIZE],
    skip: [[u32; PACKET_SIZE]; 2],
    len: usize,
}

impl Default for RayPacket {
    fn default() -> Self {
        Self {
            o: [[0.0; PACKET_SIZE]; 3],
            // Lanes without a ray look nowhere, but count as sane.
            d: [[1.0; PACKET_SIZE], [0.0; PACKET_SIZE], [0.0; PACKET_SIZE]],
            t_max: [0.0; PACKET_SIZE],
            skip: [[NOWHERE; PACKET_SIZE]; 2],
            len: 0,
        }
    }
}

impl RayPacket {
    /// Number of rays.
    #[inline(always)]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no ray.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Whether there is room for no more.
    #[inline(always)]
    pub fn is_full(&self) -> bool {
        self.len == PACKET_SIZE
    }

    /// Adds a ray to a packet that is not full. It leaves the first surface in `skip`; whether anything hides its end is
    /// asked as if the second were not there.
    #[inline(always)]
    pub fn push(&mut self, o: [f32; 3], d: [f32; 3], t_max: f32, skip: [u32; 2]) {
        let i = self.len % PACKET_SIZE;
        for k in 0..3 {
            self.o[k][i] = o[k];
            self.d[k][i] = d[k];
        }
        self.t_max[i] = t_max;
        (self.skip[0][i], self.skip[1][i]) = (skip[0], skip[1]);
        self.len += 1;
    }

    /// Replaces all rays by the first `n` of these, at most [`PACKET_SIZE`].
    #[inline(always)]
    pub fn fill(&mut self, n: usize, ray: impl Fn(usize) -> ([f32; 3], [f32; 3], f32, [u32; 2])) {
        self.clear();
        for i in 0..n.min(PACKET_SIZE) {
            let (o, d, t_max, skip) = ray(i);
            self.push(o, d, t_max, skip);
        }
    }

    /// Forgets all rays.
    #[inline(always)]
    pub fn clear(&mut self) {
        for t in &mut self.t_max[..self.len] {
            *t = 0.0;
        }
        self.len = 0;
    }

    /// Origin, direction, limit and surfaces of ray `i`.
    #[inline(always)]
    pub(super) fn ray(&self, i: usize) -> ([f32; 3], [f32; 3], f32, [u32; 2]) {
        let at = |x: &[[f32; PACKET_SIZE]; 3]| [x[0][i], x[1][i], x[2][i]];
        (
            at(&self.o),
            at(&self.d),
            self.t_max[i],
            [self.skip[0][i], self.skip[1][i]],
        )
    }

    /// The surfaces that rays leave, or those that they go to, as [`mark`]s.
    #[inline(always)]
    fn marks(&self, end: usize) -> f32x16 {
        let mut marks = [0.0; PACKET_SIZE];
        for (m, surface) in marks.iter_mut().zip(&self.skip[end % 2]) {
            *m = mark(*surface);
        }
        f32x16::from(marks)
    }

    /// Origins and directions.
    #[inline(always)]
    pub(super) fn lanes(&self) -> ([f32x16; 3], [f32x16; 3]) {
        (each(self.o, f32x16::from), each(self.d, f32x16::from))
    }

    /// The distances that the rays look ahead, or `None` if one of them cannot be traced as it is: see
    /// [`Ray::new`].
    #[inline(always)]
    pub(super) fn limits(&self) -> Option<[f32; PACKET_SIZE]> {
        let sane = (0..PACKET_SIZE).fold(true, |sane, i| {
            let (o, d, ..) = self.ray(i);
            sane & Ray::new(o, d, [NOWHERE; 2]).is_some()
        });
        let mut limits = self.t_max;
        for t in &mut limits {
            *t = capped(*t);
        }
        sane.then_some(limits)
    }
}

/// The primitives of a small scene, in the order of their indices.
#[derive(Clone, Debug)]
pub(super) struct Few {
    items: Vec<(One, Tag)>,
    curved: bool,
}

#[derive(Clone, Copy, Debug)]
enum One {
    Flat(Flat<f32>),
    Curved(Curved),
}

/// The nearest hits so far.
struct Nearest {
    t: f32x16,
    u: f32x16,
    v: f32x16,
    /// Which of the items: the bits of integers, so that lanes can be selected.
    slot: f32x16,
}

impl Few {
    /// From primitives with ascending indices.
    pub(super) fn new(items: impl Iterator<Item = (super::Shape, Tag)>) -> Few {
        let one = |(shape, tag)| match shape {
            super::Shape::Flat(f) => (One::Flat(f), tag),
            super::Shape::Curved(c) => (One::Curved(c), tag),
        };
        let items: Vec<_> = items.map(one).collect();
        let curved = items.iter().any(|i| matches!(i.0, One::Curved(_)));
        Few { items, curved }
    }

    pub(super) fn memory_bytes(&self) -> usize {
        self.items.capacity() * size_of::<(One, Tag)>()
    }

    /// The nearest hit of every ray, or `None` if one of them needs special care.
    #[inline(never)]
    pub(super) fn intersect(
        &self,
        packet: &RayPacket,
        hits: &mut [Option<Hit>; PACKET_SIZE],
    ) -> Option<()> {
        self.search::<false>(packet, hits)
    }

    /// [`Few::intersect`], `CAREFUL`: without the surfaces that rays leave. As these start off them, it hardly ever
    /// matters, and is found out by looking at what was hit.
    #[inline(always)]
    fn search<const CAREFUL: bool>(
        &self,
        packet: &RayPacket,
        hits: &mut [Option<Hit>; PACKET_SIZE],
    ) -> Option<()> {
        let start = f32x16::from(packet.limits()?);
        let lanes = PacketLanes::new(packet, self.curved);
        let zero = f32x16::splat(0.0);
        let mut best = Nearest {
            t: start,
            u: zero,
            v: zero,
            slot: zero,
        };
        let from = packet.marks(0);
        for (slot, (one, Tag { surface, .. })) in (0..).zip(&self.items) {
            // Strict, and primitives ascend: the lowest one among equals stays.
            let (mut hit, t, u, v) = lanes.test(one, best.t);
            if CAREFUL {
                hit &= f32x16::splat(mark(*surface)).simd_ne(from);
            }
            best.t = hit.select(t, best.t);
            best.u = hit.select(u, best.u);
            best.v = hit.select(v, best.v);
            best.slot = hit.select(f32x16::splat(f32::from_bits(slot)), best.slot);
        }
        let found = best.t.simd_lt(start).to_bitmask();
        let (t, u, v) = (best.t.to_array(), best.u.to_array(), best.v.to_array());
        let slot = best.slot.to_array();
        let mut again = false;
        for i in 0..packet.len {
            hits[i] = None;
            if found >> i & 1 != 0 {
                let Tag { id, surface } = self.items[slot[i].to_bits() as usize].1;
                again |= surface == packet.skip[0][i];
                hits[i] = Some(hit_of(id, t[i], u[i], v[i]));
            }
        }
        if !CAREFUL && again {
            return self.again(packet, hits);
        }
        Some(())
    }

    #[cold]
    #[inline(never)]
    fn again(&self, packet: &RayPacket, hits: &mut [Option<Hit>; PACKET_SIZE]) -> Option<()> {
        self.search::<true>(packet, hits)
    }

    /// One bit per ray that hits anything, or `None` if a ray needs special care.
    #[inline(never)]
    pub(super) fn occluded(&self, packet: &RayPacket) -> Option<u32> {
        // All to the same light, as a rule, which then need not be tested.
        let to = packet.skip[1][0];
        let mut alike = true;
        for i in 0..PACKET_SIZE {
            alike &= (packet.skip[1][i] == to) | (i >= packet.len);
        }
        if alike {
            self.blocked::<true>(packet)
        } else {
            self.blocked::<false>(packet)
        }
    }

    /// `ALIKE`: whether all rays go to the same surface.
    #[inline(always)]
    fn blocked<const ALIKE: bool>(&self, packet: &RayPacket) -> Option<u32> {
        let t_max = f32x16::from(packet.limits()?);
        let lanes = PacketLanes::new(packet, self.curved);
        let mut any = f32x16::splat(0.0);
        let (from, to) = (packet.marks(0), packet.marks(1));
        for (one, tag) in &self.items {
            if ALIKE && tag.surface == packet.skip[1][0] {
                continue;
            }
            let surface = f32x16::splat(mark(tag.surface));
            let mut hit = lanes.test(one, t_max).0 & surface.simd_ne(from);
            if !ALIKE {
                hit &= surface.simd_ne(to);
            }
            any |= hit;
        }
        Some(any.to_bitmask())
    }
}

/// A packet in registers.
struct PacketLanes {
    single: RayLanes<f32x16>,
    /// Halves of it, if there is anything curved.
    double: Option<[Line<f64x8>; 2]>,
}

impl PacketLanes {
    #[inline(always)]
    fn new(packet: &RayPacket, double: bool) -> PacketLanes {
        let wide = |x: &[[f32; PACKET_SIZE]; 3], first: usize| {
            let mut lanes = [[0.0; LANES_F64]; 3];
            for k in 0..3 {
                for i in 0..LANES_F64 {
                    lanes[k][i] = f64::from(x[k][first + i]);
                }
            }
            [lanes[0].into(), lanes[1].into(), lanes[2].into()]
        };
        let half = |first| Line::new(wide(&packet.o, first), wide(&packet.d, first));
        let (o, d) = packet.lanes();
        PacketLanes {
            single: RayLanes::of(o, d),
            double: double.then(|| [half(0), half(LANES_F64)]),
        }
    }

    /// Which lanes hit the primitive before `t_max`, and where.
    #[inline(always)]
    fn test(&self, one: &One, t_max: f32x16) -> (f32x16, f32x16, f32x16, f32x16) {
        let zero = f32x16::splat(0.0);
        let ahead = |t: f32x16| t.simd_gt(zero) & t.simd_lt(t_max);
        let miss = (zero, zero, zero, zero);
        match one {
            One::Flat(flat) => flat.test_lanes(&self.single, t_max),
            One::Curved(curved) => {
                let Some([a, b]) = &self.double else {
                    return miss;
                };
                let (a, b) = (curved.candidates(a), curved.candidates(b));
                if a.is_none() && b.is_none() {
                    return miss;
                }
                let nowhere = [f64x8::splat(f64::NAN); 4];
                let (a, b) = (a.unwrap_or(nowhere), b.unwrap_or(nowhere));
                let (near, far) = (narrow(a[0], b[0]), narrow(a[1], b[1]));
                let first = ahead(near);
                let (u, v) = (narrow(a[2], b[2]), narrow(a[3], b[3]));
                (first | ahead(far), first.select(near, far), u, v)
            }
        }
    }
}

/// Two halves side by side, in single precision.
#[inline(always)]
fn narrow(a: f64x8, b: f64x8) -> f32x16 {
    let (a, b) = (a.to_array(), b.to_array());
    let mut lanes = [0.0; PACKET_SIZE];
    for i in 0..LANES_F64 {
        lanes[i] = a[i] as f32;
        lanes[LANES_F64 + i] = b[i] as f32;
    }
    lanes.into()
}
