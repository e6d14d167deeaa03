//! Unpacking a bundle from outside, zip or tar.gz, in memory and within bounds.
//!
//! Nothing touches the disk. Only plain files and folders are taken: no links, no devices, no
//! encryption, no absolute paths and no `..`.

use std::collections::BTreeMap;
use std::io::Read;
use std::sync::Arc;

use flate2::Crc;
use flate2::read::{DeflateDecoder, GzDecoder};

use crate::wire::normalise;

/// Longest path in a bundle (bytes).
const LONGEST_PATH: usize = 512;
/// What the headers of one entry may take beside its content, in a tar file (bytes).
const TAR_OVERHEAD: usize = 4096;
/// Small bundles may be packed as tightly as they like up to this size (bytes).
const FREE_OF_RATIO: usize = 1 << 20;

/// How large a bundle may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ArchiveLimits {
    /// Most files.
    pub entries: usize,
    /// Most bytes of all files together.
    pub unpacked_bytes: usize,
    /// Most bytes of one file.
    pub file_bytes: usize,
    /// Greatest ratio of unpacked to packed size.
    pub ratio: usize,
}

impl Default for ArchiveLimits {
    fn default() -> Self {
        Self { entries: 1000, unpacked_bytes: 128 << 20, file_bytes: 32 << 20, ratio: 100 }
    }
}

/// Why an archive is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ArchiveError {
    /// It is no archive of this kind, or a broken one.
    #[error("the archive cannot be read: {0}")]
    Broken(String),
    /// It holds something that is not taken.
    #[error("`{path}`: {why}")]
    Refused {
        /// Which entry.
        path: String,
        /// What is wrong with it.
        why: &'static str,
    },
    /// It holds more than is taken.
    #[error("the archive holds more than {limit} {what}")]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How much is taken.
        limit: usize,
    },
}

/// The files of a bundle by their paths.
pub type Files = BTreeMap<String, Arc<[u8]>>;

fn broken(why: impl std::fmt::Display) -> ArchiveError {
    ArchiveError::Broken(why.to_string())
}

/// Files as they are taken in, within bounds.
struct Intake {
    limits: ArchiveLimits,
    /// What is left of the bound on all files.
    left: usize,
    bound: (&'static str, usize),
    files: Files,
}

impl Intake {
    fn new(limits: ArchiveLimits, packed: usize) -> Self {
        let by_ratio = packed.saturating_mul(limits.ratio).max(FREE_OF_RATIO);
        let bound = if by_ratio < limits.unpacked_bytes {
            ("times its packed size", limits.ratio)
        } else {
            ("bytes unpacked", limits.unpacked_bytes)
        };
        Self { limits, left: by_ratio.min(limits.unpacked_bytes), bound, files: Files::new() }
    }

    /// Takes a file whose content comes from `source`.
    fn take(&mut self, path: &str, source: impl Read) -> Result<&Arc<[u8]>, ArchiveError> {
        let shown = || path.chars().take(100).collect::<String>();
        let inside = normalise(path).ok().filter(|inside| inside.len() <= LONGEST_PATH);
        let Some(inside) = inside else {
            let why = "paths are relative, without `..`, backslashes or colons, and not too long";
            return Err(ArchiveError::Refused { path: shown(), why });
        };
        if self.files.contains_key(&inside) {
            return Err(ArchiveError::Refused { path: shown(), why: "it stands twice" });
        }
        if self.files.len() >= self.limits.entries {
            return Err(ArchiveError::TooLarge { what: "files", limit: self.limits.entries });
        }
        let most = self.left.min(self.limits.file_bytes);
        let mut content = Vec::new();
        source.take(most as u64 + 1).read_to_end(&mut content).map_err(broken)?;
        if content.len() > self.limits.file_bytes {
            return Err(ArchiveError::TooLarge { what: "bytes in one file", limit: self.limits.file_bytes });
        }
        if content.len() > most {
            return Err(ArchiveError::TooLarge { what: self.bound.0, limit: self.bound.1 });
        }
        self.left -= content.len();
        Ok(self.files.entry(inside).or_insert_with(|| content.into()))
    }
}

/// The files of a gzipped tar archive.
///
/// # Errors
/// [`ArchiveError`].
pub fn unpack_tar_gz(bytes: &[u8], limits: ArchiveLimits) -> Result<Files, ArchiveError> {
    let mut intake = Intake::new(limits, bytes.len());
    // Headers count too: a stream of empty entries must end somewhere.
    let most = intake.left.saturating_add(limits.entries.saturating_mul(TAR_OVERHEAD)) as u64;
    let mut archive = tar::Archive::new(GzDecoder::new(bytes).take(most));
    let mut folders = 0;
    for entry in archive.entries().map_err(broken)? {
        let entry = entry.map_err(broken)?;
        let kind = entry.header().entry_type();
        let path =
            String::from_utf8(entry.path_bytes().into_owned()).map_err(|_| broken("a path is not UTF-8"))?;
        if kind.is_dir() {
            folders += 1;
            if folders > limits.entries {
                return Err(ArchiveError::TooLarge { what: "folders", limit: limits.entries });
            }
        } else if kind.is_file() || kind.is_contiguous() {
            let announced = entry.size();
            let taken = intake.take(&path, entry)?.len() as u64;
            if taken != announced {
                return Err(broken("it breaks off"));
            }
        } else if kind.is_pax_global_extensions() {
            // Comments for the whole archive, as `git archive` writes them.
        } else {
            let path = path.chars().take(100).collect();
            return Err(ArchiveError::Refused { path, why: "only plain files and folders are taken" });
        }
    }
    // What follows the last entry is read too: the checksum stands at the very end.
    std::io::copy(&mut archive.into_inner(), &mut std::io::sink()).map_err(broken)?;
    Ok(intake.files)
}

/// A little-endian number of `N` bytes at `at`.
fn number<const N: usize>(bytes: &[u8], at: usize) -> Result<u32, ArchiveError> {
    let field =
        at.checked_add(N).and_then(|end| bytes.get(at..end)).ok_or_else(|| broken("it is cut off"))?;
    Ok(field.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
}

/// The start of the record that ends a zip archive: it is within a comment's length of the end.
fn end_of_directory(bytes: &[u8]) -> Option<usize> {
    let last = bytes.len().checked_sub(22)?;
    let first = last.saturating_sub(usize::from(u16::MAX));
    (first..=last).rev().find(|at| {
        let comment = number::<2>(bytes, at + 20).unwrap_or(u32::MAX) as usize;
        bytes.get(*at..at + 4) == Some(b"PK\x05\x06") && at + 22 + comment == bytes.len()
    })
}

/// The files of a zip archive: stored or deflated, not encrypted, in one part, below 4 GiB.
///
/// # Errors
/// [`ArchiveError`].
pub fn unpack_zip(bytes: &[u8], limits: ArchiveLimits) -> Result<Files, ArchiveError> {
    let end = end_of_directory(bytes).ok_or_else(|| broken("it has no zip directory"))?;
    let (here, all) = (number::<2>(bytes, end + 8)?, number::<2>(bytes, end + 10)?);
    let mut at = number::<4>(bytes, end + 16)? as usize;
    if here != all || number::<2>(bytes, end + 4)? != 0 || all == 0xffff || at == 0xffff_ffff {
        return Err(broken("archives in several parts and zip64 are not taken"));
    }
    if all as usize > 2 * limits.entries {
        return Err(ArchiveError::TooLarge { what: "files", limit: limits.entries });
    }
    let mut intake = Intake::new(limits, bytes.len());
    for _ in 0..all {
        if bytes.get(at..at.saturating_add(4)) != Some(b"PK\x01\x02") {
            return Err(broken("its directory is damaged"));
        }
        let (flags, method) = (number::<2>(bytes, at + 8)?, number::<2>(bytes, at + 10)?);
        let (crc, packed) = (number::<4>(bytes, at + 16)?, number::<4>(bytes, at + 20)? as usize);
        let size = number::<4>(bytes, at + 24)? as usize;
        let lengths = [28, 30, 32].map(|field| number::<2>(bytes, at + field).map(|length| length as usize));
        let [name, extra, comment] = lengths;
        let (name, extra, comment) = (name?, extra?, comment?);
        let unix_mode = number::<4>(bytes, at + 38)? >> 16;
        let header = number::<4>(bytes, at + 42)? as usize;
        let path = bytes.get(at + 46..at + 46 + name).ok_or_else(|| broken("it is cut off"))?;
        let path = std::str::from_utf8(path).map_err(|_| broken("a path is not UTF-8"))?;
        at += 46 + name + extra + comment;
        let refused = |why| ArchiveError::Refused { path: path.chars().take(100).collect(), why };
        if !matches!(unix_mode & 0o170_000, 0 | 0o100_000 | 0o040_000) {
            return Err(refused("only plain files and folders are taken"));
        }
        if flags & 0x2041 != 0 {
            return Err(refused("it is encrypted"));
        }
        if path.ends_with('/') {
            continue;
        }
        let content = local_content(bytes, header, packed)?;
        let taken = match method {
            0 => intake.take(path, content)?,
            8 => intake.take(path, DeflateDecoder::new(content))?,
            _ => return Err(refused("it is neither stored nor deflated")),
        };
        let mut sum = Crc::new();
        sum.update(taken);
        if taken.len() != size || sum.sum() != crc {
            return Err(refused("its size or checksum is not what the directory says"));
        }
    }
    Ok(intake.files)
}

/// The packed content behind the local header at `header`.
fn local_content(bytes: &[u8], header: usize, packed: usize) -> Result<&[u8], ArchiveError> {
    let cut = || broken("it is cut off");
    if bytes.get(header..header.saturating_add(4)) != Some(b"PK\x03\x04") {
        return Err(broken("its directory is damaged"));
    }
    let (name, extra) = (number::<2>(bytes, header + 26)?, number::<2>(bytes, header + 28)?);
    let start = header + 30 + name as usize + extra as usize;
    start.checked_add(packed).and_then(|end| bytes.get(start..end)).ok_or_else(cut)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::{DeflateEncoder, GzEncoder};

    use super::*;

    const LIMITS: ArchiveLimits =
        ArchiveLimits { entries: 3, unpacked_bytes: 3 << 20, file_bytes: 2 << 20, ratio: 100 };

    /// One entry: path, content, unix mode.
    type Entry<'a> = (&'a str, &'a [u8], u32);

    fn zip(entries: &[Entry<'_>]) -> Vec<u8> {
        let (mut out, mut directory) = (Vec::new(), Vec::new());
        for (path, content, mode) in entries {
            let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
            encoder.write_all(content).unwrap();
            let packed = encoder.finish().unwrap();
            let mut sum = Crc::new();
            sum.update(content);
            let mut common = Vec::new();
            common.extend([20_u16, 0, 8, 0, 0].iter().flat_map(|field| field.to_le_bytes()));
            common.extend(
                [sum.sum(), packed.len() as u32, content.len() as u32].iter().flat_map(|f| f.to_le_bytes()),
            );
            common.extend([path.len() as u16, 0].iter().flat_map(|field| field.to_le_bytes()));
            let offset = out.len() as u32;
            out.extend(b"PK\x03\x04");
            out.extend(&common);
            out.extend(path.as_bytes());
            out.extend(&packed);
            directory.extend(b"PK\x01\x02\x14\x03");
            directory.extend(&common);
            directory.extend([0_u8; 6]);
            directory.extend((mode << 16).to_le_bytes());
            directory.extend(offset.to_le_bytes());
            directory.extend(path.as_bytes());
        }
        let (start, count) = (out.len() as u32, entries.len() as u16);
        out.extend(&directory);
        out.extend(b"PK\x05\x06\0\0\0\0");
        out.extend([count, count].iter().flat_map(|field| field.to_le_bytes()));
        out.extend([directory.len() as u32, start].iter().flat_map(|field| field.to_le_bytes()));
        out.extend([0, 0]);
        out
    }

    fn tar_gz(entries: &[Entry<'_>]) -> Vec<u8> {
        let mut builder = tar::Builder::new(GzEncoder::new(Vec::new(), Compression::best()));
        for (path, content, mode) in entries {
            let mut header = tar::Header::new_ustar();
            // Written past the builder, which refuses what the reader is to refuse.
            header.as_mut_bytes()[..path.len()].copy_from_slice(path.as_bytes());
            header.set_mode(0o644);
            header.set_size(content.len() as u64);
            header.set_entry_type(match mode & 0o170_000 {
                0o120_000 => tar::EntryType::Symlink,
                0o020_000 => tar::EntryType::Char,
                0o040_000 => tar::EntryType::Directory,
                _ => tar::EntryType::Regular,
            });
            header.set_cksum();
            builder.append(&header, *content).unwrap();
        }
        builder.into_inner().unwrap().finish().unwrap()
    }

    fn both(entries: &[Entry<'_>]) -> [Result<Files, ArchiveError>; 2] {
        [unpack_zip(&zip(entries), LIMITS), unpack_tar_gz(&tar_gz(entries), LIMITS)]
    }

    const FILE: u32 = 0o100_644;

    #[test]
    fn files_come_out_as_they_went_in() {
        let noise: Vec<u8> =
            (0..100_000_u32).flat_map(|n| n.wrapping_mul(2_654_435_761).to_le_bytes()).collect();
        for files in
            both(&[("a/", b"", 0o040_755), ("a/x.urdf", b"<robot/>", FILE), ("./b.stl", &noise, FILE)])
        {
            let files = files.unwrap();
            assert_eq!(files.keys().collect::<Vec<_>>(), ["a/x.urdf", "b.stl"]);
            assert_eq!((&*files["a/x.urdf"], &*files["b.stl"]), (&b"<robot/>"[..], &noise[..]));
        }
    }

    #[test]
    fn nothing_leads_outside() {
        for path in ["../x", "/etc/passwd", "a/../../x", "a\\b", "C:x", ""] {
            for result in both(&[(path, b"x", FILE)]) {
                assert!(matches!(result, Err(ArchiveError::Refused { .. })), "{path}: {result:?}");
            }
        }
        for mode in [0o120_777, 0o020_644] {
            for result in both(&[("x", b"", mode)]) {
                assert!(matches!(result, Err(ArchiveError::Refused { .. })), "{mode:o}: {result:?}");
            }
        }
        for result in both(&[("x", b"1", FILE), ("./x", b"2", FILE)]) {
            assert!(
                matches!(result, Err(ArchiveError::Refused { why: "it stands twice", .. })),
                "{result:?}"
            );
        }
    }

    #[test]
    fn every_size_is_bounded() {
        let zeros = vec![0_u8; (2 << 20) + 1];
        let what = |result: Result<Files, ArchiveError>| match result {
            Err(ArchiveError::TooLarge { what, .. }) => what,
            other => panic!("{other:?}"),
        };
        for result in both(&[("x", &zeros[..2 << 20], FILE)]) {
            assert_eq!(what(result), "times its packed size", "a bomb");
        }
        let generous = ArchiveLimits { ratio: 1_000_000, ..LIMITS };
        let large = [("x", &zeros[..], FILE)];
        assert_eq!(what(unpack_zip(&zip(&large), generous)), "bytes in one file");
        assert_eq!(what(unpack_tar_gz(&tar_gz(&large), generous)), "bytes in one file");
        let many = [("x", &zeros[..2 << 20], FILE), ("y", &zeros[..2 << 20], FILE)];
        assert_eq!(what(unpack_zip(&zip(&many), generous)), "bytes unpacked");
        assert_eq!(what(unpack_tar_gz(&tar_gz(&many), generous)), "bytes unpacked");
        let names = ["a", "b", "c", "d"].map(|name| (name, &b""[..], FILE));
        for result in both(&names) {
            assert_eq!(what(result), "files");
        }
    }

    #[test]
    fn damage_is_told_and_never_worse() {
        let entries: [Entry<'_>; 2] = [("x", b"some text that is packed", FILE), ("y", b"more of it", FILE)];
        for (good, unpack) in [
            (zip(&entries), unpack_zip as fn(&[u8], ArchiveLimits) -> Result<Files, ArchiveError>),
            (tar_gz(&entries), unpack_tar_gz),
        ] {
            let files = unpack(&good, LIMITS).unwrap();
            for cut in 0..good.len() {
                assert_ne!(unpack(&good[..cut], LIMITS).ok().as_ref(), Some(&files), "cut at {cut}");
                let mut flipped = good.clone();
                flipped[cut] ^= 0x55;
                let _ = unpack(&flipped, LIMITS);
            }
        }
        assert!(unpack_zip(b"", LIMITS).is_err() && unpack_tar_gz(b"", LIMITS).is_err());
    }
}
