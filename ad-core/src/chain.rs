//! Tape-free reverse mode over a chain of stages.
//!
//! A stage maps a state of `S` numbers and its own `I - S` local parameters to the next state. The
//! forward sweep keeps one local Jacobian per stage; the backward sweep is the adjoint recursion
//! `adj_x <- (ds/dx)^T adj`, `adj_p = (ds/dp)^T adj`. Memory is `S x I` numbers per stage, whatever
//! happens inside the stages, and it is reused from chain to chain.

use crate::real::{Real, array};
use crate::vjp::{DiffFn, jacobian, transpose_mul};

/// Recorder of a chain: states of `S` numbers, stages of `I` inputs (the state first, then
/// `I - S` local parameters). Stages of different types may follow each other.
///
/// ```
/// use ad_core::{Chain, diff_fn};
/// diff_fn! { fn step<R>([x, a]: [R; 2]) -> [R; 1] { [x.sin() * a] } }
///
/// let mut chain = Chain::<f64, 2, 1>::new();
/// chain.start([0.3]);
/// chain.advance(&step, [0.9]);
/// chain.advance_all(&step, [[1.1], [0.8]]);
/// let mut grad = [0.0; 3];
/// let [d_x0] = chain.pull_back([1.0], |i, [d_a]: [f64; 1]| grad[i] = d_a);
/// assert!(d_x0 > 0.0 && grad.iter().all(|g| *g > 0.0));
/// ```
#[derive(Clone, Debug)]
pub struct Chain<P, const I: usize, const S: usize> {
    state: [P; S],
    jacobians: Vec<[[P; I]; S]>,
}

impl<P: Real, const I: usize, const S: usize> Chain<P, I, S> {
    /// An empty recorder.
    pub fn new() -> Self {
        Self::with_capacity(0)
    }

    /// An empty recorder that holds `stages` stages without allocating.
    pub fn with_capacity(stages: usize) -> Self {
        Self {
            state: [P::zero(); S],
            jacobians: Vec::with_capacity(stages),
        }
    }

    /// Begins a new chain at state `x0`; the buffer of the previous one is reused.
    #[inline]
    pub fn start(&mut self, x0: [P; S]) {
        self.state = x0;
        self.jacobians.clear();
    }

    /// Applies `stage` with local parameters `p` and returns the new state.
    #[inline]
    pub fn advance<F: DiffFn<I, S>, const Q: usize>(&mut self, stage: &F, p: [P; Q]) -> [P; S] {
        self.advance_all(stage, [p])
    }

    /// Applies `stage` once for each set of local parameters and returns the new state. Faster than
    /// a loop over [`advance`](Self::advance): the state stays in registers.
    #[inline]
    pub fn advance_all<F: DiffFn<I, S>, const Q: usize>(
        &mut self,
        stage: &F,
        params: impl IntoIterator<Item = [P; Q]>,
    ) -> [P; S] {
        const {
            assert!(
                S + Q == I,
                "a stage reads the state and its local parameters"
            )
        };
        let mut state = self.state;
        self.jacobians.extend(params.into_iter().map(|p| {
            let x = array(|k| if k < S { state[k] } else { p[k - S] });
            let (y, jac) = jacobian(stage, x);
            state = y;
            jac
        }));
        self.state = state;
        state
    }

    /// The current (last) state.
    #[inline]
    pub fn state(&self) -> [P; S] {
        self.state
    }

    /// Number of stages since `start`.
    #[inline]
    pub fn len(&self) -> usize {
        self.jacobians.len()
    }

    /// Whether no stage was applied since `start`.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.jacobians.is_empty()
    }

    /// Adjoint recursion from the adjoint of the last state back to the first, whose adjoint is
    /// returned. `each` receives stage index and local parameter gradient, last stage first.
    #[inline]
    pub fn pull_back<const Q: usize>(
        &self,
        adjoint: [P; S],
        mut each: impl FnMut(usize, [P; Q]),
    ) -> [P; S] {
        const {
            assert!(
                S + Q == I,
                "a stage reads the state and its local parameters"
            )
        };
        let mut adjoint = adjoint;
        for (i, jac) in self.jacobians.iter().enumerate().rev() {
            let all = transpose_mul(jac, adjoint);
            each(i, array(|k| all[S + k]));
            adjoint = array(|k| all[k]);
        }
        adjoint
    }

    /// As [`pull_back`](Self::pull_back), with a contribution of every state to the objective:
    /// `source(i)` is the derivative of the objective with respect to the state after stage `i`
    /// and is added before that stage is passed. A path's radiance is such a sum.
    #[inline]
    pub fn pull_back_sum<const Q: usize>(
        &self,
        mut source: impl FnMut(usize) -> [P; S],
        mut each: impl FnMut(usize, [P; Q]),
    ) -> [P; S] {
        const {
            assert!(
                S + Q == I,
                "a stage reads the state and its local parameters"
            )
        };
        let mut adjoint = [P::zero(); S];
        for (i, jac) in self.jacobians.iter().enumerate().rev() {
            let direct = source(i);
            let all = transpose_mul(jac, array(|k| adjoint[k] + direct[k]));
            each(i, array(|k| all[S + k]));
            adjoint = array(|k| all[k]);
        }
        adjoint
    }
}

impl<P: Real, const I: usize, const S: usize> Default for Chain<P, I, S> {
    fn default() -> Self {
        Self::new()
    }
}
