//! Every attribute of every scene of the corpus with every value that is hard, one at a time: a scene that can be rendered and
//! differentiated, or an error that names a line, never a panic.

use std::fs;
use std::ops::Range;
use std::panic::catch_unwind;
use std::path::Path;

use fuzz::{check_message, corpus};
use render::instances::{Estimator, render_f32};
use render::integrator::gradient::Active;
use render::params::{ParamInfo, Theta};
use render::scene::LoadOptions;
use render::{Job, Scene, Settings};

/// Values of any attribute.
const VALUES: [&str; 14] = [
    "",
    "0",
    "-1",
    "1",
    "1e-30",
    "1e30",
    "nan",
    "inf",
    "2",
    "0.5, 0.5, 0.5",
    "0, 0, 0",
    "true",
    "../a",
    "400:1, 700:2",
];

/// Attributes that have any.
const NAMES: [&str; 10] = [
    "value",
    "x",
    "y",
    "z",
    "angle",
    "origin",
    "filename",
    "temperature",
    "version",
    "name",
];

/// Films of more pixels are loaded, and not rendered.
const MOST_PIXELS: usize = 256;

/// Where the texts of all attributes called so are.
fn places(text: &str, name: &str) -> Vec<Range<usize>> {
    let key = format!(" {name}=\"");
    let start = |(at, _): (usize, &str)| at + key.len();
    (text.match_indices(&key).map(start))
        .map(|at| at..at + text[at..].find('"').expect("an end"))
        .collect()
}

/// What is wrong if something is not so.
fn ensure(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}

/// Loads, renders and differentiates: whether it was taken.
fn exercise(text: &str, folder: &Path) -> Result<bool, String> {
    let (scene, _) = match Scene::from_xml(text, folder, &LoadOptions::default()) {
        Ok(loaded) => loaded,
        Err(error) => {
            check_message(&error);
            let message = error.to_string();
            // A line of the scene file, something in another file, or a parameter by name.
            let number = |s: &str| !s.is_empty() && s.bytes().all(|c| c.is_ascii_digit());
            let placed = message.split(':').skip(1).any(number) || message.contains("/a.");
            let placed = placed || message.starts_with("parameter `");
            ensure(placed, || format!("no line in {message}"))?;
            return Ok(false);
        }
    };
    let finite = |values: &[f32]| values.iter().all(|x| x.is_finite());
    ensure(finite(scene.params().values()), || "parameters".into())?;
    if scene.film.pixels() > MOST_PIXELS {
        return Ok(true);
    }
    let settings = Settings {
        max_depth: scene.settings.max_depth.min(5),
        connections: None,
        glints: None,
        ..scene.settings
    };
    let theta = Theta::constant(scene.params().values());
    let job = Job::new(&scene, &settings, 1, 0..2, &());
    let image = render_f32(&job, &theta, Estimator::Mis);
    ensure(finite(&image.image(0).data), || "the image".into())?;
    ensure(image.non_finite.count == 0, || {
        format!("{} samples of the image", image.non_finite.count)
    })?;
    let seen = |i: &&ParamInfo| Estimator::Mis.active(&scene, &[&i.name]).is_ok();
    let names: Vec<_> = (scene.params().infos().iter().filter(seen))
        .map(|i| i.name.clone())
        .collect();
    let active = Active::new(&scene, &names).map_err(|e| e.to_string())?;
    let adjoint = vec![1.0; scene.film.pixels() * 3];
    if let Ok(g) = Estimator::Mis.backward_f32(&job, &theta, &active, &adjoint) {
        let numbers = g.values.iter().flatten().all(|x| x.is_finite());
        ensure(numbers, || "the gradient".into())?;
        ensure(g.non_finite.count == 0, || {
            format!("{} samples of the gradient", g.non_finite.count)
        })?;
    }
    Ok(true)
}

#[test]
#[cfg_attr(debug_assertions, ignore = "thousands of scenes: runs with --release")]
fn every_value_is_taken_or_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in corpus::files() {
        fs::write(folder.path().join(name), bytes).expect("a file");
    }
    let mut taken = [0, 0];
    let mut wrong = Vec::new();
    for scene in [corpus::SCENE, corpus::OTHERS, corpus::LATEST] {
        assert_eq!(exercise(scene, folder.path()), Ok(true));
        let mut swap = |place: &Range<usize>, by: &str| {
            let mut text = scene.to_owned();
            text.replace_range(place.clone(), by);
            let found = catch_unwind(|| exercise(&text, folder.path()));
            let why = match found {
                Ok(Ok(was)) => {
                    taken[usize::from(was)] += 1;
                    return;
                }
                Ok(Err(why)) => why,
                Err(_) => "a panic".into(),
            };
            let line = scene[..place.start].matches('\n').count() + 1;
            let old = &scene[place.clone()];
            wrong.push(format!("line {line}: `{old}` by `{by}`: {why}"));
        };
        for name in NAMES {
            for place in places(scene, name) {
                VALUES.iter().for_each(|by| swap(&place, by));
            }
        }
        // Plugins in the place of others.
        let types = places(scene, "type");
        let mut all: Vec<_> = types.iter().map(|t| &scene[t.clone()]).collect();
        all.sort_unstable();
        all.dedup();
        for place in &types {
            all.iter().for_each(|by| swap(place, by));
        }
    }
    println!("{} taken, {} refused", taken[1], taken[0]);
    assert!(wrong.is_empty(), "{}:\n{}", wrong.len(), wrong.join("\n"));
    assert!(taken[0] > 5000 && taken[1] > 500, "{taken:?}");
}
