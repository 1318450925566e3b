//! Where the files that a scene file names are looked up.

use std::collections::HashMap;
use std::ffi::{OsStr, OsString};
use std::fmt;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::error::quoted;

/// The directory of one scene file, then those of the files that include it. (Scenes keep fragments in a subfolder but name
/// meshes relative to the main file.)
#[derive(Debug, Clone)]
pub(super) struct Directories {
    all: Arc<[PathBuf]>,
    listings: Arc<Listings>,
}

impl Directories {
    pub fn new(own: &Path, includer: Option<&Self>) -> Self {
        let own = if own == Path::new("") {
            Path::new(".")
        } else {
            own
        };
        let own = std::path::absolute(own).unwrap_or_else(|_| own.to_owned());
        let outer = includer.map_or(&[][..], |d| &d.all);
        let outer = outer.iter().filter(|&d| *d != own).cloned();
        Self {
            all: std::iter::once(own.clone()).chain(outer).collect(),
            listings: includer.map_or_else(Arc::default, |d| d.listings.clone()),
        }
    }

    /// The first folder that exists under this name.
    pub fn find_folder(&self, name: &Path) -> Option<PathBuf> {
        self.first(name, Path::is_dir)
    }

    /// The first that exists under this name and is no directory. Reading it refuses what is no file.
    pub fn find(&self, name: &Path) -> Option<PathBuf> {
        self.first(name, is_no_folder)
    }

    /// What is found under a name that is not there as it is written.
    pub fn substitution(&self, name: &str, found: &Path) -> Option<String> {
        let exact = self.all.iter().any(|d| d.join(name) == found);
        let message = || {
            let name = quoted(name);
            format!("there is no {name}; {} is read instead", found.display())
        };
        (!exact).then(message)
    }

    /// By its name, and otherwise by the one that it has where backslashes part folders and capitals are small letters: files
    /// that were written there name others so.
    fn first(&self, name: &Path, is_right: impl Fn(&Path) -> bool) -> Option<PathBuf> {
        let mut exact = self.all.iter().map(|d| d.join(name));
        if let Some(path) = exact.find(|p| is_right(p)) {
            return Some(path);
        }
        let name = name.to_str()?.replace('\\', "/");
        let mut nearly = (self.all.iter()).filter_map(|d| self.listings.walk(d, Path::new(&name)));
        nearly.find(|p| is_right(p))
    }
}

fn is_no_folder(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|found| !found.is_dir())
}

impl fmt::Display for Directories {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (i, directory) in self.all.iter().enumerate() {
            let separator = if i == 0 { "" } else { ", " };
            write!(f, "{separator}{}", directory.display())?;
        }
        Ok(())
    }
}

/// What is in a folder, by its name in small letters.
type Listing = HashMap<String, Vec<OsString>>;

/// The folders that were looked through so far, each of them once.
#[derive(Debug, Default)]
struct Listings(Mutex<HashMap<PathBuf, Listing>>);

impl Listings {
    /// What lies below a folder under a name whose capitals may be others.
    fn walk(&self, folder: &Path, name: &Path) -> Option<PathBuf> {
        let mut at = folder.to_owned();
        for part in name.components() {
            match part {
                Component::Normal(part) if !at.join(part).exists() => {
                    let only = self.only(&at, part)?;
                    at.push(only);
                }
                part => at.push(part),
            }
        }
        Some(at)
    }

    /// What alone in a folder differs from a name by capitals.
    fn only(&self, folder: &Path, name: &OsStr) -> Option<OsString> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if !all.contains_key(folder) {
            all.insert(folder.to_owned(), list(folder));
        }
        match all[folder].get(&name.to_str()?.to_lowercase())?.as_slice() {
            [only] => Some(only.clone()),
            _ => None,
        }
    }
}

fn list(folder: &Path) -> Listing {
    let mut listing = Listing::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        if let Some(text) = name.to_str() {
            listing.entry(text.to_lowercase()).or_default().push(name);
        }
    }
    listing
}
