//! The scenes of [Zeltner et al. 2020], where `RENDER_SHARED` names a folder that has them in `scenes/sms`: figures measure there
//! what they measure on scenes of their own. Without that variable there is nothing of this.

use std::path::{Path, PathBuf};

use render::Scene;
use render::scene::{Connections, LoadOptions, Method, Starts};
use render::statistics::z_limit;

use super::manifold_methods::{Effort, Measured, by_particles, measure_in};
use examples::figure::{Figure, Result};
use examples::say;

/// Samples of paths for each one of connections: they are quick, and seldom meet a light.
const PATHS: u64 = 64;

/// The folder of the scenes.
pub struct Authors(PathBuf);

/// One of the scenes.
pub struct Published {
    /// What it is called in checks and in files.
    pub name: &'static str,
    /// As read.
    pub scene: Scene,
    /// What stands in for files that are missing.
    pub note: String,
}

impl Authors {
    /// Where the variable says that they are; `None` without it, and, with a message, without them.
    pub fn find() -> Option<Self> {
        let folder = Path::new(&std::env::var_os("RENDER_SHARED")?).join("scenes/sms");
        if folder.is_dir() {
            return Some(Self(folder));
        }
        say!(
            "  skipped: no scenes of the authors at {}",
            folder.display()
        );
        None
    }

    /// A file among them, as it stands in the text of another.
    pub fn path(&self, file: &str) -> String {
        attribute(&self.0.join(file))
    }

    /// The text of a file among them.
    ///
    /// # Errors
    /// Those of reading, with the name of the file.
    pub fn read(&self, file: &str) -> Result<String> {
        let path = self.0.join(file);
        Ok(std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?)
    }

    /// The scene of a file, in pictures of so many columns. Each first part of `changes` stands in the file, and is there the second
    /// one. Textures that are missing are grey.
    ///
    /// # Errors
    /// Those of reading.
    pub fn scene(
        &self,
        fig: &mut Figure,
        name: &'static str,
        file: &str,
        columns: u32,
        changes: &[(&str, &str)],
    ) -> Result<Published> {
        let path = self.0.join(file);
        let mut text = self.read(file)?;
        for (from, to) in changes {
            if !text.contains(from) {
                return Err(format!("{}: expected `{from}`, found none", path.display()).into());
            }
            text = text.replace(from, to);
        }
        let text = resized(&text, columns).ok_or_else(|| {
            let file = path.display();
            format!("{file}: expected width and height of a film, found none")
        })?;
        let options = LoadOptions {
            allow_missing: true,
            ..LoadOptions::default()
        };
        let folder = path.parent().unwrap_or(&self.0);
        let (scene, warnings) = Scene::from_xml(&text, folder, &options)?;
        let missing = warnings.iter().filter(|w| w.ends_with(" instead"));
        let names = missing.filter_map(|w| {
            let file = w.split('`').find(|part| part.starts_with("textures/"))?;
            Some(file.rsplit('/').next().unwrap_or(file))
        });
        let names: Vec<&str> = names.collect();
        let note = if names.is_empty() {
            String::new()
        } else {
            format!("no {}: constant", names.join(", "))
        };
        fig.note(&format!("{name}: file"), file);
        fig.note(&format!("{name}: missing"), names.join(", "));
        Ok(Published { name, scene, note })
    }
}

/// A path as an attribute of a scene file.
pub fn attribute(path: &Path) -> String {
    let text = path.display().to_string();
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}

/// A scene file with a film of so many columns, of the same shape.
fn resized(text: &str, columns: u32) -> Option<String> {
    let place = |key: &str| {
        let before = format!("name=\"{key}\" value=\"");
        let start = text.find(&before)? + before.len();
        Some(start..start + text[start..].find('"')?)
    };
    let (w, h) = (place("width")?, place("height")?);
    let number = |at: &std::ops::Range<usize>| text[at.clone()].parse::<f64>().ok();
    let rows = (f64::from(columns) * number(&h)? / number(&w)?).round() as u32;
    let (columns, rows) = (columns.to_string(), rows.max(1).to_string());
    let between = text.get(w.end..h.start)?;
    let all = [&text[..w.start], &columns, between, &rows, &text[h.end..]].concat();
    // Those that crop ask for all of it.
    Some(
        all.replace("\"$crop_width\"", &format!("\"{columns}\""))
            .replace("\"$crop_height\"", &format!("\"{rows}\"")),
    )
}

/// What was found in a scene.
pub struct Found {
    /// By particles that land.
    pub particles: Measured,
    /// By paths.
    pub paths: Measured,
    /// By each way that was asked for.
    pub ways: Vec<Measured>,
}

impl Found {
    /// What part of the light is found by way `k`, against particles, and its error.
    pub fn share(&self, k: usize) -> [f64; 2] {
        let [a, b] = [&self.ways[k], &self.particles].map(|m| m.series.whole);
        let ratio = a.mean / b.mean;
        [ratio, ratio * (a.se / a.mean).hypot(b.se / b.mean)]
    }

    /// How much smaller the error of way `k` is than that of paths in the same time, squared.
    pub fn gain(&self, k: usize) -> f64 {
        let seconds = self.ways[k].seconds;
        self.paths.variance_after(seconds) / self.ways[k].variance()
    }
}

/// The light of chains in a scene of the authors by these ways, by paths and by so many particles in each run: pictures, a table, and
/// checks that unbiased estimates bring the light of particles, to within 2 % or what chance allows, which is less than `most`. Those
/// that start anywhere are not checked: what they find seldom counts for so much that means of few samples are far from normal.
///
/// # Errors
/// Those of rendering.
pub fn compare(
    fig: &mut Figure,
    of: &Published,
    ways: &[(&str, Connections)],
    effort: Effort,
    (particles, most): (u64, f64),
) -> Result<Found> {
    let Published { name, scene, note } = of;
    let [width, height] = scene.film.crop_size;
    let block = (width.min(height) / 2).max(1) as usize;
    let after = |label: &str, m: &Measured| say!("        {name}: {label}, {:.1} s", m.seconds);
    fig.note(&format!("{name}: size"), vec![width, height]);
    fig.note(&format!("{name}: spp"), effort.spp);
    fig.note(&format!("{name}: runs"), effort.runs);
    fig.note(&format!("{name}: particles"), particles);
    let mut found = Vec::new();
    for (k, (label, connections)) in (0..).zip(ways) {
        let m = measure_in(block, scene, *connections, false, effort.other(k))?;
        after(label, &m);
        found.push(m);
    }
    let connections = ways.first().ok_or("no ways")?.1;
    let many = Effort {
        spp: PATHS * effort.spp,
        ..effort.other(80)
    };
    let paths = measure_in(block, scene, connections, true, many)?;
    after("paths", &paths);
    let landed = by_particles(block, scene, connections, effort.other(90), particles)?;
    after("particles", &landed);
    let found = Found {
        particles: landed,
        paths,
        ways: found,
    };
    let reference = &found.particles;
    for (k, (label, connections)) in ways.iter().enumerate() {
        if connections.method != Method::Sms || connections.starts == Starts::Uniform {
            continue;
        }
        let m = &found.ways[k];
        let blocks = m.series.blocks.iter().zip(&reference.series.blocks);
        let worst = blocks.map(|(a, b)| a.z(b).abs()).fold(0.0, f64::max);
        let bound = z_limit(m.series.blocks.len() + 1, effort.runs, 1e-3);
        let [ratio, error] = found.share(k);
        fig.check(
            format!("{name}: {label}: unbiased estimates bring the light of particles, all in all and block by block"),
            (ratio - 1.0).abs() < (bound * error).max(0.02)
                && worst < bound
                && error < most
                && m.found.exhausted == 0,
            format!(
                "{ratio:.4} ± {error:.4} of it; largest |z| of {} blocks {worst:.2}, limit {bound:.2}",
                m.series.blocks.len()
            ),
        );
    }
    let factor = (256 / width as usize).max(1);
    let label = |label: &str| match note.as_str() {
        "" => label.to_owned(),
        note => format!("{label} ({note})"),
    };
    let mut panels = vec![
        reference.panel(&label("particles"), reference, factor),
        found.paths.panel("paths", reference, factor),
    ];
    let each = ways.iter().zip(&found.ways);
    panels.extend(each.map(|((label, _), m)| m.panel(label, reference, factor)));
    let words = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '.');
    let file = words
        .filter(|w| !w.is_empty())
        .collect::<Vec<_>>()
        .join("-");
    fig.images(&file, 3, &panels);
    let labels = ["particles", "paths"].into_iter();
    let labels = labels.chain(ways.iter().map(|w| w.0));
    let all = [reference, &found.paths].into_iter().chain(&found.ways);
    let rows = labels.zip(all).map(|(label, m)| {
        let numbers = [
            m.series.whole.mean,
            m.series.whole.se,
            m.variance(),
            m.success(),
            m.lit(),
            m.trials(),
            m.seconds,
        ];
        let [a, b, c, d, e, f, g] = numbers.map(|x| x.to_string());
        [label.to_owned(), a, b, c, d, e, f, g]
    });
    let columns = [
        "method",
        "mean",
        "error",
        "variance",
        "success_rate",
        "with_light",
        "trials",
        "seconds",
    ];
    fig.csv_text(&file, &columns, rows.collect::<Vec<_>>());
    Ok(found)
}

/// [`compare`] of one walk towards the light, of unbiased estimates with starts anywhere and with those of particles, and of trial
/// sets of growing size, with checks of what the biased ones miss. One walk comes first, then the unbiased ones, then the sets.
///
/// # Errors
/// Those of rendering.
pub fn compare_methods(
    fig: &mut Figure,
    of: &Published,
    bounces: u32,
    effort: Effort,
    accuracy: (u64, f64),
) -> Result<Found> {
    let way = |method: Method, starts: Starts| Connections {
        bounces,
        starts,
        ..Connections::new(method)
    };
    let sizes: &[u32] = fig.pick(&[2, 8], &[4, 16, 64]);
    let labels: Vec<String> = sizes.iter().map(|n| format!("{n} walks")).collect();
    let mut ways = vec![
        ("one walk", way(Method::Mnee, Starts::Uniform)),
        ("unbiased", way(Method::Sms, Starts::Uniform)),
        ("from particles", way(Method::Sms, Starts::Particles)),
    ];
    let sets = sizes.iter().zip(&labels);
    ways.extend(sets.map(|(n, l)| (l.as_str(), way(Method::SmsBiased(*n), Starts::Uniform))));
    let found = compare(fig, of, &ways, effort, accuracy)?;
    let name = of.name;
    let shares: Vec<f64> = (3..ways.len()).map(|k| found.share(k)[0]).collect();
    let last = found.share(ways.len() - 1);
    let one = found.share(0);
    let limit = z_limit(2, effort.runs, 1e-2);
    fig.check(
        format!("{name}: trial sets lose light, smaller ones more, and one walk brings no more than there is"),
        shares.windows(2).all(|w| w[0] < w[1])
            && shares[0] < 0.95
            && last[0] < 1.0 + limit * last[1]
            && one[0] < 1.0 + limit * one[1],
        format!("{shares:.3?} of it, one walk {:.3} ± {:.3}", one[0], one[1]),
    );
    fig.check(
        format!("{name}: walks take fewer trials where particles passed"),
        found.ways[2].trials() < found.ways[1].trials(),
        format!(
            "{:.1} per solution, {:.1} from anywhere; {:.1} % and {:.1} % of walks converge",
            found.ways[2].trials(),
            found.ways[1].trials(),
            100.0 * found.ways[2].success(),
            100.0 * found.ways[1].success()
        ),
    );
    if fig.pick(false, true) {
        let gains = [1, 2].map(|k| found.gain(k));
        fig.check(
            format!("{name}: in the same time unbiased estimates have less noise than paths"),
            gains[1] > 1.0,
            format!("variance times time is {:.1} and {:.1} times smaller, from anywhere and where particles passed", gains[0], gains[1]),
        );
    }
    Ok(found)
}
