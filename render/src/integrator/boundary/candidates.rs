//! The choice of one edge among several, by what they may bring.

/// Edges that a vertex chooses among.
pub(super) const CANDIDATES: u32 = 4;

/// One of [`CANDIDATES`] is kept, in proportion to what it may bring over the density that it was drawn with.
pub(super) struct Candidates<T> {
    /// A uniform number, used again for each choice.
    choice: f64,
    total: f64,
    /// With its target.
    one: Option<(T, f64)>,
}

impl<T> Candidates<T> {
    pub fn new(choice: f64) -> Self {
        Self {
            choice,
            total: 0.0,
            one: None,
        }
    }

    /// `target` is what it may bring, `weight` is one over its density.
    pub fn add(&mut self, one: T, target: f64, weight: f64) {
        let weight = target * weight;
        if !(weight > 0.0 && weight.is_finite()) {
            return;
        }
        self.total += weight;
        let p = weight / self.total;
        if self.choice < p {
            self.choice /= p;
            self.one = Some((one, target));
        } else {
            self.choice = (self.choice - p) / (1.0 - p);
        }
    }

    /// The one that is kept, and its weight.
    pub fn kept(self) -> Option<(T, f64)> {
        let (one, target) = self.one?;
        Some((one, self.total / f64::from(CANDIDATES) / target))
    }
}
