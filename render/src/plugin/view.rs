//! Fields of view, which cameras and projectors have.

use super::Node;
use crate::camera::FovAxis;
use crate::error::SceneError;

impl Node {
    /// `fov` with `fov_axis`, or else `focal_length`: the full angle in degrees, and what it refers to.
    ///
    /// # Errors
    /// Both of them, or a length that is none.
    pub fn field_of_view(&self) -> Result<(f64, FovAxis), SceneError> {
        let given = self.choice(
            "fov_axis",
            &[
                ("x", FovAxis::X),
                ("y", FovAxis::Y),
                ("diagonal", FovAxis::Diagonal),
                ("smaller", FovAxis::Smaller),
                ("larger", FovAxis::Larger),
            ],
        )?;
        let length = self.string_or("focal_length", "50mm")?;
        match self.float("fov")? {
            Some(_) if self.has("focal_length") => {
                Err(self.invalid("focal_length", "none beside `fov`"))
            }
            Some(fov) => Ok((fov, given.unwrap_or_default())),
            None => {
                let number = length.trim().trim_end_matches("mm").trim_end();
                let millimetres = number.parse::<f64>().ok().filter(|l| *l > 0.0);
                let millimetres = millimetres
                    .ok_or_else(|| self.invalid("focal_length", "a length such as `50mm`"))?;
                // Of 35 mm film, 36 mm x 24 mm, along its diagonal; 50 mm is the default of Mitsuba.
                let fov = 2.0 * (36.0f64.hypot(24.0) / (2.0 * millimetres)).atan();
                Ok((fov.to_degrees(), FovAxis::Diagonal))
            }
        }
    }
}
