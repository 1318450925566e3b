//! What integrals over light that is found by solving equations, over chains and in glints, refuse.

use crate::error::RenderError;
use crate::estimator::{Sampling, Strategy};
use crate::params::{ParamInfo, ParamKind};
use crate::scene::{Scene, Settings};

/// Such light, in errors: it has no derivatives in what moves it, and some passes leave it out.
pub(super) struct Solved {
    /// What its paths are called.
    pub these: &'static str,
    /// The option that leaves them out.
    pub option: &'static str,
    /// Makes an error of a sentence.
    pub error: fn(String) -> RenderError,
    /// Whether settings ask for them.
    pub is_sought: fn(&Settings) -> bool,
    /// Whether estimates are right in a scene.
    pub admits: fn(&Scene, &Settings) -> Result<(), RenderError>,
}

impl Solved {
    /// Refuses scenes that it does not admit, and derivatives that it does not have: those by paths that move as a whole, and
    /// those in parameters that move something.
    ///
    /// # Errors
    /// Names the parameter, or the reason. None where nobody asks for it.
    pub fn check<'a, S: Strategy>(
        &self,
        scene: &Scene,
        settings: &Settings,
        moving: impl IntoIterator<Item = &'a ParamInfo>,
    ) -> Result<(), RenderError> {
        if !(self.is_sought)(settings) {
            return Ok(());
        }
        (self.admits)(scene, settings)?;
        if !S::Bsdf::DETACHED_PATH {
            return Err((self.error)(format!(
                "whole paths that move have none; expected another estimator, or `{}`",
                self.option
            )));
        }
        (moving.into_iter()).try_for_each(|info| self.check_stays(settings, info))
    }

    /// Refuses a parameter that moves something.
    ///
    /// # Errors
    /// Names it. None where nobody asks for such light.
    pub fn check_stays(&self, settings: &Settings, info: &ParamInfo) -> Result<(), RenderError> {
        if !(self.is_sought)(settings) {
            return Ok(());
        }
        match info.kind {
            ParamKind::Smooth | ParamKind::Emission | ParamKind::Roughness | ParamKind::Normals => {
                Ok(())
            }
            ParamKind::Delta
            | ParamKind::Position
            | ParamKind::VertexNormals
            | ParamKind::Camera
            | ParamKind::LightPosition => {
                let (name, these, option) = (&info.name, self.these, self.option);
                Err((self.error)(format!(
                    "parameter `{name}` moves {these}, which have derivatives only where they stay; expected `{option}`, and an \
                     estimator that sees it"
                )))
            }
        }
    }

    /// Refuses it in a pass over paths alone; `whose`: what that computes.
    ///
    /// # Errors
    /// Settings that ask for it.
    pub fn check_absent(&self, settings: &Settings, whose: &str) -> Result<(), RenderError> {
        if (self.is_sought)(settings) {
            return Err((self.error)(format!(
                "{whose} leave out their light; expected `{}`",
                self.option
            )));
        }
        Ok(())
    }
}
