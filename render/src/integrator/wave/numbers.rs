//! Random numbers of many paths.

use ad_core::Float;

use super::lanes::{Field, Lane};
use super::state::Paths;
use crate::sampler::{
    Points, first_four, independent_bits, scrambled, sobol_bits, sobol_points, sobol_set,
};

/// Random bits of a path in a dimension, counted from one, where points are no sequence.
#[inline(always)]
pub fn bits<P: Float>(points: Points, paths: &Paths<P>, i: usize, dim: u32) -> u64 {
    // The odd one of an antithetic pair has all bits turned.
    let pairs = u32::from(points == Points::Antithetic);
    let turned = u64::from(paths.index[i] & pairs).wrapping_neg();
    independent_bits(paths.key[i], dim) ^ turned
}

/// Random numbers of the first dimensions from `dim` on, up to four.
#[inline(always)]
pub fn draw_units<P: Float, const N: usize>(
    points: Points,
    n: usize,
    paths: &Paths<P>,
    dim: u32,
    lanes: [&mut Lane<P>; N],
) {
    if points == Points::Sobol {
        let all = sobol(n, paths, dim);
        for (lane, x) in lanes.into_iter().zip(&all) {
            for i in 0..n {
                lane[i] = P::from_bits_unit(sobol_bits(x[i]));
            }
        }
        return;
    }
    // Counted from one.
    for (lane, dim) in lanes.into_iter().zip(dim + 1..) {
        for i in 0..n {
            lane[i] = P::from_bits_unit(bits(points, paths, i, dim));
        }
    }
}

/// The first four dimensions from `dim` on of Sobol points.
#[inline(always)]
pub fn sobol<P: Float>(n: usize, paths: &Paths<P>, dim: u32) -> [Lane<u32>; 4] {
    let (mut sets, mut shuffled) = (Lane::<u64>::zero(), Lane::<u32>::zero());
    for i in 0..n {
        (sets[i], shuffled[i]) = sobol_set(paths.key[i], paths.index[i], dim);
    }
    // Looked up one by one, between what is done in vectors.
    let table = first_four();
    let [mut x, mut y, mut z, mut w] = [Lane::<u32>::zero(); 4];
    for i in 0..n {
        [x[i], y[i], z[i], w[i]] = sobol_points(table, shuffled[i]);
    }
    for i in 0..n {
        [x[i], y[i], z[i], w[i]] = scrambled(sets[i], 0, [x[i], y[i], z[i], w[i]]);
    }
    [x, y, z, w]
}
