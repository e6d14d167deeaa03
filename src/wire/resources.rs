//! Where the files that a problem refers to come from, and where they may never come from.

use std::path::{Component, Path, PathBuf};

use super::problem::KnownRobots;

/// Gives the content of what a document refers to, and may keep what was made of the like before. Implementations touch
/// no network and start no process.
pub trait Resources {
    /// The bytes at `path`, a path with forward slashes relative to the document's folder or
    /// bundle, already free of `..` and not absolute.
    ///
    /// # Errors
    /// Says why it cannot be had.
    fn read(&self, path: &str, max_bytes: usize) -> Result<Vec<u8>, ResourceError>;

    /// The robots of documents that were read before, where they are kept.
    fn known_robots(&self) -> Option<&KnownRobots> {
        None
    }
}

/// Why a file could not be had.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ResourceError {
    /// No files may be referred to here.
    #[error("files cannot be referred to here; give the text inline or a `library:` name")]
    NoFiles,
    /// The path leads out of the folder.
    #[error("the path must be relative, inside the problem's folder, and without `..`")]
    Outside,
    /// There is no such file.
    #[error("there is no such file in the problem's folder")]
    NotFound,
    /// The file cannot be read.
    #[error("the file cannot be read ({0})")]
    Unreadable(std::io::ErrorKind),
    /// The file is larger than allowed.
    #[error("the file is larger than the {0} bytes that are taken")]
    TooLarge(usize),
    /// A `package://` URI whose package `package_map` does not have.
    #[error("`package_map` has no package of that name; add it")]
    UnknownPackage,
    /// A scheme that is never resolved.
    #[error("only relative paths and `package://` URIs resolve")]
    UnknownScheme,
}

/// Only what ships with the product: every file is refused. For the service.
#[derive(Debug, Clone, Copy, Default)]
pub struct LibraryOnly;

impl Resources for LibraryOnly {
    fn read(&self, _path: &str, _max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        Err(ResourceError::NoFiles)
    }
}

/// Files from elsewhere, and robots from documents that were read before.
pub struct Remembering<'a> {
    /// Where files come from.
    pub resources: &'a dyn Resources,
    /// The robots.
    pub robots: &'a KnownRobots,
}

impl Resources for Remembering<'_> {
    fn read(&self, path: &str, max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        self.resources.read(path, max_bytes)
    }

    fn known_robots(&self) -> Option<&KnownRobots> {
        Some(self.robots)
    }
}

/// Files in one folder and below, links out of it refused. For the command line, with the problem
/// file's folder.
#[derive(Debug, Clone)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// Files below `root`.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }
}

impl Resources for Folder {
    fn read(&self, path: &str, max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        let inside = normalise(path)?;
        let find = |error: std::io::Error| match error.kind() {
            std::io::ErrorKind::NotFound => ResourceError::NotFound,
            kind => ResourceError::Unreadable(kind),
        };
        let root = self.root.canonicalize().map_err(find)?;
        let file = root.join(inside).canonicalize().map_err(find)?;
        if !file.starts_with(&root) {
            return Err(ResourceError::Outside);
        }
        let metadata = file.metadata().map_err(find)?;
        if !metadata.is_file() {
            return Err(ResourceError::NotFound);
        }
        if metadata.len() > max_bytes as u64 {
            return Err(ResourceError::TooLarge(max_bytes));
        }
        std::fs::read(&file).map_err(find)
    }
}

/// `path` with its `.` parts dropped.
///
/// # Errors
/// [`ResourceError::Outside`] when it is absolute, empty, holds `..`, a backslash, a drive or a
/// NUL.
pub fn normalise(path: &str) -> Result<String, ResourceError> {
    if path.contains(['\\', '\0', ':']) {
        return Err(ResourceError::Outside);
    }
    let mut parts = Vec::new();
    for component in Path::new(path).components() {
        match component {
            Component::Normal(part) => parts.push(part.to_string_lossy().into_owned()),
            Component::CurDir => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => {
                return Err(ResourceError::Outside);
            }
        }
    }
    if parts.is_empty() { Err(ResourceError::Outside) } else { Ok(parts.join("/")) }
}

/// The path, relative to the document, that `uri` means when it stands in a file of folder `base`
/// (relative to the document as well; empty for the document itself). `packages` maps package
/// names to folders.
///
/// # Errors
/// When it leads outside, names an unknown package, or has another scheme.
pub fn resolve_uri(uri: &str, base: &str, packages: &[(String, String)]) -> Result<String, ResourceError> {
    if let Some(rest) = uri.strip_prefix("package://") {
        let (name, path) = rest.split_once('/').ok_or(ResourceError::Outside)?;
        let (_, folder) =
            packages.iter().find(|(package, _)| package == name).ok_or(ResourceError::UnknownPackage)?;
        return join(folder, path);
    }
    if uri.contains("://") {
        return Err(ResourceError::UnknownScheme);
    }
    join(base, uri)
}

/// `path` below `folder`; neither may lead outside by itself.
fn join(folder: &str, path: &str) -> Result<String, ResourceError> {
    let path = normalise(path)?;
    match folder.trim_end_matches('/') {
        "" | "." => Ok(path),
        folder => Ok(format!("{}/{path}", normalise(folder)?)),
    }
}

/// The folder part of a relative path; empty when it has none.
pub fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_never_lead_outside() {
        for path in ["/etc/passwd", "../x", "a/../../x", "a/..", "", ".", "C:\\x", "a\\..\\b", "C:/x", "a\0"]
        {
            assert_eq!(normalise(path), Err(ResourceError::Outside), "{path:?}");
        }
        assert_eq!(normalise("./a//b/./c"), Ok("a/b/c".to_owned()));
    }

    #[test]
    fn uris_resolve_through_the_map_only() {
        let packages = [("arm".to_owned(), "robots/arm".to_owned()), ("bad".to_owned(), "..".to_owned())];
        let resolve = |uri| resolve_uri(uri, "robots", &packages);
        assert_eq!(resolve("package://arm/meshes/a.stl"), Ok("robots/arm/meshes/a.stl".to_owned()));
        assert_eq!(resolve("meshes/a.stl"), Ok("robots/meshes/a.stl".to_owned()));
        assert_eq!(resolve("package://other/a.stl"), Err(ResourceError::UnknownPackage));
        assert_eq!(resolve("package://arm/../../x"), Err(ResourceError::Outside));
        assert_eq!(resolve("package://bad/x"), Err(ResourceError::Outside));
        assert_eq!(resolve("file:///etc/passwd"), Err(ResourceError::UnknownScheme));
        assert_eq!(resolve("http://example.org/x"), Err(ResourceError::UnknownScheme));
    }

    #[test]
    fn folder_reads_inside_and_refuses_links_out() {
        let outside = tempfile::tempdir().unwrap();
        std::fs::write(outside.path().join("secret"), "x").unwrap();
        let inside = tempfile::tempdir().unwrap();
        std::fs::create_dir(inside.path().join("a")).unwrap();
        std::fs::write(inside.path().join("a/b.urdf"), "<robot/>").unwrap();
        let folder = Folder::new(inside.path());
        assert_eq!(folder.read("a/b.urdf", 100).unwrap(), b"<robot/>");
        assert_eq!(folder.read("a/b.urdf", 3), Err(ResourceError::TooLarge(3)));
        assert_eq!(folder.read("a/c.urdf", 100), Err(ResourceError::NotFound));
        assert_eq!(folder.read("a", 100), Err(ResourceError::NotFound));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(outside.path().join("secret"), inside.path().join("link")).unwrap();
            assert_eq!(folder.read("link", 100), Err(ResourceError::Outside));
        }
    }
}
