//! What is to be computed, whatever it is.

use std::fmt;
use std::ops::Range;

use super::progress::Progress;
use crate::scene::{Scene, Settings};

/// Samples of an image: of which scene, how, and which.
///
/// ```
/// use render::{Job, Scene};
///
/// let text = r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor></scene>"#;
/// let (scene, _) = Scene::from_xml(text, "".as_ref(), &Default::default())?;
/// // Sixteen samples of every pixel with seed 1, as the scene file wants them, without reports of progress.
/// let job = Job::new(&scene, &scene.settings, 1, 0..16, &());
/// assert_eq!(job.samples, 0..16);
/// # Ok::<(), render::SceneError>(())
/// ```
#[derive(Clone)]
pub struct Job<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Depths, points, choice of lights, who finds caustics.
    pub settings: &'a Settings,
    /// All random numbers are a function of it. Passes whose results are multiplied need different ones (errata Z-4.4).
    pub seed: u64,
    /// Which samples of each pixel: ranges that do not overlap are independent, and their sums add up.
    pub samples: Range<u64>,
    /// Is told how far it is, and may stop it.
    pub progress: &'a dyn Progress,
}

impl<'a> Job<'a> {
    /// From its parts.
    pub fn new(
        scene: &'a Scene,
        settings: &'a Settings,
        seed: u64,
        samples: Range<u64>,
        progress: &'a dyn Progress,
    ) -> Self {
        Self {
            scene,
            settings,
            seed,
            samples,
            progress,
        }
    }

    /// How many samples of each pixel.
    pub fn count(&self) -> u64 {
        self.samples.end.saturating_sub(self.samples.start)
    }
}

impl fmt::Debug for Job<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (f.debug_struct("Job"))
            .field("settings", self.settings)
            .field("seed", &self.seed)
            .field("samples", &self.samples)
            .finish_non_exhaustive()
    }
}
