//! Numbers of many paths, field by field.

use ad_core::{Float, Vec3};

use crate::math::{Rgb, each};

/// Paths that are followed at a time: enough to fill vectors when most have ended, few enough for the cache.
pub const WAVE_SIZE: usize = 64;

/// Loops run over multiples of this: whole vectors, and no rest that the compiler would treat by itself.
const STRIDE: usize = 16;

/// How far a loop over the first `n` of [`WAVE_SIZE`] goes. What lies beyond `n` is of no path, and harmless.
#[inline(always)]
pub fn whole(n: usize) -> usize {
    n.next_multiple_of(STRIDE).min(WAVE_SIZE)
}

/// One value of each path.
pub type Lane<T> = [T; WAVE_SIZE];

/// A vector or a colour of each path: three arrays, so that loops over them become vector instructions.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<P>([Lane<P>; 3]);

impl<P: Float> Lanes<P> {
    /// The vector of path `i`.
    #[inline(always)]
    pub fn vec(&self, i: usize) -> Vec3<P> {
        let [x, y, z] = &self.0;
        Vec3::new(x[i], y[i], z[i])
    }

    /// The colour of path `i`.
    #[inline(always)]
    pub fn rgb(&self, i: usize) -> Rgb<P> {
        let [r, g, b] = &self.0;
        Rgb::new(r[i], g[i], b[i])
    }

    /// Replaces the vector of path `i`.
    #[inline(always)]
    pub fn put_vec(&mut self, i: usize, v: Vec3<P>) {
        let [x, y, z] = &mut self.0;
        (x[i], y[i], z[i]) = (v.x, v.y, v.z);
    }

    /// Replaces the colour of path `i`.
    #[inline(always)]
    pub fn put_rgb(&mut self, i: usize, c: Rgb<P>) {
        let [r, g, b] = &mut self.0;
        (r[i], g[i], b[i]) = (c.r, c.g, c.b);
    }

    /// Adds to the colour of path `i`.
    #[inline(always)]
    pub fn add_rgb(&mut self, i: usize, c: Rgb<P>) {
        self.put_rgb(i, self.rgb(i) + c);
    }
}

/// Sums of colours of many paths: as many as there are numbers in a vector, because the order of additions is not the
/// compiler's to change.
#[derive(Clone, Copy, Debug)]
pub struct LaneSums<P>([[P; STRIDE]; 3]);

impl<P: Float> LaneSums<P> {
    /// All sums zero.
    pub fn zero() -> Self {
        Self([[P::zero(); STRIDE]; 3])
    }

    /// Adds the colours of the first [`whole`]`(n)` paths for which `counts` holds.
    #[inline(always)]
    pub fn add_where(&mut self, colours: &Lanes<P>, n: usize, counts: impl Fn(usize) -> bool) {
        // In two loops, and the sums in a variable: otherwise, these are no vector instructions.
        let mut counted = Lanes::zero();
        for i in 0..whole(n) {
            let counts = counts(i);
            let c = colours.rgb(i).map(|c| P::select(counts, c, P::zero()));
            counted.put_rgb(i, c);
        }
        for (sums, lane) in self.0.iter_mut().zip(&counted.0) {
            let mut all = *sums;
            for part in lane.as_chunks::<STRIDE>().0 {
                for k in 0..STRIDE {
                    all[k] += part[k];
                }
            }
            *sums = all;
        }
    }

    /// The sum of all.
    pub fn total(&self) -> [P; 3] {
        each(self.0, |sums: [P; STRIDE]| {
            sums.iter().fold(P::zero(), |all, &sum| all + sum)
        })
    }
}

/// Something of every path.
pub trait Field {
    /// All zero.
    fn zero() -> Self;
    /// Path `to` gets the value of path `from`.
    fn relocate(&mut self, to: usize, from: usize);
    /// Path `to` gets the value that path `from` has in another one.
    fn copy(&mut self, to: usize, other: &Self, from: usize);
}

impl<T: Copy + Default> Field for Lane<T> {
    fn zero() -> Self {
        [T::default(); WAVE_SIZE]
    }
    #[inline(always)]
    fn relocate(&mut self, to: usize, from: usize) {
        self[to] = self[from];
    }
    #[inline(always)]
    fn copy(&mut self, to: usize, other: &Self, from: usize) {
        self[to] = other[from];
    }
}

impl<P: Float> Field for Lanes<P> {
    fn zero() -> Self {
        Self([Lane::zero(); 3])
    }
    #[inline(always)]
    fn relocate(&mut self, to: usize, from: usize) {
        for axis in 0..3 {
            self.0[axis].relocate(to, from);
        }
    }
    #[inline(always)]
    fn copy(&mut self, to: usize, other: &Self, from: usize) {
        for axis in 0..3 {
            self.0[axis].copy(to, &other.0[axis], from);
        }
    }
}

/// A struct of [`Field`]s over the scalar `P`, which is one itself.
macro_rules! lanes {
    ($(#[$doc:meta])* $name:ident { $($(#[$of:meta])* $field:ident: $t:ty,)* }) => {
        $(#[$doc])*
        #[derive(Clone, Debug)]
        pub struct $name<P> {
            $($(#[$of])* pub $field: $t,)*
        }

        impl<P: Float> Field for $name<P> {
            fn zero() -> Self {
                Self { $($field: Field::zero(),)* }
            }

            #[inline(always)]
            fn relocate(&mut self, to: usize, from: usize) {
                $(self.$field.relocate(to, from);)*
            }

            #[inline(always)]
            fn copy(&mut self, to: usize, other: &Self, from: usize) {
                $(self.$field.copy(to, &other.$field, from);)*
            }
        }
    };
}
pub(super) use lanes;
