//! Figure 1: four boxes, path-traced and interpolated between the corners of elements.

use render::finite_element::FiniteElements;

use super::boxes::{self, EYE, Which, average, mask, noiseless_difference, refine, traced};
use examples::chart::Panel;
use examples::figure::{Figure, Result};
use examples::say;

const SEED: u64 = 1;

/// Largest radiance of each lamp towards the camera as a fraction of its peak.
fn towards_the_eye(model: &FiniteElements, eye: [f64; 3]) -> Vec<f64> {
    let lamps = model
        .mesh()
        .roots
        .iter()
        .filter(|r| matches!(r.kind, render::finite_element::element::Kind::Lamp(_)));
    lamps
        .map(|r| {
            let to = (ad_core::Vec3::from(eye) - r.point(0.5, 0.5)).normalize();
            let cos = r.normal.dot(to).max(0.0);
            if cos > 0.0 { cos.powf(r.exponent) } else { 0.0 }
        })
        .collect()
}

/// `christensen-01`.
///
/// # Errors
/// None that the boxes can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let size = fig.pick(64, 128);
    let spp = 256;
    fig.note("spp", spp);
    fig.note("seed", SEED);
    let mut panels = Vec::new();
    let mut rows = Vec::new();
    for which in Which::ALL {
        let letter = which.letter();
        let scene = boxes::scene(which, size, 0)?;
        let steps = fig.pick(if which == Which::D { 7 } else { 10 }, 12);
        let (model, found) = refine(&scene, boxes::options(true), 0.02, |s| s.len() >= steps)?;
        let Some(end) = found.last() else { continue };
        let [r, s] = &traced(&scene, SEED, spp);
        let off = noiseless_difference(&end.interpolated, [r, s], &mask(&model));
        let statement = format!("({letter}) interpolated elements and path tracer differ by");
        let text = format!(
            "{off} RMS over pixels, noise of the path tracer taken out; {} elements, {} radiance and {} importance links, {:.1} MB, {:.1} s",
            end.size.elements,
            end.size.radiance_links,
            end.size.importance_links,
            end.size.bytes as f64 * 1e-6,
            end.seconds
        );
        match which {
            Which::A | Which::B => {
                let limit = fig.pick(0.08, 0.05);
                fig.check(format!("{statement} less than 5 %"), off.most < limit, text);
            }
            _ => {
                say!("  {statement} {text}");
                fig.note(&format!("rms {letter}"), off.rms);
            }
        }
        let seen = towards_the_eye(&model, [0.0, 0.0, EYE]);
        let bright = seen.iter().filter(|s| **s > 0.1).count();
        match which {
            Which::C => fig.check(
                "(c) all lamps look dark to the camera",
                bright == 0 && seen.iter().all(|s| *s < 1e-3),
                format!("radiance towards the eye over peak {seen:.4?}"),
            ),
            Which::D => fig.check(
                "(d) all lamps but one look dark to the camera",
                bright == 1 && seen.iter().filter(|s| **s > 1e-3).count() == 1,
                format!("radiance towards the eye over peak {seen:.4?}"),
            ),
            _ => {}
        }
        rows.push([
            letter.to_string(),
            off.rms.to_string(),
            off.most.to_string(),
            end.size.elements.to_string(),
            end.size.links().to_string(),
            end.size.bytes.to_string(),
            end.seconds.to_string(),
        ]);
        let exposure = if which == Which::D { 6.0 } else { 1.0 };
        let enlarge = 256usize.div_ceil(size as usize);
        for (label, image) in [
            ("path tracer", &average(&[r.clone(), s.clone()])),
            ("finite elements", &end.interpolated),
        ] {
            let label = format!("({letter}) {label}");
            panels.push(Panel::tonemapped(&label, image, exposure).enlarged(enlarge));
        }
    }
    fig.csv_text(
        "boxes",
        &[
            "box", "rms", "most", "elements", "links", "bytes", "seconds",
        ],
        rows,
    );
    fig.images("boxes", 2, &panels);
    Ok(())
}
