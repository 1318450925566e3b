//! Reading whole files.

use std::fs::{self, File, FileType};
use std::io::Read;
use std::path::Path;

use crate::error::SceneError;

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
    let info = fs::metadata(path).map_err(io)?;
    if !info.is_file() {
        let found = kind(info.file_type()).to_owned();
        return Err(asset("a regular file".to_owned(), found));
    }
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
    match bytes.len() as u64 {
        length if length > most => Err(too_long(length)),
        _ => Ok(bytes),
    }
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
    match found.is_dir() {
        true => "a directory",
        false => "something else",
    }
}
