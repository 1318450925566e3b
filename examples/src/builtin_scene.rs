//! What is unknown about the scene that `recover` looks into without any file, [`render::scene::room`].

/// A parameter that is to be found.
#[derive(Clone, Debug)]
pub struct Unknown {
    /// Its key.
    pub name: &'static str,
    /// Where the search starts.
    pub start: Vec<f32>,
}

/// What is unknown about the room: the colours of two walls, the roughness of the sphere and the
/// light. The scene itself has the true values.
pub fn cornell_unknowns() -> Vec<Unknown> {
    let unknown = |name, start: &[f32]| Unknown {
        name,
        start: start.to_vec(),
    };
    vec![
        unknown("left.reflectance.value", &[0.5; 3]),
        unknown("right.reflectance.value", &[0.5; 3]),
        unknown("sphere.alpha.value", &[0.5]),
        unknown("light.emitter.radiance.value", &[4.0; 3]),
    ]
}
