//! The perspective pinhole camera.

use ad_core::{Float, Vec3};

use crate::error::SceneError;
use crate::math::{Ray, Transform};

/// What the angle of view refers to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FovAxis {
    /// Image width.
    #[default]
    X,
    /// Image height.
    Y,
    /// The diagonal.
    Diagonal,
    /// The shorter side.
    Smaller,
    /// The longer side.
    Larger,
}

/// A pinhole camera with the peer's conventions: it looks along its local +z, +x of the world is on
/// the right when it looks along -z with y up, and row 0 of the image is the top.
#[derive(Clone, Debug)]
pub struct Camera {
    origin: [f64; 3],
    /// The direction through the point `(x, y)` of the image is `x dx + y dy + corner`, not normalised.
    dx: [f64; 3],
    dy: [f64; 3],
    corner: [f64; 3],
    resolution: [u32; 2],
}

impl Camera {
    /// A camera for an image of `resolution = [width, height]` with the full angle `fov` in degrees.
    ///
    /// # Errors
    /// An angle outside (0, 180) or a transform without inverse.
    pub fn new(
        to_world: Transform,
        fov: f64,
        axis: FovAxis,
        resolution: [u32; 2],
    ) -> Result<Self, SceneError> {
        let bad = |key: &str, expected: &str, found: String| SceneError::Parameter {
            key: key.into(),
            expected: expected.into(),
            found,
        };
        if !(fov > 0.0 && fov < 180.0) {
            return Err(bad("fov", "an angle in (0, 180) degrees", fov.to_string()));
        }
        if to_world.inverse().is_none() {
            return Err(bad(
                "to_world",
                "an invertible transform",
                format!("{:?}", to_world.matrix()),
            ));
        }
        let (w, h) = (f64::from(resolution[0]), f64::from(resolution[1]));
        let tan = (fov.to_radians() / 2.0).tan();
        let half_x = match axis {
            FovAxis::X => tan,
            FovAxis::Y => tan * w / h,
            FovAxis::Diagonal => tan * w / w.hypot(h),
            FovAxis::Smaller => tan * w / w.min(h),
            FovAxis::Larger => tan * w / w.max(h),
        };
        let half_y = half_x * h / w;
        // The camera's local x axis points left in the image, y up.
        Ok(Self {
            origin: to_world.point([0.0; 3]),
            dx: to_world.vector([-2.0 * half_x / w, 0.0, 0.0]),
            dy: to_world.vector([0.0, -2.0 * half_y / h, 0.0]),
            corner: to_world.vector([half_x, half_y, 1.0]),
            resolution,
        })
    }

    /// The ray through a point of the image: `x` in [0, width], `y` in [0, height], from the top left.
    #[inline]
    pub fn ray<P: Float>(&self, x: P, y: P) -> Ray<P> {
        let component =
            |i: usize| x * P::c(self.dx[i]) + y * P::c(self.dy[i]) + P::c(self.corner[i]);
        let d = Vec3::new(component(0), component(1), component(2));
        Ray::new(self.origin.map(P::of).into(), d.normalize())
    }

    /// Width and height of the image that the camera was made for.
    pub fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// Position, world space.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }
}
