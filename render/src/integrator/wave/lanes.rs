//! Numbers of many paths, field by field.

use ad_core::{Float, Vec3};

use crate::math::{Rgb, each};

/// Paths that are followed at a time: enough to fill vectors when most have ended, few enough for the cache.
pub const WIDTH: usize = 64;

/// Loops run over multiples of this: whole vectors, and no rest that the compiler would treat by itself.
const STRIDE: usize = 16;

/// How far a loop over the first `n` of [`WIDTH`] goes. What lies beyond `n` is of no path, and harmless.
#[inline(always)]
pub fn whole(n: usize) -> usize {
    n.next_multiple_of(STRIDE).min(WIDTH)
}

/// One value of each path.
pub type Lane<T> = [T; WIDTH];

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

    /// The sum of the colours of the first `n` paths for which `counts` holds.
    #[inline(always)]
    pub fn sum_where(&self, n: usize, counts: impl Fn(usize) -> bool) -> Rgb<P> {
        let mut counted = Self::zero();
        for i in 0..whole(n) {
            let counts = (i < n) & counts(i);
            let c = self.rgb(i).map(|c| P::select(counts, c, P::zero()));
            counted.put_rgb(i, c);
        }
        // As many sums as there are numbers in a vector: the order of additions is not the compiler's to change.
        let [r, g, b] = each(counted.0, |lane: Lane<P>| {
            let mut sums = [P::zero(); STRIDE];
            for k in 0..STRIDE {
                for j in (0..WIDTH).step_by(STRIDE) {
                    sums[k] += lane[k + j];
                }
            }
            sums.iter().fold(P::zero(), |all, &sum| all + sum)
        });
        Rgb::new(r, g, b)
    }

    /// Adds to the colour of path `i`.
    #[inline(always)]
    pub fn add_rgb(&mut self, i: usize, c: Rgb<P>) {
        self.put_rgb(i, self.rgb(i) + c);
    }
}

/// Something of every path.
pub trait Field {
    /// All zero.
    fn zero() -> Self;
    /// Path `to` gets the value of path `from`.
    fn relocate(&mut self, to: usize, from: usize);
}

impl<T: Copy + Default> Field for Lane<T> {
    fn zero() -> Self {
        [T::default(); WIDTH]
    }
    #[inline(always)]
    fn relocate(&mut self, to: usize, from: usize) {
        self[to] = self[from];
    }
}

impl<P: Float> Field for Lanes<P> {
    fn zero() -> Self {
        Self([Lane::zero(); 3])
    }
    #[inline(always)]
    fn relocate(&mut self, to: usize, from: usize) {
        for lane in &mut self.0 {
            lane.relocate(to, from);
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
        }
    };
}
pub(super) use lanes;
