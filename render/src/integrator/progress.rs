//! How long computations report, and are stopped.

/// How a long computation reports, and whether it is wanted at all.
///
/// Computations ask many times a second whether they are cancelled, between the edges of paths as well. One that was
/// must stay so: what has been cut short is recognised by asking again afterwards.
pub trait Progress: Sync {
    /// `n` more units of work are done.
    fn advance(&self, _n: u64) {}
    /// Whether to stop early.
    fn cancelled(&self) -> bool {
        false
    }
}

impl Progress for () {}

impl std::fmt::Debug for dyn Progress + '_ {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let state = if self.cancelled() {
            "cancelled"
        } else {
            "wanted"
        };
        f.write_str(state)
    }
}
