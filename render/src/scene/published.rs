//! The integrators of [Zeltner et al. 2020] in scene files: which settings their options are.
//!
//! | option | of | here |
//! |---|---|---|
//! | `bounces` | `_ms` | exactly so many vertices |
//! | `disable_reflected_emitters` | `_ss` | [`Seen::Nothing`] |
//! | `biased`, `max_trials` | `path_sms_*` | a trial set, or most trials of an estimate |
//! | `mnee_init`, `biased_mnee` | `path_sms_ss`, `_ms` | one start; without paths for what it misses |
//! | `twostage` | `path_sms_ss`, `_ms` | where walks start, of random ones; particles if it is not there |
//! | `halfvector_constraints` | `path_sms_ss`, `_ms` | the constraint |
//! | `uniqueness_threshold` | `path_sms_*` | the published rule; bounds of errors if it is not there |
//! | `max_iterations` | `path_sms_*` | most steps of a walk |
//! | `step_scale`, `solver_threshold` | `path_sms_ss`, `_ms` | the part of Newton's step that is tried first, where walks end |
//! | `bsdf_strategy_only`, `sms_strategy_only` | `path_sms_glints` | who finds glints |
//!
//! All others are warned of, with what is done instead, or are not known.

use super::{
    CasterLight, Connections, Constraint, GlintMethod, GlintTechniques, Glints, Method, Seen,
    Starts, Steps, Uniqueness,
};
use crate::error::SceneError;
use crate::plugin::Node;

/// Those that find the light of chains by paths.
pub(super) const FILTERED: &[&str] = &["path_filtered_ss", "path_filtered_ms"];
/// Those that find it by connections.
pub(super) const CONNECTED: &[&str] = &["path_sms_ss", "path_sms_ms"];
/// The one of them that finds glints.
pub(super) const GLINTY: &[&str] = &["path_sms_glints"];

/// Steps that are Newton's, whatever is asked for.
const STEPS: &str = "`step_scale`: steps are Newton's, halved where they fail";
/// Walks that end where rounding says.
const ENDS: &str = "`solver_threshold`: walks end where their root is certain, or at rounding";

/// Which light over casters there is, and how it is found.
pub(super) fn connections(node: &Node) -> Result<Connections, SceneError> {
    let plugin = node.plugin.as_str();
    let several = plugin.ends_with("_ms");
    let most = i64::from(Connections::MOST_BOUNCES);
    let (bounces, seen) = if several {
        let bounces = node.integer_in("bounces", 2, 1..=most)? as u32;
        (bounces, Seen::AlongDeltas)
    } else if node.boolean_or("disable_reflected_emitters", false)? {
        (1, Seen::Nothing)
    } else {
        (1, Seen::Directly)
    };
    let besides = match seen {
        Seen::Nothing => "",
        Seen::Directly => ", and of lights that the camera sees in them",
        Seen::AlongDeltas => ", and of lights that the camera sees in mirrors and glass",
    };
    node.warn(format!(
        "of the light over casters, there is that of chains of {bounces} by reflection in metal and refraction in \
         glass{besides}; other light over them is left out, as by the authors of this integrator"
    ));
    let family = Connections {
        bounces,
        light: CasterLight::Published(seen),
        ..Connections::new(Method::Paths)
    };
    if FILTERED.contains(&plugin) {
        return Ok(family);
    }
    let trials = trials(node)?;
    let method = method(node, trials)?;
    let starts = match node.boolean("twostage")? {
        Some(_) if method.is_deterministic() => {
            node.ignore(&["twostage"], Node::boolean)?;
            Starts::default()
        }
        Some(true) => Starts::TwoStage,
        Some(false) => Starts::Uniform,
        None => Starts::default(),
    };
    let constraint = if node.boolean_or("halfvector_constraints", false)? {
        Constraint::HalfVector
    } else {
        Constraint::Angle
    };
    let uniqueness = match threshold(node)? {
        Some(x) => {
            node.warn(
                "`uniqueness_threshold`: solutions that are nearer are taken for one, which loses light; without it they are \
                 told apart by bounds of their errors",
            );
            Uniqueness::Threshold(x)
        }
        None => Uniqueness::default(),
    };
    Ok(Connections {
        method,
        constraint,
        uniqueness,
        starts,
        steps: steps(node)?,
        budget: trials.unwrap_or(family.budget),
        ..family
    })
}

/// `max_iterations`: most steps of a walk.
fn iterations(node: &Node, default: u32) -> Result<u32, SceneError> {
    Ok(node.integer_in("max_iterations", i64::from(default), 1..=1000)? as u32)
}

/// How walks step.
fn steps(node: &Node) -> Result<Steps, SceneError> {
    let usual = Steps::default();
    let scale = node.float_or("step_scale", usual.scale)?;
    if !(scale > 0.0 && scale < 2.0) {
        return Err(node.invalid("step_scale", "a positive number below 2"));
    }
    let tolerance = node.float_or("solver_threshold", usual.tolerance)?;
    if !(tolerance > 0.0 && tolerance.is_finite()) {
        return Err(node.invalid("solver_threshold", "a positive number"));
    }
    Ok(Steps {
        most: iterations(node, usual.most)?,
        scale,
        tolerance,
    })
}

/// The estimator of `path_sms_ss` and `path_sms_ms`.
fn method(node: &Node, trials: Option<u32>) -> Result<Method, SceneError> {
    let biased = node.boolean_or("biased", false)?;
    let deterministic = node.boolean_or("mnee_init", false)?;
    let alone = node.boolean("biased_mnee")?;
    if deterministic {
        return Ok(if alone == Some(true) {
            Method::Mnee
        } else {
            Method::MneeUnbiased
        });
    }
    if alone == Some(true) {
        node.ignore(&["biased_mnee"], Node::boolean)?;
    }
    if !biased {
        return Ok(Method::Sms);
    }
    set(node, trials, Connections::TRIALS).map(Method::SmsBiased)
}

/// The size of a trial set.
fn set(node: &Node, trials: Option<u32>, default: u32) -> Result<u32, SceneError> {
    let most = Connections::MOST_WALKS;
    match trials {
        Some(n) if n > most => {
            let expected = format!("a trial set of at most {most} walks");
            Err(node.invalid("max_trials", &expected))
        }
        Some(n) => Ok(n),
        None => {
            node.warn(format!(
                "`biased` without `max_trials`: trial sets of {default} walks"
            ));
            Ok(default)
        }
    }
}

/// `max_trials`: of an estimate, or of a trial set.
fn trials(node: &Node) -> Result<Option<u32>, SceneError> {
    match node.integer("max_trials")? {
        None | Some(-1) => Ok(None),
        Some(n @ 1..=0xffff_ffff) => Ok(Some(n as u32)),
        Some(_) => Err(node.invalid("max_trials", "-1 for the default, or a positive number")),
    }
}

/// `uniqueness_threshold`.
fn threshold(node: &Node) -> Result<Option<f64>, SceneError> {
    match node.float("uniqueness_threshold")? {
        Some(x) if x > 0.0 && x.is_finite() => Ok(Some(x)),
        None => Ok(None),
        Some(_) => Err(node.invalid("uniqueness_threshold", "a positive number")),
    }
}

/// How glints are found: as published, with the options of the file.
pub(super) fn glints(node: &Node) -> Result<Glints, SceneError> {
    let trials = trials(node)?;
    let method = if node.boolean_or("biased", false)? {
        GlintMethod::Biased(set(node, trials, Glints::TRIALS)?)
    } else {
        GlintMethod::Unbiased
    };
    let techniques = match (
        node.boolean_or("bsdf_strategy_only", false)?,
        node.boolean_or("sms_strategy_only", false)?,
    ) {
        (false, false) => GlintTechniques::Both,
        (true, false) => GlintTechniques::Scattering,
        (false, true) => GlintTechniques::Walks,
        (true, true) => {
            return Err(node.invalid("sms_strategy_only", "false: `bsdf_strategy_only` is true"));
        }
    };
    let threshold = threshold(node)?;
    let published = Glints::published(method);
    let steps = iterations(node, published.steps)?;
    if node.float_or("step_scale", 1.0)? != 1.0 {
        node.warn(STEPS);
    }
    if node.float_or("glint_diff_scale_factor_clamp", 1.0)? != 1.0 {
        node.warn("`glint_diff_scale_factor_clamp`: footprints are those of the pixel's filter");
    }
    if node.float("solver_threshold")?.is_some() {
        node.warn(ENDS);
    }
    node.ignore(&["glints_vectorized"], Node::boolean)?;
    Ok(Glints {
        techniques,
        threshold,
        steps,
        budget: match method {
            GlintMethod::Unbiased => trials.unwrap_or(published.budget),
            GlintMethod::Biased(_) => published.budget,
        },
        ..published
    })
}
