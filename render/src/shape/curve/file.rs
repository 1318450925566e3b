//! Files of control points: one `x y z radius` per line, and empty lines between curves.

use std::path::Path;

use super::{CurveKind, Curves};
use crate::accel::MAX_COORDINATE;
use crate::error::{SceneError, quoted};
use crate::files;
use crate::math::Transform;

/// Largest file in bytes.
const MAX_BYTES: u64 = 1 << 32;

impl Curves {
    /// Reads curves from a text file: a control point per line, as four numbers, the last of which is the radius; empty
    /// lines, and the end, end a curve. `to_world` carries points, and leaves radii as they are, as in Mitsuba 3. What
    /// follows the four numbers of a line has no effect, as there: the second value says so, with the first such line.
    ///
    /// # Errors
    /// Whatever is wrong, with the line where there is one.
    pub fn from_file(
        path: &Path,
        kind: CurveKind,
        to_world: &Transform,
    ) -> Result<(Self, Option<String>), SceneError> {
        let text = files::read(path, MAX_BYTES)?;
        Self::from_text(&text, path, kind, to_world)
    }

    /// [`Curves::from_file`] on a file's content; `path` is for messages.
    ///
    /// # Errors
    /// See there.
    pub fn from_text(
        text: &[u8],
        path: &Path,
        kind: CurveKind,
        to_world: &Transform,
    ) -> Result<(Self, Option<String>), SceneError> {
        let asset = |line: Option<u32>, expected: String, found: String| SceneError::Asset {
            path: path.into(),
            line,
            expected,
            found,
        };
        if text.starts_with(&[0xff, 0xfe]) || text.starts_with(&[0xfe, 0xff]) {
            return Err(asset(Some(1), "text in UTF-8".into(), "UTF-16".into()));
        }
        let (mut points, mut starts) = (Vec::<[f32; 4]>::new(), Vec::new());
        let mut ignored = None;
        let mut within = false;
        let complete = |points: usize, starts: &[u32], line: u32| match starts.last() {
            Some(&start) if points - (start as usize) < kind.fewest() => {
                let expected = format!("at least {} points of a curve", kind.fewest());
                let found = format!("{} before this line", points - start as usize);
                Err(asset(Some(line), expected, found))
            }
            _ => Ok(()),
        };
        let mut line: u32 = 0;
        for content in text.split(|&b| b == b'\n') {
            line = line.saturating_add(1);
            let mut words = (content.split(u8::is_ascii_whitespace)).filter(|w| !w.is_empty());
            let Some(first) = words.next() else {
                if within {
                    complete(points.len(), &starts, line)?;
                }
                within = false;
                continue;
            };
            if !within {
                starts.push(points.len() as u32);
                within = true;
            }
            let mut numbers = [0.0; 4];
            let mut word = Some(first);
            for (number, what) in numbers.iter_mut().zip(["x", "y", "z", "a radius"]) {
                let found = word.ok_or_else(|| {
                    let expected = format!("four numbers, x, y, z and a radius: {what}");
                    asset(Some(line), expected, "the end of the line".into())
                })?;
                let read = std::str::from_utf8(found)
                    .ok()
                    .and_then(|w| w.parse::<f32>().ok());
                *number = read.filter(|x| x.is_finite()).ok_or_else(|| {
                    let found = quoted(&String::from_utf8_lossy(found)).to_string();
                    asset(Some(line), format!("a finite number as {what}"), found)
                })?;
                word = words.next();
            }
            if word.is_some() && ignored.is_none() {
                ignored = Some(format!(
                    "{}:{line}: what follows the radius of a point has no effect",
                    path.display()
                ));
            }
            if numbers[3] < 0.0 {
                let found = numbers[3].to_string();
                return Err(asset(Some(line), "a radius of at least 0".into(), found));
            }
            let [x, y, z, radius] = numbers;
            let [x, y, z] = to_world.point([x, y, z].map(f64::from)).map(|x| x as f32);
            let point = [x, y, z, radius];
            if let Some(found) = point
                .iter()
                .find(|x| x.is_nan() || x.abs() > MAX_COORDINATE)
            {
                let expected =
                    format!("numbers of magnitude at most {MAX_COORDINATE:e} in the world");
                return Err(asset(Some(line), expected, found.to_string()));
            }
            points.push(point);
            if points.len() >= (u32::MAX >> 4) as usize {
                return Err(asset(
                    Some(line),
                    "fewer points".into(),
                    points.len().to_string(),
                ));
            }
        }
        if within {
            complete(points.len(), &starts, line)?;
        }
        if points.is_empty() {
            return Err(asset(None, "at least one curve".into(), "none".into()));
        }
        let curves = Self::new(kind, points, &starts).map_err(|wrong| {
            let (expected, found) = wrong.split_once(", found ").unwrap_or((&wrong, "another"));
            let expected = expected.trim_start_matches("expected ");
            asset(None, expected.into(), found.into())
        })?;
        Ok((curves, ignored))
    }
}
