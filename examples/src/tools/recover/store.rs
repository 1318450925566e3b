//! Checkpoints of `recover`: what a run has on disk, what it was begun with, and who may write there.
//!
//! A checkpoint is a JSON file, and for long arrays a file of bytes beside it, which the former names by
//! its digest. The bytes are written first and under a name of their own, so a run that is
//! killed between the two leaves the checkpoint before, whole.

use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use optim::exact::beside;
use render::{Scene, image_io};
use serde::{Deserialize, Serialize};

use super::Checkpoint;
use super::file_path::FilePath;
use super::job::TargetArg;
use crate::cli::ToolError;
use crate::complain;
use crate::optimise::Target;
use crate::output;

/// The layout of checkpoints that this tool reads and writes.
const VERSION: u32 = 3;
const LOCK: &str = "recover.lock";

/// BLAKE3, in hexadecimal digits.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Digest(String);

impl Digest {
    fn of(hasher: &blake3::Hasher) -> Self {
        Self(hasher.finalize().to_hex().to_string())
    }

    fn of_numbers(values: &[f32]) -> Self {
        let mut hasher = blake3::Hasher::new();
        for part in values.chunks(1 << 12) {
            let bytes: Vec<u8> = part
                .iter()
                .flat_map(|v| v.to_bits().to_le_bytes())
                .collect();
            hasher.update(&bytes);
        }
        Self::of(&hasher)
    }

    fn of_file(path: &Path) -> Result<Self, ToolError> {
        let mut hasher = blake3::Hasher::new();
        (regular(path).and_then(|()| hasher.update_reader(File::open(path)?).map(|_| ())))
            .map_err(|e| ToolError::file(path, format!("cannot read the file: {e}")))?;
        Ok(Self::of(&hasher))
    }
}

/// Devices and pipes have no end.
fn regular(path: &Path) -> io::Result<()> {
    if fs::metadata(path)?.is_file() {
        Ok(())
    } else {
        Err(io::Error::other(
            "expected a file, found a folder, a device or a pipe",
        ))
    }
}

/// A file that a run was begun with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Input {
    path: FilePath,
    digest: Digest,
}

impl Input {
    fn of(path: &Path) -> Result<Self, ToolError> {
        Ok(Self {
            path: FilePath(path.to_owned()),
            digest: Digest::of_file(path)?,
        })
    }
}

/// What a run was begun with, besides its options.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Inputs {
    /// The files of the scene.
    scene: Vec<Input>,
    /// All of the scene's values, and those that the unknowns start from.
    values: [Digest; 2],
    /// The files of the target.
    targets: Vec<Input>,
    /// What the images are compared with.
    target: Vec<Digest>,
}

impl Inputs {
    /// Those of a scene as it was loaded, of its unknowns at the start, and of the target.
    pub fn of(
        scene: &Scene,
        start: &[f32],
        files: &[TargetArg],
        targets: &[Target],
    ) -> Result<Self, ToolError> {
        let scene_files = scene.files().iter().map(|path| Input::of(path));
        let file = |target: &TargetArg| image_io::split_layer(&target.image.0).0;
        let target_files = files.iter().map(|target| Input::of(&file(target)));
        Ok(Self {
            scene: scene_files.collect::<Result<_, _>>()?,
            values: [scene.params().values(), start].map(Digest::of_numbers),
            targets: target_files.collect::<Result<_, _>>()?,
            target: targets.iter().map(digest_of).collect(),
        })
    }

    /// Whether a run that was begun with these may go on with a scene and the targets in its folder.
    ///
    /// # Errors
    /// What differs, by name.
    pub fn require_same(
        &self,
        scene: &Scene,
        start: &[f32],
        (targets, files): (&[Target], &[PathBuf]),
        checkpoint: &Path,
    ) -> Result<(), ToolError> {
        let changed = |path: &Path| {
            let message = "expected what the run was begun with, found other content; without --resume, recover \
                           starts anew";
            Err(ToolError::file(path, message))
        };
        let same = |input: &Input| {
            if Digest::of_file(&input.path.0)? == input.digest {
                Ok(())
            } else {
                changed(&input.path.0)
            }
        };
        self.scene.iter().try_for_each(same)?;
        let found = scene.files().iter();
        if let Some(new) = found
            .clone()
            .find(|f| !self.scene.iter().any(|i| i.path.0 == **f))
        {
            let message = "expected the files that the run was begun with, found this one";
            return Err(ToolError::file(new, message));
        }
        if let Some(gone) = self
            .scene
            .iter()
            .find(|i| !found.clone().any(|f| *f == i.path.0))
        {
            let message = "expected a scene that reads this file, as when the run was begun";
            return Err(ToolError::file(&gone.path.0, message));
        }
        let values = [scene.params().values(), start].map(Digest::of_numbers);
        for (name, (found, begun)) in ["scene", "unknowns"]
            .iter()
            .zip(values.iter().zip(&self.values))
        {
            if found != begun {
                let message = format!("inputs.values: expected those of the {name}, found others");
                return Err(ToolError::file(checkpoint, message));
            }
        }
        // The folder has the targets; where they came from may be gone.
        let mut there = self.targets.iter().filter(|i| i.path.0.exists());
        there.try_for_each(same)?;
        for (i, (target, file)) in targets.iter().zip(files).enumerate() {
            if self.target.get(i) != Some(&digest_of(target)) {
                return changed(file);
            }
        }
        Ok(())
    }
}

fn digest_of(target: &Target) -> Digest {
    Digest::of_numbers(&target.image.data)
}

/// The long arrays of a checkpoint.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Arrays {
    file: String,
    digest: Digest,
}

/// A [`Checkpoint`] as it is on disk.
#[derive(Serialize)]
struct Written<'a> {
    version: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    arrays: Option<Arrays>,
    #[serde(flatten)]
    checkpoint: serde_json::Map<String, serde_json::Value>,
    inputs: &'a Inputs,
}

/// What has to be known before the rest is read.
#[derive(Deserialize)]
struct Head {
    version: Option<u32>,
    arrays: Option<Arrays>,
    inputs: Option<Inputs>,
}

/// The checkpoint in a folder, which nobody else writes to meanwhile.
pub(super) struct Store {
    folder: PathBuf,
    path: PathBuf,
    /// Locked until the process ends, however it does.
    _lock: File,
    /// The arrays of the last checkpoint.
    arrays: Option<String>,
}

impl Store {
    /// The folder, made if it is missing, without what runs that were killed have left there unfinished.
    ///
    /// # Errors
    /// The operating system's; another run in that folder.
    pub fn open(folder: &Path, name: &str) -> Result<Self, ToolError> {
        output::create_dir(folder)?;
        let lock = lock(&folder.join(LOCK), folder)?;
        let store = Self {
            folder: folder.to_owned(),
            path: folder.join(name),
            _lock: lock,
            arrays: None,
        };
        store.remove_if(is_temporary)?;
        Ok(store)
    }

    /// [`Store::open`] for a folder that has a checkpoint.
    ///
    /// # Errors
    /// As that, or there is none.
    pub fn existing(folder: &Path, name: &str) -> Result<Self, ToolError> {
        let path = folder.join(name);
        fs::metadata(&path)
            .map_err(|e| ToolError::file(&path, format!("cannot read the checkpoint: {e}")))?;
        Self::open(folder, name)
    }

    /// The checkpoint's path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes files of the folder by name.
    fn remove_if(&self, which: impl Fn(&str) -> bool) -> Result<(), ToolError> {
        let entries = fs::read_dir(&self.folder)
            .map_err(|e| ToolError::file(&self.folder, format!("cannot read the folder: {e}")))?;
        for entry in entries.filter_map(Result::ok) {
            let is_file = entry.file_type().is_ok_and(|t| t.is_file());
            if is_file && entry.file_name().to_str().is_some_and(&which) {
                output::remove(&entry.path())?;
            }
        }
        Ok(())
    }

    /// Removes the checkpoint of another job.
    pub fn clear(&mut self) -> Result<(), ToolError> {
        // Never bytes before what refers to them.
        output::remove(&self.path)?;
        self.arrays = None;
        self.remove_if(is_array_file)
    }

    /// Reads the checkpoint.
    ///
    /// # Errors
    /// Whatever is wrong with it, by key where there is one.
    pub fn read(&mut self) -> Result<(Checkpoint, Inputs), ToolError> {
        let path = self.path.clone();
        let wrong = |message: String| ToolError::file(&path, message);
        let text = (regular(&path).and_then(|()| fs::read_to_string(&path)))
            .map_err(|e| wrong(format!("cannot read the checkpoint: {e}")))?;
        let expected =
            |e: serde_json::Error| wrong(format!("expected a checkpoint of this tool: {e}"));
        let head: Head = serde_json::from_str(&text).map_err(expected)?;
        if head.version != Some(VERSION) {
            let found = head.version.map_or("none".into(), |v| v.to_string());
            return Err(wrong(format!(
                "version: expected {VERSION}, found {found}; another version of this tool wrote it"
            )));
        }
        let Some(inputs) = head.inputs else {
            return Err(wrong(
                "inputs: expected what the run was begun with, found nothing".into(),
            ));
        };
        let parse = || serde_json::from_str::<Checkpoint>(&text);
        let checkpoint = match &head.arrays {
            None => parse(),
            Some(arrays) => {
                if !is_array_file(&arrays.file) {
                    let found = &arrays.file;
                    return Err(wrong(format!(
                        "arrays.file: expected {ARRAYS}..{BYTES}, found {found}"
                    )));
                }
                let file = self.folder.join(&arrays.file);
                if Digest::of_file(&file)? != arrays.digest {
                    let message =
                        "expected the arrays of the checkpoint beside it, found other content";
                    return Err(ToolError::file(&file, message));
                }
                let bytes = File::open(&file)
                    .map_err(|e| ToolError::file(&file, format!("cannot read the file: {e}")))?;
                beside::read(BufReader::new(bytes), parse)
            }
        };
        let checkpoint = checkpoint.map_err(expected)?;
        (checkpoint.job.check()).map_err(|e| wrong(format!("job.{}: {}", e.key, e.message)))?;
        self.arrays = head.arrays.map(|a| a.file);
        let kept = self.arrays.clone();
        self.remove_if(|name| is_array_file(name) && Some(name) != kept.as_deref())?;
        Ok((checkpoint, inputs))
    }

    /// Replaces the checkpoint.
    ///
    /// # Errors
    /// The operating system's; the checkpoint before is then still there.
    pub fn write(&mut self, checkpoint: &Checkpoint, inputs: &Inputs) -> Result<(), ToolError> {
        let temporary = self
            .folder
            .join(format!(".{ARRAYS}.{}-0.tmp", std::process::id()));
        let written = self.write_as(&temporary, checkpoint, inputs);
        if written.is_err() {
            // Already failing; a left-over that cannot be removed changes nothing about that.
            let _ = fs::remove_file(&temporary);
        }
        written
    }

    fn write_as(
        &mut self,
        temporary: &Path,
        checkpoint: &Checkpoint,
        inputs: &Inputs,
    ) -> Result<(), ToolError> {
        let unwritable =
            |e: io::Error| ToolError::file(temporary, format!("cannot write the file: {e}"));
        let wrong = |e: serde_json::Error| {
            ToolError::file(&self.path, format!("cannot write the checkpoint: {e}"))
        };
        let sink = Hashed {
            to: BufWriter::new(File::create(temporary).map_err(unwritable)?),
            hasher: blake3::Hasher::new(),
        };
        let (value, sink) = beside::write(sink, || serde_json::to_value(checkpoint));
        let value = value.map_err(wrong)?;
        let mut file = (sink.to.into_inner()).map_err(|e| unwritable(e.into_error()))?;
        let arrays = match file.seek(SeekFrom::End(0)).map_err(unwritable)? {
            0 => None,
            _ => {
                file.sync_all().map_err(unwritable)?;
                let digest = Digest::of(&sink.hasher);
                let file = format!("{ARRAYS}{}{BYTES}", &digest.0[..16]);
                Some(Arrays { file, digest })
            }
        };
        drop(file);
        match &arrays {
            Some(a) => fs::rename(temporary, self.folder.join(&a.file)),
            None => fs::remove_file(temporary),
        }
        .map_err(unwritable)?;
        let serde_json::Value::Object(checkpoint) = value else {
            unreachable!("a struct is an object");
        };
        let name = arrays.as_ref().map(|a| a.file.clone());
        let written = Written {
            version: VERSION,
            arrays,
            checkpoint,
            inputs,
        };
        output::write_json(&self.path, &written)?;
        let before = std::mem::replace(&mut self.arrays, name);
        match before.filter(|b| Some(b) != self.arrays.as_ref()) {
            Some(before) => output::remove(&self.folder.join(before)),
            None => Ok(()),
        }
    }
}

/// What is written, and its digest.
struct Hashed<W> {
    to: W,
    hasher: blake3::Hasher,
}

impl<W: Write> Write for Hashed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.to.write(bytes)?;
        self.hasher.update(&bytes[..n]);
        Ok(n)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

const ARRAYS: &str = "checkpoint-";
const BYTES: &str = ".bin";

/// `checkpoint-0123456789abcdef.bin`.
fn is_array_file(name: &str) -> bool {
    let digits = (name.strip_prefix(ARRAYS)).and_then(|n| n.strip_suffix(BYTES));
    digits.is_some_and(|d| d.len() == 16 && d.bytes().all(|b| b.is_ascii_hexdigit()))
}

/// As [`render::image_io::write_atomically`] calls what it has not finished.
fn is_temporary(name: &str) -> bool {
    let parts = || {
        let (_, id) = name
            .strip_prefix('.')?
            .strip_suffix(".tmp")?
            .rsplit_once('.')?;
        id.split_once('-')
    };
    let number = |n: &str| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit());
    parts().is_some_and(|(process, count)| number(process) && number(count))
}

/// Takes the lock of a folder.
fn lock(path: &Path, folder: &Path) -> Result<File, ToolError> {
    let failed = |e: io::Error| ToolError::file(path, format!("cannot lock the folder: {e}"));
    if path.exists() {
        regular(path).map_err(failed)?;
    }
    let mut options = File::options();
    let mut file = (options.read(true).write(true).create(true).truncate(false))
        .open(path)
        .map_err(failed)?;
    match file.try_lock() {
        Ok(()) => {}
        Err(fs::TryLockError::WouldBlock) => {
            let mut holder = String::new();
            // Some systems let nobody read a locked file.
            let _ = (&file).take(20).read_to_string(&mut holder);
            let by = match holder.trim().parse::<u32>() {
                Ok(id) => format!(" (process {id})"),
                Err(_) => String::new(),
            };
            return Err(ToolError::file(
                folder,
                format!(
                    "expected a folder that no other run uses, found a run of recover at work{by}"
                ),
            ));
        }
        Err(fs::TryLockError::Error(e)) if e.kind() == io::ErrorKind::Unsupported => {
            complain!(
                "warning: {}: the file system has no locks",
                folder.display()
            );
        }
        Err(fs::TryLockError::Error(e)) => return Err(failed(e)),
    }
    let id = format!("{}\n", std::process::id());
    (file.set_len(0))
        .and_then(|()| file.write_all(id.as_bytes()))
        .map_err(failed)?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_files_are_left_alone() {
        assert!(is_temporary(".target.exr.12-0.tmp") && is_temporary(".a.b.c.1-22.tmp"));
        for other in [
            "target.exr",
            ".hidden",
            ".notes.tmp",
            "x.1-2.tmp",
            ".x.1-.tmp",
            ".x.a-1.tmp",
        ] {
            assert!(!is_temporary(other), "{other}");
        }
        assert!(is_array_file("checkpoint-0123456789abcdef.bin"));
        for other in [
            "checkpoint.json",
            "checkpoint-1.bin",
            "../checkpoint-0123456789abcdef.bin",
        ] {
            assert!(!is_array_file(other), "{other}");
        }
    }
}
