//! What happens at a vertex of a path, each rule once.
//!
//! Single paths ([`super::path`]), waves (`super::wave`) and particles ([`super::particle`]) are loops that call these
//! functions in the same order. Those that waves call for many paths at a time have no branches: what is not wanted is
//! selected away.

pub mod interest;
pub(crate) mod light;
pub(super) mod normals;
pub(super) mod roulette;

use ad_core::Real;

use crate::bsdf::{Component, Part, TransportMode};
use crate::math::Rgb;
use crate::scene::Settings;

/// What paths from the camera carry.
pub(super) const MODE: TransportMode = TransportMode::Radiance;

/// Whether there may be vertices beyond the next one, for a path that has `depth` edges.
#[inline(always)]
pub(super) fn has_more(depth: u32, settings: &Settings) -> bool {
    depth + 1 < settings.max_depth
}

/// Whether a path may go on from a vertex: to light, if that counts there, or to vertices that it may be found from, if
/// there may be `more`.
#[inline(always)]
pub(super) fn may_go_on(lit: bool, more: bool) -> bool {
    lit | more
}

/// What of the value of a sampled direction is differentiated. `splits`: whether the change of normals has samples of its
/// own; deltas have no distribution of normals.
#[inline(always)]
pub(super) fn part_of(component: Component, splits: bool) -> Part {
    match component {
        Component::Continuous if splits => Part::Rest,
        _ => Part::All,
    }
}

/// With debug assertions: a throughput is finite, its derivatives included, or `found` is not, which the sample has brought
/// already and for which it is counted and left out. Anything else could end as a silent zero, since comparisons with NaN
/// are false.
#[inline(always)]
pub(super) fn assert_finite<R: Real>(throughput: Rgb<R>, found: Rgb<R>) {
    debug_assert!(
        throughput.is_finite() || !found.is_finite(),
        "a sample that has brought {found:?} goes on with throughput {throughput:?}"
    );
}
