//! A workcell's document with the files that it refers to.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::archive::Files;
use crate::wire::{ResourceError, Resources, sha256};

/// Name of the document in a bundle.
pub const DOCUMENT: &str = "workcell.json";

/// A workcell's document and files.
#[derive(Debug, Clone, PartialEq)]
pub struct Bundle {
    /// The value of a problem's `workcell`.
    pub document: Value,
    /// What it refers to, by path from the bundle's root.
    pub files: Files,
}

/// Why files are no bundle.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BundleError {
    /// The document is not there.
    #[error("`{DOCUMENT}` must stand at the root of the bundle, or in its only folder")]
    NoDocument,
    /// What was stored cannot be read.
    #[error("the stored bundle is damaged")]
    Damaged,
}

/// What stands before the files when a bundle is stored.
#[derive(Serialize, Deserialize)]
struct Header {
    document: Value,
    files: Vec<(String, usize)>,
}

impl Bundle {
    /// Splits unpacked files into the document's text and the rest. A single folder around all is
    /// left away.
    ///
    /// # Errors
    /// [`BundleError::NoDocument`].
    pub fn split(mut files: Files) -> Result<(Arc<[u8]>, Files), BundleError> {
        if !files.contains_key(DOCUMENT) {
            let folder =
                files.keys().next().and_then(|path| path.split_once('/')).map(|(top, _)| format!("{top}/"));
            let folder = folder.ok_or(BundleError::NoDocument)?;
            let inside = files.into_iter().map(|(path, content)| {
                path.strip_prefix(&folder)
                    .map(|path| (path.to_owned(), content))
                    .ok_or(BundleError::NoDocument)
            });
            files = inside.collect::<Result<_, _>>()?;
        }
        let document = files.remove(DOCUMENT).ok_or(BundleError::NoDocument)?;
        Ok((document, files))
    }

    /// The bundle as it is stored.
    pub fn pack(&self) -> Vec<u8> {
        let files = self.files.iter().map(|(path, content)| (path.clone(), content.len())).collect();
        let header = Header { document: self.document.clone(), files };
        // A JSON value and numbers always serialise.
        let header = serde_json::to_vec(&header).unwrap_or_default();
        let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
        bytes.extend(header);
        self.files.values().for_each(|content| bytes.extend_from_slice(content));
        bytes
    }

    /// The bundle that [`Bundle::pack`] has given as `bytes`.
    ///
    /// # Errors
    /// [`BundleError::Damaged`].
    pub fn unpack(bytes: &[u8]) -> Result<Self, BundleError> {
        let (length, rest) = bytes.split_first_chunk().ok_or(BundleError::Damaged)?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|_| BundleError::Damaged)?;
        let (header, mut rest) = rest.split_at_checked(length).ok_or(BundleError::Damaged)?;
        let header: Header = serde_json::from_slice(header).map_err(|_| BundleError::Damaged)?;
        let mut files = Files::new();
        for (path, length) in header.files {
            let (content, further) = rest.split_at_checked(length).ok_or(BundleError::Damaged)?;
            files.insert(path, content.into());
            rest = further;
        }
        Ok(Self { document: header.document, files })
    }

    /// Path, length and digest of each file.
    pub fn listing(&self) -> impl Iterator<Item = (&str, usize, String)> {
        self.files.iter().map(|(path, content)| (path.as_str(), content.len(), sha256(content)))
    }
}

impl Resources for Bundle {
    fn read(&self, path: &str, max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        if self.files.is_empty() {
            return Err(ResourceError::NoFiles);
        }
        let content = self.files.get(path).ok_or(ResourceError::NotFound)?;
        if content.len() > max_bytes {
            return Err(ResourceError::TooLarge(max_bytes));
        }
        Ok(content.to_vec())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn files(paths: &[&str]) -> Files {
        paths.iter().map(|path| ((*path).to_owned(), path.as_bytes().into())).collect()
    }

    #[test]
    fn the_document_is_found_at_the_root_or_in_the_only_folder() {
        for paths in [["workcell.json", "a/x.stl"], ["cell/workcell.json", "cell/a/x.stl"]] {
            let (document, rest) = Bundle::split(files(&paths)).unwrap();
            assert_eq!(&*document, paths[0].as_bytes());
            assert_eq!(rest.keys().collect::<Vec<_>>(), ["a/x.stl"]);
        }
        for paths in [&["x"][..], &["a/workcell.json", "b/x"], &[], &["a/b/workcell.json"]] {
            assert_eq!(Bundle::split(files(paths)), Err(BundleError::NoDocument), "{paths:?}");
        }
    }

    #[test]
    fn what_is_stored_comes_back() {
        let bundle = Bundle { document: json!({"a": [1, 0.1]}), files: files(&["x", "y/z"]) };
        let bytes = bundle.pack();
        assert_eq!(Bundle::unpack(&bytes).unwrap(), bundle);
        for cut in 0..bytes.len() {
            assert_eq!(Bundle::unpack(&bytes[..cut]), Err(BundleError::Damaged));
        }
    }

    #[test]
    fn files_are_read_by_their_paths_only() {
        let bundle = Bundle { document: json!({}), files: files(&["a/x"]) };
        assert_eq!(bundle.read("a/x", 3).unwrap(), b"a/x");
        assert_eq!(bundle.read("a/x", 2), Err(ResourceError::TooLarge(2)));
        assert_eq!(bundle.read("x", 3), Err(ResourceError::NotFound));
    }
}
