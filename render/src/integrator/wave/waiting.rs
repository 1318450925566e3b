//! Paths that wait until there are enough of them: where most paths of a wave have ended, vectors would be empty.

use ad_core::Float;

use super::lanes::{Field, WAVE_SIZE};
use super::state::Paths;

/// With so many paths a wave goes on by itself.
const ENOUGH: usize = WAVE_SIZE * 3 / 4;

/// Paths with more edges do not wait: there are few of them, and the room for each number of edges is a wave.
const LONGEST: u32 = 32;

/// Paths that wait, by the number of edges they will have with the next one.
pub struct Waiting<P>(Vec<Rest<P>>);

/// Those of one number, fewer than a wave.
struct Rest<P> {
    n: usize,
    paths: Box<Paths<P>>,
}

impl<P: Float> Waiting<P> {
    /// No path waits.
    pub fn new() -> Self {
        Self(Vec::new())
    }

    /// Forgets all paths that wait.
    pub fn clear(&mut self) {
        for rest in &mut self.0 {
            rest.n = 0;
        }
    }

    /// The number of edges of those that have the fewest.
    pub fn shortest(&self) -> Option<u32> {
        let depth = self.0.iter().position(|rest| rest.n > 0)?;
        u32::try_from(depth).ok()
    }

    /// Paths that wait before edge number `depth` join the first `n` of `paths`, as many as there is room for. How many
    /// these are then.
    pub fn join(&mut self, depth: u32, paths: &mut Paths<P>, n: usize) -> usize {
        let Some(rest) = self.0.get_mut(depth as usize) else {
            return n;
        };
        let more = rest.n.min(WAVE_SIZE - n);
        rest.n -= more;
        for k in 0..more {
            paths.copy(n + k, &rest.paths, rest.n + k);
        }
        n + more
    }

    /// Others join the first `n` of `paths` before edge number `depth`; where they are too few all the same, they wait. How
    /// many of them go on.
    pub fn fill_up(&mut self, depth: u32, paths: &mut Paths<P>, n: usize) -> usize {
        if depth > LONGEST {
            return n;
        }
        while self.0.len() <= depth as usize {
            self.0.push(Rest {
                n: 0,
                paths: Box::new(Paths::zero()),
            });
        }
        let rest = &mut self.0[depth as usize];
        if n + rest.n > ENOUGH {
            return self.join(depth, paths, n);
        }
        for k in 0..n {
            rest.paths.copy(rest.n + k, paths, k);
        }
        rest.n += n;
        0
    }
}
