//! Paths in checkpoints.

use std::ffi::OsString;
use std::path::PathBuf;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A path, which need not be UTF-8: a string where it is, and what the operating system makes of it where not.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct FilePath(pub PathBuf);

impl std::fmt::Debug for FilePath {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

impl Serialize for FilePath {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self.0.to_str() {
            Some(text) => to.serialize_str(text),
            None => self.0.as_os_str().serialize(to),
        }
    }
}

impl<'de> Deserialize<'de> for FilePath {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Either {
            Text(PathBuf),
            Other(OsString),
        }
        Ok(Self(match Either::deserialize(from)? {
            Either::Text(path) => path,
            Either::Other(name) => name.into(),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn paths_need_not_be_utf_8() {
        use std::os::unix::ffi::OsStringExt;
        for bytes in [&b"scene.xml"[..], b"sc\xff\xfene.xml"] {
            let path = FilePath(OsString::from_vec(bytes.to_vec()).into());
            let text = serde_json::to_string(&path).unwrap();
            assert_eq!(serde_json::from_str::<FilePath>(&text).unwrap(), path);
        }
        let plain = FilePath("a/b.xml".into());
        assert_eq!(serde_json::to_string(&plain).unwrap(), "\"a/b.xml\"");
    }
}
