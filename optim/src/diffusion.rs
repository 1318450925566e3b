//! Vertices that move with their neighbours.

use std::collections::HashMap;
use std::sync::Arc;

use faer::Side;
use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::Llt;
use faer::sparse::{SparseColMat, Triplet};
use serde::{Deserialize, Serialize};

use crate::error::{OptimError, require};
use crate::scalar::Scalar;

/// A change of variables for values on the vertices of a graph, positions of a mesh above all:
/// `p = (I + lambda L)^-1 u`, where `L` is the graph's combinatorial Laplacian: the number of neighbours on the diagonal,
/// -1 between neighbours [Nicolet et al. 2021, Eq. 8 and 10].
///
/// An optimiser that moves `u` moves a vertex together with its neighbourhood, about `sqrt(lambda)` edges wide: the noise
/// of single vertices and the steep gradients of silhouettes spread before they can fold the surface, while what the
/// optimum is does not change. By plain gradient descent the step is `(I + lambda L)^-2` of the gradient. Adam keeps
/// the direction that was so found, as with [`AdamOptions::uniform`](crate::AdamOptions::uniform), in ranges that are so tied
/// ([`Constrained`](crate::Constrained)).
///
/// Several vertices may be one: those along the seams of texture coordinates, say. They get one value.
///
/// ```
/// use optim::{Constrained, Diffusion, Groups, Optimizer, Parameterisation, Sgd};
///
/// // Two triangles over four vertices, of which the gradient sees the first.
/// let mesh = Diffusion::of_triangles(&[0, 1, 2, 3], &[[0, 1, 2], [1, 3, 2]], 2.0)?;
/// let mut groups = Groups::new(4 * 3); // [vertex][component]
/// groups.add("mesh.vertex_positions", 0..12, Parameterisation::Identity)?;
/// groups.tie("mesh.vertex_positions", mesh)?;
/// let mut optimizer = Constrained::new(Sgd::new(12, 1.0)?, groups)?;
/// let (mut points, mut gradient) = ([0.0f64; 12], [0.0; 12]);
/// gradient[2] = 1.0; // the height of the first vertex
/// optimizer.step(&mut points, &gradient)?;
/// let heights: Vec<f64> = points.chunks(3).map(|p| -p[2]).collect();
/// assert!(heights[0] > heights[1] && heights[1] > heights[3] && heights[3] > 0.0, "{heights:?}");
/// assert!((heights.iter().sum::<f64>() - 1.0).abs() < 1e-9); // a step is spread, not lost
/// # Ok::<(), optim::OptimError>(())
/// ```
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(into = "RawDiffusion", try_from = "RawDiffusion")]
pub struct Diffusion {
    lambda: f64,
    /// The distinct vertex that each of them is, in order of first mention.
    distinct: Vec<u32>,
    /// Pairs of neighbours among the distinct ones, in order, each once.
    edges: Vec<[u32; 2]>,
    /// Sparse Cholesky factor over the distinct vertices.
    factor: Arc<Llt<usize, f64>>,
    /// The first vertex that is each of the distinct ones.
    first: Vec<u32>,
}

#[derive(Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawDiffusion {
    #[serde(with = "crate::exact::number")]
    lambda: f64,
    distinct: Vec<u32>,
    edges: Vec<[u32; 2]>,
}

impl From<Diffusion> for RawDiffusion {
    fn from(d: Diffusion) -> Self {
        Self {
            lambda: d.lambda,
            distinct: d.distinct,
            edges: d.edges,
        }
    }
}

impl TryFrom<RawDiffusion> for Diffusion {
    type Error = OptimError;
    fn try_from(raw: RawDiffusion) -> Result<Self, OptimError> {
        Self::over(raw.distinct, raw.edges, raw.lambda)
    }
}

impl PartialEq for Diffusion {
    fn eq(&self, other: &Self) -> bool {
        self.lambda == other.lambda && self.distinct == other.distinct && self.edges == other.edges
    }
}

impl Diffusion {
    /// Along the edges of triangles. `same[i]` is any number that vertices at the same place share, and no others: bits of
    /// a position, or the index `i` itself.
    ///
    /// # Errors
    /// `lambda` is negative or not finite, or a triangle names a vertex that `same` does not have.
    pub fn of_triangles(
        same: &[u64],
        triangles: &[[u32; 3]],
        lambda: f64,
    ) -> Result<Self, OptimError> {
        let mut numbers = HashMap::new();
        let distinct = (same.iter())
            .map(|place| {
                let next = numbers.len() as u32;
                *numbers.entry(*place).or_insert(next)
            })
            .collect::<Vec<u32>>();
        let mut edges = Vec::with_capacity(3 * triangles.len());
        for &[a, b, c] in triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let at = |i: u32| {
                    (distinct.get(i as usize).copied()).ok_or(OptimError::Option {
                        name: "triangle",
                        expected: "indices of vertices",
                        found: i.into(),
                    })
                };
                let (from, to) = (at(from)?, at(to)?);
                // A degenerate triangle connects a vertex with itself, which is no edge.
                if from != to {
                    edges.push([from.min(to), from.max(to)]);
                }
            }
        }
        edges.sort_unstable();
        edges.dedup();
        Self::over(distinct, edges, lambda)
    }

    fn over(distinct: Vec<u32>, edges: Vec<[u32; 2]>, lambda: f64) -> Result<Self, OptimError> {
        let valid = lambda >= 0.0 && lambda.is_finite();
        require(valid, "lambda", "a finite value of at least 0", lambda)?;
        let mut first = Vec::new();
        for (&d, i) in distinct.iter().zip(0u32..) {
            match (d as usize).cmp(&first.len()) {
                std::cmp::Ordering::Less => {}
                std::cmp::Ordering::Equal => first.push(i),
                std::cmp::Ordering::Greater => {
                    return Err(OptimError::Option {
                        name: "distinct vertices",
                        expected: "numbers in order of first mention",
                        found: d.into(),
                    });
                }
            }
        }
        let n = first.len();
        let ordered = edges.windows(2).all(|w| w[0] < w[1]);
        if let Some(bad) = (edges.iter()).find(|[a, b]| a >= b || *b as usize >= n || !ordered) {
            return Err(OptimError::Option {
                name: "edges",
                expected: "increasing pairs of distinct vertices, in order",
                found: bad[1].into(),
            });
        }
        let mut degree = vec![0u32; n];
        let mut entries = Vec::with_capacity(n + 2 * edges.len());
        for &[a, b] in &edges {
            degree[a as usize] += 1;
            degree[b as usize] += 1;
            entries.push(Triplet::new(a as usize, b as usize, -lambda));
            entries.push(Triplet::new(b as usize, a as usize, -lambda));
        }
        for (i, d) in degree.into_iter().enumerate() {
            entries.push(Triplet::new(i, i, 1.0 + lambda * f64::from(d)));
        }
        let too_large = |_| OptimError::Option {
            name: "lambda",
            expected: "a system that can be factored",
            found: lambda,
        };
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &entries)
            .map_err(|_| too_large(()))?;
        let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| too_large(()))?;
        Ok(Self {
            lambda,
            distinct,
            edges,
            factor: Arc::new(factor),
            first,
        })
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.distinct.len()
    }

    /// How strongly neighbours are tied: the square of the width, in edges, that a single vertex's gradient spreads to.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// `(I + lambda L) p`: the variables of values, `[vertex][component]`. Where vertices are one, the first one's value
    /// counts.
    pub(crate) fn variables<T: Scalar>(&self, values: &[T], variables: &mut [T]) {
        let components = self.components(values);
        for c in 0..components {
            let at = |d: u32| values[self.first[d as usize] as usize * components + c].to_f64();
            let mut u: Vec<f64> = (0..self.first.len() as u32).map(at).collect();
            for &[a, b] in &self.edges {
                let difference = self.lambda * (at(a) - at(b));
                u[a as usize] += difference;
                u[b as usize] -= difference;
            }
            self.spread(&u, c, variables);
        }
    }

    /// `(I + lambda L)^-1 u`: the values of variables.
    pub(crate) fn values<T: Scalar>(&self, variables: &[T], values: &mut [T]) {
        let components = self.components(variables);
        for c in 0..components {
            let u = (self.first.iter()).map(|&i| variables[i as usize * components + c].to_f64());
            let p = self.solve(u.collect());
            self.spread(&p, c, values);
        }
    }

    /// The derivative by the variables, in place of that by the values.
    pub(crate) fn pull_back<T: Scalar>(&self, gradient: &mut [T]) {
        let components = self.components(gradient);
        for c in 0..components {
            let mut sums = vec![0.0; self.first.len()];
            for (&d, g) in self.distinct.iter().zip(gradient.chunks_exact(components)) {
                sums[d as usize] += g[c].to_f64();
            }
            let g = self.solve(sums);
            self.spread(&g, c, gradient);
        }
    }

    fn components<T>(&self, values: &[T]) -> usize {
        values.len() / self.distinct.len().max(1)
    }

    fn solve(&self, rhs: Vec<f64>) -> Vec<f64> {
        let mut column = faer::Col::from_fn(rhs.len(), |i| rhs[i]);
        self.factor.solve_in_place(&mut column);
        column.iter().copied().collect()
    }

    /// Gives each vertex the value of its distinct one.
    fn spread<T: Scalar>(&self, values: &[f64], component: usize, to: &mut [T]) {
        let components = self.components(to);
        for (&d, to) in (self.distinct.iter()).zip(to.chunks_exact_mut(components.max(1))) {
            to[component] = T::from_f64(values[d as usize]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Adam, AdamOptions, Constrained, Groups, Optimizer, Parameterisation, Rates, Sgd};
    use approx::assert_relative_eq;

    /// A strip of `n` squares, each cut in two; the vertices of the lower edge first.
    fn strip(n: u32) -> Vec<[u32; 3]> {
        let up = n + 1;
        (0..n)
            .flat_map(|i| [[i, i + 1, up + i], [i + 1, up + i + 1, up + i]])
            .collect()
    }

    fn each(n: u64) -> Vec<u64> {
        (0..n).collect()
    }

    #[test]
    fn a_triangle_by_hand() {
        // L has 2 on the diagonal and -1 elsewhere: the mean is kept, what differs from it is divided by 1 + 3 lambda.
        let d = Diffusion::of_triangles(&each(3), &[[0, 1, 2]], 2.0).unwrap();
        let mut p = [0.0; 3];
        d.values(&[7.0, 0.0, -4.0], &mut p);
        for (p, expected) in p
            .iter()
            .zip([1.0 + 6.0 / 7.0, 1.0 - 1.0 / 7.0, 1.0 - 5.0 / 7.0])
        {
            assert_relative_eq!(*p, expected, epsilon = 1e-14);
        }
    }

    #[test]
    fn variables_are_the_inverse_of_values() {
        let d = Diffusion::of_triangles(&each(22), &strip(10), 19.0).unwrap();
        let p: Vec<f64> = (0..66).map(|i| f64::from(i * i % 17) - 3.0).collect();
        let (mut u, mut back) = (vec![0.0; 66], vec![0.0; 66]);
        d.variables(&p, &mut u);
        d.values(&u, &mut back);
        for (p, back) in p.iter().zip(back) {
            assert_relative_eq!(*p, back, epsilon = 1e-12);
        }
    }

    #[test]
    fn pulling_back_is_the_transpose_of_values() {
        // Vertices 3 and 21 are one: the derivative by its variable collects both, and each of them moves by it.
        let mut same = each(22);
        same[21] = 3;
        let d = Diffusion::of_triangles(&same, &strip(10), 5.0).unwrap();
        let direction: Vec<f64> = same.iter().map(|i| (*i as f64 * 0.7).sin()).collect();
        let adjoint: Vec<f64> = (0..22).map(|i| f64::from(i).cos()).collect();
        let mut moved = vec![0.0; 22];
        d.values(&direction, &mut moved);
        assert_eq!(moved[21], moved[3]);
        let forward: f64 = moved.iter().zip(&adjoint).map(|(m, a)| m * a).sum();
        let mut pulled = adjoint.clone();
        d.pull_back(&mut pulled);
        assert_eq!(pulled[21], pulled[3]);
        let reverse: f64 = (0..21).map(|i| pulled[i] * direction[i]).sum();
        assert_relative_eq!(forward, reverse, epsilon = 1e-12);
    }

    #[test]
    fn gradient_descent_steps_by_two_solves() {
        let d = Diffusion::of_triangles(&each(8), &strip(3), 1.5).unwrap();
        let mut twice: Vec<f64> = (0..8).map(|i| f64::from(i % 3)).collect();
        let gradient = twice.clone();
        d.pull_back(&mut twice);
        d.pull_back(&mut twice);

        let mut groups = Groups::new(8);
        groups.add("p", 0..8, Parameterisation::Identity).unwrap();
        groups.tie("p", d).unwrap();
        let sgd = Sgd::with_options(Rates::new(8, 0.5).unwrap(), Default::default()).unwrap();
        let mut o = Constrained::new(sgd, groups).unwrap();
        let mut p = [1.0; 8];
        o.step(&mut p, &gradient).unwrap();
        for (p, twice) in p.iter().zip(twice) {
            assert_relative_eq!(*p, 1.0 - 0.5 * twice, epsilon = 1e-13);
        }
    }

    #[test]
    fn the_optimum_stays_and_noise_does_not_fold_the_surface() {
        // Positions along a line, which should be where they are, seen with noise in each vertex.
        let n = 20;
        let d = Diffusion::of_triangles(&each(2 * (n + 1)), &strip(n as u32), 10.0).unwrap();
        let len = 2 * (n as usize + 1);
        let target: Vec<f64> = (0..len).map(|i| (i % (len / 2)) as f64 * 0.05).collect();
        let largest_fold = |tied: bool| {
            let mut groups = Groups::new(len);
            groups.add("p", 0..len, Parameterisation::Identity).unwrap();
            if tied {
                groups.tie("p", d.clone()).unwrap();
            }
            let options = AdamOptions {
                uniform: true,
                ..Default::default()
            };
            let adam = Adam::with_options(Rates::new(len, 0.02).unwrap(), options).unwrap();
            let mut o = Constrained::new(adam, groups).unwrap();
            let mut p = target.clone();
            let mut state = 1u32;
            let mut folds = 0;
            for _ in 0..200 {
                let g: Vec<f64> = (p.iter().zip(&target))
                    .map(|(p, t)| {
                        state = state.wrapping_mul(1664525).wrapping_add(1013904223);
                        p - t + 0.5 * (f64::from(state) / 2f64.powi(31) - 1.0)
                    })
                    .collect();
                o.step(&mut p, &g).unwrap();
                folds += (1..len / 2).filter(|&i| p[i] <= p[i - 1]).count();
            }
            folds
        };
        assert_eq!(largest_fold(true), 0);
        assert!(largest_fold(false) > 100);
    }

    #[test]
    fn resting_values_keep_their_bits_and_state_survives_json() {
        let d = Diffusion::of_triangles(&each(8), &strip(3), 30.0).unwrap();
        let mut groups = Groups::new(9);
        groups.add("p", 1..9, Parameterisation::Identity).unwrap();
        groups.tie("p", d).unwrap();
        let mut o = Constrained::new(Adam::<f32>::new(9, 0.1).unwrap(), groups).unwrap();
        let mut p: [f32; 9] = std::array::from_fn(|i| (i as f32).sin());
        let before = p.map(f32::to_bits);
        o.step(&mut p, &[0.0; 9]).unwrap();
        assert_eq!(p.map(f32::to_bits), before);
        let gradient: [f32; 9] = std::array::from_fn(|i| (2.0 * i as f32).cos());
        o.step(&mut p, &gradient).unwrap();

        let text = serde_json::to_string(&o).unwrap();
        let mut restored: Constrained<Adam<f32>, f32> = serde_json::from_str(&text).unwrap();
        assert_eq!(restored, o);
        let mut q = p;
        for _ in 0..5 {
            o.step(&mut p, &gradient).unwrap();
            restored.step(&mut q, &gradient).unwrap();
        }
        assert_eq!(p.map(f32::to_bits), q.map(f32::to_bits));
        for (from, to) in [
            (r#""lambda":"30.0""#, r#""lambda":"-1""#),
            (r#""edges":[[0,1]"#, r#""edges":[[1,0]"#),
            (r#""distinct":[0,1"#, r#""distinct":[0,2"#),
            (r#""distinct":[0,"#, r#""distinct":["#),
        ] {
            let damaged = text.replace(from, to);
            assert_ne!(damaged, text, "{from}");
            assert!(serde_json::from_str::<Constrained<Adam<f32>, f32>>(&damaged).is_err());
        }
    }

    #[test]
    fn what_cannot_be_tied_is_named() {
        let d = || Diffusion::of_triangles(&each(8), &strip(3), 1.0).unwrap();
        let mut groups = Groups::new(20);
        groups.add("a", 0..9, Parameterisation::Identity).unwrap();
        groups
            .add("b", 9..17, Parameterisation::bounded(0.0, 1.0).unwrap())
            .unwrap();
        assert_eq!(
            groups.tie("a", d()).unwrap_err().to_string(),
            "group `a`: expected a multiple of 8 entries, the number of vertices, found 9"
        );
        assert!(
            (groups.tie("b", d()).unwrap_err().to_string()).starts_with(
                "group `b`: expected entries without bounds and variables of their own"
            )
        );
        assert_eq!(
            groups.tie("c", d()).unwrap_err().to_string(),
            "group: expected one of a, b, found `c`"
        );
        for lambda in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(Diffusion::of_triangles(&each(8), &strip(3), lambda).is_err());
        }
        assert_eq!(
            Diffusion::of_triangles(&each(3), &[[0, 1, 3]], 1.0)
                .unwrap_err()
                .to_string(),
            "triangle: expected indices of vertices, found 3"
        );
        // Far beyond what is useful, and still finite.
        let stiff = Diffusion::of_triangles(&each(8), &strip(3), 1e12).unwrap();
        let mut p = [0.0f32; 8];
        stiff.values(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], &mut p);
        assert!(p.iter().all(|p| (p - 0.125).abs() < 1e-3));

        groups
            .add("free", 17..20, Parameterisation::Identity)
            .unwrap();
        groups
            .tie(
                "free",
                Diffusion::of_triangles(&each(3), &[[0, 1, 2]], 1.0).unwrap(),
            )
            .unwrap();
        let rates = Rates::new(20, 1.0).unwrap();
        let refused = crate::GaussNewton::<f32>::new(rates, groups, Default::default());
        assert!(refused.unwrap_err().to_string().contains("Gauss-Newton"));
    }
}
