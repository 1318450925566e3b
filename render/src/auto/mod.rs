//! An estimator that chooses: pilots measure, and samples and pixels go to whichever estimator tells
//! most there.
//!
//! A [`Mixture`] is a weighted sum of the [`Estimator`]s that are compiled. Pixel weights of all passes add up to
//! one and come from other random numbers than the passes, so a mixture of unbiased estimators is unbiased.
//! Weights and shares minimise the *measured variance of the derivative* for equal work: multiple
//! importance sampling for integrands with a sign, where the densities of the primal samples (balance and
//! power heuristic) say little about the spread of derivatives.
//!
//! Work is counted in samples of [`Estimator::Mis`] ([`costs()`]), not by a clock: the same seed
//! gives the same mixture. Pilots run in forward mode; what they find is for passes in the mode that is asked for,
//! in which other estimators may be cheap.
//!
//! ```
//! use render::Job;
//! use render::auto;
//! use render::instances::Mode;
//! use render::params::Theta;
//!
//! let room = render::scene::room(8, 8)?;
//! let names = ["sphere.alpha.value"];
//! let adjoint = vec![1.0 / 192.0; 192]; // of the mean of all pixels and channels
//! let candidates = auto::candidates(&room);
//! let job = Job::new(&room, &room.settings, 0, 0..16, &());
//! let mixture = auto::choose(&job, &names, &adjoint, &candidates, Mode::Reverse)?;
//! println!("{mixture}"); // what was chosen, and why
//! let theta = Theta::constant(room.params().values());
//! let gradient = mixture.backward_f32(&job, &theta, &names, &adjoint)?;
//! assert!(gradient.values[0].len() == 1 && gradient.values[0][0].is_finite());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod costs;
mod guide;
mod lights;
mod mixture;
mod pilot;
mod pixels;
mod shares;

use std::fmt;

use crate::bsdf::{Bsdf, TextureRef};
use crate::emitter::{AnyEmitter, Emitter};
use crate::error::RenderError;
use crate::instances::{Estimator, Mode};
use crate::integrator::Job;
use crate::sampler::Family;
use crate::scene::Scene;
use crate::texture::ScalarTexture;

pub use costs::costs;
pub use guide::guide;
pub use lights::sampling_weights;
pub use mixture::Mixture;
pub use pilot::{Finding, PILOTS, able};
pub use pixels::{pixel_weights, pixel_weights_of};

/// What may be chosen in a scene: everything that is unbiased there and that no few pilots could mistake.
///
/// A technique that rarely finds what matters looks good until it finds it, and no measurement as short
/// as a pilot rules that out. So light sampling alone is a candidate only without smooth lobes, and BSDF
/// sampling alone only below wide lights at infinity. Combinations of both find everything. The first one is
/// kept where pilots cannot tell: the balance heuristic (with the differential pair where that costs hardly more, as for
/// one of many things in forward mode); the power heuristic between rough things, where light samples
/// find what there is and should keep their weight; or the differential pair where smooth things mirror what is lit,
/// since few samples carry the variance of detached sampling there.
///
/// ```
/// use render::auto::{able, candidates};
/// use render::instances::Estimator;
///
/// let mut room = render::scene::room(8, 8)?;
/// let all = candidates(&room);
/// assert!(all.iter().all(|e| e.check(&room).is_ok()));
/// assert!(all.contains(&Estimator::Emitter)); // all roughness is at least 0.1
/// room.set([("sphere.alpha.value", &[0.02][..])])?;
/// assert!(!candidates(&room).contains(&Estimator::Emitter));
///
/// // What moves is seen by one of them, which is a candidate as soon as something may.
/// room.make_movable(&["sphere.translation"])?;
/// let moves = room.params().find("sphere.translation")?;
/// assert_eq!(able(&room, moves, &candidates(&room))?, [Estimator::Edges]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn candidates(scene: &Scene) -> Vec<Estimator> {
    /// Smoothest roughness, and sharpest exponent, for which lights need no help.
    const ROUGH: (f32, f32) = (0.1, 200.0);
    let all = |t: &ScalarTexture, f: fn(f32) -> bool| {
        let params = scene.params();
        !t.any_param(|p| {
            let values = &params.values()[params.infos()[p.id as usize].range()];
            !values.iter().all(|&v| f(v))
        })
    };
    let (mut rough, mut smooth_normals) = (true, false);
    for material in scene.materials() {
        material.visit_textures(&mut |t| {
            rough &= match t {
                TextureRef::Alpha(t) => {
                    let rough = all(t, |v| v >= ROUGH.0);
                    smooth_normals |= !rough;
                    rough
                }
                TextureRef::Exponent(t) => all(t, |v| v <= ROUGH.1),
                _ => true,
            }
        });
    }
    let deep = scene.settings.max_depth > 2;
    let mut out = match (deep && smooth_normals, deep && rough) {
        (true, _) => vec![
            Estimator::DifferentialMis,
            Estimator::MisBalance,
            Estimator::Mis,
        ],
        (false, true) => vec![
            Estimator::Mis,
            Estimator::DifferentialMisBalance,
            Estimator::MisBalance,
        ],
        (false, false) => vec![
            Estimator::MisBalance,
            Estimator::DifferentialMisBalance,
            Estimator::Mis,
        ],
    };
    out.extend([Estimator::MisAttachedWeights, Estimator::AttachedMis]);
    if rough {
        out.push(Estimator::Emitter);
    }
    if scene.emitters().iter().all(AnyEmitter::is_wide) {
        out.extend([
            Estimator::Detached,
            Estimator::Differential,
            Estimator::Attached,
            Estimator::AttachedPath,
        ]);
        // Outlines may be missed, a horizon is not.
        if scene.outline(false).is_none() && scene.horizon().is_some() {
            out.push(Estimator::Reparameterised);
        }
    }
    // No other estimator sees what moves, and edges are not seen over mirrors and glass.
    if scene.params().infos().iter().any(|i| i.kind.is_motion()) {
        out.push(if scene.scatters_deltas() {
            Estimator::ReparameterisedMis
        } else {
            Estimator::Edges
        });
    }
    out.retain(|e| e.check(scene).is_ok());
    out
}

/// Finds a mixture for the derivatives of `<adjoint, image>` in the named parameters, `adjoint` as for
/// [`crate::integrator::gradient::backward`].
///
/// The samples of the job are the work to come in `mode`, as samples per pixel of [`Estimator::Mis`]; pilots cost at most
/// [`PILOTS`] of it.
/// Every parameter is measured by itself if that leaves enough samples, otherwise all those of one
/// material or emitter together, or all of them. The first candidate that sees the parameters is taken where not
/// even that fits, and where few samples carry most of its variance: then nothing was measured. With a budget that does
/// not even suffice for [`costs()`], its samples count as those of `mis`.
///
/// ```
/// use render::Job;
/// use render::auto::{PILOTS, candidates, choose};
/// use render::instances::Mode;
///
/// let room = render::scene::room(8, 8)?;
/// let names = ["sphere.alpha.value", "left.reflectance.value"];
/// let adjoint = vec![1.0 / 192.0; 8 * 8 * 3]; // of the mean of all pixels and channels
/// let job = Job::new(&room, &room.settings, 1, 0..1024, &()); // the work to come
/// let mixture = choose(&job, &names, &adjoint, &candidates(&room), Mode::Reverse)?;
/// // Shares are parts of all work, and each parameter has some of it.
/// let shares: f64 = mixture.shares().iter().map(|(_, share)| share).sum();
/// assert!((shares - 1.0).abs() < 1e-9 && names.iter().all(|name| mixture.share(name) > 0.0));
/// assert!(mixture.spent() <= PILOTS * 1024.0); // samples of `mis` per pixel
/// // The same job gives the same mixture.
/// let again = choose(&job, &names, &adjoint, &candidates(&room), Mode::Reverse)?;
/// assert_eq!(mixture.shares(), again.shares());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// An unknown name, an adjoint of the wrong size, a parameter that no candidate sees.
pub fn choose<N: AsRef<str>>(
    job: &Job,
    names: &[N],
    adjoint: &[f32],
    candidates: &[Estimator],
    mode: Mode,
) -> Result<Mixture, RenderError> {
    crate::integrator::gradient::check_size("adjoint image", job.scene, adjoint)?;
    let pilots = Job {
        seed: Family::Pilots.seed(job.seed),
        ..job.clone()
    };
    let most = PILOTS * job.count() as f64;
    let pilots = pilot::Pilots::new(&pilots, names, adjoint, candidates, mode, most)?;
    let findings = pilots.run(job.progress)?;
    Ok(Mixture::of(job.scene, findings))
}

impl fmt::Display for Mixture {
    /// What was chosen for which parameters, and what the pilots saw.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for cluster in &self.clusters {
            let members: Vec<String> = cluster
                .members
                .iter()
                .map(|m| {
                    format!(
                        "{} ({:.0} % of the work)",
                        m.estimator.name(),
                        100.0 * m.share
                    )
                })
                .collect();
            writeln!(f, "{}: {}", cluster.params.join(", "), members.join(" + "))?;
        }
        for finding in &self.findings {
            let seen: Vec<String> = finding
                .efficiency
                .iter()
                .map(|(e, relative)| format!("{} {relative:.2}", e.name()))
                .collect();
            let what = finding.params.join(", ");
            if finding.pairs == 0 {
                writeln!(f, "  {what}: no pilots, the budget is too small")?;
            } else {
                writeln!(f, "  {what}: 1 / (variance x work): {}", seen.join(", "))?;
            }
        }
        writeln!(f, "  pilots: {:.1} samples per pixel", self.spent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Wherever a smooth lobe hides, lights alone are no candidate.
    #[test]
    fn light_sampling_needs_rough_lobes() {
        let metal = |alpha: f64| {
            format!(r#"<bsdf type="roughconductor"><float name="alpha" value="{alpha}"/></bsdf>"#)
        };
        let phong = |exponent: f64| {
            format!(r#"<bsdf type="blinnphong"><float name="exponent" value="{exponent}"/></bsdf>"#)
        };
        let within = |m: String| {
            let holes =
                format!(r#"<bsdf type="mask"><float name="opacity" value="0.9"/>{m}</bsdf>"#);
            format!(
                r#"<bsdf type="blendbsdf"><float name="weight" value="0.01"/>{m}{holes}</bsdf>"#
            )
        };
        for (material, expected) in [
            (metal(0.3), true),
            (metal(0.03), false),
            (phong(30.0), true),
            (phong(300.0), false),
            (within(metal(0.3)), true),
            (within(metal(0.03)), false),
        ] {
            let xml = format!(
                r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>
                <shape type="rectangle">{material}</shape>
                <emitter type="point"/></scene>"#
            );
            let (scene, _) = Scene::from_xml(&xml, "".as_ref(), &Default::default()).unwrap();
            let found = candidates(&scene).contains(&Estimator::Emitter);
            assert_eq!(found, expected, "{material}");
        }
    }

    /// What is kept where pilots cannot tell.
    #[test]
    fn the_first_follows_from_depth_and_roughness() {
        let first = |alpha: f64, depth: u32| {
            let xml = format!(
                r#"<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>
                <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
                <shape type="rectangle"><bsdf type="roughconductor"><float name="alpha" value="{alpha}"/></bsdf></shape>
                <emitter type="point"/></scene>"#
            );
            let (scene, _) = Scene::from_xml(&xml, "".as_ref(), &Default::default()).unwrap();
            candidates(&scene)[0]
        };
        assert_eq!(first(0.03, 3), Estimator::DifferentialMis);
        assert_eq!(first(0.03, 2), Estimator::MisBalance);
        assert_eq!(first(0.3, 3), Estimator::Mis);
    }
}
