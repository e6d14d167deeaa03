//! The scenarios that ship, as they lie in the repository.

/// A scenario that ships.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CatalogEntry {
    /// Its name: family and size, such as `switch/2x2`.
    pub name: &'static str,
    /// Its family.
    pub family: &'static str,
    /// How many arms it has.
    pub arms: usize,
    /// How many objects it has.
    pub objects: usize,
    /// The problem document.
    pub text: &'static str,
}

macro_rules! entries {
    ($($family:literal: $($arms:literal x $objects:literal),+;)+) => {
        &[$($(
            CatalogEntry {
                name: concat!($family, "/", $arms, "x", $objects),
                family: $family,
                arms: $arms,
                objects: $objects,
                text: include_str!(
                    concat!("../../scenarios/", $family, "/", $arms, "x", $objects, ".json")
                ),
            },
        )+)+]
    };
}

const CATALOG: &[CatalogEntry] = entries! {
    "switch": 2 x 2, 4 x 4, 6 x 4, 9 x 4;
    "side_to_side": 2 x 2, 4 x 4, 6 x 4, 9 x 4;
    "random": 2 x 2, 4 x 4, 6 x 4, 9 x 4;
    "in_place_swap": 1 x 2, 2 x 2, 3 x 2;
    "derangement": 1 x 4, 2 x 6;
};

/// All scenarios that ship.
pub fn catalog() -> &'static [CatalogEntry] {
    CATALOG
}

/// The scenario called `name`.
pub fn find(name: &str) -> Option<&'static CatalogEntry> {
    CATALOG.iter().find(|entry| entry.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Family, generate, to_text};
    use crate::wire::{LibraryOnly, ReadLimits, read_problem};

    /// The seed of the files.
    const SEED: u64 = 0;

    #[test]
    fn files_are_what_the_generator_makes_and_read_without_faults() {
        for entry in catalog() {
            let family: Family = entry.family.parse().unwrap();
            let made = to_text(&generate(family, entry.arms, entry.objects, SEED).unwrap());
            if std::env::var_os("QUADRILLE_WRITE_SCENARIOS").is_some() {
                let path = format!("{}/scenarios/{}.json", env!("CARGO_MANIFEST_DIR"), entry.name);
                std::fs::write(path, &made).unwrap();
                continue;
            }
            assert_eq!(entry.text, made, "{} differs from the generator", entry.name);
            let read = read_problem(entry.text.as_bytes(), &LibraryOnly, &ReadLimits::default());
            assert!(read.is_ok_and(|read| read.warnings.is_empty()), "{}", entry.name);
        }
    }

    #[test]
    fn names_are_found() {
        assert_eq!(find("switch/2x2").map(|entry| entry.objects), Some(2));
        assert!(find("switch/3x3").is_none());
    }
}
