//! What happens at a vertex of a path, each rule once.
//!
//! Single paths ([`super::path`]), waves ([`super::wave`]) and particles ([`super::particle`]) are loops that call these
//! functions in the same order. Those that waves call for many paths at a time have no branches: what is not wanted is
//! selected away.

pub mod interest;
pub(crate) mod light;
pub(super) mod roulette;

use crate::bsdf::{Component, Part, TransportMode};

/// What paths from the camera carry.
pub(super) const MODE: TransportMode = TransportMode::Radiance;

/// What of the value of a sampled direction is differentiated. `splits`: whether the change of normals has samples of its
/// own; deltas have no distribution of normals.
#[inline(always)]
pub(super) fn part_of(component: Component, splits: bool) -> Part {
    match component {
        Component::Continuous if splits => Part::Rest,
        _ => Part::All,
    }
}
