//! What a recovery writes: pictures, charts, values.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use render::params::ParamShape;
use render::{Image, image_io};
use serde::Serialize;

use super::job::OptimizerArg;
use super::{Checkpoint, PANELS, PICTURE_SPP, Recovery, Row, SAVED, is_complete};
use crate::chart::LineChart;
use crate::cli::ToolError;
use crate::output;
use crate::progress::Interrupt;
use crate::solved::SolvedReport;
use crate::{complain, say};

impl Recovery {
    /// Everything but the checkpoint. Says how many samples per pixel the picture after has; without any it
    /// is left out, and a complete one is not replaced by less.
    pub(super) fn write_results(
        &mut self,
        out: &Path,
        state: &Checkpoint,
        before: &[Option<Image>],
        interrupt: &Interrupt,
    ) -> Result<u64, ToolError> {
        let estimate = state.estimate();
        self.problem.set(&estimate)?;
        let (mut panels, mut fewest) = (Vec::new(), PICTURE_SPP);
        for (view, before) in before.iter().enumerate() {
            self.look(view)?;
            let after = self.picture("after", state.job.seed, interrupt)?;
            fewest = fewest.min(after.as_ref().map_or(0, |r| r.samples));
            let file = out.join(self.views[view].file("after"));
            if let Some(after) = after.filter(|r| is_complete(r) || !file.exists()) {
                let after = self.write_picture(&file, &after)?;
                if let Some(before) = before {
                    let target = &self.problem.targets[view].image;
                    let row = [("before", before), ("after", &after), ("target", target)];
                    panels.extend(row.map(|(kind, image)| {
                        let label = self.views[view].name.as_ref();
                        let label = label.map_or(kind.to_owned(), |name| format!("{kind}, {name}"));
                        output::panel(&label, image)
                    }));
                }
            }
        }
        if panels.len() == 3 * before.len() {
            output::write_panels(&out.join(PANELS), 3, &panels)?;
        }
        image_io::write_atomically(&out.join("iterations.csv"), self.csv(state).as_bytes())?;
        for (name, chart) in self.charts(state) {
            output::write_chart(&out.join(name), &chart)?;
        }
        self.write_textures(out, &estimate)?;
        if state.job.scene.is_some()
            && let Err(e) = self.problem.scene.save(&out.join(SAVED))
        {
            complain!("warning: the scene is not written: {e}");
        }
        // The scene is that of the estimate by now, which is behind the last step.
        self.report_folds(super::UNFOLDED);
        self.report(out, state, &estimate)?;
        Ok(fewest)
    }

    fn csv(&self, state: &Checkpoint) -> String {
        let mut text = "iteration,loss".to_owned();
        for name in self.tracked_names() {
            text.push(',');
            text.push_str(&name.replace(',', "_"));
        }
        text.push('\n');
        for (i, row) in state.history.iter().enumerate() {
            // Writing to a string cannot fail.
            let _ = write!(text, "{i},{:e}", row.loss);
            for v in &row.values {
                let _ = write!(text, ",{v}");
            }
            text.push('\n');
        }
        text
    }

    /// Loss and errors where the truth is known; loss and values where it is not.
    fn charts(&self, state: &Checkpoint) -> Vec<(&'static str, LineChart)> {
        let rows = || state.history.iter().enumerate();
        let loss = |chart: LineChart| {
            let name = format!("loss ({})", state.job.loss);
            chart.line(&name, rows().map(|(i, r)| (i as f64, r.loss)))
        };
        let names = self.tracked_names();
        let Some(truth) = &self.truth else {
            let chart = LineChart::new("Convergence", "iteration", "loss").log_y();
            let mut values = LineChart::new("Recovered values", "iteration", "value");
            for (k, name) in names.iter().enumerate() {
                values = values.line(name, rows().map(|(i, r)| (i as f64, r.values[k])));
            }
            return vec![("convergence", loss(chart)), ("values", values)];
        };
        let truth = self.tracked(truth);
        let label = "loss; largest relative error of each parameter";
        let mut chart = loss(LineChart::new("Convergence", "iteration", label).log_y());
        let mut at = 0;
        for info in self.problem.active.ranges() {
            let n = if info.shape.len() <= 3 {
                info.shape.len()
            } else {
                1
            };
            let range = at..at + n;
            at += n;
            let error = |r: &Row| largest_error(&r.values[range.clone()], &truth[range.clone()]);
            chart = chart.line(&info.name, rows().map(|(i, r)| (i as f64, error(r))));
        }
        vec![("convergence", chart)]
    }

    fn write_textures(&self, out: &Path, estimate: &[f32]) -> Result<(), ToolError> {
        let mut at = 0;
        for info in self.problem.active.ranges() {
            let own = &estimate[at..at + info.shape.len()];
            at += own.len();
            if let ParamShape::Texture {
                height,
                width,
                channels,
            } = info.shape
            {
                let path = out.join(format!("{}.exr", output::file_name(&info.name)));
                let values: Vec<f64> = own.iter().map(|&v| f64::from(v)).collect();
                output::write_texture(&path, [height, width, channels], &values)?;
            }
        }
        Ok(())
    }

    /// Prints the recovered values and writes `result.json`.
    fn report(&self, out: &Path, state: &Checkpoint, estimate: &[f32]) -> Result<(), ToolError> {
        let names = self.tracked_names();
        let start = self.tracked(&state.start);
        let found = self.tracked(estimate);
        let truth = self.truth.as_ref().map(|t| self.tracked(t));
        let mut params = BTreeMap::new();
        for (k, name) in names.iter().enumerate() {
            let truth = truth.as_ref().map(|t| t[k]);
            let error = truth.map(|t| largest_error(&[found[k]], &[t]));
            match (truth, error) {
                (Some(t), Some(e)) => say!(
                    "{name}: {:.4} -> {:.4} (truth {t:.4}, error {:.2} %)",
                    start[k],
                    found[k],
                    100.0 * e
                ),
                _ => say!("{name}: {:.4} -> {:.4}", start[k], found[k]),
            }
            let value = Recovered {
                start: start[k],
                value: found[k],
                truth,
                relative_error: error,
            };
            params.insert(name.clone(), value);
        }
        let report = Report {
            scene: match &state.job.scene {
                Some(path) => path.0.display().to_string(),
                None => "built-in".into(),
            },
            optimizer: state.job.optimizer,
            estimator: state.job.estimator.clone(),
            loss: state.job.loss.clone(),
            iterations: state.iteration,
            final_loss: state.history.last().map(|r| r.loss),
            params,
            folded: self.folds(),
            solved: self.walks.report(&self.problem.settings),
        };
        output::write_json(&out.join("result.json"), &report)?;
        say!("{}: pictures, charts and values", out.display());
        Ok(())
    }
}

#[derive(Debug, Serialize)]
struct Recovered {
    start: f64,
    value: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    relative_error: Option<f64>,
}

/// What `result.json` holds.
#[derive(Debug, Serialize)]
struct Report {
    scene: String,
    optimizer: OptimizerArg,
    estimator: String,
    loss: String,
    iterations: u32,
    final_loss: Option<f64>,
    params: BTreeMap<String, Recovered>,
    /// Triangles that are turned over, by mesh.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    folded: BTreeMap<String, usize>,
    /// What walks to solutions came to, since the run was started or resumed.
    #[serde(flatten)]
    solved: SolvedReport,
}

/// Largest relative error of any value.
fn largest_error(values: &[f64], truth: &[f64]) -> f64 {
    let error = |(v, t): (&f64, &f64)| (v - t).abs() / t.abs().max(1e-12);
    values.iter().zip(truth).map(error).fold(0.0, f64::max)
}
