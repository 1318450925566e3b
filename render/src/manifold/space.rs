//! Where connections are sought, and between what.

use ad_core::Vec3;

use crate::params::Theta;
use crate::scene::{Constraint, Scene, Steps};
use crate::shape::{Exit, SurfaceInteraction};

/// Where connections are sought.
#[derive(Clone, Copy, Debug)]
pub struct Space<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Its parameters.
    pub theta: Theta<'a, f64>,
    /// The function whose roots are chains.
    pub constraint: Constraint,
    /// How walks step.
    pub steps: Steps,
}

/// The vertex that a chain starts at, which is not specular.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    /// The surface there.
    pub si: SurfaceInteraction<f64>,
    /// How rays leave it.
    pub exit: Exit,
}

/// What a chain ends at.
#[derive(Clone, Copy, Debug)]
pub enum Target {
    /// A point, world space.
    Point(Vec3<f64>),
    /// Infinitely far in this unit direction, world space.
    Direction(Vec3<f64>),
}
