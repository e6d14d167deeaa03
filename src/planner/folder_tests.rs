//! Compiled workcells in a folder: nothing depends on them but time, whatever becomes of the files.

use std::fs;
use std::path::{Path, PathBuf};

use rand::Rng as _;

use super::PlannerCache;
use super::folder::{DEFAULT_BYTES, FORMAT, Folder};
use super::tests::{plans, random_2x2};
use crate::run::{Control, Seed};

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    all.sort();
    all
}

fn sample(length: usize) -> Vec<u64> {
    (0..length as u64).map(|n| n.wrapping_mul(0x9e37_79b9_7f4a_7c15)).collect()
}

#[test]
fn plans_are_the_same_from_a_folder() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (random_2x2(1), random_2x2(2));
    let cold = plans(&PlannerCache::new(0), &first);
    assert!(!cold.is_empty());
    // Every cache is another process.
    let cache = || PlannerCache::new(0).with_folder(folder.path(), None);
    plans(&cache(), &second);
    assert_eq!(files(folder.path()).len(), 1);
    let read = cache().get(&first, &Control::unbounded());
    assert!(!read.memory().is_empty(), "what the other run found out is there");
    assert_eq!(plans(&cache(), &first), cold);
    assert_eq!(plans(&cache(), &first), cold);
    // A file that is all wrong is passed over, and written anew.
    let path = files(folder.path()).remove(0);
    fs::write(&path, b"not a workcell").unwrap();
    assert_eq!(plans(&cache(), &first), cold);
    assert!(fs::metadata(&path).unwrap().len() > 10_000);
    assert_eq!(files(folder.path()), [path]);
}

#[test]
fn damage_anywhere_is_found() {
    let place = tempfile::tempdir().unwrap();
    let folder = Folder::new(place.path(), DEFAULT_BYTES);
    let words = sample(300);
    folder.save("a", &words);
    assert_eq!(folder.load("a"), Some(words.clone()));
    assert_eq!(folder.load("b"), None);
    let path = files(place.path()).remove(0);
    let whole = fs::read(&path).unwrap();
    let mut rng = Seed(3).stream("damage");
    for _ in 0..300 {
        let mut bytes = whole.clone();
        let at = rng.random_range(0..bytes.len());
        bytes[at] ^= 1 << rng.random_range(0..8);
        fs::write(&path, &bytes).unwrap();
        assert_eq!(folder.load("a"), None, "byte {at}");
    }
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        assert_eq!(folder.load("a"), None, "{length} bytes");
    }
    let longer: Vec<u8> = whole.iter().copied().chain([0; 8]).collect();
    fs::write(&path, longer).unwrap();
    assert_eq!(folder.load("a"), None);
    // Saving mends it.
    folder.save("a", &words);
    assert_eq!(folder.load("a"), Some(words));
}

#[test]
fn another_format_or_another_workcell_is_passed_over() {
    use sha2::{Digest as _, Sha256};

    let place = tempfile::tempdir().unwrap();
    let folder = Folder::new(place.path(), DEFAULT_BYTES);
    folder.save("a", &sample(50));
    let path = files(place.path()).remove(0);
    let whole = fs::read(&path).unwrap();
    // The format of an older version, its checksum right.
    let mut older = whole[..whole.len() - 32].to_vec();
    older[8..16].copy_from_slice(&(FORMAT - 1).to_be_bytes());
    let checksum = Sha256::digest(&older);
    older.extend(checksum);
    fs::write(&path, older).unwrap();
    assert_eq!(folder.load("a"), None);
    // A file under another one's name.
    fs::write(&path, whole).unwrap();
    folder.save("b", &sample(60));
    let other = files(place.path()).into_iter().find(|file| *file != path).unwrap();
    fs::copy(&path, other).unwrap();
    assert_eq!((folder.load("a"), folder.load("b")), (Some(sample(50)), None));
}

#[test]
fn a_folder_is_bounded_and_what_was_used_last_stays() {
    let place = tempfile::tempdir().unwrap();
    let words = sample(100);
    let size = 8 * words.len() as u64 + 200;
    let folder = Folder::new(place.path(), 3 * size);
    // Times in the past, so that nothing hangs on how finely a file system tells them.
    let age = |path: &Path, s: u64| {
        let file = fs::File::options().append(true).open(path).unwrap();
        file.set_modified(std::time::SystemTime::now() - std::time::Duration::from_secs(s)).unwrap();
    };
    for (key, s) in [("a", 300), ("b", 200), ("c", 100)] {
        let before = files(place.path());
        folder.save(key, &words);
        let new = files(place.path()).into_iter().find(|file| !before.contains(file)).unwrap();
        age(&new, s);
    }
    assert!(folder.load("a").is_some(), "and so it was used last");
    folder.save("d", &words);
    let there = ["a", "b", "c", "d"].map(|key| folder.load(key).is_some());
    assert_eq!(there, [true, false, true, true]);
    // What would fill the folder alone is not kept at all.
    folder.save("e", &sample(1000));
    assert!(folder.load("e").is_none() && folder.load("d").is_some());
}

#[test]
fn a_folder_that_cannot_be_written_changes_nothing() {
    let place = tempfile::tempdir().unwrap();
    // Root may write anywhere, so a file stands where the folder should be.
    let occupied = place.path().join("occupied");
    fs::write(&occupied, b"").unwrap();
    let problem = random_2x2(1);
    let cold = plans(&PlannerCache::new(0), &problem);
    assert_eq!(plans(&PlannerCache::new(0).with_folder(&occupied, None), &problem), cold);
    assert_eq!(fs::read(&occupied).unwrap(), b"");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let locked = place.path().join("locked");
        fs::create_dir(&locked).unwrap();
        fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
        assert_eq!(plans(&PlannerCache::new(0).with_folder(&locked, None), &problem), cold);
        fs::set_permissions(&locked, fs::Permissions::from_mode(0o755)).unwrap();
    }
}

#[test]
fn many_may_read_and_write_at_once() {
    let place = tempfile::tempdir().unwrap();
    let long = sample(20_000);
    std::thread::scope(|scope| {
        for length in [20_000, 15_000, 10_000, 5_000] {
            let (place, long) = (place.path(), &long);
            scope.spawn(move || {
                let folder = Folder::new(place, DEFAULT_BYTES);
                for _ in 0..40 {
                    folder.save("a", &long[..length]);
                    let read = folder.load("a").expect("a whole file is there at any time");
                    assert!(read.len() >= 5_000 && read == long[..read.len()]);
                }
            });
        }
    });
    assert_eq!(files(place.path()).len(), 1, "nothing unfinished is left");
}
