//! The sensors of a scene, one of which is looked through.

use super::{PixelShares, Scene};
use crate::camera::Camera;
use crate::error::{RenderError, SceneError, quoted};
use crate::film::Film;

/// What a scene is seen through.
#[derive(Clone, Debug)]
pub struct Sensor {
    /// Its id in the scene file, or a made-up one.
    pub name: String,
    /// Where it looks.
    pub camera: Camera,
    /// Resolution, crop and filter.
    pub film: Film,
    /// Samples per pixel.
    pub spp: u32,
}

/// The camera that is farthest from the origin: what is seen through any is seen as precisely as through this one.
pub(super) fn farthest<'a>(sensors: &'a [Sensor], camera: &'a Camera) -> &'a Camera {
    let distance = |c: &Camera| c.origin().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    let all = sensors.iter().map(|s| &s.camera);
    all.fold(camera, |best, c| {
        if distance(c) > distance(best) {
            c
        } else {
            best
        }
    })
}

/// Which of the sensors has this id, or this number.
pub(super) fn sensor_called(sensors: &[Sensor], name: &str) -> Result<usize, SceneError> {
    let by_number = || name.parse().ok().filter(|&i: &usize| i < sensors.len());
    let found = sensors
        .iter()
        .position(|s| s.name == name)
        .or_else(by_number);
    found.ok_or_else(|| {
        let names: Vec<_> = sensors.iter().map(|s| quoted(&s.name)).collect();
        SceneError::Parameter {
            key: "sensor".into(),
            expected: format!(
                "a number below {} or one of {}",
                names.len(),
                names.join(", ")
            ),
            found: quoted(name),
        }
    })
}

impl Scene {
    /// All that the scene can be looked at through, as they were given; one of them is [`Scene::camera`] and
    /// [`Scene::film`].
    pub fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    /// The number of the sensor with this name, or with this number.
    ///
    /// # Errors
    /// There is none; says which there are.
    pub fn sensor_called(&self, name: &str) -> Result<usize, SceneError> {
        sensor_called(&self.sensors, name)
    }

    /// The number of the sensor that is looked through.
    pub fn sensor_number(&self) -> usize {
        self.through
    }

    /// Looks through the sensor of this number from now on: at its resolution, with its samples per pixel, and all
    /// pixels sampled alike.
    ///
    /// # Errors
    /// A number without sensor, or a sensor that moves with parameters, which belong to it.
    pub fn look_through(&mut self, index: usize) -> Result<(), RenderError> {
        let Some(sensor) = self.sensors.get(index) else {
            return Err(RenderError::Count {
                what: "number of a sensor",
                expected: "one of those of the scene",
                found: index as u64,
            });
        };
        if self.camera.moves() {
            return Err(RenderError::Motion {
                name: "sensor".into(),
                culprit: "another sensor cannot take the parameters that move this one".into(),
            });
        }
        self.through = index;
        self.camera = sensor.camera.clone();
        self.film = sensor.film;
        self.settings.spp = sensor.spp;
        self.pixels = PixelShares::default();
        Ok(())
    }
}
