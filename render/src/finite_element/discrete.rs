//! The transport of radiance and importance between patches, term by term as in
//! [Christensen et al. 1993]: a model without geometry for tests of duality.

use ad_core::Float;

/// Patches that exchange radiance. Quantities from `x` to `y` are at `x * patches + y`.
#[derive(Clone, Debug)]
pub struct Patches {
    /// Number of patches.
    pub patches: usize,
    /// The geometric term `G(x, y)`, symmetric, zero on the diagonal.
    pub geometry: Vec<f64>,
    /// The BRDF `f(x, y, z)` of light from x over y to z, at `(x * patches + y) * patches + z`.
    pub brdf: Vec<f64>,
}

impl Patches {
    fn f(&self, x: usize, y: usize, z: usize) -> f64 {
        self.brdf[(x * self.patches + y) * self.patches + z]
    }

    fn pairs(&self, mut value: impl FnMut(usize, usize) -> f64) -> Vec<f64> {
        let n = self.patches;
        (0..n * n).map(|k| value(k / n, k % n)).collect()
    }

    /// `(T L)(y -> z) = sum_x f(x, y, z) G(x, y) L(x -> y)` [Eq. 3].
    pub fn transport(&self, l: &[f64]) -> Vec<f64> {
        let n = self.patches;
        self.pairs(|y, z| {
            let term = |x: usize| self.f(x, y, z) * self.geometry[x * n + y] * l[x * n + y];
            (0..n).map(term).sum()
        })
    }

    /// `(T* Gamma)(x <- y) = G(x, y) sum_z f(x, y, z) Gamma(y <- z)` [Eq. 6].
    pub fn adjoint(&self, importance: &[f64]) -> Vec<f64> {
        let n = self.patches;
        self.pairs(|x, y| {
            let term = |z: usize| self.f(x, y, z) * importance[y * n + z];
            self.geometry[x * n + y] * (0..n).map(term).sum::<f64>()
        })
    }

    /// The importance that arrives of outgoing importance: `Gamma(y <- x) = G(x, y) Gamma(x -> y)` [Eq. 11].
    pub fn arriving(&self, outgoing: &[f64]) -> Vec<f64> {
        let n = self.patches;
        self.pairs(|y, x| self.geometry[x * n + y] * outgoing[x * n + y])
    }

    /// Solves `x = source + operator(x)` by iteration to rounding. `None` if it does not come to rest.
    pub fn solve(source: &[f64], operator: impl Fn(&[f64]) -> Vec<f64>) -> Option<Vec<f64>> {
        let mut x = source.to_vec();
        for _ in 0..10_000 {
            let next: Vec<f64> = operator(&x)
                .iter()
                .zip(source)
                .map(|(t, s)| t + s)
                .collect();
            let largest = next.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
            let moved = next
                .iter()
                .zip(&x)
                .fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
            x = next;
            if !largest.is_finite() {
                return None;
            }
            if moved <= 4.0 * <f64 as Float>::EPSILON * largest {
                return Some(x);
            }
        }
        None
    }

    /// `sum_xy A(x -> y) B(x <- y)`.
    pub fn inner(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }
}
