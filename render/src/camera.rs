//! The perspective pinhole camera.

use ad_core::{Const, Float, Vec3};

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
    to_world: Transform,
    origin: [f64; 3],
    /// Half the width of the image plane at distance 1, and half its height.
    half: [f64; 2],
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
        let origin = to_world.point([0.0; 3]);
        Ok(Self {
            to_world,
            origin,
            half: [half_x, half_x * h / w],
            resolution,
        })
    }

    /// The ray through a point of the image: `x` in [0, width], `y` in [0, height], from the top left.
    #[inline]
    pub fn ray<P: Float>(&self, x: P, y: P) -> Ray<P> {
        let scale = |i: usize| P::c(2.0 * self.half[i] / f64::from(self.resolution[i]));
        // The camera's local x axis points left in the image.
        let lx = P::of(self.half[0]) - x * scale(0);
        let ly = P::of(self.half[1]) - y * scale(1);
        let m = self.to_world.matrix();
        let row = |i: usize| lx * P::c(m[i][0]) + ly * P::c(m[i][1]) + Const(P::of(m[i][2]));
        let o = self.origin.map(P::of);
        Ray::new(o.into(), Vec3::new(row(0), row(1), row(2)).normalize())
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
