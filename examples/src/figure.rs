//! The frame around a reproduced figure: arguments, checks of its outcome, and the files it leaves.
//!
//! ```no_run
//! use examples::figure::{Figure, Result};
//!
//! fn figure(fig: &mut Figure) -> Result {
//!     let spp = fig.pick(16, 256); // quick, full
//!     fig.note("spp", spp);
//!     let found = 0.5;
//!     fig.check("(a) half the light arrives", (found - 0.5f64).abs() < 1e-3, format!("{found:.4}"));
//!     fig.csv("values", &["x", "y"], [[0.0, 1.0], [1.0, 2.0]]);
//!     Ok(())
//! }
//!
//! fn main() -> std::process::ExitCode {
//!     Figure::run("stam-06", "gradients against finite differences", figure)
//! }
//! ```

use std::error::Error;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use render::image_io;
use serde_json::{Map, Value, json};

use crate::chart::{LineChart, Panel, grid};
use crate::{cli, complain, output, print, say};

/// What the code of a figure returns: an error is a failure to run, not a failed outcome.
pub type Result<T = ()> = std::result::Result<T, Box<dyn Error>>;

/// Command line of all figure binaries.
#[derive(Debug, Parser)]
#[command(
    version,
    after_help = "Exit status: 0 if every outcome holds, 1 if one does not, 2 on errors."
)]
struct Arguments {
    /// Small images and few samples: every check in seconds, with wider error bars
    #[arg(long)]
    quick: bool,
    /// Folder for images, tables and manifest.json [default: out/ID]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Number of threads; the result does not depend on it [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=cli::MOST_THREADS))]
    threads: Option<u16>,
}

/// An outcome that was looked at.
#[derive(Debug)]
struct Check {
    statement: String,
    passed: bool,
    found: String,
}

/// A figure being made.
#[derive(Debug)]
pub struct Figure {
    id: String,
    quick: bool,
    out: PathBuf,
    started: Instant,
    checks: Vec<Check>,
    notes: Map<String, Value>,
    files: Vec<String>,
    errors: Vec<String>,
}

impl Figure {
    /// Reads the command line. `--help`, `--version` and mistakes end the process here, as usual.
    pub fn start(id: &'static str, about: &'static str) -> Self {
        use clap::{CommandFactory, FromArgMatches};
        let command = Arguments::command().name(id).about(about);
        let matches = command.try_get_matches();
        let arguments = matches.and_then(|m| Arguments::from_arg_matches(&m));
        let arguments = arguments.unwrap_or_else(|e| std::process::exit(cli::usage(&e).into()));
        let out = arguments.out.unwrap_or_else(|| Path::new("out").join(id));
        let mut figure = Self::in_folder(id, arguments.quick, out);
        if let Err(e) = cli::check_threads() {
            complain!("error: {e}");
            std::process::exit(2);
        }
        if let Some(n) = arguments.threads {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n.into());
            if let Err(e) = pool.build_global() {
                figure.errors.push(format!("--threads {n}: {e}"));
            }
        }
        say!("{id}: {about}");
        figure
    }

    /// A figure that was not started from a command line.
    pub fn in_folder(id: &str, quick: bool, out: impl Into<PathBuf>) -> Self {
        Self {
            id: id.into(),
            quick,
            out: out.into(),
            started: Instant::now(),
            checks: Vec::new(),
            notes: Map::new(),
            files: Vec::new(),
            errors: Vec::new(),
        }
    }

    /// A whole figure binary.
    pub fn run(
        id: &'static str,
        about: &'static str,
        make: impl FnOnce(&mut Self) -> Result,
    ) -> ExitCode {
        let mut figure = Self::start(id, about);
        if let Err(e) = make(&mut figure) {
            figure.errors.push(e.to_string());
        }
        figure.finish()
    }

    /// Whether `--quick` was given.
    pub fn quick(&self) -> bool {
        self.quick
    }

    /// One of two settings.
    pub fn pick<T>(&self, quick: T, full: T) -> T {
        if self.quick { quick } else { full }
    }

    /// Records whether an outcome holds, with the numbers it was judged by, and prints it.
    pub fn check(&mut self, statement: impl Into<String>, passed: bool, found: impl Display) {
        let check = Check {
            statement: statement.into(),
            passed,
            found: found.to_string(),
        };
        let word = if passed { "pass" } else { "FAIL" };
        say!("  {word}  {}\n        {}", check.statement, check.found);
        self.checks.push(check);
    }

    /// Records a setting or a result (seed, samples, ..) in the manifest.
    pub fn note(&mut self, name: &str, value: impl Into<Value>) {
        self.notes.insert(name.into(), value.into());
    }

    /// Path of the output file `name`.
    pub fn path(&self, name: &str) -> PathBuf {
        self.out.join(name)
    }

    /// Writes the output file `name`. A failure is reported at the end and fails the figure.
    pub fn write(&mut self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        let written = output::create_parent(&path)
            .and_then(|()| Ok(image_io::write_atomically(&path, bytes)?));
        match written {
            Ok(()) => self.files.push(name.into()),
            Err(e) => self.errors.push(e.to_string()),
        }
    }

    /// Writes `{name}.csv`, numbers in full precision.
    pub fn csv<const N: usize>(
        &mut self,
        name: &str,
        header: &[&str; N],
        rows: impl IntoIterator<Item = [f64; N]>,
    ) {
        let rows = rows.into_iter().map(|row| row.map(|x| x.to_string()));
        self.csv_text(name, header, rows);
    }

    /// Writes `{name}.csv` of fields that are not all numbers; they are quoted where necessary.
    pub fn csv_text<const N: usize>(
        &mut self,
        name: &str,
        header: &[&str; N],
        rows: impl IntoIterator<Item = [String; N]>,
    ) {
        let quote = |field: &str| {
            if field.contains([',', '"', '\n']) {
                format!("\"{}\"", field.replace('"', "\"\""))
            } else {
                field.to_owned()
            }
        };
        let mut text = header.map(quote).join(",") + "\n";
        for row in rows {
            text += &(row.map(|f| quote(&f)).join(",") + "\n");
        }
        self.write(&format!("{name}.csv"), text.as_bytes());
    }

    /// Writes `{name}.png` and `{name}.svg`.
    pub fn chart(&mut self, name: &str, chart: &LineChart) {
        match chart.png().and_then(|png| Ok((png, chart.svg()?))) {
            Ok((png, svg)) => {
                self.write(&format!("{name}.png"), &png);
                self.write(&format!("{name}.svg"), svg.as_bytes());
            }
            Err(e) => self.errors.push(format!("chart {name}: {e}")),
        }
    }

    /// Writes one picture, `{name}.png`.
    pub fn image(&mut self, name: &str, panel: &Panel) {
        self.images(name, 1, std::slice::from_ref(panel));
    }

    /// Writes labelled pictures side by side, `columns` in a row, to `{name}.png`.
    pub fn images(&mut self, name: &str, columns: usize, panels: &[Panel]) {
        match grid(columns, panels) {
            Ok(png) => self.write(&format!("{name}.png"), &png),
            Err(e) => self.errors.push(format!("image {name}: {e}")),
        }
    }

    /// Writes `manifest.json`, prints a summary, and says how it went.
    pub fn finish(mut self) -> ExitCode {
        let seconds = self.started.elapsed().as_secs_f64();
        let failed = self.checks.iter().filter(|c| !c.passed).count();
        let manifest = json!({
            "figure": self.id,
            "version": env!("CARGO_PKG_VERSION"),
            "quick": self.quick,
            "seconds": seconds,
            "settings": self.notes,
            "checks": self.checks.iter().map(|c| json!({
                "statement": c.statement, "passed": c.passed, "found": c.found,
            })).collect::<Vec<_>>(),
            "files": self.files,
            "errors": self.errors,
        });
        self.write("manifest.json", format!("{manifest:#}\n").as_bytes());
        for e in &self.errors {
            complain!("error: {e}");
        }
        say!(
            "{}: {} of {} outcomes hold, {seconds:.1} s, files in {}",
            self.id,
            self.checks.len() - failed,
            self.checks.len(),
            self.out.display()
        );
        if let Err(e) = print::finish() {
            complain!("error: standard output: {e}");
            return ExitCode::from(2);
        }
        match (self.errors.is_empty(), failed) {
            (false, _) => ExitCode::from(2),
            (true, 0) => ExitCode::SUCCESS,
            (true, _) => ExitCode::from(1),
        }
    }
}
