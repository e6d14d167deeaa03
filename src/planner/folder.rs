//! Compiled workcells in a folder, from one process to the next.
//!
//! Each has a file of its own, named after a digest of all that it depends on: the workcell and what
//! of the options matters, the instruction set, and the build of this program. A file that is damaged,
//! cut short, or of another format or build is passed over, and written anew when the workcell has been
//! compiled. Files are written beside their place and then renamed, so that processes may share
//! a folder. Nothing that goes wrong here fails a run: it only takes longer.

use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use sha2::{Digest, Sha256};

use crate::collision::instructions;
use crate::run::touch;

/// What a file begins with: `QUADCELL`.
const MAGIC: u64 = u64::from_be_bytes(*b"QUADCELL");

/// The order of what a file holds; raised whenever that changes.
pub(super) const FORMAT: u64 = 1;

/// Words before the content: magic, format, digest of what it depends on, number of words.
const HEAD: usize = 2 + DIGEST + 1;

/// Words of a digest.
const DIGEST: usize = 4;

/// Files larger than this (bytes) are neither written nor read.
const LARGEST_FILE: usize = 64 << 20;

/// Bytes that all files may take unless told otherwise.
pub(super) const DEFAULT_BYTES: u64 = 512 << 20;

/// The files' extension, and that of those that are being written.
const EXTENSION: &str = "workcell";
const UNFINISHED: &str = "unfinished";

/// A folder of compiled workcells.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    /// What all files together may take (bytes).
    most: u64,
    /// What the answers depend on beside the question.
    build: String,
}

impl Folder {
    /// The folder at `path`, which is made when there is something to keep.
    pub(super) fn new(path: &Path, most: u64) -> Self {
        Self { path: path.to_owned(), most, build: build() }
    }

    /// What was kept under `key`, if it is there and whole.
    pub(super) fn load(&self, key: &str) -> Option<Vec<u64>> {
        let digest = self.digest(key);
        let path = self.file(&digest);
        let mut file = fs::File::open(&path).ok()?;
        let mut bytes = Vec::new();
        file.by_ref().take(LARGEST_FILE as u64 + 1).read_to_end(&mut bytes).ok()?;
        let words = content(&bytes, &digest);
        match &words {
            // The one used last is the last one to go.
            Some(_) => touch(&path),
            None => {
                tracing::debug!(path = %path.display(), "passed over: no compiled workcell of this build")
            }
        }
        words
    }

    /// Keeps `words` under `key`, and lets those go that were not used for longest.
    pub(super) fn save(&self, key: &str, words: &[u64]) {
        let digest = self.digest(key);
        let bytes = file_of(words, &digest);
        if bytes.len() > LARGEST_FILE || bytes.len() as u64 > self.most {
            return;
        }
        if let Err(error) = self.write(&self.file(&digest), &bytes).and_then(|()| self.tidy()) {
            tracing::debug!(path = %self.path.display(), %error, "a compiled workcell could not be kept");
        }
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        static NUMBER: AtomicU64 = AtomicU64::new(0);
        fs::create_dir_all(&self.path)?;
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let beside = path.with_extension(format!("{}-{number}.{UNFINISHED}", std::process::id()));
        let written = fs::write(&beside, bytes).and_then(|()| fs::rename(&beside, path));
        if written.is_err() {
            // It may not even be there.
            let _ = fs::remove_file(&beside);
        }
        written
    }

    /// Removes those files that were not used for longest until the rest has room.
    fn tidy(&self) -> io::Result<()> {
        let mut files = Vec::new();
        for entry in fs::read_dir(&self.path)? {
            let entry = entry?;
            let path = entry.path();
            let ours = path.extension().is_some_and(|end| end == EXTENSION || end == UNFINISHED);
            // Another process may have been faster.
            if let (true, Ok(about)) = (ours, entry.metadata()) {
                files.push((about.modified()?, path, about.len()));
            }
        }
        files.sort();
        let mut bytes: u64 = files.iter().map(|file| file.2).sum();
        for (_, path, size) in files {
            if bytes <= self.most {
                break;
            }
            match fs::remove_file(&path) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => bytes -= size,
            }
        }
        Ok(())
    }

    fn digest(&self, key: &str) -> [u64; DIGEST] {
        let bytes = Sha256::digest(format!("{}\n{key}", self.build));
        let mut digest = [0; DIGEST];
        digest.iter_mut().zip(words_of(&bytes)).for_each(|(place, word)| *place = word);
        digest
    }

    fn file(&self, digest: &[u64; DIGEST]) -> PathBuf {
        let name: String = digest.iter().map(|word| format!("{word:016x}")).collect();
        self.path.join(name).with_extension(EXTENSION)
    }
}

/// What tells this build of the program and the instructions that it uses from others.
fn build() -> String {
    let program = std::env::current_exe().and_then(fs::metadata);
    let stamp = program.and_then(|about| {
        let changed = about.modified()?.duration_since(std::time::UNIX_EPOCH);
        Ok((about.len(), changed.unwrap_or_default().as_nanos()))
    });
    let (length, changed) = stamp.unwrap_or_default();
    format!("{} {length} {changed} {}", env!("CARGO_PKG_VERSION"), instructions())
}

/// A file of `words`.
fn file_of(words: &[u64], digest: &[u64; DIGEST]) -> Vec<u8> {
    let head = [MAGIC, FORMAT].into_iter().chain(*digest).chain([words.len() as u64]);
    let mut bytes: Vec<u8> = head.chain(words.iter().copied()).flat_map(u64::to_be_bytes).collect();
    let checksum = Sha256::digest(&bytes);
    bytes.extend(checksum);
    bytes
}

/// What a file holds, if it is whole and for `digest`.
fn content(bytes: &[u8], digest: &[u64; DIGEST]) -> Option<Vec<u64>> {
    let (rest, checksum) = bytes.split_at_checked(bytes.len().checked_sub(8 * DIGEST)?)?;
    if !rest.len().is_multiple_of(8) || rest.len() < 8 * HEAD || Sha256::digest(rest).as_slice() != checksum {
        return None;
    }
    let mut words: Vec<u64> = words_of(rest).collect();
    let counted = (words.len() - HEAD) as u64;
    let expected = [MAGIC, FORMAT].into_iter().chain(*digest).chain([counted]);
    if !words.iter().copied().take(HEAD).eq(expected) {
        return None;
    }
    words.drain(..HEAD);
    Some(words)
}

/// Bytes by eights.
fn words_of(bytes: &[u8]) -> impl Iterator<Item = u64> + '_ {
    bytes.chunks_exact(8).map(|chunk| chunk.iter().fold(0, |word, byte| word << 8 | u64::from(*byte)))
}
