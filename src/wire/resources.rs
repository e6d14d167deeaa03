//! Where the files that a problem refers to come from, and where they may never come from.

use std::io::Read as _;
use std::path::PathBuf;

use super::problem::KnownRobots;

/// Gives the content of what a document refers to, and may keep what was made of the like before. Implementations touch
/// no network and start no process.
pub trait Resources {
    /// The bytes at `path`, a path with forward slashes relative to the document's folder or bundle: neither absolute nor
    /// with `..`.
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
    /// The path is absolute, of another kind, or no path to a file.
    #[error("the path must be relative, with forward slashes, and lead to a file")]
    NotRelative,
    /// The path leads out of where it may lead.
    #[error("the path, or a link on it, leads out of the folder that the files may come from")]
    Outside,
    /// There is no such file.
    #[error("there is no such file, seen from the problem's folder")]
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

/// Files in one folder and below it: for the command line, with the problem file's folder. A path never leads out of it, not by
/// a link either.
#[derive(Debug, Clone)]
pub struct Folder {
    root: PathBuf,
}

impl Folder {
    /// Files as seen from `root`.
    pub fn new(root: impl Into<PathBuf>) -> Self {
        Self { root: root.into() }
    }
}

impl Resources for Folder {
    fn read(&self, path: &str, max_bytes: usize) -> Result<Vec<u8>, ResourceError> {
        let parts = fold(parts_of(path)?)?;
        let find = |error: std::io::Error| match error.kind() {
            std::io::ErrorKind::NotFound => ResourceError::NotFound,
            kind => ResourceError::Unreadable(kind),
        };
        let root = self.root.canonicalize().map_err(find)?;
        let file = root.join(parts.join("/")).canonicalize().map_err(find)?;
        if !file.starts_with(&root) {
            return Err(ResourceError::Outside);
        }
        let metadata = file.metadata().map_err(find)?;
        if !metadata.is_file() {
            return Err(ResourceError::NotFound);
        }
        let mut content = Vec::new();
        let most = max_bytes as u64 + 1;
        std::fs::File::open(&file)
            .and_then(|file| file.take(most).read_to_end(&mut content))
            .map_err(find)?;
        if content.len() > max_bytes { Err(ResourceError::TooLarge(max_bytes)) } else { Ok(content) }
    }
}

/// The part of a path that leads to the folder above.
const PARENT: &str = "..";

/// The parts of a relative path, its `.` dropped and its `..` kept. What is no plain character of a path on some system is
/// refused, and nothing is decoded: `%2e` is three characters of a name.
fn parts_of(path: &str) -> Result<Vec<&str>, ResourceError> {
    if path.starts_with('/') || path.contains(['\\', '\0', ':']) {
        return Err(ResourceError::NotRelative);
    }
    Ok(path.split('/').filter(|part| !matches!(*part, "" | ".")).collect())
}

/// The parts without those that a `..` after them takes back.
fn fold(parts: Vec<&str>) -> Result<Vec<&str>, ResourceError> {
    let mut folded: Vec<&str> = Vec::with_capacity(parts.len());
    for part in parts {
        if part == PARENT {
            folded.pop().ok_or(ResourceError::Outside)?;
        } else {
            folded.push(part);
        }
    }
    Ok(folded)
}

/// `path` with its `.` parts dropped, for names that have no business with `..` at all.
///
/// # Errors
/// When it is absolute, empty, holds `..`, a backslash, a colon or a NUL.
pub fn normalise(path: &str) -> Result<String, ResourceError> {
    let parts = parts_of(path)?;
    if parts.contains(&PARENT) {
        return Err(ResourceError::Outside);
    }
    if parts.is_empty() { Err(ResourceError::NotRelative) } else { Ok(parts.join("/")) }
}

/// The path, relative to the document, that `uri` means when it stands in a file of folder `base` (relative to the document
/// as well; empty for the document itself). `packages` maps package names to folders. What counts is where the whole path
/// leads: `..` may take back parts of the folder, but may not lead out of the document's.
///
/// # Errors
/// When it leads out, is absolute, names an unknown package, or has another scheme.
pub fn resolve_uri(uri: &str, base: &str, packages: &[(String, String)]) -> Result<String, ResourceError> {
    if let Some(rest) = uri.strip_prefix("package://") {
        let (name, path) = rest.split_once('/').ok_or(ResourceError::NotRelative)?;
        let (_, folder) =
            packages.iter().find(|(package, _)| package == name).ok_or(ResourceError::UnknownPackage)?;
        return join(folder, path);
    }
    if uri.contains("://") {
        return Err(ResourceError::UnknownScheme);
    }
    join(base, uri)
}

/// The file at `path` as seen from `folder`.
fn join(folder: &str, path: &str) -> Result<String, ResourceError> {
    let path = parts_of(path)?;
    if path.last().is_none_or(|name| *name == PARENT) {
        return Err(ResourceError::NotRelative);
    }
    let mut parts = parts_of(folder)?;
    parts.extend(path);
    Ok(fold(parts)?.join("/"))
}

/// Whether `folder` is one that paths may lead into; empty for the document's own.
///
/// # Errors
/// When it is absolute or leads out of the document's.
pub fn check_folder(folder: &str) -> Result<(), ResourceError> {
    fold(parts_of(folder)?).map(|_| ())
}

/// The folder part of a relative path; empty when it has none.
pub fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or("", |(folder, _)| folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_paths_never_lead_outside() {
        use ResourceError::{NotRelative, Outside};
        for path in ["/etc/passwd", "", ".", "C:\\x", "a\\..\\b", "C:/x", "a\0"] {
            assert_eq!(normalise(path), Err(NotRelative), "{path:?}");
        }
        for path in ["../x", "a/../../x", "a/..", "a/../b"] {
            assert_eq!(normalise(path), Err(Outside), "{path:?}");
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
        assert_eq!(resolve("package://arm/../hand/a.stl"), Ok("robots/hand/a.stl".to_owned()));
        assert_eq!(resolve("package://arm/../../../x"), Err(ResourceError::Outside));
        assert_eq!(resolve("package://arm"), Err(ResourceError::NotRelative));
        assert_eq!(resolve("package://arm//etc/passwd"), Err(ResourceError::NotRelative));
        assert_eq!(resolve("package://bad/x"), Err(ResourceError::Outside));
        assert_eq!(resolve("file:///etc/passwd"), Err(ResourceError::UnknownScheme));
        assert_eq!(resolve("http://example.org/x"), Err(ResourceError::UnknownScheme));
    }

    #[test]
    fn what_counts_is_where_the_whole_path_leads() {
        let inside = |uri| resolve_uri(uri, "robots/urdf", &[]);
        assert_eq!(inside("../meshes/t.obj"), Ok("robots/meshes/t.obj".to_owned()));
        assert_eq!(inside("a/../../x"), Ok("robots/x".to_owned()));
        assert_eq!(inside("./..//../x/./y"), Ok("x/y".to_owned()));
        // Nothing is decoded: these are names of folders.
        assert_eq!(inside("%2e%2e/x"), Ok("robots/urdf/%2e%2e/x".to_owned()));
        assert_eq!(inside("..%2fx"), Ok("robots/urdf/..%2fx".to_owned()));
        assert_eq!(inside(".../x"), Ok("robots/urdf/.../x".to_owned()));
        for uri in ["/etc/passwd", "..\\x", "..\\..\\..\\x", "C:x", "", ".", "..", "x/..", "../x\0"] {
            assert_eq!(inside(uri), Err(ResourceError::NotRelative), "{uri:?}");
        }
        for uri in ["../../../x", "a/../../../../x", "../../../robots/urdf/x"] {
            assert_eq!(inside(uri), Err(ResourceError::Outside), "{uri:?}");
        }
        // From the document itself.
        assert_eq!(resolve_uri("a/../../x", "", &[]), Err(ResourceError::Outside));
        assert_eq!(resolve_uri("a/../x", "", &[]), Ok("x".to_owned()));
        assert!(check_folder("").is_ok() && check_folder("a/..").is_ok());
        assert_eq!(check_folder("../p"), Err(ResourceError::Outside));
        assert_eq!(check_folder("/p"), Err(ResourceError::NotRelative));
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

    #[test]
    fn folder_never_reads_above() {
        let all = tempfile::tempdir().unwrap();
        for folder in ["problems/old", "robots"] {
            std::fs::create_dir_all(all.path().join(folder)).unwrap();
        }
        std::fs::write(all.path().join("robots/b.urdf"), "<robot/>").unwrap();
        let folder = Folder::new(all.path().join("problems"));
        for path in ["../robots/b.urdf", "old/../../robots/b.urdf", &"../".repeat(500)] {
            assert_eq!(folder.read(path, 100), Err(ResourceError::Outside), "{path}");
        }
        let absolute = all.path().join("robots/b.urdf");
        assert_eq!(folder.read(absolute.to_str().unwrap(), 100), Err(ResourceError::NotRelative));
        assert_eq!(Folder::new(all.path()).read("problems/../robots/b.urdf", 100).unwrap(), b"<robot/>");
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(all.path().join("robots"), all.path().join("problems/near")).unwrap();
            assert_eq!(folder.read("near/b.urdf", 100), Err(ResourceError::Outside));
        }
    }
}
