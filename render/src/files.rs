//! Files as they are read and written: what is read is a file and no device, and what is written appears complete or
//! not at all.
//!
//! ```
//! use render::files;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("exposure.txt");
//! files::write_atomically(&path, b"two stops")?;
//! assert_eq!(files::read(&path, 1 << 10)?, b"two stops");
//! // What is longer than expected, or no file, is refused, with its name.
//! let long = files::read(&path, 4).unwrap_err().to_string();
//! assert!(long.contains("exposure.txt") && long.contains("at most 4 bytes"), "{long}");
//! let no_file = files::read(folder.path(), 1 << 10).unwrap_err().to_string();
//! assert!(no_file.contains("a directory"), "{no_file}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::fs::{self, File, FileType, TryLockError};
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use crate::error::SceneError;
use crate::inputs;

/// How many symbolic links are followed one after another.
const MOST_LINKS: usize = 40;

/// What a path leads to is a regular file: devices, pipes and sockets may never end. A missing one is an error of opening
/// it.
///
/// # Errors
/// It is something else.
pub fn require_regular(path: &Path) -> Result<(), SceneError> {
    match fs::metadata(path) {
        Ok(info) if !info.is_file() => Err(SceneError::Asset {
            path: path.to_owned(),
            line: None,
            expected: "a regular file".into(),
            found: kind(info.file_type()).into(),
        }),
        _ => Ok(()),
    }
}

/// The bytes of a regular file. Devices and pipes, which may never end, are refused before they are opened.
///
/// # Errors
/// [`SceneError::Asset`] for what is no regular file or has more than `most` bytes, and [`SceneError::Io`] where the
/// operating system refuses.
pub fn read(path: &Path, most: u64) -> Result<Vec<u8>, SceneError> {
    let io = |source| SceneError::Io {
        path: path.to_owned(),
        source,
    };
    let asset = |expected: String, found: String| SceneError::Asset {
        path: path.to_owned(),
        line: None,
        expected,
        found,
    };
    require_regular(path)?;
    let info = fs::metadata(path).map_err(io)?;
    let too_long = |length: u64| asset(format!("at most {most} bytes"), format!("{length} bytes"));
    if info.len() > most {
        return Err(too_long(info.len()));
    }
    // It may grow meanwhile; some file systems do not know lengths at all.
    let mut bytes = Vec::with_capacity(usize::try_from(info.len()).unwrap_or(0));
    let file = File::open(path).map_err(io)?;
    file.take(most.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(io)?;
    let length = bytes.len() as u64;
    if length > most {
        return Err(too_long(length));
    }
    inputs::note(path);
    Ok(bytes)
}

/// What else there is.
fn kind(found: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if found.is_fifo() {
            return "a pipe";
        }
        if found.is_char_device() || found.is_block_device() {
            return "a device";
        }
        if found.is_socket() {
            return "a socket";
        }
    }
    if found.is_dir() {
        "a directory"
    } else {
        "something else"
    }
}

/// Writes a file completely or not at all: a reader, or a crash, never meets half of it. What stood under the
/// name before stays until the new content is on disk. A symbolic link stays, and what it leads to is written. What
/// earlier attempts that were killed have left beside it is removed.
///
/// # Errors
/// The file cannot be written; nothing is left behind then.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), SceneError> {
    let written = target(path).and_then(|target| {
        let (temporary, mut file) = temporary(&target)?;
        let written = (file.write_all(bytes))
            .and_then(|()| file.sync_all())
            .and_then(|()| fs::rename(&temporary, &target));
        if written.is_err() {
            // Already failing; a left-over that cannot be removed changes nothing about that.
            let _ = fs::remove_file(&temporary);
        }
        written
    });
    written.map_err(|source| SceneError::Write {
        path: path.to_owned(),
        source,
    })
}

/// Whether [`write_atomically`] could write there: nothing is changed.
///
/// # Errors
/// Why not.
pub fn try_to_write(path: &Path) -> io::Result<()> {
    let (temporary, _file) = temporary(&target(path)?)?;
    fs::remove_file(temporary)
}

/// The file that is written under this name: what links lead to, whether it exists or not. Its folder does.
///
/// # Errors
/// The operating system's, or what is there is no file.
pub fn target(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        let name = path.file_name().ok_or(ErrorKind::InvalidFilename)?;
        let folder = match path.parent() {
            Some(dir) if !dir.as_os_str().is_empty() => dir,
            _ => Path::new("."),
        };
        let place = folder.canonicalize()?.join(name);
        match fs::symlink_metadata(&place) {
            Ok(info) if info.is_symlink() => {
                path = place.with_file_name("").join(fs::read_link(&place)?);
            }
            Ok(info) if !info.is_file() => {
                let message = "expected a file, found a folder or a device";
                return Err(io::Error::new(ErrorKind::InvalidInput, message));
            }
            _ => return Ok(place),
        }
    }
    Err(io::Error::other("too many symbolic links"))
}

/// A new file beside the target, since a rename is atomic within one file system only. It is locked as long as this
/// process lives: that is how others know that it is still wanted.
fn temporary(target: &Path) -> io::Result<(PathBuf, File)> {
    static COUNTER: AtomicU32 = AtomicU32::new(0);
    let name = target.file_name().ok_or(ErrorKind::InvalidFilename)?;
    remove_stale(target);
    loop {
        let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
        let mut temporary = std::ffi::OsString::from(".");
        temporary.push(name);
        temporary.push(format!(".{}-{unique}.tmp", std::process::id()));
        let temporary = target.with_file_name(temporary);
        let file = match File::create_new(&temporary) {
            // Of another process that had this number.
            Err(e) if e.kind() == ErrorKind::AlreadyExists => continue,
            file => file?,
        };
        // Where a file system knows no locks, no other process can take one, and none removes the file.
        let locked = file.lock();
        // Another process may have removed it as a stale one before it was locked.
        if locked.is_err() || temporary.exists() {
            return Ok((temporary, file));
        }
    }
}

/// Removes temporary files of this target whose process is gone. Whether that works is of no importance.
fn remove_stale(target: &Path) {
    let (Some(folder), Some(name)) = (target.parent(), target.file_name()) else {
        return;
    };
    let Ok(entries) = fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let is_file = entry.file_type().is_ok_and(|t| t.is_file());
        if is_file && is_temporary(&entry.file_name(), name) {
            let path = entry.path();
            let Ok(file) = File::open(&path) else {
                continue;
            };
            if !matches!(
                file.try_lock(),
                Err(TryLockError::WouldBlock | TryLockError::Error(_))
            ) {
                let _ = fs::remove_file(path);
            }
        }
    }
}

/// Whether a name is `.NAME.PROCESS-COUNT.tmp`.
fn is_temporary(found: &std::ffi::OsStr, name: &std::ffi::OsStr) -> bool {
    let middle = (found.as_encoded_bytes().strip_prefix(b"."))
        .and_then(|rest| rest.strip_prefix(name.as_encoded_bytes()))
        .and_then(|rest| rest.strip_prefix(b"."))
        .and_then(|rest| rest.strip_suffix(b".tmp"));
    let number = |part: &[u8]| !part.is_empty() && part.iter().all(u8::is_ascii_digit);
    middle.is_some_and(|middle| {
        let mut parts = middle.split(|&b| b == b'-');
        parts.next().is_some_and(number)
            && parts.next().is_some_and(number)
            && parts.next().is_none()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap());
        let mut names: Vec<_> = entries
            .map(|e| e.file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Those of this name without a lock are removed, and no others.
    #[test]
    fn what_killed_runs_left_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in [".a.exr.1-0.tmp", ".a.exr.123-45.tmp"] {
            fs::write(at(name), "half").unwrap();
        }
        let others = [
            ".a.exr.1-0-0.tmp",
            ".a.exr.mine.tmp",
            ".a.exr.tmp",
            ".b.exr.1-0.tmp",
        ];
        for name in others {
            fs::write(at(name), "of others").unwrap();
        }
        let held = File::create_new(at(".a.exr.7-7.tmp")).unwrap();
        held.lock().unwrap();
        write_atomically(&at("a.exr"), b"whole").unwrap();
        let mut left = others.to_vec();
        left.extend([".a.exr.7-7.tmp", "a.exr"]);
        left.sort_unstable();
        assert_eq!(names(dir.path()), left);
        drop(held);
        try_to_write(&at("a.exr")).unwrap();
        assert!(!at(".a.exr.7-7.tmp").exists());
        assert_eq!(fs::read(at("a.exr")).unwrap(), b"whole");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_written_through() {
        use std::os::unix::fs::symlink;
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("there")).unwrap();
        fs::write(at("there/old.exr"), "old").unwrap();
        symlink("there/old.exr", at("link.exr")).unwrap();
        symlink("link.exr", at("second.exr")).unwrap();
        symlink("there/new.exr", at("dangling.exr")).unwrap();
        symlink("circle.exr", at("circle.exr")).unwrap();
        symlink("/dev/null", at("null.exr")).unwrap();
        write_atomically(&at("second.exr"), b"1").unwrap();
        write_atomically(&at("dangling.exr"), b"2").unwrap();
        for name in ["link.exr", "second.exr", "dangling.exr"] {
            assert!(fs::symlink_metadata(at(name)).unwrap().is_symlink());
        }
        assert_eq!(fs::read(at("there/old.exr")).unwrap(), b"1");
        assert_eq!(fs::read(at("there/new.exr")).unwrap(), b"2");
        assert_eq!(names(&at("there")), ["new.exr", "old.exr"]);
        for name in ["circle.exr", "null.exr", "there"] {
            assert!(write_atomically(&at(name), b"3").is_err(), "{name}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_not_read() {
        for (path, found) in [("/dev/zero", "a device"), ("/dev", "a directory")] {
            let error = read(Path::new(path), 1000).unwrap_err().to_string();
            let expected = format!("{path}: expected a regular file, found {found}");
            assert_eq!(error, expected);
        }
    }
}
